"""Line-of-sight guidance that gives setpoints of heading and speed to the autopilots of a vehicle.

It is the guidance of `los_pid`, whose autopilots are here those of `auv_gym.effects.autopilot`. T. I. Fossen, Handbook
of Marine Craft Hydrodynamics and Motion Control, 2nd ed., 2021, section 12.4.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from auv_gym.effects.autopilot import LARGEST_TURN
from auv_gym.physics.errors import to_world
from auv_gym.physics.namespaces import FLOATS, Namespace, Number
from auv_gym.scenarios.names import SPEED_RANGES
from auv_gym.task.observation import Observation
from auv_gym.task.policy import Law
from baselines.gains.loading import adapted_gains, checked_gains
from baselines.policy import is_fast, reference_speed


class LosGains(NamedTuple):
    """Gains of the guidance."""

    lookahead: Number  # [s] look-ahead distance as a travel time of the reference
    crab: Number  # [1] share of the measured drift angle that the heading compensates
    lead: Number  # [s] by which the setpoint is ahead of a turn of the reference, for the lag of the autopilot
    along: Number  # [1/s] speed setpoint for an along-track error, over that error
    horizon: Number  # [s] bound of the along-track error as a travel time of the reference


@dataclass(frozen=True)
class LosSetpoints(Law):
    """The guidance. It has no memory, so it can be an expert of the analytic policy gradient.

    Args:
        slow: gains up to `policy.CRUISE_SPEED`.
        cruise: gains above it.
    """

    slow: LosGains
    cruise: LosGains

    def forces(self, o: Sequence[Number], ns: Namespace = FLOATS) -> tuple[Number, ...]:
        """Return the setpoints as shares of their ranges, times the limits by which `Law.predict` divides."""
        return self.setpoints(Observation._make(o), ns)

    def setpoints(self, o: Any, ns: Namespace) -> tuple[Number, Number]:
        """Return the setpoints of speed and heading, see `forces`, for an observation in the plane or in space."""
        fast, U = is_fast(o.u_R, o.v_R), reference_speed(o.u_R, o.v_R, ns)
        g = LosGains(*(ns.where(fast, cruise, slow) for slow, cruise in zip(self.slow, self.cruise, strict=True)))
        gamma = ns.arctan2(o.v_R, o.u_R)
        angle = o.psi_e - gamma  # heading minus course of the path
        along, across = to_world(o.e_x, o.e_y, ns.cos(angle), ns.sin(angle))
        drift = ns.arctan2(o.v_R + o.v_e, ns.clip(o.u_R + o.u_e, 0.5 * U, math.inf)) - gamma
        turn = g.lead * o.r_R - g.crab * drift - ns.arctan2(across, g.lookahead * U)
        bound = g.horizon * U
        bounded = along / ns.sqrt(1.0 + along * along / (bound * bound))
        return -g.along * bounded / U * o.F_u_max, turn / LARGEST_TURN * o.F_r_max


def make_los_setpoints(gains: Mapping[str, float] | None = None, vehicle: Any = None) -> LosSetpoints:
    """Return the guidance for a vehicle in the paper's units, with the recorded gains, or with `gains` at every speed.

    Raises:
        ValueError: see `adapted_gains`.
    """
    both = [los_gains(speed_range, gains, vehicle) for speed_range in SPEED_RANGES]
    return LosSetpoints(*both)


def los_gains(speed_range: str, gains: Mapping[str, float] | None, vehicle: Any) -> LosGains:
    """Return `gains`, or the recorded ones of a speed range or of motion in space."""
    names = LosGains._fields
    found = adapted_gains("los-setpoints", speed_range, names, vehicle) if gains is None else gains
    return LosGains(**checked_gains(found, names, "los-setpoints"))

"""Effects of scenarios in space, in place of or beside those of the plane."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

from auv_gym.effects.actuators import Astern, Delay, Fins, Reach
from auv_gym.effects.autopilot import Autopilot
from auv_gym.effects.base import At, Effect
from auv_gym.effects.current import Shear
from auv_gym.effects.faults import Faults, OffsetFaults
from auv_gym.effects.navigation import Outages
from auv_gym.effects.sensors import CorrelatedNoise
from auv_gym.physics.errors import to_world
from auv_gym.physics.namespaces import Number
from auv_gym.physics.vehicle import CrossTerms

_BOTH = [(f"{plane}_{name}", Number) for plane in ("level", "upright") for name in CrossTerms._fields]
MAX_PITCH = math.radians(80.0)
"""Pitch [rad] at which an episode ends: pitch and heading are singular at 90 degrees."""


class SpaceFins(Effect):
    """The moments of fins grow with the squared speed through water: `Actuators.fin`, for yaw and pitch."""

    thrust, limits = staticmethod(Fins.thrust), staticmethod(Fins.limits)

    class Constants(NamedTuple):
        """Its numbers in an episode."""

        fin_q: Number  # [kg] see `Actuators`
        fin_r: Number  # [kg]

    @classmethod
    def used(cls, scenario: Any) -> bool:
        """Return whether the vehicle has fins."""
        return any(scenario.vertical.fins(scenario.actuators))

    @classmethod
    def constants(cls, scenario: Any, _: Any) -> tuple[Number, ...]:
        """Return the numbers of both pairs of fins."""
        fins: tuple[Number, ...] = scenario.vertical.fins(scenario.actuators)
        return fins


class SpaceLift(Effect):
    """Lift in both planes, see `effects.mismatch.Lift`."""

    @classmethod
    def used(cls, scenario: Any) -> bool:
        """Return whether the vehicle has lift and no cross terms."""
        planes = scenario.vertical.planes(scenario)
        return any(plane.has_lift for plane in planes) and not SpaceCrossFlow.used(scenario)

    @staticmethod
    def vehicle(_: Sequence[Number], at: At) -> Sequence[Number]:
        """Return all coefficients."""
        row: Sequence[Number] = at.vehicle.row()
        return row


class SpaceCrossFlow(Effect):
    """Cross terms of the damping in both planes, and the side forces of fins, see `effects.mismatch.CrossFlow`."""

    numbers = "episode.vehicle.cross_terms"
    Constants = NamedTuple("Constants", _BOTH)  # type: ignore[misc]

    @classmethod
    def used(cls, scenario: Any) -> bool:
        """Return whether a plane of the vehicle has cross terms."""
        return any(plane.has_cross_terms for plane in scenario.vertical.planes(scenario))

    @staticmethod
    def vehicle(_: Sequence[Number], at: At) -> Sequence[Number]:
        """Return all coefficients with the cross terms."""
        row: Sequence[Number] = at.vehicle.row(at.own)
        return row


class Veer(Effect):
    """The current turns with depth, as in an Ekman spiral, and weakens with it: `Vertical.veer`, `Vertical.decay`.

    The current of a sample is that at the depth of the first reference.
    """

    class Constants(NamedTuple):
        """Its numbers in an episode."""

        z_0: Number  # [m] height at which the current is that of the sample
        veer: Number  # [rad/m] counter-clockwise per metre upward
        decay: Number  # [1/m]

    @classmethod
    def used(cls, scenario: Any) -> bool:
        """Return whether the current changes with depth."""
        return scenario.current is not None and (scenario.vertical.veer, scenario.vertical.decay) != (0.0, 0.0)

    @classmethod
    def constants(cls, _: Any, episode: Any) -> tuple[Number, ...]:
        """Return the numbers of the current's profile."""
        profile: tuple[Number, ...] = episode.profile
        return profile

    @staticmethod
    def current(current: Sequence[Number], at: At) -> tuple[Number, ...]:
        """Return the current at the height of the vehicle."""
        (V_x, V_y, V_z), up, ns = current, at.true("z") - at.own.z_0, at.ns
        angle, share = at.own.veer * up, ns.exp(at.own.decay * up)
        c, s = share * ns.cos(angle), share * ns.sin(angle)
        return *to_world(V_x, V_y, c, s), V_z


class Bounds(Effect):
    """An episode ends at the surface, and at a pitch of `MAX_PITCH`."""

    @classmethod
    def used(cls, _: Any) -> bool:
        """Return True: every scenario in space has it."""
        return True

    @staticmethod
    def failed(failed: Number, at: At) -> Number:
        """Return whether the episode has failed, also above the surface and with a steep pitch."""
        return failed | (at.true("z") > 0.0) | ((abs(at.true("theta")) <= MAX_PITCH) ^ True)


SPACE_PACKAGE: tuple[type[Effect], ...] = (
    Autopilot, Delay, Reach, CorrelatedNoise, Faults, OffsetFaults, Astern, SpaceFins, SpaceLift, SpaceCrossFlow, Veer,
    Shear, Outages, Bounds,
)  # fmt: skip
"""The effects of scenarios in space, in the order in which they act at a point."""

"""What a filter may believe beside the sea: that sensors are biased, and that actuators are weak and late.

None of it changes within an episode, so far as the filter knows, but it drifts a little, or the filter would stop
looking. A delay shows in nothing but when commands act: the filter keeps the last ones, and a delay between two whole
numbers of periods acts as a mixture of two.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from auv_gym.physics.actuators import LONGEST_DELAY
from auv_gym.physics.dynamics import Force
from auv_gym.physics.namespaces import Namespace, Number
from auv_gym.physics.vehicle import Coefficients
from baselines.estimation.sea_model import Estimate, transition


class Faults(NamedTuple):
    """What is wrong with sensors and actuators: floats, rows of shape (N,) or symbols."""

    heading: Number  # [rad] bias of the measured heading
    surge: Number  # [m/s] of the measured surge velocity over ground
    sway: Number  # [m/s]
    turn: Number  # [rad/s] of the measured yaw rate
    surge_share: Number  # [1] of the commanded force that acts
    yaw_share: Number  # [1]
    delay: Number  # control periods until a command acts


FAULTS = len(Faults._fields)  # how many rows `Faults` have
NO_FAULTS = Faults(0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 0.0)
"""Sensors and actuators as they should be."""
DRIFT = Faults(3e-4, 3e-4, 3e-4, 3e-5, 3e-3, 3e-3, 0.02)
"""Standard deviations of what each changes by in one second, in their units."""
_LEAST_SHARE = 0.3  # of a commanded force that is believed to act
FIRST_DELAY = 0.5  # control periods that are expected before the first measurement
MOMENT = 1e-3  # share of a period that counts as none
LATE = LONGEST_DELAY  # how many commands before the last one are kept


def prior_faults(tuning: Any) -> tuple[Faults, Faults]:
    """Return what is expected before the first measurement, and its standard deviations.

    Args:
        tuning: the fields of a `kalman.FaultTuning`.
    """
    t = tuning
    deviation = Faults(t.heading_bias, t.velocity_bias, t.velocity_bias, t.turn_bias, t.loss, t.loss, t.delay)
    return NO_FAULTS._replace(delay=FIRST_DELAY), deviation


def within_bounds(faults: Faults, ns: Namespace) -> Faults:
    """Return faults with shares and a delay that can be."""
    share_u, share_r = (ns.clip(x, _LEAST_SHARE, 1.0) for x in (faults.surge_share, faults.yaw_share))
    delay = ns.clip(faults.delay, 0.0, float(LATE))
    return faults._replace(surge_share=share_u, yaw_share=share_r, delay=delay)


def acting_forces(faults: Faults, actions: Sequence[Sequence[Number]], limits: Force, ns: Namespace) -> Force:
    """Return F_u [N], F_r [N m] that the actuators went for in the last period.

    Args:
        faults: of them.
        actions: the last 1 + `LATE` actions, the last one first.
        limits: what an action of 1 commands, F_u [N], F_r [N m].
        ns: the namespace of the numbers.
    """
    weights = [ns.clip(1.0 - abs(faults.delay - float(j)), 0.0, 1.0) for j in range(1 + LATE)]
    late = [
        sum((w * a for w, a in zip(weights[1:], past[1:], strict=True)), weights[0] * past[0])
        for past in zip(*actions, strict=True)
    ]
    return faults.surge_share * late[0] * limits[0], faults.yaw_share * late[1] * limits[1]


def arrived(
    z: Estimate,
    faults: Faults,
    actions: Sequence[Sequence[Number]],
    limits: Force,
    dt: Number,
    coefficients: Coefficients,
    ns: Namespace,
) -> Estimate:
    """Return the state at the time when what is commanded now begins to act, under the actions that are on their way.

    Args:
        z: the state now; the positions of the one returned are from where the reference is now, too.
        faults: of the actuators.
        actions: the last `LATE` ones, the last one first.
        limits: what an action of 1 commands, F_u [N], F_r [N m].
        dt: control period [s].
        coefficients: of the vehicle as it is known.
        ns: the namespace of the numbers.
    """
    for j in reversed(range(LATE)):
        a_u, a_r = actions[j]
        command = faults.surge_share * a_u * limits[0], faults.yaw_share * a_r * limits[1]
        share = ns.clip(faults.delay - float(j), MOMENT, 1.0)  # of a period that this action still has to act
        z = transition(z, command, (0.0, 0.0), share * dt, coefficients, ns)
    return z


def biases(faults: Faults) -> tuple[Number, ...]:
    """Return what the faults add to the measurements x_e, y_e, psi, u, v, r."""
    return 0.0, 0.0, faults.heading, faults.surge, faults.sway, faults.turn

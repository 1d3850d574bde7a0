"""Fault states of the extended Kalman filter: sensor biases, loss of effectiveness and delay of the actuators.

The filter models the faults as slow random walks, although they are constant in an episode: without drift their
estimates would stop adapting. The filter stores the last commands to predict the effect of a delay. A delay that is not
a whole number of control periods acts as a weighted mean of two commands.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from auv_gym.effects.actuators import LONGEST_DELAY
from auv_gym.physics.dynamics import Force
from auv_gym.physics.namespaces import Namespace, Number
from auv_gym.physics.vehicle import Coefficients
from baselines.estimation.sea_model import Estimate, transition


class Faults(NamedTuple):
    """Faults of sensors and actuators: floats, rows of shape (N,) or symbols."""

    heading: Number  # [rad] bias of the measured heading
    surge: Number  # [m/s] bias of the measured surge velocity over ground
    sway: Number  # [m/s]
    turn: Number  # [rad/s] bias of the measured yaw rate
    surge_share: Number  # [1] effectiveness: share of the commanded force that acts
    yaw_share: Number  # [1]
    delay: Number  # control periods until a command acts


FAULTS = len(Faults._fields)  # number of fault states
NO_FAULTS = Faults(0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 0.0)
"""Ideal sensors and actuators."""
DRIFT = Faults(3e-4, 3e-4, 3e-4, 3e-5, 3e-3, 3e-3, 0.02)
"""Standard deviations of the change of each fault in one second, in its unit."""
_LEAST_SHARE = 0.3  # lower bound of the estimated effectiveness
FIRST_DELAY = 0.5  # estimate of the delay before the first measurement, in control periods
SHORTEST_SHARE = 1e-3  # lower bound of a share of a control period that is integrated
LATE = LONGEST_DELAY  # number of stored commands before the last one


def prior_faults(tuning: Any) -> tuple[Faults, Faults]:
    """Return the estimates before the first measurement and their standard deviations.

    Args:
        tuning: has the fields of a `kalman.FaultTuning`.
    """
    t = tuning
    deviation = Faults(t.heading_bias, t.velocity_bias, t.velocity_bias, t.turn_bias, t.loss, t.loss, t.delay)
    return NO_FAULTS._replace(delay=FIRST_DELAY), deviation


def within_bounds(faults: Faults, ns: Namespace) -> Faults:
    """Return faults with effectiveness and delay clipped to their bounds."""
    share_u, share_r = (ns.clip(x, _LEAST_SHARE, 1.0) for x in (faults.surge_share, faults.yaw_share))
    delay = ns.clip(faults.delay, 0.0, float(LATE))
    return faults._replace(surge_share=share_u, yaw_share=share_r, delay=delay)


def acting_forces(faults: Faults, actions: Sequence[Sequence[Number]], limits: Force, ns: Namespace) -> Force:
    """Return the command F_u [N], F_r [N m] that acted in the last control period.

    Args:
        faults: of the actuators.
        actions: the last 1 + `LATE` actions, the latest first.
        limits: F_u [N], F_r [N m] at an action of 1.
        ns: the namespace of the numbers.
    """
    weights = [ns.clip(1.0 - abs(faults.delay - float(j)), 0.0, 1.0) for j in range(1 + LATE)]
    late = [
        sum((w * a for w, a in zip(weights[1:], past[1:], strict=True)), weights[0] * past[0])
        for past in zip(*actions, strict=True)
    ]
    return faults.surge_share * late[0] * limits[0], faults.yaw_share * late[1] * limits[1]


def after_delay(
    z: Estimate,
    faults: Faults,
    actions: Sequence[Sequence[Number]],
    limits: Force,
    dt: Number,
    coefficients: Coefficients,
    ns: Namespace,
) -> Estimate:
    """Return the state predicted over the delay, to the time at which the present command begins to act.

    Args:
        z: the state now. The positions of both states are relative to the position of the reference now.
        faults: of the actuators.
        actions: the last `LATE` actions, which act during the delay, the latest first.
        limits: F_u [N], F_r [N m] at an action of 1.
        dt: control period [s].
        coefficients: of the nominal vehicle.
        ns: the namespace of the numbers.
    """
    for j in reversed(range(LATE)):
        a_u, a_r = actions[j]
        command = faults.surge_share * a_u * limits[0], faults.yaw_share * a_r * limits[1]
        share = ns.clip(faults.delay - float(j), SHORTEST_SHARE, 1.0)  # of a period in which this action acts
        z = transition(z, command, (0.0, 0.0), share * dt, coefficients, ns)
    return z


def biases(faults: Faults) -> tuple[Number, ...]:
    """Return the biases of the measurements x_e, y_e, psi, u, v, r."""
    return 0.0, 0.0, faults.heading, faults.surge, faults.sway, faults.turn

"""Linear-quadratic control with integral action in space, with the weights of `baselines.control.lqi`.

The error dynamics are linearised about straight level motion, so its gains depend on the speed alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from functools import lru_cache
from typing import Any, ClassVar

import numpy as np

from auv_gym.physics.namespaces import Array
from auv_gym.physics.space import SpaceVehicle, axes, state_rates
from auv_gym.task.observation import Layout
from auv_gym.task.space import SPACE, Observation, in_body_frame
from baselines.control.lqi import LqiWeights, least_cost_gain, preferred, sampled
from baselines.policy import Memory, first_order
from baselines.space.integral import bounded, next_integral, speed

_SPEEDS = np.geomspace(0.05, 2.5, 14)  # [m/s] of the grid of gains; outside of it the gain at its edge is used
_ERRORS, _STATES, _FORCES = 10, 13, 3  # number of errors, of errors and integrals, of forces
_STEP = 1e-6  # of central differences


def error_dynamics(vehicle: SpaceVehicle, u_R: float) -> tuple[Array, Array]:
    """Return A (10, 10), B (10, 3) of the `space.Errors` about straight level motion at u_R [m/s]."""
    wanted = np.array([u_R, 0.0, 0.0, 0.0, 0.0])

    def slopes(errors: Array, force: Array) -> Array:
        e, (theta, psi), nu = errors[:3], errors[3:5], wanted + errors[5:]
        body: Array = np.array(axes(theta, psi))
        state = (*(body.T @ e), theta, psi, *nu)
        F_u, F_q, F_r = force
        rates = np.array(state_rates(state, (F_u, 0.0, 0.0, F_q, F_r), vehicle.acting))
        still = np.array(state_rates((0.0,) * 5 + (u_R, 0.0, 0.0, 0.0, 0.0), (0.0,) * 5, vehicle.acting))[5:]
        turn = np.array((-nu[4] * np.tan(theta), nu[3], nu[4]))
        moved = body @ (rates[:3] - (u_R, 0.0, 0.0)) - np.cross(turn, e)
        return np.array((*moved, *rates[3:5], *(rates[5:] - still)))

    zero, still = np.zeros(_ERRORS), np.zeros(_FORCES)

    def differences(one: Any, n: int) -> Array:
        return np.array([(one(_STEP * row) - one(-_STEP * row)) / (2 * _STEP) for row in np.eye(n)]).T

    return differences(lambda x: slopes(x, still), _ERRORS), differences(lambda F: slopes(zero, F), _FORCES)


@lru_cache(maxsize=64)
def gain_schedule(vehicle: SpaceVehicle, w: LqiWeights, dt: float, limits: tuple[float, ...]) -> Array:
    """Return K (speeds, 3, 19) of command = -K z, z as in `baselines.control.lqi.sampled`."""
    gains = []
    for U in _SPEEDS.tolist():
        A, B = error_dynamics(vehicle, U)
        Phi, Gamma = sampled(A, B, np.zeros((3, 3)), w, dt)
        weighted = np.zeros((_STATES, _STATES))
        weighted[:3, :3] = weighted[_ERRORS:, _ERRORS:] = np.eye(3)
        weighted[3:5, 3:5], weighted[8:10, 8:10] = w.heading * U * np.eye(2), w.turn * np.eye(2)
        weighted[5:8, 3:_ERRORS] = w.velocity * A[:3, 3:]
        gains.append(least_cost_gain(Phi, Gamma, weighted, w, dt, limits))
    return np.array(gains)


class SpaceLQI:
    """Linear-quadratic control, a `Controller`; its memory is xi (N, 3) [m] and the lagged forces (N, 3) [N], [N m]."""

    layout: ClassVar[Layout] = SPACE.layout

    def __init__(self, gains: Mapping[str, float], vehicle: SpaceVehicle) -> None:
        """Make the controller; its gains are the fields of `LqiWeights`."""
        self.weights, self.vehicle = LqiWeights(**gains), vehicle

    def start(self, n: int) -> Memory:
        """Return the memory at the start of n episodes."""
        return np.zeros((n, 3)), np.zeros((n, 3))

    def forces(self, o: Observation, memory: Memory, extra: Array) -> tuple[Array, Array, Array, Memory]:
        """Return F_u [N], F_q [N m], F_r [N m], shape (N,), and the memory for the next call."""
        w = self.weights
        xi = next_integral(memory[0].T, o, w.rate, w.horizon)
        plan = np.array((o.F_uR, o.F_qR, o.F_rR))
        previous = np.array((o.a_u * o.F_u_max, o.a_q * o.F_q_max, o.a_r * o.F_r_max))
        lagged = memory[1].T + first_order(o.dt, w.lag) * (previous - memory[1].T)
        z = np.array((*bounded(o, w.horizon), *o[3:10], *in_body_frame(xi, o), *(lagged - plan), *(previous - plan)))
        F_u, F_q, F_r = plan - np.einsum("nij,jn->in", self._gain(o), z)
        return F_u, F_q, F_r, (xi.T, lagged.T)

    def _gain(self, o: Observation) -> Array:
        """Return K for each vehicle, shape (N, 3, 19); NaN if no gain exists for its limits and control period."""
        place = np.interp(np.log(speed(o)), np.log(_SPEEDS), np.arange(len(_SPEEDS)))
        below = np.minimum(place.astype(int), len(_SPEEDS) - 2)
        share = (place - below)[:, None, None]
        K = np.full((len(place), _FORCES, _STATES + 2 * _FORCES), np.nan)
        designs = np.stack((o.dt, preferred(o.F_u_max), preferred(o.F_q_max), preferred(o.F_r_max)), axis=1)
        for dt, *limits in np.unique(designs, axis=0).tolist():
            rows = (designs == (dt, *limits)).all(axis=1)
            with suppress(ValueError, np.linalg.LinAlgError), np.errstate(all="ignore"):
                grid = gain_schedule(self.vehicle, self.weights, dt, tuple(limits))
                K[rows] = ((1 - share) * grid[below] + share * grid[below + 1])[rows]
        return K

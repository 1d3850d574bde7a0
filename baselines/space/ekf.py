"""The speed-normalised law in space on the estimates of the filter in space, see `baselines.control.ekf_law`.

The reference is planned in the water at each instant by the planner's equations, `auv_gym.planning.space`: the path's
velocity less the current, and its acceleration less the current's rate and what the side loads give.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from auv_gym.physics.namespaces import ARRAYS, Array
from auv_gym.physics.space import SpaceVehicle, axes, tracking_errors
from auv_gym.planning.space import axis_motion, axis_step, steady_axis
from auv_gym.task.observation import Layout
from auv_gym.task.space import SPACE, Observation
from baselines.control.backstepping import undamped
from baselines.estimation.kalman import ExtendedKalmanFilter, tuning_of
from baselines.estimation.sea_model import wave_transition, waves_after
from baselines.estimation.water_frame import HARDEST_BRAKING, LARGEST_CURRENT
from baselines.policy import Memory
from baselines.space.backstepping import Wanted, tracking_forces
from baselines.space.kalman import SPACE_FILTER, SPACE_SEA, SpaceEstimate, reference_motion

_NEAR = 3.0  # [s] bound of the position error, see `backstepping.bounded_error`
PLAN_ROWS = 17  # number of rows of the memory of `plan_in_water`


class SpaceEkfLaw:
    """The law with its filter, a `Controller`; its memory is that of the filter, then that of `plan_in_water`."""

    layout: ClassVar[Layout] = SPACE.layout

    def __init__(self, gains: Mapping[str, float], vehicle: SpaceVehicle) -> None:
        """Make the controller; the names of its gains are `ekf_law.EKF_GAINS`."""
        self.vehicle, self.gains, self.lead = vehicle, undamped(gains), gains["lead"]
        self.filter = ExtendedKalmanFilter(vehicle, tuning_of(gains), SPACE_FILTER)

    def start(self, n: int) -> Memory:
        """Return the memory at the start of n episodes."""
        return *self.filter.start(n), np.zeros((n, PLAN_ROWS))

    def forces(self, o: Observation, memory: Memory, extra: Array) -> tuple[Any, ...]:
        """Return F_u [N], F_q [N m], F_r [N m], shape (N,), and the memory for the next call."""
        *filters, plan = memory
        after, rows = self.filter.update(tuple(filters), np.array(o))
        z: Any = SpaceEstimate(*rows)
        waves = np.array(waves_after(z, wave_transition(0.5 * o.dt, ARRAYS), SPACE_SEA)[::2])
        X, Y, Z, M, N = rows[SPACE_SEA.bias] + waves
        current, attitude = (rows[SPACE_SEA.current], rows[SPACE_SEA.gust]), (z.theta, z.psi)
        planned, (theta, psi, *reference) = plan_in_water(plan.T, o, current, (Y, Z), attitude, self.vehicle)
        errors = tracking_errors([*rows[SPACE_SEA.motion]], (0.0, 0.0, 0.0, theta, psi, *reference[:5]), ARRAYS)
        law = tracking_forces(errors, z.theta, Wanted(theta, *reference), self.vehicle, self.gains, _NEAR, ARRAYS)
        goal = np.array(law) - (X, M, N)
        return *(goal + self.lead * z.lag * (goal - rows[SPACE_SEA.force])), (*after, planned.T)


def plan_in_water(
    memory: Array,
    o: Observation,
    current: tuple[Array, Array],
    side: tuple[Array, Array],
    attitude: tuple[Array, Array],
    vehicle: SpaceVehicle,
) -> tuple[Array, Array]:
    """Return the memory one period later, and the reference in the water: theta, psi, u, v, w, q, r, F_u, F_q, F_r.

    Args:
        memory: zeros at the start of an episode, shape (`PLAN_ROWS`, N): number of periods, pitch, heading and turn
            rates, velocity and acceleration through water, the last two accelerations over ground.
        o: the observation in SI units.
        current: its velocity [m/s] and rate [m/s^2] in the world, shape (3, N).
        side: loads Y, Z [N] on the vehicle, shape (N,).
        attitude: estimated pitch and heading [rad], at which the loads act.
        vehicle: the nominal one.
    """
    count, before, earlier, acting = memory[0], memory[1:5], memory[5:11], np.array(vehicle.acting)
    v, a = np.array(reference_motion(o, vehicle.all_coefficients, ARRAYS)).reshape(2, 3, -1)
    a_1, a_2 = (np.where(count > 0, past, a) for past in memory[11:].reshape(2, 3, -1))
    largest = LARGEST_CURRENT * np.linalg.norm(v, axis=0) / np.maximum(np.linalg.norm(current[0], axis=0), 1e-9)
    through = v - np.minimum(largest, 1.0) * current[0]
    _, port, up = (np.array(np.broadcast_arrays(*axis)) for axis in axes(*attitude, ARRAYS))
    needed = a - current[1] - side[0] / vehicle.horizontal.m22 * port - side[1] / vehicle.vertical.m22 * up
    braking = (through * needed).sum(axis=0) / (through * through).sum(axis=0)
    least = -HARDEST_BRAKING * min(p.d22 / p.m22 for p in (vehicle.horizontal, vehicle.vertical))
    now = np.concatenate((through, needed + np.maximum(least - braking, 0.0) * through))
    times = np.concatenate((earlier, 0.5 * (earlier + now), now))[None]
    turning = axis_step()(1, turning=before, times=times, vehicle=acting, step=o.dt[None])["after"][0]
    if (lost := (count == 0) | ~np.isfinite(turning).all(axis=0)).any():
        steady, _ = steady_axis(now.reshape(2, 3, -1)[[0, 0, 1]], acting)
        turning = np.where(lost, steady, turning)
    path = np.concatenate((now, (1.5 * a - 2 * a_1 + 0.5 * a_2) / o.dt))
    reference = axis_motion()(path=path, turning=turning, vehicle=acting)["motion"]
    return np.concatenate((count[None] + 1.0, turning, now, a, a_1)), reference

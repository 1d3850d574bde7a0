"""The speed-normalised tracking law on what an extended Kalman filter believes.

It steers in the water frame: current and sway load enter the plan, surge and yaw load are cancelled, and the command
runs ahead of the actuators by what they are behind, as far as their lag is known.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from functools import partial

import numpy as np

from auv_gym.errors import to_body
from auv_gym.namespaces import ARRAYS
from auv_gym.task import Observation
from auv_gym.vehicle import Vehicle
from baselines.control.backstepping import UNDAMPED_GAINS, tracking_forces, undamped
from baselines.estimation.kalman import ExtendedKalmanFilter, Tuning
from baselines.estimation.sea_model import WAVE_FREQUENCY, Estimate, wave_transition, waves_after
from baselines.estimation.water_frame import Sea, WaterPlan, reference_motion, water_errors
from baselines.gains.loading import tuned_policy
from baselines.policy import Array, Memory

FILTER_GAINS = tuple(field.name for field in fields(Tuning))  # names of the filter's gains
EKF_GAINS = (*UNDAMPED_GAINS, "lead", *FILTER_GAINS)
"""Names of the gains: the law's, see `backstepping.undamped`; `lead` [1/s], how fast the actuators' force is to
approach what the law asks for; and the filter's `Tuning`."""


class EkfLaw:
    """The law with its filter, a `Controller`; its memory is that of the filter, then that of its `WaterPlan`."""

    def __init__(self, gains: Mapping[str, float], vehicle: Vehicle) -> None:
        """Make the controller; its gains are named in `EKF_GAINS`."""
        self.vehicle, self.lead = vehicle, gains["lead"]
        self.gains = undamped(gains)
        self.filter = ExtendedKalmanFilter(vehicle, Tuning(**{name: gains[name] for name in FILTER_GAINS}))
        self.plan = WaterPlan(vehicle)

    def start(self, n: int) -> Memory:
        """Return the memory at the start of n episodes."""
        return self.filter.start(n) + self.plan.start(n)

    def forces(self, o: Observation, memory: Memory, extra: Array) -> tuple[Array, Array, Memory]:
        """Return F_u [N], F_r [N m], shape (N,), and the memory to hand in next."""
        split = self.filter.MEMORY
        motion = reference_motion(o, self.vehicle)
        believed, z = self.filter.update(memory[:split], o, motion)
        X, N, sea = foreseen_sea(z, o.dt)
        plan, R = self.plan.update(memory[split:], motion, sea, o.dt)
        e_x, e_y = to_body(z.x_e, z.y_e, np.cos(z.psi), np.sin(z.psi))
        errors = water_errors((e_x, e_y, z.psi, z.u, z.v, z.r), R)
        F_u, F_r = tracking_forces(errors, self.vehicle, self.gains, ARRAYS)
        F_u, F_r = F_u - X, F_r - N
        ahead = self.lead * z.lag
        return F_u + ahead * (F_u - z.F_u), F_r + ahead * (F_r - z.F_r), believed + plan


def foreseen_sea(z: Estimate, dt: Array) -> tuple[Array, Array, Sea]:
    """Return surge load X [N] and yaw load N [N m] in the middle of the coming period, and what to plan for."""
    X_wave, _, Y_wave, Y_swing, N_wave, _ = waves_after(z, wave_transition(0.5 * dt))
    Y_rate = WAVE_FREQUENCY * Y_swing
    return z.X + X_wave, z.N + N_wave, Sea(z.V_x, z.V_y, z.V_x_rate, z.V_y_rate, z.Y + Y_wave, Y_rate)


make_ekf_law = partial(tuned_policy, "ekf", EKF_GAINS, EkfLaw)
"""Returns the controller as a policy; its arguments `gains` and `vehicle` are those of `tuned_policy`."""

"""The noise study of section V: white noise on all measurements, with and without a low-pass filter."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from auv_gym.effects.sensors import Sensors
from auv_gym.physics.namespaces import Array
from auv_gym.scenarios.scenario import Scenario
from baselines.control.backstepping import Backstepping
from baselines.evaluation.cells import drawn
from baselines.evaluation.rollout import beginning, play

POSITION_NOISE = 0.1  # [m]
HEADING_NOISE = math.radians(1.0)  # [rad], and per second for the yaw rate
VELOCITY_NOISE = 0.01  # [m/s]
CUT_OFFS: tuple[float | None, ...] = (None, 1.0, 0.5, 0.3)  # [Hz] of the low-pass filter; None: no filter
_SEEDS = tuple(range(6))  # seeds of the sensor noise
_TRANSIENT = 400  # control steps [0.1 s] left out at the start: eight time constants of the slowest eigenvalue


@dataclass(frozen=True)
class NoiseRun:
    """Runs on the paper's circle at 10 Hz with white noise: S seeds, K control steps after the transient."""

    cut_off: float | None  # [Hz]
    force: Array  # F_u [N], F_r [N m], shape (S, K, 2)
    error: Array  # [m] true position error, shape (S, K)

    @property
    def force_std(self) -> Array:
        """Standard deviations of F_u [N] and F_r [N m], shape (2,)."""
        return np.asarray(np.sqrt(np.mean(np.var(self.force, axis=1), axis=0)))


def noise_study() -> list[NoiseRun]:
    """Return the runs of the printed law from a start on the circle with each low-pass filter and the same noise."""
    runs = []
    for cut_off in CUT_OFFS:
        sensors = Sensors(POSITION_NOISE, HEADING_NOISE, VELOCITY_NOISE, HEADING_NOISE, low_pass=cut_off)
        scenario = Scenario(name="paper-circle-noise", sensors=sensors, steps=2000)
        episodes = [drawn(scenario, 1, seed).episodes[0] for seed in _SEEDS]
        begun = beginning([(scenario, episodes)], ())
        moments = list(play(Backstepping(gains="paper"), begun, scenario.steps))[_TRANSIENT:]
        limits = np.array((scenario.actuators.F_u_max, scenario.actuators.F_r_max))
        force, error = (np.stack([getattr(m, key) for m in moments], axis=1) for key in ("command", "error"))
        runs.append(NoiseRun(cut_off, force * limits, error))
    return runs

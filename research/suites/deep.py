"""Scenarios with navigation as under water: rare and inaccurate position fixes, and dead reckoning between them.

A fix comes every 10 to 30 s with an error of metres. Between fixes the position is estimated by dead reckoning from a
Doppler log and a gyro. Both speed ranges have the same instruments, so the errors in slow motion are the same per
second and larger per metre.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from auv_gym.physics.namespaces import ARRAYS, Array
from auv_gym.physics.navigation import RandomReckoning
from auv_gym.physics.sensors import Sensors
from auv_gym.scenarios.episode import Episode
from auv_gym.scenarios.presets import PRESETS, SPEED_RANGES
from auv_gym.scenarios.scenario import Scenario
from auv_gym.task.simulation import SAMPLE, estimated_position
from baselines.control.privileged.truth import Truth
from baselines.evaluation.metrics import steady_rmse
from baselines.evaluation.runner import Cell

_CASES = {"deep": "calm", "deep-current": "current", "deep-storm": "storm"}
"""Names of the scenarios and the cases of the presets that they are based on."""
MISSION = {"slow": 300.0, "cruise": 240.0}  # [s] duration, with 15 and 12 fixes on average
INSTRUMENTS = Sensors(
    position=1.5,  # [m] of a fix
    heading=0.002,  # [rad]
    velocity=0.01,  # [m/s]
    yaw_rate=0.001,  # [rad/s]
    heading_bias=(-0.02, 0.02),  # [rad] a gyro aligned to 1.1 deg
    velocity_bias=(-0.005, 0.005),  # [m/s]
    reckoning=RandomReckoning(),
)
"""The Doppler log and the gyro of the sources that `RandomReckoning` names, with their biases and alignment."""
OUTAGES = 0.5  # [1/min] rate of outages of the fixes in a storm
OUTAGE_TIME = (20.0, 60.0)  # [s] duration of an outage


def deep_worlds() -> list[Scenario]:
    """Return the scenarios of deep-v1: calm water, a current, and storms with outages of the fixes."""
    found = []
    for speed_range in SPEED_RANGES:
        for name, case in _CASES.items():
            preset = PRESETS[f"{speed_range}-{case}"]
            failing = replace(INSTRUMENTS, outages=OUTAGES, outage_time=OUTAGE_TIME)
            found.append(
                replace(
                    preset,
                    name=f"{speed_range}-{name}",
                    sensors=failing if case == "storm" else INSTRUMENTS,
                    steps=round(MISSION[speed_range] / preset.control_dt),
                    error_scale=INSTRUMENTS.position,
                )
            )
    return found


def navigation_errors(scenario: Scenario, episodes: Sequence[Episode]) -> Array:
    """Return the distance [m] between estimated and true position on the reference, shape (K + 1, N).

    This is the error of an ideal controller that keeps the estimated position on the reference. The scenario must have
    dead reckoning.

    Raises:
        InfeasibleReferenceError: an episode's path cannot be followed.
    """
    truth = Truth.of(scenario, episodes)
    errors = np.empty((len(truth.samples), len(episodes)))
    before = last = (truth.samples[0, SAMPLE.x_R], truth.samples[0, SAMPLE.y_R])
    for k, sample in enumerate(truth.samples):
        position = (sample[SAMPLE.x_R], sample[SAMPLE.y_R])
        psi_m = sample[SAMPLE.psi_R] + sample[SAMPLE.n_psi]
        last = estimated_position(position, before, psi_m, last, tuple(sample), truth.parameters, ARRAYS)
        before = position
        errors[k] = np.hypot(last[0] - position[0], last[1] - position[1])
    return errors


def navigation_rmses(cell: Cell) -> Array:
    """Return the steady-state RMSE [m] of the `navigation_errors` in the episodes of a cell, shape (M,)."""
    return steady_rmse(navigation_errors(cell.scenario, cell.episodes)[1:])

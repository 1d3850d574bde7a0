"""The estimation lower bound, compared with one linear regression over all measurements of simulated episodes."""

import math
from dataclasses import replace

import numpy as np
import pytest

from auv_gym.physics.namespaces import FLOATS
from auv_gym.physics.rows import flatten
from auv_gym.scenarios.exogenous import (
    GUSTS,
    WAVE_ROWS,
    Errors,
    Gust,
    gusty_current,
    least_speed,
    next_gust,
    wave_components,
    wave_load,
    weather_of,
)
from auv_gym.scenarios.presets import PRESETS
from auv_gym.task.simulation import CURRENT, LOAD, Parameters, Plant, ground_state, moved
from baselines.control.privileged.optimum import arriving, oracle_actions
from baselines.control.privileged.problem import STEADY_RMSE, Problem
from baselines.control.privileged.solver import best_trajectory
from baselines.control.privileged.truth import Truth
from baselines.evaluation.runner import drawn
from research.estimation_bound.filter import position_errors
from research.estimation_bound.model import EstimationModel, has_bound


@pytest.mark.parametrize("name", ["slow-noise", "cruise-storm"])
def test_a_regression_over_all_measurements_gives_the_same_bound(name):
    """The unknown numbers of an episode are its start, the inputs of the gusts and the phases of the waves.

    Their derivatives are differences of simulations, and one linear regression gives their posterior covariance.
    """
    scenario = replace(PRESETS[name], steps=12)
    episodes = drawn(scenario, 1, 5).episodes
    (episode,), steps = episodes, scenario.steps
    problem, truth = Problem.of(scenario, episodes), Truth.of(scenario, episodes)
    trajectory = best_trajectory(problem, arriving(oracle_actions(scenario, episodes), problem.delay))
    p = Parameters.of([float(np.ravel(row)[0]) for row in flatten(truth.parameters)], scenario.parts)
    samples, stormy = truth.samples[..., 0], episode.waves is not None
    table = samples[:, :8]
    weather = weather_of(
        episode.current, scenario.control_dt, least_speed([table]), Errors(*[0.0] * 6), Errors(*[0.0] * 6)
    )
    rows = wave_components(episode.waves, scenario.control_dt).reshape(-1, WAVE_ROWS)
    normals = np.random.Generator(np.random.SFC64(episode.noise_seed)).standard_normal((steps + 1, 8))[:, GUSTS]
    phases = 3 * len(rows)

    def simulate(pose, first, driven, shifts):
        """Return poses and measurements at each instant, for changes of the unknown numbers."""
        shifted = rows.copy()
        for axis in range(3):
            amplitude = np.hypot(rows[:, 1 + 2 * axis], rows[:, 2 + 2 * axis])
            phase = np.arctan2(rows[:, 2 + 2 * axis], rows[:, 1 + 2 * axis]) + shifts[axis * len(rows) :][: len(rows)]
            shifted[:, 1 + 2 * axis], shifted[:, 2 + 2 * axis] = amplitude * np.cos(phase), amplitude * np.sin(phase)
        gust, (state, force) = Gust(0.0, 0.0, 0.0, 0.0, 0.0), (tuple(pose), (0.0, 0.0))
        poses, measured = [], []
        for k in range(steps + 1):
            shock = normals[k] + (first if k == 0 else driven[k - 1])
            load = wave_load(float(k), shifted.tolist(), FLOATS) if stormy else (0.0, 0.0, 0.0)
            current = (0.0, 0.0)
            if stormy:
                gust = next_gust(gust, shock.tolist(), weather, FLOATS)
                current = gusty_current(float(k), (gust.s_x, gust.s_y), weather, FLOATS)
            sample = samples[k].tolist()
            if not (np.any(first) or np.any(driven) or np.any(shifts)):
                np.testing.assert_allclose([*current, *load], [*samples[k][CURRENT], *samples[k][LOAD]], atol=1e-9)
            sample[CURRENT], sample[LOAD] = current, load
            if k:
                command = trajectory.commands[k - 1, :, 0].tolist()
                state, force = moved(state, force, command, sample, p, FLOATS)
            poses.append(state)
            plant = Plant(*state, *force, 0.0, 0.0, None)
            measured.append(ground_state(plant, current, p, FLOATS))
        return np.array(poses), np.array(measured)

    sizes = np.cumsum([6, 2, 2 * steps, phases])
    start = problem.begun[:6, 0]

    def at(unknown):
        pose, first, driven, shifts, _ = np.split(unknown, sizes)
        return simulate(start + pose, first, driven.reshape(steps, 2), shifts)

    count, h = sizes[-1], 1e-5
    ends = [[at(sign * h * one) for sign in (1, -1)] for one in np.eye(count)]
    by_pose, by_output = (
        np.stack([(a[i] - b[i]) / (2 * h) for a, b in ends], axis=-1) for i in (0, 1)
    )  # shape (K + 1, 6, unknown)
    variances = np.ones(count)
    g, u_R = scenario.start, start[3] / episode.surge
    spread = (*(interval[1] - interval[0] for interval in (g.x_e, g.y_e, g.psi_e)), 0.7 * u_R, 0.0, 0.0)
    variances[:6] = np.square(spread) / 12
    variances[count - phases :] = math.pi**2 / 3
    prior, expected = np.diag(variances), []
    for k in range(steps // STEADY_RMSE, steps):
        H = by_output[: k + 1].reshape(-1, count)
        R = np.diag(np.tile(np.square(scenario.sensors.noise), k + 1))
        posterior = prior - prior @ H.T @ np.linalg.solve(H @ prior @ H.T + R, H @ prior)
        expected.append(np.trace(by_pose[k + 1, :2] @ posterior @ by_pose[k + 1, :2].T))
    found = position_errors(EstimationModel.of(scenario, episodes), [0], samples=4000)
    assert found.square[0] == pytest.approx(np.mean(expected), rel=1e-5)
    assert 0.8 * np.sqrt(found.square[0]) < found.steady_rmse[0] < np.sqrt(found.square[0])


def test_the_errors_of_the_filter_agree_with_its_covariance():
    scenario = PRESETS["cruise-storm"]
    model = EstimationModel.of(replace(scenario, steps=60), drawn(scenario, 3, 11).episodes)
    found = position_errors(model, [1, 2, 3], samples=1)
    seeds = ([3 * i, 3 * i + 1, 3 * i + 2] for i in range(100))
    many = np.array([position_errors(model, own, samples=1).steady_rmse for own in seeds])
    np.testing.assert_allclose((many**2).mean(axis=0), found.square, rtol=0.2)


def test_without_noise_in_all_measurements_there_is_no_bound():
    assert [name for name in PRESETS if has_bound(PRESETS[name])] == [
        *(f"{speed_range}-{case}" for speed_range in ("slow", "cruise") for case in ("noise", "storm"))
    ]
    with pytest.raises(ValueError, match="slow-calm has no estimation lower bound"):
        EstimationModel.of(PRESETS["slow-calm"], ())

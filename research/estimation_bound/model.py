"""The random part of an episode with known parameters, as a linear system with Gaussian noise.

Known are the true vehicle, the actuators and their lag, all commands, the mean current, the statistics of its gusts,
the frequencies and amplitudes of the waves, and the statistics of start and sensors. Unknown are the random numbers of
the start, the gusts, the phases of the waves and the measurement errors. The model is linearised about the trajectory
of the full-information optimum, see `control.privileged.optimum`.

The state z of an episode is the deviation from this trajectory: (`POSE`) x, y [m], psi [rad], u, v [m/s], r [rad/s],
with velocities relative to the water; (`_GUSTS`) the process n of the gusts and its filter s on each axis, in units of
sigma, see `auv_gym.scenarios.exogenous`; from `PHASES` on the phases [rad] of the wave components, axis by axis:

    z_(k+1) = F_k z_k + Gamma w_k,    y_k = C_k z_k + e_k
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from auv_gym.codegen.derivatives import jacobian
from auv_gym.codegen.graph import SYMBOLS
from auv_gym.codegen.kernel import Kernel
from auv_gym.physics.intervals import Interval
from auv_gym.physics.namespaces import Array
from auv_gym.scenarios.episode import Episode
from auv_gym.scenarios.exogenous import WAVE_ROWS, wave_components
from auv_gym.scenarios.scenario import Scenario, Start
from auv_gym.task.simulation import CURRENT, LOAD, PARAMETER_ROWS, SAMPLE_ROWS, Parameters, Parts, moved
from baselines.control.privileged.optimum import arriving, oracle_actions
from baselines.control.privileged.problem import COMMAND_ROWS, PLANT_STATES, Problem, Trajectory
from baselines.control.privileged.solver import best_trajectory

POSE = slice(0, 6)  # part of z
_GUSTS = slice(6, 10)  # part of z
PHASES = 10  # first phase in z
GUST_INPUTS = 2  # white-noise inputs of the gusts in a control period
_DISTURBANCES = (*range(CURRENT.start, CURRENT.stop), *range(LOAD.start, LOAD.stop))
"""Disturbances in a sample of the exogenous inputs: V_x, V_y [m/s], X, Y [N], N [N m]."""
AXES = 3  # axes of the wave loads
ANY_PHASE = math.pi**2 / 3  # [rad^2] variance of a phase that is uniform over a full turn


@dataclass(frozen=True)
class EstimationModel:
    """The linear model of N episodes of K control periods, with n unknown numbers each."""

    pose: Array  # derivative of the pose after a period by the pose before it, shape (K, N, 6, 6)
    disturbance: Array  # derivative of the pose after a period by the disturbances in it, shape (K, N, 6, 5)
    gusts: Array  # transition matrix of the gusts over a period, shape (N, 4, 4)
    drive: Array  # input matrix of the gusts, shape (N, 4, GUST_INPUTS)
    sigma: Array  # [m/s] standard deviation of the gusts, shape (N,)
    waves: Array  # [N], [N], [N m] derivative of each load by the phases, shape (K + 1, N, AXES, components)
    measured: Array  # derivative of u, v over ground by psi and by V_x, V_y, shape (K + 1, N, 2, 3)
    initial: Array  # covariance at the start, shape (N, n, n)
    noise: Array  # [m], [m], [rad], [m/s], [m/s], [rad/s] standard deviations of the measurements, shape (6,)

    @classmethod
    def of(cls, scenario: Scenario, episodes: Sequence[Episode]) -> EstimationModel:
        """Return the model of N episodes of a scenario.

        Raises:
            ValueError: the model does not apply to the scenario, see `has_bound`.
            InfeasibleReferenceError: an episode's path cannot be followed in still water.
        """
        if not has_bound(scenario):
            raise ValueError(
                f"{scenario.name} has no estimation lower bound: all measurements must have noise, and of the optional "
                "parts of the simulation only weak actuators may be in use"
            )
        problem = Problem.of(scenario, episodes)
        trajectory = best_trajectory(problem, arriving(oracle_actions(scenario, episodes), problem.delay))
        pose, disturbance = pose_derivatives(problem, trajectory)
        decays = [_decays(e.current.gust_time, e.current.smoothing, scenario.control_dt) for e in episodes]
        waves = np.stack([_wave_derivatives(episode, scenario) for episode in episodes], axis=1)
        u_R = problem.begun[3] / [e.surge for e in episodes]
        return cls(
            pose,
            disturbance,
            np.array([_gust_transition(a, b) for a, b in decays]),
            np.array([_gust_input(a, b) for a, b in decays]),
            np.array([e.current.gust for e in episodes]),
            waves,
            _velocity_derivatives(problem, trajectory),
            _initial_covariance(scenario.start, u_R, AXES * waves.shape[-1]),
            np.array(scenario.sensors.noise),
        )

    def transition(self, k: int) -> tuple[Array, Array]:
        """Return for period k the rows of F for `POSE`, shape (N, 6, n), and Gamma, shape (N, n, GUST_INPUTS)."""
        N, count = len(self.sigma), self.waves.shape[-1]
        by_filter = self.disturbance[k][..., :2] * self.sigma[:, None, None]  # by the filter at the end of the period
        loads = self.disturbance[k][..., 2:, None] * self.waves[k + 1][:, None]
        loads = loads.reshape(N, 6, AXES * count)
        rows = np.concatenate((self.pose[k], by_filter @ self.gusts[:, 2:], loads), axis=2)
        gamma = np.concatenate(
            (by_filter @ self.drive[:, 2:], self.drive, np.zeros((N, AXES * count, GUST_INPUTS))), axis=1
        )
        return rows, gamma

    def propagate(self, rows: Array, z: Array) -> Array:
        """Return F z for columns z, shape (N, n, columns), given the rows of F for `POSE`."""
        return np.concatenate((rows @ z, self.gusts @ z[:, _GUSTS], z[:, PHASES:]), axis=1)

    def output(self, k: int) -> Array:
        """Return C at instant k, shape (N, 6, n)."""
        C = np.zeros((len(self.sigma), 6, self.initial.shape[-1]))
        C[:, range(6), range(6)] = 1.0
        C[:, 3:5, 2] += self.measured[k][..., 0]
        C[:, 3:5, 8:10] = self.measured[k][..., 1:] * self.sigma[:, None, None]
        return C


def has_bound(scenario: Scenario) -> bool:
    """Return whether an `EstimationModel` applies to a scenario.

    All measurements must have noise. Of the optional `Parts` of the simulation only weak actuators may be in use.
    """
    plain = scenario.parts._replace(substeps=1, weak=False) == Parts()
    return plain and all(deviation > 0 for deviation in scenario.sensors.noise)


def pose_derivatives(problem: Problem, trajectory: Trajectory) -> tuple[Array, Array]:
    """Return the derivatives of the pose after each period by the pose before it and by the disturbances.

    Shapes (K, N, 6, 6) and (K, N, 6, 5), see `EstimationModel`.
    """
    steps, _, n = trajectory.commands.shape
    found = np.empty((steps, 6 * (6 + len(_DISTURBANCES)), n))
    derivative_kernel(problem.parts).bound(
        state=np.ascontiguousarray(trajectory.states[:-1]),
        command=trajectory.commands,
        sample=problem.samples,
        parameters=problem.parameters,
        derivatives=found,
    )(0, steps)
    table = found.reshape(steps, 6, 6 + len(_DISTURBANCES), n).transpose(0, 3, 1, 2)
    return np.ascontiguousarray(table[..., :6]), np.ascontiguousarray(table[..., 6:])


@cache
def derivative_kernel(parts: Parts) -> Kernel:
    """Return the kernel of `pose_derivatives`."""

    def equation(state: Any, command: Any, sample: Any, parameters: Any) -> Mapping[str, Sequence[Any]]:
        p = Parameters.of(parameters, parts)
        pose, _ = moved(tuple(state[:6]), (state[6], state[7]), (command[0], command[1]), sample, p, SYMBOLS)
        inputs = [*state[:6], *(sample[i] for i in _DISTURBANCES)]
        return {"derivatives": [entry for row in jacobian(list(pose), inputs) for entry in row]}

    rows = {"state": PLANT_STATES, "command": COMMAND_ROWS, "sample": SAMPLE_ROWS, "parameters": PARAMETER_ROWS}
    return Kernel.traced(equation, rows, ("state", "command", "sample", "derivatives"), structural=True, blocked=True)


def _decays(gust_time: float, smoothing: float, dt: float) -> tuple[float, float]:
    """Return the factors by which the process of the gusts and its filter decay in a control period."""
    return math.exp(-dt / gust_time), math.exp(-dt / smoothing) if smoothing > 0 else 0.0


def _gust_transition(a: float, b: float) -> Array:
    """Return the transition matrix of the gusts for the decay factors of the process and of the filter."""
    ab = (1 - b) * a
    return np.array([[a, 0, 0, 0], [0, a, 0, 0], [ab, 0, b, 0], [0, ab, 0, b]])


def _gust_input(a: float, b: float) -> Array:
    """Return the input matrix of the gusts for the decay factors of the process and of the filter."""
    s = math.sqrt(1 - a * a)
    return np.array([[s, 0], [0, s], [(1 - b) * s, 0], [0, (1 - b) * s]])


def _wave_derivatives(episode: Episode, scenario: Scenario) -> Array:
    """Return the derivatives of the loads by the phases at every instant, shape (K + 1, AXES, components).

    The load of a component is p sin + q cos of its angle, so its derivative is p cos - q sin.
    """
    rows = wave_components(episode.waves, scenario.control_dt).reshape(-1, WAVE_ROWS)
    angle = np.arange(scenario.steps + 1)[:, None] * rows[:, 0]
    p, q = rows[:, 1::2].T, rows[:, 2::2].T
    return np.asarray(p * np.cos(angle)[:, None] - q * np.sin(angle)[:, None])


def _velocity_derivatives(problem: Problem, trajectory: Trajectory) -> Array:
    """Return the derivatives of u, v over ground by psi, V_x and V_y, see `EstimationModel.measured`."""
    c, s = np.cos(trajectory.states[:, 2]), np.sin(trajectory.states[:, 2])
    samples = np.concatenate((problem.samples[:1], problem.samples))  # the sample at the start is missing: the next one
    V_x, V_y = samples[:, CURRENT].transpose(1, 0, 2)
    by_u, by_v = (V_y * c - V_x * s, c, s), (-V_x * c - V_y * s, -s, c)
    return np.stack((np.stack(by_u, axis=-1), np.stack(by_v, axis=-1)), axis=-2)


def _initial_covariance(start: Start, u_R: Array, phases: int) -> Array:
    """Return the covariance of z at the start, from the distributions of the start and of the phases."""
    P = np.zeros((len(u_R), PHASES + phases, PHASES + phases))
    for i, interval in enumerate((start.x_e, start.y_e, start.psi_e)):
        P[:, i, i] = _variance(interval)
    P[:, 3, 3] = _variance(start.surge) * u_R**2
    P[:, _GUSTS, _GUSTS] = np.tile(np.eye(2), (2, 2))  # process and filter start with the same value
    P[:, range(PHASES, PHASES + phases), range(PHASES, PHASES + phases)] = ANY_PHASE
    return P


def _variance(interval: Interval) -> float:
    """Return the variance of a number that is uniform in an interval."""
    low, high = interval if isinstance(interval, tuple) else (interval, interval)
    return (high - low) ** 2 / 12

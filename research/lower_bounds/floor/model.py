"""What is not known beforehand of an episode whose every parameter is known, as a linear system with Gaussian noise.

Known are the true vehicle, the actuators and their lag, all commands, the mean current, the statistics of its gusts,
the waves' frequencies and amplitudes, and the statistics of start and sensors. Not known are the numbers that were
drawn: of the start, of the gusts, of the waves' phases and of the measurement errors. What that comes to is linearised
about the way that the vehicle really takes where it is kept on its path, see `control.privileged.optimum`.

The state z of an episode is what is off by (`POSE`) x, y [m], psi [rad], u, v [m/s], r [rad/s], velocities relative to
the water; (`_GUSTS`) the gusts' process n and its filter s on each axis, in units of sigma, see
`auv_gym.scenarios.exogenous`; and from `PHASES` on the phases [rad] of the waves' components, axis by axis:

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

POSE = slice(0, 6)  # the part of z that is the pose
_GUSTS = slice(6, 10)  # the part of z that is the gusts
PHASES = 10  # where the phases begin in z
DRIVEN = 2  # numbers that drive the gusts in a control period
_SEA = (*range(CURRENT.start, CURRENT.stop), *range(LOAD.start, LOAD.stop))
"""Numbers of a sample that the sea supplies: V_x, V_y [m/s], X, Y [N], N [N m]."""
AXES = 3  # that waves act on
ANY_PHASE = math.pi**2 / 3  # [rad^2] variance of a phase of which nothing is known


@dataclass(frozen=True)
class FloorModel:
    """N episodes of K control periods with n unknown numbers each."""

    pose: Array  # of a period, the pose behind it by the pose before it, shape (K, N, 6, 6)
    sea: Array  # of a period, the pose behind it by what the sea supplies in it, shape (K, N, 6, 5)
    gusts: Array  # one period later by those before it, shape (N, 4, 4)
    drive: Array  # the gusts by what drives them in a period, shape (N, 4, DRIVEN)
    sigma: Array  # [m/s] of the gusts, shape (N,)
    waves: Array  # [N], [N], [N m] each axis's load by the phases of its components, shape (K + 1, N, AXES, components)
    measured: Array  # u, v over ground by psi and by V_x, V_y, shape (K + 1, N, 2, 3)
    begun: Array  # covariance at the start, shape (N, n, n)
    noise: Array  # [m], [m], [rad], [m/s], [m/s], [rad/s] standard deviations of the measurements, shape (6,)

    @classmethod
    def of(cls, scenario: Scenario, episodes: Sequence[Episode]) -> FloorModel:
        """Return the model of N episodes of a scenario.

        Raises:
            ValueError: the scenario is none that has a floor, see `has_floor`.
            InfeasibleReferenceError: an episode's path cannot be followed in still water.
        """
        if not has_floor(scenario):
            raise ValueError(f"{scenario.name} has no floor: its measurements must be noisy, present and prompt")
        problem = Problem.of(scenario, episodes)
        course = best_trajectory(problem, arriving(oracle_actions(scenario, episodes), problem.delay))
        pose, sea = slopes(problem, course)
        left = [_left(e.current.gust_time, e.current.smoothing, scenario.control_dt) for e in episodes]
        waves = np.stack([_waves(episode, scenario) for episode in episodes], axis=1)
        u_R = problem.begun[3] / [e.surge for e in episodes]
        return cls(
            pose,
            sea,
            np.array([_gusts(a, b) for a, b in left]),
            np.array([_drive(a, b) for a, b in left]),
            np.array([e.current.gust for e in episodes]),
            waves,
            _measured(problem, course),
            _begun(scenario.start, u_R, AXES * waves.shape[-1]),
            np.array(scenario.sensors.noise),
        )

    def forward(self, k: int) -> tuple[Array, Array]:
        """Return what z becomes in period k: the rows of F of `POSE`, shape (N, 6, n), and Gamma, (N, n, DRIVEN)."""
        N, count = len(self.sigma), self.waves.shape[-1]
        by_filter = self.sea[k][..., :2] * self.sigma[:, None, None]  # the gusts' filter at the end of the period acts
        loads = self.sea[k][..., 2:, None] * self.waves[k + 1][:, None]
        loads = loads.reshape(N, 6, AXES * count)
        rows = np.concatenate((self.pose[k], by_filter @ self.gusts[:, 2:], loads), axis=2)
        driven = np.concatenate(
            (by_filter @ self.drive[:, 2:], self.drive, np.zeros((N, AXES * count, DRIVEN))), axis=1
        )
        return rows, driven

    def passed(self, rows: Array, z: Array) -> Array:
        """Return F z for columns z, shape (N, n, columns); `rows` are those of F of `POSE`."""
        return np.concatenate((rows @ z, self.gusts @ z[:, _GUSTS], z[:, PHASES:]), axis=1)

    def output(self, k: int) -> Array:
        """Return C at instant k, shape (N, 6, n)."""
        C = np.zeros((len(self.sigma), 6, self.begun.shape[-1]))
        C[:, range(6), range(6)] = 1.0
        C[:, 3:5, 2] += self.measured[k][..., 0]
        C[:, 3:5, 8:10] = self.measured[k][..., 1:] * self.sigma[:, None, None]
        return C


def has_floor(scenario: Scenario) -> bool:
    """Whether a scenario's episodes are of the kind that a `FloorModel` describes, all measurements noisy."""
    plain = scenario.parts._replace(substeps=1, weak=False) == Parts()
    return plain and all(deviation > 0 for deviation in scenario.sensors.noise)


def slopes(problem: Problem, course: Trajectory) -> tuple[Array, Array]:
    """Return the derivatives of the pose behind each period by that before it and by the sea, see `FloorModel`."""
    steps, _, n = course.commands.shape
    found = np.empty((steps, 6 * (6 + len(_SEA)), n))
    slope_kernel(problem.parts).bound(
        state=np.ascontiguousarray(course.states[:-1]),
        command=course.commands,
        sample=problem.samples,
        parameters=problem.parameters,
        slopes=found,
    )(0, steps)
    table = found.reshape(steps, 6, 6 + len(_SEA), n).transpose(0, 3, 1, 2)
    return np.ascontiguousarray(table[..., :6]), np.ascontiguousarray(table[..., 6:])


@cache
def slope_kernel(parts: Parts) -> Kernel:
    """Return the kernel of `slopes`."""

    def equation(state: Any, command: Any, sample: Any, parameters: Any) -> Mapping[str, Sequence[Any]]:
        p = Parameters.of(parameters, parts)
        pose, _ = moved(tuple(state[:6]), (state[6], state[7]), (command[0], command[1]), sample, p, SYMBOLS)
        inputs = [*state[:6], *(sample[i] for i in _SEA)]
        return {"slopes": [slope for row in jacobian(list(pose), inputs) for slope in row]}

    rows = {"state": PLANT_STATES, "command": COMMAND_ROWS, "sample": SAMPLE_ROWS, "parameters": PARAMETER_ROWS}
    return Kernel.traced(equation, rows, ("state", "command", "sample", "slopes"), structural=True, blocked=True)


def _left(gust_time: float, smoothing: float, dt: float) -> tuple[float, float]:
    """Return what is left after a period of the process behind the gusts, and of the filter behind it."""
    return math.exp(-dt / gust_time), math.exp(-dt / smoothing) if smoothing > 0 else 0.0


def _gusts(a: float, b: float) -> Array:
    pull = (1 - b) * a
    return np.array([[a, 0, 0, 0], [0, a, 0, 0], [pull, 0, b, 0], [0, pull, 0, b]])


def _drive(a: float, b: float) -> Array:
    push = math.sqrt(1 - a * a)
    return np.array([[push, 0], [0, push], [(1 - b) * push, 0], [0, (1 - b) * push]])


def _waves(episode: Episode, scenario: Scenario) -> Array:
    """Return the derivatives of the loads by the phases at every instant, shape (K + 1, AXES, components)."""
    rows = wave_components(episode.waves, scenario.control_dt).reshape(-1, WAVE_ROWS)
    angle = np.arange(scenario.steps + 1)[:, None] * rows[:, 0]
    sines, cosines = (
        rows[:, 1::2].T,
        rows[:, 2::2].T,
    )  # a component's load is p sin + q cos, so its slope is p cos - q sin
    return np.asarray(sines * np.cos(angle)[:, None] - cosines * np.sin(angle)[:, None])


def _measured(problem: Problem, course: Trajectory) -> Array:
    """Return the derivatives of u, v over ground by psi, V_x and V_y, see `FloorModel`."""
    c, s = np.cos(course.states[:, 2]), np.sin(course.states[:, 2])
    samples = np.concatenate((problem.samples[:1], problem.samples))  # the start's own is not kept: as one period later
    V_x, V_y = samples[:, CURRENT].transpose(1, 0, 2)
    by_u, by_v = (V_y * c - V_x * s, c, s), (-V_x * c - V_y * s, -s, c)
    return np.stack((np.stack(by_u, axis=-1), np.stack(by_v, axis=-1)), axis=-2)


def _begun(start: Start, u_R: Array, phases: int) -> Array:
    """Return the covariance of what is unknown at the start, as large as that of the distributions drawn from."""
    begun = np.zeros((len(u_R), PHASES + phases, PHASES + phases))
    for i, interval in enumerate((start.x_e, start.y_e, start.psi_e)):
        begun[:, i, i] = _variance(interval)
    begun[:, 3, 3] = _variance(start.surge) * u_R**2
    begun[:, _GUSTS, _GUSTS] = np.tile(np.eye(2), (2, 2))  # the filter begins where the process does
    begun[:, range(PHASES, PHASES + phases), range(PHASES, PHASES + phases)] = ANY_PHASE
    return begun


def _variance(interval: Interval) -> float:
    """Return the variance of a number drawn from an interval."""
    low, high = interval if isinstance(interval, tuple) else (interval, interval)
    return (high - low) ** 2 / 12

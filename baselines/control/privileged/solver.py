"""Gauss-Newton iteration over whole episodes, each with its own damping.

The method is that of `baselines.control.nmpc.gauss_newton` over a whole episode, with the damping of K. Levenberg
(Quarterly of Applied Mathematics 2(2):164-168, 1944): if a step does not lower the cost, the damping increases.

With commands at their limits for a long time, the problem can have several local minima. The commands of the oracle,
which are clipped at the limits, can lead to a poor one. Receding horizon control with full information gives other
initial commands, which are optimal at the limits within each window (D. Q. Mayne and H. Michalska, "Receding horizon
control of nonlinear systems", IEEE Trans. Automatic Control 35(7):814-824, 1990).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_gym.physics.namespaces import Array
from baselines.control.nmpc.problem import replaced, subset
from baselines.control.privileged.problem import GaussNewtonStep, Problem, Trajectory

TOLERANCE = 1e-5
"""Tolerance [m of the paper's vehicle] of the steady-state error: an episode is solved when a step with little damping
gains less."""
_LENGTHS = (1.0, 0.5, 0.2, 0.05, 0.01)
"""Fractions of a step in the line search, tried in this order until one lowers the cost."""
DAMPING = 1e-6  # [m^2 of the paper's vehicle] initial damping
LEAST_DAMPING = 1e-12  # [m^2 of the paper's vehicle]
MOST_DAMPING = 1e3  # [m^2 of the paper's vehicle]
HARDLY_DAMPED = 1e-9
"""Largest damping [m^2 of the paper's vehicle] at which a full step without gain ends the iteration."""
STIFFER = 10.0  # factor on the damping after a failed line search
LOOSER = 0.1  # factor on the damping after a full step
_MOST_STEPS = 200  # for an episode
GOOD = 0.002
"""Steady-state error [m of the paper's vehicle] from which other initial commands are tried."""
_FADING = 0.5  # initial commands in the periods after a window, as a share of its last command
_STEPS_OF_WINDOW = 20  # most Gauss-Newton steps in a window


def best_trajectory(problem: Problem, guess: Array, others: Sequence[Callable[[Problem], Array]] = ()) -> Trajectory:
    """Return the best of the trajectories that are optimised from different initial commands, for N episodes.

    Args:
        problem: see `Problem`.
        guess: initial commands, shape (K, channels, N).
        others: functions that return other initial commands for a problem; they are tried in turn in episodes whose
            steady-state error is not below `GOOD`.
    """
    best = optimised(problem, problem.open_loop(guess))
    for other in others:
        poor = np.flatnonzero(~(best.steady_rmse < GOOD))
        if not poor.size:
            break
        part = problem.subset(poor)
        trial = optimised(part, part.open_loop(other(part)))
        better = np.flatnonzero(trial.cost < best.cost[poor])
        best = replaced(best, poor[better], subset(trial, better))
    return best


def optimised(problem: Problem, trajectory: Trajectory, most: int = _MOST_STEPS) -> Trajectory:
    """Return the trajectory after Gauss-Newton steps until convergence, at most `most` of them."""
    damping, active = np.full(len(trajectory.cost), DAMPING), np.arange(len(trajectory.cost))
    for _ in range(most):
        part, now = problem.subset(active), subset(trajectory, active)
        after, full = _line_search(part, now, part.gauss_newton_step(now, damping[active]))
        with np.errstate(invalid="ignore"):  # both costs of a diverged episode are infinite
            gain = np.sqrt(now.cost) - np.sqrt(after.cost)
        failed = ~(after.cost < now.cost)
        dampings = damping[active]
        done = ~(gain > TOLERANCE) & ((full & (dampings <= HARDLY_DAMPED)) | (failed & (dampings >= MOST_DAMPING)))
        factor = np.where(failed, STIFFER, np.where(full, LOOSER, 1.0))
        damping[active] = np.clip(factor * dampings, LEAST_DAMPING, MOST_DAMPING)
        trajectory = replaced(trajectory, active, after)
        active = active[~done]
        if not active.size:
            break
    return trajectory


def _line_search(
    problem: Problem, trajectory: Trajectory, change: GaussNewtonStep
) -> tuple[Trajectory, NDArray[np.bool_]]:
    """Return the trajectory after the longest fraction of a step that lowers the cost, and whether the step is full."""
    best, full = trajectory, np.zeros(len(trajectory.cost), dtype=bool)
    active = np.arange(len(trajectory.cost))
    for length in _LENGTHS:
        now, part = subset(trajectory, active), problem.subset(active)
        trial = part.simulated(now, subset(change, active), length)
        better = trial.cost < now.cost
        best = replaced(best, active[better], subset(trial, np.flatnonzero(better)))
        full[active[better]] = length == _LENGTHS[0]
        active = active[~better]
        if not active.size:
            break
    return best, full


def about_reference(problem: Problem) -> Array:
    """Return the commands of linear-quadratic control about the reference, shape (K, channels, N).

    Its feedback is that of a Gauss-Newton step with the reference in place of a simulated trajectory.
    """
    model, p = problem.parts.model, problem.parts.parameters(tuple(problem.parameters))
    planned = problem.samples[:, model.reference]
    commands = planned[:, model.forces] / np.stack(np.broadcast_arrays(*model.thrusts(p), problem.unit)[:-1])
    infinite = np.full(len(problem.unit), np.inf)
    reference = Trajectory(commands, np.concatenate((planned[:1], planned)), infinite, infinite)
    change = problem.gauss_newton_step(reference, np.full(len(problem.unit), DAMPING))
    return problem.simulated(reference, change).commands


class Window(NamedTuple):
    """Lengths of receding horizon control."""

    length: int  # control periods that are optimised
    kept: int  # control periods, the first ones, whose commands are applied


WINDOWS = Window(80, 40), Window(160, 40), Window(80, 10)
"""Windows that are tried in turn: 8 s and 16 s at the cruise of the paper's vehicle."""


def receding_horizon(window: Window, problem: Problem) -> Array:
    """Return the commands of receding horizon control with full information, shape (K, channels, N)."""
    commands, begun, steps = np.zeros_like(problem.limits), problem.begun, len(problem.limits)
    for first in range(0, steps, window.kept):
        end = min(first + window.length, steps)
        part = problem.between(first, end, begun)
        trajectory = optimised(part, part.open_loop(commands[first:end].copy()), _STEPS_OF_WINDOW)
        commands[first:end] = trajectory.commands
        commands[end : end + window.kept] = _FADING * trajectory.commands[-1]
        if end == steps:
            break
        begun = trajectory.states[window.kept]
    return commands

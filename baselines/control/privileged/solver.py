"""The Gauss-Newton iteration through whole episodes, each with a damping of its own.

It is the method of `baselines.control.nmpc.gauss_newton` over all of an episode, with the damping of K. Levenberg
(Quarterly of Applied Mathematics 2(2):164-168, 1944): a step that disappoints makes the next one shorter.

Where limits bind for long, the optimum is one of several that Gauss-Newton steps may end in, and the oracle's commands,
which a regulator cuts at the limits, may lead to a poor one. A window that moves through the episode, optimised with
all that will happen in it, goes along the limits from the start (D. Q. Mayne and H. Michalska, "Receding horizon
control of nonlinear systems", IEEE Trans. Automatic Control 35(7):814-824, 1990).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_gym.physics.namespaces import Array
from baselines.control.nmpc.problem import replaced, taken
from baselines.control.privileged.problem import Problem, Trajectory, Way

TOLERANCE = 1e-5
"""[m of the paper's vehicle] of the tail's root mean square: an episode is solved when a step that is hardly damped
gains less."""
_LENGTHS = (1.0, 0.5, 0.2, 0.05, 0.01)
"""Parts of a step that are tried until one lowers the cost."""
DAMPING = 1e-6  # [m^2 of the paper's vehicle] at the start
LEAST_DAMPING = 1e-12  # [m^2 of the paper's vehicle]
MOST_DAMPING = 1e3  # [m^2 of the paper's vehicle]
HARDLY_DAMPED = 1e-9
"""[m^2 of the paper's vehicle] damping up to which a step that gains nothing means that nothing is left to gain."""
STIFFER = 10.0  # factor on the damping where no part of a step lowers the cost
LOOSER = 0.1  # factor on the damping where all of a step does
_MOST_STEPS = 200  # for an episode
GOOD = 0.002
"""[m of the paper's vehicle] tail from which other commands to begin with are tried."""
_FADING = 0.5  # share of the last command that the periods after a window begin with
_STEPS_OF_WINDOW = 20  # most Gauss-Newton steps in a window


def best_trajectory(problem: Problem, guess: Array, others: Sequence[Callable[[Problem], Array]] = ()) -> Trajectory:
    """Return the best course of N episodes that is found from commands to begin with.

    Args:
        problem: see `Problem`.
        guess: commands, shape (K, ACTIONS, N), to begin with.
        others: each returns commands for the problem of a few of the episodes; they are tried in turn in those whose
            tail is not `GOOD`.
    """
    best = refined(problem, problem.standing(guess))
    for other in others:
        few = np.flatnonzero(~(best.steady_rmse < GOOD))
        if not few.size:
            break
        part = problem.taken(few)
        found = refined(part, part.standing(other(part)))
        better = np.flatnonzero(found.cost < best.cost[few])
        best = replaced(best, few[better], taken(found, better))
    return best


def refined(problem: Problem, course: Trajectory, most: int = _MOST_STEPS) -> Trajectory:
    """Return a course after as many steps as each episode takes, at most so many."""
    damping, few = np.full(len(course.cost), DAMPING), np.arange(len(course.cost))
    for _ in range(most):
        part, now = problem.taken(few), taken(course, few)
        then, whole = _stepped(part, now, part.way(now, damping[few]))
        gained = np.sqrt(now.cost) - np.sqrt(then.cost)
        idle = ~(then.cost < now.cost)
        own = damping[few]
        done = ~(gained > TOLERANCE) & ((whole & (own <= HARDLY_DAMPED)) | (idle & (own >= MOST_DAMPING)))
        damping[few] = np.clip(np.where(idle, STIFFER, np.where(whole, LOOSER, 1.0)) * own, LEAST_DAMPING, MOST_DAMPING)
        course = replaced(course, few, then)
        few = few[~done]
        if not few.size:
            break
    return course


def _stepped(problem: Problem, course: Trajectory, way: Way) -> tuple[Trajectory, NDArray[np.bool_]]:
    """Return the course after the longest part of a step that lowers the cost, and whether that is all of it."""
    best, whole = course, np.zeros(len(course.cost), dtype=bool)
    few = np.arange(len(course.cost))
    for length in _LENGTHS:
        now, part = taken(course, few), problem.taken(few)
        trial = part.played(now, taken(way, few), length)
        better = trial.cost < now.cost
        best = replaced(best, few[better], taken(trial, np.flatnonzero(better)))
        whole[few[better]] = length == _LENGTHS[0]
        few = few[~better]
        if not few.size:
            break
    return best, whole


class ForesightWindow(NamedTuple):
    """How far is looked ahead."""

    ahead: int  # control periods that are optimised
    kept: int  # of them, the first ones, whose commands are taken


WINDOWS = ForesightWindow(80, 40), ForesightWindow(160, 40)
"""Windows that are tried in turn: 8 s and 16 s at the cruise of the paper's vehicle."""


def foreseeing(window: ForesightWindow, problem: Problem) -> Array:
    """Return the commands, shape (K, ACTIONS, N), that windows through an episode of K periods give."""
    commands, begun, steps = np.zeros_like(problem.limits), problem.begun, len(problem.limits)
    for first in range(0, steps, window.kept):
        end = min(first + window.ahead, steps)
        part = problem.between(first, end, begun)
        course = refined(part, part.standing(commands[first:end].copy()), _STEPS_OF_WINDOW)
        commands[first:end] = course.commands
        commands[end : end + window.kept] = _FADING * course.commands[-1]
        if end == steps:
            break
        begun = course.states[window.kept]
    return commands

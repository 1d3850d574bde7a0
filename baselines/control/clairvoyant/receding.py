"""Commands to begin with for the whole-episode optimum: those of predictive control that foresees everything.

Where limits bind for long, the optimum is one of several that Gauss-Newton steps may end in, and the oracle's commands,
which a regulator cuts at the limits, may lead to a poor one. A window that moves through the episode, optimised with
all that will happen in it, goes along the limits from the start (D. Q. Mayne and H. Michalska, "Receding horizon
control of nonlinear systems", IEEE Trans. Automatic Control 35(7):814-824, 1990).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from auv_gym.physics.namespaces import Array
from baselines.control.clairvoyant.problem import Problem
from baselines.control.clairvoyant.solver import refined


class Window(NamedTuple):
    """How far is looked ahead."""

    ahead: int  # control periods that are optimised
    kept: int  # of them, the first ones, whose commands are taken


WINDOWS = Window(80, 40), Window(160, 40)
"""Windows that are tried in turn: 8 s and 16 s at the cruise of the paper's vehicle."""
FADING = 0.5  # share of the last command that the periods after a window begin with
MOST_STEPS = 20  # in a window


def foreseeing(window: Window, problem: Problem) -> Array:
    """Return the commands, shape (K, ACTIONS, N), that windows through an episode of K periods give."""
    commands, begun, steps = np.zeros_like(problem.limits), problem.begun, len(problem.limits)
    for first in range(0, steps, window.kept):
        end = min(first + window.ahead, steps)
        part = problem.between(first, end, begun)
        course = refined(part, part.standing(commands[first:end].copy()), MOST_STEPS)
        commands[first:end] = course.commands
        commands[end : end + window.kept] = FADING * course.commands[-1]
        if end == steps:
            break
        begun = course.states[window.kept]
    return commands

"""The clairvoyant optimum as a policy: the benchmark's upper bound and its score's 1, for evaluation only."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from auv_gym.physics.dynamics import State
from auv_gym.physics.namespaces import Array
from auv_gym.scenarios.episode import Episode
from auv_gym.scenarios.scenario import Scenario
from baselines.control.privileged.oracle import rehearsed, settling_gains, true_plan
from baselines.control.privileged.problem import COMMAND_ROWS, PLANT_STATES, Problem
from baselines.control.privileged.solver import DAMPING, WINDOWS, best_trajectory, foreseeing
from baselines.control.privileged.truth import FullInformation, Truth


class Clairvoyant(FullInformation):
    """The best commands for episodes of which everything is known, a `baselines.policy.Privileged`.

    They are found by optimisation over the whole episode, see `problem` and `solver`, from those of the oracle, and
    where these lead nowhere good, of predictive control that foresees everything, see `solver.foreseeing`. What
    rounding makes of them on the way is fed back by the gains of the last Gauss-Newton step.
    """

    def _planned(self, scenario: Scenario, episodes: Sequence[Episode]) -> Truth:
        problem, n = Problem.of(scenario, episodes), len(episodes)
        guess = arriving(oracle_actions(scenario, episodes), problem.delay)
        self._course = best_trajectory(problem, guess, [partial(foreseeing, window) for window in WINDOWS])
        feedback = problem.way(self._course, np.full(n, DAMPING)).feedback
        self._gains = feedback.reshape(len(feedback), COMMAND_ROWS, PLANT_STATES, n)
        self._limits, self._delay = problem.limits, problem.delay
        return Truth.of(scenario, episodes)

    def _decided(self, state: State, force: Array, sent: Array, k: NDArray[np.int64]) -> Array:
        assert self._truth is not None
        then = self._truth.foretell(state, force, sent, k)
        acting, lanes = np.minimum(k + self._delay, len(self._gains) - 1), np.arange(len(k))
        off = then - self._course.states[acting, :, lanes].T
        fed_back = np.einsum("nij,jn->in", self._gains[acting, :, :, lanes], off)
        limits = self._limits[acting, :, lanes].T
        return np.asarray(np.clip(self._course.commands[acting, :, lanes].T + fed_back, -limits, limits))


def oracle_actions(scenario: Scenario, episodes: Sequence[Episode]) -> Array:
    """Return what the oracle does in N episodes, shape (K, 2, N)."""
    plan = true_plan(scenario, episodes)
    return rehearsed(plan, settling_gains(scenario, episodes, plan), episodes).actions


def arriving(actions: Array, delay: NDArray[np.int64]) -> Array:
    """Return the actions, shape (K, 2, N), that act in each period, `delay` (N,) periods after they are sent."""
    late = np.zeros_like(actions)
    for d in np.unique(delay).tolist():
        lanes = delay == d
        late[d:, :, lanes] = actions[: len(actions) - d, :, lanes]
    return late

"""The full-information optimum as a policy: it has score 1 in the benchmark; for evaluation only."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from auv_gym.physics.dynamics import State
from auv_gym.physics.namespaces import Array
from auv_gym.scenarios.episode import Episode
from auv_gym.scenarios.scenario import Scenario
from baselines.control.privileged.oracle import oracle_run, stable_gains, true_plan
from baselines.control.privileged.problem import Problem
from baselines.control.privileged.solver import DAMPING, WINDOWS, about_reference, best_trajectory, receding_horizon
from baselines.control.privileged.truth import FullInformationPolicy, Truth


class FullInformationOptimum(FullInformationPolicy):
    """Optimal commands for known episodes, a `baselines.policy.Privileged`.

    They are optimised over the whole episode, see `problem` and `solver`, starting from the commands of the oracle, in
    space from those of `solver.about_reference`. If the result is poor, the optimisation is repeated from the commands
    of predictive control with full information, see `solver.receding_horizon`. The feedback of the last Gauss-Newton
    step corrects deviations due to rounding.
    """

    def _prepared(self, scenario: Scenario, episodes: Sequence[Episode]) -> Truth:
        problem, n = Problem.of(scenario, episodes), len(episodes)
        if scenario.vertical is None:
            guess = arriving(oracle_actions(scenario, episodes), problem.delay)
        else:  # there is no oracle in space
            guess = about_reference(problem)
        self._trajectory = best_trajectory(problem, guess, [partial(receding_horizon, window) for window in WINDOWS])
        feedback = problem.gauss_newton_step(self._trajectory, np.full(n, DAMPING)).feedback
        self._gains = feedback.reshape(len(feedback), problem.limits.shape[1], len(problem.begun), n)
        self._limits, self._delay = problem.limits, problem.delay
        return Truth.of(scenario, episodes)

    def _actions(self, state: State, force: Array, sent: Array, k: NDArray[np.int64]) -> Array:
        assert self._truth is not None
        state_then = self._truth.state_after_delay(state, force, sent, k)
        acting, columns = np.minimum(k + self._delay, len(self._gains) - 1), np.arange(len(k))
        deviation = state_then - self._trajectory.states[acting, :, columns].T
        feedback = np.einsum("nij,jn->in", self._gains[acting, :, :, columns], deviation)
        limits = self._limits[acting, :, columns].T
        return np.asarray(np.clip(self._trajectory.commands[acting, :, columns].T + feedback, -limits, limits))


def oracle_actions(scenario: Scenario, episodes: Sequence[Episode]) -> Array:
    """Return the actions of the oracle in N episodes, shape (K, 2, N)."""
    plan = true_plan(scenario, episodes)
    return oracle_run(plan, stable_gains(scenario, episodes, plan), episodes).actions


def arriving(actions: Array, delay: NDArray[np.int64]) -> Array:
    """Return the actions that act in each period, `delay` (N,) periods after they were sent; shape (K, 2, N)."""
    delayed = np.zeros_like(actions)
    for d in np.unique(delay).tolist():
        columns = delay == d
        delayed[d:, :, columns] = actions[: len(actions) - d, :, columns]
    return delayed

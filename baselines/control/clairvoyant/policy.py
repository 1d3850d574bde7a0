"""The clairvoyant optimum as a policy: the benchmark's upper bound and its score's 1, for evaluation only."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from auv_gym.physics.errors import to_body
from auv_gym.physics.namespaces import Array
from auv_gym.scenarios.episode import Episode
from auv_gym.scenarios.scenario import Scenario
from baselines.control.clairvoyant.problem import ACTIONS, STATES, Problem
from baselines.control.clairvoyant.receding import WINDOWS, foreseeing
from baselines.control.clairvoyant.solver import DAMPING, solved
from baselines.control.oracle import rehearsed, settling_gains, true_plan
from baselines.control.truth import Truth, nothing_sent

_BLIND = "the optimum needs prepare() before the reset and observe() before predict(), as evaluate.py calls them"


class Clairvoyant:
    """The best commands for episodes of which everything is known, a `baselines.policy.Privileged`.

    They are found by optimisation over the whole episode, see `problem` and `solver`, from those of the oracle, and
    where these lead nowhere good, of predictive control that foresees everything, see `receding`. What rounding makes
    of them on the way is fed back by the gains of the last Gauss-Newton step.
    """

    def __init__(self) -> None:
        self._truth: Truth | None = None
        self._action = np.zeros((0, ACTIONS), dtype=np.float32)

    def prepare(self, scenario: Scenario, episodes: Sequence[Episode]) -> None:
        """Find the commands of N episodes that are to run side by side.

        Raises:
            InfeasibleReferenceError: an episode's path cannot be followed in still water.
        """
        problem, n = Problem.of(scenario, episodes), len(episodes)
        guess = arriving(oracle_actions(scenario, episodes), problem.delay)
        self._course = solved(problem, guess, [partial(foreseeing, window) for window in WINDOWS])
        feedback = problem.way(self._course, np.full(n, DAMPING)).feedback
        self._gains = feedback.reshape(len(feedback), ACTIONS, STATES, n)
        self._limits, self._delay = problem.limits, problem.delay
        self._truth, self._sent, self._dt = Truth.of(scenario, episodes), nothing_sent(n), scenario.control_dt

    def observe(self, env: Any) -> None:
        """Decide on the true state of the vector environment."""
        if self._truth is None:
            raise RuntimeError(_BLIND)
        k = np.rint(env.time / self._dt).astype(int)
        x, y, psi, u, v, r = env.state.T
        V_x, V_y = env.current.T
        V_u, V_v = to_body(V_x, V_y, np.cos(psi), np.sin(psi))
        then = self._truth.foretell((x, y, psi, u - V_u, v - V_v, r), env.force.T, self._sent, k)
        acting, lanes = np.minimum(k + self._delay, len(self._gains) - 1), np.arange(len(k))
        off = then - self._course.states[acting, :, lanes].T
        fed_back = np.einsum("nij,jn->in", self._gains[acting, :, :, lanes], off)
        limits = self._limits[acting, :, lanes].T
        action = np.clip(self._course.commands[acting, :, lanes].T + fed_back, -limits, limits)
        self._sent = np.concatenate((action[None], self._sent[:-1]))
        self._action = action.T.astype(np.float32)

    def predict(
        self,
        observation: NDArray[Any],
        state: tuple[NDArray[Any], ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[NDArray[Any], ...] | None]:
        """Return the actions (N, 2) decided by the last `observe`, whatever the observation (N, 18) is.

        Raises:
            RuntimeError: nobody has let it look behind the observation.
        """
        if self._truth is None:
            raise RuntimeError(_BLIND)
        return self._action, state


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

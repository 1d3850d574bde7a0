"""A course: episodes of all cases of a regime, side by side, that policies run one after the other to be compared."""

from __future__ import annotations

import copy
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from auv_gym.envs.track_vector_env import UnderactuatedAUVTrackVectorEnv
from auv_gym.policy import Policy, preview_of
from auv_gym.presets import CASES, PRESETS
from baselines.evaluation.metrics import Array, effort, smoothness, tail_rmse
from baselines.evaluation.score import LARGEST_TAIL


@dataclass(frozen=True)
class Result:
    """What a policy does in a regime."""

    error_m: float  # mean over cases of the capped tail RMSE
    case_error_m: dict[str, float]  # the same by case
    lost: float  # share of the episodes whose tail RMSE reaches the cap
    effort: float  # mean square command
    smoothness: float  # mean squared change of the command


class Course:
    """Episodes of the eight cases of a regime, side by side, to be run again and again by different policies.

    Args:
        regime: "slow" or "cruise".
        episodes: how many, a multiple of eight; episode i is of case i modulo 8.
        seed: episode i is drawn with seed + i.
    """

    def __init__(self, regime: str, episodes: int, seed: int) -> None:
        self.cases = np.arange(episodes) % len(CASES)
        self.cap = LARGEST_TAIL[regime]
        presets = [PRESETS[f"{regime}-{case}"] for case in CASES]
        self.steps, self.lost_distance = presets[0].steps, presets[0].lost_distance
        # Nothing ends or begins within the run: one step more than are run, and vehicles go on when they are lost.
        scenarios = [replace(s, steps=s.steps + 1, lost_distance=64.0) for s in presets]
        self._lanes, self._seed = [scenarios[i] for i in self.cases.tolist()], seed
        self._begun: dict[tuple[int, ...], tuple[UnderactuatedAUVTrackVectorEnv, Array]] = {}

    def run(self, policy: Policy) -> Result:
        """Return what a policy does on the course."""
        env, observation = copy.deepcopy(self._beginning(preview_of(policy)))
        memory, first = None, np.ones(len(self.cases), dtype=bool)
        errors = np.zeros((self.steps, len(self.cases)))
        actions = np.zeros((self.steps, len(self.cases), 2))
        for k in range(self.steps):
            action, memory = policy.predict(observation, memory, first)
            observation, *_, info = env.step(action)
            first = np.zeros_like(first)
            errors[k], actions[k] = info["position_error"], action
        tail = tail_rmse(errors)
        tail = np.where((errors.max(axis=0) > self.lost_distance) | ~(tail < self.cap), self.cap, tail)
        means = [float(tail[self.cases == i].mean()) for i in range(len(CASES))]
        return Result(
            error_m=float(np.mean(means)),
            case_error_m=dict(zip(CASES, means, strict=True)),
            lost=float(np.mean(tail == self.cap)),
            effort=effort(actions),
            smoothness=smoothness(actions),
        )

    def _beginning(self, preview: tuple[int, ...]) -> tuple[UnderactuatedAUVTrackVectorEnv, Array]:
        """Return the episodes at their beginning, and what is observed of them with a preview."""
        if preview not in self._begun:
            env = UnderactuatedAUVTrackVectorEnv(len(self._lanes), self._lanes, preview=preview)
            self._begun[preview] = env, env.reset(seed=self._seed)[0]
        return self._begun[preview]


def compared(result: Result, expert: Result) -> dict[str, Any]:
    """Return a result with what it is relative to the expert's: 1 - its error, effort and smoothness ratio."""
    return {
        **asdict(result),
        "expert_error_m": expert.error_m,
        "score": 1 - result.error_m / expert.error_m,
        "effort_ratio": result.effort / expert.effort,
        "smoothness_ratio": result.smoothness / expert.smoothness,
    }

"""A course: episodes of all cases of a regime, side by side, that policies run one after the other to be compared."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from auv_gym.envs.track_vector_env import UnderactuatedAUVTrackVectorEnv
from auv_gym.policy import Policy
from auv_gym.presets import CASES, PRESETS
from baselines.evaluation.metrics import effort, smoothness, tail_rmse
from baselines.evaluation.rollout import Begun, Repeatable
from baselines.evaluation.score import LARGEST_TAIL, cut, is_lost


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
        lanes = [scenarios[i] for i in self.cases.tolist()]

        def begin(preview: tuple[int, ...]) -> Begun:
            env = UnderactuatedAUVTrackVectorEnv(len(lanes), lanes, preview=preview)
            return env, env.reset(seed=seed)[0]

        self._episodes = Repeatable(begin)

    def run(self, policy: Policy) -> Result:
        """Return what a policy does on the course.

        Raises:
            PolicyError: its actions are not finite.
        """
        moments = list(self._episodes.play(policy, self.steps))
        errors, actions = (np.array([getattr(m, key) for m in moments]) for key in ("error", "command"))
        tail, farther = tail_rmse(errors), errors.max(axis=0) > self.lost_distance
        tail = cut(tail, farther, self.cap)
        means = [float(tail[self.cases == i].mean()) for i in range(len(CASES))]
        return Result(
            error_m=float(np.mean(means)),
            case_error_m=dict(zip(CASES, means, strict=True)),
            lost=float(np.mean(is_lost(tail, farther, self.cap))),
            effort=effort(actions),
            smoothness=smoothness(actions),
        )


def compared(result: Result, expert: Result) -> dict[str, Any]:
    """Return a result with what it is relative to the expert's: 1 - its error, effort and smoothness ratio."""
    return {
        **asdict(result),
        "expert_error_m": expert.error_m,
        "score": 1 - result.error_m / expert.error_m,
        "effort_ratio": result.effort / expert.effort,
        "smoothness_ratio": result.smoothness / expert.smoothness,
    }

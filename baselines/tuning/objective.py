"""A course: episodes of a mixture of scenarios, side by side, that policies run one after the other to be compared."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from auv_gym.envs.track_vector_env import UnderactuatedAUVTrackVectorEnv
from auv_gym.physics.namespaces import Array
from auv_gym.scenarios.fitting import changed
from auv_gym.scenarios.mixtures import adverse
from auv_gym.scenarios.presets import CASES, PRESETS
from auv_gym.scenarios.scenario import Scenario
from auv_gym.scenarios.vehicles import PAPER, VehicleModel
from auv_gym.task.policy import Policy
from baselines.evaluation.metrics import Ended, effort, smoothness, steady_rmse
from baselines.evaluation.rollout import Begun, Repeatable
from baselines.evaluation.score import ERROR_CAPS, capped, has_failed

_WORLDS = ("plain", "adverse")
"""What controllers are tuned for: a regime's eight cases alone, or those and, as often, the adverse storm."""


@dataclass(frozen=True)
class Result:
    """What a policy does in a regime."""

    error_m: float  # mean over scenarios of the capped tail RMSE, each counted as often as it is in the course
    case_error_m: dict[str, float]  # the same by case
    failed: float  # share of the episodes whose tail RMSE reaches the cap
    effort: float  # mean square command
    smoothness: float  # mean squared change of the command


def rewound_scenarios(speed_range: str, world: str, vehicle_model: VehicleModel = PAPER) -> tuple[Scenario, ...]:
    """Return the scenarios of a course's first episodes, in their order, which then begins anew.

    Args:
        speed_range: "slow" or "cruise".
        world: one of `_WORLDS`.
        vehicle_model: whose they are; in the paper's units, so that caps and gains mean the same for every vehicle.

    Raises:
        ValueError: its fins do not steer it that slowly.
    """
    cases = tuple(PRESETS[f"{speed_range}-{case}"] for case in CASES)
    every = cases if world == "plain" else (*cases, *(adverse(speed_range),) * len(cases))
    if vehicle_model == PAPER:
        return every
    own = [replace(changed(s, vehicle_model.in_paper_units), name=s.name) for s in every]
    return tuple(replace(s, substeps=max(other.substeps for other in own)) for s in own)


class TuningEpisodes:
    """Episodes of a regime, side by side, to be run again and again by different policies.

    Args:
        speed_range: "slow" or "cruise".
        episodes: how many, a multiple of sixteen; they take turns over `rewound_scenarios`.
        seed: episode i is drawn with seed + i.
        world: one of `_WORLDS`.
        vehicle_model: the vehicle, see `rewound_scenarios`.
    """

    def __init__(
        self, speed_range: str, episodes: int, seed: int, world: str = "plain", vehicle_model: VehicleModel = PAPER
    ) -> None:
        turns = rewound_scenarios(speed_range, world, vehicle_model)
        self._names = [turns[i % len(turns)].name.removeprefix(f"{speed_range}-") for i in range(episodes)]
        self.cap = ERROR_CAPS[speed_range]
        self.steps, self.lost_distance = turns[0].steps, turns[0].lost_distance
        # Nothing ends or begins within the run: one step more than are run, and vehicles go on when they are lost.
        scenarios = [replace(s, steps=s.steps + 1, lost_distance=64.0) for s in turns]
        lanes = [scenarios[i % len(turns)] for i in range(episodes)]

        def begin(preview: tuple[int, ...]) -> Begun:
            env = UnderactuatedAUVTrackVectorEnv(len(lanes), lanes, preview=preview)
            return env, env.reset(seed=seed)[0]

        self._episodes = Repeatable(begin)

    def run(self, policy: Policy) -> Result:
        """Return what a policy does on the course.

        Raises:
            PolicyError: its actions are not finite.
        """
        steady_rmse, gone, actions = self.steady_rmses(policy)
        return Result(
            error_m=float(steady_rmse.mean()),
            case_error_m={name: float(own.mean()) for name, own in self.by_case(steady_rmse).items()},
            failed=float(np.mean(gone)),
            effort=effort(actions),
            smoothness=smoothness(actions),
        )

    def by_case(self, values: Array) -> dict[str, Array]:
        """Return what there is of each episode, shape (N,), by the case that it is of."""
        names = np.array(self._names)
        return {name: values[names == name] for name in dict.fromkeys(self._names)}

    def steady_rmses(self, policy: Policy) -> tuple[Array, NDArray[np.bool_], Array]:
        """Return the capped tail RMSE [m] of each episode, whether it was lost, and the commands, shape (steps, N, 2).

        Raises:
            PolicyError: the policy's actions are not finite.
        """
        moments = list(self._episodes.play(policy, self.steps))
        errors, actions = (np.array([getattr(m, key) for m in moments]) for key in ("error", "command"))
        ended = Ended(steady_rmse(errors), errors.max(axis=0) > self.lost_distance)
        return capped(ended, self.cap), has_failed(ended, self.cap), actions


@lru_cache(maxsize=2)
def course(
    speed_range: str, episodes: int, seed: int, world: str, vehicle_model: VehicleModel = PAPER
) -> TuningEpisodes:
    """Return a course; the last ones that were asked for are kept."""
    return TuningEpisodes(speed_range, episodes, seed, world, vehicle_model)


def compared(result: Result, expert: Result) -> dict[str, Any]:
    """Return a result with what it is relative to the expert's: 1 - its error, effort and smoothness ratio."""
    return {
        **asdict(result),
        "expert_error_m": expert.error_m,
        "score": 1 - result.error_m / expert.error_m,
        "effort_ratio": result.effort / expert.effort,
        "smoothness_ratio": result.smoothness / expert.smoothness,
    }

"""The check of a user's policy before it is evaluated or trained with."""

from __future__ import annotations

from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np

from auv_gym.scenarios.presets import as_scenario
from auv_gym.scenarios.scenario import Scenario
from auv_gym.task.policy import Policy, preview_of
from baselines.evaluation.rollout import PolicyError
from baselines.policy import Privileged

_VEHICLES, _STEPS = 3, 40


def check_policy(policy: Policy, scenario: Scenario | str = "cruise-storm") -> None:
    """Run a policy for a few steps and compare what it does for several vehicles with what it does for each alone.

    It is for policies what `check_env` of Stable-Baselines3 is for environments. A policy with random actions fails.

    Args:
        policy: an object with `predict(observation, state, episode_start, deterministic)`.
        scenario: the scenario whose observations it gets, shape (3, 18) each, (3, 31) in space, more with the policy's
            `preview`.

    Raises:
        PolicyError: it is a class or uses more than the observation; an action has not one number for each channel, is
            not finite or outside [-1, 1]; the action of a vehicle depends on the others, on the call before, or after
            `episode_start` on the episode before.
    """
    check_predict(policy)
    if isinstance(policy, Privileged):
        raise PolicyError("the policy uses more than the observation; only others can be checked")
    scenario = as_scenario(scenario)
    called = partial(_called, policy, len(scenario.parts.model.channels))
    env = gym.make_vec(
        f"auv_gym:UnderactuatedAUVTrack{'3D' if scenario.vertical else ''}-v0",
        _VEHICLES,
        vectorization_mode="vector_entry_point",
        scenario=scenario,
        preview=preview_of(policy),
    )
    observation, _ = env.reset(seed=0)
    memory, seen, actions = None, [], []
    for k in range(_STEPS):
        action, memory = called(observation, memory, np.full(_VEHICLES, k == 0))
        seen.append(observation)
        actions.append(action)
        observation, *_ = env.step(action)
    env.close()
    again, _ = called(seen[0], memory, np.ones(_VEHICLES, dtype=bool))
    _compare(
        again, actions[0], "after episode_start its action is another one than at first: it must forget its memory"
    )
    for i in range(_VEHICLES):
        memory = None
        for k, rows in enumerate(seen):
            action, memory = called(rows[i : i + 1], memory, np.array([k == 0]))
            what = f"step {k}, vehicle {i}: the action for it alone is another one than among {_VEHICLES}"
            _compare(action[0], actions[k][i], f"{what}; memory must be in state, with one row for each vehicle")
    single, _ = called(seen[0][0], None, np.array([True]))
    _compare(single, actions[0][0], "the action for one observation alone, shape (n,), is another one than in a batch")


def check_predict(policy: Any) -> None:
    """Raise PolicyError if a policy is a class, or has no method `predict`."""
    if isinstance(policy, type):
        raise PolicyError(f"{policy.__name__} is a class; give an object, {policy.__name__}()")
    if not callable(getattr(policy, "predict", None)):
        raise PolicyError(f"a {type(policy).__name__} has no method predict")


def _called(policy: Policy, channels: int, observation: Any, memory: Any, first: Any) -> tuple[Any, Any]:
    """Return the action and the memory of a policy; raise PolicyError if they are not those of one."""
    try:
        action, memory = policy.predict(observation.copy(), memory, first, True)
    except (TypeError, ValueError) as error:
        raise PolicyError(
            f"predict fails for an observation of shape {observation.shape}: {error}; it gets (observation, state, "
            "episode_start, deterministic) and returns (action, state)"
        ) from error
    array, shape = np.asarray(action), (*observation.shape[:-1], channels)
    if array.shape != shape or not (np.abs(array) <= 1).all():
        raise PolicyError(
            f"for an observation of shape {observation.shape} the action is {array.tolist()}; it must have the shape "
            f"{shape} and be finite and in [-1, 1]"
        )
    return array, memory


def _compare(action: Any, before: Any, failure: str) -> None:
    if not np.allclose(action, before, rtol=1e-4, atol=1e-5):
        raise PolicyError(f"{failure} ({np.asarray(action).tolist()}, before {np.asarray(before).tolist()})")

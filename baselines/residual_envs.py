"""The residual environments, in which an agent corrects an expert, and their command as a policy."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import gymnasium as gym
from gymnasium.vector import VectorEnv

from auv_gym.envs.arguments import ScenarioLike, scenarios_of
from auv_gym.envs.residual import ResidualAction, VectorResidualAction
from auv_gym.envs.space import UnderactuatedAUVTrack3DEnv, UnderactuatedAUVTrack3DVectorEnv
from auv_gym.envs.track_env import UnderactuatedAUVTrackEnv
from auv_gym.envs.track_vector_env import UnderactuatedAUVTrackVectorEnv
from auv_gym.physics.space import SpaceVehicle
from auv_gym.rendering import PICTURE
from auv_gym.scenarios.scenario import Scenario
from auv_gym.scenarios.vehicles import VehicleLike
from auv_gym.task.policy import Policy, preview_of
from baselines.agents.corrected import CorrectedPolicy
from baselines.evaluation.score import expert_of
from baselines.policies import check_actions, make_policy
from baselines.policy import Privileged


def make_residual_env(
    scenario: ScenarioLike = "paper-circle",
    vehicle: VehicleLike | None = None,
    control_dt: float | None = None,
    render_mode: str | None = None,
    expert: Policy | str | None = None,
    authority: float | Sequence[float] = 0.5,
    render_size: Sequence[int] = PICTURE,
) -> gym.Env[Any, Any]:
    """Return the environment of `UnderactuatedAUVTrackResidual-v0`: the tracking task with corrections to an expert.

    Args:
        scenario: see `UnderactuatedAUVTrackEnv`.
        vehicle: see `UnderactuatedAUVTrackEnv`.
        control_dt: see `UnderactuatedAUVTrackEnv`.
        render_mode: see `UnderactuatedAUVTrackEnv`.
        expert: a policy, or the name of one, which is then made for the known vehicle; the observation has the preview
            that it needs. None: `backstepping`, or `los-setpoints` if the actions of the scenario are setpoints.
        authority: largest correction of surge and yaw, as fractions of the limits in (0, 2]; one number or a pair.
        render_size: see `UnderactuatedAUVTrackEnv`.

    Raises:
        OSError: the expert's file cannot be read.
        ValueError: scenario, vehicle, control period, render mode or size, expert or authority is invalid.
    """
    (scenario,) = scenarios_of(scenario, 1, vehicle, control_dt)
    policy = _expert(expert, scenario.known, [scenario])
    make = UnderactuatedAUVTrack3DEnv if scenario.vertical else UnderactuatedAUVTrackEnv
    env = make(scenario, render_mode=render_mode, preview=preview_of(policy), render_size=render_size)
    return ResidualAction(env, policy, authority)


# Gymnasium reads the render modes here, for "rgb_array_list".
make_residual_env.metadata = UnderactuatedAUVTrackEnv.metadata  # type: ignore[attr-defined]


def make_residual_vector_env(
    num_envs: int = 1,
    scenario: ScenarioLike | Sequence[ScenarioLike] = "paper-circle",
    vehicle: VehicleLike | None = None,
    control_dt: float | None = None,
    *,
    expert: Policy | str | None = None,
    authority: float | Sequence[float] = 0.5,
    **options: Any,
) -> VectorEnv[Any, Any, Any]:
    """Return the vector environment of `UnderactuatedAUVTrackResidual-v0`.

    Args:
        num_envs: see `UnderactuatedAUVTrackVectorEnv`.
        scenario: see `UnderactuatedAUVTrackVectorEnv`.
        vehicle: see `UnderactuatedAUVTrackVectorEnv`.
        control_dt: see `UnderactuatedAUVTrackVectorEnv`.
        expert: a policy, or the name of one, which is then made for the known vehicle, if all scenarios have the same;
            None: see `make_residual_env`.
        authority: largest correction of surge and yaw, as fractions of the limits in (0, 2]; one number or a pair.
        options: further options of `UnderactuatedAUVTrackVectorEnv`, without the preview, which is the expert's.

    Raises:
        OSError: the expert's file cannot be read.
        TypeError: there is no such option.
        ValueError: an argument is invalid.
    """
    scenarios = scenarios_of(scenario, num_envs, vehicle, control_dt)
    first = scenarios[0].known
    policy = _expert(expert, first if all(one.known == first for one in scenarios) else None, scenarios)
    make = UnderactuatedAUVTrack3DVectorEnv if scenarios[0].vertical else UnderactuatedAUVTrackVectorEnv
    env = make(num_envs, scenarios, preview=preview_of(policy), **options)
    return VectorResidualAction(env, policy, authority)


def make_residual_policy(
    network: Policy | Callable[[Any], Any],
    expert: Policy | str = "backstepping",
    authority: float | Sequence[float] = 0.5,
    vehicle: VehicleLike | None = None,
) -> Policy:
    """Return the policy of the tracking task whose command is that of `UnderactuatedAUVTrackResidual-v0`.

    Args:
        network: gives the corrections, shape (N, 2), for a batch of observations of the residual environment, shape
            (N, n): a function of the batch, a module of torch, or an object with the method predict of
            Stable-Baselines3.
        expert: as in the residual environment.
        authority: as in the residual environment.
        vehicle: for which an expert is made by its name, see `make_policy`. None: the paper's.

    Raises:
        OSError: the expert's file cannot be read.
        ValueError: vehicle, expert, network or authority is invalid.
    """
    return CorrectedPolicy(_expert(expert, vehicle), network, authority)


def _expert(
    expert: Policy | str | None, vehicle: VehicleLike | SpaceVehicle | None, scenarios: Sequence[Scenario] = ()
) -> Policy:
    """Return the expert of an environment.

    Raises:
        OSError: its file cannot be read.
        ValueError: there is no such policy, it is no policy, it needs more than the observation, or its actions are not
            those of the scenarios.
    """
    expert = expert_of(scenarios) if expert is None else expert
    if isinstance(expert, str):
        check_actions(expert, scenarios)
    policy = make_policy(expert, vehicle) if isinstance(expert, str) else expert
    if isinstance(policy, type) or not callable(getattr(policy, "predict", None)):
        raise ValueError(f"expert is {expert!r}; it must be the name of a policy, or an object with the method predict")
    if isinstance(policy, Privileged):
        raise ValueError(f"expert {expert!r} uses more than the observation; choose another policy")
    return policy

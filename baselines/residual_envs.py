"""The environments of `UnderactuatedAUVTrackResidual-v0`: the tracking task with corrections to an expert."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium as gym

from auv_gym.envs import make_track_vector_env
from auv_gym.envs.residual import ResidualAction, VectorResidualAction
from auv_gym.envs.sub_environments import ScenarioLike
from auv_gym.envs.track_env import UnderactuatedAUVTrackEnv
from auv_gym.envs.vector_api import VectorEnv
from auv_gym.physics.vehicle import Vehicle
from auv_gym.rendering import PICTURE
from auv_gym.scenarios.fitting import changed
from auv_gym.scenarios.presets import as_scenario
from auv_gym.scenarios.scenario import Scenario
from auv_gym.task.policy import Policy, preview_of
from baselines.policies import common_vehicle, make_policy
from baselines.policy import Privileged


def make_residual_env(
    scenario: Scenario | str | Mapping[str, Any] = "paper-circle",
    vehicle: Vehicle | str | Mapping[str, Any] | None = None,
    control_dt: float | None = None,
    render_mode: str | None = None,
    expert: Policy | str = "backstepping",
    authority: float | Sequence[float] = 0.5,
    render_size: Sequence[int] = PICTURE,
) -> gym.Env[Any, Any]:
    """Return the environment of `UnderactuatedAUVTrackResidual-v0`: the tracking task with corrections to an expert.

    Args:
        scenario: a `Scenario`, its dict, or a preset's name.
        vehicle: the known vehicle, in place of the scenario's.
        control_dt: control period [s], in place of the scenario's.
        render_mode: None, "human" or "rgb_array".
        expert: a policy, or the name of one, which is then made for the known vehicle; the observation has the preview
            that it needs.
        authority: largest correction of surge and yaw, as fractions of the limits in (0, 2]; one number or a pair.
        render_size: width and height of pictures [px].

    Raises:
        OSError: the expert's file cannot be read.
        ValueError: scenario, vehicle, control period, render mode or size, expert or authority is invalid.
    """
    policy = _expert(expert, changed(as_scenario(scenario), vehicle).vehicle)
    env = UnderactuatedAUVTrackEnv(scenario, vehicle, control_dt, render_mode, preview_of(policy), render_size)
    return ResidualAction(env, policy, authority)


# Gymnasium reads the render modes here, for "rgb_array_list".
make_residual_env.metadata = UnderactuatedAUVTrackEnv.metadata  # type: ignore[attr-defined]


def make_residual_vector_env(
    num_envs: int = 1,
    scenario: ScenarioLike | Sequence[ScenarioLike] = "paper-circle",
    vehicle: Vehicle | str | Mapping[str, Any] | None = None,
    *,
    expert: Policy | str = "backstepping",
    authority: float | Sequence[float] = 0.5,
    backend: str = "numpy",
    **options: Any,
) -> VectorEnv[Any, Any, Any]:
    """Return the vector environment of `UnderactuatedAUVTrackResidual-v0`.

    Args:
        num_envs: N, the number of vehicles.
        scenario: a `Scenario`, its dict, a preset's name, or a sequence of N of them.
        vehicle: the known vehicle, in place of the scenarios'.
        expert: a policy, or the name of one, which is then made for the known vehicle, if all scenarios have the same;
            with backend "torch" a law that computes on tensors.
        authority: largest correction of surge and yaw, as fractions of the limits in (0, 2]; one number or a pair.
        backend: "numpy" for arrays of float64, or "torch" for tensors.
        options: further options of `auv_gym.envs.make_track_vector_env`, without the preview, which is the expert's.

    Raises:
        ImportError: the back end is "torch", and torch is not installed.
        OSError: the expert's file cannot be read.
        TypeError: there is no such option.
        ValueError: an argument is invalid.
    """
    given = [scenario] if isinstance(scenario, (Scenario, str, Mapping)) else scenario
    known = common_vehicle([changed(as_scenario(s), vehicle) for s in given])
    policy: Any = _expert(expert, known)
    env = make_track_vector_env(num_envs, scenario, vehicle, backend=backend, preview=preview_of(policy), **options)
    if backend == "numpy":
        return VectorResidualAction(env, policy, authority)
    from auv_gym.envs.torch_residual import TorchResidualAction

    return TorchResidualAction(env, policy, authority)  # type: ignore[arg-type]


def _expert(expert: Policy | str, vehicle: Vehicle | None) -> Policy:
    """Return the expert of an environment.

    Raises:
        OSError: its file cannot be read.
        ValueError: there is no such policy, it is no policy, or it needs more than the observation.
    """
    policy = make_policy(expert, vehicle) if isinstance(expert, str) else expert
    if isinstance(policy, type) or not callable(getattr(policy, "predict", None)):
        raise ValueError(f"expert is {expert!r}; it must be the name of a policy, or an object with the method predict")
    if isinstance(policy, Privileged):
        raise ValueError(f"expert {expert!r} uses more than the observation; choose another policy")
    return policy

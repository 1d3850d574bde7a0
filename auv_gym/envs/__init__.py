"""The environments on NumPy, scalar and vector, and on torch tensors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from auv_gym.envs.vector_api import AutoresetMode, VectorEnv
from auv_gym.installation import install

if TYPE_CHECKING:
    from auv_gym.envs.sub_environments import ScenarioLike
    from auv_gym.physics.vehicle import Vehicle
    from auv_gym.scenarios.vehicles import VehicleModel


def make_track_vector_env(
    num_envs: int = 1,
    scenario: ScenarioLike | Sequence[ScenarioLike] = "paper-circle",
    vehicle: Vehicle | VehicleModel | str | Mapping[str, Any] | None = None,
    control_dt: float | None = None,
    render_mode: str | None = None,
    backend: str = "numpy",
    device: Any = None,
    dtype: Any = None,
    preview: Sequence[int] = (),
    autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
    max_episode_steps: int | None = None,
) -> VectorEnv[Any, Any, Any]:
    """Return the vector environment of `UnderactuatedAUVTrack-v0`.

    Args:
        num_envs: N, the number of sub-environments.
        scenario: a `Scenario`, the name of a preset or a dict; or a sequence of N of them.
        vehicle: replaces the known vehicle of the scenarios: a `Vehicle`, a name or a dict.
        control_dt: control period [s], replaces that of the scenarios; the duration of episodes does not change.
        render_mode: None, since vector environments do not draw.
        backend: "numpy" for arrays of float64, or "torch" for tensors, see `TorchSimulator`.
        device: device of the tensors, "cpu" or "cuda"; with backend "torch" only.
        dtype: type of the tensors, "float32" or "float64"; with backend "torch" only.
        preview: control periods ahead at which the reference is observed, see `auv_gym.task.preview.Preview`.
        autoreset_mode: "SameStep", "NextStep" or "Disabled", see `UnderactuatedAUVTrackVectorEnv`.
        max_episode_steps: control steps after which episodes are truncated, if fewer than those of the scenario.

    Raises:
        ValueError: the back end is unknown or does not have an option, or the device is not available.
        ImportError: the back end is "torch", and torch is not installed.
    """
    if backend == "numpy":
        if device is not None or dtype is not None:
            raise ValueError("device and dtype are options of backend='torch'; backend 'numpy' computes in float64")
        from auv_gym.envs.track_vector_env import UnderactuatedAUVTrackVectorEnv

        return UnderactuatedAUVTrackVectorEnv(
            num_envs, scenario, vehicle, control_dt, render_mode, preview, autoreset_mode, max_episode_steps
        )
    if backend != "torch":
        raise ValueError(f"unknown backend {backend!r}; allowed are 'numpy' and 'torch'")
    if render_mode is not None:
        raise ValueError(f"render_mode is {render_mode!r}; the vector environments do not draw, the scalar one does")
    if find_spec("torch") is None:
        raise ImportError(f"backend 'torch' needs torch: {install('train')}, or choose backend='numpy'")
    from auv_gym.envs.torch_sim import TorchSimulator

    return TorchSimulator(
        num_envs,
        scenario,
        vehicle,
        control_dt,
        device or "cpu",
        dtype or "float32",
        preview=preview,
        autoreset_mode=autoreset_mode,
        max_episode_steps=max_episode_steps,
    )

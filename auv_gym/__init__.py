"""Trajectory tracking with an underactuated AUV: environments, planner and scenarios; import registers the ids."""

from typing import Any

import gymnasium as gym

from auv_gym.scenarios.names import SPACE_STEPS, STEPS

__version__ = "0.1.0"
__all__ = [
    "PRESETS",
    "Scenario",
    "Vehicle",
    "decode_observation",
    "list_scenarios",
    "list_vehicles",
    "plan",
]

_HOMES = {
    "PRESETS": "scenarios.presets",
    "Scenario": "scenarios.scenario",
    "Vehicle": "physics.vehicle",
    "decode_observation": "task.decoding",
    "list_scenarios": "scenarios.presets",
    "list_vehicles": "scenarios.vehicles",
    "plan": "planning.planner",
}


def __getattr__(name: str) -> Any:
    """Import a public name at its first use, so `import auv_gym` takes no longer than that of Gymnasium."""
    if name in _HOMES:
        import importlib

        return getattr(importlib.import_module(f"auv_gym.{_HOMES[name]}"), name)
    raise AttributeError(f"module 'auv_gym' has no attribute {name!r}")


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted(__all__)


def _register() -> None:
    """Register the tasks in the plane and in space, each with an id for any scenario and an id for each preset."""
    residual = "baselines.residual_envs:make_residual_env", "baselines.residual_envs:make_residual_vector_env"
    space = "auv_gym.envs.space:UnderactuatedAUVTrack3DEnv", "auv_gym.envs.space:UnderactuatedAUVTrack3DVectorEnv"
    plane = (
        "auv_gym.envs.track_env:UnderactuatedAUVTrackEnv",
        "auv_gym.envs.track_vector_env:UnderactuatedAUVTrackVectorEnv",
    )
    for task, (entry_point, vector_entry_point), presets, default in (
        ("UnderactuatedAUVTrack", plane, STEPS, ""),
        ("UnderactuatedAUVTrackResidual", residual, STEPS, ""),
        ("UnderactuatedAUVTrack3D", space, SPACE_STEPS, "-space-calm"),
        ("UnderactuatedAUVTrackResidual3D", residual, SPACE_STEPS, "-space-calm"),
    ):
        for name in ("", *(f"-{preset}" for preset in presets)):
            scenario = (name or default)[1:]
            if f"{task}{name}-v0" not in gym.registry:
                # The environment checks actions and the order of calls, and truncates, so it needs no wrappers.
                gym.register(
                    f"{task}{name}-v0",
                    entry_point,
                    order_enforce=False,
                    disable_env_checker=True,
                    kwargs={"scenario": scenario} if scenario else {},
                    vector_entry_point=vector_entry_point,
                )


_register()

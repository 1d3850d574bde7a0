"""Trajectory tracking for an underactuated AUV: environments, planner and scenarios. Importing registers the ids."""

from typing import Any

import gymnasium as gym

from auv_gym.scenarios.names import STEPS

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
    "decode_observation": "task.observation",
    "list_scenarios": "scenarios.presets",
    "list_vehicles": "scenarios.vehicles",
    "plan": "planning.planner",
}


def __getattr__(name: str) -> Any:
    """Import the public names when first used, so that `import auv_gym` costs no more than Gymnasium."""
    if name in _HOMES:
        import importlib

        return getattr(importlib.import_module(f"auv_gym.{_HOMES[name]}"), name)
    raise AttributeError(f"module 'auv_gym' has no attribute {name!r}")


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted(__all__)


def _register() -> None:
    """Register both tasks, once for any scenario, and under an id of its own for each that ships with the package."""
    for task, entry_point, vector_entry_point in (
        (
            "UnderactuatedAUVTrack",
            "auv_gym.envs.track_env:UnderactuatedAUVTrackEnv",
            "auv_gym.envs:make_track_vector_env",
        ),
        (
            "UnderactuatedAUVTrackResidual",
            "baselines.residual_envs:make_residual_env",
            "baselines.residual_envs:make_residual_vector_env",
        ),
    ):
        scenarios: dict[str, int | None] = {"": None, **{f"-{name}": steps for name, steps in STEPS.items()}}
        for name, steps in scenarios.items():
            if f"{task}{name}-v0" not in gym.registry:
                # The environment itself refuses bad actions and steps without reset, so no wrapper need watch it.
                gym.register(
                    f"{task}{name}-v0",
                    entry_point,
                    max_episode_steps=steps,
                    order_enforce=False,
                    disable_env_checker=True,
                    kwargs={"scenario": name[1:]} if name else {},
                    vector_entry_point=vector_entry_point,
                )


_register()

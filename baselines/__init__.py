"""Controllers, agents, training and evaluation for auv_gym. The names in `__all__` are public, all others internal."""

from typing import Any

_MODULES = {
    "Agent": "agents.agent",
    "EpisodeRecord": "evaluation.episodes",
    "Log": "identification.log",
    "POLICIES": "control",
    "citation": "sources",
    "check_policy": "evaluation.policy_check",
    "identify": "identification.fit",
    "list_policies": "policies",
    "list_suites": "evaluation.suites",
    "make_video": "video.video",
    "make_policy": "policies",
    "make_residual_env": "residual_envs",
    "make_residual_policy": "residual_envs",
    "make_residual_vector_env": "residual_envs",
    "run_episode": "evaluation.episodes",
    "run_episodes": "evaluation.episodes",
}
__all__ = list(_MODULES)


def __getattr__(name: str) -> Any:
    """Import a public name at its first use, so that `import baselines` is fast."""
    if name in _MODULES:
        from importlib import import_module

        return getattr(import_module(f"baselines.{_MODULES[name]}"), name)
    raise AttributeError(f"module 'baselines' has no attribute {name!r}")


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted(__all__)

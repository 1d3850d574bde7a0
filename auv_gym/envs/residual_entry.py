"""Where Gymnasium finds what makes the residual environments: `baselines` has it, and is imported for the first one."""

from __future__ import annotations

from typing import Any

from auv_gym.installation import from_baselines


def __getattr__(name: str) -> Any:
    """Return a function of `baselines`; see `from_baselines` for what it raises."""
    if name.startswith("__"):
        raise AttributeError(name)
    return from_baselines(name)

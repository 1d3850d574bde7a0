"""Controllers and agents for auv_gym, all with Stable-Baselines3's `predict`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import gymnasium as gym

from auv_gym.envs.track_env import UnderactuatedAUVTrackEnv
from auv_gym.residual import Policy, ResidualAction
from auv_gym.scenario import Scenario
from auv_gym.vehicle import Vehicle
from baselines.backstepping import Backstepping
from baselines.open_loop import OpenLoop

POLICIES: dict[str, tuple[Callable[..., Policy], dict[str, Any], str]] = {
    "backstepping": (
        Backstepping,
        {},
        "the paper's law; its gains in slow motion, re-tuned ones at cruise: the expert",
    ),
    "backstepping-paper": (Backstepping, {"gains": "paper"}, "the paper's law with the paper's gains at every speed"),
    "backstepping-robust": (Backstepping, {"gains": "robust"}, "the paper's law, gains tuned for decay up to 2 m/s"),
    "backstepping-normalised": (Backstepping, {"gains": "normalised"}, "the speed-normalised law, spin-safe gains"),
    "open-loop": (OpenLoop, {}, "the planner's forces alone"),
}
"""Policies by name: (factory, its options, one line about it). Add an entry here to use it everywhere by name."""


def list_policies() -> dict[str, str]:
    """Return the names of the policies with a line about each."""
    return {name: text for name, (_, _, text) in POLICIES.items()}


def make_policy(name: str, **options: Any) -> Policy:
    """Return a policy by name; options override those of the entry.

    Raises:
        ValueError: the name is unknown, or the policy does not take such options.
    """
    if name not in POLICIES:
        raise ValueError(f"unknown policy {name!r}; allowed are {', '.join(POLICIES)}")
    factory, defaults, _ = POLICIES[name]
    try:
        return factory(**{**defaults, **options})
    except TypeError as error:
        raise ValueError(f"policy {name!r} does not take these options: {error}") from error


def make_residual_env(
    scenario: Scenario | str | Mapping[str, Any] = "paper-circle",
    vehicle: Vehicle | str | Mapping[str, Any] | None = None,
    control_dt: float | None = None,
    render_mode: str | None = None,
    expert: Policy | str = "backstepping",
    authority: float | Sequence[float] = 0.5,
) -> gym.Env[Any, Any]:
    """Return the environment of `UnderactuatedAUVTrackResidual-v0`: the tracking task with corrections to an expert.

    Args:
        scenario: see `UnderactuatedAUVTrackEnv`, as the next three.
        vehicle: likewise.
        control_dt: likewise.
        render_mode: likewise.
        expert: a policy or the name of one.
        authority: see `ResidualAction`.
    """
    env = UnderactuatedAUVTrackEnv(scenario, vehicle, control_dt, render_mode)
    return ResidualAction(env, make_policy(expert) if isinstance(expert, str) else expert, authority)

"""Checks of the arguments of vector environments: scenarios, lengths of episodes, seeds, reset options."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils import seeding

from auv_gym.physics.namespaces import Indices
from auv_gym.scenarios.episode import checked_mapping, checked_options
from auv_gym.scenarios.fitting import changed
from auv_gym.scenarios.presets import as_scenario
from auv_gym.scenarios.scenario import Scenario
from auv_gym.scenarios.vehicles import VehicleLike
from auv_gym.task.model import Model

ScenarioLike = Scenario | str | os.PathLike[str] | Mapping[str, Any]
"""A scenario, its dict, its file, or the name of a preset."""


def scenarios_of(
    scenario: ScenarioLike | Sequence[ScenarioLike],
    num_envs: int,
    vehicle: VehicleLike | None = None,
    control_dt: float | None = None,
    kind: Model | None = None,
) -> list[Scenario]:
    """Return the scenario of each of N sub-environments; for the arguments see `UnderactuatedAUVTrackVectorEnv`.

    Raises:
        ValueError: a wrong number of sub-environments or scenarios, different numbers of substeps, a wrong scenario, or
            one of another kind of motion than `kind`.
    """
    if isinstance(num_envs, bool) or not isinstance(num_envs, int) or num_envs < 1:
        raise ValueError(f"num_envs is {num_envs!r}; it must be an integer of at least 1")
    if isinstance(scenario, (Scenario, str, Mapping)) or not isinstance(scenario, Iterable):
        return [_changed(scenario, vehicle, control_dt, kind)] * num_envs
    scenarios = [_changed(s, vehicle, control_dt, kind) for s in scenario]
    if len(scenarios) != num_envs:
        raise ValueError(
            f"{len(scenarios)} scenarios are given for {num_envs} sub-environments; give one, or one for each"
        )
    if (fewest := min(s.substeps for s in scenarios)) < (most := max(s.substeps for s in scenarios)):
        raise ValueError(f"scenarios have {fewest} to {most} substeps; give each replace(scenario, substeps={most})")
    return scenarios


def _changed(
    scenario: ScenarioLike, vehicle: VehicleLike | None, control_dt: float | None, kind: Model | None
) -> Scenario:
    found = changed(as_scenario(scenario), vehicle, control_dt)
    if kind is not None and found.parts.model != kind:
        name, needed = (
            ("space", "UnderactuatedAUVTrack3D-v0") if found.vertical else ("the plane", "UnderactuatedAUVTrack-v0")
        )
        raise ValueError(f"scenario {found.name!r} is one in {name}; make the environment {needed}")
    return found


def completed(spec: EnvSpec, steps: int) -> EnvSpec:
    """Return a spec with a number of control steps, and with records of scenarios, whose effects JSON then keeps."""
    kwargs = dict(spec.kwargs)
    with suppress(KeyError, ValueError):  # a path of the user has no record
        kwargs["scenario"] = _recorded(kwargs["scenario"])
    return replace(spec, max_episode_steps=spec.max_episode_steps or steps, kwargs=kwargs)


def _recorded(given: Any) -> Any:
    if isinstance(given, Scenario):
        return given.record
    return [*map(_recorded, given)] if isinstance(given, (list, tuple)) else given


def checked_steps(max_episode_steps: int | None) -> int:
    """Return a number of control steps; the largest integer for None.

    Raises:
        ValueError: it is not an integer of at least 1.
    """
    if max_episode_steps is None or max_episode_steps == -1:  # Gymnasium's value for no limit
        return int(np.iinfo(np.int64).max)
    if isinstance(max_episode_steps, bool) or not isinstance(max_episode_steps, int) or max_episode_steps < 1:
        raise ValueError(f"max_episode_steps is {max_episode_steps!r}; it must be an integer of at least 1, or None")
    return min(max_episode_steps, int(np.iinfo(np.int64).max))


def checked_seed(seed: Any) -> int | None:
    """Return a seed as a Python integer, or None.

    Raises:
        ValueError: it is neither None nor an integer of at least 0.
    """
    if seed is not None and (isinstance(seed, bool) or not isinstance(seed, (int, np.integer)) or seed < 0):
        raise ValueError(f"seed is {seed!r}; it must be an integer of at least 0, or None")
    return None if seed is None else int(seed)


def seeded(
    generators: Sequence[np.random.Generator | None], seed: int | Sequence[int | None] | None
) -> list[np.random.Generator]:
    """Return the random generators of N sub-environments: new ones for seeds, otherwise the present ones.

    Args:
        generators: the present ones; None where there is none, so a new one is made.
        seed: an integer, so sub-environment i has seed + i; or N seeds, None to keep the generator.

    Raises:
        ValueError: a wrong number of seeds, or a seed that is not an integer of at least 0.
    """
    n = len(generators)
    if isinstance(seed, Iterable) and not isinstance(seed, (str, Mapping)):
        seeds = [checked_seed(s) for s in seed]
        if len(seeds) != n:
            raise ValueError(f"seed has {len(seeds)} entries; it must be one integer, or {n} of them")
    else:
        first = checked_seed(seed)
        seeds = [None if first is None else first + i for i in range(n)]
    return [
        generator if s is None and generator is not None else seeding.np_random(s)[0]
        for s, generator in zip(seeds, generators, strict=True)
    ]


def checked_reset(options: Any, n: int, started: bool, size: int = 3) -> tuple[Indices, list[dict[str, Any]] | None]:
    """Return the indices of the sub-environments to reset, and the options of each of N; None without any.

    Args:
        options: of `reset`; values for all sub-environments, or N entries.
        n: N.
        started: whether all sub-environments have been reset before.
        size: of vectors, see `checked_options`.

    Raises:
        ValueError: an option is unknown, wrong or of another length, or the first reset is not of all.
    """
    indices, rest = np.arange(n), dict(checked_mapping(options))
    if "reset_mask" in rest:
        mask = np.asarray(rest.pop("reset_mask"))
        if mask.shape != (n,) or mask.dtype != np.bool_ or not mask.any():
            raise ValueError(f"reset_mask is {mask!r}; it must be a boolean array ({n},) with a True")
        if not (started or mask.all()):
            raise ValueError("the first reset must be of all sub-environments, without reset_mask")
        indices = mask.nonzero()[0]
    if not rest:
        return indices, None
    checked_options(dict.fromkeys(set(rest) - {"episode"}, (0,) * size), size)  # checks the names only
    choices: list[dict[str, Any]] = [{} for _ in range(n)]
    for key, value in rest.items():
        shared = key != "episode" and np.ndim(value) == 1
        if not shared and (np.ndim(value) == 0 or len(value) != n):
            raise ValueError(f"reset option {key} is {value!r}; it must have {n} entries, one for each sub-environment")
        for i, choice in enumerate(choices):
            choice.update(checked_options({key: value if shared else value[i]}, size))
    return indices, choices

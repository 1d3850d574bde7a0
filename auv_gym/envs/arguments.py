"""What is given to environments of many vehicles, checked: scenarios, lengths of episodes, seeds, reset options."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.utils import seeding
from numpy.typing import NDArray

from auv_gym.physics.vehicle import Vehicle
from auv_gym.scenarios.episode import checked_options
from auv_gym.scenarios.fitting import changed
from auv_gym.scenarios.presets import as_scenario
from auv_gym.scenarios.scenario import Scenario
from auv_gym.scenarios.vehicles import VehicleModel


def scenarios_of(
    scenario: Any,
    num_envs: int,
    vehicle: Vehicle | VehicleModel | str | Mapping[str, Any] | None,
    control_dt: float | None,
) -> list[Scenario]:
    """Return the scenario of each of N vehicles.

    Args:
        scenario: one for all, in any form that `presets.as_scenario` takes, or a sequence of N.
        num_envs: N.
        vehicle: in place of the scenarios' known vehicle.
        control_dt: control period [s] in place of the scenarios'.

    Raises:
        ValueError: a wrong number of scenarios, scenarios with several numbers of substeps, or whatever one refuses.
    """
    several = isinstance(scenario, Iterable) and not isinstance(scenario, (str, Mapping))
    given = list(scenario) if several else [scenario]
    if several and len(given) != num_envs:
        raise ValueError(f"{len(given)} scenarios are given for {num_envs} sub-environments; give one, or one for each")
    made = [changed(as_scenario(s), vehicle, control_dt) for s in given]
    if len({s.substeps for s in made}) > 1:
        raise ValueError("the scenarios differ in substeps; side by side they must have the same number")
    return made if several else made * num_envs


def checked_steps(max_episode_steps: int | None) -> int:
    """Return a number of control steps; a very large one for None.

    Raises:
        ValueError: it is no integer of at least 1.
    """
    if max_episode_steps is None or max_episode_steps == -1:  # Gymnasium's word for no limit
        return int(np.iinfo(np.int64).max)
    if isinstance(max_episode_steps, bool) or not isinstance(max_episode_steps, int) or max_episode_steps < 1:
        raise ValueError(f"max_episode_steps is {max_episode_steps!r}; it must be an integer of at least 1, or None")
    return max_episode_steps


def seeded(
    generators: Sequence[np.random.Generator], seed: int | Sequence[int | None] | None
) -> list[np.random.Generator]:
    """Return the random generators of N vehicles, new ones where a seed is given.

    Args:
        generators: the present ones, which stay where there is no seed.
        seed: of the first vehicle, whose i-th neighbour gets seed + i; or N seeds, None where there is none.

    Raises:
        ValueError: a wrong number of seeds.
        gymnasium.error.Error: a seed is no integer, or negative.
    """
    n = len(generators)
    seeds = seed if isinstance(seed, Iterable) else [None if seed is None else seed + i for i in range(n)]
    if len(seeds) != n:
        raise ValueError(f"seed has {len(seeds)} entries; it must be one integer, or {n} of them")
    plain = [int(s) if isinstance(s, np.integer) else s for s in seeds]
    return [generators[i] if s is None else seeding.np_random(s)[0] for i, s in enumerate(plain)]


def checked_reset(options: Mapping[str, Any], n: int, begun: bool) -> tuple[NDArray[np.int64], list[dict[str, Any]]]:
    """Return which of N vehicles a reset is for, as indices, and every vehicle's own options.

    Args:
        options: of `reset`; what holds for all, or N entries.
        n: N.
        begun: whether all of them have been reset before.

    Raises:
        ValueError: options that are unknown, wrong or of another length, or a first reset that leaves some out.
    """
    lanes, rest = np.arange(n), dict(options)
    if "reset_mask" in rest:
        mask = np.asarray(rest.pop("reset_mask"))
        if mask.shape != (n,) or mask.dtype != np.bool_ or not mask.any():
            raise ValueError(f"reset_mask is {mask!r}; it must be a boolean array ({n},) with a True")
        if not (begun or mask.all()):
            raise ValueError("the first reset must be of all sub-environments, without reset_mask")
        lanes = mask.nonzero()[0]
    checked_options(dict.fromkeys(set(rest) - {"episode"}, (0, 0, 0)))  # the names alone
    choices: list[dict[str, Any]] = [{} for _ in range(n)]
    for key, value in rest.items():
        shared = key != "episode" and np.ndim(value) == 1
        if not shared and (np.ndim(value) == 0 or len(value) != n):
            raise ValueError(f"reset option {key} is {value!r}; it must have one entry for each of {n} vehicles")
        for i, choice in enumerate(choices):
            choice.update(checked_options({key: value if shared else value[i]}))
    return lanes, choices

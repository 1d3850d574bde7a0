"""Recipes of the frozen suites."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from auv_gym.effects.faults import RandomFaults
from auv_gym.planning.feasibility import InfeasibleReferenceError
from auv_gym.planning.paths import Spline
from auv_gym.planning.planner import plan
from auv_gym.planning.sideslip import path_rates
from auv_gym.scenarios.episode import Episode
from auv_gym.scenarios.fitting import changed
from auv_gym.scenarios.presets import CASES, PRESETS, SPEED_RANGES
from auv_gym.scenarios.scenario import RandomPath, Scenario
from auv_gym.scenarios.vehicles import vehicle_model, vehicle_names
from baselines.evaluation.cells import Cell
from baselines.evaluation.suites import rounded
from research.suites import sealed

SUITE_FAMILIES = ("line", "circle", "sine", "figure_eight", "random_smooth")
"""Path families of the training; each has the same number of episodes in a cell."""
GENTLE = ("line", "circle", "sine", "random_smooth")
"""Path families that every published vehicle can follow. A figure-eight turns too fast for some rudders, and for ships
with little sway drag."""
_EPISODES = 52  # episodes of a path family in a cell of benchmark-v2
_VALIDATION_EPISODES = 10  # episodes of a path family in a cell of benchmark-v2-validation
SEALED_EPISODES = 64  # episodes in a cell of a sealed suite
FAULT_EPISODES = 40  # episodes in a cell of faults-v1
VEHICLE_EPISODES = {"cruise": 16, "slow": 4}  # episodes in a cell of vehicles-v2
FAULT_RATE = 2.0  # [1/min] of faults
LONG_OUTAGES = 1.5  # [1/min] rate of long outages of the position fix
SUITE_OUTAGE_TIME = (25.0, 35.0)  # [s]


@dataclass(frozen=True)
class Recipe:
    """Recipe of a cell."""

    scenario: Scenario
    families: tuple[str, ...] = SUITE_FAMILIES  # path families in rotation
    episodes: int = _EPISODES * len(SUITE_FAMILIES)
    waypoints: bool = False  # paths through random waypoints in place of the families


def _benchmark(per_family: int) -> list[Recipe]:
    scenarios = [PRESETS[f"{speed_range}-{case}"] for speed_range in SPEED_RANGES for case in CASES]
    return [Recipe(scenario, episodes=per_family * len(SUITE_FAMILIES)) for scenario in scenarios]


def _sealed(name: str) -> list[Recipe]:
    """Return the recipes of a sealed suite: missions follow waypoints, the others rotate through the families."""
    return [
        Recipe(s, (*SUITE_FAMILIES, "lawnmower"), SEALED_EPISODES, sealed.is_mission(s))
        for s in sealed.sealed_worlds(name)
    ]


def _faults() -> list[Recipe]:
    """Return storms with each kind of fault, long outages of the position fix, and very slow actuators."""
    recipes = []
    for speed_range in SPEED_RANGES:
        storm = PRESETS[f"{speed_range}-storm"]
        changes: dict[str, dict[str, Any]] = {
            kind.replace(" ", "-"): {"faults": RandomFaults((kind,), rate=FAULT_RATE)} for kind in sealed.FAULTS
        }
        blind = replace(storm.sensors, outages=LONG_OUTAGES, outage_time=SUITE_OUTAGE_TIME)
        changes["long-outages"] = {"sensors": blind}
        changes["lag-1-s"] = {"actuators": replace(storm.actuators, lag=(0.8, 1.2))}
        recipes += [
            Recipe(replace(storm, name=f"{speed_range}-{name}", **change), episodes=FAULT_EPISODES)
            for name, change in changes.items()
        ]
    return recipes


def _vehicles() -> list[Recipe]:
    """Return all cases for each published vehicle at its own speeds; slow motion only for vehicles without fins."""
    return [
        Recipe(changed(PRESETS[f"{speed_range}-{case}"], vehicle), GENTLE, episodes)
        for speed_range, episodes in VEHICLE_EPISODES.items()
        for vehicle in vehicle_names()
        if speed_range == "cruise" or not vehicle_model(vehicle).actuators.fin
        for case in CASES
    ]


def waypoints(rng: np.random.Generator, path: RandomPath, duration: float) -> Spline:
    """Return a spline through random waypoints whose turn rate is at most that of a figure-eight: 1.75 `turn_rate`.

    From leg to leg the heading changes by at most half a radian, and the speed by at most a fifth.
    """
    assert isinstance(path.speed, tuple)
    speed, leg_time = rng.uniform(*path.speed), 0.8 / path.turn_rate
    legs = math.ceil(1.3 * duration / leg_time) + 2
    while True:
        headings = np.cumsum(rng.uniform(-0.5, 0.5, legs)) + rng.uniform(-math.pi, math.pi)
        lengths = speed * leg_time * rng.uniform(0.8, 1.2, legs)
        steps = lengths[:, None] * np.stack((np.cos(headings), np.sin(headings)), axis=1)
        points = np.vstack((np.zeros(2), np.cumsum(steps, axis=0)))
        speeds = speed * rng.uniform(0.9, 1.1, legs + 1)
        spline = Spline(tuple(map(tuple, points.tolist())), float(speed), tuple(speeds.tolist()))
        if spline.end < duration:
            continue
        turn_rates = path_rates(spline.derivatives(np.linspace(0.0, duration, 600))).omega
        if np.abs(turn_rates).max() <= 1.75 * path.turn_rate:
            return spline


BUILDERS: dict[str, tuple[int | None, Callable[[], list[Recipe]]]] = {
    "benchmark-v2": (1_000_001, lambda: _benchmark(_EPISODES)),
    "benchmark-v2-validation": (1_000_002, lambda: _benchmark(_VALIDATION_EPISODES)),
    "vehicles-v2": (1_000_007, _vehicles),
    "faults-v1": (1_000_008, _faults),
    **{name: (None, partial(_sealed, name)) for name in sealed.CHANGES},
}
"""Suites by name: the seed, or None for the seed of a secret, and the function that returns the recipes. Training
selects agents on the validation split, never on a test."""


def build(name: str) -> list[Cell]:
    """Return the cells of a suite, drawn from its seed; they are the same with the same random streams of NumPy.

    Raises:
        SuiteError: the suite is sealed.
    """
    known, recipes = BUILDERS[name]
    seed = sealed.seed(name) if known is None else known
    return [rounded(_cell(recipe, seed, i)) for i, recipe in enumerate(recipes())]


def _cell(recipe: Recipe, seed: int, index: int) -> Cell:
    """Return a cell; the first family depends on its index, so the first paths of the cells differ."""
    families = [recipe.families[(index + i) % len(recipe.families)] for i in range(recipe.episodes)]
    episodes = (_episode(recipe, family, np.random.default_rng([seed, index, i])) for i, family in enumerate(families))
    return Cell(recipe.scenario, tuple(episodes))


def _episode(recipe: Recipe, family: str, rng: np.random.Generator) -> Episode:
    """Return an episode; it is drawn again while its path is infeasible."""
    scenario, act = recipe.scenario, recipe.scenario.actuators
    assert isinstance(scenario.path, RandomPath)
    times = scenario.control_dt * np.arange(scenario.steps + 1, dtype=np.float64)
    while True:
        spline = waypoints(rng, scenario.path, scenario.duration) if recipe.waypoints else None
        speed = spline.speed if spline else scenario.path.speed
        episode = replace(scenario, path=replace(scenario.path, families=(family,), speed=speed)).draw(rng)
        episode = replace(episode, path=spline or episode.path, noise_seed=episode.noise_seed % 2**32)
        try:
            plan(episode.path, scenario.vehicle, times, (act.F_u_max, act.F_r_max), act.fin)
        except InfeasibleReferenceError:
            continue
        return episode

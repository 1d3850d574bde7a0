"""Recipes of the frozen suites."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from auv_gym.effects.current import RandomCurrent
from auv_gym.effects.faults import RandomFaults
from auv_gym.effects.mismatch import RandomMismatch
from auv_gym.effects.navigation import RandomReckoning
from auv_gym.planning.feasibility import InfeasibleReferenceError
from auv_gym.planning.paths import Spline
from auv_gym.planning.sideslip import path_rates
from auv_gym.scenarios.episode import Episode
from auv_gym.scenarios.fitting import changed
from auv_gym.scenarios.mixtures import OFFSETS, slewing
from auv_gym.scenarios.presets import CASES, PRESETS, SPACE_PRESETS, SPEED_RANGES, TYPICAL_NOISE
from auv_gym.scenarios.scenario import RandomPath, Scenario, Start
from auv_gym.scenarios.vehicles import vehicle_model, vehicle_names
from baselines.evaluation.cells import Cell
from baselines.evaluation.suites import rounded
from research.suites import sealed

SUITE_FAMILIES = ("line", "circle", "sine", "figure_eight", "random_smooth")
"""Path families of the training; each has the same number of episodes in a cell."""
GENTLE = ("line", "circle", "sine", "random_smooth")
"""Path families that every published vehicle can follow. A figure-eight turns too fast for some rudders, and for ships
with little sway drag."""
POSITION_FIXES = {"rtk": 0.2, "usbl": 20.0}
"""Fixed levels of the position noise of benchmark-v3 by instrument, as multiples of `TYPICAL_NOISE`."""
_EPISODES = {"benchmark-v3": 150, "benchmark-v3-validation": 50, "hard-v1": 40, "sealed-v3": 64, "space-v1": 128}
"""Number of episodes in a cell."""
VEHICLE_EPISODES = {"cruise": 16, "slow": 4}  # episodes in a cell of vehicles-v3
# Numbers of hard-v1:
_STALE = 20.0  # [s] for which a velocity is frozen
_CORRELATION = 2.0  # [s] correlation time of the noise of the position
OUTAGES, OUTAGE_TIME = 1.5, (25.0, 35.0)  # [1/min] rate and [s] duration of outages of the position fix
_SHARPER = 3.0  # factor of the turn rate of the storm
_LAG = (1.8, 2.2)  # [s] time constants of the actuators
_SLEW = 2.0  # [s] time from zero to the limit of slewing actuators
_FAR = (-5.0, 5.0)  # [m] position on each axis of a far start
_MASS, _DRAG = (0.7, 1.3), (0.6, 1.4)  # of a vehicle as shares of the known ones
_BETWEEN = {"slow": (0.3, 0.4), "cruise": (0.4, 0.5)}  # [m/s] speeds between the speed ranges
_BEYOND = {"slow": (0.05, 0.1), "cruise": (1.6, 2.0)}  # [m/s] speeds outside the speed ranges
MISSION = "mission"  # case with paths through random waypoints
_MISSION = 300.0  # [s] its duration
_SHORT = {"slow": (5.0, 10.0), "cruise": (3.0, 6.0)}  # [s] duration of a short outage
_SHORT_SHEAR = {"slow": (3.0, 5.0), "cruise": (10.0, 20.0)}  # [m] wavelength of a shear of the current


@dataclass(frozen=True)
class Recipe:
    """Recipe of a cell."""

    scenario: Scenario
    families: tuple[str, ...]  # path families in rotation
    episodes: int
    waypoints: bool = False  # paths through random waypoints in place of the families


def _presets(name: str) -> list[Recipe]:
    scenarios = [PRESETS[f"{speed_range}-{case}"] for speed_range in SPEED_RANGES for case in CASES]
    return [Recipe(scenario, SUITE_FAMILIES, _EPISODES[name]) for scenario in scenarios]


def _benchmark(name: str) -> list[Recipe]:
    """Return the presets, and those with noise with two fixed levels of that of the position."""
    return _presets(name) + [
        Recipe(with_position_noise(PRESETS[f"{r}-{case}"], r, fix), SUITE_FAMILIES, _EPISODES[name])
        for r in SPEED_RANGES
        for case in ("noise", "storm")
        for fix in POSITION_FIXES
    ]


def _space(name: str) -> list[Recipe]:
    """Return the presets in space, and storms with two fixed levels of the noise of the position."""
    storm = SPACE_PRESETS["space-storm"]
    fixes = (with_position_noise(storm, "cruise", fix) for fix in POSITION_FIXES)
    return [Recipe(scenario, SUITE_FAMILIES, _EPISODES[name]) for scenario in (*SPACE_PRESETS.values(), *fixes)]


def with_position_noise(scenario: Scenario, speed_range: str, fix: str) -> Scenario:
    """Return a preset with the position noise of an instrument of `POSITION_FIXES`; the other levels are drawn."""
    level = POSITION_FIXES[fix] * TYPICAL_NOISE[speed_range].noise[0]
    return replace(scenario, name=f"{scenario.name}-{fix}", sensors=replace(scenario.sensors, position=level))


def _sealed(name: str) -> list[Recipe]:
    families = *SUITE_FAMILIES, "lawnmower"
    return [Recipe(scenario, families, _EPISODES[name]) for scenario in sealed.sealed_worlds(name)]


def _hard(name: str) -> list[Recipe]:
    """Return storms with one thing that is hard: a sensor, the path, the actuators, faults, the start, the vehicle."""
    return [
        Recipe(
            replace(PRESETS[f"{speed_range}-storm"], name=f"{speed_range}-{case}", **change),
            ("lawnmower",) if case == "sharp" else SUITE_FAMILIES,
            _EPISODES[name],
            waypoints=case == MISSION,
        )
        for speed_range in SPEED_RANGES
        for case, change in _hard_changes(PRESETS[f"{speed_range}-storm"], speed_range).items()
    ]


def _hard_changes(storm: Scenario, speed_range: str) -> sealed.Changes:
    """Return the fields of the scenarios of hard-v1 that differ from the storm, by case."""
    path, sensors, mismatch, current, act = storm.path, storm.sensors, storm.mismatch, storm.current, storm.actuators
    assert isinstance(path, RandomPath)
    assert isinstance(mismatch, RandomMismatch)
    assert isinstance(current, RandomCurrent)
    T, offset, slow = storm.duration, OFFSETS[speed_range], slewing(storm, _SLEW).actuators
    hulls = replace(mismatch, mass=_MASS, m33=_MASS, d11=_DRAG, d22=_DRAG, d33=_DRAG)
    return {
        "velocity-stale": {"faults": RandomFaults(("velocity frozen",), begin=(0.4 * T, 0.5 * T), time=_STALE)},
        "velocity-offset": {"faults": RandomFaults(("velocity offset",), begin=0.4 * T, time=T, offset=offset)},
        "velocity-bias": {"sensors": replace(sensors, velocity_bias=(-offset, offset))},
        "correlated": {"sensors": replace(sensors, correlation=_CORRELATION)},
        "dead-reckoning": {"sensors": replace(sensors, reckoning=RandomReckoning())},
        "outages": {"sensors": replace(sensors, outages=OUTAGES, outage_time=OUTAGE_TIME)},
        "sharp": {"path": replace(path, turn_rate=_SHARPER * path.turn_rate)},
        "lag": {"actuators": replace(act, lag=_LAG)},
        "slew": {"actuators": slow},
        "actuator-faults": {"faults": RandomFaults(sealed.ACTUATOR_FAULTS)},
        "sensor-faults": {"faults": RandomFaults(sealed.SENSOR_FAULTS)},
        "far-start": {"start": Start(x_e=_FAR, y_e=_FAR, psi_e=(-math.pi, math.pi), surge=(0.0, 1.0))},
        "hulls": {"mismatch": hulls},
        "beyond": {"path": replace(path, speed=_BEYOND[speed_range])},
        MISSION: {"steps": round(_MISSION / storm.control_dt)},
        "all-at-once": {
            "path": replace(path, speed=_BETWEEN[speed_range]),
            "actuators": replace(slow, effectiveness=(0.7, 1.0), delay=(0.0, 2.0)),
            "sensors": replace(sensors, outages=1.0, outage_time=_SHORT[speed_range], heading_bias=(-0.04, 0.04)),
            "mismatch": hulls,
            "current": replace(current, shear=(0.1, 0.2), wavelength=_SHORT_SHEAR[speed_range]),
        },
    }


def _vehicles(_: str) -> list[Recipe]:
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


BUILDERS: dict[str, tuple[int | None, Callable[[str], list[Recipe]]]] = {
    "benchmark-v3": (1_000_011, _benchmark),
    "benchmark-v3-validation": (1_000_012, _presets),
    "hard-v1": (1_000_013, _hard),
    "vehicles-v3": (1_000_014, _vehicles),
    "space-v1": (1_000_015, _space),
    **dict.fromkeys(sealed.CHANGES, (None, _sealed)),
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
    return [rounded(_cell(recipe, seed, i)) for i, recipe in enumerate(recipes(name))]


def _cell(recipe: Recipe, seed: int, index: int) -> Cell:
    """Return a cell; the first family depends on its index, so the first paths of the cells differ."""
    families = [recipe.families[(index + i) % len(recipe.families)] for i in range(recipe.episodes)]
    episodes = (_episode(recipe, family, np.random.default_rng([seed, index, i])) for i, family in enumerate(families))
    return Cell(recipe.scenario, tuple(episodes))


def _episode(recipe: Recipe, family: str, rng: np.random.Generator) -> Episode:
    """Return an episode; it is drawn again while its path is infeasible."""
    scenario = recipe.scenario
    assert isinstance(scenario.path, RandomPath)
    while True:
        spline = waypoints(rng, scenario.path, scenario.duration) if recipe.waypoints else None
        speed = spline.speed if spline else scenario.path.speed
        episode = replace(scenario, path=replace(scenario.path, families=(family,), speed=speed)).draw(rng)
        episode = replace(episode, path=spline or episode.path, noise_seed=episode.noise_seed % 2**32)
        try:
            scenario.planner.plan(episode.path)
        except InfeasibleReferenceError:
            continue
        return episode

"""Recipes of the frozen suites."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from auv_gym.physics.disturbances import RandomCurrent, RandomMismatch, RandomWaves
from auv_gym.physics.faults import FAULTS, RandomFaults
from auv_gym.physics.intervals import Interval
from auv_gym.planning.feasibility import InfeasibleReferenceError
from auv_gym.planning.governor import Governor
from auv_gym.planning.paths import Path, Retimed, Spline
from auv_gym.planning.planner import plan
from auv_gym.planning.sideslip import path_rates
from auv_gym.scenarios.episode import Episode
from auv_gym.scenarios.fitting import changed
from auv_gym.scenarios.presets import CASES, PRESETS, SPEED_RANGES
from auv_gym.scenarios.scenario import RandomPath, Scenario
from auv_gym.scenarios.vehicles import vehicle_model, vehicle_names
from baselines.evaluation.runner import Cell
from baselines.evaluation.score import BY_BOUND, BY_ORACLE, Anchors
from baselines.evaluation.suites import rounded
from research.suites import deep, sealed

FAMILIES = ("line", "circle", "sine", "figure_eight", "random_smooth")
"""Path families of the training; each has the same number of episodes in a cell."""
GENTLE = ("line", "circle", "sine", "random_smooth")
"""Path families that every published vehicle can follow. A figure-eight turns too fast for some rudders, and for ships
with little sway drag."""
_EPISODES = 52  # episodes of a path family in a cell of benchmark-v1 and ood-v1
_VALIDATION_EPISODES = 10  # episodes of a path family in a cell of benchmark-v1-validation
UNMODELLED_EPISODES = 30  # episodes of a path family in a cell of unmodelled-v1
SEALED_EPISODES = 64  # episodes in a cell of a sealed suite
DEEP_EPISODES = 60  # episodes in a cell of deep-v1
FAULT_EPISODES = 40  # episodes in a cell of faults-v1
GOVERNED_EPISODES = 24  # episodes in a cell of governed-v1
VEHICLE_EPISODES = {"cruise": 16, "slow": 4}  # episodes in a cell of vehicles-v2
STRONGER = 1.5  # factor on current and waves in ood-v1
FARTHER = 1.3  # factor on the ranges of the mismatch about 1 in ood-v1

SWELL = (0.15, 0.45)  # [rad/s] frequencies of waves below the usual band
_EFFECTIVENESS = (0.6, 0.9)  # actual force as a share of the commanded force
SLUGGISH = (0.4, 0.7)  # [s] time constants of the actuators
RAMP = 0.5  # [s] time from zero to the limit of sluggish actuators
DELAY = (1.0, 3.0)  # delay of the commands in control periods
_SATURATION = (0.45, 0.75)  # force at which the actuators saturate, as a share of their known limits
_OUTAGES = 4.0  # [1/min] rate of outages of the position fix
_OUTAGE_TIME = {"slow": (0.5, 2.5), "cruise": (0.3, 1.5)}  # [s] duration of an outage of the position fix
SHEAR = (0.1, 0.25)  # amplitude of a sheared current as a share of the path's speed
_WAVELENGTHS = {"slow": (5.0, 15.0), "cruise": (20.0, 60.0)}  # [m] of a sheared current
FAULT_RATE = 2.0  # [1/min] of faults
LONG_OUTAGES = 1.5  # [1/min] rate of long outages of the position fix
LONG_OUTAGE_TIME = (25.0, 35.0)  # [s]
_TURN = {"slow": (-0.02, 0.02), "cruise": (-0.05, 0.05)}  # [rad/s] turn rate of a turning current

PathOf = Callable[[np.random.Generator, RandomPath, float], Path | None]
"""Returns a path for a duration [s], or None if the scenario draws the path."""


@dataclass(frozen=True)
class Recipe:
    """Recipe of a cell: a scenario, the path families in rotation, and the number of episodes."""

    scenario: Scenario
    families: tuple[str, ...] = FAMILIES
    episodes: int = _EPISODES * len(FAMILIES)
    path: PathOf = lambda *_: None


def _benchmark(per_family: int) -> list[Recipe]:
    scenarios = [PRESETS[f"{speed_range}-{case}"] for speed_range in SPEED_RANGES for case in CASES]
    return [Recipe(scenario, episodes=per_family * len(FAMILIES)) for scenario in scenarios]


def _out_of_distribution() -> list[Recipe]:
    recipes = []
    for speed_range in SPEED_RANGES:
        current, storm = PRESETS[f"{speed_range}-current"], PRESETS[f"{speed_range}-storm"]
        assert current.current is not None
        stronger = replace(current.current, speed=_scaled(current.current.speed, STRONGER))
        turning = replace(current.current, turn=_TURN[speed_range])
        recipes += [
            Recipe(replace(current, name=f"{speed_range}-current-x1.5", current=stronger)),
            Recipe(_worse(storm)),
            Recipe(replace(storm, name=f"{speed_range}-lawnmower"), families=("lawnmower",)),
            Recipe(replace(storm, name=f"{speed_range}-waypoints"), path=waypoints),
            Recipe(replace(current, name=f"{speed_range}-current-sheared", current=_sheared(current, speed_range))),
            Recipe(replace(current, name=f"{speed_range}-current-turning", current=turning)),
        ]
    return recipes


def _unmodelled() -> list[Recipe]:
    """Return storms with sensor, actuator and current effects that the model of the controllers does not have."""
    recipes = []
    for speed_range in SPEED_RANGES:
        storm = PRESETS[f"{speed_range}-storm"]
        act, waves, velocity = storm.actuators, storm.waves, storm.sensors.velocity
        assert isinstance(waves, RandomWaves)
        biased = replace(
            storm.sensors,
            heading_bias=(-0.05, 0.05),
            velocity_bias=(-2.5 * velocity, 2.5 * velocity),
            yaw_rate_bias=(-0.005, 0.005),
        )
        swell = replace(waves, band=SWELL)
        weak = replace(act, effectiveness=_EFFECTIVENESS)
        slow = replace(act, lag=SLUGGISH, F_u_rate=act.F_u_max / RAMP, F_r_rate=act.F_r_max / RAMP)
        patchy = replace(storm.sensors, outages=_OUTAGES, outage_time=_OUTAGE_TIME[speed_range])
        sheared = _sheared(storm, speed_range)
        broken = replace(act, effectiveness=_EFFECTIVENESS, delay=DELAY)
        changes: dict[str, dict[str, Any]] = {
            "bias": {"sensors": biased},
            "swell": {"waves": swell},
            "thruster-loss": {"actuators": weak},
            "sluggish": {"actuators": slow},
            "dropout": {"sensors": patchy},
            "delay": {"actuators": replace(act, delay=DELAY)},
            "short-limits": {"actuators": replace(act, reach=_SATURATION)},
            "shear": {"current": sheared},
            "everything": {"sensors": biased, "waves": swell, "actuators": broken, "current": sheared},
        }
        count = UNMODELLED_EPISODES * len(FAMILIES)
        recipes += [Recipe(replace(storm, name=f"{speed_range}-{n}", **c), episodes=count) for n, c in changes.items()]
    return recipes


def _sealed(name: str) -> list[Recipe]:
    """Return the recipes of a sealed suite: missions follow waypoints, the others rotate through the families."""
    return [
        Recipe(s, (*FAMILIES, "lawnmower"), SEALED_EPISODES, waypoints if sealed.is_mission(s) else Recipe.path)
        for s in sealed.sealed_worlds(name)
    ]


def _faults() -> list[Recipe]:
    """Return storms with each kind of fault, long outages of the position fix, and very slow actuators."""
    recipes = []
    for speed_range in SPEED_RANGES:
        storm = PRESETS[f"{speed_range}-storm"]
        changes: dict[str, dict[str, Any]] = {
            kind.replace(" ", "-"): {"faults": RandomFaults((kind,), rate=FAULT_RATE)} for kind in FAULTS
        }
        blind = replace(storm.sensors, outages=LONG_OUTAGES, outage_time=LONG_OUTAGE_TIME)
        changes["long-outages"] = {"sensors": blind}
        changes["lag-1-s"] = {"actuators": replace(storm.actuators, lag=(0.8, 1.2))}
        recipes += [
            Recipe(replace(storm, name=f"{speed_range}-{name}", **change), episodes=FAULT_EPISODES)
            for name, change in changes.items()
        ]
    return recipes


def _governed() -> list[Recipe]:
    """Return disturbed cruise cases with governed plans for each published vehicle with fins."""
    recipes = []
    for vehicle in (name for name in vehicle_names() if vehicle_model(name).actuators.fin):
        for case in ("current", "waves", "storm"):
            scenario = replace(changed(PRESETS[f"cruise-{case}"], vehicle), governor=Governor())
            name = f"cruise-{case}-governed@{vehicle}"
            recipes.append(Recipe(replace(scenario, name=name), GENTLE, GOVERNED_EPISODES))
    return recipes


def own_pace(cell: Cell) -> Cell:
    """Return a cell of a governed suite with the paths at their own pace; everything else is the same."""
    scenario = replace(cell.scenario, name=cell.scenario.name.replace("-governed", ""), governor=None)
    return Cell(scenario, tuple(replace(e, path=_own_pace(e.path)) for e in cell.episodes))


def _own_pace(path: Path) -> Path:
    return path.path if isinstance(path, Retimed) else path


def _deep() -> list[Recipe]:
    return [Recipe(scenario, (*FAMILIES, "lawnmower"), DEEP_EPISODES) for scenario in deep.deep_worlds()]


def _vehicles() -> list[Recipe]:
    """Return all cases for each published vehicle at its own speeds; slow motion only for vehicles without fins."""
    return [
        Recipe(changed(PRESETS[f"{speed_range}-{case}"], vehicle), GENTLE, episodes)
        for speed_range, episodes in VEHICLE_EPISODES.items()
        for vehicle in vehicle_names()
        if speed_range == "cruise" or not vehicle_model(vehicle).actuators.fin
        for case in CASES
    ]


def _sheared(scenario: Scenario, speed_range: str) -> RandomCurrent:
    """Return the scenario's current with a shear."""
    assert isinstance(scenario.current, RandomCurrent)
    return replace(scenario.current, shear=SHEAR, wavelength=_WAVELENGTHS[speed_range])


def _worse(storm: Scenario) -> Scenario:
    """Return a storm with more current and waves and a wider mismatch."""
    current, waves, mismatch = storm.current, storm.waves, storm.mismatch
    assert isinstance(current, RandomCurrent)
    assert isinstance(waves, RandomWaves)
    assert isinstance(mismatch, RandomMismatch)
    factors = ("mass", "ratio", "m33", "d11", "d22", "d33")
    wider: dict[str, Any] = {name: _widened(getattr(mismatch, name)) for name in factors}
    return replace(
        storm,
        name=storm.name.replace("storm", "all-x1.5"),
        current=replace(current, speed=_scaled(current.speed, STRONGER), gust=STRONGER * current.gust),
        waves=replace(waves, surge=STRONGER * waves.surge, sway=STRONGER * waves.sway, yaw=STRONGER * waves.yaw),
        mismatch=replace(mismatch, **wider, quadratic=_scaled(mismatch.quadratic, FARTHER)),
    )


def _scaled(interval: Interval, factor: float) -> Interval:
    return tuple(factor * end for end in interval) if isinstance(interval, tuple) else factor * interval  # type: ignore[return-value]


def _widened(interval: Interval) -> Interval:
    assert isinstance(interval, tuple)
    return 1 + FARTHER * (interval[0] - 1), 1 + FARTHER * (interval[1] - 1)


def waypoints(rng: np.random.Generator, path: RandomPath, duration: float) -> Path:
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
    "benchmark-v1": (1_000_001, lambda: _benchmark(_EPISODES)),
    "benchmark-v1-validation": (1_000_002, lambda: _benchmark(_VALIDATION_EPISODES)),
    "ood-v1": (1_000_003, _out_of_distribution),
    "unmodelled-v1": (1_000_004, _unmodelled),
    "deep-v1": (1_000_005, _deep),
    "vehicles-v2": (1_000_007, _vehicles),
    "faults-v1": (1_000_008, _faults),
    "governed-v1": (1_000_009, _governed),
    **{name: (None, partial(_sealed, name)) for name in sealed.CHANGES},
}
"""Suites by name: the seed, or None for the seed of a secret, and the function that returns the recipes. Training
selects agents on the validation split, never on a test."""
SHARED = {"benchmark-v2": "benchmark-v1"}
"""Suites with the episodes of another suite and their own anchors."""
OLDEST = ("benchmark-v1", "benchmark-v1-validation", "ood-v1", "unmodelled-v1")
"""Suites in which the oracle scores 1; in the others it is the full-information optimum."""


def anchors_of(name: str) -> Anchors:
    """Return the anchors of a new suite."""
    return BY_ORACLE if name in OLDEST else BY_BOUND


def build(name: str) -> list[Cell]:
    """Return the cells of a suite, drawn from its seed; they are the same with the same random streams of NumPy.

    Raises:
        SuiteError: the suite is sealed.
    """
    known, recipes = BUILDERS[name]
    seed = sealed.seed(name) if known is None else known
    return [rounded(_cell(recipe, seed, i)) for i, recipe in enumerate(recipes())]


def _cell(recipe: Recipe, seed: int, index: int) -> Cell:
    """Return a cell; the order of the families depends on its index, so the first paths of the cells differ."""
    families = recipe.families[index % len(recipe.families) :] + recipe.families[: index % len(recipe.families)]
    rotated = replace(recipe, families=families)
    episodes = [_episode(rotated, i, np.random.default_rng([seed, index, i])) for i in range(recipe.episodes)]
    return Cell(recipe.scenario, tuple(episodes))


def _episode(recipe: Recipe, i: int, rng: np.random.Generator) -> Episode:
    """Return episode i; it is drawn again while its path is infeasible."""
    scenario, act = recipe.scenario, recipe.scenario.actuators
    assert isinstance(scenario.path, RandomPath)
    family = recipe.families[i % len(recipe.families)]
    times = scenario.control_dt * np.arange(scenario.steps + 1, dtype=np.float64)
    while True:
        given = recipe.path(rng, scenario.path, scenario.duration)
        distribution = replace(scenario.path, families=(family,))
        if given is not None:
            distribution = replace(distribution, speed=given.speed)
        episode = replace(scenario, path=distribution).draw(rng)
        episode = replace(episode, path=given or episode.path, noise_seed=episode.noise_seed % 2**32)
        try:
            for path in dict.fromkeys((_own_pace(episode.path), episode.path)):
                plan(path, scenario.vehicle, times, (act.F_u_max, act.F_r_max), act.fin)
        except InfeasibleReferenceError:
            continue
        return episode

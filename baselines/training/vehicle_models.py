"""Random vehicle models to train on, in the units of the paper's vehicle: coefficients, limits, lag, model errors.

By dimensional analysis every vehicle can be scaled to the mass, length and speed of the paper's vehicle, see
`auv_gym.physics.units`. Therefore these three are not drawn. The ranges of the other parameters include the published
vehicles of `auv_gym.scenarios.vehicles`, which are not trained on. A vehicle that cannot follow the paths of its
scenario is rejected.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from auv_gym.effects.actuators import Actuators
from auv_gym.effects.mismatch import RandomMismatch
from auv_gym.physics.vehicle import PAPER_VEHICLE, Vehicle
from auv_gym.planning.paths import Path
from auv_gym.scenarios.fitting import adapted
from auv_gym.scenarios.scenario import ATTEMPTS, RandomPath, Scenario
from auv_gym.scenarios.vehicles import VehicleModel

SUBSTEPS = 2
"""Integration steps in a control period, the same for all vehicles; a model that needs more is rejected."""
SEVERAL = 16
"""Number of drawn models of a sub-environment; its episodes cycle through them."""
TEST_PATHS = 8  # paths on which a model is tested
ENOUGH = 6  # number of them that it must be able to follow
FIXED_PATHS = 6  # number of fixed paths of a sub-environment whose vehicle has cross terms
DECADES = {
    "d11": (7.0, 450.0),  # [kg/s] surge drag over speed at the design speed, including quadratic drag
    "d22": (1.8, 900.0),  # [kg/s]
    "d33": (6.0, 320.0),  # [kg m^2/s]
    "Y_vv": (25.0, 1300.0),  # [kg/m]
    "N_rr": (8.0, 950.0),  # [kg m^2]
    "Y_uv": (40.0, 800.0),  # [kg/m]
    "N_ur": (15.0, 130.0),  # [kg m]
    "m22": (1.06, 2.4),  # over m11
    "thrust": (2.2, 14.0),  # F_u_max over the drag at the design speed
    "F_r_max": (40.0, 700.0),  # [N m]
    "turn_rate": (0.025, 0.16),  # [rad/s] at most, at cruise
    "lag": (0.02, 0.6),  # [s]
    "fin": (4.5, 60.0),  # [kg]
    "astern": (0.45, 1.0),
}
"""Ranges in the paper's units, drawn with a uniform distribution of the logarithm."""
LIFTS = {"Y_ur": (0.0, 450.0), "N_uv": (-120.0, 220.0)}  # [kg], uniform distribution
SOME = 0.65  # probability of each quadratic drag, and of each lift coefficient of a model with lift
LIFTING = 0.5  # probability of lift
FINNED = 0.5  # probability of fins, whose torque depends on the speed, instead of a yaw torque at any speed
WRONG = 0.75  # probability that the nominal model of an episode has errors
MISTAKE = (0.35, 1.65)
"""Range of nominal over true m22/m11, limited to slender vehicles, and of nominal over true drag."""


def variants_of(scenarios: Sequence[Scenario], share: float, seed: int) -> list[list[Scenario]]:
    """Return for each sub-environment the scenarios of its episodes, through which it cycles.

    A share of the sub-environments, evenly distributed, has `SEVERAL` drawn models; the others have their scenario.

    Args:
        scenarios: of the paper's vehicle, one for each sub-environment.
        share: of the sub-environments with drawn models, 0 ... 1.
        seed: of the draws.
    """
    rng = np.random.default_rng([seed, len(scenarios)])
    stepped = [replace(s, substeps=SUBSTEPS, model=None) for s in scenarios]  # the drawn models have other actuators
    drawn = [math.floor((i + 1) * share) > math.floor(i * share) for i in range(len(scenarios))]
    return [
        [drawn_model(scenario, rng)[1] for _ in range(SEVERAL)] if other else [scenario]
        for scenario, other in zip(stepped, drawn, strict=True)
    ]


def with_fixed_paths(scenarios: Sequence[Scenario], seed: int) -> list[list[Scenario]]:
    """Return the scenario of each sub-environment, or `FIXED_PATHS` scenarios with fixed paths for cross terms.

    The plan of a path with cross terms takes as long as some hundred control steps, so each path is used several times.

    Args:
        scenarios: of one vehicle, one for each sub-environment.
        seed: of the paths.

    Raises:
        ValueError: the vehicle can follow none of `ATTEMPTS` paths of a scenario.
    """
    rng = np.random.default_rng([seed, len(scenarios)])
    return [_on_fixed_paths(s, rng) if s.vehicle.has_cross_terms else [s] for s in scenarios]


def _on_fixed_paths(scenario: Scenario, rng: np.random.Generator) -> list[Scenario]:
    if not isinstance(scenario.path, RandomPath):
        return [scenario]
    if not (paths := _followed(scenario, rng, ATTEMPTS, FIXED_PATHS)):
        raise ValueError(f"the vehicle of scenario {scenario.name!r} can follow none of {ATTEMPTS} paths; use others")
    return [replace(scenario, path=path) for path in paths]


def drawn_model(scenario: Scenario, rng: np.random.Generator) -> tuple[VehicleModel, Scenario]:
    """Return a random vehicle that can follow the paths of a scenario, and the scenario adapted to it.

    Both are in the paper's units. The adapted scenario has the same number of integration steps.

    Args:
        scenario: of the paper's vehicle.
        rng: of the draws.
    """
    while True:
        with suppress(ValueError):  # the vehicle, its scenario or its plan is impossible
            model = _drawn(rng)
            other = adapted(model, scenario)
            if other.substeps == scenario.substeps and len(_followed(other, rng, TEST_PATHS)) >= ENOUGH:
                return model, other


def _drawn(rng: np.random.Generator) -> VehicleModel:
    """Return a random vehicle in the paper's units.

    Raises:
        ValueError: the parameters are not those of a possible vehicle; for example it is not slender.
    """
    x = {name: float(np.exp(rng.uniform(*np.log(ends)))) for name, ends in DECADES.items()}
    x |= {name: float(rng.uniform(*ends)) for name, ends in LIFTS.items()}
    lifting, finned = rng.random() < LIFTING, rng.random() < FINNED
    x |= {name: x[name] * (rng.random() < SOME) for name in ("Y_vv", "N_rr")}
    x |= {name: x[name] * (lifting and rng.random() < SOME) for name in ("Y_uv", "Y_ur", "N_uv", "N_ur")}
    linear = 1.0 - 0.97 * rng.uniform() * (rng.random() < SOME)
    paper = PAPER_VEHICLE
    vehicle = Vehicle(
        paper.m11, paper.m11 * x["m22"], paper.m33, linear * x["d11"], x["d22"], x["d33"],
        (1 - linear) * x["d11"] / paper.speed, x["Y_vv"], x["N_rr"], x["Y_uv"], x["Y_ur"], x["N_uv"], x["N_ur"],
    )  # fmt: skip
    limits = x["thrust"] * x["d11"] * paper.speed, x["F_r_max"]
    fin = x["fin"] if finned else 0.0
    slowest = 0.4 if finned else 0.0  # [m/s] excludes the slow speed range
    acts = Actuators(*limits, fin=fin, astern=x["astern"] if rng.random() < SOME else 1.0)
    return VehicleModel("drawn", "", "", "", "", vehicle, acts, x["turn_rate"], x["lag"], slowest)


def with_model_error(vehicle: Vehicle, rng: np.random.Generator) -> Vehicle:
    """Return the nominal model of a vehicle in an episode: the vehicle, or one with errors in m22 and drag."""
    if rng.random() >= WRONG:
        return vehicle
    low, high = MISTAKE
    slender = max(low, 1.02 * vehicle.m11 / vehicle.m22), high
    mistake = RandomMismatch(ratio=slender, d11=MISTAKE, d22=MISTAKE, d33=MISTAKE)
    return mistake.draw(rng.uniform, vehicle)


def _followed(scenario: Scenario, rng: np.random.Generator, trials: int, most: int | None = None) -> list[Path]:
    """Return those of some random paths that the vehicle of a scenario can follow; `most`: only the first ones."""
    paths: list[Path] = []
    for _ in range(trials):
        with suppress(ValueError):
            episode = scenario.draw(rng)
            scenario.planner.table(episode.path)
            paths.append(episode.path)
        if len(paths) == most:
            break
    return paths

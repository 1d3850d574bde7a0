"""Measure the growth of errors if a policy is given a wrong vehicle model: `python -m research model-error`.

True vehicles and plans are unchanged. Each parameter of the given model has its own error. Mass and inertia also define
the units of a policy (`auv_gym.physics.units`), so they are wrong in only one of the two sets of parameters.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from auv_gym.physics.namespaces import Array
from auv_gym.physics.vehicle import PAPER_VEHICLE, Vehicle
from auv_gym.scenarios.names import SPEED_RANGES
from baselines.control.backstepping import StabilityWarning
from baselines.evaluation.cells import Cell, SideBySide
from baselines.evaluation.score import ERROR_CAPS, capped, count_failures, relative_error
from baselines.evaluation.suites import load_suite
from baselines.policies import make_policy
from research.seeds import SENSITIVITY
from research.study import Study, stamp

_SUITE = "benchmark-v3"
_POLICIES = ("helm", "helm-any", "ekf", "backstepping", "nmpc")
_EPISODES = 12  # of each case
ERROR_SIZE = 0.6
"""Largest relative error of a parameter; errors are uniform between plus and minus it."""
_MODELS = 12
"""Number of wrong models, the same ones for all policies."""
_RATIOS = ("m22", "d11", "d22", "d33")
PARAMETER_SETS: Mapping[str, tuple[tuple[str, ...], str]] = {
    "ratios": (_RATIOS, "m22, drag"),
    "all": ((*_RATIOS, "m11", "m33"), "m22, drag, m11, m33"),
}
"""Parameters of the vehicle model that are wrong together, and their description, by name."""


def model_errors(number: int) -> dict[str, float]:
    """Return the errors of the parameters of wrong model `number`, in -1 ... 1 as shares of the largest error.

    They are drawn again until the vehicle is valid with each set of parameters.
    """
    rng = np.random.default_rng([SENSITIVITY.first + number, 5])
    while True:
        drawn = {name: float(rng.uniform(-1.0, 1.0)) for name in ("m11", "m22", "m33", "d11", "d22", "d33")}
        with suppress(ValueError):  # no slender vehicle
            for key in PARAMETER_SETS:
                wrong_model(PAPER_VEHICLE, drawn, ERROR_SIZE, key)
            return drawn


def wrong_model(vehicle: Vehicle, errors: Mapping[str, float], size: float, wrong: str) -> Vehicle:
    """Return the wrong model of a vehicle.

    Args:
        vehicle: the true vehicle.
        errors: errors of the parameters, see `model_errors`.
        size: largest relative error.
        wrong: the parameters that are wrong, a name of `PARAMETER_SETS`.

    Raises:
        ValueError: the result is no valid vehicle.
    """
    names, _ = PARAMETER_SETS[wrong]
    return replace(vehicle, **{name: (1 + size * errors[name]) * getattr(vehicle, name) for name in names})


def cells_of(speed_range: str, quick: bool = False) -> list[Cell]:
    """Return the first episodes of the cells of a speed range, without still water, where errors are nearly zero."""
    cells = [c for c in load_suite(_SUITE).cells_in((speed_range,)) if not c.scenario.name.endswith("-calm")]
    return [Cell(c.scenario, c.episodes[: 2 if quick else _EPISODES]) for c in cells[: 2 if quick else None]]


def _measure(policy: str, speed_range: str, quick: bool = False) -> dict[str, Any]:
    """Return the results of a policy with the true and with wrong vehicle models."""
    cells, models = cells_of(speed_range, quick), 2 if quick else _MODELS
    vehicle, batch = cells[0].scenario.vehicle, SideBySide(cells)
    right, failed = _errors(policy, vehicle, batch, speed_range)

    def compared(wrong: str) -> dict[str, Any]:
        wrong_models = (wrong_model(vehicle, model_errors(k), ERROR_SIZE, wrong) for k in range(models))
        results = [_errors(policy, model, batch, speed_range) for model in wrong_models]
        by_case = [np.array(errors) for errors in zip(*(errors for errors, _ in results), strict=True)]
        ratio = relative_error(right, by_case)
        return {
            "ratio": [ratio.mean, *ratio.ci95],
            "models": [relative_error(right, [rows[k] for rows in by_case]).mean for k in range(models)],
            "error_m": [float(rows.mean()) for rows in by_case],
            "failed": sum(count for _, count in results),
        }

    return {
        "episodes": sum(len(cell.episodes) for cell in cells),
        "models": models,
        "right": {"error_m": [float(row.mean()) for row in right], "failed": failed},
        "wrong": {key: compared(key) for key in PARAMETER_SETS},
    }


def _errors(policy: str, model: Vehicle, batch: SideBySide, speed_range: str) -> tuple[list[Array], int]:
    """Return the capped errors [m] of a policy with a vehicle model, cell by cell, and the number of failures."""
    cap = ERROR_CAPS[speed_range]
    with warnings.catch_warnings():  # an unstable law with a wrong model is a part of the result
        warnings.simplefilter("ignore", StabilityWarning)
        ended = batch.run(make_policy(policy, model))
    return [capped(e, cap) for e in ended], sum(count_failures(e, cap) for e in ended)


STUDY = Study(
    "model-error",
    [(policy, speed_range) for policy in _POLICIES for speed_range in SPEED_RANGES],
    _measure,
    lambda policy, speed_range: stamp(
        policy, [c.scenario for c in cells_of(speed_range)], load_suite(_SUITE).hash[:20], _EPISODES, _MODELS
    ),
)
main = STUDY.main


def context(_: str = "") -> dict[str, Any]:
    """Return the values of the template of docs/sensitivity.md."""
    values = STUDY.values()
    places = [(speed_range, key) for speed_range in SPEED_RANGES for key in PARAMETER_SETS]
    return {
        "size": f"{100 * ERROR_SIZE:.0f} %",
        "models": _MODELS,
        "episodes": _EPISODES,
        "columns": [f"{speed_range}: {PARAMETER_SETS[key][1]}" for speed_range, key in places],
        "rows": [[f"`{p}`", *(_text(values[p, speed]["wrong"][key]) for speed, key in places)] for p in _POLICIES],
        "runs": {value["models"] * value["episodes"] for value in values.values()},
    }


def _text(wrong: Mapping[str, Any]) -> str:
    """Return a ratio with its interval, and the number of failures, as text."""
    return "{:.2f} ({:.2f} ... {:.2f}), {}".format(*wrong["ratio"], wrong["failed"])

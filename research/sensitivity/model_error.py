"""What a wrong vehicle model costs a policy: the score on frozen episodes, whose vehicles and plans stay as they are.

Every parameter of the known vehicle is wrong by a share of its own. Mass and inertia are also units, in which a policy
sees everything (`auv_gym.physics.units`): they are wrong in one of the two ways only.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from auv_gym.physics.namespaces import Array
from auv_gym.physics.vehicle import PAPER_VEHICLE, Vehicle
from baselines.control.backstepping import StabilityWarning
from baselines.evaluation import recorded
from baselines.evaluation.runner import Cell
from baselines.evaluation.score import LARGEST_TAIL, RIVAL, Score, capped, lead, losses, seeds_score
from baselines.evaluation.side_by_side import SideBySide
from baselines.evaluation.suites import load_suite
from research.sensitivity.episodes import SENSITIVITY_SEED, acting

_SUITE = "benchmark-v1"
"""Whose episodes run, and whose anchors the score has."""
ERROR_SIZES = (0.2, 0.4, 0.6)
"""How wrong a parameter is at most, as a share of it; any error up to that is as likely as another."""
_HULLS = 12
"""Wrong models of each size, the same ones for all policies."""
_EPISODES = 12
"""Episodes of each case, the first ones of the suite."""
LESS: Mapping[str, tuple[int, int]] = {RIVAL: (4, 6)}
"""Models and episodes of a policy that takes its time, the first ones too; and the largest size alone."""
KEPT_EPISODES = 3
"""Episodes of each case whose errors are kept one by one, with the true model and the first wrong one."""


_HULL = ("m11", "m22", "m33", "d11", "d22", "d33")
"""Parameters of the vehicle that may be wrong."""


class _Way(NamedTuple):
    """A way in which a vehicle model is wrong."""

    names: tuple[str, ...]  # the parameters that are wrong
    says: str


WAYS: Mapping[str, _Way] = {
    "ratios": _Way(("m22", "d11", "d22", "d33"), "m22, drag"),
    "all": _Way(_HULL, "m22, drag, m11, m33"),
}
"""The ways, by name."""


def mistakes(number: int) -> dict[str, float]:
    """Return how wrong each parameter of a model is, by its number: shares of the largest size, in -1 ... 1.

    They are drawn together, until there is such a vehicle in every way.
    """
    rng = np.random.default_rng([SENSITIVITY_SEED + number, 5])
    while True:
        drawn = {name: float(rng.uniform(-1.0, 1.0)) for name in _HULL}
        with suppress(ValueError):  # no slender vehicle
            for way in WAYS.values():
                wrong(PAPER_VEHICLE, drawn, ERROR_SIZES[-1], way)
            return drawn


def wrong(vehicle: Vehicle, mistaken: Mapping[str, float], size: float, way: _Way) -> Vehicle:
    """Return the model that is given in place of a vehicle.

    Args:
        vehicle: the true one.
        mistaken: see `mistakes`.
        size: how wrong a parameter is at most.
        way: which of them are wrong.

    Raises:
        ValueError: there is no such vehicle.
    """
    return replace(vehicle, **{name: (1 + size * mistaken[name]) * getattr(vehicle, name) for name in way.names})


def cells_of(regime: str, episodes: int) -> list[Cell]:
    """Return the first episodes of each cell of a regime in the suite."""
    return [Cell(cell.scenario, cell.episodes[:episodes]) for cell in load_suite(_SUITE).cells_in((regime,))]


def with_wrong_models(name: str, regime: str, episodes: int | None = None) -> dict[str, Any]:
    """Return what a policy's capped score loses where its vehicle model is wrong, as plain numbers.

    Args:
        name: of the policy; none that looks behind the observation.
        regime: "slow" or "cruise".
        episodes: of each case. None: `_EPISODES`, or fewer of one that takes its time.

    Raises:
        ValueError: there is no such policy.
        PolicyError: its actions are not finite.
    """
    hulls, usual = LESS.get(name, (_HULLS, _EPISODES))
    sizes, cells = ERROR_SIZES[-1:] if name in LESS else ERROR_SIZES, cells_of(regime, episodes or usual)
    known, true = cells[0].scenario.vehicle, SideBySide(cells)
    zero, one = (_recorded(policy, regime, cells) for policy in load_suite(_SUITE).anchors)
    right, lost = _tails(name, known, true, regime)

    def compared(way: _Way, size: float) -> dict[str, Any]:
        each, gone = [], []
        for vehicle in (wrong(known, mistakes(k), size, way) for k in range(hulls)):
            tails, own = _tails(name, vehicle, true, regime)
            each.append(tails)
            gone.append(own)
        rows = [np.array(own) for own in zip(*each, strict=True)]
        return {"size": size, "lost": gone, **_compared(zero, right, rows, one)}

    return {
        "episodes": len(cells[0].episodes),
        "cases": [cell.scenario.name.removeprefix(f"{regime}-") for cell in cells],
        "right": {
            "score": _ends(seeds_score(zero, [row[None] for row in right], one)),
            "lost": lost,
            "error_m": [round(float(row.mean()), 6) for row in right],
            "first_m": [np.round(row[:KEPT_EPISODES], 6).tolist() for row in right],
        },
        "wrong": {key: [compared(way, size) for size in sizes] for key, way in WAYS.items()},
    }


def _recorded(policy: str, regime: str, cells: Sequence[Cell]) -> list[Array]:
    """Return the capped tails [m] that are recorded of a policy in episodes of the suite, cell by cell."""
    runs = {run.scenario.name: run.measures for run in recorded.read_recorded(load_suite(_SUITE), policy)}
    rows = ((runs[cell.scenario.name], len(cell.episodes)) for cell in cells)
    return [capped(row[:count], LARGEST_TAIL[regime]) for row, count in rows if row is not None]


def _tails(name: str, model: Vehicle, there: SideBySide, regime: str) -> tuple[list[Array], int]:
    """Return the capped tails [m] of a policy with a vehicle model, cell by cell, and how many episodes it lost."""
    cap = LARGEST_TAIL[regime]
    with warnings.catch_warnings():  # that its law may be unstable for such a model is a part of the price
        warnings.simplefilter("ignore", StabilityWarning)
        ended = there.run(acting(name, model))
    return [capped(e, cap) for e in ended], sum(losses(e, cap) for e in ended)


def _compared(zero: Sequence[Array], right: Sequence[Array], each: Sequence[Array], one: Sequence[Array]) -> Any:
    """Return what the tails with wrong models, shape (models, M) in each cell, are beside those with the true one."""
    above = partial(lead, zero, right, one=one)
    return {
        "score": _ends(seeds_score(zero, each, one)),
        "above": _ends(above(each)),
        "hulls": [round(above([rows[[k]] for rows in each]).mean, 5) for k in range(len(each[0]))],
        "error_m": [round(float(rows.mean()), 6) for rows in each],
        "first_m": [np.round(rows[0, :KEPT_EPISODES], 6).tolist() for rows in each],
    }


def _ends(value: Score) -> list[float]:
    return [round(float(x), 5) for x in (value.mean, *value.ci95)]

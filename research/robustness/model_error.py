"""Sensitivity to model error: `python -m research model-error --help`, and its page, docs/sensitivity.md.

The study measures by how much the score on frozen episodes is lower where a policy is given a wrong vehicle model.
Vehicles and plans stay as they are. Every parameter of the given model has an error of its own. Mass and inertia are
also the units in which a policy sees everything (`auv_gym.physics.units`): they are wrong in one of the two ways only.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from tyro.conf import arg

from auv_gym.physics.namespaces import Array
from auv_gym.physics.vehicle import PAPER_VEHICLE, Vehicle
from auv_gym.scenarios.names import SPEED_RANGES
from auv_gym.task.policy import Policy
from baselines.agents.agent import Agent
from baselines.agents.names import agent_folder
from baselines.control.backstepping import StabilityWarning
from baselines.evaluation import recorded
from baselines.evaluation.rollout import PolicyError
from baselines.evaluation.runner import Cell
from baselines.evaluation.score import (
    ERROR_CAPS,
    EXPERT,
    FORESIGHTED,
    RIVAL,
    Score,
    capped,
    count_failures,
    lead,
    seeds_score,
)
from baselines.evaluation.side_by_side import SideBySide
from baselines.evaluation.suites import load_suite
from baselines.policies import list_policies, make_policy
from baselines.similar import made_for
from baselines.tools.command_line import DONE, FAILED, UsageError, called, check_words, parse
from baselines.tools.files import json_text, read_json, write_atomically
from research import DATA
from research.seeds import SENSITIVITY

PROGRAM = "python -m research model-error"
_PRECISION = "float32"  # of the networks: a fifth of the time, and errors that differ by 1e-6
MODEL_ERROR_FOLDER = DATA / "model_error"
_POLICIES = ("helm-any", "helm", "ekf", "backstepping", "nmpc")
"""Policies by default."""
_SUITE = "benchmark-v1"
"""Whose episodes run, and whose anchors the score has."""
ERROR_SIZES = (0.2, 0.4, 0.6)
"""How wrong a parameter is at most, as a share of it; any error up to that is as likely as another."""
_MODELS = 12
"""Wrong models of each size, the same ones for all policies."""
_EPISODES = 12
"""Episodes of each case, the first ones of the suite."""
LESS: Mapping[str, tuple[int, int]] = {RIVAL: (4, 6)}
"""Models and episodes of a policy that takes its time, the first ones too; and the largest size alone."""
KEPT_EPISODES = 3
"""Episodes of each case whose errors are kept one by one, with the true model and the first wrong one."""

_PARAMETERS = ("m11", "m22", "m33", "d11", "d22", "d33")
"""Parameters of the vehicle that may be wrong."""


class _Way(NamedTuple):
    """A way in which a vehicle model is wrong."""

    names: tuple[str, ...]  # the parameters that are wrong
    says: str


WAYS: Mapping[str, _Way] = {
    "ratios": _Way(("m22", "d11", "d22", "d33"), "m22, drag"),
    "all": _Way(_PARAMETERS, "m22, drag, m11, m33"),
}
"""The ways, by name."""


def mistakes(number: int) -> dict[str, float]:
    """Return how wrong each parameter of a model is, by its number: shares of the largest size, in -1 ... 1.

    They are drawn together, until there is such a vehicle in every way.
    """
    rng = np.random.default_rng([SENSITIVITY.first + number, 5])
    while True:
        drawn = {name: float(rng.uniform(-1.0, 1.0)) for name in _PARAMETERS}
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


def cells_of(speed_range: str, episodes: int) -> list[Cell]:
    """Return the first episodes of each cell of a speed range in the suite."""
    return [Cell(cell.scenario, cell.episodes[:episodes]) for cell in load_suite(_SUITE).cells_in((speed_range,))]


def with_wrong_models(name: str, speed_range: str, episodes: int | None = None) -> dict[str, Any]:
    """Return the loss of a policy's capped score with wrong vehicle models, as plain numbers.

    Args:
        name: of the policy; none that uses more than the observation.
        speed_range: the speed range, "slow" or "cruise".
        episodes: of each case. None: `_EPISODES`, or fewer of one that takes its time.

    Raises:
        ValueError: there is no such policy.
        PolicyError: its actions are not finite.
    """
    models, usual = LESS.get(name, (_MODELS, _EPISODES))
    sizes, cells = ERROR_SIZES[-1:] if name in LESS else ERROR_SIZES, cells_of(speed_range, episodes or usual)
    known, true = cells[0].scenario.vehicle, SideBySide(cells)
    zero, one = (_recorded(policy, speed_range, cells) for policy in load_suite(_SUITE).anchors)
    right, failed = _steady_rmses(name, known, true, speed_range)

    def compared(way: _Way, size: float) -> dict[str, Any]:
        each, gone = [], []
        for vehicle in (wrong(known, mistakes(k), size, way) for k in range(models)):
            steady_rmses, own = _steady_rmses(name, vehicle, true, speed_range)
            each.append(steady_rmses)
            gone.append(own)
        rows = [np.array(own) for own in zip(*each, strict=True)]
        return {"size": size, "failed": gone, **_compared(zero, right, rows, one)}

    return {
        "episodes": len(cells[0].episodes),
        "cases": [cell.scenario.name.removeprefix(f"{speed_range}-") for cell in cells],
        "right": {
            "score": _ends(seeds_score(zero, [row[None] for row in right], one)),
            "failed": failed,
            "error_m": [round(float(row.mean()), 6) for row in right],
            "first_m": [np.round(row[:KEPT_EPISODES], 6).tolist() for row in right],
        },
        "wrong": {key: [compared(way, size) for size in sizes] for key, way in WAYS.items()},
    }


def _recorded(policy: str, speed_range: str, cells: Sequence[Cell]) -> list[Array]:
    """Return the recorded capped errors [m] of a policy in episodes of the suite, cell by cell."""
    runs = {run.scenario.name: run.measures for run in recorded.read_recorded(load_suite(_SUITE), policy)}
    rows = ((runs[cell.scenario.name], len(cell.episodes)) for cell in cells)
    return [capped(row[:count], ERROR_CAPS[speed_range]) for row, count in rows if row is not None]


def _steady_rmses(name: str, model: Vehicle, there: SideBySide, speed_range: str) -> tuple[list[Array], int]:
    """Return the capped errors [m] of a policy with a vehicle model, cell by cell, and the number of failures."""
    cap = ERROR_CAPS[speed_range]
    with warnings.catch_warnings():  # that its law may be unstable for such a model is a part of the price
        warnings.simplefilter("ignore", StabilityWarning)
        ended = there.run(acting(name, model))
    return [capped(e, cap) for e in ended], sum(count_failures(e, cap) for e in ended)


def _compared(zero: Sequence[Array], right: Sequence[Array], each: Sequence[Array], one: Sequence[Array]) -> Any:
    """Compare the errors with wrong models, shape (models, M) in each cell, to those with the true one."""
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


def acting(name: str, vehicle: Vehicle) -> Policy:
    """Return a policy by name that is given a vehicle model; the network of an agent computes in single precision.

    Raises:
        OSError: an agent cannot be read.
        ValueError: there is no such policy.
    """
    if (folder := agent_folder(name)) is None:
        return make_policy(name, vehicle)
    return made_for(vehicle, lambda known: Agent.load(folder).policy(vehicle=known, precision=_PRECISION))


@dataclass(frozen=True)
class Options:
    """Measure the sensitivity of policies to model error; a file for each policy.

    All of it takes about ten minutes of one core. Exit status: 0 done, 1 a policy failed, 2 wrong usage.
    """

    policy: Annotated[tuple[str, ...], arg(metavar="P [P ...]", help_behavior_hint="")] = _POLICIES
    """Policies by name, or agents by their folder."""
    speed_range: Annotated[tuple[str, ...], arg(metavar="R [R ...]", help_behavior_hint="")] = SPEED_RANGES
    """Speed ranges: slow, cruise."""
    episodes: Annotated[int | None, arg(metavar="INT", help_behavior_hint="")] = None
    """Episodes of each case. Default: 12, of nmpc 6."""
    out: Path = MODEL_ERROR_FOLDER
    """Folder for the files. Results of other policies are left in it."""


def main(arguments: Sequence[str]) -> int:
    """Measure as the arguments say and return the exit status.

    Raises:
        UsageError: the arguments do not make sense.
    """
    options = parse(Options, arguments, PROGRAM)
    check_words("policy", [name for name in options.policy if agent_folder(name) is None], list_policies())
    check_words("speed range", options.speed_range, SPEED_RANGES)
    if privileged := [name for name in options.policy if name in FORESIGHTED]:
        raise UsageError(f"{privileged[0]} uses more than the observation, so no model of it is wrong; leave it out")
    if options.episodes is not None and options.episodes < 2:
        raise UsageError(f"--episodes is {options.episodes}; it must be 2 or more, since intervals are over episodes")
    options.out.mkdir(parents=True, exist_ok=True)
    for name in options.policy:
        file = options.out / f"{Path(name).name}.json"
        record = read_json(file) if file.exists() else {}
        try:
            record |= {
                speed_range: with_wrong_models(name, speed_range, options.episodes)
                for speed_range in options.speed_range
            }
        except (ValueError, PolicyError) as error:
            print(f"{called(PROGRAM)}: {name}: {error}", file=sys.stderr)
            return FAILED
        write_atomically(file, json_text(record))
        print(file, flush=True)
    return DONE


def context(_: str = "", folder: Path = MODEL_ERROR_FOLDER) -> dict[str, Any]:
    """Return what the page shows of the records in a folder.

    Raises:
        ValueError: a file is damaged.
    """
    found = {file.stem: read_json(file) for file in folder.glob("*.json")}
    own = dict(sorted(found.items(), key=lambda item: (item[0] == EXPERT, item[0] == RIVAL, item[0])))
    places = [(speed_range, key) for speed_range in SPEED_RANGES for key in WAYS]
    return {
        "records": {
            speed_range: [
                row for name, record in own.items() if speed_range in record for row in _rows(name, record[speed_range])
            ]
            for speed_range in SPEED_RANGES
        },
        "sizes": [f"up to {100 * size:.0f} %" for size in ERROR_SIZES],
        "largest": f"{100 * ERROR_SIZES[-1]:.0f} %",
        "columns": [f"{speed_range}: {WAYS[key].says}" for speed_range, key in places],
        "summary": [[f"`{name}`", *(_at_most(record, *place) for place in places)] for name, record in own.items()],
    }


def _at_most(record: Mapping[str, Any], speed_range: str, key: str) -> str:
    """Return the mean change of the score with the largest errors."""
    if speed_range not in record:
        return "-"
    return f"{max(record[speed_range]['wrong'][key], key=lambda at: float(at['size']))['above'][0]:+.3f}"


def _rows(name: str, of: Mapping[str, Any]) -> Iterator[list[str]]:
    """Yield a row for each way in which a policy was given wrong vehicle models."""
    right = of["right"]
    for key, way in WAYS.items():
        sizes = {float(at["size"]): at for at in of["wrong"][key]}
        last, episodes = sizes[max(sizes)], of["episodes"] * len(of["cases"])
        worse = [after - before for before, after in zip(right["error_m"], last["error_m"], strict=True)]
        i = worse.index(max(worse))
        growth = f"{of['cases'][i]}, {1e3 * right['error_m'][i]:.1f} -> {1e3 * last['error_m'][i]:.1f} mm"
        less = [f"{sizes[size]['above'][0]:+.3f}" if size in sizes else "-" for size in ERROR_SIZES[:-1]]
        above = [*less, _spread(last["above"])]
        failed = f"{sum(last['failed'])} of {len(last['failed']) * episodes}; {right['failed']} of {episodes}"
        yield [f"`{name}`", f"{right['score'][0]:.3f}", way.says, *above, f"{min(last['hulls']):+.3f}", growth, failed]


def _spread(ends: Sequence[float]) -> str:
    """Return a difference with its interval, as `-0.013 [-0.028, 0.006]`."""
    return "{:+.3f} [{:+.3f}, {:+.3f}]".format(*ends)

"""Measure the sensitivity to model error: `python -m research model-error --help`.

The study measures the loss of score on frozen episodes if a policy is given a wrong vehicle model. True vehicles and
plans are unchanged. Each parameter of the given model has its own error. Mass and inertia also define the units of a
policy (`auv_gym.physics.units`), so they are wrong in only one of the two sets of parameters. The page is
docs/sensitivity.md.
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
    FULL_INFORMATION,
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
from baselines.scaling import scaled_for
from baselines.tools.command_line import DONE, FAILED, UsageError, called, check_words, checked_folder, parse
from baselines.tools.files import json_text, read_json, write_atomically
from research import DATA
from research.seeds import SENSITIVITY

PROGRAM = "python -m research model-error"
_PRECISION = "float32"  # precision of the networks: a fifth of the time, and a difference of errors of 1e-6
MODEL_ERROR_FOLDER = DATA / "model_error"
_POLICIES = ("helm-any", "helm", "ekf", "backstepping", "nmpc")
"""Policies by default."""
_SUITE = "benchmark-v1"
"""Suite of the episodes and of the anchors of the score."""
ERROR_SIZES = (0.2, 0.4, 0.6)
"""Largest relative errors of a parameter; errors are uniform between plus and minus the largest one."""
_MODELS = 12
"""Number of wrong models of each size, the same ones for all policies."""

_PARAMETERS = ("m11", "m22", "m33", "d11", "d22", "d33")
"""Parameters of the vehicle that may be wrong."""


class _ParameterSet(NamedTuple):
    """Parameters of a vehicle model that are wrong together."""

    names: tuple[str, ...]
    label: str


PARAMETER_SETS: Mapping[str, _ParameterSet] = {
    "ratios": _ParameterSet(("m22", "d11", "d22", "d33"), "m22, drag"),
    "all": _ParameterSet(_PARAMETERS, "m22, drag, m11, m33"),
}
"""Sets of wrong parameters, by name."""


def model_errors(number: int) -> dict[str, float]:
    """Return the errors of the parameters of wrong model `number`, in -1 ... 1 as shares of the largest error.

    They are drawn again until the vehicle is valid with each set of parameters.
    """
    rng = np.random.default_rng([SENSITIVITY.first + number, 5])
    while True:
        drawn = {name: float(rng.uniform(-1.0, 1.0)) for name in _PARAMETERS}
        with suppress(ValueError):  # no slender vehicle
            for wrong in PARAMETER_SETS.values():
                wrong_model(PAPER_VEHICLE, drawn, ERROR_SIZES[-1], wrong)
            return drawn


def wrong_model(vehicle: Vehicle, errors: Mapping[str, float], size: float, wrong: _ParameterSet) -> Vehicle:
    """Return the wrong model of a vehicle.

    Args:
        vehicle: the true vehicle.
        errors: errors of the parameters, see `model_errors`.
        size: largest relative error.
        wrong: the parameters that are wrong.

    Raises:
        ValueError: the result is no valid vehicle.
    """
    return replace(vehicle, **{name: (1 + size * errors[name]) * getattr(vehicle, name) for name in wrong.names})


def cells_of(speed_range: str, episodes: int) -> list[Cell]:
    """Return the first episodes of each cell of a speed range in the suite."""
    return [Cell(cell.scenario, cell.episodes[:episodes]) for cell in load_suite(_SUITE).cells_in((speed_range,))]


def with_wrong_models(name: str, speed_range: str, episodes: int) -> dict[str, Any]:
    """Return the results of a policy with the true and with wrong vehicle models, as JSON values.

    Args:
        name: name of the policy, which must use the observation only.
        speed_range: "slow" or "cruise".
        episodes: number of episodes of each case.

    Raises:
        ValueError: there is no such policy.
        PolicyError: its actions are not finite.
    """
    cells = cells_of(speed_range, episodes)
    vehicle, batch = cells[0].scenario.vehicle, SideBySide(cells)
    zero, one = (_recorded(policy, speed_range, cells) for policy in load_suite(_SUITE).anchors)
    right, failed = _steady_rmses(name, vehicle, batch, speed_range)

    def compared(wrong: _ParameterSet, size: float) -> dict[str, Any]:
        wrong_models = (wrong_model(vehicle, model_errors(k), size, wrong) for k in range(_MODELS))
        results = [_steady_rmses(name, model, batch, speed_range) for model in wrong_models]
        rows = [np.array(own) for own in zip(*(steady_rmses for steady_rmses, _ in results), strict=True)]
        return {"size": size, "failed": [own for _, own in results], **_compared(zero, right, rows, one)}

    return {
        "episodes": len(cells[0].episodes),
        "cases": [cell.scenario.name.removeprefix(f"{speed_range}-") for cell in cells],
        "right": {
            "score": _ends(seeds_score(zero, [row[None] for row in right], one)),
            "failed": failed,
            "error_m": [round(float(row.mean()), 6) for row in right],
        },
        "wrong": {key: [compared(wrong, size) for size in ERROR_SIZES] for key, wrong in PARAMETER_SETS.items()},
    }


def _recorded(policy: str, speed_range: str, cells: Sequence[Cell]) -> list[Array]:
    """Return the recorded capped errors [m] of a policy in episodes of the suite, cell by cell."""
    runs = {run.scenario.name: run.measures for run in recorded.read_recorded(load_suite(_SUITE), policy)}
    rows = ((runs[cell.scenario.name], len(cell.episodes)) for cell in cells)
    return [capped(row[:count], ERROR_CAPS[speed_range]) for row, count in rows if row is not None]


def _steady_rmses(name: str, model: Vehicle, batch: SideBySide, speed_range: str) -> tuple[list[Array], int]:
    """Return the capped errors [m] of a policy with a vehicle model, cell by cell, and the number of failures."""
    cap = ERROR_CAPS[speed_range]
    with warnings.catch_warnings():  # an unstable law with a wrong model is a part of the result
        warnings.simplefilter("ignore", StabilityWarning)
        ended = batch.run(policy_with(name, model))
    return [capped(e, cap) for e in ended], sum(count_failures(e, cap) for e in ended)


def _compared(zero: Sequence[Array], right: Sequence[Array], each: Sequence[Array], one: Sequence[Array]) -> Any:
    """Return the comparison of the errors with wrong models, shape (models, M) by cell, to those with the true one."""
    above = partial(lead, zero, right, one=one)
    return {
        "above": _ends(above(each)),
        "vehicles": [round(above([rows[[k]] for rows in each]).mean, 5) for k in range(len(each[0]))],
        "error_m": [round(float(rows.mean()), 6) for rows in each],
    }


def _ends(value: Score) -> list[float]:
    return [round(float(x), 5) for x in (value.mean, *value.ci95)]


def policy_with(name: str, vehicle: Vehicle) -> Policy:
    """Return a policy by name with a given vehicle model; the network of an agent computes in single precision.

    Raises:
        OSError: an agent cannot be read.
        ValueError: there is no such policy.
    """
    if (folder := agent_folder(name)) is None:
        return make_policy(name, vehicle)
    return scaled_for(vehicle, lambda known: Agent.load(folder).policy(vehicle=known, precision=_PRECISION))


@dataclass(frozen=True)
class Options:
    """Measure the sensitivity of policies to model error and write a file for each policy.

    It takes about twenty minutes on one core. Exit status: 0 done, 1 a policy failed, 2 wrong usage.
    """

    policy: Annotated[tuple[str, ...], arg(metavar="P [P ...]", help_behavior_hint="")] = _POLICIES
    """Policies by name, or agents by their folder."""
    speed_range: Annotated[tuple[str, ...], arg(metavar="R [R ...]", help_behavior_hint="")] = SPEED_RANGES
    """Speed ranges: slow, cruise."""
    episodes: int = 12
    """Number of episodes of each case, the first ones of the suite."""
    out: Path = MODEL_ERROR_FOLDER
    """Folder for the files. Files of other policies are kept."""


def main(arguments: Sequence[str]) -> int:
    """Measure policies, write their files, and return the exit status.

    Raises:
        UsageError: the arguments are invalid.
    """
    options = parse(Options, arguments, PROGRAM)
    check_words("policy", [name for name in options.policy if agent_folder(name) is None], list_policies())
    check_words("speed range", options.speed_range, SPEED_RANGES)
    if privileged := [name for name in options.policy if name in FULL_INFORMATION]:
        raise UsageError(f"{privileged[0]} uses more than the observation, so it has no wrong model; leave it out")
    if options.episodes < 2:
        raise UsageError(f"--episodes is {options.episodes}; it must be 2 or more, since intervals are over episodes")
    checked_folder(options.out)
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
    """Return the values of the page's template from the records in a folder.

    Raises:
        ValueError: a file is damaged.
    """
    found = {file.stem: read_json(file) for file in folder.glob("*.json")}
    own = dict(sorted(found.items(), key=lambda item: (item[0] == EXPERT, item[0] == RIVAL, item[0])))
    places = [(speed_range, key) for speed_range in SPEED_RANGES for key in PARAMETER_SETS]
    return {
        "records": {
            speed_range: [
                row for name, record in own.items() if speed_range in record for row in _rows(name, record[speed_range])
            ]
            for speed_range in SPEED_RANGES
        },
        "sizes": [f"up to {100 * size:.0f} %" for size in ERROR_SIZES],
        "largest": f"{100 * ERROR_SIZES[-1]:.0f} %",
        "columns": [f"{speed_range}: {PARAMETER_SETS[key].label}" for speed_range, key in places],
        "summary": [[f"`{name}`", *(_at_most(record, *place) for place in places)] for name, record in own.items()],
    }


def _at_most(record: Mapping[str, Any], speed_range: str, key: str) -> str:
    """Return the mean change of the score with the largest errors."""
    if speed_range not in record:
        return "-"
    return f"{max(record[speed_range]['wrong'][key], key=lambda at: float(at['size']))['above'][0]:+.3f}"


def _rows(name: str, of: Mapping[str, Any]) -> Iterator[list[str]]:
    """Yield a row for each set of wrong parameters."""
    right = of["right"]
    for key, wrong in PARAMETER_SETS.items():
        sizes = {float(at["size"]): at for at in of["wrong"][key]}
        last, episodes = sizes[max(sizes)], of["episodes"] * len(of["cases"])
        worse = [after - before for before, after in zip(right["error_m"], last["error_m"], strict=True)]
        i = worse.index(max(worse))
        growth = f"{of['cases'][i]}, {1e3 * right['error_m'][i]:.1f} -> {1e3 * last['error_m'][i]:.1f} mm"
        less = [f"{sizes[size]['above'][0]:+.3f}" for size in ERROR_SIZES[:-1]]
        above = [*less, _spread(last["above"])]
        failed = f"{sum(last['failed'])} of {len(last['failed']) * episodes}; {right['failed']} of {episodes}"
        yield [
            f"`{name}`",
            f"{right['score'][0]:.3f}",
            wrong.label,
            *above,
            f"{min(last['vehicles']):+.3f}",
            growth,
            failed,
        ]


def _spread(ends: Sequence[float]) -> str:
    """Return a difference with its interval, as `-0.013 [-0.028, 0.006]`."""
    return "{:+.3f} [{:+.3f}, {:+.3f}]".format(*ends)

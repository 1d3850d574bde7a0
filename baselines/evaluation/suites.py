"""Frozen suites: files of fixed episodes, so that results from different places and times are comparable.

The file suites/NAME.json.bz2 of a folder of data has the parameters of every episode and the seed of its noise. It is
made once, by `python -m research suites build NAME`. SHA256SUMS beside it has the hash of its text; a file with another
hash is refused. The file also has a digest: some values of the reference and of the exogenous inputs of each episode.
It shows if the planner or a random stream has changed. Loading a suite compares a sample of these values, and
`python -m research suites check NAME` compares all.
"""

from __future__ import annotations

import bz2
import hashlib
import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from auv_gym.effects.current import Current
from auv_gym.effects.faults import Fault
from auv_gym.effects.waves import SpaceWaves, Waves
from auv_gym.physics.namespaces import ARRAYS, Array
from auv_gym.physics.space import SpaceVehicle
from auv_gym.physics.vehicle import Vehicle
from auv_gym.scenarios.episode import Episode
from auv_gym.scenarios.records import from_record, guarded, meant, to_record
from auv_gym.scenarios.scenario import Scenario, path_from, path_record
from auv_gym.task.simulation import measurement_errors
from baselines.control.privileged.truth import Truth
from baselines.evaluation.cells import Cell
from baselines.evaluation.score import speed_range_of
from baselines.tools.files import data_files

FOLDER = "suites"  # name of the folders of the files
SUMS = "SHA256SUMS"  # file of the hashes
SUITE_FORMAT = 1  # version of the file format


class SuiteError(ValueError):
    """A suite's file is missing, damaged or changed, or its episodes generate other values than when it was made."""


@dataclass(frozen=True)
class Suite:
    """A frozen suite with its cells in the order of the file."""

    name: str
    hash: str  # SHA-256 of its text
    cells: tuple[Cell, ...]
    digests: tuple[Array, ...]  # of each cell's episodes, shape (episodes, 8)

    def cells_in(self, speed_ranges: Collection[str | None]) -> list[Cell]:
        """Return the cells of some speed ranges, in the order of the suite."""
        return [cell for cell in self.cells if speed_range_of(cell.scenario.name) in speed_ranges]


def list_suites() -> list[str]:
    """Return the names of the frozen suites."""
    return sorted(_suites())


def _suites() -> dict[str, tuple[Path, str]]:
    """Return the file and the hash of each suite, by name."""
    return {
        name: (sums.with_name(f"{name}.json.bz2"), text_hash)
        for sums in data_files(f"{FOLDER}/{SUMS}")
        for text_hash, name in map(str.split, sums.read_text(encoding="ascii").splitlines())
    }


def load_suite(name: str) -> Suite:
    """Return a suite after checking its hash and a sample of its episodes.

    Raises:
        SuiteError: there is no such suite, its file has been changed, or the sample differs.
    """
    known = _suites()
    if name not in known:
        raise SuiteError(f"unknown suite {name!r}{meant(name, known)}; allowed are {', '.join(sorted(known))}")
    return _loaded(name, *known[name])


@cache
def _loaded(name: str, file: Path, text_hash: str) -> Suite:
    try:
        with guarded(str(file)):
            text = bz2.decompress(file.read_bytes())
            if (now := hashlib.sha256(text).hexdigest()) != text_hash:
                raise ValueError(f"the file has been changed: its SHA-256 is {now}, that of the suite {text_hash}")
            suite = _parsed(json.loads(text), text_hash)
            for cell, recorded in zip(suite.cells, suite.digests, strict=True):
                check_cell(Cell(cell.scenario, cell.episodes[:1]), recorded[:1])
            return suite
    except (OSError, ValueError) as error:
        raise SuiteError(f"cannot use suite {name}: {error}") from error


def save_suite(name: str, cells: Sequence[Cell], folder: Path) -> str:
    """Write a suite and its hash to a folder, and return the hash."""
    record: dict[str, Any] = {
        "suite": name,
        "format": SUITE_FORMAT,
        "cells": [
            {
                "scenario": cell.scenario.to_dict(),
                "episodes": [_episode_record(episode, cell.scenario) for episode in cell.episodes],
                "digests": [[_rounded(float(value)) for value in row] for row in cell_digest(cell)],
            }
            for cell in cells
        ],
    }
    text = json.dumps(record, sort_keys=True, separators=(",", ":"), allow_nan=False).encode()
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{name}.json.bz2").write_bytes(bz2.compress(text))
    sums, text_hash = folder / SUMS, hashlib.sha256(text).hexdigest()
    others = [line for line in sums.read_text("ascii").splitlines() if line.split()[1] != name] if sums.exists() else []
    sums.write_text(
        "\n".join(sorted((*others, f"{text_hash}  {name}"), key=lambda line: line.split()[1])) + "\n", "ascii"
    )
    return text_hash


def rounded(cell: Cell) -> Cell:
    """Return a cell as it is in a file, with all numbers of its episodes rounded to 6 significant digits."""
    records = [_episode_record(episode, cell.scenario) for episode in cell.episodes]
    return replace(cell, episodes=tuple(_episode(record, cell.scenario) for record in records))


def cell_digest(cell: Cell) -> Array:
    """Return some values that each episode generates, shape (episodes, 8).

    They are x, y, F_u, F_r of the reference at the end of the episode, and V_x, the sway force of the waves and the
    measurement errors of x and r after a third of it.
    """
    truth, model = Truth.of(cell.scenario, cell.episodes), cell.scenario.parts.model
    end, third = truth.samples[-1], truth.samples[cell.scenario.steps // 3]
    n_x, *_, n_r = measurement_errors(tuple(third), truth.parameters, ARRAYS)
    of_end = [0, 1, len(model.state), model.reference.stop - 1]
    return np.stack((*end[of_end], *third[[model.current_rows.start, model.load_rows.start + 1]], n_x, n_r), axis=1)


def check_cell(cell: Cell, recorded: Array) -> None:
    """Compare the digest of a cell with the recorded one, shape (episodes, 8).

    Raises:
        SuiteError: they differ by more than 1e-4 of the value plus 1e-5.
    """
    now = cell_digest(cell)
    differs = ~np.isclose(now, recorded, rtol=1e-4, atol=1e-5).all(axis=1)
    if differs.any():
        i = int(np.argmax(differs))
        raise SuiteError(
            f"{differs.sum()} of {len(cell.episodes)} episodes of {cell.scenario.name} generate other values than when "
            f"the suite was made; the first is episode {i}: {now[i].round(6).tolist()} "
            f"instead of {recorded[i].tolist()}; the planner or a random stream has changed"
        )


def _rounded(value: Any) -> Any:
    """Return a value in which all floats, also those in lists and dicts, are rounded to 6 significant digits."""
    if isinstance(value, float):
        return float(f"{value:.6g}")
    if isinstance(value, Mapping):
        return {key: _rounded(entry) for key, entry in value.items()}
    return [_rounded(entry) for entry in value] if isinstance(value, (list, tuple)) else value


def _episode_record(episode: Episode, scenario: Scenario) -> dict[str, Any]:
    """Return an episode as a plain dict, without the values that follow from its scenario."""
    record = to_record(episode) | {"path": path_record(episode.path)}
    if episode.vehicle == scenario.vehicle:
        del record["vehicle"]
    return {key: value for key, value in _rounded(record).items() if key not in _DEFAULTS or value != _DEFAULTS[key]}


_DEFAULTS: dict[str, Any] = {"current": {}, "waves": None, "bias": [0.0] * 6, "lag": 0.0}
"""Values of an episode without disturbances, which its record leaves out."""


def _episode(record: Mapping[str, Any], scenario: Scenario) -> Episode:
    values: dict[str, Any] = {**_DEFAULTS, **record}
    if "vehicle" not in record:
        values["vehicle"] = scenario.vehicle
    vehicle: Any = SpaceVehicle if scenario.vertical else Vehicle
    waves: Any = SpaceWaves if scenario.vertical else Waves
    special = {
        "path": path_from,
        "vehicle": lambda value: value if isinstance(value, vehicle) else from_record(vehicle, value, "vehicle"),
        "current": lambda value: from_record(Current, value, "current"),
        "waves": lambda value: None if value is None else from_record(waves, value, "waves"),
        "faults": lambda value: tuple(Fault(kind, begin, end, tuple(jump)) for kind, begin, end, jump in value),
    }
    return from_record(Episode, values, "episode", special)


def _parsed(record: Mapping[str, Any], text_hash: str) -> Suite:
    cells, digests = [], []
    for entry in record["cells"]:
        scenario = Scenario.from_dict(entry["scenario"])
        cells.append(Cell(scenario, tuple(_episode(e, scenario) for e in entry["episodes"])))
        digests.append(np.array(entry["digests"], dtype=np.float64))
    return Suite(record["suite"], text_hash, tuple(cells), tuple(digests))

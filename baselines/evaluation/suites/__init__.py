"""Frozen suites: files of fixed episodes, so that scores from different places and times are comparable.

The file NAME.json.bz2 has the parameters of every episode and the seed of its noise. It is made once, by
`python -m research suites build NAME`. SHA256SUMS has the hash of its text; a file with another hash is refused. The
file also has a digest: some values of the reference and of the exogenous inputs of each episode. It shows if the
planner or a random stream has changed. Loading a suite compares a sample of these values, and
`python -m research suites check NAME` compares all.

A suite has episodes and the anchors of its score. A suite that differs from another one in the anchors only refers to
the other suite by name and hash, instead of its own episodes. Results of a policy on one of them are valid for both.
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

from auv_gym.installation import checkout, found, left_out
from auv_gym.physics.disturbances import Current, Waves
from auv_gym.physics.faults import Fault
from auv_gym.physics.namespaces import Array
from auv_gym.physics.vehicle import Vehicle
from auv_gym.scenarios.episode import Episode
from auv_gym.scenarios.records import from_record, guarded, to_record
from auv_gym.scenarios.scenario import Scenario, path_from, path_record
from baselines.control.privileged.truth import samples
from baselines.evaluation.runner import Cell
from baselines.evaluation.score import BY_ORACLE, Anchors, speed_range_of
from baselines.tools.files import checked_plain

SUITES_FOLDER = Path(__file__).parent  # folder of the files
SUMS = "SHA256SUMS"  # file of the hashes
FORMAT = 1  # version of the file format
_LARGEST = 2**22  # [bytes] largest uncompressed size of a file


class SuiteError(ValueError):
    """A suite's file is missing, damaged or changed, or its episodes generate other values than when it was made."""


@dataclass(frozen=True)
class Suite:
    """A frozen suite with its cells in the order of the file."""

    name: str
    hash: str  # SHA-256 of its text
    cells: tuple[Cell, ...]
    digests: tuple[Array, ...]  # of each cell's episodes, shape (episodes, 8)
    anchors: Anchors = BY_ORACLE  # of the score
    same_as: tuple[str, str] | None = None  # name and hash of the suite with the same episodes; None: its own episodes

    @property
    def source(self) -> tuple[str, str]:
        """Name and hash of the suite with the episodes, which are also those of recorded rows."""
        return self.same_as or (self.name, self.hash)

    def cells_in(self, speed_ranges: Collection[str | None]) -> list[Cell]:
        """Return the cells of some speed ranges, in the order of the suite."""
        return [cell for cell in self.cells if speed_range_of(cell.scenario.name) in speed_ranges]


def list_suites() -> list[str]:
    """Return the names of the frozen suites."""
    return sorted(_sums(SUITES_FOLDER))


def _sums(folder: Path) -> dict[str, str]:
    """Return the hash of each suite, by name."""
    try:
        lines = (folder / SUMS).read_text(encoding="ascii").splitlines()
    except FileNotFoundError:
        return {}
    return {name.removesuffix(".json"): digest for digest, name in (line.split() for line in lines)}


def load_suite(name: str, folder: Path = SUITES_FOLDER) -> Suite:
    """Return a suite after checking its hash and a sample of its episodes.

    Raises:
        SuiteError: there is no such suite, its file has been changed, or the sample differs.
    """
    return _loaded(name, folder)


@cache
def _loaded(name: str, folder: Path) -> Suite:
    sums = _sums(folder)
    if name not in sums:
        raise SuiteError(f"unknown suite {name!r}; allowed are {', '.join(sorted(sums))}")
    file = found(folder, f"{name}.json.bz2")
    if not file.exists() and checkout() is None:
        raise SuiteError(left_out(f"the episodes of {name} are"))
    try:
        with bz2.open(file) as stream:
            text = stream.read(_LARGEST + 1)
    except (OSError, EOFError, ValueError) as error:
        raise SuiteError(f"cannot read {file}: {error}") from error
    if len(text) > _LARGEST:
        raise SuiteError(f"{file} is larger than {_LARGEST} bytes unpacked")
    digest = hashlib.sha256(text).hexdigest()
    if digest != sums[name]:
        raise SuiteError(f"{file} has been changed: its SHA-256 is {digest}, that of the suite {sums[name]}")
    try:
        with guarded(str(file)):
            record = checked_plain(json.loads(text))
            if "episodes_of" in record:
                return _shared(record, digest, folder)
            suite = _parsed(record, digest)
            for cell, recorded in zip(suite.cells, suite.digests, strict=True):
                check_cell(Cell(cell.scenario, cell.episodes[:1]), recorded[:1])
            return suite
    except ValueError as error:
        raise SuiteError(str(error)) from error


def save_suite(name: str, cells: Sequence[Cell], folder: Path = SUITES_FOLDER, anchors: Anchors = BY_ORACLE) -> str:
    """Write a suite and its hash, and return the hash."""
    record: dict[str, Any] = {
        "suite": name,
        "format": FORMAT,
        "cells": [
            {
                "scenario": cell.scenario.to_dict(),
                "episodes": [_episode_record(episode, cell.scenario) for episode in cell.episodes],
                "digests": [[_rounded(float(value)) for value in row] for row in digest(cell)],
            }
            for cell in cells
        ],
    }
    if anchors != BY_ORACLE:  # the files of the oldest suites have no anchors
        record["anchors"] = anchors._asdict()
    return _written(name, record, folder)


def save_shared(name: str, episodes_of: str, anchors: Anchors, folder: Path = SUITES_FOLDER) -> str:
    """Write a suite with the episodes of another one and its own anchors, and its hash, and return the hash.

    Raises:
        SuiteError: the other suite cannot be read.
    """
    source = {"suite": episodes_of, "hash": load_suite(episodes_of, folder).hash}
    record = {"suite": name, "format": FORMAT, "episodes_of": source, "anchors": anchors._asdict()}
    return _written(name, record, folder)


def _written(name: str, record: Mapping[str, Any], folder: Path) -> str:
    text = json.dumps(record, sort_keys=True, separators=(",", ":"), allow_nan=False).encode()
    (folder / f"{name}.json.bz2").write_bytes(bz2.compress(text))
    sums = _sums(folder) | {name: hashlib.sha256(text).hexdigest()}
    lines = "".join(f"{sums[key]}  {key}.json\n" for key in sorted(sums))
    (folder / SUMS).write_text(lines, encoding="ascii")
    return sums[name]


def rounded(cell: Cell) -> Cell:
    """Return a cell as it is in a file, with all numbers of its episodes rounded to 6 significant digits."""
    records = [_episode_record(episode, cell.scenario) for episode in cell.episodes]
    return replace(cell, episodes=tuple(_episode(record, cell.scenario) for record in records))


def digest(cell: Cell) -> Array:
    """Return some values that each episode generates, shape (episodes, 8).

    They are x, y, F_u, F_r of the reference at the end of the episode, and V_x, the sway force of the waves and the
    measurement errors of x and r after a third of it.
    """
    rows = samples(cell.scenario, cell.episodes)
    end, third = rows[-1], rows[cell.scenario.steps // 3]
    return np.stack((*end[[0, 1, 6, 7]], *third[[8, 11, 13, 18]]), axis=1)


def check_cell(cell: Cell, recorded: Array) -> None:
    """Compare the digest of a cell with the recorded one, shape (episodes, 8).

    Raises:
        SuiteError: they differ by more than 1e-4 of the value plus 1e-5.
    """
    now = digest(cell)
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
    special = {
        "path": path_from,
        "vehicle": lambda value: value if isinstance(value, Vehicle) else from_record(Vehicle, value, "vehicle"),
        "current": lambda value: from_record(Current, value, "current"),
        "waves": lambda value: None if value is None else from_record(Waves, value, "waves"),
        "faults": lambda value: tuple(Fault(kind, begin, end, tuple(jump)) for kind, begin, end, jump in value),
    }
    return from_record(Episode, values, "episode", special)


def _shared(record: Mapping[str, Any], text_hash: str, folder: Path) -> Suite:
    """Return a suite with the episodes of another one."""
    source = load_suite(record["episodes_of"]["suite"], folder)
    if source.hash != record["episodes_of"]["hash"]:
        raise SuiteError(f"{record['suite']} refers to another {source.name}; this one has the hash {source.hash[:12]}")
    anchors = Anchors(**record["anchors"])
    return replace(source, name=record["suite"], hash=text_hash, anchors=anchors, same_as=source.source)


def _parsed(record: Mapping[str, Any], text_hash: str) -> Suite:
    cells, digests = [], []
    for entry in record["cells"]:
        scenario = Scenario.from_dict(entry["scenario"])
        cells.append(Cell(scenario, tuple(_episode(e, scenario) for e in entry["episodes"])))
        digests.append(np.array(entry["digests"], dtype=np.float64))
    anchors = Anchors(**record["anchors"]) if "anchors" in record else BY_ORACLE
    return Suite(record["suite"], text_hash, tuple(cells), tuple(digests), anchors)

"""Frozen suites: a score means the same wherever and whenever it was measured.

A file NAME.json.bz2 holds every episode's parameters and the seed of its noise. It is made once, by
`python -m research suites build NAME`; SHA256SUMS has the hash of its text, and a file with another one is
refused. It also holds a digest of what its episodes generate, some values of each reference and tape, so that a planner
or a random stream that has changed is noticed: a sample is compared on every load, all of it by
`python -m research suites check NAME`.

A suite is episodes and the anchors of its score. One with other anchors for known episodes names their suite, with its
hash, in place of them: what a policy did in one counts in both.
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
from auv_gym.physics.namespaces import Array
from auv_gym.physics.vehicle import Vehicle
from auv_gym.planning.paths import PATHS
from auv_gym.scenarios.episode import Episode
from auv_gym.scenarios.records import from_record, guarded, to_record
from auv_gym.scenarios.scenario import Scenario
from baselines.control.privileged.truth import samples
from baselines.evaluation.runner import Cell
from baselines.evaluation.score import BY_ORACLE, Anchors, speed_range_of
from baselines.tools.files import checked_plain

SUITES_FOLDER = Path(__file__).parent  # of the files of the suites
SUMS = "SHA256SUMS"  # file of the suites' hashes
FORMAT = 1  # version of the files' layout
_LARGEST = 2**22  # [bytes] that a file unpacks to


class SuiteError(ValueError):
    """A suite's file is missing, damaged or changed, or its episodes are no longer what they were."""


@dataclass(frozen=True)
class Suite:
    """A frozen suite: cells in the order of its file."""

    name: str
    hash: str  # SHA-256 of its text
    cells: tuple[Cell, ...]
    digests: tuple[Array, ...]  # of each cell's episodes, shape (episodes, 8)
    anchors: Anchors = BY_ORACLE  # of the score
    same_as: tuple[str, str] | None = None  # name and hash of the suite whose episodes these are; None: its own

    @property
    def source(self) -> tuple[str, str]:
        """Name and hash of the suite whose episodes these are, under which rows of them are kept."""
        return self.same_as or (self.name, self.hash)

    def cells_in(self, speed_ranges: Collection[str | None]) -> list[Cell]:
        """Return the cells of some regimes, in the order of the suite."""
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
    """Return a suite once its hash is right and a sample of its episodes is what it was.

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
    """Write a suite and its hash, which is returned."""
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
    if anchors != BY_ORACLE:  # the oldest suites do not say theirs
        record["anchors"] = anchors._asdict()
    return _written(name, record, folder)


def save_shared(name: str, episodes_of: str, anchors: Anchors, folder: Path = SUITES_FOLDER) -> str:
    """Write a suite that has the episodes of another one and anchors of its own, and its hash, which is returned.

    Raises:
        SuiteError: the other one cannot be read.
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
    """Return the cell as its file will have it, every number of an episode rounded to 6 digits."""
    records = [_episode_record(episode, cell.scenario) for episode in cell.episodes]
    return replace(cell, episodes=tuple(_episode(record, cell.scenario) for record in records))


def digest(cell: Cell) -> Array:
    """Return some values of what each episode generates, shape (episodes, 8).

    They are the reference's x, y, F_u, F_r at the end; V_x, the waves' sway force, the errors of x and r on the way.
    """
    rows = samples(cell.scenario, cell.episodes)
    end, way = rows[-1], rows[cell.scenario.steps // 3]
    return np.stack((*end[[0, 1, 6, 7]], *way[[8, 11, 13, 18]]), axis=1)


def check_cell(cell: Cell, recorded: Array) -> None:
    """Compare what a cell's episodes generate with what they did, shape (episodes, 8).

    Raises:
        SuiteError: they differ by more than 1e-4 of the value and 1e-5.
    """
    now = digest(cell)
    differs = ~np.isclose(now, recorded, rtol=1e-4, atol=1e-5).all(axis=1)
    if differs.any():
        i = int(np.argmax(differs))
        raise SuiteError(
            f"{differs.sum()} of {len(cell.episodes)} episodes of {cell.scenario.name} generate other values than when "
            f"the suite was made, the first is episode {i}: {now[i].round(6).tolist()} "
            f"instead of {recorded[i].tolist()}; the planner or a random stream has changed"
        )


def _rounded(value: Any) -> Any:
    """Return a value with its floats rounded to 6 significant digits, in lists and dicts too."""
    if isinstance(value, float):
        return float(f"{value:.6g}")
    if isinstance(value, Mapping):
        return {key: _rounded(entry) for key, entry in value.items()}
    return [_rounded(entry) for entry in value] if isinstance(value, (list, tuple)) else value


def _episode_record(episode: Episode, scenario: Scenario) -> dict[str, Any]:
    """Return an episode as a plain dict without what its scenario says already."""
    family = next(name for name, cls in PATHS.items() if type(episode.path) is cls)
    record = to_record(episode) | {"path": {"family": family, **to_record(episode.path)}}
    if episode.vehicle == scenario.vehicle:
        del record["vehicle"]
    return {key: value for key, value in _rounded(record).items() if key not in _NOTHING or value != _NOTHING[key]}


_NOTHING: dict[str, Any] = {"current": {}, "waves": None, "bias": [0.0] * 6, "lag": 0.0}
"""What an episode without a disturbance has: entries that its record leaves out."""


def _episode(record: Mapping[str, Any], scenario: Scenario) -> Episode:
    rest = dict(record["path"])
    path: Any = from_record(PATHS[rest.pop("family")], rest, "path")
    values: dict[str, Any] = {**_NOTHING, **record, "path": path}
    if "vehicle" not in record:
        values["vehicle"] = scenario.vehicle
    special = {
        "path": lambda value: value,
        "vehicle": lambda value: value if isinstance(value, Vehicle) else from_record(Vehicle, value, "vehicle"),
        "current": lambda value: from_record(Current, value, "current"),
        "waves": lambda value: None if value is None else from_record(Waves, value, "waves"),
    }
    return from_record(Episode, values, "episode", special)


def _shared(record: Mapping[str, Any], text_hash: str, folder: Path) -> Suite:
    """Return a suite that has the episodes of another one."""
    source = load_suite(record["episodes_of"]["suite"], folder)
    if source.hash != record["episodes_of"]["hash"]:
        raise SuiteError(f"{record['suite']} has the episodes of another {source.name}, of hash {source.hash[:12]}")
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

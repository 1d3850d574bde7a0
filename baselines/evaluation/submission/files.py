"""Submissions: results of a policy on a frozen suite, episode by episode, in one file that is checked when it is read.

The file is an .npz with a JSON record and four arrays, which have an entry for each episode in the order of the suite.
"""

from __future__ import annotations

import itertools
import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from datetime import date, datetime, timezone
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from baselines.evaluation.about import About, checked_about, checked_name
from baselines.evaluation.metrics import Measures
from baselines.evaluation.runner import Cell, Recorded, Run
from baselines.evaluation.score import speed_range_of
from baselines.evaluation.store import Stored, reading, write
from baselines.evaluation.suites import Suite, list_suites, load_suite
from baselines.tools.command_line import printable
from baselines.tools.files import checked_plain

_FORMAT = 1
"""Version of the file format."""
LARGEST_SUBMISSION = 200_000
"""Largest size of a file [bytes]."""
LARGEST_CONTENT = 20 * LARGEST_SUBMISSION
"""Largest uncompressed size [bytes]."""
SUBMITTED = ("steady_rmse", "effort", "smoothness", "failed")
"""The metrics of an episode in the file, fields of `Measures`."""
_TYPES = {key: np.dtype(bool if key == "failed" else np.float32) for key in SUBMITTED}
_MOST = {"steady_rmse": 1e6, "effort": 1.0, "smoothness": 4.0, "failed": True}  # largest possible value of a metric
_TEXTS = ("policy", "fingerprint", "date", "command", "versions")
KEYS = frozenset(("format", "name", "suite", "suite_hash", "about", "cells", "episodes", "decision_seconds", *_TEXTS))
"""Entries of the record."""


@dataclass(frozen=True)
class Submission:
    """Results of a policy in all cells of a frozen suite, or in all cells of some of its speed ranges."""

    name: str  # of the entry
    policy: str  # as on the command line
    fingerprint: str  # SHA-256 of the policy's files
    about: About
    versions: Mapping[str, str]
    date: str  # ISO 8601
    command: str  # command of the evaluation
    suite: Suite
    runs: tuple[Run, ...]  # cell by cell; metrics other than `SUBMITTED` are nan

    @property
    def episodes(self) -> int:
        """Number of episodes."""
        return sum(len(run.measures or ()) for run in self.runs)

    @property
    def stored(self) -> Stored:
        """Content of the file."""
        record = {key: getattr(self, key) for key in ("name", "policy", "fingerprint", "date", "command")}
        record |= {"format": _FORMAT, "suite": self.suite.name, "suite_hash": self.suite.hash}
        record |= {"about": asdict(self.about), "versions": dict(self.versions)}
        record |= {"cells": [run.scenario.name for run in self.runs]}
        record |= {"episodes": [len(run.measures or ()) for run in self.runs]}
        record |= {"decision_seconds": [run.decision_seconds for run in self.runs]}
        measures = Measures.joined([run.measures for run in self.runs if run.measures is not None])
        return Stored(record, {key: getattr(measures, key).astype(_TYPES[key]) for key in SUBMITTED})


def submission_of(
    suite: Suite, runs: Sequence[Run], name: str, about: About, versions: Mapping[str, str], command: str
) -> Submission:
    """Return the submission of a policy's runs.

    Args:
        suite: the suite.
        runs: the runs of one policy in whole cells, in any order.
        name: name of the entry.
        about: description of the entry.
        versions: versions of Python and the libraries.
        command: command of the evaluation.

    Raises:
        ValueError: a run failed or is missing, or name or description is invalid.
    """
    if failed := next((run for run in runs if run.measures is None), None):
        raise ValueError(f"{failed.policy} failed in {failed.scenario.name}: {failed.error}")
    order = [cell.scenario.name for cell in suite.cells]
    own = tuple(sorted(runs, key=lambda run: order.index(run.scenario.name)))
    when = own[0].recorded.date if own[0].recorded else datetime.now(timezone.utc).date().isoformat()
    made = Submission(name, own[0].policy, own[0].fingerprint, about, versions, when, command, suite, own)
    return _checked(made.stored)


def save_submission(submission: Submission, file: Path) -> int:
    """Write a submission and return the size of the file [bytes].

    Raises:
        OSError: the file cannot be written.
        ValueError: it would be larger than `LARGEST_SUBMISSION`.
    """
    write(file, submission.stored)
    if (size := file.stat().st_size) > LARGEST_SUBMISSION:
        file.unlink()
        raise ValueError(f"the submission would be {size} bytes long; allowed are {LARGEST_SUBMISSION}")
    return size


def read_submission(file: Path) -> Submission:
    """Return the submission of a file after checking all of it.

    Raises:
        OSError: it cannot be read.
        ValueError: it is too large or damaged, its suite does not exist, or its cells are not whole speed ranges.
    """
    with reading(file, LARGEST_SUBMISSION, LARGEST_CONTENT) as stored:
        return _checked(stored)


def _checked(stored: Stored) -> Submission:
    """Return the submission in the content of a file; raise ValueError if it is invalid."""
    record = checked_plain(dict(stored.record))
    if record.get("format") != _FORMAT or set(record) != KEYS:
        raise ValueError(f"its record must be of format {_FORMAT} with {', '.join(sorted(KEYS))}, and nothing else")
    if set(stored.arrays) != set(SUBMITTED):
        raise ValueError(f"its arrays are {', '.join(sorted(stored.arrays))}; they must be {', '.join(SUBMITTED)}")
    for key in ("policy", "command"):
        _text(record, key, r".{0,2000}")
    _text(record, "fingerprint", r"[0-9a-f]{64}")
    date.fromisoformat(_text(record, "date", r"\d{4}-\d\d-\d\d"))
    if not isinstance(record["versions"], dict) or len(json.dumps(record["versions"])) > 1000:
        raise ValueError("its versions must be a table of at most 1000 characters")
    for key in record["versions"]:
        _text(record["versions"], key, r"[\w.+-]{1,60}")
    suite = _suite(record)
    runs = _runs(suite, record, stored.arrays)
    texts = {key: record[key] for key in _TEXTS}
    name, about = checked_name(record["name"]), checked_about(record["about"])
    return Submission(name=name, about=about, suite=suite, runs=runs, **texts)


def _text(record: Mapping[str, Any], key: str, pattern: str) -> str:
    value = record[key]
    if not isinstance(value, str) or value != printable(value) or not re.fullmatch(pattern, value):
        raise ValueError(f"its {key} is {value!r:.100}, which is invalid")
    return value


def _suite(record: Mapping[str, Any]) -> Suite:
    name = record["suite"]
    if name not in list_suites():
        raise ValueError(f"its suite is {name!r:.100}; there are {', '.join(list_suites())}")
    suite = load_suite(name)
    if record["suite_hash"] != suite.hash:
        raise ValueError(f"it is for another {name}, of hash {record['suite_hash']!r:.20}, not {suite.hash[:12]}")
    return suite


def _runs(suite: Suite, record: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> tuple[Run, ...]:
    """Return the runs of a file after checking that its cells are whole speed ranges and its numbers plausible."""
    cells = _cells(suite, record["cells"])
    lengths = [len(cell.episodes) for cell in cells]
    if record["episodes"] != lengths:
        raise ValueError("its numbers of episodes are not those of the suite's cells; all of them must be run")
    seconds = record["decision_seconds"]
    if not isinstance(seconds, list) or len(seconds) != len(cells) or not all(map(_is_time, seconds)):
        raise ValueError("its decision_seconds are not a time for each cell")
    for key, values in arrays.items():
        kind, shape = _TYPES[key], (sum(lengths),)
        if values.dtype != kind or values.shape != shape:
            raise ValueError(f"its {key} is {values.dtype} of shape {values.shape}; it must be {kind} of shape {shape}")
        if not ((values >= 0) & (values <= _MOST[key])).all():
            raise ValueError(f"its {key} is not within [0, {_MOST[key]:g}] everywhere")
    when, bounds = Recorded(record["date"], record["versions"]), np.cumsum([0, *lengths]).tolist()
    parts = [{key: arrays[key][a:b] for key in SUBMITTED} for a, b in itertools.pairwise(bounds)]
    for cell, part in zip(cells, parts, strict=True):
        _check_plausible(cell, part)
    make = partial(Run, record["policy"], recorded=when, fingerprint=record["fingerprint"])
    return tuple(
        make(cell.scenario, cell.hash, _measures(part), decision_seconds=float(s))
        for cell, part, s in zip(cells, parts, seconds, strict=True)
    )


def _cells(suite: Suite, names: Any) -> list[Cell]:
    """Return the cells with these names; they must be all cells of some speed ranges, in the suite's order."""
    speed_ranges = (
        {speed_range_of(name) for name in names if isinstance(name, str)} if isinstance(names, list) else set()
    )
    cells = suite.cells_in(speed_ranges)
    if not cells or names != [cell.scenario.name for cell in cells]:
        raise ValueError(f"its cells are not those of {suite.name}, or of whole speed ranges of it")
    return cells


def _is_time(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and 0 <= value < math.inf


def _check_plausible(cell: Cell, part: Mapping[str, NDArray[Any]]) -> None:
    """Raise ValueError if the numbers of a cell contradict each other."""
    limit = cell.scenario.lost_distance
    inside = ~part["failed"] & (part["steady_rmse"] > limit * (1 + 1e-6))
    if inside.any():
        i = int(np.argmax(inside))
        raise ValueError(
            f"in episode {i} of {cell.scenario.name} the steady-state error is {part['steady_rmse'][i]:.3g} m, but the "
            f"episode did not end, which it must beyond {limit:g} m"
        )
    # For N commands a, the sum of the N - 1 squared changes is at most 4 times the sum of a^2.
    share = np.where(part["failed"], 2.0, cell.scenario.steps / max(cell.scenario.steps - 1, 1))
    excessive = part["smoothness"] > 4 * share * part["effort"] * (1 + 1e-5) + 1e-9
    if excessive.any():
        i = int(np.argmax(excessive))
        raise ValueError(f"in episode {i} of {cell.scenario.name} the command rate is too large for the effort")


def _measures(part: Mapping[str, NDArray[Any]]) -> Measures:
    """Return the metrics of a part; those that are not in the file are nan."""
    unknown = np.full(len(part["steady_rmse"]), math.nan)
    known: dict[str, Any] = {
        key: values if key == "failed" else values.astype(np.float64) for key, values in part.items()
    }
    return Measures(**{f.name: known.get(f.name, unknown) for f in fields(Measures)})

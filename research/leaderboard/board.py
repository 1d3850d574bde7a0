"""The leaderboard: a folder of submissions, SUITE/NAME.npz, and the record of those that the project has verified."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from baselines.evaluation.report.numbers import Entry
from baselines.evaluation.submission.files import LARGEST_SUBMISSION, Submission, read_submission, save_submission
from baselines.evaluation.submission.scores import anchor_errors, entries
from baselines.evaluation.suites import Suite, list_suites
from baselines.tools.command_line import printable
from baselines.tools.files import json_text, read_bytes, read_json, write_atomically

VERIFIED_FILE = "verified.json"
"""File in the folder with the verified submissions: SHA-256 of the file, date and number of episodes of the run."""


@dataclass(frozen=True)
class Leaderboard:
    """The submissions of one suite."""

    suite: Suite
    submissions: tuple[Submission, ...]
    entries: tuple[Entry, ...]  # by speed range, the best first
    verified: Mapping[str, Mapping[str, Any]]  # entries of `VERIFIED_FILE`, by the name of the submission


def enter(submission: Submission, folder: Path, replace: bool = False) -> Path:
    """Write a submission into the folder of a leaderboard and return its file.

    Raises:
        FileExistsError: the file exists, and `replace` is false.
        OSError: the file cannot be written.
    """
    file = folder / submission.suite.name / f"{submission.name}.npz"
    if file.exists() and not replace:
        raise FileExistsError(f"{file} is there already; choose another name, or --replace it")
    save_submission(submission, file)
    return file


def boards(folder: Path) -> list[Leaderboard]:
    """Return the leaderboard of each suite that has submissions.

    Raises:
        OSError: a file cannot be read.
        ValueError: a file is no submission or has a wrong name or folder, or scores cannot be computed.
    """
    found, stamps = [], _stamps(folder)
    if stray := [path for path in folder.glob("*/*.npz") if path.parent.name not in list_suites()]:
        raise ValueError(f"{stray[0]} lies in the folder of no suite; the suites are {', '.join(list_suites())}")
    for name in list_suites():
        files = sorted((folder / name).glob("*.npz"))
        if not files:
            continue
        submissions = tuple(_read(file) for file in files)
        suite = submissions[0].suite
        own = {
            file.stem: stamp for file in files if (stamp := stamps.get(_key(file))) and stamp["sha256"] == _digest(file)
        }
        found.append(Leaderboard(suite, submissions, tuple(entries(submissions, anchor_errors(suite))), own))
    return found


def _read(file: Path) -> Submission:
    """Return the submission of a file; raise ValueError if the file has another name or folder than the submission."""
    submission = read_submission(file)
    if (submission.suite.name, submission.name) != (file.parent.name, file.stem):
        raise ValueError(f"{file} holds {submission.name} in {submission.suite.name}: its name must be the same")
    return submission


def stamp(file: Path, folder: Path, episodes: int, of: int, seed: int) -> None:
    """Record that a submission of a leaderboard was reproduced.

    Args:
        file: the submission.
        folder: the folder of the leaderboard.
        episodes: number of episodes that were run again.
        of: number of episodes of the submission.
        seed: the seed that selected the episodes.

    Raises:
        OSError: the record cannot be written.
        ValueError: the file is not in the folder.
    """
    if file.resolve().parent.parent != folder.resolve():
        raise ValueError(f"{file} is not in the leaderboard {folder}; enter it first")
    when = datetime.now(timezone.utc).date().isoformat()
    record = {"sha256": _digest(file), "date": when, "episodes": episodes, "of": of, "seed": seed}
    stamps = _stamps(folder) | {_key(file): record}
    kept = {key: stamps[key] for key in sorted(stamps) if (folder / f"{key}.npz").exists()}
    write_atomically(folder / VERIFIED_FILE, json_text(kept))


def _key(file: Path) -> str:
    return f"{file.resolve().parent.name}/{file.stem}"


def _digest(file: Path) -> str:
    return hashlib.sha256(read_bytes(file, LARGEST_SUBMISSION)).hexdigest()


def _stamps(folder: Path) -> dict[str, Any]:
    """Return the entries of `VERIFIED_FILE`; {} without the file."""
    file = folder / VERIFIED_FILE
    record = read_json(file) if file.exists() else {}
    if not isinstance(record, dict) or not all(_is_stamp(entry) for entry in record.values()):
        raise ValueError(f"{file} is no record of verified submissions")
    return record


def _is_stamp(entry: Any) -> bool:
    types = {"sha256": str, "date": str, "episodes": int, "of": int, "seed": int}
    if not isinstance(entry, dict) or set(entry) != set(types):
        return False
    plain = all(isinstance(entry[key], kind) for key, kind in types.items())
    return plain and entry["date"] == printable(entry["date"]) and len(entry["date"]) == 10

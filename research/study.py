"""The frame of a study: rows by key in one file, measured where they are missing or stale.

A study is a question, a function that yields a row of plain numbers, and a section of a page. Its command builds one
`Task` for each row and calls `Rows.measure`; its page reads `Rows.load`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from baselines.tools.command_line import UsageError
from baselines.tools.files import json_text, read_json, write_atomically
from baselines.tools.workers import Workers

STAMP = "stamp"
"""Entry of a row that says what it depends on."""


@dataclass(frozen=True)
class Task:
    """One row that is to be measured."""

    key: str  # of the row in its file
    stamp: str  # what the row depends on, such as a policy's fingerprint; a row with another stamp is stale
    run: Callable[..., Mapping[str, Any]]  # returns the row; a function of a module, so that it can be pickled
    arguments: tuple[Any, ...] = ()  # of `run`


@dataclass(frozen=True)
class Rows:
    """The rows of a study in a JSON file."""

    file: Path

    def load(self) -> dict[str, dict[str, Any]]:
        """Return the rows by key; none where there is no file.

        Raises:
            UsageError: the file holds something else.
        """
        try:
            record = read_json(self.file) if self.file.exists() else {}
        except ValueError as error:
            raise UsageError(str(error)) from error
        if not isinstance(record, dict) or not all(isinstance(row, dict) for row in record.values()):
            raise UsageError(f"{self.file} holds no rows of a study; delete it, or name another file with --out")
        return record

    def measure(self, tasks: Iterable[Task], jobs: int = 1) -> dict[str, dict[str, Any]]:
        """Run the tasks whose rows are missing or stale, write each row when it is there, and return all rows.

        Args:
            tasks: what is asked for; other rows of the file stay.
            jobs: worker processes.

        Raises:
            UsageError: the file holds something else.
        """
        rows = self.load()
        due = [task for task in tasks if rows.get(task.key, {}).get(STAMP) != task.stamp]
        self.file.parent.mkdir(parents=True, exist_ok=True)
        for task, row in zip(due, Workers(jobs).results(_row, [(task,) for task in due]), strict=True):
            rows[task.key] = {STAMP: task.stamp, **row}
            write_atomically(self.file, json_text(rows))
            print(f"{task.key}: measured", flush=True)
        return rows


def _row(task: Task) -> Mapping[str, Any]:
    return task.run(*task.arguments)

"""Studies: measurements that take minutes to hours, in research/data/NAME.json, made by `python -m research NAME`.

A study has rows, such as a policy and a vehicle. Each is recorded with a stamp of everything that its numbers depend
on, and measured again only if its stamp has changed.
"""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import Positional, arg

from auv_gym.scenarios.scenario import Scenario
from baselines.evaluation.cells import drawn
from baselines.evaluation.fingerprints import fingerprint, simulator_fingerprint
from baselines.evaluation.rollout import PolicyError
from baselines.tools.command_line import DONE, FAILED, UsageError, called, check_words, checked_folder, parse
from baselines.tools.files import finite, read_json, write_atomically
from baselines.tools.workers import Workers
from research import DATA

Row = tuple[str, ...]


def stamp(policy: str, scenarios: Sequence[Scenario], *others: object) -> str:
    """Return a stamp that changes with a policy, with scenarios and their simulation, and with other values."""
    episodes = hashlib.sha256(" ".join(map(_first_episode, scenarios)).encode()).hexdigest()[:20]
    parts = fingerprint(policy, scenarios), simulator_fingerprint(scenarios), episodes
    return " ".join((*parts, *map(str, others)))


@cache
def _first_episode(scenario: Scenario) -> str:
    """Return the hash of a scenario and of the first episode that it draws."""
    return drawn(scenario, 1, 0).hash


@dataclass(frozen=True)
class Options:
    """Measure the rows of a study that are missing or outdated, and record each as soon as it is done.

    Exit status: 0 done, 1 a policy failed, 2 wrong usage.
    """

    word: Annotated[Positional[tuple[str, ...]], arg(metavar="[WORD ...]")] = ()
    """Words of rows, such as a policy and a vehicle: only rows that have all of them. Default: all rows."""
    quick: bool = False
    """Try the study with so few episodes that the numbers mean nothing; the file is runs/quick/NAME.json."""
    again: bool = False
    """Measure rows also if nothing has changed."""
    jobs: int = 1
    """Number of rows that are measured at the same time."""


class Values(dict[Row, Any]):
    """The recorded values of a study by row; a row that is not recorded raises UsageError."""

    program: str

    def __missing__(self, row: Row) -> Any:
        raise UsageError(f"{' '.join(row)} is not measured: run {self.program} {' '.join(row)}")


@dataclass(frozen=True)
class Study:
    """A study, of which a module has one.

    Attributes:
        name: name of the command.
        rows: the rows, in the order in which they are measured and recorded.
        measure: returns the JSON value of a row from its words, with the keyword `quick`.
        stamp: returns the stamp of a row from its words.
    """

    name: str
    rows: Sequence[Row]
    measure: Callable[..., Any]
    stamp: Callable[..., str]

    @property
    def file(self) -> Path:
        """File of the record."""
        return DATA / f"{self.name.replace('-', '_')}.json"

    @property
    def program(self) -> str:
        """The command."""
        return f"python -m research {self.name}"

    def values(self) -> Values:
        """Return the recorded values by row; rows that have not been measured are left out."""
        record, values = _read(self.file), Values()
        values.program = self.program
        values |= {row: record[key]["value"] for row in self.rows if (key := " ".join(row)) in record}
        return values

    def is_outdated(self, row: Row) -> bool:
        """Return whether the record lacks a row, or has it with another stamp."""
        return bool(_read(self.file).get(" ".join(row), {}).get("stamp") != self.stamp(*row))

    def main(self, arguments: Sequence[str]) -> int:
        """Measure rows and return the exit status."""
        options = parse(Options, arguments, self.program)
        check_words("word", options.word, dict.fromkeys(word for row in self.rows for word in row))
        if options.jobs < 1:
            raise UsageError(f"--jobs is {options.jobs}; it must be 1 or more")
        file = Path("runs/quick") / self.file.name if options.quick else self.file
        checked_folder(file.parent)
        rows = [row for row in self.rows if {*options.word} <= {*row}]
        if not (options.again or options.quick):
            rows = list(filter(self.is_outdated, rows))
        tasks = [(self.measure, row, options.quick) for row in rows]
        try:
            for row, value in Workers(options.jobs).results(_measured, tasks):
                self._record(row, value, file)
                print(" ".join(row), flush=True)
        except (PolicyError, OSError) as error:
            print(f"{called(self.program)}: {error}", file=sys.stderr)
            return FAILED
        print(f"{len(rows)} of {len(self.rows)} rows measured: {file}")
        return DONE

    def _record(self, row: Row, value: Any, file: Path) -> None:
        """Write a row to a file with a line for each row, in their order, without rows that the study no longer has."""
        record = _read(file) | {" ".join(row): {"stamp": self.stamp(*row), "value": value}}
        keys = (" ".join(row) for row in self.rows)
        lines = (f"{json.dumps(key)}: {json.dumps(finite(record[key]))}" for key in keys if key in record)
        write_atomically(file, "{\n" + ",\n".join(lines) + "\n}\n")


def _measured(measure: Callable[..., Any], row: Row, quick: bool) -> tuple[Row, Any]:
    return row, measure(*row, quick=quick)


def _read(file: Path) -> dict[str, Any]:
    return read_json(file) if file.exists() else {}

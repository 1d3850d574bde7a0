"""What is kept of a front: a controller or a family of agents at several prices of its commands, in one regime."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from baselines.evaluation.runner import Run
from baselines.evaluation.store import Stored, reading, write
from baselines.tools.files import versions
from research import DATA
from research.results.study_files import InSuite, packed_study, unpacked_study

FRONTS_FOLDER = DATA / "fronts"
FRONT_SUITE = "benchmark-v1"
"""The suite whose episodes are run, the first ones of each case, under the name that rows of them are kept under."""


@dataclass(frozen=True)
class Point:
    """A policy on a front."""

    label: str  # its price, or what it pays for effort and rate in training
    command: str  # that made it
    shipped: bool = False  # whether it is what ships with the package


@dataclass(frozen=True)
class Front:
    """What the points of a front do in the same episodes."""

    name: str  # of the controller or of the family of agents
    regime: str
    points: tuple[Point, ...]
    rows: InSuite  # of the points in place of seeds
    date: str  # ISO 8601
    versions: Mapping[str, str]

    @classmethod
    def of(cls, name: str, regime: str, points: Sequence[Point], runs: Sequence[Sequence[Run]]) -> Front:
        """Return the front of what each point did in each cell of a regime.

        Raises:
            ValueError: one failed.
        """
        today = datetime.now(timezone.utc).date().isoformat()
        return cls(name, regime, tuple(points), InSuite.of(FRONT_SUITE, runs), today, versions())


def save_front(front: Front, folder: Path = FRONTS_FOLDER) -> None:
    """Write a front to its file, NAME-REGIME.npz."""
    entry, arrays = packed_study(FRONT_SUITE, front.rows)
    record: dict[str, Any] = {key: getattr(front, key) for key in ("name", "regime", "date")}
    record |= {"versions": dict(front.versions), "points": [asdict(point) for point in front.points], "rows": entry}
    write(folder / f"{front.name}-{front.regime}.npz", Stored(record, arrays))


def load_fronts(folder: Path = FRONTS_FOLDER) -> list[Front]:
    """Return the fronts that are kept, in the order of their names; one of a suite that has changed is left out.

    Raises:
        ValueError: a file is damaged.
    """
    found = (_load(file) for file in sorted(folder.glob("*.npz")))
    return [front for front in found if front is not None]


def _load(file: Path) -> Front | None:
    with reading(file) as stored:
        record = dict(stored.record)
        rows = unpacked_study(FRONT_SUITE, record.pop("rows"), stored.arrays)
        points = tuple(Point(**point) for point in record.pop("points"))
        return None if rows is None else Front(points=points, rows=rows, **record)

"""The log of a trial: what was measured and commanded, checked before anything is fitted to it."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np

from auv_gym.physics.namespaces import Array
from auv_gym.scenarios.records import guarded
from baselines.tools.files import read_bytes

LOG_COLUMNS = {
    "t": "s",
    "x": "m",
    "y": "m",
    "psi": "rad",
    "u": "m/s",
    "v": "m/s",
    "r": "rad/s",
    "F_u": "N",
    "F_r": "N m",
}
"""The columns of a log and their units: time, position, heading, velocities in the body frame, and the commands of
surge force and yaw moment that hold from that row to the next."""
MEASURED_COLUMNS = tuple(LOG_COLUMNS)[1:7]  # what sensors say
_COMMANDS = tuple(LOG_COLUMNS)[7:]  # what was asked of the actuators
_SHORTEST = 50  # fewest rows of a log
_LARGEST = 30_000  # most rows of a log
_LARGEST_FILE = 2**24  # [bytes]


@dataclass(frozen=True)
class Log:
    """What a vehicle did and was told, at T instants.

    x, y and psi may be in any axes in which x' = u cos(psi) - v sin(psi) and y' = u sin(psi) + v cos(psi): x north, y
    east, psi clockwise and v to starboard, or x east, y north, psi counter-clockwise and v to port.

    Raises:
        ValueError: arrays that do not fit together, numbers that are not finite, time that does not go on, too few
            rows, commands that never change, or units that contradict each other.
    """

    t: Array  # [s], shape (T,)
    measured: Array  # x, y [m], psi [rad], u, v [m/s] over ground, r [rad/s], shape (T, 6)
    commands: Array  # F_u [N], F_r [N m], held until the next instant, shape (T, 2)

    def __post_init__(self) -> None:
        T = len(self.t)
        if self.measured.shape != (T, len(MEASURED_COLUMNS)) or self.commands.shape != (T, len(_COMMANDS)):
            raise ValueError(
                f"a log of {T} instants has measurements of shape {self.measured.shape} and commands of shape "
                f"{self.commands.shape}; they must be ({T}, {len(MEASURED_COLUMNS)}) and ({T}, {len(_COMMANDS)})"
            )
        if not _SHORTEST <= T <= _LARGEST:
            raise ValueError(f"the log has {T} rows; it must have {_SHORTEST} to {_LARGEST}")
        for name, column in zip(LOG_COLUMNS, self.table.T, strict=True):
            if len(bad := np.flatnonzero(~np.isfinite(column))):
                raise ValueError(f"{name} in data row {bad[0] + 1} is {column[bad[0]]}; every entry must be a number")
        if len(back := np.flatnonzero(np.diff(self.t) <= 0)):
            k = int(back[0])
            raise ValueError(
                f"t goes from {self.t[k]:g} to {self.t[k + 1]:g} s in data row {k + 2}; time must increase: sort the "
                "rows and leave out doubles"
            )
        if (longest := float(np.diff(self.t).max())) > 5 * self.dt:
            raise ValueError(
                f"t has a gap of {longest:.3g} s where rows are {self.dt:.3g} s apart; cut the log there, and identify "
                "from the longer part"
            )
        for name, column in zip(_COMMANDS, self.commands.T, strict=True):
            if np.ptp(column) == 0 and np.ptp(self.commands) == 0:
                raise ValueError(f"{name} is {column[0]:g} throughout; a vehicle is known by how it answers to changes")
        check_units(self)

    @property
    def dt(self) -> float:
        """Usual time [s] from one row to the next."""
        return float(np.median(np.diff(self.t)))

    @property
    def duration(self) -> float:
        """Length of the log [s]."""
        return float(self.t[-1] - self.t[0])

    @property
    def table(self) -> Array:
        """All columns in the order of `LOG_COLUMNS`, shape (T, 9)."""
        return np.column_stack((self.t, self.measured, self.commands))

    def save(self, file: str | Path) -> None:
        """Write the log to a CSV file, a line of headings first."""
        rows = [",".join(f"{x:.9g}" for x in row) for row in self.table]
        Path(file).write_text("\n".join((",".join(LOG_COLUMNS), *rows)) + "\n", encoding="utf-8")

    @classmethod
    def load(cls, file: str | Path) -> Log:
        """Return the log in a CSV file, see `LOG_COLUMNS`; others are ignored, and a unit in brackets may stand behind.

        Raises:
            ValueError: the file is no table of numbers, lacks a column, says another unit, or holds no log.
            OSError: it cannot be read.
        """
        data = read_bytes(Path(file), _LARGEST_FILE)
        with guarded(f"{file} is not valid CSV"):
            stream = io.StringIO(data.decode("utf-8-sig"), newline="")
            rows = [*islice(filter(None, csv.reader(stream, strict=True)), _LARGEST + 2)]
        with guarded(str(file)):
            table = _table(rows)
            return cls(table[:, 0], table[:, 1:7], table[:, 7:])


def _table(rows: Sequence[Sequence[str]]) -> Array:
    """Return the columns of `LOG_COLUMNS`, shape (T, 9), from the rows of a file, headings first."""
    heads = [re.fullmatch(r"\s*(\w*)\s*(?:[\[(](.*)[\])])?\s*", head) for head in (rows[0] if rows else [])]
    names = [head[1] if head else "" for head in heads]
    if missing := [name for name in LOG_COLUMNS if name not in names]:
        needed = ", ".join(f"{name} [{unit}]" for name, unit in LOG_COLUMNS.items())
        raise ValueError(f"there is no column {missing[0]!r}; the first line must name {needed}")
    for head in heads:
        if head and head[2] and head[1] in LOG_COLUMNS and head[2].replace("*", " ") != LOG_COLUMNS[head[1]]:
            raise ValueError(f"{head[1]} is in [{head[2]}]; it must be in [{LOG_COLUMNS[head[1]]}]")
    places = [names.index(name) for name in LOG_COLUMNS]
    table = np.empty((len(rows) - 1, len(LOG_COLUMNS)))
    for k, row in enumerate(rows[1:]):
        for j, place in enumerate(places):
            text = row[place] if place < len(row) else ""
            try:
                table[k, j] = float(text)
            except ValueError:
                raise ValueError(f"{names[place]} in data row {k + 1} is {text[:60]!r}; it must be a number") from None
    return table


def unwrapped(log: Log) -> Array:
    """Return the measurements with a heading that does not jump, shape (T, 6)."""
    measured = log.measured.copy()
    measured[:, 2] = np.unwrap(measured[:, 2])
    return measured


def check_units(log: Log) -> None:
    """Raise ValueError if positions, heading and speeds contradict each other as wrong units or axes make them.

    Over a second the vehicle moves by what its speeds say, and turns by what its yaw rate says.
    """
    x, y, psi, u, v, r = log.measured.T
    step = max(1, round(1 / log.dt))
    turned, told = _over(np.unwrap(psi), step), _integral(r, log.t, step)
    raw = _over(psi, step)
    degree = math.pi / 180
    if told.std() > 0:
        if abs(_slope(told, raw) * degree - 1) < 0.3 and abs(_slope(told, turned) - 1) > 0.3:
            raise ValueError("psi turns 57 times as fast as r says: it looks like degrees; it must be in [rad]")
        if abs(_slope(turned, told) * degree - 1) < 0.3:
            raise ValueError("r is 57 times as fast as psi turns: it looks like degrees; it must be in [rad/s]")
    moved = np.concatenate((_over(x, step), _over(y, step)))
    speed = float(np.hypot(u, v).mean())
    if speed * log.duration < 1.0 or moved.std() == 0:
        return  # hardly moved: nothing to compare

    def fits(heading: Array, north: Array, east: Array) -> float:
        """Return which share of the displacement the speeds leave unexplained."""
        c, s = np.cos(heading), np.sin(heading)
        told = np.concatenate([_integral(w, log.t, step) for w in (u * c - v * s, u * s + v * c)])
        gone = np.concatenate((_over(north, step), _over(east, step)))
        return float(np.mean((gone - told) ** 2) / np.mean(gone**2))

    usual = fits(psi, x, y)
    if usual < 0.3:
        return
    for says, other in (
        ("psi looks like degrees; it must be in [rad]", fits(psi * degree, x, y)),
        ("x and y look interchanged; x' = u cos(psi) - v sin(psi) must hold", fits(psi, y, x)),
        ("psi looks counted the other way round; x' = u cos(psi) - v sin(psi) must hold", fits(-psi, x, y)),
    ):
        if other < 0.3 * usual:
            raise ValueError(f"positions do not move as heading and speeds say: {says}")
    along = _slope(np.hypot(*(_integral(w, log.t, step) for w in (u, v))), np.hypot(*np.split(moved, 2)))
    if not 0.7 < along < 1.4:
        hint = ": u and v look like knots" if 0.48 < along < 0.56 else ""
        raise ValueError(f"positions move {along:.3g} times as fast as u and v say{hint}; both must be in SI units")


def _over(values: Array, step: int) -> Array:
    return values[step:] - values[:-step]


def _integral(rate: Array, t: Array, step: int) -> Array:
    total = np.concatenate(([0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(t))))
    return _over(total, step)


def _slope(x: Array, y: Array) -> float:
    """Return the slope of the line through zero that explains y by x."""
    return float(x @ y / max(float(x @ x), 1e-300))

"""The log of a trial: what was measured and commanded, checked before anything is fitted to it."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import islice, pairwise
from pathlib import Path

import numpy as np

from auv_gym.physics.namespaces import Array
from auv_gym.scenarios.records import guarded
from baselines.identification.columns import Format
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
"""The columns of a log of forces and their units: time, position, heading, velocities in the body frame, and the
commands of surge force and yaw moment that hold from that row to the next."""
MEASURED_COLUMNS = tuple(LOG_COLUMNS)[1:7]  # what sensors say
CONTROLS: Mapping[str, Mapping[str, str]] = {
    "force": {"F_u": "N", "F_r": "N m"},
    "thrust": {"thrust": "N", "rudder": "rad"},
    "revolutions": {"revolutions": "1/s", "rudder": "rad"},
}
"""Kinds of commands, with their columns and units."""
WIND_COLUMNS = {"W_x": "m/s", "W_y": "m/s"}
"""Velocity of the air over ground along the axes of x and y."""
_SHORTEST = 50  # fewest rows of a run
_LARGEST = 100_000  # most rows of a log
_LARGEST_FILE = 2**24  # [bytes]
_MOST = 1e12  # largest magnitude of an entry
_LEAST = 1e-6  # least velocity [m/s], [rad/s] that a log must reach, and least change of its commands
_GAP = 5  # rows are this many times as far apart as usual where a log has a gap


@dataclass(frozen=True)
class Log:
    """What a vehicle did and which commands it had, at T instants of one run or of several ones.

    x, y and psi may be in any axes in which x' = u cos(psi) - v sin(psi) and y' = u sin(psi) + v cos(psi): x north, y
    east, psi clockwise and v to starboard, or x east, y north, psi counter-clockwise and v to port. A positive rudder
    angle is one that turns to positive r.

    Raises:
        ValueError: arrays that do not fit together, numbers that are not finite, time that does not go on, too few
            rows, commands that never change or cannot explain what was measured, or units that contradict each other.
    """

    t: Array  # [s], shape (T,)
    measured: Array  # x, y [m], psi [rad], u, v [m/s] over ground, r [rad/s], shape (T, 6)
    commands: Array  # the columns of `CONTROLS[kind]`, held until the next instant, shape (T, 2)
    kind: str = "force"  # of the commands
    wind: Array | None = None  # the columns of `WIND_COLUMNS`, held until the next instant, shape (T, 2)
    starts: tuple[int, ...] = (0,)  # rows at which a run begins

    def __post_init__(self) -> None:
        T, own = len(self.t), CONTROLS[self.kind]
        if self.measured.shape != (T, len(MEASURED_COLUMNS)) or self.commands.shape != (T, len(own)):
            raise ValueError(
                f"a log of {T} instants has measurements of shape {self.measured.shape} and commands of shape "
                f"{self.commands.shape}; they must be ({T}, {len(MEASURED_COLUMNS)}) and ({T}, {len(own)})"
            )
        if self.wind is not None and self.wind.shape != (T, len(WIND_COLUMNS)):
            raise ValueError(f"a log of {T} instants has wind of shape {self.wind.shape}; it must be ({T}, 2)")
        if T > _LARGEST:
            raise ValueError(f"the log has {T} rows; it must have {_SHORTEST} to {_LARGEST}")
        for name, column in zip(self.columns, self.table.T, strict=True):
            if len(bad := np.flatnonzero(~(np.abs(column) <= _MOST))):
                entry = f"{name} in data row {bad[0] + 1} is {column[bad[0]]}"
                raise ValueError(f"{entry}; every entry must be a number of at most {_MOST:g}")
        for run in self.runs:
            self._check_times(run)
        if (fastest := float(np.abs(self.measured[:, 3:]).max(initial=0.0))) < _LEAST:
            raise ValueError(f"u, v and r are at most {fastest:.3g} in [m/s] and [rad/s]; the vehicle must move")
        if np.ptp(self.commands) < _LEAST:
            name, value = next(iter(own)), self.commands[0, 0]
            raise ValueError(f"{name} is {value:g} throughout; a vehicle is known by how it answers to changes")
        if self.kind == "force" and not self.commands[:, 1].any():
            _check_straight(self)
        for run in self.runs:
            check_units(self.t[run], self.measured[run])

    def _check_times(self, run: slice) -> None:
        t = self.t[run]
        if len(t) < _SHORTEST:
            raise ValueError(f"the log has {len(t)} rows; it must have {_SHORTEST} to {_LARGEST}")
        if len(back := np.flatnonzero(np.diff(t) <= 0)):
            k = int(back[0])
            raise ValueError(
                f"t goes from {t[k]:g} to {t[k + 1]:g} s in data row {run.start + k + 2}; time must increase: sort the "
                "rows and leave out doubles; decimals need a point"
            )
        if (longest := float(np.diff(t).max())) > _GAP * self.dt:
            raise ValueError(f"t has a gap of {longest:.3g} s where rows are {self.dt:.3g} s apart; cut the log there")

    @property
    def columns(self) -> dict[str, str]:
        """Its columns and their units."""
        measured = {name: LOG_COLUMNS[name] for name in ("t", *MEASURED_COLUMNS)}
        return measured | dict(CONTROLS[self.kind]) | (WIND_COLUMNS if self.wind is not None else {})

    @property
    def runs(self) -> tuple[slice, ...]:
        """The rows of each run."""
        return tuple(slice(a, b) for a, b in pairwise((*self.starts, len(self.t))))

    @property
    def steps(self) -> Array:
        """Time [s] from each row to the next one; the last of a run is the usual one, shape (T,)."""
        return np.concatenate([np.append(np.diff(self.t[run]), self.dt) for run in self.runs])

    @cached_property
    def dt(self) -> float:
        """Usual time [s] from one row to the next."""
        return float(np.median(np.diff(self.t)))

    @property
    def duration(self) -> float:
        """Length of all runs together [s]."""
        return float(sum(self.t[run][-1] - self.t[run][0] for run in self.runs))

    @property
    def table(self) -> Array:
        """All columns in the order of `columns`, shape (T, 9) or, with wind, (T, 11)."""
        wind = () if self.wind is None else (self.wind,)
        return np.column_stack((self.t, self.measured, self.commands, *wind))

    def rows(self, chosen: slice) -> Log:
        """Return some rows of one run as a log of its own."""
        wind = None if self.wind is None else self.wind[chosen]
        return Log(self.t[chosen], self.measured[chosen], self.commands[chosen], self.kind, wind)

    def save(self, file: str | Path) -> None:
        """Write the log to a CSV file, a line of headings first."""
        rows = [",".join(f"{x:.9g}" for x in row) for row in self.table]
        Path(file).write_text("\n".join((",".join(self.columns), *rows)) + "\n", encoding="utf-8")

    @classmethod
    def load(cls, file: str | Path, form: Format | None = None) -> Log:
        """Return the log in a file; without a format in a CSV file with the columns of `LOG_COLUMNS`.

        Others are ignored, and a unit in brackets may stand behind a name; in the place of F_u, F_r there may be the
        columns of another of `CONTROLS`, and W_x, W_y beside them. With a format, gaps divide the log into runs.

        Raises:
            ValueError: the file is no table of numbers, lacks a column, says another unit, or holds no log.
            OSError: it cannot be read.
        """
        with guarded(str(file)):
            columns = _plain(Path(file)) if form is None else form.read(file)
            return cls._of(columns, None if form is None else _pieces(columns.get("t", np.empty(0))))

    @classmethod
    def _of(cls, columns: Mapping[str, Array], pieces: list[slice] | None) -> Log:
        """Return the log of some columns, by name; one run of all rows, or one of each piece."""
        kind = next((kind for kind, own in CONTROLS.items() if own.keys() <= columns.keys()), "force")
        needed = {name: LOG_COLUMNS[name] for name in ("t", *MEASURED_COLUMNS)} | dict(CONTROLS[kind])
        if missing := [name for name in needed if name not in columns]:
            named = ", ".join(f"{name} [{unit}]" for name, unit in needed.items())
            raise ValueError(f"there is no column {missing[0]!r}; the first line must name {named}")
        if pieces == []:
            raise ValueError(f"the log has no {_SHORTEST} rows without a gap; it must have {_SHORTEST} to {_LARGEST}")
        pieces = pieces or [slice(0, len(columns["t"]))]
        rows = np.concatenate([np.arange(piece.start, piece.stop) for piece in pieces])
        starts = np.cumsum([0, *(piece.stop - piece.start for piece in pieces[:-1])])

        def table(names: Iterable[str]) -> Array:
            return np.column_stack([columns[name][rows] for name in names])

        wind = table(WIND_COLUMNS) if WIND_COLUMNS.keys() <= columns.keys() else None
        measured, commands = table(MEASURED_COLUMNS), table(CONTROLS[kind])
        return cls(columns["t"][rows], measured, commands, kind, wind, tuple(starts.tolist()))


def joined(logs: Sequence[Log]) -> Log:
    """Return several logs as one of as many runs.

    Raises:
        ValueError: there is none, or their commands are of different kinds, or wind is in some only.
    """
    if not logs:
        raise ValueError("there is no log")
    if len(logs) == 1:
        return logs[0]
    if len({(log.kind, log.wind is None) for log in logs}) > 1:
        kinds = ", ".join(sorted({f"{log.kind}{'' if log.wind is None else ' and wind'}" for log in logs}))
        raise ValueError(f"logs that are taken together have commands of {kinds}; they must be of one kind")
    before = np.cumsum([0, *(len(log.t) for log in logs)]).tolist()
    starts = tuple(k + start for k, log in zip(before, logs, strict=False) for start in log.starts)
    wind = None if logs[0].wind is None else np.concatenate([log.wind for log in logs])
    t, measured, commands = (
        np.concatenate([getattr(log, name) for log in logs]) for name in ("t", "measured", "commands")
    )
    return Log(t, measured, commands, logs[0].kind, wind, starts)


def _pieces(t: Array) -> list[slice]:
    """Return the rows between gaps; what is too short for a run is left out."""
    if len(t) < _SHORTEST:
        return []
    steps = np.diff(t)
    cuts = np.flatnonzero((steps > _GAP * np.median(steps)) | (steps <= 0)) + 1
    return [slice(int(a), int(b)) for a, b in pairwise((0, *cuts, len(t))) if b - a >= _SHORTEST]


def _plain(file: Path) -> dict[str, Array]:
    """Return the columns of a CSV file by name, those of a log alone."""
    data = read_bytes(file, _LARGEST_FILE)
    with guarded("not valid CSV"):
        stream = io.StringIO(data.decode("utf-8-sig"), newline="")
        rows = [*islice(filter(None, csv.reader(stream, strict=True)), _LARGEST + 2)]
    units = {**LOG_COLUMNS, **WIND_COLUMNS}
    for own in CONTROLS.values():
        units |= own
    if rows and len(rows[0]) == 1 and ";" in rows[0][0]:
        raise ValueError("columns are separated by semicolons; give a format with separator = ';', or use commas")
    heads = [re.fullmatch(r"\s*(\w*)\s*(?:[\[(](.*)[\])])?\s*", head) for head in (rows[0] if rows else [])]
    names = [head[1] if head else "" for head in heads]
    for head in heads:
        if head and head[1] in units:
            if head[2] and head[2].replace("*", " ") != units[head[1]]:
                raise ValueError(f"{head[1]} is in [{head[2]}]; it must be in [{units[head[1]]}]")
            if names.count(head[1]) > 1:
                raise ValueError(f"there is more than one column {head[1]!r}; leave one of them out")
    if missing := [name for name in ("t", *MEASURED_COLUMNS) if name not in names]:
        needed = ", ".join(f"{name} [{unit}]" for name, unit in LOG_COLUMNS.items())
        raise ValueError(f"there is no column {missing[0]!r}; the first line must name {needed}")
    found = {name: np.empty(len(rows) - 1) for name in units if name in names}
    for name, values in found.items():
        place = names.index(name)
        for k, row in enumerate(rows[1:]):
            text = row[place] if place < len(row) else ""
            try:
                values[k] = float(text)
            except ValueError:
                raise ValueError(f"{name} in data row {k + 1} is {text[:60]!r}; it must be a number") from None
    return found


def _check_straight(log: Log) -> None:
    """Raise ValueError if a log without a yaw moment turns by more than its own noise."""
    r = log.measured[:, 5]
    noise = 1.4826 * float(np.median(np.abs(np.diff(r, 2) - np.median(np.diff(r, 2))))) / math.sqrt(6)
    if r.std() > 3 * noise + 1e-9 and np.ptp(np.unwrap(log.measured[:, 2])) > 0.5:
        raise ValueError("F_r is 0 throughout, but the vehicle turns: log the yaw moments that were commanded")


def unwrapped(log: Log) -> Array:
    """Return the measurements with a heading that does not jump, shape (T, 6)."""
    measured = log.measured.copy()
    for run in log.runs:
        measured[run, 2] = np.unwrap(measured[run, 2])
    return measured


def check_units(t: Array, measured: Array) -> None:
    """Raise ValueError if positions, heading and speeds contradict each other as wrong units or axes make them.

    Over a second the vehicle moves by what its speeds say, and turns by what its yaw rate says.
    """
    x, y, psi, u, v, r = measured.T
    step = max(1, round(1 / float(np.median(np.diff(t)))))
    turned, told = _over(np.unwrap(psi), step), _integral(r, t, step)
    raw = _over(psi, step)
    degree = math.pi / 180
    if told.std() > 0:
        if abs(_slope(told, raw) * degree - 1) < 0.3 and abs(_slope(told, turned) - 1) > 0.3:
            raise ValueError("psi turns 57 times as fast as r says: it looks like degrees; it must be in [rad]")
        if abs(_slope(turned, told) * degree - 1) < 0.3:
            raise ValueError("r is 57 times as fast as psi turns: it looks like degrees; it must be in [rad/s]")
    moved = np.concatenate((_over(x, step), _over(y, step)))
    speed = float(np.hypot(u, v).mean())
    if speed * (t[-1] - t[0]) < 1.0 or moved.std() == 0:
        return  # hardly moved: nothing to compare

    def fits(heading: Array, north: Array, east: Array) -> float:
        """Return which share of the displacement the speeds leave unexplained."""
        c, s = np.cos(heading), np.sin(heading)
        told = np.concatenate([_integral(w, t, step) for w in (u * c - v * s, u * s + v * c)])
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
    along = _slope(np.hypot(*(_integral(w, t, step) for w in (u, v))), np.hypot(*np.split(moved, 2)))
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

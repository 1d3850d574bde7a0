"""The log of a trial: measurements and commands, checked before a vehicle is fitted to them."""

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
    "t": "s", "x": "m", "y": "m", "psi": "rad", "u": "m/s", "v": "m/s", "r": "rad/s", "F_u": "N", "F_r": "N m",
}  # fmt: skip
"""Columns of a log of forces with their units: time, position, heading, velocities in the body frame, surge force and
yaw moment. Commands hold until the next row."""
MEASURED_COLUMNS = tuple(LOG_COLUMNS)[1:7]  # measurements
CONTROLS: Mapping[str, Mapping[str, str]] = {
    "force": {"F_u": "N", "F_r": "N m"},
    "thrust": {"thrust": "N", "rudder": "rad"},
    "revolutions": {"revolutions": "1/s", "rudder": "rad"},
}
"""Columns of the commands with their units, for each kind of commands."""
WIND_COLUMNS = {"W_x": "m/s", "W_y": "m/s"}
"""Columns of the velocity of the air over ground, along the axes of x and y."""
_MIN_ROWS = 50  # of a run
_MAX_ROWS = 100_000  # of a log
_MAX_BYTES = 2**24  # of a file
_MAX_ENTRY = 1e12  # largest magnitude of an entry
_MIN_MOTION = 1e-6  # least peak velocity [m/s], [rad/s] of a log, and least range of its commands
_GAP = 5  # a gap is a time step above this multiple of the median time step


@dataclass(frozen=True)
class Log:
    """Measurements and commands of a vehicle at T instants of one run or of several runs.

    x, y and psi may be in any axes in which x' = u cos(psi) - v sin(psi) and y' = u sin(psi) + v cos(psi): x north, y
    east, psi clockwise and v to starboard, or x east, y north, psi counter-clockwise and v to port. A positive rudder
    angle turns the vehicle to positive r.

    Raises:
        ValueError: shapes that do not match, numbers that are not finite, time that does not increase, too few rows,
            commands that are constant or cannot explain the motion, or units that contradict each other.
    """

    t: Array  # [s], shape (T,)
    measured: Array  # x, y [m], psi [rad], u, v [m/s] over ground, r [rad/s], shape (T, 6)
    commands: Array  # the columns of `CONTROLS[kind]`, held until the next instant, shape (T, 2)
    kind: str = "force"  # of the commands
    wind: Array | None = None  # the columns of `WIND_COLUMNS`, held until the next instant, shape (T, 2)
    starts: tuple[int, ...] = (0,)  # first row of each run

    def __post_init__(self) -> None:
        T = len(self.t)
        for name, values, width in (
            ("measured", self.measured, 6),
            ("commands", self.commands, 2),
            ("wind", self.wind, 2),
        ):
            if values is not None and values.shape != (T, width):
                raise ValueError(f"a log of {T} instants has {name} of shape {values.shape}; it must be ({T}, {width})")
        if T > _MAX_ROWS:
            raise ValueError(f"the log has {T} rows; it must have {_MIN_ROWS} to {_MAX_ROWS}")
        for name, column in zip(self.columns, self.table.T, strict=True):
            if len(bad := np.flatnonzero(~(np.abs(column) <= _MAX_ENTRY))):
                entry = f"{name} in data row {bad[0] + 1} is {column[bad[0]]}"
                raise ValueError(f"{entry}; every entry must be a number of at most {_MAX_ENTRY:g}")
        for run in self.runs:
            self._check_times(run)
        if (fastest := float(np.abs(self.measured[:, 3:]).max(initial=0.0))) < _MIN_MOTION:
            raise ValueError(f"u, v and r are at most {fastest:.3g} in [m/s] and [rad/s]; the vehicle must move")
        if np.ptp(self.commands) < _MIN_MOTION:
            name, value = next(iter(CONTROLS[self.kind])), self.commands[0, 0]
            raise ValueError(f"{name} is {value:g} throughout; the commands must change during the log")
        if self.kind == "force" and not self.commands[:, 1].any():
            _check_straight(self)
        for run in self.runs:
            check_units(self.t[run], self.measured[run])

    def _check_times(self, run: slice) -> None:
        t = self.t[run]
        if len(t) < _MIN_ROWS:
            raise ValueError(f"the log has {len(t)} rows; it must have {_MIN_ROWS} to {_MAX_ROWS}")
        if len(back := np.flatnonzero(np.diff(t) <= 0)):
            k = int(back[0])
            raise ValueError(
                f"t goes from {t[k]:g} to {t[k + 1]:g} s in data row {run.start + k + 2}; time must increase: sort the "
                "rows, remove duplicates, and write decimals with a point"
            )
        if (longest := float(np.diff(t).max())) > _GAP * self.dt:
            raise ValueError(f"t has a gap of {longest:.3g} s where rows are {self.dt:.3g} s apart; cut the log there")

    @property
    def columns(self) -> dict[str, str]:
        """The columns of the log with their units."""
        return _columns(self.kind) | (WIND_COLUMNS if self.wind is not None else {})

    @property
    def runs(self) -> tuple[slice, ...]:
        """The rows of each run."""
        return tuple(slices(self.starts, len(self.t)))

    @property
    def steps(self) -> Array:
        """Time [s] from each row to the next, shape (T,); for the last row of a run the median."""
        return np.concatenate([np.append(np.diff(self.t[run]), self.dt) for run in self.runs])

    @cached_property
    def dt(self) -> float:
        """Median time [s] from one row to the next."""
        return float(np.median(np.diff(self.t)))

    @property
    def duration(self) -> float:
        """Total length of all runs [s]."""
        return float(sum(self.t[run][-1] - self.t[run][0] for run in self.runs))

    @property
    def table(self) -> Array:
        """All columns in the order of `columns`, shape (T, 9) or, with wind, (T, 11)."""
        wind = () if self.wind is None else (self.wind,)
        return np.column_stack((self.t, self.measured, self.commands, *wind))

    def rows(self, chosen: slice) -> Log:
        """Return a log of some rows of one run."""
        wind = None if self.wind is None else self.wind[chosen]
        return Log(self.t[chosen], self.measured[chosen], self.commands[chosen], self.kind, wind)

    def save(self, file: str | Path) -> None:
        """Write the log to a CSV file whose first line has the names of the columns."""
        rows = [",".join(f"{x:.9g}" for x in row) for row in self.table]
        Path(file).write_text("\n".join((",".join(self.columns), *rows)) + "\n", encoding="utf-8")

    @classmethod
    def load(cls, file: str | Path, form: Format | None = None) -> Log:
        """Return the log in a file; without a format it must be a CSV file with the columns of `LOG_COLUMNS`.

        A unit in brackets may follow the name of a column. F_u, F_r may be replaced by the columns of another kind in
        `CONTROLS`. W_x and W_y are optional. Other columns are ignored. With a format, gaps divide the log into runs.

        Raises:
            ValueError: the file is not a table of numbers, a column is missing or has the wrong unit, or the log is
                invalid.
            OSError: the file cannot be read.
        """
        with guarded(str(file)):
            columns = _read_csv(Path(file)) if form is None else form.read(file)
            t = columns.get("t", np.empty(0))
            return cls._of_columns(columns, [slice(0, len(t))] if form is None else _without_gaps(t))

    @classmethod
    def _of_columns(cls, columns: Mapping[str, Array], runs: Sequence[slice]) -> Log:
        """Return the log of columns, by name, with the rows of each run."""
        kind = next((kind for kind, controls in CONTROLS.items() if controls.keys() <= columns.keys()), "force")
        needed = _columns(kind)
        if missing := [name for name in needed if name not in columns]:
            expected = ", ".join(f"{name} [{unit}]" for name, unit in needed.items())
            raise ValueError(f"there is no column {missing[0]!r}; the first line must name {expected}")
        if not runs:
            raise ValueError(f"the log has no {_MIN_ROWS} rows without a gap; it must have {_MIN_ROWS} to {_MAX_ROWS}")
        rows = np.concatenate([np.arange(run.start, run.stop) for run in runs])
        starts = np.cumsum([0, *(run.stop - run.start for run in runs[:-1])])

        def table(names: Iterable[str]) -> Array:
            return np.column_stack([columns[name][rows] for name in names])

        wind = table(WIND_COLUMNS) if WIND_COLUMNS.keys() <= columns.keys() else None
        measured, commands = table(MEASURED_COLUMNS), table(CONTROLS[kind])
        return cls(columns["t"][rows], measured, commands, kind, wind, tuple(starts.tolist()))


def slices(starts: Iterable[int], end: int) -> list[slice]:
    """Return the rows from each start to the next start, and from the last start to `end`."""
    return [slice(int(a), int(b)) for a, b in pairwise((*starts, end))]


def joined(logs: Sequence[Log]) -> Log:
    """Return one log with the runs of several logs.

    Raises:
        ValueError: there is no log, their commands are of different kinds, or only some of them have wind.
    """
    if not logs:
        raise ValueError("there is no log")
    if len(logs) == 1:
        return logs[0]
    if len({(log.kind, log.wind is None) for log in logs}) > 1:
        kinds = ", ".join(sorted({f"{log.kind}{'' if log.wind is None else ' and wind'}" for log in logs}))
        raise ValueError(f"the logs have commands of different kinds: {kinds}; they must be of one kind")
    before = np.cumsum([0, *(len(log.t) for log in logs)]).tolist()
    starts = tuple(k + start for k, log in zip(before, logs, strict=False) for start in log.starts)
    wind = None if logs[0].wind is None else np.concatenate([log.wind for log in logs])
    t, measured, commands = (
        np.concatenate([getattr(log, name) for log in logs]) for name in ("t", "measured", "commands")
    )
    return Log(t, measured, commands, logs[0].kind, wind, starts)


def unwrapped(log: Log) -> Array:
    """Return the measurements with a heading that does not jump by 2 pi within a run, shape (T, 6)."""
    measured = log.measured.copy()
    for run in log.runs:
        measured[run, 2] = np.unwrap(measured[run, 2])
    return measured


def _columns(kind: str) -> dict[str, str]:
    """Return the columns of a log without wind, with their units."""
    return {name: LOG_COLUMNS[name] for name in ("t", *MEASURED_COLUMNS)} | dict(CONTROLS[kind])


def _without_gaps(t: Array) -> list[slice]:
    """Return the rows of each part without a gap; parts that are too short for a run are omitted."""
    if len(t) < _MIN_ROWS:
        return []
    steps = np.diff(t)
    cuts = np.flatnonzero((steps > _GAP * np.median(steps)) | (steps <= 0)) + 1
    return [part for part in slices((0, *cuts), len(t)) if part.stop - part.start >= _MIN_ROWS]


def _read_csv(file: Path) -> dict[str, Array]:
    """Return those columns of a CSV file that belong to a log, by name."""
    data = read_bytes(file, _MAX_BYTES)
    with guarded("not valid CSV"):
        stream = io.StringIO(data.decode("utf-8-sig"), newline="")
        header, *rows = [*islice(filter(None, csv.reader(stream, strict=True)), _MAX_ROWS + 2)] or [[]]
    if len(header) == 1 and ";" in header[0]:
        raise ValueError("columns are separated by semicolons; give a format with separator = ';', or use commas")
    units = {**LOG_COLUMNS, **WIND_COLUMNS, **CONTROLS["thrust"], **CONTROLS["revolutions"]}
    heads = [re.fullmatch(r"\s*(\w*)\s*(?:[\[(](.*)[\])])?\s*", head) for head in header]
    names = [head[1] if head else "" for head in heads]
    for head in heads:
        if head and head[1] in units:
            if head[2] and head[2].replace("*", " ") != units[head[1]]:
                raise ValueError(f"{head[1]} is in [{head[2]}]; it must be in [{units[head[1]]}]")
            if names.count(head[1]) > 1:
                raise ValueError(f"there is more than one column {head[1]!r}; remove all but one")
    columns = {name: np.empty(len(rows)) for name in units if name in names}
    for name, values in columns.items():
        place = names.index(name)
        for k, row in enumerate(rows):
            text = row[place] if place < len(row) else ""
            try:
                values[k] = float(text)
            except ValueError:
                raise ValueError(f"{name} in data row {k + 1} is {text[:60]!r}; it must be a number") from None
    return columns


def _check_straight(log: Log) -> None:
    """Raise ValueError if a log without a yaw moment has a yaw motion above the measurement noise."""
    r = log.measured[:, 5]
    noise = 1.4826 * float(np.median(np.abs(np.diff(r, 2) - np.median(np.diff(r, 2))))) / math.sqrt(6)
    if r.std() > 3 * noise + 1e-9 and np.ptp(np.unwrap(log.measured[:, 2])) > 0.5:
        raise ValueError("F_r is 0 throughout, but the vehicle turns: log the commanded yaw moments")


def check_units(t: Array, measured: Array) -> None:
    """Raise ValueError if positions, heading and speeds contradict each other, as with wrong units or axes.

    The changes of position and heading over one second are compared with the integrals of the velocities.
    """
    x, y, psi, u, v, r = measured.T
    step = max(1, round(1 / float(np.median(np.diff(t)))))
    turned, wrapped, integrated = _change(np.unwrap(psi), step), _change(psi, step), _integral(r, t, step)
    degree = math.pi / 180
    if integrated.std() > 0:
        if abs(_slope(integrated, wrapped) * degree - 1) < 0.3 and abs(_slope(integrated, turned) - 1) > 0.3:
            raise ValueError("psi changes 57 times as fast as r: it looks like degrees; it must be in [rad]")
        if abs(_slope(turned, integrated) * degree - 1) < 0.3:
            raise ValueError("r is 57 times the rate of psi: it looks like degrees; it must be in [rad/s]")
    moved = np.concatenate((_change(x, step), _change(y, step)))
    speed = float(np.hypot(u, v).mean())
    if speed * (t[-1] - t[0]) < 1.0 or moved.std() == 0:
        return  # too little motion for a comparison

    def unexplained(heading: Array, north: Array, east: Array) -> float:
        """Return the share of the squared displacement that the velocities do not explain."""
        c, s = np.cos(heading), np.sin(heading)
        expected = np.concatenate([_integral(w, t, step) for w in (u * c - v * s, u * s + v * c)])
        actual = np.concatenate((_change(north, step), _change(east, step)))
        return float(np.mean((actual - expected) ** 2) / np.mean(actual**2))

    usual = unexplained(psi, x, y)
    if usual < 0.3:
        return
    for message, other in (
        ("psi looks like degrees; it must be in [rad]", unexplained(psi * degree, x, y)),
        ("x and y look interchanged; x' = u cos(psi) - v sin(psi) must hold", unexplained(psi, y, x)),
        ("psi seems to have the opposite sign; x' = u cos(psi) - v sin(psi) must hold", unexplained(-psi, x, y)),
    ):
        if other < 0.3 * usual:
            raise ValueError(f"positions contradict heading and speeds: {message}")
    along = _slope(np.hypot(*(_integral(w, t, step) for w in (u, v))), np.hypot(*np.split(moved, 2)))
    if not 0.7 < along < 1.4:
        hint = ": u and v look like knots" if 0.48 < along < 0.56 else ""
        raise ValueError(f"positions change {along:.3g} times as fast as u and v{hint}; both must be in SI units")


def _change(values: Array, step: int) -> Array:
    return values[step:] - values[:-step]


def _integral(rate: Array, t: Array, step: int) -> Array:
    total = np.concatenate(([0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(t))))
    return _change(total, step)


def _slope(x: Array, y: Array) -> float:
    """Return the slope of the line through the origin that explains y by x with the least squared error."""
    return float(x @ y / max(float(x @ x), 1e-300))

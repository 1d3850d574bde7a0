"""The log of a trial: measurements and commands, checked before a vehicle is fitted to them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from auv_gym.physics.namespaces import Array, Indices
from auv_gym.scenarios.records import guarded
from baselines.identification.axes import ContradictionError, check_commands, check_motion
from baselines.identification.columns import QUANTITIES, Format, Table, regular, repeated

MEASURED_COLUMNS = ("x", "y", "psi", "u", "v", "r")
"""Columns of the measurements: position, heading, velocities in the body frame."""
CONTROLS: Mapping[str, tuple[str, str]] = {
    "force": ("F_u", "F_r"), "thrust": ("thrust", "rudder"), "revolutions": ("revolutions", "rudder")
}  # fmt: skip
"""Columns of the commands, which hold until the next row, for each kind of commands."""
WIND_COLUMNS = ("W_x", "W_y")
"""Columns of the velocity of the air over ground, along the axes of x and y."""
_COLUMNS = ("t", *MEASURED_COLUMNS, "F_u", "F_r", "thrust", "revolutions", "rudder", *WIND_COLUMNS)
_MIN_ROWS = 50  # of a run
_MAX_ROWS = 100_000  # of a log
_ALLOWED = f"it must have {_MIN_ROWS} to {_MAX_ROWS}"
_MAX_ENTRY = 1e12  # largest magnitude of an entry
_MIN_MOTION = 1e-6  # least peak velocity [m/s], [rad/s] of a log, and least range of its commands
_TURNED = 0.5  # [rad] change of the heading from which no speed is constant
_LEAST_NOISE = 1e-6  # as a share of the range of a measurement
_EPOCH = 1e8  # [s] time from which stamps are counted from the first one
_FAR, _BEYOND = 10.0, 3.0  # least distances of an outlier, as multiples of usual changes and of the range of the others
_FEW = 0.02  # largest share of outliers
_FROZEN, _OFTEN = 10, 0.05  # rows from which a value is frozen; share of equal rows from which a sensor is coarse
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
    seen: NDArray[np.bool_] | None = None  # measurements that count, shape (T, 6); None: all. Others are interpolated
    notes: tuple[str, ...] = ()  # what does not count, and why

    def __post_init__(self) -> None:
        T = len(self.t)
        for name, values, width in (
            ("measured", self.measured, 6),
            ("commands", self.commands, 2),
            ("wind", self.wind, 2),
            ("seen", self.seen, 6),
        ):
            if values is not None and values.shape != (T, width):
                raise ValueError(f"a log of {T} instants has {name} of shape {values.shape}; it must be ({T}, {width})")
        if T > _MAX_ROWS:
            every = self.duration / (0.5 * _MAX_ROWS)
            raise ValueError(f"the log has {T} rows; {_ALLOWED}: thin it by every = {every:.2g} in a format, or cut it")
        for name, column in zip(self.columns, self.table.T, strict=True):
            if len(bad := np.flatnonzero(~(np.abs(column) <= _MAX_ENTRY))):
                entry = f"{name} in data row {bad[0] + 1} is {column[bad[0]]}"
                raise ValueError(f"{entry}; every entry must be a number of at most {_MAX_ENTRY:g}")
        for run in self.runs:
            self._check_times(run)
        if (fastest := float(np.abs(self.measured[:, 3:]).max(initial=0.0))) < _MIN_MOTION:
            raise ValueError(f"u, v and r are at most {fastest:.3g} in [m/s] and [rad/s]; the vehicle must move")
        if np.ptp(self.commands) < _MIN_MOTION:
            name, value = CONTROLS[self.kind][0], self.commands[0, 0]
            raise ValueError(f"{name} is {value:g} throughout; the commands must change during the log")
        noise = rough_noise(self)
        if self.kind == "force" and not self.commands[:, 1].any():
            _, _, psi, _, _, r = self.measured.T
            if r.std() > 3 * noise[5] + 1e-9 and np.ptp(np.unwrap(psi)) > 0.5:
                raise ValueError("F_r is 0 throughout, but the vehicle turns: log the commanded yaw moments")
        for run in self.runs:
            check_motion(self.t[run], self.measured[run], noise)
            check_commands(self.t[run], self.commands[run], self.measured[run], CONTROLS[self.kind])

    def _check_times(self, run: slice) -> None:
        t = self.t[run]
        if len(t) < _MIN_ROWS:
            raise ValueError(f"the log has {len(t)} rows; {_ALLOWED}")
        if len(back := np.flatnonzero(np.diff(t) <= 0)):
            k = int(back[0])
            raise ValueError(
                f"t goes from {t[k]:g} to {t[k + 1]:g} s in data row {run.start + k + 2}; time must increase: where a "
                "new run begins, write a file for each run, or give a format, which divides runs"
            )
        if (longest := float(np.diff(t).max())) > _GAP * self.dt:
            raise ValueError(
                f"t has a gap of {longest:.3g} s where rows are {self.dt:.3g} s apart; cut the log there, or give a "
                "format, which divides runs"
            )

    @property
    def columns(self) -> tuple[str, ...]:
        """The names of the columns."""
        return ("t", *MEASURED_COLUMNS, *CONTROLS[self.kind], *(() if self.wind is None else WIND_COLUMNS))

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

    def counted(self, rows: slice, column: int) -> Indices:
        """Return those of some rows in which a measurement counts."""
        every = np.arange(rows.start, rows.stop)
        return every if self.seen is None else every[self.seen[rows, column]]

    @property
    def rarity(self) -> int:
        """Number of rows for each value of the measurement that comes most often."""
        return 1 if self.seen is None else max(1, round(len(self.t) / max(int(self.seen.sum(axis=0).max()), 1)))

    @property
    def duration(self) -> float:
        """Total length of all runs [s]."""
        return float(sum(self.t[run][-1] - self.t[run][0] for run in self.runs))

    @property
    def table(self) -> Array:
        """All columns in the order of `columns`, shape (T, 9) or, with wind, (T, 11)."""
        wind = () if self.wind is None else (self.wind,)
        return np.column_stack((self.t, self.measured, self.commands, *wind))

    def save(self, file: str | Path) -> None:
        """Write the log to a CSV file whose first line has the names of the columns."""
        table = self.table
        if self.seen is not None:
            table[:, 1:7][~self.seen] = np.nan
        np.savetxt(file, table, "%.9g", ",", header=",".join(self.columns), comments="", encoding="utf-8")

    @classmethod
    def load(cls, file: str | Path, form: Format | str | None = None) -> Log:
        """Return the log in a file; without a format its first line names the columns, see `Format.of_first_line`.

        Its columns are t, those of `MEASURED_COLUMNS`, those of one kind in `CONTROLS`, and optionally those of
        `WIND_COLUMNS`. With a format, gaps divide the log into runs. A measurement without a value does not count, and
        one that is held for several rows counts once. A format may be given by its name or file.

        Raises:
            ContradictionError: columns contradict each other.
            ValueError: the file is not a table of numbers, a column is missing or has the wrong unit, or the log is
                invalid.
            OSError: the file cannot be read.
        """
        form = Format.named(form) if isinstance(form, str) else form
        with guarded(str(file)):
            table = (Format.of_first_line(Path(file), _COLUMNS) if form is None else form).read(file)
            try:
                return cls._of_columns(table, form)
            except ContradictionError as error:
                contradiction = ContradictionError(f"{file}: {error}{form.hints if form else ''}")
        raise contradiction

    @classmethod
    def _of_columns(cls, read: Table, form: Format | None) -> Log:
        """Return the log of columns, by name; with a format in runs without gaps."""
        columns, notes = read.columns, [*read.notes]
        kind = next((kind for kind, names in CONTROLS.items() if columns.keys() >= {*names}), "force")
        needed = ("t", *MEASURED_COLUMNS, *CONTROLS[kind])
        if lone := {"port", "starboard", "q_w", "q_z"} & columns.keys():
            raise ValueError(f"there is {', '.join(sorted(lone))} alone; port needs starboard, and q_w needs q_z")
        if missing := [name for name in needed if name not in columns]:
            expected = ", ".join(f"{name} [{QUANTITIES[name]}]" for name in needed)
            hint = "" if form else "; describe other names, units and separators in a format: --format FILE.toml"
            raise ValueError(f"there is no column {missing[0]!r}; the first line must name {expected}{hint}")
        if not len(columns["t"]):
            raise ValueError(f"the log has no rows; {_ALLOWED}")
        known = np.isfinite(np.column_stack([columns[name] for name in CONTROLS[kind]])).all(axis=1)
        begin = int(np.argmax(known)) if known.any() else 0
        columns = {name: values[begin:] for name, values in columns.items()}
        if begin:
            notes.append(f"{begin} rows before the first commands are left out")
        if empty := [name for name in needed if len(columns[name]) and not np.isfinite(columns[name]).any()]:
            raise ValueError(f"{empty[0]} has no value in any row; all of {', '.join(needed)} are needed")
        seen, held = _seen(columns)
        columns |= {
            name: _filled(name, columns[name], mask) for name, mask in zip(MEASURED_COLUMNS, seen.T, strict=True)
        }
        for name in MEASURED_COLUMNS[3:]:
            if len(values := columns[name]) and np.ptp(values) == 0 and np.ptp(np.unwrap(columns["psi"])) > _TURNED:
                raise ValueError(f"{name} is {values[0]:g} in all rows, but the heading changes; it must be measured")
        t = columns["t"]
        t = t - t[0] if len(t) and t[0] > _EPOCH else t
        if not (runs := [slice(0, len(t))] if form is None else _without_gaps(t)):
            raise ValueError(f"the log has no {_MIN_ROWS} rows without a gap; {_ALLOWED}")
        rows = np.concatenate([np.arange(run.start, run.stop) for run in runs])
        if form and (len(rows) < len(t) or len(runs) > 1):
            notes.append(
                f"{len(runs)} runs without a gap of more than {_GAP} steps; {len(t) - len(rows)} of {len(t)} rows are "
                f"left out, in parts of fewer than {_MIN_ROWS}"
            )
        starts = np.cumsum([0, *(run.stop - run.start for run in runs[:-1])])

        def table(names: Iterable[str]) -> Array:
            return np.column_stack([columns[name][rows] for name in names])

        wind = table(WIND_COLUMNS) if columns.keys() >= {*WIND_COLUMNS} else None
        measured, commands = table(MEASURED_COLUMNS), table(CONTROLS[kind])
        counted = None if seen.all() else seen[rows]
        return cls(t[rows], measured, commands, kind, wind, tuple(starts.tolist()), counted, (*notes, *held))


def _seen(columns: Mapping[str, Array]) -> tuple[NDArray[np.bool_], list[str]]:
    """Return which measurements count, shape (T, 6), and sentences on the others.

    Those without a value do not count, nor outliers. Of values that are held the first one counts, and of values that
    are interpolated those between which they are.
    """
    table = np.column_stack([columns[name] for name in MEASURED_COLUMNS])
    seen, notes = np.isfinite(table), []
    fastest = float(np.nanquantile(np.hypot(table[:, 3], table[:, 4]), 0.99))  # [m/s]
    for names in (("x", "y"), *((name,) for name in MEASURED_COLUMNS[2:])):
        at = [MEASURED_COLUMNS.index(name) for name in names]
        rows, label = np.flatnonzero(seen[:, at].all(axis=1)), ", ".join(names)
        values = np.unwrap(table[rows][:, at], axis=0) if names == ("psi",) else table[rows][:, at]
        if len(values) > 1 and (often := repeated(values)) > 1:
            again = np.append(False, (np.diff(values, axis=0) == 0).all(axis=1))
            notes.append(f"{label} change in about every {often}. row only: each value counts once")
        elif (knots := _knots(values)) is not None:
            again = ~knots
            notes.append(f"{label} are interpolated between {np.count_nonzero(knots)} values: only these count")
        else:
            reach = 0.0
            if names == ("x", "y"):  # a place that the vehicle could not reach from fix to fix
                reach = _FAR * fastest * float(np.median(np.diff(columns["t"][rows]))) if len(rows) > 1 else 0.0
            again, frozen = _outliers(values, reach), _frozen(values)
            for found, what in ((again, "are far from those before and after"), (frozen, "repeat the row before")):
                if found.any():
                    first = rows[found][0] + 1
                    count = np.count_nonzero(found)
                    notes.append(f"{label}: {count} rows {what}, the first in data row {first}; they do not count")
            again = again | frozen
        seen[np.ix_(rows[again], at)] = False
    return seen, notes


def _knots(values: Array) -> NDArray[np.bool_] | None:
    """Return the rows between which values (T, n) are linear, None if they are not linear between some rows.

    Straight motion without noise is linear too, so such rows must come at equal distances, as fixes do.
    """
    if len(values) < _MIN_ROWS:
        return None
    steps = np.abs(np.diff(values, axis=0))
    bends = np.abs(np.diff(values, 2, axis=0))
    usual, least = np.median(steps, axis=0), np.array([_resolution(one) for one in values.T])
    bent = (bends > np.maximum(2.1 * least, 1e-6 * usual)).any(axis=1)
    every = np.diff(np.flatnonzero(bent))
    if (usual < 20 * least).any() or len(every) < 10 or (often := float(np.median(every))) < 2:
        return None
    return np.concatenate(([True], bent, [True])) if regular(every, often) else None


def _outliers(values: Array, reach: float) -> NDArray[np.bool_]:
    """Return the rows of values (T, n) that are far from the median of five, compared with usual changes; few or none.

    Up to two of five are then found: single wrong cells, and marks such as -999 for a missing value. They are also
    farther than `reach` away, or than several times the range of all other values, since a short manoeuvre changes a
    speed as suddenly.
    """
    if len(values) < _MIN_ROWS:
        return np.zeros(len(values), dtype=bool)
    away = np.abs(values - median_filter(values, (5, 1), mode="nearest"))
    usual = np.quantile(np.abs(np.diff(values, axis=0)), 0.95, axis=0)
    apart = away > _FAR * np.maximum(usual, 1e-9)
    others = np.where(apart, np.nan, values)
    limit = reach or _BEYOND * (np.nanmax(others, axis=0) - np.nanmin(others, axis=0))
    far: NDArray[np.bool_] = (apart & (away > limit)).any(axis=1)
    return far if 0 < np.mean(far) < _FEW else np.zeros(len(values), dtype=bool)


def _frozen(values: Array) -> NDArray[np.bool_]:
    """Return the rows of noisy values (T, n) that repeat the row before for long; a speed of 0 may be one at rest."""
    steps, bends = np.abs(np.diff(values, axis=0)), np.abs(np.diff(values, 2, axis=0))
    if len(values) < _MIN_ROWS or not (np.median(bends, axis=0) > 0.5 * np.median(steps, axis=0)).all():
        return np.zeros(len(values), dtype=bool)
    same = np.append(False, (steps == 0).all(axis=1))
    begins = np.flatnonzero(~same)
    lengths = np.diff(np.append(begins, len(same)))
    long = np.repeat((lengths > _FROZEN) & values[begins].any(axis=1), lengths)
    coarse = np.mean(same[~long]) >= _OFTEN
    return np.asarray(same & long & ~coarse)


def _resolution(values: Array) -> float:
    """Return the smallest difference of values, which is that of their digits if they have few."""
    apart = np.diff(np.unique(values))
    return float(np.min(apart, where=apart > 1e-9 * np.sum(apart), initial=np.inf)) if len(apart) else 0.0


def _filled(name: str, values: Array, seen: NDArray[np.bool_]) -> Array:
    """Return a measurement with values interpolated over the rows in which it does not count."""
    if seen.all() or not seen.any():
        return values
    rows = np.arange(len(values))
    known = np.unwrap(values[seen]) if name == "psi" else values[seen]
    return np.asarray(np.interp(rows, rows[seen], known))


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
    seen = None
    if any(log.seen is not None for log in logs):
        seen = np.concatenate([np.ones_like(log.measured, bool) if log.seen is None else log.seen for log in logs])
    notes = tuple(dict.fromkeys(note for log in logs for note in log.notes))
    return Log(t, measured, commands, logs[0].kind, wind, starts, seen, notes)


def unwrapped(log: Log) -> Array:
    """Return the measurements with a heading that does not jump by 2 pi within a run, shape (T, 6)."""
    measured = log.measured.copy()
    for run in log.runs:
        measured[run, 2] = np.unwrap(measured[run, 2])
    return measured


def _without_gaps(t: Array) -> list[slice]:
    """Return the rows of each part without a gap; parts that are too short for a run are omitted."""
    if len(t) < _MIN_ROWS:
        return []
    steps = np.diff(t)
    cuts = np.flatnonzero((steps > _GAP * np.median(steps)) | (steps <= 0)) + 1
    return [part for part in slices((0, *cuts), len(t)) if part.stop - part.start >= _MIN_ROWS]


def rough_noise(log: Log) -> Array:
    """Return standard deviations of the measurement noise from second differences, shape (6,)."""
    measured = unwrapped(log)
    noise = np.zeros(6)
    for j in range(6):
        parts = [measured[log.counted(run, j), j] for run in log.runs]
        bends = np.concatenate([np.diff(part, 2) for part in parts])
        if len(bends):
            usual = 1.4826 * np.median(np.abs(bends - np.median(bends))) / math.sqrt(6)
            noise[j] = max(usual, _resolution(np.concatenate(parts)) / math.sqrt(12))  # of rounding
    return np.asarray(np.maximum(noise, least_noise(log)))


def least_noise(log: Log) -> Array:
    """Return lower bounds of the standard deviations of the noise, a small share of the range, shape (6,)."""
    return np.asarray(np.maximum(_LEAST_NOISE * np.ptp(unwrapped(log), axis=0), 1e-9))

"""The log of a trial: measurements and commands, checked before a vehicle is fitted to them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.integrate import cumulative_trapezoid

from auv_gym.physics.namespaces import Array
from auv_gym.scenarios.records import guarded
from baselines.identification.columns import QUANTITIES, Format, standard_columns

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
_MAX_ENTRY = 1e12  # largest magnitude of an entry
_MIN_MOTION = 1e-6  # least peak velocity [m/s], [rad/s] of a log, and least range of its commands
_LEAST_NOISE = 1e-6  # as a share of the range of a measurement
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
            name, value = CONTROLS[self.kind][0], self.commands[0, 0]
            raise ValueError(f"{name} is {value:g} throughout; the commands must change during the log")
        if self.kind == "force" and not self.commands[:, 1].any():
            _, _, psi, _, _, r = self.measured.T
            if r.std() > 3 * rough_noise(self)[5] + 1e-9 and np.ptp(np.unwrap(psi)) > 0.5:
                raise ValueError("F_r is 0 throughout, but the vehicle turns: log the commanded yaw moments")
        for run in self.runs:
            _check_units(self.t[run], self.measured[run])

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
        np.savetxt(file, self.table, "%.9g", ",", header=",".join(self.columns), comments="", encoding="utf-8")

    @classmethod
    def load(cls, file: str | Path, form: Format | None = None) -> Log:
        """Return the log in a file; without a format it must be a CSV file, see `columns.standard_columns`.

        Its columns are t, those of `MEASURED_COLUMNS`, those of one kind in `CONTROLS`, and optionally those of
        `WIND_COLUMNS`. With a format, gaps divide the log into runs.

        Raises:
            ValueError: the file is not a table of numbers, a column is missing or has the wrong unit, or the log is
                invalid.
            OSError: the file cannot be read.
        """
        with guarded(str(file)):
            return cls._of_columns(standard_columns(Path(file), _COLUMNS) if form is None else form.read(file), form)

    @classmethod
    def _of_columns(cls, columns: Mapping[str, Array], form: Format | None) -> Log:
        """Return the log of columns, by name; with a format in runs without gaps."""
        kind = next((kind for kind, names in CONTROLS.items() if columns.keys() >= {*names}), "force")
        needed = ("t", *MEASURED_COLUMNS, *CONTROLS[kind])
        if missing := [name for name in needed if name not in columns]:
            expected = ", ".join(f"{name} [{QUANTITIES[name]}]" for name in needed)
            raise ValueError(f"there is no column {missing[0]!r}; the first line must name {expected}")
        t = columns["t"]
        if not (runs := [slice(0, len(t))] if form is None else _without_gaps(t)):
            raise ValueError(f"the log has no {_MIN_ROWS} rows without a gap; it must have {_MIN_ROWS} to {_MAX_ROWS}")
        rows = np.concatenate([np.arange(run.start, run.stop) for run in runs])
        starts = np.cumsum([0, *(run.stop - run.start for run in runs[:-1])])

        def table(names: Iterable[str]) -> Array:
            return np.column_stack([columns[name][rows] for name in names])

        wind = table(WIND_COLUMNS) if columns.keys() >= {*WIND_COLUMNS} else None
        measured, commands = table(MEASURED_COLUMNS), table(CONTROLS[kind])
        return cls(t[rows], measured, commands, kind, wind, tuple(starts.tolist()))


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
    bends = np.concatenate([np.diff(measured[run], 2, axis=0) for run in log.runs])
    noise = 1.4826 * np.median(np.abs(bends - np.median(bends, axis=0)), axis=0) / math.sqrt(6)
    return np.asarray(np.maximum(noise, least_noise(log)))


def least_noise(log: Log) -> Array:
    """Return lower bounds of the standard deviations of the noise, a small share of the range, shape (6,)."""
    return np.asarray(np.maximum(_LEAST_NOISE * np.ptp(unwrapped(log), axis=0), 1e-9))


def _check_units(t: Array, measured: Array) -> None:
    """Raise ValueError if positions, heading and speeds contradict each other, as with wrong units or axes.

    The changes of position and heading over one second are compared with the integrals of the velocities.
    """
    x, y, psi, u, v, r = measured.T
    step = max(1, round(1 / float(np.median(np.diff(t)))))

    def change(values: Array) -> Array:
        return values[step:] - values[:-step]

    def integral(rate: Array) -> Array:
        return change(cumulative_trapezoid(rate, t, initial=0.0))

    turned, wrapped, integrated = change(np.unwrap(psi)), change(psi), integral(r)
    degree = math.pi / 180
    if integrated.std() > 0:
        if abs(_slope(integrated, wrapped) * degree - 1) < 0.3 and abs(_slope(integrated, turned) - 1) > 0.3:
            raise ValueError("psi changes 57 times as fast as r: it looks like degrees; it must be in [rad]")
        if abs(_slope(turned, integrated) * degree - 1) < 0.3:
            raise ValueError("r is 57 times the rate of psi: it looks like degrees; it must be in [rad/s]")
    moved = np.concatenate((change(x), change(y)))
    speed = float(np.hypot(u, v).mean())
    if speed * (t[-1] - t[0]) < 1.0 or moved.std() == 0:
        return  # too little motion for a comparison

    def unexplained(heading: Array, north: Array, east: Array) -> float:
        """Return the share of the squared displacement that the velocities do not explain."""
        c, s = np.cos(heading), np.sin(heading)
        expected = np.concatenate([integral(w) for w in (u * c - v * s, u * s + v * c)])
        actual = np.concatenate((change(north), change(east)))
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
    along = _slope(np.hypot(integral(u), integral(v)), np.hypot(*np.split(moved, 2)))
    if not 0.7 < along < 1.4:
        hint = ": u and v look like knots" if 0.48 < along < 0.56 else ""
        raise ValueError(f"positions change {along:.3g} times as fast as u and v{hint}; both must be in SI units")


def _slope(x: Array, y: Array) -> float:
    """Return the slope of the line through the origin that explains y by x with the least squared error."""
    return float(x @ y / max(float(x @ x), 1e-300))

"""The columns of a log's file, in SI units: of a CSV file with the standard columns, or of a file of any other format.

A format is a TOML file with the fields of `Format`; docs/identify.md has an example.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import numpy as np

from auv_gym.physics.errors import to_body
from auv_gym.physics.intervals import check_number
from auv_gym.physics.namespaces import Array, Indices
from auv_gym.planning.paths.waypoints import EQUATOR, FLATTENING
from auv_gym.scenarios.records import from_record, read_table
from baselines.tools.files import read_bytes

FORMATS_FOLDER = Path(__file__).parent / "formats"
"""Folder of the included formats, NAME.toml."""
_DEGREE = math.pi / 180
UNITS: Mapping[str, Mapping[str, float]] = {
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0},
    "m": {"m": 1.0, "km": 1e3, "ft": 0.3048},
    "rad": {"rad": 1.0, "deg": _DEGREE},
    "m/s": {"m/s": 1.0, "knots": 1852 / 3600, "km/h": 1 / 3.6},
    "rad/s": {"rad/s": 1.0, "deg/s": _DEGREE, "deg/min": _DEGREE / 60},
    "N": {"N": 1.0, "kN": 1e3},
    "N m": {"N m": 1.0, "kN m": 1e3},
    "1/s": {"1/s": 1.0, "rpm": 1 / 60, "rad/s": 0.5 / math.pi},
    "1": {"1": 1.0},
}
"""Allowed units of a column and their factors, by SI unit."""
_SPELLINGS: Mapping[str, str] = {
    "sec": "s", "second": "s", "seconds": "s", "msec": "ms", "millisecond": "ms", "milliseconds": "ms", "µs": "us",
    "microseconds": "us", "nsec": "ns", "nanoseconds": "ns", "minutes": "min", "hours": "h", "metre": "m",
    "metres": "m", "meter": "m", "meters": "m", "feet": "ft", "radian": "rad", "radians": "rad", "°": "deg",
    "degree": "deg", "degrees": "deg", "m/sec": "m/s", "mps": "m/s", "kn": "knots", "kt": "knots", "kts": "knots",
    "knot": "knots", "kmh": "km/h", "kph": "km/h", "rad/sec": "rad/s", "°/s": "deg/s", "deg/sec": "deg/s",
    "dps": "deg/s", "newton": "N", "newtons": "N", "nm": "N m", "knm": "kN m", "hz": "1/s", "rps": "1/s",
    "rev/s": "1/s", "rev/min": "rpm", "r/min": "rpm",
}  # fmt: skip
"""Usual spellings of units, in lower case and without spaces, stars, dots and hyphens."""
QUANTITIES: Mapping[str, str] = {
    "t": "s", "x": "m", "y": "m", "latitude": "rad", "longitude": "rad", "psi": "rad", "u": "m/s", "v": "m/s",
    "r": "rad/s", "F_u": "N", "F_r": "N m", "thrust": "N", "revolutions": "1/s", "rudder": "rad", "W_x": "m/s",
    "W_y": "m/s", "wind_speed": "m/s", "wind_from": "rad", "port": "N", "starboard": "N", "q_w": "1", "q_x": "1",
    "q_y": "1", "q_z": "1",
}  # fmt: skip
"""Quantities that a column may have, with their SI units."""
_HELD = ("F_u", "F_r", "thrust", "revolutions", "rudder", "port", "starboard", "W_x", "W_y")  # until the next row
_STAMPS = ((1e17, "ns"), (1e14, "us"), (1e11, "ms"))  # least time [s] that looks like another unit since 1970
_NOTHING = ("", "nan", "na", "null", "none", "-")  # cells without a value, in lower case
_NUMBERS = r"[-+\d.,;\seE:TZ]*"  # a row without names
_DAY = 86400.0  # [s]
_RESET = 10  # multiple of the usual step by which time goes back where a run begins
_NEAR = 0.2  # share of the usual time between two values within which rows are one
_SAME = 10  # fewest changes of values that are held for rows


@dataclass(frozen=True)
class LogColumn:
    """The column of a quantity in a log.

    Raises:
        ValueError: the column is neither a name nor a number from 1 on, or the scale is not a number.
    """

    column: str | int  # its name, or its number from 1 on
    unit: str = ""  # "" for the SI unit
    scale: float = 1.0  # additional factor
    offset: float = 0.0  # entry that means 0, subtracted before the scaling, such as 1500 us of a pulse
    dead_band: float = 0.0  # distance from it, in the unit of the entry, within which the actuator gives nothing

    def __post_init__(self) -> None:
        if isinstance(self.column, bool) or not (isinstance(self.column, str) or 1 <= self.column <= 10_000):
            raise ValueError(f"column is {self.column!r}; it must be a name or a number from 1 on")
        check_number("column scale", self.scale, -1e9, 1e9)
        check_number("column offset", self.offset, -1e12, 1e12)
        check_number("column dead_band", self.dead_band, 0, 1e12)

    def si(self, entries: Array, quantity: str) -> Array:
        """Return entries in the SI unit of a quantity."""
        value = entries - self.offset
        if self.dead_band:
            value = np.sign(value) * np.maximum(np.abs(value) - self.dead_band, 0.0)
        unit = QUANTITIES[quantity]
        return np.asarray(value * (UNITS[unit][unit_named(self.unit, unit)] * self.scale))


@dataclass(frozen=True)
class Table:
    """The columns of a log by quantity, in SI units, axes NED and body velocities, shape (T,) each."""

    columns: Mapping[str, Array]  # nan: there is no value
    notes: tuple[str, ...] = ()  # what does not count, and why


@dataclass(frozen=True)
class Format:
    """The format of a log.

    Raises:
        ValueError: an entry is not allowed, or a quantity or unit of a column is unknown.
    """

    columns: Mapping[str, Any]  # by quantity, see `LogColumn`
    about: str = ""
    skip: int = 1  # lines before the data; the first one has the names of the columns
    separator: str = ","  # "space" for any white space
    decimal: str = "."  # or ","
    encoding: str = "utf-8-sig"
    every: float = 0.0  # [s] time between the rows that are kept; 0: all rows
    lever: float = 0.0  # [m] distance of the thrusters `port` and `starboard` from the centre line
    velocity: str = "body"  # axes of u and v: "body", or "world" for those of x and y
    axes: str = "NED"  # x north, y east, psi clockwise; "ENU": x east, y north, psi anticlockwise from east

    def __post_init__(self) -> None:
        choices = ("velocity", ("body", "world")), ("axes", ("NED", "ENU")), ("decimal", (".", ","))
        for name, allowed in choices:
            if getattr(self, name) not in allowed:
                raise ValueError(
                    f"format {name} is {getattr(self, name)!r}; allowed are {', '.join(map(repr, allowed))}"
                )
        if isinstance(self.skip, bool) or not isinstance(self.skip, int) or not 0 <= self.skip <= 1000:
            raise ValueError(f"format skip is {self.skip!r}; it must be an integer from 0 to 1000")
        if self.separator != "space" and not (isinstance(self.separator, str) and len(self.separator) == 1):
            raise ValueError(f"format separator is {self.separator!r}; it must be one character, or 'space'")
        if self.separator == self.decimal:
            raise ValueError(f"format separator and decimal are both {self.decimal!r}; one of them must be another")
        check_number("format every", self.every, 0, 1e4)
        check_number("format lever", self.lever, 0, 1e3)
        if {"port", "starboard"} & {*self.columns} and not self.lever:
            raise ValueError("format has port or starboard, but no lever, the distance from the centre line [m]")
        if unknown := [name for name in self.columns if name not in QUANTITIES]:
            raise ValueError(f"format has a column {unknown[0]!r}; allowed are {', '.join(QUANTITIES)}")
        for name, entry in self.columns.items():
            unit, units = _column(entry).unit, UNITS[QUANTITIES[name]]
            if unit_named(unit, QUANTITIES[name]) not in units:
                raise ValueError(f"{name} is in {unit!r}; allowed are {', '.join(units)}")

    @classmethod
    def named(cls, name: str) -> Format:
        """Return an included format by name, or the format of a .toml file.

        Raises:
            ValueError: there is no such format, or its file is invalid.
            OSError: the file cannot be read.
        """
        known = sorted(file.stem for file in FORMATS_FOLDER.glob("*.toml"))
        if name not in known and not name.endswith(".toml"):
            raise ValueError(f"unknown format {name!r}; allowed are a .toml file, or one of {', '.join(known)}")
        file = FORMATS_FOLDER / f"{name}.toml" if name in known else Path(name)
        return from_record(cls, read_table(file), f"format {name}", {"columns": dict})

    @classmethod
    def of_first_line(cls, file: Path, names: Collection[str]) -> Format:
        """Return the format of a file whose first line has the names of the columns, with units in brackets or without.

        Other columns are ignored. The separator is the most frequent one of comma, semicolon and tab.

        Raises:
            ValueError: the file is not text, or a column is there twice or has an unknown unit.
            OSError: the file cannot be read.
        """
        lines = _lines(file, "utf-8-sig")
        skip = next((k for k, line in enumerate(lines) if not line.startswith("#")), 0)
        if skip == 0 or not re.fullmatch(_NUMBERS, lines[skip]):
            skip += 1  # else the last comment names the columns
        head, first = [*(line.lstrip("# ") for line in lines[skip - 1 :]), "", ""][:2]
        separator = max(",;\t", key=head.count)
        if head.count(separator) == 0 and len(head.split()) > 1:
            separator = "space"
        decimal = "," if separator != "," and re.search(r"\d,\d", first) else "."
        columns: dict[str, Any] = {}
        for place, text in enumerate(cls({}, separator=separator, decimal=decimal)._split([head])[0] if head else []):
            match = re.fullmatch(r"\s*(\w*)\s*(?:[\[(](.*)[\])])?\s*", text)
            if match is None or match[1] not in names:
                continue
            if match[1] in columns:
                raise ValueError(f"there is more than one column {match[1]!r}; remove all but one")
            columns[match[1]] = {"column": place + 1, "unit": match[2] or ""}
        return cls(columns, skip=skip, separator=separator, decimal=decimal)

    @property
    def hints(self) -> str:
        """What to look at first where columns contradict each other."""
        found = {
            "psi comes from the quaternion: look at the order of its columns first": "q_w" in self.columns,
            "F_r comes from port and starboard: look whether they are exchanged first": "port" in self.columns,
            'axes is "ENU": leave it out if psi is a compass heading': self.axes == "ENU",
        }
        return "".join(f" ({hint})" for hint, here in found.items() if here)

    def read(self, file: str | Path) -> Table:
        """Return the columns of a log. A cell that is empty, nan or not a number has no value; a command is then held.

        Rows without a time are left out.

        Raises:
            ValueError: the file is not text, a column is missing, or most of its cells are not numbers.
            OSError: the file cannot be read.
        """
        lines = _lines(Path(file), self.encoding)
        heads, rows = self._split(lines[: min(self.skip, 1)]), self._split(lines[self.skip :])
        names = [head.strip() for head in heads[0]] if heads else []
        places = {name: _place(name, _column(entry).column, names) for name, entry in self.columns.items()}
        cells = [[row[place].strip() if place < len(row) else "" for place in places.values()] for row in rows]
        cells = [row for row in cells if any(row)]
        texts = {name: [row[k] for row in cells] for k, name in enumerate(places)}
        numbers = {name: np.array([self._number(name, cell) for cell in column]) for name, column in texts.items()}
        notes = [*_left_out(rows, cells), *_unread(texts, numbers)]
        columns = {name: _column(entry).si(numbers[name], name) for name, entry in self.columns.items()}
        kept = np.isfinite(columns["t"]) if "t" in columns else np.ones(len(cells), dtype=bool)
        columns, more = _in_order({name: values[kept] for name, values in columns.items()})
        notes += more
        for t in columns.get("t", ())[:1]:
            if looks_like := next((unit for least, unit in _STAMPS if t > least), None):
                raise ValueError(
                    f"t begins at {t:.3g} s, which looks like {looks_like} since 1970; name the unit: "
                    f"t [{looks_like}] in the first line, or unit = {looks_like!r} in a format"
                )
        columns |= {name: _held(columns[name]) for name in _HELD if name in columns}
        notes += _without_place(columns)
        table = _in_standard_axes(columns, self)
        if self.axes == "ENU" or "latitude" in self.columns:
            notes.append("axes of the result: x north, y east, psi clockwise; V_x is the current to the north")
        return Table(_thinned(table, self.every), tuple(notes))

    def _number(self, name: str, cell: str) -> float:
        """Return the number in a cell, nan if there is none; for t also a date of ISO 8601 or a time of day, in [s]."""
        with suppress(ValueError):
            return float(cell if self.decimal == "." else cell.replace(",", "."))
        with suppress(ValueError):
            if name == "t":
                if day := re.fullmatch(r"(\d\d?):(\d\d):(\d\d(?:\.\d*)?)", cell):
                    return 3600.0 * int(day[1]) + 60.0 * int(day[2]) + float(day[3])
                date = datetime.fromisoformat(cell.replace("Z", "+00:00"))
                return (date if date.tzinfo else date.replace(tzinfo=timezone.utc)).timestamp()
        return math.nan

    def _split(self, lines: Sequence[str]) -> list[list[str]]:
        if self.separator == "space":
            return [line.split() for line in lines if line.strip()]
        return [row for row in csv.reader(lines, delimiter=self.separator) if row]


def _column(entry: Any) -> LogColumn:
    return from_record(LogColumn, entry if isinstance(entry, Mapping) else {"column": entry}, "column")


def _place(quantity: str, column: str | int, names: Sequence[str]) -> int:
    if isinstance(column, int):
        return column - 1
    if names.count(column) != 1:
        many = "no column" if column not in names else "more than one column"
        raise ValueError(f"there is {many} {column!r} for {quantity}; the first line names {', '.join(names)}")
    return names.index(column)


def unit_named(text: str, si: str) -> str:
    """Return the name of a unit in `UNITS` for one of its usual spellings; "" is the SI unit `si`."""
    if not text or text in UNITS[si]:
        return text or si
    plain = re.sub(r"[\s*·.\-]", "", text).lower()
    return _SPELLINGS.get(plain, next((unit for unit in UNITS[si] if unit.lower().replace(" ", "") == plain), text))


def _lines(file: Path, encoding: str) -> list[str]:
    """Return the lines of a text; a byte order mark tells UTF-16.

    Raises:
        ValueError: the file is not text in the encoding.
    """
    data = read_bytes(file)
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        encoding = "utf-16"
    elif b"\0" in data[:100] and not (any(data[:100:2]) and any(data[1:100:2])) and encoding.startswith("utf-8"):
        raise ValueError(
            "the file looks like UTF-16 without a byte order mark; give a format with encoding = 'utf-16-le'"
        )
    elif (b"\0" in data[:100] or data[:2] in (b"PK", b"\x1f\x8b")) and encoding.startswith("utf-8"):
        raise ValueError("it is no text but a spreadsheet, an archive or a binary log; export it as CSV")
    try:
        return data.decode(encoding).splitlines()
    except (UnicodeDecodeError, LookupError) as error:
        hint = "; give a format with encoding = 'latin-1', or that of the file" if encoding.startswith("utf-8") else ""
        raise ValueError(f"it is not text in {encoding}: {error}{hint}") from error


def _left_out(rows: Sequence[Any], kept: Sequence[Any]) -> list[str]:
    count = len(rows) - len(kept)
    return [f"{count} of {len(rows)} rows are blank and left out"] if count else []


def _unread(table: Mapping[str, Sequence[str]], numbers: Mapping[str, Array]) -> list[str]:
    """Return sentences on the cells without a number; raise ValueError if most of a column's are other text."""
    notes, blank = [], dict[int, list[str]]()
    for name, cells in table.items():
        missing = np.flatnonzero(~np.isfinite(numbers[name])).tolist()
        wrong = [k for k in missing if cells[k].lower() not in _NOTHING]
        if wrong:
            first = f"{name} in data row {wrong[0] + 1} is {cells[wrong[0]][:60]!r}"
            if 2 * len(wrong) > len(cells):
                comma = re.fullmatch(r"[+-]?\d+,\d+", cells[wrong[0]])
                hint = '; for decimal commas give a format with decimal = ","' if comma else ""
                raise ValueError(f"{first}; it must be a number{hint}")
            notes.append(f"{first}, not a number; {len(wrong)} of {len(cells)} rows have such a cell and no value")
        if len(missing) > len(wrong):
            blank.setdefault(len(missing) - len(wrong), []).append(name)
    for count, names in blank.items():
        notes.append(f"{', '.join(names)}: blank in {count} of {len(next(iter(table.values())))} rows")
    return notes


def _in_order(columns: dict[str, Array]) -> tuple[dict[str, Array], list[str]]:
    """Return columns whose time increases, and sentences on what was done.

    Rows that are out of order are sorted; a large step back begins a run. Rows nearer than a fifth of the usual time
    between two values of a column are one: stamps that are doubled, and messages of several sensors in a burst.
    """
    if len(t := columns.get("t", np.empty(0))) < 3:
        return columns, []
    notes, usual = [], float(np.median(np.abs(np.diff(t))))
    if len(midnights := np.flatnonzero(np.abs(np.diff(t) + _DAY) < max(60.0, 10 * usual)) + 1):
        t = t + _DAY * (np.searchsorted(midnights, np.arange(len(t)), side="right"))
        notes.append(f"t begins again at midnight in data row {midnights[0] + 1}; a day is added")
    run = np.cumsum(np.diff(t, prepend=t[0]) < -_RESET * usual)
    order = np.lexsort((t, run))
    if late := int(np.count_nonzero((np.diff(t) < 0) & (np.diff(run) == 0))):
        notes.append(f"t goes back {late} times within a run: its rows are sorted")
    table = {name: values[order] for name, values in {**columns, "t": t}.items()}
    values = [table["t"][np.isfinite(column)] for name, column in table.items() if name != "t"]
    period = min((float(np.median(np.abs(np.diff(one)))) for one in values if len(one) > 2), default=0.0)
    step = np.diff(table["t"])
    near = np.append(False, (step >= 0) & (step <= _NEAR * period) & (np.diff(run) == 0))
    if not near.any():
        return table, notes
    notes.append(f"{np.count_nonzero(near)} rows are within {_NEAR * period:.2g} s of the row before: merged with it")
    groups, rows = np.flatnonzero(~near), np.arange(len(near))

    def merged(name: str, values: Array) -> Array:
        """Return the last command or the first measurement of each group."""
        known = np.isfinite(values)
        if name in _HELD:
            at = np.maximum.reduceat(np.where(known, rows, -1), groups)
            return np.where(at >= 0, values[at], np.nan)
        at = np.minimum.reduceat(np.where(known, rows, len(rows)), groups)
        return np.where(at < len(rows), values[np.minimum(at, len(rows) - 1)], np.nan)

    return {name: merged(name, values) for name, values in table.items()}, notes


def _without_place(columns: dict[str, Array]) -> list[str]:
    """Remove positions at latitude and longitude 0, which receivers write without a fix; return sentences on that."""
    if not {"latitude", "longitude"} <= columns.keys():
        return []
    for name, most in (("latitude", 0.5 * math.pi), ("longitude", 2 * math.pi)):
        if len(wrong := np.flatnonzero(np.abs(columns[name]) > most)):
            value = math.degrees(columns[name][wrong[0]])
            raise ValueError(
                f"{name} is {value:.6g} degrees in a row; it must be in [-{math.degrees(most):g}, "
                f"{math.degrees(most):g}]: are the columns exchanged, or is the unit another one?"
            )
    none = (columns["latitude"] == 0) & (columns["longitude"] == 0)
    for name in ("latitude", "longitude"):
        columns[name] = np.where(none, np.nan, columns[name])
    return [f"latitude and longitude are 0 in {none.sum()} rows: no fix"] if none.any() else []


def _held(values: Array) -> Array:
    """Return commands in which a missing one is the last one before it."""
    known = np.isfinite(values)
    last = np.maximum.accumulate(np.where(known, np.arange(len(values)), -1))
    return np.where(last >= 0, values[last], np.nan)


def repeated(values: Array) -> int:
    """Return the number of rows for which each value of a measurement is held, 1 if values are not held.

    Args:
        values: one measurement, or several that come together, shape (T,) or (T, n).
    """
    changes = np.flatnonzero((np.diff(values, axis=0) != 0).reshape(len(values) - 1, -1).any(axis=1))
    if len(changes) <= _SAME:
        return 1
    lengths = np.diff(changes)
    usual = int(np.median(lengths))
    return usual if usual > 1 and regular(lengths, usual) else 1


def regular(lengths: Array | Indices, usual: float) -> bool:
    """Return whether most lengths are near the usual one, as those between fixes are."""
    return bool(np.mean(np.abs(lengths - usual) < 0.35 * usual) > 0.8)


def _in_standard_axes(columns: Mapping[str, Array], form: Format) -> dict[str, Array]:
    """Return columns with positions on a plane, wind vectors, axes NED and velocities in the body frame."""
    table, world = dict(columns), form.velocity == "world"
    if "wind_speed" in table and "wind_from" in table:
        speed, angle = table.pop("wind_speed"), table.pop("wind_from")
        table["W_x"], table["W_y"] = -speed * np.cos(angle), -speed * np.sin(angle)
    if {"q_w", "q_z"} <= table.keys():
        w, z = table.pop("q_w"), table.pop("q_z")
        x, y = (table.pop(name, 0.0 * w) for name in ("q_x", "q_y"))
        table["psi"] = np.arctan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z)
    if form.axes == "ENU":
        for one, other in (("x", "y"), ("W_x", "W_y"), *([("u", "v")] if world else [])):
            if one in table and other in table:
                table[one], table[other] = table[other], table[one]
        if "psi" in table:
            table["psi"] = 0.5 * math.pi - table["psi"]
        turned = ("r", "F_r", "rudder", "" if world else "v")
        table |= {name: -table[name] for name in turned if name in table}
    if "latitude" in table and "longitude" in table:
        table["x"], table["y"] = _on_plane(table.pop("latitude"), table.pop("longitude"))
    if world and {"u", "v", "psi"} <= table.keys():
        table["u"], table["v"] = to_body(table["u"], table["v"], np.cos(table["psi"]), np.sin(table["psi"]))
    if {"port", "starboard"} <= table.keys():
        port, starboard = table.pop("port"), table.pop("starboard")
        table["F_u"], table["F_r"] = port + starboard, form.lever * (port - starboard)
    return table


def _on_plane(latitude: Array, longitude: Array) -> tuple[Array, Array]:
    """Return the distances [m] north and east of the first position, by the radii of curvature of the ellipsoid."""
    if not (known := np.isfinite(latitude)).any():
        return latitude, longitude
    first = int(np.argmax(known))
    squared = FLATTENING * (2 - FLATTENING)  # squared eccentricity
    root = math.sqrt(1 - squared * math.sin(latitude[first]) ** 2)
    north, east = EQUATOR * (1 - squared) / root**3, EQUATOR / root * math.cos(latitude[first])
    around = np.remainder(longitude - longitude[first] + math.pi, 2 * math.pi) - math.pi
    return north * (latitude - latitude[first]), east * around


def _thinned(columns: dict[str, Array], every: float) -> dict[str, Array]:
    """Return measurements about `every` [s] apart, from the first row that has all of them.

    Rows in which a command changes and rows a fifth of this apart stay, without measurements. If commands change in
    most rows, as measured rudder angles do, they are averaged until the next row.
    """
    if every == 0 or "t" not in columns or len(columns["t"]) < 2:
        return columns
    t, held = columns["t"], [name for name in columns if name in _HELD]
    whole = np.isfinite(np.column_stack([v for name, v in columns.items() if name not in held])).all(axis=1)
    bins, fine = (
        np.diff(np.floor((t - t[np.argmax(whole)]) / apart + 1e-6), prepend=-np.inf) > 0 for apart in (every, every / 5)
    )
    commands = np.column_stack([np.zeros(len(t)), *(columns[name] for name in held)])
    changes = np.append(False, (np.diff(commands, axis=0) != 0).any(axis=1))
    if changes.mean() <= 0.5:
        kept = bins | fine | changes
        return {n: (v if n in (*held, "t") else np.where(bins, v, np.nan))[kept] for n, v in columns.items()}
    rows = np.flatnonzero(bins)
    lengths = np.diff(np.append(rows, len(t)))
    return {n: np.add.reduceat(v, rows) / lengths if n in held else v[rows] for n, v in columns.items()}

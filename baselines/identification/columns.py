"""The columns of a log's file, in SI units: of a CSV file with the standard columns, or of a file of any other format.

A format is a TOML file with the fields of `Format`; docs/identify.md has an example.
"""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from auv_gym.physics.errors import to_body
from auv_gym.physics.intervals import check_number
from auv_gym.physics.namespaces import Array
from auv_gym.scenarios.records import from_record, guarded, read_table
from baselines.tools.files import read_bytes

FORMATS_FOLDER = Path(__file__).parent / "formats"
"""Folder of the included formats, NAME.toml."""
_DEGREE = math.pi / 180
UNITS: Mapping[str, Mapping[str, float]] = {
    "s": {"s": 1.0, "ms": 1e-3, "min": 60.0, "h": 3600.0},
    "m": {"m": 1.0, "km": 1e3, "ft": 0.3048},
    "rad": {"rad": 1.0, "deg": _DEGREE},
    "m/s": {"m/s": 1.0, "knots": 1852 / 3600, "km/h": 1 / 3.6},
    "rad/s": {"rad/s": 1.0, "deg/s": _DEGREE, "deg/min": _DEGREE / 60},
    "N": {"N": 1.0, "kN": 1e3},
    "N m": {"N m": 1.0, "kN m": 1e3},
    "1/s": {"1/s": 1.0, "rpm": 1 / 60, "rad/s": 0.5 / math.pi},
}
"""Allowed units of a column and their factors, by SI unit."""
QUANTITIES: Mapping[str, str] = {
    "t": "s", "x": "m", "y": "m", "latitude": "rad", "longitude": "rad", "psi": "rad", "u": "m/s", "v": "m/s",
    "r": "rad/s", "F_u": "N", "F_r": "N m", "thrust": "N", "revolutions": "1/s", "rudder": "rad", "W_x": "m/s",
    "W_y": "m/s", "wind_speed": "m/s", "wind_from": "rad",
}  # fmt: skip
"""Quantities that a column may have, with their SI units."""
_HELD = ("F_u", "F_r", "thrust", "revolutions", "rudder", "W_x", "W_y")  # until the next row
_EQUATOR, _FLATTENING = 6378137.0, 1 / 298.257223563  # [m] WGS 84


@dataclass(frozen=True)
class LogColumn:
    """The column of a quantity in a log.

    Raises:
        ValueError: the column is neither a name nor a number from 1 on, or the scale is not a number.
    """

    column: str | int  # its name, or its number from 1 on
    unit: str = ""  # "" for the SI unit
    scale: float = 1.0  # additional factor

    def __post_init__(self) -> None:
        if isinstance(self.column, bool) or not (isinstance(self.column, str) or 1 <= self.column <= 10_000):
            raise ValueError(f"column is {self.column!r}; it must be a name or a number from 1 on")
        check_number("column scale", self.scale, -1e9, 1e9)


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
    encoding: str = "utf-8-sig"
    every: float = 0.0  # [s] time between the rows that are kept; 0: all rows
    velocity: str = "body"  # axes of u and v: "body", or "world" for those of x and y
    axes: str = "NED"  # x north, y east, psi clockwise; "ENU": x east, y north, psi anticlockwise from east

    def __post_init__(self) -> None:
        for name, allowed in (("velocity", ("body", "world")), ("axes", ("NED", "ENU"))):
            if getattr(self, name) not in allowed:
                raise ValueError(f"format {name} is {getattr(self, name)!r}; allowed are {', '.join(allowed)}")
        if isinstance(self.skip, bool) or not isinstance(self.skip, int) or not 0 <= self.skip <= 1000:
            raise ValueError(f"format skip is {self.skip!r}; it must be an integer from 0 to 1000")
        if self.separator != "space" and not (isinstance(self.separator, str) and len(self.separator) == 1):
            raise ValueError(f"format separator is {self.separator!r}; it must be one character, or 'space'")
        check_number("format every", self.every, 0, 1e4)
        if unknown := [name for name in self.columns if name not in QUANTITIES]:
            raise ValueError(f"format has a column {unknown[0]!r}; allowed are {', '.join(QUANTITIES)}")
        for name, entry in self.columns.items():
            units = UNITS[QUANTITIES[name]]
            if (unit := _column(entry).unit) and unit not in units:
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

    def read(self, file: str | Path) -> dict[str, Array]:
        """Return the columns of a log by quantity, in SI units, axes NED and body velocities, shape (T,) each.

        Rows in which a column is empty or not a number are omitted.

        Raises:
            ValueError: the file is not text, or a column is missing.
            OSError: the file cannot be read.
        """
        try:
            lines = read_bytes(Path(file)).decode(self.encoding).splitlines()
        except (UnicodeDecodeError, LookupError) as error:
            raise ValueError(f"{file} is not text in {self.encoding}: {error}") from error
        heads, rows = self._split(lines[: min(self.skip, 1)]), self._split(lines[self.skip :])
        names = [head.strip() for head in heads[0]] if heads else []
        entries = {name: _column(entry) for name, entry in self.columns.items()}
        places = [_place(name, entry.column, names) for name, entry in entries.items()]
        table = np.array([[_number(row, place) for place in places] for row in rows]).reshape(-1, len(places))
        table = table[np.isfinite(table).all(axis=1)]
        columns = {}
        for (name, entry), values in zip(entries.items(), table.T, strict=True):
            unit = QUANTITIES[name]
            columns[name] = values * (UNITS[unit][entry.unit or unit] * entry.scale)
        return _thinned(_in_standard_axes(columns, self), self.every)

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


def _number(row: Sequence[str], place: int) -> float:
    try:
        return float(row[place])
    except (ValueError, IndexError):
        return math.nan


def _in_standard_axes(columns: Mapping[str, Array], form: Format) -> dict[str, Array]:
    """Return columns with positions on a plane, wind vectors, axes NED and velocities in the body frame."""
    table, world = dict(columns), form.velocity == "world"
    if "wind_speed" in table and "wind_from" in table:
        speed, angle = table.pop("wind_speed"), table.pop("wind_from")
        table["W_x"], table["W_y"] = -speed * np.cos(angle), -speed * np.sin(angle)
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
    return table


def _on_plane(latitude: Array, longitude: Array) -> tuple[Array, Array]:
    """Return the distances [m] north and east of the first position, by the radii of curvature of the ellipsoid."""
    if len(latitude) == 0:
        return latitude, longitude
    squared = _FLATTENING * (2 - _FLATTENING)  # squared eccentricity
    root = math.sqrt(1 - squared * math.sin(latitude[0]) ** 2)
    north, east = _EQUATOR * (1 - squared) / root**3, _EQUATOR / root * math.cos(latitude[0])
    return north * (latitude - latitude[0]), east * (longitude - longitude[0])


def _thinned(columns: dict[str, Array], every: float) -> dict[str, Array]:
    """Return rows about `every` [s] apart; commands and wind are averaged until the next row."""
    if every == 0 or "t" not in columns or len(columns["t"]) < 2:
        return columns
    t = columns["t"]
    rows = np.flatnonzero(np.diff(np.floor((t - t[0]) / every + 1e-6), prepend=-1))
    lengths = np.diff(np.append(rows, len(t)))
    return {
        name: np.add.reduceat(values, rows) / lengths if name in _HELD else values[rows]
        for name, values in columns.items()
    }


def standard_columns(file: Path, names: Collection[str]) -> dict[str, Array]:
    """Return those of some columns that a CSV file has, in SI units, shape (T,) each.

    The first line has the names of the columns, each with its unit in brackets or without. Other columns are ignored.

    Raises:
        ValueError: the file is no CSV, or a column has another unit, is there twice or has an entry that is no number.
        OSError: the file cannot be read.
    """
    with guarded("not valid CSV"):
        stream = io.StringIO(read_bytes(file).decode("utf-8-sig"), newline="")
        head, *rows = [*filter(None, csv.reader(stream, strict=True))] or [[]]
    if len(head) == 1 and ";" in head[0]:
        raise ValueError("columns are separated by semicolons; give a format with separator = ';', or use commas")
    columns: dict[str, Array] = {}
    for place, text in enumerate(head):
        match = re.fullmatch(r"\s*(\w*)\s*(?:[\[(](.*)[\])])?\s*", text)
        if match is None or (name := match[1]) not in names:
            continue
        if match[2] and match[2].replace("*", " ") != QUANTITIES[name]:
            raise ValueError(f"{name} is in [{match[2]}]; it must be in [{QUANTITIES[name]}]")
        if name in columns:
            raise ValueError(f"there is more than one column {name!r}; remove all but one")
        columns[name] = np.array([_number(row, place) for row in rows])
        for k in np.flatnonzero(np.isnan(columns[name])):
            if (entry := rows[k][place] if place < len(rows[k]) else "").strip().lower() != "nan":
                raise ValueError(f"{name} in data row {k + 1} is {entry[:60]!r}; it must be a number")
    return columns

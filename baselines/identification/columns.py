"""Formats of logs with other columns, units or axes: TOML files with the fields of `Format`.

docs/identify.md has an example. Rows in which a column is empty or not a number are omitted.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from auv_gym.physics.errors import to_body
from auv_gym.physics.intervals import check_number
from auv_gym.physics.namespaces import Array
from auv_gym.scenarios.records import from_record, read_table
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
_QUANTITIES = {
    "t": "s", "x": "m", "y": "m", "latitude": "rad", "longitude": "rad", "psi": "rad", "u": "m/s", "v": "m/s",
    "r": "rad/s", "F_u": "N", "F_r": "N m", "thrust": "N", "revolutions": "1/s", "rudder": "rad", "W_x": "m/s",
    "W_y": "m/s", "wind_speed": "m/s", "wind_from": "rad",
}  # fmt: skip
"""Quantities that a column may have, with their SI units."""
_INPUTS = ("F_u", "F_r", "thrust", "revolutions", "rudder", "W_x", "W_y")  # averaged between the rows that are kept
_EQUATOR, _FLATTENING = 6378137.0, 1 / 298.257223563  # [m] WGS 84


@dataclass(frozen=True)
class Column:
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

    columns: Mapping[str, Any]  # by quantity, see `Column`
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
        if unknown := [name for name in self.columns if name not in _QUANTITIES]:
            raise ValueError(f"format has a column {unknown[0]!r}; allowed are {', '.join(_QUANTITIES)}")
        for name, given in self.columns.items():
            units = UNITS[_QUANTITIES[name]]
            if (unit := _column(given).unit) and unit not in units:
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

        Raises:
            ValueError: the file is not text, or a column is missing.
            OSError: the file cannot be read.
        """
        try:
            lines = read_bytes(Path(file)).decode(self.encoding).splitlines()
        except (UnicodeDecodeError, LookupError) as error:
            raise ValueError(f"{file} is not text in {self.encoding}: {error}") from error
        heads, rows = self._split(lines[: min(self.skip, 1)]), self._split(lines[self.skip :])
        places = [self._place(name, [h.strip() for h in heads[0]] if heads else []) for name in self.columns]
        table = np.array([[_number(row, place) for place in places] for row in rows]).reshape(-1, len(places))
        table = table[np.isfinite(table).all(axis=1)]
        columns = {}
        for (name, given), values in zip(self.columns.items(), table.T, strict=True):
            column, unit = _column(given), _QUANTITIES[name]
            columns[name] = values * (UNITS[unit][column.unit or unit] * column.scale)
        return _thinned(_in_standard_axes(columns, self), self.every)

    def _split(self, lines: Sequence[str]) -> list[list[str]]:
        if self.separator == "space":
            return [line.split() for line in lines if line.strip()]
        return [row for row in csv.reader(io.StringIO("\n".join(lines)), delimiter=self.separator) if row]

    def _place(self, name: str, heads: Sequence[str]) -> int:
        column = _column(self.columns[name]).column
        if isinstance(column, int):
            return column - 1
        if heads.count(column) != 1:
            many = "no column" if column not in heads else "more than one column"
            raise ValueError(f"there is {many} {column!r} for {name}; the first line names {', '.join(heads)}")
        return heads.index(column)


def _column(given: Any) -> Column:
    return from_record(Column, given if isinstance(given, Mapping) else {"column": given}, "column")


def _number(row: Sequence[str], place: int) -> float:
    try:
        return float(row[place])
    except (ValueError, IndexError):
        return math.nan


def _in_standard_axes(columns: dict[str, Array], form: Format) -> dict[str, Array]:
    """Return columns with positions on a plane, wind vectors, axes NED and velocities in the body frame."""
    found = dict(columns)
    if "wind_speed" in found and "wind_from" in found:
        speed, angle = found.pop("wind_speed"), found.pop("wind_from")
        found["W_x"], found["W_y"] = -speed * np.cos(angle), -speed * np.sin(angle)
    if form.axes == "ENU":
        for one, other in (("x", "y"), ("W_x", "W_y"), *([("u", "v")] if form.velocity == "world" else [])):
            if one in found and other in found:
                found[one], found[other] = found[other], found[one]
        if "psi" in found:
            found["psi"] = 0.5 * math.pi - found["psi"]
        turned = ("r", "F_r", "rudder", *(["v"] if form.velocity == "body" else []))
        found |= {name: -found[name] for name in turned if name in found}
    if "latitude" in found and "longitude" in found:
        found["x"], found["y"] = _on_plane(found.pop("latitude"), found.pop("longitude"))
    if form.velocity == "world" and {"u", "v", "psi"} <= found.keys():
        c, s = np.cos(found["psi"]), np.sin(found["psi"])
        found["u"], found["v"] = to_body(found["u"], found["v"], c, s)
    return found


def _on_plane(latitude: Array, longitude: Array) -> tuple[Array, Array]:
    """Return the distances [m] north and east of the first position, by the radii of curvature of the ellipsoid."""
    if not len(latitude):
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
    kept = np.flatnonzero(np.diff(np.floor((t - t[0]) / every + 1e-6), prepend=-1))
    found = {name: values[kept] for name, values in columns.items()}
    for name in columns.keys() & set(_INPUTS):
        found[name] = np.add.reduceat(columns[name], kept) / np.diff(np.append(kept, len(t)))
    return found

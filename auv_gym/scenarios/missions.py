"""Missions: waypoints from files of planners, and the scenario that follows them.

Axes are x east and y north. Geographic coordinates (WGS 84) become metres from the first waypoint.
"""

from __future__ import annotations

import codecs
import csv
import json
import math
import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path as FilePath
from typing import Any

import numpy as np

from auv_gym.effects.current import RandomCurrent
from auv_gym.planning.paths import Legs, from_geographic
from auv_gym.planning.paths.space import Through, WithHeight
from auv_gym.planning.paths.waypoints import NEAR, WaypointWarning
from auv_gym.scenarios.fitting import changed
from auv_gym.scenarios.records import guarded
from auv_gym.scenarios.scenario import MOST_STEPS, Scenario
from auv_gym.scenarios.vehicles import PAPER, PAPER_TURN_RATE, VehicleModel, as_vehicle_model
from auv_gym.scenarios.vertical import Vertical

SUFFIXES = ".csv", ".geojson", ".json", ".plan", ".waypoints", ".txt"
"""Files of missions: columns x, y or lat, lon; GeoJSON; plans and waypoint files of QGroundControl, also as .txt."""
_NAMES = {
    "x": ("x", "east", "easting", "e"),
    "y": ("y", "north", "northing", "n"),
    "lat": ("lat", "latitude"),
    "lon": ("lon", "long", "lng", "longitude"),
    "speed": ("speed", "velocity", "vel", "groundspeed"),
    "depth": ("depth",),
}
_HEAD = re.compile(r"(.*?)(?:[\s_]*[\[(]\s*(.*?)\s*[\])]|[\s_]([a-z/]+))?")
"""A heading of a column: "speed [m/s]", "speed (m/s)", "speed_kn", "speed"."""
_LENGTHS, _ANGLES = {"m": 1.0, "km": 1e3}, {"deg": 1.0, "degrees": 1.0}
_SPEEDS = {"m/s": 1.0, "mps": 1.0, "km/h": 1 / 3.6, "kmh": 1 / 3.6, "kph": 1 / 3.6}
_SPEEDS |= dict.fromkeys(("kn", "kt", "kts", "knots"), 1852 / 3600)
_UNITS = {"x": _LENGTHS, "y": _LENGTHS, "lat": _ANGLES, "lon": _ANGLES, "speed": _SPEEDS, "depth": _LENGTHS}
"""Units of the columns, the first of each without one, and their factors."""
_WAYPOINT, _SPLINE, _SPEED = 16, 82, 178  # of MAVLink: NAV_WAYPOINT, NAV_SPLINE_WAYPOINT, DO_CHANGE_SPEED
_IN_PLACE = (112, 113, 114, 115, 177, 194)
"""Commands of MAVLink that change the motion, beside those up to 95: conditions, DO_JUMP, DO_SET_REVERSE."""

_Places = tuple[list[float], list[float], list[float]]
"""Latitudes, longitudes [deg], and speeds [m/s] on the way to the next one, nan where there is none."""


@dataclass(frozen=True)
class Mission:
    """Waypoints of a file."""

    name: str
    points: tuple[tuple[float, float], ...]  # x, y [m]
    speeds: tuple[float, ...] = ()  # [m/s] one for each leg, nan where it has none; or none
    origin: tuple[float, float] | None = None  # latitude, longitude [deg] of x = y = 0, if the file has them
    depths: tuple[float, ...] = ()  # [m] one for each waypoint, or none: motion in the plane


def read_mission(file: str | FilePath) -> Mission:
    """Return the waypoints of a file of one of the `SUFFIXES`.

    Raises:
        OSError: the file cannot be read.
        ValueError: the file is of another kind, is damaged, or has no waypoints; the message says where.
    """
    file = FilePath(file)
    if file.suffix.lower() not in SUFFIXES:
        raise ValueError(f"mission {file} ends in {file.suffix!r}; it must end in {', '.join(SUFFIXES)}")
    content = file.read_bytes()
    with guarded(f"mission {file}"):
        utf16 = content[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
        try:
            text = content.decode("utf-16" if utf16 else "utf-8-sig")
        except UnicodeDecodeError as error:
            raise ValueError(f"it is no text in UTF-8 or UTF-16; save it as UTF-8 ({error})") from error
        if text.startswith("QGC WPL"):
            return _geographic(file.stem, *_of_waypoint_file(text))
        if file.suffix.lower() in (".waypoints", ".txt"):
            raise ValueError(f"its first line is {text.partition(chr(10))[0]!r}; it must begin with 'QGC WPL'")
        if file.suffix.lower() == ".csv":
            return _of_table(file.stem, text)
        try:
            record = json.loads(text)
        except ValueError as error:
            raise ValueError(f"it is not one object of JSON: {error}") from error
        if not isinstance(record, dict):
            raise ValueError("it is a list; it must be an object of GeoJSON or a plan of QGroundControl")
        return _geographic(file.stem, *(_of_plan(record) if "mission" in record else _of_geojson(record)))


def mission_scenario(
    mission: Mission,
    vehicle: VehicleModel | str | Mapping[str, Any] | None = None,
    speed: float | None = None,
    radius: float | None = None,
    current: Sequence[float] = (0.0, 0.0),
) -> Scenario:
    """Return the scenario in which a vehicle follows a mission: straight legs and rounded corners, in a current.

    A mission with depths is one in space: the rate of climb is constant on a leg and changes in the corner.

    Args:
        mission: the waypoints.
        vehicle: a name, a file, or a model; None: the paper's vehicle.
        speed: [m/s] where the mission has none; None: the vehicle's design speed.
        radius: least radius of corners [m]; None: that of the vehicle's turn rate at this speed.
        current: V_x (to the east), V_y (to the north) [m/s].

    Raises:
        ValueError: the vehicle is unknown, a number is out of range, a corner does not fit on its legs, or a change of
            depth has no leg.
    """
    model = as_vehicle_model(vehicle) or PAPER
    speed = model.vehicle.speed if speed is None else speed
    speeds = tuple(speed if math.isnan(one) else one for one in mission.speeds)
    if radius is None:
        turn_rate = model.turn_rate or PAPER_TURN_RATE * PAPER.vehicle.time / model.vehicle.time
        radius = max(speeds or (speed,)) / turn_rate
    _check_dive(mission)
    with guarded(f"mission {mission.name}"):
        path = Legs(mission.points, speed, radius, speeds)
    V_x, V_y = map(float, current)
    flow = RandomCurrent(speed=math.hypot(V_x, V_y), direction=math.atan2(V_y, V_x), relative=False)
    steered, vertical = _in_space(path, mission, radius) if mission.depths else (path, None)
    scenario = Scenario(mission.name, steered, steps=1, current=flow if V_x or V_y else None, vertical=vertical)
    scenario = replace(changed(scenario, vehicle), name=mission.name)
    if (steps := max(1, int(path.end / scenario.control_dt))) > MOST_STEPS:
        longest = np.hypot(*np.diff(path.waypoints, axis=0).T)
        raise ValueError(
            f"the mission takes {path.end:.3g} s, {steps} control steps, and an episode has at most {MOST_STEPS}; leg "
            f"{np.argmax(longest)} is {longest.max() / 1000:.4g} km long: are order, sign and unit of the coordinates "
            "right?"
        )
    return replace(scenario, steps=steps)


def _check_dive(mission: Mission) -> None:
    """Raise ValueError if a waypoint of a dive is above the surface, or at the place of the one before."""
    for k, depth in enumerate(mission.depths):
        if depth < 0:
            raise ValueError(f"waypoint {k} has the depth {depth:.4g} m; depths are positive below the surface")
        if k and math.dist(*mission.points[k - 1 : k + 1]) < NEAR:
            raise ValueError(
                f"waypoint {k} is at the place of the one before; a vehicle cannot dive on the spot: move it, or leave "
                "it out"
            )


def _in_space(path: Legs, mission: Mission, radius: float) -> tuple[WithHeight, Vertical]:
    """Return the path of a mission with depths, and the vertical part of its scenario."""
    times = path.arrivals.tolist()
    blend = min(radius / max(path.speeds or (path.speed,)), 0.5 * min(np.diff(times)))
    heights = tuple(-depth for depth in mission.depths)
    return WithHeight(path, Through(times, heights, float(blend))), Vertical()


def _note(text: str) -> None:
    """Warn of what a file has and the mission has not."""
    warnings.warn(text, WaypointWarning, stacklevel=4)


def _of_table(name: str, text: str) -> Mission:
    """Return the mission of a table with a row for each waypoint; the speed is that of the leg that begins there."""
    lines = text.splitlines()
    filled = [k for k, line in enumerate(lines) if line.strip(" ,;\t")]
    if not (data := [k for k in filled if not lines[k].startswith("#")]):
        raise ValueError("it is empty")
    if re.fullmatch(r"[-+\d.,;\seE]*", lines[data[0]]):  # numbers: the line before may be a heading behind a "#"
        data = filled[max(0, filled.index(data[0]) - 1) :]
    separator = max(",;\t", key=lines[data[0]].count)
    blanks = separator not in lines[data[0]]
    heading, *rows = ([cell.strip() for cell in (lines[k].split() if blanks else one)] for k, one in zip(
        data, csv.reader([lines[k].lstrip("# ") for k in data], delimiter=separator), strict=True
    ))  # fmt: skip
    for k, row in zip(data[1:], rows, strict=True):
        if separator == "," and not blanks and any(row[len(heading) :]):
            raise ValueError(
                f"line {k + 1} has {len(row)} cells, the heading {len(heading)}; with decimal commas, separate columns "
                "by semicolons"
            )
    found = {key: place for key in _NAMES if (place := _place(heading, key)) is not None}
    pair = ("lat", "lon") if {"lat", "lon"} <= set(found) else ("x", "y")
    if not set(pair) <= set(found):
        raise ValueError(
            f"its columns are {', '.join(heading)}; it needs x and y [m], or lat and lon [deg]; speed "
            "[m/s] and depth [m] are optional"
        )
    used = {found[key][0] for key in (*pair, "speed", "depth") if key in found}
    if unused := [column for k, column in enumerate(heading) if k not in used]:
        _note(f"{name}: the columns {', '.join(unused)} are not used")

    def column(key: str, blank: float | None = None) -> list[float]:
        place, factor = found[key]
        numbers = []
        for k, row in zip(data[1:], rows, strict=True):
            cell = row[place] if place < len(row) else ""
            if blank is not None and not cell:
                numbers.append(blank)
                continue
            try:
                numbers.append(factor * float(cell.replace(",", ".") if separator != "," else cell))
                if not math.isfinite(numbers[-1]):
                    raise ValueError
            except ValueError:
                raise ValueError(f"{cell!r} in column {heading[place]} of line {k + 1} is no number") from None
        return numbers

    if len(rows) < 2:
        raise ValueError(f"it has too few waypoints, {len(rows)}; it needs 2 or more")
    first, second = column(pair[0]), column(pair[1])
    speeds = column("speed", math.nan) if "speed" in found else [math.nan] * len(first)
    depths = tuple(column("depth")) if "depth" in found else ()
    if pair == ("lat", "lon"):
        return replace(_geographic(name, first, second, speeds), depths=depths)
    return Mission(name, tuple(zip(first, second, strict=True)), _of_legs(speeds), depths=depths)


def _place(heading: Sequence[str], key: str) -> tuple[int, float] | None:
    """Return index and factor to SI units of the first column of a quantity, None if there is none.

    Raises:
        ValueError: its unit is unknown.
    """
    units = _UNITS[key]
    for k, cell in enumerate(heading):
        name, bracket, suffix = _HEAD.fullmatch(re.sub(r"(k?m)_([sh])\b", r"\1/\2", cell.lower())).groups()  # type: ignore[union-attr]
        unit = bracket or suffix or next(iter(units))
        if name in _NAMES[key] and (bracket or unit in units):
            if unit not in units:
                raise ValueError(f"the unit of column {cell} is unknown; allowed are {', '.join(units)}")
            return k, units[unit]
    return None


def _of_legs(speeds: Sequence[float]) -> tuple[float, ...]:
    """Return the speeds of the legs, none if no leg has one."""
    legs = tuple(speeds[:-1])
    return () if all(map(math.isnan, legs)) else legs


def _of_waypoint_file(text: str) -> _Places:
    """Return the places of a file "QGC WPL": lines with command, four parameters, latitude and longitude."""
    items: list[tuple[int, Sequence[float]]] = []
    for k, line in enumerate(text.splitlines()[1:], 2):
        if (cells := line.split()) and (items or cells[2:3] != ["0"]):  # a first one with absolute height is home
            if len(cells) < 11:
                raise ValueError(f"line {k} has {len(cells)} entries; a waypoint has 12")
            with guarded(f"line {k}"):
                items.append((int(cells[3]), [float(cell) for cell in cells[4:11]]))
    return _of_items(items)


def _of_plan(record: Any) -> _Places:
    """Return the places of a plan of QGroundControl; surveys have theirs as items of their own."""
    items: list[tuple[int, Sequence[float]]] = []
    waiting, empty = list(record["mission"].get("items", ())), 0
    while waiting:
        item = waiting.pop(0)
        if "command" in item:
            if len(params := item.get("params", ())) < 6:
                raise ValueError(f"an item with command {item['command']} has no params: save it with a newer planner")
            items.append((int(item["command"]), [math.nan if p is None else p for p in params]))
        else:
            inner = item.get("TransectStyleComplexItem", {}).get("Items", ())
            waiting, empty = [*inner, *waiting], empty + (not inner)
    if empty:
        _note(f"{empty} surveys, structures or landings without waypoints are left out; newer planners write them")
    return _of_items(items)


def _of_items(items: Sequence[tuple[int, Sequence[float]]]) -> _Places:
    """Return the places of commands with their parameters, the fifth and sixth of which are latitude and longitude."""
    lat, lon, speeds, speed, others = [], [], [math.nan], math.nan, []
    for k, (command, params) in enumerate(items, 1):
        if command == _SPEED and params[0] in (0, 1) and params[1] != -1:  # of air or ground; -1: no change
            speed = params[1] if params[1] > 0 else math.nan
        elif command in (_WAYPOINT, _SPLINE):
            if params[4] == params[5] == 0:
                raise ValueError(f"the waypoint in item {k} has latitude 0 and longitude 0, which is no place")
            lat.append(params[4])
            lon.append(params[5])
            speeds.append(speed)  # it holds from its command on, on the way to this waypoint
        if command == _WAYPOINT:
            others += [f"{command} with a hold time in item {k}"] if params[0] > 0 else []
        elif command <= 95 or command in _IN_PLACE:
            others.append(f"{command} in item {k}")
    if others:
        _note(
            f"commands of MAVLink that are not followed: {', '.join(others)}; waypoints ({_WAYPOINT}, {_SPLINE}) are "
            "joined by straight legs"
        )
    return lat, lon, [*speeds[2:], math.nan]


def _of_geojson(record: Any) -> _Places:
    """Return the places of the first line of a GeoJSON file, or of its points in their order."""
    features = [one for one in record.get("features", [record]) if one.get("geometry", one)]
    shapes = [one.get("geometry", one) for one in features]
    kinds = [shape.get("type") for shape in shapes]
    if "LineString" in kinds:
        if kinds.count("LineString") > 1:
            _note(f"the first of {kinds.count('LineString')} lines is used")
        points = shapes[kinds.index("LineString")]["coordinates"]
        speeds = [_speed_of(features[kinds.index("LineString")])] * len(points)
    else:
        chosen = [k for k, kind in enumerate(kinds) if kind == "Point"]
        if not chosen:
            shown = ", ".join(str(kind or "no geometry") for kind in dict.fromkeys(kinds)) or "no features"
            raise ValueError(f"it has {shown}; it must have a LineString or Points")
        points = [shapes[k]["coordinates"] for k in chosen]
        speeds = [_speed_of(features[k]) for k in chosen]
    return [point[1] for point in points], [point[0] for point in points], speeds


def _speed_of(feature: Any) -> float:
    """Return the property `speed` [m/s] of a feature, nan without one."""
    value = (feature.get("properties") or {}).get("speed")
    return math.nan if value in (None, "") else float(value)


def _geographic(name: str, lat: Sequence[float], lon: Sequence[float], speeds: Sequence[float]) -> Mission:
    """Return the mission of geographic coordinates [deg]."""
    if len(lat) < 2:
        raise ValueError(f"it has {len(lat)} waypoints; it must have 2 or more")
    xy = np.round(from_geographic(lat, lon), 6)
    return Mission(name, tuple(map(tuple, xy.tolist())), _of_legs(speeds), (float(lat[0]), float(lon[0])))

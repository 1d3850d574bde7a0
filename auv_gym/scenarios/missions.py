"""Missions: waypoints from files of planners, and the scenario that follows them.

Axes are x east and y north. Geographic coordinates (WGS 84) become metres from the first waypoint.
"""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path as FilePath
from typing import Any

import numpy as np

from auv_gym.effects.current import RandomCurrent
from auv_gym.physics.vehicle import PAPER_VEHICLE
from auv_gym.planning.paths import Legs, from_geographic
from auv_gym.scenarios.fitting import changed
from auv_gym.scenarios.records import guarded
from auv_gym.scenarios.scenario import Scenario
from auv_gym.scenarios.vehicles import PAPER as PAPER_MODEL
from auv_gym.scenarios.vehicles import VehicleModel, as_vehicle_model

SUFFIXES = ".csv", ".geojson", ".json", ".plan", ".waypoints"
"""Files of missions: columns x, y or lat, lon; GeoJSON; plans and waypoint files of QGroundControl."""
_NAMES = {
    "x": ("x", "x_m", "east", "easting", "e"),
    "y": ("y", "y_m", "north", "northing", "n"),
    "lat": ("lat", "latitude"),
    "lon": ("lon", "long", "lng", "longitude"),
    "speed": ("speed", "speed_m_s", "v"),
}
_WAYPOINT, _SPEED = 16, 178  # commands of MAVLink: NAV_WAYPOINT, DO_CHANGE_SPEED
_TURN_RATE = 0.12
"""Turn rate [rad/s] of a vehicle that has none of its own, for the paper's vehicle."""


@dataclass(frozen=True)
class Mission:
    """Waypoints of a file."""

    name: str
    points: tuple[tuple[float, float], ...]  # x, y [m]
    speeds: tuple[float, ...] = ()  # [m/s] one for each leg
    origin: tuple[float, float] | None = None  # latitude, longitude [deg] of x = y = 0, if the file has them


def read_mission(file: str | FilePath) -> Mission:
    """Return the waypoints of a file of one of the `SUFFIXES`.

    Raises:
        OSError: the file cannot be read.
        ValueError: the file is of another kind, is damaged, or has no waypoints; the message says where.
    """
    file = FilePath(file)
    if file.suffix.lower() not in SUFFIXES:
        raise ValueError(f"mission {file} ends in {file.suffix!r}; it must end in {', '.join(SUFFIXES)}")
    text = file.read_bytes().decode("utf-8-sig")
    with guarded(f"mission {file}"):
        if file.suffix.lower() == ".csv":
            return _of_table(file.stem, text)
        if file.suffix.lower() == ".waypoints":
            return _of_waypoint_file(file.stem, text)
        record = json.loads(text)
        places = _of_plan(record) if "mission" in record else _of_geojson(record)
        return _geographic(file.stem, *places)


def mission_scenario(
    mission: Mission,
    vehicle: VehicleModel | str | Mapping[str, Any] | None = None,
    speed: float | None = None,
    radius: float | None = None,
    current: Sequence[float] = (0.0, 0.0),
) -> Scenario:
    """Return the scenario in which a vehicle follows a mission: straight legs and rounded corners, in a current.

    Args:
        mission: the waypoints.
        vehicle: a name, a file, or a model; None: the paper's vehicle.
        speed: [m/s] where the mission has none; None: the vehicle's design speed.
        radius: least radius of corners [m]; None: that of the vehicle's turn rate at this speed.
        current: V_x (to the east), V_y (to the north) [m/s].

    Raises:
        ValueError: the vehicle is unknown, a number is out of range, or a corner does not fit on its legs.
    """
    model = as_vehicle_model(vehicle) or PAPER_MODEL
    usual = model.vehicle.speed if vehicle is not None else PAPER_VEHICLE.speed
    speed = usual if speed is None else speed
    if radius is None:
        turn_rate = model.turn_rate or _TURN_RATE * PAPER_VEHICLE.time / model.vehicle.time
        radius = max((speed, *mission.speeds)) / turn_rate
    path = Legs(mission.points, speed, radius, mission.speeds)
    V_x, V_y = map(float, current)
    flow = RandomCurrent(speed=math.hypot(V_x, V_y), direction=math.atan2(V_y, V_x), relative=False)
    scenario = Scenario(mission.name, path, steps=1, current=flow if V_x or V_y else None)
    scenario = replace(changed(scenario, vehicle), name=mission.name)
    return replace(scenario, steps=max(1, int(path.end / scenario.control_dt)))


def _of_table(name: str, text: str) -> Mission:
    """Return the mission of a table with a row for each waypoint; the speed is that of the leg that begins there."""
    lines = [line if not line.startswith("#") else "" for line in text.splitlines()]  # numbers of lines stay
    separator = max(",;\t", key=next(filter(str.strip, lines), "").count)
    table = [[cell.strip() for cell in row] for row in csv.reader(lines, delimiter=separator)]
    if not (rows := {k: row for k, row in enumerate(table, 1) if any(row)}):
        raise ValueError("it is empty")
    head, *numbers = rows
    names = [cell.lower().replace(" ", "_") for cell in rows[head]]
    places = {key: names.index(one) for key, several in _NAMES.items() for one in several if one in names}
    if {"lat", "lon"} <= set(places):
        pair = "lat", "lon"
    elif {"x", "y"} <= set(places):
        pair = "x", "y"
    else:
        raise ValueError(f"its columns are {', '.join(rows[head])}; it needs x and y [m], or lat and lon [deg]")

    def column(key: str) -> list[float]:
        found = []
        for line in numbers:
            cell = rows[line][places[key]] if places[key] < len(rows[line]) else ""
            try:
                found.append(float(cell.replace(",", ".") if separator != "," else cell))
            except ValueError:
                raise ValueError(f"{cell!r} in column {rows[head][places[key]]} of line {line} is no number") from None
        return found

    speeds = tuple(column("speed")[:-1]) if "speed" in places else ()
    first, second = column(pair[0]), column(pair[1])
    if pair == ("lat", "lon"):
        return _geographic(name, first, second, speeds)
    return Mission(name, tuple(zip(first, second, strict=True)), speeds)


def _of_waypoint_file(name: str, text: str) -> Mission:
    """Return the mission of a file "QGC WPL": lines with command, four parameters, latitude and longitude."""
    head, *lines = text.splitlines()
    if not head.startswith("QGC WPL"):
        raise ValueError(f"its first line is {head!r}; it must begin with 'QGC WPL'")
    rows = [line.split() for line in lines if line.strip()]
    items = [(int(row[3]), float(row[5]), float(row[8]), float(row[9])) for row in rows[1:]]  # the first one is home
    return _geographic(name, *_of_items(items))


def _of_plan(record: Any) -> tuple[list[float], list[float], tuple[float, ...]]:
    """Return the waypoints of a plan of QGroundControl; surveys have theirs as items of their own."""
    items: list[Any] = []
    waiting = list(record["mission"]["items"])
    while waiting:
        item = waiting.pop(0)
        inner = item.get("TransectStyleComplexItem", {}).get("Items")
        if inner is not None:
            waiting = [*inner, *waiting]
        elif "command" in item:
            known = [math.nan if p is None else p for p in item["params"]]
            items.append((int(item["command"]), known[1], known[4], known[5]))
    return _of_items(items)


def _of_items(
    items: Sequence[tuple[int, float, float, float]],
) -> tuple[list[float], list[float], tuple[float, ...]]:
    """Return the waypoints and speeds of commands (command, second parameter, latitude, longitude)."""
    lat, lon, speeds, speed = [], [], [], math.nan
    for command, second, latitude, longitude in items:
        if command == _SPEED:
            speed = second
        elif command == _WAYPOINT:
            lat.append(latitude)
            lon.append(longitude)
            speeds.append(speed)
    known = tuple(speeds[1:])  # a speed holds from its command on, on the way to the next waypoint
    return lat, lon, () if any(map(math.isnan, known)) else known


def _of_geojson(record: Any) -> tuple[list[float], list[float], tuple[float, ...]]:
    """Return the points of the first line of a GeoJSON file, or its points in their order."""
    features = record.get("features", [record])
    shapes = [feature.get("geometry", feature) for feature in features]
    lines = [shape["coordinates"] for shape in shapes if shape.get("type") == "LineString"]
    points = lines[0] if lines else [shape["coordinates"] for shape in shapes if shape.get("type") == "Point"]
    return [point[1] for point in points], [point[0] for point in points], ()


def _geographic(name: str, lat: Sequence[float], lon: Sequence[float], speeds: tuple[float, ...] = ()) -> Mission:
    """Return the mission of geographic coordinates [deg]."""
    if len(lat) < 2:
        raise ValueError(f"it has {len(lat)} waypoints; it must have 2 or more")
    xy = np.round(from_geographic(lat, lon), 6)
    return Mission(name, tuple(map(tuple, xy.tolist())), speeds, (float(lat[0]), float(lon[0])))

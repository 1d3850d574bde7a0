"""Missions: the same waypoints from every kind of file, and the scenario that follows them."""

import json
from dataclasses import replace

import numpy as np
import pytest

from auv_gym.envs.track_env import UnderactuatedAUVTrackEnv
from auv_gym.physics.vehicle import PAPER_VEHICLE
from auv_gym.planning.paths import from_geographic
from auv_gym.scenarios.missions import Mission, mission_scenario, read_mission
from auv_gym.scenarios.scenario import Scenario

LAT, LON = [59.9, 59.9005, 59.9005, 59.9], [10.7, 10.7, 10.7003, 10.7003]
XY = from_geographic(LAT, LON)
SQUARE = Mission("square", ((0.0, 0.0), (60.0, 0.0), (60.0, 30.0), (0.0, 30.0)))


def item(command, *params):
    return {"type": "SimpleItem", "command": command, "params": list(params)}


def places():
    rows = [item(16, 0, 0, 0, None, lat, lon, -5) for lat, lon in zip(LAT, LON, strict=True)]
    fast, slow = (item(178, 1, speed, -1, 0, 0, 0, 0) for speed in (0.8, 0.6))
    return [rows[0], fast, *rows[1:3], slow, rows[3]]


PLAN = {"fileType": "Plan", "mission": {"items": places(), "plannedHomePosition": [59.0, 10.0, 0]}}
SURVEY = {
    "fileType": "Plan",
    "mission": {
        "items": [{"type": "ComplexItem", "TransectStyleComplexItem": {"Items": places()}}],
    },
}
COMMANDS = [
    (16, 0, 59.0, 10.0), (16, 0, LAT[0], LON[0]), (178, 0.8, 0, 0), (16, 0, LAT[1], LON[1]), (16, 0, LAT[2], LON[2]),
    (178, 0.6, 0, 0), (16, 0, LAT[3], LON[3]),
]  # fmt: skip
WPL = "QGC WPL 110\n" + "".join(
    f"{k}\t0\t3\t{command}\t0\t{speed}\t0\t0\t{lat}\t{lon}\t-5\t1\n"
    for k, (command, speed, lat, lon) in enumerate(COMMANDS)
)
LINE = {"type": "LineString", "coordinates": [[lon, lat, 0.0] for lat, lon in zip(LAT, LON, strict=True)]}
POINTS = [{"type": "Feature", "geometry": {"type": "Point", "coordinates": point}} for point in LINE["coordinates"]]
FILES = {
    "a.csv": "lat,lon\n" + "".join(f"{lat},{lon}\n" for lat, lon in zip(LAT, LON, strict=True)),
    "b.csv": "\ufeffLatitude;Longitude;Speed\n"
    + "".join(f"{lat};{lon};{v}\n".replace(".", ",") for lat, lon, v in zip(LAT, LON, (0.8, 0.8, 0.6, 1), strict=True)),
    "c.csv": "easting\tnorthing\n" + "".join(f"{x + 5e5}\t{y + 6.6e6}\n" for x, y in XY.tolist()),
    "d.geojson": json.dumps({"type": "FeatureCollection", "features": [{"type": "Feature", "geometry": LINE}]}),
    "e.geojson": json.dumps({"type": "FeatureCollection", "features": POINTS}),
    "f.json": json.dumps(LINE),
    "g.plan": json.dumps(PLAN),
    "h.plan": json.dumps(SURVEY),
    "i.waypoints": WPL,
}
WITH_SPEEDS = {"b.csv", "g.plan", "h.plan", "i.waypoints"}


@pytest.mark.parametrize("name", FILES)
def test_every_kind_of_file_has_the_same_waypoints(name, tmp_path):
    (tmp_path / name).write_text(FILES[name], encoding="utf-8")
    mission = read_mission(tmp_path / name)
    points = np.array(mission.points)
    np.testing.assert_allclose(points - points[0], XY, atol=2e-5)
    assert mission.speeds == ((0.8, 0.8, 0.6) if name in WITH_SPEEDS else ())
    assert mission.origin == (None if name == "c.csv" else (59.9, 10.7))


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("m.kml", "", r"ends in '.kml'; it must end in .csv, .geojson, .json, .plan, .waypoints"),
        ("m.csv", "a,b\n1,2\n", r"its columns are a, b; it needs x and y \[m\], or lat and lon \[deg\]"),
        ("m.csv", "x,y\n1,2\n3,four\n", "'four' in column y of line 3 is no number"),
        ("m.csv", "x,y\n1,2\n3\n", "'' in column y of line 3 is no number"),
        ("m.csv", "lat,lon\n91,2\n3,4\n", r"latitude of point 0 is 91.0; it must be in \[-90, 90\] degrees"),
        ("m.waypoints", "1 2 3\n", "its first line is '1 2 3'; it must begin with 'QGC WPL'"),
        ("m.geojson", "{", "m.geojson: "),
        ("m.geojson", '{"type": "Polygon", "coordinates": []}', "it has 0 waypoints; it must have 2 or more"),
        ("m.plan", '{"mission": {"items": []}}', "it has 0 waypoints"),
    ],
)
def test_wrong_files_are_refused_with_the_place(name, text, message, tmp_path):
    (tmp_path / name).write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=message):
        read_mission(tmp_path / name)


def test_a_vehicle_follows_a_mission_at_its_speed_in_a_current():
    scenario = mission_scenario(SQUARE, speed=0.8, radius=5.0, current=(0.1, -0.05))
    env = UnderactuatedAUVTrackEnv(scenario)
    env.reset(seed=0)
    np.testing.assert_allclose(env.current, (0.1, -0.05), atol=1e-12)
    assert (env.reference.x, env.reference.y, env.reference.u) == pytest.approx((0.0, 0.0, 0.8))
    assert scenario.steps == int(scenario.path.end / scenario.control_dt)
    assert scenario.duration <= scenario.path.end
    assert Scenario.from_dict(json.loads(json.dumps(scenario.to_dict()))) == scenario


@pytest.mark.parametrize("vehicle", ["lauv", "otter", "remus100"])
def test_speed_radius_and_period_are_those_of_the_vehicle(vehicle):
    wide = replace(SQUARE, points=tuple((10 * x, 10 * y) for x, y in SQUARE.points))
    scenario = mission_scenario(wide, vehicle)
    assert scenario.path.speed == scenario.vehicle.speed
    assert scenario.vehicle == scenario.model.vehicle
    assert scenario.steps == int(scenario.path.end / scenario.control_dt)
    rate = scenario.path.speed / scenario.path.radius
    assert rate == pytest.approx(scenario.model.turn_rate or 0.12 * PAPER_VEHICLE.time / scenario.vehicle.time)
    UnderactuatedAUVTrackEnv(scenario).reset(seed=0)


def test_a_corner_that_does_not_fit_is_said_with_a_radius_that_does():
    with pytest.raises(ValueError, match=r"need .* m of the leg .* a radius of [\d.]+ m would fit"):
        mission_scenario(SQUARE, speed=1.0, radius=30.0)

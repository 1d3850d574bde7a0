"""Missions: the same waypoints from every kind of file, and the scenario that follows them."""

import json
import math
import re
from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest

from auv_gym import decode_observation
from auv_gym.envs.space import UnderactuatedAUVTrack3DEnv
from auv_gym.envs.track_env import UnderactuatedAUVTrackEnv
from auv_gym.physics.vehicle import PAPER_VEHICLE
from auv_gym.planning.paths import from_geographic
from auv_gym.planning.paths.waypoints import WaypointWarning
from auv_gym.planning.planner import plan
from auv_gym.scenarios.missions import Mission, mission_scenario, read_mission
from auv_gym.scenarios.scenario import Scenario
from auv_gym.scenarios.vehicles import vehicle_model

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
    f"{k}\t0\t{3 if k else 0}\t{command}\t0\t{speed}\t0\t0\t{lat}\t{lon}\t-5\t1\n"
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


STEPS = [[0, 0], [30, 0], [30, 20], [0, 20]]
TABLES = {
    "units": ("X [m],Y (m),Speed [kn]\n", "{},{},1\n"),
    "suffixes": ("x_m;y_m;speed_kn\n", "{};{};1\n"),
    "per hour": ("x,y,speed_km_h\n", "{},{},1.852\n"),
    "without brackets": ("x m,y m,speed km/h\n", "{},{},1.852\n"),
    "no speed on the last row": ("x,y,speed_kn\n", "{},{},1\n"),
    "a heading in a comment": ("# a survey\n# x_km,y_km,velocity (knots)\n", "{0:e},{1:e},1\n"),
    "blanks": ("  x   y   speed_kn\n", "{}  {}  1\n"),
}


@pytest.mark.parametrize("name", TABLES)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_headings_of_tables_are_read_with_their_units(name, encoding, tmp_path):
    head, row = TABLES[name]
    scale = 1e-3 if "x_km" in head else 1.0
    text = head + "".join(row.format(x * scale, y * scale) for x, y in STEPS)
    text = text.removesuffix("1\n") if "last" in name else text
    (tmp_path / "m.csv").write_bytes(text.encode(encoding))
    mission = read_mission(tmp_path / "m.csv")
    np.testing.assert_allclose(mission.points, STEPS, atol=1e-9)
    assert mission.speeds == pytest.approx((1852 / 3600,) * 3)


def test_legs_without_a_speed_have_the_usual_one_and_the_radius_is_for_the_speeds_in_use(tmp_path):
    (tmp_path / "m.csv").write_text("x,y,speed\n0,0,0.5\n60,0,\n60,40,0.7\n0,40,9\n", encoding="utf-8")
    mission = read_mission(tmp_path / "m.csv")
    slow, usual = (
        mission_scenario(mission, speed=0.4).path,
        mission_scenario(replace(mission, speeds=()), speed=0.7).path,
    )
    assert slow.speeds == (0.5, 0.4, 0.7)
    assert slow.radius == usual.radius


def test_a_leg_behind_merged_waypoints_has_the_speed_of_the_last_of_them():
    twice = Mission("m", ((0, 0), (50, 0), (50.01, 0), (50, 50)), (0.8, 0.3, 0.4))
    with pytest.warns(WaypointWarning, match="nearer than 0.1 m to the one before: waypoint 2$"):
        assert mission_scenario(twice, radius=5.0).path.speeds == (0.8, 0.4)


def changed_plan(*items, at=2):
    before = places()
    return json.dumps({"mission": {"items": [*before[:at], *items, *before[at:]]}})


@pytest.mark.parametrize(
    ("items", "speeds", "note"),
    [
        ([item(178, 2, 0.1, -1, 0, 0, 0, 0)], (0.8, 0.8, 0.6), None),  # of a climb
        ([item(178, 1, -1, -1, 0, 0, 0, 0)], (0.8, 0.8, 0.6), None),  # no change
        ([item(178, 1, -2, -1, 0, 0, 0, 0)], (math.nan, math.nan, 0.6), None),  # the usual one
        ([item(18, 1, 0, 0, 0, *XY[0], 0)], (0.8, 0.8, 0.6), "not followed: 18 in item 3"),
        ([item(177, 1, 2, 0, 0, 0, 0, 0)], (0.8, 0.8, 0.6), "not followed: 177 in item 3"),
        ([{"type": "ComplexItem", "complexItemType": "survey"}], (0.8, 0.8, 0.6), "1 surveys, structures or landings"),
        ([item(194, 1, 0, 0, 0, 0, 0, 0)], (0.8, 0.8, 0.6), "not followed: 194 in item 3"),
        ([item(203, 0, 0, 0, 0, 0, 0, 0)], (0.8, 0.8, 0.6), None),  # a camera
    ],
)
def test_commands_of_a_plan_are_followed_or_named(items, speeds, note, tmp_path, recwarn):
    (tmp_path / "m.plan").write_text(changed_plan(*items), encoding="utf-8")
    with pytest.warns(WaypointWarning, match=note) if note else nullcontext():
        mission = read_mission(tmp_path / "m.plan")
    np.testing.assert_array_equal(mission.speeds, speeds)
    assert len(mission.points) == 4


def test_what_a_file_has_beside_is_named(tmp_path):
    two = {"type": "FeatureCollection", "features": [{"geometry": None}, {"geometry": LINE}, {"geometry": LINE}]}
    slow = [{**point, "properties": {"speed": 0.5}} for point in POINTS]
    slow[-1]["properties"] = {"speed": None}
    for name, text, note, speeds in (
        ("m.csv", "x,y,alt,v\n0,0,3,1\n9,0,3,1\n", "m: the columns alt, v are not used", ()),
        ("m.geojson", json.dumps(two), "the first of 2 lines is used", ()),
        ("m.geojson", json.dumps({"geometry": LINE, "properties": {"speed": 0.5}}), None, (0.5,) * 3),
        (
            "m.plan",
            json.dumps(PLAN).replace('"params": [0,', '"params": [30,', 1),
            "16 with a hold time in item 1",
            (0.8, 0.8, 0.6),
        ),
        ("m.json", json.dumps({"type": "FeatureCollection", "features": slow}), None, (0.5,) * 3),
        ("m.txt", WPL.replace("\t16\t", "\t82\t"), "not followed: 82 in item 1", (0.8, 0.8, 0.6)),
    ):
        (tmp_path / name).write_text(text, encoding="utf-8")
        with pytest.warns(WaypointWarning, match=note) if note else nullcontext():
            assert read_mission(tmp_path / name).speeds == speeds


def test_names_with_blanks_in_a_table_without_separators_are_left_out(tmp_path):
    (tmp_path / "m.csv").write_text("x y name\n0 0 the first buoy\n30 0 harbour\n", encoding="utf-8")
    with pytest.warns(WaypointWarning, match="the columns name are not used"):
        assert read_mission(tmp_path / "m.csv").points == ((0.0, 0.0), (30.0, 0.0))


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        (
            "m.csv",
            "x,y,speed [furlong/h]\n0,0,1\n",
            r"unit of column speed \[furlong/h\] is unknown; allowed are m/s, mps",
        ),
        ("m.csv", "x [kn],y\n0,0\n", r"unit of column x \[kn\] is unknown; allowed are m, km"),
        ("m.geojson", '{"features": []}', "it has no features; it must have"),
        ("m.csv", b"\xff\xfe\x00", "m.csv: "),
        ("m.csv", "x,y\n0,0\n".encode("utf-32"), "m.csv: "),
        ("m.geojson", "[[1, 2], [3, 4]]", "it is a list; it must be an object of GeoJSON"),
        ("m.plan", '{"mission": {"items": [{"command": 16, "coordinate": [1, 2, 3]}]}}', "command 16 has no params"),
        ("m.waypoints", "QGC WPL 110\n0 1 3 16 0\n", "line 2 has 5 entries; a waypoint has 12"),
        ("m.waypoints", "QGC WPL 110\n0 1 3 16 0 0 0 0 a 1 0 1\n", "line 2: could not convert"),
        ("m.plan", changed_plan(item(16, 0, 0, 0, None, 0, 0, 0)), "item 3 has latitude 0 and longitude 0"),
        ("m.kml", "", r"ends in '.kml'; it must end in .csv, .geojson, .json, .plan, .waypoints, .txt"),
        ("m.csv", "a,b\n1,2\n", r"its columns are a, b; it needs x and y \[m\], or lat and lon \[deg\]"),
        ("m.csv", "x,y\n1,2\n3,four\n", "'four' in column y of line 3 is no number"),
        ("m.csv", "x,y\n1,2\nnan,4\n", "'nan' in column x of line 3 is no number"),
        ("m.csv", "x,y\n1,2\n", "it has too few waypoints, 1; it needs 2 or more"),
        ("m.csv", "x,y\n1,2\n3\n", "'' in column y of line 3 is no number"),
        ("m.csv", "x,y\n1,2\n3,5,4\n", "line 3 has 3 cells, the heading 2; with decimal commas"),
        ("m.csv", "lat,lon\n91,2\n3,4\n", r"latitude of point 0 is 91.0; it must be in \[-90, 90\] degrees"),
        ("m.waypoints", "1 2 3\n", "its first line is '1 2 3'; it must begin with 'QGC WPL'"),
        ("m.geojson", "{", "m.geojson: it is not one object of JSON: "),
        (
            "m.csv",
            "x,y\n0,0\n# Bucht von Kiel, 5 °\n".encode("latin-1"),
            "no text in UTF-8 or UTF-16; save it as UTF-8",
        ),
        ("m.geojson", '{"type": "Polygon", "coordinates": []}', "it has Polygon; it must have a LineString or Points"),
        ("m.plan", '{"mission": {"items": []}}', "it has 0 waypoints"),
    ],
)
def test_wrong_files_are_refused_with_the_place(name, text, message, tmp_path):
    (tmp_path / name).write_bytes(text if isinstance(text, bytes) else text.encode())
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


def test_a_vehicle_dives_to_the_depths_of_a_mission(tmp_path):
    """The planned forces alone keep it near the path; at a waypoint it is at the depth, beside the rounding."""
    (tmp_path / "m.csv").write_text("x,y,depth [m]\n0,0,5\n60,0,12\n60,40,12\n0,40,4\n", encoding="utf-8")
    mission = read_mission(tmp_path / "m.csv")
    assert mission.depths == (5, 12, 12, 4)
    scenario = mission_scenario(mission, speed=0.5, radius=8.0)
    assert Scenario.from_dict(json.loads(json.dumps(scenario.to_dict()))) == scenario
    env = UnderactuatedAUVTrack3DEnv(scenario)
    observation, _ = env.reset(seed=0)
    depths, ended = [5.0], False
    while not ended:
        o = decode_observation(observation, space=True)
        action = np.divide((o.F_uR, o.F_qR, o.F_rR), (o.F_u_max, o.F_q_max, o.F_r_max))
        observation, _, lost, ended, info = env.step(action)
        depths.append(-env.state[2])
        assert not lost
    at = np.rint(scenario.path.path.arrivals / scenario.control_dt).astype(int)[:-1]
    np.testing.assert_allclose(np.array(depths)[at], mission.depths[:-1], atol=0.4)
    assert info["position_error"] < 0.1


@pytest.mark.parametrize(
    ("points", "depths", "vehicle", "message"),
    [
        (((0, 0), (60, 0)), (5, -1), None, "waypoint 1 has the depth -1 m; depths are positive below the surface"),
        (((0, 0), (60, 0), (60, 0), (60, 60)), (5, 5, 9, 9), None, "waypoint 2 is at the place of the one before"),
        (((0, 0), (60, 0)), (5, 59), "remus100", "the pitch|a climb"),
    ],
)
@pytest.mark.filterwarnings("ignore::auv_gym.planning.paths.waypoints.WaypointWarning")
def test_depths_that_cannot_be_followed_are_refused(points, depths, vehicle, message):
    with pytest.raises(ValueError, match=message):
        UnderactuatedAUVTrack3DEnv(mission_scenario(Mission("m", points, depths=depths), vehicle)).reset(seed=0)


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
    for radius in (30.0, 15.0, 13.0):
        with pytest.raises(ValueError, match=r"corners, of 90.0 and 90.0 degrees, need .*fit") as refused:
            mission_scenario(SQUARE, speed=1.0, radius=radius)
        fits = float(re.search(r"a radius of ([\d.]+) m would fit", str(refused.value))[1])
        mission_scenario(SQUARE, speed=1.0, radius=fits)
    dense = replace(SQUARE, points=tuple((0.5 * k, 0.2 * (k % 2)) for k in range(40)))
    with pytest.raises(ValueError, match="a path that almost turns back needs two corners there"):
        mission_scenario(replace(SQUARE, points=((0.0, 0.0), (30.0, 0.0), (0.0, 0.1))), speed=1.0, radius=4.0)
    with pytest.raises(ValueError, match="where waypoints are that dense, thin them, or use a Spline"):
        mission_scenario(dense, radius=5.0)


def test_coordinates_that_cannot_be_right_are_asked_about():
    with pytest.raises(ValueError, match=r"leg 1 is 1188 km long: are order, sign and unit of the coordinates right\?"):
        mission_scenario(replace(SQUARE, points=((0.0, 0.0), (60.0, 0.0), (1.188e6, 0.0))), radius=5.0)
    with pytest.raises(ValueError, match=r"are these degrees\? In a file name the columns lat and lon"):
        mission_scenario(replace(SQUARE, points=tuple((1e-5 * x, 1e-5 * y) for x, y in SQUARE.points)))


@pytest.mark.parametrize("vehicle", ["paper", "eca-a9", "gunnerus", "lauv", "otter", "remus100"])
def test_a_bend_of_any_angle_can_be_followed(vehicle):
    """Also one of rounding, as in the coordinates of a straight line."""
    D = 300.0 * PAPER_VEHICLE.length if vehicle == "paper" else 300.0 * vehicle_model(vehicle).vehicle.length
    for degrees in (0.01, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 60.0, 90.0, 120.0):
        a = math.radians(degrees)
        bend = Mission("bend", ((0.0, 0.0), (D, 0.0), (D + D * math.cos(a), D * math.sin(a))))
        scenario = mission_scenario(bend, vehicle)
        act, around = (
            scenario.actuators,
            scenario.path.arrivals[1] + 30 * scenario.vehicle.time * np.linspace(-1, 1, 600),
        )
        plan(scenario.path, scenario.vehicle, around, (act.F_u_max, act.F_r_max), act.fin)

"""A log's own columns: units, axes, places on the earth, gaps, and what is refused in one line."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from auv_gym.effects.actuators import Actuators
from auv_gym.effects.sensors import Sensors
from auv_gym.physics.vehicle import PAPER_VEHICLE
from baselines.identification.columns import FORMATS_FOLDER, Format
from baselines.identification.log import CONTROLS, MEASURED_COLUMNS, Log, joined
from baselines.identification.trials import example

SI = {name: name for name in ("t", *MEASURED_COLUMNS, *CONTROLS["force"])}


@pytest.fixture(scope="module")
def log():
    return example(PAPER_VEHICLE, Actuators(lag=0.4), Sensors(), 0)


def written(folder, columns, heads=None, separator=","):
    """Write columns to a file and return it."""
    file = folder / "log.txt"
    rows = [separator.join(f"{x:.12g}" for x in row) for row in np.column_stack(list(columns.values()))]
    file.write_text("\n".join([separator.join(heads or columns), *rows]) + "\n", encoding="utf-8")
    return file


def table(log):
    return dict(zip(log.columns, log.table.T, strict=True))


def test_units_are_converted(log, tmp_path):
    si = table(log)
    shown = {
        "time (min)": si["t"] / 60, "x_km": si["x"] / 1e3, "y_ft": si["y"] / 0.3048, "hdg": np.degrees(si["psi"]),
        "u_kn": si["u"] * 3600 / 1852, "v_kmh": si["v"] * 3.6, "rot": np.degrees(si["r"]) * 60,
        "kN": si["F_u"] / 1e3, "minus": -si["F_r"],
    }  # fmt: skip
    units = ("min", "km", "ft", "deg", "knots", "km/h", "deg/min", "kN", "N m")
    columns = {name: {"column": head, "unit": unit} for name, head, unit in zip(SI, shown, units, strict=True)}
    columns["F_r"]["scale"] = -1.0
    got = Log.load(written(tmp_path, shown, separator=";"), Format(columns, separator=";"))
    np.testing.assert_allclose(got.table, log.table, rtol=1e-9, atol=1e-9)


def test_columns_by_number_and_white_space(log, tmp_path):
    file = written(tmp_path, table(log), separator="   ")
    got = Log.load(file, Format({name: k + 1 for k, name in enumerate(SI)}, separator="space"))
    np.testing.assert_allclose(got.table, log.table, rtol=1e-9, atol=1e-9)


def test_east_north_up(log, tmp_path):
    si = table(log)
    enu = si | {"x": si["y"], "y": si["x"], "psi": math.pi / 2 - si["psi"]}
    enu |= {name: -si[name] for name in ("v", "r", "F_r")}
    got = Log.load(written(tmp_path, enu), Format(SI, axes="ENU"))
    np.testing.assert_allclose(got.table, log.table, rtol=1e-9, atol=1e-9)


def test_gaps_and_empty_rows_divide_a_log_into_runs(log, tmp_path):
    si = table(log)
    si["x"] = np.where((log.t > 20) & (log.t < 30), np.nan, si["x"])
    got = Log.load(written(tmp_path, si), Format(SI))
    assert got.starts == (0, 201)
    assert got.duration == pytest.approx(50.0)
    both = joined([got, log])
    assert both.starts == (0, 201, len(got.t))
    assert [run.stop - run.start for run in both.runs] == [201, 301, 601]


def test_rows_are_thinned_and_commands_averaged(log, tmp_path):
    got = Log.load(written(tmp_path, table(log)), Format(SI, every=0.5))
    assert got.dt == pytest.approx(0.5)
    np.testing.assert_allclose(got.measured, log.measured[::5])
    np.testing.assert_allclose(got.commands[:-1], log.commands[:600].reshape(120, 5, 2).mean(axis=1))


def test_wind_blows_from_where_it_is_said_to_come(log, tmp_path):
    si = table(log) | {"speed": np.full(len(log.t), 3.0), "from": np.full(len(log.t), math.pi / 2)}
    columns = SI | {"wind_speed": "speed", "wind_from": "from"}
    got = Log.load(written(tmp_path, si), Format(columns))
    np.testing.assert_allclose(got.wind, np.tile([0.0, -3.0], (len(log.t), 1)), atol=1e-9)


@pytest.mark.parametrize("name", sorted(file.stem for file in FORMATS_FOLDER.glob("*.toml")))
def test_formats_that_ship_are_whole(name):
    form = Format.named(name)
    assert form.about
    assert {"t", "u", "v"} <= form.columns.keys()


@pytest.mark.parametrize(
    ("entries", "says"),
    [
        ({"columns": SI | {"z": "z"}}, "format has a column 'z'; allowed are t, x, y"),
        ({"columns": SI | {"psi": {"column": "psi", "unit": "gon"}}}, "psi is in 'gon'; allowed are rad, deg"),
        ({"columns": SI | {"psi": 0}}, "column is 0; it must be a name or a number from 1 on"),
        ({"axes": "up"}, "format axes is 'up'; allowed are NED, ENU"),
        ({"skip": -1}, "format skip is -1"),
        ({"separator": "tab"}, "format separator is 'tab'"),
    ],
)
def test_a_wrong_format_is_refused(entries, says):
    with pytest.raises(ValueError, match=says):
        Format(**{"columns": SI, **entries})


def test_wrong_files_are_refused_in_one_line(log, tmp_path):
    file = written(tmp_path, table(log), heads=[*list(SI)[:-1], "F_u"])
    with pytest.raises(ValueError, match="there is more than one column 'F_u'; remove all but one"):
        Log.load(file)
    with pytest.raises(ValueError, match="there is more than one column 'F_u' for F_u"):
        Log.load(file, Format({name: name for name in SI if name != "F_r"} | {"F_r": "F_u"}))
    with pytest.raises(ValueError, match="columns are separated by semicolons; give a format"):
        Log.load(written(tmp_path, table(log), separator=";"))
    with pytest.raises(ValueError, match="the log has no 50 rows without a gap"):
        Log.load(written(tmp_path, {n: x[:40] for n, x in table(log).items()}), Format(SI))
    with pytest.raises(ValueError, match=r"unknown format 'none'; allowed are a .toml file, or one of esso-osaka"):
        Format.named("none")
    with pytest.raises(ValueError, match="the logs have commands of different kinds: force, thrust"):
        joined([log, replace(log, kind="thrust")])
    file.write_text("é" * 100, encoding="utf-8")
    with pytest.raises(ValueError, match="is not text in ascii"):
        Format(SI, encoding="ascii").read(file)


def test_the_format_of_the_page_reads_a_log(log, tmp_path):
    """A TOML block of docs/identify.md: places near 59 degrees north, axes ENU, speeds in the world, a ship's commands.

    Distances on the earth are those of the ellipsoid's radii of curvature, as Vincenty has them.
    """
    page = (Path(__file__).parents[2] / "docs" / "identify.md").read_text(encoding="utf-8")
    (tmp_path / "own.toml").write_text(page.split("```toml\n")[1].split("```")[0], encoding="utf-8")
    si = table(log)
    c, s = np.cos(si["psi"]), np.sin(si["psi"])
    north, east = si["u"] * c - si["v"] * s, si["u"] * s + si["v"] * c
    a, b, place = 6378137.0, 6356752.314245, math.radians(59.0)
    across = math.hypot(a * math.cos(place), b * math.sin(place))
    lat = 59 + np.degrees(si["x"] / ((a * b) ** 2 / across**3))
    lon = 10 + np.degrees(si["y"] / (a**2 / across * math.cos(place)))
    shown = {
        "time": si["t"], "lat": lat, "lon": lon, "yaw": 90 - np.degrees(si["psi"]),
        "v_east": east * 3600 / 1852, "v_north": north * 3600 / 1852, "yaw_rate": -np.degrees(si["r"]),
        "propeller": 60 * si["F_u"], "helm": np.degrees(si["F_r"] / 1000),
    }  # fmt: skip
    form = replace(Format.named(str(tmp_path / "own.toml")), every=0.0)
    got = Log.load(written(tmp_path, shown, separator=";"), form)
    assert got.kind == "revolutions"
    measured = log.measured - log.measured[0] * ([1, 1] + [0] * 4)
    np.testing.assert_allclose(got.measured, measured, rtol=1e-5, atol=2e-4)
    np.testing.assert_allclose(got.commands, np.column_stack((si["F_u"], si["F_r"] / 1000)), atol=1e-9)

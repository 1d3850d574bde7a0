"""A log's own columns: units, axes, places on the earth, gaps, and what is refused in one line."""

import math
from dataclasses import replace
from datetime import datetime, timezone
from pathlib import Path

import numpy as np
import pytest

from auv_gym.effects.actuators import Actuators
from auv_gym.effects.sensors import Sensors
from auv_gym.physics.vehicle import PAPER_VEHICLE
from auv_gym.scenarios.presets import PRESETS
from baselines.identification import identify
from baselines.identification.axes import ContradictionError
from baselines.identification.columns import FORMATS_FOLDER, Format, repeated
from baselines.identification.log import CONTROLS, MEASURED_COLUMNS, Log, joined, rough_noise
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


def test_gaps_divide_a_log_into_runs(log, tmp_path):
    si = {name: column[(log.t <= 20) | (log.t >= 30)] for name, column in table(log).items()}
    got = Log.load(written(tmp_path, si), Format(SI))
    assert got.starts == (0, 201)
    assert got.duration == pytest.approx(50.0)
    both = joined([got, log])
    assert both.starts == (0, 201, len(got.t))
    assert [run.stop - run.start for run in both.runs] == [201, 301, 601]


def test_a_missing_measurement_has_no_weight_and_its_row_keeps_its_command(log, tmp_path):
    """As with positions at 2 Hz in a table of 10 Hz; blank commands are held."""
    si, often = table(log), np.arange(len(log.t)) % 5 == 0
    si |= {name: np.where(often, si[name], np.nan) for name in ("x", "y", "psi")}
    si["F_u"] = np.where(np.append(True, np.diff(si["F_u"]) != 0), si["F_u"], np.nan)
    file = written(tmp_path, si)
    file.write_text(file.read_text(encoding="utf-8").replace("nan", ""), encoding="utf-8")
    for form in (None, Format(SI)):
        got = Log.load(file, form)
        np.testing.assert_array_equal(got.commands, log.commands)
        np.testing.assert_array_equal(got.seen[:, :3], np.tile(often[:, None], 3))
        assert got.seen[:, 3:].all()
        np.testing.assert_allclose(got.measured[often], log.measured[often], atol=1e-9)
        assert "x, y, psi: blank in 480 of 601 rows" in got.notes
    got.save(tmp_path / "again.csv")
    np.testing.assert_array_equal(Log.load(tmp_path / "again.csv").seen, got.seen)


def test_a_held_measurement_counts_once(log, tmp_path):
    """As with fixes of a receiver that are repeated until the next one."""
    si = table(log)
    held = np.arange(len(log.t)) // 5 * 5
    si |= {"x": si["x"][held], "y": si["y"][held]}
    got = Log.load(written(tmp_path, si))
    np.testing.assert_array_equal(np.flatnonzero(got.seen[:, 0]), np.unique(held))
    assert got.notes == ("x, y change in about every 5. row only: each value counts once",)
    assert log.seen is None
    assert repeated(np.round(log.measured[:, 5], 2)) == 1  # a coarse sensor is not a slow one


@pytest.mark.parametrize(
    ("unit", "shown"),
    [
        ("ns", lambda t: [f"{1_700_000_000_000_000_000 + round(1e9 * x)}" for x in t]),
        ("microseconds", lambda t: [f"{1e6 * x:.0f}" for x in t]),
        ("msec", lambda t: [f"{1e3 * x:.0f}" for x in t]),
        ("", lambda t: [datetime.fromtimestamp(1.7e9 + x, timezone.utc).isoformat().replace("+00:00", "Z") for x in t]),
    ],
)
def test_stamps_of_any_kind(log, tmp_path, unit, shown):
    columns = {name: [f"{x:.12g}" for x in values] for name, values in table(log).items()} | {"t": shown(log.t)}
    file = tmp_path / "log.csv"
    head = ",".join(columns).replace("t,", f"t [{unit}],", 1) if unit else ",".join(columns)
    file.write_text("\n".join([head, *map(",".join, zip(*columns.values(), strict=True))]), encoding="utf-8")
    np.testing.assert_allclose(Log.load(file).t, log.t, atol=1e-5)
    if unit == "ns":
        with pytest.raises(ValueError, match=r"t begins at 1.7e\+18 s, which looks like ns since 1970"):
            Log.load(file, Format(SI | {"t": 1}))


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
@pytest.mark.parametrize("separator", [";", "\t"])
def test_exports_of_other_countries_are_read(log, tmp_path, encoding, separator):
    file = written(tmp_path, table(log), separator=separator)
    file.write_text(file.read_text(encoding="utf-8").replace(".", ","), encoding=encoding)
    np.testing.assert_allclose(Log.load(file).table, log.table, rtol=1e-9, atol=1e-9)
    with pytest.raises(ValueError, match=r"t in data row 2 is '0,1'; it must be .* decimal = \",\""):
        Log.load(file, Format(SI, separator=separator))


def test_two_thrusters_pulses_and_quaternions(log, tmp_path):
    si, lever = table(log), 0.4
    side = 0.5 * si["F_r"] / lever
    shown = {name: si[name] for name in ("t", "x", "y", "u", "v", "r")}
    thrusts = {"left": 0.5 * si["F_u"] + side, "right": 0.5 * si["F_u"] - side}
    shown |= {name: 1500 + 2 * force + 25 * np.sign(force) for name, force in thrusts.items()}
    shown |= {"qz": np.sin(0.5 * si["psi"]), "qw": np.cos(0.5 * si["psi"])}
    pulse = {"offset": 1500, "dead_band": 25, "scale": 0.5}
    columns = {name: name for name in ("t", "x", "y", "u", "v", "r")} | {"q_z": "qz", "q_w": "qw"}
    columns |= {"port": {"column": "left", **pulse}, "starboard": {"column": "right", **pulse}}
    got = Log.load(written(tmp_path, shown), Format(columns, lever=lever))
    np.testing.assert_allclose(got.commands, log.commands, rtol=1e-8, atol=1e-7)
    np.testing.assert_allclose(np.exp(1j * got.measured[:, 2]), np.exp(1j * si["psi"]), atol=1e-8)
    with pytest.raises(ValueError, match="format has port or starboard, but no lever"):
        Format(columns)


def test_cells_that_are_no_numbers_are_counted(log, tmp_path):
    columns = {name: [f"{x:.12g}" for x in values] for name, values in table(log).items()}
    columns["r"][6] = columns["r"][9] = "--"
    file = tmp_path / "log.csv"
    lines = [",".join(columns), *map(",".join, zip(*columns.values(), strict=True)), ",,,,,,,,", ",,,,,,,,"]
    file.write_text("\n".join(lines), encoding="utf-8")
    got = Log.load(file)
    assert np.flatnonzero(~got.seen[:, 5]).tolist() == [6, 9]
    assert got.notes == (
        "2 of 603 rows are blank and left out",
        "r in data row 7 is '--', not a number; 2 of 601 rows have such a cell and no value",
    )
    file.write_text("time;yaw\n0;1\n", encoding="utf-8")
    with pytest.raises(ValueError, match=r"there is no column 't'; .* in a format: --format FILE\.toml"):
        Log.load(file)


def test_too_long_a_log_is_told_its_length_and_how_to_thin_it():
    rows = np.zeros((120_000, 6))
    with pytest.raises(ValueError, match=r"the log has 120000 rows; .* thin it by every = 0.024 in a format"):
        Log(0.01 * np.arange(120_000), rows, rows[:, :2])


def test_measurements_are_thinned_and_commands_kept(log, tmp_path):
    """From the first row on that has all of them; commands that change in most rows are averaged."""
    si = table(log)
    fixes = np.arange(len(log.t)) % 5 == 3
    got = Log.load(written(tmp_path, si | {"x": np.where(fixes, si["x"], np.nan)}), Format(SI, every=0.5))
    np.testing.assert_array_equal(got.commands, log.commands)
    np.testing.assert_array_equal(got.seen[1:], np.tile(fixes[1:, None], 6))
    np.testing.assert_allclose(got.measured[fixes], log.measured[fixes])
    rough = si | {"F_r": si["F_r"] + 0.01 * np.arange(len(log.t))}
    got = Log.load(written(tmp_path, rough), Format(SI, every=0.5))
    assert got.dt == pytest.approx(0.5)
    np.testing.assert_allclose(got.measured, log.measured[::5])
    np.testing.assert_allclose(got.commands[:-1, 0], log.commands[:600, 0].reshape(120, 5).mean(axis=1))


@pytest.mark.parametrize("form", [None, Format(SI)])
@pytest.mark.parametrize(
    ("rows", "note"),
    [
        (lambda n: np.sort(np.append(np.arange(n), np.arange(0, 480, 40))), "12 rows are within 0.02 s of the row"),
        (lambda n: np.concatenate(([1, 0], np.arange(2, 200), [201, 200], np.arange(202, n))), "t goes back 2 times"),
        (lambda n: np.arange(n)[::-1], "t goes back 600 times"),
    ],
)
def test_doubled_and_disordered_rows_are_put_in_order(log, tmp_path, form, rows, note):
    """No row is lost, and no run begins."""
    shown = {name: values[rows(len(log.t))] for name, values in table(log).items()}
    got = Log.load(written(tmp_path, shown), form)
    np.testing.assert_allclose(got.table, log.table, rtol=1e-9, atol=1e-9)
    assert got.starts == (0,)
    assert any(text.startswith(note) for text in got.notes)


def test_messages_of_a_burst_are_one_row(log, tmp_path):
    """A table that joins the topics of a robot: each row has the values of one topic."""
    topics = [("x", "y", "psi"), ("u", "v"), ("r",), ("F_u", "F_r")]
    rows = []
    for k, t in enumerate(log.t.tolist()):
        values = dict(zip(log.columns, log.table[k].tolist(), strict=True))
        for late, names in enumerate(topics):
            rows.append(
                [f"{t + 0.001 * late:.12g}", *(f"{values[n]:.12g}" if n in names else "" for n in list(SI)[1:])]
            )
    file = tmp_path / "joined.csv"
    file.write_text("\n".join([",".join(SI), *map(",".join, rows)]), encoding="utf-8")
    np.testing.assert_allclose(Log.load(file).table, log.table, rtol=1e-9, atol=1e-9)


def test_a_day_ends_in_a_log_and_a_run_begins_in_another(log, tmp_path):
    times = [f"{k // 3600 % 24:02.0f}:{k // 60 % 60:02.0f}:{k % 60:07.4f}" for k in (86370.0 + log.t).tolist()]
    for shown in (times, [f"{x:.12g}" for x in ((86370.0 + log.t) % 86400).tolist()]):
        columns = {name: [f"{x:.12g}" for x in values] for name, values in table(log).items()} | {"t": shown}
        file = tmp_path / "log.csv"
        file.write_text(
            "\n".join([",".join(columns), *map(",".join, zip(*columns.values(), strict=True))]), encoding="utf-8"
        )
        got = Log.load(file)
        np.testing.assert_allclose(got.t - got.t[0], log.t, atol=1e-6)
        assert got.notes == ("t begins again at midnight in data row 301; a day is added",)
    twice = {name: np.tile(values, 2) for name, values in table(log).items()}
    with pytest.raises(ValueError, match=r"t goes from 60 to 0 s in data row 602; .* where a new run begins, write a"):
        Log.load(written(tmp_path, twice))
    assert Log.load(written(tmp_path, twice), Format(SI)).starts == (0, 601)


def test_interpolated_positions_count_where_they_were_measured(log, tmp_path):
    si = table(log)
    noisy = {name: si[name] + np.random.default_rng(0).normal(0, 0.05, len(log.t)) for name in ("x", "y")}
    fixes = np.arange(0, len(log.t), 10)
    shown = si | {name: np.interp(log.t, log.t[fixes], values[fixes]) for name, values in noisy.items()}
    got = Log.load(written(tmp_path, shown))
    assert got.notes == ("x, y are interpolated between 61 values: only these count",)
    np.testing.assert_array_equal(np.flatnonzero(got.seen[:, 0]), fixes)


def test_marks_of_missing_values_and_wrong_fixes_do_not_count(log, tmp_path):
    rng, si = np.random.default_rng(1), table(log)
    shown = {name: values + (rng.normal(0, 0.03, len(values)) if name in SI else 0) for name, values in si.items()}
    shown |= {"t": si["t"], "F_u": si["F_u"], "F_r": si["F_r"]}
    shown["u"][[100, 300]] = -999.0
    shown["x"][[50, 51, 200]] += 30.0
    got = Log.load(written(tmp_path, shown))
    assert np.flatnonzero(~got.seen[:, 3]).tolist() == [100, 300]
    assert np.flatnonzero(~got.seen[:, 0]).tolist() == np.flatnonzero(~got.seen[:, 1]).tolist() == [50, 51, 200]
    assert "u: 2 rows are far from those before and after, the first in data row 101; they do not count" in got.notes


def test_a_frozen_sensor_does_not_count_and_one_at_rest_does(log, tmp_path):
    rng, si = np.random.default_rng(1), table(log)
    shown = {
        n: values + (0 if n in ("t", "F_u", "F_r") else rng.normal(0, 0.03, len(values))) for n, values in si.items()
    }
    shown["u"][200:300], shown["v"][:50] = shown["u"][200], 0.0
    got = Log.load(written(tmp_path, shown))
    assert np.flatnonzero(~got.seen[:, 3]).tolist() == [*range(201, 300)]
    assert got.seen[:, [0, 1, 2, 4, 5]].all()
    assert got.notes == ("u: 99 rows repeat the row before, the first in data row 202; they do not count",)


def test_a_short_manoeuvre_is_no_outlier(tmp_path):
    """A vehicle at rest that sprints for eight seconds, at 1 Hz; and turns of a transect that last two rows."""
    t, noise = np.arange(600.0), 0.01 * np.random.default_rng(0).standard_normal((6, 600))
    for begins in ([570], [100, 200, 300, 400, 500]):
        r, u = np.zeros(600), np.full(600, 0.8 if len(begins) > 1 else 0.0)
        for k in begins:
            r[k : k + 3] = 0.1, 0.3, 0.1
            u[k - 4 : k + 4] = 1.2
        psi = np.cumsum(r)
        x, y = np.cumsum(u * np.cos(psi)), np.cumsum(u * np.sin(psi))
        measured = np.array((x, y, psi, u, 0 * t, r)) + noise
        commands = {"F_u": 80 * u, "F_r": 50 * r}
        got = Log.load(written(tmp_path, dict(zip(("t", *MEASURED_COLUMNS), (t, *measured), strict=True)) | commands))
        assert got.notes == ()


@pytest.mark.parametrize("rows", [5, 10])
def test_measurements_that_are_rarer_than_rows_are_fitted(rows, tmp_path):
    """All of them blank in the other rows, whose commands change."""
    noisy = example(PAPER_VEHICLE, Actuators(lag=0.4), PRESETS["cruise-noise"].sensors, 3)
    often = np.arange(len(noisy.t)) % rows == 0
    shown = {n: v if n in ("t", "F_u", "F_r") else np.where(often, v, np.nan) for n, v in table(noisy).items()}
    got = Log.load(written(tmp_path, shown))
    np.testing.assert_array_equal(got.commands, noisy.commands)
    fitted = identify(got, ("X_uu",))
    assert not fitted.misfit
    for name in ("m11", "m22", "m33", "d11", "d22", "d33"):
        assert fitted[name].value == pytest.approx(getattr(PAPER_VEHICLE, name), rel=0.05)


def test_the_noise_of_a_coarse_sensor_is_that_of_its_rounding(log):
    coarse = replace(log, measured=np.column_stack((np.round(2 * log.measured[:, :2]) / 2, log.measured[:, 2:])))
    assert rough_noise(coarse)[0] == pytest.approx(0.5 / math.sqrt(12))
    assert rough_noise(log)[0] < 0.01


def test_places_that_cannot_be_are_named_and_the_date_line_is_crossed(log, tmp_path):
    si = table(log)
    entries = {name: {"column": name, "unit": "deg"} for name in ("latitude", "longitude")}
    form = Format({name: name for name in SI if name not in ("x", "y")} | entries)
    north, east = np.degrees(si["x"] / 6.37e6), np.degrees(si["y"] / 6.37e6)
    for latitude, longitude in ((0.0, 20.0), (0.0, 180.0 - east.mean())):
        around = (longitude + east + 180) % 360 - 180
        shown = si | {"latitude": latitude + north, "longitude": around}
        got = Log.load(written(tmp_path, shown), form)
        np.testing.assert_allclose(got.measured[:, 1] - got.measured[0, 1], log.measured[:, 1], rtol=0.01, atol=0.1)
    begins = np.arange(len(log.t)) < 15
    got = Log.load(written(tmp_path, shown | {n: np.where(begins, 0.0, shown[n]) for n in entries}), form)
    assert got.notes[0] == "latitude and longitude are 0 in 15 rows: no fix"
    with pytest.raises(ValueError, match=r"latitude is 1[78]\d.* degrees in a row; .* are the columns exchanged"):
        Log.load(written(tmp_path, shown | {"latitude": shown["longitude"]}), form)


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
        ({"axes": "up"}, "format axes is 'up'; allowed are 'NED', 'ENU'"),
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
    with pytest.raises(ValueError, match="the log has no 50 rows without a gap"):
        Log.load(written(tmp_path, {n: x[:40] for n, x in table(log).items()}), Format(SI))
    with pytest.raises(ValueError, match=r"unknown format 'none'; allowed are a .toml file, or one of esso-osaka"):
        Format.named("none")
    with pytest.raises(ValueError, match="the logs have commands of different kinds: force, thrust"):
        joined([log, replace(log, kind="thrust")])
    file.write_text("é" * 100, encoding="utf-8")
    with pytest.raises(ValueError, match="is not text in ascii"):
        Format(SI, encoding="ascii").read(file)
    for content, says in (
        (
            b"PK\x03\x04\x14\x00\x08\x08",
            "it is no text but a spreadsheet, an archive or a binary log; export it as CSV",
        ),
        (b"\x1f\x8b\x08\x08abc", "it is no text but a spreadsheet"),
        ("t,psi [°]\n".encode("latin-1"), "not text in utf-8-sig: .* encoding = 'latin-1', or that of the file"),
        ("t,x\n".encode("utf-16-le"), "looks like UTF-16 without a byte order mark"),
    ):
        file.write_bytes(content)
        with pytest.raises(ValueError, match=says):
            Log.load(file)
    still = table(log) | {"v": 0 * log.t}
    with pytest.raises(ValueError, match="v is 0 in all rows, but the heading changes; it must be measured"):
        Log.load(written(tmp_path, still))
    with pytest.raises(
        ValueError, match="v has no value in any row; all of t, x, y, psi, u, v, r, F_u, F_r are needed"
    ):
        Log.load(written(tmp_path, still | {"v": np.nan * log.t}))
    alone = Format({name: name for name in SI if name[:2] != "F_"} | {"port": "F_u"}, lever=0.3)
    with pytest.raises(ValueError, match="there is port alone; port needs starboard"):
        Log.load(written(tmp_path, table(log)), alone)


def test_a_contradiction_tells_what_to_look_at_first(log, tmp_path):
    si = table(log)
    port, starboard = si["F_u"] / 2 - si["F_r"], si["F_u"] / 2 + si["F_r"]
    shown = si | {"port": port, "starboard": starboard, "q_w": np.sin(si["psi"] / 2), "q_z": np.cos(si["psi"] / 2)}
    known = {name: name for name in SI if name[:2] != "F_"}
    two = Format(known | {"port": "port", "starboard": "starboard"}, lever=0.5)
    with pytest.raises(ContradictionError, match=r"F_r has the opposite sign .* \(F_r comes from port and starboard"):
        Log.load(written(tmp_path, shown), two)
    quaternion = Format({name: name for name in SI if name != "psi"} | {"q_w": "q_w", "q_z": "q_z"})
    with pytest.raises(ContradictionError, match=r"\(psi comes from the quaternion: look at the order of its columns"):
        Log.load(written(tmp_path, shown), quaternion)
    with pytest.raises(ContradictionError, match=r'\(axes is "ENU": leave it out if psi is a compass heading\)'):
        Log.load(written(tmp_path, shown | {"x": si["y"], "y": si["x"]}), Format(SI, axes="ENU"))


@pytest.mark.parametrize("head", ["# a trial\n# of May\n{}\n", "# {}\n", "# a trial\n# {}\n"])
def test_comments_before_the_table_are_skipped(log, tmp_path, head):
    file = written(tmp_path, table(log))
    names, rest = file.read_text(encoding="utf-8").split("\n", 1)
    file.write_text(head.format(names) + rest, encoding="utf-8")
    np.testing.assert_allclose(Log.load(file).table, log.table, rtol=1e-9, atol=1e-9)


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

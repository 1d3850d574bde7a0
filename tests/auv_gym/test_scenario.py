"""Scenarios: presets, files and errors of unknown entries."""

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from auv_gym.effects.sensors import NOISES
from auv_gym.physics.vehicle import PAPER_VEHICLE
from auv_gym.planning.paths import PATHS, Circle
from auv_gym.scenarios.fitting import changed
from auv_gym.scenarios.presets import CASES, PRESETS, SPEED_RANGES, TYPICAL_NOISE, as_scenario
from auv_gym.scenarios.scenario import RandomPath, Scenario
from auv_gym.scenarios.vehicles import as_vehicle


def test_presets_are_the_paper_and_all_cases_in_both_speed_ranges():
    assert set(PRESETS) == {"paper-circle"} | {f"{r}-{c}" for r in ("slow", "cruise") for c in CASES}


def test_the_page_has_the_levels_of_the_noise_and_the_typical_one_is_within():
    page = (Path(__file__).parents[2] / "docs/scenarios.md").read_text(encoding="utf-8")
    for name in NOISES:
        ranges = [getattr(PRESETS[f"{r}-storm"].sensors, name) for r in SPEED_RANGES]
        assert f"| {' | '.join(f'{low:g} to {high:g}' for low, high in ranges)} |" in page
        assert all(
            low < getattr(TYPICAL_NOISE[r], name) < high for r, (low, high) in zip(SPEED_RANGES, ranges, strict=True)
        )
    assert "of {slow.position} m (slow) and {cruise.position} m (cruise)".format(**TYPICAL_NOISE) in " ".join(
        page.split()
    )


def test_draws_are_reproducible_and_differ():
    scenario = PRESETS["cruise-storm"]
    first, again, other = (scenario.draw(np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert first == again != other


@pytest.mark.parametrize("family", [name for name, cls in PATHS.items() if hasattr(cls, "drawn")])
def test_every_family_can_be_drawn(family):
    scenario = Scenario(path=RandomPath(speed=(0.5, 1.0), turn_rate=0.1, families=(family,)))
    rng = np.random.default_rng(0)
    assert all(type(scenario.draw(rng).path) is PATHS[family] for _ in range(3))


def test_random_signs_have_all_eight_combinations():
    rng = np.random.default_rng(0)
    errors = {PRESETS["paper-circle"].draw(rng).initial_error for _ in range(200)}
    assert len(errors) == 8
    assert {tuple(map(abs, e)) for e in errors} == {(0.5, 1.0, math.radians(20))}


@pytest.mark.parametrize(
    ("record", "message"),
    [
        ({"speeed": 1}, r"scenario has no entry 'speeed'; allowed are name, path"),
        ({"path": {"family": "spiral"}}, r"unknown path family 'spiral'; allowed are line, circle"),
        ({"path": {"family": "circle", "speed": 1.0}}, r"path circle lacks the entry 'turn_rate'"),
        ({"path": 3}, r"scenario path is 3"),
        ({"vehicle": "submarine"}, r"unknown vehicle .submarine.; allowed are a .toml file, or one of paper"),
        ({"vehicle": {**vars(PAPER_VEHICLE), "m11": -1.0}}, r"vehicle parameter m11 is -1.0"),
        ({"vehicle": {**vars(PAPER_VEHICLE), "m22": 200.0}}, r"m22 = 200.0 kg is not above m11"),
        ({"current": {"speed": [0.4, 0.1]}}, r"current speed is \(0.4, 0.1\); low must not be above high"),
        ({"current": 1.0}, r"current is 1.0; it must be a table"),
        ({"mismatch": {"ratio": [0.5, 1.0]}}, r"mismatch ratio may fall to 0.5"),
        ({"lost_distance": 1e6}, r"lost_distance is 1000000.0; it must be a number in \[0.001, 100000\]"),
        ({"path": {"family": "spline", "waypoints": [[0, 0], [9, 0]], "speed": 1.0}}, r"the path runs from 0 to 9 s"),
        ({"path": "circle"}, r"scenario path is 'circle'; it must be a table"),
        ({"mismatch": 3}, r"mismatch is 3; it must be a table"),
        ({"control_dt": 2.0}, r"an integration step, .* is 2 s; it must be at most 0.231 s .* so raise substeps"),
    ],
)  # fmt: skip
def test_bad_records_are_refused(record, message):
    with pytest.raises(ValueError, match=message):
        Scenario.from_dict(record)


def test_bad_files_are_refused(tmp_path):
    with pytest.raises(ValueError, match=r"must end in .json or .toml"):
        Scenario.load(tmp_path / "scenario.yaml")
    for suffix in ("json", "toml"):
        file = tmp_path / f"broken.{suffix}"
        file.write_text("{ name = ")
        with pytest.raises(ValueError, match=rf"broken.{suffix} is not valid {suffix.upper()}"):
            Scenario.load(file)
    (tmp_path / "wrong.json").write_text('{"steps": 0}')
    with pytest.raises(ValueError, match=r"wrong.json: steps is 0"):
        Scenario.load(tmp_path / "wrong.json")


BIG = "9" * 400


@pytest.mark.parametrize(
    "text",
    [
        '{"vehicle": {"m11": BIG, "m22": 265, "m33": 80, "d11": 70, "d22": 100, "d33": 50}}',
        '{"control_dt": BIG}',
        '{"sensors": {"position_bias": BIG}}',
        '{"sensors": {"position_bias": [0, BIG]}}',
        '{"actuators": {"F_u_rate": BIG}}',
        '{"path": {"family": "circle", "speed": BIG, "turn_rate": 0.1}}',
        '{"path": {"family": ["circle"]}}',
        '{"path": {"speed": 1, "turn_rate": 0.1, "families": [["circle"]]}}',
        '{"vehicle": ["paper"]}',
        '{"name": ["storm"]}',
        '{"name": "\\ud800"}',
        '{"name": "\\u001b[31mred"}',
        "\xff",
    ],
    ids=range(13),
)
def test_wrong_entries_of_a_file_are_refused_with_one_error(text, tmp_path):
    file = tmp_path / "scenario.json"
    file.write_bytes(text.replace("BIG", BIG).encode("latin-1"))
    with pytest.raises(ValueError, match=r"scenario\.json"):
        Scenario.load(file)


def test_a_user_defined_path_cannot_be_written(tmp_path):
    class MyPath(Circle):
        pass

    with pytest.raises(ValueError, match="MyPath is not in"):
        Scenario(path=MyPath(1.0, 0.1)).save(tmp_path / "s.json")


def test_unknown_names_are_refused_with_the_known_ones():
    with pytest.raises(ValueError, match=r"unknown scenario 'stormy'; .*cruise-storm"):
        as_scenario("stormy")
    with pytest.raises(ValueError, match="unknown vehicle 7"):
        as_vehicle(7)


@pytest.mark.parametrize(
    ("make", "name"),
    [
        (lambda: as_scenario("cruise_strom"), "cruise-storm"),
        (lambda: as_vehicle("REMUS_10"), "remus100"),
        (lambda: as_scenario("zzz"), None),
        (lambda: Scenario.from_dict({"substep": 2}), "substeps"),
        (lambda: Scenario.from_dict({"path": {"family": "Cirlce"}}), "circle"),
    ],
)
def test_a_misspelt_name_is_answered_by_the_one_that_was_meant(make, name):
    with pytest.raises(ValueError, match="allowed are") as refused:
        make()
    meant = re.findall(r"did you mean '([\w-]+)'", str(refused.value))
    assert meant == ([name] if name else [])


def test_changed_chooses_the_substeps_that_a_period_or_a_vehicle_needs():
    slow = changed(PRESETS["cruise-storm"], control_dt=0.5)
    light = changed(PRESETS["cruise-calm"], replace(PAPER_VEHICLE, m33=2.0))
    for scenario in (slow, light):
        assert scenario.substeps == scenario.least_substeps > 1
    with pytest.raises(ValueError, match="control_dt / substeps"):
        changed(PRESETS["cruise-calm"], replace(PAPER_VEHICLE, m33=1e-4))


def test_the_mismatch_is_cut_to_what_a_hardly_slender_vehicle_allows():
    """With m22/m11 = 1.038, as of a BlueROV2 Heavy, all true vehicles stay slender."""
    stout = replace(PAPER_VEHICLE, m22=1.038 * PAPER_VEHICLE.m11)
    for name in ("cruise-storm", "slow-mismatch"):
        scenario = changed(PRESETS[name], stout)
        drawn = [scenario.draw(np.random.default_rng(seed)).vehicle for seed in range(200)]
        assert min(one.m22 / one.m11 for one in drawn) >= 1.01
        assert max(one.m22 / one.m11 for one in drawn) > 1.02
    with pytest.raises(ValueError, match=r"since the vehicle has m22/m11 = 1\.038"):
        Scenario(vehicle=stout, mismatch=PRESETS["cruise-storm"].mismatch, substeps=20)


def test_changed_keeps_the_duration():
    scenario = changed(PRESETS["cruise-calm"], control_dt=0.05)
    assert (scenario.steps, scenario.duration) == (1200, pytest.approx(60.0))
    with pytest.raises(ValueError, match="control_dt is -1"):
        changed(scenario, control_dt=-1)

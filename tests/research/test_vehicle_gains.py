"""Gains that follow the vehicle: stable on published and random vehicles, compared with searches, and on the page."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from auv_gym.physics.namespaces import ARRAYS
from auv_gym.physics.units import POWERS, Units
from auv_gym.physics.vehicle import PAPER_VEHICLE, Vehicle
from auv_gym.scenarios.vehicles import PAPER, vehicle_model, vehicle_names
from baselines import make_policy
from baselines.control.linearisation import linearise
from baselines.gains.loading import RATIOS
from baselines.tools.command_line import run
from baselines.tuning.objective import TuningEpisodes, tuning_scenarios
from baselines.tuning.search import TUNING_SEED
from baselines.tuning.tunables import TUNABLES
from research.vehicles import exponents, vehicles, vehicles_page

ROOT = Path(__file__).parents[2]
SLIP = 0.25  # [rad] largest sideslip in the turns of random vehicles


@pytest.mark.parametrize("name", vehicle_names())
def test_expert_and_normalised_law_are_stable_on_published_vehicles(name):
    assert vehicles_page.worst_growth(vehicle_model(name)) < 0
    assert vehicles_page.worst_growth(vehicle_model(name), "backstepping-normalised") < 0


SIZES = st.floats(-1.5, 1.5).map(lambda x: 10**x)


def between(low, high):
    return st.floats(np.log(low), np.log(high)).map(lambda x: float(np.exp(x)))


@settings(max_examples=25, deadline=None)
@given(between(1.06, 2.4), between(0.2, 6.0), between(0.1, 7.0), between(0.25, 6.0), SIZES, SIZES)
def test_expert_is_stable_on_random_vehicles_of_any_size(ratio, surge, sway, yaw, length, mass):
    """Drag: 0.1 to 7 times that of the paper, in the units of the vehicle; turns have 14 degrees of sideslip."""
    units = Units(length, length, mass)  # as fast as the paper's vehicle
    m22 = 215.0 * ratio
    own = (215.0, m22, 80.0, 70.0 * surge, m22 / 265.0 * 100.0 * sway, 50.0 * yaw)
    dims = ("kg", "kg", "kg m^2", "kg/s", "kg/s", "kg m^2/s")
    vehicle = Vehicle(*(x * units.factor(*POWERS[d]) for x, d in zip(own, dims, strict=True)))
    law = make_policy("backstepping", vehicle=vehicle)
    for U in (0.1, 0.39, 0.41, 1.5):
        turn_rate = min(0.14 if U < 0.4 else 0.21, SLIP * own[4] / 215.0)
        for w in (0.0, turn_rate / units.time):
            assert linearise(vehicle, lambda o: law.forces(o, ARRAYS), U, w).eigenvalues[0].real < 0


def test_a_course_of_another_vehicle_is_in_the_papers_units():
    plain, own = tuning_scenarios("cruise", "plain"), tuning_scenarios("cruise", "plain", vehicle_model("otter"))
    assert [s.name for s in own] == [s.name for s in plain]
    assert {s.vehicle.speed for s in own} == {1.5}
    assert {s.control_dt for s in own} == {0.1}
    assert len({s.substeps for s in own}) == 1
    assert tuning_scenarios("slow", "plain", PAPER) is not plain
    episodes = TuningEpisodes("cruise", 8, TUNING_SEED, vehicle_model=vehicle_model("otter"))
    steady_rmses, failed, commands = episodes.steady_rmses(
        TUNABLES["los-pid"].factory(vehicles.load_gains("los-pid", "cruise", TUNABLES["los-pid"].names),
                                    vehicle=vehicle_model("otter").in_paper_units.vehicle)
    )  # fmt: skip
    assert steady_rmses.shape == failed.shape == commands.shape[1:2] == (8,)
    assert np.median(steady_rmses) < 0.2


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["search", "--vehicle", "nautilus"], "unknown vehicle 'nautilus'; allowed are paper, cybership2"),
        (["search", "--policy", "helm"], "unknown controller 'helm'; allowed are backstepping-tuned"),
        (["search", "--episodes", "12"], "--episodes is 12; it must be a positive multiple of 8"),
        (["search", "--evaluations", "-1"], "--evaluations is -1; it must be at least 0"),
        (
            ["agent", "--policy", "lqi"],
            "--policy is for `search` only, since `agent` runs helm-any and nmpc; leave it out",
        ),
    ],
)
def test_wrong_usage_is_one_line(arguments, says, capsys):
    assert run(vehicles.main, vehicles.PROGRAM, arguments) == 2
    assert says in capsys.readouterr().err


def test_the_command_adds_its_results_to_the_file(tmp_path):
    out = tmp_path / "found.json"
    out.write_text(json.dumps({"search": {"otter": {"lqi": {"ratio": 1.0}}}}))
    few = ["--vehicle", "otter", "--policy", "los-pid", "--held-out", "8", "--out", str(out)]
    assert run(vehicles.main, vehicles.PROGRAM, ["search", "--evaluations", "0", "--episodes", "8", *few]) == 0
    record = json.loads(out.read_text())
    assert set(record["search"]["otter"]) == {"lqi", "los-pid"}
    found = record["search"]["otter"]["los-pid"]
    assert found["ratio"] == pytest.approx(1.0)  # nothing was searched
    assert found["error"]["units"] != found["error"]["parameters"] == found["error"]["searched"]


@pytest.mark.slow
def test_an_agent_is_compared_with_predictive_control_with_both_gains(tmp_path, capsys):
    """If the searched gains are those from the parameters, both rows of predictive control are the same."""
    out = tmp_path / "found.json"
    few = ["--vehicle", "otter", "--held-out", "8", "--out", str(out)]
    assert run(vehicles.main, vehicles.PROGRAM, ["agent", *few]) == 2
    assert f"no gains of nmpc are searched for otter: run {vehicles.PROGRAM} search" in capsys.readouterr().err
    _, gains = vehicles.from_parameters("nmpc", vehicle_model("otter").in_paper_units)
    out.write_text(json.dumps({"search": {"otter": {"nmpc": {"gains": gains, "budget": [60, 16]}}}}))
    assert run(vehicles.main, vehicles.PROGRAM, ["agent", *few]) == 0
    record = json.loads(out.read_text())
    steady_rmses = record["agent"]["otter"]["steady_rmses"]
    assert steady_rmses["parameters"] == steady_rmses["searched"] != steady_rmses["helm-any"]
    assert [len(own) for own in steady_rmses["helm-any"].values()] == [1] * 8
    says, rows = vehicles_page._agent(record)
    assert "Over all 1 vehicles" in says
    own, theirs = (np.concatenate(list(steady_rmses[side].values())) for side in ("helm-any", "parameters"))
    assert rows.splitlines()[-1].count(f" {np.exp(np.log(own / theirs).mean()):.2f} (") == 2


def test_for_the_papers_vehicle_nothing_is_adapted():
    for name in vehicles.SEARCHED:
        plain, adapted = vehicles.from_parameters(name, PAPER)
        assert plain == adapted
    assert replace(PAPER_VEHICLE) == PAPER.vehicle


class Quadratic:
    """Vehicles whose loss is a quadratic function of the changes of the gains, least at given exponents."""

    def __init__(self, seed, exponents):
        self.ratios = np.random.default_rng(seed).uniform(-1.0, 1.0, (64, len(exponents)))
        self.best = self.ratios @ exponents

    def losses(self, tunable, start, changes):
        assert list(start) == list(tunable.names)
        return np.square(changes - self.best).sum(axis=1)


def test_the_fit_finds_the_exponents_of_a_known_optimum(monkeypatch):
    monkeypatch.setattr(exponents, "_DECAY", 0.0)
    best = np.random.default_rng(1).uniform(-0.5, 0.5, (12, len(TUNABLES["backstepping-tuned"].names)))
    found = exponents.fitted("backstepping-tuned", 200, [Quadratic(seed, best) for seed in range(3)], 0.03)
    assert np.abs(found.T - best).max() < 0.1


def test_the_exponents_of_one_controller_do_not_change_the_others(tmp_path, monkeypatch):
    file = tmp_path / "exponents.json"
    file.write_text(json.dumps({"lqi": {"exponents": {}}}))
    monkeypatch.setattr(exponents, "EXPONENTS", file)
    monkeypatch.setattr(exponents, "_CHECK", (2, 1))
    words = ["los-pid", "--steps", "1", "--vehicles", "1", "--sets", "1"]
    assert run(exponents.main, exponents.PROGRAM, words) == 0
    record = json.loads(file.read_text())
    assert record["lqi"] == {"exponents": {}}
    assert record["los-pid"]["command"] == f"{exponents.PROGRAM} {' '.join(words)}"
    assert list(record["los-pid"]["exponents"]) == list(TUNABLES["los-pid"].names)
    assert {len(powers) for powers in record["los-pid"]["exponents"].values()} == {2 * len(RATIOS)}
    assert record["los-pid"]["check"]["vehicles"] == 2


def test_the_check_compares_with_no_exponents():
    best = np.zeros((12, len(TUNABLES["lqi"].names)))
    found = exponents.checked("lqi", best.T + 0.1, Quadratic(0, best))
    growth = np.square(0.1 * Quadratic(0, best).ratios.sum(axis=1)) * best.shape[1]
    assert found["ratio"] == pytest.approx(np.exp(growth.mean()), abs=1e-3)
    assert found["largest"] == pytest.approx(np.exp(growth.max()), rel=1e-3)
    assert found["worse"] == pytest.approx(np.mean(growth > np.log(1.02)), abs=1e-3)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["helm"], "unknown controller 'helm'; allowed are backstepping-tuned"),
        (["lqi", "--steps", "0"], "--steps is 0; it must be at least 1"),
    ],
)
def test_wrong_usage_of_the_fit_is_one_line(arguments, says, capsys):
    assert run(exponents.main, exponents.PROGRAM, arguments) == 2
    assert says in capsys.readouterr().err


def test_the_readme_compares_the_agent_with_searched_gains():
    """One training seed, without fine-tuning."""
    pattern = r"(\d\.\d\d \(\d\.\d\d \.\.\. \d\.\d\d\))"
    page = " ".join((ROOT / "docs/vehicle-gains.md").read_text(encoding="utf-8").split())
    measured = re.search(f"{pattern} times that with searched", page)[1]
    said = rf"searched for each vehicle it is {pattern} at cruise"
    readme = " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())
    [shown] = re.findall(said, readme)
    assert shown == measured
    rows = re.findall(
        rf"^\| `.*\| {pattern} \| {pattern} \|$", (ROOT / "docs/vehicle-gains.md").read_text("utf-8"), re.MULTILINE
    )
    assert (len(rows), sum(float(last.split()[0]) >= 1 for _, last in rows)) == (8, 4)
    assert "and not smaller on four of the eight" in readme

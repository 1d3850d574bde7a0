"""Sealed suites: their episodes need the secret, and their scenarios are outside the training distributions."""

from functools import partial

import numpy as np
import pytest

from auv_gym.scenarios.mixtures import MIXTURES
from baselines.evaluation import suites
from baselines.evaluation.suites import SuiteError
from baselines.tools.command_line import DONE, UsageError
from baselines.training.vehicle_models import DECADES
from research.suites import builder, sealed
from research.suites.command import main


@pytest.fixture
def empty(monkeypatch, tmp_path):
    """Use a file without seals and return a folder for suites."""
    file = tmp_path / "seals.json"
    file.write_text("{}")
    monkeypatch.setattr(sealed, "SEALS", file)
    monkeypatch.setattr(suites, "save_suite", partial(suites.save_suite, folder=tmp_path))
    return tmp_path


def test_from_a_seal_to_a_suite(empty, capsys, monkeypatch):
    monkeypatch.setattr(builder, "SEALED_EPISODES", 1)
    assert main(["seal", "sealed-v2"]) == DONE
    secret = capsys.readouterr().out.split()[-1]
    assert sealed.seals()["sealed-v2"] == sealed.Seal(sealed.sha256(secret), sealed.worlds_hash("sealed-v2"))
    assert secret not in (empty / "seals.json").read_text()
    with pytest.raises(SuiteError, match="is sealed"):
        builder.build("sealed-v2")
    assert main(["open", "sealed-v2", "--secret", secret + "?"]) != DONE
    assert "not the secret" in capsys.readouterr().err
    assert main(["open", "sealed-v2", "--secret", secret]) == DONE
    suite = suites.load_suite("sealed-v2", empty)
    assert [cell.scenario for cell in suite.cells] == sealed.sealed_worlds("sealed-v2")
    again = builder.build("sealed-v2")
    monkeypatch.setitem(sealed.CHANGES, "sealed-v2", sealed.CHANGES["sealed-v3"])
    with pytest.raises(SuiteError, match="the scenarios of sealed-v2 have changed"):
        builder.build("sealed-v2")
    assert all(a.episodes == b.episodes for a, b in zip(suite.cells, again, strict=True))


def test_a_seal_is_not_replaced(empty):
    sealed.write_seal("sealed-v2", sealed.Seal(sealed.sha256("one"), ""))
    with pytest.raises(SuiteError, match="sealed already"):
        sealed.write_seal("sealed-v2", sealed.Seal(sealed.sha256("two"), ""))


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["seal", "ood-v1"], "not a sealed suite"),
        (["open", "sealed-v2"], "needs --secret"),
        (["check", "ood-v1", "--secret", "x"], "no other action"),
        (["open", "sealed-v2", "--secret", "x"], "has no seal"),
        (["seal"], "name the suite"),
    ],
)
def test_wrong_usage(empty, words, message):
    with pytest.raises(UsageError, match=message):
        main(words)


def test_without_a_seal_there_is_no_seed(empty):
    with pytest.raises(SuiteError, match="has no seal"):
        builder.build("sealed-v2")


def slew_time(scenario):
    """Return the time from zero to the limit of the thruster."""
    return scenario.actuators.F_u_max / scenario.actuators.F_u_rate


def test_the_open_suite_has_the_scenarios_of_its_seal():
    assert [cell.scenario for cell in suites.load_suite("sealed-v2").cells] == sealed.sealed_worlds("sealed-v2")


@pytest.mark.parametrize("name", sealed.CHANGES)
def test_every_scenario_is_outside_the_training_distributions(name):
    """In at least one property, such as its speed or its faults.

    `helm-any` alone was trained on long outages and far starts, see docs/suites.md. The lag of its drawn vehicles is
    less than a second, too.
    """
    trained = [s for mixed, mixture in MIXTURES.items() if not mixed.endswith("-outages") for s, _ in mixture]
    speeds = [s.path.speed for s in trained]
    assert all(s.mismatch is None or s.mismatch.mass[0] > sealed.MASS_SHARES[0] for s in trained)
    assert DECADES["lag"][1] < sealed.LAG[0]
    for scenario in sealed.sealed_worlds(name):
        low, high = scenario.path.speed
        act = scenario.actuators
        other = {
            "speed": all(high <= a or b <= low for a, b in speeds),
            "duration": all(scenario.duration > s.duration for s in trained),
            "slew": all(slew_time(scenario) > slew_time(s) for s in trained),
            "outages": scenario.sensors.outages > 0
            and all(scenario.sensors.outage_time[0] >= s.sensors.outage_time[1] for s in trained if s.sensors.outages),
            "start": all(scenario.start.x_e[1] > s.start.x_e[1] for s in trained),
            "vehicle": scenario.mismatch.mass == sealed.MASS_SHARES,
            "faults": scenario.faults is not None and all(s.faults is None for s in trained),
            "lag": all(np.min(act.lag) > np.max(s.actuators.lag) for s in trained),
            "weak": all(np.max(act.effectiveness) < np.min(s.actuators.effectiveness) for s in trained),
            "period": all(scenario.control_dt < s.control_dt for s in trained),
            "turning": scenario.current.turn != 0.0 and all(not s.current or s.current.turn == 0.0 for s in trained),
            "waves": all(not s.waves or scenario.waves.band[0] > s.waves.band[1] for s in trained),
        }
        assert any(other.values()), scenario.name

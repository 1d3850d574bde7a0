"""Sensitivity to model error: the wrong models, the loss of score, the command and its records."""

import json

import numpy as np
import pytest

from auv_gym.physics.vehicle import PAPER_VEHICLE
from baselines.evaluation.side_by_side import SideBySide
from baselines.tools.command_line import run
from baselines.tools.files import read_json
from research.robustness import model_error


def test_wrong_models_are_wrong_in_their_parameters_and_within_their_size():
    """Errors cover the whole range; `ratios` leaves m11 and m33 correct; each model has its own errors."""
    drawn = [model_error.model_errors(k) for k in range(40)]
    assert all(abs(share) <= 1 for own in drawn for share in own.values())
    assert min(own["d11"] for own in drawn) < -0.9
    assert max(own["d11"] for own in drawn) > 0.9
    sets = model_error.PARAMETER_SETS
    by = {name: model_error.wrong_model(PAPER_VEHICLE, drawn[0], 0.6, wrong) for name, wrong in sets.items()}
    assert (by["ratios"].m11, by["ratios"].m33, by["ratios"].speed) == (215, 80, PAPER_VEHICLE.speed)
    assert by["all"].m33 / 80 - 1 == pytest.approx(0.6 * drawn[0]["m33"])
    assert by["all"].d22 == by["ratios"].d22 == pytest.approx(100 * (1 + 0.6 * drawn[0]["d22"]))
    assert model_error.wrong_model(PAPER_VEHICLE, drawn[0], 0.0, sets["all"]) == PAPER_VEHICLE
    assert model_error.model_errors(3) == drawn[3] != drawn[4]


@pytest.fixture
def few(monkeypatch):
    """Make the measurement short: two cases, two models, one size."""
    whole = model_error.cells_of
    monkeypatch.setattr(model_error, "cells_of", lambda speed_range, n: [whole(speed_range, n)[i] for i in (0, 1)])
    monkeypatch.setattr(model_error, "_MODELS", 2)
    monkeypatch.setattr(model_error, "ERROR_SIZES", (0.6,))


@pytest.mark.slow
def test_a_policy_that_does_not_use_its_model_loses_nothing(few, tmp_path):
    """The planned forces do not depend on the given model; the paper's law cancels terms of its model."""
    without = model_error.with_wrong_models("open-loop", "cruise", 6)
    assert without["wrong"]["ratios"][0]["above"] == [0, 0, 0]
    assert without["wrong"]["ratios"][0]["error_m"] == without["right"]["error_m"]
    found = model_error.with_wrong_models("backstepping", "cruise", 6)
    assert found["right"]["score"][0] == pytest.approx(0, abs=1e-3)  # the anchor of score 0, run again
    for rows in found["wrong"].values():
        mean, low, high = rows[0]["above"]
        assert low <= mean <= high
        assert mean == pytest.approx(np.mean(rows[0]["vehicles"]), abs=1e-4)
        assert rows[0]["error_m"] != found["right"]["error_m"]
    (tmp_path / "backstepping.json").write_text(json.dumps({"cruise": found}))
    row = model_error.context("", tmp_path)["records"]["cruise"][1]
    mean, low, high = found["wrong"]["all"][0]["above"]
    shown = ["`backstepping`", "0.000", "m22, drag, m11, m33", f"{mean:+.3f} [{low:+.3f}, {high:+.3f}]"]
    assert row[:4] == shown


def test_command_keeps_what_it_measures(few, tmp_path):
    words = ["--policy", "open-loop", "--speed-range", "cruise", "--episodes", "2", "--out", str(tmp_path)]
    assert run(model_error.main, model_error.PROGRAM, words) == 0
    assert list(read_json(tmp_path / "open-loop.json")) == ["cruise"]
    assert run(model_error.main, model_error.PROGRAM, [*words[:2], "--speed-range", "slow", *words[4:]]) == 0
    assert sorted(read_json(tmp_path / "open-loop.json")) == ["cruise", "slow"]


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--policy", "helmet"], "'helmet'"),
        (["--speed-range", "fast"], "'fast'"),
        (["--episodes", "1"], "--episodes is 1; it must be 2 or more"),
        (["--policy", "oracle"], "oracle uses more than the observation"),
    ],
)
def test_wrong_usage(arguments, says, capsys):
    assert run(model_error.main, model_error.PROGRAM, arguments) == 2
    error = capsys.readouterr().err
    assert says in error
    assert error.count("\n") == 1


@pytest.mark.parametrize("wrong", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_recorded_errors_are_reproduced(wrong):
    """Mean errors in still water, with the true model or over the wrong ones."""
    kept = read_json(model_error.MODEL_ERROR_FOLDER / "helm-any.json")["cruise"]
    cell = model_error.cells_of("cruise", kept["episodes"])[0]
    models, errors = [cell.scenario.vehicle], kept["right"]["error_m"]
    if wrong:
        chosen, size = model_error.PARAMETER_SETS["ratios"], model_error.ERROR_SIZES[-1]
        drawn = [model_error.model_errors(k) for k in range(model_error._MODELS)]
        models = [model_error.wrong_model(cell.scenario.vehicle, each, size, chosen) for each in drawn]
        errors = kept["wrong"]["ratios"][-1]["error_m"]
    episodes = SideBySide([cell])
    found = [
        episodes.run(model_error.policy_with("helm-any", vehicle))[0].steady_rmse.clip(max=2.0) for vehicle in models
    ]
    assert np.mean(found) == pytest.approx(errors[0], rel=1e-2)

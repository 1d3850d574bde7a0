"""The studies of failure rates and model errors: their rows, and what the pages say."""

import numpy as np
import pytest

from auv_gym.physics.vehicle import PAPER_VEHICLE
from research.robustness import failure_rate, model_error


def test_failures_without_feedback_are_counted(monkeypatch):
    """The vehicle drifts away, in batches as in one."""
    monkeypatch.setitem(failure_rate._EPISODES, "open-loop", 5)
    counts = []
    for batch in (2, 5):
        monkeypatch.setattr(failure_rate, "_BATCH", batch)
        counts.append(failure_rate._measure("open-loop", "slow-current"))
    assert counts[0] == pytest.approx(counts[1])
    assert 0 < counts[0]["failed"] <= counts[0]["episodes"] == 5


def test_wrong_models_are_wrong_in_their_parameters_and_within_their_size():
    """Errors cover the whole range; `ratios` leaves m11 and m33 correct; each model has its own errors."""
    drawn = [model_error.model_errors(k) for k in range(40)]
    assert all(abs(share) <= 1 for errors in drawn for share in errors.values())
    assert min(errors["d11"] for errors in drawn) < -0.9
    assert max(errors["d11"] for errors in drawn) > 0.9
    ratios, whole = (model_error.wrong_model(PAPER_VEHICLE, drawn[0], 0.6, name) for name in ("ratios", "all"))
    assert (ratios.m11, ratios.m33, ratios.speed) == (215, 80, PAPER_VEHICLE.speed)
    assert whole.m33 / 80 - 1 == pytest.approx(0.6 * drawn[0]["m33"])
    assert whole.d22 == ratios.d22 == pytest.approx(100 * (1 + 0.6 * drawn[0]["d22"]))
    assert model_error.wrong_model(PAPER_VEHICLE, drawn[0], 0.0, "all") == PAPER_VEHICLE
    assert model_error.model_errors(3) == drawn[3] != drawn[4]


def test_rows_of_a_policy_with_and_without_a_model():
    """Planned forces do not depend on the given model; the paper's law cancels terms of its model."""
    without = model_error._measure("open-loop", "cruise", quick=True)
    assert without["wrong"]["ratios"]["ratio"] == [1, 1, 1]
    assert without["wrong"]["ratios"]["error_m"] == without["right"]["error_m"]
    record = model_error._measure("backstepping", "cruise", quick=True)
    for wrong in record["wrong"].values():
        mean, low, high = wrong["ratio"]
        assert low <= mean <= high
        growth = np.divide(wrong["error_m"], record["right"]["error_m"])
        assert mean == pytest.approx(np.exp(np.log(growth).mean()))
        assert min(wrong["models"]) < mean < max(wrong["models"])


def test_the_page_shows_the_growth_of_errors():
    page, wrong = model_error.context(), model_error.STUDY.values()["ekf", "cruise"]["wrong"]["all"]
    mean, low, high = wrong["ratio"]
    (row,) = (row for row in page["rows"] if row[0] == "`ekf`")
    shown = row[1 + page["columns"].index("cruise: m22, drag, m11, m33")]
    assert shown == f"{mean:.2f} ({low:.2f} ... {high:.2f}), {wrong['failed']}"
    assert page["runs"] == {1584}


@pytest.mark.slow
def test_recorded_errors_are_reproduced_and_the_sentence_of_the_page_is_true():
    """Mean errors of the first case with the true model; agents depend little on m22 and on drag, controllers do."""
    cell, values = model_error.cells_of("cruise")[0], model_error.STUDY.values()
    batch = model_error.SideBySide([cell])
    ((errors,), _) = model_error._errors("helm-any", cell.scenario.vehicle, batch, "cruise")
    assert errors.mean() == pytest.approx(values["helm-any", "cruise"]["right"]["error_m"][0], rel=1e-2)
    for speed_range in ("slow", "cruise"):
        ratios = {p: values[p, speed_range]["wrong"]["ratios"]["ratio"][0] for p in model_error._POLICIES}
        assert ratios["helm"] < 1.1
        assert ratios["helm-any"] < 1.6
        assert 6 < min(ratios["ekf"], ratios["nmpc"]) < max(ratios["ekf"], ratios["nmpc"]) < 11.5

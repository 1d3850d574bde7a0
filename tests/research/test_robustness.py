"""The studies of faults, guards, failure rates and model errors: their rows, and what the pages say."""

import re

import numpy as np
import pytest

from auv_gym.physics.vehicle import PAPER_VEHICLE
from baselines import make_policy
from baselines.evaluation.rollout import rollout
from baselines.evaluation.suites import load_suite
from research.robustness import failure_rate, faults, model_error


def test_the_suite_has_each_fault_in_its_episodes():
    suite = load_suite("faults-v1")
    for cell in suite.cells:
        kinds = {fault.kind for episode in cell.episodes for fault in episode.faults}
        assert kinds == set(cell.scenario.faults.kinds if cell.scenario.faults else ()), cell.scenario.name
        for episode in cell.episodes:
            for fault in episode.faults:
                assert 3.0 - 1e-3 <= fault.end - fault.begin <= 10.0 + 1e-3
    assert sum(bool(cell.scenario.faults) for cell in suite.cells) == len(suite.cells) - 4


@pytest.mark.filterwarnings("ignore:these gains are stable up to")  # the suite has faster references
def test_rows_are_those_of_rollouts():
    """An agent for cruise has no row in slow motion."""
    rows = faults._measure("sealed-v2", "apg-cruise:guard", quick=True)
    cells = [c for c in load_suite("sealed-v2").cells if c.scenario.name.startswith("cruise")][:2]
    assert list(rows) == [cell.scenario.name for cell in cells]
    for cell in cells:
        ended = rollout(make_policy("apg-cruise:guard"), cell.scenario, cell.episodes[:2]).measures
        failed = ended.failed | (ended.steady_rmse >= 2.0)
        row = rows[cell.scenario.name]
        assert (row["episodes"], row["failed"]) == (2, failed.sum())
        assert row["error_mm"] == pytest.approx(1e3 * np.where(failed, 2.0, ended.steady_rmse).mean(), abs=0.01)


def test_the_page_shows_the_rows():
    shown, values = faults.context(), faults.STUDY.values()
    before, after = (values["faults-v1", policy]["slow-heading-frozen"] for policy in ("helm", "helm:checked"))
    cell = f"{before['failed']}; {before['error_mm'] / 10:.3g} -> {after['failed']}; {after['error_mm'] / 10:.3g}"
    (_, table), _ = shown["tables"]
    (row,) = (line for line in table.splitlines() if line.startswith("| heading frozen |"))
    assert cell in row
    assert shown["failures"][0] > shown["failures"][1]


def test_a_guard_helps_an_agent_that_was_not_trained_on_rate_limits_and_not_helm():
    """As docs/safety.md says, in sealed-v2."""
    values = faults.STUDY.values()
    failed = {
        policy: sum(row["failed"] for row in values["sealed-v2", policy].values())
        for policy in ("apg-cruise", "apg-cruise:guard", "helm", "helm:guard")
    }
    assert failed["apg-cruise"] > failed["apg-cruise:guard"]
    assert failed["helm"] < failed["helm:guard"]
    (row,) = (row for row in faults.guards() if row[0] == "`helm`")
    assert re.sub(r"; \S+", "", row[2]) == f"{failed['helm']} -> {failed['helm:guard']}"


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
    assert without["cases"] == ["noise", "current"]
    assert without["wrong"]["ratios"][0]["ratio"] == [1, 1, 1]
    assert without["wrong"]["ratios"][0]["error_m"] == without["right"]["error_m"]
    record = model_error._measure("backstepping", "cruise", quick=True)
    for rows in record["wrong"].values():
        mean, low, high = rows[-1]["ratio"]
        assert low <= mean <= high
        growth = np.divide(rows[-1]["error_m"], record["right"]["error_m"])
        assert mean == pytest.approx(np.exp(np.log(growth).mean()))
        assert min(rows[-1]["models"]) < mean < max(rows[-1]["models"])


def test_the_page_shows_the_growth_of_errors():
    shown, values = model_error.context()["records"]["slow"], model_error.STUDY.values()
    mean, low, high = values["helm", "slow"]["wrong"]["all"][-1]["ratio"]
    (row,) = (row for row in shown if row[:2] == ["`helm`", "m22, drag, m11, m33"])
    assert row[4] == f"{mean:.2f} ({low:.2f} ... {high:.2f})"


@pytest.mark.slow
def test_recorded_errors_are_reproduced_and_the_sentence_of_the_page_is_true():
    """Mean errors of the first case with the true model; agents depend little on m22 and on drag, controllers do."""
    cell, values = model_error.cells_of("cruise")[0], model_error.STUDY.values()
    batch = model_error.SideBySide([cell])
    ((errors,), _) = model_error._errors("helm-any", cell.scenario.vehicle, batch, "cruise")
    assert errors.mean() == pytest.approx(values["helm-any", "cruise"]["right"]["error_m"][0], rel=1e-2)
    for speed_range in ("slow", "cruise"):
        ratios = {p: values[p, speed_range]["wrong"]["ratios"][-1]["ratio"][0] for p in model_error._POLICIES}
        assert ratios["helm"] < 1.1
        assert ratios["helm-any"] < 1.6
        assert min(ratios["ekf"], ratios["nmpc"]) > 10.0

"""Held-out episodes are in no suite, and the recorded rows of policies on them are reproduced."""

from pathlib import Path

import numpy as np
import pytest

from baselines.evaluation import recorded, suites
from baselines.evaluation.runner import Task, drawn
from baselines.tools.command_line import UsageError
from research.results.learning import context, held_out_results
from research.seeds import HELD_OUT
from research.suites import command, held_out

ROOT = Path(__file__).parents[2]
pytestmark = pytest.mark.slow  # recorded rows of all policies are read


@pytest.fixture(scope="module")
def results_of_all():
    return held_out_results()


def test_held_out_episodes_are_in_no_suite():
    suite, frozen = held_out.held_out("benchmark-v2"), suites.load_suite("benchmark-v1")
    known, new = ({episode.noise_seed for cell in own.cells for episode in cell.episodes} for own in (frozen, suite))
    assert not known & new
    assert suite.hash != frozen.hash
    assert HELD_OUT.holds(held_out.HELD_OUT_SEED, max(held_out.HELD_OUT_EPISODES.values()))


@pytest.mark.parametrize("policy", ["backstepping", "apg-cruise", "apg-preview-cruise"])
def test_recorded_rows_are_reproduced(results_of_all, policy):
    results = next(r for r in results_of_all if r.suite.name == "benchmark-v2")
    kept = next(r for r in results.runs if (r.policy, r.scenario.name) == (policy, "cruise-storm"))
    cell = drawn(kept.scenario, 2, held_out.HELD_OUT_SEED)
    again = Task(policy, cell.scenario, cell.episodes).run()[1].rollout
    np.testing.assert_allclose(again.measures.steady_rmse, kept.measures.steady_rmse[:2], rtol=1e-4)


def test_the_command_keeps_rows(tmp_path, monkeypatch):
    monkeypatch.setattr(held_out, "HELD_OUT_FOLDER", tmp_path)
    monkeypatch.setattr(held_out, "HELD_OUT_EPISODES", {"benchmark-v2": 2})
    assert command.main(["record", "benchmark-v2", "--held-out", "--policy", "open-loop"]) == 0
    suite = held_out.held_out("benchmark-v2")
    assert [len(run.measures) for run in recorded.load_recorded(suite, tmp_path).runs] == [2] * len(suite.cells)
    held_out.HELD_OUT_EPISODES["benchmark-v2"] = 3
    assert recorded.load_recorded(held_out.held_out("benchmark-v2"), tmp_path).refused
    with pytest.raises(UsageError, match="--held-out is for record of benchmark-v2"):
        command.main(["record", "ood-v1", "--held-out"])
    with pytest.raises(UsageError, match="--held-out excludes --episodes"):
        command.main(["record", "benchmark-v2", "--held-out", "--episodes", "1"])


def test_the_sentences_of_the_page_and_of_the_readme_are_true():
    """`helm` leads `nmpc`, as in the README; no agent leads `nmpc-adverse`, and `helm-any` at cruise is level."""
    leads = {suite: rows for suite, (_, rows) in context()["leads"].items()}
    rows = {suite: [line.strip("| ").split(" | ") for line in text.splitlines()[2:]] for suite, text in leads.items()}
    own = {row[0]: row for row in rows["benchmark-v2"]}
    for speed_range in ("slow", "cruise"):
        assert all(float(own[f"`helm`, {speed_range}"][column].split(" ... ")[0]) > 0 for column in (4, 6))
        assert abs(float(own[f"`apg-{speed_range}`"][2]) - float(own[f"`apg-scratch-{speed_range}`"][2])) < 0.005
    level = ["`helm-any`, cruise", "`helm-any-first`, cruise"]
    intervals = {row[0]: [float(end) for end in row[4].split(" ... ")] for row in rows["unmodelled-v1"]}
    assert [agent for agent, (_, high) in intervals.items() if high >= 0] == level
    assert all(low < 0 for low, _ in intervals.values())
    readme = " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())
    slow, cruise = (own[f"`helm`, {speed_range}"][3] for speed_range in ("slow", "cruise"))
    assert f"by {slow} in slow motion and by {cruise} at cruise" in readme

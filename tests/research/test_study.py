"""The study of trained agents: its scores compared with those of the evaluation, its files, its page of results."""

import shlex
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from baselines.agents.agent import Agent
from baselines.agents.features import FEATURES
from baselines.agents.names import AGENT_FOLDER
from baselines.agents.networks import Gru
from baselines.evaluation.score import EXPERT, ORACLE, lead, score, seeds_score
from baselines.tools.command_line import parse, run
from baselines.training.options import Options
from research.results import learning
from research.results.collection import results_of
from research.trainings import study
from research.trainings.study_files import InSuite, Study, load_studies, save_study
from research.trainings.trainings import FIRST_TRAININGS, request_of, training

SPEED_RANGE, SUITE = "cruise", "benchmark-v1"


@pytest.fixture(scope="module")
def results():
    return results_of(SUITE)


def runs_of(results, policy):
    return [r for r in results.runs if r.policy == policy and r.scenario.name.startswith(SPEED_RANGE)]


def steady_rmses(results, policy):
    return [run.measures.steady_rmse for run in runs_of(results, policy)]


@pytest.fixture(scope="module")
def made(results):
    """Return the study of two seeds with the runs of two controllers."""
    own = {SUITE: [runs_of(results, "ekf"), runs_of(results, "integral")]}
    return Study.of(SPEED_RANGE, "python train.py", own)


def test_seeds_that_differ_widen_the_interval(results, made):
    expert, oracle = steady_rmses(results, EXPERT), steady_rmses(results, ORACLE)
    mixed = seeds_score(expert, made.suites[SUITE].steady_rmses, oracle)
    alone = [score(expert, steady_rmses(results, p), oracle).mean for p in ("ekf", "integral")]
    assert mixed.mean == pytest.approx(np.mean(alone))
    assert mixed.ci95[0] < min(alone) + 0.1
    assert mixed.ci95[1] > max(alone) - 0.1


def test_a_saved_study_can_be_loaded(made, tmp_path):
    save_study("a", made, tmp_path)
    loaded = load_studies(tmp_path)["a"]
    assert (loaded.speed_range, loaded.command) == (made.speed_range, made.command)
    before, after = made.suites[SUITE], loaded.suites[SUITE]
    assert after.cells == before.cells
    for a, b in zip(after.steady_rmses, before.steady_rmses, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-6)
    np.testing.assert_array_equal(np.concatenate(after.failed, axis=1), np.concatenate(before.failed, axis=1))
    np.testing.assert_array_equal(after.smoothness, before.smoothness)


def test_results_of_a_changed_suite_are_ignored(made, tmp_path):
    old = replace(made, suites={SUITE: replace(made.suites[SUITE], hash="0" * 64)})
    save_study("a", old, tmp_path)
    assert load_studies(tmp_path)["a"].suites == {}


def test_page_has_a_row_for_each_agent(results, made):
    (row,) = learning.lead_rows(results, None, {"mine": made, "short-ekf": made}, "lqi")
    expert, oracle, lqi = (steady_rmses(results, p) for p in (EXPERT, ORACLE, "lqi"))
    own = made.suites[SUITE]
    score_of, above = seeds_score(expert, own.steady_rmses, oracle), lead(expert, lqi, own.steady_rmses, oracle)
    assert row[1:4] == ["2", f"{score_of.mean:.3f}", f"{above.mean:.3f}"]
    failed = sum(
        int((r.measures.failed | (r.measures.steady_rmse >= 2.0)).sum())
        for p in ("ekf", "integral")
        for r in runs_of(results, p)
    )
    assert row[7].startswith(f"{failed} of {2 * sum(map(len, expert))} (<= ")


def test_failures_added_and_prevented_by_hand():
    """From the files: a failure is an early end, or an error of at least the cap of 2 m."""
    suite = results_of("unmodelled-v1")
    failed = {}
    for policy in ("backstepping", "apg-cruise"):
        own = [r.measures for r in runs_of(suite, policy)]
        failed[policy] = np.concatenate([m.failed | (m.steady_rmse >= 2.0) for m in own])
    added = int((failed["apg-cruise"] & ~failed["backstepping"]).sum())
    prevented = int((~failed["apg-cruise"] & failed["backstepping"]).sum())
    assert learning.versus_expert(suite, "apg-cruise") == (added, prevented, len(failed["apg-cruise"]))
    assert added > 0 < prevented


def test_a_failed_run_is_refused(results):
    bad = replace(runs_of(results, "ekf")[0], measures=None, error="it broke")
    with pytest.raises(ValueError, match="failed in cruise-calm: it broke"):
        InSuite.of(SUITE, [[bad]])


def test_trained_agents_are_run_on_the_cells_of_their_speed_range(tmp_path, monkeypatch):
    """Two agents with zero networks have the results of their expert in every episode."""
    network = Gru(len(FEATURES), 2, 2, 2)
    zeros = {name: np.zeros(shape, np.float32) for name, shape in network.shapes.items()}
    folders = [tmp_path / f"seed-{i}" for i in range(2)]
    for folder in folders:
        Agent(network, zeros, "backstepping", (0.3, 0.3)).save(folder / AGENT_FOLDER)
    few = [replace(cell, episodes=cell.episodes[:2]) for cell in study.suite_cells(SUITE, SPEED_RANGE)[:2]]
    monkeypatch.setattr(study, "suite_cells", lambda suite, speed_range: few)
    variant = study.Variant(SPEED_RANGE, training("apg", SPEED_RANGE), (SUITE,))
    request = SimpleNamespace(folders=folders, command="python train.py")
    found = study.studied(variant, request, 1)
    first = results_of(SUITE)
    for cell, own in zip(few, found.suites[SUITE].steady_rmses, strict=True):
        expert = next(r for r in first.runs if r.policy == EXPERT and r.scenario.name == cell.scenario.name)
        np.testing.assert_allclose(own, np.stack([expert.measures.steady_rmse[:2]] * 2), rtol=1e-5)


def test_trainings_are_what_train_py_can_repeat(tmp_path):
    small = training("ppo", SPEED_RANGE, (0.2, 0.4), timesteps=5000, changes={"gamma": 0.5})
    request = request_of(replace(small, seeds=2), tmp_path / "a")
    assert [config.seed for config in request.configs] == [0, 1]
    assert request.configs[0].authority == (0.2, 0.4)
    assert request.configs[0].hyperparameters["gamma"] == 0.5
    assert "--authority 0.2 0.4 --seeds 2 --timesteps 5000 --set gamma=0.5" in request.command
    assert parse(Options, shlex.split(request.command)[2:], "train.py") == replace(small, seeds=2)
    plain = request_of(training("ppo", SPEED_RANGE), tmp_path / "b")
    assert plain.command == f"python train.py --algo ppo --scenario {SPEED_RANGE}"


@pytest.mark.parametrize("name", study.VARIANTS)
def test_variants_can_be_trained(name, tmp_path):
    variant = study.VARIANTS[name]
    shipped = {"from_": "helm-any"} if variant.training.from_ in FIRST_TRAININGS else {}  # not trained here
    request = request_of(replace(variant.training, **shipped), tmp_path / name)
    assert len(request.configs) == variant.training.seeds > 1
    assert any(scenario.name.startswith(variant.speed_range) for scenario, _ in request.configs[0].scenarios)


def test_unknown_variants_are_named(monkeypatch):
    monkeypatch.setattr("sys.argv", ["study", "nonsense"])
    assert run(study.main, study.PROGRAM) == 2


def test_failures_have_the_error_cap_of_their_cell():
    """An error of a metre is a failure in slow motion, but not with dead reckoning."""
    steady_rmse, ended = np.array([[1.0, 0.1]]), np.zeros((1, 2), bool)
    own = InSuite("", ("slow-calm", "slow-deep"), (steady_rmse, steady_rmse), (ended, ended), np.zeros(1))
    assert own.count_failures() == 1
    np.testing.assert_array_equal(own.capped(), [[[0.6, 0.1]], [[1.0, 0.1]]])

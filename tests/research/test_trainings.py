"""The shipped trainings and those of the study: they can be repeated, and their records agree with the runs."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from auv_gym.scenarios.presets import PRESETS, SPEED_RANGES
from baselines.agents.agent import Agent
from baselines.agents.features import FEATURES
from baselines.agents.names import AGENT_FOLDER, SHIPPED_FOLDER, agent_folder, shipped_agents
from baselines.agents.networks import Gru
from baselines.evaluation.cells import drawn
from baselines.evaluation.episodes import run_episode
from baselines.evaluation.metrics import Measures
from baselines.evaluation.runner import run_all
from baselines.evaluation.suites import Suite
from baselines.tools.command_line import DONE
from baselines.training.config import Config
from research.trainings import command, fine_tuning, registered, seed_runs
from research.trainings.seed_runs import SeedRuns, trained
from research.trainings.trainings import FIRST_TRAININGS, SEED_TRAININGS, SHIPPED_TRAININGS, request_of


def measures(steady_rmse, failed=(), rate=1.0):
    steady_rmse = np.array(steady_rmse, dtype=np.float64)
    ones, gone = np.ones(len(steady_rmse)), np.isin(np.arange(len(steady_rmse)), failed)
    return Measures(steady_rmse, steady_rmse, ones, ones, rate * ones, ones, ones, ones, gone)


def test_results_of_seeds_by_hand():
    """An error of a metre is a failure in slow motion, where the error cap is 0.6 m; at cruise it is 2 m."""
    seeds = SeedRuns({
        "slow-calm": [measures([1.0, 0.1]), measures([0.2, 0.3], failed=[1])],
        "cruise-calm": [measures([1.0, 2.5], rate=3.0), measures([0.1, 0.1], rate=3.0)],
    })  # fmt: skip
    assert (seeds.seeds, seeds.failed, seeds.episodes, seeds.smoothness) == (2, 3, 8, 2.0)
    np.testing.assert_array_equal(seeds.steady_rmses["cruise-calm"], [[1.0, 2.5], [0.1, 0.1]])
    np.testing.assert_array_equal(seeds.capped["slow-calm"], [[0.6, 0.1], [0.2, 0.6]])


def test_every_training_is_recorded_with_its_seeds():
    names = {suite: {} for suite in ("benchmark-v2", "vehicles-v2")}
    for name, entry in SEED_TRAININGS.items():
        for suite in entry.suites:
            names[suite] |= dict.fromkeys(entry.recorded_names(name), entry.seeds)
    names[registered.SUITE] |= dict.fromkeys(registered.TRAININGS, registered.SEEDS)
    for suite, seeds in names.items():
        assert {name: runs.seeds for name, runs in trained(suite).items()} == seeds
    speed_ranges = {tuple(entry.recorded_names(name).values()) for name, entry in SEED_TRAININGS.items()}
    assert speed_ranges == {("slow",), ("cruise",), SPEED_RANGES}


@pytest.mark.parametrize("name", SEED_TRAININGS)
def test_trainings_of_the_study_can_begin(name, tmp_path):
    entry = SEED_TRAININGS[name]
    start = {"from_": "helm-any"} if entry.training.from_ in FIRST_TRAININGS else {}  # not trained here
    request = request_of(replace(entry.training, seeds=entry.seeds, **start), tmp_path)
    assert len(request.configs) == entry.seeds > 1
    for speed_range in entry.recorded_names(name).values():
        assert any(scenario.name.startswith(speed_range) for scenario, _ in request.configs[0].scenarios)


@pytest.mark.parametrize("name", SHIPPED_TRAININGS)
def test_shipped_agents_are_those_of_their_trainings(name, tmp_path, monkeypatch):
    """The agent that ships was trained with the configuration that the command makes."""
    begun = []

    def begin(request):
        begun.append(request)
        if request.out.name not in FIRST_TRAININGS:
            return 1
        shutil.copytree(agent_folder(name), request.out / AGENT_FOLDER)
        return DONE

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(command, "train_all", begin)
    assert command.main([name, "--timesteps", "100"]) == 1
    [config] = begun[-1].configs
    assert config.timesteps == 100
    shipped = Config.from_dict(json.loads((SHIPPED_FOLDER / name / "agent.json").read_text())["training"]["config"])
    origin = shipped.origin if len(begun) > 1 else config.origin  # the agent of the first training
    assert shipped == replace(config, timesteps=shipped.timesteps, origin=origin)
    assert set(SHIPPED_TRAININGS) == set(shipped_agents())


def agent_of_zeros():
    """Return an agent whose corrections are zero, with its expert's results."""
    network = Gru(len(FEATURES), 2, 2, 2)
    zeros = {name: np.zeros(shape, np.float32) for name, shape in network.shapes.items()}
    return Agent(network, zeros, "backstepping", (0.3, 0.3))


def test_agents_of_the_study_run_on_the_cells_of_their_speed_range(tmp_path, monkeypatch):
    cells = tuple(drawn(replace(PRESETS[name], steps=60), 2, 0) for name in ("slow-noise", "cruise-noise"))
    suite = Suite("benchmark-v2", "its hash", cells, ())

    def train(request):
        assert len(request.folders) == 5
        for folder in request.folders:
            agent_of_zeros().save(folder / AGENT_FOLDER)
        return DONE

    monkeypatch.chdir(tmp_path)
    for module in (command, seed_runs):
        monkeypatch.setattr(module, "load_suite", lambda _: suite)
    monkeypatch.setattr(command, "train_all", train)
    monkeypatch.setattr(seed_runs, "SEED_RUNS", tmp_path)
    for _ in range(2):  # a second call replaces the results of the first
        shutil.rmtree(command.STUDY_RUNS, ignore_errors=True)
        assert command.main(["apg-cruise", "--study", "--jobs", "1"]) == DONE
    ((name, seeds),) = trained("benchmark-v2").items()
    (expert,) = run_all(("backstepping",), cells[1:])
    assert (name, list(seeds.steady_rmses)) == ("apg-cruise", ["cruise-noise"])
    np.testing.assert_allclose(seeds.steady_rmses["cruise-noise"], [expert.measures.steady_rmse] * 5, rtol=1e-5)


def test_a_fine_tuned_agent_is_compared_with_the_best_controller():
    def row(error, failed, rate):
        return {"steady_rmses": [[error, error], [2 * error, 2 * error]], "failed": failed, "command_rate": rate}

    rows = {name: row(9.0, 2, 1.0) for name in fine_tuning.CONTROLLERS}
    rows |= {"ekf": row(2.0, 3, 1.0), "nmpc": row(5.0, 1, 4.0), fine_tuning.BASE_AGENT: row(4.0, 0, 2.0)}
    rows |= {fine_tuning.TUNED_AGENT: {**row(1.0, 5, 2.0), "seconds": 61.4}}
    assert fine_tuning.best_controller(rows) == "ekf"
    ratios = ["2.00 (2.00 ... 2.00)", "0.50 (0.50 ... 0.50)", "0.25 (0.25 ... 0.25)"]
    assert fine_tuning.row_of("otter", rows) == ["`otter`", "`ekf`", *ratios, "3, 1, 0, 5", "0.50", "61"]


def test_ppo_learns_on_the_environments_as_registered(tmp_path):
    """In a quick form of the study: the model is the policy of an evaluation, and a second call trains nothing."""
    for name in registered.TRAININGS:
        file = registered.train(name, 0, 1, tmp_path)
        written = Path(file).stat().st_mtime_ns
        assert registered.train(name, 0, 1, tmp_path) == file
        assert Path(file).stat().st_mtime_ns == written
        assert run_episode(file, "cruise-calm", seed=0).actions.any()

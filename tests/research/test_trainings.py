"""The shipped trainings and those of the study: they can be repeated, and their records agree with the runs."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from auv_gym.scenarios.presets import PRESETS, SPEED_RANGES
from baselines.agents.agent import Agent
from baselines.agents.features import FEATURES
from baselines.agents.names import AGENT_FOLDER, SHIPPED_FOLDER, shipped_agents
from baselines.agents.networks import Gru
from baselines.evaluation.cells import drawn
from baselines.evaluation.metrics import Measures
from baselines.evaluation.runner import run_all
from baselines.evaluation.suites import Suite
from baselines.tools.command_line import DONE
from baselines.training.config import Config
from research.results import error_only
from research.trainings import command, fine_tuning, seed_runs
from research.trainings.seed_runs import SeedRuns, trained
from research.trainings.trainings import ABLATIONS, SEED_TRAININGS, SHIPPED_TRAININGS, request_of


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
    np.testing.assert_array_equal(seeds.capped["slow-calm"], [[0.6, 0.1], [0.2, 0.6]])


def test_every_training_is_recorded_with_its_seeds():
    seeds = {"benchmark-v3": {}, "space-v1": {}, "vehicles-v3": {}}
    for name, entry in SEED_TRAININGS.items():
        for suite in entry.suites:
            seeds[suite][name] = entry.seeds
    seeds[error_only.SUITE][error_only.NAME] = 1
    for suite, expected in seeds.items():
        assert {name: runs.seeds for name, runs in trained(suite).items()} == expected


@pytest.mark.parametrize("name", SEED_TRAININGS)
def test_trainings_of_the_study_can_begin(name, tmp_path):
    entry = SEED_TRAININGS[name]
    request = request_of(replace(entry.training, seeds=entry.seeds), tmp_path)
    assert len(request.configs) == entry.seeds
    assert (entry.seeds > 1) != (name in ABLATIONS)
    for speed_range in ("space",) if "space-v1" in entry.suites else SPEED_RANGES:
        assert any(scenario.name.startswith(speed_range) for scenario, _ in request.configs[0].scenarios)


@pytest.mark.parametrize("name", SHIPPED_TRAININGS)
def test_shipped_agents_are_those_of_their_trainings(name, tmp_path, monkeypatch):
    """The agent that ships was trained with the configuration that the command makes."""
    begun = []

    def begin(request):
        begun.append(request)
        return 1

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(command, "train_all", begin)
    assert command.main([name, "--timesteps", "100"]) == 1
    [config] = begun[-1].configs
    assert config.timesteps == 100
    shipped = Config.from_dict(json.loads((SHIPPED_FOLDER / name / "agent.json").read_text())["training"]["config"])
    assert shipped == replace(config, timesteps=shipped.timesteps)
    assert set(SHIPPED_TRAININGS) == set(shipped_agents())


def agent_of_zeros():
    """Return an agent whose corrections are zero, with its expert's results."""
    network = Gru(len(FEATURES), 2, 2, 2)
    zeros = {name: np.zeros(shape, np.float32) for name, shape in network.shapes.items()}
    return Agent(network, zeros, "backstepping", (0.3, 0.3))


def test_agents_of_the_study_run_on_the_cells_of_the_suite(tmp_path, monkeypatch):
    cells = tuple(drawn(replace(PRESETS[name], steps=60), 2, 0) for name in ("slow-noise", "cruise-noise"))
    suite = Suite("benchmark-v3", "its hash", cells, ())

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
        assert command.main(["helm", "--study", "--jobs", "1"]) == DONE
    ((name, seeds),) = trained("benchmark-v3").items()
    assert (name, list(seeds.capped)) == ("helm", ["slow-noise", "cruise-noise"])
    for run in run_all(("backstepping",), cells):
        found = [m.steady_rmse for m in seeds.measures[run.scenario.name]]
        np.testing.assert_allclose(found, [run.measures.steady_rmse] * 5, rtol=1e-5)


def test_an_agent_of_a_vehicle_is_compared_where_the_optimum_succeeds():
    """The optimum fails in the last episode; so does everything else, and the agent once more."""
    errors = {"nmpc": [4.0, 4.0, 9.0], "helm-any": [2.0, 6.0, 9.0], "clairvoyant": [1.0, 1.0, 9.0]}
    errors |= {"tuned": [1.0, 3.0, 9.0], "tuned:guard": [1.0, 1.0, 9.0], "los-pid": [9.0, 9.0, 9.0]}
    failed = {name: [2] for name in errors} | {"tuned": [1, 2], "los-pid": [0, 1, 2]}
    row = fine_tuning.row_of("lauv", {"best": "nmpc", "seconds": 61.4, "errors": errors, "failed": failed})
    assert [cell.split()[0] for cell in row[2:5]] == ["1.00", "0.50", "2.00"]
    assert row[:2] + row[5:] == ["`lauv`", "`nmpc`", "1, 1, 2, 1, 1", "1", "61"]

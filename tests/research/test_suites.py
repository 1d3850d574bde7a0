"""Frozen suites: complete, unchanged, reproducible, and refused if they are damaged."""

import bz2
import hashlib
from dataclasses import replace

import numpy as np
import pytest

from auv_gym.installation import found
from auv_gym.planning.paths import PATHS
from auv_gym.scenarios.presets import CASES
from baselines.agents.agent import Agent
from baselines.agents.features import FEATURES
from baselines.agents.networks import Gru
from baselines.evaluation import recorded, suites
from baselines.evaluation.options import Options
from baselines.evaluation.recorded import DIGITS
from baselines.evaluation.report.numbers import compare, pool
from baselines.evaluation.request import Request
from baselines.evaluation.runner import Cell, drawn, run_all
from baselines.evaluation.score import BY_BOUND
from baselines.evaluation.suites.anchor_errors import ANCHOR_ERRORS_FILE, recorded_anchor_errors, write_anchor_errors
from baselines.tools.command_line import UsageError
from baselines.tools.files import read_json, versions
from research.suites import sealed
from research.suites.builder import BUILDERS, FAMILIES, SHARED, anchors_of, build
from research.suites.command import main

NAMES = suites.list_suites()
OWN = [name for name in NAMES if name not in SHARED]
"""Suites with episodes of their own."""


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """Return a folder with a suite of two cells, three episodes each."""
    folder = tmp_path_factory.mktemp("suites")
    whole = suites.load_suite("benchmark-v1-validation")
    cells = [Cell(c.scenario, c.episodes[:3]) for c in (whole.cells[7], whole.cells[14])]
    suites.save_suite("small", cells, folder)
    return folder


def test_every_suite_has_its_file():
    closed = {name for name, seal in sealed.seals().items() if seal.secret is None}
    assert set(NAMES) == {*BUILDERS, *SHARED} - closed
    for name in NAMES:
        file = found(suites.SUITES_FOLDER, f"{name}.json.bz2")
        assert file.stat().st_size < 3e6
        assert hashlib.sha256(bz2.decompress(file.read_bytes())).hexdigest() == suites.load_suite(name).hash


def test_the_benchmark_has_all_cases_and_families():
    suite = suites.load_suite("benchmark-v1")
    assert [cell.scenario.name for cell in suite.cells] == [f"{r}-{c}" for r in ("slow", "cruise") for c in CASES]
    for cell in suite.cells:
        families = [next(n for n, cls in PATHS.items() if type(e.path) is cls) for e in cell.episodes]
        assert {family: families.count(family) for family in FAMILIES} == dict.fromkeys(FAMILIES, 52)
    seeds = [e.noise_seed for name in OWN for cell in suites.load_suite(name).cells for e in cell.episodes]
    assert len(set(seeds)) == len(seeds)  # no episode of a test is one of the validation split


@pytest.mark.slow
def test_benchmark_v2_has_the_same_episodes_and_the_optimum_scores_1(tmp_path):
    old, new = suites.load_suite("benchmark-v1"), suites.load_suite("benchmark-v2")
    assert new.cells is old.cells
    assert old.hash == "4cee6c9f29e0accf0221a233bbf0b47e952c48d322b9f7888d4590f5a96d4fe3"
    assert new.hash != old.hash
    assert (old.anchors, new.anchors) == (("backstepping", "oracle"), ("backstepping", "clairvoyant"))
    assert new.source == old.source == ("benchmark-v1", old.hash)
    rows = recorded.load_recorded(new)
    assert len(rows.runs) == len(recorded.load_recorded(old).runs) > 16
    steady_rmses = {}
    for run in rows.runs:
        if run.scenario.name.startswith("cruise-") and len(run.measures) == 260:
            steady_rmses[run.policy] = steady_rmses.get(run.policy, 0.0) + run.measures.steady_rmse.mean() / len(CASES)
    for suite, best in ((old, "oracle"), (new, "clairvoyant")):
        (entry,) = (e for e in pool(rows.runs, suite.anchors) if (e.policy, e.place) == ("nmpc", "cruise"))
        expected = (steady_rmses["backstepping"] - steady_rmses["nmpc"]) / (
            steady_rmses["backstepping"] - steady_rmses[best]
        )
        assert entry.score.mean == pytest.approx(expected, rel=1e-9)


def test_a_suite_with_shared_episodes_needs_the_very_same_episodes(small, tmp_path):
    for name in ("small.json.bz2", suites.SUMS):
        (tmp_path / name).write_bytes((small / name).read_bytes())
    digest = suites.save_shared("other", "small", BY_BOUND, tmp_path)
    other = suites.load_suite("other", tmp_path)
    assert (other.hash, other.anchors, other.source[0]) == (digest, BY_BOUND, "small")
    recorded.save_recorded(other, run_all(("open-loop",), other.cells), versions(), tmp_path / "rows")
    found = recorded.load_recorded(suites.load_suite("small", tmp_path), tmp_path / "rows")
    assert [run.policy for run in found.runs] == ["open-loop"] * 2
    folder = tmp_path / "folder"
    folder.mkdir()
    for name in ("other.json.bz2", suites.SUMS):
        (folder / name).write_bytes((tmp_path / name).read_bytes())
    suites.save_suite("small", other.cells[:1], folder)
    with pytest.raises(suites.SuiteError, match="refers to another small; this one has the hash"):
        suites.load_suite("other", folder)


def test_new_suites_have_their_anchors(small, tmp_path):
    cells = suites.load_suite("small", small).cells
    suites.save_suite("new", cells[:1], tmp_path, anchors_of("new"))
    assert suites.load_suite("new", tmp_path).anchors == BY_BOUND


def test_paths_out_of_distribution_are_no_training_paths():
    cells = {cell.scenario.name: cell for cell in suites.load_suite("ood-v1").cells}
    for name, family in (("slow-lawnmower", "lawnmower"), ("cruise-waypoints", "spline")):
        assert family not in FAMILIES
        assert {type(e.path) for e in cells[name].episodes} == {PATHS[family]}
    assert all(e.vehicle.m22 > e.vehicle.m11 for e in cells["cruise-all-x1.5"].episodes)


@pytest.mark.slow
@pytest.mark.parametrize("name", OWN)
def test_generated_episodes_are_unchanged(name, capsys):
    assert main(["check", name]) == 0
    assert "all unchanged" in capsys.readouterr().out


def test_a_suite_can_be_built_again(tmp_path):
    built = build("benchmark-v1-validation")
    assert suites.save_suite("again", built, tmp_path) != ""
    frozen = suites.load_suite("benchmark-v1-validation")
    assert [cell.episodes for cell in built] == [cell.episodes for cell in frozen.cells]
    assert suites.load_suite("again", tmp_path).cells == frozen.cells


def test_a_changed_file_is_refused(small, tmp_path):
    for name in ("small.json.bz2", suites.SUMS):
        (tmp_path / name).write_bytes((small / name).read_bytes())
    file = tmp_path / "small.json.bz2"
    text = bz2.decompress(file.read_bytes())
    file.write_bytes(bz2.compress(text.replace(b'"surge":0.', b'"surge":1.', 1)))
    with pytest.raises(suites.SuiteError, match="has been changed"):
        suites.load_suite("small", tmp_path)
    file.write_bytes(file.read_bytes()[:50])
    with pytest.raises(suites.SuiteError, match="cannot read"):
        suites.load_suite("small", tmp_path)
    file.unlink()
    with pytest.raises(suites.SuiteError, match="cannot read"):
        suites.load_suite("small", tmp_path)


def test_a_changed_random_stream_is_detected(small):
    cell = suites.load_suite("small", small).cells[0]
    digest = suites.digest(cell)
    suites.check_cell(cell, digest * (1 + 1e-6))
    other = digest.copy()
    other[1, 6] += 0.01
    with pytest.raises(suites.SuiteError, match=r"1 of 3 episodes of slow-storm .* the first is episode 1"):
        suites.check_cell(cell, other)


def test_recorded_rows_belong_to_a_hash(small, tmp_path):
    suite = suites.load_suite("small", small)
    runs = run_all(("open-loop",), suite.cells)
    recorded.save_recorded(suite, runs, versions(), tmp_path)
    again = recorded.load_recorded(suite, tmp_path)
    assert again.refused == {}
    assert [(r.policy, r.scenario.name) for r in again.runs] == [("open-loop", c.scenario.name) for c in suite.cells]
    for run, old in zip(again.runs, runs, strict=True):
        np.testing.assert_allclose(run.measures.steady_rmse, old.measures.steady_rmse, rtol=1e-6)
        assert run.measures.failed.dtype == bool
        assert run.decision_seconds == old.decision_seconds
        assert run.recorded.versions == versions()
        assert len(run.recorded.date) == len("2000-01-01")
    other = suites.Suite(suite.name, "0" * 64, suite.cells, suite.digests)
    found = recorded.load_recorded(other, tmp_path)
    assert found.runs == ()
    assert found.refused == {"open-loop": f"its rows belong to another small, of hash {suite.hash[:12]}"}
    with pytest.raises(ValueError, match="open-loop has no result in cruise-actuator"):
        recorded.save_recorded(suite, runs[:1], versions(), tmp_path)
    (tmp_path / "small" / "open-loop.npz").write_bytes(b"PK")
    assert "is damaged: BadZipFile" in recorded.load_recorded(suite, tmp_path).refused["open-loop"]


def test_recorded_rows_belong_to_an_agents_weights(small, tmp_path, monkeypatch):
    suite, folder = suites.load_suite("small", small), tmp_path / "agents"
    network = Gru(len(FEATURES), 2, 2, 2)
    weights = {name: np.zeros(shape, np.float32) for name, shape in network.shapes.items()}
    monkeypatch.setattr("baselines.agents.names.SHIPPED_FOLDER", folder)
    Agent(network, weights, "backstepping", (0.5, 0.5)).save(folder / "mine")
    recorded.save_recorded(suite, run_all(("mine",), suite.cells), versions(), tmp_path)
    assert len(recorded.load_recorded(suite, tmp_path).runs) == 2
    weights[next(iter(weights))][:] = 0.1
    Agent(network, weights, "backstepping", (0.5, 0.5)).save(folder / "mine")
    assert "have changed" in recorded.load_recorded(suite, tmp_path).refused["mine"]


@pytest.mark.slow
def test_a_slow_policy_is_compared_on_its_first_episodes(small, tmp_path):
    suite = suites.load_suite("small", small)
    first = [Cell(cell.scenario, cell.episodes[:2]) for cell in suite.cells]
    recorded.save_recorded(suite, run_all(("open-loop",), first), versions(), tmp_path)
    few = recorded.load_recorded(suite, tmp_path).runs
    assert [len(run.measures) for run in few] == [2, 2]
    all_runs = run_all(("backstepping", "oracle"), suite.cells)
    mixed, alike = compare([*all_runs, *few]), compare(run_all(("backstepping", "oracle", "open-loop"), first))
    scores = [{r.entry.place: r.entry for r in rows if r.run.policy == "open-loop"} for rows in (mixed, alike)]
    for name, result in scores[0].items():
        assert result.score.mean == pytest.approx(scores[1][name].score.mean, rel=1e-5)
        assert result.effort_ratio == pytest.approx(scores[1][name].effort_ratio, rel=2.0 ** -DIGITS["effort"])
    pooled = [next(p for p in pool(rows) if p.policy == "open-loop") for rows in ([*all_runs, *few],)]
    assert pooled[0].summary.episodes == 2


def test_the_recorded_rows_of_the_oracle_are_reproduced():
    suite = suites.load_suite("benchmark-v1")
    runs = {run.scenario.name: run for run in recorded.load_recorded(suite).runs if run.policy == "oracle"}
    assert set(runs) == {cell.scenario.name for cell in suite.cells}
    for speed_range, largest in (("slow", 5e-4), ("cruise", 3e-3)):
        steady_rmses = [run.measures.steady_rmse for name, run in runs.items() if name.startswith(speed_range)]
        assert np.mean(np.concatenate(steady_rmses)) < largest
    cell = suite.cells[7]
    again = run_all(("oracle",), [Cell(cell.scenario, cell.episodes[:20])])[0]
    np.testing.assert_allclose(
        again.measures.steady_rmse, runs[cell.scenario.name].measures.steady_rmse[:20], rtol=1e-3
    )


def test_request_of_a_frozen_suite(tmp_path):
    whole = Request.of(Options(suite="benchmark-v1", out=tmp_path))
    assert whole.hash == suites.load_suite("benchmark-v1").hash
    assert sum(len(cell.episodes) for cell in whole.cells) == 4160
    assert {run.policy for run in whole.earlier} >= {"oracle"}
    assert whole.policies == ("backstepping",)
    part = Request.of(Options(policy=("oracle",), suite="benchmark-v1", episodes=5, out=tmp_path))
    assert part.hash != whole.hash
    assert {len(cell.episodes) for cell in part.cells} == {5}
    assert "oracle" not in {run.policy for run in part.earlier}
    with pytest.raises(UsageError, match="frozen"):
        Request.of(Options(suite="benchmark-v1", seed=1, out=tmp_path))


@pytest.mark.parametrize(
    "arguments", [["build", "nothing"], ["mend", "ood-v1"], ["record", "ood-v1", "--policy", "nobody"], []]
)
def test_wrong_usage_of_the_suites_command(arguments):
    with pytest.raises(UsageError):
        main(arguments)


def test_drawn_episodes_are_those_of_a_reset():
    scenario = suites.load_suite("benchmark-v1").cells[0].scenario
    assert drawn(scenario, 2, 5).episodes[1] == drawn(scenario, 1, 6).episodes[0]


def test_an_agent_of_one_speed_range_is_recorded_there(small, tmp_path, monkeypatch):
    suite, agents = suites.load_suite("small", small), tmp_path / "agents"
    network = Gru(len(FEATURES), 2, 2, 2)
    zeros = {name: np.zeros(shape, np.float32) for name, shape in network.shapes.items()}
    Agent(network, zeros, "backstepping", (0.5, 0.5), ("cruise-storm",)).save(agents / "mine")
    monkeypatch.setattr("baselines.agents.names.SHIPPED_FOLDER", agents)
    assert (recorded.speed_ranges_of("mine"), recorded.speed_ranges_of("ekf")) == (("cruise",), ("slow", "cruise"))
    cells = [cell for cell in suite.cells if cell.scenario.name.startswith("cruise-")]
    recorded.save_recorded(suite, run_all(("mine",), cells), versions(), tmp_path, recorded.speed_ranges_of("mine"))
    runs = recorded.load_recorded(suite, tmp_path).runs
    assert [(run.policy, run.scenario.name) for run in runs] == [("mine", cell.scenario.name) for cell in cells]
    with pytest.raises(ValueError, match="has no result in slow-"):
        recorded.save_recorded(suite, runs, versions(), tmp_path)


def test_anchor_errors_are_those_of_expert_and_oracle(tmp_path):
    """There is one for every cell of the validations; a cell of each speed range is measured again."""
    suite = suites.load_suite("benchmark-v1-validation")
    assert all(recorded_anchor_errors(cell) for cell in suite.cells)
    few = replace(suite, cells=tuple(c for c in suite.cells if c.scenario.name in ("slow-noise", "cruise-storm")))
    write_anchor_errors(few, tmp_path / "anchor_errors.json")
    mine, theirs = (read_json(file)[suite.name] for file in (tmp_path / "anchor_errors.json", ANCHOR_ERRORS_FILE))
    assert len(mine) == 2
    for name, record in mine.items():
        assert record.pop("cell") == theirs[name].pop("cell")
        assert record == pytest.approx(theirs[name], rel=1e-6), name
    assert recorded_anchor_errors(replace(few.cells[0], episodes=few.cells[0].episodes[:3])) is None

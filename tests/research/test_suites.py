"""Frozen suites: complete, unchanged, reproducible, refused if damaged; sealed ones need their secret; the command."""

import bz2
from dataclasses import replace

import numpy as np
import pytest

from auv_gym.effects.faults import RandomFaults
from auv_gym.effects.sensors import Sensors
from auv_gym.planning.paths import PATHS
from auv_gym.scenarios.mixtures import MIXTURES
from auv_gym.scenarios.presets import CASES, PRESETS, SPEED_RANGES
from baselines.agents.agent import Agent
from baselines.agents.features import FEATURES
from baselines.agents.networks import Gru
from baselines.evaluation import recorded, suites
from baselines.evaluation.cells import Cell, drawn
from baselines.evaluation.options import Options
from baselines.evaluation.report.numbers import pool
from baselines.evaluation.request import Request
from baselines.evaluation.results import ResultFile
from baselines.evaluation.runner import run_all
from baselines.tools import files
from baselines.tools.command_line import DONE, UsageError
from research.suites import builder, command, sealed
from research.suites.builder import BUILDERS, SUITE_FAMILIES, build
from research.suites.command import main

NAMES = suites.list_suites()
BENCHMARK, SEALED = "benchmark-v3", "sealed-v3"


@pytest.fixture
def small(tmp_path, monkeypatch):
    """A suite of two cells with three episodes each, in the only folder of data."""
    whole = suites.load_suite(f"{BENCHMARK}-validation")
    cells = [Cell(c.scenario, c.episodes[:3]) for c in (whole.cells[7], whole.cells[14])]
    monkeypatch.setattr(files, "DATA_FOLDERS", [tmp_path])
    monkeypatch.setattr(command, "_folder", lambda _: tmp_path)
    suites.save_suite("small", cells, tmp_path / suites.FOLDER)
    return suites.load_suite("small")


@pytest.fixture
def file(small, tmp_path):
    """The file of the small suite."""
    return tmp_path / suites.FOLDER / "small.json.bz2"


def test_every_suite_has_its_file():
    closed = {name for name, seal in sealed.seals().items() if seal.secret is None}
    assert set(NAMES) == set(BUILDERS) - closed


def test_the_benchmark_has_all_cases_and_families():
    suite = suites.load_suite(BENCHMARK)
    presets = [f"{r}-{c}" for r in SPEED_RANGES for c in CASES]
    fixed = [f"{r}-{c}-{fix}" for r in SPEED_RANGES for c in ("noise", "storm") for fix in ("rtk", "usbl")]
    assert [cell.scenario.name for cell in suite.cells] == presets + fixed
    for cell in suite.cells:
        families = [next(n for n, cls in PATHS.items() if type(e.path) is cls) for e in cell.episodes]
        assert {family: families.count(family) for family in SUITE_FAMILIES} == dict.fromkeys(SUITE_FAMILIES, 30)
    seeds = [e.noise_seed for name in NAMES for cell in suites.load_suite(name).cells for e in cell.episodes]
    assert len(set(seeds)) == len(seeds)  # no episode of a test is one of the validation split


def test_fixed_levels_of_the_benchmark_are_those_of_the_page():
    """0.2 and 20 times the typical level of the position; other levels differ from episode to episode."""
    cells = {cell.scenario.name: cell for cell in suites.load_suite(BENCHMARK).cells}
    for name, level in (("slow-noise-rtk", 0.006), ("cruise-storm-rtk", 0.01), ("slow-storm-usbl", 0.6)):
        cell = cells[name]
        position, _, heading, *_ = np.transpose([cell.scenario.noise_of(episode) for episode in cell.episodes])
        assert position == pytest.approx(level)
        assert len(set(heading)) == len(cell.episodes)


def test_hard_cells_have_what_their_names_say():
    """Times and sizes of the faults in the episodes, and what differs from the storm."""
    cells = {cell.scenario.name: cell for cell in suites.load_suite("hard-v1").cells}
    assert len(cells) == 32
    storms = {r: PRESETS[f"{r}-storm"] for r in SPEED_RANGES}
    changes = {
        "velocity-bias": "sensors", "correlated": "sensors", "dead-reckoning": "sensors", "outages": "sensors",
        "sharp": "path", "beyond": "path", "lag": "actuators", "slew": "actuators", "far-start": "start",
        "hulls": "mismatch", "mission": "steps", "velocity-stale": "faults", "velocity-offset": "faults",
        "actuator-faults": "faults", "sensor-faults": "faults",
    }  # fmt: skip
    for speed_range, storm in storms.items():
        for case, entry in changes.items():
            own = cells[f"{speed_range}-{case}"].scenario
            assert own == replace(storm, name=own.name, **{entry: getattr(own, entry)}) != replace(storm, name=own.name)
        T, size = storm.duration, {"slow": 0.05, "cruise": 0.1}[speed_range]
        for episode in cells[f"{speed_range}-velocity-stale"].episodes:
            (fault,) = episode.faults
            assert (fault.kind, fault.end - fault.begin) == ("velocity frozen", pytest.approx(20, abs=1e-3))
            assert 0.4 * T - 1e-3 <= fault.begin <= 0.5 * T + 1e-3
        for episode in cells[f"{speed_range}-velocity-offset"].episodes:
            (fault,) = episode.faults
            assert (fault.kind, fault.begin) == ("velocity offset", pytest.approx(0.4 * T))
            assert fault.end >= T
            assert np.hypot(*fault.jump) == pytest.approx(size, rel=1e-4)
        for end in ("actuator-faults", "sensor-faults"):
            cell = cells[f"{speed_range}-{end}"]
            faults = [fault for episode in cell.episodes for fault in episode.faults]
            assert {fault.kind for fault in faults} == set(cell.scenario.faults.kinds)
            assert all(3.0 - 1e-3 <= fault.end - fault.begin <= 10.0 + 1e-3 for fault in faults)
        assert {type(e.path) for e in cells[f"{speed_range}-sharp"].episodes} == {PATHS["lawnmower"]}
        assert {type(e.path) for e in cells[f"{speed_range}-mission"].episodes} == {PATHS["spline"]}


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_generated_episodes_are_unchanged(name, capsys):
    assert main(["check", name]) == 0
    assert "all unchanged" in capsys.readouterr().out


def test_a_suite_can_be_built_again():
    frozen = suites.load_suite(f"{BENCHMARK}-validation")
    assert [cell.episodes for cell in build(frozen.name)] == [cell.episodes for cell in frozen.cells]


def test_a_changed_file_is_refused(file):
    whole = file.read_bytes()
    for damaged, reason in (
        (bz2.compress(bz2.decompress(whole).replace(b'"surge":0.', b'"surge":1.', 1)), "has been changed"),
        (whole[:50], "cannot use suite small"),
        (None, "cannot use suite small"),
    ):
        suites._loaded.cache_clear()
        file.unlink() if damaged is None else file.write_bytes(damaged)
        with pytest.raises(suites.SuiteError, match=reason):
            suites.load_suite("small")


def test_correlated_noise_and_offsets_are_in_the_files_of_suites(tmp_path, monkeypatch, small):
    scenario = replace(
        small.cells[1].scenario,
        sensors=Sensors(position=(0.1, 1.0), correlation=(1.0, 5.0)),
        faults=RandomFaults(("velocity offset",), begin=(20.0, 30.0)),
    )
    cell = suites.rounded(Cell(scenario, tuple(scenario.draw(np.random.default_rng(seed)) for seed in range(2))))
    suites.save_suite("coloured", [cell], tmp_path / suites.FOLDER)
    assert suites.load_suite("coloured").cells == (cell,)
    for episode in cell.episodes:
        assert 1.0 <= episode.correlation <= 5.0
        assert [fault.kind for fault in episode.faults] == ["velocity offset"]


def test_a_changed_random_stream_is_detected(small):
    cell = small.cells[0]
    digest = suites.cell_digest(cell)
    suites.check_cell(cell, digest * (1 + 1e-6))
    other = digest.copy()
    other[1, 6] += 0.01
    with pytest.raises(suites.SuiteError, match=r"1 of 3 episodes of slow-storm .* the first is episode 1"):
        suites.check_cell(cell, other)


def test_the_command_records_policies_and_verifies_them(small, tmp_path, monkeypatch, capsys):
    """Agents run in the cells of their speed range; verifying with --stamp renews fingerprints of equal results."""
    network = Gru(len(FEATURES), 2, 2, 2)
    zeros = {name: np.zeros(shape, np.float32) for name, shape in network.shapes.items()}
    monkeypatch.setattr("baselines.agents.names.SHIPPED_FOLDER", tmp_path / "agents")
    Agent(network, zeros, "backstepping", (0.5, 0.5), ("cruise-storm",)).save(tmp_path / "agents" / "mine")
    monkeypatch.setattr(command, "BUILDERS", {"small": ("", None)})
    assert main(["record", "small", "--policy", "mine", "open-loop"]) == 0
    runs = recorded.recorded_runs(small).runs
    pairs = [(run.policy, run.scenario.name.partition("-")[0]) for run in runs]
    assert pairs == [("open-loop", "slow"), ("open-loop", "cruise"), ("mine", "cruise")]
    assert main(["verify", "small"]) == 0
    out = capsys.readouterr().out
    assert out.count("equal") == 2
    path = tmp_path / recorded.RECORDED / "small.npz"
    content = ResultFile.read(path)
    old = tuple(replace(run, fingerprint="1.2.3") for run in content.runs)
    replace(content, runs=old).write(path, single=True)
    assert len(recorded.recorded_runs(small).runs) < 3
    assert main(["verify", "small", "--stamp"]) == 0
    assert len(recorded.recorded_runs(small).runs) == 3
    measures = replace(old[0].measures, steady_rmse=old[0].measures.steady_rmse * 1.001)
    replace(content, runs=(replace(old[0], measures=measures), *old[1:])).write(path, single=True)
    capsys.readouterr()
    assert main(["verify", "small", "--stamp", "--policy", "open-loop"]) == 1
    assert "DIFFERENT  open-loop in small: 3 of" in capsys.readouterr().out
    assert ResultFile.read(path).runs[0].fingerprint == "1.2.3"


def test_a_policy_is_compared_in_the_episodes_that_it_ran(small):
    runs = run_all(("backstepping", "nmpc", "open-loop"), small.cells)
    first = [replace(run, measures=run.measures[:2]) for run in runs]
    mixed = pool([few if run.policy == "open-loop" else run for run, few in zip(runs, first, strict=True)])
    (one, other) = ([e for e in entries if e.policy == "open-loop"] for entries in (mixed, pool(first)))
    assert [(e.summary.episodes, e.effort_ratio, e.error_ratio) for e in one] == [
        (2, pytest.approx(e.effort_ratio), pytest.approx(e.error_ratio)) for e in other
    ]


def test_recorded_results_of_the_oracle_are_reproduced():
    suite = suites.load_suite(BENCHMARK)
    runs = {run.scenario.name: run for run in recorded.recorded_runs(suite).runs if run.policy == "oracle"}
    assert set(runs) == {cell.scenario.name for cell in suite.cells}
    cell = suite.cells[7]
    (again,) = run_all(("oracle",), [Cell(cell.scenario, cell.episodes[:20])])
    expected = runs[cell.scenario.name].measures.steady_rmse[:20]
    np.testing.assert_allclose(again.measures.steady_rmse, expected, rtol=1e-3)


def test_request_of_a_frozen_suite(tmp_path):
    part = Request.of(Options(policy=("oracle",), suite=BENCHMARK, episodes=5, out=tmp_path))
    assert {len(cell.episodes) for cell in part.cells} == {5}
    assert "oracle" not in {run.policy for run in part.earlier}
    with pytest.raises(UsageError, match="frozen"):
        Request.of(Options(suite=BENCHMARK, seed=1, out=tmp_path))
    scenario = part.cells[0].scenario
    assert drawn(scenario, 2, 5).episodes[1] == drawn(scenario, 1, 6).episodes[0]  # as an environment's resets


@pytest.fixture
def empty(monkeypatch, tmp_path):
    """Use a file without seals and return a folder for suites."""
    file = tmp_path / "seals.json"
    file.write_text("{}")
    monkeypatch.setattr(sealed, "SEALS", file)
    monkeypatch.setattr(command, "DATA", tmp_path)
    monkeypatch.setattr(files, "DATA_FOLDERS", [tmp_path])
    return tmp_path


def test_sealed_scenarios_are_unchanged():
    """Also by kinds of faults or entries of scenarios that were added after the sealing."""
    for name, seal in sealed.seals().items():
        assert sealed.worlds_hash(name) == seal.worlds


def test_from_a_seal_to_a_suite(empty, capsys, monkeypatch):
    monkeypatch.setitem(builder._EPISODES, SEALED, 1)
    assert main(["seal", SEALED]) == DONE
    secret = capsys.readouterr().out.split()[-1]
    assert sealed.seals()[SEALED] == sealed.Seal(sealed.sha256(secret), sealed.worlds_hash(SEALED))
    assert secret not in (empty / "seals.json").read_text()
    with pytest.raises(suites.SuiteError, match="is sealed"):
        build(SEALED)
    assert main(["open", SEALED, "--secret", secret + "?"]) != DONE
    assert "not the secret" in capsys.readouterr().err
    assert main(["open", SEALED, "--secret", secret]) == DONE
    suite = suites.load_suite(SEALED)
    assert [cell.scenario for cell in suite.cells] == sealed.sealed_worlds(SEALED)
    again = build(SEALED)
    monkeypatch.setitem(sealed.CHANGES, SEALED, lambda storm, _: {"storm": {}})
    with pytest.raises(suites.SuiteError, match=f"the scenarios of {SEALED} have changed"):
        build(SEALED)
    assert all(a.episodes == b.episodes for a, b in zip(suite.cells, again, strict=True))


def test_a_seal_is_not_replaced_and_without_one_there_is_no_seed(empty):
    with pytest.raises(suites.SuiteError, match="has no seal"):
        build(SEALED)
    sealed.write_seal(SEALED, sealed.Seal(sealed.sha256("one"), ""))
    with pytest.raises(suites.SuiteError, match="sealed already"):
        sealed.write_seal(SEALED, sealed.Seal(sealed.sha256("two"), ""))


def test_sealed_scenarios_are_outside_the_training_distributions():
    """In at least one property, but for the lag, which was added to the training after the sealing."""
    trained = [s for mixture in MIXTURES.values() for s, _ in mixture]
    kinds = {kind for s in trained if s.faults for kind in s.faults.kinds}
    for scenario in sealed.sealed_worlds(SEALED):
        act = scenario.actuators
        other = {
            "faults": scenario.faults is not None and not set(scenario.faults.kinds) <= kinds,
            "weak": all(np.max(act.effectiveness) < np.min(s.actuators.effectiveness) for s in trained),
            "period": all(scenario.control_dt < s.control_dt for s in trained),
            "turning": scenario.current.turn != 0.0 and all(not s.current or s.current.turn == 0.0 for s in trained),
            "waves": all(not s.waves or scenario.waves.band[0] > s.waves.band[1] for s in trained),
        }
        assert any(other.values()) != scenario.name.endswith("-lag"), scenario.name

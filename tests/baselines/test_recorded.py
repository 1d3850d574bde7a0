"""Stored results: recorded rows are reproduced, fingerprints cover the right code, damaged files are refused."""

import ast
import dataclasses
import json
import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
from marks import slow_except

import baselines
from auv_gym.installation import found
from auv_gym.scenarios.presets import PRESETS
from baselines.agents.agent import Agent
from baselines.agents.features import FEATURES
from baselines.agents.networks import Gru
from baselines.control.backstepping import Backstepping
from baselines.evaluation import fingerprints, recorded, store, suites
from baselines.evaluation.fingerprints import fingerprint
from baselines.evaluation.rows import RowStore
from baselines.evaluation.runner import drawn, run_all
from baselines.evaluation.store import Stored, reading, write
from baselines.tools.command_line import DONE, FAILED
from research.suites import command
from research.suites.verify import PolicyVerdict, cells_to_run, verdict_line
from research.trainings.study_files import load_studies

ROOT = Path(__file__).parents[2]
SAMPLE = {
    "benchmark-v1": "cruise-storm",
    "ood-v1": "slow-current-x1.5",
    "unmodelled-v1": "slow-everything",
    "deep-v1": "cruise-deep",
    "sealed-v2": "slow-far-start",
    "vehicles-v2": "cruise-storm@otter",
}
CLOSEST = 1e-6
"""Largest relative difference on another processor; on the processor of the recording the rows are equal."""


@pytest.mark.parametrize("suite", slow_except(["benchmark-v1", "vehicles-v2"], SAMPLE))
@pytest.mark.parametrize("policy", ["backstepping", "open-loop", "los-pid"])
def test_recorded_rows_are_reproduced(suite, policy):
    """`make verify` compares all rows; this test compares a sample."""
    whole = suites.load_suite(suite)
    old = recorded.read_recorded(whole, policy)
    (cell,) = cells_to_run(whole, old, [SAMPLE[suite]])
    verdict = PolicyVerdict.of(next(run for run in old if run.cell_hash == cell.hash), run_all((policy,), [cell])[0])
    assert verdict.numbers == 9 * len(cell.episodes)
    assert verdict.largest < CLOSEST
    assert verdict.differing < 0.01 * verdict.numbers


@pytest.fixture
def rows(tmp_path, monkeypatch):
    """A folder with the recorded rows of two fast policies in a suite; the command uses this folder."""
    folder = tmp_path / "recorded"
    (folder / "ood-v1").mkdir(parents=True)
    for policy in ("backstepping", "open-loop"):
        shutil.copy(found(recorded.RECORDED_FOLDER, f"ood-v1/{policy}.npz"), folder / "ood-v1")
    shutil.copy(recorded.RECORDED_FOLDER / recorded.STAMPS_FILE, folder)
    for name, count in (("read_recorded", 2), ("stamp_recorded", 2), ("recorded_policies", 1)):
        bound = getattr(recorded, name)
        monkeypatch.setattr(recorded, name, lambda *a, count=count, bound=bound: bound(*a[:count], folder))
    return folder


def test_verify_finds_a_changed_number(rows, capsys):
    arguments = ["verify", "ood-v1", "--cells", "slow-lawnmower"]
    assert command.main(arguments) == DONE
    assert capsys.readouterr().out.count("equal ") == 2
    file = rows / "ood-v1" / "open-loop.npz"
    with reading(file) as kept:
        measures = kept.arrays["measures"].copy()
    suite = suites.load_suite("ood-v1")
    at = [cell.scenario.name for cell in suite.cells].index("slow-lawnmower") * 260 + 7
    measures[1, at] *= 1.001
    write(file, Stored(kept.record, {"measures": measures}))
    assert command.main([*arguments, "--policy", "open-loop"]) == FAILED
    out = capsys.readouterr().out
    assert (
        "DIFFERENT  open-loop in ood-v1: 1 of 2340 numbers, at most by 1.0e-03 of the value, steady_rmse of episode 7"
        in out
    )


def test_outdated_rows_are_used_after_verification(rows, monkeypatch, capsys):
    suite = suites.load_suite("ood-v1")
    entry = (Backstepping, {"gains": "auto"}, "the same law with other options")
    monkeypatch.setitem(baselines.POLICIES, "backstepping", entry)
    found = recorded.load_recorded(suite, rows)
    assert "have changed since" in found.refused["backstepping"]
    assert {run.policy for run in found.runs} == {"open-loop"}
    assert (
        command.main(["verify", "ood-v1", "--policy", "backstepping", "--cells", "slow-lawnmower", "--stamp"]) == DONE
    )
    assert recorded.load_recorded(suite, rows).refused == {}


def test_changed_rows_and_rows_of_another_policy_are_not_used(rows):
    suite, folder = suites.load_suite("ood-v1"), rows / "ood-v1"
    shutil.copy(folder / "open-loop.npz", folder / "backstepping.npz")
    assert "has the rows of open-loop" in recorded.load_recorded(suite, rows).refused["backstepping"]
    with reading(folder / "open-loop.npz") as kept:
        write(folder / "open-loop.npz", Stored(kept.record, {"measures": kept.arrays["measures"] * 1.5}))
    assert "the rows have" in recorded.load_recorded(suite, rows).refused["open-loop"]


def test_verdicts_on_known_differences():
    (old,) = run_all(("open-loop",), [drawn(PRESETS["slow-calm"], 3, 0)])
    assert PolicyVerdict.of(old, old).differing == 0
    steady_rmse = old.measures.steady_rmse.copy()
    steady_rmse[2] = np.nan
    other = dataclasses.replace(old, measures=dataclasses.replace(old.measures, steady_rmse=steady_rmse))
    verdict = PolicyVerdict.of(old, other)
    assert (verdict.differing, verdict.largest, verdict.where) == (1, np.inf, "steady_rmse of episode 2")
    assert "DIFFERENT" in verdict_line("open-loop", [PolicyVerdict.of(old, old), verdict])
    with pytest.raises(ValueError, match="fails in slow-calm: no"):
        PolicyVerdict.of(old, dataclasses.replace(old, measures=None, error="no"))


def test_all_policies_have_different_fingerprints():
    prints = {name: fingerprint(name) for name in baselines.list_policies()}
    assert all(len(digest) == 64 for digest in prints.values())
    assert len(set(prints.values())) == len(prints)
    assert fingerprint("nobody") == ""


def test_fingerprints_cover_code_without_docstrings_and_format(tmp_path):
    file = tmp_path / "law.py"
    digests = []
    for text in (
        'def f(x):\n    """Return x."""\n    return 2 * x\n',
        '"""A module."""\n# a comment\ndef f(\n    x,\n):\n    return 2*x\n\n',
        "def f(x):\n    return 3 * x\n",
    ):
        file.write_text(text)
        fingerprints._parsed.cache_clear()
        digests.append(fingerprints._module(file).digest)
    assert digests[0] == digests[1] != digests[2]
    assert fingerprints._plain(ast.parse("'alone'\nx = 1")) == fingerprints._plain(ast.parse("x = 1"))


def simulator_of(folder):
    """Return the fingerprint of the simulator in a folder, computed in another process."""
    code = "from baselines.evaluation.fingerprints import simulator_fingerprint as f; print(f())"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join((str(folder), str(ROOT)))}
    return subprocess.check_output([sys.executable, "-c", code], text=True, cwd=folder, env=environment).strip()


def test_fingerprint_of_the_simulator_covers_equations_without_docstrings(tmp_path):
    copy = tmp_path / "auv_gym"
    shutil.copytree(ROOT / "auv_gym", copy, ignore=shutil.ignore_patterns("__pycache__"))
    now = fingerprints.simulator_fingerprint()
    assert simulator_of(tmp_path) == now
    for file in copy.rglob("*.py"):
        text = file.read_text().replace("auv_gym.physics.dynamics", "auv_gym.physics.motion")
        text = text.replace('"""', '"""Another word. ', 1)
        file.write_text(f'{text}\n"""More words."""\n# a comment\n')
    dynamics = (copy / "physics" / "dynamics.py").rename(copy / "physics" / "motion.py")
    (copy / "physics" / "dynamics.py").write_text("from auv_gym.physics.motion import *\n")  # for the policies
    for name in ("native", "cache"):
        with (copy / "codegen" / f"{name}.py").open("a") as stream:
            stream.write("\nANOTHER = 3\n")
    assert simulator_of(tmp_path) == now
    text = dynamics.read_text()
    assert "+ X) / m11" in text
    dynamics.write_text(text.replace("+ X) / m11", "+ 0.5 * X) / m11", 1))
    assert simulator_of(tmp_path) != now
    dynamics.write_text(text)
    for name in ("planning/driver.c", "scenarios/exogenous.c"):
        source = (copy / name).read_text()
        (copy / name).write_text(f"{source}static int another;\n")
        assert simulator_of(tmp_path) != now
        (copy / name).write_text(source)
    assert simulator_of(tmp_path) == now


@pytest.mark.parametrize("name", ["metrics", "rollout"])
def test_fingerprint_of_the_simulator_covers_the_computation_of_metrics(name, tmp_path, monkeypatch):
    now, real = fingerprints.simulator_fingerprint(), fingerprints._module
    other = tmp_path / f"{name}.py"
    other.write_text((ROOT / "baselines" / "evaluation" / f"{name}.py").read_text() + "\nANOTHER = 3\n")
    monkeypatch.setattr(fingerprints, "_module", lambda file: real(other if file.name == other.name else file))
    assert fingerprints.simulator_fingerprint() != now


def test_rows_of_another_simulator_are_used_with_a_note(rows, monkeypatch):
    suite = suites.load_suite("ood-v1")
    for policy in ("backstepping", "open-loop"):
        recorded.stamp_recorded(suite, policy)
    found = recorded.load_recorded(suite, rows)
    assert (found.refused, found.note) == ({}, "")
    monkeypatch.setattr(recorded, "simulator_fingerprint", lambda: "another")
    changed = recorded.load_recorded(suite, rows)
    assert changed.note == "the code of the simulator has changed since rows of ood-v1 were recorded"
    assert changed.refused == {}
    assert [run.policy for run in changed.runs] == [run.policy for run in found.runs]


@pytest.mark.parametrize("name", ["lqi", "ekf", "nmpc", "integral-normalised", "backstepping-tuned"])
def test_fingerprint_of_a_controller_covers_its_own_gains(name, tmp_path, monkeypatch):
    shutil.copytree(fingerprints.GAINS, tmp_path / "gains")
    monkeypatch.setattr(fingerprints, "GAINS", tmp_path / "gains")
    others = {"smc-dob", "los-pid", "adaptive"}
    before = {own: fingerprint(own) for own in (name, *others)}
    file = tmp_path / "gains" / f"{name}-slow.json"
    record = json.loads(file.read_text())
    file.write_text(json.dumps(record | {"command": "another"}))
    assert fingerprint(name) == before[name]
    record["gains"][next(iter(record["gains"]))] *= 1.5
    file.write_text(json.dumps(record))
    assert {own for own in before if fingerprint(own) == before[own]} == others


def test_fingerprint_of_an_agent_covers_everything_that_affects_actions(tmp_path, monkeypatch):
    network = Gru(len(FEATURES), 2, 2, 2)
    zeros = {name: np.zeros(shape, np.float32) for name, shape in network.shapes.items()}
    agent = Agent(network, zeros, "backstepping", (0.5, 0.5), region=(1.0,) * 6)
    name = str(tmp_path / "agent")

    def digest(suffix="", **changes):
        dataclasses.replace(agent, **changes).save(name)
        return fingerprint(name + suffix)

    same = digest()
    assert digest(training={"seconds": 3}, scenarios=("slow-calm",)) == same
    (tmp_path / "agent" / "card.md").write_text("another card")
    assert fingerprint(name) == same == digest(region=(2.0,) * 6)
    assert digest(":fade") != digest(":fade", region=(2.0,) * 6)
    assert same not in (digest(expert="ekf"), digest(authority=(0.5, 0.4)))
    monkeypatch.setitem(baselines.POLICIES, "backstepping", (Backstepping, {"gains": "robust"}, "another"))
    assert digest() != same


def test_a_huge_file_is_no_policy(tmp_path):
    file = tmp_path / "model.zip"
    with file.open("wb") as stream:
        stream.truncate(fingerprints.LARGEST_POLICY_FILE + 1)
    with pytest.raises(ValueError, match="is larger than"):
        fingerprint(str(file))


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """A finished run and the store with its file."""
    run = run_all(("open-loop",), [drawn(PRESETS["slow-calm"], 2, 0)])[0]
    folder = RowStore(tmp_path_factory.mktemp("rows"))
    folder.save(run)
    return folder, run


def test_a_row_under_another_key_is_refused(kept):
    folder, run = kept
    assert folder.load(run.key).policy == "open-loop"
    (folder.folder / "0123456789abcdef0123.npz").write_bytes((folder.folder / f"{run.key}.npz").read_bytes())
    assert folder.load("0123456789abcdef0123") is None


def test_damaged_files_are_refused(kept, tmp_path):
    """A changed bit or a cut raises ValueError, or does not change the content."""
    folder, run = kept
    whole, file = (folder.folder / f"{run.key}.npz").read_bytes(), tmp_path / "a.npz"
    rng = np.random.default_rng(0)
    for i in range(150):
        data = bytearray(whole)
        data[rng.integers(len(data))] ^= 1 << int(rng.integers(8))
        file.write_bytes(data if i % 3 else data[: rng.integers(len(data))])
        try:
            with reading(file) as stored:
                assert stored.record["policy"] == "open-loop"
        except ValueError as error:
            assert str(file) in str(error)  # noqa: PT017
        assert RowStore(tmp_path).load("a") is None


@pytest.mark.parametrize("record", ["[]", "{}", "3", "[" * 100_000, '{"policy": {}, "fingerprint": []}'])
def test_records_of_the_wrong_kind_are_refused(record, tmp_path):
    np.savez(tmp_path / "a.npz", record=np.array(record))
    assert RowStore(tmp_path).load("a") is None
    with pytest.raises(ValueError, match=r"a\.npz is damaged"):
        load_studies(tmp_path)


def test_a_file_with_a_large_content_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(store, "_LARGEST_CONTENT", 10**6)
    with zipfile.ZipFile(tmp_path / "a.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("measures.npy", bytes(2 * 10**6))
    assert (tmp_path / "a.npz").stat().st_size < 10**4
    with pytest.raises(ValueError, match="larger than"), reading(tmp_path / "a.npz"):
        pass


def test_no_pickle_is_loaded(tmp_path):
    np.savez(tmp_path / "a.npz", record=np.array("{}"), arrays=np.array([{}], dtype=object))
    with pytest.raises(ValueError, match="allow_pickle"), reading(Path(tmp_path / "a.npz")):
        pass

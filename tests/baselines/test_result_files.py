"""Files of results: they are restored, outdated results are not used, and forged or impossible ones are refused."""

import re
from dataclasses import fields, replace

import numpy as np
import pytest

import baselines
from auv_gym.scenarios.presets import PRESETS
from baselines.__main__ import COMMANDS, call
from baselines.control import Registration
from baselines.control.backstepping import Backstepping
from baselines.evaluation import fingerprints, recorded
from baselines.evaluation.cells import drawn
from baselines.evaluation.metrics import Measures
from baselines.evaluation.recorded import recorded_runs
from baselines.evaluation.results import ResultFile
from baselines.evaluation.suites import load_suite, save_suite
from baselines.evaluation.verify import PROGRAM, main
from baselines.tools import files
from baselines.tools.command_line import run


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a small frozen suite, and with results.npz of an evaluation on it."""
    folder = tmp_path_factory.mktemp("verify")
    cells = [drawn(replace(PRESETS[name], steps=40), 4, 0) for name in ("cruise-storm", "slow-calm")]
    save_suite("small", cells, folder / "suites")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(files, "DATA_FOLDERS", [folder])
        words = ["--suite", "small", "--policy", "los-pid", "--jobs", "1", "--out", str(folder)]
        assert call(COMMANDS["evaluate"], words, "auv-gym evaluate") == 0
    return folder


@pytest.fixture
def results(folder, monkeypatch):
    monkeypatch.setattr(files, "DATA_FOLDERS", [folder])
    return folder / "results.npz"


@pytest.mark.parametrize("single", [False, True])
def test_a_file_has_all_of_its_runs(results, single, tmp_path):
    *runs, last = ResultFile.read(results).runs
    runs = (*runs, replace(last, tracks=(), bands=None))
    ResultFile(runs, command="a command").write(tmp_path / "a.npz", single)
    content = ResultFile.read(tmp_path / "a.npz")
    assert (content.suite, content.suite_hash, content.command) == ("", "", "a command")
    for again, before in zip(content.runs, runs, strict=True):
        expected = replace(before, recorded=again.recorded, measures=None, bands=None, tracks=())
        assert replace(again, measures=None, bands=None, tracks=()) == expected
        for field in fields(Measures):
            values = (getattr(measures, field.name) for measures in (again.measures, before.measures))
            np.testing.assert_allclose(*values, rtol=1e-6 if single else 0)
        assert again.measures.failed.dtype == bool
        assert (again.bands is None) == (before.bands is None)
        for track, another in zip(again.tracks, before.tracks, strict=True):
            np.testing.assert_array_equal(track.rows, another.rows)


@pytest.fixture
def suite(results, monkeypatch):
    """The suite, with the file of results as its recorded ones."""
    monkeypatch.setattr(recorded, "recorded_files", lambda _: [results])
    return load_suite("small")


def test_recorded_results_are_those_of_the_suite(suite):
    runs, notes = recorded_runs(suite)
    assert [run.policy for run in runs] == ["backstepping"] * 2 + ["los-pid"] * 2 + ["clairvoyant"] * 2
    assert notes == ()
    with pytest.raises(ValueError, match="belongs to another small, of hash "):
        recorded_runs(replace(suite, hash="1" * 64))


def test_results_of_a_changed_policy_are_left_out(suite, monkeypatch):
    monkeypatch.setitem(baselines.POLICIES, "los-pid", Registration(Backstepping, "another law"))
    monkeypatch.setattr(fingerprints, "_known_kernels", {})
    runs, notes = recorded_runs(suite)
    assert {run.policy for run in runs} == {"backstepping", "clairvoyant"}
    assert notes == ("the recorded results of los-pid are left out: its equations have changed",)


def test_results_of_a_changed_simulator_are_used_with_a_note(suite, monkeypatch):
    monkeypatch.setattr(recorded, "simulator_fingerprint", lambda _: "another")
    runs, notes = recorded_runs(suite)
    assert len(runs) == 6
    assert notes == ("the simulator has changed since results of small were recorded",)


def verified(file, *words):
    return run(main, PROGRAM, [str(file), *words, "--jobs", "1"])


def forged(file, **values):
    """Write a copy of a file in which the first episode of the second policy has other metrics, and return it."""
    content = ResultFile.read(file)
    runs = list(content.runs)
    arrays = {name: getattr(runs[1].measures, name).copy() for name in values}
    for name, value in values.items():
        arrays[name][0] = value
    runs[1] = replace(runs[1], measures=replace(runs[1].measures, **arrays))
    replace(content, runs=tuple(runs)).write(file.with_name("forged.npz"))
    return file.with_name("forged.npz")


def test_equal_results_are_repeated(results, capsys):
    assert verified(results) == 0
    assert "24 episodes of small, plausible" in capsys.readouterr().out
    assert verified(results, "los-pid", "--share", "0.5", "--seed", "3") == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert "Running 4 episodes of los-pid again, chosen by --seed 3" in printed
    (share,) = re.findall(r"If ([\d.]+) % of the episodes were forged", printed)
    assert 1 - (1 - float(share) / 100) ** 4 == pytest.approx(0.95, abs=1e-3)
    assert verified(results, "lqi") == 1  # the name of the policy on this machine may be another one
    assert "Running 2 episodes of los-pid again" in capsys.readouterr().out


def test_a_forged_number_is_found(results, capsys):
    error = ResultFile.read(results).runs[1].measures.steady_rmse[0]
    file = forged(results, steady_rmse=0.99 * error)
    assert verified(file) == 0
    assert verified(file, "los-pid", "--share", "1") == 1
    printed = capsys.readouterr().out
    assert "NOT REPEATED: 1 numbers differ" in printed
    assert "episode 0 of cruise-storm: steady_rmse" in printed


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"effort": 1.5}, "effort is not within [0, 1] everywhere"),
        ({"steady_rmse": 1e3}, "an episode beyond the lost distance is not counted as failed"),
        ({"effort": 1e-6, "smoothness": 1.0}, "the command rate is too large for the effort"),
    ],
)
def test_impossible_numbers_are_refused(results, values, says, capsys):
    assert verified(forged(results, **values)) == 1
    assert f"los-pid in cruise-storm: {says}" in capsys.readouterr().err


def test_only_all_episodes_of_a_frozen_suite_count(results, capsys):
    content = ResultFile.read(results)
    other = results.with_name("other.npz")
    replace(content, suite="").write(other)
    assert verified(other) == 1
    first = content.runs[0]
    short = Measures(*(getattr(first.measures, field.name)[:2] for field in fields(Measures)))
    replace(content, runs=(replace(first, measures=short), *content.runs[1:])).write(other)
    assert verified(other) == 1
    err = capsys.readouterr().err
    assert "has no frozen suite" in err
    assert "all of a case must be run" in err
    assert verified(results, "--share", "0") == 2

"""The study of faults: a quick form of the command, its record, and the page."""

from dataclasses import replace

import pytest

from baselines.evaluation.fingerprints import fingerprint
from baselines.evaluation.suites import load_suite
from baselines.tools.command_line import run
from baselines.tools.files import read_json
from research.robustness import faults


def test_the_suite_has_each_fault_in_its_episodes():
    suite = load_suite(faults.SUITE)
    for cell in suite.cells:
        kinds = {fault.kind for episode in cell.episodes for fault in episode.faults}
        own = cell.scenario.faults.kinds if cell.scenario.faults else ()
        assert kinds == set(own), cell.scenario.name
        for episode in cell.episodes:
            for fault in episode.faults:
                assert 3.0 - 1e-3 <= fault.end - fault.begin <= 10.0 + 1e-3
    assert sum(bool(cell.scenario.faults) for cell in suite.cells) == len(suite.cells) - 4


def test_a_quick_form_of_the_command(tmp_path, monkeypatch):
    suite = load_suite(faults.SUITE)
    monkeypatch.setattr(faults, "load_suite", lambda _: replace(suite, cells=suite.cells[7:9]))
    out = tmp_path / "faults.json"
    words = ["--policy", "backstepping", "--episodes", "2", "--jobs", "1", "--out", str(out)]
    assert run(faults.main, faults.PROGRAM, words) == 0
    record = read_json(out)
    assert list(record) == ["backstepping", "backstepping:checked"]
    row = record["backstepping"]["slow-heading-frozen"]
    assert (row["episodes"], set(row)) == (2, {"episodes", "failed", "error_mm"})
    monkeypatch.setattr(faults, "FAULTS_FILE", out)
    (_, table), *others = faults.context()["tables"]
    assert not others
    assert "heading frozen" in table
    assert f"{row['failed']}; {row['error_mm'] / 10:.3g} -> " in table


def test_wrong_options_are_refused(capsys):
    assert run(faults.main, faults.PROGRAM, ["--episodes", "0"]) == 2
    assert "--episodes is 0; it must be 1 or more" in capsys.readouterr().err


@pytest.mark.parametrize("policy", faults.POLICIES)
def test_the_record_is_of_these_policies(policy):
    record = read_json(faults.FAULTS_FILE)
    for name in (policy, f"{policy}:checked"):
        assert record[name]["fingerprint"] == fingerprint(name), f"run {faults.PROGRAM} --policy {policy} again"

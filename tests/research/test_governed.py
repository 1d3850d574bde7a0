"""The study of governed plans: its suite, a quick form of the command, its record, and the page."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from auv_gym.planning.paths import Retimed
from baselines.evaluation.fingerprints import fingerprint
from baselines.evaluation.suites import load_suite
from baselines.tools.command_line import run
from baselines.tools.files import read_json
from research.robustness import governed
from research.suites.builder import own_pace

ROOT = Path(__file__).parents[2]


def test_the_suite_differs_from_the_same_paths_at_their_own_pace_by_the_pace_only():
    changed = 0
    for cell in load_suite(governed.SUITE).cells:
        plain = own_pace(cell)
        assert plain.scenario == replace(cell.scenario, name=plain.scenario.name, governor=None)
        for before, after in zip(plain.episodes, cell.episodes, strict=True):
            assert not isinstance(before.path, Retimed)
            assert replace(after, path=before.path) == before
            if isinstance(after.path, Retimed):
                assert after.path.path == before.path
                assert after.path.end >= cell.scenario.duration
                low, high = cell.scenario.governor.slowest, cell.scenario.governor.fastest
                assert low - 1e-5 <= min(after.path.rates) <= max(after.path.rates) <= high + 1e-5
                changed += not np.allclose(after.path.rates, 1.0, atol=0.05)
    assert changed > 100


def test_a_quick_form_of_the_command(tmp_path, monkeypatch):
    suite = load_suite(governed.SUITE)
    suite = replace(suite, cells=suite.cells[2:3])
    monkeypatch.setattr(governed, "load_suite", lambda _: suite)
    out = tmp_path / "governed.json"
    words = ["--policy", "los-pid", "--episodes", "2", "--jobs", "1", "--out", str(out)]
    assert run(governed.main, governed.PROGRAM, words) == 0
    rows = read_json(out)["los-pid"]
    name = suite.cells[0].scenario.name
    assert list(rows) == ["fingerprint", name.replace("-governed", ""), name]
    assert rows[name]["episodes"] == 2
    monkeypatch.setattr(governed, "GOVERNED_FILE", out)
    found = governed.context()
    assert found["failures"] == {"los-pid": [rows[name.replace("-governed", "")]["failed"], rows[name]["failed"]]}
    assert f"-> {rows[name]['failed']}; {rows[name]['error_mm'] / 10:.3g} |" in found["table"]


@pytest.mark.parametrize("policy", governed.POLICIES)
def test_the_record_is_of_these_policies(policy):
    stamp = read_json(governed.GOVERNED_FILE)[policy]["fingerprint"]
    assert stamp == fingerprint(policy), f"run {governed.PROGRAM} --policy {policy} again"

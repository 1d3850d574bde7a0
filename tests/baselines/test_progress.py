"""Progress of an evaluation: lines, or a bar on a terminal."""

import io

import pytest
from rich.console import Console

from auv_gym.scenarios.presets import PRESETS
from baselines.evaluation.cells import drawn
from baselines.evaluation.report import terminal as module
from baselines.evaluation.report.terminal import run_and_show
from baselines.tools.workers import Workers


@pytest.mark.parametrize("is_terminal", [True, False])
def test_each_run_is_shown(is_terminal, monkeypatch, capsys):
    out = io.StringIO()
    if is_terminal:
        monkeypatch.setattr(module, "Console", lambda **_: Console(file=out, force_terminal=True, width=100))
    cell = drawn(PRESETS["slow-calm"], 3, 0)
    found = run_and_show([(policy, cell) for policy in ("backstepping", "open-loop")], Workers(2))
    assert {run.policy for run in found} == {"backstepping", "open-loop"}
    lines = [f"{run.policy} in slow-calm: done" for run in found]
    if is_terminal:
        assert "0/2 runs" in out.getvalue()
        assert f"2/2 {lines[1]}" in out.getvalue()
    else:
        assert capsys.readouterr().err == f"[1/2] {lines[0]}\n[2/2] {lines[1]}\n"

"""Progress of an evaluation: the counter of steps and the estimate of the remaining time."""

import io
import time

from rich.console import Console

from auv_gym.scenarios.presets import PRESETS
from baselines.evaluation import progress as module
from baselines.evaluation.progress import INTERVAL, Clock, StepCounter, progress
from baselines.evaluation.runner import drawn
from baselines.tools.workers import Workers


def test_step_counter(tmp_path):
    counter = StepCounter(tmp_path)
    counter.note("0-0", 5)
    counter.note("0-1", 7)
    counter.note("0-0", 6)
    (tmp_path / "0-2").write_text("")  # while a worker writes the file
    assert counter.total() == 13
    StepCounter(tmp_path / "elsewhere").note("0-0", 1)
    assert not (tmp_path / "elsewhere").exists()


def test_remaining_time():
    now = [0.0]
    clock = Clock(1000, lambda: now[0])
    assert clock.left(0) == ""
    now[0] = 30.0
    assert clock.left(500) == ", 30 s left"
    assert clock.left(50) == ", 10 min left"
    assert clock.left(1000) == ""
    clock.skip(400)  # of an earlier evaluation, so 100 steps took 30 s
    assert clock.left(500) == ", 2 min left"


def test_workers_count_steps(capsys):
    cell = drawn(PRESETS["slow-calm"], 3, 0)
    pairs = [(policy, cell) for policy in ("backstepping", "open-loop")]
    with progress(pairs) as report:
        assert {run.policy for run in report.runs(pairs, Workers(2))} == {"backstepping", "open-loop"}
        assert report.counter.total() == 2 * 3 * PRESETS["slow-calm"].steps
        time.sleep(2 * INTERVAL)  # until the thread has updated the display
    lines = capsys.readouterr().err.splitlines()
    assert sorted(line.split("] ")[1].split(",")[0] for line in lines) == [
        "backstepping in slow-calm: done",
        "open-loop in slow-calm: done",
    ]


def test_progress_bar_on_a_terminal(monkeypatch):
    out = io.StringIO()
    monkeypatch.setattr(module, "Console", lambda **_: Console(file=out, force_terminal=True, width=100))
    cell = drawn(PRESETS["slow-calm"], 1, 0)
    with progress([("a policy", cell)]) as report:
        report.message("a policy")
        report.counter.note("0-0", cell.scenario.steps // 2)
        time.sleep(3 * INTERVAL)
    for text in ("a policy", "50%", "left"):
        assert text in out.getvalue()

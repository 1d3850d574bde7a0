"""Workers: equal results in this process and in worker processes, and messages for wrong options."""

import sys

import pytest

from baselines.evaluation import entry as evaluation
from baselines.tools.command_line import run
from baselines.tools.workers import DEFAULT_JOBS, Workers


def power(base, exponent):
    return base**exponent


@pytest.mark.parametrize("workers", [Workers(), Workers(2)])
def test_results_are_the_same_for_any_number_of_workers(workers):
    tasks = [(base, exponent) for base in range(5) for exponent in range(3)]
    assert sorted(workers.results(power, tasks)) == sorted(power(*task) for task in tasks)
    assert list(workers.results(power, [])) == []


def test_workers_of_a_command_line():
    assert Workers.of(None) == Workers(DEFAULT_JOBS)
    assert Workers.of(5) == Workers(5)
    with pytest.raises(ValueError, match="--jobs is 0; it must be 1 or more"):
        Workers.of(0)


def test_arguments_with_invalid_characters_are_refused(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["evaluate.py", "--out", "a\udcff"])
    assert run(evaluation.main, evaluation.PROGRAM) == 2
    message = "evaluate.py: 'a\\udcff' contains characters that cannot be printed; leave them out\n"
    assert capsys.readouterr().err == message

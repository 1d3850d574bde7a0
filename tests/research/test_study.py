"""Studies: a quick form of each command, rows that are measured again only if something has changed, the records."""

import json
import shutil
from importlib import import_module

import pytest
from marks import slow_except

from baselines.tools.command_line import UsageError, run
from research import study
from research.__main__ import RESEARCH_COMMANDS
from research.deployment.emulator import PROGRAMS
from research.robustness import failure_rate
from research.study import Study

MODULES = {name: import_module(command.module) for name, command in RESEARCH_COMMANDS.items()}
STUDIES = {name: module.STUDY for name, module in MODULES.items() if hasattr(module, "STUDY")}
QUICK = {
    "deployment": "helm-small",
    "failure-rate": "helm slow-storm",
    "fine-tuning": "lauv",
    "identification-coverage": "rate-limits",
    "model-error": "backstepping cruise",
    "speed": "decisions",
    "transfer": "otter los-pid",
    "vehicle-gains": "otter los-pid",
}
"""Words of the rows whose quick form runs here; the tests of a study say more about it."""


@pytest.mark.filterwarnings("ignore:these gains are stable up to")  # a suite has faster references
@pytest.mark.parametrize(
    "name", slow_except(set(QUICK) - {"deployment", "fine-tuning", "identification-coverage"}, QUICK)
)
def test_a_quick_form_of_each_study(name, tmp_path, monkeypatch, capsys):
    if name == "deployment" and not all(map(shutil.which, PROGRAMS)):
        pytest.skip("the emulator is not installed")
    monkeypatch.chdir(tmp_path)
    own, words = STUDIES[name], QUICK[name].split()
    recorded = own.values()
    assert run(own.main, own.program, [*words, "--quick"]) == 0
    assert list(json.loads((tmp_path / "runs" / "quick" / own.file.name).read_text())) == [" ".join(words)]
    assert own.values() == recorded
    assert f"1 of {len(own.rows)} rows measured" in capsys.readouterr().out


def test_the_quick_forms_are_of_all_studies():
    assert set(QUICK) == set(STUDIES) - {"validation"}  # needs the measured runs, see test_validation.py


@pytest.mark.slow
@pytest.mark.parametrize("name", STUDIES)
def test_records_are_complete_and_belong_to_the_present_policies_and_simulator(name):
    outdated = [" ".join(row) for row in STUDIES[name].rows if STUDIES[name].is_outdated(row)]
    assert not outdated, f"run {STUDIES[name].program}"


@pytest.fixture
def small(tmp_path, monkeypatch):
    """A study of four rows, whose stamp can change; each measurement is counted in its value."""
    monkeypatch.setattr(study, "DATA", tmp_path)
    monkeypatch.chdir(tmp_path)
    calls = []

    def measure(policy, case, quick=False):
        calls.append((policy, case))
        return {"calls": len(calls), "quick": quick}

    stamps = {"a": "first", "b": "first"}
    rows = [(policy, case) for policy in "ab" for case in ("calm", "storm")]
    return Study("small-one", rows, measure, lambda policy, case: stamps[policy]), calls, stamps


def test_rows_are_measured_once_until_their_stamp_changes(small):
    own, calls, stamps = small
    assert (own.main([]), calls) == (0, list(own.rows))
    assert (own.main([]), len(calls)) == (0, 4)
    stamps["b"] = "second"
    assert [row for row in own.rows if own.is_outdated(row)] == [("b", "calm"), ("b", "storm")]
    assert (own.main([]), calls[4:]) == (0, [("b", "calm"), ("b", "storm")])
    assert own.main(["--again", "a", "storm"]) == 0
    assert calls[6:] == [("a", "storm")]
    assert [value["calls"] for value in own.values().values()] == [1, 7, 5, 6]


def test_words_choose_rows_and_an_interruption_loses_one_row(small, monkeypatch):
    own, calls, _ = small
    assert (own.main(["storm", "b"]), calls) == (0, [("b", "storm")])
    assert (own.main(["calm"]), calls[1:]) == (0, [("a", "calm"), ("b", "calm")])
    assert (own.main(["a", "b"]), len(calls)) == (0, 3)  # no row has both
    with pytest.raises(UsageError, match="a storm is not measured: run python -m research small-one a storm"):
        own.values()["a", "storm"]

    def broken(*row, quick):
        raise OSError("no compiler")

    object.__setattr__(own, "measure", broken)
    assert own.main([]) == 1
    assert list(own.values()) == [("a", "calm"), ("b", "calm"), ("b", "storm")]


def test_an_unknown_word_is_refused_in_one_line(small, capsys):
    assert run(small[0].main, "research", ["ocean"]) == 2
    assert capsys.readouterr().err == "research: unknown word 'ocean'; allowed are a, calm, storm, b\n"


def test_stamps_change_with_the_policy_the_simulation_and_the_budget(monkeypatch):
    rows = [("helm", "slow-calm"), ("clairvoyant", "slow-calm"), ("helm", "cruise-storm")]
    stamps = [failure_rate.STUDY.stamp(*row) for row in rows]
    assert len(set(stamps)) == 3
    monkeypatch.setitem(failure_rate._EPISODES, "helm", 7)
    assert failure_rate.STUDY.stamp(*rows[0]) not in stamps
    assert failure_rate.STUDY.stamp(*rows[1]) == stamps[1]

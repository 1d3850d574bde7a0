"""Submissions: checks of files, reproduction of episodes, the leaderboard and its tutorial."""

import dataclasses
import html
import json
import re
import shlex
import shutil
import zipfile
from pathlib import Path

import numpy as np
import pytest
from markdown_it import MarkdownIt

from baselines.evaluation import entry as evaluation
from baselines.evaluation import recorded, request, suites
from baselines.evaluation.about import About
from baselines.evaluation.fingerprints import fingerprint
from baselines.evaluation.report.numbers import pool
from baselines.evaluation.runner import Cell, Recorded, run_all
from baselines.evaluation.score import BY_BOUND, EXPERT
from baselines.evaluation.store import Stored
from baselines.evaluation.store import write as write_stored
from baselines.evaluation.submission import command as submit
from baselines.evaluation.submission import files
from baselines.evaluation.submission.files import (
    LARGEST_SUBMISSION,
    SUBMITTED,
    read_submission,
    save_submission,
    submission_of,
)
from baselines.evaluation.submission.reproduction import chosen, chosen_cells, detectable_share, mismatches
from baselines.evaluation.submission.scores import anchor_errors, entries
from baselines.evaluation.suites import Suite
from baselines.tools.command_line import DONE, FAILED, UsageError
from baselines.tools.files import versions
from research.leaderboard import board, command
from research.leaderboard.board import boards, enter, stamp
from research.leaderboard.page import NBSP, leaderboard_page, plain

ROOT = Path(__file__).parents[2]
FENCE = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
BLOCKS, WRITTEN = (
    FENCE.findall((ROOT / "docs" / name).read_text(encoding="utf-8"))
    for name in ("enter.md", "tutorials/controller.md")
)
LINES = [line for language, text in BLOCKS if language == "bash" for line in text.splitlines()]
QUICK = {"--episodes": "1", "--share": "1"}
"""Options of the commands on the page that have other values in this test."""
CASES = ("slow-calm", "cruise-storm")


@pytest.fixture(scope="module")
def suite():
    """Two cases of the benchmark with three episodes each, under its name."""
    cells = [cell for cell in suites.load_suite("benchmark-v2").cells if cell.scenario.name in CASES]
    few = tuple(Cell(cell.scenario, cell.episodes[:3]) for cell in cells)
    return Suite("benchmark-v2", "5" * 64, few, (), BY_BOUND)


@pytest.fixture(scope="module")
def rows(suite):
    """The runs of the suite's anchors, with a date as if they were recorded."""
    when = Recorded("2026-01-31", versions())
    return tuple(dataclasses.replace(run, recorded=when) for run in run_all(suite.anchors, suite.cells))


@pytest.fixture
def small(suite, rows, tmp_path, monkeypatch):
    """A folder with the files of the page, in which all suites are `suite`."""
    for module in (suites, request, files):
        monkeypatch.setattr(module, "load_suite", lambda _: suite)
    monkeypatch.setattr(recorded, "load_recorded", lambda _: recorded.Found(rows, {}))
    monkeypatch.chdir(tmp_path)
    text = next(text for _, text in WRITTEN if text.startswith("# line_of_sight.py"))
    Path("line_of_sight.py").write_text(text, encoding="utf-8")


@pytest.fixture
def made(small, suite, rows):
    """The submission of the expert, also written to expert.npz."""
    own = [dataclasses.replace(run, fingerprint="0" * 64) for run in rows if run.policy == EXPERT]
    made = submission_of(
        suite, own, "expert", About("Ada", "https://example.org/a", "The law."), versions(), "no command"
    )
    save_submission(made, Path("expert.npz"))
    return made


def typed(line):
    """Run a command of the page with the options `QUICK` and return the exit status."""
    words = shlex.split(line)
    for option, value in QUICK.items():
        if option in words:
            words[words.index(option) + 1] = value
    for before, main in (
        (["auv-gym", "evaluate"], evaluation.main),
        (["auv-gym", "submit"], submit.main),
        (["python", "-m", "research", "leaderboard"], command.main),
    ):
        if words[: len(before)] == before:
            return main([*words[len(before) :], "--jobs", "1"])
    raise AssertionError(line)


@pytest.mark.slow
@pytest.mark.usefixtures("small")
def test_commands_of_the_tutorial(capsys):
    """After all commands the controller is on the leaderboard, with the scores of evaluate.py."""
    for line in LINES:
        assert typed(line) == DONE, line
    out = capsys.readouterr().out
    assert Path("runs/evaluate/line-of-sight.npz").stat().st_size < LARGEST_SUBMISSION
    assert "Reproduced: all 24 numbers" in out
    assert "6 of 6 episodes again, chosen by --seed" in out
    results = json.loads(Path("runs/evaluate/results.json").read_text())
    [found] = boards(Path("leaderboard"))
    assert found.suite.hash == results["suite_hash"]
    own = {row["speed_range"]: row for row in results["pooled"] if row["policy"] == "line_of_sight.py:LineOfSight"}
    assert [entry.place for entry in found.entries] == ["slow", "cruise"]
    for entry in found.entries:
        assert entry.policy == "line-of-sight"
        assert entry.score.mean == pytest.approx(own[entry.place]["score"]["mean"], rel=1e-5)
        assert entry.failed == own[entry.place]["failed"]
    assert found.verified["line-of-sight"]["episodes"] >= 2
    text = Path("docs/leaderboard.md").read_text()
    assert "| 1 | `line-of-sight`<br>Ada |" in text


@pytest.mark.usefixtures("small")
def test_submission_of_an_agent_has_its_speed_range_only(suite, capsys):
    policy = ["--policy", "apg-slow", "--submit", "mine", "--training-steps", "8e6", "--training-seconds", "300"]
    assert evaluation.main([*policy, "--jobs", "1", "--out", "out"]) == DONE
    found = read_submission(Path("out/mine.npz"))
    assert [run.scenario.name for run in found.runs] == ["slow-calm"]
    assert (found.policy, found.about.training_steps) == ("apg-slow", 8e6)
    assert found.fingerprint == fingerprint("apg-slow")
    assert "--submit mine" in found.command
    assert "8 M steps<br>5 min".replace(" ", NBSP) in leaderboard_page(
        [board.Leaderboard(suite, (found,), tuple(entries([found], anchor_errors(suite))), {})]
    )


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--submit a --scenario slow-calm --policy lqi", "needs a frozen suite"),
        ("--submit a --suite presets --policy lqi", "needs a frozen suite"),
        ("--submit a", "needs one policy, --policy P; there are 0"),
        ("--submit a --policy lqi ekf", "there are 2"),
        ("--submit a --policy lqi --episodes 3", "leave out --episodes"),
        ("--submit ../a --policy lqi", "lower-case letters"),
        ("--submit A --policy lqi", "lower-case letters"),
        (f"--submit a --policy lqi --author {'a' * 81}", "at most 80"),
        ("--submit a --policy lqi --link javascript:alert(1)", "begins with https://"),
        ("--submit a --policy lqi --training-steps nan", "training_steps is nan"),
        ("--policy lqi --author Ada", "for --submit NAME"),
    ],
)
def test_wrong_submissions_are_refused_before_episodes_run(words, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UsageError, match=re.escape(message)):
        evaluation.main(shlex.split(words))
    assert not list(tmp_path.iterdir())


def test_a_failed_policy_gives_no_submission(small, capsys):
    Path("late.py").write_text("class Law:\n    def predict(self, *_):\n        raise KeyError('x')\n")
    assert evaluation.main(["--policy", "late.py:Law", "--submit", "a", "--jobs", "1", "--out", "out"]) == FAILED
    assert "no submission: late.py:Law failed in slow-calm: KeyError" in capsys.readouterr().err
    assert not Path("out/a.npz").exists()


def test_a_file_has_the_results_of_the_runs(made):
    found = read_submission(Path("expert.npz"))
    assert (found.name, found.about, found.date) == ("expert", made.about, "2026-01-31")
    for old, new in zip(made.runs, found.runs, strict=True):
        assert old.scenario == new.scenario
        for key in SUBMITTED:
            np.testing.assert_array_equal(getattr(old.measures, key), getattr(new.measures, key))
    with np.load("expert.npz", allow_pickle=False) as arrays:
        assert arrays["steady_rmse"].shape == (6,)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["benchmark-v1", "benchmark-v2"])
def test_scores_of_files_equal_those_of_recorded_rows(name):
    """For the whole benchmark, with the anchors of each suite."""
    suite = suites.load_suite(name)
    found = recorded.load_recorded(suite)
    kept = [run for run in found.runs if run.policy in (*suite.anchors, "lqi")]
    expected = {entry.place: entry for entry in pool(kept) if entry.policy == "lqi"}
    for entry in entries([command.own_submission(name, "lqi")], anchor_errors(suite)):
        assert entry.score.mean == pytest.approx(expected[entry.place].score.mean, rel=1e-6)
        assert entry.score.ci95 == pytest.approx(expected[entry.place].score.ci95, rel=1e-6)
        assert entry.failed == expected[entry.place].failed
        assert entry.effort_ratio == pytest.approx(expected[entry.place].effort_ratio, rel=1e-6)


def changed(made, arrays=(), **record):
    """Write the submission with changes of its record or arrays; None deletes an entry."""
    stored = made.stored
    both = {**stored.record, **record}, {**stored.arrays, **dict(arrays)}
    write_stored(Path("bad.npz"), Stored(*({k: v for k, v in part.items() if v is not None} for part in both)))
    return Path("bad.npz")


STEADY_RMSE = np.full(6, 0.01, dtype=np.float32)
WRONG = {
    "format": ({"format": 2}, {}, "must be of format 1"),
    "less": ({"command": None}, {}, "must be of format 1 with"),
    "more": ({"score": 3.0}, {}, "and nothing else"),
    "name": ({"name": "a/b"}, {}, "lower-case letters"),
    "policy": ({"policy": "a\x1b[2J"}, {}, "its policy is"),
    "fingerprint": ({"fingerprint": "abc"}, {}, "its fingerprint is 'abc'"),
    "date": ({"date": "2026-02-30"}, {}, "day"),
    "versions": ({"versions": {"auv_gym": "<b>"}}, {}, "its auv_gym is"),
    "suite": ({"suite": "paper"}, {}, "its suite is 'paper'; there are"),
    "hash": ({"suite_hash": "6" * 64}, {}, "it is for another benchmark-v2"),
    "about": ({"about": {"email": "a"}}, {}, "must be a table with some of author"),
    "link": ({"about": {"link": "https://a)[b](c"}}, {}, "begins with https://"),
    "cells": ({"cells": ["slow-calm", "slow-storm"]}, {}, "its cells are not those of"),
    "order": ({"cells": ["cruise-storm", "slow-calm"]}, {}, "its cells are not those of"),
    "no cells": ({"cells": []}, {}, "its cells are not those of"),
    "cells of a kind": ({"cells": [["slow-calm"]]}, {}, "its cells are not those of"),
    "episodes": ({"episodes": [3, 2]}, {}, "all of them must be run"),
    "seconds": ({"decision_seconds": [0.1, -1.0]}, {}, "not a time for each cell"),
    "true": ({"decision_seconds": [True, 0.1]}, {}, "not a time for each cell"),
    "short": ({}, {"steady_rmse": STEADY_RMSE[:5]}, "its steady_rmse is float32 of shape (5,)"),
    "double": ({}, {"steady_rmse": STEADY_RMSE.astype(float)}, "its steady_rmse is float64"),
    "missing": ({}, {"steady_rmse": None}, "its arrays are effort, failed, smoothness;"),
    "nan": ({}, {"steady_rmse": STEADY_RMSE * np.float32(np.nan)}, "its steady_rmse is not within [0, 1e+06]"),
    "negative": ({}, {"effort": -STEADY_RMSE}, "its effort is not within [0, 1]"),
    "far": ({}, {"steady_rmse": STEADY_RMSE + 35, "failed": np.zeros(6, dtype=bool)}, "the episode did not end"),
    "command rate": (
        {},
        {"effort": STEADY_RMSE, "smoothness": STEADY_RMSE * 5},
        "the command rate is too large for the effort",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_invalid_files_are_refused(case, made):
    record, arrays, message = WRONG[case]
    with pytest.raises(ValueError, match=re.escape(message)):
        read_submission(changed(made, arrays, **record))
    assert submit.main(["bad.npz"]) == FAILED


def test_damaged_files_are_refused(made):
    whole, rng, file = Path("expert.npz").read_bytes(), np.random.default_rng(0), Path("a.npz")
    for i in range(120):
        data = bytearray(whole)
        data[rng.integers(len(data))] ^= 1 << int(rng.integers(8))
        file.write_bytes(data if i % 3 else data[: rng.integers(len(data))])
        try:
            assert read_submission(file).episodes == 6
        except ValueError as error:
            assert "a.npz is damaged" in str(error)  # noqa: PT017


def test_large_files_and_pickles_are_refused(made, tmp_path):
    Path("long.npz").write_bytes(bytes(LARGEST_SUBMISSION + 1))
    with zipfile.ZipFile("bomb.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("steady_rmse.npy", bytes(files.LARGEST_CONTENT + 1))
    np.savez("pickle.npz", record=np.array("{}"), steady_rmse=np.array([{}], dtype=object))
    for name, message in (("long", "larger than"), ("bomb", "unpacked"), ("pickle", "allow_pickle")):
        with pytest.raises(ValueError, match=message):
            read_submission(Path(f"{name}.npz"))
    big = dataclasses.replace(made, command="".join(map(chr, np.random.default_rng(0).integers(33, 126, 300_000))))
    with pytest.raises(ValueError, match="allowed are"):
        save_submission(big, Path("big.npz"))
    assert not Path("big.npz").exists()


@pytest.mark.parametrize(("measure", "by"), [("steady_rmse", 1.01), ("smoothness", 0.9), ("effort", 1.01)])
def test_forged_results_are_printed_with_both_numbers(measure, by, made, capsys):
    values = made.stored.arrays[measure].copy()
    true = float(values[4])
    values[4] *= by
    file = changed(made, {measure: values})
    assert submit.main([str(file), EXPERT, "--share", "1", "--jobs", "1"]) == FAILED
    out = capsys.readouterr().out
    assert "NOT REPRODUCED: 1 of 6 episodes differ" in out
    unit = " m" if measure == "steady_rmse" else ""
    assert f"episode 1 of cruise-storm: {measure} {true * by:.6g}{unit} submitted, {true:.6g}{unit} found" in out


def test_another_policy_does_not_reproduce_it(made, capsys):
    assert submit.main(["expert.npz", "lqi", "--share", "1", "--jobs", "1"]) == FAILED
    captured = capsys.readouterr()
    assert "NOT REPRODUCED: 6 of 6" in captured.out
    assert "lqi is not the submitted policy" in captured.err


def test_a_policy_that_fails_does_not_reproduce_it(made, capsys):
    Path("late.py").write_text("class Law:\n    def predict(self, *_):\n        raise KeyError('x')\n")
    assert submit.main(["expert.npz", "late.py:Law", "--jobs", "1"]) == FAILED
    assert "late.py:Law fails in slow-calm: KeyError" in capsys.readouterr().err


def test_the_choice_of_episodes_is_random(made):
    whole = own_submission_like(made, 200)
    a, b = chosen(whole, 0.05, 1), chosen(whole, 0.05, 2)
    assert {name: len(own) for name, own in a.items()} == dict.fromkeys(CASES, 10)
    assert any((a[name] != b[name]).any() for name in CASES)
    np.testing.assert_equal(a, chosen(whole, 0.05, 1))
    counts = sum(np.bincount(chosen(whole, 0.1, seed)["slow-calm"], minlength=200) for seed in range(500))
    assert 15 < counts.min() <= counts.max() < 95  # mean 50, standard deviation 6.7
    assert (1 - detectable_share(208)) ** 208 == pytest.approx(0.05)


def own_submission_like(made, count):
    """Return a submission with `count` episodes in each cell."""
    runs = [dataclasses.replace(run, measures=run.measures[np.zeros(count, dtype=int)]) for run in made.runs]
    return dataclasses.replace(made, runs=tuple(runs))


def test_tolerances_of_reproduction(made, rows):
    """The tolerance is 0.1 % plus a small constant; the flag of a failed episode must be equal."""
    episodes = chosen(made, 1.0, 0)
    again = [run for run in rows if run.policy == EXPERT]
    assert mismatches(made, episodes, again) == []
    assert [len(cell.episodes) for cell in chosen_cells(made, episodes)] == [3, 3]
    run = again[1]
    for key, values, count in (
        ("steady_rmse", run.measures.steady_rmse * 1.0009, 0),
        ("steady_rmse", run.measures.steady_rmse * 1.002 + 1e-5, 3),
        ("steady_rmse", run.measures.steady_rmse * np.nan, 3),
        ("failed", ~run.measures.failed, 3),
    ):
        other = dataclasses.replace(run, measures=dataclasses.replace(run.measures, **{key: values}))
        found = mismatches(made, episodes, [again[0], other])
        assert [m.measure for m in found] == [key] * count


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("leaderboard enter a b", "enter takes FILE"),
        ("leaderboard reproduce a", "reproduce takes FILE POLICY; given are 1 words"),
        ("leaderboard page a", "page takes no file"),
        ("leaderboard page", "no submission in --folder leaderboard"),
        ("leaderboard invent", "invent"),
        ("submit none.npz", "cannot read none.npz"),
        ("submit expert.npz backstepping --share 0", "--share is 0.0"),
        ("submit expert.npz backstepping --share nan", "--share is nan"),
        ("submit expert.npz backstepping --seed -1", "--seed is -1"),
        ("submit expert.npz backstepping --jobs 0", "--jobs and --step-limit must be positive"),
        ("submit expert.npz nobody", "unknown policy 'nobody'"),
    ],
)
def test_wrong_usage(words, message, made):
    name, *arguments = shlex.split(words)
    with pytest.raises(UsageError, match=re.escape(message)):
        {"leaderboard": command, "submit": submit}[name].main(arguments)


def test_an_entry_is_replaced_only_with_the_option(made, capsys):
    arguments = ["enter", "expert.npz", "--out", "pages"]
    assert command.main(arguments) == DONE
    with pytest.raises(UsageError, match="is there already; choose another name, or --replace it"):
        command.main(arguments)
    assert command.main([*arguments, "--replace"]) == DONE
    assert "1 entries" in capsys.readouterr().out


def test_only_the_submitted_policy_verifies_an_entry(made, capsys):
    """A policy with the same actions but another fingerprint does not, even if all episodes are equal."""
    assert command.main(["enter", "expert.npz", "--out", "pages"]) == DONE
    file = "leaderboard/benchmark-v2/expert.npz"
    assert command.main(["reproduce", file, EXPERT, "--share", "1", "--out", "pages", "--jobs", "1"]) == FAILED
    captured = capsys.readouterr()
    assert "Reproduced: all 24 numbers" in captured.out
    assert f"not verified: {EXPERT} is not the policy that was submitted" in captured.err
    assert boards(Path("leaderboard"))[0].verified == {}
    with pytest.raises(UsageError, match=r"--share is 0\.01; an entry is verified by 0\.05 or more"):
        command.main(["reproduce", file, EXPERT, "--share", "0.01"])
    with pytest.raises(UsageError, match="seed"):
        command.main(["reproduce", file, EXPERT, "--seed", "3"])


def test_a_verification_belongs_to_one_file(made):
    folder = Path("board")
    file = enter(made, folder)
    stamp(file, folder, 5, 6, 7)
    assert boards(folder)[0].verified["expert"]["episodes"] == 5
    other = dataclasses.replace(made, command="another")
    enter(other, folder, replace=True)
    assert boards(folder)[0].verified == {}
    with pytest.raises(ValueError, match="enter it first"):
        stamp(Path("expert.npz"), folder, 5, 6, 7)
    for record in ("[]", '{"a": 3}', '{"benchmark-v2/expert": {"sha256": "a"}}', "no json"):
        (folder / board.VERIFIED_FILE).write_text(record)
        with pytest.raises(ValueError, match=board.VERIFIED_FILE):
            boards(folder)


def test_misplaced_files_on_the_leaderboard_are_reported(made):
    folder = Path("board")
    file = enter(made, folder)
    shutil.copy(file, file.with_name("other.npz"))
    with pytest.raises(ValueError, match=r"other\.npz holds expert in benchmark-v2"):
        boards(folder)
    file.with_name("other.npz").unlink()
    (folder / "mine").mkdir()
    shutil.copy(file, folder / "mine")
    with pytest.raises(ValueError, match="lies in the folder of no suite"):
        boards(folder)


def test_texts_of_entries_are_escaped():
    for text in (
        "<script>alert(1)</script>",
        "a | b `c` *d* _e_ [f](g) ![h](i)",
        "# a & &lt; ~~b~~ {ref}`c` $x$ \\",
        "é: € x",
    ):
        assert MarkdownIt("gfm-like", {"linkify": False}).renderInline(plain(text)) == html.escape(
            text, quote=False
        ).replace('"', "&quot;")


def test_scores_need_recorded_rows(made, monkeypatch):
    monkeypatch.setattr(recorded, "load_recorded", lambda _: recorded.Found((), {EXPERT: "they changed"}))
    with pytest.raises(ValueError, match="rows of backstepping in benchmark-v2, which cannot be used: they"):
        anchor_errors(made.suite)


def test_the_page_is_that_of_the_command():
    """If this fails after a new recording of rows, run `python -m research leaderboard own`."""
    found = boards(ROOT / "leaderboard")
    assert (ROOT / "docs" / command.PAGE).read_text(encoding="utf-8") == leaderboard_page(found)
    own = {submission.name for submission in found[0].submissions}
    assert set(command.OWN) <= own
    assert set(command.OWN) <= set(found[0].verified)


@pytest.mark.slow
def test_own_entries_equal_the_recorded_rows():
    for policy, file in command.own_files(ROOT / "leaderboard"):
        kept, now = read_submission(file), command.own_submission(command.SUITE, policy)
        assert kept.fingerprint == now.fingerprint
        for old, new in zip(kept.runs, now.runs, strict=True):
            np.testing.assert_array_equal(old.measures.steady_rmse, new.measures.steady_rmse)

"""The page about what learning is worth says what the files say; held-out episodes are new ones."""

import re
from pathlib import Path

import numpy as np
import pytest

from baselines.evaluation import recorded, suites
from baselines.evaluation.metrics import most_lost
from baselines.evaluation.runner import Task
from baselines.tools.command_line import UsageError
from research.results import fresh
from research.results.findings import fresh_results
from research.seeds import HELD_OUT

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "results" / "learning.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def anew():
    return fresh_results()


def test_storms_by_hand():
    """In how many storms an agent without a preview beats the controller, from the files alone."""
    folder = ROOT / "baselines/evaluation/data/recorded/benchmark-v1"
    own, rival = (np.load(folder / f"{name}.npz")["measures"] for name in ("apg-slow", "nmpc"))
    share = np.mean(own[1].reshape(8, 260)[7] < rival[1].reshape(16, 260)[7])
    row = re.search(r"^\| `apg-slow` \|(?: \d+ % \|)+$", PAGE, re.MULTILINE)[0].split(" | ")
    assert row[-1] == f"{100 * share:.0f} % |"
    assert share < 0.5


def test_upper_bound_is_the_rule_of_three():
    assert most_lost(0, 2080) == pytest.approx(3 / 2080, rel=5e-3)
    assert most_lost(1, 2080) > most_lost(0, 2080)
    assert most_lost(5, 5) == 1.0


def test_fresh_episodes_are_those_of_no_suite():
    suite, frozen = fresh.fresh("benchmark-v2", 3, ["slow-storm"]), suites.load_suite("benchmark-v1")
    known = {episode.noise_seed for cell in frozen.cells for episode in cell.episodes}
    (cell,) = suite.cells
    assert cell.scenario.name == "slow-storm"
    assert not known & {episode.noise_seed for episode in cell.episodes}
    assert suite.hash != frozen.hash
    assert HELD_OUT.holds(fresh.HELD_OUT_SEED, max(fresh.HELD_OUT_EPISODES.values()))


@pytest.mark.parametrize("policy", ["backstepping", "apg-cruise", "apg-preview-cruise"])
def test_kept_rows_are_what_the_policies_do(anew, policy):
    results = next(r for r in anew if r.suite.name == "benchmark-v2")
    kept = next(r for r in results.runs if (r.policy, r.scenario.name) == (policy, "cruise-storm"))
    (cell,) = fresh.fresh("benchmark-v2", 2, ["cruise-storm"]).cells
    again = Task(policy, cell.scenario, cell.episodes).run()[1].rollout
    np.testing.assert_allclose(again.measures.tail, kept.measures.tail[:2], rtol=1e-4)


def test_command_keeps_rows_that_are_found_again(tmp_path, capsys):
    words = "--suite benchmark-v2 --case cruise-calm --episodes 2 --policy apg-slow open-loop --out"
    assert fresh.main([*words.split(), str(tmp_path)]) == 0
    assert capsys.readouterr().out == "benchmark-v2: open-loop, 2 episodes\n"
    found = recorded.load_recorded(fresh.fresh("benchmark-v2", 2, ["cruise-calm"]), tmp_path)
    assert [len(run.measures) for run in found.runs] == [2]
    assert recorded.load_recorded(fresh.fresh("benchmark-v2", 3, ["cruise-calm"]), tmp_path).refused


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--policy", "nobody"], "unknown policy 'nobody'; allowed are backstepping"),
        (["--suite", "paper"], "unknown suite 'paper'; allowed are benchmark-v2, unmodelled-v1"),
        (
            ["--case", "slow-tea", "--suite", "benchmark-v2"],
            "'slow-tea' is no case of benchmark-v2; allowed are slow-calm",
        ),
        (["--episodes", "0"], "--episodes is 0; it must be 1 or more"),
    ],
)
def test_mistakes_are_refused(arguments, message):
    with pytest.raises(UsageError, match=message):
        fresh.main(arguments)


def leads():
    """Return the rows of leads over nmpc in the page of policies, as the page of findings has them."""
    section, storms = PAGE.split("## Where an agent leads")[0], PAGE.split("## Where an agent leads")[1]
    families = ("`helm`, {}", "`apg-{}`", "`apg-preview-{}`")
    for name in (family.format(regime) for regime in ("slow", "cruise") for family in families):
        cells = re.search(rf"^\| {name} \| (.*) \|$", section, re.MULTILINE)[1].split(" | ")
        share = re.search(rf"^\| {name} \|.* (\d+ %) \|$", storms.split("## Where all")[0], re.MULTILINE)[1]
        yield f"| {name} | {cells[2]} ({cells[3]}) of {cells[4]} | {cells[5]} ({cells[6]}) of {cells[7]} | {share} |"


def test_readme_and_page_of_policies_say_the_same():
    readme, policies = ((ROOT / name).read_text(encoding="utf-8") for name in ("README.md", "docs/policies.md"))
    assert "\n".join(leads()) + "\n" in policies
    for page in (readme, policies):
        assert f"a share of up to {100 * most_lost(0, 2080):.2f} %" in page


def test_who_is_ahead_where_all_is_not_as_told():
    """What README and the page of policies say in words: nobody on frozen episodes, `helm` is level on fresh ones."""
    section = PAGE.split("## Where all is not as told")[1].split("\n## ")[0]
    rows = [row.strip("| ").split(" | ") for row in section.splitlines() if row.startswith("| `")]
    ends = {cells[0]: [cells[column].split(" ... ") for column in (4, 7)] for cells in rows}
    assert all(float(frozen[1]) < 0 for frozen, _ in ends.values())
    assert [name for name, (_, anew) in ends.items() if float(anew[1]) >= 0] == ["`helm`, cruise"]

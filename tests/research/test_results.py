"""The pages of results and the README agree with the recorded rows."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from auv_gym.installation import found
from baselines import list_policies
from baselines.agents.names import agent_folder
from baselines.evaluation import recorded
from baselines.evaluation.score import error_cap, has_failed, lead
from baselines.tools.files import read_json
from research import pages
from research.estimation_bound.command import episode_errors, recorded_bounds
from research.pages import SUITE_PAGES
from research.results import collection, overview
from research.results.collection import ROUNDING, Results, better_than, results_of
from research.results.learning import versus_expert
from research.robustness.faults import FAULTS_FILE
from research.throughput.measure import THROUGHPUT_FILE
from research.transfer.comparison import TRANSFER_FILE

pytestmark = pytest.mark.slow  # all recorded rows are read

ROOT = Path(__file__).parents[2]
AGENT = "helm"  # the agent of the README
WORDS = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve")


@pytest.fixture(scope="module")
def suites():
    return {name: results_of(name) for name in SUITE_PAGES}


@pytest.fixture(scope="module")
def benchmark(suites):
    return suites["benchmark-v2"]


def test_every_policy_is_there(benchmark):
    assert benchmark.policies == list(list_policies())
    assert {run.recorded.versions["auv_gym"] for run in benchmark.runs} == {"0.1.0"}


def test_the_oracle_has_the_smallest_error(suites):
    """But for some mm where a current is nearly as fast as the path, and for slow actuators and high speeds."""
    tolerances = {"benchmark-v2": 2e-3, "ood-v1": 1e-2, "unmodelled-v1": 1e-2, "deep-v1": 1e-2, "sealed-v2": 1e-2}
    for name, tolerance in tolerances.items():
        better = {case for case, _, gain in better_than("oracle", suites[name]) if gain > tolerance}
        assert better == ({"slow-slew", "slow-all-at-once", "cruise-beyond"} if name == "sealed-v2" else set()), name


def test_no_policy_is_better_than_the_full_information_optimum(suites):
    """In the mean of each case of each suite, within the tolerance of the solver."""
    for entry in suites.values():
        assert "clairvoyant" in entry.policies
        worst = max((gain for *_, gain in better_than("clairvoyant", entry)), default=0.0)
        assert worst < ROUNDING


def test_no_policy_with_measurements_is_below_the_estimation_lower_bound(benchmark):
    """In the mean of each case with noise, from the files."""
    bounds = recorded_bounds(benchmark.suite.source[1])
    assert set(bounds) == {f"{speed_range}-{case}" for speed_range in ("slow", "cruise") for case in ("noise", "storm")}
    for case, bound in bounds.items():
        assert bound.episodes == 260
        steady_rmses = {policy: own[case] for policy, own in benchmark.steady_rmses.items() if case in own}
        below = {policy for policy, steady_rmse in steady_rmses.items() if steady_rmse < bound.steady_rmse_m}
        assert below == {"oracle", "clairvoyant"}  # they need no measurements
        assert bound.steady_rmse_m < bound.rms_m < 1.06 * bound.steady_rmse_m


def test_recorded_bounds_of_single_episodes_are_reproduced(benchmark):
    cell = next(cell for cell in benchmark.suite.cells if cell.scenario.name == "cruise-noise")
    bound = recorded_bounds(benchmark.suite.source[1])["cruise-noise"]
    found = episode_errors(cell.scenario, cell.episodes[: len(bound.first_m)])
    np.testing.assert_allclose(found.steady_rmse, bound.first_m, rtol=1e-3)


def test_the_readme_shows_rows_and_times_of_the_summary(benchmark):
    """The first columns of docs/results.md, the times of a decision at cruise, and the training time of the agent."""
    values = overview.context()
    rows, ratios = values["rows"], values["ratios"]
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    shown = re.findall(r"^\| (`\S+`) \| (.*) \|$", readme, re.MULTILINE)
    assert [[name, *cells.split(" | ")] for name, cells in shown] == [row[:4] for row in rows]
    cruise = {entry.policy: entry for entry in benchmark.pooled if entry.place == "cruise"}
    agent, rival = (f"{1e6 * cruise[name].decision_seconds:.2g} us" for name in (AGENT, "nmpc"))
    card = (agent_folder(AGENT) / "card.md").read_text(encoding="utf-8")
    minutes = round(float(re.search(r"\| seconds \| `([\d.]+)` \|", card)[1]) / 60)
    prose = " ".join(readme.split())
    assert f"is {ratios['slow']:.2f} (slow) and {ratios['cruise']:.2f} (cruise) times that of `nmpc`" in prose
    assert f"A decision of `{AGENT}` takes {agent} and one of `nmpc` {rival}" in prose
    assert f"`{AGENT}` was trained in {WORDS[minutes]} minutes on two cores" in prose
    alone = {figure["case"].rpartition(": ")[2]: figure["value"] for figure in read_json(THROUGHPUT_FILE)["figures"]}
    agent, rival = (f"{1e6 * alone[name]:.0f}" for name in (AGENT, "nmpc"))
    assert f"for one vehicle {agent} and {rival} us)" in prose


def test_the_limitations_of_the_readme_are_measured(suites):
    """Failures where the expert has none; errors on the REMUS 100 are as large in six degrees of freedom."""
    added = {name: versus_expert(results, AGENT)[0] for name, results in suites.items()}
    assert {name for name, count in added.items() if count} == {"sealed-v2"}
    readme = " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())
    expert, own = (_failed_in(suites["sealed-v2"], "cruise-slew", policy) for policy in ("backstepping", AGENT))
    assert (own & ~expert).sum() == added["sealed-v2"]
    assert f"from zero to the limit (`sealed-v2`: {added['sealed-v2']} of {len(own)} episodes)" in readme
    faults = json.loads(FAULTS_FILE.read_text(encoding="utf-8"))
    frozen = [faults[policy]["cruise-yaw-rate-frozen"] for policy in (AGENT, "backstepping")]
    assert frozen[0]["failed"] > frozen[1]["failed"]
    assert f"{frozen[0]['failed']} of {frozen[0]['episodes']} episodes, the law {frozen[1]['failed']})" in readme
    transfer = json.loads(TRANSFER_FILE.read_text(encoding="utf-8"))
    record = transfer["remus100"]
    errors = record["policies"]
    agent, rival = (f"{errors[policy]['space_m']:.3g} m" for policy in ("helm-any", "ilos"))
    assert f"`helm-any` is level with `ilos`, and both errors are large: {agent} and {rival}" in readme
    assert {"helm-any", "ilos"} <= set(record["best"]["plane"]) & set(record["best"]["space"])
    otter = transfer["otter"]["policies"]["helm-any"]
    said = f"its error is {otter['space_m'] / otter['plane_m']:.1f} times that in the plane, {otter['space_m']:.3f} m"
    assert f"{said}, level with `nmpc`" in readme
    assert {"helm-any", "nmpc"} <= set(transfer["otter"]["best"]["space"])


def _failed_in(results, scenario, policy):
    """Return for each episode of a case whether a policy failed."""
    (run,) = (run for run in results.runs if (run.policy, run.scenario.name) == (policy, scenario))
    return has_failed(run.measures, error_cap(scenario))


def test_where_the_agents_are_behind(suites):
    """As docs/results.md says: dead reckoning in slow motion, and long outages of the position fix."""
    deep = [case for name, case in suites["deep-v1"].cases.items() if name.startswith("slow")]
    own, law = (np.mean([case[policy].steady_rmse.mean() for case in deep]) for policy in ("helm-any", "backstepping"))
    assert own > law
    faults = read_json(FAULTS_FILE)
    failed = {p: sum(faults[p][f"{r}-long-outages"]["failed"] for r in ("slow", "cruise")) for p in (AGENT, "nmpc")}
    assert failed["nmpc"] == 0
    assert failed[AGENT] > 40  # of 80


def test_helm_any_in_the_suite_that_was_secret(suites):
    """It is level with `nmpc` and behind `nmpc-adverse`, and fails with slow actuators."""
    opened = suites["sealed-v2"]
    for speed_range in ("slow", "cruise"):
        errors = {
            policy: {run.scenario.name: run.measures.steady_rmse for run in opened.runs_of(policy, speed_range)}
            for policy in ("backstepping", "nmpc", "nmpc-adverse", "helm-any", "clairvoyant")
        }
        zero, level, ahead, own, one = (list(each.values()) for each in errors.values())
        low, high = lead(zero, level, [cell[None] for cell in own], one).ci95
        assert low < 0 < high
        assert lead(zero, ahead, [cell[None] for cell in own], one).ci95[1] < 0
    names = [cell.scenario.name for cell in opened.suite.cells]
    others = [name for name in names if not name.endswith(("-slew", "-all-at-once"))]
    assert sum(_failed_in(opened, name, "helm-any").sum() for name in others) == 1


def test_numbers_of_the_table_by_hand(benchmark):
    """One row of a page, from the file and without the functions that make the page."""
    cells = [i for i, cell in enumerate(benchmark.suite.cells) if cell.scenario.name.startswith("cruise-")]
    folder = ROOT / "baselines/evaluation/data/recorded/benchmark-v1"
    raw = {p: np.load(folder / f"{p}.npz") for p in ("ekf", "backstepping")}
    own, expert = (raw[p]["measures"].reshape(9, 16, 260)[:, cells].reshape(9, -1) for p in ("ekf", "backstepping"))
    text = (ROOT / "docs/results/benchmark-v2.md").read_text(encoding="utf-8").split("## cruise")[1]
    rows = [line.strip("| ").split(" | ") for line in text.split("\n\n")[1].splitlines()]
    row = dict(zip(rows[0], next(row for row in rows if row[0] == "`ekf`"), strict=True))
    steady_rmse = own[1].astype(float)
    worst = np.sort(steady_rmse)[-104:].mean()
    shown = [float(row[name]) for name in ("error [mm]", "worst 5 % [mm]")]
    assert shown == pytest.approx([1e3 * steady_rmse.mean(), 1e3 * worst], rel=5e-3)
    ratios = [own[i].astype(float).mean() / expert[i].astype(float).mean() for i in (3, 4)]
    assert [float(row[name]) for name in ("effort", "command rate")] == pytest.approx(ratios, abs=6e-3)
    failed = int(((own[8] > 0) | (steady_rmse >= 2.0)).sum())
    assert row["failures"].startswith(f"{failed} of 2080 (<= ")
    scores = [float(line[rows[0].index("score")].split(" (")[0]) for line in rows[2:]]
    assert scores == sorted(scores, reverse=True)


def test_a_worse_oracle_is_detected(benchmark):
    runs = [
        replace(run, measures=replace(run.measures, steady_rmse=run.measures.steady_rmse + 1.0))
        if run.policy == "oracle"
        else run
        for run in benchmark.runs
        if run.policy in ("backstepping", "ekf", "oracle", "clairvoyant")
    ]
    bad = Results.of(benchmark.suite, runs)
    assert len({case for case, *_ in better_than("oracle", bad)}) == 16


def test_a_suite_without_the_oracle_is_refused(monkeypatch):
    whole = collection.recorded.load_recorded(collection.suites.load_suite("benchmark-v1"))
    few = replace(whole, runs=tuple(run for run in whole.runs if run.policy != "oracle"))
    monkeypatch.setattr(collection.recorded, "load_recorded", lambda _: few)
    with pytest.raises(collection.SuiteError, match="benchmark-v1 has no valid rows of oracle: oracle is not recorded"):
        results_of("benchmark-v1")


def test_the_summary_is_the_mean_of_the_rows():
    """One row of the page, from the file."""
    measures = np.load(found(recorded.RECORDED_FOLDER, "benchmark-v1/nmpc.npz"))["measures"]
    steady_rmses = measures[1].astype(float).reshape(2, -1)
    text = (ROOT / "docs" / "results.md").read_text(encoding="utf-8")
    cells = re.search(r"^\| `nmpc` \| (.*) \|$", text, re.MULTILINE)[1].split(" | ")
    assert [cell.split(" (")[0] for cell in cells[:2]] == [
        f"{1e3 * steady_rmse.mean():.3g}" for steady_rmse in steady_rmses
    ]


def test_pages_are_short_and_up_to_date(capsys):
    assert pages.main(["--check"]) == 0, "run `make pages`"
    for page in (page for page in pages.PAGES if page.startswith("results")):
        lines = (ROOT / "docs" / f"{page}.md").read_text(encoding="utf-8").splitlines()
        assert len(lines) <= 150, page
    assert "up to date" in capsys.readouterr().out


def test_a_stale_page_is_named_and_written(tmp_path, capsys):
    (tmp_path / "safety.md").write_text("old")
    assert pages.main(["safety", "--check", "--out", str(tmp_path)]) == 1
    assert capsys.readouterr().out == "stale: safety\n"
    assert pages.main(["safety", "--out", str(tmp_path)]) == 0
    assert pages.main(["safety", "--check", "--out", str(tmp_path)]) == 0


def test_the_sentences_of_the_summary_are_true():
    """The suites in which `helm` does not lead, and the errors of the table, which are above the lower bounds."""
    unmodelled, opened, vehicles = (results_of(name) for name in ("unmodelled-v1", "sealed-v2", "vehicles-v2"))

    def mean(results, policy, speed_range):
        return np.concatenate([m.steady_rmse for m in results.measures(policy, speed_range)]).mean()

    for speed_range in ("slow", "cruise"):
        assert mean(unmodelled, "nmpc-adverse", speed_range) < mean(unmodelled, "helm", speed_range)
    in_case = {(run.policy, run.scenario.name): run.measures.steady_rmse.mean() for run in opened.runs}
    assert in_case["nmpc", "slow-outages"] < in_case["helm", "slow-outages"]
    for speed_range in ("slow", "cruise"):
        assert in_case["nmpc-adverse", f"{speed_range}-slew"] < in_case["helm", f"{speed_range}-slew"]
    failed = {p: sum(e.failed for e in vehicles.pooled if e.policy == p) for p in ("helm-any", "nmpc")}
    assert failed["helm-any"] > failed["nmpc"]
    values = overview.context()
    rows = {row[0].strip("`"): [float(cell.split(" (")[0]) for cell in row[1:3]] for row in values["rows"]}
    for i, speed_range in enumerate(("slow", "cruise")):
        errors = [row[i] for row in rows.values()]
        assert min(errors) == rows["helm"][i]
        assert min(errors) > values["estimation"][speed_range] > values["optimum"][speed_range]

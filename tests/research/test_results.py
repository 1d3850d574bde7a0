"""The pages of results and the README agree with the recorded results."""

import re
from pathlib import Path

import numpy as np
import pytest

from auv_gym.scenarios.vehicles import vehicle_names
from baselines import list_policies
from baselines.evaluation.results import ResultFile
from baselines.evaluation.score import vehicle_of
from research import DATA, pages, study
from research.results import overview, suite_page, vehicles
from research.results.collection import CONTROLLERS, ROUNDING, results_of
from research.robustness import failure_rate

pytestmark = pytest.mark.slow  # all recorded results are read

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def benchmark():
    return results_of("benchmark-v3")


def test_every_policy_is_there(benchmark):
    assert benchmark.policies == list(list_policies())


def test_only_the_optimum_has_smaller_errors_than_the_oracle(benchmark):
    """But for some mm where a current is nearly as fast as the path."""
    assert {case for case, _, gain in benchmark.better_than("oracle") if gain > 3e-3} == set()
    assert max((gain for *_, gain in benchmark.better_than("clairvoyant")), default=0.0) < ROUNDING


def test_a_row_of_a_page_by_hand():
    """From the file, without the functions that make the page; no episode of the row has failed."""
    file, cell = ResultFile.read(ROOT / "baselines/evaluation/data/recorded/benchmark-v3.npz"), "cruise-waves"
    runs = {p: next(r.measures for r in file.of(p) if r.scenario.name == cell) for p in (*CONTROLLERS, "helm")}
    best = min(CONTROLLERS, key=lambda policy: runs[policy].steady_rmse.mean())
    text = (ROOT / "docs/results/benchmark-v3.md").read_text(encoding="utf-8")
    row = next(line.strip("| ").split(" | ") for line in text.splitlines() if line.startswith(f"| `{cell}` |"))
    theirs, mine = runs[best].steady_rmse.mean(), runs["helm"].steady_rmse.mean()
    assert row[1] == f"`{best}`"
    assert [float(number) for number in row[2:4]] == pytest.approx([1e3 * theirs, 1e3 * mine], rel=6e-3)
    assert float(row[4].split()[0]) == pytest.approx(mine / theirs, abs=6e-3)
    assert row[5] == "0, 0"
    rate = runs["helm"].smoothness.mean() / runs[best].smoothness.mean()
    assert float(row[6]) == pytest.approx(rate, abs=6e-3)


def test_the_readme_shows_the_summary():
    shown = re.findall(r"^\| (`\S+`) \| (.*) \|$", (ROOT / "README.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert [[name, *cells.split(" | ")] for name, cells in shown] == [row[:4] for row in overview.context()["rows"]]


def test_the_readme_has_the_results_in_space():
    text = " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())
    results = results_of("space-v1")
    rows = {row[0].strip("`"): row for row in suite_page.cell_rows(results)}
    ratio, failed = (suite_page.headline(results)[key] for key in ("ratio", "failed"))
    assert f"`helm-3d` has {ratio} times the error of the best controller" in text
    assert failed == "2 (best controllers: 0) of 1024"
    assert "fails in 2 of 1024 episodes" in text
    assert rows["space-storm"][1] == "`nmpc`"
    assert f"in storms it has {rows['space-storm'][4]} times the error of `nmpc`" in text
    assert [p for p in results.policies if p != "clairvoyant" and not results.errors(p)] == []


def test_the_table_by_vehicle_has_the_controller_of_the_smallest_error():
    results = results_of(vehicles.VEHICLES_SUITE)
    pairs = vehicles.pairs_of(results)

    def mean(policy, vehicle):
        """Return the geometric mean over the cells of a vehicle of the mean capped error."""
        cells = [(name, case) for name, case in results.cases.items() if vehicle_of(name) == vehicle]
        caps = [0.6 if name.startswith("slow") else 2.0 for name, _ in cells]
        errors = [np.minimum(case[policy].steady_rmse, cap).mean() for (_, case), cap in zip(cells, caps, strict=True)]
        return np.exp(np.log(errors).mean())

    rows = {row[0].strip("`"): row for row in vehicles.vehicle_rows(pairs, results)}
    assert list(rows) == vehicle_names()
    for vehicle, (_, best, ratio, *_) in rows.items():
        errors = {p: mean(p, vehicle) for p in ("nmpc", "nmpc-adverse", "ekf", "los-pid", "ilos", "lqi")}
        assert min(errors, key=errors.get) == best.strip("`")
        assert float(ratio.split()[0]) == pytest.approx(mean(vehicles.AGENT, vehicle) / min(errors.values()), rel=0.02)
    assert max((gain for *_, gain in results.better_than("clairvoyant")), default=0.0) < 1e-3


def test_pages_are_up_to_date():
    assert pages.main(["--check"]) == 0, "run `make pages`"


def test_a_stale_page_is_written_and_one_without_measurements_named(tmp_path, monkeypatch, capsys):
    words = ["sensitivity", "safety", "--out", str(tmp_path)]
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "model_error.json").write_bytes((DATA / "model_error.json").read_bytes())
    monkeypatch.setattr(study, "DATA", tmp_path / "data")
    assert pages.main([*words, "--check"]) == 1
    assert capsys.readouterr().out == "stale: sensitivity\n"
    assert pages.main(words) == 1
    assert "| m22, drag |" in (tmp_path / "sensitivity.md").read_text(encoding="utf-8")
    message = "page safety cannot be made: helm slow-calm is not measured: run python -m research failure-rate helm "
    assert message in capsys.readouterr().err
    assert pages.main(["sensitivity", "--check", "--out", str(tmp_path)]) == 0


def test_the_reference_policy_does_not_fail():
    """As docs/metrics.md says."""
    rows = [value for (policy, _), value in failure_rate.STUDY.values().items() if policy == "clairvoyant"]
    assert (sum(row["failed"] for row in rows), sum(row["episodes"] for row in rows)) == (0, 2_000)

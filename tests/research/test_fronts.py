"""Fronts of error against effort: gains that price commands, what is measured of them, who leads at equal effort."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from baselines import make_policy
from baselines.agents.names import agent_folder
from baselines.evaluation.rollout import rollout
from baselines.gains.loading import load_gains
from baselines.tools.command_line import DONE, UsageError
from baselines.tuning import command as tuning
from baselines.tuning.objective import Result
from baselines.tuning.search import TUNING_EPISODES
from baselines.tuning.tunables import TUNABLES
from research.results import front_files
from research.results import fronts as page
from research.results.collection import collected
from research.results.front_files import FRONT_SUITE, Front, Point, load_fronts, save_front
from research.results.study_files import load_studies
from research.trainings import front
from research.trainings.study import suite_cells
from research.trainings.trainings import SHIPPED_TRAININGS, request_of
from research.vehicles import priced


def test_every_priced_gain_has_the_same_budget_and_was_made_by_its_command():
    """The same prices for every controller that has any, and nothing by hand."""
    files = sorted(priced.PRICED_FOLDER.glob("*.json"))
    for file in files:
        record = json.loads(file.read_text(encoding="utf-8"))
        name, regime, price = record["policy"], record["regime"], record["price"]
        assert file == priced.priced_file(name, regime, price)
        assert price in priced.PRICES
        assert (record["evaluations"], record["episodes"]) == (priced.PRICED_EVALUATIONS, TUNING_EPISODES)
        options = f"--regime {regime} --price {price:g} --evaluations {priced.PRICED_EVALUATIONS}"
        assert record["command"] == f"auv-gym tune {name} {options}"
        assert record["start"] == pytest.approx(
            priced.priced_gains(name, regime, max(p for p in priced.prices_of(name, regime) if p < price))
        )
    assert {name for name in front.CONTROLLERS if not TUNABLES[name].sweep} == set()


def test_a_sweep_changes_the_weights_of_commands_alone():
    for name in front.CONTROLLERS:
        shipped, names = load_gains(name, "slow", TUNABLES[name].names), set(TUNABLES[name].sweep)
        swept = priced.swept_gains(name, "slow", 16.0)
        assert priced.swept_gains(name, "slow", 1.0) == shipped
        assert {key for key in shipped if swept[key] != shipped[key]} == names
        for key in names:
            assert swept[key] / shipped[key] == pytest.approx(0.5 if name == "ekf" else 16.0)


def test_tuning_with_a_price_begins_at_shipped_gains_or_those_of_a_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(tuning, "VALIDATION_EPISODES", 16)
    monkeypatch.setattr(tuning.TuningEpisodes, "run", lambda *_: Result(1.0, {}, 0.0, 1.0, 1.0))
    words = ["lqi", "--regime", "slow", "--evaluations", "0"]
    assert tuning.main([*words, "--price", "0.1"]) == DONE
    first = Path("runs/tune/lqi-slow-0.1.json")
    assert json.loads(first.read_text())["start"] == load_gains("lqi", "slow", TUNABLES["lqi"].names)
    first.write_text(json.dumps({"gains": dict.fromkeys(TUNABLES["lqi"].names, 2.0)}))
    assert tuning.main([*words, "--price", "0.3", "--start", str(first)]) == DONE
    assert set(json.loads(Path("runs/tune/lqi-slow-0.3.json").read_text())["start"].values()) == {2.0}
    first.write_text("[]")
    with pytest.raises(UsageError, match="holds no gains"):
        tuning.main([*words, "--price", "0.3", "--start", str(first)])


@pytest.fixture
def short(monkeypatch):
    """Let fronts run one short cell of two episodes."""
    cell = suite_cells(FRONT_SUITE, "slow")[-1]
    cell = replace(cell, scenario=replace(cell.scenario, steps=30), episodes=cell.episodes[:3])
    monkeypatch.setattr(front, "suite_cells", lambda *_: [cell])
    monkeypatch.setattr(priced, "PRICED_FOLDER", front_files.FRONTS_FOLDER / "none")
    return cell


def test_points_of_a_controller_are_what_its_gains_do(short, tmp_path):
    assert front.main(["lqi", "--regime", "slow", "--episodes", "2", "--out", str(tmp_path)]) == DONE
    (found,) = load_fronts(tmp_path)
    assert [point.label for point in found.points] == ["x 0.5", "x 1", "x 2", "x 4", "x 8"]
    assert [point.shipped for point in found.points] == [False, True, False, False, False]
    assert found.rows.effort[0] > found.rows.effort[-1]
    measures = rollout(make_policy("lqi"), short.scenario, short.episodes[:2]).measures
    np.testing.assert_allclose(found.rows.tails[0][1], measures.tail, rtol=1e-6)
    assert found.rows.effort[1] == pytest.approx(measures.effort.mean())
    assert found.rows.smoothness[1] == pytest.approx(measures.smoothness.mean())


def test_agents_are_trained_with_larger_weights_and_run(short, tmp_path, monkeypatch):
    trained = []

    def train(request):
        trained.append(request)
        shutil.copytree(agent_folder("apg-slow"), request.folders[0] / front.AGENT_FOLDER)
        return DONE

    monkeypatch.setattr(front, "train", train)
    words = ["apg-preview", "--regime", "slow", "--episodes", "2", "--timesteps", "1000"]
    assert front.main([*words, "--runs", str(tmp_path / "runs"), "--out", str(tmp_path / "out")]) == DONE
    (found,) = load_fronts(tmp_path / "out")
    assert [point.label for point in found.points] == ["shipped", *(f"{a:g}, {b:g}" for a, b in front.FRONT_WEIGHTS)]
    shipped = request_of(SHIPPED_TRAININGS["apg-preview-slow"], tmp_path / "other").configs[0]
    for request, (effort, rate) in zip(trained, front.FRONT_WEIGHTS, strict=True):
        (config,) = request.configs
        changes = {"effort_weight": effort, "rate_weight": rate}
        assert config.hyperparameters == {**shipped.hyperparameters, **changes}
        assert (config.scenarios, config.timesteps) == (shipped.scenarios, 1000)
    np.testing.assert_array_equal(found.rows.tails[0][1], found.rows.tails[0][2])
    assert not np.array_equal(found.rows.tails[0][0], found.rows.tails[0][1])


def test_weights_of_both_regimes_are_replaced():
    both = replace(SHIPPED_TRAININGS["apg-slow"], set=("effort_weight=0.1", "cruise_effort_weight=0.2", "n_envs=64"))
    words = front.priced_training(both, 0.5, 0.03, 1000).set
    assert words == ("effort_weight=0.5", "cruise_effort_weight=0.5", "n_envs=64", "rate_weight=0.03")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["oracle"], "'oracle' has no front; allowed are lqi, ekf, nmpc, apg, apg-adverse, apg-preview, apg-scratch"),
        (
            ["lqi", "--case", "slow-fog"],
            "unknown case 'slow-fog'; allowed are slow-calm",
        ),
        (["lqi", "--episodes", "0"], "--episodes is 0; it must be 1 or more"),
    ],
)
def test_what_has_no_front(words, message):
    with pytest.raises(UsageError) as error:
        front.main(words)
    assert str(error.value).startswith(message.partition(", apg-adverse")[0])


@pytest.fixture(scope="module")
def benchmark():
    return collected(FRONT_SUITE)[0]


def runs_of(results, policy, regime):
    return [r for r in results.runs if r.policy == policy and r.scenario.name.startswith(regime)]


@pytest.fixture(scope="module")
def three(benchmark):
    """A front of three policies that are recorded: one that is calm, one as busy as an agent, one that chatters."""
    points = [Point("x 2", ""), Point("x 1", "", shipped=True), Point("price 0.1", "")]
    names = ("nmpc-adverse", "nmpc", "lqi")
    return [Front.of("nmpc", r, points, [runs_of(benchmark, n, r) for n in names]) for r in ("slow", "cruise")]


def test_files_give_back_fronts(three, tmp_path):
    for each in three:
        save_front(each, tmp_path)
    back = load_fronts(tmp_path)
    assert [(f.name, f.regime, f.points) for f in back] == [(f.name, f.regime, f.points) for f in reversed(three)]
    np.testing.assert_allclose(back[0].rows.tails[3], three[1].rows.tails[3], rtol=1e-6)
    old = replace(three[0], rows=replace(three[0].rows, hash="0" * 64))
    save_front(old, tmp_path)
    assert [f.regime for f in load_fronts(tmp_path)] == ["cruise"]


def test_a_lead_at_equal_effort_is_over_all_that_spend_as_much(benchmark, three):
    text = page.fronts_section(three, benchmark, {})
    part = text.split("### At equal effort, slow")[1].split("### At equal effort, cruise")[0]
    rows = {cells[1]: cells for line in part.splitlines() if (cells := line.split(" | ")) and len(cells) == 9}
    rows = {
        line.split(" | ")[0].strip("| "): line.strip("| ").split(" | ")
        for line in part.splitlines()
        if "`nmpc`" in line
    }
    agent = np.concatenate([r.measures.tail for r in runs_of(benchmark, "apg-slow", "slow")])
    nmpc, adverse, lqi = (
        np.concatenate([np.minimum(r.measures.tail, 0.6) for r in runs_of(benchmark, n, "slow")])
        for n in ("nmpc", "nmpc-adverse", "lqi")
    )
    row = rows["`apg-slow`"]
    assert row[2:4] == ["no", "2 of 3"]  # all of them spend more; of these it leads two
    assert row[4] == f"{1e3 * np.mean(nmpc - agent):.2f}"
    assert np.mean(adverse - agent) > 0 < np.mean(lqi - agent)
    assert row[6:] == ["-", "-", "-"]
    busy = rows["`apg-preview-slow`"]
    assert busy[2:4] == ["yes", "1 of 1"]
    assert busy[6] == "1 of 2"
    assert float(busy[4]) > 9
    assert page.fronts_section([], benchmark, {}) == ""


def test_all_seeds_count_where_there_are_several(benchmark, three):
    studies = load_studies()
    who = page.spenders(three, benchmark, studies, "cruise")
    (agent,) = who.agents["apg-preview-cruise"]
    assert [tail.shape for tail in agent.tails] == [(5, 260)] * 8
    own = studies["apg-preview-cruise"].suites[FRONT_SUITE]
    assert agent.error == pytest.approx(np.mean(own.capped()))
    fewer = replace(three[0], rows=replace(three[0].rows, tails=tuple(t[:, :9] for t in three[0].rows.tails)))
    with pytest.raises(ValueError, match="measure them with the same number"):
        page.spenders([three[0], fewer], benchmark, studies, "slow")


def test_the_figure_has_every_point(benchmark, three):
    axes = page.figure(three, benchmark, {}).axes
    assert [ax.get_xlabel() for ax in axes] == ["effort, over the expert's", "rate, over the expert's"] * 2
    who = page.spenders(three, benchmark, {}, "slow")
    drawn = sorted({float(y) for line in axes[0].lines for y in np.atleast_1d(line.get_ydata())})
    everybody = [p for kind in (who.controllers, who.agents) for points in kind.values() for p in points]
    assert drawn == pytest.approx(sorted(1e3 * p.error for p in everybody))

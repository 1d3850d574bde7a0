"""The suite of published vehicles: complete and reproducible; scores without units; the optimum; the page."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from similar_vehicles import twin

from auv_gym import PRESETS
from auv_gym.envs.track_env import UnderactuatedAUVTrackEnv
from auv_gym.envs.track_vector_env import UnderactuatedAUVTrackVectorEnv
from auv_gym.physics.units import Units
from auv_gym.physics.vehicle import PAPER_VEHICLE
from auv_gym.scenarios.fitting import changed, in_vehicle_units
from auv_gym.scenarios.presets import CASES, as_scenario
from auv_gym.scenarios.vehicles import vehicle_model, vehicle_names
from auv_gym.task.observation import SIZE
from baselines import make_policy
from baselines.control.privileged.optimum import arriving, oracle_actions
from baselines.control.privileged.problem import Problem
from baselines.control.privileged.solver import TOLERANCE, WINDOWS, best_trajectory, optimised, receding_horizon
from baselines.evaluation import recorded, suites
from baselines.evaluation.metrics import Measures
from baselines.evaluation.options import Options
from baselines.evaluation.report.numbers import compare, pool
from baselines.evaluation.request import Request
from baselines.evaluation.rollout import rollout
from baselines.evaluation.runner import Cell, Recorded, Run, drawn, run_all
from baselines.evaluation.score import (
    BY_BOUND,
    cap_of,
    fixed_ends,
    in_paper_metres,
    relative_error,
    unit_of,
    vehicle_of,
)
from baselines.evaluation.suites import rounded
from baselines.scaling import shown_factors
from research.results import vehicles
from research.results.collection import Results, better_than
from research.suites.builder import BUILDERS, VEHICLE_EPISODES, _cell
from research.trainings.study_files import Study, load_studies

ROOT = Path(__file__).parents[2]
OTHER = Units(length=16.0, time=4.0, mass=4096.0)  # of a similar vehicle


@pytest.fixture(scope="module")
def suite():
    return suites.load_suite(vehicles.VEHICLES_SUITE)


def test_the_suite_has_eight_published_vehicles_in_every_case(suite):
    assert suite.hash == "92874480fcf14335e4403a37804e4ad68dfc42da43d71cfbbeeb5d581007011c"
    assert suite.anchors == BY_BOUND
    slow = [name for name in vehicle_names() if not vehicle_model(name).actuators.fin]
    names = [f"{r}-{c}@{v}" for r, own in (("cruise", vehicle_names()), ("slow", slow)) for v in own for c in CASES]
    assert [cell.scenario.name for cell in suite.cells] == names
    known = {cell.scenario.vehicle for cell in suite.cells}
    assert len(known) == 8
    assert PAPER_VEHICLE not in known
    for cell in suite.cells:
        assert len(cell.episodes) == VEHICLE_EPISODES[cell.scenario.name.split("-")[0]]
        assert cell.scenario == as_scenario(cell.scenario.name)
    assert sum(len(cell.episodes) for cell in suite.cells) == 1152


@pytest.mark.parametrize("index", [15, 39, 95])
def test_its_episodes_come_from_its_seed(suite, index):
    seed, recipes = BUILDERS[vehicles.VEHICLES_SUITE]
    recipe = replace(recipes()[index], episodes=4)
    assert rounded(_cell(recipe, seed, index)).episodes == suite.cells[index].episodes[:4]
    suites.check_cell(Cell(recipe.scenario, suite.cells[index].episodes[:4]), suite.digests[index][:4])


def measures(steady_rmse, failed=()):
    steady_rmse = np.array(steady_rmse, dtype=np.float64)
    ones, gone = np.ones(len(steady_rmse)), np.isin(np.arange(len(steady_rmse)), failed)
    return Measures(steady_rmse.copy(), steady_rmse, ones, ones, ones, ones, ones, ones, gone)


def runs_of(scenario, by_policy):
    return [Run(policy, scenario, "", measures(steady_rmse)) for policy, steady_rmse in by_policy.items()]


PAPER_CELL = PRESETS["cruise-storm"]
FAR_CELL = replace(changed(PAPER_CELL, twin(OTHER)), name="cruise-storm@twin")
STEADY_RMSES = {
    "backstepping": [1.0, 5.0, 0.5],
    "nmpc": [0.3, 0.1, 0.2],
    "ekf": [0.4, 0.3, 0.1],
    "clairvoyant": [0.0] * 3,
}


def test_a_similar_vehicle_scores_the_same():
    """Score, capped score and failures, with errors in proportion to the length of the vehicle."""
    assert (unit_of(PAPER_CELL), unit_of(FAR_CELL)) == (1.0, pytest.approx(16.0))
    assert cap_of(FAR_CELL) == pytest.approx(16 * cap_of(PAPER_CELL))
    far = {policy: [16 * x for x in steady_rmse] for policy, steady_rmse in STEADY_RMSES.items()}
    for mine, its in zip(compare(runs_of(PAPER_CELL, STEADY_RMSES)), compare(runs_of(FAR_CELL, far)), strict=True):
        for what in ("score", "capped"):
            assert getattr(its.entry, what).mean == pytest.approx(getattr(mine.entry, what).mean)
        assert its.entry.failed == mine.entry.failed
        assert its.entry.summary.steady_rmse_m.mean == pytest.approx(
            16 * mine.entry.summary.steady_rmse_m.mean
        )  # metres


def test_a_ship_does_not_dominate_pooled_results():
    far = {policy: [16 * x for x in steady_rmse] for policy, steady_rmse in STEADY_RMSES.items()}
    entries = pool([*runs_of(PAPER_CELL, STEADY_RMSES), *runs_of(FAR_CELL, far)])
    found = {(e.place, e.policy): e for e in entries}
    assert {place for place, _ in found} == {"cruise", "cruise@paper", "cruise@twin"}
    alone = {e.policy: e for e in pool(runs_of(PAPER_CELL, STEADY_RMSES))}
    for policy, steady_rmse in STEADY_RMSES.items():
        both = found["cruise", policy]
        assert both.capped.mean == pytest.approx(alone[policy].capped.mean)
        assert both.error_ratio == pytest.approx(alone[policy].error_ratio)
        assert both.failed == 2 * alone[policy].failed
        assert both.summary.steady_rmse_m.mean == pytest.approx(np.mean(steady_rmse))  # metres of the paper's vehicle
        assert found["cruise@twin", policy].summary.steady_rmse_m.mean == pytest.approx(16 * np.mean(steady_rmse))


def test_the_relative_error_is_a_geometric_mean_over_cells_without_units():
    rng = np.random.default_rng(1)
    rival, own = ([rng.uniform(0.5, 1.5, n) for n in (40, 40, 30)] for _ in range(2))
    expected = np.prod([a.mean() / b.mean() for a, b in zip(own, rival, strict=True)]) ** (1 / 3)
    found = relative_error(rival, own)
    assert found.mean == pytest.approx(expected)
    assert found.ci95[0] < expected < found.ci95[1]
    other = relative_error([42.0 * rival[0], *rival[1:]], [42.0 * own[0], *own[1:]])
    assert (other.mean, *other.ci95) == pytest.approx((found.mean, *found.ci95))
    seeds = relative_error(rival, [np.stack((0.9 * steady_rmse, 1.1 * steady_rmse)) for steady_rmse in own])
    assert seeds.mean == pytest.approx(expected)
    assert seeds.ci95[0] < found.ci95[0] < found.ci95[1] < seeds.ci95[1]
    twice = relative_error(rival, [2 * steady_rmse for steady_rmse in rival])  # paired episodes: no uncertainty
    assert (twice.mean, *twice.ci95) == pytest.approx((2.0, 2.0, 2.0))


def test_the_optimum_of_a_similar_vehicle_is_similar():
    short = [replace(s, steps=s.steps // 3) for s in (PAPER_CELL, FAR_CELL)]
    steady_rmses = [
        rollout(make_policy("clairvoyant"), s, drawn(s, 3, 100).episodes).measures.steady_rmse for s in short
    ]
    np.testing.assert_allclose(steady_rmses[1] / 16, steady_rmses[0], atol=2 * TOLERANCE)


@pytest.mark.slow
def test_with_active_limits_a_receding_horizon_gives_a_better_optimum_than_the_oracle():
    """A torpedo with lift and small fins in a storm: started at the commands of the oracle, the solver ends badly."""
    scenario = as_scenario("cruise-storm@remus100")
    episodes = drawn(scenario, 4, 5).episodes[3:]
    problem = Problem.of(scenario, episodes)
    guess = arriving(oracle_actions(scenario, episodes), problem.delay)
    alone = optimised(problem, problem.open_loop(guess))
    both = best_trajectory(problem, guess, [partial(receding_horizon, WINDOWS[0])])
    assert both.steady_rmse[0] < 0.5 * alone.steady_rmse[0]
    run = rollout(make_policy("backstepping", scenario.vehicle), scenario, episodes)
    assert both.steady_rmse[0] < in_paper_metres(run.measures, scenario).steady_rmse[0]


def test_a_factory_is_called_with_each_vehicle(suite, tmp_path):
    """A user's factory with the parameter `vehicle`, in a suite of several vehicles."""
    calls = tmp_path / "calls.txt"
    file = tmp_path / "mine.py"
    file.write_text(
        "from baselines import make_policy as known\n\n\ndef make(vehicle):\n"
        f"    with open({str(calls)!r}, 'a') as f:\n        print(vehicle.m11, file=f)\n"
        "    return known('los-pid', vehicle)\n"
    )
    name = f"{file}:make"
    request = Request.of(Options(policy=(name,), suite=vehicles.VEHICLES_SUITE, episodes=1, out=tmp_path))
    assert (name, "slow-storm@supply") in [(policy, cell.scenario.name) for policy, cell in request.pairs]
    calls.unlink()  # the request has made the policy once
    wanted = [cell for cell in suite.cells if cell.scenario.name in ("cruise-calm@otter", "cruise-calm@lauv")]
    cells = [Cell(replace(cell.scenario, steps=30), cell.episodes[:2]) for cell in wanted]
    mine, known = run_all((name,), cells), run_all(("los-pid",), cells)
    assert [float(line) for line in calls.read_text().split()] == [cell.scenario.vehicle.m11 for cell in cells]
    for a, b in zip(mine, known, strict=True):
        np.testing.assert_array_equal(a.measures.steady_rmse, b.measures.steady_rmse)


@pytest.mark.parametrize("name", vehicle_names())
def test_observations_scale_with_the_units_of_the_vehicle(name):
    """Also the preview, which has hundreds of metres for a ship; no term reaches its bound."""
    scenario, preview = as_scenario(f"cruise-calm@{name}"), (1, 40)
    seen = []
    for each in (scenario, in_vehicle_units(scenario)):
        vectors = UnderactuatedAUVTrackVectorEnv(2, [each, each], preview=preview)
        single = UnderactuatedAUVTrackEnv(each, preview=preview)
        rows, one = vectors.reset(seed=3)[0], single.reset(seed=3)[0]
        np.testing.assert_allclose(rows[0], one, rtol=1e-6, atol=1e-6)
        assert vectors.single_observation_space.contains(rows[0])
        seen.append(rows.astype(float))
    units = Units.of(scenario.vehicle)
    factors = shown_factors(units) + [1 / units.length] * 2 * len(preview)
    np.testing.assert_allclose(seen[0] * factors, seen[1], rtol=1e-5, atol=1e-5)
    assert np.abs(seen[0][:, SIZE:]).max() > 0.9 * 40 * scenario.control_dt * scenario.path.speed[0]


def test_the_page_agrees_with_its_rows(suite):
    """Artificial rows: half the rival's errors on every vehicle, then one error below the optimum."""
    rng, runs, when = np.random.default_rng(0), [], Recorded("2026-01-01", {"auv_gym": "0"})
    for cell in suite.cells:
        base = rng.uniform(0.01, 0.02, len(cell.episodes)) * unit_of(cell.scenario)
        factors = {"backstepping": 9.0, "nmpc": 1.0, "ekf": 0.5, "clairvoyant": 0.1}
        runs += [
            Run(policy, cell.scenario, cell.hash, measures(f * base), recorded=when) for policy, f in factors.items()
        ]
    results = Results.of(suite, runs)
    pairs = vehicles.pairs_of(results)
    assert list(pairs) == ["clairvoyant", "ekf", "nmpc", "backstepping"]
    for speed_range, episodes in (("", 1152), ("cruise", 1024), ("slow", 128)):
        pair = vehicles.pairs_of(results, speed_range)["ekf"]
        assert (pair.error.mean, pair.failed, pair.episodes) == (pytest.approx(0.5), 0, episodes)
    studies = {}
    for speed_range in ("cruise", "slow"):
        own = [run for run in runs if run.policy == "ekf" and run.scenario.name.startswith(speed_range)]
        studies[f"any-{speed_range}"] = Study.of(speed_range, "", {vehicles.VEHICLES_SUITE: [own, own]})
    half = "0.50 (0.50 ... 0.50)"
    (row,) = vehicles.seed_rows(pairs["nmpc"].own, studies)
    assert row == ["`any`", "2", half, half, "0 of 2304 (<= 0.13 %)"]
    assert vehicles.seed_rows(pairs["nmpc"].own, {"any-cruise": studies["any-cruise"]}) == []
    assert vehicles.better_than_optimum(results) == []
    first = next(i for i, run in enumerate(runs) if run.policy == "ekf")
    better = runs[first].measures.steady_rmse.copy()
    better[3] = 1e-5 * unit_of(runs[first].scenario)
    runs[first] = replace(runs[first], measures=measures(better))
    ((name, episode, policy, _),) = vehicles.better_than_optimum(Results.of(suite, runs))
    assert (name, episode, policy) == (suite.cells[0].scenario.name, 3, "ekf")


def test_failures_in_which_another_controller_succeeds():
    """Errors of three episodes; the error cap is 2 m."""
    errors = {"helm-any": (3, 3, 1), "nmpc": (3, 1, 1), "ekf": (3, 3, 3), "clairvoyant": (0, 0, 0)}
    pairs = {
        p: vehicles.Pair({"cruise-storm@otter": measures(np.array(own, dtype=float))}, {}) for p, own in errors.items()
    }
    assert [vehicles.avoidable_failures(pairs, policy) for policy in ("helm-any", "nmpc", "ekf")] == [1, 0, 2]


def test_no_recorded_policy_is_better_than_the_optimum(suite):
    found = recorded.load_recorded(suite)
    assert found.refused == {}
    if {"backstepping", "clairvoyant"} <= {run.policy for run in found.runs}:
        results = Results.of(suite, found.runs)
        assert [gain for *_, gain in better_than("clairvoyant", results) if gain > 1e-4] == []
        assert [gain for *_, gain in vehicles.better_than_optimum(results) if gain > 5e-3] == []


def test_the_readme_says_how_the_agent_for_every_vehicle_compares(suite):
    """Its error ratio over all cells, and the vehicles with fins on which it fails more often."""
    pairs = vehicles.pairs_of(Results.of(suite, recorded.load_recorded(suite).runs))
    error = pairs["helm-any"].error
    readme = " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())
    assert (
        f"`helm-any` has {error.mean:.2f} ({fixed_ends(error.ci95, 2)}) times the error of `nmpc`, but it fails more "
        "often on one of the four vehicles with fins"
    ) in readme
    rows = {row[0].strip("`"): row[1:3] for row in vehicles.seed_rows(pairs["nmpc"].own, load_studies())}
    assert {seeds for seeds, _ in rows.values()} == {"3"}
    (_, first), (_, second) = rows["helm-any-first"], rows["helm-any"]
    assert f"Three other seeds of its second training have {second}." in readme
    page = " ".join((ROOT / "docs" / "fine-tuning.md").read_text(encoding="utf-8").split())
    assert f"Three seeds have {first.split()[0]} times the errors of `nmpc`" in page
    assert f"have a ratio of {second.split()[0]}; that of the shipped agent is {error.mean:.2f}." in page
    finned = [name for name in vehicle_names() if vehicle_model(name).actuators.fin]
    own, rival = (
        [pairs[policy].among(lambda cell, name=name: vehicle_of(cell) == name).failed for name in finned]
        for policy in ("helm-any", "nmpc")
    )
    assert (len(finned), sum(a > b for a, b in zip(own, rival, strict=True))) == (4, 1)


def test_the_table_by_vehicle_has_the_controller_of_the_smallest_error():
    results = vehicles.results_of(vehicles.VEHICLES_SUITE)
    rows = {row[0].strip("`"): row for row in vehicles.vehicle_rows(vehicles.pairs_of(results), results)}
    assert list(rows) == vehicle_names()

    def mean(policy, vehicle):
        """Return the geometric mean over the cells of a vehicle of the mean capped error."""
        cells = [(name, case) for name, case in results.cases.items() if vehicle_of(name) == vehicle]
        caps = [0.6 if name.startswith("slow") else 2.0 for name, _ in cells]
        errors = [np.minimum(case[policy].steady_rmse, cap).mean() for (_, case), cap in zip(cells, caps, strict=True)]
        return np.exp(np.log(errors).mean())

    for vehicle, (_, best, ratio, *_) in rows.items():
        errors = {p: mean(p, vehicle) for p in ("nmpc", "nmpc-adverse", "ekf", "los-pid", "ilos", "lqi", "smc-dob")}
        assert min(errors, key=errors.get) == best.strip("`")
        assert float(ratio.split()[0]) == pytest.approx(mean(vehicles.AGENT, vehicle) / min(errors.values()), rel=0.02)

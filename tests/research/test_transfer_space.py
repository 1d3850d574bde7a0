"""The REMUS 100 in six degrees of freedom on paths in space, against the vehicle with five."""

import math
from dataclasses import replace

import numpy as np
import pytest

from auv_gym.physics.space import State, rk4_step, state_rates
from auv_gym.planning.paths import Circle, Line
from auv_gym.planning.paths.space import Climb, Steps, WithHeight
from auv_gym.scenarios.presets import as_scenario
from auv_gym.scenarios.scenario import Start
from auv_gym.task.space import SPACE
from baselines import make_policy
from baselines.evaluation.cells import drawn
from baselines.evaluation.plants import input_names, moved_by
from baselines.evaluation.rollout import rollout
from research.transfer import comparison
from research.transfer.simulators import IN_SPACE, SixDofSimulator

SPEED = 1.5  # [m/s]
CALM, STORM = (as_scenario(f"space-{case}@remus100") for case in ("calm", "storm"))


PATHS = (  # helices of 30 m, 6 deg and 50 m, 12 deg, and a dive of 10 deg that levels out
    WithHeight(Circle(SPEED, -SPEED / 30), Climb(-SPEED * math.tan(math.radians(6))), -20.0),
    WithHeight(Circle(SPEED, -SPEED / 50), Climb(-SPEED * math.tan(math.radians(12))), -20.0),
    WithHeight(Line(SPEED), Steps([(30.0, -12 * SPEED * math.tan(math.radians(10)))], 6.0), -20.0),
)


def simulator():
    return SixDofSimulator("remus100", 1, IN_SPACE)


def inputs(**values):
    return np.array([[values.get(name, 0.0)] for name in input_names(SPACE)])


@pytest.mark.parametrize(
    ("policy", "errors"), [("backstepping-normalised", (0.073, 0.048, 0.023)), ("backstepping", (0.008, 0.005, 0.003))]
)
def test_the_law_follows_a_helix_and_a_dive(policy, errors):
    """The errors are those of another implementation of the plan, the law and the axes."""
    for path, error in zip(PATHS, errors, strict=True):
        vertical = replace(CALM.vertical, z_e=0.0, theta_e=0.0)
        scenario = replace(CALM, path=path, start=Start(surge=1.0), vertical=vertical, control_dt=0.1, steps=1200)
        law, episodes, vehicle = make_policy(policy, scenario.known), drawn(scenario, 1, 0).episodes, simulator()
        made = moved_by(lambda _, vehicle=vehicle: vehicle)
        result = rollout(law, scenario, episodes, simulator=made)
        assert result.measures.steady_rmse[0] == pytest.approx(error, rel=0.08, abs=5e-4)
        assert 0.2 < math.degrees(abs(vehicle.rows[3, 0])) < 1.0  # the roll of the propeller's torque


def test_a_rolled_vehicle_is_seen_with_the_kinematics_of_five_degrees_of_freedom():
    rng, vehicle, h = np.random.default_rng(0), simulator(), 1e-4
    for _ in range(10):
        vehicle.place([0], rng.normal(size=(10, 1)) * 0.4)
        vehicle.rows[[3, 9]] += rng.normal(size=(2, 1)) * 0.3
        current = rng.normal(size=3)
        flow = inputs(**dict(zip(("V_x", "V_y", "V_z"), current, strict=True)))
        before, now, after = (vehicle.advance(flow, h)[0][:, 0] for _ in range(3))
        wanted = state_rates(now, (0.0,) * 5, CALM.known.acting, tuple(current))
        np.testing.assert_allclose((after - before)[:5] / (2 * h), wanted[:5], atol=1e-5)


def test_drawn_vehicles_accelerate_alike_in_the_vertical_plane():
    """Masses, drag, lift, restoring moment and loads; five degrees of freedom leave out the mass below the axis."""
    at, no_load = State._fields.index, (0.0,) * 5
    for true in (episode.vehicle for episode in drawn(STORM, 8, 0).episodes):
        for name, value, load in (
            ("theta", 0.5, no_load), ("w", 0.1, no_load), ("q", 0.6, no_load),
            ("x", 0.0, (2.0, 0.0, 6.0, 4.0, 0.0)),
        ):  # fmt: skip
            start, vehicle = np.zeros(10), simulator()
            start[[at("u"), at(name)]] = 0.5, value
            vehicle.place([0], start[:, None], true.coefficients)
            six = vehicle.advance(inputs(**dict(zip(SPACE.load, load, strict=True))), 0.05)[0][:, 0]
            five = rk4_step(start, SPACE.from_outside(load, true.acting), true.acting, 0.05)
            own, known = six - start, np.array(five) - start
            own[7], known[7] = (change[7] + true.horizontal.eps * change[8] for change in (own, known))  # of the origin
            for part, least in (("u", 2e-3), ("v", 1e-5), ("w", 5e-5), ("q", 1e-3), ("r", 1e-5)):
                assert own[at(part)] == pytest.approx(known[at(part)], rel=0.05, abs=least)


def test_the_lag_of_the_propeller_is_why_errors_of_prediction_grow():
    """With a lag of 1 s the vehicle with five degrees of freedom has the errors of the one with six."""
    policy, found = make_policy("nmpc", CALM.known), []
    for lag, made in ((0.0, None), (1.0, None), (0.0, moved_by(lambda n: SixDofSimulator("remus100", n, IN_SPACE)))):
        scenario = replace(CALM, actuators=replace(CALM.actuators, lag=lag))
        episodes = drawn(scenario, 8, 5).episodes
        found.append(np.median(rollout(policy, scenario, episodes, simulator=made).measures.steady_rmse))
    five, lagging, six = found
    assert five < 0.1 * six
    assert lagging == pytest.approx(six, rel=0.3)


def test_the_sentences_about_space_are_true():
    record = comparison.space_summary("remus100")
    predicting = {"ekf", "nmpc"}
    for name, row in record["policies"].items():
        calm, _, waves, _ = row["median_growth_by_case"]
        assert (calm > 3, waves > 3) == (name in predicting,) * 2
        assert name == "ekf" or row["growth"] == pytest.approx(1.0, abs=0.15 if name == "helm-3d" else 0.06)
        assert row["roll_deg"][1] < 2.1
    quick = record["quick"]
    assert all(row["growth"] == pytest.approx(1.0, abs=0.1) for row in quick["policies"].values())
    assert quick["tau"] > 0.8
    values, cap = comparison.STUDY.values(), comparison.cap_of(CALM)
    cases = [case for row in values if "space" in row and "ekf" not in row for case in values[row].values()]
    ends = np.array([[case[place]["steady_rmse"] for place in ("5-DOF", "6-DOF")] for case in cases]) > 0.999 * cap
    assert ends.all(axis=1).sum() > 0.85 * ends.any(axis=1).sum()

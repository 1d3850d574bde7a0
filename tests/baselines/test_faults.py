"""The filter in waves, with outages and with faults: estimates against true values, and errors of its policies."""

from dataclasses import replace

import numpy as np
import pytest

import baselines
from auv_gym.envs.track_vector_env import UnderactuatedAUVTrackVectorEnv
from auv_gym.physics.actuators import LONGEST_DELAY, Actuators
from auv_gym.physics.namespaces import ARRAYS
from auv_gym.physics.vehicle import PAPER_VEHICLE
from auv_gym.planning.paths import Circle
from auv_gym.scenarios.mixtures import adverse
from auv_gym.scenarios.presets import PRESETS
from auv_gym.scenarios.scenario import Start
from baselines.control.nmpc.controller import ENDS, delayed_targets
from baselines.estimation.faults import FAULTS, NO_FAULTS, Faults, acting_forces, after_delay
from baselines.estimation.filter_equations import Belief
from baselines.estimation.kalman import ODDS
from baselines.estimation.sea_model import STATE_SIZE, Estimate
from baselines.evaluation.rollout import rollout
from baselines.evaluation.runner import drawn

ACTIONS = [(0.1, -0.1), (0.2, -0.3), (0.4, 0.5), (0.8, 0.7)]


@pytest.mark.parametrize("delay", range(LONGEST_DELAY + 1))
def test_with_a_whole_delay_one_action_acts(delay):
    faults = NO_FAULTS._replace(surge_share=0.5, yaw_share=0.8, delay=float(delay))
    a_u, a_r = ACTIONS[delay]
    assert acting_forces(faults, ACTIONS, (400.0, 200.0), ARRAYS) == pytest.approx((0.5 * 400 * a_u, 0.8 * 200 * a_r))


def test_with_half_a_period_the_mean_of_two_actions_acts():
    F_u, _ = acting_forces(NO_FAULTS._replace(delay=1.5), ACTIONS, (400.0, 200.0), ARRAYS)
    assert F_u == pytest.approx(400 * 0.5 * (0.2 + 0.4))


@pytest.mark.parametrize("delay", range(LONGEST_DELAY + 1))
def test_the_state_after_the_delay_is_that_of_the_simulation(delay):
    """Three commands that do not act yet, then zero commands."""
    weak = Actuators(lag=0.3, effectiveness=0.7, delay=delay)
    scenario = replace(PRESETS["cruise-calm"], path=Circle(1.0, 0.1), actuators=weak, start=Start(), steps=50)
    env = UnderactuatedAUVTrackVectorEnv(1, scenario)
    env.reset(seed=0)
    for a_u, a_r in reversed(ACTIONS[:3]):
        env.step(np.array([[a_u, a_r]]))
    plant, reference = env.state[0], np.ravel(env.reference[:2])
    z = Estimate(*np.zeros(STATE_SIZE))._replace(
        x_e=plant[0] - reference[0], y_e=plant[1] - reference[1], psi=plant[2], u=plant[3], v=plant[4], r=plant[5],
        F_u=env.force[0, 0], F_r=env.force[0, 1], lag=0.3,
    )  # fmt: skip
    faults = Faults(0.0, 0.0, 0.0, 0.0, 0.7, 0.7, float(delay))
    limits, c = (weak.F_u_max, weak.F_r_max), PAPER_VEHICLE.coefficients
    found = after_delay(z, faults, ACTIONS[:3], limits, 0.1, c, ARRAYS)
    for _ in range(delay):
        env.step(np.zeros((1, 2)))
    x, y, psi, u, v, r = env.state[0]
    expected = (x - reference[0], y - reference[1], psi, u, v, r)
    assert found[:6] == pytest.approx(expected, abs=5e-3)  # without delay a thousandth of a period is integrated
    assert found[6:8] == pytest.approx(env.force[0], abs=0.05)


@pytest.mark.parametrize("delay", [0.0, 1.0, 2.5, 3.0])
def test_delayed_targets_are_on_the_path(delay):
    dt, speed, turn_rate = 0.1, 1.0, 0.12

    def position(periods):
        angle = turn_rate * dt * np.asarray(periods, dtype=float)
        return speed / turn_rate * np.array((np.sin(angle), 1 - np.cos(angle)))

    target = position(ENDS).T[:, :, None]
    expected = position(np.array(ENDS) + delay).T
    np.testing.assert_allclose(delayed_targets(target, np.array([delay]))[:, :, 0], expected, atol=2e-3)


def filtered(name, scenario, n, steps):
    """Return the last memory of a policy and the last result of its filter, for n vehicles."""
    policy = baselines.make_policy(name)
    env = UnderactuatedAUVTrackVectorEnv(n, scenario, preview=policy.preview)
    observation, _ = env.reset(seed=0)
    controller = policy.controller.slow if scenario.name.startswith("slow") else policy.controller.cruise
    update, result, memory = controller.filter.update, [], None

    def recorded(memory, o):
        after, z = update(memory, o)
        result[:] = [z]
        return after, z

    controller.filter.update = recorded
    for _ in range(steps):
        action, memory = policy.predict(observation, memory)
        observation, *_ = env.step(action)
    return memory, result[0]


@pytest.mark.parametrize("speed_range", ["slow", "cruise"])
def test_the_filter_distinguishes_calm_from_rough_water(speed_range):
    for case, calm in (("noise", True), ("storm", False)):
        memory, _ = filtered("ekf", PRESETS[f"{speed_range}-{case}"], 8, 300)
        rough_fit, calm_fit = (Belief.of(rows.T).fit[0] for rows in memory[:2])
        assert ((calm_fit > rough_fit + ODDS) == calm).all()


def test_the_filter_estimates_biases_losses_and_delays():
    """In storms, heading bias to one degree, delay to a fraction of a period."""
    world = adverse("cruise")
    steady = replace(
        world.sensors,
        heading_bias=0.05,
        velocity_bias=-0.05,
        yaw_rate_bias=0.005,
        outages=0.0,
    )
    weak = replace(world.actuators, effectiveness=0.7, reach=1.0, delay=2.0)
    _, z = filtered("ekf-adverse", replace(world, sensors=steady, actuators=weak), 16, 550)
    faults = Faults(*z[STATE_SIZE : STATE_SIZE + FAULTS])
    assert faults.heading.mean() == pytest.approx(0.05, abs=0.015)
    assert faults.surge.mean() == pytest.approx(-0.05, abs=0.01)
    assert faults.sway.mean() == pytest.approx(-0.05, abs=0.01)
    assert faults.turn.mean() == pytest.approx(0.005, abs=0.001)
    assert faults.delay.mean() == pytest.approx(2.0, abs=0.3)
    assert 0.5 < faults.yaw_share.mean() < 0.85


def test_a_position_without_a_new_fix_is_not_used():
    """Without fixes for five seconds the measured position is constant; the filter integrates the velocities."""
    noisy = PRESETS["cruise-noise"]
    scenario = replace(noisy, sensors=replace(noisy.sensors, outages=0.01))
    episodes = [replace(e, outages=((20.0, 25.0),)) for e in drawn(scenario, 8, 0).episodes]
    policy = baselines.make_policy("ekf")
    env = UnderactuatedAUVTrackVectorEnv(8, scenario)
    observation, _ = env.reset(seed=0, options={"episode": episodes})
    memory = None
    for _ in range(248):
        action, memory = policy.predict(observation, memory)
        observation, *_ = env.step(action)
    _, memory = policy.predict(observation, memory)
    rough, _ = (Belief.of(rows.T) for rows in memory[:2])
    true = env.state[:, :2] - np.stack((env.reference.x, env.reference.y), axis=1)
    assert np.hypot(*(rough.fix.T - true).T).min() > 1.0
    assert np.hypot(*(rough.state[:2].T - true).T).max() < 0.3


def test_a_distant_start_with_any_heading_converges():
    anywhere = Start(x_e=(-5.0, 5.0), y_e=(-5.0, 5.0), psi_e=(-3.1, 3.1), surge=(0.3, 1.0))
    for case in ("calm", "storm"):
        scenario = replace(PRESETS[f"slow-{case}"], start=anywhere)
        run = rollout(baselines.make_policy("ekf"), scenario, drawn(scenario, 40, 0).episodes)
        assert run.measures.steady_rmse.max() < 0.2


@pytest.mark.slow
def test_estimated_faults_lower_the_error():
    world = adverse("slow")
    late = replace(world, actuators=replace(world.actuators, delay=3.0, reach=1.0))
    episodes = drawn(late, 6, 0).episodes
    steady_rmses = {name: rollout(baselines.make_policy(name), late, episodes).measures.steady_rmse.mean()
             for name in ("ekf", "ekf-adverse", "nmpc", "nmpc-adverse")}  # fmt: skip
    assert steady_rmses["ekf-adverse"] < 0.5 * steady_rmses["ekf"]
    assert steady_rmses["nmpc-adverse"] < 0.5 * steady_rmses["nmpc"]

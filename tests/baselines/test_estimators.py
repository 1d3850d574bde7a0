"""The filter against true disturbances, faults and statistics; the plan in the water frame against the planner."""

from dataclasses import replace

import numpy as np
import pytest

from auv_gym.codegen.matrices import symmetric
from auv_gym.effects.actuators import LONGEST_DELAY, Actuators
from auv_gym.effects.current import RandomCurrent
from auv_gym.effects.sensors import NOISES
from auv_gym.effects.waves import RandomWaves, Waves
from auv_gym.envs.track_vector_env import UnderactuatedAUVTrackVectorEnv
from auv_gym.physics.errors import to_body
from auv_gym.physics.namespaces import ARRAYS, wrap_angle
from auv_gym.physics.vehicle import PAPER_VEHICLE
from auv_gym.planning.paths import Circle, FigureEight, Sine
from auv_gym.planning.planner import plan
from auv_gym.planning.reserves import ThroughWater
from auv_gym.scenarios.mixtures import adverse
from auv_gym.scenarios.presets import CASES, PRESETS, TYPICAL_NOISE
from auv_gym.scenarios.scenario import RandomPath, Scenario, Start
from auv_gym.task.observation import Observation
from baselines import make_policy
from baselines.control.backstepping import Gains, tracking_forces
from baselines.control.ekf_law import EKF_GAINS
from baselines.control.nmpc.controller import ENDS, delayed_targets
from baselines.estimation.faults import FAULTS, NO_FAULTS, Faults, acting_forces, after_delay
from baselines.estimation.filter_equations import Belief
from baselines.estimation.kalman import HYPOTHESES, ODDS
from baselines.estimation.sea_model import STATE_SIZE, Estimate
from baselines.estimation.water_frame import (
    PlannedReference,
    ReferenceMotion,
    Sea,
    plan_in_water,
    reference_motion,
    water_errors,
)
from baselines.evaluation.cells import drawn
from baselines.evaluation.rollout import rollout
from baselines.gains.loading import load_gains
from baselines.policy import Remembering


def at_typical_noise(scenario):
    """Return the scenario with the typical level of each noise that it has."""
    typical, own = TYPICAL_NOISE[scenario.name.partition("-")[0]], scenario.sensors
    return replace(scenario, sensors=replace(own, **{n: getattr(typical, n) for n in NOISES if getattr(own, n)}))


def every_preset(count):
    """Return an environment with `count` vehicles in each preset with typical noise, whose episodes do not end."""
    names = [f"{speed_range}-{case}" for speed_range in ("slow", "cruise") for case in CASES for _ in range(count)]
    scenarios = [replace(at_typical_noise(PRESETS[name]), steps=601, lost_distance=64.0) for name in names]
    return UnderactuatedAUVTrackVectorEnv(len(names), scenarios), np.array(names)


def covariances(belief):
    """Return the covariances of the states, shape (N, 22, 22)."""
    return np.array(symmetric(list(belief.covariance))).transpose(2, 0, 1)


def likelier(memory):
    """Return for each vehicle the memory of the filter with the higher likelihood, with covariances (N, 22, 22)."""
    rough, calm = (Belief.of(rows.T) for rows in memory[:HYPOTHESES])
    better = calm.fit[0] > rough.fit[0] + ODDS
    chosen = Belief(*(np.where(better, b, a) if np.size(a) else a for a, b in zip(rough, calm, strict=True)))
    return chosen._replace(covariance=covariances(chosen))


def test_filter_over_long_runs():
    """The covariance stays positive definite, and it agrees with the errors in scenarios with noisy sensors."""
    env, names = every_preset(4)
    policy, memory = make_policy("ekf"), None
    observation, _ = env.reset(seed=20_000_000)
    first, distances, least = np.ones(len(names), dtype=bool), [], np.inf
    for k in range(600):
        action, memory = policy.predict(observation, memory, first)
        if k >= 200 and k % 5 == 0:
            _, z, P, *_ = likelier(memory)
            position = position_errors(env) - z[:2].T
            heading = wrap_angle(env.state[:, 2:3] - z[2][:, None], ARRAYS)
            error = np.concatenate((position, heading), axis=1)
            distances.append(np.einsum("ni,ni->n", error, np.linalg.solve(P[:, :3, :3], error[..., None])[..., 0]))
        observation, *_ = env.step(action)
        first = np.zeros_like(first)
        if k % 25 == 0:
            for P in (covariances(Belief.of(rows.T)) for rows in memory[:HYPOTHESES]):
                deviation = np.sqrt(np.einsum("nii->ni", P))
                least = min(least, np.linalg.eigvalsh(P / deviation[:, :, None] / deviation[:, None, :]).min())
    assert least > 1e-12
    mean = np.mean(distances, axis=0)
    assert 2 < mean[names == "cruise-noise"].mean() < 4
    assert 2 < mean[names == "cruise-storm"].mean() < 4.5
    noise = np.sqrt(likelier(memory).noise.T)
    assert noise[names == "cruise-noise"].mean(axis=0) == pytest.approx([0.05, 0.05, 0.015, 0.02, 0.02, 0.005], rel=0.2)
    assert noise[names == "slow-storm"].mean(axis=0)[:3] == pytest.approx([0.03, 0.03, 0.015], rel=0.2)
    assert (noise[names == "cruise-calm"] < 0.002).all()


TURNING = RandomPath(speed=(0.6, 1.2), turn_rate=0.12, families=("circle", "sine", "figure_eight"))
CURRENT = replace(PRESETS["cruise-current"], path=TURNING)


def filtered(policy, scenario, n, steps, episodes=None, varied=0.0):
    """Return memory, estimates and environment after `steps` control periods with random changes of the commands."""
    env = UnderactuatedAUVTrackVectorEnv(n, scenario, preview=policy.preview)
    observation, _ = env.reset(seed=0, options={"episode": episodes} if episodes else None)
    controller = getattr(policy.controller, scenario.name.partition("-")[0], policy.controller)  # by its speed range
    update, result, memory, rng = controller.filter.update, [], None, np.random.default_rng(0)

    def recorded(memory, o):
        after, z = update(memory, o)
        result[:] = [z]
        return after, z

    controller.filter.update = recorded
    for _ in range(steps):
        action, memory = policy.predict(observation, memory)
        observation, *_ = env.step(np.clip(action + rng.normal(0, varied, (n, 2)), -1, 1))
    _, memory = policy.predict(observation, memory)
    return memory, result[0], env


def position_errors(env):
    """Return the true position errors in the world, shape (N, 2)."""
    return env.state[:, :2] - np.stack((env.reference.x, env.reference.y), axis=1)


def test_filter_estimates_the_current_with_noisy_sensors():
    """On a turning path current and load are both observable, if the model's load is almost constant."""
    calm = dict.fromkeys(("surge_bias", "sway_bias", "yaw_bias", "surge_waves", "sway_waves", "yaw_waves"), 0.01)
    gains = {**load_gains("ekf", "cruise", EKF_GAINS), "current": 0.01, "gust": 0.001, **calm}
    turning = RandomPath(speed=(0.6, 1.2), turn_rate=0.12, families=("circle", "sine", "figure_eight"))
    scenario = replace(PRESETS["cruise-current"], path=turning, sensors=TYPICAL_NOISE["cruise"])
    memory, _, env = filtered(make_policy("ekf", gains=gains), scenario, 24, 500)
    z = Estimate(*likelier(memory).state)
    error = np.hypot(z.V_x - env.current[:, 0], z.V_y - env.current[:, 1])
    assert np.hypot(*env.current.T).mean() > 0.2
    assert error.mean() < 0.06
    assert np.hypot(*(np.array((z.x_e, z.y_e)) - position_errors(env).T)).mean() < 0.03
    assert abs(wrap_angle(z.psi - env.state[:, 2], ARRAYS)).mean() < 0.01


def test_filter_estimates_lag_and_load():
    """Actuators with different lags and a constant load, without measurement noise, under varying commands."""
    lags, load = np.array([0.15, 0.3, 0.6]), (15.0, 0.0, -6.0)
    steady = Waves(*(x / np.sqrt(2) for x in load), (0.0,), ((np.pi / 2,),) * 3)  # the crest of a sine that stands
    scenario = replace(PRESETS["cruise-calm"], path=Circle(1.0, 0.15), waves=RandomWaves(), start=Start(), steps=700)
    (episode,) = drawn(scenario, 1, 0).episodes
    episodes = [replace(episode, lag=lag, waves=steady) for lag in lags]
    _, z, env = filtered(make_policy("ekf"), scenario, 3, 600, episodes, varied=0.1)
    z = Estimate(*z[:STATE_SIZE])
    np.testing.assert_allclose(z.lag, lags, rtol=0.1)
    np.testing.assert_allclose(z.F_u, env.force[:, 0], atol=3.0)
    np.testing.assert_allclose(z.X + z.X_wave, load[0], atol=4.0)
    np.testing.assert_allclose(z.N + z.N_wave, load[2], atol=2.0)


AT_FIRST = PlannedReference(*np.zeros((len(PlannedReference._fields), 1)))


def in_water(memory, motion, sea, dt):
    return plan_in_water(memory, motion, sea, dt, PAPER_VEHICLE.coefficients, ARRAYS)


@pytest.mark.parametrize("path", [Circle(1.0, 0.1), Sine(0.8, 2.0, 0.15), FigureEight(20.0, 0.06)])
def test_water_plan_is_the_planners(path):
    """Step by step from the terms of the observation, up to the error of the formulas of second order."""
    V, dt = (0.2, -0.1), 0.1
    times = dt * np.arange(400)
    ground, water = plan(path, PAPER_VEHICLE, times), plan(ThroughWater(path, V), PAPER_VEHICLE, times)
    memory, rows = AT_FIRST, []
    for k in range(len(times)):
        values = dict.fromkeys(Observation._fields, np.zeros(1))
        psi_m = ground.psi[k] + 0.7
        values |= {"cos_psi": np.cos([psi_m]), "sin_psi": np.sin([psi_m]), "psi_e": np.array([0.7])}
        for name in ("u", "v", "r"):
            values[f"{name}_R"] = getattr(ground, name)[k : k + 1]
        values |= {"F_uR": ground.F_u[k : k + 1], "F_rR": ground.F_r[k : k + 1]}
        motion = reference_motion(Observation(**values), PAPER_VEHICLE.coefficients, ARRAYS)
        derivatives = path.derivatives(times[k : k + 1])
        np.testing.assert_allclose(np.ravel(motion[1:]), derivatives[1:3].ravel(), atol=1e-4)
        memory, R = in_water(memory, motion, Sea(np.full(1, V[0]), np.full(1, V[1])), np.full(1, dt))
        rows.append(np.concatenate(R))
    psi, *others = np.array(rows).T
    assert abs(wrap_angle(psi - water.psi, ARRAYS))[50:].max() < 2e-4
    tolerances = {"u": 2e-4, "v": 2e-4, "r": 1e-3, "F_u": 0.02, "F_r": 0.2}
    for mine, (name, tolerance) in zip(others, tolerances.items(), strict=True):
        assert abs(mine - getattr(water, name))[50:].max() < tolerance, name


def test_water_plan_under_a_sway_load_is_feasible():
    """The planned motion obeys (2b) with the load."""
    n, dt, w = 1, 0.02, 0.8
    memory, rows = AT_FIRST, []
    still = np.zeros(n)
    for k in range(600):
        t = dt * k
        motion = ReferenceMotion(still, np.ones(n), still, still, still)
        Y, Y_rate = 20 * np.sin([w * t]), 20 * w * np.cos([w * t])
        memory, R = in_water(memory, motion, Sea(still, still, Y=Y, Y_rate=Y_rate), np.full(n, dt))
        rows.append((*(x[0] for x in R), Y[0]))
    psi, u, v, r, _, _, Y = np.array(rows).T
    V = PAPER_VEHICLE
    residual = V.m22 * np.gradient(v, dt) + V.m11 * u * r + V.d22 * v - Y
    assert abs(residual[100:-1]).max() < 0.05
    np.testing.assert_allclose(np.gradient(psi, dt)[100:-1], r[100:-1], atol=2e-4)


FIRM = Gains(k=9.5, k1=0.0, cu=0.3, ku=0.0, c=1.65, kc=0.0, cr=1.62, reference_speed=0.276)


class KnownCurrent:
    """The law in the water frame with a given current."""

    def __init__(self, V):
        self.V = V

    def start(self, n):
        return tuple(np.zeros((len(PlannedReference._fields), n)))

    def forces(self, o, memory, extra):
        V_x, V_y = (np.full_like(o.u_R, x) for x in self.V)
        memory, R = in_water(
            PlannedReference(*memory), reference_motion(o, PAPER_VEHICLE.coefficients, ARRAYS), Sea(V_x, V_y), o.dt
        )
        V_u, V_v = to_body(V_x, V_y, o.cos_psi, o.sin_psi)
        psi = np.arctan2(o.sin_psi, o.cos_psi)
        state = (o.e_x, o.e_y, psi, o.u_R + o.u_e - V_u, o.v_R + o.v_e - V_v, o.r_R + o.r_e)
        return *tracking_forces(water_errors(state, R, ARRAYS), PAPER_VEHICLE, FIRM, ARRAYS), memory


def test_known_current_gives_no_error():
    """In a current of half the vehicle's speed, except for the error due to constant forces in a control period."""
    V = (0.4, 0.3)
    current = RandomCurrent(speed=0.5, direction=float(np.arctan2(V[1], V[0])), relative=False)
    scenario = Scenario(path=Circle(1.0, 0.1), current=current, start=Start(), control_dt=0.02, steps=3500)
    errors = {}
    for name, policy in {"water": Remembering(KnownCurrent(V)), "ground": make_policy("backstepping")}.items():
        env = UnderactuatedAUVTrackVectorEnv(1, scenario)
        observation, _ = env.reset(seed=0)
        memory, first, kept = None, np.ones(1, dtype=bool), []
        for k in range(3499):
            action, memory = policy.predict(observation, memory, first)
            observation, *_, info = env.step(action)
            first[:] = False
            kept += [info["position_error"][0]] if k > 2750 else []
        errors[name] = np.sqrt(np.mean(np.square(kept)))
    assert errors["ground"] > 0.5
    assert errors["water"] < 1.5e-4


# Faults of sensors and actuators.

ACTIONS = [(0.1, -0.1), (0.2, -0.3), (0.4, 0.5), (0.8, 0.7)]


def test_the_action_of_a_delayed_period_acts():
    """For half a period, the mean of two actions."""
    faults = NO_FAULTS._replace(surge_share=0.5, yaw_share=0.8)
    for delay, (a_u, a_r) in (*enumerate(ACTIONS), (1.5, (0.3, 0.1))):
        forces = acting_forces(faults._replace(delay=float(delay)), ACTIONS, (400.0, 200.0), ARRAYS)
        assert forces == pytest.approx((0.5 * 400 * a_u, 0.8 * 200 * a_r))


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


@pytest.mark.parametrize("speed_range", ["slow", "cruise"])
def test_the_filter_distinguishes_calm_from_rough_water(speed_range):
    for case, calm in (("noise", True), ("storm", False)):
        scenario = at_typical_noise(PRESETS[f"{speed_range}-{case}"])
        memory, *_ = filtered(make_policy("ekf"), scenario, 8, 300)
        rough_fit, calm_fit = (Belief.of(rows.T).fit[0] for rows in memory[:2])
        assert ((calm_fit > rough_fit + ODDS) == calm).all()


def test_the_filter_estimates_biases_losses_and_delays():
    """In storms, heading bias to one degree, delay to a fraction of a period."""
    world = adverse("cruise")
    biases = {"heading_bias": 0.05, "velocity_bias": -0.05, "yaw_rate_bias": 0.005}
    steady = replace(world.sensors, **biases, outages=0.0)
    weak = replace(world.actuators, effectiveness=0.7, reach=1.0, delay=2.0)
    scenario = replace(world, sensors=steady, actuators=weak)
    _, z, _ = filtered(make_policy("nmpc-adverse"), scenario, 16, 550)
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
    memory, _, env = filtered(make_policy("ekf"), scenario, 8, 248, episodes)
    rough, _ = (Belief.of(rows.T) for rows in memory[:2])
    assert np.hypot(*(rough.fix.T - position_errors(env)).T).min() > 1.0
    assert np.hypot(*(rough.state[:2].T - position_errors(env)).T).max() < 0.3


def test_a_distant_start_with_any_heading_converges():
    anywhere = Start(x_e=(-5.0, 5.0), y_e=(-5.0, 5.0), psi_e=(-3.1, 3.1), surge=(0.3, 1.0))
    for case in ("calm", "storm"):
        scenario = replace(PRESETS[f"slow-{case}"], start=anywhere)
        run = rollout(make_policy("ekf"), scenario, drawn(scenario, 40, 0).episodes)
        assert run.measures.steady_rmse.max() < 0.2


@pytest.mark.slow
def test_estimated_faults_lower_the_error():
    world = adverse("slow")
    late = replace(world, actuators=replace(world.actuators, delay=3.0, reach=1.0))
    episodes = drawn(late, 6, 0).episodes
    steady_rmses = {name: rollout(make_policy(name), late, episodes).measures.steady_rmse.mean()
             for name in ("nmpc", "nmpc-adverse")}  # fmt: skip
    assert steady_rmses["nmpc-adverse"] < 0.5 * steady_rmses["nmpc"]

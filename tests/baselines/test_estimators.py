"""Filter and observer against true disturbances and statistics; the plan in the water frame against the planner."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from auv_gym.envs.track_vector_env import UnderactuatedAUVTrackVectorEnv
from auv_gym.physics.actuators import Response
from auv_gym.physics.disturbances import RandomCurrent
from auv_gym.physics.errors import to_body
from auv_gym.physics.namespaces import ARRAYS, FLOATS, wrap_angle
from auv_gym.physics.vehicle import PAPER_VEHICLE, Coefficients
from auv_gym.planning.paths import Circle, FigureEight, Sine
from auv_gym.planning.planner import plan
from auv_gym.scenarios.presets import CASES, PRESETS
from auv_gym.scenarios.scenario import RandomPath, Scenario, Start
from auv_gym.task.observation import Observation
from auv_gym.task.simulation import PARAMETER_ROWS, Parameters, Parts, start, step
from baselines import make_policy
from baselines.control.backstepping import Gains, tracking_forces
from baselines.control.current_observer import sampled_gains
from baselines.control.ekf_law import EKF_GAINS
from baselines.estimation.filter_equations import Belief
from baselines.estimation.kalman import HYPOTHESES, ODDS, ExtendedKalmanFilter, beliefs_of, tuning_of
from baselines.estimation.sea_model import Estimate
from baselines.estimation.water_frame import (
    PlannedReference,
    ReferenceMotion,
    Sea,
    plan_in_water,
    reference_motion,
    water_errors,
)
from baselines.gains.loading import load_gains
from baselines.policy import Remembering


def every_preset(count):
    """Return an environment with `count` vehicles in each benchmark scenario, whose episodes do not end."""
    names = [f"{speed_range}-{case}" for speed_range in ("slow", "cruise") for case in CASES for _ in range(count)]
    scenarios = [replace(PRESETS[name], steps=601, lost_distance=64.0) for name in names]
    return UnderactuatedAUVTrackVectorEnv(len(names), scenarios), np.array(names)


def likelier(memory):
    """Return for each vehicle the memory of the filter with the higher likelihood."""
    rough, calm = beliefs_of(memory[:HYPOTHESES])
    better = calm.fit[0] > rough.fit[0] + ODDS

    def chosen(a, b):
        vehicles_first = len(a) == len(better) and a.ndim == 3
        return np.where(better[:, None, None] if vehicles_first else better, b, a)

    return Belief(*(chosen(a, b) if np.size(a) else a for a, b in zip(rough, calm, strict=True)))


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
            position = (env.state[:, :2] - np.stack((env.reference.x, env.reference.y), axis=1)) - z[:2].T
            heading = wrap_angle(env.state[:, 2:3] - z[2][:, None], ARRAYS)
            error = np.concatenate((position, heading), axis=1)
            distances.append(np.einsum("ni,ni->n", error, np.linalg.solve(P[:, :3, :3], error[..., None])[..., 0]))
        observation, *_ = env.step(action)
        first = np.zeros_like(first)
        if k % 25 == 0:
            for P in (belief.covariance for belief in beliefs_of(memory[:HYPOTHESES])):
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


def memory_after(scenario, policy, n=24, steps=500):
    """Return the memory of the policy and the environment after `steps` steps from seed 0."""
    env = UnderactuatedAUVTrackVectorEnv(n, scenario)
    observation, _ = env.reset(seed=0)
    memory, first = None, np.ones(n, dtype=bool)
    for _ in range(steps):
        action, memory = policy.predict(observation, memory, first)
        observation, *_ = env.step(action)
        first = np.zeros_like(first)
    _, memory = policy.predict(observation, memory, first)
    return memory, env


def test_filter_estimates_the_current_with_noisy_sensors():
    """On a turning path current and load are both observable, if the model's load is almost constant."""
    calm = dict.fromkeys(("surge_bias", "sway_bias", "yaw_bias", "surge_waves", "sway_waves", "yaw_waves"), 0.01)
    gains = {**load_gains("ekf", "cruise", EKF_GAINS), "current": 0.01, "gust": 0.001, **calm}
    policy = make_policy("ekf", gains=gains)
    memory, env = memory_after(replace(CURRENT, sensors=PRESETS["cruise-noise"].sensors), policy)
    z = Estimate(*likelier(memory).state)
    error = np.hypot(z.V_x - env.current[:, 0], z.V_y - env.current[:, 1])
    assert np.hypot(*env.current.T).mean() > 0.2
    assert error.mean() < 0.06
    state, reference = env.state, env.reference
    assert np.hypot(z.x_e - (state[:, 0] - reference.x), z.y_e - (state[:, 1] - reference.y)).mean() < 0.03
    assert abs(wrap_angle(z.psi - state[:, 2], ARRAYS)).mean() < 0.01


def test_observer_estimates_the_current():
    memory, env = memory_after(CURRENT, make_policy("current-observer"))
    assert np.hypot(*(memory[0][:, 5:7] - env.current).T).max() < 0.02


def test_filter_estimates_lag_and_load():
    """Actuators with different lags and a constant load, without measurement noise, under varying commands."""
    lags, load = np.array([0.15, 0.3, 0.6]), (15.0, 0.0, -6.0)
    dt, n, steps = 0.1, len(lags), 600
    reference = plan(Circle(1.0, 0.15), PAPER_VEHICLE, dt * np.arange(steps + 1)).table
    h, F_u_max, F_r_max = (np.full(n, x) for x in (dt, 400.0, 200.0))
    p = Parameters.of([np.ones(n)] * PARAMETER_ROWS, Parts())._replace(
        h=h,
        coefficients=Coefficients(*(np.full(n, x) for x in PAPER_VEHICLE.coefficients)),
        response=Response(*np.array([Response.of(lag, np.inf, np.inf, dt) for lag in lags]).T),
        F_u_max=F_u_max,
        F_r_max=F_r_max,
        thrust_u=F_u_max,
        thrust_r=F_r_max,
    )
    sample = [
        np.concatenate((row, (0.0, 0.0), load, np.zeros(6), [1.0, 0.0]))[:, None] * np.ones(n) for row in reference
    ]
    plant, terms = start(tuple(np.zeros((6, n)) + np.array([0, 0, 0, 1.0, 0, 0])[:, None]), sample[0], p, ARRAYS)
    estimator = ExtendedKalmanFilter(PAPER_VEHICLE, tuning_of(load_gains("ekf", "cruise", EKF_GAINS)))
    o = Observation(*terms)
    memory, _ = estimator.update(estimator.start(n), np.array(o))
    rng = np.random.default_rng(0)
    for k in range(1, steps + 1):
        F_u, F_r = tracking_forces(o, PAPER_VEHICLE, FIRM, ARRAYS)
        action = F_u / 400 + rng.normal(0, 0.1, n), F_r / 200 + rng.normal(0, 0.1, n)
        plant, terms, _ = step(plant, action, sample[k], p, ARRAYS)
        o = Observation(*terms)
        memory, z = estimator.update(memory, np.array(o))
    z = Estimate(*z)
    np.testing.assert_allclose(z.lag, lags, rtol=0.1)
    np.testing.assert_allclose(z.F_u, plant[6], atol=3.0)
    np.testing.assert_allclose(z.X + z.X_wave, load[0], atol=3.0)
    np.testing.assert_allclose(z.N + z.N_wave, load[2], atol=2.0)


AT_FIRST = PlannedReference(*np.zeros((len(PlannedReference._fields), 1)))


def in_water(memory, motion, sea, dt):
    return plan_in_water(memory, motion, sea, dt, PAPER_VEHICLE.coefficients, ARRAYS)


@dataclass(frozen=True)
class Drifting:
    """A path relative to water that moves with a constant velocity."""

    path: Circle | Sine | FigureEight
    V: tuple[float, float]

    @property
    def speed(self):
        return self.path.speed

    start, end = -np.inf, np.inf

    def derivatives(self, t):
        derivatives = self.path.derivatives(t).copy()
        for axis in (0, 1):
            derivatives[0, axis] -= self.V[axis] * t
            derivatives[1, axis] -= self.V[axis]
        return derivatives


@pytest.mark.parametrize("path", [Circle(1.0, 0.1), Sine(0.8, 2.0, 0.15), FigureEight(20.0, 0.06)])
def test_water_plan_is_the_planners(path):
    """Step by step from the terms of the observation, up to the error of the formulas of second order."""
    V, dt = (0.2, -0.1), 0.1
    times = dt * np.arange(400)
    ground, water = plan(path, PAPER_VEHICLE, times), plan(Drifting(path, V), PAPER_VEHICLE, times)
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


def test_gains_of_the_observer_place_its_poles():
    dt = 0.3
    for drag in (70 / 215, 100 / 265):
        l1, l2 = sampled_gains(drag, (1.2, 0.4), dt, FLOATS)
        a = np.exp(-drag * dt)
        errors = np.array([[a * (1 - l1), -l1], [-a * l2, 1 - l2]])  # of velocity and current, from step to step
        np.testing.assert_allclose(np.sort(np.linalg.eigvals(errors)), np.exp([-1.2 * dt, -0.4 * dt]))

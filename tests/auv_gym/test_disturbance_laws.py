"""Control laws with disturbance estimation: no error in calm water or a steady current, and correct estimates."""

from dataclasses import replace

import numpy as np
import pytest

import baselines
from auv_gym.envs.track_vector_env import UnderactuatedAUVTrackVectorEnv
from auv_gym.physics.disturbances import RandomCurrent
from auv_gym.physics.dynamics import rk4_step
from auv_gym.physics.errors import to_body
from auv_gym.physics.namespaces import ARRAYS
from auv_gym.physics.vehicle import PAPER_VEHICLE as V
from auv_gym.planning.paths import Circle, Line
from auv_gym.scenarios.presets import PRESETS
from auv_gym.scenarios.scenario import Scenario, Start
from auv_gym.task.observation import Observation, decode_observation
from baselines.control.adaptive import AdaptiveMemory, current_of
from baselines.control.ilos import IlosMemory
from baselines.control.smc_dob import SmcMemory, estimated_loads
from baselines.gains.loading import load_gains
from baselines.policy import CRUISE_SPEED
from baselines.tuning.tunables import TUNABLES

NAMES = ["ilos", "adaptive", "smc-dob"]
STEADY = RandomCurrent(speed=(0.3, 0.3), direction=(1.2, 1.2))


def calm_policy(name, speed):
    """Return a law with the initial gains of its tuning, since the tuned gains may chatter."""
    if name == "backstepping":
        return baselines.make_policy(name)
    speed_range = "cruise" if speed > CRUISE_SPEED else "slow"
    return baselines.make_policy(name, gains=load_gains(name, speed_range, TUNABLES[name].names, "start"))


def run(name, speed, current, steps, turn_rate=0.0):
    """Return position errors [m], shape (steps,), the last memory and the environment."""
    path = Circle(speed=speed, turn_rate=turn_rate) if turn_rate else Line(speed=speed)
    calm = replace(PRESETS["cruise-calm"], path=path, start=Start(), steps=steps + 1)
    env = UnderactuatedAUVTrackVectorEnv(1, replace(calm, current=current))
    env.reset(seed=3)
    velocity = np.stack(env.reference, axis=1)[:, 3:6]
    observation, _ = env.reset(seed=3, options={"initial_velocity": velocity})
    policy, memory, errors = calm_policy(name, speed), None, []
    for _ in range(steps):
        action, memory = policy.predict(observation, memory)
        observation, *_, info = env.step(action)
        errors.append(info["position_error"][0])
    _, memory = policy.predict(observation, memory)
    return np.array(errors), None if memory is None else memory[0][0], env


@pytest.mark.parametrize("speed", [0.2, 1.0])
@pytest.mark.parametrize("name", NAMES)
def test_in_calm_water_it_stays_on_the_reference(name, speed):
    """The remaining error is due to forces that are constant over a control period."""
    errors, _, _ = run(name, speed, None, 200, 0.05)
    assert errors.max() < 5e-3 * speed


@pytest.mark.parametrize("speed", [0.2, 1.0])
@pytest.mark.parametrize("name", NAMES)
def test_a_constant_current_is_rejected_on_a_line(name, speed):
    offset, _, _ = run("backstepping", speed, STEADY, 600)
    errors, _, _ = run(name, speed, STEADY, 2400)
    assert offset[-60:].min() > 0.05
    assert errors[-60:].max() < 0.01 * offset[-60:].min()


@pytest.mark.parametrize(("name", "memory"), [("ilos", IlosMemory), ("adaptive", AdaptiveMemory)])
def test_the_estimate_of_the_current_converges(name, memory):
    """On a circle, so the current is constant in the world frame only."""
    _, rows, env = run(name, 0.2, STEADY, 2400, 0.02)
    found = memory(*rows)
    assert np.hypot(*env.current[0]) == pytest.approx(0.06)
    tolerance = {"ilos": 0.01, "adaptive": 0.002}[name]
    assert (found.V_x, found.V_y) == pytest.approx(env.current[0], abs=tolerance)
    if name == "ilos":
        _, _, psi, _, v_g, _ = env.state[0]
        _, V_v = to_body(*env.current[0], np.cos(psi), np.sin(psi))
        assert found.v == pytest.approx(v_g - V_v, abs=1e-3)


def test_sigma_of_a_current():
    """Velocities over ground in a current, compared with the model in still water with sigma of the current."""
    rng, h = np.random.default_rng(0), 1e-3
    for _ in range(5):
        V_x, V_y, psi, u, v, r, F_u, F_r = rng.uniform(-0.3, 0.3, 8)
        V_u, V_v = to_body(V_x, V_y, np.cos(psi), np.sin(psi))
        load = (40 * F_u, 0.0, 10 * F_r)
        state = rk4_step((0.0, 0.0, psi, u, v, r), load, V.coefficients, h, (V_x, V_y), ns=ARRAYS)
        after_u, after_v = to_body(V_x, V_y, np.cos(state[2]), np.sin(state[2]))
        still = rk4_step((0.0, 0.0, psi, u + V_u, v + V_v, r), load, V.coefficients, h, ns=ARRAYS)
        sigma = (state[3] + after_u - still[3]) / h, (state[4] + after_v - still[4]) / h
        assert current_of(sigma, r, V.coefficients) == pytest.approx((V_u, V_v), abs=1e-3)


def test_observer_of_loads_converges_with_its_bandwidths():
    """Under constant loads the errors of the observer decay as exp(-l t)."""
    true, dt, bandwidths = np.array([0.05, -0.03, 0.02]), 0.1, (2.0, 0.5, 1.0)
    nu, memory = np.array([1.0, 0.0, 0.0]), SmcMemory(*np.zeros(7))
    for k in range(31):
        values = dict.fromkeys(Observation._fields, 0.0)
        values |= {"a_u": 0.1, "a_r": 0.05, "F_u_max": 400.0, "F_r_max": 200.0, "dt": dt}
        found = estimated_loads(Observation(**values), memory, tuple(nu), bandwidths, V.coefficients, ARRAYS)
        memory = SmcMemory(1.0, *nu, *found)
        decay = np.exp(-np.array(bandwidths) * dt * k)
        np.testing.assert_allclose(found, true * (1 - decay), rtol=0.01, atol=1e-3)  # axes are coupled
        load = np.array((0.1 * 400, 0.0, 0.05 * 200)) + true * (V.m11, V.m22, V.m33)
        nu = np.array(rk4_step((0.0, 0.0, 0.0, *nu), load, V.coefficients, dt, ns=ARRAYS)[3:])


@pytest.mark.parametrize(("speed_range", "speed"), [("slow", 0.2), ("cruise", 1.0)])
@pytest.mark.parametrize("name", NAMES)
def test_the_loop_is_stable_about_steady_motion(name, speed_range, speed):
    """Eigenvalues of one control period of vehicle and controller, differentiated numerically, on a line."""
    dt = PRESETS[f"{speed_range}-calm"].control_dt
    scenario = Scenario(path=Line(speed=speed), start=Start(), control_dt=dt, steps=50)
    env = UnderactuatedAUVTrackVectorEnv(1, scenario)
    reference = decode_observation(env.reset(seed=0)[0])
    controller = calm_policy(name, speed).controller
    size = controller.start(1)[0].shape[1]

    def period(x):
        """Return errors in the world, the last forces and the memory one period later."""
        (x_e, y_e, psi_e, u_e, v_e, r_e), force, memory = x[:6], x[6:8], x[8:]
        cos, sin = np.cos(psi_e), np.sin(psi_e)
        e_x, e_y = to_body(x_e, y_e, cos, sin)
        one = np.ones(1)
        o = reference._replace(
            e_x=e_x * one, e_y=e_y * one, psi_e=psi_e * one, u_e=u_e * one, v_e=v_e * one, r_e=r_e * one,
            cos_psi=cos * one, sin_psi=sin * one, a_u=force[:1] / reference.F_u_max, a_r=force[1:] / reference.F_r_max,
        )  # fmt: skip
        F_u, F_r, (after,) = controller.forces(o, (memory[None],), np.zeros((1, 0)))
        state = (x_e, y_e, psi_e, speed + u_e, v_e, r_e)
        moved = np.array(rk4_step(state, (F_u[0], 0.0, F_r[0]), V.coefficients, dt, ns=ARRAYS), dtype=float)
        moved -= (speed * dt, 0.0, 0.0, speed, 0.0, 0.0)
        return np.concatenate((moved, (F_u[0], F_r[0]), after[0]))

    x = np.concatenate((np.zeros(6), (reference.F_uR[0], reference.F_rR[0]), np.zeros(size)))
    for _ in range(400):  # until the memory is that of steady motion
        x = period(x)
    assert abs(x[:2]).max() < 1e-3
    h = 1e-6
    loop = np.array([(period(x + h * d) - period(x - h * d)) / (2 * h) for d in np.eye(len(x))]).T
    kept = abs(loop).sum(axis=1) + abs(loop).sum(axis=0) > 0
    values = np.abs(np.linalg.eigvals(loop[np.ix_(kept, kept)]))
    assert np.sort(values)[-2] < 1  # the largest eigenvalue is 1, of the flag that an episode has begun

"""Classical controllers: no error on the plan, no steady-state error in a current, bounded memory, checks of files."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

import baselines
from auv_gym.effects.current import RandomCurrent
from auv_gym.envs.track_vector_env import UnderactuatedAUVTrackVectorEnv
from auv_gym.physics.dynamics import rates
from auv_gym.physics.errors import to_body
from auv_gym.physics.vehicle import PAPER_VEHICLE as V
from auv_gym.physics.vehicle import Vehicle
from auv_gym.planning.paths import Circle, Line
from auv_gym.scenarios.presets import PRESETS
from auv_gym.scenarios.scenario import Start
from auv_gym.task.observation import SCALES, bounds
from auv_gym.task.policy import preview_of
from baselines.control.ilos import IlosMemory
from baselines.control.linearisation import error_dynamics
from baselines.control.lqi import LqiWeights, gain_schedule, optimal_gain, sampled_model
from baselines.gains import loading as gain_files
from baselines.gains.loading import load_gains
from baselines.policy import CRUISE_SPEED
from baselines.tuning.objective import TUNABLES

NAMES = ["integral-normalised", "los-pid", "lqi"]
CURRENT = RandomCurrent(speed=0.3, direction=1.2)


def gain_names(name):
    return TUNABLES[name].names


def initial_policy(name, speed, **changes):
    """Return a controller with the initial gains of its tuning; nmpc, which has none, with its tuned gains."""
    speed_range = "cruise" if speed > CRUISE_SPEED else "slow"
    gains = load_gains(name, speed_range, gain_names(name), "gains" if name == "nmpc" else "start")
    return baselines.make_policy(name, gains=gains | changes)


def run(policy, speed, current, steps, turn_rate=0.0):
    """Return the position errors [m] on a steady path, shape (steps,), the last memory and the environment."""
    path = Circle(speed=speed, turn_rate=turn_rate) if turn_rate else Line(speed=speed)
    scenario = replace(PRESETS["cruise-calm"], path=path, start=Start(), steps=steps + 1, current=current)
    env = UnderactuatedAUVTrackVectorEnv(1, scenario, preview=preview_of(policy))
    env.reset(seed=3)
    velocity = np.stack(env.reference, axis=1)[:, 3:6]
    observation, _ = env.reset(seed=3, options={"initial_velocity": velocity})
    memory, errors = None, []
    for _ in range(steps):
        action, memory = policy.predict(observation, memory)
        observation, *_, info = env.step(action)
        errors.append(info["position_error"][0])
    _, memory = policy.predict(observation, memory)
    return np.array(errors), memory, env


@pytest.mark.parametrize("speed", [0.2, 1.0])
@pytest.mark.parametrize("name", [*NAMES, "ilos", "nmpc"])
def test_the_vehicle_stays_on_the_reference_in_calm_water(name, speed):
    """The remaining error is due to forces that are constant over a control period."""
    errors, *_ = run(initial_policy(name, speed), speed, None, 200, 0.05)
    assert errors[-20:].max() < (5e-3 if name == "ilos" else 2e-3) * speed
    assert errors.max() < 0.03 * speed or name in NAMES


@pytest.mark.parametrize(
    ("name", "speed", "steps", "changes"),
    [
        ("integral-normalised", 0.2, 1500, {"rate": 0.06}),
        pytest.param("los-pid", 0.2, 1500, {"rate": 0.1}, marks=pytest.mark.slow),
        pytest.param("lqi", 0.2, 1500, {"rate": 0.3}, marks=pytest.mark.slow),
        ("ilos", 0.2, 2400, {}),
        ("ilos", 1.0, 2400, {}),
    ],
)
def test_a_constant_current_gives_no_steady_error_on_a_line_and_little_on_a_circle(name, speed, steps, changes):
    """With gains whose integral converges within the run."""
    policy, law = initial_policy(name, speed, **changes), baselines.make_policy("backstepping")
    offset = run(law, speed, CURRENT, 600)[0][-60:].min()
    assert offset > 0.05
    assert run(policy, speed, CURRENT, steps)[0][-150:].max() < (0.01 if name == "ilos" else 0.05) * offset
    assert run(policy, speed, CURRENT, 1500, 0.01)[0][-150:].max() < 0.3 * offset


def test_the_estimates_of_current_and_sway_of_ilos_converge():
    """On a circle, so the current is constant in the world frame only."""
    _, memory, env = run(initial_policy("ilos", 0.2), 0.2, CURRENT, 2400, 0.02)
    estimates = IlosMemory(*memory[0][0])
    assert np.hypot(*env.current[0]) == pytest.approx(0.06)
    assert (estimates.V_x, estimates.V_y) == pytest.approx(env.current[0], abs=0.02)
    _, _, psi, _, v_g, _ = env.state[0]
    _, V_v = to_body(*env.current[0], np.cos(psi), np.sin(psi))
    assert estimates.v == pytest.approx(v_g - V_v, abs=1e-3)


def observations(n):
    """Return random observations of vehicles near the plan, shape (n, 18)."""
    return UnderactuatedAUVTrackVectorEnv(n, "cruise-storm").reset(seed=7)[0]


@pytest.mark.parametrize("name", NAMES)
def test_memory_is_bounded_at_any_distance(name):
    policy = baselines.make_policy(name)
    rows = observations(4).copy()
    rows[:, :2] = np.array([[1, 1], [-1, 1], [1, -1], [-1, -1]]) * bounds(1)[:2]
    rows[2:, 15] = 1.0  # the surge actuator at its limit
    memory = None
    for _ in range(1000):
        action, memory = policy.predict(rows, memory, np.array([memory is None]))
    speed = np.hypot(rows[:, 6], rows[:, 7]) * SCALES[6]
    horizon = load_gains(name, "cruise", gain_names(name))["horizon"]
    assert np.isfinite(action).all()
    assert (np.hypot(*memory[0].T) <= horizon * speed * (1 + 1e-9)).all()
    assert (memory[0][2:] == 0).all()
    assert all(np.isfinite(a).all() for a in memory)


# Linearised errors and the LQI against independent computations.


@pytest.mark.parametrize("cross", [{}, {"Y_rv": 40.0, "N_vr": 30.0, "X_rr": 5.0, "d23": 20.0, "eps": 0.4}])
def test_error_dynamics_with_quadratic_drag_and_lift(cross):
    """Against differences of (2) and of the errors' kinematics in the body frame."""
    vehicle = Vehicle(m11=215.0, m22=265.0, m33=80.0, d11=70.0, d22=100.0, d33=50.0, X_uu=30.0, Y_vv=80.0, N_rr=20.0)
    vehicle = replace(vehicle, Y_uv=60.0, Y_ur=40.0, N_uv=25.0, N_ur=30.0, **cross)
    u_R, v_R, r_R = 0.8, -0.3, 0.2

    def error_rates(e, force=(0.0, 0.0)):
        e_x, e_y, psi_e, u_e, v_e, r_e = e
        u, v, r = u_R + u_e, v_R + v_e, r_R + r_e
        c, s = np.cos(psi_e), np.sin(psi_e)
        _, _, *accelerations = rates(0.0, u, v, r, (force[0], 0.0, force[1]), vehicle.acting)
        return np.array((u - c * u_R - s * v_R + r * e_y, v - c * v_R + s * u_R - r * e_x, r_e, *accelerations))

    A, B = error_dynamics(vehicle, u_R, v_R, r_R)
    h, still = 1e-6, np.zeros(6)
    slopes = [(error_rates(h * d) - error_rates(-h * d)) / (2 * h) for d in np.eye(6)]
    np.testing.assert_allclose(A, np.array(slopes).T, atol=1e-8)
    np.testing.assert_allclose(
        B, np.array([error_rates(still, d) - error_rates(still) for d in np.eye(2)]).T, atol=1e-12
    )


WEIGHTS = LqiWeights(**dict(zip(LqiWeights._fields, (0.5, 0.3, 1.0, 1.0, 0.3, 1.0, 0.3, 0.2, 0.2, 5.0), strict=True)))


def test_gain_is_that_of_the_riccati_recursion():
    """The gain of a long finite horizon, iterated backward with an independent form of the cost."""
    u_R, r_R, dt, w = 1.0, 0.1, 0.1, WEIGHTS
    Phi, Gamma = sampled_model(u_R, r_R, V, w, dt)
    U2 = u_R**2 * (1 + (V.m11 * r_R / V.d22) ** 2)
    state_cost = np.diag([1, 1, w.heading**2 * U2, 0, 0, w.turn**2, 1, 1, 0, 0, 0, 0]).astype(float)
    e_dot = np.zeros((2, 12))  # (17) at e = 0: body-frame rate of the position error as seen from the world
    e_dot[:, 3:5], e_dot[:, 2] = np.eye(2), (V.m11 * u_R * r_R / V.d22, u_R)
    state_cost += w.velocity**2 * e_dot.T @ e_dot
    effort = np.diag([w.surge_effort / 400, w.yaw_effort / 200]) ** 2
    change = np.diag([w.surge_rate / 400 / dt, w.yaw_rate / 200 / dt]) ** 2
    pick = np.zeros((2, 12))
    pick[:, 10:] = np.eye(2)
    P = np.zeros((12, 12))
    for _ in range(3000):
        H = effort + change + Gamma.T @ P @ Gamma
        G = Gamma.T @ P @ Phi - change @ pick
        P = state_cost + pick.T @ change @ pick + Phi.T @ P @ Phi - G.T @ np.linalg.solve(H, G)
        P = 0.5 * (P + P.T)
    np.testing.assert_allclose(
        optimal_gain(u_R, r_R, V, w, dt, (400.0, 200.0)), np.linalg.solve(H, G), rtol=1e-6, atol=1e-6
    )


@pytest.mark.parametrize(
    ("speed_range", "lag"), [("slow", 0.02), ("slow", 0.3), ("cruise", 0.02), ("cruise", 0.3), ("cruise", 0.6)]
)
def test_interpolated_gains_stabilise_vehicles_with_other_lags(speed_range, lag):
    """Eigenvalues of plant, true lag, integral and the controller's model of the forces over one control period.

    The weights are the initial ones of the search. The tuned gains in slow motion are too high for lags of 0.3 s: they
    cause limit cycles of a few millimetres.
    """
    w = LqiWeights(**load_gains("lqi", speed_range, LqiWeights._fields, "start"))
    dt, speeds = {"slow": (0.2, (0.1, 0.2, 0.33)), "cruise": (0.1, (0.5, 0.93, 1.5))}[speed_range]
    actuators = PRESETS[f"{speed_range}-actuator"].actuators
    for u_R in speeds:
        for r_R in (0.0, 0.07):
            A, B = error_dynamics(V, u_R, -V.m11 * u_R * r_R / V.d22, r_R)
            M = np.zeros((14, 14))  # errors 6, xi 2, true forces 2, modelled forces 2, command 2
            M[:6, :6], M[:6, 8:10] = A, B
            M[6:8, 6:8], M[6:8, :2] = [[0, r_R], [-r_R, 0]], w.rate * np.eye(2)
            for rows, tau in ((slice(8, 10), lag), (slice(10, 12), w.lag)):
                M[rows, rows], M[rows, 12:] = -np.eye(2) / tau, np.eye(2) / tau
            K = gain_schedule(V, w, dt, (actuators.F_u_max, actuators.F_r_max))([[u_R, r_R]])[0]
            step = expm(dt * M)[:12]
            feedback = -np.hstack((K[:, :8], np.zeros((2, 2)), K[:, 8:]))  # on errors, xi, true, modelled, last command
            loop = np.vstack((np.hstack((step[:, :12], np.zeros((12, 2)))) + step[:, 12:] @ feedback, feedback))
            assert np.abs(np.linalg.eigvals(loop)).max() < 1, (u_R, r_R)


@pytest.mark.parametrize(
    ("gains", "reason"),
    [
        ({"heading": 1.0}, "has the gains heading; they must be velocity, heading"),
        ({**WEIGHTS._asdict(), "lag": float("nan")}, "gain lag is nan"),
    ],
)
def test_wrong_gains_are_refused(monkeypatch, gains, reason):
    record = {"tuned": {"lqi": {"slow": {"gains": gains}}}, "exponents": {}}
    monkeypatch.setattr(gain_files, "recorded_gains", lambda: record)
    with pytest.raises(ValueError, match=reason):
        baselines.make_policy("lqi")


def test_given_gains_replace_the_recorded_ones(monkeypatch):
    monkeypatch.setattr(gain_files, "recorded_gains", lambda: {"tuned": {}, "exponents": {}})
    with pytest.raises(ValueError, match="has no gains of lqi in slow: auv-gym tune lqi"):
        baselines.make_policy("lqi")
    policy = baselines.make_policy("lqi", gains=dict.fromkeys(LqiWeights._fields, 0.5))
    assert np.isfinite(policy.predict(observations(2))[0]).all()

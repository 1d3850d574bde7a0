"""Classical controllers: no error on the plan, no steady-state error in a current, bounded memory, checks of files."""

import json
from dataclasses import replace

import numpy as np
import pytest
from marks import slow_except
from scipy.linalg import expm

import baselines
from auv_gym.envs.track_vector_env import UnderactuatedAUVTrackVectorEnv
from auv_gym.physics.disturbances import RandomCurrent
from auv_gym.physics.errors import error_rates
from auv_gym.physics.vehicle import PAPER_VEHICLE as V
from auv_gym.planning.paths import Circle, Line
from auv_gym.scenarios.presets import PRESETS
from auv_gym.scenarios.scenario import Start
from auv_gym.task.observation import BOUNDS, SCALES
from auv_gym.task.policy import preview_of
from baselines.control.linearisation import error_dynamics
from baselines.control.lqi import LqiWeights, gain_schedule, optimal_gain, sampled_model
from baselines.gains import loading as gain_files
from baselines.gains.loading import load_gains
from baselines.policy import CRUISE_SPEED, BySpeed
from baselines.tuning.tunables import TUNABLES

NAMES = ["integral", "integral-normalised", "los-pid", "lqi"]


def final_errors(policy, speed, current, steps, turn_rate=0.0, largest=np.inf):
    """Return the position errors [m] in the last tenth of a run on a steady path; all are below `largest`."""
    path = Circle(speed=speed, turn_rate=turn_rate) if turn_rate else Line(speed=speed)
    calm = replace(PRESETS["cruise-calm"], path=path, start=Start(), steps=steps + 1)
    scenario = replace(calm, current=RandomCurrent(speed=(current, current), direction=(1.2, 1.2)) if current else None)
    env = UnderactuatedAUVTrackVectorEnv(1, scenario, preview=preview_of(policy))
    env.reset(seed=3)
    velocity = np.stack(env.reference, axis=1)[:, 3:6]
    observation, _ = env.reset(seed=3, options={"initial_velocity": velocity})
    memory, errors = None, []
    for _ in range(steps):
        action, memory = policy.predict(observation, memory)
        observation, *_, info = env.step(action)
        errors.append(info["position_error"][0])
    assert max(errors) < largest
    return np.array(errors[-steps // 10 :])


@pytest.mark.parametrize("speed", [0.2, 1.0])
@pytest.mark.parametrize("name", [*NAMES, "nmpc"])
def test_the_vehicle_stays_on_the_reference_in_calm_water(name, speed):
    """With the initial gains of the search; nmpc with its tuned gains."""
    part = "gains" if name == "nmpc" else "start"
    gains = load_gains(name, "cruise" if speed > CRUISE_SPEED else "slow", gain_names(name), part)
    largest = 0.03 * speed if name == "nmpc" else np.inf  # its filter must converge first
    errors = final_errors(baselines.make_policy(name, gains=gains), speed, 0.0, 200, 0.05, largest)
    assert errors.max() < 2e-3 * speed


@pytest.mark.parametrize("name", slow_except(["integral"], NAMES))
def test_a_constant_current_gives_no_steady_error_on_a_line_and_little_on_a_circle(name):
    """With gains whose integral converges within the run."""
    gains = {**load_gains(name, "slow", gain_names(name), "start"), **INTEGRATING[name]}
    policy, law = baselines.make_policy(name, gains=gains), baselines.make_policy("backstepping")
    offset = final_errors(law, 0.2, 0.3, 600).min()
    assert offset > 0.05
    assert final_errors(policy, 0.2, 0.3, 1500).max() < 0.05 * offset
    assert final_errors(policy, 0.2, 0.3, 1500, 0.01).max() < 0.3 * offset


INTEGRATING = {
    "integral": {"rate": 0.06},
    "integral-normalised": {"rate": 0.06},
    "los-pid": {"rate": 0.1},
    "lqi": {"rate": 0.3},
}


def observations(n, speed_range="cruise"):
    """Return random observations of vehicles near the plan, shape (n, 18)."""
    env = UnderactuatedAUVTrackVectorEnv(n, f"{speed_range}-storm")
    return env.reset(seed=7)[0]


@pytest.mark.parametrize("name", NAMES)
def test_memory_is_bounded_at_any_distance(name):
    policy = baselines.make_policy(name)
    rows = observations(4).copy()
    rows[:, :2] = np.array([[1, 1], [-1, 1], [1, -1], [-1, -1]]) * BOUNDS[:2]
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


def gain_names(name):
    return TUNABLES[name].names


# The LQI against independent computations.

WEIGHTS = LqiWeights(**dict(zip(LqiWeights._fields, (0.5, 0.3, 1.0, 1.0, 0.3, 1.0, 0.3, 0.2, 0.2, 5.0), strict=True)))


@pytest.mark.parametrize(("u_R", "r_R"), [(0.1, 0.0), (0.7, 0.1), (1.5, -0.05)])
def test_error_dynamics_are_the_linearised_equations(u_R, r_R):
    v_R = -V.m11 * u_R * r_R / V.d22
    reference, plan = (0.0, 0.0, 0.0, u_R, v_R, r_R), np.zeros(2)

    def body_rates(z, force):
        """Return the rates of body-frame errors from those of world-frame errors."""
        c, s = np.cos(z[2]), np.sin(z[2])
        rates = np.array(error_rates((0.0, 0.0, *z[2:]), reference, force, plan, V.coefficients))
        e_x_dot, e_y_dot = c * rates[0] + s * rates[1], c * rates[1] - s * rates[0]
        r = r_R + z[5]
        return np.array([e_x_dot + r * z[1], e_y_dot - r * z[0], *rates[2:]])

    A, B = error_dynamics(V, u_R, -V.m11 * u_R * r_R / V.d22, r_R)
    h = 1e-6
    A_numeric = np.array([(body_rates(h * d, plan) - body_rates(-h * d, plan)) / (2 * h) for d in np.eye(6)]).T
    B_numeric = np.array([(body_rates(np.zeros(6), d) - body_rates(np.zeros(6), -d)) / 2 for d in np.eye(2)]).T
    np.testing.assert_allclose(A, A_numeric, atol=1e-8)
    np.testing.assert_allclose(B, B_numeric, atol=1e-12)


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


# Gain files.


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setattr(gain_files, "GAINS_FOLDER", tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (None, "lqi-slow.json does not exist; .*auv-gym tune lqi --speed-range slow"),
        ("{", "is not valid JSON"),
        ("[1, 2]", "has the gains"),
        ('{"gains": {"heading": 1.0}}', "has the gains heading; they must be velocity, heading"),
        (json.dumps({"gains": {**WEIGHTS._asdict(), "lag": "0.2"}}), "gain lag is '0.2'"),
        (json.dumps({"gains": {**WEIGHTS._asdict(), "lag": -0.2}}), "gain lag is -0.2"),
        (json.dumps({"gains": {**WEIGHTS._asdict(), "lag": float("nan")}}), "gain lag is nan"),
    ],
)
def test_wrong_gain_files_are_refused(folder, text, reason):
    if text is not None:
        (folder / "lqi-slow.json").write_text(text)
    with pytest.raises(ValueError, match=reason):
        baselines.make_policy("lqi")


@pytest.mark.parametrize("name", NAMES)
def test_given_gains_replace_the_files(folder, name):
    with pytest.raises(ValueError, match="does not exist"):
        baselines.make_policy(name)
    names = gain_names(name)
    policy = baselines.make_policy(name, gains=dict.fromkeys(names, 0.5))
    assert not isinstance(policy.controller, BySpeed)
    assert np.isfinite(policy.predict(observations(2))[0]).all()
    with pytest.raises(ValueError, match=f"{name} has the gains k9"):
        baselines.make_policy(name, gains={"k9": 1.0})


def test_unknown_speed_ranges_and_options_are_refused():
    with pytest.raises(ValueError, match="unknown speed range 'fast'; allowed are slow, cruise"):
        load_gains("lqi", "fast", LqiWeights._fields)
    with pytest.raises(ValueError, match=r"policy 'integral' does not take these options: .*form"):
        baselines.make_policy("integral", form="other")

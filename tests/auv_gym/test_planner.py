"""The planner: numbers of the paper, open-loop accuracy, the sideslip equation, symmetries, errors raised."""

import math
import pickle
import warnings
from dataclasses import dataclass, fields, replace

import numpy as np
import pytest
from marks import slow_except
from matrix_form import matrix_form
from scipy.integrate import solve_ivp
from scipy.special import fresnel

from auv_gym.physics.namespaces import ARRAYS
from auv_gym.physics.vehicle import PAPER_VEHICLE, Vehicle
from auv_gym.planning.feasibility import InfeasibleReferenceError
from auv_gym.planning.kernels import driver
from auv_gym.planning.paths import (
    PAPER_CIRCLE,
    Circle,
    Ellipse,
    FigureEight,
    Lawnmower,
    Line,
    Path,
    RandomSmooth,
    Sine,
    Spline,
    WaypointWarning,
    stack,
)
from auv_gym.planning.planner import Planner, Reference, plan
from auv_gym.planning.sideslip import MAX_SIDESLIP, path_rates, sideslip_step, steady_sideslip

ROUGH = Vehicle(215.0, 265.0, 80.0, 70.0, 100.0, 50.0, X_uu=40.0, Y_vv=150.0, N_rr=60.0)
FINNED = replace(ROUGH, Y_uv=160.0, Y_ur=40.0, N_uv=25.0, N_ur=30.0)
CROSSED = replace(
    FINNED, X_vv=10.0, X_vr=20.0, X_rr=5.0, Y_rv=60.0, Y_vr=20.0, Y_rr=10.0, N_vv=15.0, N_rv=10.0, N_vr=80.0
)
COMPILED = pytest.mark.parametrize("vehicle", [PAPER_VEHICLE, ROUGH, FINNED], ids=["linear", "quadratic", "lift"])
VEHICLES = pytest.mark.parametrize(
    "vehicle", [PAPER_VEHICLE, ROUGH, FINNED, CROSSED], ids=["linear", "quadratic", "lift", "cross-flow"]
)
TURN = 0.4075575636029479  # width over arc length of a lawnmower's turn; legs take 9 s, turns 12 s
PATHS = {
    "line": Line(0.5, heading=1.0),
    "circle": Circle(0.5, 0.1, 3.0, -2.0, 0.4),
    "sine": Sine(0.5, 2.0, 0.2, 0.3),
    "ellipse": Ellipse(6.0, 3.0, -0.09, 0.7),
    "figure_eight": FigureEight(5.0, 0.08, 0.2),
    "lawnmower": Lawnmower(0.5, 4.5, -0.5 * 12 * TURN),
    "random_smooth": RandomSmooth(0.5, (0.05, -0.03, 0.02), (0.04, 0.09, 0.13), (0.3, 2.0, 5.0), 0.2, 0.07, 1.0),
    "spline": Spline(((0, 0), (5, 1), (9, 4.5), (15, 4), (16.5, -2), (10, -6)), 0.5, (0.4, 0.5, 0.6, 0.5, 0.4, 0.5)),
    "fast_circle": Circle(1.5, 0.12),
    "fast_sine": Sine(1.2, 4.0, 0.2),
}
FIELDS = [field.name for field in fields(Reference)]


def columns(reference, *names):
    return np.array([getattr(reference, name) for name in names])


def test_section_iii_numbers():
    R = plan(PAPER_CIRCLE, PAPER_VEHICLE, np.arange(0, 10, 0.1))
    for name, value, digits in (
        ("u", 0.0999769, 7), ("v", 0.0021495, 7), ("r", -0.01, 12), ("F_u", 7.00408, 5), ("F_r", -0.48925, 5)
    ):  # fmt: skip
        np.testing.assert_allclose(getattr(R, name), value, rtol=0, atol=0.5 * 10**-digits)
    np.testing.assert_allclose(np.degrees(R.gamma), 1.2317, rtol=0, atol=5e-5)
    np.testing.assert_allclose((R.x, R.y), (10 * np.sin(0.01 * R.t), 10 * np.cos(0.01 * R.t)), rtol=0, atol=1e-13)


@pytest.mark.parametrize(
    ("name", "vehicle"),
    [(name, PAPER_VEHICLE) for name in PATHS]
    + [(name, ROUGH) for name in ("circle", "ellipse", "figure_eight", "fast_circle")]  # |v| v has a kink at v = 0
    + [(name, FINNED) for name in ("ellipse", "fast_circle")]
    + [(name, CROSSED) for name in ("ellipse", "fast_circle")],
)
def test_planned_forces_keep_the_vehicle_on_its_path_in_open_loop(name, vehicle):
    """Runge-Kutta steps of h with the forces at both ends and the middle; above 0.68 m/s errors grow in open loop."""
    h, end = 0.01, 12 if name in ("fast_circle", "fast_sine", "spline") else 25
    R = plan(PATHS[name], vehicle, np.arange(0, end + h / 4, h / 2))
    path, F_u, F_r = columns(R, "x", "y").T, R.F_u.tolist(), R.F_r.tolist()
    state = columns(R, "x", "y", "psi", "u", "v", "r")[:, 0]

    def rates(state, k):
        return matrix_form(state, (F_u[k], 0.0, F_r[k]), vehicle)

    drift = 0.0
    for k in range(0, len(path) - 2, 2):
        a = rates(state, k)
        b = rates(state + h / 2 * a, k + 1)
        c = rates(state + h / 2 * b, k + 1)
        state = state + h / 6 * (a + 2 * (b + c) + rates(state + h * c, k + 2))
        drift = max(drift, *np.abs(state[:2] - path[k + 2]))
    assert drift < 1e-9


def sideslip(path, vehicle, times, start):
    """Integrate gam' = -(m om + D tan(gam)) / Dm, D = d22 + Yuv u + Yvv |v| + m22 vp'/vp, with small tolerances."""
    m = vehicle.m11 - vehicle.Y_ur

    def rate(t, gamma):
        (x1, y1), (x2, y2) = path.derivatives(np.array([t]))[1:3, :, 0]
        square = x1 * x1 + y1 * y1
        sway = abs(math.sqrt(square) * math.sin(gamma[0]))
        lift = vehicle.Y_uv * math.sqrt(square) * math.cos(gamma[0])
        D = vehicle.d22 + lift + vehicle.Y_vv * sway + vehicle.m22 * (x1 * x2 + y1 * y2) / square
        return -(m * (x1 * y2 - y1 * x2) / square + D * np.tan(gamma)) / (vehicle.m22 - m)

    span = times[0], times[-1]
    return solve_ivp(rate, span, [start], "DOP853", times, rtol=1e-10, atol=1e-12, max_step=0.5).y[0]


@pytest.mark.parametrize("name", ["circle", "sine", "random_smooth"])
def test_cross_flow_that_vanishes_leaves_the_plan(name):
    """Two planners, one answer: the equation that is linear in the yaw rate, and the one that is not."""
    t, vanishing = 0.1 * np.arange(200), replace(FINNED, X_vv=1e-13)
    plain, crossed = (plan(PATHS[name], vehicle, t).table for vehicle in (FINNED, vanishing))
    size = np.abs(plain).max(axis=0)
    np.testing.assert_allclose(crossed / size, plain / size, rtol=0, atol=1e-5)


@pytest.mark.parametrize("name", slow_except(PATHS.keys() - {"lawnmower", "random_smooth"}, PATHS))
@COMPILED
def test_sideslip_solves_its_differential_equation(name, vehicle):
    """From the planner's initial value, which after the run-in is that of a start at t = -30 s."""
    t, path = 0.1 * np.arange(201), PATHS[name]
    R = plan(path, vehicle, t)
    np.testing.assert_allclose(R.gamma, sideslip(path, vehicle, t, R.gamma[0]), rtol=0, atol=1e-5)
    np.testing.assert_allclose(R.gamma, np.arctan2(R.v, R.u), rtol=0, atol=1e-14)
    if path.start < 0:
        earlier = np.array([-30.0, 0.0])
        assert R.gamma[0] == pytest.approx(sideslip(path, vehicle, earlier, 0.0)[1], abs=1e-5)


@dataclass(frozen=True)
class Bounded:
    """A path restricted to t >= 0."""

    path: Path
    start, end = 0.0, math.inf

    def derivatives(self, t):
        return self.path.derivatives(t)


@pytest.mark.parametrize("name", ["circle", "sine", "ellipse", "figure_eight", "random_smooth", "fast_sine"])
@VEHICLES
def test_initial_sideslip_without_a_run_in_is_close(name, vehicle):
    t = 0.1 * np.arange(100)
    error = np.abs(plan(PATHS[name], vehicle, t).gamma - plan(Bounded(PATHS[name]), vehicle, t).gamma)
    assert error[0] < 4e-3
    assert error[70:].max() < 1e-6


@pytest.mark.parametrize("turn_rate", [0.05, 0.2, 0.6, 1.2, 2.4])
@pytest.mark.parametrize("dt", [0.02, 0.2, 1.0])
def test_steady_sideslip_on_circles_up_to_its_limit(turn_rate, dt):
    R = plan(Circle(1.0, turn_rate), PAPER_VEHICLE, dt * np.arange(301))
    np.testing.assert_allclose(np.tan(R.gamma), -2.15 * turn_rate, rtol=1e-9)


@pytest.mark.parametrize("path", [PATHS["sine"], PATHS["ellipse"], PATHS["fast_sine"]])
def test_error_is_of_third_order_in_the_time_step(path):
    fine, *coarse = (plan(path, PAPER_VEHICLE, np.linspace(0, 20, n * 200 + 1)).F_r[::n] for n in (16, 1, 2))
    error = [np.abs(F_r - fine).max() for F_r in coarse]
    assert error[0] < 1e-3
    assert error[1] < error[0] / 8


def test_steady_sideslip_is_close_on_a_path_that_turns_more_and_less():
    """Up to 42 degrees; the one without the change of the sideslip, tan(gamma) = -m omega / D, is four times as far."""
    path, t = Ellipse(6.0, 4.0, 0.25), np.linspace(0, 40, 801)
    along, w = path_rates(path.derivatives(t)), np.sin(plan(path, PAPER_VEHICLE, t).gamma)
    tan = -PAPER_VEHICLE.m11 * along.omega / (PAPER_VEHICLE.d22 + PAPER_VEHICLE.m22 * along.v_p_dot / along.v_p)
    error = np.abs(steady_sideslip(along, PAPER_VEHICLE, ARRAYS) - w)[200:].max()
    assert error < 0.015
    assert np.abs(np.sin(np.arctan(tan)) - w)[200:].max() > 4 * error


def test_a_single_step_of_the_sideslip_is_of_second_order():
    """w' = -2 w + n(w, t) as it is integrated online, compared with a solution of small tolerance."""

    def n(w, t):
        return 0.5 * math.cos(3 * t) - w * w

    exact = solve_ivp(lambda t, w: -2 * w + n(w, t), (0, 1), [0.3], rtol=1e-10, atol=1e-12).y[0, -1]
    errors = []
    for steps in (20, 40):
        h, w, rest = 1 / steps, 0.3, n(0.3, 0.0) / steps
        for k in range(1, steps + 1):
            w, rest = sideslip_step(w, rest, lambda w, t=k * h, h=h: h * n(w, t), 2 * h, 0.9)
        errors.append(abs(w - exact))
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.1)
    assert sideslip_step(0.3, 2.0, lambda w: 2.0 * w, 0.1, 0.9) == (0.9, 1.8)


@pytest.mark.parametrize(
    ("path", "mirrored"),
    [
        (Circle(0.5, 0.1), Circle(0.5, -0.1)),
        (Sine(0.5, 2.0, 0.2, 0.3), Sine(0.5, -2.0, 0.2, 0.3)),
        (Ellipse(6.0, 3.0, 0.09, 0.7), Ellipse(6.0, 3.0, -0.09, -0.7)),
        (Lawnmower(0.5, 4.0, 2.0), Lawnmower(0.5, 4.0, -2.0)),
    ],
)
@VEHICLES
def test_mirrored_path_has_the_mirrored_reference(path, mirrored, vehicle):
    t = 0.1 * np.arange(300)
    R, M = plan(path, vehicle, t), plan(mirrored, vehicle, t)
    turn = R.psi[0] + M.psi[0] - math.remainder(R.psi[0] + M.psi[0], math.tau)
    for name in FIELDS:
        sign = -1 if name in ("y", "psi", "v", "r", "F_r", "gamma", "omega") else 1
        offset = turn if name == "psi" else 0.0
        np.testing.assert_allclose(getattr(R, name), sign * getattr(M, name) + offset, rtol=0, atol=1e-11)


@pytest.mark.skipif(driver() is None, reason="there is no compiler")
@pytest.mark.parametrize("times", [0.1 * np.arange(150), 2.5 + 0.7 * np.arange(20), np.array([0.0, 0.3])], ids=len)
@pytest.mark.parametrize("name", PATHS)
@COMPILED
def test_compiled_plans_equal_plans_in_python(name, vehicle, times):
    """With one sample or several per period, with and without refinement, from t = 0 and from a later time."""
    planner, path, rest = Planner(vehicle, times), PATHS[name], np.empty((3, len(times)))
    compiled = np.vstack((planner._compiled(path, rest).T, rest))
    table, others = planner._in_python(path)
    python = np.vstack((table.T, others))
    size = np.abs(python).max(axis=1, keepdims=True)
    np.testing.assert_allclose(compiled / (1e-9 + size), python / (1e-9 + size), rtol=0, atol=1e-11)
    np.testing.assert_array_equal(planner.table(path), compiled[:8].T)


@pytest.mark.skipif(driver() is None, reason="there is no compiler")
def test_compiled_code_and_python_refuse_the_same_paths():
    rng, limits = np.random.default_rng(0), (160.0, 60.0)
    planner = Planner(FINNED, 0.1 * np.arange(100), limits, fin=200.0)
    refused = 0
    for speed, turn_rate in rng.uniform((0.2, 0.2), (1.5, 0.6), (200, 2)):
        for path in (Circle(speed, turn_rate), Sine(speed, turn_rate * speed / 2, 2 * turn_rate)):
            compiled = planner._compiled(path)
            try:
                R = planner.plan(path)
            except InfeasibleReferenceError:
                refused += 1
                assert compiled is None
                with pytest.raises(InfeasibleReferenceError):
                    planner.table(path)
            else:
                assert np.abs(compiled[:, 6:]).max(axis=0).tolist() <= list(limits)
                np.testing.assert_array_equal(compiled, R.table)
    assert 50 < refused < 350


@pytest.mark.parametrize(
    ("path", "laps"), [(Circle(1.0, -0.2), -3), (Ellipse(6.0, 4.0, 0.2), 3), (FigureEight(9.0, 0.2), 0)]
)
def test_heading_is_continuous_over_laps(path, laps):
    R = plan(path, PAPER_VEHICLE, np.linspace(0, 3 * 2 * math.pi / 0.2, 2001))
    assert R.psi[-1] - R.psi[0] == pytest.approx(laps * 2 * math.pi, abs=1e-4)
    assert np.abs(np.diff(R.psi)).max() < 0.1
    np.testing.assert_allclose(np.cos(R.psi + R.gamma) * R.v_p, path.derivatives(R.t)[1, 0], rtol=0, atol=1e-12)


def test_path_rates_are_derivatives_of_each_other():
    t = np.linspace(0, 20, 20001)
    along = path_rates(PATHS["figure_eight"].derivatives(t))
    for rate, of in (("omega", "beta"), ("omega_dot", "omega"), ("v_p_dot", "v_p"), ("v_p_ddot", "v_p_dot")):
        numeric = np.gradient(np.unwrap(getattr(along, of)), t, edge_order=2)
        np.testing.assert_allclose(getattr(along, rate), numeric, rtol=0, atol=1e-6)


@dataclass(frozen=True)
class Braking:
    """The straight path x = t - .05 t^2, y = 2, whose speed is zero at t = 10 s."""

    speed = 1.0
    start, end = 0.0, 20.0

    def derivatives(self, t):
        zero = 0.0 * t
        return np.array([[t - 0.05 * t * t, zero + 2], [1 - 0.1 * t, zero], [zero - 0.1, zero], [zero, zero]])


@dataclass(frozen=True)
class Clothoid:
    """A clothoid with turn rate t/2 [rad/s] at 1 m/s; its position is given by Fresnel integrals."""

    speed = 1.0
    start, end = 0.0, math.inf

    def derivatives(self, t):
        scale, angle = math.sqrt(2 * math.pi), t * t / 4
        s, c = fresnel(t / scale)
        (x1, y1), w = (np.cos(angle), np.sin(angle)), t / 2
        x2, y2 = -w * y1, w * x1
        return np.array([[scale * c, scale * s], [x1, y1], [x2, y2], [-w * y2 - y1 / 2, w * x2 + x1 / 2]])


@pytest.mark.parametrize(
    ("path", "end", "condition", "time"),
    [
        (Braking(), 15, "the path stops, v_p = ", 10.0),
        (Braking(), 9, "braking -v_p'/v_p", 10 - 265 / 100),
        (Clothoid(), 9, "the sideslip exceeds 80 degrees", 2 * math.tan(MAX_SIDESLIP) / 2.15),
    ],
)
def test_infeasible_references_are_refused_with_time_and_place(path, end, condition, time):
    with pytest.raises(InfeasibleReferenceError, match="infeasible at t") as caught:
        plan(path, PAPER_VEHICLE, 0.1 * np.arange(10 * end + 1))
    assert caught.value.condition.startswith(condition)
    assert caught.value.time == pytest.approx(time, abs=0.1)
    assert caught.value.place == tuple(path.derivatives(np.array([caught.value.time]))[0, :, 0])


def test_a_reversal_of_direction_is_refused():
    flat = replace(PATHS["ellipse"], semi_x=5.0, semi_y=1e-9)
    with pytest.raises(InfeasibleReferenceError, match="the path stops, v_p = "):
        plan(flat, PAPER_VEHICLE, 0.1 * np.arange(600))


def test_a_noisy_track_is_refused_with_the_true_reason():
    """Points 1 m apart with half a metre of noise, as a recorded track has them."""
    track = np.stack((np.arange(60.0), np.zeros(60)), axis=1) + np.random.default_rng(0).normal(0, 0.5, (60, 2))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", WaypointWarning)
        path = Spline(tuple(map(tuple, track.tolist())), 0.8)
    with pytest.raises(InfeasibleReferenceError, match=r"more than 90 degrees within one sample: .* points are noisy"):
        plan(path, PAPER_VEHICLE, np.arange(0, path.end, 0.5))


@pytest.mark.parametrize(("name", "unit"), [("F_u", "N"), ("F_r", "N m")])
def test_first_force_beyond_its_limit_is_reported(name, unit):
    path, t = PATHS["figure_eight"], 0.1 * np.arange(600)
    R = plan(path, PAPER_VEHICLE, t)
    largest = {force: float(np.abs(getattr(R, force)).max()) for force in ("F_u", "F_r")}
    assert plan(path, PAPER_VEHICLE, t, tuple(largest.values())).x[-1] == R.x[-1]
    largest[name] *= 0.95
    k = int((np.abs(getattr(R, name)) > largest[name]).argmax())
    message = f"{name} = .* {unit} is beyond its limit of {largest[name]:.4g} {unit}"
    with pytest.raises(InfeasibleReferenceError, match=message) as caught:
        plan(path, PAPER_VEHICLE, t, tuple(largest.values()))
    assert k > 0
    assert caught.value.time == t[k]
    assert caught.value.place == (R.x[k], R.y[k])


@pytest.mark.parametrize("shape", [(4, 2, 1), (3, 2, 50), (8, 50)])
def test_derivatives_of_another_shape_are_refused(shape):
    class Wrong:
        speed, start, end = 1.0, -math.inf, math.inf

        def derivatives(self, t):
            return np.ones(shape)

    with pytest.raises(ValueError, match=r"Wrong.derivatives returns an array of shape .* it must be \(4, 2, \d+\)"):
        plan(Wrong(), PAPER_VEHICLE, 0.1 * np.arange(50))


def test_errors_can_be_pickled():
    error = pickle.loads(pickle.dumps(InfeasibleReferenceError("too fast", 1.5, (2.0, 3.0))))
    assert (error.condition, error.time, error.place) == ("too fast", 1.5, (2.0, 3.0))
    assert str(error) == "infeasible at t = 1.5 s, (x, y) = (2, 3) m: too fast"


@pytest.mark.parametrize(
    ("times", "message"),
    [
        ([0.0], "two or more finite numbers"),
        ([0.0, math.nan], "two or more finite numbers"),
        ([0.2, 0.1, 0.0], "must increase in even steps"),
        ([0.0, 0.1, 0.3], "must increase in even steps"),
        ([-0.1, 0.0, 0.1], r"times -0.1 \.\.\. 0.1 s leave the path's domain, 0 \.\.\."),
        ([0.0, 500.0, 1000.0], r"times 0 \.\.\. 1000 s leave the path's domain, 0 \.\.\."),
    ],
)
def test_bad_times_are_refused(times, message):
    with pytest.raises(ValueError, match=message):
        plan(PATHS["spline"], PAPER_VEHICLE, np.array(times))


def test_a_path_can_be_planned_to_its_end():
    path = PATHS["spline"]
    R = plan(path, PAPER_VEHICLE, np.linspace(0, path.end, 500))
    np.testing.assert_allclose((R.x[-1], R.y[-1]), path.waypoints[-1], rtol=0, atol=1e-9)
    assert plan(path, PAPER_VEHICLE, np.array([1.0, 1.1])).x.shape == (2,)


def test_plans_with_too_many_samples_are_refused():
    for vehicle, steps in ((replace(PAPER_VEHICLE, d22=1e8), 1000), (PAPER_VEHICLE, 3_000_000)):
        with pytest.raises(ValueError, match=r"the plan needs \d+ samples of the path; at most 2097152"):
            plan(Circle(1.0, 0.1), vehicle, 0.1 * np.arange(steps + 1))


def test_references_beyond_the_bounds_are_refused():
    planner = Planner(PAPER_VEHICLE, 0.1 * np.arange(50), most=(1.0, 1.0, 0.5, 1e3, 1e3))
    assert planner.table(Circle(0.9, 0.4)).shape == (50, 8)
    with pytest.raises(ValueError, match=r"^reference r_R reaches 0.6 rad/s; it must be at most 0.5 rad/s$"):
        planner.table(Circle(0.9, 0.6))
    fine, fast = planner.tables(stack([Circle(0.9, 0.4), Circle(0.9, 0.6)]), 2)
    np.testing.assert_array_equal(fine, planner.table(Circle(0.9, 0.4)))
    assert fast is None

"""Plans in space: open-loop integration, the plan of the plane, inclined planes, paths that are refused."""

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import make_interp_spline

from auv_gym.physics.space import Limits, SpaceVehicle, axes, state_rates
from auv_gym.physics.vehicle import PAPER_2007
from auv_gym.planning import planner
from auv_gym.planning.feasibility import InfeasibleReferenceError
from auv_gym.planning.paths import Circle, FigureEight, Lawnmower, Legs, Line, Sine
from auv_gym.planning.paths.space import Climb, Steps, Through, Trefoil, Wave, WithHeight
from auv_gym.planning.space import plan
from auv_gym.scenarios.vehicles import PAPER, vehicle_model

VEHICLES = {"paper": PAPER.in_space, "paper-2007": SpaceVehicle(PAPER_2007, PAPER_2007, 36.0)} | {
    name: vehicle_model(name).in_space for name in ("lauv", "eca-a9", "nps-auv2", "remus100")
}
TIMES = 0.05 * np.arange(1201)
FINE = 0.005 * np.arange(12001)  # |v| v, |r| v and the turns of a lawnmower pattern give the planned forces kinks


def paths(U, turn):
    """Return paths of a speed [m/s] and a turn rate [rad/s]."""
    return {
        "line": WithHeight(Line(U), Climb(0.3 * U)),
        "helix": WithHeight(Circle(U, turn), Climb(-0.25 * U), 3.0),
        "dive and level": WithHeight(Line(U), Steps(((30, -3 * U),), 6.0)),
        "lawnmower": WithHeight(
            Lawnmower(U, 20 * U, 3 * U / turn), Steps(((12, -3 * U), (35, -3 * U), (52, 4 * U)), 8.0)
        ),
        "wave": WithHeight(Sine(U, 0.2 * U / turn, turn), Wave(0.2 * U / turn, turn, 1.0)),
        "knot": Trefoil(U / (1.2 * turn), 0.4 * U / (1.2 * turn), 0.3 * turn, 0.3),
    }


def deviation(path, vehicle, window):
    """Return the largest distance [m] to a path under the planned forces alone, for starts on it in each window [s]."""
    R = plan(path, vehicle, FINE)
    forces = make_interp_spline(R.t, np.stack((R.F_u, R.F_q, R.F_r)).T, k=7)

    def rates(t, state):
        F_u, F_q, F_r = forces(t)
        return state_rates(state, (F_u, 0.0, 0.0, F_q, F_r), vehicle.acting)

    worst, n = 0.0, round(window / FINE[1])
    for k in range(0, len(R.t) - 1, n):
        t = R.t[k : k + n + 1]
        flown = solve_ivp(rates, t[[0, -1]], R.table[k, :10], "DOP853", t[::200], rtol=1e-11, atol=1e-12)
        worst = max(worst, np.linalg.norm(flown.y[:3].T - R.table[k : k + n + 1 : 200, :3], axis=1).max())
    return worst


@pytest.mark.parametrize("path", paths(1.0, 0.1))
@pytest.mark.parametrize(
    ("name", "speed", "window"),
    [  # above 0.68 m/s the paper's vehicle is unstable without control
        ("paper", 0.6, 60),
        ("paper", 1.5, 10),
        ("paper-2007", 1.0, 10),
        ("lauv", 0.8, 60),
        ("eca-a9", 1.0, 60),
        ("nps-auv2", 0.9, 60),
    ],
)
def test_the_planned_forces_alone_keep_the_vehicle_on_its_path(name, speed, window, path):
    chosen, length = paths(speed, 0.02 if name == "nps-auv2" else 0.06)[path], VEHICLES[name].horizontal.length
    assert deviation(chosen, VEHICLES[name], window) < (2e-6 if path == "lawnmower" else 1e-7 * max(1.0, length))


@pytest.mark.parametrize("path", ["line", "helix"])
def test_the_planned_forces_keep_the_remus_100_on_its_path_where_no_turn_rate_changes_its_sign(path):
    """Elsewhere cross-flow |r| v makes the planned torque jump, and its interpolation limits the comparison."""
    assert deviation(paths(1.2, 0.03)[path], VEHICLES["remus100"], 60) < 1e-7


@pytest.mark.parametrize(
    ("flat", "size"),
    [(Line(0.8, heading=0.3), 1e-12), (Circle(0.8, 0.05, heading=-3.1), 1e-12), (Sine(0.9, 3.0, 0.1), 1e-7)],
)
@pytest.mark.parametrize("name", VEHICLES)
def test_a_level_plan_is_that_of_the_plane(name, flat, size):
    """To rounding in steady motion, after the run-in; otherwise to the errors of both integrations."""
    vehicle = VEHICLES[name]
    R, expected = plan(WithHeight(flat, Climb(0.0)), vehicle, TIMES), planner.plan(flat, vehicle.horizontal, TIMES)
    for key in ("x", "y", "psi", "u", "v", "r", "F_u", "F_r"):
        a, b = getattr(R, key)[200:], getattr(expected, key)[200:]
        np.testing.assert_allclose(a, b, rtol=0, atol=size * max(1.0, vehicle.horizontal.m33 * (key[0] == "F")))
    assert not np.abs([R.z, R.theta, R.w, R.q, R.F_q]).any()


@dataclass(frozen=True)
class Inclined:
    """A planar path in a plane that is turned about the x axis."""

    path: Circle
    angle: float
    start: float = -math.inf
    end: float = math.inf

    def derivatives(self, t):
        x, y = np.moveaxis(self.path.derivatives(t), 1, 0)
        return np.stack((x, math.cos(self.angle) * y, math.sin(self.angle) * y), axis=1)


def test_in_an_inclined_plane_a_neutral_body_of_revolution_moves_as_in_a_level_one():
    round_body, circle = replace(VEHICLES["paper-2007"], stiffness=0.0), Circle(1.0, 0.1)
    R, flat = plan(Inclined(circle, 1.0), round_body, TIMES), planner.plan(circle, round_body.horizontal, TIMES)
    np.testing.assert_allclose(R.u, flat.u, atol=1e-9)
    np.testing.assert_allclose(np.hypot(R.v, R.w), np.abs(flat.v), atol=1e-9)
    np.testing.assert_allclose(np.hypot(R.F_q, R.F_r), np.abs(flat.F_r), atol=1e-7)
    np.testing.assert_allclose(R.F_u, flat.F_u, atol=1e-7)
    ahead = np.stack(np.broadcast_arrays(*axes(R.theta, R.psi, np)[0]))
    assert np.abs(ahead[2] * math.cos(1.0) - ahead[1] * math.sin(1.0)).max() < 1e-8  # the axis stays in the plane


DIVE = WithHeight(
    Legs(((0, 0), (11, 0), (30, 8), (60, 8)), 1.0, 5.0), Through((0.0, 10.5, 30.0, 60.0), (-5.0, -7.0, -4.0, -9.0), 3.0)
)


@pytest.mark.parametrize("path", [*paths(1.0, 0.1).values(), DIVE], ids=[*paths(1.0, 0.1), "waypoints"])
def test_derivatives_of_the_paths_are_those_of_their_positions(path):
    t = np.linspace(10.0, 12.0, 201)
    derivatives = path.derivatives(t)
    for k in range(3):
        slope = make_interp_spline(t, derivatives[k].T, k=7).derivative()(t)
        np.testing.assert_allclose(derivatives[k + 1].T, slope, atol=1e-7)


def test_heights_join_times_by_constant_rates():
    """Beside the changes the heights are linear, and in their middle 5/32 of blend times change of rate away."""
    times, heights, blend = DIVE.height.times, DIVE.height.heights, DIVE.height.blend
    middles = 0.5 * np.add(times[1:], times[:-1])
    rates = np.diff(heights) / np.diff(times)
    z, climb, *bend = DIVE.height.derivatives(middles)
    np.testing.assert_allclose(z, np.interp(middles, times, heights), atol=1e-12)
    np.testing.assert_allclose(climb, rates, atol=1e-12)
    np.testing.assert_array_equal(bend, 0.0)
    z = DIVE.height.derivatives(np.array(times))[0]
    np.testing.assert_allclose(z[1:-1] - heights[1:-1], 5 / 32 * blend * np.diff(rates), atol=1e-12)
    assert (z[0], z[-1]) == pytest.approx((heights[0], heights[-1]))


REMUS = vehicle_model("remus100")
REFUSED = {
    "pitch": (WithHeight(Line(0.1), Climb(1.0)), "paper", None, "the pitch exceeds 80 degrees"),
    "loop": (Inclined(Circle(0.5, 0.1), math.pi / 2), "paper", None, "the pitch exceeds 80 degrees"),
    "fins": (
        WithHeight(Line(1.2), Climb(0.35)),
        "remus100",
        REMUS.space_limits,
        r"at a pitch of -18.6 degrees is -1.94\d N m, and the fins give at most 1.56 N m at 1.25 m/s: such a climb",
    ),
    "torque": (WithHeight(Circle(1.2, 0.2), Climb(0.0)), "remus100", REMUS.space_limits, "F_r = .* beyond its limit"),
    "thrust": (
        WithHeight(Line(1.0), Climb(0.1)),
        "paper",
        Limits(F_u_max=20.0),
        "F_u = .* N is beyond its limit of 20 N",
    ),
    "stop": (WithHeight(FigureEight(1e-4, 0.1), Wave(1e-4, 0.1)), "paper", None, "the path stops"),
    "too slow": (
        WithHeight(Line(0.4), Wave(1.0, 0.1)),
        "eca-a9",
        None,
        r"the path climbs or dives below 0.45\d* m/s, where",
    ),
    "braking": (WithHeight(Line(0.3), Wave(5.0, 0.4)), "paper", None, "braking|the pitch exceeds"),
    "sideslip": (
        WithHeight(Circle(0.5, 3.0), Climb(0.0)),
        "paper",
        None,
        "the angle between axis and velocity exceeds 80",
    ),
}


@pytest.mark.parametrize("name", ["lauv", "eca-a9", "nps-auv2", "remus100"])
def test_the_pitch_of_a_slow_climb_grows_towards_the_speed_at_which_the_fins_reverse(name):
    """Lift and side force of the fins balance: lift (climb + theta) = side theta, theta nose down."""
    vehicle, c = VEHICLES[name], VEHICLES[name].vertical
    for share in (1.2, 1.5, 3.0):
        u, per_arm = share * vehicle.reversal_speed, c.eps * c.m22 / c.m33
        R = plan(WithHeight(Line(u), Climb(1e-5 * u)), vehicle, TIMES[:21])
        lift = (c.d22 + c.Y_uv * u) * u + per_arm * (c.d32 + (c.m22 - c.m11 - c.N_uv) * u) * u
        assert R.theta[-1] == pytest.approx(-1e-5 / (1 - vehicle.stiffness * per_arm / lift), rel=1e-3)


@pytest.mark.parametrize("case", REFUSED)
def test_a_path_that_cannot_be_followed_is_refused_with_place_and_reason(case):
    path, name, limits, message = REFUSED[case]
    with pytest.raises(InfeasibleReferenceError, match=message) as error:
        plan(path, VEHICLES[name], TIMES, limits)
    at = error.value.time
    assert len(error.value.place) == 3
    np.testing.assert_allclose(path.derivatives(np.array([at]))[0, :, 0], error.value.place)
    assert "(x, y, z) = (" in str(error.value)


def test_a_climb_at_the_trim_bound_of_the_fins_is_planned():
    plan(WithHeight(Line(1.2), Climb(0.24)), VEHICLES["remus100"], TIMES, REMUS.space_limits)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: plan(Line(1.0), VEHICLES["paper"], TIMES), r"returns an array of shape \(4, 2, "),
        (lambda: plan(Trefoil(1.0, 1.0, 0.1), VEHICLES["paper"], TIMES[::-1]), "times must increase"),
        (lambda: plan(Trefoil(1.0, 1.0, 0.1), VEHICLES["paper"], 1e5 * TIMES), "the plan needs"),
        (lambda: Steps(((1.0, math.nan),), 2.0), "a step must be a time"),
        (lambda: Through((0.0, 5.0), (1.0,), 1.0), "as many heights as times, two or more; there are 1 and 2"),
        (lambda: Through((0.0, 5.0, 6.0), (1.0, 2.0, 3.0), 1.0), "two times are 1 s apart; twice the blend is 2 s"),
        (lambda: Through((0.0, math.inf), (1.0, 2.0), 1.0), "times and heights must be finite"),
        (lambda: Trefoil(-1.0, 1.0, 0.1), "size must be finite and positive"),
    ],
)
def test_wrong_input_is_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()

"""Paths: derivatives against mpmath, smoothness, stacking, invariance, random paths, errors raised."""

import json
import math
import random
import re
import warnings
from dataclasses import asdict, replace

import mpmath as mp
import numpy as np
import pytest
from hypothesis import given, reject, settings
from hypothesis import strategies as st

from auv_gym.physics.vehicle import PAPER_VEHICLE
from auv_gym.planning.paths import (
    PAPER_CIRCLE,
    PATHS,
    Circle,
    Ellipse,
    FigureEight,
    Lawnmower,
    Legs,
    Line,
    Path,
    RandomSmooth,
    Sine,
    Spline,
    WaypointWarning,
    evaluate_paths,
    from_geographic,
    stack,
)
from auv_gym.planning.planner import plan

POSE = {"x0": 3.0, "y0": -2.0, "heading": 0.7}
RANDOM = RandomSmooth(1.1, (0.05, -0.03, 0.02), (0.04, 0.09, 0.13), (0.3, 2.0, 5.0), 0.2, 0.07, 1.0, **POSE)
SAMPLES = (
    Line(1.2, **POSE),
    Circle(0.8, -0.11, **POSE),
    Sine(0.9, 4.0, 0.15, 0.4, **POSE),
    Ellipse(7.0, 4.0, -0.09, 0.3, **POSE),
    FigureEight(9.0, 0.07, 1.3, **POSE),
    Lawnmower(1.3, 20.0, -11.0, **POSE),
    RANDOM,
)
WAYPOINTS = ((0.0, 0.0), (10.0, 2.0), (18.0, 9.0), (30.0, 8.0), (33.0, -4.0), (20.0, -12.0), (7.0, -9.0))
SPEEDS = (0.6, 1.0, 1.2, 0.8, 0.9, 1.1, 0.7)
SPLINES = (
    Spline(WAYPOINTS, 0.9),
    Spline(WAYPOINTS, 0.9, SPEEDS),
    Spline(WAYPOINTS, 0.9, SPEEDS, closed=True),
    Spline(WAYPOINTS[:3], 0.9, SPEEDS[:3]),
    Spline(WAYPOINTS[:2], 0.9, SPEEDS[:2]),
)
RANDOM_FAMILIES = [family for family in PATHS.values() if hasattr(family, "drawn")]


def name_of(path):
    return type(path).__name__


def drawn_paths(family, count, speed=1.0, turn_rate=0.12):
    uniform = random.Random(family.__name__).random
    return [family.drawn(speed, turn_rate, uniform) for _ in range(count)]


def speed_and_turn_rate(d):
    v = np.hypot(*d[1])
    return v, (d[1, 0] * d[2, 1] - d[1, 1] * d[2, 0]) / v**2


# Independent formulas of the position, z = x + iy in the path's own frame, in mpmath.


def sine_position(p, t):
    return mp.mpc(p.speed * t, p.amplitude * mp.sin(p.frequency * t + p.phase))


def ellipse_position(p, t):
    theta = p.frequency * t + p.phase
    return mp.mpc(p.semi_x * mp.cos(theta), p.semi_y * mp.sin(theta))


def figure_eight_position(p, t):
    theta = p.frequency * t + p.phase
    return mp.mpc(p.size * mp.sin(theta), p.size * mp.sin(2 * theta) / 2)


def lawnmower_velocity(p, t):
    def angle(z):
        return mp.pi * z**3 * (10 - 15 * z + 6 * z**2)

    turn = abs(p.spacing) / p.speed / mp.quad(lambda z: mp.sin(angle(z)), [0, 0.5, 1])
    straight = mp.mpf(p.leg) / p.speed
    k = int(mp.floor(t / (straight + turn)))
    bearing = angle(max((t - k * (straight + turn) - straight) / turn, 0))
    side = (-1 if k % 2 else 1) * mp.sign(p.spacing)
    return p.speed * (-1 if k % 2 else 1) * mp.expj(side * bearing)


def random_smooth_velocity(p, t):
    turns = zip(p.turn_rates, p.frequencies, p.phases, strict=True)
    bearing = sum(mp.quad(lambda s, A=A, w=w, b=b: A * mp.sin(w * s + b), [0, t]) for A, w, b in turns)
    return p.speed * (1 + p.speed_variation * mp.sin(p.speed_frequency * t + p.speed_phase)) * mp.expj(bearing)


POSITIONS = {
    Line: lambda p, t: mp.mpc(p.speed * t),
    Circle: lambda p, t: p.speed * (mp.expj(p.turn_rate * t) - 1) / mp.mpc(0, p.turn_rate),
    Sine: sine_position,
    Ellipse: ellipse_position,
    FigureEight: figure_eight_position,
}
VELOCITIES = {Lawnmower: lawnmower_velocity, RandomSmooth: random_smooth_velocity}


def reference(path, t):
    """Return position and three derivatives, (4, 2), by numerical differentiation with 40 digits."""
    with mp.workdps(40):
        if type(path) in POSITIONS:
            z = [mp.diff(lambda s: POSITIONS[type(path)](path, s), mp.mpf(t), n) for n in range(4)]
        else:
            z = [0, *(mp.diff(lambda s: VELOCITIES[type(path)](path, s), mp.mpf(t), n) for n in range(3))]
        z = [mp.expj(path.heading) * value for value in z]
        z[0] += mp.mpc(path.x0, path.y0)
        return np.array([[float(value.real), float(value.imag)] for value in z])


@pytest.mark.parametrize("path", SAMPLES, ids=name_of)
def test_derivatives_equal_numerical_ones(path):
    times = np.array([-50.3, -7.0, 0.0, 2.7, 31.1, 77.7])
    expected = np.stack([reference(path, t) for t in times], axis=-1)
    first = 0 if type(path) in POSITIONS else 1
    np.testing.assert_allclose(path.derivatives(times)[first:], expected[first:], rtol=1e-13, atol=1e-13)


@pytest.mark.parametrize("path", [p for p in SAMPLES if type(p) in VELOCITIES], ids=name_of)
@pytest.mark.parametrize("until", [-23.0, 11.0, 64.0])
def test_position_is_the_integral_of_velocity(path, until):
    edges = np.linspace(0.0, until, 2001)  # fine enough for the jumps of the Lawnmower's fourth derivative
    nodes, weights = np.polynomial.legendre.leggauss(8)
    t = edges[:-1, None] + np.diff(edges)[:, None] * (nodes + 1) / 2
    order = np.argsort(t.ravel())
    velocity = np.empty((2, t.size))
    velocity[:, order] = path.derivatives(t.ravel()[order])[1]
    moved = (velocity.reshape(2, *t.shape) @ weights).sum(axis=1) * (edges[1] - edges[0]) / 2
    np.testing.assert_allclose(path.derivatives(until)[0], np.add([POSE["x0"], POSE["y0"]], moved), atol=2e-12)


@given(
    rates=st.tuples(*[st.floats(-0.3, 0.3)] * 3),
    frequencies=st.tuples(*[st.floats(0.01, 1.0)] * 3),
    spacing=st.floats(0.01, 30.0),
    first=st.floats(-40.0, 40.0),
)
@settings(max_examples=50, deadline=None)
def test_random_smooth_does_not_depend_on_the_spacing_of_times(rates, frequencies, spacing, first):
    path = RandomSmooth(1.0, rates, frequencies, (0.1, 2.0, 4.0), speed_frequency=0.3)
    times = first + spacing * np.arange(5)
    fine = np.linspace(first, times[-1], 2001)
    np.testing.assert_allclose(path.derivatives(times), path.derivatives(fine)[:, :, ::500], atol=2e-12)
    one_by_one = np.stack([path.derivatives(t) for t in times], axis=-1)
    np.testing.assert_allclose(path.derivatives(times), one_by_one, atol=2e-12)


@pytest.mark.parametrize("path", SAMPLES, ids=name_of)
def test_pose_moves_and_turns_the_derivatives(path):
    t = np.linspace(-20.0, 90.0, 23)
    c, s = math.cos(path.heading), math.sin(path.heading)
    expected = np.einsum("ij,kjt->kit", [[c, -s], [s, c]], replace(path, x0=0.0, y0=0.0, heading=0.0).derivatives(t))
    expected[0] += [[path.x0], [path.y0]]
    np.testing.assert_allclose(path.derivatives(t), expected, atol=1e-13)


def test_paper_circle():
    t = np.linspace(0.0, 600.0, 61)
    expected = 10 * np.array([np.sin(0.01 * t), np.cos(0.01 * t)])
    np.testing.assert_allclose(PAPER_CIRCLE.derivatives(t)[0], expected, atol=1e-14)


def test_lawnmower_is_continuous_and_has_constant_speed():
    path = Lawnmower(1.3, 20.0, -11.0, **POSE)
    leg, period = 20.0 / 1.3, 20.0 / 1.3 + path.turn_time
    joins = np.array([k * period + offset for k in range(-2, 3) for offset in (0.0, leg)])
    before, after = path.derivatives(joins - 1e-9), path.derivatives(joins + 1e-9)
    np.testing.assert_allclose(after, before, atol=1e-8)
    speed, turn_rate = speed_and_turn_rate(path.derivatives(np.linspace(-2 * period, 2 * period, 4001)))
    np.testing.assert_allclose(speed, 1.3, rtol=1e-14)
    assert np.abs(turn_rate).max() == pytest.approx(15 * math.pi / (8 * path.turn_time), rel=1e-6)


def test_lawnmower_legs_are_aligned_and_spaced():
    path = Lawnmower(0.5, leg=12.0, spacing=5.0)
    period = 12.0 / 0.5 + path.turn_time
    starts = path.derivatives(period * np.arange(-1, 4) + 1e-12)[0]
    np.testing.assert_allclose(starts, [[12, 0, 12, 0, 12], [-5, 0, 5, 10, 15]], atol=1e-11)


def test_figure_eight_has_the_documented_extremes():
    speed, turn_rate = speed_and_turn_rate(FigureEight(1.0, 1.0).derivatives(np.linspace(0.0, 2 * math.pi, 20001)))
    assert speed.min() == pytest.approx(math.sqrt(7) / 4, rel=1e-6)
    assert speed.max() == pytest.approx(math.sqrt(2), rel=1e-6)
    assert 3.17 < np.abs(turn_rate).max() < 3.18


# Splines


@pytest.mark.parametrize("path", SPLINES)
def test_spline_passes_its_waypoints_at_their_speeds(path):
    count = len(path.waypoints)
    position, velocity, *_ = path.derivatives(path.arrivals)
    np.testing.assert_allclose(position.T[:count], path.waypoints, atol=1e-12)
    np.testing.assert_allclose(np.hypot(*velocity)[:count], path.speeds or path.speed, rtol=1e-12)
    assert path.arrivals[0] == path.start == 0
    assert path.arrivals[-1] == path.end


@pytest.mark.parametrize("path", SPLINES)
def test_spline_derivatives_equal_finite_differences(path):
    inside = np.concatenate(
        [np.linspace(a + 0.3, b - 0.3, 4) for a, b in zip(path.arrivals, path.arrivals[1:], strict=False)]
    )
    h = 0.02
    weights = np.array([-1 / 60, 3 / 20, -3 / 4, 0, 3 / 4, -3 / 20, 1 / 60]) / h  # sixth order
    around = path.derivatives(inside[:, None] + h * np.arange(-3, 4))
    np.testing.assert_allclose(around[:3] @ weights, around[1:, :, :, 3], atol=1e-9)


@pytest.mark.parametrize("path", SPLINES)
def test_spline_is_continuous_across_its_knots(path):
    knots = path.arrivals[1:-1]
    before, after = path.derivatives(knots - 1e-8), path.derivatives(knots + 1e-8)
    np.testing.assert_allclose(after, before, atol=1e-7)


def test_closed_spline_returns_with_all_derivatives():
    path = SPLINES[2]
    np.testing.assert_allclose(path.derivatives(path.end), path.derivatives(0.0), atol=1e-11)


def test_open_spline_starts_and_ends_straight():
    _, turn_rate = speed_and_turn_rate(SPLINES[1].derivatives(np.array([0.0, SPLINES[1].end])))
    np.testing.assert_allclose(turn_rate, 0, atol=1e-12)


def test_spline_through_points_of_a_circle_is_a_circle():
    angles = 2 * math.pi * np.arange(24) / 24
    path = Spline(tuple(zip(20 * np.cos(angles), 20 * np.sin(angles), strict=True)), 0.5, closed=True)
    speed, turn_rate = speed_and_turn_rate(path.derivatives(np.linspace(0.0, path.end, 101)))
    np.testing.assert_allclose(speed, 0.5, rtol=1e-12)
    np.testing.assert_allclose(turn_rate, 0.5 / 20, rtol=1e-3)
    assert path.end == pytest.approx(2 * math.pi * 20 / 0.5, rel=1e-5)


@given(st.lists(st.tuples(st.floats(1.0, 9.0), st.floats(-6.0, 6.0), st.floats(0.6, 1.0)), min_size=2, max_size=8))
@settings(max_examples=30, deadline=None)
def test_spline_time_law_holds_for_random_waypoints(steps):
    points = tuple((float(x), y) for x, (_, y, _) in zip(np.cumsum([dx for dx, _, _ in steps]), steps, strict=True))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", WaypointWarning)
            path = Spline(points, 1.0, tuple(v for _, _, v in steps))
    except ValueError as refused:  # with uneven legs the interpolated speed may become negative
        if "the speed must stay positive" in str(refused):
            reject()
        raise
    position, velocity, *_ = path.derivatives(path.arrivals)
    np.testing.assert_allclose(position.T, points, atol=1e-10)
    np.testing.assert_allclose(np.hypot(*velocity), path.speeds, rtol=1e-10)


# Missions

LAWN = (0, 0), (60, 0), (60, 12), (0, 12), (0, 24), (60, 24), (60, 36), (0, 36)
MISSIONS = [
    Legs(LAWN, 1.0, 3.0),
    Legs(LAWN, 1.0, 3.0, speeds=(1.0, 0.5, 1.2, 0.6, 1.0, 1.0, 0.7)),
    Legs(LAWN[:4], 0.8, 3.0, closed=True),
    Legs(((0, 0), (20, 5), (30, 25), (10, 40)), 0.8, 4.0, speeds=(0.8, 0.6, 0.9, 0.7), closed=True),
    Legs(((0, 0), (40, 0), (80, 0)), 1.0, 5.0, speeds=(0.5, 1.0)),
]


@pytest.mark.parametrize("path", MISSIONS, ids=str)
def test_missions_are_three_times_differentiable(path):
    """Compared with differences, also across the ends of corners."""
    t, h = np.linspace(1.0, path.end - 1.0, 3001), 1e-4
    given, before, after = (path.derivatives(times) for times in (t, t - h, t + h))
    for n in range(3):
        atol = 1e-8 if n < 2 else 1e-5  # the third derivative is continuous, and its slope is not
        np.testing.assert_allclose((after[n] - before[n]) / (2 * h), given[n + 1], atol=atol)
    assert np.hypot(*path.derivatives(np.linspace(0, path.end, 999))[1]).min() > 0.45


@pytest.mark.parametrize("path", MISSIONS[:4], ids=str)
def test_missions_keep_to_their_legs_and_corners_to_their_radius(path):
    d = path.derivatives(np.linspace(0.0, path.end, 20_001))
    points = np.array(path.waypoints)
    ends = np.roll(points, -1, axis=0) if path.closed else points[1:]
    begins = points if path.closed else points[:-1]
    along = ends - begins
    share = np.clip(((d[0].T[:, None] - begins) * along).sum(-1) / (along**2).sum(-1), 0, 1)
    beside = np.hypot(*np.moveaxis(d[0].T[:, None] - begins - share[..., None] * along, -1, 0)).min(axis=1)
    curvature = (d[1, 0] * d[2, 1] - d[1, 1] * d[2, 0]) / np.hypot(*d[1]) ** 3
    assert beside[np.abs(curvature) < 1e-9].max() < 1e-9
    assert beside.max() < path.radius
    assert 1 / np.abs(curvature).max() == pytest.approx(path.radius, rel=1e-5)
    np.testing.assert_allclose(path.derivatives(np.array([0.0, path.end]))[0, :, 1], d[0, :, -1])
    if path.closed:
        np.testing.assert_allclose(d[:, :, 0], d[:, :, -1], atol=1e-9)
    else:
        np.testing.assert_allclose((d[0, :, 0], d[0, :, -1]), (points[0], points[-1]), atol=1e-9)
    assert len(path.arrivals) == len(points)


def test_a_lawnmower_of_legs_can_be_planned_and_is_shorter_than_its_spline():
    legs, table = MISSIONS[0], plan(MISSIONS[0], PAPER_VEHICLE, 0.1 * np.arange(int(10 * MISSIONS[0].end))).table
    assert np.isfinite(table).all()
    with pytest.warns(WaypointWarning, match=r"the curve is 32\d.* m long, the polygon of its waypoints 276 m; `Legs`"):
        spline = Spline(LAWN, 1.0)
    assert legs.end < 276 < spline.end


@pytest.mark.parametrize("offset", [(5e5, 6.58e6), (-1e7, 3e7)])
@pytest.mark.parametrize("family", [lambda points: Legs(points, 1.0, 2.0), lambda points: Spline(points, 1.0)])
def test_paths_do_not_depend_on_the_origin(family, offset):
    """As with UTM, whose northings are millions of metres."""
    near, far = family(WAYPOINTS), family(tuple((x + offset[0], y + offset[1]) for x, y in WAYPOINTS))
    t = np.linspace(0, near.end, 301)
    assert far.end == pytest.approx(near.end, rel=1e-8)
    np.testing.assert_allclose(
        far.derivatives(t * far.end / near.end)[0].T - offset, near.derivatives(t)[0].T, atol=1e-6
    )


def test_doubled_and_near_waypoints_are_left_out_with_a_word():
    points = (0, 0), (0.0, 1e-9), (10, 0), (10.05, 0), (20, 5)
    for family, rest in ((Spline, ()), (Legs, (2.0, (0.5, 0.6, 0.7, 0.8)))):
        with pytest.warns(WaypointWarning, match=r"nearer than 0\.1 m to the one before: waypoint 1, 3"):
            path = family(points, 1.0, *rest)
        assert path.waypoints == ((0, 0), (10, 0), (20, 5))
    assert path.speeds == (0.6, 0.8)
    with pytest.warns(WaypointWarning, match="the one before: waypoint 3$"):
        assert len(Legs(((0, 0), (9, 0), (5, 9), (0, 0)), 1.0, 0.5, closed=True).waypoints) == 3


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((((0, 0), (10, 0), (0, 0)), 1.0, 1.0), "Legs: the path turns back at waypoint 1; a vehicle that cannot turn"),
        ((LAWN, 1.0, 5.0), r"the leg from waypoint 1 to 2 has 12 m, .* need 17.33 m; a radius of 3.46[12] m would fit"),
        ((LAWN, 1.0, 0.0), "Legs: radius must be finite and positive, got 0.0"),
        ((LAWN, 1.0, 3.0, (1.0, 2.0)), r"Legs: speeds must be none or one for each of 7 legs, got \(1.0, 2.0\)"),
        ((LAWN[:3], 1.0, 3.0, (1.0, -2.0)), "Legs: speeds must be finite and positive, got -2.0 on leg 1"),
    ],
)
def test_wrong_missions_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        Legs(*arguments)


def test_geographic_coordinates_become_metres():
    """Compared with the radii of curvature of WGS 84 at 59.9 degrees, and with the way there and back."""
    phi, e_2 = math.radians(59.9), 0.00669437999014
    meridian = 6378137.0 * (1 - e_2) / (1 - e_2 * math.sin(phi) ** 2) ** 1.5
    parallel = 6378137.0 / math.sqrt(1 - e_2 * math.sin(phi) ** 2) * math.cos(phi)
    step = math.radians(1e-3)
    xy = from_geographic([59.9, 59.901, 59.9], [10.7, 10.7, 10.701])
    np.testing.assert_allclose(xy, [[0, 0], [0, meridian * step], [parallel * step, 0]], rtol=1e-5, atol=1e-3)
    shifted = from_geographic([59.9], [10.701], origin=(59.9, 10.7))
    np.testing.assert_allclose(shifted, xy[2:], atol=1e-9)
    for wrong, message in (([91.0], "latitude of point 0 is 91.0"), ([math.nan], "latitude of point 0 is nan")):
        with pytest.raises(ValueError, match=message):
            from_geographic(wrong, [0.0])


# Stacking


@pytest.mark.parametrize("family", RANDOM_FAMILIES)
def test_stack_equals_single_paths(family):
    paths, t = drawn_paths(family, 5), np.linspace(-10.0, 80.0, 91)
    single = np.stack([path.derivatives(t) for path in paths], axis=-1)
    stacked = stack(paths).derivatives(t[:, None])
    assert stacked.shape == (4, 2, 91, 5)
    np.testing.assert_allclose(stacked, single, rtol=1e-13, atol=1e-12 if family is RandomSmooth else 1e-13)
    np.testing.assert_allclose(stack(paths).speed, [path.speed for path in paths], rtol=1e-15)


def test_evaluate_paths_keeps_the_order_of_families():
    class Own:
        speed, start, end = 1.0, -math.inf, math.inf

        def derivatives(self, t):
            return np.array([[t, t * t], [t**0, 2 * t], [0 * t, 2 * t**0], [0 * t, 0 * t]])

    paths = (SAMPLES[1], SPLINES[0], SAMPLES[6], replace(SAMPLES[1], turn_rate=0.3), Own(), SAMPLES[0])
    t = np.linspace(0.0, 40.0, 41)
    single = np.stack([path.derivatives(t) for path in paths], axis=-1)
    np.testing.assert_allclose(evaluate_paths(paths, t), single, rtol=1e-13, atol=1e-12)
    assert evaluate_paths((), t).shape == (4, 2, 41, 0)


@pytest.mark.parametrize("path", [*SAMPLES, SPLINES[0]], ids=name_of)
def test_shapes_and_protocol(path):
    assert isinstance(path, Path)
    assert type(path)(**json.loads(json.dumps(asdict(path)))) == path
    for shape in ((), (1,), (7,), (7, 1), (0,)):
        t = np.linspace(1.0, 2.0, math.prod(shape)).reshape(shape)
        assert path.derivatives(t).shape == (4, 2, *shape)


# Random paths


@pytest.mark.parametrize("family", RANDOM_FAMILIES)
@pytest.mark.parametrize(("speed", "turn_rate"), [(0.2, 0.04), (1.0, 0.12)])
def test_random_paths_have_the_speed_and_limited_turn_rates(family, speed, turn_rate):
    paths = drawn_paths(family, 200, speed, turn_rate)
    d = evaluate_paths(paths, np.linspace(0.0, 20 / turn_rate, 801))
    v, rate = speed_and_turn_rate(d)
    peak = np.abs(rate).max(axis=0)
    braking = np.abs((d[1] * d[2]).sum(axis=0) / v**2)
    np.testing.assert_allclose([path.speed for path in paths], speed, rtol=1e-13)
    limit = {FigureEight: 1.75, Sine: 0.8001}.get(family, 1.0 + 1e-12) * turn_rate
    assert peak.max() <= limit
    assert family is Line or peak.min() > 0.2 * turn_rate
    assert braking.max() < (1.2 if family is FigureEight else 0.85) * turn_rate
    assert 0.54 * speed < v.min() <= v.max() < 1.42 * speed
    headings = np.array([path.heading for path in paths])
    assert np.all((headings >= 0) & (headings < 2 * math.pi))
    assert np.abs(np.exp(1j * headings).mean()) < 0.2


@pytest.mark.parametrize(("family", "field"), [(Circle, "turn_rate"), (Ellipse, "frequency"), (Lawnmower, "spacing")])
def test_random_paths_turn_in_both_directions(family, field):
    assert 30 < sum(getattr(path, field) > 0 for path in drawn_paths(family, 100)) < 70


# Errors

POSITIVE = {"speed", "semi_x", "semi_y", "size", "leg", "frequencies"}
NOT_ZERO = {Circle: "turn_rate", Ellipse: "frequency", FigureEight: "frequency", Lawnmower: "spacing"}


@pytest.mark.parametrize("path", SAMPLES, ids=name_of)
def test_wrong_fields_are_refused(path):
    """Each field must be finite, some of them positive, and some not zero; three fields are three numbers."""
    for name, value in asdict(path).items():
        wrong = [math.nan, math.inf, "fast", None, True] + [0.0, -1.0] * (name in POSITIVE)
        wrong += [0.0] * (name == NOT_ZERO.get(type(path)))
        for bad in wrong if isinstance(value, float) else [(0.1, 0.2), 0.1, *((0.1, 0.2, x) for x in wrong)]:
            with pytest.raises(ValueError, match=re.escape(f"{name_of(path)}: {name} must be")) as caught:
                replace(path, **{name: bad})
            assert str(caught.value).endswith(f", got {bad!r}")
    with pytest.raises(ValueError, match=r"RandomSmooth: speed_variation must be in \[0, 1\), got 1\.0"):
        replace(RANDOM, speed_variation=1.0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((((0, 0),), 1.0), r"waypoints must be 2 or more pairs \(x, y\), got \(\(0, 0\),\)"),
        ((((0, 0), (1, 0)), 1.0, (), True), r"waypoints must be 3 or more pairs"),
        ((((0, 0, 0), (1, 0, 0)), 1.0), r"waypoints must be 2 or more pairs"),
        ((((0, 0), (1,)), 1.0), r"waypoints must be 2 or more pairs"),
        (("here", 1.0), r"waypoints must be 2 or more pairs \(x, y\), got 'here'"),
        ((((0, 0), (1, math.nan)), 1.0), r"waypoints must be finite, got \[1\.0, nan\] at waypoint 1"),
        ((((0, 0), (0, 0)), 1.0), r"the waypoints are at most 0 m apart: they are one point"),
        ((((59.9, 10.7), (59.9001, 10.7003)), 1.0), r"at most 0\.0003 m .* are these degrees\? .* `from_geographic`"),
        ((WAYPOINTS, 0.0), r"Spline: speed must be finite and positive, got 0\.0"),
        ((WAYPOINTS, (1.0, 2.0)), r"Spline: speed must be finite and positive, got \(1\.0, 2\.0\)"),
        ((WAYPOINTS, 1.0, (1.0, 2.0)), r"speeds must be none or one for each of 7 waypoints, got \(1\.0, 2\.0\)"),
        ((WAYPOINTS, 1.0, 2.0), r"speeds must be none or one for each of 7 waypoints, got 2\.0"),
        ((WAYPOINTS[:2], 1.0, (1.0, -2.0)), r"speeds must be finite and positive, got -2\.0 at waypoint 1"),
        ((WAYPOINTS[:4], 1.0, (2.0, 0.01, 0.01, 2.0)), r"must stay positive, got -.* between waypoints 1 and 2"),
        ((((0, 0), (5, 0), (0, 0)), 1.0), r"reverses its direction near waypoint 1, \(5\.0, 0\.0\)"),
    ],
)
def test_wrong_splines_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        Spline(*arguments)


@pytest.mark.parametrize("t", [-0.1, 1e6, math.nan])
def test_spline_refuses_times_outside_its_domain(t):
    with pytest.raises(ValueError, match=r"times must be in 0 \.\.\. .* s, got"):
        SPLINES[0].derivatives(np.array([1.0, t]))


@pytest.mark.parametrize("paths", [(), SAMPLES[:2], SPLINES[:2]])
def test_stack_refuses_other_sequences_of_paths(paths):
    with pytest.raises(ValueError, match=r"stack takes paths of one family out of Circle, .*, got"):
        stack(paths)

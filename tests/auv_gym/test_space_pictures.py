"""Pictures of motion in space: the view from above and that from the side, and pictures of the plane as before."""

import math

import gymnasium as gym
import numpy as np
import pytest
from pictures import SIZE, VIEW, count

from auv_gym.envs.space import UnderactuatedAUVTrack3DEnv
from auv_gym.physics.space import axes
from auv_gym.rendering import Renderer, View, two_planes
from auv_gym.rendering.canvas import PLAN, VEHICLE, WHITE

MAP, SIDE = (slice(100, 180), slice(150, 320)), slice(240, 360)  # without cards; below
ABOVE = VIEW._replace(force=(7.0, 20.0, -0.5), force_limits=(200.0, 40.0, 50.0), title="space-calm")
DOWN = np.array((0.0, 20.0))
DEEP = ABOVE._replace(path=VIEW.path - DOWN, trail=VIEW.trail - DOWN, state=(-1.5, -19.5, 0.3, 1.0, 0.0, 0.0))
DEEP = DEEP._replace(reference=(1.5, -19.5, 0.2))


def drawn(view=ABOVE, side=DEEP):
    """Return the first picture of both views."""
    return Renderer("rgb_array", 20.0, SIZE).draw(view, side)


def test_each_view_shows_its_own_plane():
    first = drawn()
    deeper = drawn(side=DEEP._replace(state=(-1.5, -22.0, 0.3, 1.0, 0.0, 0.0)))
    aside = drawn(ABOVE._replace(state=(-1.5, 2.5, 0.0, 0.1, 0.0, 0.0)))
    assert first.shape == (360, 480, 3)
    np.testing.assert_array_equal(first[MAP], deeper[MAP])
    np.testing.assert_array_equal(first[SIDE], aside[SIDE])
    for other, place in ((deeper, SIDE), (aside, MAP)):
        assert (first[place] != other[place]).any()
    for color in (VEHICLE, PLAN):
        assert count(first[SIDE], color) > 0
    assert (first[:90, :130] != deeper[:90, :130]).any()  # the depth as a number


def test_the_air_is_above_the_surface():
    """Half the height of the view from the side shows 8 m."""
    near = DEEP._replace(state=(0.0, -1.0, 0.0, 1.0, 0.0, 0.0), reference=(0.0, -1.0, 0.0))
    above, below = (drawn(side=near)[rows, 250:400] for rows in (slice(245, 285), slice(300, 355)))
    assert count(above, WHITE, 0) > 0.8 * above.shape[0] * above.shape[1]
    assert count(below, WHITE, 0) == 0
    assert count(drawn()[SIDE, 250:400], WHITE, 0) == 0


def test_both_planes_are_projections():
    """Against projections of vectors on a straight way that climbs, in any direction."""
    rng = np.random.default_rng(0)
    course, slope, n = 2.1, 0.3, 40
    ahead = np.array((math.cos(course), math.sin(course)))
    distance = np.linspace(0.0, 50.0, n)
    path = np.column_stack((distance[:, None] * ahead, -30 + slope * distance, np.full((n, 2), (-0.29, course))))
    states, vectors = rng.uniform(-1.0, 1.0, (5, 10)), rng.uniform(-1.0, 1.0, (5, 3))
    above, side = two_planes(states, path, vectors, 7)
    for k, state in enumerate(states):
        velocity = np.array(axes(*state[3:5])).T @ state[5:8]
        for plane, matrix in ((above, np.eye(2, 3)), (side, np.array([[*ahead, 0.0], [0.0, 0.0, 1.0]]))):
            x, y, psi, u, v, _ = plane.states[k]
            turn = np.array([[math.cos(psi), -math.sin(psi)], [math.sin(psi), math.cos(psi)]])
            np.testing.assert_allclose([x, y], matrix @ state[:3], atol=1e-12)
            np.testing.assert_allclose(turn @ (u, v), matrix @ velocity, atol=1e-12)
            np.testing.assert_allclose(plane.vectors[k], matrix @ vectors[k], atol=1e-12)
            np.testing.assert_allclose(plane.path[:, :2], path[:, :3] @ matrix.T, atol=1e-12)
    np.testing.assert_array_equal(side.states[:, 2], -states[:, 3])  # positive nose up


@pytest.mark.parametrize("size", [(480, 360), (84, 84)])
def test_environments_in_space_draw_both_views(size, monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    env = gym.make("auv_gym:UnderactuatedAUVTrack3D-space-storm-v0", render_mode="rgb_array", render_size=size)
    env.reset(seed=0)
    first = env.render()
    for _ in range(10):
        env.step(np.array([0.5, -0.2, 0.1], dtype=np.float32))
    second, height = env.render(), round(2 / 3 * size[1])
    assert first.shape == (*size[::-1], 3)
    for part in (slice(0, height), slice(height, None)):
        assert (first[part] != second[part]).any()
    window = UnderactuatedAUVTrack3DEnv(render_mode="human", render_size=size)
    window.reset(seed=0)
    assert window.render() is None
    window.close()


def test_pictures_of_the_plane_are_those_of_its_view():
    env = gym.make("auv_gym:UnderactuatedAUVTrack-v0", scenario="cruise-storm", render_mode="rgb_array").unwrapped
    env.reset(seed=6)
    renderer, act = Renderer("rgb_array", 10.0), env.scenario.actuators
    path, trail = env._path[:, :2], []
    for k in range(12):
        trail.append(env.state[:2])
        view = View(
            env.time, tuple(env.state), env.reference[:3], path, k, np.array(trail), tuple(env.current),
            tuple(env.force), (act.F_u_max, act.F_r_max), env._info["position_error"], "cruise-storm",
        )  # fmt: skip
        np.testing.assert_array_equal(env.render(), renderer.draw(view))
        env.step(np.array([0.5, 0.3], dtype=np.float32))

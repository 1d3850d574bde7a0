"""Pictures: shape, determinism, contents, independence of a display, windows."""

from __future__ import annotations

import math
import os
import re
import subprocess
import sys
import time

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import DependencyNotInstalled
from pictures import SIZE, VIEW, count

from auv_gym.rendering import Renderer, View
from auv_gym.rendering.canvas import ALERT, CURRENT_COLOUR, INK, PLAN, VEHICLE, WHITE

pygame = pytest.importorskip("pygame")


def picture(view: View = VIEW, size: tuple[int, int] = SIZE) -> np.ndarray:
    """Return the first picture of a new renderer."""
    array = Renderer("rgb_array", fps=20.0, size=size).draw(view)
    assert array is not None
    return array


@pytest.fixture
def human(monkeypatch):
    """Yield a renderer with a window on the dummy display of SDL."""
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    renderer = Renderer("human", fps=200.0, size=SIZE)
    yield renderer
    renderer.close()


@pytest.mark.parametrize("size", [(480, 360), (301, 202), (960, 720)])
def test_pictures_are_contiguous_arrays_and_not_reused(size):
    renderer = Renderer("rgb_array", fps=20.0, size=size)
    first = renderer.draw(VIEW)
    assert first.shape == (size[1], size[0], 3)
    assert first.dtype == np.uint8
    assert first.flags.c_contiguous
    assert first.flags.writeable
    kept = first.copy()
    renderer.draw(VIEW._replace(time=4.0, state=(0.0, 2.0, 1.0, 0.1, 0.0, 0.0)))
    np.testing.assert_array_equal(first, kept)


def test_the_same_views_give_the_same_pictures():
    views = [VIEW._replace(time=0.1 * k, state=(-1.5 + 0.3 * k, 0.5, 0.1 * k, 1.0, 0.1, 0.1)) for k in range(5)]
    runs = [[renderer.draw(view) for view in views] for renderer in (Renderer("rgb_array", 20.0, SIZE) for _ in "ab")]
    np.testing.assert_array_equal(runs[0], runs[1])
    assert not np.array_equal(runs[0][0], runs[0][-1])


@pytest.mark.parametrize("start", [0.0, 3.0])
def test_a_new_episode_does_not_depend_on_the_last_one(start):
    renderer = Renderer("rgb_array", 20.0, SIZE)
    renderer.draw(VIEW._replace(state=(40.0, 9.0, 1.0, 2.0, 0.0, 0.0)))
    again = VIEW._replace(time=start)
    np.testing.assert_array_equal(renderer.draw(again), picture(again))


def test_position_of_the_vehicle_in_the_picture():
    # Half the height shows 8 m, the middle is (0, 0.5): 22.5 px/m, x to the right.
    array = picture(VIEW._replace(state=(-1.5, 0.5, 0.5 * math.pi, 0.0, 0.0, 0.0)))
    row, column = 180, 240 - round(22.5 * 1.5)
    assert count(array[row - 4 : row + 5, column - 4 : column - 1], VEHICLE, tolerance=40) > 0
    mirrored = array[row - 4 : row + 5, 2 * 240 - column - 4 : 2 * 240 - column + 5]
    assert count(mirrored, VEHICLE, tolerance=40) == 0


def test_y_points_up_and_angles_turn_counter_clockwise():
    up = picture(VIEW._replace(state=(0.0, 0.0, 0.5 * math.pi, 0.0, 0.0, 0.0), reference=(0.0, 3.0, 0.0)))
    columns = slice(236, 245)
    assert count(up[190:240, columns], VEHICLE) > count(up[120:170, columns], VEHICLE)  # vehicle below its reference
    beside = slice(240 + 6, 240 + 9)  # only the dark fins reach that far from the axis
    assert count(up[214 + 12 : 214 + 22, beside], INK, tolerance=30) > 0  # the stern is below the middle, row 214
    assert count(up[214 - 22 : 214 - 12, beside], INK, tolerance=30) == 0


def test_arrows_are_drawn_if_there_is_a_current():
    calm = picture()
    flowing = picture(VIEW._replace(current=(0.03, 0.04)))
    assert count(calm, CURRENT_COLOUR) == 0
    assert count(flowing, CURRENT_COLOUR) > 0  # the arrow of the legend
    middle = slice(100, 260), slice(0, 480)
    assert not np.array_equal(calm[middle], flowing[middle])  # arrows in the scene


def test_saturated_bar_turns_red():
    bars = slice(296, 354), slice(326, 474)
    free = count(picture()[bars], ALERT)
    assert count(picture(VIEW._replace(force=(-200.0, 50.0)))[bars], ALERT) > free + 200
    assert count(picture(VIEW._replace(force_limits=(math.inf, math.inf)))[bars], ALERT) == 0


def test_path_ahead_is_darker_than_the_path_done():
    array = picture(VIEW._replace(state=(0.0, 3.0, 0.0, 0.0, 0.0, 0.0), reference=(0.0, 0.5, 0.0)))
    row = slice(200, 216)
    assert count(array[row, 300:470], PLAN, tolerance=60) > 100
    assert count(array[row, 10:180], PLAN, tolerance=60) == 0


@pytest.mark.parametrize("error", [0.0, 1.0, 30.0, 1e5])
def test_vehicle_and_reference_stay_in_the_picture(error):
    renderer = Renderer("rgb_array", 20.0, SIZE)
    renderer.draw(VIEW)
    renderer.draw(VIEW._replace(time=3.05, reference=(-1.5 + error, 0.5, 0.0), position_error=error))
    for point in ((-1.5, 0.5), (-1.5 + error, 0.5)):
        place = renderer._camera.project(point)
        assert ((place > 40.0) & (place < renderer._canvas.extent - 40.0)).all()


def test_zoom_is_smooth():
    renderer = Renderer("rgb_array", 20.0, SIZE)
    scales = []
    for k in range(40):
        x = 9.0 if k >= 10 else 6.0  # the reference jumps once, within the picture
        renderer.draw(VIEW._replace(time=0.05 * k, state=(0.0, 0.0, 0.0, 0.0, 0.0, 0.0), reference=(x, 0.0, 0.0)))
        scales.append(renderer._camera.scale)
    steps = np.abs(np.diff(np.log(scales)))
    assert 0.0 < steps.max() < 0.02


def test_empty_and_single_points_are_drawn():
    picture(VIEW._replace(path=np.zeros((0, 2)), trail=np.zeros((0, 2)), current=(1e-9, 0.0)))
    picture(VIEW._replace(path=np.zeros((1, 2)), trail=np.zeros((1, 2)), title="a rather long name of a scenario"))


def test_import_is_lazy_and_arrays_need_no_display():
    code = (
        "import sys, numpy as np, auv_gym.rendering as r; assert 'pygame' not in sys.modules;"
        "v = r.View(0.0, (0.0,) * 6, (0.0,) * 3, np.zeros((2, 2)), 0, np.zeros((1, 2)), (0.0, 0.0), (0.0, 0.0),"
        "(1.0, 1.0), 0.0, ''); assert r.Renderer('rgb_array', 20.0).draw(v).std() > 1;"
        "import pygame; assert not pygame.display.get_init()"
    )
    clean = {key: value for key, value in os.environ.items() if key not in ("SDL_VIDEODRIVER", "DISPLAY")}
    clean["PYTHONPATH"] = os.pathsep.join(sys.path)
    subprocess.run([sys.executable, "-c", code], check=True, env=clean, timeout=60)


def test_the_error_for_missing_pygame_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "pygame", None)
    with pytest.raises(DependencyNotInstalled, match=r"drawing needs pygame: pip install .*\[render\]"):
        Renderer("rgb_array", 20.0)


def test_wrong_arguments_are_refused():
    with pytest.raises(ValueError, match=r"'ansi'.*human.*rgb_array"):
        Renderer("ansi", 20.0)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="positive"):
        Renderer("rgb_array", 0.0)
    for size in ((0, 720), (480.0, 360), (480,), 480, "ab", (480, 5000), None):
        with pytest.raises(ValueError, match=re.escape(f"render_size is {size!r}; it must be (width, height)")):
            Renderer("rgb_array", 20.0, size=size)


@pytest.mark.parametrize("env_id", ["UnderactuatedAUVTrack-v0", "UnderactuatedAUVTrackResidual-v0"])
def test_both_environments_take_a_size_and_keep_it_in_their_spec(env_id):
    env = gym.make(f"auv_gym:{env_id}", scenario="cruise-storm", render_mode="rgb_array_list", render_size=(320, 240))
    copy = gym.make(gym.envs.registration.EnvSpec.from_json(env.spec.to_json()))
    copy.reset(seed=0)
    copy.step(np.zeros(2, dtype=np.float32))
    assert [picture.shape for picture in copy.render()] == [(240, 320, 3)] * 2
    assert copy.render() == []
    with pytest.raises(ValueError, match="render_size"):
        gym.make(f"auv_gym:{env_id}", render_size=(10, 10))


def test_small_pictures_have_no_text():
    small, readable = picture(size=(84, 84)), picture(size=(320, 240))
    assert count(small, WHITE, 0) == 0
    assert count(readable, WHITE, 0) > 0.1 * 320 * 240
    assert count(small, VEHICLE, tolerance=60) > 5


def test_the_frame_rate_of_the_window_is_limited(human):
    human.draw(VIEW)
    start = time.perf_counter()
    human._fps = 10.0
    for k in range(3):
        assert human.draw(VIEW._replace(time=4.0 + k)) is None
    assert time.perf_counter() - start > 0.2


@pytest.mark.parametrize(("control_dt", "fps"), [(0.3, 1 / 0.3), (0.1, 10), (4.0, 0.25)])
def test_pictures_are_shown_in_real_time(control_dt, fps):
    env = gym.make("auv_gym:UnderactuatedAUVTrack-v0", scenario="slow-calm", control_dt=control_dt, render_mode="human")
    env.reset(seed=0)
    assert env.metadata["render_fps"] == env.unwrapped._renderer._fps == pytest.approx(fps)
    env.close()


def test_the_user_can_close_the_window(human):
    assert human.draw(VIEW) is None
    assert pygame.display.get_init()
    pygame.event.post(pygame.event.Event(pygame.QUIT))
    assert human.draw(VIEW) is None
    assert not pygame.display.get_init()
    assert human.draw(VIEW._replace(time=4.0)) is None
    assert not pygame.display.get_init()


def test_a_window_goes_on_when_that_of_another_environment_is_closed(human):
    other = Renderer("human", fps=200.0, size=SIZE)
    human.draw(VIEW)
    other.draw(VIEW)
    other.close()
    human.draw(VIEW._replace(time=4.0))
    assert pygame.display.get_init()

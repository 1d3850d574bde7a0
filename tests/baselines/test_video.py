"""Tests of videos: trajectories against the environment, frames by their pixels, files, errors."""

import math
import re
from dataclasses import replace
from itertools import islice
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from PIL import Image

from auv_gym.rendering.canvas import SEA_COLOUR
from auv_gym.scenarios.presets import PRESETS, SPACE_PRESETS
from baselines import make_policy
from baselines.evaluation.cells import drawn
from baselines.evaluation.runner import run_all
from baselines.tools.command_line import UsageError
from baselines.tools.figure_style import look
from baselines.video import command, make_video
from baselines.video.recording import trajectory_of
from baselines.video.video import Video, _rgb, save_video

pytest.importorskip("pygame")

ROOT = Path(__file__).parents[2]
PAIR = ("backstepping", "ppo-cruise")
COLOURS = [_rgb(look(policy, PAIR).colour) for policy in PAIR]


def video_of(policies, scenario, seed, **options):
    """Return a video in memory."""
    cell = drawn(scenario, 1, seed)
    return Video(tuple(trajectory_of(p, cell.scenario, cell.episodes[0]) for p in policies), "a title", **options)


@pytest.fixture(scope="module")
def storm():
    return video_of(PAIR, PRESETS["cruise-storm"], 3, size=(640, 400))


def near(frame, color, tolerance=30):
    """Return the mask of the pixels that have about this colour."""
    return np.abs(frame.astype(int) - color).max(axis=-1) <= tolerance


def test_a_trajectory_is_the_episode_of_the_scalar_environment(storm):
    for trajectory in storm.trajectories:
        env, policy = (
            gym.make("auv_gym:UnderactuatedAUVTrack-v0", scenario="cruise-storm"),
            make_policy(trajectory.policy),
        )
        observation, info = env.reset(seed=3)
        memory, first = None, np.array([True])
        for k in range(300):
            assert trajectory.error[k] == pytest.approx(info["position_error"], abs=1e-9)
            angle = trajectory.state[k, 2] - env.unwrapped.state[2]
            assert np.delete(trajectory.state[k], 2) == pytest.approx(np.delete(env.unwrapped.state, 2), abs=1e-9)
            assert np.cos(angle) == pytest.approx(1.0)
            assert trajectory.current[k] == pytest.approx(env.unwrapped.current, abs=1e-12)
            action, memory = policy.predict(observation, memory, first)
            observation, *_, info = env.step(action)
            first = np.array([False])
        assert trajectory.time[k] == pytest.approx(0.1 * k)


def test_trajectories_are_interpolated_between_control_instants(storm):
    trajectory = storm.trajectories[0]
    middle = trajectory.at(10.05)
    assert middle.state == pytest.approx(0.5 * (trajectory.state[100] + trajectory.state[101]))
    assert middle.error == pytest.approx(np.hypot(*(middle.state[:2] - middle.reference[:2])))
    assert trajectory.at(10.0).state == pytest.approx(trajectory.state[100])
    assert (trajectory.at(1e4).state == trajectory.state[-1]).all()
    assert np.abs(np.diff(trajectory.state[:, 2])).max() < 1.0  # no jumps where the heading passes pi


def test_vehicles_are_drawn_at_their_position_error(storm):
    """The reference is in the centre of a panel; the distance of the vehicle from it is the position error."""
    time, frame = next((t, f) for t, f in islice(zip(storm.times, storm.frames(), strict=True), 1, None) if t > 8.0)
    errors = [v.error.max() for v in storm.trajectories]
    reach = 1.25 * max(errors)
    panel = frame[60:289]  # below the title and the texts
    for trajectory, colour, left in zip(storm.trajectories, COLOURS, (0, 322), strict=True):
        rows, columns = np.nonzero(near(panel[:, left : left + 318], colour, 12))
        instant = trajectory.at(time)
        unit = 0.5 * min(318, 400 * 0.73 - 34 * 640 / 960 - 1.3) / max(reach, 3.0)  # [px/m]
        x, y = unit * (instant.state[:2] - instant.reference[:2])
        middle = 0.5 * (34 * 640 / 960 + 0.73 * 400) - 60
        assert columns.mean() - 159 == pytest.approx(x, abs=14)  # the drawn outline has another centroid
        assert middle - rows.mean() == pytest.approx(y, abs=14)


def test_chart_grows_with_time(storm):
    frames = list(islice(storm.frames(), 30))
    counts = [[near(p[300:], colour).sum() for p in frames] for colour in COLOURS]
    for count in counts:
        assert count[1] < count[15] < count[29] < count[0]  # the first frame shows the whole episode


def test_frames_have_the_requested_size_number_and_speed():
    video = video_of(["backstepping"], PRESETS["slow-calm"], 0, size=(301, 203), fps=10, speed=20.0, seconds=0.5)
    frames = list(video.frames())
    assert [p.shape for p in frames] == [(203, 301, 3)] * 7
    assert video.times == pytest.approx([10.0, 0.0, 2.0, 4.0, 6.0, 8.0, 10.0])
    assert near(frames[-1], SEA_COLOUR, 2).mean() > 0.3
    np.testing.assert_array_equal(frames[2], list(video.frames())[2])


def test_a_failed_vehicle_stays_at_its_last_position():
    narrow = replace(PRESETS["cruise-storm"], lost_distance=3.0)
    video = video_of(["backstepping", "open-loop"], narrow, 0, speed=30.0)
    expert, failed = video.trajectories
    assert (expert.failed, failed.failed) == (False, True)
    assert failed.time[-1] < expert.time[-1]
    assert len(list(video.frames())) == len(video.times) == 25


def test_panels_in_space_have_two_views():
    """The error is that of the environment in space; views from the side show the height and the pitch."""
    video = video_of(("backstepping", "los-pid"), SPACE_PRESETS["space-storm"], 3, size=(640, 400))
    trajectory = video.trajectories[1]
    env = gym.make("auv_gym:UnderactuatedAUVTrack3D-v0", scenario="space-storm")
    policy, memory = make_policy("los-pid", env.unwrapped.scenario.known), None
    observation, info = env.reset(seed=3)
    for k in range(50):
        x, y, z, theta, psi, *_ = env.unwrapped.state
        assert trajectory.error[k] == pytest.approx(info["position_error"], abs=1e-9)
        assert trajectory.state[k, :2] == pytest.approx([x, y], abs=1e-9)
        assert np.cos(trajectory.state[k, 2] - psi) == pytest.approx(1.0)
        assert trajectory.side.state[k, 1:3] == pytest.approx([z, -theta], abs=1e-9)
        assert trajectory.side.reference[k, 1] == pytest.approx(env.unwrapped.reference.z, abs=1e-9)
        action, memory = policy.predict(observation, memory, np.array([k == 0]))
        observation, *_, info = env.step(action)
    first, *_, last = islice(video.frames(), 1, 30)
    for rows in (slice(70, 200), slice(220, 285)):  # above, from the side
        assert (first[rows] != last[rows]).any()


def test_loops_contain_their_frames(tmp_path, storm):
    frames = list(islice(storm.frames(), 4))
    with Image.open(save_video(frames, tmp_path / "folder/video.webp", 10)) as image:
        assert (image.n_frames, image.size, image.info["loop"]) == (4, (640, 400), 0)
        for k, frame in enumerate(frames):
            image.seek(k)
            shown = np.asarray(image.convert("RGB")).astype(int)
            assert np.abs(shown - frame).mean() < 4.0
            assert image.info["duration"] == (1500 if k == 3 else 100)


def test_videos_contain_their_frames(tmp_path):
    from imageio_ffmpeg import count_frames_and_secs
    from moviepy.video.io.ffmpeg_reader import ffmpeg_parse_infos

    file = str(make_video(tmp_path / "video.mp4", ["backstepping"], "slow-calm", size=(301, 203), seconds=0.5))
    assert count_frames_and_secs(file)[0] == 8
    about = ffmpeg_parse_infos(file)
    assert (about["video_size"], about["video_fps"]) == ([300, 202], 12.0)


def test_the_command_writes_the_file_and_names_the_episode(tmp_path, capsys):
    out = tmp_path / "video.webp"
    words = "--policy backstepping ppo-cruise --seed 5 --seconds 0.2 --size 320x200 --out"
    assert command.main([*words.split(), str(out)]) == 0
    assert re.fullmatch(rf"written: {out}, cruise-storm, seed 5, \d+ kB\n", capsys.readouterr().out)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--out video.avi", r"must end in .webp, .mp4"),
        ("--size 100x100", "--size is '100x100'; it must be WIDTHxHEIGHT, from 240x180 to 4096x4096"),
        ("--size 400x300 --policy backstepping ekf lqi", "from 480x180"),
        ("--speed 0.001", "at most 3600 are allowed"),
        ("--fps 0", "--fps is 0; it must be an integer from 1 to 60"),
        ("--policy a b c d e f", "--policy names 6 policies; a video shows 1 to 5"),
        ("--scenario space-storm --policy oracle", "there is no policy 'oracle' in space; allowed are backstepping"),
    ],
)
def test_wrong_arguments_raise_usage_errors(words, message):
    with pytest.raises(UsageError, match=message):
        command.main(words.split())


def test_message_without_pygame_says_what_to_install(monkeypatch, tmp_path):
    monkeypatch.setitem(__import__("sys").modules, "pygame", None)
    with pytest.raises(UsageError, match=r"drawing needs pygame: pip install .*\[render\]"):
        command.main(["--seconds", "0.1", "--out", str(tmp_path / "video.webp")])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("preset", "caption", "file", "agent", "picture"),
    [
        (PRESETS["cruise-storm"], "The same storm", "storm.webp", "helm", ((820, 470), 101)),
        (SPACE_PRESETS["space-storm"], "The same in space", "space-storm.webp", "helm-3d", ((700, 420), 81)),
    ],
)
def test_captions_of_the_videos_in_the_documentation(preset, caption, file, agent, picture):
    """The seed is that of the command in the Makefile; numbers are those of 20 episodes; the file is small."""
    page, makefile = ((ROOT / name).read_text(encoding="utf-8") for name in ("docs/videos.md", "Makefile"))
    words = " ".join(re.search(rf"\*{caption}.*?\*\n", page, re.DOTALL)[0].split())
    runs = run_all(("backstepping", "nmpc", agent), (drawn(preset, 20, 0),), math.inf)
    first, *others = [run.measures.steady_rmse for run in runs]
    for errors in (first, *others):
        assert f"{errors.mean():.3f} m" in words
    logarithms = [np.log(errors / first) for errors in others]
    usual = int(np.argmin(sum(np.abs(ratios - np.median(ratios)) for ratios in logarithms)))
    assert f"seed {usual}" in words
    assert f"{agent} --scenario {preset.name} --seed {usual} " in makefile
    image = ROOT / "docs" / "images" / file
    assert image.stat().st_size < 1.5e6
    with Image.open(image) as frames:
        assert (frames.size, frames.n_frames, frames.info["loop"]) == (*picture, 0)

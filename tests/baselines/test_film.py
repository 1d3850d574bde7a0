"""Films: what they show against the environment and by pixels, which storm is the typical one, files and words."""

import math
import re
from dataclasses import replace
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from PIL import Image

from auv_gym.rendering.canvas import SEA_COLOUR
from auv_gym.scenarios.presets import PRESETS
from baselines import make_policy
from baselines.evaluation.runner import drawn, run_all
from baselines.tools.command_line import UsageError
from baselines.tools.workers import Workers
from baselines.video import command, make_film
from baselines.video.files import save_video
from baselines.video.layout import HULLS
from baselines.video.pairs import leads, typical
from baselines.video.video import film, label_of

pytest.importorskip("pygame")

ROOT = Path(__file__).parents[2]
TRIO = ("backstepping", "nmpc", "helm")
PAIR = ("backstepping", "apg-cruise")


@pytest.fixture(scope="module")
def storm():
    return film(PAIR, "cruise-storm", 3, size=(640, 400))


def near(picture, color, tolerance=30):
    """Return where a picture has about this colour."""
    return np.abs(picture.astype(int) - color).max(axis=-1) <= tolerance


def test_a_voyage_is_the_episode_of_the_scalar_environment(storm):
    for voyage in storm.voyages:
        env, policy = gym.make("auv_gym:UnderactuatedAUVTrack-v0", scenario="cruise-storm"), make_policy(voyage.policy)
        observation, info = env.reset(seed=3)
        memory, first = None, np.array([True])
        for k in range(300):
            assert voyage.error[k] == pytest.approx(info["position_error"], abs=1e-9)
            angle = voyage.state[k, 2] - env.unwrapped.state[2]
            assert np.delete(voyage.state[k], 2) == pytest.approx(np.delete(env.unwrapped.state, 2), abs=1e-9)
            assert np.cos(angle) == pytest.approx(1.0)
            assert voyage.current[k] == pytest.approx(env.unwrapped.current, abs=1e-12)
            action, memory = policy.predict(observation, memory, first)
            observation, *_, info = env.step(action)
            first = np.array([False])
        assert voyage.time[k] == pytest.approx(0.1 * k)


def test_between_two_instants_it_is_interpolated(storm):
    voyage = storm.voyages[0]
    middle = voyage.at(10.05)
    assert middle.state == pytest.approx(0.5 * (voyage.state[100] + voyage.state[101]))
    assert middle.error == pytest.approx(np.hypot(*(middle.state[:2] - middle.reference[:2])))
    assert voyage.at(10.0).state == pytest.approx(voyage.state[100])
    assert (voyage.at(1e4).state == voyage.state[-1]).all()
    assert np.abs(np.diff(voyage.state[:, 2])).max() < 1.0  # no jumps where the heading passes pi


def test_vehicles_are_shown_where_they_are_off_their_reference(storm):
    """The reference stays in the middle of a panel; the hull's middle lies beside it, as far as the error says."""
    picture = next(iter([f for t, f in zip(storm.times, storm.frames(40), strict=False) if t > 8.0]))
    time = next(t for t in storm.times if t > 8.0)
    errors = [v.error.max() for v in storm.voyages]
    reach = 1.25 * max(errors)
    panel = picture[60:289]  # below the title and the cards
    for voyage, hull, left in zip(storm.voyages, HULLS, (0, 322), strict=False):
        rows, columns = np.nonzero(near(panel[:, left : left + 318], hull, 12))
        away = voyage.at(time)
        unit = 0.5 * min(318, 400 * 0.73 - 34 * 640 / 960 - 1.3) / max(reach, 3.0)  # [px/m]
        x, y = unit * (away.state[:2] - away.reference[:2])
        middle = 0.5 * (34 * 640 / 960 + 0.73 * 400) - 60
        assert columns.mean() - 159 == pytest.approx(x, abs=14)  # the hull's middle is not quite its centroid
        assert middle - rows.mean() == pytest.approx(y, abs=14)


def test_chart_grows_with_time(storm):
    pictures = list(storm.frames(30))
    counts = [[near(p[300:], hull).sum() for p in pictures] for hull in HULLS[:2]]
    for own in counts:
        assert own[0] < own[15] < own[29]
    assert not near(pictures[0][300:], HULLS[2]).any()


def test_pictures_have_their_size_number_and_pace():
    made = film(["backstepping"], "slow-calm", 0, size=(301, 203), fps=10, speed=20.0, seconds=0.5)
    pictures = list(made.frames())
    assert [p.shape for p in pictures] == [(203, 301, 3)] * 6
    assert made.times == pytest.approx([0.0, 2.0, 4.0, 6.0, 8.0, 10.0])
    assert near(pictures[-1], SEA_COLOUR, 2).mean() > 0.3
    np.testing.assert_array_equal(pictures[2], list(made.frames(3))[2])


def test_who_is_lost_stays_where_it_was_lost():
    narrow = replace(PRESETS["cruise-storm"], lost_distance=3.0)
    made = film(["backstepping", "open-loop"], narrow, 0, speed=30.0)
    expert, failed = made.voyages
    assert (expert.failed, failed.failed) == (False, True)
    assert failed.time[-1] < expert.time[-1]
    assert len(list(made.frames())) == len(made.times) == 24


def test_labels_say_what_policies_are():
    assert [label_of(p) for p in (*TRIO, "apg-slow:fade", "lqi")] == [
        "expert",
        "EKF + MPC",
        "trained agent",
        "trained agent",
        "controller",
    ]


def test_typical_episode_is_the_one_with_the_median_ratios():
    first = np.array([1.0, 2.0, 1.0, 4.0, 1.0])
    second = first / (2.0, 5.0, 3.0, 9.0, 4.0)  # ratios with the median 4, in the last episode
    third = first / (20.0, 50.0, 30.0, 90.0, 31.0)
    assert typical({"a": first, "b": second}) == 4
    assert typical({"a": first, "b": second, "c": third}) == 4
    assert typical({"a": np.array([3.0, 1.0, 2.0])}) == 2


def test_a_lead_is_the_difference_of_paired_means():
    (lead,) = leads({"a": np.array([1.0, 2.0, 3.0]), "b": np.array([0.5, 0.5, 0.5])}, PRESETS["cruise-storm"])
    assert lead.kept == (0.5, 2.0)
    assert lead.less[0] < 1.5 < lead.less[1]
    assert str(lead).startswith("b keeps 0.500 m where a keeps 2.000 m (3 paired episodes of cruise-storm; 95 %")
    (single,) = leads({"a": np.array([1.0]), "b": np.array([0.5])}, PRESETS["cruise-storm"])
    assert str(single) == "b keeps 0.500 m where a keeps 1.000 m (1 paired episode of cruise-storm)"


@pytest.mark.parametrize("suffix", [".webp", ".gif"])
def test_loops_hold_their_pictures(suffix, tmp_path, storm):
    pictures = list(storm.frames(4))
    with Image.open(save_video(pictures, tmp_path / f"folder/film{suffix}", 10)) as image:
        assert (image.n_frames, image.size, image.info["loop"]) == (4, (640, 400), 0)
        for k, picture in enumerate(pictures):
            image.seek(k)
            shown = np.asarray(image.convert("RGB")).astype(int)
            assert np.abs(shown - picture).mean() < 4.0
            assert image.info["duration"] == (1500 if k == 3 else 100)


def test_videos_hold_their_pictures(tmp_path):
    from imageio_ffmpeg import count_frames_and_secs
    from moviepy.video.io.ffmpeg_reader import ffmpeg_parse_infos

    file = str(make_film(tmp_path / "film.mp4", ["backstepping"], "slow-calm", size=(301, 203), seconds=0.5))
    assert count_frames_and_secs(file)[0] == 7
    about = ffmpeg_parse_infos(file)
    assert (about["video_size"], about["video_fps"]) == ([300, 202], 12.0)


def test_command_says_what_is_kept_and_films_the_typical_episode(tmp_path, capsys):
    out = tmp_path / "film.gif"
    words = "--policy backstepping apg-cruise --episodes 3 --seed 5 --jobs 1 --seconds 0.2 --size 320x200 --out"
    assert command.main([*words.split(), str(out)]) == 0
    said, written = capsys.readouterr().out.splitlines()
    runs = run_all(PAIR, (drawn(PRESETS["cruise-storm"], 3, 5),))
    steady_rmses = {run.policy: run.measures.steady_rmse for run in runs}
    assert said == str(leads(steady_rmses, PRESETS["cruise-storm"])[0])
    assert f"seed {5 + typical(steady_rmses)}," in written
    assert out.exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--out film.avi", r"must end in .mp4, .webp, .gif"),
        ("--size 100x100", "--size is '100x100'; it must be WIDTHxHEIGHT, from 240x180 to 4096x4096"),
        ("--size 400x300 --policy backstepping ekf lqi", "from 480x180"),
        ("--size big", "WIDTHxHEIGHT"),
        ("--speed 0", "--speed is 0.0; it must be positive"),
        ("--speed nan", "--speed is nan; it must be positive"),
        ("--seconds -1", "--seconds is -1.0; it must be positive"),
        ("--speed 0.001", "at most 3600 are allowed"),
        ("--fps 0", "--fps is 0; it must be an integer from 1 to 60"),
        ("--episodes 0", "--episodes is 0"),
        ("--jobs 0", "--jobs is 0"),
        ("--policy nobody", "unknown policy 'nobody'"),
        ("--policy a b c d e f", "--policy names 6 policies; a film shows 1 to 5"),
        ("--scenario nowhere", "unknown scenario 'nowhere'"),
    ],
)
def test_wrong_words_are_answered_in_a_line(words, message):
    with pytest.raises(UsageError, match=message):
        command.main(words.split())


def test_missing_pygame_says_what_to_install(monkeypatch, tmp_path):
    monkeypatch.setitem(__import__("sys").modules, "pygame", None)
    with pytest.raises(UsageError, match=r"drawing needs pygame: pip install .*\[render\]"):
        command.main(["--seconds", "0.1", "--out", str(tmp_path / "film.gif")])


def test_the_picture_of_the_readme_is_what_its_caption_says():
    """Seed and numbers of the caption come out of the command that the Makefile names; the file is small."""
    caption = re.search(
        r"\*The same storm.*?\*\n", (ROOT / "docs" / "videos.md").read_text(encoding="utf-8"), re.DOTALL
    )[0]
    caption = " ".join(caption.split())
    steady_rmses = {
        run.policy: run.measures.steady_rmse
        for run in run_all(TRIO, (drawn(PRESETS["cruise-storm"], 20, 0),), Workers(), math.inf)
    }
    for steady_rmse in steady_rmses.values():
        assert f"{steady_rmse.mean():.3f} m" in caption
    assert f"seed {typical(steady_rmses)}" in caption
    file = ROOT / "docs" / "images" / "storm.webp"
    assert file.stat().st_size < 1.5e6
    with Image.open(file) as image:
        assert (image.size, image.n_frames, image.info["loop"]) == ((820, 470), 100, 0)

"""Make videos of policies side by side: `auv-gym video --help`."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

from gymnasium.error import DependencyNotInstalled
from tyro.conf import arg

from auv_gym.rendering.renderer import SIZES
from auv_gym.scenarios.scenario import Scenario
from baselines.evaluation.request import checked_policies, checked_scenario
from baselines.evaluation.rollout import PolicyError
from baselines.evaluation.runner import drawn, run_all
from baselines.evaluation.score import EXPERT
from baselines.tools.command_line import DONE, FAILED, UsageError, called, checked, checked_folder, parse, printable
from baselines.tools.workers import Workers
from baselines.video.files import WRITERS, save_video
from baselines.video.layout import MOST_PANELS
from baselines.video.pairs import Comparison, comparisons, typical_episode
from baselines.video.video import FPS, SPEED, VIDEO_SIZE, video_of

PROGRAM = "auv-gym video"
_SMALLEST = (240, 180)
"""Smallest width and height [px] of a video."""
MOST_FRAMES = 3600  # largest number of frames of a video
NARROWEST = 160  # [px] smallest width of a policy's panel
_MOST_EPISODES = 10_000  # largest number of episodes in the search for a typical one


@dataclass(frozen=True)
class Options:
    """Make a video of policies side by side in the same episode, with a chart of their position errors.

    Exit status: 0 done, 1 a policy failed or the file could not be written, 2 wrong usage.

    Example: auv-gym video --policy backstepping apg-cruise --scenario cruise-storm --seed 6 --out storm.mp4
    """

    policy: Annotated[tuple[str, ...], arg(metavar="P [P ...]", help_behavior_hint="")] = (EXPERT,)
    """One to five policies, by name, file or folder, from left to right."""
    scenario: str = "cruise-storm"
    """A preset's name, or a .toml or .json file."""
    seed: int = 0
    """Seed of the episode."""
    episodes: Annotated[int | None, arg(metavar="N", help_behavior_hint="")] = None
    """Run N episodes from the seed on, and show the typical one: the one in which the ratios of the policies' errors
    are closest to their medians. Also print the mean steady-state error of each policy in all N episodes."""
    jobs: Annotated[int | None, arg(metavar="INT", help_behavior_hint="")] = None
    """Worker processes for these episodes; the video is the same for any number. Default: 2, or 1 on one processor."""
    out: Path = Path("runs/video.webp")
    """The file: a .webp or .gif, which plays in a loop, or an .mp4."""
    size: str = f"{VIDEO_SIZE[0]}x{VIDEO_SIZE[1]}"
    """Width and height in pixels."""
    speed: float = SPEED
    """Playback speed: 4 is four times as fast as real time."""
    seconds: Annotated[float | None, arg(metavar="FLOAT", help_behavior_hint="")] = None
    """Length of the video. Default: the whole episode."""
    fps: int = FPS
    """Frames per second."""


def main(arguments: Sequence[str]) -> int:
    """Make a video and return the exit status.

    Raises:
        UsageError: the arguments are wrong.
    """
    options = parse(Options, arguments, PROGRAM)
    size = _checked(options)
    scenario = checked_scenario(options.scenario)
    frames = min(scenario.duration / options.speed, options.seconds or math.inf) * options.fps
    if frames > MOST_FRAMES:
        raise UsageError(
            f"the video would have {frames:.0f} frames; at most {MOST_FRAMES} are allowed: raise --speed, "
            "or give --seconds"
        )
    policies = checked_policies(options.policy)
    workers = checked(partial(Workers.of, options.jobs))
    checked_folder(options.out.parent)
    try:
        k, found = _typical(policies, scenario, options, workers) if options.episodes else (0, [])
        seed = options.seed + k
        video = video_of(
            policies, scenario, seed, size=size, fps=options.fps, speed=options.speed, seconds=options.seconds
        )
        save_video(video.frames(), options.out, video.fps)
    except DependencyNotInstalled as error:
        raise UsageError(str(error)) from error
    except PolicyError as error:
        print(f"{called(PROGRAM)}: {printable(str(error))}", file=sys.stderr)
        return FAILED
    for comparison in found:
        print(comparison)
    length, size_kb = len(video.times) / video.fps, options.out.stat().st_size / 1000
    print(f"written: {options.out}, {length:.1f} s of {scenario.name}, seed {seed}, {size_kb:.0f} kB")
    return DONE


def _checked(options: Options) -> tuple[int, int]:
    """Return the width and height of the video.

    Raises:
        UsageError: an option is wrong.
    """
    if options.out.suffix not in WRITERS:
        raise UsageError(f"--out is {options.out}; its name must end in {', '.join(WRITERS)}")
    if options.out.is_dir():
        raise UsageError(f"--out {options.out} is a folder; give the name of a file")
    if not 1 <= len(options.policy) <= MOST_PANELS:
        raise UsageError(f"--policy names {len(options.policy)} policies; a video shows 1 to {MOST_PANELS}")
    for name, least, most in (("seed", 0, 2**62), ("episodes", 1, _MOST_EPISODES), ("fps", 1, 60)):
        if (value := getattr(options, name)) is not None and not least <= value <= most:
            raise UsageError(f"--{name} is {value}; it must be an integer from {least} to {most}")
    for name, longest in (("speed", 1000.0), ("seconds", 3600.0)):
        if (value := getattr(options, name)) is not None and not 0.0 < value <= longest:
            raise UsageError(f"--{name} is {value}; it must be positive, and at most {longest:g}")
    words = options.size.lower().split("x")
    width, height = (int(word) if word.isdecimal() and len(word) < 6 else 0 for word in (*words, "", "")[:2])
    narrowest, lowest, largest = max(_SMALLEST[0], NARROWEST * len(options.policy)), _SMALLEST[1], SIZES[1]
    if len(words) != 2 or not (narrowest <= width <= largest and lowest <= height <= largest):
        raise UsageError(
            f"--size is {options.size!r}; it must be WIDTHxHEIGHT, from {narrowest}x{lowest} to {largest}x{largest}"
        )
    return width, height


def _typical(
    policies: Sequence[str], scenario: Scenario, options: Options, workers: Workers
) -> tuple[int, list[Comparison]]:
    """Return the index of the typical one of `options.episodes` episodes, and the comparisons of the policies in all.

    Raises:
        PolicyError: a policy failed.
    """
    cell = drawn(scenario, options.episodes or 1, options.seed)
    steady_rmses = {}
    for run in run_all(policies, (cell,), workers, math.inf):
        if run.measures is None:
            raise PolicyError(f"{run.policy} in {scenario.name}: {run.error}")
        steady_rmses[run.policy] = run.measures.steady_rmse
    return typical_episode(steady_rmses), comparisons(steady_rmses, scenario)

"""Make videos of policies side by side: `auv-gym video --help`."""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from gymnasium.error import DependencyNotInstalled
from tyro.conf import arg

from auv_gym.rendering.renderer import FRAME_SIZES
from baselines.evaluation.request import checked_policies, checked_scenario, import_effects
from baselines.evaluation.rollout import PolicyError
from baselines.evaluation.score import EXPERT
from baselines.tools.command_line import DONE, FAILED, UsageError, called, checked_folder, parse, printable
from baselines.video.layout import MOST_PANELS
from baselines.video.video import FPS, SPEED, VIDEO_SIZE, WRITERS, make_video

PROGRAM = "auv-gym video"
_SMALLEST = (240, 180)  # [px] smallest width and height of a video
MOST_FRAMES = 3600  # largest number of frames of a video
NARROWEST = 160  # [px] smallest width of a policy's panel


@dataclass(frozen=True)
class Options:
    """Make a video of policies side by side in the same episode, with a chart of their position errors.

    Exit status: 0 done, 1 a policy failed or the file could not be written, 2 wrong usage.

    Example: auv-gym video --policy backstepping ppo-cruise --scenario cruise-storm --seed 6 --out storm.mp4
    """

    policy: Annotated[tuple[str, ...], arg(metavar="P [P ...]", help_behavior_hint="")] = (EXPERT,)
    """One to five policies, by name, file or folder, from left to right. Default: backstepping."""
    scenario: str = "cruise-storm"
    """A preset's name, or a .toml or .json file."""
    effects: Annotated[tuple[Path, ...], arg(metavar="FILE.py [...]")] = ()
    """Python files with effects of your own, which scenario files name: docs/make-your-own.md. They are executed."""
    seed: int = 0
    """Seed of the episode."""
    out: Path = Path("runs/video.webp")
    """The file: a .webp, which plays in a loop, or an .mp4."""
    size: str = f"{VIDEO_SIZE[0]}x{VIDEO_SIZE[1]}"
    """Width and height in pixels."""
    speed: float = SPEED
    """Playback speed: 4 is four times as fast as real time."""
    seconds: float | None = None
    """Length of the video. Default: the whole episode."""
    fps: int = FPS
    """Frames per second."""


def main(arguments: Sequence[str]) -> int:
    """Run the command; see `run` of `baselines.tools.command_line`."""
    options = parse(Options, arguments, PROGRAM)
    size = _checked_size(options)
    import_effects(options.effects)
    scenario = checked_scenario(options.scenario)
    frames = min(scenario.duration / options.speed, options.seconds or math.inf) * options.fps
    if frames > MOST_FRAMES:
        raise UsageError(
            f"the video would have {frames:.0f} frames; at most {MOST_FRAMES} are allowed: raise --speed, "
            "or give --seconds"
        )
    policies = checked_policies(options.policy, (scenario,))
    checked_folder(options.out.parent)
    fps, speed, seconds = options.fps, options.speed, options.seconds
    try:
        make_video(options.out, policies, scenario, options.seed, size=size, fps=fps, speed=speed, seconds=seconds)
    except DependencyNotInstalled as error:
        raise UsageError(str(error)) from error
    except PolicyError as error:
        print(f"{called(PROGRAM)}: {printable(str(error))}", file=sys.stderr)
        return FAILED
    size_kb = options.out.stat().st_size / 1000
    print(f"written: {options.out}, {scenario.name}, seed {options.seed}, {size_kb:.0f} kB")
    return DONE


def _checked_size(options: Options) -> tuple[int, int]:
    """Return the width and height of the video; raise UsageError if an option is wrong."""
    if options.out.suffix not in WRITERS:
        raise UsageError(f"--out is {options.out}; its name must end in {', '.join(WRITERS)}")
    if options.out.is_dir():
        raise UsageError(f"--out {options.out} is a folder; give the name of a file")
    if not 1 <= len(options.policy) <= MOST_PANELS:
        raise UsageError(f"--policy names {len(options.policy)} policies; a video shows 1 to {MOST_PANELS}")
    for name, least, most in (("seed", 0, 2**62), ("fps", 1, 60)):
        if not least <= (value := getattr(options, name)) <= most:
            raise UsageError(f"--{name} is {value}; it must be an integer from {least} to {most}")
    for name, longest in (("speed", 1000.0), ("seconds", 3600.0)):
        if (value := getattr(options, name)) is not None and not 0.0 < value <= longest:
            raise UsageError(f"--{name} is {value}; it must be positive, and at most {longest:g}")
    match = re.fullmatch(r"(\d{1,5})x(\d{1,5})", options.size.lower())
    width, height = (int(match[1]), int(match[2])) if match else (0, 0)
    narrowest, lowest, largest = max(_SMALLEST[0], NARROWEST * len(options.policy)), _SMALLEST[1], FRAME_SIZES[1]
    if not (narrowest <= width <= largest and lowest <= height <= largest):
        raise UsageError(
            f"--size is {options.size!r}; it must be WIDTHxHEIGHT, from {narrowest}x{lowest} to {largest}x{largest}"
        )
    return width, height

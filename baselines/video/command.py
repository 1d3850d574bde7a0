"""Moving pictures of policies side by side: `auv-gym video --help`."""

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
from baselines.evaluation.request import checked, checked_policies, checked_scenario
from baselines.evaluation.rollout import PolicyError
from baselines.evaluation.runner import drawn, run_all
from baselines.evaluation.score import EXPERT
from baselines.tools.command_line import DONE, FAILED, UsageError, called, parse, printable
from baselines.tools.workers import Workers
from baselines.video.files import WRITERS, save_video
from baselines.video.layout import HULLS
from baselines.video.pairs import Lead, leads, typical
from baselines.video.video import FPS, SPEED, VIDEO_SIZE, film

PROGRAM = "auv-gym video"
_SMALLEST = (240, 180)
"""Least width and height [px] of a film."""
MOST_PICTURES = 3600  # of a film
NARROWEST = 160  # least width [px] of a policy's panel
_MOST_EPISODES = 10_000  # among which the typical one is looked for


@dataclass(frozen=True)
class Options:
    """Film policies side by side in one episode, the same sea for all, with the position errors of all below.

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
    """Run N episodes, from the seed on, and film the typical one: there the policies' errors relate to the first one's
    as in the median episode. Says what each policy keeps in all N."""
    jobs: Annotated[int | None, arg(metavar="INT", help_behavior_hint="")] = None
    """Worker processes for these episodes; the film is the same for any number. Default: 2, or 1 on one processor."""
    out: Path = Path("runs/film.webp")
    """The file: a .webp or .gif, which are loops, or an .mp4."""
    size: str = f"{VIDEO_SIZE[0]}x{VIDEO_SIZE[1]}"
    """Width and height in pixels."""
    speed: float = SPEED
    """How many times faster than the vehicles it is played."""
    seconds: Annotated[float | None, arg(metavar="FLOAT", help_behavior_hint="")] = None
    """Length of the film. Default: the whole episode."""
    fps: int = FPS
    """Pictures a second."""


def main(arguments: Sequence[str]) -> int:
    """Film as the arguments say and return the exit status.

    Raises:
        UsageError: the arguments do not make sense.
    """
    options = parse(Options, arguments, PROGRAM)
    size = _checked(options)
    scenario = checked_scenario(options.scenario)
    pictures = min(scenario.duration / options.speed, options.seconds or math.inf) * options.fps
    if pictures > MOST_PICTURES:
        raise UsageError(
            f"the film would have {pictures:.0f} pictures; at most {MOST_PICTURES} are allowed: raise --speed, "
            "or give --seconds"
        )
    policies = checked_policies(options.policy)
    workers = checked(partial(Workers.of, options.jobs))
    try:
        k, found = _typical(policies, scenario, options, workers) if options.episodes else (0, [])
        seed = options.seed + k
        made = film(policies, scenario, seed, size=size, fps=options.fps, speed=options.speed, seconds=options.seconds)
        save_video(made.frames(), options.out, made.fps)
    except DependencyNotInstalled as error:
        raise UsageError(str(error)) from error
    except PolicyError as error:
        print(f"{called(PROGRAM)}: {printable(str(error))}", file=sys.stderr)
        return FAILED
    for lead in found:
        print(lead)
    length, size_kb = len(made.times) / made.fps, options.out.stat().st_size / 1000
    print(f"written: {options.out}, {length:.1f} s of {scenario.name}, seed {seed}, {size_kb:.0f} kB")
    return DONE


def _checked(options: Options) -> tuple[int, int]:
    """Return the width and height of a film that can be made.

    Raises:
        UsageError: an option is wrong.
    """
    if options.out.suffix not in WRITERS:
        raise UsageError(f"--out is {options.out}; its name must end in {', '.join(WRITERS)}")
    if not 1 <= len(options.policy) <= len(HULLS):
        raise UsageError(f"--policy names {len(options.policy)} policies; a film shows 1 to {len(HULLS)}")
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


def _typical(policies: Sequence[str], scenario: Scenario, options: Options, workers: Workers) -> tuple[int, list[Lead]]:
    """Run the policies through so many episodes; return the number of the typical one, and what they keep in all.

    Raises:
        PolicyError: a policy failed.
    """
    cell = drawn(scenario, options.episodes or 1, options.seed)
    steady_rmses = {}
    for run in run_all(policies, (cell,), workers, math.inf):
        if run.measures is None:
            raise PolicyError(f"{run.policy} in {scenario.name}: {run.error}")
        steady_rmses[run.policy] = run.measures.steady_rmse
    return typical(steady_rmses), leads(steady_rmses, scenario)

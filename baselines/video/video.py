"""Films: the same episode with several policies side by side, and the files that they are kept in."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from auv_gym.rendering.renderer import import_pygame
from auv_gym.scenarios.presets import as_scenario
from auv_gym.scenarios.scenario import Scenario
from baselines.agents.names import agent_folder
from baselines.evaluation.runner import drawn
from baselines.evaluation.score import EXPERT, ORACLE
from baselines.video.files import save_video
from baselines.video.layout import VEHICLE_COLORS, Panel, Picture
from baselines.video.recording import Recording, record

VIDEO_SIZE = (480, 360)
"""Width and height [px] of a film where none is asked for."""
FPS = 12
"""Pictures a second where no other number is asked for."""
SPEED = 4.0
"""How many times faster than the vehicles a film is played where nothing else is said."""
_LABELS = {EXPERT: "expert", ORACLE: "oracle: sees the sea", "nmpc": "EKF + MPC", "ekf": "Kalman filter"}
"""What policies are, for those who do not know their names."""


@dataclass(frozen=True)
class Film:
    """Some recordings through the same sea, and how they are to be shown.

    Args:
        recordings: what the policies did in one episode.
        title: what sea it is.
        size: width and height [px].
        fps: pictures a second.
        speed: how many times faster than the vehicles it is played.
        seconds: its length [s]; None: the whole episode.
    """

    recordings: tuple[Recording, ...]
    title: str
    size: tuple[int, int] = VIDEO_SIZE
    fps: int = FPS
    speed: float = SPEED
    seconds: float | None = None

    @cached_property
    def times(self) -> list[float]:
        """The moments [s] of the episode that are shown, one for each picture."""
        whole = max(float(v.time[-1]) for v in self.recordings)
        end = whole if self.seconds is None else min(self.seconds * self.speed, whole)
        pictures = math.floor(end * self.fps / self.speed) + 1
        return [k * self.speed / self.fps for k in range(pictures)]

    def frames(self, count: int | None = None) -> Iterator[NDArray[np.uint8]]:
        """Yield the pictures, arrays (height, width, 3); with a count only the first ones."""
        longest = max(self.recordings, key=lambda v: len(v.time))
        panels = [
            Panel(v, label_of(v.policy), color) for v, color in zip(self.recordings, VEHICLE_COLORS, strict=False)
        ]
        path = longest.reference[:, :2]
        picture = Picture(import_pygame(), self.size, self.title, panels, path, self.speed)
        for time in self.times[:count]:
            yield picture.at(time)


def label_of(policy: str) -> str:
    """Return what a policy is, in a word or two."""
    return _LABELS.get(policy) or ("trained agent" if agent_folder(policy.partition(":")[0]) else "controller")


def film(
    policies: Sequence[str],
    scenario: Scenario | str,
    seed: int = 0,
    *,
    size: tuple[int, int] = VIDEO_SIZE,
    fps: int = FPS,
    speed: float = SPEED,
    seconds: float | None = None,
) -> Film:
    """Run policies through the episode of a seed and return the film of it; see `make_film`."""
    cell = drawn(as_scenario(scenario), 1, seed)
    recordings = tuple(record(policy, cell.scenario, cell.episodes[0]) for policy in policies)
    return Film(recordings, f"{cell.scenario.name}, seed {seed}", size, fps, speed, seconds)


def make_film(
    out: Path | str,
    policies: Sequence[str],
    scenario: Scenario | str,
    seed: int = 0,
    *,
    size: tuple[int, int] = VIDEO_SIZE,
    fps: int = FPS,
    speed: float = SPEED,
    seconds: float | None = None,
) -> Path:
    """Film policies side by side in one episode, the same sea for all, and write the file.

    Each policy has a panel with vehicle, reference, trail and current; below them are the position errors of all.

    Args:
        out: the file: .webp or .gif (a loop, needs Pillow) or .mp4 (needs imageio-ffmpeg). Its folder is made.
        policies: one to five, see `baselines.make_policy`.
        scenario: a `Scenario`, or a preset's name.
        seed: of the episode, the one of an environment that is reset with it.
        size: width and height [px].
        fps: pictures a second.
        speed: how many times faster than the vehicles it is played.
        seconds: length of the film [s]; None: the whole episode.

    Returns:
        The file.

    Raises:
        DependencyNotInstalled: pygame, or what writes such a file, is missing.
        OSError: a policy cannot be read, or the file not be written.
        ValueError: there is no such policy or scenario, or the file's ending is unknown.
        PolicyError: a policy gave no usable action.
    """
    made = film(policies, scenario, seed, size=size, fps=fps, speed=speed, seconds=seconds)
    return save_video(made.frames(), Path(out), fps)

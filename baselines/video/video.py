"""Makes videos of several policies side by side in the same episode."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from auv_gym.rendering.canvas import Color
from auv_gym.rendering.renderer import import_pygame
from auv_gym.scenarios.presets import as_scenario
from auv_gym.scenarios.scenario import Scenario
from baselines.agents.names import agent_folder
from baselines.evaluation.runner import drawn
from baselines.evaluation.score import EXPERT, ORACLE
from baselines.tools.figure_style import look
from baselines.video.files import save_video
from baselines.video.layout import FrameRenderer, Panel
from baselines.video.recording import Trajectory, trajectory_of

VIDEO_SIZE = (480, 360)
"""Default width and height [px]."""
FPS = 12
"""Default number of frames per second."""
SPEED = 4.0
"""Default playback speed, as a multiple of real time."""
_LABELS = {EXPERT: "expert", ORACLE: "oracle: known disturbances", "nmpc": "EKF + MPC", "ekf": "Kalman filter"}
"""Labels that say what kind of policy a name stands for."""


@dataclass(frozen=True)
class Video:
    """A video of several policies in the same episode.

    Args:
        trajectories: one for each policy.
        title: text of the title.
        size: width and height [px].
        fps: frames per second.
        speed: playback speed, as a multiple of real time.
        seconds: length of the video [s]; None: the whole episode.
    """

    trajectories: tuple[Trajectory, ...]
    title: str
    size: tuple[int, int] = VIDEO_SIZE
    fps: int = FPS
    speed: float = SPEED
    seconds: float | None = None

    @cached_property
    def times(self) -> list[float]:
        """The times of the episode [s], one for each frame; the first frame shows the end, as a summary."""
        whole = max(float(v.time[-1]) for v in self.trajectories)
        end = whole if self.seconds is None else min(self.seconds * self.speed, whole)
        count = math.floor(end * self.fps / self.speed) + 1
        return [end, *(k * self.speed / self.fps for k in range(count))]

    def frames(self, count: int | None = None) -> Iterator[NDArray[np.uint8]]:
        """Yield the frames, arrays (height, width, 3); only the first `count`, if it is given."""
        longest = max(self.trajectories, key=lambda v: len(v.time))
        policies = [v.policy for v in self.trajectories]
        panels = [Panel(v, label_of(v.policy), _rgb(look(v.policy, policies).colour)) for v in self.trajectories]
        path = longest.reference[:, :2]
        renderer = FrameRenderer(import_pygame(), self.size, self.title, panels, path, self.speed)
        for time in self.times[:count]:
            yield renderer.frame_at(time)


def _rgb(colour: str) -> Color:
    """Return the numbers of a colour #rrggbb."""
    red, green, blue = bytes.fromhex(colour[1:])
    return red, green, blue


def label_of(policy: str) -> str:
    """Return a short text that says what kind of policy a name stands for."""
    return _LABELS.get(policy) or ("trained agent" if agent_folder(policy.partition(":")[0]) else "controller")


def video_of(
    policies: Sequence[str],
    scenario: Scenario | str,
    seed: int = 0,
    *,
    size: tuple[int, int] = VIDEO_SIZE,
    fps: int = FPS,
    speed: float = SPEED,
    seconds: float | None = None,
) -> Video:
    """Run policies through the episode of a seed and return the video; see `make_video`."""
    cell = drawn(as_scenario(scenario), 1, seed)
    trajectories = tuple(trajectory_of(policy, cell.scenario, cell.episodes[0]) for policy in policies)
    return Video(trajectories, f"{cell.scenario.name}, seed {seed}", size, fps, speed, seconds)


def make_video(
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
    """Make a video of policies side by side in the same episode, write it to a file and return the file.

    Each policy has a panel with vehicle, reference, trail and current; a chart below shows the position errors of all.

    Args:
        out: the file: .webp or .gif (a loop, needs Pillow) or .mp4 (needs imageio-ffmpeg). Its folder is created.
        policies: one to five names, see `baselines.make_policy`.
        scenario: a `Scenario`, or a preset's name.
        seed: seed of the episode; an environment that is reset with this seed runs the same episode.
        size: width and height [px].
        fps: frames per second.
        speed: playback speed, as a multiple of real time.
        seconds: length of the video [s]; None: the whole episode.

    Raises:
        DependencyNotInstalled: pygame, or the library for this format, is missing.
        OSError: a policy cannot be read, or the file cannot be written.
        ValueError: there is no such policy or scenario, or the suffix of the file is unknown.
        PolicyError: a policy gave no usable action.
    """
    video = video_of(policies, scenario, seed, size=size, fps=fps, speed=speed, seconds=seconds)
    return save_video(video.frames(), Path(out), fps)

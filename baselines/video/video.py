"""Videos of several policies side by side in the same episode, as files: loops with Pillow, .mp4 with ffmpeg."""

from __future__ import annotations

import io
import math
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from gymnasium.error import DependencyNotInstalled
from numpy.typing import NDArray

from auv_gym.installation import install
from auv_gym.rendering.canvas import Color
from auv_gym.rendering.renderer import import_pygame
from auv_gym.scenarios.presets import as_scenario
from auv_gym.scenarios.scenario import Scenario
from baselines.agents.names import agent_folder
from baselines.evaluation.cells import drawn
from baselines.evaluation.score import EXPERT, ORACLE
from baselines.tools.figure_style import look
from baselines.tools.files import write_atomically
from baselines.video.layout import FrameRenderer, Panel
from baselines.video.recording import RecordedEpisode, trajectory_of

VIDEO_SIZE = (480, 360)  # default width and height [px]
FPS = 12  # default number of frames per second
SPEED = 4.0  # default playback speed, as a multiple of real time
QUALITY = 60  # of lossy compression, 0 ... 100
LAST = 1500  # [ms] duration of the last frame of a loop
_LABELS = {EXPERT: "expert", ORACLE: "oracle: known disturbances", "nmpc": "EKF + MPC", "ekf": "Kalman filter"}
"""Labels that say what kind of policy a name stands for."""
Frames = Iterable[NDArray[np.uint8]]
"""Frames of one size, arrays (height, width, 3)."""


@dataclass(frozen=True)
class Video:
    """A video of several policies in the same episode."""

    trajectories: tuple[RecordedEpisode, ...]  # one for each policy
    title: str
    size: tuple[int, int] = VIDEO_SIZE  # width and height [px]
    fps: int = FPS  # frames per second
    speed: float = SPEED  # playback speed, as a multiple of real time
    seconds: float | None = None  # length of the video [s]; None: the whole episode

    @cached_property
    def times(self) -> list[float]:
        """The times of the episode [s], one for each frame; the first frame shows the end, as a summary."""
        whole = max(float(v.time[-1]) for v in self.trajectories)
        end = whole if self.seconds is None else min(self.seconds * self.speed, whole)
        count = math.floor(end * self.fps / self.speed) + 1
        return [end, *(k * self.speed / self.fps for k in range(count))]

    def frames(self) -> Iterator[NDArray[np.uint8]]:
        """Yield the frames, arrays (height, width, 3)."""
        longest = max(self.trajectories, key=lambda v: len(v.time))
        policies = [v.policy for v in self.trajectories]
        panels = [Panel(v, label_of(v.policy), _rgb(look(v.policy, policies).colour)) for v in self.trajectories]
        paths = [view.reference[:, :2] for view in (longest, longest.side) if view]
        renderer = FrameRenderer(import_pygame(), self.size, self.title, panels, paths, self.speed)
        for time in self.times:
            yield renderer.frame_at(time)


def _rgb(colour: str) -> Color:
    """Return the numbers of a colour #rrggbb."""
    red, green, blue = bytes.fromhex(colour[1:])
    return red, green, blue


def label_of(policy: str) -> str:
    """Return a short text that says what kind of policy a name stands for."""
    return _LABELS.get(policy) or ("trained agent" if agent_folder(policy.partition(":")[0]) else "controller")


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
    In space a panel has a view from above and one from the side.

    Args:
        out: the file: .webp (a loop, needs Pillow) or .mp4 (needs imageio-ffmpeg). Its folder is created.
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
    cell = drawn(as_scenario(scenario), 1, seed)
    trajectories = tuple(trajectory_of(policy, cell.scenario, cell.episodes[0]) for policy in policies)
    video = Video(trajectories, f"{cell.scenario.name}, seed {seed}", size, fps, speed, seconds)
    return save_video(video.frames(), Path(out), fps)


def save_video(frames: Frames, out: Path, fps: int) -> Path:
    """Write frames to a file and return it; the suffix of its name, one of `WRITERS`, chooses the format.

    Raises:
        DependencyNotInstalled: the library for this format is missing.
        OSError: the file cannot be written.
        ValueError: the suffix is unknown.
    """
    if out.suffix not in WRITERS:
        raise ValueError(f"{out.name!r} is no name of a video; it must end in {', '.join(WRITERS)}")
    out.parent.mkdir(parents=True, exist_ok=True)
    WRITERS[out.suffix](frames, out, fps)
    return out


def _write_webp(frames: Frames, out: Path, fps: int) -> None:
    """Write a loop with Pillow; its last frame is shown longer."""
    try:
        from PIL import Image
    except ImportError as error:
        raise DependencyNotInstalled(f"a loop needs Pillow: {install('eval')}") from error
    first, *rest = [Image.fromarray(frame) for frame in frames]
    durations = [round(1000 / fps)] * len(rest) + [max(LAST, round(1000 / fps))]
    buffer = io.BytesIO()
    first.save(buffer, "WEBP", save_all=True, append_images=rest, duration=durations, loop=0, quality=QUALITY, method=2)
    write_atomically(out, buffer.getvalue())


def _write_mp4(frames: Frames, out: Path, fps: int) -> None:
    """Write an .mp4 with the ffmpeg of imageio-ffmpeg."""
    try:
        from imageio_ffmpeg import write_frames
    except ImportError as error:
        raise DependencyNotInstalled(f"a video needs ffmpeg: {install('render')}") from error
    video = None
    with tempfile.TemporaryDirectory(dir=out.parent) as folder:
        unfinished = Path(folder) / out.name
        try:
            for frame in frames:
                height, width = len(frame) // 2 * 2, frame.shape[1] // 2 * 2  # the codec needs even sizes
                if video is None:
                    video = write_frames(str(unfinished), (width, height), fps=fps, macro_block_size=2)
                    video.send(None)
                video.send(np.ascontiguousarray(frame[:height, :width]))
        finally:
            if video is not None:
                video.close()
        unfinished.replace(out)


WRITERS: Mapping[str, Callable[[Frames, Path, int], None]] = {".webp": _write_webp, ".mp4": _write_mp4}
"""The function that writes a file, by the suffix of its name."""

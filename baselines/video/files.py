"""Writes videos as files: loops with Pillow, .mp4 with ffmpeg."""

from __future__ import annotations

import io
import tempfile
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

import numpy as np
from gymnasium.error import DependencyNotInstalled
from numpy.typing import NDArray

from auv_gym.installation import install
from baselines.tools.files import write_atomically

Frames = Iterable[NDArray[np.uint8]]
"""Frames of one size, arrays (height, width, 3)."""
QUALITY = 60  # of lossy compression, 0 ... 100
LAST = 1500  # [ms] duration of the last frame of a loop


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
    _write_loop(frames, out, fps, "WEBP", {"quality": QUALITY, "method": 2})


def _write_gif(frames: Frames, out: Path, fps: int) -> None:
    _write_loop(frames, out, fps, "GIF", {"optimize": False})


def _write_loop(frames: Frames, out: Path, fps: int, kind: str, options: Mapping[str, object]) -> None:
    """Write a loop with Pillow; its last frame is shown longer."""
    try:
        from PIL import Image
    except ImportError as error:
        raise DependencyNotInstalled(f"a loop needs Pillow: {install('eval')}") from error
    images = [Image.fromarray(frame) for frame in frames]
    if kind == "GIF":
        palette = images[len(images) // 2].quantize(255)
        images = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    each, last = round(1000 / fps), max(LAST, round(1000 / fps))
    lengths = [each] * (len(images) - 1) + [last]
    buffer = io.BytesIO()
    images[0].save(buffer, kind, save_all=True, append_images=images[1:], duration=lengths, loop=0, **options)
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


WRITERS: Mapping[str, Callable[[Frames, Path, int], None]] = {
    ".mp4": _write_mp4,
    ".webp": _write_webp,
    ".gif": _write_gif,
}
"""The function that writes a file, by the suffix of its name."""

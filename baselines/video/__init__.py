"""Videos of policies in the same episode: `auv-gym video --help`."""

from baselines.video.video import Video, make_video

__all__ = ["Video", "make_video"]

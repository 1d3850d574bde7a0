"""Videos of policies in the same episode: `auv-gym video --help`."""

from baselines.video.video import Video, make_film

__all__ = ["Video", "make_film"]

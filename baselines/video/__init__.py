"""Moving pictures of policies in the same sea: `auv-gym video --help`."""

from baselines.video.video import Film, make_film

__all__ = ["Film", "make_film"]

"""Moving pictures of policies in the same sea: `python -m baselines.film --help`."""

from baselines.film.film import Film, make_film

__all__ = ["Film", "make_film"]

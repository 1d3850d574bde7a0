"""Ranges of seeds by purpose: no policy is evaluated on episodes that it was trained, tuned or chosen on.

Different seeds give independent episodes of a scenario. The frozen suites use keys outside of all these ranges.
"""

from __future__ import annotations

from typing import NamedTuple


class Seeds(NamedTuple):
    """A range of seeds."""

    first: int
    end: int  # first seed after the range

    def holds(self, first: int, count: int = 1) -> bool:
        """Return whether the `count` seeds that begin with `first` are all in the range."""
        return self.first <= first and first + count <= self.end


USERS = Seeds(0, 10_000_000)
"""For evaluations with --seed, examples, and users' own episodes."""
TUNING = Seeds(10_000_000, 20_000_000)
"""For the search of gains."""
TUNING_CHECK = Seeds(20_000_000, 30_000_000)
"""For the comparison of the gains that a search has found."""
VALIDATION = Seeds(30_000_000, 40_000_000)
"""For the choice of agents, where the suite has no validation episodes."""
STUDIES = Seeds(40_000_000, 150_000_000)
"""For the studies of the project."""
TRAINING = Seeds(1_000_000_000, 2**62)
"""For the training of agents."""

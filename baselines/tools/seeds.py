"""Seeds of episodes by purpose, so that no policy is judged on episodes that it was made on.

Episodes of the same scenario from different seeds have nothing in common. The frozen suites draw theirs from keys of
their own, which no range here meets.
"""

from __future__ import annotations

from typing import NamedTuple


class Seeds(NamedTuple):
    """A range of seeds."""

    first: int
    end: int  # the first one that is no longer in it

    def holds(self, first: int, count: int = 1) -> bool:
        """Return whether `count` seeds from a first one on are all in it."""
        return self.first <= first and first + count <= self.end


USERS = Seeds(0, 10_000_000)
"""Evaluations with --seed, examples, and what users draw themselves."""
TUNING = Seeds(10_000_000, 20_000_000)
"""Gains are searched for on these."""
TUNING_CHECK = Seeds(20_000_000, 30_000_000)
"""Gains that were found are compared on these."""
VALIDATION = Seeds(30_000_000, 40_000_000)
"""Agents are chosen on these, where the suite has no validation episodes."""
STUDIES = Seeds(40_000_000, 140_000_000)
"""Studies of the project measure on these."""
TRAINING = Seeds(1_000_000_000, 2**62)
"""Agents are trained on these."""

TABLE = (USERS, TUNING, TUNING_CHECK, VALIDATION, STUDIES, TRAINING)
"""Every range, in order; none overlaps another."""

"""Who draws episodes from which seeds: one table, so that nobody is judged on what he was made on.

Episodes of the same scenario from different seeds have nothing in common. The frozen suites draw theirs from keys of
their own (`research.suites.builder`), which no range here meets.
"""

from __future__ import annotations

from typing import NamedTuple


class Seeds(NamedTuple):
    """A range of seeds and whose it is."""

    first: int
    end: int  # the first one that is no longer in it
    reader: str  # the module that draws from it; "" for users of the commands
    purpose: str

    def holds(self, first: int, count: int = 1) -> bool:
        """Return whether so many seeds from a first one on are all in it."""
        return self.first <= first and first + count <= self.end


USERS = Seeds(0, 10_000_000, "", "evaluations with --seed, examples, and what users draw themselves")
"""Anybody's."""
TUNING = Seeds(10_000_000, 20_000_000, "baselines.tuning.search", "gains are searched for on these")
"""Those that gains are tuned on."""
TUNING_CHECK = Seeds(20_000_000, 30_000_000, "baselines.tuning.search", "gains that were found are compared on these")
"""Those that tuned gains are compared on."""
VALIDATION = Seeds(
    30_000_000, 40_000_000, "baselines.training.validation", "agents are chosen on these, where the suite has none"
)
"""Those that agents are validated on."""
GUARD = Seeds(40_000_000, 45_000_000, "research.robustness.thresholds", "the guard's thresholds are chosen on these")
"""Those that the guard's thresholds are chosen on."""
CERTIFICATE = Seeds(45_000_000, 55_000_000, "research.robustness.certificate", "lost episodes are counted on these")
"""Those of the episodes that are counted for a certificate."""
FALSIFICATION = Seeds(
    55_000_000,
    60_000_000,
    "research.robustness.falsification",
    "seas that lose a policy are looked for in these",
)
"""Those of the episodes in which seas are looked for that lose a policy."""
FRESH = Seeds(
    70_000_000, 80_000_000, "research.results.fresh", "policies are compared on these; nothing is chosen on them"
)
"""Those of fresh episodes."""
KNOWLEDGE = Seeds(80_000_000, 90_000_000, "research.probing.collect", "what agents know is looked for on these")
"""Those of the episodes in which memories are read and vehicles change."""
SWEEP = Seeds(
    90_000_000, 100_000_000, "research.lower_bounds.bound", "the bound is tried on these: does it lose a vehicle?"
)
"""Those of the episodes on which the bound is tried."""
ELSEWHERE = Seeds(120_000_000, 130_000_000, "research.transfer.comparison", "two simulators are compared on these")
"""Those of the episodes that run in two simulators."""
FINE_TUNING = Seeds(
    130_000_000,
    140_000_000,
    "research.trainings.fine_tuning",
    "agents that were tuned to a vehicle are compared on these",
)
"""Those that agents are compared on that were tuned to a vehicle."""
TRAINING = Seeds(1_000_000_000, 2**62, "baselines.training.config", "agents are trained on these")
"""Those that agents are trained on."""

TABLE = (
    USERS,
    TUNING,
    TUNING_CHECK,
    VALIDATION,
    GUARD,
    CERTIFICATE,
    FALSIFICATION,
    FRESH,
    KNOWLEDGE,
    SWEEP,
    ELSEWHERE,
    FINE_TUNING,
    TRAINING,
)
"""Every range, in order; none overlaps another."""

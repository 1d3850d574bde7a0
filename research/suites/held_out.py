"""Suites of held-out episodes, drawn from the cases of the frozen suites.

On their seeds no policy was trained, tuned or chosen. `python -m research suites record NAME --held-out` runs policies
and keeps the rows in `research/data/held_out/`. `make pages` compares the leads with those on the frozen episodes.
"""

from __future__ import annotations

import hashlib

from baselines.evaluation import suites
from baselines.evaluation.runner import drawn
from baselines.evaluation.suites import Suite
from research import DATA
from research.seeds import HELD_OUT

HELD_OUT_FOLDER = DATA / "held_out"
HELD_OUT_SEED = HELD_OUT.first  # seed of the first episode of each case
HELD_OUT_EPISODES = {"benchmark-v2": 64, "unmodelled-v1": 24}
"""Number of episodes of each case, by suite."""


def held_out(name: str) -> Suite:
    """Return a suite of held-out episodes, drawn from the cases of one of the frozen suites of `HELD_OUT_EPISODES`."""
    frozen, count = suites.load_suite(name), HELD_OUT_EPISODES[name]
    names = " ".join(cell.scenario.name for cell in frozen.cells)
    digest = hashlib.sha256(f"{frozen.source[1]} {HELD_OUT_SEED} {count} {names}".encode()).hexdigest()
    cells = tuple(drawn(cell.scenario, count, HELD_OUT_SEED) for cell in frozen.cells)
    return Suite(name, digest, cells, (), frozen.anchors, (frozen.source[0], digest))

"""Of the page of findings: episodes that an agent loses and the expert keeps, and the reverse, in every suite."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from auv_gym.scenarios.presets import REGIMES
from baselines.agents.names import shipped_agents
from baselines.evaluation.score import is_lost, largest_tail, regime_of
from research.pages import table
from research.results.collection import Results


def gone(results: Results, policy: str, regime: str) -> NDArray[np.bool_]:
    """Return which episodes of a regime a policy loses, case by case, shape (M,); (0,) if it did not run."""
    own = [r for r in results.runs if r.policy == policy and regime_of(r.scenario.name) == regime]
    parts = [is_lost(r.measures, largest_tail(r.scenario.name)) for r in own if r.measures]
    return np.concatenate(parts) if parts else np.zeros(0, dtype=np.bool_)


def versus_expert(results: Results, policy: str) -> tuple[int, int, int]:
    """Return how many episodes a policy loses and the expert keeps, the reverse, and how many both have run."""
    pairs = [(gone(results, policy, regime), gone(results, results.suite.anchors.zero, regime)) for regime in REGIMES]
    whole = [(mine, its) for mine, its in pairs if len(mine) == len(its)]
    lost, saved, ran = (
        sum(int(part.sum()) for part in parts)
        for parts in zip(*((m & ~i, ~m & i, np.ones_like(m)) for m, i in whole), strict=True)
    )
    return lost, saved, ran


def kept_by_the_expert(found: Sequence[Results]) -> str:
    """Return the section with every shipped agent in every suite; "" where nothing is recorded."""
    rows = []
    for name in shipped_agents():
        counts = [versus_expert(results, name) if name in results.policies else None for results in found]
        if ran := [count for count in counts if count is not None]:
            cells = ["-" if count is None else f"{count[0]} / {count[1]}" for count in counts]
            lost, saved, episodes = (sum(parts) for parts in zip(*ran, strict=True))
            rows.append([f"`{name}`", *cells, f"{lost} / {saved}", str(episodes)])
    return f"{_TEXT}\n\n{table(['agent', *(r.suite.name for r in found), 'all', 'episodes'], rows)}" if rows else ""


_TEXT = """### Episodes that the expert keeps

How many episodes an agent loses although the expert alone keeps them, and behind the stroke how many it keeps although
the expert loses them. The first number is what a correction has to answer for: [Safety](safety.md)."""

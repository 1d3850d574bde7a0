"""What can be read from an agent's memory, of vehicle and sea, as time goes on; beside what others would know."""

from __future__ import annotations

from typing import Any

import numpy as np

from auv_gym.physics.namespaces import Array
from auv_gym.scenarios.presets import PRESETS
from research.probing.collect import SOURCES, TARGETS, Collected, collected, episodes_of
from research.probing.regression import FLAT, Probed, Read, lead, linear, nonlinear, read

CASES = ("storm", "mismatch")
"""Where memories are read: with everything at once, and where the vehicle alone differs from its model."""
_EPISODES = 960
"""Episodes of each case."""
FITTED = 2 / 3
"""Share of the episodes, the first ones, that the probes are fitted to."""
INSTANTS = (5, 15, 50, 150, 300, 590)
"""Control instants at which memories are read."""
_BASE = "inputs"
"""The source that the memory's lead is over: what is in front of the network without any memory of its own."""


def probed(name: str, regime: str, episodes: int | None = None) -> dict[str, Any]:
    """Return what probes say of an agent in a regime, by case, as plain numbers.

    Args:
        name: of the agent.
        regime: "slow" or "cruise".
        episodes: of each case. None: `_EPISODES`.

    Raises:
        ValueError: the policy is unknown, or no agent that remembers.
        PolicyError: its actions are not finite.
    """
    count = episodes or _EPISODES
    found = {}
    for case in CASES:
        scenario = PRESETS[f"{regime}-{case}"]
        seen = collected(name, scenario, episodes_of(scenario, count), INSTANTS)
        found[case] = {"episodes": count, "dt": scenario.control_dt, **_of(seen, round(FITTED * count))}
    return found


def _of(seen: Collected, fitted: int) -> dict[str, Any]:
    """Return R^2 by source, target and instant; and at the last instant that of a nonlinear probe, and the lead."""
    asked = [name for name in TARGETS if seen.targets[name][-1].std() > FLAT]
    truth = np.stack([seen.targets[name] for name in asked], axis=-1)
    result: dict[str, Any] = {"targets": asked, "instants": list(INSTANTS), "linear": {}, "bent": {}}
    last: dict[str, Probed] = {}
    for source in SOURCES:
        rows = [_probe(linear, seen.sources[source][t], truth[t], fitted) for t in range(len(INSTANTS))]
        result["linear"][source] = [[_plain(r) for r in read(row)] for row in rows]
        last[source] = rows[-1]
        curved = _probe(nonlinear, seen.sources[source][-1], truth[-1], fitted)
        result["bent"][source] = [_plain(r) for r in read(curved)]
    result["lead"] = [_plain(r) for r in lead(last["memory"], last[_BASE])]
    return result


def _probe(kind: Any, source: Array, truth: Array, fitted: int) -> Probed:
    found: Probed = kind(source[:fitted], truth[:fitted], source[fitted:], truth[fitted:])
    return found


def _plain(found: Read) -> list[float]:
    return [round(value, 3) for value in found]

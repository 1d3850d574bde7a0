"""What is kept of the study of residuals: errors of every episode by situation and seed, and the first minutes."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from auv_gym.physics.namespaces import Array
from auv_gym.scenarios.presets import CASES
from baselines.evaluation.score import LARGEST_TAIL
from baselines.tools.files import guarded, read_json, write_atomically
from research import DATA

RESIDUAL_FILE = DATA / "residual.json"  # of all groups
RESIDUAL_KIND = "residual"  # kind of a group: agents that correct the expert
SCRATCH = "scratch"  # kind of a group: agents that command alone
STUCK = "stuck"  # kind of a group: the law, below a network that says nothing until it is stuck
SHIPPED_KIND = "shipped"  # kind of a group: one policy of the registry
UNIT = 1e-4
"""[m] to which errors are kept; that of an episode that was lost is the largest of its regime, no other reaches it."""
CURVE_COLUMNS = ("timesteps", "error_m", "lost")
"""Columns of a learning curve: control steps, mean capped tail RMSE [m] and share lost of the validation episodes."""


@dataclass(frozen=True)
class ResidualGroup:
    """Agents that differ in the training seed alone, or a single policy."""

    name: str
    regime: str
    kind: str  # `RESIDUAL_KIND`, `SCRATCH`, `STUCK` or `SHIPPED_KIND`
    authority: float | None  # largest correction, as a fraction of the limits; None: a policy of the registry
    date: str  # ISO 8601
    command: str  # that trains the agents; "": a single policy
    tails: Mapping[str, Array]  # [m] capped tail RMSE by situation, shape (S, M), case after case
    curves: tuple[Array, ...] = ()  # of each seed, columns `CURVE_COLUMNS`
    fingerprint: str = ""  # of the policy whose numbers these are, or of the law below the network; none for a study's

    def lost(self, situation: str) -> Array:
        """Return which episodes were lost in a situation, shape (S, M), 1 or 0."""
        return (self.tails[situation] >= LARGEST_TAIL[self.regime] - UNIT / 2).astype(np.float64)

    def by_case(self, values: Array) -> list[Array]:
        """Return values of shape (S, M) case by case, shape (S, M / cases) each."""
        return np.split(values, len(CASES), axis=1)


def whole(tail: Array, regime: str) -> list[int]:
    """Return capped tails [m], shape (M,), in whole `UNIT`; only one that was lost has the regime's largest."""
    cap = round(LARGEST_TAIL[regime] / UNIT)
    return [cap if lost else min(round(t / UNIT), cap - 1) for t, lost in zip(tail, tail >= cap * UNIT, strict=True)]


def save_groups(groups: Iterable[ResidualGroup], file: Path = RESIDUAL_FILE) -> None:
    """Write groups to a file, in place of those of the same name and regime; the others in it stay.

    Raises:
        OSError: it cannot be read or written.
        ValueError: what is there is damaged.
    """
    kept = {(g.name, g.regime): g for g in load_groups(file)} if file.exists() else {}
    kept |= {(g.name, g.regime): g for g in groups}
    file.parent.mkdir(parents=True, exist_ok=True)
    lines = (json.dumps(_record(group), allow_nan=False, separators=(",", ":")) for _, group in sorted(kept.items()))
    write_atomically(file, "[\n" + ",\n".join(lines) + "\n]\n")


def load_groups(file: Path = RESIDUAL_FILE) -> list[ResidualGroup]:
    """Return the groups of a file.

    Raises:
        OSError: it cannot be read.
        ValueError: it is damaged.
    """
    record = read_json(file)
    with guarded(f"{file} is damaged"):
        return [_group(**entry) for entry in record]


def _record(group: ResidualGroup) -> dict[str, Any]:
    tails = {name: [whole(seed, group.regime) for seed in own] for name, own in group.tails.items()}
    curves = [[[round(x, 5) for x in row] for row in curve.tolist()] for curve in group.curves]
    return {**vars(group), "tails": tails, "curves": curves}


def _group(tails: Mapping[str, Sequence[Any]], curves: Sequence[Any], **entries: Any) -> ResidualGroup:
    own = {name: np.array(rows) * UNIT for name, rows in tails.items()}
    return ResidualGroup(**entries, tails=own, curves=tuple(map(np.array, curves)))

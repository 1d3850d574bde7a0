"""Run policies with faults, with and without a check of the measurements and a guard: `python -m research faults`.

Each row is a policy in a frozen suite: faults-v1 with the check, sealed-v2 with the guard.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from auv_gym.scenarios.presets import SPEED_RANGES
from baselines.agents.names import CHECKED, GUARD
from baselines.evaluation.cells import Cell
from baselines.evaluation.recorded import speed_ranges_of
from baselines.evaluation.rollout import rollout
from baselines.evaluation.score import capped, count_failures, error_cap, in_paper_metres
from baselines.evaluation.suites import load_suite
from baselines.policies import make_policy
from research.pages import table
from research.study import Study, stamp

_FAULTS, _SEALED = "faults-v1", "sealed-v2"
_POLICIES = ("backstepping", "nmpc", "nmpc-adverse", "helm", "helm-any", f"helm-any{GUARD}=nmpc-adverse")
"""The policies in faults-v1, without and with the check."""
_AGENTS = ("helm", "helm-any", "apg-cruise", "ppo-cruise")
"""The agents in sealed-v2, without and with a guard."""
_MENDED = ("heading-frozen", "velocity-frozen", "yaw-rate-frozen", "velocity-missing")
"""The faults of which the page says how many failures are left."""


def _cells(suite: str, policy: str) -> list[Cell]:
    """Return the cells of a suite in which a policy runs: an agent for one speed range runs in that range only."""
    return load_suite(suite).cells_in(speed_ranges_of(policy))


def _measure(suite: str, policy: str, quick: bool = False) -> dict[str, Any]:
    """Return episodes, failures and the mean capped error [mm] in metres of the paper's vehicle, by scenario."""
    rows, most = {}, 2 if quick else None
    for cell in _cells(suite, policy)[:most]:
        scenario, cap = cell.scenario, error_cap(cell.scenario.name)
        ended = rollout(make_policy(policy, scenario.known), scenario, cell.episodes[:most]).measures
        measures = in_paper_metres(ended, scenario)
        rows[scenario.name] = {
            "episodes": len(measures),
            "failed": count_failures(measures, cap),
            "error_mm": round(1e3 * float(capped(measures, cap).mean()), 2),
        }
    return rows


STUDY = Study(
    "faults",
    [(_FAULTS, policy + end) for policy in _POLICIES for end in ("", CHECKED)]
    + [(_SEALED, policy + end) for policy in _AGENTS for end in ("", GUARD)],
    _measure,
    lambda suite, policy: stamp(policy, [c.scenario for c in _cells(suite, policy)], load_suite(suite).hash[:20]),
)
main = STUDY.main


def context(_: str = "") -> dict[str, Any]:
    """Return the values of the template of docs/results/faults.md."""
    values = STUDY.values()
    pairs = [[values[_FAULTS, policy + end] for end in ("", CHECKED)] for policy in _POLICIES]
    cells = list(pairs[0][0])

    def row(label: str, names: list[str]) -> list[str]:
        return [label, *(_both(*([side[name] for name in names] for side in pair)) for pair in pairs)]

    tables = []
    for speed_range in SPEED_RANGES:
        names = [name for name in cells if name.startswith(speed_range)]
        rows = [row(name.partition("-")[2].replace("-", " "), [name]) for name in names]
        tables.append((speed_range, table(["fault", *map("`{}`".format, _POLICIES)], [*rows, row("all", names)])))
    mended = [name for name in cells if name.partition("-")[2] in _MENDED]
    failures = [sum(pair[i][name]["failed"] for pair in pairs for name in mended) for i in range(2)]
    episodes = pairs[0][0][cells[0]]["episodes"]
    total = episodes * len(mended) * len(_POLICIES)
    return {"tables": tables, "episodes": episodes, "cells": len(cells), "failures": failures, "total": total}


def guards() -> list[list[str]]:
    """Return a row of docs/safety.md for each agent: episodes, and failures and error without -> with a guard."""
    values, rows = STUDY.values(), []
    for agent in _AGENTS:
        sides = [list(values[_SEALED, agent + end].values()) for end in ("", GUARD)]
        rows.append([f"`{agent}`", str(sum(row["episodes"] for row in sides[0])), _both(*sides)])
    return rows


def _both(*sides: list[Mapping[str, float]]) -> str:
    """Return failures and mean error [cm] of rows before and after a change; once if it changes nothing."""
    errors = (sum(row["error_mm"] for row in rows) / len(rows) / 10 for rows in sides)
    texts = (f"{sum(row['failed'] for row in rows)}; {e:.3g}" for rows, e in zip(sides, errors, strict=True))
    return " -> ".join(dict.fromkeys(texts))

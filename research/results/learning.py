"""The page docs/results/learning.md: scores, leads and failures of agents with several training seeds."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from auv_gym.physics.namespaces import Array
from auv_gym.scenarios.presets import SPEED_RANGES
from baselines.agents.names import shipped_agents
from baselines.evaluation.report.columns import failures_text
from baselines.evaluation.score import (
    ADVERSE_RIVAL,
    EXPERT,
    OPTIMUM_POLICY,
    RIVAL,
    Score,
    error_cap,
    has_failed,
    interval_text,
    lead,
    score_text,
    speed_range_of,
)
from research.pages import SUITE_PAGES, table
from research.results.collection import Results, results_of
from research.trainings.seed_runs import SeedRuns, trained
from research.trainings.trainings import SHORT_TRAININGS

_SUITE = "benchmark-v2"
_SEALED = "sealed-v2"


def context(_: str = "") -> dict[str, Any]:
    """Return the values of the page's template."""
    agents, results = trained(_SUITE), {name: results_of(name) for name in SUITE_PAGES}
    heads = ("agent", "seeds", "score", "lead", "95 %", "failures", "command rate")
    opened = ("agent", f"lead over {RIVAL}", f"lead over {ADVERSE_RIVAL}", "failures")
    return {
        "rival": RIVAL,
        "leads": table(heads, lead_rows(results[_SUITE], agents, RIVAL)),
        "opened": table(opened, _opened(results[_SEALED])),
        "against_expert": table(("agent", *results, "all", "episodes"), _against_expert(results)),
        "parts": table(("training", "score", "95 %", "failures"), _short_rows(results[_SUITE], agents)),
    }


def lead_rows(results: Results, agents: Mapping[str, SeedRuns], rival: str) -> list[list[str]]:
    """Return a row for each training with several seeds, except the short ones.

    Args:
        results: recorded results of the suite.
        agents: results of the trainings on the suite, by name.
        rival: the policy that a lead is relative to.
    """
    rows = []
    for name, seeds in sorted((name, seeds) for name, seeds in agents.items() if name not in SHORT_TRAININGS):
        speed_range = speed_range_of(next(iter(seeds.measures)))
        agent = name if name in shipped_agents() else name.removesuffix(f"-{speed_range}")
        base = np.mean([results.cases[case][EXPERT].smoothness.mean() for case in seeds.measures])
        rows.append([
            f"`{name}`" if agent == name else f"`{agent}`, {speed_range}",
            str(seeds.seeds),
            score_text(lead_of(results, seeds.steady_rmses, EXPERT)),
            *_texts(lead_of(results, seeds.steady_rmses, rival)),
            failures_text(seeds.failed, seeds.episodes),
            f"{seeds.smoothness / base:.2g}",
        ])  # fmt: skip
    return rows


def lead_of(results: Results, seeds: Mapping[str, Array], rival: str) -> Score:
    """Return the lead of agents with S seeds over a rival in their common episodes; over `EXPERT` it is their score.

    Args:
        results: recorded results of the suite.
        seeds: steady-state errors [m] of the agents by case, shape (S, M).
        rival: name of the policy.
    """
    cases = {case: results.cases[case] for case in seeds}
    counts = {case: min(len(cases[case][rival]), errors.shape[1]) for case, errors in seeds.items()}
    zero, theirs, one = (
        [case[policy].steady_rmse[: counts[name]] for name, case in cases.items()]
        for policy in (EXPERT, rival, OPTIMUM_POLICY)
    )
    return lead(zero, theirs, [errors[:, : counts[case]] for case, errors in seeds.items()], one)


def _texts(value: Score) -> tuple[str, str]:
    return score_text(value), interval_text(value)


def _opened(results: Results) -> list[list[str]]:
    """Return the rows of leads and failures of the shipped agents in the sealed suite."""
    rows = []
    for name in shipped_agents():
        for speed_range in SPEED_RANGES:
            if errors := results.steady_rmses(name, speed_range):
                seeds = {case: steady_rmses[None] for case, steady_rmses in errors.items()}
                leads = (_texts(lead_of(results, seeds, rival)) for rival in (RIVAL, ADVERSE_RIVAL))
                failed = np.concatenate([has_failed(results.cases[c][name], error_cap(c)) for c in errors])
                texts = (f"{mean} ({ends})" for mean, ends in leads)
                rows.append([f"`{name}`, {speed_range}", *texts, f"{failed.sum()} of {len(failed)}"])
    return rows


def versus_expert(results: Results, policy: str) -> tuple[int, int, int]:
    """Return the numbers of failures that a policy adds to those of the expert and prevents, and of episodes."""
    counts = np.zeros(3, dtype=int)
    for name, case in results.cases.items():
        if policy in case:
            failed, expert = (has_failed(case[p], error_cap(name)) for p in (policy, EXPERT))
            counts += (failed & ~expert).sum(), (~failed & expert).sum(), len(failed)
    added, prevented, episodes = counts.tolist()
    return added, prevented, episodes


def _against_expert(suites: Mapping[str, Results]) -> list[list[str]]:
    rows = []
    for name in shipped_agents():
        counts = [versus_expert(results, name) for results in suites.values()]
        added, prevented, episodes = map(sum, zip(*counts, strict=True))
        cells = [f"{count[0]} / {count[1]}" if count[2] else "-" for count in counts]
        rows.append([f"`{name}`", *cells, f"{added} / {prevented}", str(episodes)])
    return rows


def _short_rows(results: Results, agents: Mapping[str, SeedRuns]) -> list[list[str]]:
    """Return a row for each short training, the highest score first."""
    scores = {name: lead_of(results, agents[name].steady_rmses, EXPERT) for name in SHORT_TRAININGS}
    return [
        [SHORT_TRAININGS[n].about, *_texts(scores[n]), failures_text(agents[n].failed, agents[n].episodes)]
        for n in sorted(scores, key=lambda name: -scores[name].mean)
    ]

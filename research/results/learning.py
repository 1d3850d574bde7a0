"""What learning is worth, docs/results/learning.md: scores, leads and failures of agents of several training seeds."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from auv_gym.physics.namespaces import Array
from auv_gym.scenarios.presets import REGIMES
from baselines.agents.names import agent_of, shipped_agents
from baselines.evaluation import recorded
from baselines.evaluation.report.columns import lost_text
from baselines.evaluation.score import (
    ADVERSE_RIVAL,
    RIVAL,
    Score,
    interval_text,
    is_lost,
    largest_tail,
    lead,
    regime_of,
    score_text,
    seeds_score,
)
from research.pages import table
from research.results import fresh
from research.results.collection import SUITES, Results, results_of
from research.results.study_files import Study, load_studies

SHORT = "short-"  # begins the names of short trainings that differ from `short-cruise` in one thing
_RIVALS = {"benchmark-v2": RIVAL, "unmodelled-v1": ADVERSE_RIVAL}
"""The strongest controller that does not learn, by suite."""
_SEALED = "sealed-v1"
_HEADS = ("agent", "seeds", "score", "lead", "95 %", "held-out lead", "95 %", "failures", "command rate")


def context(_: str = "") -> dict[str, Any]:
    """Return the values of the page's template."""
    studies = load_studies()
    found = {name: results for name in SUITES if (results := results_of(name)) is not None}
    held_out = {results.suite.name: results for results in held_out_results()}
    return {
        "leads": {
            name: (rival, table(_HEADS, lead_rows(found[name], held_out.get(name), studies, rival)))
            for name, rival in _RIVALS.items()
        },
        "opened": table(("agent", *(f"lead over {r}" for r in _RIVALS.values()), "failures"), _opened(found[_SEALED])),
        "against_expert": table(("agent", *found, "all", "episodes"), _against_expert(found)),
        "parts": table(("training", "score", "95 %", "failures"), _short_rows(found["benchmark-v2"], studies)),
    }


def held_out_results() -> list[Results]:
    """Return what is recorded of held-out episodes, of the suites whose anchors ran."""
    runs = {
        suite: recorded.load_recorded(suite, fresh.HELD_OUT_FOLDER).runs
        for suite in map(fresh.fresh, fresh.HELD_OUT_EPISODES)
    }
    return [Results.of(suite, own) for suite, own in runs.items() if set(suite.anchors) <= {r.policy for r in own}]


def lead_rows(results: Results, held_out: Results | None, studies: Mapping[str, Study], rival: str) -> list[list[str]]:
    """Return a row of `_HEADS` for each agent of several seeds that ran in a suite.

    Args:
        results: what is recorded of the suite.
        held_out: what is recorded of its cases on held-out episodes.
        studies: agents of several training seeds, by name.
        rival: the policy over which a lead is measured.
    """
    rows = []
    for name, study in studies.items():
        own, regime = study.suites.get(results.suite.source[0]), study.regime
        if own is None or name.startswith(SHORT):
            continue
        agent = agent_of(name)
        tails = dict(zip(own.cells, own.tails, strict=True))
        again = {case: tail[None] for case, tail in _tails(held_out, agent, regime).items()} if held_out else {}
        zero, one = (_tails(results, policy, regime) for policy in results.suite.anchors)
        base = np.concatenate([m.smoothness for m in results.measures(results.suite.anchors.zero, regime)]).mean()
        rows.append([
            f"`{name}`" if agent == name else f"`{agent}`, {regime}",
            str(len(own.tails[0])),
            score_text(seeds_score([zero[c] for c in tails], own.tails, [one[c] for c in tails])),
            *_texts(_lead(results, regime, tails, rival)),
            *(_texts(_lead(held_out, regime, again, rival)) if held_out and again else ("-", "-")),
            lost_text(own.losses(), sum(tail.size for tail in own.tails)),
            f"{float(own.smoothness.mean()) / base:.2g}",
        ])  # fmt: skip
    return rows


def _tails(results: Results, policy: str, regime: str) -> dict[str, Array]:
    """Return the steady-state errors [m] of a policy by case of a speed range, shape (M,) each; {} without any."""
    own = [r for r in results.runs if r.policy == policy and regime_of(r.scenario.name) == regime]
    return {r.scenario.name: r.measures.tail for r in own if r.measures is not None}


def _lead(results: Results, regime: str, seeds: Mapping[str, Array], rival: str) -> Score:
    """Return by how much agents, errors of shape (S, M) by case, score above a rival in the episodes that both ran."""
    zero, its, one = (
        _tails(results, policy, regime) for policy in (results.suite.anchors.zero, rival, results.suite.anchors.one)
    )
    count = {case: min(len(its[case]), own.shape[1]) for case, own in seeds.items()}
    return lead(*([kind[case][..., :n] for case, n in count.items()] for kind in (zero, its, seeds, one)))


def _texts(value: Score) -> tuple[str, str]:
    return score_text(value), interval_text(value)


def _failed(results: Results, policy: str, regime: str) -> NDArray[np.bool_]:
    """Return which episodes of a speed range a policy fails, case by case, shape (M,); (0,) if it did not run."""
    own = [r for r in results.runs if r.policy == policy and regime_of(r.scenario.name) == regime]
    parts = [is_lost(r.measures, largest_tail(r.scenario.name)) for r in own if r.measures]
    return np.concatenate(parts) if parts else np.zeros(0, dtype=np.bool_)


def _opened(results: Results) -> list[list[str]]:
    """Return the leads of shipped agents in the suite that was sealed, which no study ran in, and their failures."""
    rows = []
    for name in shipped_agents():
        for regime in REGIMES:
            if own := _tails(results, name, regime):
                seeds = {case: tail[None] for case, tail in own.items()}
                leads = (_lead(results, regime, seeds, rival) for rival in _RIVALS.values())
                failed = _failed(results, name, regime)
                texts = (f"{score_text(value)} ({interval_text(value)})" for value in leads)
                rows.append([f"`{name}`, {regime}", *texts, f"{failed.sum()} of {len(failed)}"])
    return rows


def versus_expert(results: Results, policy: str) -> tuple[int, int, int]:
    """Return how many failures a policy adds to the expert's, how many it prevents, and of how many episodes."""
    pairs = [(_failed(results, policy, regime), _failed(results, "backstepping", regime)) for regime in REGIMES]
    own, its = (np.concatenate(side) for side in zip(*(p for p in pairs if len(p[0]) == len(p[1])), strict=True))
    return int((own & ~its).sum()), int((~own & its).sum()), len(own)


def _against_expert(found: Mapping[str, Results]) -> list[list[str]]:
    rows = []
    for name in shipped_agents():
        counts = [versus_expert(results, name) if name in results.policies else None for results in found.values()]
        if ran := [count for count in counts if count is not None]:
            cells = ["-" if count is None else f"{count[0]} / {count[1]}" for count in counts]
            added, prevented, episodes = map(sum, zip(*ran, strict=True))
            rows.append([f"`{name}`", *cells, f"{added} / {prevented}", str(episodes)])
    return rows


def _short_rows(results: Results, studies: Mapping[str, Study]) -> list[list[str]]:
    """Return what each part of the training contributes, the highest score first."""
    rows = []
    for study in (study for name, study in studies.items() if name.startswith(SHORT)):
        own = study.suites[results.suite.source[0]]
        zero, one = ([_tails(results, p, study.regime)[case] for case in own.cells] for p in results.suite.anchors)
        points, episodes = seeds_score(zero, own.tails, one), sum(tail.size for tail in own.tails)
        rows.append((points.mean, [study.about, *_texts(points), lost_text(own.losses(), episodes)]))
    return [row for _, row in sorted(rows, key=lambda entry: -entry[0])]

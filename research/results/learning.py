"""The page docs/results/learning.md: scores, leads and failures of agents with several training seeds."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from auv_gym.physics.namespaces import Array
from auv_gym.scenarios.presets import SPEED_RANGES
from baselines.agents.names import agent_of, shipped_agents
from baselines.evaluation import recorded
from baselines.evaluation.report.columns import failures_text
from baselines.evaluation.score import (
    ADVERSE_RIVAL,
    RIVAL,
    Score,
    error_cap,
    has_failed,
    interval_text,
    lead,
    score_text,
    seeds_score,
)
from research.pages import SUITE_PAGES, table
from research.results.collection import Results, results_of
from research.suites import held_out
from research.trainings.study import SHORT_TRAININGS
from research.trainings.study_files import Study, load_studies

_RIVALS = {"benchmark-v2": RIVAL, "unmodelled-v1": ADVERSE_RIVAL}
"""The strongest controller without learning, by suite."""
_SEALED = "sealed-v2"
_HEADS = ("agent", "seeds", "score", "lead", "95 %", "held-out lead", "95 %", "failures", "command rate")


def context(_: str = "") -> dict[str, Any]:
    """Return the values of the page's template."""
    studies = load_studies()
    found = {name: results_of(name) for name in SUITE_PAGES}
    new = {results.suite.name: results for results in held_out_results()}
    return {
        "leads": {
            name: (rival, table(_HEADS, lead_rows(found[name], new.get(name), studies, rival)))
            for name, rival in _RIVALS.items()
        },
        "opened": table(("agent", *(f"lead over {r}" for r in _RIVALS.values()), "failures"), _opened(found[_SEALED])),
        "against_expert": table(("agent", *found, "all", "episodes"), _against_expert(found)),
        "parts": table(("training", "score", "95 %", "failures"), _short_rows(found["benchmark-v2"], studies)),
    }


def held_out_results() -> list[Results]:
    """Return the recorded results on held-out episodes, of the suites whose anchors are recorded."""
    runs = {
        suite: recorded.load_recorded(suite, held_out.HELD_OUT_FOLDER).runs
        for suite in map(held_out.held_out, held_out.HELD_OUT_EPISODES)
    }
    return [Results.of(suite, own) for suite, own in runs.items() if set(suite.anchors) <= {r.policy for r in own}]


def lead_rows(results: Results, held_out: Results | None, studies: Mapping[str, Study], rival: str) -> list[list[str]]:
    """Return a row of `_HEADS` for each agent with several training seeds that ran in a suite.

    Args:
        results: recorded results of the suite.
        held_out: recorded results on held-out episodes of its cases.
        studies: agents with several training seeds, by name.
        rival: the policy that a lead is relative to.
    """
    rows = []
    for name, study in sorted(studies.items()):
        own, speed_range = study.suites.get(results.suite.source[0]), study.speed_range
        if own is None or name in SHORT_TRAININGS:
            continue
        agent = agent_of(name)
        steady_rmses = dict(zip(own.cells, own.steady_rmses, strict=True))
        new = _one_seed(_steady_rmses(held_out, agent, speed_range)) if held_out else {}
        zero, one = (_steady_rmses(results, policy, speed_range) for policy in results.suite.anchors)
        base = np.concatenate([m.smoothness for m in results.measures(results.suite.anchors.zero, speed_range)]).mean()
        rows.append([
            f"`{name}`" if agent == name else f"`{agent}`, {speed_range}",
            str(len(own.steady_rmses[0])),
            score_text(seeds_score([zero[c] for c in steady_rmses], own.steady_rmses, [one[c] for c in steady_rmses])),
            *_texts(_lead(results, speed_range, steady_rmses, rival)),
            *(_texts(_lead(held_out, speed_range, new, rival)) if held_out and new else ("-", "-")),
            failures_text(own.count_failures(), sum(steady_rmse.size for steady_rmse in own.steady_rmses)),
            f"{float(own.smoothness.mean()) / base:.2g}",
        ])  # fmt: skip
    return rows


def _steady_rmses(results: Results, policy: str, speed_range: str) -> dict[str, Array]:
    """Return the steady-state errors [m] of a policy by case of a speed range, shape (M,) each; {} without results."""
    own = results.runs_of(policy, speed_range)
    return {r.scenario.name: r.measures.steady_rmse for r in own if r.measures is not None}


def _one_seed(steady_rmses: Mapping[str, Array]) -> dict[str, Array]:
    """Return errors of shape (M,) by case as those of one training seed, shape (1, M)."""
    return {case: own[None] for case, own in steady_rmses.items()}


def _lead(results: Results, speed_range: str, seeds: Mapping[str, Array], rival: str) -> Score:
    """Return the lead of agents with S seeds, errors of shape (S, M) by case, over a rival in their common episodes."""
    zero, its, one = (
        _steady_rmses(results, policy, speed_range)
        for policy in (results.suite.anchors.zero, rival, results.suite.anchors.one)
    )
    count = {case: min(len(its[case]), own.shape[1]) for case, own in seeds.items()}
    return lead(*([kind[case][..., :n] for case, n in count.items()] for kind in (zero, its, seeds, one)))


def _texts(value: Score) -> tuple[str, str]:
    return score_text(value), interval_text(value)


def _failed(results: Results, policy: str, speed_range: str) -> NDArray[np.bool_]:
    """Return for each episode of a speed range whether a policy failed, shape (M,); shape (0,) without results."""
    own = results.runs_of(policy, speed_range)
    parts = [has_failed(r.measures, error_cap(r.scenario.name)) for r in own if r.measures]
    return np.concatenate(parts) if parts else np.zeros(0, dtype=np.bool_)


def _opened(results: Results) -> list[list[str]]:
    """Return the rows of leads and failures of the shipped agents in the sealed suite."""
    rows = []
    for name in shipped_agents():
        for speed_range in SPEED_RANGES:
            if own := _steady_rmses(results, name, speed_range):
                leads = (_lead(results, speed_range, _one_seed(own), rival) for rival in _RIVALS.values())
                failed = _failed(results, name, speed_range)
                texts = (f"{score_text(value)} ({interval_text(value)})" for value in leads)
                rows.append([f"`{name}`, {speed_range}", *texts, f"{failed.sum()} of {len(failed)}"])
    return rows


def versus_expert(results: Results, policy: str) -> tuple[int, int, int]:
    """Return the numbers of failures that a policy adds to those of the expert and prevents, and of episodes."""
    pairs = [
        (_failed(results, policy, speed_range), _failed(results, "backstepping", speed_range))
        for speed_range in SPEED_RANGES
    ]
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
    """Return a row for each short training, the highest score first."""
    rows = []
    for name, variant in SHORT_TRAININGS.items():
        study = studies[name]
        own = study.suites[results.suite.source[0]]
        zero, one = (
            [_steady_rmses(results, p, study.speed_range)[case] for case in own.cells] for p in results.suite.anchors
        )
        score, episodes = seeds_score(zero, own.steady_rmses, one), sum(errors.size for errors in own.steady_rmses)
        rows.append((score.mean, [variant.about, *_texts(score), failures_text(own.count_failures(), episodes)]))
    return [row for _, row in sorted(rows, key=lambda entry: -entry[0])]

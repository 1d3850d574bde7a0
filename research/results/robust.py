"""The section of the results page on how robust a lead is: one table a regime, from recorded rows alone."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from auv_gym.physics.namespaces import Array
from auv_gym.scenarios.presets import REGIMES
from baselines.evaluation.score import FORESIGHTED, LARGEST_TAIL, RIVAL, capped, fixed, regime_of
from research.pages import table
from research.results.collection import Results, results_of
from research.results.leads import COMPARISONS, LEVEL, WORST_LEFT_OUT, LeadEstimate, holm, ratios
from research.results.study_files import Study, load_studies

_WORST_PERCENT = f"{100 * WORST_LEFT_OUT:.0f}"
_LEFT_OUT = (*FORESIGHTED, "open-loop", "backstepping", "integral")
"""What the names of policies without a row begin with: those that nobody can be, and those far behind."""


def context(_: str) -> dict[str, Any]:
    """Return the body of the page."""
    results = results_of("benchmark-v2")
    return {"body": _section(results, load_studies()) if results else ""}


def _section(results: Results, studies: Mapping[str, Study]) -> str:
    """Return the section's text, "" where the rival is not recorded.

    Args:
        results: what is recorded of the suite.
        studies: agents of several seeds, by name.
    """
    if RIVAL not in results.policies:
        return ""
    return "\n\n".join([_INTRODUCTION, *(_regime(results, studies, regime) for regime in REGIMES)])


_INTRODUCTION = f"""## How robust a lead is

The score pools errors, so a few bad episodes can make or unmake a lead. Here are tails over those of `{RIVAL}` in the
same episodes of the benchmark, none counted above the cap, below 1 is nearer: the ratio of the means over all episodes
(*pooled*) and over the *storm* alone; *median* and *geometric mean* of the ratios of single episodes, in which a calm
episode with an error of micrometres counts as much as a storm; and the ratio of the means without the episodes that
are among the worst {_WORST_PERCENT} % of either side. In brackets 95 % intervals by bootstrap over episodes and, where
there are several, training seeds; in *italics* what differs from 1 no more than chance may, after Holm's correction
over all entries of the table. The paper's law, its variants with an integral and `open-loop` are far behind and left
out."""


def _regime(results: Results, studies: Mapping[str, Study], regime: str) -> str:
    rival = {case: tail[0] for case, tail in tails_of(RIVAL, results, {}, regime).items()}
    sides = {}
    for policy in results.policies:
        if policy == RIVAL or policy.startswith(_LEFT_OUT):
            continue
        if own := tails_of(policy, results, studies, regime):
            count = {case: min(len(rival[case]), tail.shape[1]) for case, tail in own.items()}
            shorter = ({case: tails[case][..., :n] for case, n in count.items()} for tails in (rival, own))
            sides[policy] = len(next(iter(own.values()))), ratios(*shorter)
    entries = [(policy, kind) for policy, (_, found) in sides.items() for kind in found]
    corrected = dict(zip(entries, holm([sides[policy][1][kind].p for policy, kind in entries]), strict=True))
    rows = [
        [f"`{policy}`", str(seeds), *(_text(found[kind], corrected[policy, kind]) for kind in COMPARISONS)]
        for policy, (seeds, found) in sorted(sides.items(), key=lambda side: side[1][1]["pooled"].value)
    ]
    return table([regime, "seeds", *COMPARISONS], rows)


def tails_of(policy: str, results: Results, studies: Mapping[str, Study], regime: str) -> dict[str, Array]:
    """Return the capped tails [m] of a policy by case of a regime, shape (S, M), of all seeds where it has a study.

    Args:
        policy: its name.
        results: what is recorded of a suite.
        studies: agents of several seeds, by name.
        regime: "slow" or "cruise".
    """
    study = studies.get(policy) or studies.get(f"{policy}-{regime}")  # that of one agent for both regimes
    if study is not None and study.regime == regime and (own := study.suites.get(results.suite.source[0])) is not None:
        return dict(zip(own.cells, own.capped(), strict=True))
    found = [r for r in results.runs if r.policy == policy and regime_of(r.scenario.name) == regime]
    return {r.scenario.name: capped(r.measures, LARGEST_TAIL[regime])[None] for r in found if r.measures is not None}


def _text(estimate: LeadEstimate, p: float) -> str:
    low, high = (_digits(end) for end in estimate.ci95)
    text = f"{_digits(estimate.value)} ({low} ... {high})"
    return text if p < LEVEL else f"*{text}*"


def _digits(value: float) -> str:
    return fixed(value, 2 if value < 10 else 1) if value < 1000 else f"{value:.0f}"

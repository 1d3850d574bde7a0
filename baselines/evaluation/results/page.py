"""The text of the results page, docs/results.md."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from baselines.evaluation.metrics import Measures, cvar, ratio
from baselines.evaluation.results.collection import TOLERANCE, Results, better_than_oracle
from baselines.evaluation.score import EXPERT, ORACLE, Pooled, interval_text, paired, regime_of, score_text


def page(found: Sequence[Results], missing: Sequence[str], learned: str = "") -> str:
    """Return the text of docs/results.md, with a section on learned agents, if there is one, behind the suites."""
    parts = [INTRODUCTION]
    for results in found:
        regimes = list(dict.fromkeys(entry.regime for entry in results.pooled))
        parts += [_setting(results), *(_regime(results, regime) for regime in regimes)]
        parts += [_cases(results, regimes), _oracle(results)]
    for name in missing:
        parts.append(f"## {name}\n\nNot recorded yet: `python -m baselines.evaluation.suites record {name}`.")
    return "\n\n".join([*parts, *([learned] if learned else [])]) + "\n"


INTRODUCTION = """# Results

<!-- Made by `python -m baselines.evaluation.results`; do not edit. -->

Every policy on the frozen suites, from the rows in `baselines/evaluation/data/recorded/`. `make results` writes this
page; `python -m baselines.evaluation.suites record SUITE [--policy P ...]` runs policies again.
[Evaluation](metrics.md) has the definitions. In short: *score* is 0 for the expert and 1 for the oracle, errors pooled
over cases, with a 95 % interval; *capped* counts no tail error above .6 m (slow) or 2 m (cruise), and *lost* is the
share of episodes that reach it; *tail*, *p95* and *worst 5 %* are mean, 95th percentile and mean of the worst of the
tail errors; *effort* and *rate* are relative to the expert's; *ms* is a policy's time for one decision, many vehicles
side by side on one processor."""


def _setting(results: Results) -> str:
    suite = results.suite
    by_date: dict[str, list[str]] = {}
    for run_ in results.runs:
        assert run_.recorded is not None
        versions = ", ".join(f"{name} {version}" for name, version in run_.recorded.versions.items())
        policies = by_date.setdefault(f"{run_.recorded.date} with {versions}", [])
        policies += [run_.policy] if run_.policy not in policies else []
    when = "; ".join(f"{_all_or_names(policies, results)} on {date}" for date, policies in by_date.items())
    episodes = sum(len(cell.episodes) for cell in suite.cells)
    return (
        f"## {suite.name}\n\n{len(suite.cells)} cases, {episodes} episodes, SHA-256 `{suite.hash}`.\n"
        f"Recorded: {when}.\n\n![Scores on {suite.name}](images/results-{suite.name}-scores.png)"
    )


def _all_or_names(policies: Sequence[str], results: Results) -> str:
    return "all" if len(policies) == len(results.policies) else ", ".join(policies)


def table(names: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a Markdown table, its first column to the left and the others to the right."""
    lines = [names, ["---", *("--:" for _ in names[1:])], *rows]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


def _regime(results: Results, regime: str) -> str:
    names = ("policy", "score", "95 %", "capped", "lost", "tail [m]", "p95 [m]", "worst 5 % [m]", "effort", "rate",
             "saturated", "ms", "episodes")  # fmt: skip
    rows = [_row(results, entry) for entry in results.pooled if entry.regime == regime]
    return f"### {regime}\n\n{table(names, rows)}"


def _row(results: Results, entry: Pooled) -> list[str]:
    own, expert = (results.measures(policy, entry.regime) for policy in (entry.policy, EXPERT))
    tail = np.concatenate([m.tail for m in own])
    pairs = [paired(a, b) for a, b in zip(own, expert, strict=True)]
    a, b = (Measures.joined(column) for column in zip(*pairs, strict=True))
    ratios = [
        ratio(float(np.mean(x)), float(np.mean(y))) for x, y in ((a.effort, b.effort), (a.smoothness, b.smoothness))
    ]
    saturated = float((a.saturation * a.steps).sum() / a.steps.sum())
    runs = (r for r in results.runs if r.policy == entry.policy and regime_of(r.scenario.name) == entry.regime)
    return [
        f"`{entry.policy}`",
        score_text(entry.score, 2),
        interval_text(entry.score, 2),
        score_text(entry.capped, 2),
        f"{100 * entry.lost:.2f} %",
        *(f"{value:.3g}" for value in (entry.tail_m, float(np.quantile(tail, 0.95)), cvar(tail))),
        *(f"{value:.2f}" for value in ratios),
        f"{100 * saturated:.1f} %",
        f"{1e3 * float(np.mean([r.decision_seconds for r in runs])):.2g}",
        str(entry.episodes),
    ]


def _cases(results: Results, regimes: Sequence[str]) -> str:
    """Return the scores of each case, regime by regime."""
    parts = ["### Case by case\n\nScores in each case alone; where the expert leaves little to gain they mean little."]
    parts.append(f"![Scores case by case](images/results-{results.suite.name}-cases.png)")
    for regime in regimes:
        cases = [c.scenario.name for c in results.suite.cells if regime_of(c.scenario.name) == regime]
        rows = [
            [f"`{policy}`", *(score_text(results.scores[policy].get(case), 2) for case in cases)]
            for policy in results.policies
        ]
        parts.append(table([regime, *(case.removeprefix(f"{regime}-") for case in cases)], rows))
    return "\n\n".join(parts)


def _oracle(results: Results) -> str:
    """Return in how many cases the oracle is the best."""
    better = better_than_oracle(results)
    cases = len(results.suite.cells) - len({case for case, _, _ in better})
    text = (
        f"### The oracle\n\nIts mean tail error is the smallest of all in {cases} of {len(results.suite.cells)} cases."
    )
    for case, policy, gain in better:
        own = 1e3 * results.tails[ORACLE][case]
        text += f" In `{case}` that of `{policy}` is {1e3 * gain:.3f} mm smaller in the same episodes,"
        text += f" its own over all is {own:.3f} mm."
    return text + f" More than {1e3 * TOLERANCE[results.suite.name]:g} mm is an error of `make results`."

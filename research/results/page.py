"""The text of the results page, docs/results.md."""

from __future__ import annotations

from collections.abc import Sequence

from baselines.evaluation import suites
from baselines.evaluation.report.columns import NONE, ranked, used
from baselines.evaluation.report.numbers import pool
from baselines.evaluation.score import BOUND, ORACLE, regime_of, score_text
from research.lower_bounds import bound
from research.pages import table
from research.results.collection import ROUNDING, TOLERANCE, Results, better_than
from research.results.left import what_is_left
from research.results.navigation import navigation


def page(found: Sequence[Results], missing: Sequence[str], learned: str = "", first: str = "") -> str:
    """Return the text of docs/results.md, with a section before the suites and one behind them, if there are such."""
    parts = [INTRODUCTION, *([first] if first else [])]
    for results in found:
        regimes = list(dict.fromkeys(entry.place for entry in results.pooled))
        parts += [_setting(results), *(_regime(results, regime) for regime in regimes)]
        parts += [_cases(results, regimes), *what_is_left(results), *navigation(results, regimes)]
        parts += [_oracle(results), *_elsewhere(results)]
    for name in missing:
        parts.append(f"## {name}\n\nNot recorded yet: `python -m research suites record {name}`.")
    return "\n\n".join([*parts, *([learned] if learned else [])]) + "\n"


INTRODUCTION = """# Results

<!-- Made by `python -m research results`; do not edit. -->

Every policy on the frozen suites, from the rows in `baselines/evaluation/data/recorded/`. `make results` writes this
page; `python -m research suites record SUITE [--policy P ...]` runs policies again, and `make verify` looks
whether they still give these numbers. [Evaluation](metrics.md) has the definitions of the columns."""


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
    own = f"The episodes are those of {suite.same_as[0]}. " if suite.same_as else ""
    image = f"![Scores on {suite.name}](images/results-{suite.name}-scores.png)"
    return (
        f"## {suite.name}\n\n{len(suite.cells)} cases, {episodes} episodes, SHA-256 `{suite.hash}`.\n"
        f"{own}The score's 0 is `{suite.anchors.zero}`, its 1 `{suite.anchors.one}`. Recorded: {when}.\n\n{image}"
    )


def _all_or_names(policies: Sequence[str], results: Results) -> str:
    return "all" if len(policies) == len(results.policies) else ", ".join(policies)


def _regime(results: Results, regime: str) -> str:
    entries = ranked([entry for entry in results.pooled if entry.place == regime])
    columns = used(entries)
    rows = [[f"`{entry.policy}`", *(column.text(entry) for column in columns)] for entry in entries]
    return f"### {regime}\n\n{table(['policy', *(column.heading for column in columns)], rows)}"


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
    """Return in how many cases the oracle is the best of all but the bound, and whether that is one."""
    better = better_than(ORACLE, results)
    cases = len(results.suite.cells) - len({case for case, _, _ in better})
    text = f"### The oracle\n\nIts mean tail error is the smallest in {cases} of {len(results.suite.cells)} cases"
    text += f", `{BOUND}` apart."
    for case, policy, gain in better:
        own = 1e3 * results.tails[ORACLE][case]
        text += f" In `{case}` that of `{policy}` is {1e3 * gain:.3f} mm smaller in the same episodes,"
        text += f" its own over all is {own:.3f} mm."
    text += f" More than {1e3 * TOLERANCE[results.suite.name]:g} mm is an error of `make results`."
    return f"{text}\n\n{_bound(results)}"


def _elsewhere(results: Results) -> list[str]:
    """Return the scores that the same rows have in the suite whose episodes these are, with its anchors."""
    if results.suite.same_as is None:
        return []
    source = suites.load(results.suite.same_as[0])
    scores = {(e.policy, e.place): score_text(e.score) for e in pool(results.runs, source.anchors)}
    places = list(dict.fromkeys(place for _, place in scores))
    rows = [[f"`{p}`", *(scores.get((p, place), NONE) for place in places)] for p in results.policies]
    text = f"### The same scores in {source.name}\n\nIts 1 is `{source.anchors.one}`, a little farther from the"
    return [f"{text} reference, so the same errors score a little higher.", table(("policy", *places), rows)]


def _bound(results: Results) -> str:
    """Return what the bound leaves to the oracle, and who is better than it."""
    if BOUND not in results.tails:
        return f"### The bound\n\n`{BOUND}` is not recorded yet."
    least, most = (1e3 * end(results.tails[BOUND].values()) for end in (min, max))
    beaten = [(c, p, g) for c, p, g in better_than(BOUND, results) if g > ROUNDING]
    names = ", ".join(f"`{policy}` in `{case}`" for case, policy, _ in beaten) or "nobody, in no case"
    return (
        f"### The bound\n\n`{BOUND}` knows everything beforehand and optimises its commands over the whole episode. "
        f"Its mean tail error is {least:.3f} to {most:.3f} mm, case by case. Better than it by more than the "
        f"{1e3 * ROUNDING:g} mm to which it is solved: {names}.{_tried(results)}"
    )


def _tried(results: Results) -> str:
    """Return what came of trying the bound on episodes of the same cases, where those are known."""
    counts = bound.kept()
    if not {cell.scenario.name for cell in results.suite.cells} <= set(counts):
        return ""
    return f" On fresh episodes of these cases (`{bound.PROGRAM}`): {bound.told(counts)}."

"""The section on learned agents of the results page, docs/results.md."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from auv_gym.physics.namespaces import Array
from baselines.evaluation.report.columns import lost_text
from baselines.evaluation.score import EXPERT, RIVAL, capped, interval_text, largest_tail, lead, score_text, seeds_score
from baselines.tools.figure_style import LOOKS, REFERENCE_STYLE, panels, to_png
from research.pages import table
from research.results.collection import Results, results_of
from research.results.study_files import InSuite, Study, load_studies

"""The strongest of the controllers that do not learn."""
SHORT = "short-"
"""Begins the names of short trainings that differ in one thing; their learning curves have a figure of their own."""


def context(_: str) -> dict[str, Any]:
    """Return the body of the page."""
    results = results_of("benchmark-v2")
    return {"body": studies_section(load_studies(), [results] if results else [])}


def figures(_: str) -> dict[str, bytes]:
    """Return the learning curves as PNG by name."""
    return {name: to_png(curves_figure(own)) for name, own in figures_of(load_studies()).items()}


def studies_section(studies: Mapping[str, Study], found: Sequence[Results]) -> str:
    """Return the section's text for studies and what is recorded of the suites."""
    if not studies:
        return ""
    parts = [_INTRODUCTION]
    for regime in dict.fromkeys(study.regime for study in studies.values()):
        own = {name: study for name, study in studies.items() if study.regime == regime}
        parts.append(f"### {regime}")
        parts += [f"![Learning curves, {regime}](images/{name})" for name in figures_of(own)]
        for results in found:
            rows = [
                _row(name, study, results) for name, study in own.items() if results.suite.source[0] in study.suites
            ]
            if rows:
                parts.append(f"On {results.suite.name}:\n\n{table(_NAMES, rows)}")
    return "\n\n".join(parts)


_INTRODUCTION = f"""## Learned agents, several seeds

Each row is one way of training, repeated with several seeds; `python -m research study` makes it. *steps* are
control steps, summed over vehicles; *score* and its interval are over training seeds and episodes; *lead* is the
score's distance to `{RIVAL}`, the strongest controller that does not learn, with an interval of the same kind; *lost*
adds up all seeds' episodes; *effort* and *rate* are relative to the expert's; *minutes* are the wall time of a
training, two at a time on a machine that was more or less busy with other work, so that only steps compare."""
_NAMES = (
    "agent",
    "steps",
    "seeds",
    "score",
    "95 %",
    f"lead over {RIVAL}",
    "95 %",
    "capped",
    "lost",
    "effort",
    "rate",
    "ms",
)


def _row(name: str, study: Study, results: Results) -> list[str]:
    own, regime = study.suites[results.suite.source[0]], study.regime
    zero, one = (_tails(results, policy, own) for policy in results.suite.anchors)
    low, high = (_tails(results, policy, own, cut=True) for policy in results.suite.anchors)
    score, below_cap = seeds_score(zero, own.tails, one), seeds_score(low, own.capped(), high)
    above = None
    if RIVAL in results.policies:
        rival = _tails(results, RIVAL, own)
        count = [len(tail) for tail in rival]  # it may have run fewer
        few = [[tail[..., :n] for tail, n in zip(kind, count, strict=True)] for kind in (zero, own.tails, one)]
        above = lead(few[0], rival, few[1], few[2])
    base = results.measures(EXPERT, regime)
    effort, rate = (float(np.concatenate([getattr(m, key) for m in base]).mean()) for key in ("effort", "smoothness"))
    episodes = sum(tail.size for tail in own.tails)
    return [
        f"`{name}`",
        f"{_last(study, 0) / 1e6:.3g} M",
        str(len(own.tails[0])),
        score_text(score, 3),
        interval_text(score, 3),
        score_text(above, 3),
        interval_text(above, 3),
        score_text(below_cap, 3),
        lost_text(own.losses(), episodes),
        f"{float(own.effort.mean()) / effort:.2f}",
        f"{float(own.smoothness.mean()) / rate:.2f}",
        f"{1e3 * own.decision_seconds:.2g}",
    ]


def _tails(results: Results, policy: str, own: InSuite, cut: bool = False) -> list[Array]:
    """Return a policy's tails in the cells that agents ran in, shape (M,) each, cut at `score.LARGEST_TAIL` or not."""
    by_case = {r.scenario.name: r.measures for r in results.runs if r.policy == policy and r.measures is not None}
    tails = (capped(by_case[cell], largest_tail(cell)) if cut else by_case[cell].tail for cell in own.cells)
    return [tail[: ran.shape[1]] for tail, ran in zip(tails, own.tails, strict=True)]


def _last(study: Study, column: int) -> float:
    """Return where the learning curves end, the mean over seeds."""
    return float(np.mean([curve[-1, column] for curve in study.curves]))


def figures_of(studies: Mapping[str, Study]) -> dict[str, dict[str, Study]]:
    """Return the figures of learning curves by file name, with the studies in each; regimes and lengths apart."""
    figures: dict[str, dict[str, Study]] = {}
    for name, study in studies.items():
        kind = "short" if name.startswith(SHORT) else "learning"
        figures.setdefault(f"results-{kind}-{study.regime}.png", {})[name] = study
    return dict(sorted(figures.items()))


def curves_figure(studies: Mapping[str, Study]) -> Figure:
    """Return the learning curves of studies: mean over seeds, with the range of the seeds."""
    figure, [axes] = panels(1, 2, (7.4, 3.2), sharey=True)
    axes[0].set_ylabel("score on validation episodes")
    for ax, column, unit, label in zip(
        axes, (0, 1), (1e6, 60.0), ("control steps [million]", "wall time [min]"), strict=True
    ):
        ax.set_xlabel(label)
        ax.axhline(0.0, **REFERENCE_STYLE)
        for i, (name, study) in enumerate(studies.items()):
            x = np.mean([curve[:, column] for curve in study.curves], axis=0) / unit
            scores = np.array([curve[:, 2] for curve in study.curves])
            line = LOOKS[i].line
            ax.plot(x, scores.mean(axis=0), **line, label=name)
            ax.fill_between(x, scores.min(axis=0), scores.max(axis=0), color=line["color"], alpha=0.15, linewidth=0)
    axes[0].set_ylim(-0.2, 1.02)
    axes[0].set_xscale("log", nonpositive="mask")  # some learn from forty times fewer steps than others
    axes[0].xaxis.set_major_locator(LogLocator(subs=(1.0, 3.0)))
    axes[0].xaxis.set_major_formatter("{x:g}")
    axes[0].xaxis.set_minor_formatter("")
    axes[1].legend(fontsize=7, loc="lower right")
    return figure

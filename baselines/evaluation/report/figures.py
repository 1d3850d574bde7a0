"""All pictures of an evaluation, as PNG."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from matplotlib.figure import Figure

from baselines.evaluation.report.numbers import Result
from baselines.evaluation.report.plots import error_over_time, tail_error, trajectories
from baselines.evaluation.report.score_plots import error_distribution, score_by_case
from baselines.tools.figure_style import styled, to_png

_DRAWN: tuple[Callable[[Sequence[Result], Sequence[str]], Figure | None], ...] = (
    score_by_case,
    tail_error,
    error_distribution,
    error_over_time,
    trajectories,
)


def evaluation_figures(results: Sequence[Result]) -> dict[str, bytes]:
    """Return the figures of an evaluation as PNG, by name; failed results are left out."""
    done = [result for result in results if result.entry.summary is not None]
    if not done:
        return {}
    policies = list(dict.fromkeys(result.run.policy for result in done))
    figures = {}
    for draw in _DRAWN:
        with styled():
            if (figure := draw(done, policies)) is not None:
                figures[draw.__name__] = to_png(figure)
    return figures

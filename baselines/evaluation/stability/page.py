"""stability.html: what `evaluate.py --stability` finds, verdicts first."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from baselines.evaluation.report.charts import rate_chart
from baselines.evaluation.report.page import mixed, render_report
from baselines.evaluation.report.page_data import look_of
from baselines.evaluation.stability.certificate import MISSING, installed
from baselines.evaluation.stability.tables import Stability, decay_texts, sheets
from baselines.evaluation.stability.verdicts import stable, verdicts

STRONG = 0.3  # [1/s] rate that has the full colour
WITH_MEMORY = "It has a memory: the loop is looked at from one control period to the next, as in the presets."
"""Said of a policy with memory."""


def stability_html(found: Sequence[Stability], command: str) -> str:
    """Return the text of the page about some policies."""
    rows = [
        {"policy": s.policy, "speed": U, "turn": w, "rate": rate}
        for s in found
        for U, row in zip(s.speeds, s.abscissa, strict=True)
        for w, rate in zip(s.turn_rates, row, strict=True)
        if math.isfinite(rate)
    ]
    return render_report(
        "stability.html",
        {"charts": {"rates": rate_chart([s.policy for s in found])}, "rows": {"rates": rows}},
        ("figures.js",),
        title="Stability about steady motion",
        command=command,
        looks=[look_of(s.policy, [each.policy for each in found]) for s in found],
        turn_rates=found[0].turn_rates,
        policies=[_policy(s) for s in found],
    )


def _policy(s: Stability) -> dict[str, Any]:
    return {
        "name": s.policy,
        "verdicts": verdicts(s),
        "memory": WITH_MEMORY if s.largest_period is None else "",
        "missing": "" if installed() or s.largest_period is None else MISSING,
        "lines": [
            (f"{U:g}", [(text, _colour(rate)) for text, rate in zip(texts, rates, strict=True)])
            for U, texts, rates in zip(s.speeds, decay_texts(s), s.abscissa, strict=True)
        ],
        "sheets": sheets(s)[1:],
    }


def _colour(rate: float) -> str:
    """Return the colour of a rate of growth: blue fades, orange grows."""
    if math.isnan(rate):
        return "#e9e9e6"
    return mixed(-1.0 if math.isinf(rate) else (1 if stable(rate) else -1) * min(1.0, abs(rate) / STRONG))

"""Draws the report's charts as PNG files, from the same specifications as the page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import vl_convert

from baselines.evaluation.report.charts import Spec
from baselines.evaluation.report.numbers import Entry, Result
from baselines.evaluation.report.page_data import page_data
from baselines.evaluation.score import FORESIGHTED

_WIDTH = 640  # [px] width of a chart without its axis
_SCALE = 2.0  # resolution of the file, relative to the chart


def charts_png(results: Sequence[Result], pooled: Sequence[Entry]) -> dict[str, bytes]:
    """Return PNG charts by name: scores of speed ranges, steady-state errors and errors over time of scenarios."""
    data = page_data(results, pooled)
    specs, scenarios, found = data["charts"], data["scenarios"], {}
    for speed_range in dict.fromkeys(s["speed_range"] for s in scenarios if s["speed_range"]):
        rows = [
            {"policy": row["policy"], "case": s["case"], "failed": row["failed"], **row["score"]}
            for s in scenarios
            for row in s["rows"]
            if s["speed_range"] == speed_range and row["score"] and row["policy"] not in FORESIGHTED
        ]
        if rows:
            found[f"scores-{speed_range}"] = _png(specs["scores"], rows)
    for s in scenarios:
        steady_rmses = [{"policy": row["policy"], "failed": row["failed"], **row["steady_rmse"]} for row in s["rows"]]
        found[f"steady-rmse-{s['name']}"] = _png(specs["steady_rmses"], steady_rmses)
        names = "t", "low", "middle", "high"
        bands = [
            {"policy": band["policy"], **dict(zip(names, values, strict=True))}
            for band in s["bands"]
            for values in zip(*(band[name] for name in names), strict=True)
        ]
        if bands:
            found[f"errors-{s['name']}"] = _png(specs["bands"], bands, {"steady_rmses": [{"t": s["duration"] / 3}]})
    return found


def _png(spec: Spec, rows: Sequence[Any], others: Mapping[str, Any] | None = None) -> bytes:
    """Return a chart with its rows and a legend as a PNG file."""
    names = list(dict.fromkeys(row["policy"] for row in rows))
    filled = {**_with_legend(spec, names), "width": _WIDTH, "datasets": {"rows": rows, **(others or {})}}
    picture: bytes = vl_convert.vegalite_to_png(filled, scale=_SCALE)
    return picture


def _with_legend(node: Any, names: Sequence[str]) -> Any:
    """Return a specification with a legend of these policies; on the page their table is the legend."""
    if isinstance(node, list):
        return [_with_legend(item, names) for item in node]
    if not isinstance(node, dict):
        return node
    legend = {"title": None, "orient": "bottom", "columns": 4, "symbolOpacity": 1, "symbolLimit": 0, "values": names}
    kept = {key: _with_legend(value, names) for key, value in node.items()}
    if "color" in kept and isinstance(kept["color"], dict) and "field" in kept["color"]:
        kept["color"] = {**kept["color"], "legend": legend}
    return kept

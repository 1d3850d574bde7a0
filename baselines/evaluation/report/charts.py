"""The Vega-Lite specifications of the report's charts: marks and scales; the page adds the data."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from baselines.evaluation.score import SCALE
from baselines.tools.figure_style import DASHES, OUTLINES, look

Spec = dict[str, Any]

_LINE: Spec = {"type": "line", "strokeWidth": 1.8}  # style of a curve
_POLICY_TOOLTIP = [{"field": "policy", "title": "policy"}]
GUIDE_COLOUR = "#8a8a8a"  # colour of auxiliary lines
_DOTTED: Spec = {"type": "rule", "strokeDash": [2, 3], "color": GUIDE_COLOUR}  # style of an auxiliary line


def charts(policies: Sequence[str]) -> dict[str, Spec]:
    """Return the charts of an evaluation by name, with the looks of the policies."""
    styles = [look(policy, policies) for policy in policies]
    ranges: dict[str, list[Any]] = {
        "color": [style.colour for style in styles],
        "strokeDash": [list(DASHES[style.dash][1]) or [1, 0] for style in styles],
        "shape": [OUTLINES[style.marker] for style in styles],
    }
    looks = {  # the encoding of the policy in each channel, without a legend, since the leaderboard is one
        channel: {
            "field": "policy", "type": "nominal", "scale": {"domain": list(policies), "range": values}, "legend": None,
        }
        for channel, values in ranges.items()
    }  # fmt: skip
    colour, dash, shape = ({channel: looks[channel]} for channel in ranges)
    return {
        "scores": _scores(colour, colour | shape),
        "steady_rmses": _steady_rmses(colour, colour | shape),
        "shares": _shares(colour | dash),
        "bands": _bands(colour, colour | dash),
        "errors": _errors(colour | dash),
    }


def _number(field: str, title: str | None = None, log: bool = False, **scale: Any) -> Spec:
    kind = {"type": "log"} if log else {}
    axis = {"title": title, "labelSeparation": 6, "tickCount": 5}
    scales = {**kind, "zero": False, "nice": True, **scale}
    return {"field": field, "type": "quantitative", "axis": axis, "scale": scales}


def _tooltip(**titles: str) -> list[Spec]:
    """Return the tooltip of a mark from the titles of its fields."""
    return [{"field": field, "title": title} for field, title in titles.items()]


def _frame(layer: list[Spec], **more: Any) -> Spec:
    """Return a chart with the data set that the page fills."""
    return {"data": {"name": "rows"}, "width": "container", "layer": layer, **more}


def _scores(colour: Spec, point: Spec) -> Spec:
    """Return the chart of the score of each policy with its interval, with a group of rows for each case."""
    tooltip = _tooltip(policy="policy", case="case", text="score", failed="failed")
    limits: Spec = {"domainMin": {"expr": "max(-1, least)"}, "domainMax": 1.05, "nice": False}
    x, bands = _number("value", f"score: {SCALE}", **limits), {"title": None, "grid": True, "tickBand": "extent"}
    place = {
        "y": {"field": "case", "type": "nominal", "sort": None, "axis": bands},
        "yOffset": {"field": "policy", "type": "nominal", "sort": None, "scale": {"paddingOuter": 0.4}},
    }
    guide = {"type": "rule", "color": GUIDE_COLOUR, "strokeWidth": 1}
    return _frame(
        [
            *({"mark": guide, "encoding": {"x": {"datum": at}}} for at in (0.0, 1.0)),
            {
                "mark": {"type": "rule", "strokeWidth": 2.2, "clip": True},
                "encoding": {"x": {**x, "field": "low"}, "x2": {"field": "high"}, **place, **colour},
            },
            {
                "mark": {"type": "point", "filled": True, "size": 42, "opacity": 1, "clip": True},
                "encoding": {"x": x, **place, **point, "tooltip": tooltip},
            },
        ],
        params=[{"name": "least", "value": -0.1}],
        height={"step": 9, "for": "offset"},
    )


def _steady_rmses(colour: Spec, point: Spec) -> Spec:
    """Return the chart of the mean steady-state error of each policy in a scenario, with its interval."""
    tooltip = _tooltip(policy="policy", text="steady-state RMSE [m]", failed="failed")
    x = _number("value", "mean steady-state error [m], 95 % interval", log=True)
    y = {"field": "policy", "type": "nominal", "sort": None, "axis": {"title": None, "labelLimit": 150, "grid": True}}
    return _frame(
        [
            {
                "mark": {"type": "rule", "strokeWidth": 2.2},
                "encoding": {"x": {**x, "field": "low"}, "x2": {"field": "high"}, "y": y, **colour},
            },
            {
                "mark": {"type": "point", "filled": True, "size": 55, "opacity": 1},
                "encoding": {"x": x, "y": y, **point, "tooltip": tooltip},
            },
        ],
        height={"step": 19},
    )


def _shares(line: Spec) -> Spec:
    """Return the chart of the cumulative distribution of the steady-state error over the episodes of a scenario."""
    share = {"axis": {"title": "share of the episodes", "format": "%", "tickCount": 5}, "scale": {"domain": [0, 1]}}
    return _frame(
        [
            {
                "mark": {**_LINE, "interpolate": "step-after"},
                "encoding": {
                    "x": _number("steady_rmse", "steady-state error [m]; dotted: error cap", log=True),
                    "y": {"field": "share", "type": "quantitative", **share},
                    "tooltip": _POLICY_TOOLTIP,
                    **line,
                },
            },
            {"data": {"name": "caps"}, "mark": _DOTTED, "encoding": {"x": {"field": "cap", "type": "quantitative"}}},
        ],
        height=300,
    )


def _bands(colour: Spec, line: Spec) -> Spec:
    """Return the chart of the position error over time: median and band of the episodes."""
    t = _number("t", "time [s]; dotted: a third of the episode", zero=True, nice=False)
    error, third = _number("middle", "position error [m]", log=True, clamp=True), {"field": "t", "type": "quantitative"}
    return _frame(
        [
            {
                "mark": {"type": "area", "opacity": 0.16},
                "encoding": {"x": t, "y": {**error, "field": "low"}, "y2": {"field": "high"}, **colour},
            },
            {"mark": _LINE, "encoding": {"x": t, "y": error, **line, "tooltip": _POLICY_TOOLTIP}},
            {"data": {"name": "steady_rmses"}, "mark": _DOTTED, "encoding": {"x": third}},
        ],
        height=260,
    )


def _errors(line: Spec) -> Spec:
    """Return the chart of the position error of one episode over time, with a cursor at the time of the player."""
    t, now = _number("t", "time [s]", zero=True, nice=False), {"datum": {"expr": "now"}, "type": "quantitative"}
    error, cursor = _number("error", "position error [m]", log=True, clamp=True), {"color": GUIDE_COLOUR}
    return _frame(
        [
            {"mark": _LINE, "encoding": {"x": t, "y": error, **line, "tooltip": _POLICY_TOOLTIP}},
            {
                "data": {"values": [{}]},
                "mark": {"type": "rule", "strokeWidth": 1.5, **cursor},
                "encoding": {"x": now},
            },
        ],
        params=[{"name": "now", "value": 0}],
        height=220,
    )

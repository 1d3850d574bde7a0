"""The Vega-Lite specifications of the report's charts: marks and scales; the page adds the data."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from baselines.evaluation.score import SCALE
from baselines.tools.figure_style import DASHES, OUTLINES, look

Spec = dict[str, Any]

_ROWS = {"name": "rows"}  # the data set that the page fills
_LINE: Spec = {"type": "line", "strokeWidth": 1.8}  # style of a curve
_POLICY_TOOLTIP = [{"field": "policy", "title": "policy"}]
GUIDE_COLOUR = "#8a8a8a"  # colour of auxiliary lines


def charts(policies: Sequence[str]) -> dict[str, Spec]:
    """Return the charts of an evaluation by name, with the looks of the policies."""
    looks = _Looks(policies)
    return {
        "scores": _intervals(looks, "score", "case", f"score: {SCALE}", -1.0),
        "steady_rmses": _steady_rmses(looks),
        "shares": _shares(looks),
        "bands": _bands(looks),
        "errors": _errors(looks),
    }


class _Looks:
    """The scales for colour, dash pattern and marker of each policy."""

    def __init__(self, policies: Sequence[str]) -> None:
        own = [look(policy, policies) for policy in policies]
        names = list(policies)
        self.colour = _scale(names, [x.colour for x in own])
        self.dash = _scale(names, [list(DASHES[x.dash][1]) or [1, 0] for x in own])
        self.shape = _scale(names, [OUTLINES[x.marker] for x in own])

    def of(self, *channels: str) -> Spec:
        """Return the encoding of the policy in these channels, without a legend, since the leaderboard is one."""
        scales = {"color": self.colour, "strokeDash": self.dash, "shape": self.shape}
        return {
            name: {"field": "policy", "type": "nominal", "scale": scales[name], "legend": None} for name in channels
        }


def _scale(names: list[str], values: list[Any]) -> Spec:
    return {"domain": names, "range": values}


def _number(field: str, title: str | None = None, log: bool = False, **scale: Any) -> Spec:
    kind = {"type": "log"} if log else {}
    axis = {"title": title, "labelSeparation": 6, "tickCount": 5}
    scales = {**kind, "zero": False, "nice": True, **scale}
    return {"field": field, "type": "quantitative", "axis": axis, "scale": scales}


def _tooltip(*fields: tuple[str, str]) -> list[Spec]:
    """Return the tooltip of a mark."""
    return [{"field": field, "title": title} for field, title in fields]


def _frame(layer: list[Spec], **more: Any) -> Spec:
    return {"data": _ROWS, "width": "container", "layer": layer, **more}


def _intervals(looks: _Looks, value: str, group: str, title: str, least: float) -> Spec:
    """Return the chart of a value of each policy with its interval, with a group of rows for each case."""
    tooltip = _tooltip(("policy", "policy"), (group, group), ("text", value), ("failed", "failed"))
    x = _number("value", title, domainMin={"expr": f"max({least}, least)"}, domainMax=1.05, nice=False)
    bands = {"title": None, "grid": True, "tickBand": "extent"}
    place = {
        "y": {"field": group, "type": "nominal", "sort": None, "axis": bands},
        "yOffset": {"field": "policy", "type": "nominal", "sort": None, "scale": {"paddingOuter": 0.4}},
    }
    lines = [{"datum": at} for at in (0.0, 1.0)]
    return _frame(
        [
            *(
                {"mark": {"type": "rule", "color": GUIDE_COLOUR, "strokeWidth": 1}, "encoding": {"x": line}}
                for line in lines
            ),
            {
                "mark": {"type": "rule", "strokeWidth": 2.2, "clip": True},
                "encoding": {"x": {**x, "field": "low"}, "x2": {"field": "high"}, **place, **looks.of("color")},
            },
            {
                "mark": {"type": "point", "filled": True, "size": 42, "opacity": 1, "clip": True},
                "encoding": {"x": x, **place, **looks.of("color", "shape"), "tooltip": tooltip},
            },
        ],
        params=[{"name": "least", "value": -0.1}],
        height={"step": 9, "for": "offset"},
    )


def _steady_rmses(looks: _Looks) -> Spec:
    """Return the chart of the mean steady-state error of each policy in a scenario, with its interval."""
    tooltip = _tooltip(("policy", "policy"), ("text", "steady-state RMSE [m]"), ("failed", "failed"))
    x = _number("value", "mean steady-state error [m], 95 % interval", log=True)
    y = {"field": "policy", "type": "nominal", "sort": None, "axis": {"title": None, "labelLimit": 150, "grid": True}}
    return _frame(
        [
            {
                "mark": {"type": "rule", "strokeWidth": 2.2},
                "encoding": {"x": {**x, "field": "low"}, "x2": {"field": "high"}, "y": y, **looks.of("color")},
            },
            {
                "mark": {"type": "point", "filled": True, "size": 55, "opacity": 1},
                "encoding": {"x": x, "y": y, **looks.of("color", "shape"), "tooltip": tooltip},
            },
        ],
        height={"step": 19},
    )


def _shares(looks: _Looks) -> Spec:
    """Return the chart of the cumulative distribution of the steady-state error over the episodes of a scenario."""
    share = {"axis": {"title": "share of the episodes", "format": "%", "tickCount": 5}, "scale": {"domain": [0, 1]}}
    return _frame(
        [
            {
                "mark": {**_LINE, "interpolate": "step-after"},
                "encoding": {
                    "x": _number("steady_rmse", "steady-state error of an episode [m]; dotted: error cap", log=True),
                    "y": {"field": "share", "type": "quantitative", **share},
                    "tooltip": _POLICY_TOOLTIP,
                    **looks.of("color", "strokeDash"),
                },
            },
            {
                "data": {"name": "caps"},
                "mark": {"type": "rule", "strokeDash": [2, 3], "color": GUIDE_COLOUR},
                "encoding": {"x": {"field": "cap", "type": "quantitative"}},
            },
        ],
        height=300,
    )


def _bands(looks: _Looks) -> Spec:
    """Return the chart of the position error over time: median and band of the episodes."""
    t = _number("t", "time [s]; dotted: a third of the episode", zero=True, nice=False)
    error = _number("middle", "position error [m]", log=True, clamp=True)
    return _frame(
        [
            {
                "mark": {"type": "area", "opacity": 0.16},
                "encoding": {"x": t, "y": {**error, "field": "low"}, "y2": {"field": "high"}, **looks.of("color")},
            },
            {
                "mark": _LINE,
                "encoding": {"x": t, "y": error, **looks.of("color", "strokeDash"), "tooltip": _POLICY_TOOLTIP},
            },
            {
                "data": {"name": "steady_rmses"},
                "mark": {"type": "rule", "strokeDash": [2, 3], "color": GUIDE_COLOUR},
                "encoding": {"x": {"field": "t", "type": "quantitative"}},
            },
        ],
        height=260,
    )


def _errors(looks: _Looks) -> Spec:
    """Return the chart of the position error of one episode over time, with a cursor at the time of the player."""
    t = _number("t", "time [s]", zero=True, nice=False)
    error = _number("error", "position error [m]", log=True, clamp=True)
    return _frame(
        [
            {
                "mark": _LINE,
                "encoding": {"x": t, "y": error, **looks.of("color", "strokeDash"), "tooltip": _POLICY_TOOLTIP},
            },
            {
                "data": {"values": [{}]},
                "mark": {"type": "rule", "color": GUIDE_COLOUR, "strokeWidth": 1.5},
                "encoding": {"x": {"datum": {"expr": "now"}, "type": "quantitative"}},
            },
        ],
        params=[{"name": "now", "value": 0}],
        height=220,
    )

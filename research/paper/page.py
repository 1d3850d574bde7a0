"""paper.html: the paper's numbers and figures, recomputed, as a page; any of section V's eight starts can be chosen."""

from __future__ import annotations

from typing import Any

import numpy as np

from auv_gym.physics.vehicle import PAPER_VEHICLE
from auv_gym.planning.paths import PAPER_CIRCLE
from auv_gym.planning.planner import plan
from baselines.evaluation.report.page import render_report
from baselines.tools.figure_style import COLOURS
from research.paper.closed_loop import Response
from research.paper.noise_study import TRANSIENT, NoiseRun, noise_scenario
from research.paper.numbers import CHOSEN, SIGNS, Reproduction

_Spec = dict[str, Any]

_FLOOR = 1e-5  # the errors that the paper's figures end at, in their units
GREY = "#8a8a8a"  # colour of the reference
_ERRORS = (
    ("x_e", "m", 1.0), ("y_e", "m", 1.0), ("psi_e", "deg", 180 / np.pi), ("u_e", "m/s", 1.0), ("v_e", "m/s", 1.0),
    ("r_e", "rad/s", 1.0),
)  # fmt: skip
"""The errors of a response: name, unit and the factor into it."""
NOISY = 30.0  # [s] of the noisy commands that are drawn


def paper_html(reproduction: Reproduction, command: str) -> str:
    """Return the text of the page."""
    checked = [row for row in reproduction.rows if row.agrees is not None]
    figures = [
        ("Fig. 3: the way of the centre of mass", "the whole circle, and the start", ["whole", "start"]),
        ("Fig. 4: control force and torque", "dashed: the forces of the plan", ["F_u", "F_r"]),
        ("Fig. 5: velocity errors", "", ["u_e", "v_e", "r_e", "u_e log", "v_e log", "r_e log"]),
        ("Fig. 6: errors of position and heading", "", ["x_e", "y_e", "psi_e", "x_e log", "y_e log", "psi_e log"]),
    ]
    rows = {"response": _rows(reproduction.response), **_noise(reproduction.noise)}
    return render_report(
        "paper.html",
        {"charts": _charts(), "rows": rows},
        ("figures.js",),
        title="The paper, recomputed",
        command=command,
        agreeing=sum(row.agrees is True for row in checked),
        checked=len(checked),
        tables=[
            ("The paper's numbers", reproduction.rows),
            ("Where the printed equations do not hold", reproduction.remarks),
        ],
        starts=reproduction.starts,
        signs=[" ".join("+" if sign > 0 else "-" for sign in signs) for signs in SIGNS],
        chosen=CHOSEN,
        figures=figures,
        studies=[("noise force", "noise"), ("noise error", "noise"), ("noise trade", "trade")],
    )


def _rows(response: Response) -> list[dict[str, float]]:
    """Return the response from the eight starts, dense where it is fast."""
    kept = np.flatnonzero((response.t <= 15) & (np.arange(len(response.t)) % 5 == 0))
    kept = np.append(kept, np.flatnonzero((response.t > 15) & (np.arange(len(response.t)) % 40 == 0)))
    rows = []
    for i in range(len(SIGNS)):
        columns = {"t": response.t, "x": response.state[0, i], "y": response.state[1, i]}
        columns |= {
            name: factor * error for (name, _, factor), error in zip(_ERRORS, response.errors[:, i], strict=True)
        }
        columns |= dict(zip(("F_u", "F_r"), response.force[:, i], strict=True))
        values = [[float(f"{x:.5g}") for x in column[kept].tolist()] for column in columns.values()]
        rows += [{"start": i, **dict(zip(columns, line, strict=True))} for line in zip(*values, strict=True)]
    return rows


def _charts() -> dict[str, _Spec]:
    """Return the charts by name."""
    F_u, F_r = plan(PAPER_CIRCLE, PAPER_VEHICLE, np.array([0.0, 1.0])).table[0, 6:].tolist()
    circle = PAPER_CIRCLE.derivatives(np.linspace(0.0, 200 * np.pi, 181))[0].T
    charts = {
        "whole": _way(circle, (-12.0, 12.0), (-12.0, 12.0)),
        "start": _way(circle, (-1.0, 3.4), (7.8, 12.2)),
        "F_u": _over_time("F_u", "N", level=F_u),
        "F_r": _over_time("F_r", "N m", level=F_r),
    }
    for name, unit, _ in _ERRORS:
        charts[name], charts[f"{name} log"] = _over_time(name, unit, level=0.0, end=40.0), _magnitude(name, unit)
    return charts | {
        "noise force": _noise_over_time("F_u", "F_u [N]"),
        "noise error": _noise_over_time("error", "position error [cm]"),
        "noise trade": _trade(),
    }


def _axis(field: str, title: str, **scale: Any) -> _Spec:
    axis = {"title": title, "tickCount": 5}
    return {"field": field, "type": "quantitative", "axis": axis, "scale": {"zero": False, **scale}}


def _chosen(layer: list[_Spec], **more: Any) -> _Spec:
    """Return a chart of the start that is chosen."""
    start = {"name": "start", "value": CHOSEN}
    return {"data": {"name": "rows"}, "width": "container", "height": 170, "params": [start], "layer": layer, **more}


MINE: _Spec = {"filter": "datum.start === start"}  # what belongs to the start that is chosen
_LINE: _Spec = {"type": "line", "color": COLOURS[0], "strokeWidth": 1.8, "clip": True}
"""The look of a curve."""


def _way(circle: Any, x: tuple[float, float], y: tuple[float, float]) -> _Spec:
    """Return the ways from all starts in a square of the plane, the chosen one in front."""
    axes = {"x": _axis("x", "X [m]", domain=x, nice=False), "y": _axis("y", "Y [m]", domain=y, nice=False)}
    order = {"order": {"field": "t", "type": "quantitative"}}
    path = [{"x": a, "y": b, "t": i} for i, (a, b) in enumerate(np.round(circle, 4).tolist())]
    return _chosen(
        [
            {"mark": {**_LINE, "color": COLOURS[5], "strokeWidth": 0.8},
             "encoding": {**axes, **order, "detail": {"field": "start", "type": "nominal"}}},
            {"data": {"values": path}, "mark": {**_LINE, "color": GREY, "strokeDash": [5, 3]},
             "encoding": {**axes, **order}},
            {"transform": [MINE], "mark": {**_LINE, "strokeWidth": 2.4}, "encoding": {**axes, **order}},
            {"transform": [MINE, {"filter": "datum.t === 0"}], "mark": {"type": "point", "filled": True, "size": 60,
             "color": COLOURS[0], "clip": True}, "encoding": axes},
        ], width=300, height=300,
    )  # fmt: skip


def _over_time(name: str, unit: str, level: float, end: float = 60.0) -> _Spec:
    t, y = _axis("t", "time [s]", domain=[0, end], nice=False), _axis(name, f"{name} [{unit}]")
    return _chosen(
        [
            {
                "mark": {"type": "rule", "color": GREY, "strokeDash": [5, 3]},
                "encoding": {"y": {"datum": round(level, 5)}},
            },
            {"transform": [MINE, {"filter": f"datum.t <= {end}"}], "mark": _LINE, "encoding": {"x": t, "y": y}},
        ]
    )


def _magnitude(name: str, unit: str) -> _Spec:
    t, y = (
        _axis("t", "time [s]", nice=False),
        _axis("size", f"|{name}| [{unit}]", type="log", domain=[1e-11, 100], clamp=True),
    )
    size = {"calculate": f"max(abs(datum['{name}']), 1e-11)", "as": "size"}
    return _chosen(
        [
            {"mark": {"type": "rule", "color": COLOURS[1]}, "encoding": {"y": {"datum": _FLOOR}}},
            {"transform": [MINE, size], "mark": {**_LINE, "strokeWidth": 1.2}, "encoding": {"x": t, "y": y}},
        ]
    )


def _noise(study: list[NoiseRun]) -> dict[str, Any]:
    """Return the rows of the noise study: commands and errors over time, and what a low-pass trades between them."""
    dt, names = (
        noise_scenario(None).control_dt,
        [f"{run.cut_off:g} Hz" if run.cut_off else "no filter" for run in study],
    )
    steps = range(round(NOISY / dt))
    over_time = [
        {"t": round(dt * (TRANSIENT + 1 + k), 3), "run": name, "F_u": round(float(run.force[0, k, 0]), 2),
         "error": round(100 * float(run.error[0, k]), 3)}
        for run, name in ((study[0], names[0]), (study[-1], names[-1])) for k in steps
    ]  # fmt: skip
    trade = [
        {"run": name, "force": float(run.force_std[0]), "error": 100 * run.position_rms}
        for run, name in zip(study, names, strict=True)
    ]
    return {"noise": over_time, "trade": trade}


def _noise_over_time(field: str, title: str) -> _Spec:
    colour = {"field": "run", "type": "nominal", "sort": None, "scale": {"range": [COLOURS[5], COLOURS[0]]},
              "legend": {"title": None, "orient": "top"}}  # fmt: skip
    step = {"type": "line", "interpolate": "step-before", "strokeWidth": 1.2}
    encoding = {
        "x": _axis("t", "time [s]", nice=False),
        "y": _axis(field, title, zero=field == "error"),
        "color": colour,
    }
    return {"data": {"name": "rows"}, "width": "container", "height": 190, "mark": step, "encoding": encoding}


def _trade() -> _Spec:
    at = {"x": _axis("force", "std of F_u [N]", zero=True), "y": _axis("error", "rms position error [cm]", zero=True)}
    text = {"type": "text", "align": "left", "dx": 7, "dy": -7}
    return {
        "data": {"name": "rows"}, "width": "container", "height": 190,
        "layer": [
            {"mark": {"type": "line", "point": {"filled": True, "color": COLOURS[0]}, "color": COLOURS[0]},
             "encoding": {**at, "order": {"field": "force"}}},
            {"mark": text, "encoding": {**at, "text": {"field": "run"}}},
        ],
    }  # fmt: skip

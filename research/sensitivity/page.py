"""The values and the figures of docs/sensitivity.md, from the records of this folder's studies."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from auv_gym.scenarios.names import REGIMES
from baselines.evaluation.metrics import resamplings
from baselines.evaluation.score import EXPERT, RIVAL
from baselines.tools.files import read_json
from research import DATA
from research.sensitivity.adaptation import AS_GOOD, ROD, WITHIN
from research.sensitivity.changes import CHANGES, LENGTHS, SEAS
from research.sensitivity.extrapolation import parameters_of
from research.sensitivity.figures import adaptation_figure, extrapolation_figure
from research.sensitivity.model_error import ERROR_SIZES, WAYS

SENSITIVITY_FOLDER = DATA / "sensitivity"
Record: TypeAlias = dict[str, Any]
_GOAL = 10
"""Lengths within which a policy should be back."""
_DRAWN: Mapping[str, Callable[[Mapping[str, Any], str], bytes]] = {
    "adaptation": adaptation_figure,
    "extrapolation": extrapolation_figure,
}
"""What draws the figure of a part in a regime."""
BEARABLE = 0.01
"""What a score may be lower where a vehicle model is wrong."""


def context(page: str, folder: Path = SENSITIVITY_FOLDER) -> dict[str, Any]:
    """Return what each section of the page shows, of the records in a folder.

    Raises:
        ValueError: a file is damaged.
    """
    del page
    found = load_sensitivity(folder)
    sections = {
        "adaptation": _adaptation,
        "extrapolation": _extrapolation,
        "model_error": _model_error,
    }
    return {key: {"figures": list(_figures(found, key)), **of(_own(found, key))} for key, of in sections.items()}


def figures(page: str, folder: Path = SENSITIVITY_FOLDER) -> dict[str, bytes]:
    """Return the figures of the records in a folder as PNG files, by name."""
    del page
    found = load_sensitivity(folder)
    return {name: draw() for key in _DRAWN for name, draw in _figures(found, key).items()}


def load_sensitivity(folder: Path) -> dict[tuple[str, str], Record]:
    """Return the records in a folder by part and policy.

    Raises:
        ValueError: a file is damaged.
    """
    files = sorted(folder.glob("*-*.json"))
    return {(file.stem.partition("-")[0], file.stem.partition("-")[2]): read_json(file) for file in files}


def _own(found: Mapping[tuple[str, str], Record], part: str) -> dict[str, Record]:
    """Return the records of a part by policy, `RIVAL` and then the expert last."""
    own = {name: record for (key, name), record in found.items() if key == part}
    return dict(sorted(own.items(), key=lambda item: (item[0] == EXPERT, item[0] == RIVAL, item[0])))


def _figures(found: Mapping[tuple[str, str], Record], part: str) -> dict[str, Callable[[], bytes]]:
    """Return what draws each figure of a part, by the name of its file."""
    own = _own(found, part)
    if part not in _DRAWN:
        return {}
    return {f"sensitivity-{part}-{regime}.png": partial(_DRAWN[part], own, regime) for regime, _ in _by_regime(own)}


def _by_regime(own: Mapping[str, Record]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield each regime that something is known of, with the records of it by policy."""
    for regime in REGIMES:
        if mine := {name: record[regime] for name, record in own.items() if regime in record}:
            yield regime, mine


def spread(ends: Sequence[float | None], form: str = ".2f") -> str:
    """Return a value with its interval, as `0.35 [0.28, 0.41]`; what is None was not measured."""
    value, low, high = ("-" if x is None else f"{x:{form}}" for x in ends)
    return f"{value} [{low}, {high}]"


def _adaptation(own: Mapping[str, Record]) -> dict[str, Any]:
    records = []
    for regime, mine in _by_regime(own):
        for sea in SEAS:
            first = next(iter(mine.values()))[sea]
            records.append({
                "place": f"{regime}-{sea}",
                "episodes": first["episodes"],
                "length": f"{first['length_m']:.2f}",
                "rows": _changes({name: of[sea]["changes"] for name, of in mine.items()}),
            })  # fmt: skip
    return {"records": records, "lengths": LENGTHS, "verdict": [_verdict(*item) for item in own.items()]}


def _verdict(name: str, record: Mapping[str, Any]) -> list[str]:
    """Return how often a policy is back within so many lengths."""
    courses = [c for seas in record.values() for of in seas.values() for c in of["changes"].values()]
    places = [[c["back"][i][0] for c in courses] for i in range(len(WITHIN))]
    counts = [sum(x is not None and x <= limit for x in row) for row in places for limit in (_GOAL, _GOAL * ROD)]
    never = sum(x is None for x in places[0])
    calm = sum(max(c["factor"][0]) <= AS_GOOD for c in courses)
    return [f"`{name}`", *(f"{count} of {len(courses)}" for count in (*counts, never, calm))]


def _changes(of: Mapping[str, Mapping[str, Any]]) -> list[list[str]]:
    """Return a row for each change and policy, of its courses by policy and change."""
    rows = []
    for change in CHANGES:
        own = {name: changes[change] for name, changes in of.items()}
        best = min(c["level_m"][0] for c in own.values())
        for name, c in own.items():
            good = np.flatnonzero(np.array(c["error_m"][0]) > AS_GOOD * best)
            reached = int(good[-1]) + 1 if len(good) else 0
            level = f"{1e3 * c['never_m']:.0f} -> {1e3 * c['level_m'][0]:.0f}"
            cells = [CHANGES[change].says, f"`{name}`", level, f"{max(c['factor'][0]):.1f}", *map(_lengths, c["back"])]
            cells.append("never" if reached == len(c["error_m"][0]) else str(reached))
            rows.append([*cells, f"{c['lost']} / {c['lost_always']}"])
    return rows


def _lengths(ends: Sequence[float | None]) -> str:
    value, low, high = ("never" if x is None else f"{x:g}" for x in ends)
    return f"{value} [{low}, {high}]"


def _extrapolation(own: Mapping[str, Record]) -> dict[str, Any]:
    records = []
    for regime, mine in _by_regime(own):
        first = next((name for name in mine if name != RIVAL), None) if RIVAL in mine else None
        rows = []
        for key, parameter in parameters_of(regime).items():
            every = {name: of["parameters"][key] for name, of in mine.items()}
            lost = (_some(v for v, n in zip(of["values"], of["lost"], strict=True) if n) for of in every.values())
            row = [parameter.says, f"{parameter.trained[0]:g} ... {parameter.trained[1]:g}", *lost]
            rows.append([*row, _some(_behind(every[first], every[RIVAL]))] if first else row)
        heads = ["stretched", "trained on", *(f"`{name}` loses vehicles at" for name in mine)]
        records.append({
            "place": f"{regime}-storm",
            "episodes": next(iter(mine.values()))["episodes"],
            "heads": [*heads, f"`{first}` is behind `{RIVAL}` at"] if first else heads,
            "rows": rows,
        })  # fmt: skip
    return {"records": records}


def _some(values: Iterator[float]) -> str:
    return ", ".join(f"{v:g}" for v in values) or "-"


def _behind(mine: Mapping[str, Any], rival: Mapping[str, Any]) -> Iterator[float]:
    """Yield the values at which the interval of the geometric mean ratio of errors lies above 1."""
    for value, a, b in zip(mine["values"], mine["tails_m"], rival["tails_m"], strict=True):
        if ratio_of(np.array(a), np.array(b))[1] > 1:
            yield value


def ratio_of(mine: Any, other: Any) -> tuple[float, float, float]:
    """Return the geometric mean of the ratio of paired errors, with its 95 % interval by bootstrap over episodes."""
    (counts,) = resamplings((len(mine),))
    logs = counts @ np.log(np.maximum(mine, 1e-6) / np.maximum(other, 1e-6)) / len(mine)
    low, high = np.quantile(logs[1:], (0.025, 0.975))
    return math.exp(logs[0]), math.exp(low), math.exp(high)


def _model_error(own: Mapping[str, Record]) -> dict[str, Any]:
    records = [
        {"place": regime, "rows": [row for name, of in mine.items() for row in _ways(name, of)]}
        for regime, mine in _by_regime(own)
    ]
    robust: dict[bool, list[str]] = {True: [], False: []}
    for name, record in own.items():
        for regime, of in record.items():
            for key, way in WAYS.items():
                last = max(of["wrong"][key], key=lambda at: float(at["size"]))
                robust[last["above"][0] >= -BEARABLE].append(f"`{name}` with {way.says} ({regime})")
    return {
        "records": records,
        "bearable": f"{BEARABLE:g}",
        "robust": "; ".join(robust[True]) or "none",
        "others": "; ".join(robust[False]) or "none",
        "sizes": [f"by {100 * size:.0f} % at most" for size in ERROR_SIZES],
    }


def _ways(name: str, of: Mapping[str, Any]) -> list[list[str]]:
    """Return a row for each way in which a policy was given wrong vehicle models."""
    right, rows = of["right"], []
    for key, way in WAYS.items():
        sizes = {float(at["size"]): at for at in of["wrong"][key]}
        last, episodes = sizes[max(sizes)], of["episodes"] * len(of["cases"])
        worse = [after - before for before, after in zip(right["error_m"], last["error_m"], strict=True)]
        i = worse.index(max(worse))
        growth = f"{of['cases'][i]}, {1e3 * right['error_m'][i]:.1f} -> {1e3 * last['error_m'][i]:.1f} mm"
        above = [spread(sizes[size]["above"], "+.3f") if size in sizes else "-" for size in ERROR_SIZES]
        lost = f"{sum(last['lost'])} of {len(last['lost']) * episodes}; {right['lost']} of {episodes}"
        cells = [f"`{name}`", f"{right['score'][0]:.3f}", way.says, *above, f"{min(last['hulls']):+.3f}", growth, lost]
        rows.append(cells)
    return rows

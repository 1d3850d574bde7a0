"""What was found, as tables in Markdown and figures."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from baselines.evaluation.metrics import resamplings
from baselines.evaluation.score import EXPERT, RIVAL
from baselines.tools.files import read_json
from research.probing import ranges
from research.probing.adaptation import LARGEST, ROD, WITHIN
from research.probing.changes import CHANGES, LENGTHS, SEAS
from research.probing.collect import SOURCES, TARGETS
from research.probing.figures import adaptation_figure, outside_figure, probe_figure, range_figure
from research.probing.outside import parameters_of
from research.probing.told import SIZES, WAYS
from research.probing.transplant import SWAPS, TRAITS

Found: TypeAlias = Mapping[tuple[str, str], dict[str, Any]]
"""Records by part and policy."""
NAMES = {
    "probe": "What can be read from its memory",
    "transplant": "Whether that is used",
    "adaptation": "When the vehicle changes in mid-run",
    "range": "What it was trained on",
    "outside": "Outside of that",
    "told": "Told a wrong hull",
}
"""The sections and their titles."""
_GOAL = 10
"""Lengths within which a policy should be back."""
BORNE = 0.01
"""What a score may be lower where a hull is told wrong."""


def load(folder: Path) -> dict[tuple[str, str], dict[str, Any]]:
    """Return the records in a folder by part and policy.

    Raises:
        ValueError: a file is damaged.
    """
    files = sorted(folder.glob("*-*.json"))
    return {(file.stem.partition("-")[0], file.stem.partition("-")[2]): read_json(file) for file in files}


def of_part(found: Found, part: str) -> dict[str, dict[str, Any]]:
    """Return the records of a part by policy: agents that are most told first, the expert last."""
    own = {name: record for (key, name), record in found.items() if key == part}
    return dict(sorted(own.items(), key=lambda item: (item[0] == EXPERT, item[0] == RIVAL, item[0])))


def sections(found: Found, images: str) -> dict[str, str]:
    """Return the text of each section, by its key in `NAMES`; figures are linked in the folder `images`."""
    writers: dict[str, Callable[[Found], list[str]]] = {
        "probe": _probe,
        "transplant": _transplant,
        "adaptation": _adaptation,
        "range": _range,
        "outside": _outside,
        "told": _told,
    }
    texts = {}
    for key, write in writers.items():
        links = [f"![{NAMES[key]}]({images}{name})" for name in _pictures_of(found, key)]
        texts[key] = "\n\n".join([*links, *write(found)]) + "\n"
    return texts


def pictures(found: Found) -> dict[str, bytes]:
    """Return the figures as PNG files by name."""
    return {name: draw() for key in NAMES for name, draw in _pictures_of(found, key).items()}


def _pictures_of(found: Found, key: str) -> dict[str, Callable[[], bytes]]:
    own = of_part(found, key)
    if key == "probe":
        return {f"knows-probe-{name}.png": lambda r=record: probe_figure(r) for name, record in own.items()}  # type: ignore[misc]
    if key == "range":
        return {f"knows-range-{name}.png": lambda r=record: range_figure(r) for name, record in own.items()}  # type: ignore[misc]
    draw = {"adaptation": adaptation_figure, "outside": outside_figure}.get(key)
    if draw is None or not own:
        return {}
    regimes = [regime for regime in ("slow", "cruise") if any(regime in record for record in own.values())]
    return {f"knows-{key}-{regime}.png": lambda r=regime: draw(own, r) for regime in regimes}  # type: ignore[misc]


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table in Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


def spread(ends: Sequence[float | None], digits: int = 2) -> str:
    """Return a value with its interval, as `0.35 [0.28, 0.41]`."""
    value, low, high = ("-" if x is None else f"{x:.{digits}f}" for x in ends)
    return f"{value} [{low}, {high}]"


def _probe(found: Found) -> list[str]:
    parts = []
    for name, record in of_part(found, "probe").items():
        for regime, cases in record.items():
            for case, of in cases.items():
                time = of["instants"][-1] * of["dt"]
                parts.append(f"**`{name}`, {regime}-{case}**, {of['episodes']} episodes, {time:g} s after the start:")
                parts.append(_probe_table(of))
    return parts


def _probe_table(of: Mapping[str, Any]) -> str:
    head = ["asked", "one instant", "untrained", "network's inputs", "Kalman filter", "**memory**", "bent", "lead"]
    rows = []
    for i, target in enumerate(of["targets"]):
        plain = [f"{of['linear'][source][-1][i][0]:.2f}" for source in SOURCES if source != "memory"]
        memory, bent = of["linear"]["memory"][-1][i], of["bent"]["memory"][i][0]
        order = [plain[list(SOURCES).index(source)] for source in ("instant", "untrained", "inputs", "ekf")]
        rows.append([TARGETS[target], *order, spread(memory), f"{bent:.2f}", spread(of["lead"][i])])
    return table(head, rows)


def _transplant(found: Found) -> list[str]:
    parts = []
    for name, record in of_part(found, "transplant").items():
        for regime, of in record.items():
            says = f"**`{name}`, {regime}-storm**, {of['pairs']} pairs of twins for each trait, the {of['seconds']:g} s"
            parts.append(f"{says} behind the exchange:")
            head = ["twins differ in", "error [mm]", *(f"{how} [95 %]" for how in _HOW.values())]
            rows = [
                [TRAITS[trait].says, f"{1e3 * row['error_m']:.1f}", *(spread(row[how]) for how in SWAPS)]
                for trait, row in of["traits"].items()
            ]
            parts.append(table(head, rows))
    return parts


_HOW = {"network": "network's memory exchanged", "inputs": "inputs' memory exchanged", "emptied": "network's set to 0"}


def _adaptation(found: Found) -> list[str]:
    own = of_part(found, "adaptation")
    parts = [_verdict(own)] if own else []
    for regime in ("slow", "cruise"):
        for sea in SEAS:
            courses = {name: record[regime][sea] for name, record in own.items() if regime in record}
            if courses:
                first = next(iter(courses.values()))
                parts.append(f"**{regime}-{sea}**, {first['episodes']} episodes, L = {first['length_m']:.2f} m:")
                parts.append(_adaptation_table(courses))
    return parts


def _verdict(own: Mapping[str, Any]) -> str:
    """Return how often each policy is back within so many lengths."""
    lines = []
    for name, record in own.items():
        courses = [c for seas in record.values() for of in seas.values() for c in of["changes"].values()]
        places = [[c["back"][i][0] for c in courses] for i in range(len(WITHIN))]
        counts = [sum(x is not None and x <= limit for x in row) for row in places for limit in (_GOAL, _GOAL * ROD)]
        never = sum(x is None for x in places[0])
        calm = sum(max(c["factor"][0]) <= LARGEST for c in courses)
        lines.append([f"`{name}`", *(f"{count} of {len(courses)}" for count in (*counts, never, calm))])
    ways = [f"{100 * share:.0f} % after {way}" for share in WITHIN for way in (f"{_GOAL} L", f"{_GOAL} hull lengths")]
    return table(
        ["policy", *(f"within {way}" for way in ways), f"not within 20 % after {LENGTHS} L", "never away"], lines
    )


def _adaptation_table(courses: Mapping[str, Any]) -> str:
    rows = []
    for change in CHANGES:
        own = {name: of["changes"][change] for name, of in courses.items()}
        best = min(c["level_m"][0] for c in own.values())
        for name, c in own.items():
            good = np.flatnonzero(np.array(c["error_m"][0]) > LARGEST * best)
            reached = int(good[-1]) + 1 if len(good) else 0
            level = f"{1e3 * c['never_m']:.0f} -> {1e3 * c['level_m'][0]:.0f}"
            cells = [CHANGES[change].says, f"`{name}`", level, f"{max(c['factor'][0]):.1f}", *map(_lengths, c["back"])]
            cells.append("never" if reached == len(c["error_m"][0]) else str(reached))
            rows.append([*cells, f"{c['lost']} / {c['lost_always']}"])
    head = ["change", "policy", "error before -> used to it [mm]", "worst factor", "back, within 20 % [L]"]
    return table([*head, "within 50 % [L]", "as good as the best [L]", "lost now / always changed"], rows)


def _lengths(ends: Sequence[float | None]) -> str:
    value, low, high = ("never" if x is None else f"{x:g}" for x in ends)
    return f"{value} [{low}, {high}]"


def _range(found: Found) -> list[str]:
    parts = []
    for name, record in of_part(found, "range").items():
        parts.append(f"**`{name}`**, {record['draws']} episodes drawn from its training:")
        ends = [
            [says, f"{low:.3g}", f"{high:.3g}"]
            for says, low, high in zip(ranges.RATIOS.values(), record["low"], record["high"], strict=True)
        ]
        parts.append(table(["ratio", "least", "largest"], ends))
        rows = [[f"`{v}`", "; ".join(ranges.outside(record, v)) or "nothing"] for v in record["vehicles"]]
        parts.append(table(["vehicle at its speed", "outside of the training"], rows))
    return parts


def _outside(found: Found) -> list[str]:
    own, parts = of_part(found, "outside"), []
    for regime in ("slow", "cruise"):
        mine = {name: record[regime] for name, record in own.items() if regime in record}
        if mine:
            first = next(iter(mine.values()))
            parts.append(f"**{regime}-storm**, {first['episodes']} episodes of each value:")
            parts.append(_outside_table(mine, regime))
    return parts


def _outside_table(mine: Mapping[str, Any], regime: str) -> str:
    rivals = [name for name in mine if name != RIVAL]
    rows = []
    for key, parameter in parameters_of(regime).items():
        low, high = parameter.trained
        cells = [parameter.says, f"{low:g} ... {high:g}"]
        for name in mine:
            of = mine[name]["parameters"][key]
            cells.append(_some([v for v, lost in zip(of["values"], of["lost"], strict=True) if lost]))
        if RIVAL in mine:
            for name in rivals[:1]:
                behind = _behind(mine[name]["parameters"][key], mine[RIVAL]["parameters"][key])
                cells.append(_some(behind))
        rows.append(cells)
    head = ["stretched", "trained on", *(f"`{name}` loses vehicles at" for name in mine)]
    if RIVAL in mine:
        head += [f"`{name}` is behind `{RIVAL}` at" for name in rivals[:1]]
    return table(head, rows)


def _told(found: Found) -> list[str]:
    own, parts = of_part(found, "told"), []
    for regime in ("slow", "cruise"):
        rows = [row for name, record in own.items() if regime in record for row in _told_rows(name, record[regime])]
        if rows:
            sizes = [f"by {100 * size:.0f} % at most" for size in SIZES]
            head = ["policy", "told the truth", "wrong in", *sizes, "worst hull", "dearest in", "lost"]
            parts += [f"**{regime}**:", table(head, rows)]
    return [_borne(own), *parts] if own else []


def _borne(own: Mapping[str, Any]) -> str:
    """Return who bears a hull that is wrong by the largest share, in which way and regime, and who does not."""
    borne: dict[bool, list[str]] = {True: [], False: []}
    for name, record in own.items():
        for regime, of in record.items():
            for key, way in WAYS.items():
                last = max(of["wrong"][key], key=lambda at: float(at["size"]))
                borne[last["above"][0] >= -BORNE].append(f"`{name}` with {way.says} ({regime})")
    yes, no = ("; ".join(borne[is_so]) or "nobody" for is_so in (True, False))
    return f"At most {BORNE:g} lower on average where hulls are wrong by the largest share: {yes}. Not: {no}."


def _told_rows(name: str, of: Mapping[str, Any]) -> list[list[str]]:
    """Return a row for each way in which a policy was told wrong hulls."""
    right, rows = of["right"], []
    for key, way in WAYS.items():
        sizes = {float(at["size"]): at for at in of["wrong"][key]}
        last, episodes = sizes[max(sizes)], of["episodes"] * len(of["cases"])
        worse = [after - before for before, after in zip(right["error_m"], last["error_m"], strict=True)]
        i = worse.index(max(worse))
        dearest = f"{of['cases'][i]}, {1e3 * right['error_m'][i]:.1f} -> {1e3 * last['error_m'][i]:.1f} mm"
        above = [_above(sizes[size]["above"]) if size in sizes else "-" for size in SIZES]
        lost = f"{sum(last['lost'])} of {len(last['lost']) * episodes}; {right['lost']} of {episodes}"
        cells = [f"`{name}`", f"{right['score'][0]:.3f}", way.says, *above, f"{min(last['hulls']):+.3f}", dearest, lost]
        rows.append(cells)
    return rows


def _above(ends: Sequence[float]) -> str:
    value, low, high = (f"{x:+.3f}" for x in ends)
    return f"{value} [{low}, {high}]"


def _some(values: Sequence[float]) -> str:
    return ", ".join(f"{v:g}" for v in values) or "-"


def _behind(mine: Mapping[str, Any], rival: Mapping[str, Any]) -> list[float]:
    """Return the values at which the interval of the geometric mean ratio of errors lies above 1."""
    return [
        value
        for value, a, b in zip(mine["values"], mine["tails_m"], rival["tails_m"], strict=True)
        if ratio_of(np.array(a), np.array(b))[1] > 1
    ]


def ratio_of(mine: Any, other: Any) -> tuple[float, float, float]:
    """Return the geometric mean of the ratio of paired errors, with its 95 % interval by bootstrap over episodes."""
    (counts,) = resamplings((len(mine),))
    logs = counts @ np.log(np.maximum(mine, 1e-6) / np.maximum(other, 1e-6)) / len(mine)
    low, high = np.quantile(logs[1:], (0.025, 0.975))
    return math.exp(logs[0]), math.exp(low), math.exp(high)

"""The values of docs/validation.md: predictions of measured runs, and the errors of a Doppler log."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from baselines.tools.figure_style import COLOURS, DASHES, panels, styled, to_png
from baselines.tools.files import read_json
from research import DATA
from research.validation.navigation import DRAWS, FOLDER
from research.validation.vessels import BIN, BINS, VESSELS

VALIDATION_FILE = DATA / "validation.json"
_NAMES = {"kvlcc2-hsva": "KVLCC2", "esso-osaka": "Esso Osaka"}
_NOTES = {
    "kvlcc2-hsva": (
        "The bands of the heading are too narrow: each run has its own rudder angle, so a run that is left out is "
        "often outside of the range of the others. The largest errors are those of the largest angle, `Z_35_05`, and "
        "of a run that begins to port, `Z_20_10_P`."
    ),
    "esso-osaka": (
        "Runs with random commands were left out before: their propeller turns astern, which the equations do not "
        "describe, and with them among the fitted runs the others are predicted worse. At 0.1 to 0.5 m/s the wind of "
        "1 to 2 m/s acts as strongly as the rudder, and its drift current is unknown. Overshoots are a few degrees, "
        "less than what the wind does to the heading over a whole run, and are not predicted."
    ),
}
"""What is to be said about the results of a vessel."""
_TICKS = (0.5, 1, 2, 5, 10, 20, 50, 100)  # [degrees]
_CHANNELS = ("along", "across", "heading", "u", "v", "r")


def context(_: str = "") -> dict[str, Any]:
    """Return the numbers of the page."""
    records = read_json(VALIDATION_FILE)
    sea = records.pop(FOLDER)
    tanker, pond = (records[name] for name in VESSELS)
    overshoots = [m for m in tanker["manoeuvres"] if m["name"] == "first overshoot"]
    turns = [m for m in pond["manoeuvres"] if m["name"] == "turning diameter"]
    zigzags = heading(row for run, row in pond["by_run"].items() if run.startswith("zigzag"))
    shares = [100 * (m["predicted"] / m["measured"] - 1) for m in turns]
    near = sum(abs(m["predicted"] - m["measured"]) <= max(1.5, 0.1 * m["measured"]) for m in overshoots)
    inside = {name: 100 * float(np.mean(record["inside"])) for name, record in records.items()}
    goals = [
        ("KVLCC2, heading over 60 s", f"{tanker['rms']['model']['heading_deg']:.1f} degrees", "3 degrees",
         tanker["rms"]["model"]["heading_deg"] <= 3),
        ("KVLCC2, first overshoot within 1.5 degrees or 10 %", f"{near} of {len(overshoots)}", "all",
         near == len(overshoots)),
        ("Esso Osaka, turning diameter", f"{float(np.median(np.abs(shares))):.1f} %, median of {len(shares)} turns",
         "5 %", float(np.median(np.abs(shares))) <= 5),
        ("Esso Osaka, zig-zags, heading over 60 s", f"{zigzags:.1f} degrees", "5 degrees", zigzags <= 5),
        *((f"{_NAMES[name]}, errors inside the 95 % bands, mean of six quantities", f"{share:.0f} %", "90 to 98 %",
           90 <= share <= 98) for name, share in inside.items()),
    ]  # fmt: skip
    return {
        "goals": [(what, found, goal, "yes" if met else "no") for what, found, goal, met in goals],
        "met": sum(met for *_, met in goals),
        "vessels": [_vessel(name, record) for name, record in records.items()],
        "sea": _sea(sea),
    }


def heading(rows: Iterable[Mapping[str, float]]) -> float:
    """Return the root mean square of the heading over several runs [degrees]."""
    counts, errors = zip(*((row["points"], row["heading_deg"]) for row in rows), strict=True)
    return math.sqrt(float(np.average(np.square(errors), weights=counts)))


def _vessel(name: str, record: Mapping[str, Any]) -> dict[str, Any]:
    """Return what the page shows of a vessel."""
    known = VESSELS[name].known
    manoeuvres: dict[str, list[Mapping[str, Any]]] = {}
    for m in record["manoeuvres"]:
        manoeuvres.setdefault(m["name"], []).append(m)
    return {
        "name": _NAMES[name],
        "runs": record["runs"],
        "minutes": f"{record['minutes']:.0f}",
        "folds": record["folds"],
        "misfit": record["misfit"],
        "note": _NOTES[name],
        "known": ", ".join(f"{key} {value:.4g}" for key, value in known.items()),
        "predictors": [
            (what, f"{row['heading_deg']:.1f}", f"{row['speed_m_s']:.3f}", f"{row['place_m']:.2f}")
            for what, row in record["rms"].items()
        ],
        "by_run": [
            (f"`{run}`", f"{row['heading_deg']:.1f}", f"{row['speed_m_s']:.3f}", f"{row['place_m']:.2f}")
            for run, row in record["by_run"].items()
        ],
        "inside": ", ".join(f"{n} {100 * x:.0f} %" for n, x in zip(_CHANNELS, record["inside"], strict=True)),
        "manoeuvres": [_manoeuvre(what, rows) for what, rows in manoeuvres.items()],
        "image": f"validation-{name}.png",
    }


def _manoeuvre(name: str, rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return a row of the table of manoeuvres: how predicted figures differ from measured ones."""
    unit = "m" if name == "turning diameter" else "degrees"
    off = np.array([m["predicted"] - m["measured"] for m in rows])
    share = 100 * off / np.array([m["measured"] for m in rows])
    return [
        name,
        str(len(rows)),
        f"{off.mean():+.2f} {unit}",
        f"{np.median(np.abs(off)):.2f} {unit}",
        f"{np.median(np.abs(share)):.0f} %",
        f"{np.abs(off).max():.2f} {unit}",
    ]


def _sea(record: Mapping[str, Any]) -> dict[str, Any]:
    """Return what the page shows of the Doppler log."""
    sections, suite = record["sections"], record["suite"]
    columns = {key: np.array([row[key] for row in sections]) for key in sections[0]}

    def row(what: str, key: str, scale: float, form: str, expected: float) -> tuple[str, ...]:
        values = np.sort(np.abs(columns[key])) * scale
        ends = f"{values[0]:{form}} ... {values[-1]:{form}}"
        return what, f"{np.median(values):{form}}", ends, f"{scale * expected:{form}}"

    median = {key: float(np.median(values)) for key, values in columns.items()}
    assert median["drift_m"] / median["suite_whole_drift_m"] > 1  # as the page says
    return {
        "sections": len(sections),
        "draws": DRAWS,
        "rows": [
            row("scale of the velocity [%]", "scale", 100, ".2f", suite["scale"]),
            row("misalignment [degrees]", "misalignment", 180 / math.pi, ".2f", suite["misalignment"]),
            row("noise of the velocity at 1 Hz [m/s]", "noise", 1, ".3f", suite["noise"]),
            row("drift in 400 s, recorded values [m]", "raw_drift_m", 1, ".1f", median["suite_drift_m"]),
            row("drift in 400 s, time and place corrected [m]", "drift_m", 1, ".1f", median["suite_drift_m"]),
        ],
        "bias": f"{suite['bias']:.2g}",
        "way": f"{median['way_m']:.0f}",
        "ratio": f"{median['drift_m'] / median['suite_drift_m']:.1f}",
        "noise_ratio": f"{median['noise'] / suite['noise']:.1f}",
        "whole": f"{median['suite_whole_drift_m']:.1f}",
        "whole_ratio": f"{median['drift_m'] / median['suite_whole_drift_m']:.1f}",
        "drift": f"{median['drift_m']:.1f}",
        "delay": f"{abs(median['delay_s']):.2f}",
        "ahead": f"{abs(median['ahead_m']):.1f}",
        "related": f"{median['related']:.2f}",
    }


def figures(page: str = "") -> dict[str, bytes]:
    """Return the figures of the page as PNG by name."""
    del page
    records, found = read_json(VALIDATION_FILE), {}
    ages = BIN * (np.arange(BINS) + 0.5)
    for name in VESSELS:
        with styled():
            figure, axes = panels(1, 1, (6.0, 3.2))
            for (predictor, errors), colour, (dash, _) in zip(
                records[name]["growth_deg"].items(), COLOURS, DASHES, strict=False
            ):
                axes[0][0].plot(
                    ages[: len(errors)], errors, color=colour, linestyle=dash, marker="o", markersize=3, label=predictor
                )
            axes[0][0].set(xlabel="time since the prediction has begun [s]", ylabel="heading, rms error [degrees]")
            axes[0][0].set(yscale="log")
            axes[0][0].minorticks_off()
            axes[0][0].set_yticks(_TICKS, labels=[f"{tick:g}" for tick in _TICKS])
            axes[0][0].legend()
            found[f"validation-{name}.png"] = to_png(figure)
    return found

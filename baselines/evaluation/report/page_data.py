"""The data of the report's page for its scripts: plain lists of numbers, reduced so that the page stays small."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from auv_gym.physics.namespaces import Array
from auv_gym.scenarios.scenario import Scenario
from baselines.evaluation.metrics import Track
from baselines.evaluation.report.charts import charts
from baselines.evaluation.report.columns import digits, ends, failures_text, ranked
from baselines.evaluation.report.numbers import Entry, Result
from baselines.evaluation.rollout import TRACED
from baselines.evaluation.score import ERROR_CAPS, EXPERT, OPTIMUM_POLICY, fixed, fixed_ends, speed_range_of
from baselines.tools.figure_style import DASHES, OUTLINES, look

FEW = 10
"""Largest number of policies that a page shows initially; the user can switch on the others."""
LEVELS = np.linspace(0.0, 1.0, 41)
"""Levels of the quantiles that represent the distribution of many episodes."""
INSTANTS = 120
"""Largest number of instants of an error over time."""
FRAMES = 150
"""Largest number of instants of an episode in the player."""
_LEAST = 1e-9
"""Smallest error [m] on a logarithmic axis."""
LARGEST_TRACES = 60_000
"""Largest number of instants of all episodes together; with many policies and scenarios the player has fewer."""


def page_data(results: Sequence[Result], pooled: Sequence[Entry]) -> dict[str, Any]:
    """Return the data of an evaluation's page, from the results without failed runs."""
    policies = list(dict.fromkeys(result.run.policy for result in results))
    shown, traced = at_first(results, pooled), _traced(results)
    groups: dict[str, list[Result]] = {}
    for result in results:
        groups.setdefault(result.run.scenario.name, []).append(result)
    scenarios = [_scenario(group[0].run.scenario, group, traced) for group in groups.values()]
    hardest = [group[0].entry.summary for group in groups.values()]  # of the first policy, the expert
    return {
        "policies": [{"name": policy, **look_of(policy, policies), "on": policy in shown} for policy in policies],
        "charts": charts(policies),
        "first": int(np.argmax([summary.steady_rmse_m.mean for summary in hardest if summary] or [0])),
        "scenarios": scenarios,
    }


def look_of(policy: str, policies: Sequence[str]) -> dict[str, Any]:
    """Return a policy's look for the page: colour, dash pattern in pixels, outline of the marker."""
    style = look(policy, policies)
    return {"colour": style.colour, "dash": list(DASHES[style.dash][1]), "outline": OUTLINES[style.marker]}


def at_first(results: Sequence[Result], pooled: Sequence[Entry]) -> set[str]:
    """Return the policies that are shown initially: all of a few, otherwise those that ran now and the best ones."""
    live = [result.run.policy for result in results if result.run.recorded is None]
    entries = [entry for entry in pooled or [result.entry for result in results] if entry.summary is not None]
    groups = [ranked([e for e in entries if e.place == place]) for place in dict.fromkeys(e.place for e in entries)]
    deepest = max(map(len, groups), default=0)
    best = [group[i].policy for i in range(deepest) for group in groups if i < len(group)]
    order = list(dict.fromkeys((EXPERT, OPTIMUM_POLICY, *live, *best)))
    known = {result.run.policy for result in results}
    named = [policy for policy in order if policy in known]
    return set(named if len(named) <= 1.3 * FEW else named[:FEW])


def _traced(results: Sequence[Result]) -> int:
    """Return the number of episodes of each scenario in the player."""
    most = max((len(result.run.tracks) for result in results), default=0)
    runs = sum(1 for result in results if result.run.tracks)
    return min(most, max(1, LARGEST_TRACES // (FRAMES * runs))) if runs else TRACED


def _scenario(scenario: Scenario, results: Sequence[Result], traced: int) -> dict[str, Any]:
    speed_range, known = speed_range_of(scenario.name), max(len(result.run.tracks) for result in results)
    return {
        "name": scenario.name,
        "speed_range": speed_range,
        "case": scenario.name.removeprefix(f"{speed_range}-"),
        "duration": scenario.duration,
        "cap": ERROR_CAPS.get(speed_range or ""),
        "rows": [_row(entry, results) for entry in ranked([result.entry for result in results])],
        "bands": [_band(result, scenario) for result in results if result.run.bands is not None],
        "episodes": [_episode(results, scenario, i) for i in range(min(traced, known))],
    }


def _row(entry: Entry, results: Sequence[Result]) -> dict[str, Any]:
    """Return the data of a policy for the charts of a scenario."""
    (run,) = (result.run for result in results if result.entry is entry)
    assert entry.summary is not None
    assert run.measures is not None
    steady_rmse, score = entry.summary.steady_rmse_m, entry.score
    return {
        "policy": entry.policy,
        "steady_rmse": _positive(_interval(steady_rmse.mean, steady_rmse.ci95, digits(3), ends)),
        "score": _interval(score.mean, score.ci95, fixed, fixed_ends) if score and math.isfinite(score.mean) else None,
        "failed": failures_text(entry.failed, entry.summary.episodes),
        "steady_rmses": _distribution(run.measures.steady_rmse),
    }


def _interval(mean: float, ci95: tuple[float, float], form: Any, form_ends: Any) -> dict[str, Any]:
    """Return a value with its interval, as numbers and as text; a missing interval becomes a point."""
    known = all(map(math.isfinite, ci95))
    low, high = ci95 if known else (mean, mean)
    text = f"{form(mean)} ({form_ends(ci95)})" if known else form(mean)
    return {"value": _short(mean), "low": _short(low), "high": _short(high), "text": text}


def _positive(interval: dict[str, Any]) -> dict[str, Any]:
    """Return an interval with positive ends, for a logarithmic axis."""
    return {key: value if key == "text" else max(value, _LEAST) for key, value in interval.items()}


def _distribution(values: Array) -> list[list[float]]:
    """Return the cumulative distribution: values and shares, exact for few values and at `LEVELS` for many."""
    few = len(values) <= len(LEVELS)
    shares = np.arange(1, len(values) + 1) / len(values) if few else LEVELS
    levels = np.sort(values) if few else np.quantile(values, LEVELS)
    return [_shortened(np.maximum(levels, _LEAST)), _shortened(shares)]


def _band(result: Result, scenario: Scenario) -> dict[str, Any]:
    """Return the band of the position error over time, at `INSTANTS` times or fewer."""
    assert result.run.bands is not None
    instants = _kept(result.run.bands.shape[1], INSTANTS)
    low, middle, high = (_shortened(np.maximum(row[instants], _LEAST)) for row in result.run.bands)
    t = _shortened(scenario.control_dt * (instants + 1))
    return {"policy": result.run.policy, "t": t, "low": low, "middle": middle, "high": high}


def _episode(results: Sequence[Result], scenario: Scenario, i: int) -> dict[str, Any]:
    """Return the i-th episode for the player: the reference, and trajectory, error and current of each policy."""
    tracks = {r.run.policy: r.run.tracks[i] for r in results if len(r.run.tracks) > i}
    longest = max(tracks.values(), key=lambda track: len(track.position))
    instants = _kept(len(longest.position), FRAMES)
    return {
        "dt": scenario.control_dt * float(instants[1] - instants[0]) if len(instants) > 1 else scenario.control_dt,
        "reference": _pose(longest.reference, longest.heading[:, 1], longest.height[:, 1:], instants),
        "vehicles": [{"policy": policy, **_vehicle(track, instants)} for policy, track in tracks.items()],
    }


def _vehicle(track: Track, instants: Array) -> dict[str, Any]:
    shown = instants[instants < len(track.position)]
    current = [_shortened(row, 2) for row in track.current[shown].T]
    pose = _pose(track.position, track.heading[:, 0], track.height[:, :1], shown)
    still = not np.any(track.current)
    return {**pose, "error": _shortened(np.maximum(track.error[shown], _LEAST)), "current": None if still else current}


def _pose(position: Array, heading: Array, height: Array, instants: Array) -> dict[str, Any]:
    """Return positions and, in space, depths in centimetres and headings in hundredths of a radian, as integers."""
    rows = np.column_stack((position, heading, -height))[instants].T
    return dict(zip(("x", "y", "psi", "depth"), np.round(100 * rows).astype(int).tolist(), strict=False))


def _kept(count: int, most: int) -> Any:
    """Return at most `most` equidistant integers of range(count), from 0 on."""
    return np.arange(0, count, math.ceil(count / most))


def _short(value: float, digits: int = 4) -> float:
    return float(f"{value:.{digits}g}")


def _shortened(values: Any, digits: int = 3) -> list[float]:
    return [_short(value, digits) for value in np.asarray(values, dtype=np.float64).tolist()]

"""The page docs/results/vehicles-v2.md: error of every policy on published vehicles, divided by that of a rival."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from auv_gym.physics.namespaces import Array
from auv_gym.scenarios.presets import SPEED_RANGES
from baselines.control import POLICIES
from baselines.evaluation.metrics import Measures
from baselines.evaluation.report.columns import failures_text
from baselines.evaluation.score import (
    FULL_INFORMATION,
    OPTIMUM_POLICY,
    RIVAL,
    Score,
    capped,
    count_failures,
    error_cap,
    fixed,
    fixed_ends,
    has_failed,
    paired,
    relative_error,
    speed_range_of,
    vehicle_of,
)
from baselines.tools.figure_style import panels, styled, to_png
from research.pages import table
from research.results.collection import ROUNDING, Results, results_of
from research.trainings.study_files import InSuite, Study, load_studies

VEHICLES_SUITE = "vehicles-v2"  # suite of the page
AGENT = "helm-any"  # the agent of the table by vehicle
_FIGURE = f"results-{VEHICLES_SUITE}.png"  # file of the figure
_CALM = "calm"  # case without a disturbance, where errors are rounding errors
LEAST, MOST = 0.1, 10.0  # ratios at the ends of the colour scale
_VEHICLE_HEADS = (
    "vehicle", "best controller", f"`{AGENT}` / best", "optimum / best", f"failures: best, `{AGENT}`, optimum",
    f"command rate / {RIVAL}", f"time [us]: best / `{AGENT}`",
)  # fmt: skip
_HEADS = (f"error / {RIVAL}", f"without {_CALM}", "failures")


@dataclass(frozen=True)
class Pair:
    """Measures of a policy and of the rival in their common episodes, by scenario, in metres of the paper's vehicle."""

    own: Mapping[str, Measures]
    rival: Mapping[str, Measures]

    def among(self, wanted: Callable[[str], bool]) -> Pair:
        """Return the pair in the scenarios for whose names `wanted` is true."""
        return Pair(*({name: m for name, m in side.items() if wanted(name)} for side in (self.own, self.rival)))

    def on(self, vehicle: str) -> Pair:
        """Return the pair in the scenarios of a vehicle."""
        return self.among(lambda name: vehicle_of(name) == vehicle)

    @property
    def capped(self) -> dict[str, Array]:
        """Capped errors [m] of the policy's episodes, by scenario."""
        return {name: capped(m, error_cap(name)) for name, m in self.own.items()}

    @cached_property
    def error(self) -> Score:
        """Geometric mean over cells of the ratio of the policy's capped mean error to the rival's."""
        rival = [capped(m, error_cap(name)) for name, m in self.rival.items()]
        return relative_error(rival, [*self.capped.values()])

    @property
    def failed(self) -> int:
        """Number of failures of the policy."""
        return sum(count_failures(m, error_cap(name)) for name, m in self.own.items())

    @property
    def episodes(self) -> int:
        """Number of episodes."""
        return sum(map(len, self.own.values()))

    def over(self, what: str) -> float:
        """Return the ratio of the policy's mean of a measure, such as the effort, to the rival's."""
        own, rival = (_mean(getattr(m, what) for m in side.values()) for side in (self.own, self.rival))
        return own / rival


def _mean(values: Iterable[Array]) -> float:
    return float(np.concatenate(list(values)).mean())


def pairs_of(results: Results, speed_range: str = "") -> dict[str, Pair]:
    """Return the policies that ran in all cells of a speed range, by default of both, the smallest error first."""
    cases = {
        name: case for name, case in results.cases.items() if not speed_range or speed_range_of(name) == speed_range
    }
    found = {}
    for policy in results.policies:
        if all(policy in case for case in cases.values()):
            both = {name: paired(case[policy], case[RIVAL]) for name, case in cases.items()}
            found[policy] = Pair({name: p[0] for name, p in both.items()}, {name: p[1] for name, p in both.items()})
    return dict(sorted(found.items(), key=lambda item: item[1].error.mean))


def context(_: str = "") -> dict[str, Any]:
    """Return the values of the page's template."""
    results = results_of(VEHICLES_SUITE)
    pairs = pairs_of(results)
    seeds = seed_rows(pairs[RIVAL].own, load_studies())
    return {
        "suite": results.suite,
        "vehicles": len(vehicles_of(results)),
        "episodes": sum(len(cell.episodes) for cell in results.suite.cells),
        "rival": RIVAL,
        "rows": table(("policy", *_HEADS, "effort", "command rate"), map(_row, pairs, pairs.values())),
        "seeds": table(("agent", "seeds", *_HEADS), seeds) if seeds else "",
        "by_vehicle": table(_VEHICLE_HEADS, vehicle_rows(pairs, results)),
        "agent": AGENT,
        "figure": _FIGURE,
        "optimum": OPTIMUM_POLICY,
        "better": better_than_optimum(results)[:1],
        "avoidable": [(p, pairs[p].failed, avoidable_failures(pairs, p)) for p in (AGENT, RIVAL)],
    }


def vehicles_of(results: Results) -> list[str]:
    """Return the vehicles in the order of the suite."""
    return list(dict.fromkeys(vehicle_of(cell.scenario.name) for cell in results.suite.cells))


def vehicle_rows(pairs: Mapping[str, Pair], results: Results) -> list[list[str]]:
    """Return for each vehicle how the agent and the optimum compare with the controller of the smallest error."""
    rows, controllers = [], _controllers(pairs)
    for vehicle in vehicles_of(results):
        own = {policy: pair.on(vehicle) for policy, pair in pairs.items()}
        errors = {policy: own[policy].error.mean for policy in controllers}
        best, shown = min(errors, key=errors.__getitem__), (AGENT, OPTIMUM_POLICY)
        ratios = (relative_error(*([*own[p].capped.values()] for p in (best, policy))) for policy in shown)
        failed = ", ".join(str(own[policy].failed) for policy in (best, *shown))
        times = (_decision_time(results, policy, vehicle) for policy in (best, AGENT))
        rows.append([
            f"`{vehicle}`", f"`{best}`", *_ratios(*ratios),
            f"{failed} of {own[best].episodes}", _ratio(own[AGENT].over("smoothness")),
            " / ".join(f"{1e6 * time:.3g}" for time in times),
        ])  # fmt: skip
    return rows


def _controllers(pairs: Mapping[str, Pair]) -> list[str]:
    """Return the policies that are controllers and use measurements only."""
    return [policy for policy in pairs if policy in POLICIES and policy not in FULL_INFORMATION]


def avoidable_failures(pairs: Mapping[str, Pair], policy: str) -> int:
    """Return the number of failures of a policy in episodes in which another controller does not fail."""
    others = [pairs[name] for name in _controllers(pairs) if name != policy]
    count = 0
    for cell, measures in pairs[policy].own.items():
        unavoidable = np.logical_and.reduce([has_failed(pair.own[cell], error_cap(cell)) for pair in others])
        count += int((has_failed(measures, error_cap(cell)) & ~unavoidable).sum())
    return count


def _decision_time(results: Results, policy: str, vehicle: str) -> float:
    """Return the median over cells of the time of a decision [s]."""
    cells = (run for run in results.runs if run.policy == policy and vehicle_of(run.scenario.name) == vehicle)
    return float(np.median([run.decision_seconds for run in cells]))


def _row(policy: str, pair: Pair) -> list[str]:
    return [
        f"`{policy}`",
        *_ratios(pair.error, pair.among(_disturbed).error),
        failures_text(pair.failed, pair.episodes),
        *(_ratio(pair.over(what)) for what in ("effort", "smoothness")),
    ]


def seed_rows(rival: Mapping[str, Measures], studies: Mapping[str, Study]) -> list[list[str]]:
    """Return a row for each agent with several training seeds that ran in all cells.

    Args:
        rival: measures of the rival in each cell, in metres of the paper's vehicle.
        studies: by name; those of an agent for both speed ranges are `NAME-slow` and `NAME-cruise`.
    """
    agents: dict[str, list[InSuite]] = {}
    for name, study in studies.items():
        if VEHICLES_SUITE in study.suites:
            agents.setdefault(name.removesuffix(f"-{study.speed_range}"), []).append(study.suites[VEHICLES_SUITE])
    rows = []
    for agent, found in agents.items():
        steady_rmses = {
            cell: steady_rmse for each in found for cell, steady_rmse in zip(each.cells, each.capped(), strict=True)
        }
        if rival.keys() <= steady_rmses.keys():
            base = {cell: capped(m, error_cap(cell))[: steady_rmses[cell].shape[1]] for cell, m in rival.items()}
            disturbed = list(filter(_disturbed, rival))
            ratios = (
                relative_error([base[c] for c in cells], [steady_rmses[c] for c in cells])
                for cells in (base, disturbed)
            )
            own = [each for each in found if {*each.cells} <= rival.keys()]
            failed, total = sum(each.count_failures() for each in own), sum(steady_rmses[cell].size for cell in rival)
            seeds = len(next(iter(steady_rmses.values())))
            rows.append([f"`{agent}`", str(seeds), *_ratios(*ratios), failures_text(failed, total)])
    return rows


def _ratios(*errors: Score) -> list[str]:
    """Return error ratios with their intervals as text."""
    return [f"{_ratio(error.mean)} ({fixed_ends(error.ci95, 2)})" for error in errors]


def _disturbed(scenario: str) -> bool:
    """Return whether a scenario CASE@VEHICLE has a disturbance."""
    return not scenario.partition("@")[0].endswith(f"-{_CALM}")


def _ratio(value: float) -> str:
    return fixed(value, 2 if value < 10 else 1)


def better_than_optimum(results: Results) -> list[tuple[str, int, str, float]]:
    """Return the policies with a smaller error than the optimum in an episode: scenario, episode, policy, difference.

    Differences are in metres of the paper's vehicle and above `ROUNDING`, the largest of each policy and scenario; the
    list begins with the largest one.
    """
    found = []
    for name, case in results.cases.items():
        for policy in case if OPTIMUM_POLICY in case else ():
            own, best = paired(case[policy], case[OPTIMUM_POLICY])
            gain = best.steady_rmse - own.steady_rmse
            if policy != OPTIMUM_POLICY and gain.max() > ROUNDING:
                found.append((name, int(gain.argmax()), policy, float(gain.max())))
    return sorted(found, key=lambda entry: -entry[-1])


def figures(_: str = "") -> dict[str, bytes]:
    """Return the figure of the page as PNG, by name."""
    results = results_of(VEHICLES_SUITE)
    with styled():
        return {_FIGURE: to_png(_map(results, vehicles_of(results)))}


def _map(results: Results, vehicles: Sequence[str]) -> Figure:
    """Return the heat map of the error ratios: a row for each policy, a column for each vehicle, two speed ranges."""
    own = {speed_range: {p: pair for p, pair in pairs_of(results, speed_range).items() if p not in FULL_INFORMATION}
           for speed_range in SPEED_RANGES}  # fmt: skip
    fig, [axes] = panels(1, len(own), (9.6, 1.6 + 0.27 * max(map(len, own.values()))))
    for ax, (speed_range, pairs) in zip(axes, own.items(), strict=True):
        shown = [v for v in vehicles if any(vehicle_of(n) == v for n in next(iter(pairs.values())).own)]
        values = np.array([[pair.on(v).error.mean for v in shown] for pair in pairs.values()])
        image = ax.imshow(values, aspect="auto", cmap="RdBu_r", norm=LogNorm(LEAST, MOST))
        for (i, j), value in np.ndenumerate(values):
            colour = "white" if abs(np.log10(value)) > 0.7 else "black"
            ax.text(j, i, _ratio(value), ha="center", va="center", fontsize=7, color=colour)
        ax.set_xticks(range(len(shown)), shown, rotation=40, ha="right", rotation_mode="anchor")
        ax.set_yticks(range(len(pairs)), list(pairs))
        ax.set_title(speed_range)
        ax.grid(visible=False)
    fig.colorbar(image, ax=axes, label=f"error / {RIVAL}", shrink=0.9)
    return fig

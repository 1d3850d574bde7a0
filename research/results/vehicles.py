"""The page docs/results/vehicles-v3.md: error of every policy on published vehicles, divided by that of a rival."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from matplotlib.colors import LogNorm

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
    has_failed,
    paired,
    relative_error,
    vehicle_of,
)
from baselines.tools.figure_style import panels, styled, to_png
from research.pages import table, with_interval
from research.results.collection import Results, results_of
from research.trainings.seed_runs import SEED_RUNS, SeedRuns, trained

VEHICLES_SUITE = "vehicles-v3"  # suite of the page
AGENT = "helm-any"  # the agent of the table by vehicle
_FIGURE = f"results-{VEHICLES_SUITE}.png"  # file of the figure
_CALM = "calm"  # case without a disturbance, where errors are rounding errors
_VEHICLE_HEADS = (
    "vehicle", "best controller", f"`{AGENT}` / best", "optimum / best", f"failures: best, `{AGENT}`, optimum",
    f"command rate / {RIVAL}",
)  # fmt: skip
_HEADS = (f"error / {RIVAL}", f"without {_CALM}", "failures")


@dataclass(frozen=True)
class Pair:
    """Metrics of a policy and of the rival in their common episodes, by scenario, in metres of the paper's vehicle."""

    policy: Mapping[str, Measures]
    rival: Mapping[str, Measures]

    def among(self, wanted: Callable[[str], bool]) -> Pair:
        """Return the pair in the scenarios for whose names `wanted` is true."""
        return Pair(*({name: m for name, m in side.items() if wanted(name)} for side in (self.policy, self.rival)))

    def on(self, vehicle: str) -> Pair:
        """Return the pair in the scenarios of a vehicle."""
        return self.among(lambda name: vehicle_of(name) == vehicle)

    @cached_property
    def error(self) -> Score:
        """Geometric mean over cells of the ratio of the policy's capped mean error to the rival's."""
        return relative_error(
            *([capped(m, error_cap(name)) for name, m in s.items()] for s in (self.rival, self.policy))
        )

    @property
    def failed(self) -> int:
        """Number of failures of the policy."""
        return sum(count_failures(m, error_cap(name)) for name, m in self.policy.items())

    @property
    def episodes(self) -> int:
        """Number of episodes."""
        return sum(map(len, self.policy.values()))

    def over(self, metric: str) -> float:
        """Return the ratio of the policy's mean of a metric, such as the effort, to the rival's."""
        sides = ([getattr(m, metric) for m in side.values()] for side in (self.policy, self.rival))
        policy, rival = (np.concatenate(side).mean() for side in sides)
        return float(policy / rival)


def pairs_of(results: Results, speed_range: str = "") -> dict[str, Pair]:
    """Return the policies that ran in all cells of a speed range, by default of both, the smallest error first."""
    cases = {name: case for name, case in results.cases.items() if name.startswith(speed_range)}
    pairs = {}
    for policy in results.policies:
        if all(policy in case for case in cases.values()):
            both = {name: paired(case[policy], case[RIVAL]) for name, case in cases.items()}
            pairs[policy] = Pair(*({name: pair[i] for name, pair in both.items()} for i in range(2)))
    return dict(sorted(pairs.items(), key=lambda item: item[1].error.mean))


def context(_: str = "") -> dict[str, Any]:
    """Return the values of the page's template."""
    results = results_of(VEHICLES_SUITE)
    pairs = pairs_of(results)
    agents = trained(VEHICLES_SUITE) if (SEED_RUNS / f"{VEHICLES_SUITE}.npz").exists() else {}
    seeds = seed_rows(pairs[RIVAL].policy, agents)
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
        "avoidable": [(p, pairs[p].failed, avoidable_failures(pairs, p)) for p in (AGENT, RIVAL)],
    }


def vehicles_of(results: Results) -> list[str]:
    """Return the vehicles in the order of the suite."""
    return list(dict.fromkeys(vehicle_of(cell.scenario.name) for cell in results.suite.cells))


def vehicle_rows(pairs: Mapping[str, Pair], results: Results) -> list[list[str]]:
    """Return for each vehicle how the agent and the optimum compare with the controller of the smallest error."""
    rows = []
    for vehicle in vehicles_of(results):
        on_vehicle = {policy: pair.on(vehicle) for policy, pair in pairs.items()}
        best = min(_controllers(pairs), key=lambda policy: on_vehicle[policy].error.mean)
        shown = (AGENT, OPTIMUM_POLICY)
        ratios = (Pair(on_vehicle[policy].policy, on_vehicle[best].policy).error for policy in shown)
        failed = ", ".join(str(on_vehicle[policy].failed) for policy in (best, *shown))
        rows.append([
            f"`{vehicle}`", f"`{best}`", *map(with_interval, ratios), f"{failed} of {on_vehicle[best].episodes}",
            f"{on_vehicle[AGENT].over('smoothness'):.2f}",
        ])  # fmt: skip
    return rows


def _controllers(pairs: Mapping[str, Pair]) -> list[str]:
    """Return the policies that are controllers and use measurements only."""
    return [policy for policy in pairs if policy in POLICIES and policy not in FULL_INFORMATION]


def avoidable_failures(pairs: Mapping[str, Pair], policy: str) -> int:
    """Return the number of failures of a policy in episodes in which another controller does not fail."""
    others = [pairs[name] for name in _controllers(pairs) if name != policy]
    count = 0
    for cell, measures in pairs[policy].policy.items():
        unavoidable = np.logical_and.reduce([has_failed(pair.policy[cell], error_cap(cell)) for pair in others])
        count += int((has_failed(measures, error_cap(cell)) & ~unavoidable).sum())
    return count


def _row(policy: str, pair: Pair) -> list[str]:
    ratios = map(with_interval, (pair.error, pair.among(_disturbed).error))
    rates = (f"{pair.over(metric):.2f}" for metric in ("effort", "smoothness"))
    return [f"`{policy}`", *ratios, failures_text(pair.failed, pair.episodes), *rates]


def seed_rows(rival: Mapping[str, Measures], trainings: Mapping[str, SeedRuns]) -> list[list[str]]:
    """Return a row for each agent with several training seeds that ran in all cells.

    Args:
        rival: metrics of the rival in each cell, in metres of the paper's vehicle.
        trainings: by name.
    """
    rows = []
    for agent, seeds in trainings.items():
        if rival.keys() <= seeds.measures.keys():
            base = {cell: capped(m, error_cap(cell))[: seeds.capped[cell].shape[1]] for cell, m in rival.items()}
            ratios = (
                relative_error([base[cell] for cell in cells], [seeds.capped[cell] for cell in cells])
                for cells in (list(base), list(filter(_disturbed, base)))
            )
            failures = failures_text(seeds.failed, seeds.episodes)
            rows.append([f"`{agent}`", str(seeds.seeds), *map(with_interval, ratios), failures])
    return rows


def _disturbed(scenario: str) -> bool:
    """Return whether a scenario CASE@VEHICLE has a disturbance."""
    return not scenario.partition("@")[0].endswith(f"-{_CALM}")


def figures(_: str = "") -> dict[str, bytes]:
    """Return the figure of the page as PNG, by name: the error ratio of each policy on each vehicle."""
    results = results_of(VEHICLES_SUITE)
    ranges = {speed_range: pairs_of(results, speed_range) for speed_range in SPEED_RANGES}
    with styled():
        fig, [axes] = panels(1, len(ranges), (9.6, 1.6 + 0.27 * max(map(len, ranges.values()))))
        for ax, (speed_range, pairs) in zip(axes, ranges.items(), strict=True):
            names = [policy for policy in pairs if policy not in FULL_INFORMATION]
            vehicles = [v for v in vehicles_of(results) if pairs[RIVAL].on(v).policy]
            values = np.array([[pairs[policy].on(v).error.mean for v in vehicles] for policy in names])
            image = ax.imshow(values, aspect="auto", cmap="RdBu_r", norm=LogNorm(0.1, 10.0))
            for (i, j), value in np.ndenumerate(values):
                colour = "white" if abs(np.log10(value)) > 0.7 else "black"
                ax.text(j, i, f"{value:.{2 if value < 10 else 0}f}", ha="center", va="center", fontsize=7, color=colour)
            ax.set_xticks(range(len(vehicles)), vehicles, rotation=40, ha="right", rotation_mode="anchor")
            ax.set_yticks(range(len(names)), names)
            ax.set_title(speed_range)
            ax.grid(visible=False)
        fig.colorbar(image, ax=axes, label=f"error / {RIVAL}", shrink=0.9)
        return {_FIGURE: to_png(fig)}

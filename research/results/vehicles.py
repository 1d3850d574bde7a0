"""The section on other vehicles of the results page: every policy, made for each vehicle, over the rival."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeGuard

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from auv_gym.physics.namespaces import Array
from baselines.evaluation.metrics import Measures
from baselines.evaluation.report.columns import lost_text
from baselines.evaluation.report.numbers import measures_of
from baselines.evaluation.score import (
    EXPERT,
    FORESIGHTED,
    OPTIMUM_POLICY,
    RIVAL,
    Score,
    capped,
    fixed,
    fixed_ends,
    interval_text,
    largest_tail,
    losses,
    paired,
    regime_of,
    relative_error,
    score,
    score_text,
    vehicle_of,
)
from baselines.tools.figure_style import panels, styled, to_png
from research.pages import table
from research.results.collection import ROUNDING, Results, results_of
from research.results.study_files import InSuite, Study, load_studies

VEHICLES_SUITE = "vehicles-v1"  # what the section is about
_FIGURE = f"results-{VEHICLES_SUITE}.png"  # its figure
CALM = "calm"  # the case without a trouble, whose errors are those of rounding
LEAST, MOST = 0.1, 10.0  # ratios from which on the figure has its darkest colours
_SMALL = 1e-3  # [m of the paper's vehicle] below which one column takes every error to be as good


@dataclass(frozen=True)
class Pair:
    """A policy and the rival in the cells of a regime that both ran in, in the same episodes."""

    own: Mapping[str, Measures]  # by scenario, in metres of the paper's vehicle
    rival: Mapping[str, Measures]

    @classmethod
    def of(cls, results: Results, policy: str, regime: str) -> Pair | None:
        """Return a policy and the rival in a regime; None where it did not run in all of its cells."""
        cases = {name: case for name, case in results.cases.items() if regime_of(name) == regime}
        if not cases or any(policy not in case or RIVAL not in case for case in cases.values()):
            return None
        both = {name: paired(case[policy], case[RIVAL]) for name, case in cases.items()}
        return cls({name: pair[0] for name, pair in both.items()}, {name: pair[1] for name, pair in both.items()})

    def among(self, wanted: Callable[[str], bool]) -> Pair:
        """Return both in the scenarios that are wanted."""
        return Pair(*({name: m for name, m in side.items() if wanted(name)} for side in (self.own, self.rival)))

    @classmethod
    def joined(cls, pairs: Iterable[Pair]) -> Pair:
        """Return both in the scenarios of several pairs."""
        own, rival = ({name: m for side in sides for name, m in side.items()}
                      for sides in zip(*((pair.own, pair.rival) for pair in pairs), strict=True))  # fmt: skip
        return cls(own, rival)

    @cached_property
    def error(self) -> Score:
        """The geometric mean over cells of the policy's mean tail, capped, over the rival's."""
        sides = ([capped(m, largest_tail(name)) for name, m in side.items()] for side in (self.rival, self.own))
        return relative_error(*sides)

    def error_above(self, least: float) -> float:
        """Return the same ratio where no mean error counts as less than this [m]: both are good enough there."""
        sides = (
            [max(least, capped(m, largest_tail(name)).mean()) for name, m in side.items()]
            for side in (self.own, self.rival)
        )
        own, rival = map(np.log, sides)
        return float(np.exp(np.mean(own - rival)))

    @property
    def lost(self) -> int:
        """How many episodes the policy loses."""
        return sum(losses(m, largest_tail(name)) for name, m in self.own.items())

    @property
    def episodes(self) -> int:
        """How many there are."""
        return sum(map(len, self.own.values()))

    def over(self, what: str) -> float:
        """Return the mean of a measure over the rival's, such as the effort."""
        own, rival = (_mean(getattr(m, what) for m in side.values()) for side in (self.own, self.rival))
        return own / rival


def _mean(values: Iterable[Array]) -> float:
    return float(np.concatenate(list(values)).mean())


def _shown(results: Results | None) -> TypeGuard[Results]:
    """Return whether enough is recorded of the suite: its anchors and the rival."""
    return results is not None and RIVAL in results.policies


def vehicles_section(results: Results | None, studies: Mapping[str, Study]) -> str:
    """Return the section's text for what is recorded of the suite, and for agents of several seeds that ran in it.

    Args:
        results: None where the anchors are not recorded.
        studies: by name.
    """
    if not _shown(results):
        return f"## {VEHICLES_SUITE}\n\nNot recorded yet: `python -m research suites record {VEHICLES_SUITE}`."
    regimes = list(dict.fromkeys(regime_of(cell.scenario.name) or "" for cell in results.suite.cells))
    pairs = {regime: pairs_of(results, regime) for regime in regimes}
    everywhere = [policy for policy in pairs[regimes[0]] if all(policy in own for own in pairs.values())]
    whole = nearest_first({policy: Pair.joined([own[policy] for own in pairs.values()]) for policy in everywhere})
    parts = [_introduction(results)]
    for heading, own in (
        (f"{VEHICLES_SUITE}, all cells", whole),
        *((f"{VEHICLES_SUITE}, {r}", pairs[r]) for r in regimes),
    ):
        parts += [f"### {heading}", *_together(results, own), *of_seeds(own[RIVAL].own, studies)]
    parts += [MAP, f"![Errors by vehicle](images/{_FIGURE})"]
    return "\n\n".join([*parts, _anchors(results), _CAVEATS])


def context(_: str) -> dict[str, Any]:
    """Return the body of the page."""
    return {"body": vehicles_section(results_of(VEHICLES_SUITE), load_studies())}


def vehicles_of(results: Results) -> list[str]:
    """Return the vehicles of the suite, in its order."""
    return list(dict.fromkeys(vehicle_of(cell.scenario.name) for cell in results.suite.cells))


def pairs_of(results: Results, regime: str) -> dict[str, Pair]:
    """Return the policies that ran in all cells of a regime with the rival in the same episodes, the nearest first."""
    found = {policy: Pair.of(results, policy, regime) for policy in results.policies}
    whole = {policy: pair for policy, pair in found.items() if pair is not None}
    return nearest_first(whole)


def nearest_first(pairs: Mapping[str, Pair]) -> dict[str, Pair]:
    """Return pairs by policy in the order of their errors over the rival's."""
    return dict(sorted(pairs.items(), key=lambda item: item[1].error.mean))


def _introduction(results: Results) -> str:
    suite, cells = results.suite, results.suite.cells
    episodes = sum(len(cell.episodes) for cell in cells)
    dates = sorted({run.recorded.date for run in results.runs if run.recorded is not None})
    return (
        f"## {VEHICLES_SUITE}\n\n{len(vehicles_of(results))} published vehicles ([Vehicles](vehicles.md)), none of "
        f"them the paper's, each in the eight cases at its own speeds: {len(cells)} cells, {episodes} episodes, "
        f"SHA-256 `{suite.hash}`. Every policy is made for each vehicle, which it is told as the plan knows "
        f"it. Recorded: {' and '.join(dates)}.\n\n{_INTRODUCTION}"
    )


_INTRODUCTION = f"""### What is compared

*error / {RIVAL}*: in each cell, that is a case with one vehicle, the mean tail error over that of
`{RIVAL}`, which is told each vehicle too, in the same episodes, none counted above the cap; of these ratios the
geometric mean over cells. It has no unit, and a ship counts no more than a torpedo. In brackets a 95 % interval, by
bootstrap over the episodes of each cell, the same for both. *without {CALM}* leaves out the cells in which nothing is
in the way and errors are those of rounding; *at least {1e3 * _SMALL:g} mm* takes every mean error below that, in the
paper's units, to be as good. *score* is the capped one of all cells together, its distances in lengths
$\\sqrt{{m_{{33}}/m_{{11}}}}$ of each vehicle. The cap, from which on an episode is *lost*, is as many times the
paper's vehicle's as the vehicle is as long. *effort* and *rate* are means over all cells, over those of `{RIVAL}`."""


def _together(results: Results, pairs: Mapping[str, Pair]) -> list[str]:
    """Return the tables of all vehicles together, over all cases and case by case."""
    names = list(pairs[RIVAL].own)
    cases = list(dict.fromkeys(map(_case, names)))
    rows, more = [], []
    for policy, pair in pairs.items():
        points = _score(results, policy, names)
        rows.append([
            f"`{policy}`",
            *_ratios(pair.error, pair.among(_troubled).error),
            _ratio(pair.error_above(_SMALL)),
            f"{score_text(points, 2)} ({interval_text(points, 2)})",
            lost_text(pair.lost, pair.episodes),
            *(_ratio(pair.over(what)) for what in ("effort", "smoothness")),
        ])  # fmt: skip
        by_case = (pair.among(lambda name, case=case: _case(name) == case) for case in cases)  # type: ignore[misc]
        more.append([f"`{policy}`", *(_ratio(few.error.mean) for few in by_case)])
    heads = ("policy", *_RATIOS, f"at least {1e3 * _SMALL:g} mm", "score", "lost", "effort", "rate")
    about = (
        f"{len(set(map(vehicle_of, names)))} vehicles, {len(names)} cells, {pairs[RIVAL].episodes} episodes; "
        "below, the same ratio case by case."
    )
    return [about, table(heads, rows), table(("", *cases), more)]


def of_seeds(rival: Mapping[str, Measures], studies: Mapping[str, Study]) -> list[str]:
    """Return the text about agents of several training seeds; [] without any that ran in all of the cells.

    Args:
        rival: what was measured of the rival in each cell, in metres of the paper's vehicle.
        studies: by name: those of an agent for both regimes are NAME-REGIME.
    """
    agents: dict[str, list[InSuite]] = {}
    for name, study in studies.items():
        if VEHICLES_SUITE in study.suites:
            agents.setdefault(name.removesuffix(f"-{study.regime}"), []).append(study.suites[VEHICLES_SUITE])
    rows = []
    for agent, found in agents.items():
        tails = {cell: tail for each in found for cell, tail in zip(each.cells, each.capped(), strict=True)}
        if rival.keys() <= tails.keys():
            theirs = {cell: capped(m, largest_tail(cell))[: tails[cell].shape[1]] for cell, m in rival.items()}
            troubled = list(filter(_troubled, rival))
            ratios = (relative_error([theirs[c] for c in few], [tails[c] for c in few]) for few in (theirs, troubled))
            own = [each for each in found if {*each.cells} <= rival.keys()]
            lost, total = sum(each.losses() for each in own), sum(tails[cell].size for cell in rival)
            rows.append([f"`{agent}`", str(len(next(iter(tails.values())))), *_ratios(*ratios), lost_text(lost, total)])
    text = "Agents of several training seeds; intervals are over seeds and episodes."
    return [text, table(("agent", "seeds", *_RATIOS, "lost"), rows)] if rows else []


_RATIOS = (f"error / {RIVAL}", f"without {CALM}")
"""Heads of the columns that `_ratios` fills."""


def _ratios(overall: Score, troubled: Score) -> list[str]:
    """Return the errors over the rival's in all cells and in those with a trouble, with their intervals."""
    return [f"{_ratio(error.mean)} ({fixed_ends(error.ci95, 2)})" for error in (overall, troubled)]


def _troubled(scenario: str) -> bool:
    """Return whether anything is in the way in a scenario."""
    return _case(scenario) != CALM


def _case(scenario: str) -> str:
    """Return the case of a scenario REGIME-CASE@VEHICLE."""
    return scenario.partition("@")[0].partition("-")[2]


def _ratio(value: float) -> str:
    """Return a ratio as text."""
    return fixed(value, 2 if value < 10 else 1)


def _score(results: Results, policy: str, names: Sequence[str]) -> Score:
    """Return the capped score of a policy in these cells together."""
    cases, (zero, one) = results.cases, results.suite.anchors
    three = [paired(*(cases[name][key] for key in (zero, policy, one))) for name in names]
    cut = [[capped(m, largest_tail(name)) for m in own] for name, own in zip(names, three, strict=True)]
    return score(*zip(*cut, strict=True))


MAP = f"""### Vehicle by vehicle

Error over that of `{RIVAL}` for each vehicle; blue is below 1, red above."""


def nearer_than_optimum(results: Results) -> list[tuple[str, int, str, float]]:
    """Return scenario, episode, policy and by how much it is nearer than the bound, the worst of each cell first.

    Distances are in metres of the paper's vehicle. What counts is more than `ROUNDING` in a single episode.
    """
    found = []
    for name, case in results.cases.items():
        for policy in case if OPTIMUM_POLICY in case else ():
            own, best = paired(case[policy], case[OPTIMUM_POLICY])
            gain = best.tail - own.tail
            if policy != OPTIMUM_POLICY and gain.max() > ROUNDING:
                found.append((name, int(gain.argmax()), policy, float(gain.max())))
    return sorted(found, key=lambda entry: -entry[-1])


def _anchors(results: Results) -> str:
    """Return what expert and bound do: how many episodes they lose, and who is nearer than the bound."""
    lost = {}
    for policy in (EXPERT, OPTIMUM_POLICY):
        own = [run for run in results.runs if run.policy == policy and run.measures is not None]
        cases = measures_of(own)
        count = sum(losses(case[policy], largest_tail(name)) for name, case in cases.items())
        lost[policy] = f"{count} of {sum(len(case[policy]) for case in cases.values())}"
    better = nearer_than_optimum(results)
    if better:
        name, episode, policy, gain = better[0]
        told = (
            f"In {len({entry[0] for entry in better})} cells somebody is, most in episode {episode} of `{name}`: "
            f"`{policy}`, by {1e3 * gain:.2g} mm. Where limits bind the bound is a local optimum, and `make pages` "
            "fails only if somebody is nearer in the mean of a cell"
        )
    else:
        told = "Nobody is"
    return (
        f"### The anchors\n\n`{EXPERT}` loses {lost[EXPERT]} episodes, `{OPTIMUM_POLICY}` {lost[OPTIMUM_POLICY]}. "
        f"Is anybody nearer than `{OPTIMUM_POLICY}` in any single episode by more than the {1e3 * ROUNDING:g} mm, in "
        f"the paper's units, to which it is solved? {told}."
    )


_CAVEATS = """### What the vehicles do not show

The vehicles are as their sources say, in the plane, with sea and sensors scaled
to their length and speed rather than measured on them; limits and speeds of some are ours ([Vehicles](vehicles.md)).
Eight vehicles are no sample of all there are."""


def figures(_: str) -> dict[str, bytes]:
    """Return the figure of the page as PNG by name."""
    results = results_of(VEHICLES_SUITE)
    return {_FIGURE: vehicles_figure(results)} if _shown(results) else {}


def vehicles_figure(results: Results) -> bytes:
    """Return the section's figure as PNG."""
    with styled():
        return to_png(_drawn(results))


def _drawn(results: Results) -> Figure:
    """Return a map of the errors over the rival's: a row for each policy, a column a vehicle, a panel a regime."""
    regimes = list(dict.fromkeys(regime_of(cell.scenario.name) or "" for cell in results.suite.cells))
    vehicles = vehicles_of(results)
    own = {regime: {p: pair for p, pair in pairs_of(results, regime).items() if p not in FORESIGHTED}
           for regime in regimes}  # fmt: skip
    rows = max(map(len, own.values()))
    fig, [axes] = panels(1, len(regimes), (9.6, 1.6 + 0.27 * rows))
    for ax, regime in zip(axes, regimes, strict=True):
        shown = [v for v in vehicles if any(vehicle_of(n) == v for n in next(iter(own[regime].values())).own)]
        values = np.array([
            [pair.among(lambda name, v=v: vehicle_of(name) == v).error.mean for v in shown]  # type: ignore[misc]
            for pair in own[regime].values()
        ])  # fmt: skip
        image = ax.imshow(values, aspect="auto", cmap="RdBu_r", norm=LogNorm(LEAST, MOST))
        for (i, j), value in np.ndenumerate(values):
            colour = "white" if abs(np.log10(value)) > 0.7 else "black"
            ax.text(j, i, _ratio(value), ha="center", va="center", fontsize=7, color=colour)
        ax.set_xticks(range(len(shown)), shown, rotation=40, ha="right", rotation_mode="anchor")
        ax.set_yticks(range(len(own[regime])), list(own[regime]))
        ax.set_title(regime)
        ax.grid(visible=False)
    fig.colorbar(image, ax=axes, label=f"error / {RIVAL}", shrink=0.9)
    return fig

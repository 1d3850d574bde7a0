"""The section of the results page on fronts: error against effort and command rate, and who leads at equal effort."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from auv_gym.physics.namespaces import Array
from auv_gym.scenarios.presets import REGIMES
from baselines.control import POLICIES
from baselines.evaluation.metrics import Measures
from baselines.evaluation.score import EXPERT, fixed, fixed_ends
from baselines.tools.figure_style import COLOURS, MARKERS, panels, styled, to_png
from research.pages import table
from research.results.collection import Results, results_of
from research.results.fresh import FAMILIES
from research.results.front_files import Front, load_fronts
from research.results.leads import LEVEL, LeadEstimate, differences, holm
from research.results.robust import tails_of
from research.results.study_files import Study, load_studies

_FIGURE = "results-fronts.png"
"""File of the figure."""


@dataclass(frozen=True)
class Spent:
    """A policy with its error and what it spends for it."""

    name: str  # of the policy, or of the front that it is a point of
    label: str  # its price, "" for an agent that is no point of a front
    shipped: bool
    tails: tuple[Array, ...]  # [m] capped, shape (S, M) for each case, S training seeds
    effort: float  # over the expert's
    rate: float  # over the expert's

    @property
    def error(self) -> float:
        """Mean tail [m]."""
        return float(np.mean([tail.mean() for tail in self.tails]))

    @property
    def text(self) -> str:
        """Its name with the price."""
        return f"`{self.name}`" + (f", {self.label}" if self.label else "")


@dataclass(frozen=True)
class Spenders:
    """Who is compared in a regime."""

    controllers: Mapping[str, tuple[Spent, ...]]  # fronts by name
    agents: Mapping[str, tuple[Spent, ...]]  # fronts, and single agents, by name
    episodes: int  # of each case


def spenders(fronts: Sequence[Front], results: Results, studies: Mapping[str, Study], regime: str) -> Spenders:
    """Return whose errors and efforts are compared in a regime, all in the same episodes.

    Args:
        fronts: that are kept, of as many episodes each.
        results: what is recorded of their suite.
        studies: agents of several seeds, by name.
        regime: "slow" or "cruise".

    Raises:
        ValueError: the fronts are of different numbers of episodes.
    """
    own = [front for front in fronts if front.regime == regime]
    counts = {tail.shape[1] for front in own for tail in front.rows.tails}
    if len(counts) != 1:
        raise ValueError(f"fronts are of {sorted(counts)} episodes a case; measure them with the same number")
    (episodes,) = counts
    expert = _means([m[:episodes] for m in results.measures(EXPERT, regime)])
    found: dict[str, tuple[Spent, ...]] = {front.name: _points(front, expert) for front in own}
    agents = {name: points for name, points in found.items() if name not in POLICIES}
    for name in (f"{family}-{regime}" for family in FAMILIES):
        if measures := [m[:episodes] for m in results.measures(name, regime)]:
            effort, rate = _means(measures)
            tails = (tail[:, :episodes] for tail in tails_of(name, results, studies, regime).values())
            agents[name] = (Spent(name, "", True, tuple(tails), effort / expert[0], rate / expert[1]),)
    return Spenders({name: points for name, points in found.items() if name in POLICIES}, agents, episodes)


def _points(front: Front, expert: tuple[float, float]) -> tuple[Spent, ...]:
    """Return the points of a front; an agent that ships with the package has a place of its own."""
    tails, rows = front.rows.capped(), front.rows
    return tuple(
        Spent(
            front.name,
            point.label,
            point.shipped,
            tuple(tail[i : i + 1] for tail in tails),
            float(rows.effort[i]) / expert[0],
            float(rows.smoothness[i]) / expert[1],
        )
        for i, point in enumerate(front.points)
    )


def _means(measures: Iterable[Measures]) -> tuple[float, float]:
    """Return mean effort and rate over all episodes."""
    whole = Measures.joined(list(measures))
    return float(whole.effort.mean()), float(whole.smoothness.mean())


def _regimes_of(fronts: Sequence[Front]) -> list[str]:
    """Return the regimes in which there are fronts."""
    return [regime for regime in REGIMES if any(front.regime == regime for front in fronts)]


def context(_: str) -> dict[str, Any]:
    """Return the body of the page."""
    results = results_of("benchmark-v2")
    return {"body": fronts_section(load_fronts(), results, load_studies()) if results else ""}


def figures(_: str) -> dict[str, bytes]:
    """Return the figure of the page as PNG by name."""
    results = results_of("benchmark-v2")
    return {_FIGURE: to_png(figure(load_fronts(), results, load_studies()))} if results else {}


def fronts_section(fronts: Sequence[Front], results: Results, studies: Mapping[str, Study]) -> str:
    """Return the section's text, "" without fronts; the arguments are those of `spenders`."""
    if not fronts:
        return ""
    parts = [_INTRODUCTION, f"![Error against effort and command rate](images/{_FIGURE})"]
    for regime in _regimes_of(fronts):
        who = spenders(fronts, results, studies, regime)
        parts += [f"### At equal effort, {regime}", _setting(who), _leads(who)]
    return "\n\n".join(parts)


_INTRODUCTION = """## At equal effort

Error can be bought with commands, so here controllers are shown at several prices of theirs
(`python -m research front`): with the weights of the commands halved, as they ship, twice, four and
eight times as large (for `ekf`, which has none, all rates of the law by the fourth root of that), and with all gains
tuned anew for the error times the command's rate to the power of a price ([Controllers](controllers.md#at-a-price)).

An agent *leads at equal effort* where its mean tail is smaller than that of every point of the opponent's front that
spends at least as much of both effort and rate: nobody can say then that it bought its lead. But a point that spends
more need not be a better one: with half the weights a controller may chatter. So the points that spend less of either
are told beside; only where an agent leads those too is no point of the front level with it. The smallest lead of
each kind, in millimetres over the same episodes, has a 95 % interval over episodes and training seeds;
counted as led are points whose lead holds after Holm's correction over all pairs of the table.

In the figure a line joins the points of a sweep, hollow ones are tuned at a price, and what ships is outlined. An
agent that ships was trained for longer than the other points of its front: those show what a price does, not the least
error that can be had at it."""


def _setting(who: Spenders) -> str:
    return f"The first {who.episodes} episodes of each case. Effort and rate are relative to the expert's."


def _leads(who: Spenders) -> str:
    """Return the table of leads: a row for each agent and front."""
    agents = [agent for points in who.agents.values() for agent in points]
    pairs = [(agent, rival) for agent in agents for points in who.controllers.values() for rival in points]
    found = [differences([tail[0] for tail in rival.tails], agent.tails) for agent, rival in pairs]
    led = [lead.value > 0 and p < LEVEL for lead, p in zip(found, holm([lead.p for lead in found]), strict=True)]
    rows = []
    for agent in agents:
        for name in who.controllers:
            own = [i for i, (a, rival) in enumerate(pairs) if a is agent and rival.name == name]
            more = [i for i in own if spends(pairs[i][1], agent)]
            less = [i for i in own if i not in more]
            verdict = "-" if not more else "yes" if all(led[i] for i in more) else "no"
            kinds = (_kind([found[i] for i in kind], [led[i] for i in kind]) for kind in (more, less))
            rows.append([agent.text, f"`{name}`", verdict, *(cell for kind in kinds for cell in kind)])
    return table(_NAMES, rows)


_NAMES = (
    "agent",
    "against",
    "leads at equal effort",
    "of those that spend as much, led",
    "smallest lead [mm]",
    "95 %",
    "of the others, led",
    "smallest lead [mm]",
    "95 %",
)


def spends(rival: Spent, agent: Spent) -> bool:
    """Return whether a rival spends at least as much of both effort and rate as an agent."""
    return rival.effort >= agent.effort and rival.rate >= agent.rate


def _kind(leads: Sequence[LeadEstimate], led: Sequence[bool]) -> tuple[str, str, str]:
    if not leads:
        return "-", "-", "-"
    least = min(leads, key=lambda lead: lead.value)
    ends = [1e3 * end for end in least.ci95]
    return f"{sum(led)} of {len(led)}", fixed(1e3 * least.value, 2), fixed_ends(ends, 2)


def figure(fronts: Sequence[Front], results: Results, studies: Mapping[str, Study]) -> Figure:
    """Return error over effort and over rate, a row of panels for each regime; the arguments as for `spenders`."""
    with styled():
        return _drawn(fronts, results, studies, _regimes_of(fronts))


def _drawn(fronts: Sequence[Front], results: Results, studies: Mapping[str, Study], regimes: Sequence[str]) -> Figure:
    drawn, axes = panels(len(regimes), 2, (7.4, 0.8 + 2.8 * len(regimes)), sharey="row")
    for row, regime in zip(axes, regimes, strict=True):
        who = spenders(fronts, results, studies, regime)
        for ax, kind in zip(row, ("effort", "rate"), strict=True):
            everybody = {**who.controllers, **who.agents}
            for i, (name, points) in enumerate(everybody.items()):
                _draw(ax, kind, name.removesuffix(f"-{regime}"), points, i)
            ax.set_xscale("log")
            ax.set_yscale("log")
            ax.set_xlabel(f"{kind}, over the expert's")
            ax.set_title(regime)
            for axis in (ax.xaxis, ax.yaxis):
                axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
                axis.set_major_formatter("{x:g}")
                axis.set_minor_formatter("")
        row[0].set_ylabel("mean tail error [mm]")
    handles, labels = axes[0][1].get_legend_handles_labels()
    drawn.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=8)
    return drawn


def _draw(ax: Axes, kind: str, name: str, points: Sequence[Spent], i: int) -> None:
    """Draw a front: a line through what was swept or trained, hollow what has a price, outlined what ships."""
    colour, marker = COLOURS[i % len(COLOURS)], MARKERS[i % len(MARKERS)]
    line = [p for p in points if not p.label.startswith("price")]
    for own, look in (
        (line, {"color": colour, "marker": marker, "markersize": 5, "label": name}),
        ([p for p in points if p not in line], {"color": colour, "marker": marker, "markersize": 4, "mfc": "none"}),
        ([p for p in points if p.shipped], {"color": colour, "marker": marker, "markersize": 8, "mec": "black"}),
    ):
        style = "-" if own is line and len(line) > 1 else ""
        ax.plot([getattr(p, kind) for p in own], [1e3 * p.error for p in own], linestyle=style, **look)  # type: ignore[arg-type]

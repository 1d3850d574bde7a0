"""What a residual is for, docs/results/residual.md: the tables of what its study has measured."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from auv_gym.physics.namespaces import Array
from auv_gym.scenarios.presets import CASES, REGIMES
from baselines.evaluation.metrics import share_interval
from baselines.evaluation.score import EXPERT, LARGEST_TAIL, Score, fixed, fixed_ends, seeds_score
from research.pages import table
from research.results.residual_file import CURVE_COLUMNS, RESIDUAL_KIND, SCRATCH, SHIPPED_KIND, STUCK, ResidualGroup
from research.robustness.failures import SATURATED
from research.robustness.situations import AS_TRAINED, FASTER, SITUATIONS, SLOWER, WORLDS

SHOWN = {RESIDUAL_KIND: 0.5, SCRATCH: 1.0}
"""Authorities of the first table and of the learning curves: the usual one, and all that a vehicle has."""
MILESTONES = (0.0, 0.1e6, 0.2e6, 0.4e6, 0.8e6, 1e6)
"""Control steps at which the first minutes are looked at."""
FIGURE = "residual.png"  # file in images/ of the drawn part


def what_it_is_for(groups: Sequence[ResidualGroup]) -> str:
    """Return the section's text; "" where nothing is kept."""
    if not groups:
        return ""
    parts = [_INTRODUCTION]
    for regime in REGIMES:
        shown = _shown(groups, regime)
        if len(shown) > 1:
            parts += [_setting(shown, regime), _comparison(shown)]
    parts.append(f"![Authority, failures and first minutes](images/{FIGURE})")
    parts += [
        BOUNDED,
        bounded(groups),
        MINUTES,
        minutes(groups),
        _CAVEATS,
    ]
    return "\n\n".join(part for part in parts if part)


def mean_error(group: ResidualGroup, situation: str) -> Score:
    """Return the mean capped tail [m] of agents in a situation, its interval over training seeds and episodes.

    It is the score of 1 - error between yardsticks of 1 and 0, so that both have one bootstrap.
    """
    seeds = group.by_case(group.tails[situation])
    ones = [np.ones(own.shape[1]) for own in seeds]
    return seeds_score(ones, [1.0 - own for own in seeds], [np.zeros_like(one) for one in ones])


def lost_share(group: ResidualGroup, situation: str) -> Score:
    """Return the share of the episodes lost, its interval (Clopper and Pearson) over the episodes of all seeds."""
    lost = group.lost(situation)
    return Score(float(lost.mean()), share_interval(int(lost.sum()), lost.size))


def of(groups: Sequence[ResidualGroup], regime: str, kind: str) -> list[ResidualGroup]:
    """Return the groups of a kind in a regime, those of small authority first, then those of small error."""
    own = [group for group in groups if (group.regime, group.kind) == (regime, kind)]
    return sorted(own, key=lambda group: (group.authority or 0.0, next(iter(group.tails.values())).mean()))


def law(groups: Sequence[ResidualGroup], regime: str) -> ResidualGroup | None:
    """Return what the expert alone does in a regime."""
    return next((group for group in of(groups, regime, SHIPPED_KIND) if group.name == EXPERT), None)


def _shown(groups: Sequence[ResidualGroup], regime: str) -> list[ResidualGroup]:
    """Return the groups of the first table: the law, then the kinds with the authority that is shown."""
    first = law(groups, regime)
    rest = [g for kind, authority in SHOWN.items() for g in of(groups, regime, kind) if g.authority == authority]
    return [*([first] if first else []), *rest]


def _title(group: ResidualGroup) -> str:
    return "the law alone" if group.kind == SHIPPED_KIND else f"{group.kind}, authority {group.authority:g}"


def _setting(shown: Sequence[ResidualGroup], regime: str) -> str:
    counts = "; ".join(f"{_title(g)}: {_counts(*g.tails[AS_TRAINED].shape)}" for g in shown)
    return (
        f"### {regime}\n\n{counts}. *faster* is {_speeds(FASTER[regime])}, *slower* {_speeds(SLOWER[regime])}. An "
        f"episode is lost from a tail of {LARGEST_TAIL[regime]:g} m on."
    )


def _counts(seeds: int, episodes: int) -> str:
    return f"{seeds} training seeds, {episodes} episodes each" if seeds > 1 else f"{episodes} episodes"


def _speeds(interval: tuple[float, float]) -> str:
    return f"{interval[0]:g} to {interval[1]:g} m/s"


def _comparison(shown: Sequence[ResidualGroup]) -> str:
    """Return error and lost episodes of a few groups, a row for each situation."""
    heads = [f"{_title(g)}: {what}" for g in shown for what in ("error [cm]", "lost", "by seed")]
    heads = [head for head in heads if head != "the law alone: by seed"]
    rows = [[situation, *(cell for g in shown for cell in _cells(g, situation))] for situation in SITUATIONS]
    return table(("situation", *heads), rows)


def _cells(group: ResidualGroup, situation: str) -> list[str]:
    """Return error, lost episodes and, of several seeds, the least and most of one seed."""
    several = len(group.tails[AS_TRAINED]) > 1
    if situation not in group.tails:
        return ["-"] * (2 + several)
    seeds = 100 * group.lost(situation).mean(axis=1)
    by_seed = [f"{fixed(seeds.min(), 0)} ... {fixed(seeds.max(), 0)} %"] if several else []
    return [_error_text(group, situation), share_text(lost_share(group, situation)), *by_seed]


def _error_text(group: ResidualGroup, situation: str) -> str:
    error = mean_error(group, situation)
    return f"{fixed(100 * error.mean, 1)} ({fixed_ends([100 * end for end in error.ci95], 1)})"


def share_text(share: Score) -> str:
    """Return a share with its interval in per cent."""
    return f"{fixed(100 * share.mean, 1)} % ({fixed_ends([100 * end for end in share.ci95], 1)})"


def bounded(groups: Sequence[ResidualGroup]) -> str:
    """Return how many episodes are lost with a correction that is stuck at its limit, by authority and regime."""
    own = {(g.regime, g.authority or 0.0): g for regime in REGIMES for g in of(groups, regime, STUCK)}
    rows = [
        [
            f"{authority:g}",
            *(
                share_text(lost_share(own[regime, authority], limit)) if (regime, authority) in own else "-"
                for regime in REGIMES
                for limit in SATURATED
            ),
        ]
        for authority in sorted({authority for _, authority in own})
    ]
    return table(("authority", *(f"{r}: {limit}" for r in REGIMES for limit in SATURATED)), rows) if rows else ""


def minutes(groups: Sequence[ResidualGroup]) -> str:
    """Return the errors after so many control steps of training, mean and range over seeds."""
    followed = [g for g in _shown(groups, "cruise") if g.curves]
    rows = []
    for steps in MILESTONES:
        found = [at(group, steps) for group in followed]
        cells = [cell for error, lost in found for cell in (_range(100 * error, 1), _range(100 * lost, 1, " %"))]
        rows.append([f"{steps / 1e6:g} M", *cells])
    heads = [f"{_title(group)}: {what}" for group in followed for what in ("error [cm]", "lost")]
    return table(("control steps", *heads), rows) if followed else ""


def at(group: ResidualGroup, steps: float) -> tuple[Array, Array]:
    """Return mean errors [m] and shares lost of each seed at the validation nearest to so many steps, shape (S,)."""
    nearest = [curve[np.abs(curve[:, 0] - steps).argmin()] for curve in group.curves]
    error, lost = (np.array([row[CURVE_COLUMNS.index(name)] for row in nearest]) for name in ("error_m", "lost"))
    return error, lost


def _range(values: Array, digits: int, unit: str = "") -> str:
    return f"{fixed(float(values.mean()), digits)}{unit} ({fixed_ends([values.min(), values.max()], digits)})"


_INTRODUCTION = f"""## What a residual is for

Two ways to use a network: it corrects an expert, here the published law (*residual*), or commands alone (*scratch*).
Trained long enough they end level ([What learning is worth](results/learning.md#what-the-expert-is-for)), and after a
million control steps
seeds from scratch lie on both sides of those with an expert: a residual buys no better score. What it buys shows when
something goes wrong, and how much of that is left is a matter of its authority, the largest correction as a share of
the vehicle's limits. `python -m research residual` trains both kinds, alike but for expert and authority, for
a million steps, an eighth of those of `apg-cruise`, and runs them through fresh episodes of the {len(CASES)} cases.
From a third of each episode on the network is *dead* (its output is zero), *held* (at its last output), *stuck* (both
outputs at +1 or at -1), or its weights are *shuffled*; the law below it goes on. Or the network works, and speed or
thrusters are such as it was never trained on: *slew* is the time in which a thruster goes from zero to full force, at
once in training. *error* is the mean tail, capped, with a 95 % interval over seeds and episodes; *lost* the share of
all seeds' episodes, its 95 % interval as if they were independent (Clopper and Pearson), so *by seed* says how far the
best and the worst seed are apart."""
BOUNDED = """### What an authority bounds

What no training changes: the law, and from a third of each episode on a correction that is stuck at its limit. Lost
episodes, by authority. One that is to bound what a broken network does must be small: at cruise half of the limits is
too much already, and with all of them hardly an episode is left in either regime."""
MINUTES = """### The first minutes

What the agents do on validation episodes after so many control steps: mean over seeds, behind it the least and the
most of a seed. Zero steps of a residual are the law; from scratch a hundred thousand steps still lose everything, and
after four hundred thousand the two are level."""
_OTHER_WORLDS = [name for name in WORLDS if name != AS_TRAINED]
_CAVEATS = f"""### What this does not show

Whatever notices that a network is dead can switch to the law, and save an agent
from scratch as well; a residual needs nobody to notice. Held, stuck and shuffled outputs are four failures of many, and
none of an expert, a sensor or a thruster. Agents of a million steps are not at their best; the failures of longer
trained ones are under *What ships*. {", ".join(f"*{name}*" for name in _OTHER_WORLDS)} are of the same eight
cases, and lost episodes there are few where agents were trained to the end."""

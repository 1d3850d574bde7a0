"""How soon a policy is used to a vehicle that changes in mid-run, in lengths travelled.

Each episode runs three times, with the same path, sea and noise: the vehicle never changed, changed at an instant, and
changed from the start. Errors are means over a window of the way, and are compared window by window and episode by
episode. A policy is *back* where, from there on to the end, its error is at most 20 % above that of the same policy
there with a vehicle that had been changed all along. That alone could be had by being bad all along; so the absolute
errors are kept too, which `report` holds against the level of the best of the policies. What never comes back is said
to have not.

Lengths are L = sqrt(m33/m11) of the known vehicle, a radius of gyration; a uniform rod has sqrt(12) of them.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np

from auv_gym.envs.lanes import plan_of, reference_tables
from auv_gym.physics.namespaces import Array
from auv_gym.scenarios.episode import Episode
from auv_gym.task.policy import preview_of
from baselines.control.backstepping import StabilityWarning
from baselines.evaluation.metrics import resamplings
from baselines.evaluation.rollout import beginning, play
from baselines.evaluation.score import LARGEST_TAIL
from research.sensitivity.changes import BEFORE, CHANGES, LENGTHS, ChangeTrial
from research.sensitivity.episodes import acting

_WINDOW = 2
"""Lengths L that an error is a mean over; windows begin a length apart."""
WITHIN = (0.2, 0.5)
"""Shares by which an error may be above what it is compared with and count as back."""
AS_GOOD = 1 + WITHIN[0]
"""Factor of what it is compared with up to which an error is as good."""
ROD = math.sqrt(12)
"""Lengths L of a uniform rod, whose radius of gyration is L."""
ADAPTATION_EPISODES = 40
"""Episodes of each sea."""
_SMALLEST = 1e-4
"""Error [m] that stands for any that is smaller, where errors are compared by their ratio."""
ENDS = (0.025, 0.975)
"""Quantiles of an interval of 95 %."""


def adaptation_of(name: str, regime: str, sea: str, episodes: int | None = None) -> dict[str, Any]:
    """Return how a policy takes each change, as plain numbers.

    Args:
        name: of the policy.
        regime: "slow" or "cruise".
        sea: one of `changes.SEAS`.
        episodes: how many. None: `ADAPTATION_EPISODES`.

    Raises:
        ValueError: there is no such policy.
        PolicyError: its actions are not finite.
    """
    trial = ChangeTrial.of(regime, sea, episodes or ADAPTATION_EPISODES)
    errors, lost = followed(name, trial, LARGEST_TAIL[regime])
    found: dict[str, Any] = {"episodes": len(trial.never), "length_m": trial.scenario.vehicle.length, "changes": {}}
    for change in CHANGES:
        course = course_of(errors[change], errors[always(change)], errors["never"])
        counts = {"lost": int(lost[change].sum()), "lost_always": int(lost[always(change)].sum())}
        found["changes"][change] = course | counts
    return found


def always(change: str) -> str:
    """Return the name of the run whose vehicle has been changed all along."""
    return f"always {change}"


def followed(name: str, trial: ChangeTrial, cap: float) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return the errors [m] of a policy behind the change, by run, windows first, and which episodes were lost.

    Args:
        name: of the policy.
        trial: what it runs in.
        cap: error [m] that stands for any that is larger, and for those of lost episodes.
    """
    later = {change: trial.changed(change) for change in CHANGES}
    runs: dict[str, tuple[Sequence[Episode], Sequence[Episode]]] = {"never": (trial.never, trial.never)}
    for change, episodes in later.items():
        runs |= {change: (trial.never, episodes), always(change): (episodes, episodes)}
    first, then = ([episode for run in runs.values() for episode in run[i]] for i in (0, 1))
    policy, steps = acting(name, trial.scenario.vehicle), trial.scenario.steps
    env, seen = beginning([(trial.scenario, first)], preview_of(policy))
    errors, lost = np.zeros((steps, len(first))), np.zeros(len(first), dtype=bool)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", StabilityWarning)
        for k, moment in enumerate(play(policy, (env, seen), steps)):
            lost |= moment.lost
            errors[k] = np.where(moment.running & ~lost, np.minimum(moment.error, cap), cap)
            if k + 1 == BEFORE:
                env.change(then)
    places, n = lengths_of(trial), len(trial.never)
    own = {run: slice(n * i, n * (i + 1)) for i, run in enumerate(runs)}
    return {run: windows(errors[:, mine], places) for run, mine in own.items()}, {run: lost[own[run]] for run in runs}


def lengths_of(trial: ChangeTrial) -> Array:
    """Return how many whole lengths the references have gone since the change, behind each step, shape (steps, n)."""
    tables = np.stack(reference_tables(trial.never, *plan_of(trial.scenario)), axis=-1)
    way = np.cumsum(np.hypot(*np.diff(tables[:, :2], axis=0).transpose(1, 0, 2)), axis=0)
    return np.asarray(np.floor((way - way[BEFORE - 1]) / trial.scenario.vehicle.length))


def windows(errors: Array, places: Array) -> Array:
    """Return mean errors over `_WINDOW` lengths each, shape (`LENGTHS` - `_WINDOW` + 1, n).

    Args:
        errors: of each step, shape (steps, n).
        places: length that each step is in, see `lengths_of`.
    """
    inside = [places == j for j in range(LENGTHS)]
    means = np.array([np.where(here, errors, 0.0).sum(axis=0) / np.maximum(here.sum(axis=0), 1) for here in inside])
    return np.array([means[j : j + _WINDOW].mean(axis=0) for j in range(LENGTHS - _WINDOW + 1)])


def course_of(now: Array, all_along: Array, never: Array) -> dict[str, Any]:
    """Return how errors come back to those of a vehicle that has been changed all along.

    Means over episodes are geometric: a factor of two is as much in an episode with small errors as in a bad one.

    Args:
        now: mean errors [m] by window and episode, of the vehicle that changes.
        all_along: of the vehicle that has been changed from the start.
        never: of the one that stays as it is.
    """
    (counts,) = resamplings((now.shape[1],))
    shares = counts / counts.sum(axis=1, keepdims=True)
    mine, theirs = (np.log(np.maximum(errors, _SMALLEST)) for errors in (now, all_along))
    factor, absolute = np.exp(shares @ (mine - theirs).T), np.exp(shares @ mine.T)
    level = np.exp(shares @ theirs.mean(axis=0))
    return {
        "never_m": _rounded(np.exp(np.log(np.maximum(never, _SMALLEST)).mean()), 5),
        "level_m": _rounded((level[0], *np.quantile(level[1:], ENDS)), 5),
        "back": [_places(factor, 1 + share) for share in WITHIN],
        "factor": [_rounded(row, 3) for row in (factor[0], *np.quantile(factor[1:], ENDS, axis=0))],
        "error_m": [_rounded(row, 5) for row in (absolute[0], *np.quantile(absolute[1:], ENDS, axis=0))],
    }


def _places(factor: Array, largest: float) -> list[float | None]:
    """Return where a factor is back, of the episodes and the ends of its interval; None for nowhere."""
    places = np.array([back(row, largest) for row in factor])
    ends = np.quantile(places[1:], ENDS, method="inverted_cdf")
    return [float(x) if math.isfinite(x) else None for x in (places[0], *ends)]


def back(factor: Array, largest: float) -> float:
    """Return the window from which on a factor stays below the largest, in lengths; infinite where it never does."""
    outside = np.flatnonzero(~(factor <= largest))
    if not len(outside):
        return 0.0
    last = int(outside[-1])
    return math.inf if last + 1 == len(factor) else float(last + 1)


def _rounded(value: Any, digits: int) -> Any:
    plain: Any = np.round(value, digits).tolist()
    return plain

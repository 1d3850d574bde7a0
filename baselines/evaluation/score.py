"""The score: 0 is the expert, 1 the best that is possible; paired episodes, errors pooled over cases.

    score of p = (E_zero - E_p) / (E_zero - E_one),     E: mean over episodes of the tail RMSE

Whose errors E_zero and E_one are, the anchors say: a suite has its own.

Errors are pooled before the division: a ratio of every case would be dominated by those where little can be gained.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_gym.physics.namespaces import Array
from auv_gym.physics.units import Units
from auv_gym.scenarios.presets import SPEED_RANGES
from auv_gym.scenarios.scenario import Scenario
from baselines.evaluation.metrics import RESAMPLES, Ended, Measures, resamplings, seed_shares

EXPERT = "backstepping"  # the policy that scores 0
ORACLE = "oracle"  # the policy that knows plant and sea, and regulates; it scores 1 in the oldest suites
OPTIMUM_POLICY = "clairvoyant"  # the full-information optimum; it scores 1 in the others
FORESIGHTED = (ORACLE, OPTIMUM_POLICY)
"""Policies that know what no competitor may know."""
RIVAL = "nmpc"  # the strongest policy that does not learn, where sensors and actuators are as told
ADVERSE_RIVAL = "nmpc-adverse"  # the strongest one where they are not
DEEP = "deep"  # where positions are reckoned: scenarios called REGIME-deep or REGIME-deep-CASE
ERROR_CAPS: Mapping[str, float] = {"slow": 0.6, "cruise": 2.0, DEEP: 5.0}
"""Tail RMSE [m] from which an episode counts as lost, by regime; the capped score counts no more than that for it.

That is for the paper's vehicle; for another one it is as many times as long as the vehicle is, see `cap_of`."""
VEHICLE_MARK = "@"  # stands between preset and vehicle in the name of a scenario that was made for another vehicle


class Anchors(NamedTuple):
    """The policies that a score lies between."""

    zero: str  # scores 0
    one: str  # scores 1

    @classmethod
    def among(cls, policies: Collection[str]) -> Anchors:
        """Return the anchors where no suite says them: 1 is the bound if it ran, else the oracle."""
        return BY_BOUND if OPTIMUM_POLICY in policies or ORACLE not in policies else BY_ORACLE


BY_BOUND = Anchors(EXPERT, OPTIMUM_POLICY)
"""Anchors of benchmark-v2, and of scenarios of one's own where the bound runs."""
BY_ORACLE = Anchors(EXPERT, ORACLE)
"""Anchors of the suites that were frozen before there was a bound."""
SCALE = "0 the expert, 1 the bound, in older suites the oracle"  # what the ends of a score are, in words


@dataclass(frozen=True)
class Score:
    """A score with its 95 % interval; nan where the policy that scores 0 is no worse than the one that scores 1."""

    mean: float
    ci95: tuple[float, float]


def score_text(value: Score | None, digits: int = 3) -> str:
    """Return a score as text, - if there is none."""
    return fixed(value.mean, digits) if value and math.isfinite(value.mean) else "-"


def interval_text(value: Score | None, digits: int = 3) -> str:
    """Return the interval of a score as text, - if there is none."""
    return fixed_ends(value.ci95, digits) if value and math.isfinite(value.ci95[0]) else "-"


def fixed(value: float, digits: int = 3) -> str:
    """Return a number with that many decimal places, none of a large one; there is no minus before a zero."""
    digits = digits if abs(value) < 100 else 0
    return f"{round(value, digits) + 0.0:.{digits}f}"


def fixed_ends(interval: Sequence[float], digits: int = 3) -> str:
    """Return an interval with that many decimal places."""
    return " ... ".join(fixed(end, digits) for end in interval)


def paired(*measures: Measures) -> list[Measures]:
    """Return the measures of the episodes that all policies have run: the first ones, where one has run fewer."""
    shortest = min(map(len, measures))
    return [m if len(m) == shortest else m[:shortest] for m in measures]


def speed_range_of(scenario: str) -> str | None:
    """Return the regime that a scenario's name begins with, if any."""
    return next((speed_range for speed_range in SPEED_RANGES if scenario.startswith(f"{speed_range}-")), None)


def cap_key(scenario: str) -> str | None:
    """Return what of `ERROR_CAPS` a scenario belongs to: its regime, or `DEEP` in both."""
    speed_range = speed_range_of(scenario)
    return DEEP if speed_range and f"{scenario}-".startswith(f"{speed_range}-{DEEP}-") else speed_range


def vehicle_of(scenario: str) -> str:
    """Return the name of the vehicle that a scenario was made for, "" for those of the paper's."""
    return scenario.partition(VEHICLE_MARK)[2]


def unit_of(scenario: Scenario) -> float:
    """Return how many metres of a scenario's vehicle are one of the paper's: its length over that vehicle's."""
    return Units.of(scenario.vehicle).length


def in_paper_metres(m: Measures, scenario: Scenario) -> Measures:
    """Return what was measured in a scenario with its distances in metres of the paper's vehicle, see `unit_of`.

    So measured, the errors of a ship and of a torpedo can be added up, and have the same cap.
    """
    unit = unit_of(scenario)
    return m if unit == 1 else replace(m, rmse=m.rmse / unit, steady_rmse=m.steady_rmse / unit)


def cap_of(scenario: Scenario) -> float:
    """Return the tail RMSE [m] from which an episode of a scenario is lost, infinite where it belongs to no regime."""
    return unit_of(scenario) * error_cap(scenario.name)


def error_cap(scenario: str) -> float:
    """Return the same in metres of the paper's vehicle, by the scenario's name; see `in_paper_metres`."""
    key = cap_key(scenario)
    return ERROR_CAPS[key] if key else math.inf


def has_failed(ended: Measures | Ended, cap: float) -> NDArray[np.bool_]:
    """Return which episodes are lost, the one rule of it: those that ended so, and those whose tail reaches the cap.

    Args:
        ended: how they ended.
        cap: tail RMSE [m] from which they count as lost, see `cap_of`.
    """
    return ended.failed | ~(ended.steady_rmse < cap)


def count_failures(ended: Measures | Ended, cap: float) -> int:
    """Return how many episodes are lost, see `has_failed`."""
    return int(has_failed(ended, cap).sum())


def capped(ended: Measures | Ended, cap: float) -> Array:
    """Return the tail RMSE [m] with the cap in place of those of episodes that are lost; without a cap as it is."""
    return np.where(has_failed(ended, cap), cap, ended.steady_rmse) if math.isfinite(cap) else ended.steady_rmse


def relative_error(rival: Sequence[Array], own: Sequence[Array]) -> Score:
    """Return own errors over a rival's: the geometric mean over cells of the ratio of mean tail errors in a cell.

    It has no unit, every cell counts alike, and what is in the denominator does not matter to the order. The interval
    is that of a bootstrap over episodes within each cell, the same ones for both.

    Args:
        rival: tail errors of paired episodes, shape (M,) for each cell, in any unit that a cell has for both.
        own: the same, or of agents that differ in the training seed alone, shape (S, M): the interval is over both.
    """
    seeds = [np.atleast_2d(mine) for mine in own]
    logs, shares = np.zeros(RESAMPLES + 1), seed_shares(len(seeds[0]))
    with np.errstate(divide="ignore"):
        for weights, theirs, mine in zip(resamplings(tuple(map(len, rival))), rival, seeds, strict=True):
            logs += np.log(((weights @ mine.T) * shares).sum(axis=1)) - np.log(weights @ theirs)
    values = np.exp(logs / len(rival))
    low, high = np.quantile(values[1:], (0.025, 0.975)).tolist()
    return Score(float(values[0]), (low, high))


def score(zero: Sequence[Array], policy: Sequence[Array], one: Sequence[Array]) -> Score:
    """Return the score from tail errors [m] of paired episodes, an array for each case.

    The interval is that of a bootstrap over episodes, the same ones for all three policies, within each case.
    """
    sums = np.zeros((RESAMPLES + 1, 3))
    for weights, errors in zip(resamplings(tuple(map(len, zero))), zip(zero, policy, one, strict=True), strict=True):
        sums += weights @ np.stack(errors, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        values = (sums[:, 0] - sums[:, 1]) / (sums[:, 0] - sums[:, 2])
    if not sums[0, 0] > sums[0, 2]:
        return Score(math.nan, (math.nan, math.nan))
    if sum(map(len, zero)) < 2:
        return Score(float(values[0]), (math.nan, math.nan))
    low, high = np.quantile(values[1:], (0.025, 0.975)).tolist()
    return Score(float(values[0]), (low, high))


def seeds_score(zero: Sequence[Array], seeds: Sequence[Array], one: Sequence[Array]) -> Score:
    """Return the score of agents that differ in the training seed alone; the interval is over seeds and episodes.

    Args:
        zero: tail errors [m] of paired episodes, shape (M,) for each case.
        seeds: those of the agents, shape (S, M) for each case.
        one: as `zero`.
    """
    return lead(zero, zero, seeds, one)


def lead(zero: Sequence[Array], rival: Sequence[Array], seeds: Sequence[Array], one: Sequence[Array]) -> Score:
    """Return by how much agents' score is above a rival's, with its interval over training seeds and episodes.

    Args:
        zero: see `seeds_score`.
        rival: as `zero`.
        seeds: see `seeds_score`.
        one: as `zero`.
    """
    count, weights = len(seeds[0]), resamplings(tuple(map(len, zero)))
    above, span = np.zeros((RESAMPLES + 1, count)), np.zeros(RESAMPLES + 1)
    for w, e, r, p, o in zip(weights, zero, rival, seeds, one, strict=True):
        above += w @ (r - p).T
        span += w @ (e - o)
    shares = seed_shares(count)
    with np.errstate(divide="ignore", invalid="ignore"):
        values = (above * shares).sum(axis=1) / span
    low, high = np.quantile(values[1:], (0.025, 0.975)).tolist()
    return Score(float(values[0]), (low, high))

"""The navigation error in a suite with rare position fixes, and the additional error of each policy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from auv_gym.physics.namespaces import Array
from baselines.evaluation.metrics import bootstrap_interval
from baselines.evaluation.score import FULL_INFORMATION, speed_range_of
from research.pages import table
from research.results.collection import Results
from research.suites.deep import navigation_rmses

ADDITIONAL = "additional error [mm]"
_TEXT = """## Navigation

Between position fixes the position is estimated by dead reckoning. Most of an error is the error of this navigation.
The table has the mean steady-state error [mm] of a controller that keeps the estimated position exactly on the
reference. The *additional error* above is what a policy adds to it in the same episodes, with a 95 % bootstrap
interval. It can be negative: a policy can average the jumps of the estimate, or learn the errors of the sensors from
them. `clairvoyant` and `oracle` use the true position, so the scores of all other policies are far below 1."""


def navigation_alone(results: Results, speed_range: str) -> dict[str, Array]:
    """Return the navigation errors [m] of each episode, by case; {} without dead reckoning."""
    own = [cell for cell in results.suite.cells if speed_range_of(cell.scenario.name) == speed_range]
    return {cell.scenario.name: navigation_rmses(cell) for cell in own if cell.scenario.sensors.reckoning}


def additional_errors(results: Results, navigation: Mapping[str, Array]) -> dict[str, str]:
    """Return the error [mm] that each policy adds to the navigation error, with its interval, as text."""
    found = {}
    for policy in [p for p in results.policies if p not in FULL_INFORMATION]:
        own = [results.cases[case][policy] for case in navigation if policy in results.cases[case]]
        if navigation and len(own) == len(navigation):
            pairs = zip((m.steady_rmse for m in own), navigation.values(), strict=True)
            more = np.concatenate([steady_rmse - errors[: len(steady_rmse)] for steady_rmse, errors in pairs])
            low, high = bootstrap_interval(more)
            found[policy] = f"{_mm(more.mean())} ({_mm(low)} ... {_mm(high)})"
    return found


def navigation_part(errors: Mapping[str, Mapping[str, Array]]) -> str:
    """Return the section of a page about the navigation error, by speed range and case; "" without errors.

    Args:
        errors: results of `navigation_alone`, by speed range.
    """
    if not any(errors.values()):
        return ""
    cases = [case.partition("-")[2] for case in next(iter(errors.values()))]
    rows = [[speed_range, *_means(own)] for speed_range, own in errors.items()]
    return f"{_TEXT}\n\n{table(['speed range', *cases, 'all'], rows)}"


def _means(errors: Mapping[str, Array]) -> Sequence[str]:
    return [*(_mm(own.mean()) for own in errors.values()), _mm(np.concatenate(list(errors.values())).mean())]


def _mm(value: float) -> str:
    return f"{round(1e3 * value) + 0:d}"

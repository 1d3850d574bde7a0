"""The columns of a result: name, unit, definition and format, for all tables, files and pages.

A new `Column` in `COLUMNS` is a new column everywhere.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from baselines.evaluation.metrics import WORST, Summary, failure_bound
from baselines.evaluation.report.numbers import Entry
from baselines.evaluation.score import ERROR_CAPS, OPTIMUM_POLICY, ORACLE, RIVAL, Score, fixed, fixed_ends

NONE = "-"
"""Text for a missing value."""
_CAPS = ", ".join(f"{cap:g} m ({speed_range})" for speed_range, cap in ERROR_CAPS.items())


@dataclass(frozen=True)
class Column:
    """One quantity of a policy in a scenario, or in all scenarios of a speed range."""

    key: str  # in results.json, with a dot between a table and its entry; in results.csv with `_` instead
    heading: str  # heading in tables with the unit; "" for columns that tables do not have
    definition: str
    value: Callable[[Entry, Summary], Any]  # plain JSON; None for a missing value
    form: Callable[[Any], str] = str  # format of the value in tables
    keep: int = 0  # priority: a narrow terminal drops the columns of the lowest numbers
    show: Callable[[Entry, Summary], str] | None = None  # text in tables, if it has more than the value

    def of(self, entry: Entry) -> Any:
        """Return the value of an entry, None if its policy failed."""
        return None if entry.summary is None else self.value(entry, entry.summary)

    def text(self, entry: Entry) -> str:
        """Return the value of an entry as the text of a table cell."""
        if self.show is not None and entry.summary is not None:
            return self.show(entry, entry.summary)
        value = self.of(entry)
        first = value[0] if isinstance(value, list) else value
        return NONE if first is None or not math.isfinite(first) else self.form(value)

    @property
    def name(self) -> str:
        """The name of the column in results.csv; the mean of a table has the name of the table."""
        return self.key.removesuffix(".mean").replace(".", "_")


def digits(count: int) -> Callable[[float], str]:
    """Return the format of numbers with `count` significant digits."""
    return lambda value: f"{value:.{count}g}"


def ends(value: Sequence[float]) -> str:
    """Return an interval as text."""
    return "{:.3g} ... {:.3g}".format(*value)


def ratio_text(value: float) -> str:
    """Return a ratio as text."""
    return f"{value:.2f}"


def failures_text(failed: int, episodes: int) -> str:
    """Return the number of failed episodes, and the 95 % upper confidence bound of the failure rate, as text."""
    most = 100 * failure_bound(failed, episodes)
    return f"{failed} of {episodes} (<= {most:.2g} %)" if most < 99.5 else f"{failed} of {episodes}"


def difference_text(value: Score | None) -> str:
    """Return a difference with its interval as text."""
    if value is None:
        return NONE
    low, high = value.ci95
    interval = f" ({low:+.2g} ... {high:+.2g})" if math.isfinite(low) else ""
    return f"{value.mean:+.3g}{interval}"


COLUMNS = (
    Column("episodes", "episodes", "episodes that were run", lambda _, s: s.episodes),
    Column("rmse_m", "", "root mean square of the distance to the reference [m], mean over episodes",
           lambda _, s: s.rmse_m),
    Column("steady_rmse_m.mean", "steady [m]",
           "steady-state error: root mean square of the distance to the reference after the first third of an episode, "
           "mean over episodes",
           lambda _, s: s.steady_rmse_m.mean, digits(3), 9),
    Column("steady_rmse_m.ci95", "95 % interval", "95 % bootstrap interval of that mean over episodes",
           lambda _, s: list(s.steady_rmse_m.ci95), ends, 6),
    Column("steady_rmse_m.median", "median [m]", "median of the steady-state error over episodes",
           lambda _, s: s.steady_rmse_m.median, digits(3), 5),
    Column("steady_rmse_m.p95", "p95 [m]", "95th percentile of the steady-state error over episodes",
           lambda _, s: s.steady_rmse_m.p95, digits(3), 4),
    Column("steady_rmse_m.cvar95", "worst 5 % [m]",
           f"mean of the worst {100 * WORST:g} % of the steady-state errors (conditional value at risk)",
           lambda _, s: s.steady_rmse_m.cvar95, digits(3), 3),
    Column("to_best_m.mean", "to best [m]",
           "mean steady-state error minus the smallest one of a policy in the same episodes, without "
           f"{ORACLE} and {OPTIMUM_POLICY}; with its 95 % bootstrap interval",
           lambda e, _: e.to_best and e.to_best.mean, digits(3), 4, lambda e, _: difference_text(e.to_best)),
    Column("to_best_m.ci95", "", "95 % bootstrap interval of that difference over paired episodes",
           lambda e, _: e.to_best and list(e.to_best.ci95)),
    Column("score.mean", "score",
           f"(E_0 - E_policy) / (E_0 - E_1): 0 is the paper's law, 1 the full-information optimum, {OPTIMUM_POLICY}",
           lambda e, _: e.score and e.score.mean, fixed, 7),
    Column("score.ci95", "95 % of score", "95 % bootstrap interval of the score over paired episodes",
           lambda e, _: e.score and list(e.score.ci95), fixed_ends, 5),
    Column("capped.mean", "capped", f"the score with errors counted up to the error cap: {_CAPS}",
           lambda e, _: e.capped and e.capped.mean, fixed, 2),
    Column("capped.ci95", "", "95 % interval of the capped score", lambda e, _: e.capped and list(e.capped.ci95)),
    Column("error_ratio", f"error / {RIVAL}",
           f"mean steady-state error, up to the error cap, over that of {RIVAL} in the same episodes",
           lambda e, _: e.error_ratio, ratio_text, 1),
    Column("failed", "failures",
           "failed episodes: they ended beyond the lost_distance of the scenario, or their error reaches the error "
           f"cap, {_CAPS}; in parentheses the 95 % upper confidence bound of the failure rate",
           lambda e, _: e.failed, keep=8, show=lambda e, s: failures_text(e.failed, s.episodes)),
    Column("failure_rate", "", "failure rate", lambda e, s: e.failed / s.episodes),
    Column("failure_rate_bound", "", "95 % upper confidence bound of the failure rate (one-sided, Clopper and Pearson)",
           lambda e, s: failure_bound(e.failed, s.episodes)),
    Column("failed_within", "within limits",
           "failed episodes among those whose plan stays within the limits of the actuators in the mean current; "
           "empty where all plans do, and for frozen suites",
           lambda e, _: e.within and e.within[0], keep=7,
           show=lambda e, _: NONE if e.within is None else "{} of {}".format(*e.within)),
    Column("episodes_within", "", "number of these episodes", lambda e, _: e.within and e.within[1]),
    Column("settling_s", "settled [s]", "time of the last position error above the scenario's `error_scale`, mean",
           lambda _, s: s.settling_s, digits(3)),
    Column("effort_ratio", "effort", "mean square of the normalised command, relative to the expert's",
           lambda e, _: e.effort_ratio, ratio_text, 1),
    Column("smoothness_ratio", "command rate",
           "command rate: mean squared change of the command in a step, relative to the expert's",
           lambda e, _: e.smoothness_ratio, ratio_text),
    Column("saturation", "saturated", "share of the steps with an actuator commanded to its limit",
           lambda _, s: s.saturation, lambda share: f"{100 * share:.1f} %"),
    Column("return_mean", "", "mean sum of rewards", lambda _, s: s.return_mean),
    Column("decision_ms", "time [ms]",
           "wall time of one decision for one vehicle, with many vehicles simulated together",
           lambda e, _: 1e3 * e.decision_seconds, digits(2)),
)  # fmt: skip
"""The columns, in the order of the tables."""
_SHOWN = tuple(column for column in COLUMNS if column.heading)  # the columns of tables


def used(entries: Sequence[Entry]) -> list[Column]:
    """Return the columns of tables in which at least one entry has a value."""
    return [column for column in _SHOWN if any(column.text(entry) != NONE for entry in entries)]


def record(entry: Entry) -> dict[str, Any]:
    """Return the values of an entry by the keys of results.json; a missing value is None."""
    values: dict[str, Any] = {}
    for column in COLUMNS:
        table, _, name = column.key.partition(".")
        value = column.of(entry)
        if not name or value is None:
            values[table] = value
        else:
            values.setdefault(table, {})[name] = value
    return values


def line(entry: Entry) -> dict[str, Any]:
    """Return the values of an entry by the columns of results.csv; an interval has a column for each end."""
    values: dict[str, Any] = {}
    for column in COLUMNS:
        value = column.of(entry)
        if column.name.endswith("_ci95"):
            low, high = value or (None, None)
            values |= {f"{column.name}_low": low, f"{column.name}_high": high}
        else:
            values[column.name] = value
    return values


def ranked(entries: Sequence[Entry]) -> list[Entry]:
    """Return the entries of a scenario or speed range, best score first, or smallest error first without scores."""

    def rank(entry: Entry) -> tuple[bool, bool, float]:
        score = entry.score.mean if entry.score else math.nan
        steady_rmse = entry.summary.steady_rmse_m.mean if entry.summary else math.inf
        return entry.summary is None, not math.isfinite(score), -score if math.isfinite(score) else steady_rmse

    return sorted(entries, key=rank)

"""The summary of the results, docs/results.md: errors, failures, command rates and times of the main policies."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from auv_gym.physics.namespaces import Array
from auv_gym.scenarios.presets import CASES, PRESETS, SPEED_RANGES
from baselines.evaluation.metrics import bootstrap_interval
from baselines.evaluation.report.columns import failures_text
from baselines.evaluation.report.numbers import Entry
from baselines.evaluation.score import OPTIMUM_POLICY, RIVAL
from baselines.tools.figure_style import MARKERS, look, panels, styled, to_png
from research.results.collection import Results, results_of
from research.results.suite_page import error_figure

_SUITE = "benchmark-v2"
MAIN_AGENT = "helm"  # the agent that the page compares with `RIVAL`
_POLICIES = {
    "backstepping": "-",
    "los-pid": "tuning",
    "lqi": "tuning",
    "ekf": "tuning",
    "nmpc": "tuning, preview",
    "ppo-*": "training",
    "apg-*": "training",
    "helm": "training, preview",
}
"""The policies of the summary and their needs; * is replaced by the speed range."""
_BELOW = ("ekf", "helm", "lqi")  # policies whose names are below their points in the figure of command rates


def context(_: str = "") -> dict[str, Any]:
    """Return the values of the page's template."""
    results, rows = results_of(_SUITE), []
    for name, needs in _POLICIES.items():
        entries = [_entry(results, name, speed_range) for speed_range in SPEED_RANGES]
        episodes = sum(entry.summary.episodes for entry in entries if entry.summary is not None)
        rates = " / ".join(f"{entry.smoothness_ratio:.2f}" for entry in entries)
        times = " / ".join(f"{1e6 * entry.decision_seconds:.2g}" for entry in entries)
        failed = failures_text(sum(entry.failed for entry in entries), episodes)
        errors = (_error(_errors(results, name, speed_range)) for speed_range in SPEED_RANGES)
        rows.append([f"`{name}`", *errors, failed, rates, times, needs])
    means = {
        policy: {speed_range: float(_errors(results, policy, speed_range).mean()) for speed_range in SPEED_RANGES}
        for policy in (MAIN_AGENT, RIVAL, OPTIMUM_POLICY)
    }
    return {
        "rows": rows,
        "episodes": sum(len(cell.episodes) for cell in results.suite.cells),
        "speeds": {r: "{:g} to {:g}".format(*PRESETS[f"{r}-calm"].path.speed) for r in SPEED_RANGES},  # type: ignore[misc]
        "ratios": {r: means[MAIN_AGENT][r] / means[RIVAL][r] for r in SPEED_RANGES},
        "optimum": means[OPTIMUM_POLICY],
    }


def figures(_: str = "") -> dict[str, bytes]:
    """Return the figures as PNG, by name: errors with intervals, errors by disturbance, error against command rate."""
    results = results_of(_SUITE)
    with styled():
        return {
            "results-overview.png": to_png(error_figure(results, (*_POLICIES, OPTIMUM_POLICY))),
            "results-disturbances.png": to_png(_heat_map(results)),
            "results-command-rate.png": to_png(_command_rates(results)),
        }


def _entry(results: Results, policy: str, speed_range: str) -> Entry:
    wanted = policy.replace("*", speed_range), speed_range
    return next(entry for entry in results.pooled if (entry.policy, entry.place) == wanted)


def _errors(results: Results, policy: str, speed_range: str) -> Array:
    """Return the steady-state errors [mm] of all episodes of a speed range, shape (M,)."""
    return 1e3 * np.concatenate([*results.steady_rmses(policy.replace("*", speed_range), speed_range).values()])


def _error(errors: Array) -> str:
    """Return the mean error with its interval."""
    return "{:.3g} ({:.3g} to {:.3g})".format(errors.mean(), *bootstrap_interval(errors))


def _heat_map(results: Results) -> Figure:
    names = [f"{speed_range}-{case}" for speed_range in SPEED_RANGES for case in CASES]
    values = np.array([
        [1e3 * results.cases[name][policy.replace("*", name.partition("-")[0])].steady_rmse.mean() for name in names]
        for policy in _POLICIES
    ])  # fmt: skip
    figure, [[ax]] = panels(1, 1, (9.4, 3.6))
    image = ax.imshow(values, aspect="auto", cmap="viridis_r", norm=LogNorm(0.1, 1000))
    for (i, j), value in np.ndenumerate(values):
        text, colour = f"{value:.0f}" if value >= 10 else f"{value:.2g}", "white" if value > 20 else "black"
        ax.text(j, i, text, ha="center", va="center", fontsize=7, color=colour)
    ax.set_xticks(range(len(names)), names, rotation=40, ha="right", rotation_mode="anchor")
    ax.set_yticks(range(len(_POLICIES)), list(_POLICIES))
    ax.grid(visible=False)
    figure.colorbar(image, ax=ax, label="mean steady-state error [mm]")
    return figure


def _command_rates(results: Results) -> Figure:
    figure, [axes] = panels(1, 2, (8.2, 3.2), sharey=True)
    for ax, speed_range in zip(axes, SPEED_RANGES, strict=True):
        for policy in _POLICIES:
            rate = _entry(results, policy, speed_range).smoothness_ratio
            error, below = _errors(results, policy, speed_range).mean(), policy in _BELOW
            style = look(policy, [*_POLICIES])
            ax.plot(rate, error, color=style.colour, marker=MARKERS[style.marker], markersize=5)
            ax.annotate(
                policy, (rate, error), (0, -4 if below else 4), textcoords="offset points", fontsize=7,
                ha="center", va="top" if below else "bottom",
            )  # fmt: skip
        ax.set_xscale("log")
        ax.set_yscale("log")
        ax.margins(0.15)
        ax.set_xlabel(f"{speed_range}: command rate, relative to backstepping")
    axes[0].set_ylabel("mean steady-state error [mm]")
    return figure

"""The summary of the results, docs/results.md: errors, failures, command rates and times of the main policies."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.colors import LogNorm

from auv_gym.physics.namespaces import Array
from auv_gym.scenarios.presets import CASES, PRESETS, SPEED_RANGES
from auv_gym.scenarios.scenario import RandomPath
from baselines.evaluation.metrics import bootstrap_interval
from baselines.evaluation.report.columns import COLUMNS, failures_text
from baselines.evaluation.report.numbers import Entry
from baselines.evaluation.score import OPTIMUM_POLICY
from baselines.tools.figure_style import MARKERS, Look, look, panels, styled, to_png
from research.estimation_bound.command import recorded_bounds
from research.results.collection import Results, results_of

_SUITE = "benchmark-v2"
_POLICIES = {
    "backstepping": "-",
    "los-pid": "tuning",
    "lqi": "tuning",
    "ekf": "tuning",
    "nmpc": "tuning, preview",
    "ppo-{}": "training",
    "apg-{}": "training",
    "helm": "training, preview",
}
"""The policies of the summary and their needs; {} is replaced by the speed range."""
_BELOW = ("ekf", "helm", "lqi")  # policies whose names are below their points in the figure of command rates
FIGURES = "results-overview.png", "results-disturbances.png", "results-command-rate.png"


def context(_: str = "") -> dict[str, Any]:
    """Return the values of the page's template."""
    results = results_of(_SUITE)
    rows = []
    for name, needs in _POLICIES.items():
        slow, cruise = (_entry(results, name.format(speed_range), speed_range) for speed_range in SPEED_RANGES)
        episodes = sum(entry.summary.episodes for entry in (slow, cruise) if entry.summary is not None)
        rates = " / ".join(_text(entry, "smoothness_ratio") for entry in (slow, cruise))
        times = " / ".join(f"{1e6 * entry.decision_seconds:.2g}" for entry in (slow, cruise))
        failed = failures_text(slow.failed + cruise.failed, episodes)
        errors = (_error(_steady_rmses(results, name.format(speed_range), speed_range)) for speed_range in SPEED_RANGES)
        rows.append([f"`{name.format('*')}`", *errors, failed, rates, times, needs])
    return {
        "rows": rows,
        "episodes": sum(len(cell.episodes) for cell in results.suite.cells),
        "speeds": {
            speed_range: " to ".join(f"{speed:g}" for speed in _speeds(speed_range)) for speed_range in SPEED_RANGES
        },
        "ratios": {
            speed_range: _mean(results, "helm", speed_range) / _mean(results, "nmpc", speed_range)
            for speed_range in SPEED_RANGES
        },
        "optimum": {speed_range: 1e3 * _mean(results, OPTIMUM_POLICY, speed_range) for speed_range in SPEED_RANGES},
        "estimation": {speed_range: 1e3 * _estimation(results, speed_range) for speed_range in SPEED_RANGES},
    }


def figures(_: str = "") -> dict[str, bytes]:
    """Return the figures as PNG, by name: errors with intervals, errors by disturbance, error against command rate."""
    with styled():
        drawings = (draw(results_of(_SUITE)) for draw in (_errors, _heat_map, _command_rates))
        return dict(zip(FIGURES, map(to_png, drawings), strict=True))


def _entry(results: Results, policy: str, speed_range: str) -> Entry:
    return next(entry for entry in results.pooled if (entry.policy, entry.place) == (policy, speed_range))


def _text(entry: Entry, key: str) -> str:
    return next(column for column in COLUMNS if column.key == key).text(entry)


def _steady_rmses(results: Results, policy: str, speed_range: str) -> Array:
    """Return the steady-state errors [m] of all episodes of a speed range, shape (M,)."""
    return np.concatenate([m.steady_rmse for m in results.measures(policy, speed_range)])


def _mean(results: Results, policy: str, speed_range: str) -> float:
    return float(_steady_rmses(results, policy, speed_range).mean())


def _speeds(speed_range: str) -> tuple[float, float]:
    """Return the smallest and the largest speed [m/s] of a speed range."""
    path = PRESETS[f"{speed_range}-calm"].path
    assert isinstance(path, RandomPath)
    assert isinstance(path.speed, tuple)
    return path.speed


def _estimation(results: Results, speed_range: str) -> float:
    """Return the mean over cases of the estimation lower bound [m]; with exact measurements it is the optimum."""
    bounds, best = recorded_bounds(results.suite.source[1]), results.steady_rmses[OPTIMUM_POLICY]
    names = [f"{speed_range}-{case}" for case in CASES]
    return float(
        np.mean([max(bounds[name].steady_rmse_m, best[name]) if name in bounds else best[name] for name in names])
    )


def _error(steady_rmses: Array) -> str:
    """Return the mean error [mm] with its interval."""
    mean, low, high = (f"{1e3 * value:.3g}" for value in (steady_rmses.mean(), *bootstrap_interval(steady_rmses)))
    return f"{mean} ({low} to {high})"


def _look(policy: str) -> Look:
    """Return the look of a policy of the summary, the same for both speed ranges."""
    return look(policy.format("cruise"), [name.format("cruise") for name in _POLICIES])


def _errors(results: Results) -> Any:
    figure, [axes] = panels(1, 2, (8.2, 3.4), sharey=True)
    names = list(_POLICIES)
    for ax, speed_range in zip(axes, SPEED_RANGES, strict=True):
        for i, name in enumerate(names):
            steady_rmses = 1e3 * _steady_rmses(results, name.format(speed_range), speed_range)
            own = _look(name)
            ax.plot(bootstrap_interval(steady_rmses), [i, i], color=own.colour, linewidth=2)
            ax.plot(steady_rmses.mean(), i, color=own.colour, marker=MARKERS[own.marker], markersize=5)
        for value, label, style in (
            (1e3 * _mean(results, OPTIMUM_POLICY, speed_range), "full-information optimum", "-"),
            (1e3 * _estimation(results, speed_range), "estimation lower bound", "--"),
        ):
            ax.axvline(value, color="0.45", linestyle=style, linewidth=1.2, label=label)
        ax.set_xscale("log")
        ax.set_title(f"{speed_range}: mean steady-state error [mm]")
    axes[0].set_yticks(range(len(names)), [name.format("*") for name in names])
    axes[0].set_ylim(len(names) - 0.5, -0.5)
    figure.legend(*axes[1].get_legend_handles_labels(), loc="outside lower center", ncols=2, fontsize=8)
    return figure


def _heat_map(results: Results) -> Any:
    names = [f"{speed_range}-{case}" for speed_range in SPEED_RANGES for case in CASES]
    values = np.array([
        [1e3 * results.steady_rmses[policy.format(name.partition("-")[0])][name] for name in names]
        for policy in _POLICIES
    ])  # fmt: skip
    figure, [[ax]] = panels(1, 1, (9.4, 3.6))
    image = ax.imshow(values, aspect="auto", cmap="viridis_r", norm=LogNorm(0.1, 1000))
    for (i, j), value in np.ndenumerate(values):
        text, colour = f"{value:.0f}" if value >= 10 else f"{value:.2g}", "white" if value > 20 else "black"
        ax.text(j, i, text, ha="center", va="center", fontsize=7, color=colour)
    ax.set_xticks(range(len(names)), names, rotation=40, ha="right", rotation_mode="anchor")
    ax.set_yticks(range(len(_POLICIES)), [name.format("*") for name in _POLICIES])
    ax.grid(visible=False)
    figure.colorbar(image, ax=ax, label="mean steady-state error [mm]")
    return figure


def _command_rates(results: Results) -> Any:
    figure, [axes] = panels(1, 2, (8.2, 3.2), sharey=True)
    for ax, speed_range in zip(axes, SPEED_RANGES, strict=True):
        for policy in _POLICIES:
            name = policy.format(speed_range)
            rate, error = _entry(results, name, speed_range).smoothness_ratio, 1e3 * _mean(results, name, speed_range)
            own = _look(policy)
            ax.plot(rate, error, color=own.colour, marker=MARKERS[own.marker], markersize=5)
            below = policy in _BELOW
            ax.annotate(
                policy.format("*"), (rate, error), (0, -4 if below else 4), textcoords="offset points", fontsize=7,
                ha="center", va="top" if below else "bottom",
            )  # fmt: skip
        ax.set_xscale("log")
        ax.set_yscale("log")
        ax.margins(0.15)
        ax.set_xlabel(f"{speed_range}: command rate, relative to backstepping")
    axes[0].set_ylabel("mean steady-state error [mm]")
    return figure

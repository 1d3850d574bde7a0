"""The summary of the results, docs/results.md: errors, failures, command rates and times of the main policies."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from auv_gym.scenarios.presets import PRESETS, SPEED_RANGES
from baselines.evaluation.report.columns import failures_text
from baselines.tools.figure_style import MARKERS, look, panels, styled, to_png
from research.pages import SUITE_PAGES, with_interval
from research.results import error_only
from research.results.collection import CONTROLLERS, MAIN_AGENT, Results, results_of
from research.results.suite_page import DESCRIPTIONS, entry_of, error_figure, headline

_SUITE = SUITE_PAGES[0]
_POLICIES = {
    "backstepping": "-",
    "los-pid": "tuning",
    "lqi": "tuning",
    "ekf": "tuning",
    "nmpc": "tuning, preview",
    "nmpc-adverse": "tuning, preview",
    "ppo-*": "training",
    MAIN_AGENT: "training, preview",
}
"""The policies of the summary and their needs; * is replaced by the speed range."""
_BINS = 5  # groups of the episodes of storms by their noise, with about the same number of episodes


def context(_: str = "") -> dict[str, Any]:
    """Return the values of the page's template."""
    results, rows = results_of(_SUITE), []
    for name, needs in _POLICIES.items():
        entries = [entry_of(results, name, speed_range) for speed_range in SPEED_RANGES]
        episodes = sum(entry.summary.episodes for entry in entries if entry.summary is not None)
        rates = " / ".join(f"{entry.smoothness_ratio:.2f}" for entry in entries)
        times = " / ".join(f"{1e6 * entry.decision_seconds:.2g}" for entry in entries)
        failed = failures_text(sum(entry.failed for entry in entries), episodes)
        ratios = (with_interval(results.to_best(results.errors(name, speed_range))) for speed_range in SPEED_RANGES)
        rows.append([f"`{name}`", *ratios, failed, rates, times, needs])
    return {
        "rows": rows,
        "suite": results.suite,
        "episodes": sum(len(cell.episodes) for cell in results.suite.cells),
        "speeds": {r: "{:g} to {:g}".format(*PRESETS[f"{r}-calm"].path.speed) for r in SPEED_RANGES},  # type: ignore[misc]
        "agent": MAIN_AGENT,
        "controllers": ", ".join(map("`{}`".format, CONTROLLERS)),
        "error_only": error_only.context(),
        "suites": [(name, DESCRIPTIONS[name], headline(results_of(name))) for name in SUITE_PAGES],
    }


def figures(_: str = "") -> dict[str, bytes]:
    """Return the figures as PNG, by name: ratios with intervals, errors by cell, errors over the position noise."""
    results = results_of(_SUITE)
    with styled():
        return {
            "results-overview.png": to_png(error_figure(results, list(_POLICIES))),
            "results-disturbances.png": to_png(_heat_map(results)),
            "results-noise.png": to_png(_noise(results)),
        }


def _heat_map(results: Results) -> Figure:
    errors = {policy: results.errors(policy) for policy in _POLICIES}
    values = np.array([[1e3 * errors[policy][cell].mean() for cell in results.cases] for policy in _POLICIES])
    figure, [[ax]] = panels(1, 1, (11.4, 3.6))
    image = ax.imshow(values, aspect="auto", cmap="viridis_r", norm=LogNorm(0.1, 1000))
    for (i, j), value in np.ndenumerate(values):
        text, colour = f"{value:.0f}" if value >= 10 else f"{value:.2g}", "white" if value > 20 else "black"
        ax.text(j, i, text, ha="center", va="center", fontsize=7, color=colour)
    ax.set_xticks(range(len(results.cases)), list(results.cases), rotation=40, ha="right", rotation_mode="anchor")
    ax.set_yticks(range(len(_POLICIES)), list(_POLICIES))
    ax.grid(visible=False)
    figure.colorbar(image, ax=ax, label="mean steady-state error [mm]")
    return figure


def noise_curve(results: Results, policy: str, speed_range: str) -> list[tuple[float, float]]:
    """Return position noise [m] and mean error [m] in storms: of groups of drawn levels, and of fixed levels."""
    points = []
    for cell in results.suite.cells:
        if (name := cell.scenario.name).startswith(f"{speed_range}-storm"):
            levels = np.array([cell.scenario.noise_of(episode)[0] for episode in cell.episodes])
            errors = results.errors(policy, name)[name]
            groups = np.array_split(np.argsort(levels), 1 if levels.min() == levels.max() else _BINS)
            points += [(float(np.exp(np.log(levels[own]).mean())), float(errors[own].mean())) for own in groups]
    return sorted(points)


def _noise(results: Results) -> Figure:
    figure, [axes] = panels(1, 2, (8.2, 3.2))
    for ax, speed_range in zip(axes, SPEED_RANGES, strict=True):
        for policy in (MAIN_AGENT, *CONTROLLERS):
            levels, errors = zip(*noise_curve(results, policy, speed_range), strict=True)
            style = look(policy, [MAIN_AGENT, *CONTROLLERS])
            marker, values = MARKERS[style.marker], 1e3 * np.array(errors)
            ax.plot(levels, values, label=policy, color=style.colour, marker=marker, markersize=4)
        ax.set_xscale("log")
        ax.set_yscale("log")
        ax.set_title(f"{speed_range}-storm")
        ax.set_xlabel("standard deviation of the position noise [m]")
    axes[0].set_ylabel("mean steady-state error [mm]")
    axes[0].legend(fontsize=7)
    return figure

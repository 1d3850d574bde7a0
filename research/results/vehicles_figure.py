"""The figure of the section on other vehicles of the results page: a map of errors over the rival's."""

from __future__ import annotations

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from baselines.evaluation.score import FORESIGHTED, RIVAL, regime_of, vehicle_of
from baselines.tools.figure_style import panels, styled, to_png
from research.results.collection import Results
from research.results.vehicles import pairs_of, ratio, vehicles_of

LEAST = 0.1  # ratio from which on all have the darkest blue
MOST = 10.0  # ratio from which on all have the darkest red


def figure(results: Results) -> bytes:
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
            ax.text(j, i, ratio(value), ha="center", va="center", fontsize=7, color=colour)
        ax.set_xticks(range(len(shown)), shown, rotation=40, ha="right", rotation_mode="anchor")
        ax.set_yticks(range(len(own[regime])), list(own[regime]))
        ax.set_title(regime)
        ax.grid(visible=False)
    fig.colorbar(image, ax=axes, label=f"error / {RIVAL}", shrink=0.9)
    return fig

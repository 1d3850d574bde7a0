"""The learning curve: score on the validation episodes over control steps and over wall time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from baselines.tools.figure_style import COLOURS, REFERENCE, panels, styled, to_png


def learning_curve(seeds: Sequence[Sequence[Mapping[str, float]]], names: Sequence[str] = ()) -> bytes:
    """Return the picture, PNG.

    Args:
        seeds: for each training the rows of its progress.csv.
        names: of the trainings, for the legend; none for a single one.
    """
    figure, [axes] = panels(1, 2, (7.0, 2.8), sharey=True)
    axes[0].set_ylabel("score (0: expert, 1: oracle)")
    with styled():
        for ax, key, unit, label in zip(
            axes, ("timesteps", "seconds"), (1e6, 60.0), ("control steps [million]", "wall time [min]"), strict=True
        ):
            ax.set_xlabel(label)
            ax.axhline(0.0, **REFERENCE)
            for i, rows in enumerate(seeds):
                points = [row for row in rows if "score" in row]
                ax.plot(
                    [row[key] / unit for row in points],
                    [row["score"] for row in points],
                    color=COLOURS[i % len(COLOURS)],
                    marker=".",
                    label=names[i] if names else None,
                )
        if names:
            axes[0].legend()
    return to_png(figure)

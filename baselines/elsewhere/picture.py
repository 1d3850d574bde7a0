"""A picture of tracks in two simulators, one policy on the same episodes."""

from __future__ import annotations

from collections.abc import Sequence

from baselines.elsewhere.comparison import PLANE, SPACE, Task
from baselines.tools.figure_style import COLOURS, REFERENCE, panels, to_png

NAMES = {PLANE: "in the plane", SPACE: "in six degrees of freedom"}


def picture(tasks: Sequence[Task]) -> bytes:
    """Return a PNG file's bytes: a row for each task, the track of its first episode and its error over time."""
    figure, rows = panels(len(tasks), 2, (8.0, 3.2 * len(tasks)))
    for task, (above, beside) in zip(tasks, rows, strict=True):
        for place, colour in zip((PLANE, SPACE), COLOURS, strict=False):
            track = task.played(place).tracks[0]
            if place == PLANE:
                above.plot(track.reference[:, 1], track.reference[:, 0], label="reference", **REFERENCE)
            above.plot(track.position[:, 1], track.position[:, 0], color=colour, label=NAMES[place])
            beside.plot(track.error, color=colour, label=NAMES[place])
        above.set(title=f"{task.vehicle}: {task.policy}, {task.case}", xlabel="y [m], east", ylabel="x [m], north")
        above.set_aspect("equal", adjustable="datalim")
        beside.set(title="distance to the reference", xlabel="control step", ylabel="error [m]")
        beside.set_ylim(bottom=0)
        above.legend()
    return to_png(figure)

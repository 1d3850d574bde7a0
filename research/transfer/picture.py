"""A picture of tracks in two simulators, one policy on the same episodes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from auv_gym.scenarios.vehicles import craft
from baselines.evaluation.metrics import Track
from baselines.evaluation.rollout import rollout
from baselines.policies import make_policy
from baselines.tools.figure_style import COLOURS, REFERENCE, panels, styled, to_png
from research.transfer.comparison import PLANE, SPACE, Task

_NAMES = {PLANE: "in the plane", SPACE: "in six degrees of freedom"}  # of the simulators, in the legend


def task_track(task: Task, place: str) -> Track:
    """Return the way of a task's first episode in one of the simulators."""
    cell, known = task.cells[0], craft(task.vehicle).vehicle
    done = rollout(make_policy(task.policy, known), cell.scenario, cell.episodes[:1], bodies=task.bodies(place))
    return done.tracks[0]


def picture(tasks: Sequence[Task]) -> bytes:
    """Return a PNG file's bytes: a row for each task, the track of its first episode and its error over time."""
    figure, rows = panels(len(tasks), 2, (8.0, 3.2 * len(tasks)))
    with styled():
        for task, axes in zip(tasks, rows, strict=True):
            _draw(task, *axes)
        rows[0][0].legend(loc="lower right", fontsize=8)
    return to_png(figure)


def _draw(task: Task, above: Axes, beside: Axes) -> None:
    """Draw the track of a task's first episode in both simulators, and its error over time."""
    dt = task.cells[0].scenario.control_dt
    for place, colour in zip((PLANE, SPACE), COLOURS, strict=False):
        track = task_track(task, place)
        if place == PLANE:
            above.plot(track.reference[:, 1], track.reference[:, 0], label="reference", **REFERENCE)
        above.plot(track.position[:, 1], track.position[:, 0], color=colour, label=_NAMES[place])
        beside.plot(dt * np.arange(len(track.error)), track.error, color=colour)
    title = f"{task.vehicle}: {task.policy}, {task.cases[0]}"
    above.set(title=title, xlabel="y [m], east", ylabel="x [m], north")
    above.set_aspect("equal", adjustable="datalim")
    beside.set(title="distance to the reference", xlabel="time [s]", ylabel="error [m]")
    beside.set_ylim(bottom=0)

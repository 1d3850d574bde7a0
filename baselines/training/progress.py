"""How far a training is: a live line on a terminal, else a line for each validation."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import timedelta

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn

from baselines.training.config import Config
from baselines.training.run_folder import State


@contextmanager
def live(config: Config) -> Iterator[Callable[[State], None]]:
    """Yield what shows the states of one run on stderr."""
    console = Console(stderr=True, highlight=False)
    if not console.is_terminal:
        yield plain("")
        return
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TextColumn("{task.fields[text]}"))
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task(config.algo, total=config.timesteps, text="")
        yield lambda state: bar.update(task, completed=state.timesteps, text=_text(state))


def plain(label: str) -> Callable[[State], None]:
    """Return what prints a line to stderr for each validation.

    Args:
        label: begins each line.
    """
    printed = 0

    def show(state: State) -> None:
        nonlocal printed
        if len(state.scores) != printed:
            printed = len(state.scores)
            print(f"{label}{min(1.0, state.timesteps / state.total):4.0%} {_text(state)}", file=sys.stderr, flush=True)

    return show


def _text(state: State) -> str:
    score = "validating the expert" if state.kept is None else f"score {state.scores[-1]:.3f}, kept {state.kept:.3f}"
    left = "" if state.seconds_left is None else f", {timedelta(seconds=round(state.seconds_left))} left"
    return f"{state.timesteps:,} steps, {score}{left}"

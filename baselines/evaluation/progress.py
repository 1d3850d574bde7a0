"""How far an evaluation is: a live line on a terminal, else a line for each run, with the time that is left."""

from __future__ import annotations

import contextlib
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from baselines.evaluation.runner import STEP_LIMIT, Cell, Run, runs
from baselines.tools.workers import Workers

INTERVAL = 0.5
"""Seconds between two looks at the board."""
MINUTE = 60.0
"""Seconds between two lines where there is no terminal."""


@dataclass(frozen=True)
class StepCounter:
    """A folder where tasks write how many control steps they have done; one that they cannot reach is no error.

    rich and tqdm count in one process, and queues of multiprocessing and of Ray reach the workers of one kind only; a
    folder needs no process of its own, and loses nothing with a worker that is killed.
    """

    folder: Path

    def note(self, task: str, steps: int) -> None:
        """Write down the steps of a task."""
        with contextlib.suppress(OSError):
            (self.folder / task).write_text(str(steps), encoding="ascii")

    def total(self) -> int:
        """Return the steps of all tasks."""
        found = 0
        for file in self.folder.iterdir():
            with contextlib.suppress(OSError, ValueError):  # a file that is just being written
                found += int(file.read_text(encoding="ascii"))
        return found


class Clock:
    """Estimates the time that is left from the steps done since it was made."""

    def __init__(self, steps: int, now: Callable[[], float] = time.monotonic) -> None:
        self._steps, self._now, self._start, self._before = steps, now, now(), 0

    def skip(self, steps: int) -> None:
        """Steps that were not done now: an earlier evaluation has left them."""
        self._before += steps

    def left(self, done: int) -> str:
        """Return how long it takes from `done` steps on, as ", 3 min left"; nothing while that cannot be known."""
        new = done - self._before
        if new <= 0 or done >= self._steps:
            return ""
        seconds = (self._now() - self._start) * (self._steps - done) / new
        return f", {seconds:.0f} s left" if seconds < 2 * MINUTE else f", {seconds / MINUTE:.0f} min left"


@dataclass(frozen=True)
class Listener:
    """Where progress is told."""

    message: Callable[[str], None]
    run: Callable[[Run], None]
    board: StepCounter

    def runs(
        self,
        pairs: Sequence[tuple[str, Cell]],
        workers: Workers,
        step_limit: float = STEP_LIMIT,
        known: Callable[[str], Run | None] = lambda _: None,
    ) -> Iterator[Run]:
        """Yield the runs of `runner.runs` and show each of them once the caller has taken it."""
        for run in runs(pairs, workers, step_limit, self.board.note, known):
            yield run
            self.run(run)


@contextmanager
def progress(pairs: Sequence[tuple[str, Cell]]) -> Iterator[Listener]:
    """Show on stderr how far an evaluation of these policies, each in its cell, is."""
    steps = sum(len(cell.episodes) * cell.scenario.steps for _, cell in pairs)
    with TemporaryDirectory() as folder:
        board, err = StepCounter(Path(folder)), Console(stderr=True, highlight=False)
        with (_bar if err.is_terminal else _lines)(len(pairs), steps, board, err) as listener:
            yield listener


def run_and_show(pairs: Sequence[tuple[str, Cell]], workers: Workers, step_limit: float = STEP_LIMIT) -> list[Run]:
    """Return the run of each policy in its cell, in the order of completion, and show on stderr how far they are."""
    with progress(pairs) as report:
        return list(report.runs(pairs, workers, step_limit))


@contextmanager
def _bar(count: int, steps: int, board: StepCounter, err: Console) -> Iterator[Listener]:
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn())
    done = iter(range(1, count + 1))
    with Progress(*columns, TextColumn("left"), TimeRemainingColumn(), console=err, transient=True) as bar:
        task = bar.add_task("control steps", total=steps)
        listener = Listener(
            lambda text: bar.update(task, description=text),
            lambda run: bar.update(task, description=f"{next(done)}/{count} {run.policy} in {run.scenario.name}"),
            board,
        )
        with _watched(board, lambda total: bar.update(task, completed=total)):
            yield listener


@contextmanager
def _lines(count: int, steps: int, board: StepCounter, _: Console) -> Iterator[Listener]:
    clock, done, last = Clock(steps), iter(range(1, count + 1)), [time.monotonic()]

    def say(text: str) -> None:
        last[0] = time.monotonic()
        print(text, file=sys.stderr, flush=True)

    def line(run: Run) -> None:
        if run.known:
            clock.skip(len(run.measures or ()) * run.scenario.steps)
        state = "failed" if run.error else "known" if run.known else "done"
        say(f"[{next(done)}/{count}] {run.policy} in {run.scenario.name}: {state}{clock.left(board.total())}")

    def tick(total: int) -> None:
        if time.monotonic() - last[0] > MINUTE:
            say(f"{100 * total / steps:.0f} %{clock.left(total)}")

    with _watched(board, tick):
        yield Listener(say, line, board)


@contextmanager
def _watched(board: StepCounter, tick: Callable[[int], None]) -> Iterator[None]:
    """Call with the board's total again and again, from another thread."""
    over = threading.Event()

    def watch() -> None:
        while not over.wait(INTERVAL):
            tick(board.total())

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()

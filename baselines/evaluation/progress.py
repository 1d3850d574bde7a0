"""Shows the progress of an evaluation: a progress bar on a terminal, otherwise a line for each run."""

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
"""Seconds between two updates."""
MINUTE = 60.0
"""Seconds between two lines without a terminal."""


@dataclass(frozen=True)
class StepCounter:
    """A folder in which each task writes its number of finished control steps; a failed write is no error.

    rich and tqdm count in one process, and a queue reaches worker processes of one library only. A folder works for
    all, and keeps the count of a worker that is killed.
    """

    folder: Path

    def note(self, task: str, steps: int) -> None:
        """Write the number of steps of a task."""
        with contextlib.suppress(OSError):
            (self.folder / task).write_text(str(steps), encoding="ascii")

    def total(self) -> int:
        """Return the steps of all tasks."""
        found = 0
        for file in self.folder.iterdir():
            with contextlib.suppress(OSError, ValueError):  # a worker is writing the file
                found += int(file.read_text(encoding="ascii"))
        return found


class Clock:
    """Estimates the remaining time from the control steps since its construction."""

    def __init__(self, steps: int, now: Callable[[], float] = time.monotonic) -> None:
        self._steps, self._now, self._start, self._before = steps, now, now(), 0

    def skip(self, steps: int) -> None:
        """Exclude steps of an earlier evaluation from the estimate."""
        self._before += steps

    def left(self, done: int) -> str:
        """Return the remaining time after `done` steps, such as ", 3 min left"; empty if there is no estimate."""
        new = done - self._before
        if new <= 0 or done >= self._steps:
            return ""
        seconds = (self._now() - self._start) * (self._steps - done) / new
        return f", {seconds:.0f} s left" if seconds < 2 * MINUTE else f", {seconds / MINUTE:.0f} min left"


@dataclass(frozen=True)
class Listener:
    """Receiver of progress: messages, finished runs and numbers of control steps."""

    message: Callable[[str], None]
    run: Callable[[Run], None]
    counter: StepCounter

    def runs(
        self,
        pairs: Sequence[tuple[str, Cell]],
        workers: Workers,
        step_limit: float = STEP_LIMIT,
        known: Callable[[str], Run | None] = lambda _: None,
    ) -> Iterator[Run]:
        """Yield the runs of `runner.runs`; each is shown after the caller has processed it."""
        for run in runs(pairs, workers, step_limit, self.counter.note, known):
            yield run
            self.run(run)


@contextmanager
def progress(pairs: Sequence[tuple[str, Cell]]) -> Iterator[Listener]:
    """Show the progress of an evaluation of these policies and cells on stderr, within a `with` block."""
    steps = sum(len(cell.episodes) * cell.scenario.steps for _, cell in pairs)
    with TemporaryDirectory() as folder:
        counter, err = StepCounter(Path(folder)), Console(stderr=True, highlight=False)
        with (_bar if err.is_terminal else _lines)(len(pairs), steps, counter, err) as listener:
            yield listener


def run_and_show(pairs: Sequence[tuple[str, Cell]], workers: Workers, step_limit: float = STEP_LIMIT) -> list[Run]:
    """Return the run of each policy in its cell, in the order of completion, and show the progress on stderr."""
    with progress(pairs) as report:
        return list(report.runs(pairs, workers, step_limit))


@contextmanager
def _bar(count: int, steps: int, counter: StepCounter, err: Console) -> Iterator[Listener]:
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn())
    done = iter(range(1, count + 1))
    with Progress(*columns, TextColumn("left"), TimeRemainingColumn(), console=err, transient=True) as bar:
        task = bar.add_task("control steps", total=steps)
        listener = Listener(
            lambda text: bar.update(task, description=text),
            lambda run: bar.update(task, description=f"{next(done)}/{count} {run.policy} in {run.scenario.name}"),
            counter,
        )
        with _polled(counter, lambda total: bar.update(task, completed=total)):
            yield listener


@contextmanager
def _lines(count: int, steps: int, counter: StepCounter, _: Console) -> Iterator[Listener]:
    clock, done, last = Clock(steps), iter(range(1, count + 1)), [time.monotonic()]

    def show(text: str) -> None:
        last[0] = time.monotonic()
        print(text, file=sys.stderr, flush=True)

    def line(run: Run) -> None:
        if run.known:
            clock.skip(len(run.measures or ()) * run.scenario.steps)
        state = "failed" if run.error else "known" if run.known else "done"
        show(f"[{next(done)}/{count}] {run.policy} in {run.scenario.name}: {state}{clock.left(counter.total())}")

    def update(total: int) -> None:
        if time.monotonic() - last[0] > MINUTE:
            show(f"{100 * total / steps:.0f} %{clock.left(total)}")

    with _polled(counter, update):
        yield Listener(show, line, counter)


@contextmanager
def _polled(counter: StepCounter, update: Callable[[int], None]) -> Iterator[None]:
    """Call `update` with the total number of steps every `INTERVAL`, from another thread, within a `with` block."""
    over = threading.Event()

    def poll() -> None:
        while not over.wait(INTERVAL):
            update(counter.total())

    thread = threading.Thread(target=poll, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()

"""The folder of a training run: configuration, progress, validations and checkpoint."""

from __future__ import annotations

import csv
import io
import math
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from filelock import FileLock, Timeout

from auv_gym.scenarios.records import guarded
from baselines.agents.agent import Agent
from baselines.agents.networks import Weights
from baselines.tools.command_line import UsageError
from baselines.tools.files import json_text, read_csv, read_json, write_atomically
from baselines.training.checkpoint import UNREADABLE, code_digest, packed, unpacked
from baselines.training.config import Config
from baselines.training.validation import VALIDATION_PRECISION, Validation, validation_cell

if TYPE_CHECKING:
    from torch.utils.tensorboard.writer import SummaryWriter

CONFIG = "config.json"  # file of the training's `Config`
PROGRESS = "progress.csv"  # file of the learning curve
CHECKPOINT = "checkpoint.pt"  # file that a run is resumed from
EVENTS = "tensorboard"  # folder of TensorBoard's files
LOCK = ".lock"  # file that the writing process locks; without a lock on it the file has no meaning
VALIDATIONS = 20
"""Number of validations of the agent in a run; a checkpoint is saved with each."""


class TrainingError(Exception):
    """A training cannot continue; the message says why, and what to change."""


@dataclass(frozen=True)
class TrainerState:
    """The progress of a run."""

    timesteps: int  # control steps, summed over vehicles
    total: int
    scores: tuple[float, ...]  # of all validations so far
    kept: float | None  # score of the selected agent; None before the first validation
    seconds: float  # wall time, including that before a resumption
    seconds_left: float | None


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Lock a run folder for this process, and create it if necessary; the lock ends with the process.

    Raises:
        OSError: it cannot be written to.
        UsageError: another process has the lock, or the file system has no locks.
    """
    folder.mkdir(parents=True, exist_ok=True)
    try:
        held = FileLock(folder / LOCK).acquire(blocking=False)
    except Timeout:
        raise UsageError(f"another training writes to {folder}; wait for it, or choose another folder") from None
    except NotImplementedError as error:
        raise UsageError(f"the file system of {folder} has no locks; choose a folder on another one") from error
    with held:
        yield


class RunFolder:
    """The log, validations and checkpoints of a training run.

    A trainer first calls `load_checkpoint` once, then `log`, `validate` and `save_checkpoint`. Only one process may
    write to the folder, see `locked`.

    Args:
        config: of the run.
        folder: created if necessary; a run in it must have the same configuration.
        on_state: called with the progress of the run.
        processes: number of processes for a trainer, including this one; the result does not depend on it.

    Attributes:
        keeps_last: whether the agent of the last validation is selected instead of that of the best one.
        weights: of the selected agent; they are also in the checkpoint.

    Raises:
        OSError: the folder cannot be written to.
        TrainingError: the folder holds another run.
        ValueError: a file of the folder is damaged.
    """

    def __init__(
        self,
        config: Config,
        folder: Path,
        on_state: Callable[[TrainerState], None] = lambda _: None,
        processes: int = 1,
    ) -> None:
        self.config = config
        self.folder = folder
        self.processes = processes
        self.keeps_last = False
        code_digest()  # of the code that runs, not of files that change later
        self.weights: Weights = {}
        self._on_state = on_state
        self._rows: list[dict[str, float]] = []
        self._begin, self._earlier, self._start = time.monotonic(), 0.0, 0
        for file in folder.glob(".*.tmp"):  # of a run that was killed
            file.unlink()
        if (there := read_config(folder)) is None:
            write_atomically(folder / CONFIG, json_text(config.to_dict()))
        elif there.to_dict() != config.to_dict():
            raise TrainingError(f"{folder} holds another training; choose another folder")

    @cached_property
    def validation(self) -> Validation:
        """The validation episodes of the run's scenarios; with an initial agent few, and without the oracle."""
        brief = self.config.origin is not None
        cells = [validation_cell(scenario, brief) for scenario, _ in self.config.scenarios]
        return Validation(cells, brief)

    @property
    def seconds(self) -> float:
        """Wall time of the run [s], including that before a resumption."""
        return self._earlier + time.monotonic() - self._begin

    def log(self, timesteps: int, **values: float) -> None:
        """Add a row to progress.csv and TensorBoard, and report the progress.

        Args:
            timesteps: control steps so far, summed over vehicles; a second row with the same number extends the first.
            values: to log, by name.

        Raises:
            OSError: the folder cannot be written to.
        """
        if not self._rows or self._rows[-1]["timesteps"] != timesteps:
            self._rows.append({"timesteps": timesteps})
        self._rows[-1] |= {"seconds": round(self.seconds, 3)} | {name: float(v) for name, v in values.items()}
        write_atomically(self.folder / PROGRESS, _csv(self._rows))
        for name, value in values.items():
            self._events.add_scalar(name, float(value), timesteps)
        self._events.flush()
        self.report(timesteps)

    def report(self, timesteps: int) -> None:
        """Call `on_state` with the progress of the run."""
        scores = tuple(row["score"] for row in self._rows if "score" in row)
        done, total = timesteps - self._start, self.config.timesteps
        left = (time.monotonic() - self._begin) * max(0, total - timesteps) / done if done > 0 else None
        kept = self.validated["score"] if scores else None
        self._on_state(TrainerState(timesteps, total, scores, kept, self.seconds, left))

    def validate(self, agent: Agent, timesteps: int) -> None:
        """Log the score of an agent on the validation episodes, and select the best agent.

        The score is 0 for the expert and 1 for the oracle. Of equal scores the first is selected; with `keeps_last` it
        is always the last one.

        Args:
            agent: the current one.
            timesteps: see `log`.

        Raises:
            OSError: the folder cannot be written to.
        """
        verdict = self.validation.run(agent.policy(vehicle=self.config.vehicle, precision=VALIDATION_PRECISION))
        self.log(timesteps, score=verdict.score, error_m=verdict.error_m, failed=verdict.failed)
        if self.validated["timesteps"] == timesteps:
            self.weights = agent.weights

    @property
    def validated(self) -> dict[str, float]:
        """The logged row of the best validation; with `keeps_last` of the last one."""
        rows = [row for row in self._rows if "score" in row]
        return rows[-1] if self.keeps_last else max(rows, key=lambda row: (not math.isnan(row["score"]), row["score"]))

    def save_checkpoint(self, state: Mapping[str, Any]) -> None:
        """Write a checkpoint and replace the last one atomically.

        Args:
            state: objects that can be pickled; its entry "timesteps" is the number of control steps so far.

        Raises:
            OSError: the folder cannot be written to.
        """
        record = {"timesteps": int(state["timesteps"]), "seconds": self.seconds, "weights": dict(self.weights)}
        write_atomically(self.folder / CHECKPOINT, packed({**record, "state": dict(state)}))

    def load_checkpoint(self) -> dict[str, Any] | None:
        """Return the state of the last checkpoint, None if there is none; later rows of the log are dropped.

        Raises:
            OSError: the folder cannot be read.
            TrainingError: a file is damaged, or of other code, or of other versions of the libraries.
        """
        file = self.folder / CHECKPOINT
        if not file.exists():
            return None
        with self.restoring():
            record = unpacked(file.read_bytes())
            rows = [row for row in read_progress(self.folder) if row["timesteps"] <= record["timesteps"]]
            if not rows or rows[-1]["timesteps"] != record["timesteps"]:
                raise ValueError(f"{PROGRESS} is damaged, it ends before the checkpoint")
            self.weights = record["weights"]
        self._earlier, self._begin, self._start = record["seconds"], time.monotonic(), record["timesteps"]
        self._rows = rows
        state: dict[str, Any] = record["state"]
        return state

    @contextmanager
    def restoring(self) -> Iterator[None]:
        """Convert exceptions of an unreadable checkpoint; a trainer restores its state within this context.

        Raises:
            TrainingError: instead of one of `UNREADABLE`.
        """
        try:
            yield
        except UNREADABLE as error:
            what = f"it has no {error}" if isinstance(error, KeyError) else str(error)
            raise TrainingError(
                f"cannot resume from {self.folder / CHECKPOINT}: {what}; start again in another folder, or use the "
                "code and the libraries that wrote it"
            ) from error

    def close(self) -> None:
        """Write the buffered events of TensorBoard."""
        if "_events" in self.__dict__:
            self._events.close()

    @cached_property
    def _events(self) -> SummaryWriter:
        from torch.utils.tensorboard.writer import SummaryWriter

        return SummaryWriter(str(self.folder / EVENTS), purge_step=self._start + 1 if self._start else None)


def read_progress(folder: Path) -> list[dict[str, float]]:
    """Return the rows of a folder's progress.csv without their empty entries; empty if there is no such file.

    Raises:
        OSError: it cannot be read.
        ValueError: it is damaged.
    """
    if not (folder / PROGRESS).exists():
        return []
    with guarded(f"{folder / PROGRESS} is damaged"):
        rows = read_csv(folder / PROGRESS)
        return [{"timesteps": int(row.pop("timesteps")), **{k: float(v) for k, v in row.items()}} for row in rows]


def read_config(folder: Path) -> Config | None:
    """Return the configuration of a run folder, None if it holds none.

    Raises:
        OSError: it cannot be read.
        ValueError: it is damaged.
    """
    try:
        record = read_json(folder / CONFIG)
    except (FileNotFoundError, NotADirectoryError):
        return None
    with guarded(str(folder / CONFIG)):
        return Config.from_dict(record)


def _csv(rows: list[dict[str, float]]) -> str:
    """Return the rows as CSV with a column for each name."""
    buffer = io.StringIO()
    writer = csv.DictWriter(buffer, list(dict.fromkeys(key for row in rows for key in row)), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return buffer.getvalue()

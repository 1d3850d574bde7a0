"""The folder of a training run: configuration, progress, validations and checkpoint."""

from __future__ import annotations

import csv
import hashlib
import io
import math
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from datetime import timedelta
from functools import cache, cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import auv_gym
from auv_gym.scenarios.records import guarded
from baselines.agents.agent import Agent
from baselines.agents.networks import Weights
from baselines.tools.command_line import UsageError
from baselines.tools.files import json_text, read_csv, read_json, write_atomically
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

Show = Callable[[int, str, bool], None]
"""Displays the progress of a run: control steps so far, a text, and whether there is a new score."""


class TrainingError(Exception):
    """A training cannot continue; the message says why, and what to change."""


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Lock a run folder for this process, and create it if necessary; the lock ends with the process.

    Raises:
        OSError: it cannot be written to.
        UsageError: another process has the lock, or the file system has no locks.
    """
    from filelock import FileLock, Timeout

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
    write to the folder, see `locked`. All methods raise OSError if the folder cannot be read or written to.

    Args:
        config: of the run.
        folder: created if necessary; a run in it must have the same configuration.
        show: displays the progress.
        processes: number of processes for a trainer, including this one; the result does not depend on it.

    Attributes:
        keeps_last: whether the agent of the last validation is selected instead of that of the best one.
        weights: of the selected agent; they are also in the checkpoint.

    Raises:
        TrainingError: the folder holds another run.
        ValueError: a file of the folder is damaged.
    """

    def __init__(self, config: Config, folder: Path, show: Show = lambda *_: None, processes: int = 1) -> None:
        self.config, self.folder, self.processes = config, folder, processes
        self.keeps_last = False
        code_digest()  # of the code that runs, not of files that change later
        self.weights: Weights = {}
        self._show = show
        self._rows: list[dict[str, float]] = []
        self._begin, self._earlier, self._start = time.monotonic(), 0.0, 0
        for file in folder.glob(".*.tmp"):  # of a run that was killed
            file.unlink()
        if (config_of_folder := read_config(folder)) is None:
            write_atomically(folder / CONFIG, json_text(config.to_dict()))
        elif config_of_folder.to_dict() != config.to_dict():
            raise TrainingError(f"{folder} holds another training; choose another folder")

    @cached_property
    def validation(self) -> Validation:
        """The validation episodes of the run's scenarios; with an initial agent few."""
        brief = self.config.origin is not None
        cells = [validation_cell(scenario, brief) for scenario, _ in self.config.scenarios]
        return Validation(cells)

    @property
    def seconds(self) -> float:
        """Wall time of the run [s], including that before a resumption."""
        return self._earlier + time.monotonic() - self._begin

    def log(self, timesteps: int, **values: float) -> None:
        """Add a row to progress.csv and TensorBoard, and report the progress.

        Args:
            timesteps: control steps so far, summed over vehicles; a second row with the same number extends the first.
            values: to log, by name.
        """
        if not self._rows or self._rows[-1]["timesteps"] != timesteps:
            self._rows.append({"timesteps": timesteps})
        self._rows[-1] |= {"seconds": round(self.seconds, 3)} | {name: float(v) for name, v in values.items()}
        write_atomically(self.folder / PROGRESS, _csv(self._rows))
        for name, value in values.items():
            self._events.add_scalar(name, float(value), timesteps)
        self._events.flush()
        self.report(timesteps, "score" in values)

    def report(self, timesteps: int, validated: bool = False) -> None:
        """Show the progress of the run; `validated`: there is a new score."""
        scores = [row["score"] for row in self._rows if "score" in row]
        score = f"score {scores[-1]:.3f}, kept {self.validated['score']:.3f}" if scores else "validating the expert"
        left, done = "", timesteps - self._start
        if done > 0:
            seconds = (time.monotonic() - self._begin) * max(0, self.config.timesteps - timesteps) / done
            left = f", {timedelta(seconds=round(seconds))} left"
        self._show(timesteps, f"{timesteps:,} steps, {score}{left}", validated)

    def validate(self, agent: Agent, timesteps: int) -> None:
        """Log the score of an agent on the validation episodes, and select the best agent.

        The score is 0 for the expert and 1 for no error. Of equal scores the first is selected; with `keeps_last` it
        is always the last one.

        Args:
            agent: the current one.
            timesteps: see `log`.
        """
        verdict = self.validation.run(agent.policy(vehicle=self.config.known, precision=VALIDATION_PRECISION))
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
        """
        import torch

        content = io.BytesIO()
        torch.save({"seconds": self.seconds, "weights": dict(self.weights), "state": dict(state)}, content)
        write_atomically(self.folder / CHECKPOINT, code_digest() + content.getvalue())

    def load_checkpoint(self) -> dict[str, Any] | None:
        """Return the state of the last checkpoint, None if there is none; later rows of the log are dropped.

        Raises:
            TrainingError: a file is damaged, or of other code, or of other versions of the libraries.
        """
        if not (self.folder / CHECKPOINT).exists():
            return None
        with self.restoring():
            record = read_checkpoint(self.folder)
            state: dict[str, Any] = record["state"]
            rows = [row for row in read_progress(self.folder) if row["timesteps"] <= state["timesteps"]]
            if not rows or rows[-1]["timesteps"] != state["timesteps"]:
                raise ValueError(f"{PROGRESS} is damaged, it ends before the checkpoint")
            self._earlier, self.weights = record["seconds"], record["weights"]
        self._begin, self._start, self._rows = time.monotonic(), state["timesteps"], rows
        return state

    @contextmanager
    def restoring(self) -> Iterator[None]:
        """Convert exceptions of an unreadable checkpoint; a trainer restores its state within this context.

        Raises:
            TrainingError: instead of every exception but OSError.
        """
        try:
            with guarded(f"cannot resume from {self.folder / CHECKPOINT}"):
                yield
        except (ImportError, ValueError) as error:
            raise TrainingError(
                f"{error}; start again in another folder, or use the code and the libraries that wrote it"
            ) from error

    def close(self) -> None:
        """Write the buffered events of TensorBoard."""
        if "_events" in self.__dict__:
            self._events.close()

    @cached_property
    def _events(self) -> SummaryWriter:
        from torch.utils.tensorboard.writer import SummaryWriter

        return SummaryWriter(str(self.folder / EVENTS), purge_step=self._start + 1 if self._start else None)


def read_checkpoint(folder: Path) -> dict[str, Any]:
    """Return the record of a folder's checkpoint: seconds, weights of the selected agent, and state of the trainer.

    If the code has changed since, unpickling could give wrong objects without an error. Such a checkpoint is rejected
    before anything is unpickled.

    Raises:
        OSError: it cannot be read.
        ValueError: the code has changed.
        Exception: of any kind, if the file is damaged or libraries have changed.
    """
    import torch

    content, digest = (folder / CHECKPOINT).read_bytes(), code_digest()
    if not content.startswith(digest):
        raise ValueError("it is damaged, or the code of auv_gym or baselines has changed since")
    record: dict[str, Any] = torch.load(io.BytesIO(content[len(digest) :]), map_location="cpu", weights_only=False)
    return record


@cache
def code_digest() -> bytes:
    """Return the SHA-256 of the Python source files of `auv_gym` and `baselines` at the first call."""
    digest = hashlib.sha256()
    for package in (Path(auv_gym.__file__).parent, Path(__file__).parents[1]):
        for file in sorted(package.rglob("*.py")):
            digest.update(file.read_bytes())
    return digest.digest()


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

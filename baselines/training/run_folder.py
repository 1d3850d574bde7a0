"""One training run in its folder: what it is, how far it is, what it has logged, and where to go on."""

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
from baselines.training.checkpoint import UNREADABLE, packed, unpacked
from baselines.training.config import Config
from baselines.training.validation import VALIDATION_PRECISION, Validation, validation_cell

if TYPE_CHECKING:
    from torch.utils.tensorboard.writer import SummaryWriter

CONFIG = "config.json"  # file of the training's `Config`
PROGRESS = "progress.csv"  # file of the learning curve
CHECKPOINT = "checkpoint.pt"  # file that a run is resumed from
AGENT_FOLDER = "agent"  # folder of the trained agent
EVENTS = "tensorboard"  # folder of TensorBoard's files
LOCK = ".lock"  # file that the process holds which writes in the run folder; left behind, it means nothing
VALIDATIONS = 20
"""How often in a run an agent is validated; as often a checkpoint is kept."""


class TrainingError(Exception):
    """A training cannot go on; the message says why and what to change."""


@dataclass(frozen=True)
class TrainerState:
    """How far a run is."""

    timesteps: int  # control steps, summed over vehicles
    total: int
    scores: tuple[float, ...]  # of all validations so far
    kept: float | None  # that of the agent that is kept; None before the first validation
    seconds: float  # wall time, that before a resumption included
    seconds_left: float | None


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold a run folder, made if need be, for this process alone; a process that is killed lets go of it.

    Raises:
        OSError: it cannot be written to.
        UsageError: another process holds it, or its file system knows no locks.
    """
    folder.mkdir(parents=True, exist_ok=True)
    try:
        held = FileLock(folder / LOCK).acquire(blocking=False)
    except Timeout:
        raise UsageError(f"another training writes to {folder}; wait for it, or choose another folder") from None
    except NotImplementedError as error:
        raise UsageError(f"nothing can be locked where {folder} is; choose a folder on another file system") from error
    with held:
        yield


class RunFolder:
    """A training run, which a trainer logs to and goes on from.

    A trainer calls `load_checkpoint` once before anything else, then `log`, `validate` and `save_checkpoint`. One
    process writes to the folder, see `locked`.

    Args:
        config: what determines the run.
        folder: made if need be; what it holds must be of the same configuration.
        on_state: called whenever something is known about how far the run is.
        processes: that a trainer may compute in, this one included; what is learned does not depend on it.

    Attributes:
        keeps_last: whether the agent of the last validation is kept in place of that of the best one.
        weights: of the agent that is kept; a checkpoint holds them too.

    Raises:
        OSError: the folder cannot be written to.
        TrainingError: the folder holds another run.
        ValueError: what it holds is damaged.
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
        self.weights: Weights = {}
        self._on_state = on_state
        self._rows: list[dict[str, float]] = []
        self._begin, self._earlier, self._start = time.monotonic(), 0.0, 0
        for left in folder.glob(".*.tmp"):  # of a run that was killed
            left.unlink()
        if (there := read_config(folder)) is None:
            folder.mkdir(parents=True, exist_ok=True)
            write_atomically(folder / CONFIG, json_text(config.to_dict()))
        elif there.to_dict() != config.to_dict():
            raise TrainingError(f"{folder} holds another training; choose another folder")

    @cached_property
    def validation(self) -> Validation:
        """The validation episodes of the run's scenarios; few, and without the oracle, if it begins with an agent."""
        brief = self.config.origin is not None
        cells = [validation_cell(scenario, brief) for scenario, _ in self.config.scenarios]
        return Validation(cells, self.folder, brief)

    @property
    def seconds(self) -> float:
        """Wall time that the run has taken [s], that before a resumption included."""
        return self._earlier + time.monotonic() - self._begin

    def log(self, timesteps: int, **values: float) -> None:
        """Add a row to progress.csv and TensorBoard, and report how far the run is.

        Args:
            timesteps: control steps so far, summed over vehicles; a second row at the same number joins the first.
            values: what to log, by name.

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
        """Report how far the run is."""
        scores = tuple(row["score"] for row in self._rows if "score" in row)
        done, total = timesteps - self._start, self.config.timesteps
        left = (time.monotonic() - self._begin) * max(0, total - timesteps) / done if done > 0 else None
        kept = self.validated["score"] if scores else None
        self._on_state(TrainerState(timesteps, total, scores, kept, self.seconds, left))

    def validate(self, agent: Agent, timesteps: int) -> None:
        """Log the score of an agent on the validation episodes, 0 the expert, 1 the oracle, and keep the best agent.

        Of equals the first is kept; with `keeps_last` always the last one.

        Args:
            agent: as it is now.
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
        """What was logged of the validation whose agent is kept: the best one, or the last one with `keeps_last`."""
        rows = [row for row in self._rows if "score" in row]
        return rows[-1] if self.keeps_last else max(rows, key=lambda row: (not math.isnan(row["score"]), row["score"]))

    def save_checkpoint(self, state: Mapping[str, Any]) -> None:
        """Keep what it takes to go on, in place of the last checkpoint; a kill at any moment leaves one of them whole.

        Args:
            state: whatever can be pickled; its entry "timesteps" says how far the run is.

        Raises:
            OSError: the folder cannot be written to.
        """
        record = {"timesteps": int(state["timesteps"]), "seconds": self.seconds, "weights": dict(self.weights)}
        write_atomically(self.folder / CHECKPOINT, packed({**record, "state": dict(state)}))

    def load_checkpoint(self) -> dict[str, Any] | None:
        """Return the state of the last checkpoint, None if there is none; what was logged after it is forgotten.

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
        """Say what is to be done where a checkpoint cannot be gone on from; a trainer takes up its state within.

        Raises:
            TrainingError: in place of what damage, other code or other libraries raise.
        """
        try:
            yield
        except UNREADABLE as error:
            what = f"it has no {error}" if isinstance(error, KeyError) else str(error)
            raise TrainingError(
                f"cannot go on from {self.folder / CHECKPOINT}: {what}; begin again in another folder, or go on with "
                "the code and the libraries that wrote it"
            ) from error

    def close(self) -> None:
        """Write out what TensorBoard still holds."""
        if "_events" in self.__dict__:
            self._events.close()

    @cached_property
    def _events(self) -> SummaryWriter:
        from torch.utils.tensorboard.writer import SummaryWriter

        return SummaryWriter(str(self.folder / EVENTS), purge_step=self._start + 1 if self._start else None)


def read_progress(folder: Path) -> list[dict[str, float]]:
    """Return the rows of a folder's progress.csv without their empty entries; none if there is no such file.

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
    """Return the rows as CSV, a column for each name that occurs in one of them."""
    buffer = io.StringIO()
    writer = csv.DictWriter(buffer, list(dict.fromkeys(key for row in rows for key in row)), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return buffer.getvalue()

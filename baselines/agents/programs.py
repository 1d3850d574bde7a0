"""Policies that are separate programs in any language: `cmd:./my_controller --option`.

The program reads lines of JSON from its standard input and answers each with a line on its standard output. The first
line is a greeting, then there is a batch of observations per control instant. `docs/programs.md` has the protocol and
examples.
"""

from __future__ import annotations

import json
import os
import shlex
import signal
import subprocess
import tempfile
import threading
import weakref
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from auv_gym.physics.vehicle import PAPER_VEHICLE, Vehicle
from auv_gym.scenarios.records import guarded, to_record
from auv_gym.task.observation import SIZE, TERMS, Observation, encode_observation
from auv_gym.task.preview import checked_preview
from baselines.agents.names import COMMAND
from baselines.policy import Batched, Memory, Starts

PROTOCOL = 1
"""Version of the protocol."""
START = 10.0
"""Time [s] that a program has for its first answer, and for every answer in addition to the time for its decisions."""
LONGEST_ANSWER = 2**22
"""Most bytes of an answer."""
DECISION = 0.1
"""Default time limit of a decision [s]."""
LONGEST_WAIT = 3600.0  # [s] for an answer if the time limit of a decision is infinite
FAREWELL = 0.5  # [s] that a program has to end by itself once its standard input is closed
LAST_WORDS = 300  # bytes of its standard error that messages quote

_EXAMPLE = Observation(*(0.0 for _ in Observation._fields))._replace(
    e_x=0.1, e_y=-0.1, psi_e=0.05, u_R=0.5, F_uR=35.0, cos_psi=1.0, F_u_max=400.0, F_r_max=200.0, dt=0.1
)
"""Observation that is sent once at the start as a test: a vehicle that moves straight ahead, close to its path."""


class ProgramError(ValueError):
    """A program cannot be started, has ended, does not answer in time, or sends a wrong answer."""


class ProgramPolicy(Batched):
    """A program as a policy. The memory is in the program, so it can control one set of vehicles at a time.

    Attributes:
        preview: the control periods ahead at which the observation holds the position of the reference.
        step_limit: time limit [s] for the decision of one vehicle, in addition to `START` for each answer.
    """

    def __init__(self, command: str, vehicle: Vehicle | None = None) -> None:
        """Start a program, send the greeting, and request a first action.

        Args:
            command: program and arguments.
            vehicle: the nominal one, which the greeting describes; None: the paper's.

        Raises:
            ProgramError: the program cannot be started, or an answer is wrong.
        """
        self.step_limit = DECISION
        self._program = _Program(command)
        nominal = PAPER_VEHICLE if vehicle is None else vehicle
        with self._program.errors():
            answer = self._program.ask(greeting(nominal), START)
            if unknown := sorted(set(answer) - {"preview"}):
                raise ProgramError(f"its greeting has the entry {unknown[0]!r}; allowed is only 'preview'")
            self.preview = checked_preview(answer.get("preview", []))
        ahead = [x for n in self.preview for x in (_EXAMPLE.u_R * _EXAMPLE.dt * n, 0.0)]
        self.predict(np.append(encode_observation(_EXAMPLE), ahead))

    def actions(
        self, rows: NDArray[Any], state: Memory | None, episode_start: Starts, deterministic: bool
    ) -> tuple[NDArray[np.float32], Memory | None]:
        """Ask the program; it is informed of the start of an episode if `state` is None or `episode_start` is True.

        The memory has no columns, since the program has its own. Raises ProgramError if there is no usable answer.
        """
        del deterministic
        n, width = len(rows), SIZE + 2 * len(self.preview)
        if rows.shape[1] != width:
            raise ValueError(f"observation has shape {rows.shape}; it must be ({width},) or (N, {width})")
        if state is not None and len(state[0]) != n:
            raise ValueError(f"state is of {len(state[0])} vehicles, the observation of {n}")
        begins = state is None or (False if episode_start is None else episode_start)
        starts = np.broadcast_to(np.asarray(begins, dtype=bool), n)
        question = {"observations": rows.tolist(), "starts": starts.tolist()}
        with self._program.errors():
            return _actions(self._program.ask(question, START + n * self.step_limit), n), (np.zeros((n, 0)),)


def greeting(vehicle: Vehicle) -> dict[str, Any]:
    """Return the first message to a program: version, observation, action and nominal vehicle."""
    return {
        "auv_gym": PROTOCOL,
        "observation": [term._asdict() for term in TERMS],
        "action": [{"name": name, "low": -1.0, "high": 1.0} for name in ("a_u", "a_r")],
        "vehicle": to_record(vehicle),
    }


def _actions(answer: Mapping[str, Any], n: int) -> NDArray[np.float32]:
    """Return the actions of an answer, shape (n, 2), finite or not."""
    rows = answer.get("actions")
    if not isinstance(rows, list) or set(answer) != {"actions"}:
        raise ProgramError(f"it answers {_cut(json.dumps(answer))}; it must be {{'actions': [[a_u, a_r], ...]}}")
    if len(rows) != n:
        raise ProgramError(f"it answers {len(rows)} actions for {n} observations")
    for i, row in enumerate(rows):
        pair = isinstance(row, list) and len(row) == 2
        if not pair or not all(isinstance(x, (int, float)) and not isinstance(x, bool) for x in row):
            raise ProgramError(f"its action {i} of {n} is {_cut(json.dumps(row))}; it must be two numbers")
    with guarded("its actions"), np.errstate(over="ignore"):  # too large floats become infinite: `Batched` rejects them
        return np.array(rows, dtype=np.float64).astype(np.float32)


class _Program:
    """A running program that answers questions; `end` kills it and its process group."""

    def __init__(self, command: str) -> None:
        self.command, pipe = command, subprocess.PIPE
        self._stderr = tempfile.TemporaryFile()  # noqa: SIM115, it is closed with the program
        weakref.finalize(self, self._stderr.close)
        try:
            words = shlex.split(command)
            if not words:
                raise ValueError("there is no command after cmd:")
            process = subprocess.Popen(
                words, bufsize=0, stdin=pipe, stdout=pipe, stderr=self._stderr, start_new_session=True
            )
        except OSError as error:
            raise ProgramError(f"cannot start {COMMAND}{command}: {error.strerror}: {error.filename}") from error
        except ValueError as error:
            raise ProgramError(f"cannot start {COMMAND}{command}: {error}") from error
        self._process, self.end = process, weakref.finalize(self, _end, process)

    @contextmanager
    def errors(self) -> Iterator[None]:
        """End the program if an error is raised, and name its command in the message of a ValueError."""
        try:
            yield
        except BaseException as error:
            self.end()
            if isinstance(error, ValueError):
                raise ProgramError(" ".join(f"{COMMAND}{self.command}: {error}".split())) from None
            raise

    def ask(self, question: Mapping[str, Any], seconds: float) -> dict[str, Any]:
        """Return the answer to a question; raise ProgramError if it is late or not a JSON object."""
        text, line = json.dumps(question, allow_nan=False).encode() + b"\n", bytearray()
        exchange = threading.Thread(target=_exchange, args=(self._process, text, line), daemon=True)
        exchange.start()
        exchange.join(min(seconds, LONGEST_WAIT))  # its child processes may keep the pipes open
        if exchange.is_alive():
            raise ProgramError(f"it has not answered for {seconds:.3g} s{self._last_words()}")
        if len(line) > LONGEST_ANSWER:
            raise ProgramError(f"its answer is longer than {LONGEST_ANSWER} bytes")
        if not line.endswith(b"\n"):
            raise ProgramError(self._ending())
        return _json_object(bytes(line))

    def _ending(self) -> str:
        """Return a message that says how the program has ended."""
        try:
            status = self._process.wait(FAREWELL)
        except subprocess.TimeoutExpired:
            return f"it has closed its standard output{self._last_words()}"
        how = f"by signal {signal.Signals(-status).name}" if status < 0 else f"with status {status}"
        return f"it has ended {how}{self._last_words()}"

    def _last_words(self) -> str:
        """Return the last line of the program's standard error for a message."""
        size = self._stderr.seek(0, os.SEEK_END)
        self._stderr.seek(max(size - LAST_WORDS, 0))
        lines = self._stderr.read().decode(errors="replace").strip().splitlines()
        return f"; the last line of its stderr: {lines[-1]}" if lines else ""


def _json_object(line: bytes) -> dict[str, Any]:
    """Return the JSON object of a line; raise ProgramError if it is something else, or reports an error."""
    first, _, more = line.partition(b"\n")
    if more:
        raise ProgramError(f"it answers with more than one line: {_cut(more.decode(errors='replace'))}")
    with guarded(f"it answers {_cut(first.decode(errors='replace'))}, which is not JSON; write other output to stderr"):
        answer = json.loads(first)
    if not isinstance(answer, dict):
        raise ProgramError(f"it answers {_cut(json.dumps(answer))}, which is not a JSON object")
    if isinstance(answer.get("error"), str):
        raise ProgramError(f"it reports: {answer['error'][:LAST_WORDS]}")
    return answer


def _cut(text: str) -> str:
    return text if len(text) <= 80 else f"{text[:77]}..."


def _exchange(process: subprocess.Popen[bytes], question: bytes, line: bytearray) -> None:
    """Write a question to a program and append its answer, up to the end of the line, to `line`."""
    assert process.stdin is not None
    assert process.stdout is not None
    with suppress(OSError, ValueError):  # the program has ended
        while question:
            question = question[process.stdin.write(question) :]
    with suppress(OSError, ValueError):  # the pipe was closed after the time limit
        while not line.endswith(b"\n") and len(line) <= LONGEST_ANSWER and (part := process.stdout.read(2**16)):
            line += part


def _end(process: subprocess.Popen[bytes]) -> None:
    """Close a program's standard input, then kill its process group if it still runs after `FAREWELL`."""
    with suppress(OSError, ValueError):
        if process.stdin is not None:
            process.stdin.close()
    with suppress(subprocess.TimeoutExpired):
        process.wait(FAREWELL)
    with suppress(OSError):
        if hasattr(os, "killpg"):
            os.killpg(process.pid, signal.SIGKILL)
        else:
            process.kill()
    process.wait()
    if process.stdout is not None:
        process.stdout.close()


def files_of(words: Sequence[str]) -> list[Path]:
    """Return the files that a command names: a word, or the part of a word after its first "="."""
    paths = dict.fromkeys(path for word in words for path in (word, word.partition("=")[2]))
    return [Path(path) for path in paths if os.path.isfile(path)]  # noqa: PTH113, a word of any kind

"""Programs in any language that answer lines of JSON: one line on standard input, one on standard output."""

from __future__ import annotations

import json
import os
import queue
import shlex
import signal
import subprocess
import tempfile
import threading
import time
import weakref
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from auv_gym.scenarios.records import guarded

COMMAND = "cmd:"
"""Prefix of a command line, where the name of a policy or a plant is allowed."""
LONGEST_ANSWER = 2**22
"""Most bytes of an answer."""
LONGEST_WAIT = 3600.0  # [s] for an answer if the time limit is infinite
FAREWELL = 0.5  # [s] that a program has to end by itself once its standard input is closed
LAST_WORDS = 300  # bytes of its standard error that messages quote
_AT_ONCE = 4096  # bytes that any pipe takes without waiting for its reader


class ProgramError(ValueError):
    """A program cannot be started, has ended, does not answer in time, or sends a wrong answer."""


class Program:
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
        self._answers: queue.SimpleQueue[bytes] = queue.SimpleQueue()
        threading.Thread(target=_read, args=(process, self._answers), daemon=True).start()
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
        end = time.monotonic() + min(seconds, LONGEST_WAIT)
        text = json.dumps(question, allow_nan=False).encode() + b"\n"
        if len(text) <= _AT_ONCE:
            _write(self._process, text)
        else:  # the program may not read it
            threading.Thread(target=_write, args=(self._process, text), daemon=True).start()
        try:  # its child processes may keep the pipes open
            line = self._answers.get(timeout=max(end - time.monotonic(), 0.0))
        except queue.Empty:
            raise ProgramError(f"it has not answered for {seconds:.3g} s{self._last_words()}") from None
        if len(line) > LONGEST_ANSWER:
            raise ProgramError(f"its answer is longer than {LONGEST_ANSWER} bytes")
        if not line.endswith(b"\n"):
            raise ProgramError(self._ending())
        return _json_object(line)

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
        raise ProgramError(f"it answers with more than one line: {cut(more.decode(errors='replace'))}")
    with guarded(f"it answers {cut(first.decode(errors='replace'))}, which is not JSON; write other output to stderr"):
        answer = json.loads(first)
    if not isinstance(answer, dict):
        raise ProgramError(f"it answers {cut(json.dumps(answer))}, which is not a JSON object")
    if isinstance(answer.get("error"), str):
        raise ProgramError(f"it reports: {answer['error'][:LAST_WORDS]}")
    return answer


def cut(text: str) -> str:
    """Return a text, shortened for a message."""
    return text if len(text) <= 80 else f"{text[:77]}..."


def _write(process: subprocess.Popen[bytes], text: bytes) -> None:
    """Write a line to a program."""
    assert process.stdin is not None
    with suppress(OSError, ValueError):  # the program has ended
        while text:
            text = text[process.stdin.write(text) :]


def _read(process: subprocess.Popen[bytes], answers: queue.SimpleQueue[bytes]) -> None:
    """Pass on the lines of a program; the last one is without an end of line, or is longer than `LONGEST_ANSWER`."""
    assert process.stdout is not None
    line = bytearray()
    with suppress(OSError, ValueError):  # the pipe was closed
        while len(line) <= LONGEST_ANSWER and (part := process.stdout.read(2**16)):
            line += part
            if line.endswith(b"\n"):
                answers.put(bytes(line))
                line.clear()
    answers.put(bytes(line))


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

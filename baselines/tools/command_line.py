"""What the command lines share: options from a dataclass, mistakes answered in one line, threads, and a tidy end."""

from __future__ import annotations

import contextlib
import io
import os
import shlex
import signal
import sys
import unicodedata
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextvars import ContextVar
from dataclasses import fields
from pathlib import Path
from typing import Any, NoReturn, TypeVar

import tyro
from threadpoolctl import threadpool_limits

Options = TypeVar("Options")

_called: ContextVar[str] = ContextVar("_called", default="")  # what the user has typed, while `run` runs it

DONE = 0  # exit status of a command that did its work
FAILED = 1  # exit status of a command that could not
WRONG_USAGE = 2  # exit status of a command with wrong arguments
THREADS = "OMP_NUM_THREADS"
"""Variable that says how many threads a process computes with; without it, one."""


class UsageError(Exception):
    """A user's mistake; the message says in one line what to change."""


class WorkerError(Exception):
    """A worker process was lost; the message says in one line what is known about it."""


def parse(options: type[Options], arguments: Sequence[str], program: str) -> Options:
    """Return the options given on a command line.

    Args:
        options: a dataclass; its docstring and those of its fields are the help.
        arguments: the words behind the program's name.
        program: its name, where it was not started by `run`.

    Raises:
        UsageError: the arguments do not fit.
        SystemExit: help was asked for, and printed.
    """
    program = called(program)
    if strange := [word for word in arguments if word != printable(word)]:
        raise UsageError(f"{strange[0]!r} holds characters that cannot be printed; leave them out")
    errors = io.StringIO()
    try:
        with contextlib.redirect_stderr(errors):
            return tyro.cli(options, prog=program, args=list(arguments))
    except SystemExit as end:
        if end.code in (None, 0):
            raise
        raise UsageError(f"{_first_paragraph(errors.getvalue())}; see {program} --help") from None


def printable(text: str) -> str:
    """Return a text without what a terminal would obey or no file could hold: control characters, lone surrogates."""
    return "".join(c if unicodedata.category(c) not in ("Cc", "Cs") else "\N{REPLACEMENT CHARACTER}" for c in text)


def _first_paragraph(box: str) -> str:
    """Return what stands between title and first rule of a message that tyro has drawn as a box, on one line.

    All that tyro offers besides is a hook in a private module, which it says may change in any release.
    """
    words: list[str] = []
    for row in box.splitlines()[1:]:
        if row.strip(" │─╰╯-"):
            words.append(row.strip(" │"))
        elif words:
            break
    return " ".join(words).strip(" .") or "the arguments are not understood"


def words_of(options: Any, defaults: Any) -> list[str]:
    """Return the words of a command line that turn one value of a dataclass into another.

    A field whose option is a word of Python has a `_` behind its name, such as `from_`.

    Args:
        options: what the words are to give.
        defaults: what is there without a word; of the same class.
    """
    words = []
    for f in fields(options):
        if (value := getattr(options, f.name)) != getattr(defaults, f.name):
            given = value if isinstance(value, tuple) else () if value is True else (value,)
            words += [f"--{f.name.rstrip('_').replace('_', '-')}", *map(str, given)]
    return words


def check_words(kind: str, given: Iterable[str], allowed: Iterable[str]) -> None:
    """Check words that the user has typed, of a kind such as "policy".

    Raises:
        UsageError: one is not allowed; the first of them is named, with what is.
    """
    known = tuple(allowed)
    if unknown := [word for word in given if word not in known]:
        raise UsageError(f"unknown {kind} {unknown[0]!r}; allowed are {', '.join(known)}")


@contextlib.contextmanager
def checked_record(file: Path, program: str) -> Iterator[None]:
    """Read within the block what a program has written to a file, to which it adds.

    Raises:
        UsageError: the block finds that the file holds something else.
    """
    try:
        yield
    except (ValueError, TypeError, KeyError, AttributeError):
        raise UsageError(f"{file} does not hold what {program} writes; delete it, or name another with --out") from None


def called(program: str) -> str:
    """Return what the user has typed to start this command: what `run` was told, else its own name."""
    return _called.get() or program


def typed(program: str, arguments: Sequence[str]) -> str:
    """Return the line that a user types to start this command with these arguments."""
    name = called(program)
    return f"{'python ' if name.endswith('.py') else ''}{name} {shlex.join(arguments)}".rstrip()


def run(command: Callable[[Sequence[str]], int], program: str, arguments: Sequence[str] | None = None) -> int:
    """Run a command and return its exit status; a mistake is one line on stderr.

    It computes with one thread unless `THREADS` says otherwise, and SIGTERM ends it as SIGINT does.

    Args:
        command: takes the arguments and returns the exit status.
        program: what the user has typed before them, for messages.
        arguments: None: those of this process.
    """
    status, line = FAILED, ""
    token = _called.set(program)
    try:
        with _terminable():
            set_threads()
            status = command(sys.argv[1:] if arguments is None else arguments)
        sys.stdout.flush()
    except UsageError as error:
        status, line = WRONG_USAGE, str(error)
    except WorkerError as error:
        line = str(error)
    except OSError as error:
        status, line = FAILED, f"cannot go on: {error}"
        _drop_output()
    except KeyboardInterrupt:
        line = "interrupted"
    finally:
        _called.reset(token)
    if line:
        print(f"{program}: {printable(' '.join(line.split()))}", file=sys.stderr)
    return status


def set_threads() -> None:
    """Make libraries compute with as many threads as `THREADS` says, those that are still to be loaded too.

    Without a word one: networks and batches here are small, and threads that wait for one another on a busy machine
    cost more than they bring.
    """
    count = os.environ.setdefault(THREADS, "1").partition(",")[0]
    if not count.isdecimal() or not 0 < int(count) <= 1024:
        raise UsageError(f"{THREADS} is {os.environ[THREADS]!r}; it must be an integer in [1, 1024]")
    threadpool_limits(int(count))


@contextlib.contextmanager
def _terminable() -> Iterator[None]:
    """Let SIGTERM unwind what is running, so that its worker processes end with it."""

    def end(*_: object) -> NoReturn:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _drop_output() -> None:
    """Let nothing more be written to stdout, which may be what has failed: the interpreter would try it at its end."""
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())

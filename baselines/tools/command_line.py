"""Shared parts of the command lines: options from a dataclass, errors as one line, number of threads, signals."""

from __future__ import annotations

import contextlib
import io
import itertools
import os
import re
import shlex
import signal
import sys
import tempfile
import unicodedata
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextvars import ContextVar
from dataclasses import fields
from functools import cache
from pathlib import Path
from typing import Annotated, Any, NoReturn, TypeVar, get_type_hints

import docstring_parser
import tyro
from threadpoolctl import threadpool_limits

from auv_gym.scenarios.records import meant

Options = TypeVar("Options")
T = TypeVar("T")

_called: ContextVar[str] = ContextVar("_called", default="")  # the command as typed by the user, while `run` runs it

DONE = 0  # exit status: success
FAILED = 1  # exit status: the command failed
WRONG_USAGE = 2  # exit status: wrong arguments
THREADS = "OMP_NUM_THREADS"
"""Environment variable with the number of threads of a process; the default is one."""


class UsageError(Exception):
    """A user's error; the message is one line that says what to change."""


class WorkerError(Exception):
    """A worker process ended unexpectedly; the message is one line with the reason, if it is known."""


def parse(options: type[Options], arguments: Sequence[str], program: str) -> Options:
    """Return the options given on a command line.

    Args:
        options: a dataclass; its docstring and those of its fields are the help.
        arguments: the words after the name of the program.
        program: name of the program, for a command that was not started by `run`.

    Raises:
        UsageError: the arguments are wrong.
        SystemExit: the user asked for the help, which has been printed.
    """
    program = called(program)
    if {"-h", "--help"} & {*arguments}:
        _join_lines(options)  # type: ignore[arg-type]
    if strange := [word for word in arguments if word != printable(word)]:
        raise UsageError(f"{strange[0]!r} contains characters that cannot be printed; leave them out")
    errors = io.StringIO()
    try:
        with contextlib.redirect_stderr(errors):
            return tyro.cli(options, prog=program, args=list(arguments), config=(tyro.conf.FlagCreatePairsOff,))
    except SystemExit as end:
        if end.code in (None, 0):
            raise
        text = _wrong_value(_first_paragraph(errors.getvalue()), options, arguments)
        known = [f"--{f.name.rstrip('_').replace('_', '-')}" for f in fields(options)]  # type: ignore[arg-type]
        words = (word.partition("=")[0] for word in arguments if word[:2] == "--" and word in text)
        hint = next((meant(word, known) for word in words if word not in known), "")
        raise UsageError(f"{text}{hint}; see {program} --help") from None


@cache
def _join_lines(options: Any) -> None:
    """Join the lines of the docstrings of fields, whose breaks the help would show, and leave out empty defaults."""
    hints, defaults = get_type_hints(options, include_extras=True), {f.name: f.default for f in fields(options)}
    for name, description in ((p.arg_name, p.description) for p in docstring_parser.parse_from_object(options).params):
        given: dict[str, Any] = {"help": " ".join((description or "").split())}
        if defaults[name] is False or defaults[name] in (None, "", ()):
            given["help_behavior_hint"] = ""
        if hints[name] in (int | None, float | None):
            given["metavar"] = "INT" if hints[name] == int | None else "FLOAT"
        options.__annotations__[name] = Annotated[hints[name], tyro.conf.arg(**given)]


def printable(text: str) -> str:
    """Return a text in which control characters and lone surrogates are replaced by the replacement character.

    A terminal would obey the first, and the second cannot be encoded as UTF-8.
    """
    return "".join(c if unicodedata.category(c) not in ("Cc", "Cs") else "\N{REPLACEMENT CHARACTER}" for c in text)


def checked_folder(folder: Path, option: str = "out") -> Path:
    """Return a folder after creating it if it does not exist, and check that it is writable.

    Args:
        folder: the folder.
        option: name of its option, for the message.

    Raises:
        UsageError: it is not writable.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise UsageError(f"--{option} {folder} is not a folder that can be written to: {error.strerror}") from error
    return folder


def described(error: BaseException) -> str:
    """Return the class and the message of an exception on one line; the message of a user's exception may fail."""
    try:
        text = " ".join(str(error).split())
    except Exception:  # noqa: BLE001
        text = "its message cannot be printed"
    return printable(f"{type(error).__name__}: {text}")


def _first_paragraph(box: str) -> str:
    """Return the first paragraph of an error message that tyro has drawn as a box, on one line.

    The only alternative is a hook in a private module of tyro, which may change in any release.
    """
    words: list[str] = []
    for row in box.splitlines()[1:]:
        if row.strip(" │─╰╯-"):
            words.append(row.strip(" │"))
        elif words:
            break
    return " ".join(words).strip(" .") or "the arguments are not understood"


def _wrong_value(text: str, options: type[Any], arguments: Sequence[str]) -> str:
    """Return an error message of tyro, or, for a value of a wrong type, one with the value and what is allowed."""
    if (found := re.match(r"Error parsing --([\w-]+):", text)) is None:
        return text
    option, name = f"--{found[1]}", found[1].replace("-", "_")
    hints = get_type_hints(options)
    hint = str(hints.get(name) or hints.get(f"{name}_"))
    if "int" not in hint and "float" not in hint:
        return text
    words = [word for given in arguments for word in (given.split("=", 1) if given.startswith(option) else [given])]
    given = itertools.takewhile(lambda word: word[:2] != "--", words[words.index(option) + 1 :])
    one, many = ("an integer", "integers") if "int" in hint else ("a number", "numbers")
    count = hint.count("float")
    allowed = one if "tuple" not in hint else many if "..." in hint else f"{count} {many}"
    return f"{option} is {' '.join(given)!r}; it must be {allowed}"


def words_of(options: Any, defaults: Any) -> list[str]:
    """Return the words of a command line that sets some options.

    A field whose option is a keyword of Python has a trailing `_`, such as `from_`.

    Args:
        options: a dataclass with the values to set.
        defaults: the values without any word; of the same class.
    """
    words = []
    for f in fields(options):
        if (value := getattr(options, f.name)) != getattr(defaults, f.name):
            given = value if isinstance(value, tuple) else () if value is True else (value,)
            words += [f"--{f.name.rstrip('_').replace('_', '-')}", *map(str, given)]
    return words


def check_words(kind: str, given: Iterable[str], allowed: Iterable[str]) -> None:
    """Check that the user has typed allowed words only; `kind`, such as "policy", is for the message.

    Raises:
        UsageError: a word is not allowed; the message has the first such word and the allowed ones.
    """
    known = tuple(allowed)
    if unknown := [word for word in given if word not in known]:
        raise UsageError(f"unknown {kind} {unknown[0]!r}{meant(unknown[0], known)}; allowed are {', '.join(known)}")


def called(program: str) -> str:
    """Return the command as the user has typed it: the argument of `run`, otherwise the command's own name."""
    return _called.get() or program


def typed(program: str, arguments: Sequence[str]) -> str:
    """Return the line that starts this command with these arguments."""
    name = called(program)
    return f"{'python ' if name.endswith('.py') else ''}{name} {shlex.join(arguments)}".rstrip()


def run(command: Callable[[Sequence[str]], int], program: str, arguments: Sequence[str] | None = None) -> int:
    """Run a command and return its exit status; an error is one line on stderr.

    The command computes with one thread unless `THREADS` has another number. SIGTERM ends it in the same way as SIGINT.

    Args:
        command: takes the arguments and returns the exit status.
        program: the words that the user has typed before the arguments, for messages.
        arguments: None: those of this process.
    """
    status, line, form = FAILED, "", warnings.formatwarning
    warnings.formatwarning = warned
    with contextlib.suppress(AttributeError):  # a stream of the caller's
        sys.stdout.reconfigure(errors="backslashreplace")  # type: ignore[union-attr]
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
        what = f"{error.filename}: {error.strerror}" if error.filename and error.strerror else str(error)
        status, line = FAILED, "" if isinstance(error, BrokenPipeError) else f"cannot continue: {what}"
        _drop_output()
    except KeyboardInterrupt:
        line = "interrupted"
    finally:
        _called.reset(token)
        warnings.formatwarning = form
    if line:
        print(f"{program}: {printable(' '.join(line.split()))}", file=sys.stderr)
    return status


def warned(message: Warning | str, *_: object, **__: object) -> str:
    """Return the line of a warning, without the place in the source."""
    return f"warning: {' '.join(str(message).split())}\n"


def set_threads() -> None:
    """Set the number of threads of all libraries, also of those that are loaded later, to the value of `THREADS`.

    The default is one: networks and batches are small here, so on a busy machine several threads take more time than
    one.

    Raises:
        UsageError: the value is no integer in [1, 1024].
    """
    count = os.environ.setdefault(THREADS, "1").partition(",")[0]
    if not count.isdecimal() or not 0 < int(count) <= 1024:
        raise UsageError(f"{THREADS} is {os.environ[THREADS]!r}; it must be an integer in [1, 1024]")
    threadpool_limits(int(count))


@contextlib.contextmanager
def _terminable() -> Iterator[None]:
    """Make SIGTERM raise KeyboardInterrupt, so that worker processes end with this process."""

    def end(*_: object) -> NoReturn:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _drop_output() -> None:
    """Redirect stdout to the null device: after a failed write the interpreter would try to flush it at exit."""
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def checked(make: Callable[[], T]) -> T:
    """Call a function, return its result, and turn OSError and ValueError into UsageError.

    Raises:
        UsageError: the function raised ValueError, or a file cannot be read.
    """
    try:
        return make()
    except OSError as error:
        raise UsageError(f"cannot read {error.filename}: {error.strerror}") from error
    except ValueError as error:
        raise UsageError(str(error)) from error

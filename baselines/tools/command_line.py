"""What the command lines share: options from a dataclass, and mistakes answered in one line."""

from __future__ import annotations

import contextlib
import io
import sys
import unicodedata
from collections.abc import Callable, Sequence
from typing import TypeVar

import tyro

Options = TypeVar("Options")

DONE, FAILED, WRONG_USAGE = 0, 1, 2
"""Exit statuses."""


class UsageError(Exception):
    """A user's mistake; the message says in one line what to change."""


def parse(options: type[Options], arguments: Sequence[str], program: str) -> Options:
    """Return the options given on a command line.

    Args:
        options: a dataclass; its docstring and those of its fields are the help.
        arguments: the words behind the program's name.
        program: its name.

    Raises:
        UsageError: the arguments do not fit.
        SystemExit: help was asked for, and printed.
    """
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
    """Return what stands between title and first rule of a message that tyro has drawn as a box, on one line."""
    words: list[str] = []
    for row in box.splitlines()[1:]:
        if row.strip(" │─╰╯-"):
            words.append(row.strip(" │"))
        elif words:
            break
    return " ".join(words).strip(" .") or "the arguments are not understood"


def run(command: Callable[[Sequence[str]], int], program: str) -> int:
    """Run a command on this process's arguments and return its exit status; a mistake is one line on stderr."""
    try:
        return command(sys.argv[1:])
    except UsageError as error:
        print(f"{program}: {printable(' '.join(str(error).split()))}", file=sys.stderr)
        return WRONG_USAGE
    except KeyboardInterrupt:
        print(f"{program}: interrupted", file=sys.stderr)
        return FAILED

"""Compare with measured runs: `python -m research validation --help`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from baselines.tools.command_line import DONE, UsageError, check_words, parse
from baselines.tools.files import json_text, read_json, write_atomically
from research.validation.navigation import FOLDER, compared
from research.validation.page import VALIDATION_FILE
from research.validation.vessels import VESSELS, cross_validated

PROGRAM = "python -m research validation"


@dataclass(frozen=True)
class Options:
    """Predict measured runs by models of other runs, and compare a Doppler log with the suite deep-v1.

    The folder has one folder for each source: kvlcc2-hsva, esso-osaka and snapir. docs/validation.md says where they
    are published. `python -m research pages validation` then writes the page.

    Exit status: 0 done, 2 wrong usage.
    """

    logs: Path
    """Folder of the measured runs."""
    only: tuple[str, ...] = ()
    """Sources to measure; the others keep their figures. Default: all."""
    out: Path = VALIDATION_FILE
    """File for the results."""


def main(arguments: Sequence[str]) -> int:
    """Compare with the measured runs and return the exit status.

    Raises:
        UsageError: the arguments are invalid.
        OSError: a file cannot be read or written.
    """
    options = parse(Options, arguments, PROGRAM)
    check_words("source", options.only, (*VESSELS, FOLDER))
    if not options.logs.is_dir():
        raise UsageError(f"--logs {options.logs} is no folder")
    records = dict(read_json(options.out)) if options.only and options.out.exists() else {}
    for name in options.only or (*VESSELS, FOLDER):
        try:
            records[name] = compared(options.logs) if name == FOLDER else cross_validated(name, options.logs)
        except ValueError as error:
            raise UsageError(str(error)) from error
        write_atomically(options.out, json_text(records))
    print(f"written: {options.out}")
    return DONE

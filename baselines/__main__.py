"""All commands in one: `auv-gym VERB`, or `python -m baselines VERB`, and `--help` behind either for a list."""

from __future__ import annotations

import ast
import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

import auv_gym
from auv_gym.installation import install

PROGRAM = "auv-gym"
PACKAGES = ("auv_gym", "baselines")
"""Where a module that is missing is no missing extra."""
WRONG_USAGE = 2  # exit status; `command_line` has it too, which needs an extra to be imported


class Verb(NamedTuple):
    """A command: `main(arguments)` of a module, whose docstring begins with a line about it."""

    module: str
    extras: str  # what it needs, with commas between them


VERBS = {
    "evaluate": Verb("baselines.evaluation.entry", "eval"),
    "train": Verb("baselines.training.entry", "train"),
    "train-all": Verb("baselines.training.shipped", "train"),
    "study": Verb("baselines.training.study.command", "train"),
    "residual": Verb("baselines.training.residual.command", "train"),
    "front": Verb("baselines.training.study.front", "train,tuning"),
    "tune": Verb("baselines.tuning.command", "tuning"),
    "suites": Verb("baselines.evaluation.suites.__main__", "eval"),
    "fresh": Verb("baselines.evaluation.fresh", "eval"),
    "results": Verb("baselines.evaluation.results.command", "eval"),
    "knows": Verb("baselines.evaluation.knows.command", "eval"),
    "submit": Verb("baselines.evaluation.submission.command", "eval"),
    "film": Verb("baselines.film.command", "eval,render"),
    "datasets": Verb("baselines.datasets", "data,eval"),
    "export": Verb("baselines.export.command", "export"),
    "live": Verb("baselines.live.command", "eval"),
    "identify": Verb("baselines.identification.command", "eval"),
    "bench": Verb("baselines.benchmarks.command", "train"),
}
"""The commands by name; a new one is a line here."""


def call(verb: str, arguments: Sequence[str], program: str) -> int:
    """Run a command and return its exit status; a missing package is one line on stderr that says what to install.

    Args:
        verb: one of `VERBS`.
        arguments: the words behind it.
        program: what the user has typed before them, for its messages.
    """
    try:
        from baselines.tools.command_line import run

        return run(import_module(VERBS[verb].module).main, program, arguments)
    except ModuleNotFoundError as error:
        missing = (error.name or PACKAGES[0]).partition(".")[0]
        if missing in PACKAGES:
            raise
        print(f"{program} needs {missing}: {install(VERBS[verb].extras)}", file=sys.stderr)
        return WRONG_USAGE


def about(verb: str) -> str:
    """Return the line about a command, read from its module, which is not imported."""
    file = Path(__file__).parent.joinpath(*VERBS[verb].module.split(".")[1:]).with_suffix(".py")
    text = ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or ""
    return text.partition("\n")[0].partition(": `")[0].rstrip(".")


def usage(program: str) -> str:
    """Return the list of the commands."""
    width = max(map(len, VERBS))
    lines = [f"  {verb:<{width}}  {about(verb)}" for verb in VERBS]
    head = f"usage: {program} VERB ...\n\nauv_gym {auv_gym.__version__}. {program} VERB --help says more of a verb.\n"
    return "\n".join((head, *lines))


def main() -> int:
    """Run the command that this process's arguments name and return its exit status."""
    called = Path(sys.argv[0])
    program = f"python -m {called.parent.name}" if called.name == "__main__.py" else called.stem
    verb, arguments = (sys.argv[1], sys.argv[2:]) if len(sys.argv) > 1 else ("", [])
    if verb in ("-h", "--help"):
        print(usage(program))
        return 0
    if verb == "--version":
        print(auv_gym.__version__)
        return 0
    if verb in VERBS:
        return call(verb, arguments, f"{program} {verb}")
    wrong = f"unknown verb {verb!r}" if verb else "no verb"
    print(f"{program}: {wrong}; allowed are {', '.join(VERBS)}; see {program} --help", file=sys.stderr)
    return WRONG_USAGE


if __name__ == "__main__":
    sys.exit(main())

"""The command `auv-gym COMMAND`, also `python -m baselines COMMAND`; `auv-gym --help` lists the commands."""

from __future__ import annotations

import ast
import signal
import sys
from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from importlib import import_module
from pathlib import Path
from typing import NamedTuple, NoReturn

import auv_gym
from auv_gym.installation import ROOT, install

PROGRAM = "auv-gym"
OWN_PACKAGES = ("auv_gym", "baselines", "research")
"""The project's own packages: a missing module of theirs is an error, not a missing extra."""
_WRONG_USAGE = 2  # exit status, as in `command_line`, which cannot be imported without an extra


class Command(NamedTuple):
    """A command: its module has the function `main(arguments)`, and a docstring whose first line describes it."""

    module: str
    extras: str  # the extras of the package that it needs, separated by commas


COMMANDS = {
    "evaluate": Command("baselines.evaluation.command", "eval"),
    "train": Command("baselines.training.command", "train"),
    "tune": Command("baselines.tuning.command", "tuning"),
    "identify": Command("baselines.identification.command", "eval"),
    "export": Command("baselines.export.command", "export"),
    "verify": Command("baselines.evaluation.verify", "eval"),
    "video": Command("baselines.video.command", "eval,render"),
}
"""The commands by name."""


def call(command: Command, arguments: Sequence[str], program: str) -> int:
    """Run a command and return its exit status; if a package is missing, one line on stderr says what to install.

    Args:
        command: an entry of `COMMANDS`.
        arguments: the words after the command's name.
        program: the words that the user has typed before the arguments, for messages.
    """
    try:
        from baselines.tools.command_line import run

        return run(import_module(command.module).main, program, arguments)
    except ModuleNotFoundError as error:
        missing = (error.name or OWN_PACKAGES[0]).partition(".")[0]
        if missing in OWN_PACKAGES:
            raise
        print(f"{program} needs {missing}: {install(command.extras)}", file=sys.stderr)
        return _WRONG_USAGE


def about(command: Command) -> str:
    """Return the first line of the docstring of a command's module, without importing the module."""
    file = ROOT.joinpath(*command.module.split(".")).with_suffix(".py")
    text = ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or ""
    return text.partition("\n")[0].partition(": `")[0].rstrip(".")


def usage(program: str, commands: Mapping[str, Command]) -> str:
    """Return the list of the commands."""
    width = max(map(len, commands))
    lines = [f"  {name:<{width}}  {about(command)}" for name, command in commands.items()]
    head = (
        f"usage: {program} COMMAND ...\n\nauv_gym {auv_gym.__version__}. Help of a command: {program} COMMAND --help\n"
        "The pages docs/*.md: https://auv-gym.github.io/auv_gym/\n"
    )
    return "\n".join((head, *lines))


def main(commands: Mapping[str, Command] = COMMANDS) -> int:
    """Run the command that is the first argument of this process, and return its exit status."""
    called = Path(sys.argv[0])
    program = f"python -m {called.parent.name}" if called.name == "__main__.py" else called.stem
    name, arguments = (sys.argv[1], sys.argv[2:]) if len(sys.argv) > 1 else ("", [])
    if name in ("-h", "--help"):
        print(usage(program, commands))
        return 0
    if name == "--version":
        print(auv_gym.__version__)
        return 0
    if name in commands:
        return call(commands[name], arguments, f"{program} {name}")
    mistake = f"unknown command {name!r}" if name else "no command"
    similar = get_close_matches(name, commands, 1)
    hint = f" (did you mean {similar[0]!r}?)" if similar else ""
    print(f"{program}: {mistake}{hint}; allowed are {', '.join(commands)}; see {program} --help", file=sys.stderr)
    return _WRONG_USAGE


def end(status: int) -> NoReturn:
    """End this process with an exit status; nothing is left to interrupt."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    sys.exit(status)


def script() -> NoReturn:
    """Run the command of this process, and end it."""
    end(main())


if __name__ == "__main__":
    script()

"""Write trained agents for other programs: `auv-gym export --help`."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from auv_gym.installation import install
from baselines.export.c_header import PREFIX, c_header
from baselines.export.parts import Exported, exported
from baselines.tools.command_line import DONE, UsageError, parse
from baselines.tools.files import write_atomically

PROGRAM = "auv-gym export"


@dataclass(frozen=True)
class Options:
    """Write an agent, its expert inside, as a C99 header and as an ONNX model.

    Exit status: 0 done, 2 wrong usage.

    Example: auv-gym export helm-any --vehicle lauv --format c
    """

    agent: Annotated[Positional[str], arg(metavar="AGENT")]
    """An agent's name or folder."""
    vehicle: Annotated[str, arg(metavar="V")] = "paper"
    """The vehicle that it is to steer, a published one by name or a .toml file: the files then take observations of
    that one, and an agent that is told the vehicle has it inside."""
    out: Path = Path("runs/export")
    """Folder of the files AGENT.h and AGENT.onnx."""
    format: Annotated[Literal["all", "c", "onnx"], arg(metavar="{all,c,onnx}")] = "all"
    """What is written."""
    precision: Annotated[Literal["float32", "float64"], arg(metavar="{float32,float64}")] = "float32"
    """Of all numbers."""
    weights: Annotated[Literal["float32", "int8"], arg(metavar="{float32,int8}")] = "float32"
    """How the header stores the network's matrices; int8 takes a fourth of the memory and costs accuracy."""
    prefix: str = PREFIX
    """What the header's names begin with; it must differ for two agents in one program."""


def main(arguments: Sequence[str]) -> int:
    """Write what the arguments say and return the exit status.

    Raises:
        UsageError: the arguments do not make sense, or a library is missing.
        OSError: a file cannot be read or written.
    """
    options = parse(Options, arguments, PROGRAM)
    if not re.fullmatch(r"[a-z][a-z0-9_]*", options.prefix):
        raise UsageError(f"prefix is {options.prefix!r}; it must be lower-case letters, digits and underscores")
    try:
        agent = exported(options.agent, options.vehicle)
    except ValueError as error:
        raise UsageError(str(error)) from None
    files = {
        f".{kind}": _made(agent, kind, options) for kind in ("h", "onnx") if options.format in ("all", _OPTION[kind])
    }
    options.out.mkdir(parents=True, exist_ok=True)
    for ending, content in files.items():
        file = options.out / f"{agent.name}{ending}"
        write_atomically(file, content)
        print(f"written: {file} ({len(content):,} bytes)")
    return DONE


_OPTION = {"h": "c", "onnx": "onnx"}


def _made(agent: Exported, kind: str, options: Options) -> bytes:
    """Return the content of a file."""
    if kind == "h":
        return c_header(agent, options.precision, options.weights, options.prefix).encode()
    try:
        from baselines.export.onnx_model import onnx_model

        model: bytes = onnx_model(agent, options.precision).SerializeToString()
    except ImportError:
        raise UsageError(f"ONNX needs its library: {install('export')}, or choose --format c") from None
    return model

"""Export trained agents as C headers and ONNX models: `auv-gym export --help`."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from auv_gym.installation import install
from auv_gym.scenarios.vehicles import PAPER
from baselines.export.c_header import PREFIX, c_header
from baselines.export.parts import Exported, exported
from baselines.tools.command_line import DONE, UsageError, checked_folder, parse
from baselines.tools.files import write_atomically

PROGRAM = "auv-gym export"


@dataclass(frozen=True)
class Options:
    """Write an agent, together with its expert, as a C99 header and as an ONNX model.

    Exit status: 0 done, 2 wrong usage.

    Example: auv-gym export helm-any --vehicle lauv --format c
    """

    agent: Annotated[Positional[str], arg(metavar="AGENT")]
    """Name or folder of an agent."""
    vehicle: Annotated[str, arg(metavar="V")] = "paper"
    """The vehicle: name of a published one, or a .toml file. The exported agent takes observations of this vehicle. If
    the agent needs the vehicle's parameters, they are in the files."""
    out: Path = Path("runs/export")
    """Folder of the files AGENT.h and AGENT.onnx, or AGENT-VEHICLE.h and so on. Files of these names are replaced."""
    format: Annotated[Literal["all", "c", "onnx"], arg(metavar="{all,c,onnx}")] = "all"
    """Format of the files."""
    precision: Annotated[Literal["float32", "float64"], arg(metavar="{float32,float64}")] = "float32"
    """Type of all numbers."""
    weights: Annotated[Literal["float32", "int8"], arg(metavar="{float32,int8}")] = "float32"
    """Type of the network's matrices in the header; int8 needs a quarter of the memory and is less accurate."""
    prefix: str = PREFIX
    """Prefix of the header's names; two agents in one program need different prefixes."""


def main(arguments: Sequence[str]) -> int:
    """Write the files and return the exit status.

    Raises:
        UsageError: the arguments are wrong, or a library is missing.
        OSError: a file cannot be read or written.
    """
    options = parse(Options, arguments, PROGRAM)
    if not re.fullmatch(r"[a-z][a-z0-9_]*", options.prefix):
        raise UsageError(f"prefix is {options.prefix!r}; it must be lower-case letters, digits and underscores")
    try:
        agent = exported(options.agent, options.vehicle)
    except ValueError as error:
        raise UsageError(str(error)) from None
    if options.vehicle != PAPER.name:
        agent = replace(agent, name=f"{agent.name}-{Path(options.vehicle).stem}")
    checked_folder(options.out)
    files: dict[str, bytes] = {}
    if options.format in ("all", "c"):
        files[".h"] = c_header(agent, options.precision, options.weights, options.prefix).encode()
    if options.format in ("all", "onnx"):
        files[".onnx"] = _onnx(agent, options.precision)
    for suffix, content in files.items():
        file = options.out / f"{agent.name}{suffix}"
        write_atomically(file, content)
        print(f"written: {file} ({len(content):,} bytes)")
    return DONE


def _onnx(agent: Exported, precision: str) -> bytes:
    """Return the content of the ONNX file.

    Raises:
        UsageError: onnx is not installed.
    """
    try:
        from baselines.export.onnx_model import onnx_model

        model: bytes = onnx_model(agent, precision).SerializeToString()
    except ImportError:
        raise UsageError(f"ONNX needs its library: {install('export')}, or choose --format c") from None
    return model

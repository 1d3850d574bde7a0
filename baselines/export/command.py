"""Export trained agents as C headers and ONNX models: `auv-gym export --help`."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from auv_gym.scenarios.vehicles import PAPER
from baselines.export.c_header import PREFIX, c_header
from baselines.export.parts import exported
from baselines.tools.command_line import DONE, UsageError, checked, checked_folder, parse
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
    """Run the command; see `run` of `baselines.tools.command_line`."""
    options = parse(Options, arguments, PROGRAM)
    if not re.fullmatch(r"[a-z][a-z0-9_]*", options.prefix):
        raise UsageError(f"prefix is {options.prefix!r}; it must be lower-case letters, digits and underscores")
    agent = checked(partial(exported, options.agent, options.vehicle))
    if options.vehicle != PAPER.name:
        agent = replace(agent, name=f"{agent.name}-{Path(options.vehicle).stem}")
    checked_folder(options.out)
    files: dict[str, bytes] = {}
    if options.format in ("all", "c"):
        files[".h"] = c_header(agent, options.precision, options.weights, options.prefix).encode()
    if options.format in ("all", "onnx"):
        from baselines.export.onnx_model import onnx_model

        files[".onnx"] = onnx_model(agent, options.precision).SerializeToString()
    for suffix, content in files.items():
        file = options.out / f"{agent.name}{suffix}"
        write_atomically(file, content)
        print(f"written: {file} ({len(content):,} bytes)")
    return DONE

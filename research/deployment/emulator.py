"""Run the C header of an agent on an emulated Cortex-M4: its commands, its instructions and its memory.

QEMU counts instructions, not cycles. A Cortex-M4 takes one to a few cycles for each, and more if its flash is slow.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from baselines.export.c_header import PREFIX, c_header
from baselines.export.parts import Exported

_FOLDER = Path(__file__).parent / "cortex_m4"
COMPILER = "arm-none-eabi-gcc"  # Debian's gcc-arm-none-eabi, with libnewlib-arm-none-eabi
_SIZE = "arm-none-eabi-size"  # Debian's binutils-arm-none-eabi
EMULATOR = "qemu-system-arm"  # Debian's package of that name
PROGRAMS = (COMPILER, _SIZE, EMULATOR)
"""Programs that must be installed."""
_FLAGS = ("-mcpu=cortex-m4", "-mthumb", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard", "-std=c99", "-O2", "-Wall", "-Wextra")
"""Options of the compiler for a Cortex-M4 with floating-point unit."""
_SOURCE = f'#define {PREFIX.upper()}_IMPLEMENTATION\n#include "{PREFIX}.h"\n'
"""C source with the functions of the header only, to measure their size and stack."""
INSTRUCTIONS_IN_A_TICK = 40
"""The system timer of the board runs at 25 MHz, and QEMU is set to 1 ns for an instruction."""
_TIMEOUT = 120.0
"""Longest run of a program [s]."""


@dataclass(frozen=True)
class Emulated:
    """Results of a run on the emulated processor."""

    commands: NDArray[np.float32]  # shape (K, 2)
    instructions: float  # mean number for one decision
    code: int  # [bytes] code and constants
    memory: int  # [bytes] memory of the agent between decisions
    stack: int  # [bytes] largest stack


def emulated(agent: Exported, observations: NDArray[Any], memories: NDArray[Any], weights: str = "float32") -> Emulated:
    """Run an agent in single precision on K observations and return the results.

    Args:
        agent: the agent whose header runs.
        observations: shape (K, n).
        memories: the memory of the agent before each decision, as numbers of the header's struct, shape (K, m).
        weights: storage of the weights, see `c_header.c_header`.

    Raises:
        OSError: a program is missing or fails.
    """
    if missing := [name for name in PROGRAMS if shutil.which(name) is None]:
        raise OSError(f"not installed: {', '.join(missing)}")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / f"{PREFIX}.h").write_text(c_header(agent, "float32", weights), encoding="utf-8")
        tables = _table("observations", observations) + _table("memories", memories)
        inputs = f"enum {{ DECISIONS = {len(observations)} }};\n{tables}"
        (folder / "inputs.h").write_text(inputs, encoding="utf-8")
        (folder / "agent.c").write_text(_SOURCE, encoding="utf-8")
        _run(folder, COMPILER, *_FLAGS, "-fstack-usage", "-c", "agent.c", "-o", "agent.o")
        sizes = _run(folder, _SIZE, "agent.o").splitlines()[1].split()
        stack = sum(int(line.split("\t")[1]) for line in (folder / "agent.su").read_text().splitlines())
        source = str(_FOLDER / "main.c")
        link = ("-I.", "-nostartfiles", "-T", str(_FOLDER / "link.ld"), "-lm")
        _run(folder, COMPILER, *_FLAGS, source, *link, "-o", "agent.elf")
        board = ("-M", "mps2-an386", "-nographic", "-monitor", "none", "-serial", "none", "-icount", "shift=0")
        semihosting = ("-semihosting-config", "enable=on,target=native")
        text = _run(folder, EMULATOR, *board, *semihosting, "-kernel", "agent.elf")
    rows = re.findall(r"^([0-9a-f]{8}) ([0-9a-f]{8}) ([0-9a-f]{8})$", text, re.MULTILINE)
    if len(rows) != len(observations):
        raise OSError(f"{EMULATOR} printed {len(rows)} decisions of {len(observations)}: {text[-200:]!r}")
    bits = np.array([[int(x, 16) for x in row] for row in rows], dtype=np.uint32)
    instructions = INSTRUCTIONS_IN_A_TICK * float(bits[:, 2].mean())
    commands = np.ascontiguousarray(bits[:, :2]).view(np.float32)
    memory = 4 * (sum(agent.memory.values()) + 2)
    return Emulated(commands, instructions, int(sizes[0]) + int(sizes[1]), memory, stack)


def _table(name: str, table: NDArray[Any]) -> str:
    """Return an array of two dimensions as the definition of a C array."""
    rows = ",\n".join(f"{{{', '.join(f'{x!r}f' for x in row)}}}" for row in table.astype(np.float32).tolist())
    count, size = table.shape
    return f"static const float {name}[{count}][{size}] = {{\n{rows}\n}};\n"


def _run(folder: Path, *command: str) -> str:
    """Run a program and return its output; raise OSError if it fails."""
    try:
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=_TIMEOUT, check=True)
    except subprocess.CalledProcessError as error:
        raise OSError(f"{command[0]} fails: {error.stderr.strip()[-500:]}") from error
    except subprocess.TimeoutExpired as error:
        raise OSError(f"{command[0]} takes longer than {_TIMEOUT:g} s") from error
    return done.stdout + done.stderr

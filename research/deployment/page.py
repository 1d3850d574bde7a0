"""Tables of docs/export-cost.md: exported agents compared with the agents on NumPy."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from baselines.evaluation.score import fixed, fixed_ends
from baselines.tools.files import read_json
from research import DATA
from research.pages import table

MEASURED_FILE = DATA / "deployment.json"
"""File that `research.deployment.measure` writes."""


def agreement_section() -> str:
    """Return the table of the largest differences of commands and of the loss of score with int8 weights."""
    heads = ("agent", "ONNX", "header", "score", "loss with int8", "interval")
    record = read_json(MEASURED_FILE)
    rows = [
        (
            a["name"],
            *(f"{a[k]:.1e}" for k in ("onnx32", "c32")),
            fixed(a["score"]),
            fixed(a["lost8"][0], 4),
            fixed_ends(a["lost8"][1:], 4),
        )
        for a in record["agents"]
    ]
    return f"Scores are of the first {record['episodes']} episodes of each cell.\n\n{table(heads, rows)}"


def speed_section() -> str:
    """Return the table of the processor time of a decision on a computer, and of the sizes of the exported files."""
    heads = ("agent", "NumPy", "ONNX Runtime", "header", "header's size", "model's size")
    times, sizes = ("numpy_us", "onnx_us", "c_us"), ("header", "model")
    return table(
        heads, [(a["name"], *(f"{a[k]:.1f} us" for k in times), *(_kibibytes(a[k]) for k in sizes)) for a in _agents()]
    )


def cortex_m4_section() -> str:
    """Return the table of the cost of a decision on the emulated Cortex-M4."""
    heads = ("on the Cortex-M4", "instructions", "code", "code, int8", "memory", "stack")
    sizes = ("code", "code8", "memory", "stack")
    return table(
        heads,
        [(a["name"], f"{a['instructions']:,.0f}", *(_kibibytes(a[k]) for k in sizes)) for a in _agents()],
    )


def _agents() -> Sequence[dict[str, Any]]:
    agents: Sequence[dict[str, Any]] = read_json(MEASURED_FILE)["agents"]
    return agents


def _kibibytes(size: int) -> str:
    return f"{size / 1024:.1f} KiB"

"""C code of a graph for eight vehicles at a time, for equations of hundreds of rows.

The arrays of a block have a fixed size, so the compiler does not store an address for each row. Long equations are
split into several functions. Both make the compilation and the compiled code several times faster. Values that are
carried from step to step stay in the block. An incomplete block is filled up with copies of its last vehicle. One
vehicle is therefore computed by the same instructions as many, and gives the same bits.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import NamedTuple

from auv_gym.codegen.graph import TRUTHS, Graph
from auv_gym.codegen.printing import C_CLOSING, Arrays, Layout, c_language, c_opening, written_statements

_BLOCK = 8
"""Vehicles in a block: the number of double-precision values that the widest registers hold."""
LONGEST_PART = 5_000
"""Largest number of characters of a part. The compilation time grows faster than linearly with it."""
_NAME = re.compile(r"[A-Za-z_]\w*")


class _Statement(NamedTuple):
    target: str  # a variable, or an entry of a result
    text: str  # the expression
    truth: bool  # whether the value is a truth value
    named: bool  # whether the target is a variable that other statements may use


def c_block_function(name: str, graph: Graph, arguments: Arrays, results: Arrays, layout: Layout) -> str:
    """Return the C source of a function with the interface of `printing.c_function` that computes block by block."""
    parts, saved = _parts(graph, arguments, results, layout.precision)
    rows = {array: len(entries) for array, entries in {**arguments, **results}.items()}
    blocks = {f"block_{a}": len(entries) for a, entries in arguments.items()}
    blocks |= {f"after_{a}": len(entries) for a, entries in results.items()} | {"kept": max(saved, 1)}
    taken = ", ".join(f"real (*restrict {block})[{_BLOCK}]" for block in blocks)
    lines = [
        *(line for i, part in enumerate(parts) for line in _function(f"{name}_{i}", taken, part)),
        *c_opening(name, arguments, results, layout),
        *(f"real {block}[{count}][{_BLOCK}] __attribute__((aligned(64)));" for block, count in blocks.items()),
        f"for (long b = 0; steps > 0 && b < n; b += {_BLOCK}) {{",
        f"const long full = n - b < {_BLOCK} ? n - b : {_BLOCK};",
        *(_read(a, rows[a], layout) for a in arguments if a not in layout.over_time),
        "for (long j = 0; j < steps; j++) {",
        f"const long k = {'first + steps - 1 - j' if layout.back else 'first + j'};",
        *(_read(a, rows[a], layout) for a in arguments if a in layout.over_time),
        *(f"{name}_{i}({', '.join(blocks)});" for i in range(len(parts))),
        *(f"memcpy(block_{a}, after_{a}, sizeof block_{a});" for a in results if a in arguments),
        *(_write(a, rows[a], layout) for a in results if a in layout.over_time),
        "}",
        *(_write(a, rows[a], layout) for a in results if a not in layout.over_time),
        "}",
        *C_CLOSING,
        "}",
    ]
    return "#include <string.h>\n" + "\n".join(lines) + "\n"


def _parts(graph: Graph, arguments: Arrays, results: Arrays, precision: str) -> tuple[list[list[str]], int]:
    """Return the statements of each part for one vehicle, and the number of values that parts keep for later parts."""
    outputs = [s for entries in results.values() for s in entries]
    inputs = {s.node[1]: f"block_{a}[{j}][i]" for a, entries in arguments.items() for j, s in enumerate(entries)}
    statements, texts = written_statements(graph, outputs, c_language(precision), {entry: entry for entry in inputs})
    whole = [_Statement(target, text, truth, True) for target, text, truth in statements]
    places = (f"after_{a}[{j}][i]" for a, entries in results.items() for j in range(len(entries)))
    for place, text, entry in zip(places, texts, outputs, strict=True):
        truth = graph.nodes[entry.index][0] in TRUTHS
        whole.append(_Statement(place, f"({text} ? (real)1 : (real)0)" if truth else text, False, False))
    cut = _cut(whole)
    defined = {s.target: (i, s.truth) for i, part in enumerate(cut) for s in part if s.named}
    saved: dict[str, int] = {}
    for i, part in enumerate(cut):
        for used in _used(part):
            if used in defined and defined[used][0] < i:
                saved.setdefault(used, len(saved))
    return [_completed(i, part, inputs, defined, saved) for i, part in enumerate(cut)], len(saved)


def _cut(statements: list[_Statement]) -> list[list[_Statement]]:
    """Return the statements in parts of at most `LONGEST_PART` characters, or of one longer statement."""
    parts: list[list[_Statement]] = [[]]
    length = 0
    for statement in statements:
        length += len(statement.text)
        if length > LONGEST_PART and parts[-1]:
            parts.append([])
            length = len(statement.text)
        parts[-1].append(statement)
    return parts


def _used(part: list[_Statement]) -> list[str]:
    """Return the names that a part uses, sorted and without repetition."""
    return sorted({name for statement in part for name in _NAME.findall(statement.text)})


def _completed(
    i: int,
    part: list[_Statement],
    inputs: Mapping[str, str],
    defined: Mapping[str, tuple[int, bool]],
    saved: Mapping[str, int],
) -> list[str]:
    """Return the lines of part i: its inputs, its statements, and the assignments of values that later parts use."""
    lines = []
    for name in _used(part):
        if name in inputs:
            lines.append(f"const real {name} = {inputs[name]};")
        elif name in defined and defined[name][0] < i:
            place, truth = f"kept[{saved[name]}][i]", defined[name][1]
            lines.append(f"const int {name} = {place} > (real)0;" if truth else f"const real {name} = {place};")
    for target, text, truth, named in part:
        kind = ("const int " if truth else "const real ") if named else ""
        lines.append(f"{kind}{target} = {text};")
        if target in saved:
            lines.append(f"kept[{saved[target]}][i] = {f'({target} ? (real)1 : (real)0)' if truth else target};")
    return lines


def _function(name: str, taken: str, lines: list[str]) -> list[str]:
    """Return the lines of the C function that computes one part for one block."""
    head = [f"static __attribute__((noinline)) void {name}({taken})", "{", "#pragma omp simd"]
    return [*head, f"for (int i = 0; i < {_BLOCK}; i++) {{", *lines, "}", "}"]


def _read(array: str, rows: int, layout: Layout) -> str:
    """Return the loops that copy an array to a block; the last vehicle fills the rest of an incomplete block."""
    loops = f"for (long r = 0; r < {rows}; r++) for (int i = 0; i < {_BLOCK}; i++)"
    target, entry = f"block_{array}[r][i]", layout.entry(array, "r")
    if array in layout.shared:
        return f"{loops} {target} = {entry};"
    whole, part = (entry.replace("+ i]", f"+ b + {i}]") for i in ("i", "(i < full ? i : full - 1)"))
    return f"if (full == {_BLOCK}) {loops} {target} = {whole}; else {loops} {target} = {part};"


def _write(array: str, rows: int, layout: Layout) -> str:
    """Return the loops that copy a block to an array."""
    copy = f"{layout.entry(array, 'r').replace('+ i]', '+ b + i]')} = after_{array}[r][i];"
    whole, part = (f"for (long r = 0; r < {rows}; r++) for (int i = 0; i < {end}; i++)" for end in (_BLOCK, "full"))
    return f"if (full == {_BLOCK}) {whole} {copy} else {part} {copy}"

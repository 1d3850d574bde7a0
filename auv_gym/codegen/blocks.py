"""A graph as C for eight vehicles at a time, for equations of hundreds of rows.

Where each row of an array begins is known beforehand in a block of eight, so that a compiler need not keep an address
for each: it is done several times sooner, and so is what it makes. What is carried from step to step stays in the
block. A block that is not full is filled up with its last vehicle, so that one is computed as many are, bit for bit.
"""

from __future__ import annotations

from collections.abc import Collection

from auv_gym.codegen.graph import TRUTHS, Graph
from auv_gym.codegen.printing import Arrays, c_language, written

LANES = 8  # as many numbers of double precision as the widest registers hold


def c_block_function(
    name: str, graph: Graph, arguments: Arrays, results: Arrays, over_time: Collection[str], precision: str, back: bool
) -> str:
    """Return the source of a C function that does the same as that of `printing.c_function`, block by block."""
    rows = {array: len(entries) for array, entries in {**arguments, **results}.items()}
    parameters = [f"{'' if a in results else 'const '}real *restrict {a}" for a in rows]
    lines = [
        *_one_block(name, graph, arguments, results, precision),
        f"void {name}({', '.join(('long n', 'long first', 'long steps', *parameters))})",
        "{",
        *(f"real block_{a}[{count}][{LANES}] __attribute__((aligned(64)));" for a, count in rows.items()),
        f"for (long b = 0; steps > 0 && b < n; b += {LANES}) {{",
        f"const long full = n - b < {LANES} ? n - b : {LANES};",
        *(_read(a, rows[a], "0") for a in arguments if a not in over_time),
        "for (long j = 0; j < steps; j++) {",
        f"const long k = {'first + steps - 1 - j' if back else 'first + j'};",
        *(_read(a, rows[a], "k") for a in arguments if a in over_time),
        f"{name}_block({', '.join(f'block_{a}' for a in rows)});",
        *(_write(a, rows[a], "k") for a in results if a in over_time),
        "}",
        *(_write(a, rows[a], "0") for a in results if a not in over_time),
        "}",
        "}",
    ]
    return "\n".join(lines) + "\n"


def _one_block(name: str, graph: Graph, arguments: Arrays, results: Arrays, precision: str) -> list[str]:
    """Return the function that computes one step of one block."""
    wanted = [s for entries in results.values() for s in entries]
    read = {graph.nodes[i][1] for i in graph.needed(s.index for s in wanted) if graph.nodes[i][0] == "input"}
    given = {s.node[1]: f"{a}[{j}][i]" for a, own in arguments.items() for j, s in enumerate(own)}
    statements, texts = written(graph, wanted, c_language(precision), {entry: entry for entry in read})
    parameters = [f"real (*restrict {a})[{LANES}]" for a in {**arguments, **results}]
    lines = [
        f"static __attribute__((noinline)) void {name}_block({', '.join(parameters)})",
        "{",
        "#pragma omp simd",
        f"for (int i = 0; i < {LANES}; i++) {{",
    ]
    lines += [f"const real {entry} = {given[entry]};" for entry in sorted(read)]
    lines += [f"const {'int' if truth else 'real'} {target} = {text};" for target, text, truth in statements]
    values = iter(texts)
    for array, entries in results.items():
        for j, entry in enumerate(entries):
            value = next(values)
            truth = graph.nodes[entry.index][0] in TRUTHS
            lines.append(f"{array}[{j}][i] = {f'({value} ? (real)1 : (real)0)' if truth else value};")
    return [*lines, "}", "}"]


def _read(array: str, rows: int, step: str) -> str:
    """Return the loops that fill a block from an array; behind the last vehicle it is repeated."""
    target, entry = f"block_{array}[r][i]", f"{array}[({step} * {rows} + r) * n + b +"
    loops = f"for (long r = 0; r < {rows}; r++) for (int i = 0; i < {LANES}; i++)"
    whole, part = f"{loops} {target} = {entry} i];", f"{loops} {target} = {entry} (i < full ? i : full - 1)];"
    return f"if (full == {LANES}) {whole} else {part}"


def _write(array: str, rows: int, step: str) -> str:
    """Return the loops that bring a block back to an array."""
    copy = f"{array}[({step} * {rows} + r) * n + b + i] = block_{array}[r][i];"
    whole, part = (f"for (long r = 0; r < {rows}; r++) for (int i = 0; i < {end}; i++)" for end in (LANES, "full"))
    return f"if (full == {LANES}) {whole} {copy} else {part} {copy}"

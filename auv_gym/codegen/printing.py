"""Printers of a graph: Python on floats or NumPy rows, and C for many vehicles."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from auv_gym.codegen.graph import TRUTHS, Graph, Symbol, arguments_of

_DEEPEST = 12
"""Largest depth of a nested expression; a deeper one is assigned to a variable."""
Arrays = Mapping[str, Sequence[Symbol]]
"""The rows of arrays by the names of the arrays."""


@dataclass(frozen=True)
class Language:
    """The syntax of operations and constants in a language."""

    forms: Mapping[str, str]  # expression of each operation with its arguments {0}, {1}, ...
    named: frozenset[str]  # operations whose expression repeats an argument, which must therefore be a variable
    number: Callable[[float | bool], str]  # returns the expression of a constant


def _python_number(value: float | bool) -> str:
    if isinstance(value, bool) or math.isfinite(value):
        return f"({value!r})"
    return "nan" if math.isnan(value) else "inf" if value > 0 else "(-inf)"


ARITHMETIC = {  # the same in every language
    "add": "({0} + {1})",
    "sub": "({0} - {1})",
    "mul": "({0} * {1})",
    "div": "({0} / {1})",
    "neg": "(-{0})",
    "lt": "({0} < {1})",
    "le": "({0} <= {1})",
}
FUNCTIONS = ("sin", "cos", "exp", "log", "sqrt", "floor", "single", "abs")  # printed by their names
PYTHON = Language(
    {
        **ARITHMETIC,
        **{name: f"{name}({{0}})" for name in FUNCTIONS},
        "arctan2": "arctan2({0}, {1})",
        "clip": "clip({0}, {1}, {2})",
        "where": "where({0}, {1}, {2})",
        "and": "({0} & {1})",
        "or": "({0} | {1})",
        "not": "({0} ^ True)",
    },
    frozenset(),
    _python_number,
)
"""Python, on floats or on NumPy rows of shape (N,), whose functions are those of a `Namespace`."""


def c_language(precision: str) -> Language:
    """Return C on numbers of a precision, "float64" or "float32"."""
    suffix = "f" if precision == "float32" else ""

    def number(value: float | bool) -> str:
        if isinstance(value, bool):
            return str(int(value))
        if not math.isfinite(value):
            return "NAN" if math.isnan(value) else "INFINITY" if value > 0 else "(-INFINITY)"
        return f"({float(value).hex()}{suffix})"

    forms = {
        **ARITHMETIC,
        **{name: f"{name}{suffix}({{0}})" for name in ("sin", "cos", "exp", "log", "sqrt", "floor")},
        "arctan2": f"atan2{suffix}({{0}}, {{1}})",
        "abs": f"fabs{suffix}({{0}})",
        "single": "((real)(float){0})",
        "clip": "({0} < {1} ? {1} : {0} > {2} ? {2} : {0})",
        "where": "({0} ? {1} : {2})",
        "and": "({0} && {1})",  # gcc does not vectorise & and |
        "or": "({0} || {1})",
        "not": "(!{0})",
    }
    return Language(forms, frozenset(("clip",)), number)


def written_statements(
    graph: Graph, outputs: Sequence[Symbol], language: Language, inputs: Mapping[str, str]
) -> tuple[list[tuple[str, str, bool]], list[str]]:
    """Return statements, (variable, expression, whether it is a truth value), and the expressions of the outputs.

    A node that is used once is nested in the expression that uses it, up to the depth `_DEEPEST`.

    Args:
        graph: the graph of the outputs.
        outputs: the symbols to compute.
        language: the syntax.
        inputs: the expression of each input by its name in the graph.
    """
    order = graph.needed(s.index for s in outputs)
    uses = Counter(a for i in order for a in arguments_of(graph.nodes[i]))
    uses.update(s.index for s in outputs)
    named = {a for i in order if graph.nodes[i][0] in language.named for a in arguments_of(graph.nodes[i])}
    text: dict[int, str] = {}
    depth: dict[int, int] = {}
    statements = []
    for i in order:
        operation, *arguments = graph.nodes[i]
        depth[i] = 0
        if operation == "input":
            text[i] = inputs[arguments[0]]
        elif operation == "constant":
            text[i] = language.number(arguments[0])
        else:
            text[i] = language.forms[operation].format(*(text[a] for a in arguments))
            depth[i] = 1 + max(depth[a] for a in arguments)
            if uses[i] > 1 or i in named or depth[i] > _DEEPEST:
                statements.append((f"v{i}", text[i], operation in TRUTHS))
                text[i], depth[i] = f"v{i}", 0
    return statements, [text[s.index] for s in outputs]


def python_function(name: str, graph: Graph, arguments: Arrays, results: Sequence[Symbol]) -> str:
    """Return the source of a Python function that takes a sequence for each array and returns a tuple of results."""
    inputs = {s.node[1]: s.node[1] for rows in arguments.values() for s in rows}
    statements, outputs = written_statements(graph, results, PYTHON, inputs)
    lines = [f"def {name}({', '.join(arguments)}):"]
    lines += [f"    {', '.join(s.node[1] for s in rows)}, = {array}" for array, rows in arguments.items() if rows]
    lines += [f"    {target} = {expression}" for target, expression, _ in statements]
    return "\n".join((*lines, f"    return ({''.join(f'{output}, ' for output in outputs)})")) + "\n"


@dataclass(frozen=True)
class Layout:
    """The memory layout of a kernel's arrays, and the order of its steps."""

    over_time: frozenset[str]  # names of the arrays with values for each step
    shared: frozenset[str]  # names of the arrays whose values are shared by all vehicles
    precision: str  # type of all numbers, "float64" or "float32"
    back: bool  # whether the steps run from the last to the first
    blocked: bool = False  # whether the C code computes eight vehicles at a time, see `blocks`

    def strides(self, array: str) -> tuple[str, ...]:
        """Return the C variables of an array's strides; the last axis has none."""
        kinds = (("time", array in self.over_time), ("row", array not in self.shared))
        return tuple(f"{array}_{kind}" for kind, exists in kinds if exists)

    def entry(self, array: str, row: int | str) -> str:
        """Return the C expression of an array's row for vehicle i at step k."""
        time = f"k * {array}_time + " if array in self.over_time else ""
        return f"{array}[{time}{row}]" if array in self.shared else f"{array}[{time}{row} * {array}_row + i]"


def c_opening(name: str, arguments: Arrays, results: Arrays, layout: Layout) -> list[str]:
    """Return the first lines of a C function, see `c_function`: the declarations of its arrays and their strides."""
    lines, at = [f"void {name}(const int64_t *at, int first, int steps)", "{", "const long n = (long)at[0];"], 1
    for array in {**arguments, **results}:
        kind = f"{'' if array in results else 'const '}real *restrict"
        lines.append(f"{kind} {array} = ({kind})at[{at}];")
        strides = layout.strides(array)
        lines += [f"const long {stride} = (long)at[{at + 1 + j}];" for j, stride in enumerate(strides)]
        at += 1 + len(strides)
    return lines


C_CLOSING = ("#ifdef __AVX__", "__builtin_ia32_vzeroupper();", "#endif")
"""Last lines of a C function: they clear the wide registers, since other code is slower while these are in use."""


def c_function(name: str, graph: Graph, arguments: Arrays, results: Arrays, layout: Layout) -> str:
    """Return the source of a C function that computes n vehicles for `steps` steps, from step `first` on.

        void NAME(const int64_t *at, int first, int steps)

    `at` holds n and then, for each array, its address and the strides of all axes except the last, in numbers. The
    arguments come first, then the results that are not arguments. A call from Python with these three arguments takes
    less time than a step of a vehicle. An array that is an argument and a result is carried from step to step. Truth
    values become 0 and 1.

    Args:
        name: the name of the function.
        graph: the graph of the results.
        arguments: the arrays that the function reads.
        results: the arrays that the function writes.
        layout: the layout of the arrays.
    """
    wanted = [s for entries in results.values() for s in entries]
    read = {graph.nodes[i][1] for i in graph.needed(s.index for s in wanted) if graph.nodes[i][0] == "input"}
    places = {s.node[1]: layout.entry(array, j) for array, rows in arguments.items() for j, s in enumerate(rows)}
    statements, texts = written_statements(
        graph, wanted, c_language(layout.precision), {entry: entry for entry in read}
    )
    lines = [
        *c_opening(name, arguments, results, layout),
        "for (long j = 0; j < steps; j++) {",
        f"const long k = {'first + steps - 1 - j' if layout.back else 'first + j'};",
        "#pragma omp simd",
        "for (long i = 0; i < n; i++) {",
    ]
    lines += [f"const real {entry} = {places[entry]};" for entry in sorted(read)]
    lines += [f"const {'int' if truth else 'real'} {target} = {text};" for target, text, truth in statements]
    values = iter(texts)
    for array, entries in results.items():
        for j, entry in enumerate(entries):
            target, value = layout.entry(array, j), next(values)
            if places.get(value) != target:  # an unchanged entry is not written
                truth = graph.nodes[entry.index][0] in TRUTHS
                lines.append(f"{target} = {f'({value} ? (real)1 : (real)0)' if truth else value};")
    return "\n".join((*lines, "}", "}", *C_CLOSING, "}")) + "\n"

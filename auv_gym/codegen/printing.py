"""Printers: a graph as flat Python on floats or on NumPy rows, as C for many vehicles side by side, or in JavaScript.

What `plain` makes of one vehicle in C or JavaScript is written in the languages of this module too.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from auv_gym.codegen.graph import TRUTHS, Graph, Symbol, arguments_of

_DEEPEST = 12
"""Levels of expressions that are written into one another before a result gets a name."""
Arrays = Mapping[str, Sequence[Symbol]]
"""The rows of arrays, by the arrays' names."""


@dataclass(frozen=True)
class Language:
    """How operations are written."""

    forms: Mapping[str, str]  # an operation with its arguments {0}, {1}, ...
    named: frozenset[str]  # operations that write an argument more than once, so that it must be a name
    number: Callable[[float | bool], str]


def _python_number(value: float | bool) -> str:
    if isinstance(value, bool) or math.isfinite(value):
        return f"({value!r})"
    return "nan" if math.isnan(value) else "inf" if value > 0 else "(-inf)"


ARITHMETIC = {  # what every language writes alike
    "add": "({0} + {1})",
    "sub": "({0} - {1})",
    "mul": "({0} * {1})",
    "div": "({0} / {1})",
    "neg": "(-{0})",
    "lt": "({0} < {1})",
    "le": "({0} <= {1})",
}
FUNCTIONS = ("sin", "cos", "exp", "log", "sqrt", "floor", "single", "abs")  # called by their names
PYTHON = Language(
    {
        **ARITHMETIC,
        **{name: f"{name}({{0}})" for name in FUNCTIONS},
        "arctan2": "arctan2({0}, {1})",
        "clip": "({1} if {0} < {1} else {2} if {0} > {2} else {0})",
        "where": "({1} if {0} else {2})",
        "and": "({0} and {1})",
        "or": "({0} or {1})",
        "not": "(not {0})",
    },
    frozenset(("clip",)),
    _python_number,
)
"""On floats."""
NUMPY = Language(
    {
        **PYTHON.forms,
        "clip": "clip({0}, {1}, {2})",
        "where": "where({0}, {1}, {2})",
        "and": "({0} & {1})",
        "or": "({0} | {1})",
        "not": "(~{0})",
    },
    frozenset(),
    _python_number,
)
"""On rows of shape (N,)."""


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
        "and": "({0} && {1})",  # with & and | gcc would not vectorise
        "or": "({0} || {1})",
        "not": "(!{0})",
    }
    return Language(forms, frozenset(("clip",)), number)


def _javascript_number(value: float | bool) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if not math.isfinite(value):
        return "NaN" if math.isnan(value) else "Infinity" if value > 0 else "(-Infinity)"
    text = repr(value).removesuffix(".0")
    return f"({text})" if text[0] == "-" else text


JAVASCRIPT = Language(
    {
        **ARITHMETIC,
        **{name: f"Math.{name}({{0}})" for name in ("sin", "cos", "exp", "log", "sqrt", "floor", "abs")},
        "arctan2": "Math.atan2({0}, {1})",
        "single": "Math.fround({0})",
        "clip": "({0} < {1} ? {1} : {0} > {2} ? {2} : {0})",
        "where": "({0} ? {1} : {2})",
        "and": "({0} && {1})",
        "or": "({0} || {1})",
        "not": "(!{0})",
    },
    frozenset(("clip",)),
    _javascript_number,
)
"""On JavaScript's numbers, which are of double precision; it contracts no product with a sum."""


def written_statements(
    graph: Graph, outputs: Sequence[Symbol], language: Language, inputs: Mapping[str, str]
) -> tuple[list[tuple[str, str, bool]], list[str]]:
    """Return statements, (name, expression, whether it is a truth value), and the expressions of some outputs then.

    A result that is used once is written into the expression that uses it, unless that grows too deep.

    Args:
        graph: what the outputs are nodes of.
        outputs: what is to be computed.
        language: how it is written.
        inputs: what each input is called, by its name in the graph.
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


def python_function(name: str, graph: Graph, arguments: Arrays, results: Sequence[Symbol], language: Language) -> str:
    """Return the source of a Python function that takes a sequence for each array and returns the results' tuple."""
    inputs = {s.node[1]: s.node[1] for rows in arguments.values() for s in rows}
    statements, outputs = written_statements(graph, results, language, inputs)
    lines = [f"def {name}({', '.join(arguments)}):"]
    lines += [f"    {', '.join(s.node[1] for s in rows)}, = {array}" for array, rows in arguments.items() if rows]
    lines += [f"    {target} = {expression}" for target, expression, _ in statements]
    return "\n".join((*lines, f"    return ({''.join(f'{output}, ' for output in outputs)})")) + "\n"


@dataclass(frozen=True)
class Layout:
    """How the arrays of a kernel lie in memory, and in which order its steps are taken."""

    over_time: frozenset[str]  # names of arrays that have rows for each step
    shared: frozenset[str]  # names of arrays that hold one number a row for all vehicles
    precision: str  # of all numbers, "float64" or "float32"
    back: bool  # whether the steps are taken from the last one to the first
    blocked: bool = False  # whether the C goes through eight vehicles at a time, see `blocks`

    def strides(self, array: str) -> tuple[str, ...]:
        """Return what the strides of an array's axes are called in C, of all axes but the last."""
        kinds = (("time", array in self.over_time), ("row", array not in self.shared))
        return tuple(f"{array}_{kind}" for kind, there in kinds if there)

    def entry(self, array: str, row: int | str) -> str:
        """Return a row of an array in C, for vehicle i at step k."""
        time = f"k * {array}_time + " if array in self.over_time else ""
        return f"{array}[{time}{row}]" if array in self.shared else f"{array}[{time}{row} * {array}_row + i]"


def c_opening(name: str, arguments: Arrays, results: Arrays, layout: Layout) -> list[str]:
    """Return the first lines of a C function, see `c_function`: where each array is, and its strides."""
    lines, at = [f"void {name}(const int64_t *at, int first, int steps)", "{", "const long n = (long)at[0];"], 1
    for array in {**arguments, **results}:
        kind = f"{'' if array in results else 'const '}real *restrict"
        lines.append(f"{kind} {array} = ({kind})at[{at}];")
        strides = layout.strides(array)
        lines += [f"const long {stride} = (long)at[{at + 1 + j}];" for j, stride in enumerate(strides)]
        at += 1 + len(strides)
    return lines


C_CLOSING = ("#ifdef __AVX__", "__builtin_ia32_vzeroupper();", "#endif")
"""What stands at the end of a C function: other code waits for the wide registers unless they are zero."""


def c_function(name: str, graph: Graph, arguments: Arrays, results: Arrays, layout: Layout) -> str:
    """Return the source of a C function for n vehicles and some steps, one after the other, from step `first` on.

        void NAME(const int64_t *at, int first, int steps)

    `at` holds n and then, of each array, the address and the strides of all axes but the last, in numbers; arguments
    come first, results that are no arguments behind. A call from Python with so few and plain arguments costs less than
    a step of a vehicle. An array that is argument and result at once is carried from step to step. Truth values become
    0 and 1.

    Args:
        name: of the function.
        graph: what the results are nodes of.
        arguments: the arrays that it reads.
        results: the arrays that it writes.
        layout: of the arrays.
    """
    wanted = [s for entries in results.values() for s in entries]
    read = {graph.nodes[i][1] for i in graph.needed(s.index for s in wanted) if graph.nodes[i][0] == "input"}
    given = {s.node[1]: layout.entry(array, j) for array, own in arguments.items() for j, s in enumerate(own)}
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
    lines += [f"const real {entry} = {given[entry]};" for entry in sorted(read)]
    lines += [f"const {'int' if truth else 'real'} {target} = {text};" for target, text, truth in statements]
    values = iter(texts)
    for array, entries in results.items():
        for j, entry in enumerate(entries):
            target, value = layout.entry(array, j), next(values)
            if given.get(value) != target:  # what stays as it is need not be written
                truth = graph.nodes[entry.index][0] in TRUTHS
                lines.append(f"{target} = {f'({value} ? (real)1 : (real)0)' if truth else value};")  # vectorises
    return "\n".join((*lines, "}", "}", *C_CLOSING, "}")) + "\n"

"""Kernels: equations on rows, traced once, that run as compiled C, or as printed Python if there is no compiler."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property, partial
from typing import Any

import numpy as np

from auv_gym.codegen import native
from auv_gym.codegen.blocks import c_block_function
from auv_gym.codegen.elementary import lowered
from auv_gym.codegen.graph import OPERATIONS, Graph, Symbol, floor
from auv_gym.codegen.printing import NUMPY, PYTHON, Arrays, Language, Layout, c_function, python_function
from auv_gym.physics.namespaces import ARRAYS, AnyArray

Equation = Callable[..., Mapping[str, Sequence[Any]]]
"""A function that takes the rows of each argument by name, as symbols, and returns the rows of each result by name."""
KernelRun = Callable[[int, int], None]
"""A function `run(first, steps)` that computes this number of steps from step `first` on."""

_DTYPES = {name: np.dtype(name) for name in ("float32", "float64")}
_MATH = {name: getattr(math, name) for name in ("sin", "cos", "exp", "log", "sqrt", "inf", "nan")}


@dataclass(frozen=True, eq=False)
class Kernel:
    """An equation on rows of n vehicles, for one or several steps.

    The shape of an array is (rows, n), or (rows,) if its values are shared by all vehicles. An array with values for
    each step has the shape (T, rows, n) or (T, rows). An array that is an argument and a result is carried from step to
    step. Any other result holds the values of the last step, unless it has values for each step.
    """

    name: str
    graph: Graph
    arguments: Arrays
    results: Arrays
    layout: Layout

    @classmethod
    def traced(
        cls,
        equation: Equation,
        rows: Mapping[str, int],
        over_time: Sequence[str] = (),
        *,
        shared: Sequence[str] = (),
        precision: str = "float64",
        back: bool = False,
        structural: bool = False,
        blocked: bool = False,
    ) -> Kernel:
        """Return the kernel of an equation, which is run once on symbols.

        Args:
            equation: see `Equation`; its namespace must be `graph.SYMBOLS`.
            rows: number of rows of each argument.
            over_time: names of the arguments and results with values for each step.
            shared: names of the arguments whose values are shared by all vehicles.
            precision: "float64" or "float32", the type of all numbers.
            back: whether the steps run from the last to the first.
            structural: see `Graph`.
            blocked: whether the C code computes eight vehicles at a time, for equations of more than a hundred rows.
        """
        graph = Graph(structural)
        arguments = {array: [graph.input(f"{array}_{j}") for j in range(n)] for array, n in rows.items()}
        results = {array: [graph.symbol(x) for x in given] for array, given in equation(**arguments).items()}
        layout = Layout(frozenset(over_time), frozenset(shared), precision, back, blocked)
        return cls("auv_kernel", graph, arguments, results, layout)

    def __getstate__(self) -> dict[str, Any]:
        """Return the fields; cached values, some of them addresses in this process, are left out."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @cached_property
    def rows(self) -> dict[str, int]:
        """Number of rows of each array, in the order of the compiled function's arguments."""
        return {array: len(entries) for array, entries in {**self.arguments, **self.results}.items()}

    @cached_property
    def source(self) -> str:
        """The C source."""
        return self._head + self._code(self.name)

    @property
    def _head(self) -> str:
        real = "float" if self.layout.precision == "float32" else "double"
        return f"#include <math.h>\n#include <stdint.h>\ntypedef {real} real;\n"

    def _code(self, name: str) -> str:
        """Return the C source of the kernel's function with this name."""
        flat = lowered(self.graph, self._outputs, self.layout.precision)
        results, at = {}, 0
        for array, entries in self.results.items():
            results[array], at = flat[at : at + len(entries)], at + len(entries)
        printed = c_block_function if self.layout.blocked else c_function
        return printed(name, self.graph, self.arguments, results, self.layout)

    @property
    def _outputs(self) -> list[Symbol]:
        return [s for entries in self.results.values() for s in entries]

    def _native(self, n: int) -> Any:
        """Return the compiled function for n vehicles; None without a compiler.

        The function for one vehicle is compiled in a fraction of the time. If the function for many vehicles exists, it
        is used for one as well.
        """
        if not self._compiled or (n > 1 and True not in self._compiled):
            self._compiled[n > 1] = _function(native.library(self.source, many=n > 1), self.name)
        return self._compiled.get(True, self._compiled.get(False))

    @cached_property
    def _compiled(self) -> dict[bool, Any]:
        """The compiled functions, by whether they are for many vehicles."""
        return {}

    @cached_property
    def _on_floats(self) -> Callable[..., tuple[Any, ...]]:
        return self._python(PYTHON, {**_MATH, "arctan2": math.atan2, "floor": floor, "single": OPERATIONS["single"]})

    @cached_property
    def _on_rows(self) -> Callable[..., tuple[Any, ...]]:
        names = {name: getattr(ARRAYS, name) for name in ("sin", "cos", "sqrt", "arctan2", "floor", "clip", "where")}
        names |= {"exp": np.exp, "log": np.log, "inf": math.inf, "nan": math.nan, "single": _single_rows}
        return self._python(NUMPY, names)

    def _python(self, language: Language, names: dict[str, Any]) -> Callable[..., tuple[Any, ...]]:
        """Return the printed function, whose source uses these global names."""
        source = python_function(self.name, self.graph, self.arguments, self._outputs, language)
        exec(compile(source, f"<{self.name}>", "exec"), names)
        function: Callable[..., tuple[Any, ...]] = names[self.name]
        return function

    def bound(self, **arrays: AnyArray) -> KernelRun:
        """Return a function that reads and writes these arrays.

        To be fast, it does not check that the steps are within the arrays; the caller must ensure this.

        Raises:
            ValueError: an array is missing, unknown, of another shape or type, or its last axis is not contiguous.
        """
        n = self._checked(arrays)
        if (function := self._native(n)) is None:
            return self._on_one(arrays) if n == 1 else self._on_several(arrays)
        table = self._table(arrays, n)
        run = partial(function, ctypes.c_void_p(table.__array_interface__["data"][0]))  # faster than a closure
        run.__dict__["kept"] = table, arrays  # references, as long as the addresses are used
        return run

    def _table(self, arrays: Mapping[str, AnyArray], n: int) -> AnyArray:
        """Return the first argument of the compiled function, see `c_function`."""
        entries, size = [n], _DTYPES[self.layout.precision].itemsize
        for name, _, strides in self._axes:
            array = arrays[name]
            entries.append(array.__array_interface__["data"][0])  # takes half the time of `array.ctypes`
            entries += [stride // size for stride in array.strides[:strides]]
        return np.array(entries, dtype=np.int64)

    @cached_property
    def _axes(self) -> list[tuple[str, int, int]]:
        """Name, number of rows and number of strides of each array."""
        return [(name, rows, len(self.layout.strides(name))) for name, rows in self.rows.items()]

    def _checked(self, arrays: Mapping[str, AnyArray]) -> int:
        """Return the number of vehicles; raise ValueError for wrong arrays, see `bound`."""
        if arrays.keys() != self.rows.keys():
            raise ValueError(f"the kernel takes arrays {', '.join(self.rows)}; given are {', '.join(arrays)}")
        n: int = next(a.shape[-1] for name, a in arrays.items() if name not in self.layout.shared)
        dtype = _DTYPES[self.layout.precision]
        for name, rows, _ in self._axes:
            array, step = arrays[name], (rows,) if name in self.layout.shared else (rows, n)
            over_time = name in self.layout.over_time
            if array.dtype != dtype or array.shape[over_time:] != step or array.ndim != over_time + len(step):
                shape = ("T", *step) if over_time else step
                raise ValueError(
                    f"array {name} is of type {array.dtype} and shape {array.shape}; it must be of type "
                    f"{self.layout.precision} and of shape ({', '.join(map(str, shape))}{',' * (len(shape) == 1)})"
                )
            if array.strides[-1] != array.itemsize and array.size and array.shape[-1] > 1:
                raise ValueError(f"the last axis of array {name} is not contiguous; it must be contiguous")
        return n

    def _steps(self, first: int, steps: int) -> Iterable[int]:
        return range(first + steps - 1, first - 1, -1) if self.layout.back else range(first, first + steps)

    def _split(self, values: tuple[Any, ...]) -> Iterator[tuple[str, tuple[Any, ...]]]:
        """Yield the name and the values of each result."""
        at = 0
        for name, entries in self.results.items():
            yield name, values[at : at + len(entries)]
            at += len(entries)

    def _on_one(self, arrays: Mapping[str, AnyArray]) -> KernelRun:
        """Return the function of `bound` for one vehicle, on floats."""
        function = self._on_floats

        def run(first: int, steps: int) -> None:
            time = slice(first, first + steps)
            rows = {name: self._only(name, array, time).tolist() for name, array in arrays.items()}
            for k in self._steps(0, steps):
                given = [rows[n][k] if n in self.layout.over_time else rows[n] for n in self.arguments]
                try:
                    values = function(*given)
                except (ArithmeticError, ValueError):  # NumPy gives inf or nan, as C does
                    values = self._without_errors(given)
                for name, own in self._split(values):
                    if name in self.layout.over_time:
                        rows[name][k] = own
                    else:
                        rows[name] = own
            for name in self.results if steps else ():
                self._only(name, arrays[name], time)[:] = rows[name]

        return run

    def _only(self, name: str, array: AnyArray, time: slice) -> AnyArray:
        """Return the values of the only vehicle in an array."""
        part = array[time] if name in self.layout.over_time else array
        return part if name in self.layout.shared else part[..., 0]

    def _without_errors(self, given: Iterable[Any]) -> tuple[Any, ...]:
        """Return the results for one vehicle; inf or nan where Python raises an error."""
        with np.errstate(all="ignore"):
            return tuple(map(float, self._on_rows(*map(np.array, given))))

    def _on_several(self, arrays: Mapping[str, AnyArray]) -> KernelRun:
        """Return the function of `bound` for several vehicles, on rows."""
        function = self._on_rows

        def run(first: int, steps: int) -> None:
            for k in self._steps(first, steps):
                at = {name: a[k] if name in self.layout.over_time else a for name, a in arrays.items()}
                with np.errstate(all="ignore"):
                    values = function(
                        *(at[name].copy() if name in self.results else at[name] for name in self.arguments)
                    )
                for name, own in self._split(values):
                    for row, value in zip(at[name], own, strict=True):
                        row[:] = value

        return run

    def __call__(self, steps: int = 1, /, **arguments: AnyArray) -> dict[str, AnyArray]:
        """Return new arrays with the results of the first `steps` steps; the arguments are not changed.

        Raises:
            ValueError: an array is missing, unknown, of another shape, or has fewer steps.
        """
        given = {name: np.ascontiguousarray(a, dtype=_DTYPES[self.layout.precision]) for name, a in arguments.items()}
        if short := [name for name in given if name in self.layout.over_time and len(given[name]) < steps]:
            raise ValueError(f"array {short[0]} has {len(given[short[0]])} steps; it must have at least {steps}")
        n = next(a.shape[-1] for name, a in given.items() if name not in self.layout.shared)
        results = {name: given[name].copy() if name in given else self._empty(name, steps, n) for name in self.results}
        arrays = {**given, **results}
        if (function := self._native(n)) is None:
            self.bound(**arrays)(0, steps)
        else:  # faster than `bound`
            table = self._table(arrays, self._checked(arrays))
            function(ctypes.c_void_p(table.__array_interface__["data"][0]), 0, steps)
        return results

    def _empty(self, name: str, steps: int, n: int) -> AnyArray:
        shape = (steps, self.rows[name], n) if name in self.layout.over_time else (self.rows[name], n)
        return np.empty(shape, dtype=_DTYPES[self.layout.precision])


def together(kernels: Mapping[str, Kernel], code: str = "", *, many: bool = True) -> Any:
    """Compile kernels of one precision as one library, and let the kernels use its functions.

    This takes less time than one library for each kernel.

    Args:
        kernels: the kernels by the names of their functions.
        code: further C code, appended to these functions; it may call them.
        many: whether the code is compiled for several vehicles at once, which takes twice the time.

    Returns:
        The library, a `ctypes.CDLL`; None without a compiler.
    """
    head = next(iter(kernels.values()))._head
    library = native.library("".join((head, *(k._code(name) for name, k in kernels.items()), code)), many=many)
    for name, kernel in kernels.items():
        function = _function(library, name)
        kernel._compiled[many] = function
        kernel._compiled.setdefault(True, function)
    return library


def _function(library: Any, name: str) -> Any:
    if library is None:
        return None
    function = library[name]
    function.restype = None
    return function


def _single_rows(x: AnyArray) -> AnyArray:
    return np.asarray(x, dtype=np.float32).astype(np.float64)

"""Kernels: an equation on rows, traced once, that runs as compiled C, or without a compiler as printed Python."""

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
from auv_gym.codegen.graph import EXACT, Graph, Symbol, floor
from auv_gym.codegen.printing import NUMPY, PYTHON, Arrays, Language, Layout, c_function, python_function
from auv_gym.physics.namespaces import ARRAYS, AnyArray

Equation = Callable[..., Mapping[str, Sequence[Any]]]
"""Takes the rows of each array by its name, as symbols, and returns rows by the names of the arrays they are for."""
KernelRun = Callable[[int, int], None]
"""Goes through so many steps from a first one on: `run(first, steps)`."""

_REAL = {name: np.dtype(name) for name in ("float32", "float64")}
_FLOAT_SPACE = {name: getattr(math, name) for name in ("sin", "cos", "exp", "log", "sqrt", "inf", "nan")}


@dataclass(frozen=True, eq=False)
class Kernel:
    """An equation on rows of n vehicles, which may go through several steps at once.

    Arrays are of shape (rows, n), or (rows,) where they hold the same for all vehicles; where they hold something else
    at each step, of shape (T, rows, n) or (T, rows). An array that is among arguments and results is carried from step
    to step; another result is that of the last step, unless it is over time.
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
        """Return the kernel of an equation, which is run once, on symbols.

        Args:
            equation: see `Equation`; it must compute with `graph.SYMBOLS`.
            rows: how many rows each of its arguments has.
            over_time: names of the arrays, arguments or results, that hold something else at each step.
            shared: names of the arguments that hold the same for all vehicles.
            precision: of all numbers, "float64" or "float32".
            back: whether to go from the last step to the first.
            structural: see `Graph`.
            blocked: whether to go through eight vehicles at a time: for equations of more than a hundred rows.
        """
        graph = Graph(structural)
        arguments = {array: [graph.input(f"{array}_{j}") for j in range(n)] for array, n in rows.items()}
        results = {array: [graph.symbol(x) for x in given] for array, given in equation(**arguments).items()}
        layout = Layout(frozenset(over_time), frozenset(shared), precision, back, blocked)
        return cls("auv_kernel", graph, arguments, results, layout)

    def __getstate__(self) -> dict[str, Any]:
        """Return everything but what is made of it when it is needed, among it addresses in this process."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @cached_property
    def rows(self) -> dict[str, int]:
        """How many rows each array has, in the order in which the compiled function takes them."""
        return {array: len(entries) for array, entries in {**self.arguments, **self.results}.items()}

    @cached_property
    def source(self) -> str:
        """The kernel in C."""
        return self._head + self._code(self.name)

    @property
    def _head(self) -> str:
        real = "float" if self.layout.precision == "float32" else "double"
        return f"#include <math.h>\n#include <stdint.h>\ntypedef {real} real;\n"

    def _code(self, name: str) -> str:
        """Return the function of a name that `source` is made of."""
        flat = lowered(self.graph, self._wanted, self.layout.precision)
        results, at = {}, 0
        for array, entries in self.results.items():
            results[array], at = flat[at : at + len(entries)], at + len(entries)
        printed = c_block_function if self.layout.blocked else c_function
        return printed(name, self.graph, self.arguments, results, self.layout)

    @property
    def _wanted(self) -> list[Symbol]:
        return [s for entries in self.results.values() for s in entries]

    def _native(self, n: int) -> Any:
        """Return the compiled function for n vehicles; None where there is none.

        That for one vehicle takes a compiler a fraction of the time. What is compiled already is preferred to that.
        """
        if not self._compiled or (n > 1 and True not in self._compiled):
            self._compiled[n > 1] = _function(native.library(self.source, many=n > 1), self.name)
        return self._compiled.get(True, self._compiled.get(False))

    @cached_property
    def _compiled(self) -> dict[bool, Any]:
        """The compiled functions: for many vehicles, and for one."""
        return {}

    @cached_property
    def _on_floats(self) -> Callable[..., tuple[Any, ...]]:
        space = {**_FLOAT_SPACE, "arctan2": math.atan2, "floor": floor, "single": EXACT["single"]}
        return self._python(PYTHON, space)

    @cached_property
    def _on_rows(self) -> Callable[..., tuple[Any, ...]]:
        space = {"exp": np.exp, "log": np.log, "inf": math.inf, "nan": math.nan, "single": _single_rows}
        plain = {name: getattr(ARRAYS, name) for name in ("sin", "cos", "sqrt", "arctan2", "floor", "clip", "where")}
        return self._python(NUMPY, {**space, **plain})

    def _python(self, language: Language, space: dict[str, Any]) -> Callable[..., tuple[Any, ...]]:
        source = python_function(self.name, self.graph, self.arguments, self._wanted, language)
        exec(compile(source, f"<{self.name}>", "exec"), space)
        function: Callable[..., tuple[Any, ...]] = space[self.name]
        return function

    def bound(self, **arrays: AnyArray) -> KernelRun:
        """Return the function that reads these arrays and writes to them.

        It is made for speed: that the steps which it is asked for are within the arrays is for the caller to see to.

        Raises:
            ValueError: an array is missing, unknown, of another shape or type, or its last axis is not contiguous.
        """
        n = self._checked(arrays)
        if (function := self._native(n)) is None:
            return self._on_one(arrays) if n == 1 else self._on_several(arrays)
        table = self._table(arrays, n)
        run = partial(function, ctypes.c_void_p(table.__array_interface__["data"][0]))  # costs less than a function
        run.__dict__["kept"] = table, arrays  # alive as long as their addresses are used
        return run

    def _table(self, arrays: Mapping[str, AnyArray], n: int) -> AnyArray:
        """Return what the compiled function finds `at` its first argument, see `c_function`."""
        entries, size = [n], _REAL[self.layout.precision].itemsize
        for name, _, strides in self._axes:
            array = arrays[name]
            entries.append(array.__array_interface__["data"][0])  # half the cost of `array.ctypes`
            entries += [stride // size for stride in array.strides[:strides]]
        return np.array(entries, dtype=np.int64)

    @cached_property
    def _axes(self) -> list[tuple[str, int, int]]:
        """Name and rows of each array, and how many of its axes have a stride."""
        return [(name, rows, len(self.layout.strides(name))) for name, rows in self.rows.items()]

    def _checked(self, arrays: Mapping[str, AnyArray]) -> int:
        """Return the number of vehicles of well-formed arrays."""
        if arrays.keys() != self.rows.keys():
            raise ValueError(f"the kernel takes arrays {', '.join(self.rows)}; given are {', '.join(arrays)}")
        n: int = next(a.shape[-1] for name, a in arrays.items() if name not in self.layout.shared)
        real = _REAL[self.layout.precision]
        for name, rows, _ in self._axes:
            array, own = arrays[name], (rows,) if name in self.layout.shared else (rows, n)
            over_time = name in self.layout.over_time
            if array.dtype != real or array.shape[over_time:] != own or array.ndim != over_time + len(own):
                shape = ("T", *own) if over_time else own
                raise ValueError(
                    f"array {name} is of type {array.dtype} and shape {array.shape}; it must be of type "
                    f"{self.layout.precision} and of shape ({', '.join(map(str, shape))}{',' * (len(shape) == 1)})"
                )
            if array.strides[-1] != array.itemsize and array.size and array.shape[-1] > 1:
                raise ValueError(f"array {name} must hold the vehicles of a row side by side in memory")
        return n

    def _steps(self, first: int, steps: int) -> Iterable[int]:
        return range(first + steps - 1, first - 1, -1) if self.layout.back else range(first, first + steps)

    def _split(self, values: tuple[Any, ...]) -> Iterator[tuple[str, tuple[Any, ...]]]:
        at = 0
        for name, entries in self.results.items():
            yield name, values[at : at + len(entries)]
            at += len(entries)

    def _on_one(self, arrays: Mapping[str, AnyArray]) -> KernelRun:
        """Return what `bound` does for one vehicle, on floats."""
        function = self._on_floats

        def run(first: int, steps: int) -> None:
            time = slice(first, first + steps)
            rows = {name: self._one(name, array, time).tolist() for name, array in arrays.items()}
            for k in self._steps(0, steps):
                given = [rows[n][k] if n in self.layout.over_time else rows[n] for n in self.arguments]
                try:
                    values = function(*given)
                except (ArithmeticError, ValueError):  # NumPy divides by zero as C does
                    values = self._beyond(given)
                for name, own in self._split(values):
                    if name in self.layout.over_time:
                        rows[name][k] = own
                    else:
                        rows[name] = own
            for name in self.results if steps else ():
                self._one(name, arrays[name], time)[:] = rows[name]

        return run

    def _one(self, name: str, array: AnyArray, time: slice) -> AnyArray:
        """Return what an array holds of the one vehicle."""
        part = array[time] if name in self.layout.over_time else array
        return part if name in self.layout.shared else part[..., 0]

    def _beyond(self, given: Iterable[Any]) -> tuple[Any, ...]:
        with np.errstate(all="ignore"):
            return tuple(map(float, self._on_rows(*map(np.array, given))))

    def _on_several(self, arrays: Mapping[str, AnyArray]) -> KernelRun:
        """Return what `bound` does for several vehicles, on rows."""
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
        """Return new arrays with the results of the first `steps` steps, for arguments that stay as they are.

        Raises:
            ValueError: an array is missing, unknown, of another shape, or of fewer steps.
        """
        real = _REAL[self.layout.precision]
        given = {name: np.ascontiguousarray(a, dtype=real) for name, a in arguments.items()}
        if short := [name for name in given if name in self.layout.over_time and len(given[name]) < steps]:
            raise ValueError(f"array {short[0]} has {len(given[short[0]])} steps; it must have at least {steps}")
        n = next(a.shape[-1] for name, a in given.items() if name not in self.layout.shared)
        results = {name: given[name].copy() if name in given else self._empty(name, steps, n) for name in self.results}
        arrays = {**given, **results}
        if (function := self._native(n)) is None:
            self.bound(**arrays)(0, steps)
        else:  # sooner than by `bound`
            table = self._table(arrays, self._checked(arrays))
            function(ctypes.c_void_p(table.__array_interface__["data"][0]), 0, steps)
        return results

    def _empty(self, name: str, steps: int, n: int) -> AnyArray:
        shape = (steps, self.rows[name], n) if name in self.layout.over_time else (self.rows[name], n)
        return np.empty(shape, dtype=_REAL[self.layout.precision])


def together(kernels: Mapping[str, Kernel], code: str = "", *, many: bool = True) -> Any:
    """Compile kernels of one precision as one library, in less time than one by one; they run from it afterwards.

    Args:
        kernels: by the names of their functions.
        code: further C, which may call these functions and stands behind them.
        many: whether they are to be fast for several vehicles; it takes a compiler twice the time.

    Returns:
        The library, a `ctypes.CDLL`; None where there is no compiler.
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

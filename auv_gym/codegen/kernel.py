"""Kernels: an equation on rows, traced once, that runs as compiled C, or without a compiler as printed Python."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from auv_gym.codegen import native
from auv_gym.codegen.blocks import c_block_function
from auv_gym.codegen.elementary import lowered
from auv_gym.codegen.graph import Graph, Symbol
from auv_gym.codegen.printing import NUMPY, PYTHON, Arrays, Language, c_function, python_function
from auv_gym.namespaces import ARRAYS

Array: TypeAlias = NDArray[Any]
Equation = Callable[..., Mapping[str, Sequence[Any]]]
"""Takes the rows of each array by its name, as symbols, and returns rows by the names of the arrays they are for."""
Run = Callable[[int, int], None]
"""Goes through so many steps from a first one on: `run(first, steps)`."""

_REAL = {name: np.dtype(name) for name in ("float32", "float64")}
_FLOAT_SPACE = {name: getattr(math, name) for name in ("sin", "cos", "exp", "log", "sqrt", "inf", "nan")}


@dataclass(frozen=True, eq=False)
class Kernel:
    """An equation on rows of n vehicles, which may go through several steps at once.

    Arrays are of shape (rows, n), or (T, rows, n) where they hold something else at each step. An array that is among
    arguments and results is carried from step to step; another result is that of the last step, unless it is over time.
    """

    name: str
    graph: Graph
    arguments: Arrays
    results: Arrays
    over_time: frozenset[str]
    precision: str  # "float64" or "float32"
    back: bool  # whether it goes from the last step to the first
    blocked: bool = False  # whether its C goes through eight vehicles at a time, see `blocks`

    @classmethod
    def traced(
        cls,
        equation: Equation,
        rows: Mapping[str, int],
        over_time: Sequence[str] = (),
        *,
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
            precision: of all numbers, "float64" or "float32".
            back: whether to go from the last step to the first.
            structural: see `Graph`.
            blocked: whether to go through eight vehicles at a time: for equations of more than a hundred rows.
        """
        graph = Graph(structural)
        arguments = {array: [graph.input(f"{array}_{j}") for j in range(n)] for array, n in rows.items()}
        results = {array: [graph.symbol(x) for x in given] for array, given in equation(**arguments).items()}
        return cls("auv_kernel", graph, arguments, results, frozenset(over_time), precision, back, blocked)

    @cached_property
    def rows(self) -> dict[str, int]:
        """How many rows each array has, in the order in which the compiled function takes them."""
        return {array: len(entries) for array, entries in {**self.arguments, **self.results}.items()}

    @cached_property
    def source(self) -> str:
        """The kernel in C."""
        flat = lowered(self.graph, self._wanted, self.precision)
        results, at = {}, 0
        for array, entries in self.results.items():
            results[array], at = flat[at : at + len(entries)], at + len(entries)
        real = "float" if self.precision == "float32" else "double"
        printed = c_block_function if self.blocked else c_function
        body = printed(self.name, self.graph, self.arguments, results, self.over_time, self.precision, self.back)
        return f"#include <math.h>\ntypedef {real} real;\n{body}"

    @property
    def _wanted(self) -> list[Symbol]:
        return [s for entries in self.results.values() for s in entries]

    @cached_property
    def _native(self) -> Any:
        """The compiled function; None where there is none."""
        import ctypes

        library = native.library(self.source)
        if library is None:
            return None
        function = library[self.name]
        function.argtypes = [ctypes.c_long] * 3 + [ctypes.c_void_p] * len(self.rows)
        function.restype = None
        return function

    @cached_property
    def _on_floats(self) -> Callable[..., tuple[Any, ...]]:
        space = {**_FLOAT_SPACE, "arctan2": math.atan2, "floor": _floor, "single": _single_float}
        return self._python(PYTHON, space)

    @cached_property
    def _on_rows(self) -> Callable[..., tuple[Any, ...]]:
        space = {"exp": np.exp, "log": np.log, "inf": math.inf, "nan": math.nan, "single": _single_rows}
        plain = {name: getattr(ARRAYS, name) for name in ("sin", "cos", "sqrt", "arctan2", "floor", "clip", "where")}
        return self._python(NUMPY, {**space, **plain})

    def _python(self, language: Language, space: dict[str, Any]) -> Callable[..., tuple[Any, ...]]:
        source = python_function(self.name, self.graph, self.arguments, self._wanted, language)
        exec(compile(source, f"<{self.name}>", "exec"), space)  # noqa: S102 - our own text
        function: Callable[..., tuple[Any, ...]] = space[self.name]
        return function

    def bound(self, **arrays: Array) -> Run:
        """Return the function that reads these arrays and writes to them; they must live as long as it does.

        Raises:
            ValueError: an array is missing, unknown, of another shape or type, or not contiguous.
        """
        n = self._checked(arrays)
        ordered = [arrays[name] for name in self.rows]
        if (function := self._native) is not None:
            addresses = [a.ctypes.data for a in ordered]

            def run(first: int = 0, steps: int = 1) -> None:
                function(n, first, steps, *addresses)

            run.__dict__["arrays"] = ordered  # alive as long as their addresses are used
            return run
        return self._interpreted(arrays, n)

    @cached_property
    def _layout(self) -> list[tuple[str, int, int]]:
        """Name, rows and dimensions of each array."""
        return [(name, rows, 3 if name in self.over_time else 2) for name, rows in self.rows.items()]

    def _checked(self, arrays: Mapping[str, Array]) -> int:
        """Return the number of vehicles of well-formed arrays."""
        if arrays.keys() != self.rows.keys():
            raise ValueError(f"the kernel takes arrays {', '.join(self.rows)}; given are {', '.join(arrays)}")
        n: int = next(iter(arrays.values())).shape[-1]
        real = _REAL[self.precision]
        for name, rows, dimensions in self._layout:
            array = arrays[name]
            if array.dtype != real or array.ndim != dimensions or array.shape[-2:] != (rows, n):
                raise ValueError(
                    f"array {name} is of type {array.dtype} and shape {array.shape}; it must be of type "
                    f"{self.precision} and of shape {'(T, ' if dimensions > 2 else '('}{rows}, {n})"
                )
            if not array.flags.c_contiguous:
                raise ValueError(f"array {name} must be contiguous")
        return n

    def _interpreted(self, arrays: Mapping[str, Array], n: int) -> Run:
        """Return what `bound` does, on floats for one vehicle and on rows for several."""
        sizes = [(name, len(entries)) for name, entries in self.results.items()]

        def computed(rows: Sequence[Array]) -> tuple[Any, ...]:
            if n == 1:
                try:
                    return self._on_floats(*(row.ravel().tolist() for row in rows))
                except (ArithmeticError, ValueError):  # what Python refuses is inf or nan on rows, as in C
                    pass
            return self._on_rows(*map(np.array, rows))

        def run(first: int = 0, steps: int = 1) -> None:
            order = range(first, first + steps)
            for k in reversed(order) if self.back else order:
                at = 0
                rows = [arrays[name][k] if name in self.over_time else arrays[name] for name in self.arguments]
                with np.errstate(all="ignore"):
                    values = computed(rows)
                for name, size in sizes:
                    target = arrays[name][k] if name in self.over_time else arrays[name]
                    for j in range(size):
                        target[j] = values[at + j]
                    at += size

        return run

    def __call__(self, steps: int = 1, **arguments: Array) -> dict[str, Array]:
        """Return new arrays with the results of the first `steps` steps, for arguments that stay as they are."""
        real = _REAL[self.precision]
        given = {name: np.ascontiguousarray(a, dtype=real) for name, a in arguments.items()}
        n = next(iter(given.values())).shape[-1]
        results = {name: given[name].copy() if name in given else self._empty(name, steps, n) for name in self.results}
        arrays = {**given, **results}
        if (function := self._native) is None:
            self.bound(**arrays)(0, steps)
        else:  # sooner than by `bound`
            function(self._checked(arrays), 0, steps, *[arrays[name].ctypes.data for name in self.rows])
        return results

    def _empty(self, name: str, steps: int, n: int) -> Array:
        shape = (steps, self.rows[name], n) if name in self.over_time else (self.rows[name], n)
        return np.empty(shape, dtype=_REAL[self.precision])


def _floor(x: float) -> float:
    return x // 1.0


def _single_float(x: float) -> float:
    return float(np.float32(x))


def _single_rows(x: Array) -> Array:
    return np.asarray(x, dtype=np.float32).astype(np.float64)

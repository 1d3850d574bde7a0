"""Kernels: equations on rows, traced once, that run as compiled C, or as printed Python if there is no compiler."""

from __future__ import annotations

import ctypes
import hashlib
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np

from auv_gym.codegen import native
from auv_gym.codegen.blocks import c_block_function
from auv_gym.codegen.elementary import lowered
from auv_gym.codegen.graph import CALLED, OPERATIONS, Graph, Symbol, floor
from auv_gym.codegen.printing import Arrays, Layout, c_function, python_function
from auv_gym.codegen.traces import Trace, read_trace, trace_key, write_trace
from auv_gym.physics.namespaces import ARRAYS, FLOATS, AnyArray, Namespace

Equation = Callable[..., Mapping[str, Sequence[Any]]]
"""A function that takes the rows of each argument by name, as symbols, and returns the rows of each result by name."""
KernelRun = Callable[[int, int], None]
"""A function `run(first, steps)` that computes this number of steps from step `first` on."""

_DTYPES = {name: np.dtype(name) for name in ("float32", "float64")}
_MOST_KERNELS = 256  # largest number of kernels that this process keeps for the same equations


def address(array: AnyArray | None) -> Any:
    """Return the address of the numbers of an array, in half the time of `array.ctypes`; None for None."""
    return None if array is None else array.__array_interface__["data"][0]


class _Parts(NamedTuple):
    """A traced equation."""

    graph: Graph
    arguments: Arrays
    results: Arrays


class Kernel:
    """An equation on rows of n vehicles, for one or several steps.

    The shape of an array is (rows, n), or (rows,) if its values are shared by all vehicles. An array with values for
    each step has the shape (T, rows, n) or (T, rows). An array that is an argument and a result is carried from step to
    step. Any other result holds the values of the last step, unless it has values for each step.

    Attributes:
        layout: memory layout of the arrays.
        rows: number of rows of each array, in the order of the compiled function's arguments.
        written: names of the results.
    """

    name = "auv_kernel"
    """Name of the compiled function."""

    def __init__(self, trace: Callable[[], _Parts], layout: Layout, earlier: Trace | None = None) -> None:
        """Make a kernel; see `traced`.

        Args:
            trace: traces the equation.
            layout: memory layout of the arrays.
            earlier: what an earlier process has kept of the equation. None: the equation is traced now.
        """
        self._trace, self.layout = trace, layout
        self._compiled: dict[bool, Any] = {}  # the compiled functions, by whether they are for many vehicles
        if earlier is not None:
            self.rows, self.written, self.__dict__["digest"] = earlier.rows, tuple(earlier.written), earlier.digest
        else:
            arrays = {**self.arguments, **self.results}
            self.rows, self.written = {name: len(entries) for name, entries in arrays.items()}, tuple(self.results)

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

        The same equation gives the same kernel again. If an earlier process has compiled it, it is traced only if its
        graph is needed, see `traces`.

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
        layout = Layout(frozenset(over_time), frozenset(shared), precision, back, blocked)

        def trace() -> _Parts:
            graph = Graph(structural)
            arguments = {array: [graph.input(f"{array}_{j}") for j in range(n)] for array, n in rows.items()}
            results = {array: [graph.symbol(x) for x in entries] for array, entries in equation(**arguments).items()}
            return _Parts(graph, arguments, results)

        if not (key := trace_key(equation, rows, layout, structural)):
            return cls(trace, layout)
        if (kernel := _kernels.pop(key, None)) is None:
            earlier = read_trace(key) if native.has_compiler() else None
            kernel = cls(trace, layout, earlier)
            if earlier is None and native.has_compiler():
                write_trace(key, Trace(kernel.digest, kernel.rows, list(kernel.written)))
        _kernels[key] = kernel
        if len(_kernels) > _MOST_KERNELS:
            del _kernels[next(iter(_kernels))]
        return kernel

    @cached_property
    def _parts(self) -> _Parts:
        return self._trace()

    @property
    def graph(self) -> Graph:
        """The graph of the results."""
        return self._parts.graph

    @property
    def arguments(self) -> Arrays:
        """The symbols of each argument."""
        return self._parts.arguments

    @property
    def results(self) -> Arrays:
        """The symbols of each result."""
        return self._parts.results

    def __deepcopy__(self, _: Any) -> Kernel:
        return self

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the graph, since the equation and the addresses of compiled code belong to this process."""
        return Kernel, (partial(_Parts, *self._parts), self.layout)

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the C source."""
        return hashlib.sha256(self.source.encode()).hexdigest()

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
            library = native.library(self.digest, lambda: self.source, many=n > 1)
            self._compiled[n > 1] = _function(library, self.name)
        return self._compiled.get(True, self._compiled.get(False))

    @cached_property
    def _on_floats(self) -> Callable[..., tuple[Any, ...]]:
        return self._python(FLOATS, floor=floor, single=OPERATIONS["single"])

    @cached_property
    def _on_rows(self) -> Callable[..., tuple[Any, ...]]:
        return self._python(ARRAYS, single=lambda x: np.asarray(x, dtype=np.float32).astype(np.float64))

    def _python(self, ns: Namespace, **others: Any) -> Callable[..., tuple[Any, ...]]:
        """Return the printed function on the numbers of a namespace."""
        names = {name: getattr(ns, name) for name in CALLED} | {"inf": math.inf, "nan": math.nan} | others
        source = python_function(self.name, self.graph, self.arguments, self._outputs)
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
            return partial(self._run_python, arrays, n)
        entries, size = [n], _DTYPES[self.layout.precision].itemsize  # of the first argument, see `c_function`
        for name, _, strides in self._axes:
            array = arrays[name]
            entries.append(address(array))
            entries += [stride // size for stride in array.strides[:strides]]
        table = np.array(entries, dtype=np.int64)
        run = partial(function, ctypes.c_void_p(address(table)))  # faster than a closure
        run.__dict__["kept"] = table, arrays  # references, as long as the addresses are used
        return run

    @cached_property
    def _axes(self) -> list[tuple[str, int, int]]:
        """Name, number of rows and number of strides of each array."""
        return [(name, rows, len(self.layout.strides(name))) for name, rows in self.rows.items()]

    def _checked(self, arrays: Mapping[str, AnyArray]) -> int:
        """Return the number of vehicles; raise ValueError for wrong arrays, see `bound`."""
        if arrays.keys() != self.rows.keys():
            raise ValueError(f"the kernel takes arrays {', '.join(self.rows)}; given are {', '.join(arrays)}")
        for digests in _recorders:
            digests.add(self.digest)
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

    def _computed(self, inputs: Sequence[AnyArray], n: int) -> Sequence[Any]:
        """Return the results of one step by the printed function; inf or nan where Python raises an error."""
        if n == 1:
            inputs = [array.ravel() for array in inputs]
            with suppress(ArithmeticError, ValueError):
                return self._on_floats(*(array.tolist() for array in inputs))
        with np.errstate(all="ignore"):
            return self._on_rows(*(array.copy() for array in inputs))

    def _run_python(self, arrays: Mapping[str, AnyArray], n: int, first: int, steps: int) -> None:
        """Run the printed function for these arrays of n vehicles, see `bound`."""
        times = range(first, first + steps)
        for k in reversed(times) if self.layout.back else times:
            at = {name: array[k] if name in self.layout.over_time else array for name, array in arrays.items()}
            values, end = self._computed([at[name] for name in self.arguments], n), 0
            for name, entries in self.results.items():
                begin, end = end, end + len(entries)
                if n == 1:
                    at[name].T[:] = values[begin:end]
                else:
                    for row, value in zip(at[name], values[begin:end], strict=True):
                        row[:] = value

    def __call__(self, steps: int = 1, /, **arguments: AnyArray) -> dict[str, AnyArray]:
        """Return new arrays with the results of the first `steps` steps; the arguments are not changed.

        Raises:
            ValueError: an array is missing, unknown, of another shape, or has fewer steps.
        """
        dtype, over_time = _DTYPES[self.layout.precision], self.layout.over_time
        inputs = {name: np.ascontiguousarray(a, dtype=dtype) for name, a in arguments.items()}
        if short := [name for name in inputs if name in over_time and len(inputs[name]) < steps]:
            raise ValueError(f"array {short[0]} has {len(inputs[short[0]])} steps; it must have at least {steps}")
        n = next(a.shape[-1] for name, a in inputs.items() if name not in self.layout.shared)
        results = {}
        for name in self.written:
            shape = (steps, self.rows[name], n) if name in over_time else (self.rows[name], n)
            results[name] = inputs[name].copy() if name in inputs else np.empty(shape, dtype=dtype)
        self.bound(**inputs | results)(0, steps)
        return results


_kernels: dict[str, Kernel] = {}
"""Kernels by the keys of their equations, those in use last at the end."""


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

    def source() -> str:
        head = next(iter(kernels.values()))._head
        return "".join((head, *(kernel._code(name) for name, kernel in kernels.items()), code))

    library = native.library(library_digest(kernels, code), source, many=many)
    for name, kernel in kernels.items():
        function = _function(library, name)
        kernel._compiled[many] = function
        kernel._compiled.setdefault(True, function)
    return library


def library_digest(kernels: Mapping[str, Kernel], code: str) -> str:
    """Return the hash of the source of a library, see `together`."""
    parts = (f"{name} {kernel.digest}\n" for name, kernel in kernels.items())
    return hashlib.sha256("".join((*parts, code)).encode()).hexdigest()


@contextmanager
def recorded_digests() -> Iterator[set[str]]:
    """Return a set to which the digest of each kernel is added that is used in a `with` block."""
    digests: set[str] = set()
    _recorders.append(digests)
    try:
        yield digests
    finally:
        _recorders.remove(digests)


_recorders: list[set[str]] = []
"""The sets of `recorded_digests`."""


def _function(library: Any, name: str) -> Any:
    if library is None:
        return None
    function = library[name]
    function.restype = None
    return function

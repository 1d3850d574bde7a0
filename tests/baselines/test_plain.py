"""Graphs and networks printed as plain functions in C and JavaScript give the same numbers."""

import ctypes
import json
import math
import shutil
import subprocess

import numpy as np
import pytest
from native_cache import compiled

from auv_gym.codegen.elementary import hyperbolic_tangent
from auv_gym.codegen.graph import SYMBOLS, Graph
from auv_gym.codegen.printing import c_language
from auv_gym.physics.namespaces import FLOATS
from baselines.export.plain import plain_function, tangent_function
from baselines.export.sums import long_sums
from baselines.export.vectors import Program, plain_program
from research.site.live.equations import LANGUAGE, javascript


def test_error_of_the_hyperbolic_tangent():
    for x in (0.0, 1e-9, 0.3, -0.7, 2.0, -5.0, 19.0, 40.0, 800.0, -math.inf, math.inf):
        assert hyperbolic_tangent(x, "float64", FLOATS) == pytest.approx(math.tanh(x), abs=3e-16)
    assert math.isnan(hyperbolic_tangent(math.nan, "float64", FLOATS))


def shared(source, precision):
    """Return the library of a source, with its static functions exported."""
    real = {"float32": "float", "float64": "double"}[precision]
    library = compiled(f"#include <math.h>\ntypedef {real} real;\n{source.replace('static void', 'void')}")
    if library is None:
        pytest.skip("there is no compiler")
    return library


def address(array):
    return ctypes.c_void_p(array.ctypes.data)


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_a_function_may_read_and_write_the_same_array(precision):
    graph = Graph()
    a, b = graph.input("pair_0"), graph.input("pair_1")
    results = {"pair": [b, a + b], "seen": [a < b, SYMBOLS.clip(a, -1.0, 1.0), SYMBOLS.sin(b)]}
    arguments = {"pair": [a, b], "idle": [graph.input("idle_0")], "none": []}
    source = plain_function("swap", graph, arguments, results, c_language(precision), precision)
    assert "none" not in source
    pair, seen = np.array([3.0, 5.0], precision), np.zeros(3, precision)
    shared(source, precision).swap(address(pair), address(np.zeros(1, precision)), address(seen))
    assert pair.tolist() == [5.0, 8.0]
    np.testing.assert_allclose(seen, [1.0, 1.0, math.sin(5.0)], atol=1e-6 if precision == "float32" else 1e-15)


def test_long_sums_are_loops_with_the_same_bits():
    """Two sums with the same factors and one with others, which one of the results and a factor need."""
    graph, rng = Graph(), np.random.default_rng(0)
    x = [graph.input(f"x_{i}") for i in range(20)]

    def total(factors):
        first, *others = (float(c) * factor for c, factor in zip(rng.normal(size=len(factors)), factors, strict=True))
        return sum(others, first)

    a, b = total(x), total(x)
    results = {"out": [a * b, total([a + entry for entry in x]), x[0] * 2.0]}
    wanted = [symbol.index for symbol in results["out"]]
    assert [(len(p.sums), len(p.factors)) for p in long_sums(graph, wanted)[0]] == [(2, 20), (1, 20)]
    numbers, found = rng.normal(size=20), []
    for loops in (False, True):
        source = plain_function("run", graph, {"x": x}, results, c_language("float64"), "float64", loops)
        assert ("for (int" in source) == loops
        found.append(np.zeros(3))
        shared(source, "float64").run(address(numbers), address(found[-1]))
    np.testing.assert_array_equal(*found)
    assert abs(found[0]).min() > 0


W, COLUMN = np.arange(12.0).reshape(4, 3) / 7 - 0.8, np.array([[0.1], [-0.2], [0.3], [0.0]])


def network(x, h):
    """Return a result of every operation that can be recorded, some of them in place."""
    y = np.dot(W, x)
    y += COLUMN
    np.tanh(y, y)
    low, high = np.maximum(y[:2], 0.0), y[2:]
    high *= 0.5
    h = h - np.clip(low, -1.0, 0.1)
    h += high * 2.0
    return h, np.maximum(np.concatenate((y[1:2], x[1:])), -0.05)


PROGRAM = Program.traced(network, {"W": W, "column": COLUMN}, {"x": 3, "h": 2}, ("next", "out"))
X, H = np.array([0.3, -0.5, 0.9]), np.array([0.4, -0.6])
EXPECTED = np.concatenate(network(X[:, None], H[:, None])).ravel()


def printed(language):
    return tangent_function("tangent", language, "float64") + plain_program("run", PROGRAM, "tangent", language, {})


def test_a_network_runs_as_loops_in_c():
    tables = "".join(
        f"static const double {name}[] = {{{', '.join(map(repr, array.ravel().tolist()))}}};\n"
        for name, array in PROGRAM.constants.items()
    )
    source = tables + printed(c_language("float64"))
    after, out = np.zeros(2), np.zeros(3)
    shared(source, "float64").run(*map(address, (X, H, after, out)))
    np.testing.assert_allclose([*after, *out], EXPECTED, atol=1e-15)


def test_a_network_runs_as_loops_in_javascript():
    if shutil.which("node") is None:
        pytest.skip("no node; tests/research/test_live.py runs the same printer in a browser")
    tables = "".join(f"const {name} = {array.ravel().tolist()};" for name, array in PROGRAM.constants.items())
    source = tables + javascript(printed(LANGUAGE))
    call = f"const a = [], b = []; run({X.tolist()}, {H.tolist()}, a, b); console.log(JSON.stringify([...a, ...b]));"
    done = subprocess.run(["node", "-e", source + call], capture_output=True, text=True, check=True)
    np.testing.assert_allclose(json.loads(done.stdout), EXPECTED, atol=1e-15)

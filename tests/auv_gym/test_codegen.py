"""Code generation: printed code gives the numbers of the equation, and derivatives are those of torch."""

import functools
import math
from dataclasses import replace

import mpmath
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from auv_gym.codegen import native
from auv_gym.codegen.derivatives import PULLBACKS, directional, gradient, jacobian
from auv_gym.codegen.elementary import sine_cosine
from auv_gym.codegen.graph import OPERATIONS, SYMBOLS, TRUTHS, Graph, single
from auv_gym.codegen.kernel import Kernel, together
from auv_gym.codegen.printing import PYTHON, c_language
from auv_gym.physics.namespaces import ARRAYS, FLOATS, tensors, wrap_angle

NUMBERS = st.floats(-50, 50, allow_subnormal=False)
PROGRAMS = st.lists(
    st.tuples(st.integers(0, 15), st.integers(0, 10**6), st.integers(0, 10**6), st.integers(0, 10**6)),
    min_size=1,
    max_size=40,
)
needs_compiler = pytest.mark.skipif(
    native.compiler() is None or not native.wanted(), reason="compiled code is switched off, or there is no compiler"
)


TERMS = (
    lambda x, y, z, ns: x + y,
    lambda x, y, z, ns: x - y,
    lambda x, y, z, ns: wrap_angle(x * y, ns),
    lambda x, y, z, ns: x / (1.5 + y * y),
    lambda x, y, z, ns: -x,
    lambda x, y, z, ns: abs(x),
    lambda x, y, z, ns: ns.sin(x),
    lambda x, y, z, ns: ns.cos(x),
    lambda x, y, z, ns: ns.sqrt(0.1 + abs(x)),
    lambda x, y, z, ns: 0.01 * ns.floor(x),
    lambda x, y, z, ns: ns.clip(x, -3.0, 3.0),
    lambda x, y, z, ns: ns.clip(x, -abs(y), abs(y) + 1.0),
    lambda x, y, z, ns: ns.where(x < y, y, z),
    lambda x, y, z, ns: ns.where((x <= y) | (y > z), z, ns.exp(-abs(x))),
    lambda x, y, z, ns: ns.where((x < y) & ((y >= z) ^ True), x * 0.3, z),
    lambda x, y, z, ns: x * 1.0 - 0.0,
)


def computed(program, inputs, ns, number=float):
    """Return the results of a random program of operations on numbers or symbols; all values are finite."""
    values = [*inputs, *map(number, (0.5, -2.0, 1.0, 0.0))]
    for operation, *places in program:
        x, y, z = (values[n % len(values)] for n in places)
        values.append(TERMS[operation](x, y, z, ns))
    return values[-3:]


def kernel_of(program, **options):
    return Kernel.traced(lambda given: {"out": computed(program, given, SYMBOLS)}, {"given": 3}, **options)


def random_programs(rng, count, length):
    return [[tuple(rng.integers(0, (16, 99, 99, 99)).tolist()) for _ in range(length)] for _ in range(count)]


@settings(deadline=None, max_examples=150)
@given(PROGRAMS, st.lists(NUMBERS, min_size=3, max_size=3))
def test_printed_python_gives_the_bits_of_the_equation(program, inputs):
    kernel = kernel_of(program)
    expected = [float(y).hex() for y in computed(program, inputs, FLOATS)]
    assert [float(y).hex() for y in kernel._on_floats(inputs)] == expected


def test_printed_numpy_gives_the_numbers_of_the_equation():
    """The last digits differ: constants are folded with the C library, whose sine differs from NumPy's."""
    rng = np.random.default_rng(2)
    for program in random_programs(rng, 40, 25):
        smooth = [step for step in program if step[0] not in (2, 9)]  # without floor, which is discontinuous
        rows = rng.uniform(-3, 3, (3, 5))
        with np.errstate(all="ignore"):
            printed = [np.broadcast_to(y, 5) for y in kernel_of(smooth)._on_rows(rows)]
            direct = [np.broadcast_to(y, 5) for y in computed(smooth, tuple(rows), ARRAYS)]
        np.testing.assert_allclose(printed, direct, rtol=1e-9, atol=1e-9)


@needs_compiler
def test_compiled_code_gives_the_bits_of_printed_python():
    """Sine and cosine are expanded to products and sums, so every form of the graph computes the same."""
    rng = np.random.default_rng(0)
    ns = replace(
        SYMBOLS,
        sin=lambda x: sine_cosine(x, "float64", SYMBOLS)[0],
        cos=lambda x: sine_cosine(x, "float64", SYMBOLS)[1],
    )
    for drawn in random_programs(rng, 12, 40):
        program = [step for step in drawn if step[0] != 13]  # exp differs: printed Python calls that of the C library
        kernel = Kernel.traced(lambda given, p=program: {"out": computed(p, given, ns)}, {"given": 3})
        given = rng.uniform(-9, 9, (3, 37))
        out = kernel(given=given)["out"]
        python = np.array([kernel._on_floats(column) for column in given.T.tolist()], dtype=np.float64).T
        np.testing.assert_array_equal(out, python)  # for many vehicles ...
        one = kernel(given=np.ascontiguousarray(given[:, :1]))["out"]
        np.testing.assert_array_equal(one, python[:, :1])  # ... as for one


@pytest.mark.parametrize(("precision", "largest", "tolerance"), [("float64", 1e4, 1e-15), ("float32", 500.0, 2e-7)])
def test_errors_of_sine_and_cosine(precision, largest, tolerance):
    kernel = Kernel.traced(
        lambda angle: {"out": (SYMBOLS.sin(angle[0]), SYMBOLS.cos(angle[0]))}, {"angle": 1}, precision=precision
    )
    rng = np.random.default_rng(0)
    angles = np.concatenate((rng.uniform(-largest, largest, 2000), np.arange(-40, 41) * math.pi / 4, [0.0, 1e-9]))
    angles = angles.astype(precision)
    out = kernel(angle=angles[None])["out"]
    exact = [[float(f(mpmath.mpf(float(x)))) for x in angles] for f in (mpmath.sin, mpmath.cos)]
    np.testing.assert_allclose(out, exact, rtol=0, atol=tolerance)
    own = sine_cosine(np.array([1e300, 1e18, -1e9]), "float64", ARRAYS)
    assert all((np.abs(x) <= 1.2).all() for x in own), "bounded for large angles"


def test_derivatives_are_those_of_autograd():
    rng = np.random.default_rng(1)
    ns, weights = tensors(), np.array((1.0, 2.0, -1.0))
    for program in random_programs(rng, 60, 25):
        inputs, direction = rng.uniform(-4, 4, (2, 3)).tolist()

        def equation(given, program=program, direction=direction):
            outputs = [given[0].graph.symbol(y) for y in computed(program, given, SYMBOLS)]
            along = directional(outputs, {s.index: d for s, d in zip(given, direction, strict=True)})
            rows = jacobian(outputs, given)
            return {"g": gradient(outputs, weights.tolist(), given), "t": along, "J": [x for row in rows for x in row]}

        values = np.array(Kernel.traced(equation, {"given": 3})._on_floats(inputs))
        leaves = [torch.tensor(x, dtype=torch.float64, requires_grad=True) for x in inputs]
        found = computed(program, leaves, ns, lambda x: torch.tensor(x, dtype=torch.float64))
        total = sum(w * y for w, y in zip(weights.tolist(), found, strict=True)) + sum(0 * x for x in leaves)
        expected = np.array([float(g) for g in torch.autograd.grad(total, leaves)])
        J = values[6:].reshape(3, 3)
        size = 1 + np.abs(J).max()
        np.testing.assert_allclose(values[:3], expected, rtol=1e-12, atol=1e-12 * size)
        np.testing.assert_allclose(weights @ J, expected, rtol=1e-12, atol=1e-12 * size)
        np.testing.assert_allclose(J @ direction, values[3:6], rtol=1e-12, atol=1e-12 * size)


@pytest.mark.parametrize("x", [-2.0, -1.0, -0.0, 0.0, 0.5, 1.0, 2.0])
def test_derivatives_at_kinks_are_those_of_autograd(x):
    kernel = Kernel.traced(lambda z: {"J": [d for row in jacobian(limited(z, SYMBOLS), z) for d in row]}, {"z": 3})
    own = [torch.tensor(a, requires_grad=True) for a in (x, -1.0, 1.0)]
    J = [torch.autograd.grad(y, own, materialize_grads=True) for y in limited(own, tensors())]
    assert kernel._on_floats((x, -1.0, 1.0)) == tuple(float(d) for row in J for d in row)


def limited(z, ns):
    return abs(z[0]), ns.clip(z[0], -1.0, 1.0), ns.clip(*z)


def test_every_operation_has_a_derivative_and_a_printed_form():
    assert set(PULLBACKS) == set(OPERATIONS) - TRUTHS
    assert set(PYTHON.forms) == set(c_language("float64").forms) == set(OPERATIONS)


def test_constants_are_folded_and_equal_expressions_merged():
    graph = Graph()
    x, y = graph.input("x"), graph.input("y")
    assert (x + y).index == (y + x).index
    assert (x * 1.0).index == x.index
    negative = -x
    assert (-negative - 0.0).index == x.index
    assert graph.symbol(SYMBOLS.sqrt(SYMBOLS.sqrt(16.0)) + 1).value == 3.0
    assert SYMBOLS.where(graph.symbol(True), x, y).index == x.index
    assert (graph.constant(True).index, graph.constant(0.0).index) != (
        graph.constant(1.0).index,
        graph.constant(-0.0).index,
    )
    truth = x < y
    assert (truth | True).value is True
    assert (truth & False).value is (False & truth).value is False
    same = truth & True, True & truth, truth | False, False | truth, ~~truth
    assert {node.index for node in same} == {truth.index}
    assert SYMBOLS.where(truth, x, x).index == x.index
    assert (x / 1.0).index == SYMBOLS.clip(x, -math.inf, math.inf).index == x.index
    needed = x - -0.0, 1.0 / x, x - 1.0, SYMBOLS.clip(x, -math.inf, 1.0), SYMBOLS.clip(x, 1.0, math.inf)
    assert x.index not in {node.index for node in needed}, "-0.0 - -0.0 is 0.0"
    assert (x * 0.0).value is None, "nan for an infinite x"
    sparse = Graph(structural=True)
    z = sparse.input("z")
    assert (z * 0.0).value == 0.0
    assert (0.0 + z).index == (z + 0.0).index == (z - 0.0).index == (-(0.0 - z)).index == z.index
    assert (0.0 / z).value == 0.0
    assert (z / 0.0).value is None
    for wrong in (lambda: x + z, lambda: x**3):
        with pytest.raises(ValueError, match="symbol"):
            wrong()
    with pytest.raises(TypeError, match="where"):
        bool(x < y)


@pytest.mark.parametrize("x", [[0.0], [0.0, 2.0]])
def test_truth_values_that_are_known_become_numbers(x):
    kernel = Kernel.traced(lambda x: {"y": [(x[0] < 1.0) | True, (x[0] < 1.0) & False]}, {"x": 1})
    np.testing.assert_array_equal(kernel(x=np.array([x]))["y"], np.array([[1.0], [0.0]]) + 0 * np.array(x))


def test_constants_may_be_infinite():
    def equation(x):
        below = x[0] < 1.0
        return {"y": [SYMBOLS.where(below, -math.inf, math.inf), SYMBOLS.where(below, math.nan, x[0])]}

    kernel, x, expected = Kernel.traced(equation, {"x": 1}), np.array([[0.0, 2.0]]), [[-np.inf, np.inf], [np.nan, 2.0]]
    for found in (kernel(x=x)["y"], kernel._on_rows(x), np.transpose([kernel._on_floats([a]) for a in x[0]])):
        np.testing.assert_array_equal(found, expected)


@functools.cache
def oscillator(back):
    """Return the kernel of x' = x + h v, v' = v - h x + push with results of every step and of the last."""

    def equation(z, h, push):
        x, v = z
        return {
            "z": (x + h[0] * v, v - h[0] * x + push[0]),
            "passed": (x, single(v)),
            "end": (SYMBOLS.log(2.0 + x * x),),
        }

    return Kernel.traced(equation, {"z": 2, "h": 1, "push": 1}, ["push", "passed"], back=back)


@pytest.mark.parametrize("back", [False, True])
@pytest.mark.parametrize("n", [1, 5])
def test_kernels_carry_rows_from_step_to_step(n, back):
    rng = np.random.default_rng(3)
    z, h, push = rng.normal(size=(2, n)), rng.uniform(0, 0.1, (1, n)), rng.normal(size=(9, 1, n))
    kernel = oscillator(back)
    for printed in (False, True):
        arrays = {"z": z.copy(), "h": h, "push": push, "passed": np.zeros((9, 2, n)), "end": np.zeros((1, n))}
        kernel._run_python(arrays, n, 2, 5) if printed else kernel.bound(**arrays)(2, 5)
        x, v = z
        passed = np.zeros((9, 2, n))
        for k in (6, 5, 4, 3, 2) if back else (2, 3, 4, 5, 6):
            passed[k], end = (x, v.astype(np.float32)), np.log(2 + x * x)
            x, v = x + h[0] * v, v - h[0] * x + push[k, 0]
        np.testing.assert_array_equal(arrays["z"], (x, v))
        np.testing.assert_array_equal(arrays["passed"], passed)
        np.testing.assert_allclose(arrays["end"], end[None], rtol=1e-15)


@pytest.mark.parametrize("n", [1, 5])
def test_shared_arguments_may_have_values_for_each_step(n):
    def equation(total, factor):
        return {"total": [total[0] + factor[0] * total[1], total[1] * factor[1]]}

    kernel = Kernel.traced(equation, {"total": 2, "factor": 2}, ["factor"], shared=["factor"])
    rng = np.random.default_rng(6)
    total, factor = rng.normal(size=(2, n)), rng.normal(size=(4, 2))
    x, y = total
    for a, b in factor[:3]:
        x, y = x + a * y, y * b
    np.testing.assert_array_equal(kernel(3, total=total, factor=factor)["total"], (x, y))


def test_the_only_argument_may_have_values_for_each_step():
    kernel = Kernel.traced(lambda push: {"twice": [2.0 * push[0]]}, {"push": 1}, ["push", "twice"])
    push = np.random.default_rng(7).normal(size=(4, 1, 5))
    np.testing.assert_array_equal(kernel(3, push=push)["twice"], 2 * push[:3])


@needs_compiler
def test_kernels_compiled_together_give_the_same_results(cache):
    programs = random_programs(np.random.default_rng(7), 3, 20)
    given = np.random.default_rng(8).uniform(-3, 3, (3, 6))
    kernels = {f"program_{i}": kernel_of(program) for i, program in enumerate(programs)}
    call = "void first(const int64_t *at) { program_0(at, 0, 1); }\n"
    library = together(kernels, call)
    assert library.first
    libraries = len([*cache.iterdir()])  # of `together`, and of the trial
    for kernel, program in zip(kernels.values(), programs, strict=True):
        np.testing.assert_array_equal(kernel(given=given)["out"], kernel_of(program)(given=given)["out"])
    assert len([*cache.iterdir()]) == libraries + 3  # those of the single programs


def test_arrays_may_be_views_of_larger_arrays():
    rng, kernel = np.random.default_rng(4), oscillator(False)
    z, push, passed = rng.normal(size=(4, 9)), rng.normal(size=(7, 3, 9)), np.zeros((7, 5, 9))
    h, end = np.full((1, 9), 0.1), np.zeros((1, 9))
    part = slice(3, 6)
    arrays = {"z": z[1:3, part], "h": h[:, part], "push": push[:, 2:, part], "passed": passed[:, 1:3, part]}
    plain = {name: np.ascontiguousarray(a) for name, a in {**arrays, "end": end[:, part]}.items()}
    kernel.bound(**arrays, end=end[:, part])(0, 7)
    kernel.bound(**plain)(0, 7)
    for name, a in arrays.items():
        np.testing.assert_array_equal(a, plain[name])
    assert not passed[:, 0].any()
    assert not passed[:, :, :3].any()


def test_nan_is_propagated():
    kernel = Kernel.traced(
        lambda a: {"out": (SYMBOLS.clip(a[0], -1.0, 1.0), SYMBOLS.sin(a[0]), (a[0] <= 1.0) ^ True)}, {"a": 1}
    )
    for n in (1, 40):
        for value in (math.nan, math.inf):
            out = kernel(a=np.full((1, n), value))["out"]
            assert np.isnan(out[1]).all()
            assert (out[2] == 1).all(), "nan is not within the bound"
        assert np.isnan(kernel(a=np.full((1, n), math.nan))["out"][0]).all()


def test_wrong_arrays_are_refused():
    kernel, good = oscillator(False), np.zeros((2, 4))
    rest = {"h": np.zeros((1, 4)), "push": np.zeros((3, 1, 4)), "passed": np.zeros((3, 2, 4)), "end": np.zeros((1, 4))}
    for z, message in (
        (np.zeros((3, 4)), "shape"),
        (np.zeros((2, 4), dtype=np.float32), "float32"),
        (np.zeros((4, 2)).T, "contiguous"),
    ):
        with pytest.raises(ValueError, match=message):
            kernel.bound(z=z, **rest)
    with pytest.raises(ValueError, match="kernel takes arrays z, h, push"):
        kernel.bound(z=good)
    with pytest.raises(ValueError, match="push has 3 steps; it must have at least 4"):
        kernel(4, z=good, h=rest["h"], push=rest["push"])


@pytest.mark.parametrize(
    ("operation", "values"),
    [
        ("div", (1.0, 0.0)), ("div", (-1.0, 0.0)), ("div", (1.0, -0.0)), ("div", (0.0, 0.0)), ("log", (0.0,)),
        ("log", (-1.0,)), ("exp", (1000.0,)), ("sqrt", (-1.0,)), ("sin", (math.inf,)), ("floor", (math.inf,)),
        ("floor", (-math.inf,)), ("floor", (-0.0,)), ("floor", (-1.5,)), ("single", (1e39,)), ("single", (0.1,)),
    ],
)  # fmt: skip
def test_constants_are_folded_as_in_numpy(operation, values):
    """Without warnings of NumPy. A kernel that runs on floats without a compiler uses the same functions."""
    graph = Graph()
    folded = graph.apply(operation, *map(graph.constant, values)).value
    kernel = Kernel.traced(lambda a: {"out": [a[0].graph.apply(operation, *a)]}, {"a": len(values)})
    given = np.array(values)[:, None]
    with np.errstate(all="ignore"):
        names = {"div": np.divide, "single": np.float32}
        expected = float(names.get(operation, getattr(np, operation, None))(*values))
    for result in (folded, float(kernel._computed([given], 1)[0])):
        np.testing.assert_equal(result, expected)  # distinguishes 0 and -0

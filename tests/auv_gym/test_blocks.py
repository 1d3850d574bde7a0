"""Blocked kernels give the results of plain ones for any number of vehicles; matrices of symbols those of NumPy."""

import numpy as np
import pytest

from auv_gym.codegen import native
from auv_gym.codegen.graph import SYMBOLS
from auv_gym.codegen.kernel import Kernel
from auv_gym.codegen.matrices import congruence, diagonal, product, symmetric, triangle

COMPILED = native.compiler() is not None and native.wanted()


def pendulum(state, push, total):
    """Return arrays of every kind: carried from step to step, with values for each step, of the last step."""
    x, v = state
    a = push[0] - SYMBOLS.sin(x) - 0.1 * abs(v) * v
    v = v + 0.1 * a
    x = x + 0.1 * v
    return {"state": [x, v], "total": [total[0] + x * x], "seen": [x, v, a], "still": [SYMBOLS.where(v < 0.0, x, 0.5)]}


@pytest.mark.parametrize("back", [False, True])
@pytest.mark.parametrize("n", [1, 7, 8, 21])
def test_blocked_kernels_give_the_results_of_plain_ones(n, back):
    rng = np.random.default_rng(n)
    given = {"state": rng.normal(size=(2, n)), "push": rng.normal(size=(6, 1, n)), "total": np.zeros((1, n))}
    rows = {"state": 2, "push": 1, "total": 1}
    plain, blocked = (
        Kernel.traced(pendulum, rows, ["push", "seen"], back=back, blocked=blocked)(6, **given)
        for blocked in (False, True)
    )
    for name, expected in plain.items():
        np.testing.assert_array_equal(blocked[name], expected)
    if n > 1:
        alone = {name: a[..., :1] for name, a in given.items()}
        one = Kernel.traced(pendulum, rows, ["push", "seen"], back=back, blocked=True)(6, **alone)
        for name, expected in blocked.items():
            np.testing.assert_allclose(one[name], expected[..., :1], rtol=0.0 if COMPILED else 1e-12)


def test_no_steps_change_nothing():
    given = {"state": np.ones((2, 3)), "push": np.ones((6, 1, 3)), "total": np.zeros((1, 3))}
    kernel = Kernel.traced(pendulum, {"state": 2, "push": 1, "total": 1}, ["push", "seen"], blocked=True)
    arrays = {**given, "seen": np.full((6, 3, 3), 7.0), "still": np.full((1, 3), 7.0)}
    kernel.bound(**arrays)(0, 0)
    assert (arrays["state"] == 1.0).all()
    assert (arrays["seen"] == 7.0).all()
    assert (arrays["still"] == 7.0).all()


def test_matrix_operations_agree_with_numpy():
    rng = np.random.default_rng(0)
    A, B, P = rng.normal(size=(3, 4)), rng.normal(size=(4, 2)), rng.normal(size=(4, 4))
    A[0, 1:], A[2, 2] = 0.0, 0.0
    P = P + P.T
    np.testing.assert_allclose(product(A, B), A @ B)
    np.testing.assert_allclose(congruence(A, P), A @ P @ A.T)
    np.testing.assert_array_equal(symmetric(triangle(P)), P)
    np.testing.assert_array_equal(diagonal([1.0, 2.0]), np.diag([1.0, 2.0]))
    assert not any(map(any, product([[0.0, 0.0]], [[1.0], [2.0]])))


def test_zeros_need_no_operations():
    def equation(p):
        return {"q": triangle(congruence([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], symmetric(p)))}

    kernel = Kernel.traced(equation, {"p": 6}, structural=True)
    assert [s.node for s in kernel.results["q"]] == [("input", f"p_{i}") for i in range(3)]

"""Elementary functions made of additions and products against NumPy; results where Python raises errors."""

import numpy as np
import pytest

from auv_gym.codegen.derivatives import jacobian
from auv_gym.codegen.graph import SYMBOLS
from auv_gym.codegen.kernel import Kernel


@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_exponential_and_arctangent_agree_with_numpy(precision):
    kernel = Kernel.traced(
        lambda x: {"y": [SYMBOLS.exp(x[0]), SYMBOLS.arctan2(x[1], x[2]), SYMBOLS.arcsin(x[3])]},
        {"x": 4},
        precision=precision,
    )
    rng = np.random.default_rng(0)
    x = rng.normal(size=(4, 20000)) * 10 ** rng.uniform(-6, 6, (4, 20000))
    x[0], x[3] = rng.uniform(-80, 80, 20000), rng.uniform(-1, 1, 20000)
    x = x.astype(precision)
    expected = np.array((np.exp(x[0]), np.arctan2(x[1], x[2]), np.arcsin(x[3])), dtype=precision)
    np.testing.assert_allclose(kernel(x=x)["y"], expected, rtol=8 * np.finfo(precision).eps)


def test_limits_of_exponential_and_arctangent():
    kernel = Kernel.traced(lambda x: {"y": [SYMBOLS.exp(x[0]), SYMBOLS.arctan2(x[1], x[2])]}, {"x": 3})
    x = np.array(
        [
            (0.0, -1e9, 1e9, -np.inf, np.inf, np.nan, 708.7, -708.35),
            (0.0, 0.0, 0.0, 1.0, -1.0, np.nan, 1e300, -1e-300),
            (0.0, 1.0, -1.0, 0.0, 0.0, 1.0, 1e300, -1e-300),
        ]
    )
    with np.errstate(all="ignore"):
        expected = np.array((np.exp(x[0]), np.arctan2(x[1], x[2])))
    np.testing.assert_allclose(kernel(x=x)["y"], expected, rtol=1e-12)


def test_derivatives_of_the_arctangent():
    def slopes(x):
        y = SYMBOLS.arctan2(x[0] * x[1], x[0] - x[1])
        return {"y": [s for row in jacobian([y], x) for s in row]}

    a, b = np.array([0.3, -1.2]), np.array([0.7, 0.4])
    ends = [np.arctan2((a + s) * b, (a + s) - b) for s in (1e-6, -1e-6)]
    found = Kernel.traced(slopes, {"x": 2})(x=np.array((a, b)))["y"]
    np.testing.assert_allclose(found[0], (ends[0] - ends[1]) / 2e-6, rtol=1e-8)


def test_floats_give_infinities_where_python_raises_errors(monkeypatch):
    monkeypatch.setenv("AUV_GYM_NATIVE", "0")
    equation = Kernel.traced(lambda x: {"y": [1.0 / x[0], SYMBOLS.sqrt(x[0] - 1.0), SYMBOLS.exp(x[1])]}, {"x": 2})
    y = equation(x=np.array([[0.0], [1e9]]))["y"]
    np.testing.assert_array_equal(y[:, 0], (np.inf, np.nan, np.inf))

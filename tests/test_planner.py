"""The planner: the paper's numbers, exactness open loop, its own differential equation, symmetries and refusals."""

import math
import pickle
from dataclasses import dataclass, fields, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matrix_form import matrix_form
from scipy.integrate import solve_ivp
from scipy.special import fresnel

from auv_gym.paths import PAPER_CIRCLE, Circle, Ellipse, FigureEight, Lawnmower, Line, RandomSmooth, Sine, Spline
from auv_gym.planner import MAX_SIDESLIP, InfeasibleReferenceError, Reference, path_rates, plan, printed_surge_rate
from auv_gym.vehicle import PAPER_VEHICLE, Vehicle

ROUGH = Vehicle(215.0, 265.0, 80.0, 70.0, 100.0, 50.0, X_uu=40.0, Y_vv=150.0, N_rr=60.0)
VEHICLES = pytest.mark.parametrize("vehicle", [PAPER_VEHICLE, ROUGH], ids=["linear", "quadratic"])
TURN = 0.4075649  # share of a lawnmower's turn in its width: legs and turns below take 9 s and 12 s
PATHS = {
    "line": Line(0.5, heading=1.0),
    "circle": Circle(0.5, 0.1, 3.0, -2.0, 0.4),
    "sine": Sine(0.5, 2.0, 0.2, 0.3),
    "ellipse": Ellipse(6.0, 3.0, -0.09, 0.7),
    "figure_eight": FigureEight(5.0, 0.08, 0.2),
    "lawnmower": Lawnmower(0.5, 4.5, -0.5 * 12 * TURN),
    "random_smooth": RandomSmooth(0.5, (0.05, -0.03, 0.02), (0.04, 0.09, 0.13), (0.3, 2.0, 5.0), 0.2, 0.07, 1.0),
    "spline": Spline(((0, 0), (5, 1), (9, 4.5), (15, 4), (16.5, -2), (10, -6)), 0.5, (0.4, 0.5, 0.6, 0.5, 0.4, 0.5)),
}
FAST = {"fast_circle": Circle(1.5, 0.12), "fast_sine": Sine(1.2, 4.0, 0.2)}
FIELDS = [field.name for field in fields(Reference)]


def columns(reference, *names):
    return np.array([getattr(reference, name) for name in names])


def test_section_iii_numbers():
    R = plan(PAPER_CIRCLE, PAPER_VEHICLE, np.arange(0, 10, 0.1))
    for name, value, digits in (
        ("u", 0.0999769, 7), ("v", 0.0021495, 7), ("r", -0.01, 12), ("F_u", 7.00408, 5), ("F_r", -0.48925, 5)
    ):  # fmt: skip
        np.testing.assert_allclose(getattr(R, name), value, rtol=0, atol=0.5 * 10**-digits)
    np.testing.assert_allclose(np.degrees(R.gamma), 1.2317, rtol=0, atol=5e-5)
    np.testing.assert_allclose((R.x, R.y), (10 * np.sin(0.01 * R.t), 10 * np.cos(0.01 * R.t)), rtol=0, atol=1e-13)


@pytest.fixture(scope="module", params=[PAPER_VEHICLE, ROUGH], ids=["linear", "quadratic"])
def drift(request):
    """Largest position error in 25 s, 12 s for the fast ones, of a plant driven by nothing but the planned forces."""
    h, paths = 0.01, PATHS | FAST
    R = plan(list(paths.values()), request.param, np.arange(0, 25 + h / 4, h / 2))
    error = {}
    for column, name in enumerate(paths):
        state = columns(R, "x", "y", "psi", "u", "v", "r")[:, 0, column]
        F_u, F_r = R.F_u[:, column].tolist(), R.F_r[:, column].tolist()

        def rates(state, k, F_u=F_u, F_r=F_r):
            return matrix_form(state, (F_u[k], 0.0, F_r[k]), request.param)

        error[name] = 0.0
        for k in range(0, (12 if name in FAST else 25) * 200, 2):
            a = rates(state, k)
            b = rates(state + h / 2 * a, k + 1)
            c = rates(state + h / 2 * b, k + 1)
            state = state + h / 6 * (a + 2 * (b + c) + rates(state + h * c, k + 2))
            error[name] = max(error[name], math.hypot(state[0] - R.x[k + 2, column], state[1] - R.y[k + 2, column]))
    return error


@pytest.mark.parametrize("name", PATHS | FAST)
def test_planned_forces_alone_keep_a_plant_on_its_path(drift, name):
    assert drift[name] < 1e-9

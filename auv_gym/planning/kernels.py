"""The equations of a plan as kernels, whose columns are the samples of a path, and the C code that calls them."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from functools import cache
from pathlib import Path as FilePath
from typing import Any

from auv_gym.codegen.graph import SYMBOLS
from auv_gym.codegen.kernel import Kernel, library_digest, together
from auv_gym.physics.vehicle import Coefficients
from auv_gym.planning.feasibility import braking, gradual, moving, sideslip_allowed, torque_limit
from auv_gym.planning.paths import PATHS
from auv_gym.planning.paths.base import POSE, Family, placed
from auv_gym.planning.paths.turning import RandomSmooth, displacement, with_sine
from auv_gym.planning.sideslip import (
    ORDER,
    RATES,
    SIDESLIP_TERMS,
    PathRates,
    in_sideslip,
    path_rates,
    response,
    sideslip_rest,
    sideslip_terms,
    steady_sideslip,
    weighted_sum,
)

FAMILIES: list[type] = [f for f in PATHS.values() if issubclass(f, Family) and f is not RandomSmooth]
"""Families whose position has a formula, in the order of the driver's table; `RandomSmooth` follows them."""
FIXED_POINT = 12  # fixed-point iterations for the first samples; fewer are enough to converge
VEHICLE_ROWS = len(Coefficients._fields)  # number of coefficients of a vehicle
LIMIT_ROWS = 8  # number of limits: F_u_max, F_r_max, fin, largest |u|, |v|, |r|, |F_u|, |F_r| of a plan


@cache
def planning_kernels() -> Mapping[str, Kernel]:
    """Return the kernels by the names of their functions in the driver."""
    return {
        **{family.__name__: _curve(family) for family in FAMILIES},
        "add_sine": _add_sine(),
        "velocity": _velocity(),
        "displacement": _displacement(),
        "along_path": _along_path(),
        "turns": _turns(),
        "steady": _steady(),
        "first_samples": _first_samples(),
        "recursion": _recursion(),
        "check_sideslip": _check_sideslip(),
        "motion": _motion(),
    }


@cache
def driver(many: bool = True) -> Callable[..., int] | None:
    """Return the compiled `plan` of driver.c; None without a compiler.

    With `many` it takes half the time, and its compilation twice the time.
    """
    library = together(planning_kernels(), _code(), many=many)
    if library is None:
        return None
    function: Callable[..., int] = library.plan
    library.plan.argtypes = [ctypes.c_int] + [ctypes.c_void_p] * 5
    return function


def _code() -> str:
    """Return the C code of the driver."""
    names = ", ".join(family.__name__ for family in FAMILIES)
    sizes = {"FAMILY_COUNT": len(FAMILIES), "FIXED_POINT": FIXED_POINT, "VEHICLE": VEHICLE_ROWS, "LIMITS": LIMIT_ROWS}
    head = "".join(f"#define {name} {value}\n" for name, value in {"FAMILIES": names, **sizes}.items())
    return head + FilePath(__file__).with_name("driver.c").read_text(encoding="utf-8")


def planning_digest() -> str:
    """Return the hash of the C source of all plans."""
    return library_digest(planning_kernels(), _code())


def _of(family: type, numbers: Mapping[str, Any]) -> Any:
    """Return a path of a family with these fields, which may be symbols, without a check."""
    path: Any = object.__new__(family)
    for name, number in numbers.items():
        object.__setattr__(path, name, number)
    return path


def _curve(family: type) -> Kernel:
    """Return the kernel of `Family.formulas`."""
    names = [field.name for field in fields(family)][: -len(POSE)]

    def equation(t: Any, p: Any) -> dict[str, Any]:
        path = _of(family, dict(zip(names, p, strict=True)))
        return {"derivatives": [number for pair in path.formulas(t[0], SYMBOLS) for number in pair]}

    return Kernel.traced(equation, {"t": 1, "p": len(names)}, shared=["p"])


def _add_sine() -> Kernel:
    """Return the kernel of the course of a `RandomSmooth`; each step adds a sine of its turn rate."""

    def equation(course: Any, t: Any, sine: Any) -> dict[str, Any]:
        return {"course": with_sine(course, sine, t[0], SYMBOLS)}

    return Kernel.traced(equation, {"course": 3, "t": 1, "sine": 3}, ["sine"], shared=["sine"])


def _velocity() -> Kernel:
    """Return the kernel of velocity, acceleration and jerk of a `RandomSmooth`, for its course."""
    names = ("speed", "speed_variation", "speed_frequency", "speed_phase")

    def equation(course: Any, t: Any, p: Any) -> dict[str, Any]:
        path = _of(RandomSmooth, dict(zip(names, p, strict=True)))
        return {"rates": [number for pair in path.rates(course, t[0], SYMBOLS) for number in pair]}

    return Kernel.traced(equation, {"course": 3, "t": 1, "p": len(names)}, shared=["p"])


def _displacement() -> Kernel:
    """Return the kernel of the displacement between two samples."""

    def equation(t: Any, next_t: Any, rates: Any, next_rates: Any) -> dict[str, Any]:
        return {"displacement": displacement(next_t[0] - t[0], _pairs(rates), _pairs(next_rates))}

    return Kernel.traced(equation, {"t": 1, "next_t": 1, "rates": 6, "next_rates": 6})


def _along_path() -> Kernel:
    """Return the kernel of position, `PathRates`, sideslip terms and `response` of a path, and a check of its rates."""

    def equation(derivatives: Any, pose: Any, scale: Any, coefficients: Any) -> dict[str, Any]:
        c = Coefficients(*coefficients)
        pairs = placed(_pairs(derivatives), pose, SYMBOLS)
        along = path_rates(pairs, SYMBOLS)
        rate, limit = braking(along.v_p, along.v_p_dot, c)
        return {
            "position": pairs[0],
            "along": [getattr(along, name) for name in RATES],
            "terms": [scale[0] * term for term in sideslip_terms(along, c)],
            "response": [response(along, c, SYMBOLS)],
            "refused": [~(moving(along.v_p) & (rate < limit))],
        }

    rows = {"derivatives": 8, "pose": 3, "scale": 1, "coefficients": VEHICLE_ROWS}
    return Kernel.traced(equation, rows, shared=["pose", "scale", "coefficients"])


def _turns() -> Kernel:
    """Return the kernel of the full turns between two directions, and a check of the change of direction."""

    def equation(beta: Any, next_beta: Any) -> dict[str, Any]:
        change = next_beta[0] - beta[0]
        return {"turns": [SYMBOLS.floor(change / (2 * math.pi) + 0.5)], "refused": [~gradual(change, SYMBOLS)]}

    return Kernel.traced(equation, {"beta": 1, "next_beta": 1})


def _steady() -> Kernel:
    """Return the kernel of `steady_sideslip`."""

    def equation(along: Any, coefficients: Any) -> dict[str, Any]:
        return {"w": [steady_sideslip(PathRates(*along), Coefficients(*coefficients), SYMBOLS)]}

    return Kernel.traced(equation, {"along": len(RATES), "coefficients": VEHICLE_ROWS}, shared=["coefficients"])


def _first_samples() -> Kernel:
    """Return the kernel of one fixed-point iteration of the implicit formula for the first `ORDER` samples.

    `inputs` are the terms of each sample. For `weights` see `formula_weights`.
    """

    def equation(u: Any, inputs: Any, weights: Any) -> dict[str, Any]:
        terms = (inputs[j : j + SIDESLIP_TERMS] for j in range(0, SIDESLIP_TERMS * ORDER, SIDESLIP_TERMS))
        F = [sideslip_rest(parts, w, SYMBOLS.sqrt) for parts, w in zip(terms, u, strict=True)]
        decays, rows = weights[: ORDER - 1], [weights[j : j + ORDER] for j in range(ORDER - 1, len(weights), ORDER)]
        after = [weighted_sum(decay * u[0], row, F) for decay, row in zip(decays, rows, strict=True)]
        return {"u": (u[0], *after), "rest": F}

    return Kernel.traced(equation, {"u": ORDER, "inputs": SIDESLIP_TERMS * ORDER, "weights": (ORDER - 1) * (ORDER + 1)})


def _recursion() -> Kernel:
    """Return the kernel of one step of the explicit formula.

    `history` is u_n, F_(n-1), F_(n-2), F_(n-3); `weights` are the decay and g_3 ... g_0, see `formula_weights`.
    """

    def equation(history: Any, weights: Any, inputs: Any) -> dict[str, Any]:
        u_n, *past = history
        F = [sideslip_rest(inputs, u_n, SYMBOLS.sqrt), *past]
        decay, *g = weights
        u = weighted_sum(decay * u_n, g[::-1], F)
        return {"history": (u, *F[:-1]), "u": (u,)}

    return Kernel.traced(equation, {"history": ORDER, "weights": ORDER + 1, "inputs": SIDESLIP_TERMS}, ["inputs", "u"])


def _check_sideslip() -> Kernel:
    """Return the kernel of a check of the sideslip."""
    return Kernel.traced(lambda w: {"refused": [~sideslip_allowed(w[0])]}, {"w": 1})


def _motion() -> Kernel:
    """Return the kernel of `in_sideslip`, and a check of the limits."""

    def equation(along: Any, w: Any, coefficients: Any, limits: Any) -> dict[str, Any]:
        *motion, F_u, F_r, gamma = in_sideslip(
            PathRates(*along), w[0], Coefficients(*coefficients), (0.0, 0.0), SYMBOLS
        )
        valid = (abs(F_u) <= limits[0]) & (abs(F_r) <= torque_limit(motion[1], limits[:3], SYMBOLS))
        for number, most in zip((*motion[1:], F_u, F_r), limits[3:], strict=True):
            valid = valid & (abs(number) <= most)
        return {"motion": (*motion, F_u, F_r), "gamma": [gamma], "refused": [~valid]}

    rows = {"along": len(RATES), "w": 1, "coefficients": VEHICLE_ROWS, "limits": LIMIT_ROWS}
    return Kernel.traced(equation, rows, shared=["coefficients", "limits"])


def _pairs(rows: Sequence[Any]) -> list[tuple[Any, Any]]:
    return list(zip(rows[::2], rows[1::2], strict=True))

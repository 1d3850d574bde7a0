"""What an agent sees and what it is paid for: observation, reward and termination, shared by every environment.

The scales of the observation are fixed powers of two, so that decoding returns the encoded numbers exactly.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_gym.namespaces import Namespace, Number


class Term(NamedTuple):
    """One entry of the observation: the physical quantity divided by `scale`, clipped to +-`bound`."""

    name: str
    unit: str
    scale: float  # [unit]
    bound: float  # of the scaled value
    meaning: str


L, V, W = 64.0, 16.0, 8.0
"""Bounds of positions [m], velocities [m/s] and yaw rates [rad/s] in an observation."""

TERMS = (
    Term("e_x", "m", 1.0, L, "measured position error along the body's surge axis, R(psi)^T (x_e, y_e)"),
    Term("e_y", "m", 1.0, L, "the same along the sway axis"),
    Term("psi_e", "rad", 0.5, 2 * math.pi, "measured heading error, in [-pi, pi)"),
    Term("u_e", "m/s", 0.5, V / 0.5, "measured surge velocity error, over ground"),
    Term("v_e", "m/s", 0.5, V / 0.5, "measured sway velocity error, over ground"),
    Term("r_e", "rad/s", 0.125, W / 0.125, "measured yaw rate error"),
    Term("u_R", "m/s", 0.5, V / 0.5, "reference surge velocity"),
    Term("v_R", "m/s", 0.5, V / 0.5, "reference sway velocity"),
    Term("r_R", "rad/s", 0.125, W / 0.125, "reference yaw rate"),
    Term("F_uR", "N", 128.0, 64.0, "reference surge force (16a)"),
    Term("F_rR", "N m", 64.0, 64.0, "reference yaw torque (16b)"),
    Term("cos_psi", "1", 1.0, 1.0, "cosine of the measured heading"),
    Term("sin_psi", "1", 1.0, 1.0, "sine of the measured heading"),
    Term("F_u_max", "N", 128.0, 64.0, "surge force that action 1 commands"),
    Term("F_r_max", "N m", 64.0, 64.0, "yaw torque that action 1 commands"),
    Term("a_u", "1", 1.0, 1.0, "previous action, surge"),
    Term("a_r", "1", 1.0, 1.0, "previous action, yaw"),
    Term("dt", "s", 0.125, 80.0, "control period"),
)
SIZE = len(TERMS)
SCALES = np.array([term.scale for term in TERMS])
INVERSE_SCALES = 1.0 / SCALES
BOUNDS = np.array([term.bound for term in TERMS])


class Observation(NamedTuple):
    """A decoded observation in SI units, the fields of `TERMS`: floats, or arrays of shape (N,)."""

    e_x: Number
    e_y: Number
    psi_e: Number
    u_e: Number
    v_e: Number
    r_e: Number
    u_R: Number
    v_R: Number
    r_R: Number
    F_uR: Number
    F_rR: Number
    cos_psi: Number
    sin_psi: Number
    F_u_max: Number
    F_r_max: Number
    a_u: Number
    a_r: Number
    dt: Number


def encode_observation(terms: Sequence[float]) -> NDArray[np.float64]:
    """Return the observation, shape (SIZE,), of terms in SI units."""
    observation = np.array(terms)
    observation *= INVERSE_SCALES
    e_x, e_y, _, u_e, v_e, r_e = terms[:6]
    if not (-L < e_x < L and -L < e_y < L and -V < u_e < V and -V < v_e < V and -W < r_e < W):
        np.clip(observation, -BOUNDS, BOUNDS, out=observation)  # rarely, as it costs more than the comparisons
    return observation


def encode_rows(terms: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Return N observations, shape (N, SIZE), of terms in SI units that are rows of shape (N,).

    In memory a term stays a row: a transposed copy would cost as much as a tenth of the whole step.
    """
    rows = np.array(terms)
    rows *= INVERSE_SCALES[:, None]
    errors, bounds = rows[:6], BOUNDS[:6, None]  # the other terms are inside by construction
    np.minimum(errors, bounds, out=errors)
    np.maximum(errors, -bounds, out=errors)
    return rows.T


def decode_observation(observation: NDArray[Any]) -> Observation:
    """Return the physical terms of an observation of shape (SIZE,) as floats, or of (N, SIZE) as arrays (N,).

    Exact, but for terms that were clipped at their bound. Further columns, as the residual environment's, are ignored.

    Raises:
        ValueError: the array has another number of dimensions, or fewer columns.
    """
    return Observation._make(decoded_terms(observation))


def decoded_terms(observation: NDArray[Any]) -> Any:
    """Return what `decode_observation` does as a plain list of floats or an array of rows: a third of its cost."""
    shape = observation.shape
    if not 1 <= len(shape) <= 2 or shape[-1] < SIZE:
        raise ValueError(f"observation has shape {shape}; it must be ({SIZE},) or (N, {SIZE}), or wider")
    if shape[-1] > SIZE:
        observation = observation[..., :SIZE]
    terms = observation * SCALES
    return terms.tolist() if len(shape) == 1 else terms.T


def check_reference(table: NDArray[np.float64]) -> None:
    """Raise ValueError if a reference table, shape (T, 8, ...), has rates or forces beyond the observation's bounds."""
    for column, i in zip(range(3, 8), range(6, 11), strict=True):
        largest, bound = float(np.abs(table[:, column]).max()), float(BOUNDS[i] * SCALES[i])
        if not largest <= bound:
            raise ValueError(
                f"reference {TERMS[i].name} reaches {largest:.4g} {TERMS[i].unit}; at most {bound:g} can be observed"
            )


def reward(
    squared_error: Number, squared_change: Number, error_scale: Number, rate_weight: Number, ns: Namespace
) -> Number:
    """Return 1 / sqrt(1 + (e / error_scale)^2) - rate_weight |a_k - a_(k-1)|^2.

    It peaks at 1 for zero position error e, falls like 1/e far away so that a lost vehicle still sees a slope, and is
    positive at a steady action, so that ending an episode early never pays. Heading is left free: under a current the
    crab angle is part of the solution.
    """
    return 1 / ns.sqrt(1 + squared_error / (error_scale * error_scale)) - rate_weight * squared_change


def lost(squared_error: Number, lost_distance: Number) -> Number:
    """Return whether the vehicle is lost: farther than lost_distance [m] from the reference."""
    return squared_error > lost_distance * lost_distance

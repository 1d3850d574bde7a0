"""The observation, for all environments.

Its scales are fixed powers of two, so decoding returns the encoded numbers exactly.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Any, NamedTuple, get_type_hints

import numpy as np
from numpy.typing import NDArray

from auv_gym.physics.dynamics import Force
from auv_gym.physics.namespaces import ARRAYS, FLOATS, Constants, Namespace, Number


class Term(NamedTuple):
    """A term of the observation: a physical quantity divided by `scale`, clipped to +-`bound`."""

    name: str
    unit: str
    scale: float  # [unit]
    bound: float  # of the scaled value
    meaning: str


L = 64.0  # [m] bound of positions in an observation
V = 16.0  # [m/s] bound of velocities in an observation
W = 8.0  # [rad/s] bound of yaw rates in an observation


class Observation(NamedTuple):
    """A decoded observation in SI units: floats, or arrays of shape (N,). Annotations hold the fields of its `Term`."""

    e_x: Annotated[Number, "m", 1.0, L, "measured position error along the body's surge axis, R(psi)^T (x_e, y_e)"]
    e_y: Annotated[Number, "m", 1.0, L, "measured position error along the body's sway axis"]
    psi_e: Annotated[Number, "rad", 0.5, 2 * math.pi, "measured heading error, in [-pi, pi)"]
    u_e: Annotated[Number, "m/s", 0.5, V / 0.5, "measured surge velocity error, over ground"]
    v_e: Annotated[Number, "m/s", 0.5, V / 0.5, "measured sway velocity error, over ground"]
    r_e: Annotated[Number, "rad/s", 0.125, W / 0.125, "measured yaw rate error"]
    u_R: Annotated[Number, "m/s", 0.5, V / 0.5, "reference surge velocity"]
    v_R: Annotated[Number, "m/s", 0.5, V / 0.5, "reference sway velocity"]
    r_R: Annotated[Number, "rad/s", 0.125, W / 0.125, "reference yaw rate"]
    F_uR: Annotated[Number, "N", 128.0, 64.0, "reference surge force (16a)"]
    F_rR: Annotated[Number, "N m", 64.0, 64.0, "reference yaw torque (16b)"]
    cos_psi: Annotated[Number, "1", 1.0, 1.0, "cosine of the measured heading"]
    sin_psi: Annotated[Number, "1", 1.0, 1.0, "sine of the measured heading"]
    F_u_max: Annotated[Number, "N", 128.0, 64.0, "surge force that action 1 commands"]
    F_r_max: Annotated[Number, "N m", 64.0, 64.0, "yaw torque that action 1 commands"]
    a_u: Annotated[Number, "1", 1.0, 1.0, "previous action, surge"]
    a_r: Annotated[Number, "1", 1.0, 1.0, "previous action, yaw"]
    dt: Annotated[Number, "s", 0.125, 80.0, "control period"]


TERMS = tuple(Term(name, *hint.__metadata__) for name, hint in get_type_hints(Observation, include_extras=True).items())
"""The terms of an observation in their order."""
SIZE = len(TERMS)  # number of terms
SCALES = np.array([term.scale for term in TERMS])  # (SIZE,) divisors of the terms in SI units
BOUNDS = np.array([term.bound for term in TERMS])  # (SIZE,) bounds of the scaled terms
ERROR_TERMS = 6
"""Number of the first terms that are clipped; the others are within their bounds by construction."""

_SCALES, _INVERSE = Constants.of(SCALES), Constants.of(1.0 / SCALES)
_LARGE = "m", "N", "N m"
"""Units of the terms whose bounds depend on the size of the vehicle."""


def bounds(bound_factor: int) -> NDArray[np.float64]:
    """Return the bounds of the scaled terms, shape (SIZE,): `BOUNDS`, times a factor for lengths, forces and torques.

    The scales are the same for all vehicles, so an observation is decoded without its scenario. Scenarios of ships have
    wider bounds of lengths and forces: their bound factor is a power of two above 1.
    """
    return BOUNDS * np.where([term.unit in _LARGE for term in TERMS], float(bound_factor), 1.0)


_ERROR_BOUNDS = {2**k: Constants.of(bounds(2**k)[:ERROR_TERMS]) for k in range(32)}  # by bound factor


def encode(terms: Sequence[Number], ns: Namespace, bound_factor: int) -> Any:
    """Return observations, with the terms on the first axis, for terms in SI units; for the bound factor see `bounds`.

    For a single vehicle a check of the bounds takes less time than clipping.
    """
    rows = ns.scaled(terms, _INVERSE)
    (e_x, e_y, _, u_e, v_e, r_e), far = terms[:ERROR_TERMS], L * bound_factor
    if ns is not FLOATS or not (
        -far < e_x < far and -far < e_y < far and -V < u_e < V and -V < v_e < V and -W < r_e < W
    ):
        rows[:ERROR_TERMS] = ns.bounded(rows[:ERROR_TERMS], _ERROR_BOUNDS[bound_factor])
    return rows if isinstance(rows, np.ndarray) else ns.stack(rows)


def decode(rows: Any, ns: Namespace) -> Any:
    """Return the terms in SI units of observations with the terms on the first axis."""
    return ns.scaled(rows, _SCALES)


def encode_observation(terms: Sequence[float], bound_factor: int = 1) -> NDArray[np.float64]:
    """Return the observation, shape (SIZE,), of terms in SI units; for the bound factor see `bounds`."""
    observation: NDArray[np.float64] = encode(terms, FLOATS, bound_factor)
    return observation


def decode_observation(observation: NDArray[Any]) -> Observation:
    """Return the physical terms of an observation of shape (SIZE,) as floats, or of (N, SIZE) as arrays (N,).

    It is exact except for clipped terms. Further columns, such as those of the residual environment, are ignored.

    Raises:
        ValueError: the array has another number of dimensions, or fewer columns.
    """
    return Observation._make(decoded_terms(observation))


def decoded_terms(observation: NDArray[Any]) -> Any:
    """Return the terms of `decode_observation` as a list of floats or an array of rows, in a third of the time."""
    shape = observation.shape
    if not 1 <= len(shape) <= 2 or shape[-1] < SIZE:
        raise ValueError(f"observation has shape {shape}; it must be ({SIZE},) or (N, {SIZE}), or wider")
    if shape[-1] > SIZE:
        observation = observation[..., :SIZE]
    return decode(observation, FLOATS).tolist() if len(shape) == 1 else decode(observation.T, ARRAYS)


F_U_MAX = Observation._fields.index("F_u_max")  # index of the surge limit in an observation
F_R_MAX = Observation._fields.index("F_r_max")  # index of the yaw limit in an observation


def action_of(forces: Force, o: Sequence[Number], ns: Namespace) -> tuple[Number, Number]:
    """Return the action that commands F_u [N], F_r [N m], clipped to [-1, 1].

    Args:
        forces: F_u, F_r.
        o: an `Observation`, or its terms in that order.
        ns: the namespace of the numbers.
    """
    F_u, F_r = forces
    return ns.clip(F_u / o[F_U_MAX], -1.0, 1.0), ns.clip(F_r / o[F_R_MAX], -1.0, 1.0)


def reference_bounds(bound_factor: int) -> list[float]:
    """Return the largest |u|, |v|, |r|, |F_u|, |F_r| of a reference within the `bounds`, in SI units."""
    first, end = map(Observation._fields.index, ("u_R", "cos_psi"))
    most: list[float] = (bounds(bound_factor) * SCALES)[first:end].tolist()
    return most

"""What an agent sees and what it is paid for: observation, reward and termination, shared by every environment.

The scales of the observation are fixed powers of two, so that decoding returns the encoded numbers exactly.
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
    """One entry of the observation: the physical quantity divided by `scale`, clipped to +-`bound`."""

    name: str
    unit: str
    scale: float  # [unit]
    bound: float  # of the scaled value
    meaning: str


L = 64.0  # [m] bound of positions in an observation
V = 16.0  # [m/s] bound of velocities in an observation
W = 8.0  # [rad/s] bound of yaw rates in an observation


class Observation(NamedTuple):
    """A decoded observation in SI units: floats, or arrays of shape (N,); behind each field the rest of its `Term`."""

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
"""The entries of an observation, in its order."""
SIZE = len(TERMS)  # of an observation without a preview
SCALES = np.array([term.scale for term in TERMS])  # (SIZE,) by which terms in SI units are divided
BOUNDS = np.array([term.bound for term in TERMS])  # (SIZE,) of the scaled terms
ERROR_TERMS = 6
"""How many of the terms, the first ones, may leave their bounds: the others are inside of them by construction."""

_SCALES, _INVERSE = Constants.of(SCALES), Constants.of(1.0 / SCALES)
_LARGE = "m", "N", "N m"
"""Units of the terms that are larger for larger vehicles."""


def bounds(span: int) -> NDArray[np.float64]:
    """Return the bounds of the scaled terms, shape (SIZE,): `BOUNDS`, those of lengths and forces `span` times as wide.

    The scales are the same for every vehicle, so that an observation is decoded without knowing whose it is; a ship's
    lengths and forces have wider bounds, by a power of two that its scenario says.
    """
    return BOUNDS * np.where([term.unit in _LARGE for term in TERMS], float(span), 1.0)


_ERROR_BOUNDS = {2**k: Constants.of(bounds(2**k)[:ERROR_TERMS]) for k in range(32)}  # by span


def encode(terms: Sequence[Number], ns: Namespace, span: int) -> Any:
    """Return observations, their first axis counting the terms, for terms in SI units: each over its scale, bounded.

    The span widens the `bounds`.

    Bounding costs a single vehicle more than seeing that it need not be done.
    """
    rows = ns.scaled(terms, _INVERSE)
    (e_x, e_y, _, u_e, v_e, r_e), far = terms[:ERROR_TERMS], L * span
    if ns is not FLOATS or not (
        -far < e_x < far and -far < e_y < far and -V < u_e < V and -V < v_e < V and -W < r_e < W
    ):
        rows[:ERROR_TERMS] = ns.bounded(rows[:ERROR_TERMS], _ERROR_BOUNDS[span])
    return rows if isinstance(rows, np.ndarray) else ns.stack(rows)


def decode(rows: Any, ns: Namespace) -> Any:
    """Return the terms in SI units of observations whose first axis counts the terms."""
    return ns.scaled(rows, _SCALES)


def encode_observation(terms: Sequence[float], span: int = 1) -> NDArray[np.float64]:
    """Return the observation, shape (SIZE,), of terms in SI units; a ship's scenario has a `span` beyond 1."""
    observation: NDArray[np.float64] = encode(terms, FLOATS, span)
    return observation


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
    return decode(observation, FLOATS).tolist() if len(shape) == 1 else decode(observation.T, ARRAYS)


F_U_MAX = Observation._fields.index("F_u_max")  # the place of the surge limit in an observation
F_R_MAX = Observation._fields.index("F_r_max")  # the place of the yaw limit in an observation


def action_of(forces: Force, o: Sequence[Number], ns: Namespace) -> tuple[Number, Number]:
    """Return the action that commands F_u [N], F_r [N m], within [-1, 1].

    Args:
        forces: F_u, F_r.
        o: an `Observation`, or its terms in that order; what an action of 1 commands is among them.
        ns: the namespace of the numbers.
    """
    F_u, F_r = forces
    return ns.clip(F_u / o[F_U_MAX], -1.0, 1.0), ns.clip(F_r / o[F_R_MAX], -1.0, 1.0)


_REFERENCE_TERMS = [TERMS[k] for k in range(*map(Observation._fields.index, ("u_R", "cos_psi")))]
"""Velocities and forces of the reference, as in an observation."""


def reference_bounds(span: int) -> list[float]:
    """Return how large |u|, |v|, |r|, |F_u|, |F_r| of a reference may be, in SI units, to be within the `bounds`."""
    most = dict(zip(Observation._fields, (bounds(span) * SCALES).tolist(), strict=True))
    return [most[term.name] for term in _REFERENCE_TERMS]


def check_reference(table: NDArray[np.float64], span: int) -> None:
    """Raise ValueError if a reference table, shape (T, 8), has rates or forces beyond the observation's bounds."""
    largest = np.abs(table[:, 3:]).max(axis=0).tolist()
    for term, value, bound in zip(_REFERENCE_TERMS, largest, reference_bounds(span), strict=True):
        if not value <= bound:
            raise ValueError(
                f"reference {term.name} reaches {value:.4g} {term.unit}; at most {bound:g} can be observed"
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


def failed(squared_error: Number, lost_distance: Number) -> Number:
    """Return whether the vehicle is lost: farther than lost_distance [m] from the reference."""
    return (squared_error <= lost_distance * lost_distance) ^ True  # so that what is no number any more is lost, too

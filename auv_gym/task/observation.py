"""The observation, for all environments.

Its scales are fixed powers of two, so decoding returns the encoded numbers exactly.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, NamedTuple, get_type_hints

import numpy as np
from numpy.typing import NDArray

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


_LARGE = "m", "N", "N m"
"""Units of the terms whose bounds depend on the size of the vehicle."""


@dataclass(frozen=True)
class Layout:
    """How the terms of an observation are encoded."""

    terms: tuple[Term, ...]
    clipped: int  # number of the first terms that are clipped; the others are within their bounds by construction
    limits: tuple[int, ...]  # indices of the limits of the channels
    last: tuple[int, ...]  # indices of the previous action
    named: Any  # makes the NamedTuple of the terms from a sequence

    @classmethod
    def of(cls, observation: Any) -> Layout:
        """Return the layout of a NamedTuple of terms, of which `F_c_max` and `a_c` are those of a channel c.

        The errors come first: terms whose names end in `_e` or begin with `e_`.
        """
        hints = get_type_hints(observation, include_extras=True)
        names = list(hints)
        clipped = sum(name.endswith("_e") or name.startswith("e_") for name in names)
        limits = (i for i, name in enumerate(names) if name.endswith("_max"))
        last = (i for i, name in enumerate(names) if name.startswith("a_"))
        terms = (Term(name, *hint.__metadata__) for name, hint in hints.items())
        return cls(tuple(terms), clipped, tuple(limits), tuple(last), observation._make)

    @cached_property
    def positive(self) -> list[int]:
        """Indices of the limits and of the control period, which are positive in a valid observation."""
        return [*self.limits, [term.name for term in self.terms].index("dt")]

    @cached_property
    def axes(self) -> int:
        """Number of axes of the position."""
        return sum(term.name in ("e_x", "e_y", "e_z") for term in self.terms)

    @cached_property
    def velocity(self) -> list[int]:
        """Indices of the reference velocities u_R, v_R, in space w_R."""
        return [i for i, term in enumerate(self.terms) if term.name in ("u_R", "v_R", "w_R")]

    @cached_property
    def size(self) -> int:
        """Number of terms."""
        return len(self.terms)

    @cached_property
    def scales(self) -> NDArray[np.float64]:
        """Divisors of the terms in SI units, shape (size,)."""
        return np.array([term.scale for term in self.terms])

    def bounds(self, bound_factor: int) -> NDArray[np.float64]:
        """Return the bounds of the scaled terms, shape (size,), with a factor for lengths, forces and torques.

        The scales are the same for all vehicles, so an observation is decoded without its scenario. Scenarios of ships
        have wider bounds of lengths and forces: their bound factor is a power of two above 1.
        """
        known = np.array([term.bound for term in self.terms])
        return known * np.where([term.unit in _LARGE for term in self.terms], float(bound_factor), 1.0)

    @cached_property
    def _constants(self) -> tuple[Constants, Constants]:
        return Constants.of(self.scales), Constants.of(1.0 / self.scales)

    @cached_property
    def _error_bounds(self) -> dict[int, Constants]:
        return {2**k: Constants.of(self.bounds(2**k)[: self.clipped]) for k in range(32)}

    def encode(self, terms: Sequence[Number], ns: Namespace, bound_factor: int) -> Any:
        """Return observations, with the terms on the first axis, for terms in SI units."""
        rows = ns.scaled(terms, self._constants[1])
        rows[: self.clipped] = ns.bounded(rows[: self.clipped], self._error_bounds[bound_factor])
        return rows if isinstance(rows, np.ndarray) else ns.stack(rows)

    def decode(self, rows: Any, ns: Namespace) -> Any:
        """Return the terms in SI units of observations with the terms on the first axis."""
        return ns.scaled(rows, self._constants[0])

    def terms_of(self, observation: NDArray[Any]) -> Any:
        """Return the terms in SI units of observations (size,) or (N, size), or wider: a list of floats, or rows (N,).

        Raises:
            ValueError: the array has another number of dimensions, or fewer columns.
        """
        shape = observation.shape
        if not 1 <= len(shape) <= 2 or shape[-1] < self.size:
            raise ValueError(f"observation has shape {shape}; it must be ({self.size},) or (N, {self.size}), or wider")
        if shape[-1] > self.size:
            observation = observation[..., : self.size]
        return self.decode(observation, FLOATS).tolist() if len(shape) == 1 else self.decode(observation.T, ARRAYS)

    def action_of(self, forces: Sequence[Number], o: Sequence[Number], ns: Namespace) -> tuple[Number, ...]:
        """Return the action that commands forces [N], [N m], one for each channel, clipped to [-1, 1].

        Args:
            forces: of the channels, F_u and F_r in the plane.
            o: the terms of an observation in SI units.
            ns: the namespace of the numbers.
        """
        clip = ns.clip
        return tuple([clip(F / o[i], -1.0, 1.0) for F, i in zip(forces, self.limits, strict=True)])


PLANE_LAYOUT = Layout.of(Observation)
"""How an observation in the plane is encoded."""
TERMS, SIZE, SCALES, ERROR_TERMS = PLANE_LAYOUT.terms, PLANE_LAYOUT.size, PLANE_LAYOUT.scales, PLANE_LAYOUT.clipped
"""The terms of an observation in the plane in their order, their number, their divisors, and how many are clipped."""
bounds, encode, decode = PLANE_LAYOUT.bounds, PLANE_LAYOUT.encode, PLANE_LAYOUT.decode
action_of, decoded_terms = PLANE_LAYOUT.action_of, PLANE_LAYOUT.terms_of


def encode_observation(terms: Sequence[float], bound_factor: int = 1) -> NDArray[np.float64]:
    """Return the observation, shape (SIZE,), of terms in SI units; for the bound factor see `bounds`."""
    observation: NDArray[np.float64] = encode(terms, FLOATS, bound_factor)
    return observation


def reference_bounds(bound_factor: int, layout: Layout = PLANE_LAYOUT) -> list[float]:
    """Return the largest velocities and forces of a reference within the `bounds`, in SI units: u, v, r, F_u, F_r."""
    names = [term.name for term in layout.terms]
    first, end = names.index("u_R"), names.index("F_rR") + 1
    most: list[float] = (layout.bounds(bound_factor) * layout.scales)[first:end].tolist()
    return most

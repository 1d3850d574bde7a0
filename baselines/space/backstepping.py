"""Tracking law of the paper in space: the law of the plane, `baselines.control.backstepping`, for both planes.

It is not a law of the paper, which treats the plane. Each plane has its errors, its gains and its torque as there. The
loads that the planes put on each other, restoring moment included, are cancelled as (21) and (22) cancel the others.
Only local stability is known, see docs/theory.md.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

from auv_gym.physics.intervals import check_number
from auv_gym.physics.namespaces import FLOATS, Namespace, Number
from auv_gym.physics.space import Errors, SpaceVehicle, coupling
from auv_gym.scenarios.vehicles import PAPER
from auv_gym.task.observation import Layout
from auv_gym.task.policy import Law
from auv_gym.task.space import SPACE, Observation
from baselines.control import backstepping
from baselines.control.backstepping import GAINS, Gains
from baselines.policy import squared_speed

_WANTED = slice(Observation._fields.index("theta_R"), Observation._fields.index("F_rR") + 1)


class Wanted(NamedTuple):
    """What the law needs of a reference: pitch, velocities and open-loop forces."""

    theta: Number  # [rad]
    u: Number  # [m/s]
    v: Number  # [m/s]
    w: Number  # [m/s]
    q: Number  # [rad/s]
    r: Number  # [rad/s]
    F_u: Number  # [N]
    F_q: Number  # [N m]
    F_r: Number  # [N m]


def wanted(o: Sequence[Number]) -> Wanted:
    """Return what the law needs of the reference of a `task.space.Observation`, or of its terms."""
    return Wanted(*o[_WANTED])


def bounded_error(errors: Sequence[Number], reference: Wanted, horizon: float, ns: Namespace = FLOATS) -> Errors:
    """Return the errors with the position error e replaced by e / sqrt(1 + |e|^2 / (horizon U)^2).

    See `backstepping.bounded_error`; U is the reference speed and `horizon` a time [s].
    """
    o = Errors(*errors)
    distance = o.e_x * o.e_x + o.e_y * o.e_y + o.e_z * o.e_z
    shrink = 1 / ns.sqrt(1 + distance / (horizon * horizon * squared(reference, ns)))
    return o._replace(e_x=shrink * o.e_x, e_y=shrink * o.e_y, e_z=shrink * o.e_z)


def squared(reference: Wanted, ns: Namespace) -> Number:
    """Return the squared reference speed, which is not 0."""
    return squared_speed(reference.u, reference.v, ns) + reference.w * reference.w


def tracking_forces(
    errors: Sequence[Number],
    theta: Number,
    reference: Wanted,
    vehicle: SpaceVehicle,
    gains: Gains,
    horizon: float | None = None,
    ns: Namespace = FLOATS,
) -> tuple[Number, Number, Number]:
    """Return F_u [N], F_q [N m], F_r [N m] of the tracking law.

    Args:
        errors: `auv_gym.physics.space.Errors` in SI units.
        theta: measured pitch [rad].
        reference: see `Wanted`.
        vehicle: nominal model of the law.
        gains: those of the plane; the normalised form is scaled by the whole reference speed.
        horizon: bound on the position error as a travel time [s], see `bounded_error`. None: no bound.
        ns: the namespace of the numbers.
    """
    o, R = errors if horizon is None else bounded_error(errors, reference, horizon, ns), reference
    e_x, e_y, e_z, theta_e, psi_e, u_e, v_e, w_e, q_e, r_e = o
    level = e_x, e_y, psi_e, u_e, v_e, r_e, R.u, R.v, R.r, R.F_u, R.F_r
    upright = e_x, e_z, -theta_e, u_e, w_e, -q_e, R.u, R.w, -R.q, R.F_u, -R.F_q
    F_u, F_r = backstepping.tracking_forces(level, vehicle.horizontal, _shared(gains, R.v, R, ns), ns)
    _, F_s = backstepping.tracking_forces(upright, vehicle.vertical, _shared(gains, R.w, R, ns), ns)
    planned = R.u, R.v, R.w, R.q, R.r
    moving = [nu + nu_e for nu, nu_e in zip(planned, o[5:], strict=True)]
    now, then = (coupling(a, nu, vehicle.acting, ns) for a, nu in ((theta, moving), (R.theta, planned)))
    (X, _, N), (_, _, S) = ([a - b for a, b in zip(*loads, strict=True)] for loads in zip(now, then, strict=True))
    return F_u - X, S - F_s, F_r - N


def _shared(gains: Gains, side: Number, reference: Wanted, ns: Namespace) -> Gains:
    """Return the gains for a plane with a sideways speed, whose normalisation knows its own two velocities alone."""
    if gains.reference_speed is None:
        return gains
    share = ns.sqrt(squared_speed(reference.u, side, ns)) / ns.sqrt(squared(reference, ns))
    scaled = copy.copy(gains)
    object.__setattr__(scaled, "reference_speed", gains.reference_speed * share)  # not checked: it may be a symbol
    return scaled


@dataclass(frozen=True)
class SpaceBackstepping(Law):
    """The tracking law in space as a policy, with Stable-Baselines3's `predict`.

    Args:
        gains: a `Gains`, or a name in `backstepping.GAINS`; "auto" are the gains for cruise.
        vehicle: nominal model of the law.
        horizon: bound on the position error as a travel time [s], see `bounded_error`. None: no bound.

    Raises:
        ValueError: unknown gains, or a horizon that is not positive.
    """

    layout: ClassVar[Layout] = SPACE.layout
    gains: Any = "auto"
    vehicle: SpaceVehicle = PAPER.in_space
    horizon: float | None = 3.0

    def __post_init__(self) -> None:
        gains = "cruise" if self.gains == "auto" else self.gains
        if isinstance(gains, str) and gains not in GAINS:
            raise ValueError(f"unknown gains {gains!r}; allowed are a Gains, auto, {', '.join(GAINS)}")
        object.__setattr__(self, "gains", GAINS[gains] if isinstance(gains, str) else gains)
        if self.horizon is not None:
            check_number("horizon", self.horizon, 1e-3, 1e6)

    def forces(self, o: Sequence[Number], ns: Namespace = FLOATS) -> tuple[Number, Number, Number]:
        """Return F_u [N], F_q [N m], F_r [N m] for a `task.space.Observation` in SI units, or its terms."""
        seen = Observation._make(o)
        theta = ns.arctan2(seen.sin_theta, seen.cos_theta)
        return tracking_forces(o[:10], theta, wanted(o), self.vehicle, self.gains, self.horizon, ns)

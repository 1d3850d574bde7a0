"""Tracking law of the paper, section IV, as a pure function of the observation; its speed-normalised form; V1 to V4.

The law is (21), (22), (34), (40) and (47) as printed. Only its local stability is established, by the eigenvalues of
the loop linearised about steady motion and by simulations. The paper's proof has a gap after (48): the conditions on
the gains contradict each other. So no form of the law is claimed to be globally stable, see docs/theory.md.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, NamedTuple

from auv_gym.physics.dynamics import rates
from auv_gym.physics.intervals import check_number
from auv_gym.physics.namespaces import FLOATS, Namespace, Number
from auv_gym.physics.vehicle import PAPER_VEHICLE, Coefficients, Vehicle
from auv_gym.scenarios.vehicles import as_vehicle
from auv_gym.task.policy import Law
from baselines.gains.loading import recorded_gains
from baselines.policy import U_R, V_R, is_fast, reference_speed, squared_speed


class StabilityWarning(UserWarning):
    """The reference is faster than the largest speed for which the gains are known to be stable."""


@dataclass(frozen=True)
class Gains:
    """Gains of the law, named as in the paper, and the largest speed at which they are stable.

    At all speeds from 0.1 m/s to `max_speed`, motion of the paper's vehicle on straight lines and on circles with
    |turn rate| <= 0.3 rad/s is exponentially stable.
    """

    k: float  # [1/s] position
    k1: float  # [1/s] position, nonlinear damping
    cu: float  # [1/s] surge
    ku: float  # [s] surge, nonlinear damping
    c: float  # [1/s] yaw
    kc: float  # [s^3/m^2] yaw, nonlinear damping
    cr: float  # [1/s] heading
    max_speed: float = math.inf  # [m/s]
    reference_speed: float | None = None  # [m/s] U0 of the speed-normalised form; None: the law as printed

    def __post_init__(self) -> None:
        for field in fields(self)[:7]:
            check_number(f"gain {field.name}", getattr(self, field.name), 0, 1e6)
        if self.reference_speed is not None:
            check_number("gain reference_speed", self.reference_speed, 1e-6, 1e6)


GAINS = {
    name: Gains(**record["gains"], max_speed=record["max_speed"] or math.inf)
    for name, record in recorded_gains()["sets"].items()
}
"""Gain sets by name; `gains.loading.GAINS_FILE` has the numbers and the origin of each set."""
LAW_GAINS = ("k", "k1", "cu", "ku", "c", "kc", "cr")
"""Names of the gains of the law as printed."""
UNDAMPED_GAINS = ("k", "cu", "c", "cr", "reference_speed")
"""Names of the gains of the speed-normalised form without nonlinear damping, for laws that estimate disturbances."""


def undamped(gains: Mapping[str, float]) -> Gains:
    """Return the gains of the speed-normalised form without nonlinear damping; other entries are ignored."""
    return Gains(k1=0.0, ku=0.0, kc=0.0, **{name: gains[name] for name in UNDAMPED_GAINS})


class BacksteppingErrors(NamedTuple):
    """Error variables of backstepping, and the factor g of the yaw rate in (28c)."""

    z_u: Number  # [m/s] (28b)
    z_v: Number  # [m/s] (28c), times U0/U in the normalised form
    z_r: Number  # [rad/s] (44c)
    g: Number  # [m/s] m11 u / m22, times U0/U in the normalised form


def backstepping_errors(o: Sequence[Number], mass_ratio: float, gains: Gains, ns: Namespace) -> BacksteppingErrors:
    """Return z_u, z_v, z_r and g for an observation in SI units; `mass_ratio` is m11/m22."""
    e_x, e_y, psi_e, u_e, v_e, r_e, u_R, v_R = o[:8]
    kap = gains.k + gains.k1
    z_v, g = v_e + kap * e_y, mass_ratio * (u_R + u_e)  # (26): alpha = -R^T (K + K_1) x_e
    if gains.reference_speed is not None:
        scale = gains.reference_speed / reference_speed(u_R, v_R, ns)
        z_v, g = scale * z_v, scale * g
    return BacksteppingErrors(u_e + kap * e_x, z_v, r_e - gains.cr * (g * z_v - psi_e), g)  # (40)


def tracking_forces(
    o: Sequence[Number], vehicle: Vehicle | Coefficients, gains: Gains, ns: Namespace = FLOATS
) -> tuple[Number, Number]:
    """Return F_u [N], F_r [N m] of the tracking law from an `Observation` in SI units, or its terms in that order.

    (21) and (22) are as printed, with linear drag. For a vehicle with cross terms they cancel all of its equations: as
    printed they would not stabilise a torpedo whose fins give a side force.
    """
    m11, m22, m33, cr = vehicle.m11, vehicle.m22, vehicle.m33, gains.cr
    z_u, z_v, z_r, g = backstepping_errors(o, m11 / m22, gains, ns)
    _, _, psi_e, u_e, v_e, r_e, u_R, v_R, r_R, F_uR, F_rR = o[:11]
    kap = gains.k + gains.k1
    tau_u = -kap * u_e - (gains.cu + gains.ku * kap * kap) * z_u  # (34)
    tau_r = -z_v - psi_e - cr * (g * g + 1) * r_e - (gains.c + gains.kc * cr * cr * g * g) * z_r  # (47)
    u, v, r = u_R + u_e, v_R + v_e, r_R + r_e
    if vehicle.has_cross_terms:
        row, still = vehicle.acting, (0.0, 0.0, 0.0)
        now, wanted = (rates(0.0 * u, *nu, still, row, ns) for nu in ((u, v, r), (u_R, v_R, r_R)))
        return F_uR + m11 * (tau_u - now[2] + wanted[2]), F_rR + m33 * (tau_r - now[4] + wanted[4])
    return (
        F_uR + vehicle.d11 * u_e - m22 * (v * r - v_R * r_R) + m11 * tau_u,  # (21)
        F_rR + vehicle.d33 * r_e + (m22 - m11) * (u * v - u_R * v_R) + m33 * tau_r,  # (22)
    )


def lyapunov_terms(
    o: Sequence[Number], vehicle: Vehicle, gains: Gains, ns: Namespace = FLOATS
) -> tuple[Number, Number, Number, Number]:
    """Return V1 (25), V2 (29), V3 (38), V4 (45), for diagnosis; V4 can grow although the loop is stable."""
    z_u, z_v, z_r, _ = backstepping_errors(o, vehicle.m11 / vehicle.m22, gains, ns)
    e_x, e_y, psi_e = o[:3]
    V1 = 0.5 * (e_x * e_x + e_y * e_y)
    V2 = V1 + 0.5 * z_u * z_u
    V3 = V2 + 0.5 * (z_v * z_v + psi_e * psi_e)
    return V1, V2, V3, V3 + 0.5 * z_r * z_r


def bounded_error(o: Sequence[Number], horizon: float, ns: Namespace = FLOATS) -> Sequence[Number]:
    """Return the observation with its position error e replaced by e / sqrt(1 + |e|^2 / (horizon U)^2).

    U is the reference speed. The bounded error is less than the distance that the reference travels in `horizon` [s].
    This bounds the commanded heading and forces.
    """
    e_x, e_y, *rest = o
    U2 = squared_speed(o[U_R], o[V_R], ns)
    shrink = 1 / ns.sqrt(1 + (e_x * e_x + e_y * e_y) / (horizon * horizon * U2))
    return shrink * e_x, shrink * e_y, *rest


@dataclass(frozen=True)
class Backstepping(Law):
    """The tracking law as a policy with Stable-Baselines3's `predict`, for one observation or a batch.

    Args:
        gains: a `Gains`, a name in `GAINS`, or two `Gains`: the first for references up to `policy.CRUISE_SPEED`, the
            second for faster ones. "auto": the paper's gains and the cruise gains.
        vehicle: nominal model of the law; an object, a name or a dict.
        horizon: bound on the position error as a travel time [s], see `bounded_error`. None: no bound.

    Raises:
        ValueError: unknown gains or vehicle, or a horizon that is not positive.
    """

    gains: Any = "auto"
    vehicle: Any = PAPER_VEHICLE
    horizon: float | None = None

    def __post_init__(self) -> None:
        gains = self.gains
        if isinstance(gains, str):
            if gains not in GAINS and gains != "auto":
                raise ValueError(f"unknown gains {gains!r}; allowed are a Gains, auto, {', '.join(GAINS)}")
            gains = (GAINS["paper"], GAINS["cruise"]) if gains == "auto" else GAINS[gains]
        object.__setattr__(self, "gains", (gains, gains) if isinstance(gains, Gains) else tuple(gains))
        object.__setattr__(self, "vehicle", as_vehicle(self.vehicle))
        if self.horizon is not None:
            check_number("horizon", self.horizon, 1e-3, 1e6)

    def forces(self, o: Sequence[Number], ns: Namespace = FLOATS) -> tuple[Number, Number]:
        """Return F_u [N], F_r [N m] for an `Observation` in SI units, or its terms in that order."""
        if self.horizon is not None:
            o = bounded_error(o, self.horizon, ns)
        slow, fast = self.gains
        if slow is fast:
            return tracking_forces(o, self.vehicle, fast, ns)
        is_cruise = is_fast(o[U_R], o[V_R])
        if isinstance(is_cruise, bool):
            return tracking_forces(o, self.vehicle, fast if is_cruise else slow, ns)
        slow_forces, fast_forces = (tracking_forces(o, self.vehicle, gains, ns) for gains in (slow, fast))
        return ns.where(is_cruise, fast_forces[0], slow_forces[0]), ns.where(is_cruise, fast_forces[1], slow_forces[1])

    def check(self, terms: Any) -> None:
        """Warn once if the reference is too fast for the gains."""
        u_R = terms[U_R] if isinstance(terms, list) else float(terms[U_R].max(initial=0.0))
        if u_R > (most := self.gains[1].max_speed) and "warned" not in vars(self):
            vars(self)["warned"] = True
            faster = [repr(name) for name, gains in GAINS.items() if gains.max_speed > u_R]
            warnings.warn(
                f"these gains are stable up to {most:g} m/s, but the reference speed is {u_R:.4g} m/s: "
                f"expect growing oscillations; stable at this speed are the gains {', '.join(faster)}",
                StabilityWarning,
                stacklevel=3,
            )

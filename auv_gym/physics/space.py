"""Motion in space: the equations of `auv_gym.physics.dynamics`, called for the horizontal and for the vertical plane.

Axes are right-handed: x ahead, y to port, z up, so that positive theta and q mean nose down. The roll angle is 0, since
the weight acts below the buoyancy. The roll rate is then p = -r tan(theta), not 0: with it the equations do not depend
on the choice of the axes across the body. A plane sees its own two velocities: (v, r) or (w, s) with s = -q. Each puts
loads on the other, see `coupling`; without vertical motion they vanish, and the equations of the plane remain. The
lateral equations are those of T. I. Fossen, Handbook of Marine Craft Hydrodynamics and Motion Control, 2nd ed., 2021,
section 8.4, for a diagonal mass matrix, with the moment that holds the roll angle as their constraint.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple, TypeAlias

from auv_gym.physics import dynamics
from auv_gym.physics.dynamics import from_outside
from auv_gym.physics.errors import to_body, to_world
from auv_gym.physics.intervals import check_number
from auv_gym.physics.namespaces import FLOATS, Namespace, Number
from auv_gym.physics.units import DIMENSIONS, POWERS, Units, in_paper_units
from auv_gym.physics.vehicle import LARGEST_PARAMETER, PARAMETER_NAMES, Coefficients, CrossTerms, Vehicle


class State(NamedTuple):
    """Pose in the world; velocities in the body frame, relative to the water. Floats, or rows of shape (N,)."""

    x: Number  # [m]
    y: Number  # [m] to port of x
    z: Number  # [m] up
    theta: Number  # [rad] pitch, positive nose down
    psi: Number  # [rad] heading, counter-clockwise seen from above
    u: Number  # [m/s] ahead
    v: Number  # [m/s] to port
    w: Number  # [m/s] up
    q: Number  # [rad/s] pitch rate, positive nose down
    r: Number  # [rad/s] yaw rate


class Load(NamedTuple):
    """Total force on the vehicle in the body frame; M and N come with the side forces of fins, see `Vehicle`."""

    X: Number  # [N]
    Y: Number  # [N]
    Z: Number  # [N]
    M: Number  # [N m] positive nose down
    N: Number  # [N m]


class Errors(NamedTuple):
    """Tracking errors, see `tracking_errors`: e_x, e_y, e_z in the body frame, the others per channel."""

    e_x: Number  # [m]
    e_y: Number  # [m]
    e_z: Number  # [m]
    theta_e: Number  # [rad]
    psi_e: Number  # [rad]
    u_e: Number  # [m/s]
    v_e: Number  # [m/s]
    w_e: Number  # [m/s]
    q_e: Number  # [rad/s]
    r_e: Number  # [rad/s]


class Limits(NamedTuple):
    """Limits of the actuators; fins give a torque of at most fin u^2, if fin is not 0."""

    F_u_max: float = math.inf  # [N]
    F_q_max: float = math.inf  # [N m]
    F_r_max: float = math.inf  # [N m]
    fin_q: float = 0.0  # [kg]
    fin_r: float = 0.0  # [kg]


CurrentVelocity: TypeAlias = tuple[Number, Number, Number]
"""V_x, V_y, V_z [m/s] of the water in the world."""
STILL_WATER: CurrentVelocity = (0.0, 0.0, 0.0)  # [m/s]
ROWS = len(PARAMETER_NAMES)  # number of coefficients of a plane
SPACE_ROWS = 2 * ROWS + 3  # number of entries of `SpaceVehicle.acting`
_ONE_PLANE = ("m11", "d11", "X_uu", "eps", "speed")  # parameters that both planes share
_TINY = 1e-280  # [m^2/s^2], [rad^2/s^2] below which a root has no slope; it changes no speed above 1e-132


class SpaceCoefficients(NamedTuple):
    """What the equations of motion need of a vehicle: floats, or rows of shape (N,). Surge drag is in `level` alone."""

    level: Coefficients  # of the horizontal plane
    upright: Coefficients  # of the vertical plane
    stiffness: Number  # [N m] see `SpaceVehicle`
    buoyancy: Number  # [N]
    of_revolution: Number  # 1 or 0

    @property
    def without_lift(self) -> tuple[Number, ...]:
        """The row that `state_rates` takes for a vehicle without lift; it takes less time than `row`."""
        return *self.level.without_lift, *self.upright.without_lift, *self[2:]

    def row(self, cross_terms: Sequence[Number] = ()) -> tuple[Number, ...]:
        """Return the row that `state_rates` takes, with the cross terms of both planes if there are some."""
        half = len(cross_terms) // 2
        return *self.level, *cross_terms[:half], *self.upright, *cross_terms[half:], *self[2:]


@dataclass(frozen=True)
class SpaceVehicle:
    """A vehicle in space: its two planes and its buoyancy.

    The vertical plane has the names of the horizontal one: m22 is its inertia in heave, m33 in pitch, Y_vv its drag in
    heave, and so on. Signs are those of the horizontal plane too, since heave and -q are to it what sway and r are.

    Raises:
        ValueError: the planes differ in a parameter that they share, or differ although the vehicle is a body of
            revolution, the stiffness is negative, or a number is not finite.
    """

    horizontal: Vehicle
    vertical: Vehicle
    stiffness: float = 0.0  # [N m] restoring moment at 90 degrees: weight times distance of mass below buoyancy
    buoyancy: float = 0.0  # [N] buoyancy less weight
    of_revolution: bool = (
        True  # whether quadratic drag goes with the whole cross-flow, sqrt(v^2 + w^2), or with each part
    )

    def __post_init__(self) -> None:
        check_number("vehicle stiffness", self.stiffness, 0.0, LARGEST_PARAMETER)
        check_number("vehicle buoyancy", self.buoyancy, -LARGEST_PARAMETER, LARGEST_PARAMETER)
        for name in _ONE_PLANE:
            if (one := getattr(self.horizontal, name)) != (other := getattr(self.vertical, name)):
                raise ValueError(f"the planes of a vehicle have {name} = {one!r} and {other!r}; it must be the same")
        if self.of_revolution and self.horizontal != self.vertical:
            raise ValueError(
                "the planes of a body of revolution are equal: set of_revolution = false, or one plane only"
            )

    def over(self, units: Units) -> SpaceVehicle:
        """Return the vehicle in the paper's units, for the units of its horizontal plane."""
        level = in_paper_units(self.horizontal)
        similar = {
            name: getattr(self.vertical, name) / units.factor(*POWERS[unit])
            for name, unit in DIMENSIONS.items()
            if name not in _ONE_PLANE
        }
        upright = level if self.has_equal_planes else replace(level, **similar)
        stiffness, buoyancy = (
            x / units.factor(*POWERS[unit]) for x, unit in ((self.stiffness, "N m"), (self.buoyancy, "N"))
        )
        return replace(self, horizontal=level, vertical=upright, stiffness=stiffness, buoyancy=buoyancy)

    @property
    def reversal_speed(self) -> float:
        """Speed [m/s] below which stern fins that lift the nose make the vehicle sink; 0 for a pure torque.

        Fins that hold a pitch against the restoring and the Munk moment push the stern to the other side: by stiffness
        over arm per angle, and by d32 + (m22 - m11 - N_uv) u over arm per heave velocity. Above this speed the lift of
        the pitch is larger. The reversal of a submarine's stern planes has the same cause.
        """
        c = self.vertical
        per_arm = c.eps * c.m22 / c.m33
        side, drag = per_arm * self.stiffness, c.d22 + per_arm * c.d32
        root = drag * drag + 4 * side * (c.Y_uv + per_arm * (c.m22 - c.m11 - c.N_uv))
        return 2 * side / (drag + math.sqrt(root)) if root >= 0 else math.inf

    @property
    def has_equal_planes(self) -> bool:
        """Whether both planes have the same parameters."""
        return self.horizontal == self.vertical

    @property
    def coefficients(self) -> SpaceCoefficients:
        """The numbers of the equations of motion without cross terms."""
        vertical = self.vertical.coefficients._replace(d11=0.0, X_uu=0.0)
        return SpaceCoefficients(
            self.horizontal.coefficients, vertical, self.stiffness, self.buoyancy, float(self.of_revolution)
        )

    @property
    def cross_terms(self) -> tuple[Number, ...]:
        """The cross terms of both planes."""
        return *self.horizontal.cross_terms, *self.vertical.cross_terms

    @property
    def all_coefficients(self) -> tuple[Number, ...]:
        """The shortest row that `state_rates` takes for the vehicle."""
        planes, c = (self.horizontal, self.vertical), self.coefficients
        if any(plane.has_cross_terms for plane in planes):
            return self.acting
        return c.row() if any(plane.has_lift for plane in planes) else c.without_lift

    @property
    def acting(self) -> tuple[Number, ...]:
        """The row of numbers that `state_rates` takes: both planes, stiffness, buoyancy, shape of the body."""
        return self.coefficients.row(self.cross_terms)


@dataclass(frozen=True)
class Pitch:
    """What a vehicle has in the vertical plane: the table [pitch] of its file.

    Raises:
        ValueError: `parameters` has a name that is no parameter of a `Vehicle`, or one that both planes share.
    """

    stiffness: float = 0.0  # [N m] see `SpaceVehicle`
    buoyancy: float = 0.0  # [N]
    of_revolution: bool = True
    F_q_max: float | None = None  # [N m] largest pitch moment; None: that of yaw
    fin: float | None = None  # [kg] the fins give up to fin u^2; None: that of yaw
    parameters: Mapping[str, float] | None = field(default=None, hash=False)
    # of the vertical plane, where they differ; None: equal planes

    def __post_init__(self) -> None:
        allowed = [name for name in PARAMETER_NAMES if name not in _ONE_PLANE]
        if wrong := [name for name in self.parameters or {} if name not in allowed]:
            raise ValueError(f"pitch parameters have no entry {wrong[0]!r}; allowed are {', '.join(allowed)}")

    def vehicle(self, horizontal: Vehicle) -> SpaceVehicle:
        """Return the vehicle in space for its horizontal plane."""
        vertical = replace(horizontal, **(self.parameters or {}))
        return SpaceVehicle(horizontal, vertical, self.stiffness, self.buoyancy, self.of_revolution)

    def limits(self, F_u_max: float, F_r_max: float, fin: float) -> Limits:
        """Return the limits of the actuators for those of surge and yaw."""
        F_q_max, fin_q = F_r_max if self.F_q_max is None else self.F_q_max, fin if self.fin is None else self.fin
        return Limits(F_u_max, F_q_max, F_r_max, fin_q, fin)

    def over(self, units: Units) -> Pitch:
        """Return the entries divided by the scale factors of their dimensions."""

        def scaled(value: float | None, unit: str) -> Any:
            return None if value is None else value / units.factor(*POWERS[unit])

        parameters = self.parameters and {key: scaled(x, DIMENSIONS[key]) for key, x in self.parameters.items()}
        return replace(
            self,
            stiffness=scaled(self.stiffness, "N m"),
            buoyancy=scaled(self.buoyancy, "N"),
            F_q_max=scaled(self.F_q_max, "N m"),
            fin=scaled(self.fin, "kg"),
            parameters=parameters,
        )


def to_ned(state: Sequence[Number]) -> State:
    """Return a state in north-east-down axes, x still ahead: y, z and what turns about them change sign."""
    x, y, z, theta, psi, u, v, w, q, r = state
    return State(x, -y, -z, -theta, -psi, u, -v, -w, -q, -r)


from_ned = to_ned
"""Return a state in this module's axes for one in north-east-down axes."""


def load_from_outside(load: Sequence[Number], row: Sequence[Number]) -> Load:
    """Return a `Load` from outside as a part of that of `state_rates`, see `dynamics.from_outside`."""
    (X, Y, Z, M, N), (level, upright, _) = load, _parts(row)
    X, Y, N = from_outside((X, Y, N), level)
    _, Z, S = from_outside((0.0, Z, -M), upright)
    return Load(X, Y, Z, -S, N)


def coupling(
    theta: Number, velocity: Sequence[Number], row: Sequence[Number], ns: Any = math
) -> tuple[dynamics.Load, dynamics.Load]:
    """Return the loads on the horizontal and on the vertical plane that motion in the other plane and buoyancy cause.

    With the inertias m22, m33 of the horizontal and n22, n33 of the vertical plane these are the forces n22 w p and
    -m22 v p, the moments n33 p s and -m33 p r, restoring moment and net buoyancy, and the surge force n22 w s of the
    vertical plane. The moment K = (n22 - m22) v w + (n33 - m33) r s holds the roll angle at 0. It acts about a level
    axis and so has a part K tan(theta) in yaw. K is 0 for a body of revolution.

    Args:
        theta: pitch [rad].
        velocity: u, v, w [m/s], q, r [rad/s].
        row: see `state_rates`.
        ns: the namespace of the numbers.
    """
    u, v, w, q, r = velocity
    level, upright, (stiffness, buoyancy, _) = _parts(row)
    m11, m22, m33, n22, n33 = *level[:3], *upright[1:3]
    s, c, sine = -q, ns.cos(theta), ns.sin(theta)
    tan = sine / c
    p = -r * tan
    v_0, w_0 = _of_origin(v, r, level), _of_origin(w, s, upright)
    K = (n22 - m22) * v_0 * w_0 + (n33 - m33) * r * s
    surge = m11 * dynamics.rates(theta, u, w, s, (0.0, 0.0, 0.0), upright, ns)[2]
    return (
        from_outside((surge - buoyancy * sine, n22 * w_0 * p, n33 * p * s + K * tan), level),
        from_outside((0.0, buoyancy * c - m22 * v_0 * p, stiffness * sine - m33 * p * r), upright),
    )


def drag(row: Sequence[Number]) -> tuple[Number, ...]:
    """Return the linear drag of u, v, w [N s/m], q, r [N m s] of a row that `state_rates` takes."""
    level, upright, _ = _parts(row)
    return level[3], level[4], upright[4], upright[5], level[5]


def _parts(row: Sequence[Number]) -> tuple[Sequence[Number], Sequence[Number], Sequence[Number]]:
    """Return the numbers of both planes, and stiffness, buoyancy and shape, of a row that `state_rates` takes."""
    size = (len(row) - 3) // 2
    return row[:size], row[size:-3], row[-3:]


def _of_origin(slip: Number, turn: Number, plane: Sequence[Number]) -> Number:
    """Return the sideways velocity of the origin of a plane, for that of the tracked point."""
    return slip - plane[-1] * turn if len(plane) == ROWS else slip


def state_rates(
    state: Sequence[Number],
    load: Sequence[Number],
    row: Sequence[Number],
    current: CurrentVelocity = STILL_WATER,
    ns: Any = math,
) -> State:
    """Return the time derivative of a `State`.

    Args:
        state: the state; |theta| < 90 degrees.
        load: a `Load`.
        row: `SpaceVehicle.acting`, or a row of `SpaceCoefficients`.
        current: of the water.
        ns: the namespace of the numbers.
    """
    _, _, _, theta, psi, u, v, w, q, r = state
    X, Y, Z, M, N = load
    level, upright = _with_cross_flow((v, w, q, r), row, ns)
    (X_c, Y_c, N_c), (_, Z_c, S_c) = coupling(theta, state[5:], row, ns)
    _, _, u_dot, v_dot, r_dot = dynamics.rates(psi, u, v, r, (X + X_c, Y + Y_c, N + N_c), level, ns)
    ahead, z_dot, _, w_dot, s_dot = dynamics.rates(-theta, u, w, -q, (0.0, Z + Z_c, S_c - M), upright, ns)
    x_dot, y_dot = to_world(ahead, v, ns.cos(psi), ns.sin(psi))
    V_x, V_y, V_z = current
    psi_dot = r / ns.cos(theta)
    return State(x_dot + V_x, y_dot + V_y, z_dot + V_z, q, psi_dot, u_dot, v_dot, w_dot, -s_dot, r_dot)


def _with_cross_flow(across: Sequence[Number], row: Sequence[Number], ns: Any) -> list[Sequence[Number]]:
    """Return the rows of both planes, in which |v|, |r| of quadratic drag are those of the whole cross-flow.

    The difference to the plane's own is a part of the linear drag. It is 0 unless the body is one of revolution.
    """
    v, w, q, r = across
    *both, (_, _, share) = _parts(row)
    v, w = _of_origin(v, r, both[0]), _of_origin(w, -q, both[1])
    slip, turn = ns.sqrt(v * v + w * w + _TINY), ns.sqrt(q * q + r * r + _TINY)
    planes: list[Sequence[Number]] = []
    for part, own, rate in zip(both, (v, w), (r, q), strict=True):
        m11, m22, m33, d11, d22, d33, X_uu, Y_vv, N_rr, *more = part
        a, b = share * (slip - abs(own)), share * (turn - abs(rate))
        d22, d33 = d22 + Y_vv * a, d33 + N_rr * b
        if len(part) == ROWS:
            x = CrossTerms(*more[4:])
            d22, d33 = d22 + x.Y_rv * b, d33 + x.N_vr * a
            d23, d32 = x.d23 + x.Y_vr * a + x.Y_rr * b, x.d32 + x.N_vv * a + x.N_rv * b
            more = [*more[:4], *x._replace(d23=d23, d32=d32)]
        planes.append((m11, m22, m33, d11, d22, d33, X_uu, Y_vv, N_rr, *more))
    return planes


def rk4_step(
    state: Sequence[Number],
    load: Sequence[Number],
    row: Sequence[Number],
    dt: Number,
    current: CurrentVelocity = STILL_WATER,
    ns: Any = math,
) -> State:
    """Return the state after dt [s] by one classical Runge-Kutta step with load and current held."""

    def rates(rows: Sequence[Number]) -> State:
        return state_rates(rows, load, row, ns=ns)

    h, weight, flow = 0.5 * dt, dt / 6, (*current, *(0.0,) * 7)
    a = rates(state)
    b = rates([x + h * k for x, k in zip(state, a, strict=True)])
    c = rates([x + h * k for x, k in zip(state, b, strict=True)])
    d = rates([x + dt * k for x, k in zip(state, c, strict=True)])
    slopes = zip(state, a, b, c, d, flow, strict=True)
    return State(*(x + weight * (k + 2 * (m + n) + o) + dt * V for x, k, m, n, o, V in slopes))


def axes(theta: Number, psi: Number, ns: Any = math) -> tuple[tuple[Number, Number, Number], ...]:
    """Return the body axes ahead, to port and up in the world."""
    c, s, cp, sp = ns.cos(theta), ns.sin(theta), ns.cos(psi), ns.sin(psi)
    return (c * cp, c * sp, -s), (-sp, cp, 0.0), (s * cp, s * sp, c)


def tracking_errors(state: Sequence[Number], reference: Sequence[Number], ns: Namespace = FLOATS) -> Errors:
    """Return the tracking errors of a `State` from a reference state.

    The angles are those of the reference's axis n in the body frame, psi_e = -atan2(n_y, n_x) and theta_e = atan2(n_z,
    hypot(n_x, n_y)). In the plane psi_e is psi - psi_R; in space the difference of two headings would grow as
    1 / cos(theta), and the errors of the axis do not.
    """
    x, y, z, theta, psi, *velocity = state
    x_R, y_R, z_R, theta_R, psi_R, *velocity_R = reference
    c, s = ns.cos(theta), ns.sin(theta)
    ahead, e_y = to_body(x - x_R, y - y_R, ns.cos(psi), ns.sin(psi))
    e_x, e_z = to_body(ahead, z - z_R, c, -s)
    c_R, turn = ns.cos(theta_R), psi_R - psi
    level, n_y = c_R * ns.cos(turn), c_R * ns.sin(turn)
    n_x, n_z = to_body(level, -ns.sin(theta_R), c, -s)
    theta_e, psi_e = ns.arctan2(n_z, ns.sqrt(n_x * n_x + n_y * n_y)), -ns.arctan2(n_y, n_x)
    return Errors(e_x, e_y, e_z, theta_e, psi_e, *(a - b for a, b in zip(velocity, velocity_R, strict=True)))

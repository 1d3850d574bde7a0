"""The Otter in six degrees of freedom: a catamaran with two propellers.

Equations and numbers are those of vehicles/otter.py of PythonVehicleSimulator (T. I. Fossen, MIT licence), after Fossen
(2021), chapters 3, 4 and 6: pontoons with hydrostatics, a payload on deck, thrust proportional to the square of the
revolutions. As in the source, the inertia counts the centre of mass twice, and the weight of the payload has a
component along the pitched boat. The integration is of fourth order.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, NamedTuple

import numpy as np

from auv_gym.physics.namespaces import FLOATS, Array, Namespace, Number
from auv_gym.task.model import PLANE, Model
from research.transfer.six_dof import (
    GRAVITY,
    Deviation,
    ModelInputs,
    SpatialMotion,
    Vector,
    coriolis,
    cross_flow,
    level,
    mass_scale,
    place_rates,
    shifted,
    skew,
    solved,
    times,
)

_DENSITY = 1025.0  # [kg/m^3] of the water
FLOW_DENSITY = 1026.0  # [kg/m^3] density of the water in the cross-flow drag of the source
_BOAT = 55.0  # [kg] mass of the boat without payload
PAYLOAD = 25.0  # [kg]
_LENGTH = 2.0  # [m]
BEAM = 1.08  # [m]
BOAT_CENTRE = (0.2, 0.0, -0.2)  # [m] centre of mass of the boat without payload
PAYLOAD_CENTRE = (0.05, 0.0, -0.35)  # [m] centre of mass of the payload
PONTOON_BEAM = 0.25  # [m]
PONTOON_ARM = 0.395  # [m] distance of pontoons and propellers from the centre line
WATERLINE = 0.75  # waterplane coefficient of a pontoon
_BLOCK = 0.4  # block coefficient of a pontoon
FLOTATION = -0.2  # [m] x of the centre of flotation
ADDED = (0.1, 1.5, 1.0, 0.2, 0.8, 1.7)  # added masses as shares of the boat's mass, and of the moments of inertia
_T_SWAY = 1.0  # [s] time constant of linear drag in sway
_T_YAW = 1.0  # [s] in yaw
FASTEST = 6 * 0.5144  # [m/s] speed at which the drag equals the largest thrust
_DAMPING = (0.3, 0.2, 0.4)  # damping ratios of heave, roll and pitch
YAW_DRAG = 10.0  # [s/rad] quadratic drag in yaw over the linear one
THRUST_AHEAD = 24.4 * GRAVITY  # [N] largest thrust of both propellers
THRUST_ASTERN = 13.6 * GRAVITY  # [N] the same astern
K_AHEAD = 0.02216 / 2  # [N s^2] thrust of one propeller over the square of its revolutions
K_ASTERN = 0.01289 / 2  # [N s^2] the same astern
PROPELLER_LAG = 0.1  # [s] of the propellers


class _Actuators(NamedTuple):
    """Revolutions of the propellers [rad/s]: floats, or rows of shape (N,)."""

    port: Number
    starboard: Number


def propeller_thrust(n: Number, ns: Namespace) -> Number:
    """Return the thrust [N] of one propeller at n [rad/s]."""
    square = n * abs(n)
    return ns.where(n > 0.0, K_AHEAD * square, K_ASTERN * square)


def propeller_speed(T: Number, ns: Namespace) -> Number:
    """Return n [rad/s] of one propeller for a thrust [N]."""
    ahead, astern = ns.where(T > 0.0, T, 0.0), ns.where(T > 0.0, 0.0, -T)
    return ns.sqrt(ahead / K_AHEAD) - ns.sqrt(astern / K_ASTERN)


def shares(F_u: Number, F_r: Number, ns: Namespace) -> tuple[Number, Number]:
    """Return the thrust [N] of the propellers to port and to starboard; within the limits, yaw has priority."""
    low, high = -THRUST_ASTERN / 2, THRUST_AHEAD / 2
    half = ns.clip(F_r / (2 * PONTOON_ARM), -(high - low) / 2, (high - low) / 2)
    size = abs(half)
    mean = ns.clip(0.5 * F_u, low + size, high - size)
    return mean + half, mean - half


@dataclass(frozen=True)
class Otter:
    """The vehicle as a `simulators._Model`."""

    name: ClassVar[str] = "otter"
    size: ClassVar[int] = len(SpatialMotion._fields) + len(_Actuators._fields)
    motion: ClassVar[Model] = PLANE
    mass: ClassVar[float] = _BOAT + PAYLOAD  # [kg]
    draft: ClassVar[float] = (_BOAT + PAYLOAD) / _DENSITY / (2 * _BLOCK * PONTOON_BEAM * _LENGTH)  # [m]

    @cached_property
    def centre(self) -> Array:
        """Centre of mass [m], payload included."""
        return (_BOAT * np.array(BOAT_CENTRE) + PAYLOAD * np.array(PAYLOAD_CENTRE)) / self.mass

    @cached_property
    def inertia(self) -> Array:
        """Moments of inertia as in the source, shape (3, 3)."""
        own = _BOAT * np.diag(np.square([0.4 * BEAM, 0.25 * _LENGTH, 0.25 * _LENGTH]))
        boat, payload = skew(self.centre.tolist()), skew(PAYLOAD_CENTRE)
        return np.asarray(own - _BOAT * boat @ boat - PAYLOAD * payload @ payload)

    @cached_property
    def masses(self) -> Array:
        """Mass matrix with added masses, shape (6, 6)."""
        rigid = np.zeros((6, 6))
        rigid[:3, :3], rigid[3:, 3:] = self.mass * np.eye(3), self.inertia
        own = np.array([_BOAT, _BOAT, _BOAT, *np.diag(self.inertia)])
        return shifted(rigid, self.centre.tolist()) + np.diag(np.array(ADDED) * own)

    @cached_property
    def stiffness(self) -> Array:
        """Stiffness matrix of the restoring forces of the pontoons, shape (6, 6); Fossen (2021), section 4.2."""
        waterline, volume = 2 * WATERLINE * _LENGTH * PONTOON_BEAM, self.mass / _DENSITY
        shape = 6 * WATERLINE**3 / ((1 + WATERLINE) * (1 + 2 * WATERLINE))
        across = 2 / 12 * _LENGTH * PONTOON_BEAM**3 * shape + waterline * PONTOON_ARM**2
        along = 0.8 * 2 / 12 * PONTOON_BEAM * _LENGTH**3
        buoyancy = (5 * self.draft / 2 - 0.5 * volume / (_LENGTH * PONTOON_BEAM)) / 3  # height of its centre above keel
        heights = [buoyancy + second / volume - (self.draft - self.centre[2]) for second in (across, along)]
        roll, pitch = (_DENSITY * GRAVITY * volume * height for height in heights)
        return shifted(np.diag([0, 0, _DENSITY * GRAVITY * waterline, roll, pitch, 0]), (FLOTATION, 0.0, 0.0))

    @cached_property
    def damping(self) -> Array:
        """Diagonal of the linear damping matrix, shape (6,)."""
        M, G = np.diag(self.masses), np.diag(self.stiffness).copy()
        G[4] -= FLOTATION**2 * G[2]  # about the centre of flotation
        own = [2 * zeta * math.sqrt(G[i] * M[i]) for zeta, i in zip(_DAMPING, (2, 3, 4), strict=True)]
        return np.array([THRUST_AHEAD / FASTEST, M[1] / _T_SWAY, *own, M[5] / _T_YAW])

    def placed(self, states: Array) -> Array:
        """Return the rows, shape (size, n), of floating boats with x, y, psi, u, v, r of shape (6, n)."""
        rows = np.zeros((self.size, states.shape[1]))
        rows[[0, 1, 5, 6, 7, 11]] = states
        vertical = slice(2, 5)
        for _ in range(20):  # equilibrium of heave, roll and pitch under the payload
            forces = self.payload(SpatialMotion(*np.zeros(2), *rows[vertical, 0], *np.zeros(7)), FLOATS)
            rows[vertical] = np.linalg.solve(self.stiffness[vertical, vertical], forces[vertical])[:, None]
        return rows

    def payload(self, s: SpatialMotion, ns: Namespace) -> tuple[Number, ...]:
        """Return the weight of the payload [N] and its moment [N m] about the origin, in body axes."""
        W, (x, _, z) = PAYLOAD * GRAVITY, PAYLOAD_CENTRE
        X = -W * ns.sin(s.theta)
        Y = W * ns.cos(s.theta) * ns.sin(s.phi)
        Z = W * ns.cos(s.theta) * ns.cos(s.phi)
        return X, Y, Z, -z * Y, -z * W * ns.sin(s.theta) - x * Z, x * Y

    def seen(self, rows: Vector, ns: Namespace) -> tuple[Vector, Vector]:
        """Return x, y, psi, u, v, r, level and relative to the water, and F_u [N], F_r [N m] of the propellers."""
        a = _Actuators(*rows[12:])
        port, starboard = propeller_thrust(a.port, ns), propeller_thrust(a.starboard, ns)
        return level(SpatialMotion(*rows[:12]), ns), (port + starboard, PONTOON_ARM * (port - starboard))

    def body_forces(self, s: SpatialMotion, d: Deviation, ns: Namespace) -> list[Number]:
        """Return the sum of drag, restoring forces and payload [N], [N m]."""
        D = self.damping
        Y, N = cross_flow(s.v, s.r, _LENGTH, PONTOON_BEAM, self.draft, FLOW_DENSITY)
        drag = (
            -d.d_u * D[0] * s.u - d.X_uu * abs(s.u) * s.u,
            d.d_v * (Y - D[1] * s.v) - d.Y_vv * abs(s.v) * s.v,
            -D[2] * s.w,
            -D[3] * s.p,
            -D[4] * s.q,
            d.d_r * (N - D[5] * (1.0 + YAW_DRAG * abs(s.r)) * s.r) - d.N_rr * abs(s.r) * s.r,
        )
        restoring = times(self.stiffness.tolist(), (0.0, 0.0, s.z, s.phi, s.theta, 0.0))
        return [a - b + c for a, b, c in zip(drag, restoring, self.payload(s, ns), strict=True)]

    def orders(self, first: Vector, inputs: ModelInputs, ns: Namespace) -> list[Number]:
        """Return the revolutions [rad/s] of the propellers for the commanded force."""
        return [propeller_speed(T, ns) for T in shares(inputs.F_u, inputs.F_r, ns)]

    def rates(self, rows: Vector, orders: Vector, inputs: ModelInputs, d: Deviation, ns: Namespace) -> list[Number]:
        """Return the time derivative of the rows."""
        s, a, scale = SpatialMotion(*rows[:12]), _Actuators(*rows[12:]), mass_scale(d, ns)
        _, (F_u, F_r) = self.seen(rows, ns)
        moved = [k * x for k, x in zip(scale, rows[6:12], strict=True)]
        momentum = [k * x for k, x in zip(scale, times(self.masses.tolist(), moved), strict=True)]
        acting = F_u + inputs.X, inputs.Y, 0.0, 0.0, 0.0, F_r + inputs.N
        parts = zip(self.body_forces(s, d, ns), coriolis(momentum, rows[6:12]), acting, strict=True)
        forces = [body - turning + other for body, turning, other in parts]
        return [
            *place_rates(s, (inputs.V_x, inputs.V_y, 0.0), ns),
            *solved(np.linalg.inv(self.masses).tolist(), forces, scale),
            *((order - n) / PROPELLER_LAG for order, n in zip(orders, a, strict=True)),
        ]


OTTER = Otter()
"""The vehicle."""

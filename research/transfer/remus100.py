"""The REMUS 100 in six degrees of freedom: a torpedo with rudder, stern planes and a propeller.

The equations are those of Fossen (2021), section 8.4.2, as in vehicles/remus100.py of PythonVehicleSimulator (T. I.
Fossen, MIT licence), with the drag and the propeller of B. Allen, W. S. Vorus and T. Prestero, "Propulsion system
performance enhancements on REMUS AUVs", OCEANS 2000. There are two differences: the advance speed of the propeller is
relative to the water, not over ground as in the source, and the integration is of fourth order.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, NamedTuple

import numpy as np

from auv_gym.physics.errors import to_world
from auv_gym.physics.namespaces import Array, Namespace, Number
from auv_gym.physics.space import from_ned, to_ned
from auv_gym.task.model import PLANE, Model
from auv_gym.task.space import SPACE
from research.transfer.six_dof import (
    GRAVITY,
    Deviation,
    ModelInputs,
    SpatialMotion,
    Vector,
    coriolis,
    cross,
    cross_flow,
    level,
    mass_scale,
    place_rates,
    shifted,
    solved,
    times,
)

_DENSITY = 1026.0  # [kg/m^3] of the water
_LENGTH = 1.6  # [m]
DIAMETER = 0.19  # [m]
CG_BELOW = 0.02  # [m] distance of the centre of mass below the centre of buoyancy
DRAG_AREA = 0.7 * _LENGTH * DIAMETER  # [m^2] S, reference area of lift and drag
FRONTAL_DRAG = 0.42  # drag coefficient of the frontal area, Allen et al. (2000)
OSWALD = 0.7  # Oswald efficiency of the body
ROLL_ADDED = 0.3  # added moment of inertia in roll as a share of that in air
T_SURGE = 20.0  # [s] time constant of linear drag in surge
_T_SWAY = 20.0  # [s] in sway and heave
_T_YAW = 1.0  # [s] in yaw
ZETA_ROLL = 0.3  # damping ratio of roll
ZETA_PITCH = 0.8  # damping ratio of pitch
_DECAY = 3.0  # [s/m] linear drag of surge and sway decreases as exp(-3 U)
FIN_AREA = 2 * 0.00665  # [m^2] of the rudder, and of the stern planes
RUDDER_LIFT = 0.5  # [1/rad] lift coefficient of the rudder
PLANE_LIFT = 0.7  # [1/rad] lift coefficient of the stern planes
FIN_MOST = math.radians(15.0)  # [rad]
FIN_LAG = 0.1  # [s] of rudder and stern planes
PROPELLER_LAG = 1.0  # [s]
RPM_MOST = 1525.0  # [1/min]
_PROPELLER = 0.14  # [m] diameter of the propeller
WAKE = 0.944  # advance speed over speed through water, Allen et al. (2000)
DEDUCTION = 0.1  # thrust deduction number
KT_0 = 0.4566  # thrust coefficient at advance number 0
KT_J = (0.1798 - 0.4566) / 0.6632  # its slope
KQ_0 = 0.0700  # torque coefficient at advance number 0
KQ_J = (0.0312 - 0.0700) / 0.6632  # its slope
TORQUE_SHARE = 0.1  # share of the propeller's torque that acts in roll
KP_Z = 0.1  # [rad/m] depth autopilot: gain from depth to pitch
T_Z = 100.0  # [s] integral time of the depth
KP_THETA = 5.0  # gain from pitch to the planes
KD_THETA = 2.0  # [s] gain from pitch rate
KI_THETA = 0.3  # [1/s] gain from the integral of pitch
K_W = 5.0  # [rad s/m] gain from heave velocity

_NOSE = _LENGTH / 2  # [m] semi-axis of the spheroid along the body
RADIUS = DIAMETER / 2  # [m] semi-axis across the body


class _Actuators(NamedTuple):
    """States of the actuators and of the depth autopilot: floats, or rows of shape (N,)."""

    rudder: Number  # [rad], positive for a turn to starboard
    plane: Number  # [rad], positive for the nose down
    rpm: Number  # [1/min]
    z_integral: Number  # [m s]
    theta_integral: Number  # [rad s]


def lamb_factors() -> tuple[float, float, float]:
    """Return Lamb's k1, k2, k' for the added mass of the spheroid in surge, sway and pitch; Fossen (2021), 8.4.2."""
    e2 = 1 - (RADIUS / _NOSE) ** 2
    e = math.sqrt(e2)
    stretched = math.log((1 + e) / (1 - e)) / 2
    alpha = 2 * (1 - e2) / e**3 * (stretched - e)
    beta = 1 / e2 - (1 - e2) / e**3 * stretched
    turning = e2 * e2 * (beta - alpha) / ((2 - e2) * (2 * e2 - (2 - e2) * (beta - alpha)))
    return alpha / (2 - alpha), beta / (2 - beta), turning


def propeller(n: Number, advance: Number, at_rest: float, slope: float, ns: Namespace) -> Number:
    """Return K |n| n for a coefficient K(J) = at_rest + slope J of the advance number J; astern J is taken as 0.

    K is linear in J between bollard pull and the largest speed, as in the source, for a Wageningen propeller of 3
    blades.

    Args:
        n: revolutions [1/s].
        advance: speed of the water into the propeller [m/s].
        at_rest: K at J = 0.
        slope: derivative of K by J.
        ns: the namespace of the numbers.
    """
    return ns.where(n > 0.0, at_rest * n * n + slope * (advance / _PROPELLER) * n, -at_rest * n * n)


def revolutions(F_u: Number, advance: Number, ns: Namespace) -> Number:
    """Return the revolutions [1/min] at which the propeller's thrust, less the deduction, is F_u [N].

    For a thrust ahead it is the branch on which the thrust increases with the revolutions. A negative thrust needs a
    propeller that runs astern.
    """
    target = F_u / ((1 - DEDUCTION) * _DENSITY * _PROPELLER**4)
    windmill = -KT_J * advance / _PROPELLER  # KT_0 n at which the thrust vanishes
    windmill = ns.where(windmill > 0.0, windmill, 0.0)
    pull = ns.where(target > 0.0, target, 0.0)
    ahead = (windmill + ns.sqrt(windmill * windmill + 4 * KT_0 * pull)) / (2 * KT_0)
    astern = -ns.sqrt((pull - target) / KT_0)
    return 60.0 * ns.clip(ns.where(target < 0.0, astern, ahead), -RPM_MOST / 60, RPM_MOST / 60)


def fin_angle(moment: Number, lift: float, speed: Number, ns: Namespace) -> Number:
    """Return the angle [rad] of fins for a moment [N m], a lift coefficient [1/rad] and a speed [m/s] of the flow."""
    per_radian = _NOSE * 0.5 * _DENSITY * FIN_AREA * lift * (speed * speed + 1e-6)
    return ns.clip(moment / per_radian, -FIN_MOST, FIN_MOST)


def pitch_error(s: SpatialMotion, a: _Actuators) -> Number:
    """Return the difference [rad] of the pitch from that which the depth control commands."""
    return s.theta - KP_Z * (s.z + a.z_integral / T_Z)


@dataclass(frozen=True)
class Remus100:
    """The vehicle as a `simulators._Model`."""

    name: ClassVar[str] = "remus100"
    size: ClassVar[int] = len(SpatialMotion._fields) + len(_Actuators._fields)
    motion: ClassVar[Model] = PLANE
    propeller_lag: float = PROPELLER_LAG  # [s]

    @cached_property
    def rigid(self) -> Array:
        """Mass matrix in air about the centre of buoyancy, shape (6, 6)."""
        m = 4 / 3 * math.pi * _DENSITY * _NOSE * RADIUS**2  # mass of the displaced water
        roll, pitch = 2 / 5 * m * RADIUS**2, 1 / 5 * m * (_NOSE**2 + RADIUS**2)
        return shifted(np.diag([m, m, m, roll, pitch, pitch]), (0.0, 0.0, CG_BELOW))

    @cached_property
    def added(self) -> Array:
        """Diagonal of the matrix of added masses, shape (6,)."""
        m, roll, pitch = self.rigid[0, 0], 2 / 5 * self.rigid[0, 0] * RADIUS**2, self.rigid[5, 5]
        k1, k2, turning = lamb_factors()
        return np.array([m * k1, m * k2, m * k2, ROLL_ADDED * roll, turning * pitch, turning * pitch])

    @cached_property
    def masses(self) -> Array:
        """Mass matrix with added masses, shape (6, 6)."""
        return self.rigid + np.diag(self.added)

    @cached_property
    def stiffness(self) -> float:
        """Restoring moment [N m] of weight and buoyancy at 90 degrees."""
        return float(self.rigid[0, 0] * GRAVITY * CG_BELOW)

    def placed(self, states: Array) -> Array:
        """Return the rows, shape (size, n), for x, y, psi, u, v, r of shape (6, n); all other states are zero."""
        rows = np.zeros((self.size, states.shape[1]))
        rows[[0, 1, 5, 6, 7, 11]] = states
        return rows

    def seen(self, rows: Vector, ns: Namespace) -> tuple[Vector, Vector]:
        """Return x, y, psi, u, v, r, level and relative to the water, and F_u [N], F_r [N m] of the actuators."""
        s, a = SpatialMotion(*rows[:12]), _Actuators(*rows[12:])
        X, _, _, _, _, N = self.actuation(s, a, ns)
        return level(s, ns), (X, N)

    def actuation(self, s: SpatialMotion, a: _Actuators, ns: Namespace) -> tuple[Number, ...]:
        """Return the forces [N] and moments [N m] of propeller, rudder and stern planes."""
        speed = ns.sqrt(s.u * s.u + s.v * s.v + s.w * s.w)
        level_2, upright_2 = s.u * s.u + s.v * s.v, s.u * s.u + s.w * s.w  # [m^2/s^2] of the flow at rudder and planes
        n, k = a.rpm / 60.0, 0.5 * _DENSITY * FIN_AREA
        T = (1 - DEDUCTION) * _DENSITY * _PROPELLER**4 * propeller(n, WAKE * speed, KT_0, KT_J, ns)
        Q = _DENSITY * _PROPELLER**5 * propeller(n, WAKE * speed, KQ_0, KQ_J, ns)
        Y = -k * RUDDER_LIFT * level_2 * a.rudder
        Z = -k * PLANE_LIFT * upright_2 * a.plane
        X = T + Y * a.rudder + Z * a.plane
        return X, Y, Z, TORQUE_SHARE * Q, _NOSE * Z, -_NOSE * Y

    def body_forces(self, s: SpatialMotion, d: Deviation, ns: Namespace) -> tuple[Number, ...]:
        """Return drag, lift and restoring forces [N] and moments [N m] of the body."""
        M, W = np.diag(self.masses), self.stiffness
        speed_2 = s.u * s.u + s.v * s.v + s.w * s.w
        decay = ns.exp(-_DECAY * ns.sqrt(speed_2))
        incidence = ns.arctan2(s.w, s.u)
        aspect = DIAMETER**2 / DRAG_AREA
        lift = math.pi * aspect / (1 + math.sqrt(1 + (aspect / 2) ** 2)) * incidence  # Beard and McLain (2012)
        least = FRONTAL_DRAG * math.pi * RADIUS**2 / DRAG_AREA
        pressure = 0.5 * _DENSITY * speed_2 * DRAG_AREA
        drag = pressure * (least + lift * lift / (math.pi * OSWALD * aspect))
        c, n, lift = ns.cos(incidence), ns.sin(incidence), pressure * lift
        Y, N = cross_flow(s.v, s.r, _LENGTH, DIAMETER, DIAMETER, _DENSITY)
        roll, pitch = (2 * zeta * math.sqrt(W * M[i]) for zeta, i in ((ZETA_ROLL, 3), (ZETA_PITCH, 4)))
        W = d.stiffness * W
        d_w, d_q, Z_ww, M_qq = self.vertical(d)
        return (
            d.d_u * (n * lift - c * drag - M[0] / T_SURGE * decay * s.u) - d.X_uu * abs(s.u) * s.u,
            d.d_v * (Y - M[1] / _T_SWAY * decay * s.v) - d.Y_vv * abs(s.v) * s.v,
            d_w * (-n * drag - c * lift - M[2] / _T_SWAY * s.w) - Z_ww * abs(s.w) * s.w,
            -roll * s.p - W * ns.cos(s.theta) * ns.sin(s.phi),
            -d_q * pitch * s.q - W * ns.sin(s.theta) - M_qq * abs(s.q) * s.q,
            d.d_r * (N - M[5] / _T_YAW * s.r) - d.N_rr * abs(s.r) * s.r,
        )

    def vertical(self, d: Deviation) -> tuple[Number, ...]:
        """Return the factors of the drag in heave and pitch, and more quadratic drag [kg/m], [kg m^2]: none."""
        return 1.0, 1.0, 0.0, 0.0

    def coriolis(self, nu: Vector, d: Deviation, ns: Namespace) -> list[Number]:
        """Return C(nu) nu [N], [N m], without the terms that the source leaves out for stability.

        These are terms of the added mass: the Munk moments in yaw and in pitch, and the corresponding forces.
        """
        scale = mass_scale(d, ns)
        moved = [s * x for s, x in zip(scale, nu, strict=True)]
        momentum = [s * x for s, x in zip(scale, times(self.rigid.tolist(), moved), strict=True)]
        a = [s * s * m * x for s, m, x in zip(scale, self.added.tolist(), nu, strict=True)]
        _, v, w, p, q, r = nu
        turning = cross((p, q, r), a[3:])
        kept = 0.0, -a[2] * p, a[1] * p, v * a[2] - w * a[1] + turning[0], turning[1], turning[2]
        return [x + y for x, y in zip(coriolis(momentum, nu), kept, strict=True)]

    def orders(self, first: Vector, inputs: ModelInputs, ns: Namespace) -> list[Number]:
        """Return rudder, stern planes [rad] and revolutions [1/min] for the commanded force, see `planes`."""
        s, a = SpatialMotion(*first[:12]), _Actuators(*first[12:])
        speed = ns.sqrt(s.u * s.u + s.v * s.v + s.w * s.w)
        return [
            fin_angle(inputs.F_r, RUDDER_LIFT, ns.sqrt(s.u * s.u + s.v * s.v), ns),
            self.planes(s, a, inputs, ns),
            revolutions(inputs.F_u, WAKE * speed, ns),
        ]

    def planes(self, s: SpatialMotion, a: _Actuators, inputs: ModelInputs, ns: Namespace) -> Number:
        """Return the angle [rad] of the stern planes for depth 0, by the autopilot of the source.

        It has PI control from depth to pitch, and PID control to the planes.
        """
        plane = KP_THETA * pitch_error(s, a) + KD_THETA * s.q + KI_THETA * a.theta_integral + K_W * s.w
        return ns.clip(plane, -FIN_MOST, FIN_MOST)

    def rates(self, rows: Vector, orders: Vector, inputs: ModelInputs, d: Deviation, ns: Namespace) -> list[Number]:
        """Return the time derivative of the rows."""
        s, a = SpatialMotion(*rows[:12]), _Actuators(*rows[12:])
        load = (inputs.X, inputs.Y, inputs.Z, 0.0, inputs.M, inputs.N)
        parts = zip(
            self.actuation(s, a, ns), self.body_forces(s, d, ns), load, self.coriolis(rows[6:12], d, ns), strict=True
        )
        forces = [acting + body + other - turning for acting, body, other, turning in parts]
        lags = FIN_LAG, FIN_LAG, self.propeller_lag
        return [
            *place_rates(s, (inputs.V_x, inputs.V_y, inputs.V_z), ns),
            *solved(np.linalg.inv(self.masses).tolist(), forces, mass_scale(d, ns)),
            *((order - now) / lag for order, now, lag in zip(orders, a, lags, strict=False)),
            s.z,
            pitch_error(s, a),
        ]


class SpaceRemus100(Remus100):
    """The vehicle with a commanded pitch moment in place of the depth control.

    Its states are seen as those of a vehicle without roll, in the axes of `physics.space`: the velocities across the
    body are those along its level and its upward axis.
    """

    motion: ClassVar[Model] = SPACE

    def placed(self, states: Array) -> Array:
        """Return the rows, shape (size, n), for the states of a `space.State`, shape (10, n)."""
        rows = np.zeros((self.size, states.shape[1]))
        rows[[0, 1, 2, 4, 5, 6, 7, 8, 10, 11]] = to_ned([*states])
        return rows

    def seen(self, rows: Vector, ns: Namespace) -> tuple[Vector, Vector]:
        """Return the `space.State`, and F_u [N], F_q, F_r [N m] of the actuators."""
        s, a = SpatialMotion(*rows[:12]), _Actuators(*rows[12:])
        X, _, _, _, M, N = self.actuation(s, a, ns)
        v, w, q, r = (x for pair in (s[7:9], s[10:12]) for x in to_world(*pair, ns.cos(s.phi), ns.sin(s.phi)))
        return from_ned((s.x, s.y, s.z, s.theta, s.psi, s.u, v, w, q, r)), (X, -M, -N)

    def planes(self, s: SpatialMotion, a: _Actuators, inputs: ModelInputs, ns: Namespace) -> Number:
        """Return the angle [rad] of the stern planes for the commanded pitch moment."""
        return fin_angle(-inputs.F_q, PLANE_LIFT, ns.sqrt(s.u * s.u + s.w * s.w), ns)

    def vertical(self, d: Deviation) -> tuple[Number, ...]:
        """Return the factors and the drag of the horizontal plane, as `scenarios.vertical` draws a vehicle."""
        return d.d_v, d.d_r, d.Y_vv, d.N_rr


REMUS100 = Remus100()
"""The vehicle."""

"""Common equations of vehicles with six degrees of freedom, component by component, so that they can be compiled.

Axes are those of T. I. Fossen, Handbook of Marine Craft Hydrodynamics and Motion Control, 2nd ed., Wiley 2021: x north,
y east, z down; the body's x ahead, y to starboard, z down; roll phi, pitch theta, yaw psi in the order zyx.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, TypeAlias

import numpy as np

from auv_gym.codegen.matrices import dot
from auv_gym.physics.namespaces import Array, Namespace, Number

Vector: TypeAlias = Sequence[Number]
_Matrix: TypeAlias = Sequence[Sequence[float]]

GRAVITY = 9.81  # [m/s^2]
STRIPS = 20  # strips of the body for the cross-flow drag, as in the sources
_HOERNER = ((0.4933, 1.2108), (0.5585, 1.0836), (0.6464, 0.9986))
"""Cross-flow drag coefficient of a section against half its beam over its draft: the part of Hoerner's curve, Fossen
(2021), section 6.4, that is needed, as digitised in PythonVehicleSimulator."""


class SpatialMotion(NamedTuple):
    """Position, attitude and velocity: floats, or rows of shape (N,)."""

    x: Number  # [m]
    y: Number  # [m]
    z: Number  # [m] down
    phi: Number  # [rad]
    theta: Number  # [rad]
    psi: Number  # [rad], not wrapped
    u: Number  # [m/s] relative to the water
    v: Number  # [m/s]
    w: Number  # [m/s]
    p: Number  # [rad/s]
    q: Number  # [rad/s]
    r: Number  # [rad/s]


class ModelInputs(NamedTuple):
    """Inputs of a vehicle during a step: floats, or rows of shape (N,)."""

    F_u: Number  # [N] commanded force
    F_r: Number  # [N m]
    V_x: Number  # [m/s] current
    V_y: Number  # [m/s]
    X: Number  # [N] load on the vehicle
    Y: Number  # [N]
    N: Number  # [N m]
    F_q: Number = 0.0  # [N m] these four for motion in space
    V_z: Number = 0.0  # [m/s]
    Z: Number = 0.0  # [N]
    M: Number = 0.0  # [N m]


class Deviation(NamedTuple):
    """Deviation of a vehicle from the published one: floats, or rows of shape (N,)."""

    m_u: Number  # factor of the inertia in surge, added mass included
    m_v: Number  # in sway and heave
    m_r: Number  # in roll, pitch and yaw
    d_u: Number  # factor of the drag in surge
    d_v: Number  # in sway
    d_r: Number  # in yaw
    X_uu: Number  # [kg/m] additional quadratic drag
    Y_vv: Number  # [kg/m]
    N_rr: Number  # [kg m^2]
    stiffness: Number = 1.0  # factor of the restoring moments of the REMUS 100


AS_PUBLISHED = Deviation(1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0)
"""No deviation."""


def cross(a: Vector, b: Vector) -> tuple[Number, Number, Number]:
    """Return a x b."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def skew(a: Vector) -> Array:
    """Return the matrix S(a) with S(a) b = a x b."""
    return np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])


def shifted(matrix: Array, r: Vector) -> Array:
    """Return a mass or stiffness matrix about a point r [m], moved to the origin: H^T M H, Fossen (2021), (3.27)."""
    H = np.eye(6)
    H[:3, 3:] = -skew(r)
    return np.asarray(H.T @ matrix @ H)


def coriolis(momentum: Vector, nu: Vector) -> tuple[Number, ...]:
    """Return C(nu) nu for the momentum M nu of a body: Kirchhoff's equations, Fossen (2021), theorem 3.2."""
    linear, angular, v, omega = momentum[:3], momentum[3:], nu[:3], nu[3:]
    moment = (a + b for a, b in zip(cross(v, linear), cross(omega, angular), strict=True))
    return *cross(omega, linear), *moment


def times(matrix: _Matrix, vector: Vector) -> list[Number]:
    """Return a constant matrix times a vector; zeros of the matrix cost nothing."""
    return [dot(row, vector) for row in matrix]


def place_rates(s: SpatialMotion, current: Vector, ns: Namespace) -> tuple[Number, ...]:
    """Return the time derivatives of position [m/s] and attitude [rad/s], Fossen (2021), (2.31) and (2.41)."""
    c_phi, s_phi, c_th, s_th, c_psi, s_psi = (f(a) for a in (s.phi, s.theta, s.psi) for f in (ns.cos, ns.sin))
    across = s.v * c_phi - s.w * s_phi  # level component of the velocity
    down = s.v * s_phi + s.w * c_phi
    ahead = s.u * c_th + down * s_th
    turn = s.q * s_phi + s.r * c_phi
    return (
        ahead * c_psi - across * s_psi + current[0],
        ahead * s_psi + across * c_psi + current[1],
        down * c_th - s.u * s_th + current[2],
        s.p + turn * s_th / c_th,
        s.q * c_phi - s.r * s_phi,
        turn / c_th,
    )


def level(s: SpatialMotion, ns: Namespace) -> tuple[Number, ...]:
    """Return x, y [m], psi [rad], level u, v [m/s] along the heading and relative to the water, psi' [rad/s]."""
    x_dot, y_dot, _, _, _, psi_dot = place_rates(s, (0.0, 0.0, 0.0), ns)
    c, n = ns.cos(s.psi), ns.sin(s.psi)
    return s.x, s.y, s.psi, c * x_dot + n * y_dot, c * y_dot - n * x_dot, psi_dot


def section_drag(beam: float, draft: float) -> float:
    """Return the cross-flow drag coefficient of a section.

    Raises:
        ValueError: the section is outside the digitised part of the curve.
    """
    half, known = beam / (2 * draft), np.array(_HOERNER).T
    if not known[0, 0] <= half <= known[0, -1]:
        raise ValueError(f"beam over twice the draft is {half:.3g}; it must be {known[0, 0]:g} to {known[0, -1]:g}")
    return float(np.interp(half, *known))


def cross_flow(v: Number, r: Number, length: float, beam: float, draft: float, density: float) -> tuple[Number, Number]:
    """Return sway force [N] and yaw moment [N m] of the cross flow by strip theory, Fossen (2021), section 6.4.

    Args:
        v: sway velocity [m/s] relative to the water.
        r: yaw rate [rad/s].
        length: length of the body [m].
        beam: beam of a section [m].
        draft: draft of a section [m].
        density: density of the water [kg/m^3].
    """
    k = 0.5 * density * draft * section_drag(beam, draft) * length / STRIPS
    Y: Number = 0.0
    N: Number = 0.0
    for i in range(STRIPS + 1):
        x = length * (i / STRIPS - 0.5)
        across = v + x * r
        Y, N = Y - k * abs(across) * across, N - k * x * abs(across) * across
    return Y, N


def solved(inverse: _Matrix, forces: Vector, scale: Vector) -> list[Number]:
    """Return the accelerations under forces for the mass matrix S M S, from the inverse of M and the diagonal of S."""
    shares = [f / s for f, s in zip(forces, scale, strict=True)]
    return [a / s for a, s in zip(times(inverse, shares), scale, strict=True)]


def mass_scale(d: Deviation, ns: Namespace) -> tuple[Number, ...]:
    """Return the diagonal of S, where S M S is the mass matrix of a vehicle with a deviation."""
    a, b, c = ns.sqrt(d.m_u), ns.sqrt(d.m_v), ns.sqrt(d.m_r)
    return a, b, b, c, c, c

"""The extended Kalman filter in space: `baselines.estimation.filter_equations` for the model of motion in space.

Each component of a load has the tuning of its kind: surge; sway for sway and heave; yaw for pitch and yaw.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from auv_gym.codegen.graph import SYMBOLS
from auv_gym.physics.namespaces import Namespace, Number, sum_of
from auv_gym.physics.space import axes, drag, state_rates
from auv_gym.task.space import SPACE, Observation, in_world
from baselines.estimation.filter_equations import FilterModel, FilterUnits
from baselines.estimation.sea_model import SeaModel
from baselines.policy import SPEED_FLOOR

_FIELDS = [
    *(f"{name}_e" if name in SPACE.position else name for name in SPACE.state),
    *(f"F_{name}" for name in SPACE.channels),
    *SPACE.current,
    *(f"{name}_rate" for name in SPACE.current),
    *SPACE.load,
    "lag",
    *(f"{name}_{part}" for name in SPACE.load for part in ("wave", "swing")),
]
SpaceEstimate: Any = NamedTuple("SpaceEstimate", [(name, Number) for name in _FIELDS])  # type: ignore[misc]
"""The state of the model in space, named as `baselines.estimation.sea_model.Estimate`; theta, psi are the angles."""
SPACE_SEA = SeaModel(SPACE, SpaceEstimate)
"""The model in space."""


def reference_heading(o: Observation, ns: Namespace) -> Number:
    """Return the heading of the reference [rad] from the errors of its axis; the measurement noise cancels."""
    c = ns.cos(o.theta_e)
    ahead, port, _ = in_world((c * ns.cos(o.psi_e), -c * ns.sin(o.psi_e), ns.sin(o.theta_e)), o)
    return ns.arctan2(port, ahead)


def reference_motion(o: Observation, row: Sequence[Number], ns: Namespace) -> tuple[Number, ...]:
    """Return velocity [m/s] and acceleration [m/s^2] of the reference over ground in the world.

    The accelerations are those of the vehicle `row` with the reference's forces.
    """
    theta, psi, velocity = o.theta_R, reference_heading(o, ns), (o.u_R, o.v_R, o.w_R)
    p, q, r = -o.r_R * ns.sin(theta) / ns.cos(theta), o.q_R, o.r_R
    state, load = (0.0, 0.0, 0.0, theta, psi, *velocity, q, r), (o.F_uR, 0.0, 0.0, o.F_qR, o.F_rR)
    _, _, _, _, _, u_dot, v_dot, w_dot, _, _ = state_rates(state, load, row, ns=ns)
    u, v, w = velocity
    acceleration = u_dot + q * w - r * v, v_dot + r * u - p * w, w_dot + p * v - q * u
    body = [*zip(*axes(theta, psi, ns), strict=True)]
    return tuple(
        sum_of(a * b for a, b in zip(column, vector, strict=True))
        for vector in (velocity, acceleration)
        for column in body
    )


def measured_motion(o: Observation, ns: Namespace) -> list[Number]:
    """Return the measurements: position error in the world, theta, psi, velocities over ground, q, r."""
    angles = ns.arctan2(o.sin_theta, o.cos_theta), ns.arctan2(o.sin_psi, o.cos_psi)
    wanted, errors = (o.u_R, o.v_R, o.w_R, o.q_R, o.r_R), (o.u_e, o.v_e, o.w_e, o.q_e, o.r_e)
    return [*in_world((o.e_x, o.e_y, o.e_z), o), *angles, *(a + b for a, b in zip(wanted, errors, strict=True))]


def _units(o: Observation, row: Sequence[Number]) -> FilterUnits:
    """Return the units of the tuning, see `FilterUnits`."""
    square = o.u_R * o.u_R + o.v_R * o.v_R + o.w_R * o.w_R
    speed = SYMBOLS.sqrt(SYMBOLS.clip(square, SPEED_FLOOR * SPEED_FLOOR, float("inf")))
    return FilterUnits(speed, [d * speed for d in drag(row)], (o.F_u_max, o.F_q_max, o.F_r_max))


_P = SPACE_SEA.place
SPACE_FILTER = FilterModel(
    sea=SPACE_SEA,
    units=_units,
    reference=reference_motion,
    measured=lambda o, _: measured_motion(o, SYMBOLS),
    first_noise=(0.05, 0.05, 0.02, 0.015, 0.015, 0.02, 0.02, 0.02, 0.005, 0.005),
    least_noise=(1e-4, 1e-4, 1e-4, *(3e-5,) * 7),
    alike=((_P.x_e, _P.y_e), (_P.theta, _P.psi), (_P.u, _P.v, _P.w), (_P.q, _P.r)),
)
"""The filter in space."""

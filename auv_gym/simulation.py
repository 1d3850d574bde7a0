"""One control step of the whole simulation, composed of the parts of vehicle, actuators, sensors and task.

A pure function of (plant, action, sample) on components: the scalar, the vector and the torch environment all run it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, TypeAlias

from auv_gym.actuators import Response, respond
from auv_gym.dynamics import Force, State, rk4_step
from auv_gym.errors import to_body, tracking_errors
from auv_gym.namespaces import Namespace, Number
from auv_gym.sensors import low_pass
from auv_gym.task import lost, reward
from auv_gym.vehicle import Coefficients

Plant: TypeAlias = tuple[Any, ...]
"""The state, 11 entries: x, y, psi, u, v, r with velocities relative to the water; the actuators' F_u, F_r;
the previous action a_u, a_r; and the six tracking errors behind the low-pass, a tuple, zero where there is none."""

Sample: TypeAlias = Sequence[Number]
"""What the outside supplies at one control instant, 19 components: the reference's x, y, psi, u, v, r, F_u, F_r; the
current's V_x, V_y; the external load X, Y, N; the measurement errors of x, y, psi, u, v, r. Current and load act over
the control period that ends at the instant."""
SAMPLE = 19

PARAMETERS = 22


class Parameters(NamedTuple):
    """The constants of an episode: floats, or rows of shape (N,)."""

    h: Number  # [s] integration step
    coefficients: Coefficients  # of the true vehicle
    F_u_max: Number  # [N] that action 1 commands, as observed
    F_r_max: Number  # [N m]
    response: Response
    filter_gain: Number
    error_scale: Number  # [m]
    rate_weight: Number
    lost_distance: Number  # [m]
    thrust_u: Number  # [N] that action 1 really gives
    thrust_r: Number  # [N m]
    filtered: bool  # whether a low-pass is in use anywhere
    substeps: int  # integration steps in a control period

    @classmethod
    def of(cls, rows: Sequence[Number], filtered: bool, substeps: int) -> Parameters:
        """Return the parameters whose `PARAMETERS` components are given in the order of the fields."""
        return cls(
            rows[0],
            Coefficients(*rows[1:10]),
            rows[10],
            rows[11],
            Response(*rows[12:16]),
            rows[16],
            rows[17],
            rows[18],
            rows[19],
            rows[20],
            rows[21],
            filtered,
            substeps,
        )


Terms: TypeAlias = tuple[Number, ...]
"""The observation in SI units, in the order of `task.TERMS`."""


Outcome: TypeAlias = tuple[Number, Number, Number, Number]
"""Reward; whether the vehicle is lost; squared position error [m^2]; whether an actuator was commanded to its limit."""


def start(state: State, sample: Sample, p: Parameters, ns: Namespace) -> tuple[Plant, Terms]:
    """Return the plant with its actuators at rest, and the first observation; the low-pass starts on its input."""
    zero = state[0] * 0.0
    filtered, terms = _observe(state, (zero, zero), (zero,) * 6, sample, p._replace(filter_gain=1.0), ns)
    return (*state, zero, zero, zero, zero, filtered), terms


def step(
    plant: Plant, action: Sequence[Number], sample: Sample, p: Parameters, ns: Namespace
) -> tuple[Plant, Terms, Outcome]:
    """Return the plant one control period later, what is observed of it, and what the task makes of it.

    Args:
        plant: the state before.
        action: surge and yaw command as fractions of the limits; clipped to [-1, 1].
        sample: the outside at the end of the period.
        p: the episode's constants.
        ns: the namespace of the numbers.
    """
    x, y, psi, u, v, r, F_u, F_r, a_u0, a_r0, filtered = plant
    h, coefficients, _, _, response, _, error_scale, rate_weight, lost_distance, thrust_u, thrust_r, _, substeps = p
    V_x, V_y, X, Y, N = sample[8:13]
    a_u, a_r = ns.clip(action[0], -1.0, 1.0), ns.clip(action[1], -1.0, 1.0)
    (mean_u, mean_r), (F_u, F_r) = respond((F_u, F_r), (a_u * thrust_u, a_r * thrust_r), response, ns)
    load, current = (mean_u + X, Y, mean_r + N), (V_x, V_y)
    state = rk4_step((x, y, psi, u, v, r), load, coefficients, h, current, ns)
    for _ in range(substeps - 1):
        state = rk4_step(state, load, coefficients, h, current, ns)
    filtered, terms = _observe(state, (a_u, a_r), filtered, sample, p, ns)
    x, y, psi, u, v, r = state
    e_x, e_y, d_u, d_r = x - sample[0], y - sample[1], a_u - a_u0, a_r - a_r0
    squared_error = e_x * e_x + e_y * e_y
    outcome = (
        reward(squared_error, d_u * d_u + d_r * d_r, error_scale, rate_weight, ns),
        lost(squared_error, lost_distance),
        squared_error,
        (abs(a_u) >= 1.0) | (abs(a_r) >= 1.0),
    )
    return (x, y, psi, u, v, r, F_u, F_r, a_u, a_r, filtered), terms, outcome


def _observe(
    state: State, action: Force, filtered: State, sample: Sample, p: Parameters, ns: Namespace
) -> tuple[State, Terms]:
    """Return the new state of the low-pass, and the observation."""
    x, y, psi, u, v, r = state
    x_R, y_R, psi_R, u_R, v_R, r_R, F_uR, F_rR, V_x, V_y, _, _, _, n_x, n_y, n_psi, n_u, n_v, n_r = sample
    V_u, V_v = to_body(V_x, V_y, ns.cos(psi), ns.sin(psi))
    psi_m = psi + n_psi
    measured = (x + n_x, y + n_y, psi_m, u + V_u + n_u, v + V_v + n_v, r + n_r)
    errors = tracking_errors(measured, (x_R, y_R, psi_R, u_R, v_R, r_R), ns)
    if p.filtered:
        errors = filtered = low_pass(filtered, errors, p.filter_gain, ns)
    x_e, y_e, psi_e, u_e, v_e, r_e = errors
    c, s = ns.cos(psi_m), ns.sin(psi_m)
    e_x, e_y = to_body(x_e, y_e, c, s)
    return filtered, (
        e_x, e_y, psi_e, u_e, v_e, r_e, u_R, v_R, r_R, F_uR, F_rR,
        c, s, p.F_u_max, p.F_r_max, action[0], action[1], p.h * p.substeps,
    )  # fmt: skip


def ground_state(plant: Plant, sample: Sample, ns: Namespace) -> State:
    """Return x, y, psi and r as they are, and u, v over ground: relative to the water plus the current."""
    x, y, psi, u, v, r = plant[:6]
    V_u, V_v = to_body(sample[8], sample[9], ns.cos(psi), ns.sin(psi))
    return x, y, psi, u + V_u, v + V_v, r

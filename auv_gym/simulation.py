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
the previous action a_u, a_r; and a tuple of what sensors and commands remember, `MEMORY` numbers that are zero where
they are not in use: six tracking errors behind the low-pass, x, y of the last position fix, the two actions before."""
MEMORY = 12

Sample: TypeAlias = Sequence[Number]
"""What the outside supplies at one control instant, 20 components: the reference's x, y, psi, u, v, r, F_u, F_r; the
current's V_x, V_y, but for the shear; the external load X, Y, N; the measurement errors of x, y, psi, u, v, r; 1 where
there is a position fix, else 0. Current and load act over the control period that ends at the instant."""
SAMPLE = 20


class Parts(NamedTuple):
    """Which parts of the simulation are in use anywhere: constants, so that what is not used costs nothing."""

    substeps: int = 1  # integration steps in a control period
    filtered: bool = False  # a low-pass on the measured errors
    outages: bool = False  # position fixes fail
    delayed: bool = False  # commands come late
    weak: bool = False  # the actuators saturate below their limits
    sheared: bool = False  # the current differs from place to place

    def joined(self, other: Parts) -> Parts:
        """Return what is in use here or there; the integration steps are these."""
        return Parts(self.substeps, *(a or b for a, b in zip(self[1:], other[1:], strict=True)))


class Shear(NamedTuple):
    """A current that varies in space, V(p) = amplitude sin(k p + phase): floats, or rows of shape (N,)."""

    V_x: Number  # [m/s] amplitude
    V_y: Number  # [m/s]
    k_x: Number  # [rad/m] wave number
    k_y: Number  # [rad/m]
    phase: Number  # [rad]

    def velocity(self, x: Number, y: Number, ns: Namespace) -> tuple[Number, Number]:
        """Return what it adds to the current [m/s] at a place [m]."""
        swing = ns.sin(self.k_x * x + self.k_y * y + self.phase)
        return self.V_x * swing, self.V_y * swing


PARAMETERS = 30


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
    reach_u: Number  # action at which the surge actuator really saturates
    reach_r: Number
    delay: Number  # control periods until a command acts
    shear: Shear
    parts: Parts

    @classmethod
    def of(cls, rows: Sequence[Number], parts: Parts) -> Parameters:
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
            rows[22],
            rows[23],
            rows[24],
            Shear(*rows[25:30]),
            parts,
        )


Terms: TypeAlias = tuple[Number, ...]
"""The observation in SI units, in the order of `task.TERMS`."""


Outcome: TypeAlias = tuple[Number, Number, Number, Number]
"""Reward; whether the vehicle is lost; squared position error [m^2]; whether an actuator was commanded to its limit."""


def rows_of(plant: Plant) -> Plant:
    """Return all numbers of a plant in a row, what sensors and commands remember last."""
    return (*plant[:-1], *plant[-1])


def start(state: State, sample: Sample, p: Parameters, ns: Namespace) -> tuple[Plant, Terms]:
    """Return the plant with its actuators at rest, and the first observation; the low-pass starts on its input."""
    zero = state[0] * 0.0
    memory, terms = _observe(state, (zero, zero), (zero,) * MEMORY, sample, p._replace(filter_gain=1.0), ns)
    return (*state, zero, zero, zero, zero, memory), terms


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
    x, y, psi, u, v, r, F_u, F_r, a_u0, a_r0, memory = plant
    h, coefficients, _, _, response, _, error_scale, rate_weight, lost_distance, thrust_u, thrust_r = p[:11]
    parts = p.parts
    X, Y, N = sample[10:13]
    a_u, a_r = ns.clip(action[0], -1.0, 1.0), ns.clip(action[1], -1.0, 1.0)
    late_u, late_r = a_u, a_r
    if parts.delayed:
        late_u, late_r, memory = _late((a_u, a_r), (a_u0, a_r0), memory, p.delay, ns)
    if parts.weak:
        late_u, late_r = ns.clip(late_u, -p.reach_u, p.reach_u), ns.clip(late_r, -p.reach_r, p.reach_r)
    (mean_u, mean_r), (F_u, F_r) = respond((F_u, F_r), (late_u * thrust_u, late_r * thrust_r), response, ns)
    load, current = (mean_u + X, Y, mean_r + N), current_at(x, y, sample, p, ns)
    state = rk4_step((x, y, psi, u, v, r), load, coefficients, h, current, ns)
    for _ in range(parts.substeps - 1):
        state = rk4_step(state, load, coefficients, h, current, ns)
    memory, terms = _observe(state, (a_u, a_r), memory, sample, p, ns)
    x, y, psi, u, v, r = state
    e_x, e_y, d_u, d_r = x - sample[0], y - sample[1], a_u - a_u0, a_r - a_r0
    squared_error = e_x * e_x + e_y * e_y
    outcome = (
        reward(squared_error, d_u * d_u + d_r * d_r, error_scale, rate_weight, ns),
        lost(squared_error, lost_distance),
        squared_error,
        (abs(a_u) >= 1.0) | (abs(a_r) >= 1.0),
    )
    return (x, y, psi, u, v, r, F_u, F_r, a_u, a_r, memory), terms, outcome


def current_at(x: Number, y: Number, sample: Sample, p: Parameters, ns: Namespace) -> tuple[Number, Number]:
    """Return V_x, V_y [m/s] of the water at a place."""
    V_x, V_y = sample[8], sample[9]
    if not p.parts.sheared:
        return V_x, V_y
    more_x, more_y = p.shear.velocity(x, y, ns)
    return V_x + more_x, V_y + more_y


def _late(
    action: Force, last: Force, memory: tuple[Number, ...], delay: Number, ns: Namespace
) -> tuple[Number, Number, tuple[Number, ...]]:
    """Return the action of `delay` control periods ago, and the memory with the last one."""
    older = memory[8:]
    late_u, late_r = (
        ns.where(delay < 0.5, now, ns.where(delay < 1.5, one, ns.where(delay < 2.5, two, three)))
        for now, one, two, three in zip(action, last, older[:2], older[2:], strict=True)
    )
    return late_u, late_r, (*memory[:8], *last, *older[:2])


def _observe(
    state: State, action: Force, memory: tuple[Number, ...], sample: Sample, p: Parameters, ns: Namespace
) -> tuple[tuple[Number, ...], Terms]:
    """Return what the sensors remember now, in the plant's memory, and the observation."""
    x, y, psi, u, v, r = state
    x_R, y_R, psi_R, u_R, v_R, r_R, F_uR, F_rR, _, _, _, _, _, n_x, n_y, n_psi, n_u, n_v, n_r, fix = sample
    V_x, V_y = current_at(x, y, sample, p, ns)
    V_u, V_v = to_body(V_x, V_y, ns.cos(psi), ns.sin(psi))
    x_m, y_m, psi_m = x + n_x, y + n_y, psi + n_psi
    if p.parts.outages:
        x_old, y_old = memory[6:8]
        x_m, y_m = ns.where(fix > 0.5, x_m, x_old), ns.where(fix > 0.5, y_m, y_old)
        memory = (*memory[:6], x_m, y_m, *memory[8:])
    measured = (x_m, y_m, psi_m, u + V_u + n_u, v + V_v + n_v, r + n_r)
    errors = tracking_errors(measured, (x_R, y_R, psi_R, u_R, v_R, r_R), ns)
    if p.parts.filtered:
        errors = low_pass(memory[:6], errors, p.filter_gain, ns)
        memory = (*errors, *memory[6:])
    x_e, y_e, psi_e, u_e, v_e, r_e = errors
    c, s = ns.cos(psi_m), ns.sin(psi_m)
    e_x, e_y = to_body(x_e, y_e, c, s)
    return memory, (
        e_x, e_y, psi_e, u_e, v_e, r_e, u_R, v_R, r_R, F_uR, F_rR,
        c, s, p.F_u_max, p.F_r_max, action[0], action[1], p.h * p.parts.substeps,
    )  # fmt: skip


def ground_state(plant: Plant, sample: Sample, p: Parameters, ns: Namespace) -> State:
    """Return x, y, psi and r as they are, and u, v over ground: relative to the water plus the current."""
    x, y, psi, u, v, r = plant[:6]
    V_u, V_v = to_body(*current_at(x, y, sample, p, ns), ns.cos(psi), ns.sin(psi))
    return x, y, psi, u + V_u, v + V_v, r

"""One control step of the simulation: vehicle, actuators, sensors, observation and reward.

It is a pure function of (plant, action, sample) on components, and is used by all environments.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeAlias

from auv_gym.physics.actuators import Response, known_torque, ordered, respond
from auv_gym.physics.dynamics import CurrentVelocity, Force, State, rk4_step
from auv_gym.physics.errors import to_body, to_world, tracking_errors
from auv_gym.physics.faults import executed, with_faults
from auv_gym.physics.namespaces import Namespace, Number
from auv_gym.physics.navigation import Reckoning
from auv_gym.physics.rows import flatten, numbered, unflatten
from auv_gym.physics.sensors import low_pass
from auv_gym.physics.vehicle import Coefficients, CrossTerms
from auv_gym.task.reward import failed, reward


class PlantMemory(NamedTuple):
    """The memory of sensors, delayed commands and faults; zero if not in use."""

    x_e: Number  # [m] low-pass filtered tracking errors
    y_e: Number  # [m]
    psi_e: Number  # [rad]
    u_e: Number  # [m/s]
    v_e: Number  # [m/s]
    r_e: Number  # [rad/s]
    x: Number  # [m] last position fix, or the estimated position
    y: Number  # [m]
    a_u_2: Number  # action of the control step before a_u, a_r of the plant
    a_r_2: Number
    a_u_3: Number  # action of the control step before a_u_2, a_r_2
    a_r_3: Number
    c_u: Number  # command that the actuators executed
    c_r: Number
    psi: Number  # [rad] last measurements
    u: Number  # [m/s]
    v: Number  # [m/s]
    r: Number  # [rad/s]


class Plant(NamedTuple):
    """The states of vehicle, actuators and memory at one control instant: floats, arrays (N,) or tensors."""

    x: Number  # [m]
    y: Number  # [m]
    psi: Number  # [rad]
    u: Number  # [m/s] relative to the water
    v: Number  # [m/s]
    r: Number  # [rad/s]
    F_u: Number  # [N] of the actuators
    F_r: Number  # [N m]
    a_u: Number  # last action
    a_r: Number
    memory: PlantMemory


class Sample(NamedTuple):
    """The exogenous inputs at one control instant; current and load act over the period that ends there."""

    x_R: Number  # [m] reference
    y_R: Number  # [m]
    psi_R: Number  # [rad]
    u_R: Number  # [m/s]
    v_R: Number  # [m/s]
    r_R: Number  # [rad/s]
    F_uR: Number  # [N]
    F_rR: Number  # [N m]
    V_x: Number  # [m/s] current without shear
    V_y: Number  # [m/s]
    X: Number  # [N] external load
    Y: Number  # [N]
    N: Number  # [N m]
    n_x: Number  # [m] measurement errors
    n_y: Number  # [m]
    n_psi: Number  # [rad]
    n_u: Number  # [m/s]
    n_v: Number  # [m/s]
    n_r: Number  # [rad/s]
    fix: Number  # 1 with a position fix, else 0; with dead reckoning the gain of the fix
    fault: Number  # code of the fault, see `faults.fault_rows`; 0 without one


class Parts(NamedTuple):
    """The parts of the simulation in use. They are constants of the compiled code, so unused parts cost no time."""

    substeps: int = 1  # integration steps per control period
    filtered: bool = False  # low-pass filter of the measured errors
    outages: bool = False  # outages of the position fix
    delayed: bool = False  # delay of commands
    weak: bool = False  # saturation of the actuators below their nominal limits
    sheared: bool = False  # current that depends on the position
    reckoned: bool = False  # dead reckoning between position fixes
    lifting: bool = False  # lift of the vehicle
    crossed: bool = False  # cross terms of the vehicle
    finned: bool = False  # yaw torque of fins, which depends on the speed
    astern: bool = False  # smaller thrust astern than ahead
    faulty: bool = False  # faults of actuators and measurements
    bound_factor: int = 1  # factor of the bounds of an observation, see `observation.bounds`

    def joined(self, other: Parts) -> Parts:
        """Return the union of the parts in use, with the larger number of integration steps."""
        return Parts._make(map(max, self, other))


class Shear(NamedTuple):
    """A current that varies in space, V(p) = amplitude sin(k p + phase): floats, or rows of shape (N,)."""

    V_x: Number  # [m/s] amplitude
    V_y: Number  # [m/s]
    k_x: Number  # [rad/m] wave number
    k_y: Number  # [rad/m]
    phase: Number  # [rad]

    def velocity(self, x: Number, y: Number, ns: Namespace) -> tuple[Number, Number]:
        """Return its velocity [m/s] at a position [m]."""
        s = ns.sin(self.k_x * x + self.k_y * y + self.phase)
        return self.V_x * s, self.V_y * s


class SpeedLog(NamedTuple):
    """The systematic errors of a Doppler velocity log: floats, or rows of shape (N,)."""

    reckons: Number  # 1 with dead reckoning between fixes, 0 if the last fix is held
    along: Number  # gain in the direction of the velocity, (1 + scale error) cos(misalignment)
    across: Number  # gain to the right of it, (1 + scale error) sin(misalignment)

    def measured(self, along: Number, across: Number) -> tuple[Number, Number]:
        """Return a measured velocity [m/s] or displacement [m], without noise."""
        return to_world(along, across, self.along, self.across)


def log_of(reckoning: Reckoning | None) -> SpeedLog:
    """Return the log of an episode; for None one without errors, which is not used for dead reckoning."""
    if reckoning is None:
        return SpeedLog(0.0, 1.0, 0.0)
    share, angle = 1.0 + reckoning.scale, reckoning.misalignment
    return SpeedLog(1.0, share * math.cos(angle), share * math.sin(angle))


class Parameters(NamedTuple):
    """The constants of an episode: floats, or rows of shape (N,)."""

    h: Number  # [s] integration step
    coefficients: Coefficients  # of the true vehicle
    F_u_max: Number  # [N] force that action 1 commands, as observed
    F_r_max: Number  # [N m]
    response: Response
    filter_gain: Number
    error_scale: Number  # [m]
    rate_weight: Number
    lost_distance: Number  # [m]
    thrust_u: Number  # [N] true force at action 1
    thrust_r: Number  # [N m]
    reach_u: Number  # action at which the surge actuator saturates
    reach_r: Number
    delay: Number  # control periods until a command acts
    fin: Number  # [kg] parameter of the fins, see `actuators.Actuators`
    astern: Number  # largest thrust astern over thrust_u
    shear: Shear
    log: SpeedLog
    cross_terms: CrossTerms  # of the true vehicle
    parts: Parts

    @classmethod
    def of(cls, rows: Sequence[Number], parts: Parts) -> Parameters:
        """Return the parameters for their numbers in the order of the fields."""
        return unflatten(PARAMETERS, rows)._replace(parts=parts)


PLANT = numbered(Plant)  # index of each number of a plant
SAMPLE = numbered(Sample)  # index of each number of a sample: `SAMPLE.V_x` is that of the current V_x
PARAMETERS = numbered(Parameters)  # index of each number of the parameters
PLANT_ROWS = len(flatten(PLANT))  # number of rows of a plant
SAMPLE_ROWS = len(flatten(SAMPLE))  # number of rows of a sample
PARAMETER_ROWS = len(flatten(PARAMETERS))  # number of rows of the parameters
REFERENCE = slice(SAMPLE.x_R, SAMPLE.F_rR + 1)  # rows of the reference in a sample
CURRENT = slice(SAMPLE.V_x, SAMPLE.V_y + 1)  # rows of the current in a sample
LOAD = slice(SAMPLE.X, SAMPLE.N + 1)  # rows of the external load in a sample
NOISE = slice(SAMPLE.n_x, SAMPLE.n_r + 1)  # rows of the measurement errors in a sample

_new = tuple.__new__
"""Makes a named tuple of a tuple in a quarter of the time."""

Position: TypeAlias = tuple[Number, Number]
"""A position x, y [m] in the world."""
Terms: TypeAlias = tuple[Number, ...]
"""The observation in SI units, in the order of `observation.TERMS`."""
StepOutcome: TypeAlias = tuple[Number, Number, Number, Number]
"""Reward; whether the episode has failed; squared position error [m^2]; whether a command was at its limit."""


def start(state: State, sample: Sequence[Number], p: Parameters, ns: Namespace) -> tuple[Plant, Terms]:
    """Return the plant with actuators at rest, and the first observation; the low-pass starts at its input."""
    zero = state[0] * 0.0
    empty = unflatten(PLANT.memory, (zero,) * PLANT_ROWS)
    memory, terms = _observe(state, state, (zero, zero), empty, sample, p._replace(filter_gain=1.0), ns)
    return Plant(*state, zero, zero, zero, zero, memory), terms


def moved(
    state: State, force: Force, command: Force, sample: Sequence[Number], p: Parameters, ns: Namespace
) -> tuple[State, Force]:
    """Return the state and the actuator forces [N], [N m] one control period later.

    Args:
        state: x, y, psi, u, v, r, relative to the water.
        force: of the actuators.
        command: of the actuators, as fractions of the force at action 1.
        sample: the numbers of a `Sample`, see `step`.
        p: the constants of the episode.
        ns: the namespace of the numbers.
    """
    x, y, _, u, *_ = state
    _, _, _, _, _, _, _, _, V_x, V_y, X, Y, N, *_ = sample
    mean, force = respond(force, ordered(command, u, p, ns), p.response, ns)
    load, current = (mean[0] + X, Y, mean[1] + N), current_at(x, y, (V_x, V_y), p, ns)
    coefficients: Sequence[Number] = p.coefficients if p.parts.lifting else p.coefficients.without_lift
    if p.parts.crossed:
        coefficients = *p.coefficients, *p.cross_terms
    for _ in range(p.parts.substeps):
        state = rk4_step(state, load, coefficients, p.h, current, ns)
    return state, force


def step(
    plant: Plant,
    action: Sequence[Number],
    sample: Sequence[Number],
    p: Parameters,
    ns: Namespace,
    move: Callable[..., tuple[State, Force]] = moved,
) -> tuple[Plant, Terms, StepOutcome]:
    """Return the plant one control period later, its observation, and the outcome of the step.

    Args:
        plant: the plant before the step.
        action: surge and yaw command as fractions of the limits; clipped to [-1, 1].
        sample: the exogenous inputs at the end of the period, the numbers of a `Sample`.
        p: the constants of the episode.
        ns: the namespace of the numbers.
        move: a function with the interface of `moved`, which moves vehicle and actuators.
    """
    before, (F_u, F_r, a_u0, a_r0, memory), parts = plant[:6], plant[6:], p.parts
    a_u, a_r = ns.clip(action[0], -1.0, 1.0), ns.clip(action[1], -1.0, 1.0)
    command_u, command_r = a_u, a_r
    if parts.delayed:
        command_u, command_r, memory = _delayed((a_u, a_r), (a_u0, a_r0), memory, p.delay, ns)
    if parts.weak:
        command_u, command_r = ns.clip(command_u, -p.reach_u, p.reach_u), ns.clip(command_r, -p.reach_r, p.reach_r)
    if parts.faulty:
        last = memory.c_u, memory.c_r
        command_u, command_r = executed((command_u, command_r), last, sample[SAMPLE.fault], ns)
        memory = memory._replace(c_u=command_u, c_r=command_r)
    state, (F_u, F_r) = move(before, (F_u, F_r), (command_u, command_r), sample, p, ns)
    memory, terms = _observe(state, before, (a_u, a_r), memory, sample, p, ns)
    x, y, *_ = state
    e_x, e_y, d_u, d_r = x - sample[SAMPLE.x_R], y - sample[SAMPLE.y_R], a_u - a_u0, a_r - a_r0
    squared_error = e_x * e_x + e_y * e_y
    outcome = (
        reward(squared_error, d_u * d_u + d_r * d_r, p.error_scale, p.rate_weight, ns),
        failed(squared_error, p.lost_distance),
        squared_error,
        (abs(a_u) >= 1.0) | (abs(a_r) >= 1.0),
    )
    return _new(Plant, (*state, F_u, F_r, a_u, a_r, memory)), terms, outcome


def current_at(x: Number, y: Number, current: CurrentVelocity, p: Parameters, ns: Namespace) -> CurrentVelocity:
    """Return the current V_x, V_y [m/s] at a position, for the current of the sample."""
    if not p.parts.sheared:
        return current
    shear_x, shear_y = p.shear.velocity(x, y, ns)
    return current[0] + shear_x, current[1] + shear_y


def _delayed(
    action: Force, last: Force, memory: PlantMemory, delay: Number, ns: Namespace
) -> tuple[Number, Number, PlantMemory]:
    """Return the action `delay` control periods earlier, and the memory with the last action."""

    def chosen(now: Number, one: Number, two: Number, three: Number) -> Number:
        return ns.where(delay < 0.5, now, ns.where(delay < 1.5, one, ns.where(delay < 2.5, two, three)))

    delayed_u = chosen(action[0], last[0], memory.a_u_2, memory.a_u_3)
    delayed_r = chosen(action[1], last[1], memory.a_r_2, memory.a_r_3)
    shifted = memory._replace(a_u_2=last[0], a_r_2=last[1], a_u_3=memory.a_u_2, a_r_3=memory.a_r_2)
    return delayed_u, delayed_r, shifted


def _observe(
    state: State,
    before: State,
    action: Force,
    memory: PlantMemory,
    sample: Sequence[Number],
    p: Parameters,
    ns: Namespace,
) -> tuple[PlantMemory, Terms]:
    """Return the memory with the new values of the sensors, and the observation.

    `before` is the state one control period earlier.
    """
    x, y, psi, u, v, r = state
    x_R, y_R, psi_R, u_R, v_R, r_R, F_uR, F_rR, V_x, V_y, _, _, _, n_x, n_y, n_psi, n_u, n_v, n_r, fix, fault = sample
    parts = p.parts
    V_x, V_y = current_at(x, y, (V_x, V_y), p, ns)
    V_u, V_v = to_body(V_x, V_y, ns.cos(psi), ns.sin(psi))
    x_m, y_m, psi_m, u_m, v_m = x + n_x, y + n_y, psi + n_psi, u + V_u, v + V_v
    if parts.reckoned:
        u_m, v_m = p.log.measured(u_m, v_m)
        x_m, y_m = estimated_position((x, y), before[:2], psi_m, (memory.x, memory.y), sample, p, ns)
        memory = memory._replace(x=x_m, y=y_m)
    elif parts.outages:
        x_m, y_m = ns.where(fix > 0.5, x_m, memory.x), ns.where(fix > 0.5, y_m, memory.y)
        memory = memory._replace(x=x_m, y=y_m)
    measured: State = (x_m, y_m, psi_m, u_m + n_u, v_m + n_v, r + n_r)
    if parts.faulty:
        last = memory.x, memory.y, memory.psi, memory.u, memory.v, memory.r
        measured = x_m, y_m, psi_m, u_m, v_m, r_m = with_faults(measured, last, fault, ns)
        memory = memory._replace(x=x_m, y=y_m, psi=psi_m, u=u_m, v=v_m, r=r_m)
    x_e, y_e, psi_e, u_e, v_e, r_e = tracking_errors(measured, (x_R, y_R, psi_R, u_R, v_R, r_R), ns)
    if parts.filtered:
        filtered = (memory.x_e, memory.y_e, memory.psi_e, memory.u_e, memory.v_e, memory.r_e)
        errors = low_pass(filtered, (x_e, y_e, psi_e, u_e, v_e, r_e), p.filter_gain, ns)
        x_e, y_e, psi_e, u_e, v_e, r_e = errors
        memory = memory._replace(x_e=x_e, y_e=y_e, psi_e=psi_e, u_e=u_e, v_e=v_e, r_e=r_e)
    cos_psi, sin_psi = ns.cos(psi_m), ns.sin(psi_m)
    e_x, e_y = to_body(x_e, y_e, cos_psi, sin_psi)
    a_u, a_r = action
    F_r_max = known_torque(measured[3], p.fin, p.F_r_max, ns) if parts.finned else p.F_r_max
    return memory, (
        e_x, e_y, psi_e, u_e, v_e, r_e, u_R, v_R, r_R, F_uR, F_rR,
        cos_psi, sin_psi, p.F_u_max, F_r_max, a_u, a_r, p.h * parts.substeps,
    )  # fmt: skip


def estimated_position(
    position: Position,
    before: Position,
    psi_m: Number,
    last: Position,
    sample: Sequence[Number],
    p: Parameters,
    ns: Namespace,
) -> Position:
    """Return the position [m] estimated by dead reckoning and position fixes.

    The dead-reckoned position is last + R(n_psi) D (position - before) + R(psi_m) (n_u, n_v) dt, with rotations R and
    the gains D of `SpeedLog`: the heading error n_psi rotates the measured displacement. A fix, position + (n_x, n_y),
    is weighted by the gain `fix`, the dead-reckoned position by 1 - `fix`.

    Args:
        position: true x, y [m].
        before: true x, y one control period earlier [m].
        psi_m: measured heading [rad].
        last: the estimate one control period earlier [m].
        sample: the numbers of a `Sample`.
        p: the constants of the episode.
        ns: the namespace of the numbers.
    """
    _, _, _, _, _, _, _, _, _, _, _, _, _, n_x, n_y, n_psi, n_u, n_v, _, fix, _ = sample
    (x, y), (x_0, y_0), dt, rest = position, before, p.h * p.parts.substeps, 1.0 - fix
    dx, dy = to_world(*p.log.measured(x - x_0, y - y_0), ns.cos(n_psi), ns.sin(n_psi))
    noise_x, noise_y = to_world(n_u * dt, n_v * dt, ns.cos(psi_m), ns.sin(psi_m))
    reckoned_x = last[0] + p.log.reckons * (dx + noise_x)
    reckoned_y = last[1] + p.log.reckons * (dy + noise_y)
    return rest * reckoned_x + fix * (x + n_x), rest * reckoned_y + fix * (y + n_y)


def ground_state(plant: Plant, current: CurrentVelocity, p: Parameters, ns: Namespace) -> State:
    """Return x, y, psi, u, v over ground and r, for the current of the sample."""
    x, y, psi, u, v, r, *_ = plant
    V_u, V_v = to_body(*current_at(x, y, current, p, ns), ns.cos(psi), ns.sin(psi))
    return x, y, psi, u + V_u, v + V_v, r

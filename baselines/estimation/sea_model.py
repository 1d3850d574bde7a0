"""Discrete-time model of vehicle, actuators and disturbances for the extended Kalman filter.

It is written on components, so that predictive control can use it as well. The wave load on each axis is a lightly
damped oscillator driven by white noise (T. I. Fossen, Handbook of Marine Craft Hydrodynamics and Motion Control, 2nd
ed., 2021, section 10.2). Current, its rate and the slowly varying load are Gauss-Markov processes. The actuators' time
constant is a random walk.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple, TypeAlias

from auv_gym.effects.actuators import Response, respond
from auv_gym.physics.dynamics import CurrentVelocity, Force, Load, from_outside, rk4_step
from auv_gym.physics.errors import to_body
from auv_gym.physics.namespaces import Namespace, Number
from auv_gym.physics.vehicle import Coefficients

WAVE_FREQUENCY = 0.8  # [rad/s] natural frequency of the wave oscillators
WAVE_DAMPING = 0.1  # [1] relative damping of the wave oscillators
GUST_MEMORY = 3.0  # [s] correlation time of the current's rate
CURRENT_MEMORY = 40.0
"""Correlation time [s] of the current. On a straight line only the sum of the effects of current and load is
observable. A finite correlation time keeps estimates of opposite signs from growing together."""
BIAS_MEMORY = 10.0  # [s] correlation time of the slowly varying load
SHORTEST_LAG = 1e-3  # [s] least time constant of the actuators; positive, so that the derivatives are finite
LONGEST_LAG = 2.0  # [s] largest time constant of the actuators

WaveTransition: TypeAlias = tuple[tuple[Number, Number], tuple[Number, Number]]
"""A matrix (2, 2), as two rows."""


class Estimate(NamedTuple):
    """The state of the model: floats, rows of shape (N,) or symbols."""

    x_e: Number  # [m] position minus that of the reference, in the world
    y_e: Number  # [m]
    psi: Number  # [rad] continuous in time
    u: Number  # [m/s] relative to the water
    v: Number  # [m/s]
    r: Number  # [rad/s]
    F_u: Number  # [N] force that the actuators apply
    F_r: Number  # [N m]
    V_x: Number  # [m/s] current, in the world
    V_y: Number  # [m/s]
    V_x_rate: Number  # [m/s^2]
    V_y_rate: Number  # [m/s^2]
    X: Number  # [N] slowly varying load on the vehicle; it includes the effect of model errors
    Y: Number  # [N]
    N: Number  # [N m]
    lag: Number  # [s] time constant of the actuators
    X_wave: Number  # [N] wave load ...
    X_swing: Number  # [N] ... and its rate divided by WAVE_FREQUENCY
    Y_wave: Number  # [N]
    Y_swing: Number  # [N]
    N_wave: Number  # [N m]
    N_swing: Number  # [N m]


STATE_SIZE = len(Estimate._fields)  # number of states
PLACE: Any = Estimate._make(range(STATE_SIZE))  # the row of each field: `PLACE.lag` is that of the lag
MOTION_STATES = slice(PLACE.x_e, PLACE.F_u)  # rows of position, heading and velocities
FORCE = slice(PLACE.F_u, PLACE.V_x)  # rows of the actuators' forces
CURRENT_STATES = slice(PLACE.V_x, PLACE.V_x_rate)  # rows of the current
GUST = slice(PLACE.V_x_rate, PLACE.X)  # rows of the current's rate
BIAS = slice(PLACE.X, PLACE.lag)  # rows of the slowly varying load
WAVES = slice(PLACE.X_wave, STATE_SIZE)  # rows of the wave loads and swings of all axes
WAVE_PAIRS = tuple(slice(row, row + 2) for row in (PLACE.X_wave, PLACE.Y_wave, PLACE.N_wave))  # load and swing
SENSORS = PLACE.F_u  # number of measurements: the `MOTION_STATES`, with velocities over ground


def lag_response(lag: Number, dt: Number, ns: Namespace) -> Response:
    """Return `Response.of` for positive time constants [s], without rate limits."""
    gain = 1.0 - ns.exp(-dt / lag)
    return Response(gain, (1.0 - lag / dt * gain) / gain, math.inf, math.inf)


def wave_transition(dt: Number, ns: Namespace) -> WaveTransition:
    """Return the transition matrix A of a wave load and its swing over dt [s] without excitation, as two rows.

    White noise for which both have the stationary variance s^2 adds the covariance s^2 (1 - A A^T) in this time.
    """
    root = math.sqrt(1 - WAVE_DAMPING**2)
    angle = root * WAVE_FREQUENCY * dt
    c, s = ns.cos(angle), ns.sin(angle) / root
    decay = ns.exp(-WAVE_DAMPING * WAVE_FREQUENCY * dt)
    a, b = WAVE_DAMPING * s, decay * s
    return (decay * (c + a), b), (-b, decay * (c - a))


def waves_after(z: Estimate, A: WaveTransition) -> tuple[Number, ...]:
    """Return the six wave states after one transition by the matrix A of `wave_transition`."""
    (a, b), (c, d) = A
    pairs = ((z.X_wave, z.X_swing), (z.Y_wave, z.Y_swing), (z.N_wave, z.N_swing))
    return tuple(row for w, s in pairs for row in (a * w + b * s, c * w + d * s))


def current_transition(dt: Number, ns: Namespace) -> tuple[Number, Number, Number]:
    """Return the decay factors of the current and of its rate over dt [s], and the effective time [s] of the rate."""
    decay = ns.exp(-dt / GUST_MEMORY)
    return ns.exp(-dt / CURRENT_MEMORY), decay, GUST_MEMORY * (1 - decay)


def current_after(z: Estimate, dt: Number, ns: Namespace) -> CurrentVelocity:
    """Return the current V_x, V_y [m/s] after dt [s]."""
    decay, _, time = current_transition(dt, ns)
    return decay * z.V_x + time * z.V_x_rate, decay * z.V_y + time * z.V_y_rate


def mean_load(z: Estimate, command: Force, dt: Number, coefficients: Coefficients, ns: Namespace) -> tuple[Load, Force]:
    """Return the mean load on the vehicle over one control period, and the actuators' force at its end."""
    (mean_u, mean_r), force = respond((z.F_u, z.F_r), command, lag_response(z.lag, dt, ns), ns)
    X_wave, _, Y_wave, _, N_wave, _ = waves_after(z, wave_transition(dt, ns))
    X, Y, N = from_outside((z.X + X_wave, z.Y + Y_wave, z.N + N_wave), coefficients)
    return (mean_u + X, Y, mean_r + N), force


def transition(
    z: Estimate,
    command: Force,
    reference_step: tuple[Number, Number],
    dt: Number,
    coefficients: Coefficients,
    ns: Namespace,
) -> Estimate:
    """Return the state one control period later, without excitation.

    Args:
        z: the state.
        command: F_u [N], F_r [N m] during the period.
        reference_step: displacement of the reference in the world during the period [m].
        dt: control period [s].
        coefficients: of the nominal vehicle.
        ns: the namespace of the numbers.
    """
    load, force = mean_load(z, command, dt, coefficients, ns)
    current = current_after(z, dt, ns)
    x, y, psi, u, v, r = rk4_step((z.x_e, z.y_e, z.psi, z.u, z.v, z.r), load, coefficients, dt, current, ns)
    step_x, step_y = reference_step
    vehicle = (x - step_x, y - step_y, psi, u, v, r)
    _, decay, _ = current_transition(dt, ns)
    gust = decay * z.V_x_rate, decay * z.V_y_rate
    bias_decay = ns.exp(-dt / BIAS_MEMORY)
    bias = (bias_decay * load for load in z[BIAS])
    waves = waves_after(z, wave_transition(dt, ns))
    return Estimate._make((*vehicle, *force, *current, *gust, *bias, z.lag, *waves))


def measurement(z: Estimate, ns: Namespace) -> tuple[Number, ...]:
    """Return the ideal measurements: x_e, y_e, psi, u and v over ground, r."""
    V_u, V_v = to_body(z.V_x, z.V_y, ns.cos(z.psi), ns.sin(z.psi))
    return z.x_e, z.y_e, z.psi, z.u + V_u, z.v + V_v, z.r

"""What the extended Kalman filter believes: the vehicle, its actuators and the sea as one discrete-time model.

Written on components, so that an optimiser may predict with it too. The wave load on each axis is a lightly damped
oscillator driven by white noise (T. I. Fossen, Handbook of Marine Craft Hydrodynamics and Motion Control, 2nd ed.,
2021, section 10.2); current, its rate and the slowly varying load are Gauss-Markov processes, the lag drifts.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple, TypeAlias

from auv_gym.physics.actuators import Response, respond
from auv_gym.physics.dynamics import CurrentVelocity, Force, Load, rk4_step
from auv_gym.physics.errors import to_body
from auv_gym.physics.namespaces import Namespace, Number
from auv_gym.physics.vehicle import Coefficients

WAVE_FREQUENCY = 0.8  # [rad/s] natural frequency of the wave oscillators
WAVE_DAMPING = 0.1  # [1] relative damping of the wave oscillators
GUST_MEMORY = 3.0  # [s] in which the current's rate is forgotten
CURRENT_MEMORY = 40.0
"""Time [s] in which the current is forgotten. On a straight line only the common effect of current and load is seen:
without an end to memory, opposite ones could grow together."""
BIAS_MEMORY = 10.0  # [s] in which the slowly varying load is forgotten
SHORTEST_LAG = 1e-3  # [s] least time constant of the actuators: they respond at once, but the derivatives are finite
LONGEST_LAG = 2.0  # [s] largest time constant of the actuators

WaveTransition: TypeAlias = tuple[tuple[Number, Number], tuple[Number, Number]]
"""A matrix of two rows."""


class Estimate(NamedTuple):
    """The state of the model: floats, rows of shape (N,) or symbols."""

    x_e: Number  # [m] position less the reference's, in the world
    y_e: Number  # [m]
    psi: Number  # [rad] continuous in time
    u: Number  # [m/s] relative to the water
    v: Number  # [m/s]
    r: Number  # [rad/s]
    F_u: Number  # [N] what the actuators apply
    F_r: Number  # [N m]
    V_x: Number  # [m/s] current, in the world
    V_y: Number  # [m/s]
    V_x_rate: Number  # [m/s^2]
    V_y_rate: Number  # [m/s^2]
    X: Number  # [N] slowly varying load on the hull, whatever makes the model wrong included
    Y: Number  # [N]
    N: Number  # [N m]
    lag: Number  # [s] time constant of the actuators
    X_wave: Number  # [N] wave load ...
    X_swing: Number  # [N] ... and its rate over WAVE_FREQUENCY
    Y_wave: Number  # [N]
    Y_swing: Number  # [N]
    N_wave: Number  # [N m]
    N_swing: Number  # [N m]


STATE_SIZE = len(Estimate._fields)  # how many rows an `Estimate` has
PLACE: Any = Estimate._make(range(STATE_SIZE))  # the row of each field: `PLACE.lag` is that of the lag
MOTION_STATES = slice(PLACE.x_e, PLACE.F_u)  # the six that sensors measure, velocities over ground, in this order
FORCE = slice(PLACE.F_u, PLACE.V_x)  # what the actuators apply
CURRENT_STATES = slice(PLACE.V_x, PLACE.V_x_rate)  # the current
GUST = slice(PLACE.V_x_rate, PLACE.X)  # the current's rate
BIAS = slice(PLACE.X, PLACE.lag)  # the slowly varying load
WAVES = slice(PLACE.X_wave, STATE_SIZE)  # the wave loads and swings of all axes
WAVE_PAIRS = tuple(slice(row, row + 2) for row in (PLACE.X_wave, PLACE.Y_wave, PLACE.N_wave))  # load and swing
SENSORS = PLACE.F_u  # how many values are measured: the `MOTION_STATES`


def lag_response(lag: Number, dt: Number, ns: Namespace) -> Response:
    """Return `Response.of` for positive time constants [s], without rate limits."""
    gain = 1.0 - ns.exp(-dt / lag)
    return Response(gain, (1.0 - lag / dt * gain) / gain, math.inf, math.inf)


def wave_transition(dt: Number, ns: Namespace) -> WaveTransition:
    """Return the matrix A that takes a wave load and its swing over dt [s] without excitation, as two rows.

    White noise that keeps both at the variance s^2 adds the covariance s^2 (1 - A A^T) meanwhile.
    """
    root = math.sqrt(1 - WAVE_DAMPING**2)
    angle = root * WAVE_FREQUENCY * dt
    c, s = ns.cos(angle), ns.sin(angle) / root
    decay = ns.exp(-WAVE_DAMPING * WAVE_FREQUENCY * dt)
    a, b = WAVE_DAMPING * s, decay * s
    return (decay * (c + a), b), (-b, decay * (c - a))


def waves_after(z: Estimate, A: WaveTransition) -> tuple[Number, ...]:
    """Return the six wave entries of the state after the time that A, see `wave_transition`, is for."""
    (a, b), (c, d) = A
    pairs = ((z.X_wave, z.X_swing), (z.Y_wave, z.Y_swing), (z.N_wave, z.N_swing))
    return tuple(row for w, s in pairs for row in (a * w + b * s, c * w + d * s))


def current_transition(dt: Number, ns: Namespace) -> tuple[Number, Number, Number]:
    """Return what is left of the current and of its rate after dt [s], and the time [s] that the rate has acted for."""
    left = ns.exp(-dt / GUST_MEMORY)
    return ns.exp(-dt / CURRENT_MEMORY), left, GUST_MEMORY * (1 - left)


def current_after(z: Estimate, dt: Number, ns: Namespace) -> CurrentVelocity:
    """Return the current V_x, V_y [m/s] after dt [s]."""
    kept, _, time = current_transition(dt, ns)
    return kept * z.V_x + time * z.V_x_rate, kept * z.V_y + time * z.V_y_rate


def mean_load(z: Estimate, command: Force, dt: Number, ns: Namespace) -> tuple[Load, Force]:
    """Return the mean load on the hull over one control period, and the actuators' force at its end."""
    (mean_u, mean_r), force = respond((z.F_u, z.F_r), command, lag_response(z.lag, dt, ns), ns)
    X_wave, _, Y_wave, _, N_wave, _ = waves_after(z, wave_transition(dt, ns))
    return (mean_u + z.X + X_wave, z.Y + Y_wave, mean_r + z.N + N_wave), force


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
        command: F_u [N], F_r [N m] commanded in between.
        reference_step: how far the reference moves in the world in between [m].
        dt: control period [s].
        coefficients: of the vehicle as it is known.
        ns: the namespace of the numbers.
    """
    load, force = mean_load(z, command, dt, ns)
    current = current_after(z, dt, ns)
    x, y, psi, u, v, r = rk4_step((z.x_e, z.y_e, z.psi, z.u, z.v, z.r), load, coefficients, dt, current, ns)
    step_x, step_y = reference_step
    hull = (x - step_x, y - step_y, psi, u, v, r)
    _, left, _ = current_transition(dt, ns)
    gust = left * z.V_x_rate, left * z.V_y_rate
    forgotten = ns.exp(-dt / BIAS_MEMORY)
    bias = (forgotten * load for load in z[BIAS])
    waves = waves_after(z, wave_transition(dt, ns))
    return Estimate._make((*hull, *force, *current, *gust, *bias, z.lag, *waves))


def measurement(z: Estimate, ns: Namespace) -> tuple[Number, ...]:
    """Return what the sensors should show: x_e, y_e, psi, u and v over ground, r."""
    V_u, V_v = to_body(z.V_x, z.V_y, ns.cos(z.psi), ns.sin(z.psi))
    return z.x_e, z.y_e, z.psi, z.u + V_u, z.v + V_v, z.r

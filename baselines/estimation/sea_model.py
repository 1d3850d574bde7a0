"""What the extended Kalman filter believes: the vehicle, its actuators and the sea as one discrete-time model.

Written on rows of shape (N,), so that an optimiser may predict with it too. The wave load on each axis is a lightly
damped oscillator driven by white noise (T. I. Fossen, Handbook of Marine Craft Hydrodynamics and Motion Control, 2nd
ed., 2021, section 10.2); current, its rate and the slowly varying load are Gauss-Markov processes, the lag drifts.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from auv_gym.actuators import Response, respond
from auv_gym.dynamics import Force, Load, rk4_step
from auv_gym.errors import to_body
from auv_gym.namespaces import ARRAYS
from auv_gym.vehicle import Vehicle
from baselines.policy import Array, first_order

WAVE_FREQUENCY = 0.8
"""Natural frequency of the wave oscillators [rad/s]."""
WAVE_DAMPING = 0.1
"""Their relative damping."""
GUST_MEMORY, CURRENT_MEMORY, BIAS_MEMORY = 3.0, 40.0, 10.0
"""Times [s] in which the current's rate, the current and the slowly varying load are forgotten. On a straight line only
their common effect is seen: without an end to memory, opposite currents and loads could grow together."""
SHORTEST_LAG, LONGEST_LAG = 1e-3, 2.0
"""Bounds of the actuators' time constant [s]; the shortest responds at once, but keeps the derivatives finite."""
STEP = 1e-6
"""Increment of the difference quotients, in SI units."""


class Estimate(NamedTuple):
    """The state of the model: rows of shape (N,)."""

    x_e: Array  # [m] position less the reference's, in the world
    y_e: Array  # [m]
    psi: Array  # [rad] continuous in time
    u: Array  # [m/s] relative to the water
    v: Array  # [m/s]
    r: Array  # [rad/s]
    F_u: Array  # [N] what the actuators apply
    F_r: Array  # [N m]
    V_x: Array  # [m/s] current, in the world
    V_y: Array  # [m/s]
    V_x_rate: Array  # [m/s^2]
    V_y_rate: Array  # [m/s^2]
    X: Array  # [N] slowly varying load on the hull, whatever makes the model wrong included
    Y: Array  # [N]
    N: Array  # [N m]
    lag: Array  # [s] time constant of the actuators
    X_wave: Array  # [N] wave load ...
    X_swing: Array  # [N] ... and its rate over WAVE_FREQUENCY
    Y_wave: Array  # [N]
    Y_swing: Array  # [N]
    N_wave: Array  # [N m]
    N_swing: Array  # [N m]


SIZE = len(Estimate._fields)
SENSORS = 6
HULL, FORCE, CURRENT, GUST = slice(0, 6), slice(6, 8), slice(8, 10), slice(10, 12)
BIAS, LAG, WAVES = slice(12, 15), 15, slice(16, 22)
"""Where they stand in an `Estimate`."""


def lag_response(lag: Array, dt: Array) -> Response:
    """Return `Response.of` for rows of positive time constants [s], without rate limits."""
    gain = first_order(dt, lag)
    return Response(gain, (1 - lag / dt * gain) / gain, np.inf, np.inf)


def wave_transition(dt: Array) -> Array:
    """Return the matrix A that takes a wave load and its swing over dt [s] without excitation, shape (2, 2, N).

    White noise that keeps both at the variance s^2 adds the covariance s^2 (1 - A A^T) meanwhile.
    """
    root = math.sqrt(1 - WAVE_DAMPING**2)
    angle = root * WAVE_FREQUENCY * dt
    c, s = np.cos(angle), np.sin(angle) / root
    decay = np.exp(-WAVE_DAMPING * WAVE_FREQUENCY * dt)
    return np.array(((c + WAVE_DAMPING * s, s), (-s, c - WAVE_DAMPING * s))) * decay


def waves_after(z: Estimate, dt: Array) -> tuple[Array, ...]:
    """Return the six wave entries of the state dt [s] later."""
    (a, b), (c, d) = wave_transition(dt)
    pairs = ((z.X_wave, z.X_swing), (z.Y_wave, z.Y_swing), (z.N_wave, z.N_swing))
    return tuple(row for w, s in pairs for row in (a * w + b * s, c * w + d * s))


def current_transition(dt: Array) -> tuple[Array, Array, Array]:
    """Return what is left of the current and of its rate after dt [s], and the time [s] that the rate has acted for."""
    left = np.exp(-dt / GUST_MEMORY)
    return np.exp(-dt / CURRENT_MEMORY), left, GUST_MEMORY * (1 - left)


def transition(z: Estimate, command: Force, reference_step: Force, dt: Array, vehicle: Vehicle) -> Estimate:
    """Return the state one control period later, without excitation.

    Args:
        z: the state.
        command: F_u [N], F_r [N m] commanded in between.
        reference_step: how far the reference moves in the world in between [m].
        dt: control period [s].
        vehicle: as it is known.
    """
    load, force = _load(z, command, dt)
    kept, left, time = current_transition(dt)
    current = kept * z.V_x + time * z.V_x_rate, kept * z.V_y + time * z.V_y_rate
    x, y, psi, u, v, r = rk4_step((z.x_e, z.y_e, z.psi, z.u, z.v, z.r), load, vehicle.coefficients, dt, current, np)
    hull = (x - reference_step[0], y - reference_step[1], psi, u, v, r)
    gust = left * z.V_x_rate, left * z.V_y_rate
    bias = (np.exp(-dt / BIAS_MEMORY) * load for load in z[BIAS])
    return Estimate._make((*hull, *force, *current, *gust, *bias, z.lag, *waves_after(z, dt)))


def _load(z: Estimate, command: Force, dt: Array) -> tuple[Load, Force]:
    """Return the mean load on the hull over one control period, and the actuators' force at its end."""
    (mean_u, mean_r), force = respond((z.F_u, z.F_r), command, lag_response(z.lag, dt), ARRAYS)
    X_wave, _, Y_wave, _, N_wave, _ = waves_after(z, dt)
    return (mean_u + z.X + X_wave, z.Y + Y_wave, mean_r + z.N + N_wave), force


def transition_jacobian(z: Estimate, command: Force, dt: Array, vehicle: Vehicle) -> Array:
    """Return the derivative of `transition` by the state, shape (N, SIZE, SIZE).

    Of the equations of motion it is the difference quotient of the integrator itself; the rest is linear but for the
    lag, and in closed form.
    """
    load, _ = _load(z, command, dt)
    hull = hull_jacobian(np.array((z.psi, z.u, z.v, z.r, *load)), dt, vehicle)
    by_X, by_N = hull[:, 4], hull[:, 6]
    gain, mean, *_ = lag_response(z.lag, dt)
    share, still = gain * mean, 1 - gain
    share_rate, gain_rate = still / z.lag - gain / dt, -still * dt / z.lag**2
    missing_u, missing_r = command[0] - z.F_u, command[1] - z.F_r
    F = np.zeros((SIZE, SIZE, len(dt)))
    F[(0, 1), (0, 1)] = 1.0
    F[HULL, 2:6], F[HULL, BIAS] = hull[:, :4], hull[:, 4:]
    F[HULL, 6], F[HULL, 7] = by_X * (1 - share), by_N * (1 - share)
    F[6, 6] = F[7, 7] = still
    F[HULL, LAG] = share_rate * (missing_u * by_X + missing_r * by_N)
    F[6, LAG], F[7, LAG] = gain_rate * missing_u, gain_rate * missing_r
    kept, left, time = current_transition(dt)
    for axis, (V, V_rate) in enumerate(((8, 10), (9, 11))):
        F[V, V], F[V_rate, V_rate], F[V, V_rate] = kept, left, time
        F[axis, V], F[axis, V_rate] = dt * kept, dt * time
    F[LAG, LAG] = 1.0
    F[(12, 13, 14), (12, 13, 14)] = np.exp(-dt / BIAS_MEMORY)
    A = wave_transition(dt)
    for axis in range(3):
        pair = slice(WAVES.start + 2 * axis, WAVES.start + 2 * axis + 2)
        F[pair, pair], F[HULL, pair] = A, hull[:, 4 + axis, None] * A[0]
    return np.ascontiguousarray(np.moveaxis(F, -1, 0))


def hull_jacobian(before: Array, dt: Array, vehicle: Vehicle) -> Array:
    """Return the derivative of x, y, psi, u, v, r after dt by psi, u, v, r, X, Y, N before, shape (6, 7, N)."""
    varied = np.repeat(before[:, None], 8, axis=1)  # the first of the eight as it is
    varied[np.arange(7), np.arange(1, 8)] += STEP
    psi, u, v, r, X, Y, N = varied
    origin = np.zeros_like(psi)
    after = np.array(rk4_step((origin, origin, psi, u, v, r), (X, Y, N), vehicle.coefficients, dt, ns=ARRAYS))
    return np.asarray((after[:, 1:] - after[:, :1]) / STEP)


def measurement(z: Estimate) -> Array:
    """Return what the sensors should show: x_e, y_e, psi, u and v over ground, r; shape (SENSORS, N)."""
    V_u, V_v = to_body(z.V_x, z.V_y, np.cos(z.psi), np.sin(z.psi))
    return np.array((z.x_e, z.y_e, z.psi, z.u + V_u, z.v + V_v, z.r))


def measurement_jacobian(z: Estimate) -> Array:
    """Return the derivative of `measurement` by the state, shape (N, SENSORS, SIZE)."""
    c, s = np.cos(z.psi), np.sin(z.psi)
    V_u, V_v = to_body(z.V_x, z.V_y, c, s)
    H = np.zeros((SENSORS, SIZE, len(c)))
    for i in range(SENSORS):
        H[i, i] = 1.0
    H[3, 2], H[3, 8], H[3, 9] = V_v, c, s
    H[4, 2], H[4, 8], H[4, 9] = -V_u, -s, c
    return np.ascontiguousarray(np.moveaxis(H, -1, 0))

"""What the extended Kalman filter believes: the vehicle, its actuators and the sea as one discrete-time model.

Written on rows of shape (N,), so that an optimiser may predict with it too. The wave load on each axis is a lightly
damped oscillator driven by white noise (T. I. Fossen, Handbook of Marine Craft Hydrodynamics and Motion Control, 2nd
ed., 2021, section 10.2); current, its rate and the slowly varying load are Gauss-Markov processes, the lag drifts.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from auv_gym.actuators import Response, respond
from auv_gym.dynamics import Force, Load, rk4_step
from auv_gym.errors import to_body
from auv_gym.namespaces import ARRAYS
from auv_gym.vehicle import Vehicle
from baselines.policy import Array, first_order

WAVE_FREQUENCY = 0.8  # [rad/s] natural frequency of the wave oscillators
WAVE_DAMPING = 0.1  # [1] relative damping of the wave oscillators
GUST_MEMORY = 3.0  # [s] in which the current's rate is forgotten
CURRENT_MEMORY = 40.0
"""Time [s] in which the current is forgotten. On a straight line only the common effect of current and load is seen:
without an end to memory, opposite ones could grow together."""
BIAS_MEMORY = 10.0  # [s] in which the slowly varying load is forgotten
SHORTEST_LAG = 1e-3  # [s] least time constant of the actuators: they respond at once, but the derivatives are finite
LONGEST_LAG = 2.0  # [s] largest time constant of the actuators
INCREMENT = 1e-6  # of the difference quotients, in SI units


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


SIZE = len(Estimate._fields)  # how many rows an `Estimate` has
AT: Any = Estimate._make(range(SIZE))  # where each field stands in an `Estimate`: `AT.lag` is the row of the lag
HULL = slice(AT.x_e, AT.F_u)  # what moves; the sensors measure these six, velocities over ground, in this order
MOTION = slice(AT.psi, AT.F_u)  # what of the hull's motion its rates depend on
FORCE = slice(AT.F_u, AT.V_x)  # what the actuators apply
CURRENT = slice(AT.V_x, AT.V_x_rate)  # the current
GUST = slice(AT.V_x_rate, AT.X)  # the current's rate
BIAS = slice(AT.X, AT.lag)  # the slowly varying load
WAVES = slice(AT.X_wave, SIZE)  # the wave loads and swings of all axes
WAVE_PAIRS = tuple(slice(wave, wave + 2) for wave in (AT.X_wave, AT.Y_wave, AT.N_wave))  # load and swing of each axis
SENSORS = AT.F_u  # how many values are measured: the `HULL`


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


def waves_after(z: Estimate, A: Array) -> tuple[Array, ...]:
    """Return the six wave entries of the state after the time that A, see `wave_transition`, is for."""
    (a, b), (c, d) = A
    pairs = ((z.X_wave, z.X_swing), (z.Y_wave, z.Y_swing), (z.N_wave, z.N_swing))
    return tuple(row for w, s in pairs for row in (a * w + b * s, c * w + d * s))


def current_transition(dt: Array) -> tuple[Array, Array, Array]:
    """Return what is left of the current and of its rate after dt [s], and the time [s] that the rate has acted for."""
    left = np.exp(-dt / GUST_MEMORY)
    return np.exp(-dt / CURRENT_MEMORY), left, GUST_MEMORY * (1 - left)


def transition(
    z: Estimate, command: Force, reference_step: tuple[Array, Array], dt: Array, A: Array, vehicle: Vehicle
) -> Estimate:
    """Return the state one control period later, without excitation.

    Args:
        z: the state.
        command: F_u [N], F_r [N m] commanded in between.
        reference_step: how far the reference moves in the world in between [m].
        dt: control period [s].
        A: its `wave_transition`.
        vehicle: as it is known.
    """
    waves = waves_after(z, A)
    load, force = _load(z, command, dt, waves)
    kept, left, time = current_transition(dt)
    current = kept * z.V_x + time * z.V_x_rate, kept * z.V_y + time * z.V_y_rate
    x, y, psi, u, v, r = rk4_step((z.x_e, z.y_e, z.psi, z.u, z.v, z.r), load, vehicle.coefficients, dt, current, np)
    step_x, step_y = reference_step
    hull = (x - step_x, y - step_y, psi, u, v, r)
    gust = left * z.V_x_rate, left * z.V_y_rate
    bias = (np.exp(-dt / BIAS_MEMORY) * load for load in z[BIAS])
    return Estimate._make((*hull, *force, *current, *gust, *bias, z.lag, *waves))


def _load(z: Estimate, command: Force, dt: Array, waves: tuple[Array, ...]) -> tuple[Load, Force]:
    """Return the mean load on the hull over one control period, and the actuators' force at its end."""
    (mean_u, mean_r), force = respond((z.F_u, z.F_r), command, lag_response(z.lag, dt), ARRAYS)
    X_wave, _, Y_wave, _, N_wave, _ = waves
    return (mean_u + z.X + X_wave, z.Y + Y_wave, mean_r + z.N + N_wave), force


def transition_jacobian(z: Estimate, command: Force, dt: Array, A: Array, vehicle: Vehicle) -> Array:
    """Return the derivative of `transition` by the state, shape (N, SIZE, SIZE).

    Of the equations of motion it is the difference quotient of the integrator itself; the rest is linear but for the
    lag, and in closed form.
    """
    load, _ = _load(z, command, dt, waves_after(z, A))
    by_motion, by_load = hull_jacobian(np.array((z.psi, z.u, z.v, z.r, *load)), dt, vehicle)
    by_X, by_N = by_load[:, 0], by_load[:, 2]
    gain, mean, *_ = lag_response(z.lag, dt)
    share, still = gain * mean, 1 - gain
    share_rate, gain_rate = still / z.lag - gain / dt, -still * dt / z.lag**2  # by the lag
    command_u, command_r = command
    missing_u, missing_r = command_u - z.F_u, command_r - z.F_r
    F = np.zeros((SIZE, SIZE, len(dt)))
    F[AT.x_e, AT.x_e] = F[AT.y_e, AT.y_e] = F[AT.lag, AT.lag] = 1.0
    F[HULL, MOTION], F[HULL, BIAS] = by_motion, by_load
    F[HULL, AT.F_u], F[HULL, AT.F_r] = by_X * (1 - share), by_N * (1 - share)
    F[AT.F_u, AT.F_u] = F[AT.F_r, AT.F_r] = still
    F[HULL, AT.lag] = share_rate * (missing_u * by_X + missing_r * by_N)
    F[AT.F_u, AT.lag], F[AT.F_r, AT.lag] = gain_rate * missing_u, gain_rate * missing_r
    kept, left, time = current_transition(dt)
    for e, V, V_rate in ((AT.x_e, AT.V_x, AT.V_x_rate), (AT.y_e, AT.V_y, AT.V_y_rate)):
        F[V, V], F[V_rate, V_rate], F[V, V_rate] = kept, left, time
        F[e, V], F[e, V_rate] = dt * kept, dt * time
    for axis, (bias, pair) in enumerate(zip((AT.X, AT.Y, AT.N), WAVE_PAIRS, strict=True)):
        F[bias, bias] = np.exp(-dt / BIAS_MEMORY)
        F[pair, pair], F[HULL, pair] = A, by_load[:, axis, None] * A[0]  # the first row of A is the load's
    return np.ascontiguousarray(np.moveaxis(F, -1, 0))


def hull_jacobian(before: Array, dt: Array, vehicle: Vehicle) -> tuple[Array, Array]:
    """Return the derivatives of x, y, psi, u, v, r after dt [s] by psi, u, v, r before and by the load X, Y, N.

    Args:
        before: psi, u, v, r, X, Y, N, shape (7, N).
        dt: [s], shape (N,).
        vehicle: as it is known.

    Returns:
        Arrays of shape (6, 4, N) and (6, 3, N).
    """
    n = len(before)
    varied = np.repeat(before[:, None], n + 1, axis=1)  # the first of the n + 1 as it is
    varied[np.arange(n), np.arange(1, n + 1)] += INCREMENT
    psi, u, v, r, X, Y, N = varied
    origin = np.zeros_like(psi)
    after = np.array(rk4_step((origin, origin, psi, u, v, r), (X, Y, N), vehicle.coefficients, dt, ns=ARRAYS))
    slopes = (after[:, 1:] - after[:, :1]) / INCREMENT
    return slopes[:, :4], slopes[:, 4:]


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
    H[AT.u, AT.psi], H[AT.u, AT.V_x], H[AT.u, AT.V_y] = V_v, c, s
    H[AT.v, AT.psi], H[AT.v, AT.V_x], H[AT.v, AT.V_y] = -V_u, -s, c
    return np.ascontiguousarray(np.moveaxis(H, -1, 0))

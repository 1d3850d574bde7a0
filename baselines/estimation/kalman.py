"""An extended Kalman filter for the vehicle, its actuators and the sea, fed with nothing but the observation.

What it believes is in `sea_model`. How noisy the sensors are it finds out as it runs. It knows no control law: `start`
and then `update` with each observation give an `Estimate` for a law, an optimiser or a trained policy to act on.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from auv_gym.errors import to_world
from auv_gym.intervals import check_number
from auv_gym.namespaces import ARRAYS, wrap_angle
from auv_gym.task import Observation
from auv_gym.vehicle import PAPER_VEHICLE, Vehicle
from baselines.estimation.sea_model import (
    AT,
    BIAS,
    CURRENT,
    FORCE,
    GUST,
    GUST_MEMORY,
    HULL,
    LONGEST_LAG,
    SENSORS,
    SHORTEST_LAG,
    SIZE,
    WAVE_PAIRS,
    WAVES,
    Estimate,
    measurement,
    measurement_jacobian,
    transition,
    transition_jacobian,
    wave_transition,
)
from baselines.estimation.water_frame import Motion
from baselines.policy import SPEED_FLOOR, Array, Memory

FIRST_NOISE = np.array((0.05, 0.05, 0.015, 0.02, 0.02, 0.005))
"""Standard deviations of x_e, y_e [m], psi [rad], u, v [m/s], r [rad/s] that the measurements are believed to have
until there are enough of them to tell."""
LEAST_NOISE = np.array((1e-4, 1e-4, 3e-5, 3e-5, 3e-5, 3e-5))
"""Lower bounds of the standard deviations that are found, in the same order and units."""
NOISE_MEMORY = 5.0  # [s] over which the noise is averaged


@dataclass(frozen=True)
class Tuning:
    """How much is believed to change, as standard deviations.

    With the reference speed U, speeds are in units of U and loads in units of the drag d11 U, d22 U, d33 U / (1 m).
    What drifts like a random walk has its deviation after one second.
    """

    acceleration: float = 0.006  # drift of u, v that nothing else explains; that of r is in [rad/s]
    current: float = 0.005  # drift
    gust: float = 0.012  # [1/s] of the current's rate
    surge_bias: float = 0.2  # drift of the slowly varying load
    sway_bias: float = 0.1
    yaw_bias: float = 0.15
    surge_waves: float = 0.15  # of the wave load
    sway_waves: float = 0.4
    yaw_waves: float = 0.12

    def __post_init__(self) -> None:
        for field in fields(self):
            check_number(f"tuning {field.name}", getattr(self, field.name), 0, 1e6)


HULL_DRIFT = 1e-5  # of position [m] and heading [rad] that no velocity explains, after one second
FORCE_DRIFT = 1e-3  # of the actuators' forces, as a share of their limits, after one second
LAG_DRIFT = 0.01  # [s] of the actuators' lag after one second
FIRST_POSE = 0.1  # deviation of position [m] and heading [rad] before the first measurement
FIRST_TURN = 0.05  # [rad/s] deviation of the yaw rate before the first measurement
FIRST_LAG = 0.2  # [s] lag that is expected before the first measurement, and the deviation from that
FIRST_SURGE = 1.0  # deviation of the surge velocity before the first measurement over the reference's speed
FIRST_SWAY = 0.3  # deviation of the sway velocity before the first measurement over the reference's speed
FIRST_CURRENT = 0.3  # deviation of the current on each axis before the first measurement over the reference's speed
FIRST_BIAS = 0.2  # deviation of the slowly varying load before the first measurement, in the units of `Tuning`


class ExtendedKalmanFilter:
    """The filter, for N vehicles at once.

    Its memory: the number of updates, (N,); the state, (N, SIZE); its covariance, (N, SIZE, SIZE); the reference's
    velocity and acceleration in the world, (N, 4); the last three measurements, carried along with the motion foreseen
    since, (N, 3, SENSORS); the variances of the measurements, (N, SENSORS).
    """

    MEMORY = 6
    """How many arrays its memory has; a controller that remembers more keeps that behind them."""
    COUNT = 0
    """Which of them is the number of updates."""

    def __init__(self, vehicle: Vehicle = PAPER_VEHICLE, tuning: Tuning | None = None) -> None:
        """Make the filter for a vehicle as it is known."""
        self.vehicle, self.tuning = vehicle, tuning or Tuning()
        self._drag = np.array((vehicle.d11, vehicle.d22, vehicle.d33))

    def start(self, n: int) -> Memory:
        """Return the memory at the start of n episodes."""
        noise = np.tile(FIRST_NOISE**2, (n, 1))
        state, covariance = np.zeros((n, SIZE)), np.zeros((n, SIZE, SIZE))
        return np.zeros(n), state, covariance, np.zeros((n, 4)), np.zeros((n, 3, SENSORS)), noise

    def update(self, memory: Memory, o: Observation, motion: Motion) -> tuple[Memory, Estimate]:
        """Return the memory and the state after one more observation.

        Args:
            memory: as `start` or the last call returned it.
            o: the observation in SI units, fields of shape (N,).
            motion: of the reference at this instant, see `reference_motion`.
        """
        count, state, P, moving, past, noise = memory
        measured = _measured(o, motion)
        before = Estimate(*state.T)
        z, P = self._predicted(before, P, moving, motion, o)
        past = past + (measurement(z) - measurement(before)).T[:, None]
        if (fresh := count == 0).any():
            first, P_first = self._prior(measured, o)
            z = Estimate(*np.where(fresh, np.array(first), np.array(z)))
            P = np.where(fresh[:, None, None], P_first, P)
        innovation = measured - measurement(z)
        innovation[AT.psi] = wrap_angle(innovation[AT.psi], ARRAYS)
        measured[AT.psi] = z.psi + innovation[AT.psi]  # continuous, for the differences
        noise = _noise(measured.T, past, noise, count, o.dt)
        z, P = _corrected(z, P, innovation, noise)
        past = np.concatenate((measured.T[:, None], past[:, :2]), axis=1)
        moving = np.array((motion.v_x, motion.v_y, motion.a_x, motion.a_y)).T
        return (count + 1, np.array(z).T, P, moving, past, noise), z

    def _predicted(
        self, z: Estimate, P: Array, moving: Array, motion: Motion, o: Observation
    ) -> tuple[Estimate, Array]:
        """Return state and covariance as foreseen from the last ones; the command is in the observation."""
        command = o.a_u * o.F_u_max, o.a_r * o.F_r_max
        z = z._replace(lag=np.maximum(z.lag, SHORTEST_LAG))  # not zero, where an episode begins
        v_x, v_y, a_x, a_y = moving.T
        half, twelfth = 0.5 * o.dt, o.dt**2 / 12  # Hermite's formula, of fourth order
        reference_step = (
            half * (v_x + motion.v_x) + twelfth * (a_x - motion.a_x),
            half * (v_y + motion.v_y) + twelfth * (a_y - motion.a_y),
        )
        A = wave_transition(o.dt)
        F = transition_jacobian(z, command, o.dt, A, self.vehicle)
        P = F @ P @ F.transpose(0, 2, 1) + self._excitation(o, A)
        return transition(z, command, reference_step, o.dt, A, self.vehicle), P

    def _units(self, o: Observation) -> tuple[Array, Array, Array]:
        """Return the units of `Tuning`: speeds (N, 1), loads (N, 3); and the actuators' limits (N, 2)."""
        speed = np.maximum(np.hypot(o.u_R, o.v_R), SPEED_FLOOR)[:, None]  # hypot: recorded rows repeat to the bit
        return speed, self._drag * speed, np.array((o.F_u_max, o.F_r_max)).T

    def _excitation(self, o: Observation, A: Array) -> Array:
        """Return the covariance that one control period adds, shape (N, SIZE, SIZE)."""
        tuning = self.tuning
        speed, drag, limits = self._units(o)
        drift = np.full((len(speed), SIZE), HULL_DRIFT)
        drift[:, [AT.u, AT.v]], drift[:, AT.r] = tuning.acceleration * speed, tuning.acceleration
        drift[:, FORCE] = FORCE_DRIFT * limits
        drift[:, CURRENT] = tuning.current * speed
        drift[:, GUST] = tuning.gust * speed * np.sqrt(2 / GUST_MEMORY)
        drift[:, BIAS] = drag * (tuning.surge_bias, tuning.sway_bias, tuning.yaw_bias)
        drift[:, AT.lag] = LAG_DRIFT
        Q: Array = (drift**2 * o.dt[:, None])[:, :, None] * np.eye(SIZE)
        A = np.moveaxis(A, -1, 0)
        fresh = np.eye(2) - A @ A.transpose(0, 2, 1)
        for pair, share, unit in zip(WAVE_PAIRS, self._waves, drag.T, strict=True):
            Q[:, pair, pair] = ((share * unit) ** 2)[:, None, None] * fresh
        return Q

    @property
    def _waves(self) -> tuple[float, float, float]:
        return self.tuning.surge_waves, self.tuning.sway_waves, self.tuning.yaw_waves

    def _prior(self, measured: Array, o: Observation) -> tuple[Estimate, Array]:
        """Return state and covariance before the first measurement: centred on it, but wide."""
        speed, drag, limits = self._units(o)
        z = np.zeros((SIZE, len(speed)))
        z[HULL], z[AT.lag] = measured, FIRST_LAG
        deviation = np.zeros((len(speed), SIZE))
        deviation[:, [AT.x_e, AT.y_e, AT.psi]], deviation[:, AT.r] = FIRST_POSE, FIRST_TURN
        deviation[:, [AT.u, AT.v]] = speed * (FIRST_SURGE, FIRST_SWAY)
        deviation[:, FORCE] = FORCE_DRIFT * limits
        deviation[:, CURRENT], deviation[:, GUST] = FIRST_CURRENT * speed, self.tuning.gust * speed
        deviation[:, BIAS], deviation[:, AT.lag] = FIRST_BIAS * drag, FIRST_LAG
        deviation[:, WAVES] = np.repeat(self._waves * drag, 2, axis=1)
        P: Array = (deviation**2)[:, :, None] * np.eye(SIZE)
        return Estimate(*z), P


def _measured(o: Observation, motion: Motion) -> Array:
    """Return the measurements x_e, y_e in the world, psi, u and v over ground, r; shape (SENSORS, N)."""
    x_e, y_e = to_world(o.e_x, o.e_y, o.cos_psi, o.sin_psi)
    return np.array((x_e, y_e, motion.psi + o.psi_e, o.u_R + o.u_e, o.v_R + o.v_e, o.r_R + o.r_e))


def _noise(measured: Array, past: Array, noise: Array, count: Array, dt: Array) -> Array:
    """Return the variances of the measurements, shape (N, SENSORS), with one more of them.

    The third difference of white noise has 20 times its variance, and hardly any motion is left in it: `past` holds the
    last three measurements plus what the model foresaw of the motion since.
    """
    last, second, third = past.transpose(1, 0, 2)
    square = (measured - 3 * last + 3 * second - third) ** 2 / 20
    for pair in ((AT.x_e, AT.y_e), (AT.u, AT.v)):  # alike on both axes
        square[:, pair] = square[:, pair].mean(axis=1, keepdims=True)
    weight = np.where(count < 3, 0.0, np.maximum(dt / NOISE_MEMORY, 1 / np.maximum(count, 1)))[:, None]
    return np.asarray(np.maximum(noise + np.minimum(weight, 1.0) * (square - noise), LEAST_NOISE**2))


def _corrected(z: Estimate, P: Array, innovation: Array, noise: Array) -> tuple[Estimate, Array]:
    """Return state and covariance after a measurement.

    The covariance is made symmetric each time: the unstable sway-yaw motion amplifies what round-off leaves.
    """
    H = measurement_jacobian(z)
    HP = H @ P
    S = HP @ H.transpose(0, 2, 1) + noise[:, :, None] * np.eye(SENSORS)
    gain = np.linalg.solve(S, HP).transpose(0, 2, 1)  # (N, SIZE, SENSORS)
    P = P - gain @ HP
    z = Estimate(*(np.array(z) + np.einsum("nij,jn->in", gain, innovation)))
    return z._replace(lag=np.clip(z.lag, SHORTEST_LAG, LONGEST_LAG)), 0.5 * (P + P.transpose(0, 2, 1))

"""An extended Kalman filter for the vehicle, its actuators and the sea, fed with nothing but the observation.

What it believes is in `ekf_model`. How noisy the sensors are it finds out as it runs. It knows no control law: `start`
and then `update` with each observation give an `Estimate` for a law, an optimiser or a trained policy to act on.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np

from auv_gym.errors import to_world
from auv_gym.intervals import check_number
from auv_gym.namespaces import ARRAYS, wrap_angle
from auv_gym.task import Observation
from auv_gym.vehicle import PAPER_VEHICLE, Vehicle
from baselines.estimation.sea_model import (
    BIAS,
    CURRENT,
    FORCE,
    GUST,
    GUST_MEMORY,
    LAG,
    LONGEST_LAG,
    SENSORS,
    SHORTEST_LAG,
    SIZE,
    WAVES,
    Estimate,
    measurement,
    measurement_jacobian,
    transition,
    transition_jacobian,
    wave_transition,
)
from baselines.estimation.water_frame import Motion, reference_motion
from baselines.policy import SPEED_FLOOR, Array, Memory

FIRST_NOISE = np.array((0.05, 0.05, 0.015, 0.02, 0.02, 0.005))
"""Standard deviations that the measurements are believed to have before the third difference exists, SI units."""
LEAST_NOISE = np.array((1e-4, 1e-4, 3e-5, 3e-5, 3e-5, 3e-5))
"""The least that they are ever believed to have."""
NOISE_MEMORY = 5.0
"""Time [s] over which the noise is averaged."""


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


HULL_DRIFT, FORCE_DRIFT, LAG_DRIFT = 1e-5, 1e-3, 0.01
"""Drift of position [m] and heading [rad]; of the actuators' forces, as a share of their limits; of the lag [s]."""
FIRST_POSE, FIRST_TURN, FIRST_LAG = 0.1, 0.05, 0.2
"""Deviations before the first measurement: of position [m] and heading [rad]; of the yaw rate [rad/s]; of the lag [s],
whose expectation is the same."""
FIRST_SURGE, FIRST_SWAY, FIRST_CURRENT, FIRST_BIAS = 1.0, 0.3, 0.3, 0.2
"""Those of velocities, current and slowly varying load, in the units of `Tuning`."""


class Foresight(NamedTuple):
    """How well a measurement was foreseen."""

    innovation: Array  # measured less foreseen, shape (N, SENSORS)
    covariance: Array  # that it is believed to have, shape (N, SENSORS, SENSORS)


class ExtendedKalmanFilter:
    """The filter, for N vehicles at once.

    Its memory: the number of updates, (N,); the state, (N, SIZE); its covariance, (N, SIZE, SIZE); the reference's
    velocity and acceleration in the world, (N, 4); the last three measurements, carried along with the motion foreseen
    since, (N, 3, SENSORS); the variances of the measurements, (N, SENSORS).
    """

    MEMORY = 6
    """Arrays of its memory, for whoever keeps more behind it."""

    def __init__(self, vehicle: Vehicle = PAPER_VEHICLE, tuning: Tuning | None = None) -> None:
        """Make the filter for a vehicle as it is known."""
        self.vehicle, self.tuning = vehicle, tuning or Tuning()
        self._drag = np.array((vehicle.d11, vehicle.d22, vehicle.d33))

    def start(self, n: int) -> Memory:
        """Return the memory at the start of n episodes."""
        noise = np.tile(FIRST_NOISE**2, (n, 1))
        state, covariance = np.zeros((n, SIZE)), np.zeros((n, SIZE, SIZE))
        return np.zeros(n), state, covariance, np.zeros((n, 4)), np.zeros((n, 3, SENSORS)), noise

    def update(self, memory: Memory, o: Observation) -> tuple[Memory, Estimate]:
        """Return the memory and the state after one more observation; see `update_and_judge`."""
        memory, z, _ = self.update_and_judge(memory, o)
        return memory, z

    def update_and_judge(self, memory: Memory, o: Observation) -> tuple[Memory, Estimate, Foresight]:
        """Return the memory and the state after one more observation, and how well it was foreseen.

        Args:
            memory: as `start` or the last call returned it.
            o: the observation in SI units, fields of shape (N,).
        """
        count, state, P, moving, past, noise = memory
        motion = reference_motion(o, self.vehicle)
        measured = _measured(o, motion)
        before = Estimate(*state.T)
        z, P = self._predicted(before, P, moving, motion, o)
        past = past + (measurement(z) - measurement(before)).T[:, None]
        if (fresh := count == 0).any():
            first, P_first = self._prior(measured, o)
            z = Estimate(*np.where(fresh, np.array(first), np.array(z)))
            P = np.where(fresh[:, None, None], P_first, P)
        innovation = measured - measurement(z)
        innovation[2] = wrap_angle(innovation[2], ARRAYS)
        measured[2] = z.psi + innovation[2]  # continuous, for the differences
        noise = _noise(measured.T, past, noise, count, o.dt)
        z, P, S = _corrected(z, P, innovation, noise)
        past = np.concatenate((measured.T[:, None], past[:, :2]), axis=1)
        memory = count + 1, np.array(z).T, P, np.array(motion[1:]).T, past, noise
        return memory, z, Foresight(innovation.T, S)

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
        F = transition_jacobian(z, command, o.dt, self.vehicle)
        P = F @ P @ F.transpose(0, 2, 1) + self._excitation(o)
        return transition(z, command, reference_step, o.dt, self.vehicle), P

    def _units(self, o: Observation) -> tuple[Array, Array, Array]:
        """Return the units of `Tuning`: speeds (N, 1), loads (N, 3); and the actuators' limits (N, 2)."""
        speed = np.maximum(np.hypot(o.u_R, o.v_R), SPEED_FLOOR)[:, None]  # hypot: recorded rows repeat to the bit
        return speed, self._drag * speed, np.array((o.F_u_max, o.F_r_max)).T

    def _excitation(self, o: Observation) -> Array:
        """Return the covariance that one control period adds, shape (N, SIZE, SIZE)."""
        tuning = self.tuning
        speed, drag, limits = self._units(o)
        drift = np.full((len(speed), SIZE), HULL_DRIFT)
        drift[:, 3:5], drift[:, 5] = tuning.acceleration * speed, tuning.acceleration
        drift[:, FORCE] = FORCE_DRIFT * limits
        drift[:, CURRENT] = tuning.current * speed
        drift[:, GUST] = tuning.gust * speed * np.sqrt(2 / GUST_MEMORY)
        drift[:, BIAS] = drag * (tuning.surge_bias, tuning.sway_bias, tuning.yaw_bias)
        drift[:, LAG] = LAG_DRIFT
        Q: Array = (drift**2 * o.dt[:, None])[:, :, None] * np.eye(SIZE)
        A = np.moveaxis(wave_transition(o.dt), -1, 0)
        fresh = np.eye(2) - A @ A.transpose(0, 2, 1)
        for axis, share in enumerate(self._waves):
            pair = slice(WAVES.start + 2 * axis, WAVES.start + 2 * axis + 2)
            Q[:, pair, pair] = ((share * drag[:, axis]) ** 2)[:, None, None] * fresh
        return Q

    @property
    def _waves(self) -> tuple[float, float, float]:
        return self.tuning.surge_waves, self.tuning.sway_waves, self.tuning.yaw_waves

    def _prior(self, measured: Array, o: Observation) -> tuple[Estimate, Array]:
        """Return state and covariance before the first measurement: centred on it, but wide."""
        speed, drag, limits = self._units(o)
        z = np.zeros((SIZE, len(speed)))
        z[:SENSORS], z[LAG] = measured, FIRST_LAG
        deviation = np.zeros((len(speed), SIZE))
        deviation[:, :3], deviation[:, 5] = FIRST_POSE, FIRST_TURN
        deviation[:, 3:4], deviation[:, 4:5] = FIRST_SURGE * speed, FIRST_SWAY * speed
        deviation[:, FORCE] = FORCE_DRIFT * limits
        deviation[:, CURRENT], deviation[:, GUST] = FIRST_CURRENT * speed, self.tuning.gust * speed
        deviation[:, BIAS], deviation[:, LAG] = FIRST_BIAS * drag, FIRST_LAG
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
    square = (measured - 3 * past[:, 0] + 3 * past[:, 1] - past[:, 2]) ** 2 / 20
    for pair in ((0, 1), (3, 4)):  # alike on both axes
        square[:, pair] = square[:, pair].mean(axis=1, keepdims=True)
    weight = np.where(count < 3, 0.0, np.maximum(dt / NOISE_MEMORY, 1 / np.maximum(count, 1)))[:, None]
    return np.asarray(np.maximum(noise + np.minimum(weight, 1.0) * (square - noise), LEAST_NOISE**2))


def _corrected(z: Estimate, P: Array, innovation: Array, noise: Array) -> tuple[Estimate, Array, Array]:
    """Return state, covariance and the innovation's covariance after a measurement.

    The covariance is made symmetric each time: the unstable sway-yaw motion amplifies what round-off leaves.
    """
    H = measurement_jacobian(z)
    HP = H @ P
    S = HP @ H.transpose(0, 2, 1) + noise[:, :, None] * np.eye(SENSORS)
    gain = np.linalg.solve(S, HP).transpose(0, 2, 1)  # (N, SIZE, SENSORS)
    P = P - gain @ HP
    z = Estimate(*(np.array(z) + np.einsum("nij,jn->in", gain, innovation)))
    return z._replace(lag=np.clip(z.lag, SHORTEST_LAG, LONGEST_LAG)), 0.5 * (P + P.transpose(0, 2, 1)), S

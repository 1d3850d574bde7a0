"""The equations of the extended Kalman filter, on symbols: foreseen by the model, corrected by the measurements.

The derivatives are those that the graph has of the model itself. The measurements are taken up one after the other, as
their errors are independent: the same as all at once, without a system of equations to solve. Of the covariance the
lower triangle is computed and nothing else, so that it is always symmetric.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

from auv_gym.codegen.derivatives import jacobian
from auv_gym.codegen.graph import SYMBOLS
from auv_gym.codegen.matrices import congruence, diagonal, dot, symmetric, triangle
from auv_gym.errors import to_world
from auv_gym.namespaces import Number, wrap_angle
from auv_gym.task import Observation
from auv_gym.vehicle import Coefficients
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
    mean_load,
    measurement,
    transition,
    wave_transition,
)
from baselines.estimation.water_frame import Motion, reference_motion
from baselines.policy import SPEED_FLOOR

FIRST_NOISE = (0.05, 0.05, 0.015, 0.02, 0.02, 0.005)
"""Standard deviations of x_e, y_e [m], psi [rad], u, v [m/s], r [rad/s] that the measurements are believed to have
until there are enough of them to tell."""
LEAST_NOISE = (1e-4, 1e-4, 3e-5, 3e-5, 3e-5, 3e-5)
"""Lower bounds of the standard deviations that are found, in the same order and units."""
NOISE_MEMORY = 5.0  # [s] over which the noise is averaged
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

Matrix = Sequence[Sequence[Any]]


class Belief(NamedTuple):
    """What the filter remembers, as rows."""

    count: Any  # of the updates so far, 1 row
    state: Any  # an `Estimate`
    covariance: Any  # of the state, the lower triangle row by row
    motion: Any  # velocity [m/s] and acceleration [m/s^2] of the reference in the world, 4 rows
    past: Any  # the last three measurements, carried along with the motion foreseen since
    noise: Any  # variances of the measurements

    @classmethod
    def of(cls, rows: Any) -> Belief:
        """Return the parts of a filter's memory; `rows` are a sequence, or an array whose first axis counts them."""
        return cls(*(rows[part] for part in _PARTS))


BELIEF = Belief(1, SIZE, SIZE * (SIZE + 1) // 2, 4, 3 * SENSORS, SENSORS)
"""How many rows each part has."""
BELIEF_ROWS = sum(BELIEF)
"""How many rows all of them have."""
_PARTS = [slice(sum(BELIEF[:i]), sum(BELIEF[: i + 1])) for i in range(len(BELIEF))]


class Units(NamedTuple):
    """What deviations are measured in."""

    speed: Number  # [m/s]
    drag: Sequence[Number]  # of loads [N], [N], [N m]
    limits: Sequence[Number]  # of the actuators [N], [N m]

    @classmethod
    def of(cls, o: Observation, coefficients: Coefficients) -> Units:
        """Return the units at a reference's speed."""
        speed = SYMBOLS.clip(SYMBOLS.hypot(o.u_R, o.v_R), SPEED_FLOOR, math.inf)
        drag = [d * speed for d in (coefficients.d11, coefficients.d22, coefficients.d33)]
        return cls(speed, drag, (o.F_u_max, o.F_r_max))


def updated(o: Observation, coefficients: Coefficients, tuning: Any, memory: Belief) -> Belief:
    """Return the memory after one more observation.

    Args:
        o: the observation in SI units.
        coefficients: of the vehicle as it is known.
        tuning: the fields of a `kalman.Tuning`, as symbols.
        memory: zeros at the start of an episode but for the noise, or as the last call returned it.
    """
    motion, units, fresh = reference_motion(o, coefficients, SYMBOLS), Units.of(o, coefficients), memory.count[0] <= 0.0
    measured = _measured(o, motion)
    before = Estimate(*memory.state)
    z, P = foreseen(before, symmetric(memory.covariance), _step(memory.motion, motion, o.dt), o, coefficients)
    P = _sum(P, excitation(o.dt, units, tuning))
    moved = [a - b for a, b in zip(measurement(z, SYMBOLS), measurement(before, SYMBOLS), strict=True)]
    past = [x + moved[i % SENSORS] for i, x in enumerate(memory.past)]
    first, deviation = prior(measured, units, tuning)
    z = Estimate(*(SYMBOLS.where(fresh, a, b) for a, b in zip(first, z, strict=True)))
    prior_P = diagonal([d * d for d in deviation])
    P = symmetric([SYMBOLS.where(fresh, a, b) for a, b in zip(triangle(prior_P), triangle(P), strict=True)])
    innovation = [a - b for a, b in zip(measured, measurement(z, SYMBOLS), strict=True)]
    innovation[AT.psi] = wrap_angle(innovation[AT.psi], SYMBOLS)
    measured[AT.psi] = z.psi + innovation[AT.psi]  # continuous, for the differences
    noise = found_noise(measured, past, memory.noise, memory.count[0], o.dt)
    z, P = corrected(z, P, innovation, noise)
    past = [*measured, *past[: 2 * SENSORS]]
    return Belief([memory.count[0] + 1.0], z, triangle(P), motion[1:], past, noise)


def _measured(o: Observation, motion: Motion) -> list[Number]:
    """Return the measurements x_e, y_e in the world, psi, u and v over ground, r."""
    x_e, y_e = to_world(o.e_x, o.e_y, o.cos_psi, o.sin_psi)
    return [x_e, y_e, motion.psi + o.psi_e, o.u_R + o.u_e, o.v_R + o.v_e, o.r_R + o.r_e]


def _step(before: Sequence[Number], motion: Motion, dt: Number) -> tuple[Number, Number]:
    """Return how far the reference has moved since the last update, by Hermite's formula, of fourth order."""
    v_x, v_y, a_x, a_y = before
    half, twelfth = 0.5 * dt, dt * dt / 12
    return (
        half * (v_x + motion.v_x) + twelfth * (a_x - motion.a_x),
        half * (v_y + motion.v_y) + twelfth * (a_y - motion.a_y),
    )


def foreseen(
    z: Estimate, P: Matrix, reference_step: tuple[Number, Number], o: Observation, coefficients: Coefficients
) -> tuple[Estimate, Matrix]:
    """Return state and covariance one control period later, without excitation; the command is in the observation.

    The hull's motion depends on eleven things alone: its covariance goes by way of theirs.
    """
    z = z._replace(lag=SYMBOLS.clip(z.lag, SHORTEST_LAG, math.inf))  # not zero, where an episode begins
    command = o.a_u * o.F_u_max, o.a_r * o.F_r_max
    after = transition(z, command, reference_step, o.dt, coefficients, SYMBOLS)
    load, _ = mean_load(z, command, o.dt, SYMBOLS)
    others = [x for i, x in enumerate(after) if not HULL.start <= i < HULL.stop]
    acting = [*z[HULL], *load, *after[CURRENT]]
    P = congruence(jacobian([*acting, *others], z), P)
    hull = [[*row, *[0.0] * len(others)] for row in jacobian(after[HULL], acting)]
    return after, congruence([*hull, *diagonal([1.0] * len(P))[len(acting) :]], P)


def excitation(dt: Number, units: Units, tuning: Any) -> Matrix:
    """Return the covariance that one control period adds."""
    speed, drag, limits = units
    drift: list[Any] = [HULL_DRIFT] * SIZE
    drift[AT.u] = drift[AT.v] = tuning.acceleration * speed
    drift[AT.r] = tuning.acceleration
    drift[FORCE] = [FORCE_DRIFT * limit for limit in limits]
    drift[CURRENT] = [tuning.current * speed] * 2
    drift[GUST] = [tuning.gust * speed * math.sqrt(2 / GUST_MEMORY)] * 2
    shares = tuning.surge_bias, tuning.sway_bias, tuning.yaw_bias
    drift[BIAS] = [share * unit for share, unit in zip(shares, drag, strict=True)]
    drift[AT.lag] = LAG_DRIFT
    Q = diagonal([d * d * dt for d in drift])
    A = wave_transition(dt, SYMBOLS)
    for pair, deviation in zip(WAVE_PAIRS, _waves(units, tuning), strict=True):
        for i, row in zip(range(pair.start, pair.stop), A, strict=True):
            for j, other in zip(range(pair.start, pair.stop), A, strict=True):
                Q[i][j] = deviation * deviation * (float(i == j) - dot(row, other))
    return Q


def _waves(units: Units, tuning: Any) -> list[Number]:
    """Return the standard deviations of the wave loads."""
    shares = tuning.surge_waves, tuning.sway_waves, tuning.yaw_waves
    return [share * unit for share, unit in zip(shares, units.drag, strict=True)]


def prior(measured: Sequence[Number], units: Units, tuning: Any) -> tuple[Estimate, Sequence[Number]]:
    """Return the state before the first measurement, centred on it, and its standard deviations, which are wide."""
    speed, drag, limits = units
    z: list[Any] = [0.0] * SIZE
    z[HULL], z[AT.lag] = measured, FIRST_LAG
    deviation: list[Any] = [FIRST_POSE] * SIZE
    deviation[AT.u], deviation[AT.v], deviation[AT.r] = FIRST_SURGE * speed, FIRST_SWAY * speed, FIRST_TURN
    deviation[FORCE] = [FORCE_DRIFT * limit for limit in limits]
    deviation[CURRENT], deviation[GUST] = [FIRST_CURRENT * speed] * 2, [tuning.gust * speed] * 2
    deviation[BIAS], deviation[AT.lag] = [FIRST_BIAS * unit for unit in drag], FIRST_LAG
    deviation[WAVES] = [x for wave in _waves(units, tuning) for x in (wave, wave)]
    return Estimate(*z), deviation


def found_noise(
    measured: Sequence[Number], past: Sequence[Number], noise: Sequence[Number], count: Number, dt: Number
) -> list[Number]:
    """Return the variances of the measurements with one more of them.

    The third difference of white noise has 20 times its variance, and hardly any motion is left in it: `past` holds the
    last three measurements plus what the model foresaw of the motion since.
    """
    last, second, third = (past[i * SENSORS : (i + 1) * SENSORS] for i in range(3))
    difference = [a - 3 * b + 3 * c - d for a, b, c, d in zip(measured, last, second, third, strict=True)]
    square = [d * d / 20 for d in difference]
    for i, j in ((AT.x_e, AT.y_e), (AT.u, AT.v)):  # alike on both axes
        square[i] = square[j] = 0.5 * (square[i] + square[j])
    weight = SYMBOLS.clip(1.0 / SYMBOLS.clip(count, 1.0, math.inf), dt / NOISE_MEMORY, math.inf)
    weight = SYMBOLS.where(count < 3.0, 0.0, SYMBOLS.clip(weight, 0.0, 1.0))
    return [
        SYMBOLS.clip(variance + weight * (new - variance), least * least, math.inf)
        for variance, new, least in zip(noise, square, LEAST_NOISE, strict=True)
    ]


def corrected(z: Estimate, P: Matrix, innovation: Sequence[Number], noise: Sequence[Number]) -> tuple[Estimate, Matrix]:
    """Return state and covariance after measurements with independent errors."""
    change: list[Any] = [0.0] * SIZE
    for h, surprise, variance in zip(jacobian(measurement(z, SYMBOLS), z), innovation, noise, strict=True):
        Ph = [dot(h, column) for column in P]
        share = 1.0 / (dot(h, Ph) + variance)
        gain, left = [x * share for x in Ph], surprise - dot(h, change)
        change = [x + k * left for x, k in zip(change, gain, strict=True)]
        P = symmetric([P[i][j] - gain[i] * Ph[j] for i in range(SIZE) for j in range(i + 1)])
    z = Estimate(*(x + d for x, d in zip(z, change, strict=True)))
    return z._replace(lag=SYMBOLS.clip(z.lag, SHORTEST_LAG, LONGEST_LAG)), P


def _sum(A: Matrix, B: Matrix) -> Matrix:
    return [[a + b for a, b in zip(*rows, strict=True)] for rows in zip(A, B, strict=True)]

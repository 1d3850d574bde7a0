"""Equations of the extended Kalman filter on symbols: prediction by the model, correction by the measurements.

The Jacobians are derived symbolically from the model. The state is an `Estimate`, followed by `Faults` in a filter that
estimates faults. The measurement errors are independent, so the measurements are processed one after the other. The
result is the same as that of one joint update, and no system of equations must be solved. Only the lower triangle of
the covariance is computed, so it is always symmetric.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

from auv_gym.codegen.derivatives import jacobian
from auv_gym.codegen.graph import SYMBOLS
from auv_gym.codegen.matrices import congruence, diagonal, dot, symmetric, triangle
from auv_gym.physics.errors import to_world
from auv_gym.physics.namespaces import Number, wrap_angle
from auv_gym.physics.vehicle import Coefficients
from auv_gym.task.observation import Observation
from baselines.estimation.faults import (
    DRIFT,
    FAULTS,
    LATE,
    NO_FAULTS,
    Faults,
    acting_forces,
    biases,
    prior_faults,
    within_bounds,
)
from baselines.estimation.sea_model import (
    BIAS,
    CURRENT_STATES,
    FORCE,
    GUST,
    GUST_MEMORY,
    LONGEST_LAG,
    MOTION_STATES,
    PLACE,
    SENSORS,
    SHORTEST_LAG,
    STATE_SIZE,
    WAVE_PAIRS,
    WAVES,
    Estimate,
    mean_load,
    measurement,
    transition,
    wave_transition,
)
from baselines.estimation.water_frame import ReferenceMotion, reference_motion
from baselines.policy import SPEED_FLOOR

FIRST_NOISE = (0.05, 0.05, 0.015, 0.02, 0.02, 0.005)
"""Initial standard deviations of the measurements x_e, y_e [m], psi [rad], u, v [m/s], r [rad/s]. They are used until
there are enough measurements to estimate them."""
LEAST_NOISE = (1e-4, 1e-4, 3e-5, 3e-5, 3e-5, 3e-5)
"""Lower bounds of the estimated standard deviations, in the same order and units."""
FINE_NOISE = tuple(0.4 * deviation for deviation in FIRST_NOISE)
"""Standard deviations, in the same order and units, below which a measurement has less weight in the choice between the
filters for rough and for calm water. With precise sensors the filter for rough water is accurate in calm water too."""
NOISE_MEMORY = 5.0  # [s] averaging time of the noise variances
POSE_DRIFT = 1e-5  # process noise of position [m] and heading [rad] after one second
FORCE_DRIFT = 1e-3  # process noise of the actuators' forces after one second, as a share of their limits
LAG_DRIFT = 0.01  # [s] process noise of the actuators' time constant after one second

# Standard deviations of the state before the first measurement:
FIRST_POSE = 0.1  # position [m] and heading [rad]
FIRST_TURN = 0.05  # [rad/s] yaw rate
FIRST_LAG = 0.2  # [s] time constant of the actuators; its first estimate as well
FIRST_SURGE = 1.0  # surge velocity over the reference's speed
FIRST_SWAY = 0.3  # sway velocity over the reference's speed
FIRST_CURRENT = 0.3  # current on each axis over the reference's speed
FIRST_BIAS = 0.2  # slowly varying load, in the units of `Tuning`

_LEAST_MOTION = 1e-4  # [m] smaller changes of a measured position in a period mean that there was no new fix
FIT_MEMORY = 20.0  # [s] averaging time of the log-likelihood

_Matrix = Sequence[Sequence[Any]]


class Belief(NamedTuple):
    """Memory of a filter, as rows."""

    count: Any  # number of updates so far, 1 row
    state: Any  # an `Estimate`, then `Faults` if the filter estimates them
    covariance: Any  # lower triangle of the state's covariance, row by row
    motion: Any  # velocity [m/s] and acceleration [m/s^2] of the reference in the world, 4 rows
    fix: Any  # last measured x_e, y_e [m]
    past: Any  # last three measurements, each plus the motion that the model has predicted since then
    noise: Any  # variances of the measurements
    fit: Any  # log-likelihood of the measurements, with exponential forgetting, 1 row
    actions: Any  # actions before the last one, surge and yaw of each, the latest first

    @classmethod
    def of(cls, rows: Any, faults: bool = False) -> Belief:
        """Return the parts of a filter's memory.

        Args:
            rows: a sequence, or an array whose first axis is that of the rows.
            faults: whether the filter estimates faults.
        """
        sizes = cls.sizes(faults)
        return cls(*(rows[sum(sizes[:i]) : sum(sizes[: i + 1])] for i in range(len(sizes))))

    @staticmethod
    def sizes(faults: bool = False) -> Belief:
        """Return the number of rows of each part."""
        size = STATE_SIZE + FAULTS * faults
        return Belief(1, size, size * (size + 1) // 2, 4, 2, 3 * SENSORS, SENSORS, 1, 2 * LATE * faults)


class FilterUnits(NamedTuple):
    """Units of the tuning's standard deviations."""

    speed: Number  # [m/s]
    drag: Sequence[Number]  # [N], [N], [N m] for loads in surge, sway and yaw
    limits: Sequence[Number]  # [N], [N m] limits of the actuators

    @classmethod
    def of(cls, o: Observation, coefficients: Coefficients) -> FilterUnits:
        """Return the units at the speed of the reference."""
        speed = SYMBOLS.clip(SYMBOLS.hypot(o.u_R, o.v_R), SPEED_FLOOR, math.inf)
        drag = [d * speed for d in (coefficients.d11, coefficients.d22, coefficients.d33)]
        return cls(speed, drag, (o.F_u_max, o.F_r_max))


def updated(o: Observation, coefficients: Coefficients, tuning: Any, memory: Belief) -> Belief:
    """Return the memory after one more observation.

    Args:
        o: the observation in SI units.
        coefficients: of the nominal vehicle.
        tuning: has the fields of a `kalman.Tuning`, or of a `kalman.FaultTuning` if faults are estimated, as symbols.
        memory: as the last call returned it. At the start of an episode all rows are zero, except for the noise.
    """
    motion, units, first = (
        reference_motion(o, coefficients, SYMBOLS),
        FilterUnits.of(o, coefficients),
        memory.count[0] <= 0.0,
    )
    measured, step = _measurements(o, motion), _reference_step(memory.motion, motion, o.dt)
    moved = [a - b + c for a, b, c in zip(measured, memory.fix, step, strict=False)]
    no_fix = ~first & (moved[0] * moved[0] + moved[1] * moved[1] < _LEAST_MOTION * _LEAST_MOTION)
    actions = [(o.a_u, o.a_r), *zip(memory.actions[::2], memory.actions[1::2], strict=True)]
    initial, deviation = prior(measured, units, tuning, len(memory.state) > STATE_SIZE)
    z, P = predicted(memory.state, symmetric(memory.covariance), actions, step, o, coefficients)
    P = _sum(P, excitation(o.dt, units, tuning, len(z)))
    change = [a - b for a, b in zip(expected_measurements(z), expected_measurements(memory.state), strict=True)]
    past = [x + change[i % SENSORS] for i, x in enumerate(memory.past)]
    z = [SYMBOLS.where(first, a, b) for a, b in zip(initial, z, strict=True)]
    initial_P = diagonal([d * d for d in deviation])
    P = symmetric([SYMBOLS.where(first, a, b) for a, b in zip(triangle(initial_P), triangle(P), strict=True)])
    expected = expected_measurements(z)
    fix = measured[:2]
    measured = [*(SYMBOLS.where(no_fix, a, b) for a, b in zip(expected[:2], fix, strict=True)), *measured[2:]]
    innovation = [a - b for a, b in zip(measured, expected, strict=True)]
    innovation[PLACE.psi] = wrap_angle(innovation[PLACE.psi], SYMBOLS)
    measured[PLACE.psi] = expected[PLACE.psi] + innovation[PLACE.psi]  # continuous, for the differences
    noise = _noise_variances(measured, past, memory.noise, memory.count[0], o.dt, no_fix)
    z, P, fits = measured_update(z, P, innovation, noise, no_fix)
    fit = SYMBOLS.where(first, 0.0, SYMBOLS.exp(-o.dt / FIT_MEMORY) * memory.fit[0] + fits)
    past = [*measured, *past[: 2 * SENSORS]]
    later = [a for pair in actions[:LATE] for a in pair] if memory.actions else []
    return Belief([memory.count[0] + 1.0], z, triangle(P), motion[1:], fix, past, noise, [fit], later)


def split(z: Sequence[Any]) -> tuple[Estimate, Faults]:
    """Return the two parts of a filter's state; `NO_FAULTS` if the filter does not estimate faults."""
    return Estimate(*z[:STATE_SIZE]), Faults(*z[STATE_SIZE:]) if len(z) > STATE_SIZE else NO_FAULTS


def expected_measurements(z: Sequence[Any]) -> list[Any]:
    """Return the measurements that a filter's state predicts, including the sensor biases."""
    estimate, faults = split(z)
    return [a + b for a, b in zip(measurement(estimate, SYMBOLS), biases(faults), strict=True)]


def _measurements(o: Observation, motion: ReferenceMotion) -> list[Number]:
    """Return the measurements x_e, y_e in the world, psi, u and v over ground, r."""
    x_e, y_e = to_world(o.e_x, o.e_y, o.cos_psi, o.sin_psi)
    return [x_e, y_e, motion.psi + o.psi_e, o.u_R + o.u_e, o.v_R + o.v_e, o.r_R + o.r_e]


def _reference_step(before: Sequence[Number], motion: ReferenceMotion, dt: Number) -> tuple[Number, Number]:
    """Return the displacement of the reference since the last update, by Hermite's quadrature of fourth order."""
    v_x, v_y, a_x, a_y = before
    half, twelfth = 0.5 * dt, dt * dt / 12
    return (
        half * (v_x + motion.v_x) + twelfth * (a_x - motion.a_x),
        half * (v_y + motion.v_y) + twelfth * (a_y - motion.a_y),
    )


def predicted(
    z: Sequence[Any],
    P: _Matrix,
    actions: Sequence[Sequence[Number]],
    reference_step: tuple[Number, Number],
    o: Observation,
    coefficients: Coefficients,
) -> tuple[Sequence[Any], _Matrix]:
    """Return state and covariance one control period later, without excitation.

    The motion states depend on eleven variables only. The covariance is first propagated to these variables and then
    to the motion states, which needs fewer operations.

    Args:
        z: the state.
        P: its covariance.
        actions: the last actions, the latest first; used only if the filter estimates faults.
        reference_step: displacement of the reference in the world during the period [m].
        o: the observation at the end of the period.
        coefficients: of the nominal vehicle.
    """
    estimate, faults = split(z)
    estimate = estimate._replace(lag=SYMBOLS.clip(estimate.lag, SHORTEST_LAG, math.inf))  # it is zero at the start
    fault_rows = [*z[STATE_SIZE:]]
    command = (o.a_u * o.F_u_max, o.a_r * o.F_r_max)
    if fault_rows:
        command = acting_forces(faults, actions, (o.F_u_max, o.F_r_max), SYMBOLS)
    after = transition(estimate, command, reference_step, o.dt, coefficients, SYMBOLS)
    load, _ = mean_load(estimate, command, o.dt, coefficients, SYMBOLS)
    others = [*(x for i, x in enumerate(after) if not MOTION_STATES.start <= i < MOTION_STATES.stop), *fault_rows]
    inputs = [*estimate[MOTION_STATES], *load, *after[CURRENT_STATES]]  # of the equations of motion
    P = congruence(jacobian([*inputs, *others], [*estimate, *fault_rows]), P)
    motion = [[*row, *[0.0] * len(others)] for row in jacobian(after[MOTION_STATES], inputs)]
    return [*after, *fault_rows], congruence([*motion, *diagonal([1.0] * len(P))[len(inputs) :]], P)


def excitation(dt: Number, units: FilterUnits, tuning: Any, size: int = STATE_SIZE) -> _Matrix:
    """Return the covariance of the process noise in one control period, shape (size, size)."""
    speed, drag, limits = units
    drift: list[Any] = [POSE_DRIFT] * STATE_SIZE
    drift[PLACE.u] = drift[PLACE.v] = tuning.acceleration * speed
    drift[PLACE.r] = tuning.acceleration
    drift[FORCE] = [FORCE_DRIFT * limit for limit in limits]
    drift[CURRENT_STATES] = [tuning.current * speed] * 2
    drift[GUST] = [tuning.gust * speed * math.sqrt(2 / GUST_MEMORY)] * 2
    shares = tuning.surge_bias, tuning.sway_bias, tuning.yaw_bias
    drift[BIAS] = [share * unit for share, unit in zip(shares, drag, strict=True)]
    drift[PLACE.lag] = LAG_DRIFT
    drift = [*drift, *DRIFT][:size]
    Q = diagonal([d * d * dt for d in drift])
    A = wave_transition(dt, SYMBOLS)
    for pair, deviation in zip(WAVE_PAIRS, _waves(units, tuning), strict=True):
        for i, row in zip(range(pair.start, pair.stop), A, strict=True):
            for j, other in zip(range(pair.start, pair.stop), A, strict=True):
                Q[i][j] = deviation * deviation * (float(i == j) - dot(row, other))
    return Q


def _waves(units: FilterUnits, tuning: Any) -> list[Number]:
    """Return the standard deviations of the wave loads."""
    shares = tuning.surge_waves, tuning.sway_waves, tuning.yaw_waves
    return [share * unit for share, unit in zip(shares, units.drag, strict=True)]


def prior(
    measured: Sequence[Number], units: FilterUnits, tuning: Any, faults: bool
) -> tuple[Sequence[Any], Sequence[Number]]:
    """Return the initial state, whose motion states are the first measurements, and its standard deviations."""
    speed, drag, limits = units
    z: list[Any] = [0.0] * STATE_SIZE
    z[MOTION_STATES], z[PLACE.lag] = measured, FIRST_LAG
    deviation: list[Any] = [FIRST_POSE] * STATE_SIZE
    deviation[PLACE.u], deviation[PLACE.v], deviation[PLACE.r] = FIRST_SURGE * speed, FIRST_SWAY * speed, FIRST_TURN
    deviation[FORCE] = [FORCE_DRIFT * limit for limit in limits]
    deviation[CURRENT_STATES], deviation[GUST] = [FIRST_CURRENT * speed] * 2, [tuning.gust * speed] * 2
    deviation[BIAS], deviation[PLACE.lag] = [FIRST_BIAS * unit for unit in drag], FIRST_LAG
    deviation[WAVES] = [x for wave in _waves(units, tuning) for x in (wave, wave)]
    if not faults:
        return z, deviation
    fault_mean, fault_deviation = prior_faults(tuning)
    return [*z, *fault_mean], [*deviation, *fault_deviation]


def _noise_variances(
    measured: Sequence[Number],
    past: Sequence[Number],
    noise: Sequence[Number],
    count: Number,
    dt: Number,
    no_fix: Any,
) -> list[Number]:
    """Return the variances of the measurement noise, updated with one more measurement.

    The third difference of white noise has 20 times its variance. The motion hardly contributes to it, as the
    measurements in `past` include the motion that the model has predicted since then. Without a new fix (`no_fix`) the
    variance of the position stays unchanged.
    """
    last, second, third = (past[i * SENSORS : (i + 1) * SENSORS] for i in range(3))
    difference = [a - 3 * b + 3 * c - d for a, b, c, d in zip(measured, last, second, third, strict=True)]
    square = [d * d / 20 for d in difference]
    for i, j in ((PLACE.x_e, PLACE.y_e), (PLACE.u, PLACE.v)):  # the same variance on both axes
        square[i] = square[j] = 0.5 * (square[i] + square[j])
    weight = SYMBOLS.clip(1.0 / SYMBOLS.clip(count, 1.0, math.inf), dt / NOISE_MEMORY, math.inf)
    weight = SYMBOLS.where(count < 3.0, 0.0, SYMBOLS.clip(weight, 0.0, 1.0))
    weights = [SYMBOLS.where(no_fix, 0.0, weight)] * 2 + [weight] * (SENSORS - 2)
    return [
        SYMBOLS.clip(variance + w * (new - variance), least * least, math.inf)
        for variance, new, least, w in zip(noise, square, LEAST_NOISE, weights, strict=True)
    ]


def measured_update(
    z: Sequence[Any], P: _Matrix, innovation: Sequence[Number], noise: Sequence[Number], no_fix: Any
) -> tuple[Sequence[Any], _Matrix, Any]:
    """Return state and covariance after measurements with independent errors, and their weighted log-likelihood.

    Args:
        z: the state.
        P: its covariance.
        innovation: measurements minus expected measurements.
        noise: variances of the measurement noise.
        no_fix: whether there is no new measurement of the position.
    """
    size = len(z)
    change: list[Any] = [0.0] * size
    fit: Any = 0.0
    for i, h in enumerate(jacobian(expected_measurements(z), z)):
        Ph = [dot(h, column) for column in P]
        precision = 1.0 / (dot(h, Ph) + noise[i])  # of the innovation
        residual = innovation[i] - dot(h, change)
        coarseness = (noise[i] / FINE_NOISE[i] ** 2) ** 2
        weight = coarseness / (1.0 + coarseness)
        fits = 0.5 * weight * (SYMBOLS.log(precision) - residual * residual * precision)
        if i < PLACE.psi:
            precision, fits = SYMBOLS.where(no_fix, 0.0, precision), SYMBOLS.where(no_fix, 0.0, fits)
        gain, fit = [x * precision for x in Ph], fit + fits
        change = [x + k * residual for x, k in zip(change, gain, strict=True)]
        P = symmetric([P[i][j] - gain[i] * Ph[j] for i in range(size) for j in range(i + 1)])
    estimate, faults = split([x + d for x, d in zip(z, change, strict=True)])
    estimate = estimate._replace(lag=SYMBOLS.clip(estimate.lag, SHORTEST_LAG, LONGEST_LAG))
    return [*estimate, *(within_bounds(faults, SYMBOLS) if size > STATE_SIZE else ())], P, fit


def _sum(A: _Matrix, B: _Matrix) -> _Matrix:
    return [[a + b for a, b in zip(*rows, strict=True)] for rows in zip(A, B, strict=True)]

"""The equations of the extended Kalman filter, on symbols: foreseen by the model, corrected by the measurements.

The derivatives are those that the graph has of the model itself. The state is an `Estimate`; where sensors and
actuators may be wrong, `Faults` follow it. The measurements are taken up one after the other, as their errors are
independent: the same as all at once, without a system of equations to solve. Of the covariance the lower triangle is
computed and nothing else, so that it is always symmetric.
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
"""Standard deviations of x_e, y_e [m], psi [rad], u, v [m/s], r [rad/s] that the measurements are believed to have
until there are enough of them to tell."""
LEAST_NOISE = (1e-4, 1e-4, 3e-5, 3e-5, 3e-5, 3e-5)
"""Lower bounds of the standard deviations that are found, in the same order and units."""
FINE_NOISE = tuple(0.4 * deviation for deviation in FIRST_NOISE)
"""Standard deviations, in the same order and units, below which noise tells seas apart less and less: with fine sensors
it costs nothing to believe in a rough one."""
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
_HELD = 1e-4  # [m] of which a measured position moves less in a period: there was no new fix
FIT_MEMORY = 20.0  # [s] over which the fit of a filter's measurements is added up
FIRST_BIAS = 0.2  # deviation of the slowly varying load before the first measurement, in the units of `Tuning`

_Matrix = Sequence[Sequence[Any]]


class Belief(NamedTuple):
    """What the filter remembers, as rows."""

    count: Any  # of the updates so far, 1 row
    state: Any  # an `Estimate`, and `Faults` behind it
    covariance: Any  # of the state, the lower triangle row by row
    motion: Any  # velocity [m/s] and acceleration [m/s^2] of the reference in the world, 4 rows
    fix: Any  # x_e, y_e [m] as measured last
    past: Any  # the last three measurements, carried along with the motion foreseen since
    noise: Any  # variances of the measurements
    fit: Any  # logarithm of the likelihood of the measurements so far, the last ones above all, 1 row
    actions: Any  # the last but one and those before, surge and yaw of each

    @classmethod
    def of(cls, rows: Any, faults: bool = False) -> Belief:
        """Return the parts of a filter's memory.

        Args:
            rows: a sequence, or an array whose first axis counts them.
            faults: whether faults are believed in.
        """
        sizes = cls.sizes(faults)
        return cls(*(rows[sum(sizes[:i]) : sum(sizes[: i + 1])] for i in range(len(sizes))))

    @staticmethod
    def sizes(faults: bool = False) -> Belief:
        """Return how many rows each part has."""
        size = STATE_SIZE + FAULTS * faults
        return Belief(1, size, size * (size + 1) // 2, 4, 2, 3 * SENSORS, SENSORS, 1, 2 * LATE * faults)


class FilterUnits(NamedTuple):
    """What deviations are measured in."""

    speed: Number  # [m/s]
    drag: Sequence[Number]  # of loads [N], [N], [N m]
    limits: Sequence[Number]  # of the actuators [N], [N m]

    @classmethod
    def of(cls, o: Observation, coefficients: Coefficients) -> FilterUnits:
        """Return the units at a reference's speed."""
        speed = SYMBOLS.clip(SYMBOLS.hypot(o.u_R, o.v_R), SPEED_FLOOR, math.inf)
        drag = [d * speed for d in (coefficients.d11, coefficients.d22, coefficients.d33)]
        return cls(speed, drag, (o.F_u_max, o.F_r_max))


def updated(o: Observation, coefficients: Coefficients, tuning: Any, memory: Belief) -> Belief:
    """Return the memory after one more observation.

    Args:
        o: the observation in SI units.
        coefficients: of the vehicle as it is known.
        tuning: the fields of a `kalman.Tuning`, and those of a `kalman.FaultTuning` if faults are believed in, as
            symbols.
        memory: zeros at the start of an episode but for the noise, or as the last call returned it.
    """
    motion, units, held_out = (
        reference_motion(o, coefficients, SYMBOLS),
        FilterUnits.of(o, coefficients),
        memory.count[0] <= 0.0,
    )
    measured, step = _measured(o, motion), _step(memory.motion, motion, o.dt)
    moved = [a - b + c for a, b, c in zip(measured, memory.fix, step, strict=False)]
    held = ~held_out & (moved[0] * moved[0] + moved[1] * moved[1] < _HELD * _HELD)
    actions = [(o.a_u, o.a_r), *zip(memory.actions[::2], memory.actions[1::2], strict=True)]
    first, deviation = prior(measured, units, tuning, len(memory.state) > STATE_SIZE)
    z, P = foreseen(memory.state, symmetric(memory.covariance), actions, step, o, coefficients)
    P = _sum(P, excitation(o.dt, units, tuning, len(z)))
    shown = [a - b for a, b in zip(shows(z), shows(memory.state), strict=True)]
    past = [x + shown[i % SENSORS] for i, x in enumerate(memory.past)]
    z = [SYMBOLS.where(held_out, a, b) for a, b in zip(first, z, strict=True)]
    prior_P = diagonal([d * d for d in deviation])
    P = symmetric([SYMBOLS.where(held_out, a, b) for a, b in zip(triangle(prior_P), triangle(P), strict=True)])
    expected = shows(z)
    fix = measured[:2]
    measured = [*(SYMBOLS.where(held, a, b) for a, b in zip(expected[:2], fix, strict=True)), *measured[2:]]
    innovation = [a - b for a, b in zip(measured, expected, strict=True)]
    innovation[PLACE.psi] = wrap_angle(innovation[PLACE.psi], SYMBOLS)
    measured[PLACE.psi] = expected[PLACE.psi] + innovation[PLACE.psi]  # continuous, for the differences
    noise = _found_noise(measured, past, memory.noise, memory.count[0], o.dt, held)
    z, P, fits = measured_update(z, P, innovation, noise, held)
    fit = SYMBOLS.where(held_out, 0.0, SYMBOLS.exp(-o.dt / FIT_MEMORY) * memory.fit[0] + fits)
    past = [*measured, *past[: 2 * SENSORS]]
    kept = [a for pair in actions[:LATE] for a in pair] if memory.actions else []
    return Belief([memory.count[0] + 1.0], z, triangle(P), motion[1:], fix, past, noise, [fit], kept)


def split(z: Sequence[Any]) -> tuple[Estimate, Faults]:
    """Return the parts of a filter's state; without faults those of sound sensors and actuators."""
    return Estimate(*z[:STATE_SIZE]), Faults(*z[STATE_SIZE:]) if len(z) > STATE_SIZE else NO_FAULTS


def shows(z: Sequence[Any]) -> list[Any]:
    """Return what the sensors should show, their biases included."""
    estimate, faults = split(z)
    return [a + b for a, b in zip(measurement(estimate, SYMBOLS), biases(faults), strict=True)]


def _measured(o: Observation, motion: ReferenceMotion) -> list[Number]:
    """Return the measurements x_e, y_e in the world, psi, u and v over ground, r."""
    x_e, y_e = to_world(o.e_x, o.e_y, o.cos_psi, o.sin_psi)
    return [x_e, y_e, motion.psi + o.psi_e, o.u_R + o.u_e, o.v_R + o.v_e, o.r_R + o.r_e]


def _step(before: Sequence[Number], motion: ReferenceMotion, dt: Number) -> tuple[Number, Number]:
    """Return how far the reference has moved since the last update, by Hermite's formula, of fourth order."""
    v_x, v_y, a_x, a_y = before
    half, twelfth = 0.5 * dt, dt * dt / 12
    return (
        half * (v_x + motion.v_x) + twelfth * (a_x - motion.a_x),
        half * (v_y + motion.v_y) + twelfth * (a_y - motion.a_y),
    )


def foreseen(
    z: Sequence[Any],
    P: _Matrix,
    actions: Sequence[Sequence[Number]],
    reference_step: tuple[Number, Number],
    o: Observation,
    coefficients: Coefficients,
) -> tuple[Sequence[Any], _Matrix]:
    """Return state and covariance one control period later, without excitation.

    The vehicle's motion depends on eleven things alone: its covariance goes by way of theirs.

    Args:
        z: the state.
        P: its covariance.
        actions: the last one, which has acted since; and if faults are believed in, those before it.
        reference_step: how far the reference has moved meanwhile in the world [m].
        o: the observation with which the period ends.
        coefficients: of the vehicle as it is known.
    """
    estimate, faults = split(z)
    estimate = estimate._replace(lag=SYMBOLS.clip(estimate.lag, SHORTEST_LAG, math.inf))  # not zero in the beginning
    wrong = [*z[STATE_SIZE:]]
    command = (o.a_u * o.F_u_max, o.a_r * o.F_r_max)
    if wrong:
        command = acting_forces(faults, actions, (o.F_u_max, o.F_r_max), SYMBOLS)
    after = transition(estimate, command, reference_step, o.dt, coefficients, SYMBOLS)
    load, _ = mean_load(estimate, command, o.dt, SYMBOLS)
    others = [*(x for i, x in enumerate(after) if not MOTION_STATES.start <= i < MOTION_STATES.stop), *wrong]
    moving = [*estimate[MOTION_STATES], *load, *after[CURRENT_STATES]]
    P = congruence(jacobian([*moving, *others], [*estimate, *wrong]), P)
    motion = [[*row, *[0.0] * len(others)] for row in jacobian(after[MOTION_STATES], moving)]
    return [*after, *wrong], congruence([*motion, *diagonal([1.0] * len(P))[len(moving) :]], P)


def excitation(dt: Number, units: FilterUnits, tuning: Any, size: int = STATE_SIZE) -> _Matrix:
    """Return the covariance that one control period adds, for a state of so many rows."""
    speed, drag, limits = units
    drift: list[Any] = [HULL_DRIFT] * STATE_SIZE
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
    """Return the state before the first measurement, centred on it, and its standard deviations, which are wide."""
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
    expected, unsure = prior_faults(tuning)
    return [*z, *expected], [*deviation, *unsure]


def _found_noise(
    measured: Sequence[Number],
    past: Sequence[Number],
    noise: Sequence[Number],
    count: Number,
    dt: Number,
    held: Any = False,
) -> list[Number]:
    """Return the variances of the measurements with one more of them.

    The third difference of white noise has 20 times its variance, and hardly any motion is left in it: `past` holds the
    last three measurements plus what the model foresaw of the motion since. Where the position is `held`, nothing is
    learned of its noise.
    """
    last, second, third = (past[i * SENSORS : (i + 1) * SENSORS] for i in range(3))
    difference = [a - 3 * b + 3 * c - d for a, b, c, d in zip(measured, last, second, third, strict=True)]
    square = [d * d / 20 for d in difference]
    for i, j in ((PLACE.x_e, PLACE.y_e), (PLACE.u, PLACE.v)):  # alike on both axes
        square[i] = square[j] = 0.5 * (square[i] + square[j])
    weight = SYMBOLS.clip(1.0 / SYMBOLS.clip(count, 1.0, math.inf), dt / NOISE_MEMORY, math.inf)
    weight = SYMBOLS.where(count < 3.0, 0.0, SYMBOLS.clip(weight, 0.0, 1.0))
    weights = [SYMBOLS.where(held, 0.0, weight)] * 2 + [weight] * (SENSORS - 2)
    return [
        SYMBOLS.clip(variance + w * (new - variance), least * least, math.inf)
        for variance, new, least, w in zip(noise, square, LEAST_NOISE, weights, strict=True)
    ]


def measured_update(
    z: Sequence[Any], P: _Matrix, innovation: Sequence[Number], noise: Sequence[Number], held: Any
) -> tuple[Sequence[Any], _Matrix, Any]:
    """Return state and covariance after measurements with independent errors, and the logarithm of their likelihood.

    Args:
        z: the state.
        P: its covariance.
        innovation: measurements less what the state makes expect.
        noise: variances of their errors.
        held: whether there is no new position.
    """
    size = len(z)
    change: list[Any] = [0.0] * size
    fit: Any = 0.0
    for i, h in enumerate(jacobian(shows(z), z)):
        Ph = [dot(h, column) for column in P]
        share = 1.0 / (dot(h, Ph) + noise[i])
        left = innovation[i] - dot(h, change)
        coarseness = (noise[i] / FINE_NOISE[i] ** 2) ** 2
        telling = coarseness / (1.0 + coarseness)
        fits = 0.5 * telling * (SYMBOLS.log(share) - left * left * share)
        if i < PLACE.psi:
            share, fits = SYMBOLS.where(held, 0.0, share), SYMBOLS.where(held, 0.0, fits)
        gain, fit = [x * share for x in Ph], fit + fits
        change = [x + k * left for x, k in zip(change, gain, strict=True)]
        P = symmetric([P[i][j] - gain[i] * Ph[j] for i in range(size) for j in range(i + 1)])
    estimate, faults = split([x + d for x, d in zip(z, change, strict=True)])
    estimate = estimate._replace(lag=SYMBOLS.clip(estimate.lag, SHORTEST_LAG, LONGEST_LAG))
    return [*estimate, *(within_bounds(faults, SYMBOLS) if size > STATE_SIZE else ())], P, fit


def _sum(A: _Matrix, B: _Matrix) -> _Matrix:
    return [[a + b for a, b in zip(*rows, strict=True)] for rows in zip(A, B, strict=True)]

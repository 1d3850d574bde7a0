"""Equations of the extended Kalman filter on symbols: prediction by the model, correction by the measurements.

The Jacobians are derived symbolically from the model. The state is an `Estimate`, followed by `Faults` in a filter that
estimates faults. The equations hold for any kind of motion, see `FilterModel`. The measurement errors are independent,
so the measurements are processed one after the other. The result is the same as that of one joint update, and no system
of equations must be solved. Only the lower triangle of the covariance is computed, so it is always symmetric.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
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
    GUST_MEMORY,
    LONGEST_LAG,
    PLACE,
    PLANE_SEA,
    SHORTEST_LAG,
    STATE_SIZE,
    SeaModel,
    mean_load,
    measurement,
    transition,
    wave_transition,
)
from baselines.estimation.water_frame import ReferenceMotion, reference_motion
from baselines.policy import SPEED_FLOOR

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

_FIX = 2  # number of measurements that a position fix gives: x and y; in space the depth has its own sensor
_LEAST_MOTION = 1e-4  # [m] smaller changes of a measured position in a period mean that there was no new fix
FIT_MEMORY = 20.0  # [s] averaging time of the log-likelihood

_Matrix = Sequence[Sequence[Any]]


class FilterUnits(NamedTuple):
    """Units of the tuning's standard deviations."""

    speed: Number  # [m/s]
    drag: Sequence[Number]  # [N], [N m] of each component of the load
    limits: Sequence[Number]  # [N], [N m] of the actuators

    @classmethod
    def of(cls, o: Observation, coefficients: Coefficients) -> FilterUnits:
        """Return the units at the speed of the reference."""
        speed = SYMBOLS.clip(SYMBOLS.hypot(o.u_R, o.v_R), SPEED_FLOOR, math.inf)
        drag = [d * speed for d in (coefficients.d11, coefficients.d22, coefficients.d33)]
        return cls(speed, drag, (o.F_u_max, o.F_r_max))


@dataclass(frozen=True)
class FilterModel:
    """What the filter takes from a kind of motion.

    Args:
        sea: the states.
        units: returns the `FilterUnits` for (observation, coefficients).
        reference: returns numbers that end with velocity and acceleration of the reference in the world, for
            (observation, coefficients, namespace).
        measured: returns the measurements, in the order of the motion, for (observation, what `reference` returns).
        first_noise: initial standard deviations of the measurements, used until there are enough of them to estimate
            these.
        least_noise: lower bounds of the estimated standard deviations.
        alike: rows of measurements with the same variance.
    """

    sea: SeaModel
    units: Callable[..., FilterUnits]
    reference: Callable[..., Sequence[Number]]
    measured: Callable[..., list[Number]]
    first_noise: tuple[float, ...]
    least_noise: tuple[float, ...]
    alike: tuple[tuple[int, ...], ...]

    @cached_property
    def fine_noise(self) -> tuple[float, ...]:
        """Standard deviations below which a measurement has less weight in the choice between the filters.

        With precise sensors the filter for rough water is accurate in calm water too.
        """
        return tuple(0.4 * deviation for deviation in self.first_noise)


def _measurements(o: Observation, motion: ReferenceMotion) -> list[Number]:
    """Return the measurements x_e, y_e in the world, psi, u and v over ground, r."""
    x_e, y_e = to_world(o.e_x, o.e_y, o.cos_psi, o.sin_psi)
    return [x_e, y_e, motion.psi + o.psi_e, o.u_R + o.u_e, o.v_R + o.v_e, o.r_R + o.r_e]


PLANE_FILTER = FilterModel(
    sea=PLANE_SEA,
    units=FilterUnits.of,
    reference=reference_motion,
    measured=_measurements,
    first_noise=(0.05, 0.05, 0.015, 0.02, 0.02, 0.005),
    least_noise=(1e-4, 1e-4, 3e-5, 3e-5, 3e-5, 3e-5),
    alike=((PLACE.x_e, PLACE.y_e), (PLACE.u, PLACE.v)),
)
"""The filter in the horizontal plane."""


class Belief(NamedTuple):
    """Memory of a filter, as rows."""

    count: Any  # number of updates so far, 1 row
    state: Any  # an `Estimate`, then `Faults` if the filter estimates them
    covariance: Any  # lower triangle of the state's covariance, row by row
    motion: Any  # velocity [m/s] and acceleration [m/s^2] of the reference in the world
    fix: Any  # last measured x_e, y_e [m]
    past: Any  # last three measurements, each plus the motion that the model has predicted since then
    noise: Any  # variances of the measurements
    fit: Any  # log-likelihood of the measurements, with exponential forgetting, 1 row
    actions: Any  # actions before the last one, surge and yaw of each, the latest first

    @classmethod
    def of(cls, rows: Any, faults: bool = False, model: FilterModel = PLANE_FILTER) -> Belief:
        """Return the parts of a filter's memory.

        Args:
            rows: a sequence, or an array whose first axis is that of the rows.
            faults: whether the filter estimates faults.
            model: the kind of motion.
        """
        sizes = cls.sizes(faults, model)
        return cls(*(rows[sum(sizes[:i]) : sum(sizes[: i + 1])] for i in range(len(sizes))))

    @staticmethod
    def sizes(faults: bool = False, model: FilterModel = PLANE_FILTER) -> Belief:
        """Return the number of rows of each part."""
        sea = model.sea
        size, sensors, axes = sea.size + FAULTS * faults, sea.motion.stop, len(sea.model.position)
        return Belief(1, size, size * (size + 1) // 2, 2 * axes, _FIX, 3 * sensors, sensors, 1, 2 * LATE * faults)


def updated(o: Any, coefficients: Any, tuning: Any, memory: Belief, model: FilterModel = PLANE_FILTER) -> Belief:
    """Return the memory after one more observation.

    Args:
        o: the observation in SI units.
        coefficients: of the nominal vehicle.
        tuning: has the fields of a `kalman.Tuning`, or of a `kalman.FaultTuning` if faults are estimated, as symbols.
        memory: as the last call returned it. At the start of an episode all rows are zero, except for the noise.
        model: the kind of motion.
    """
    sea, sensors, psi = model.sea, model.sea.motion.stop, model.sea.place.psi
    motion, units, first = (
        model.reference(o, coefficients, SYMBOLS),
        model.units(o, coefficients),
        memory.count[0] <= 0.0,
    )
    moving = motion[-len(memory.motion) :]
    measured, step = model.measured(o, motion), _reference_step(memory.motion, moving, o.dt)
    moved = [a - b + c for a, b, c in zip(measured, memory.fix, step, strict=False)]
    no_fix = ~first & (moved[0] * moved[0] + moved[1] * moved[1] < _LEAST_MOTION * _LEAST_MOTION)
    actions = [
        tuple(getattr(o, f"a_{c}") for c in sea.model.channels),
        *zip(memory.actions[::2], memory.actions[1::2], strict=True),
    ]
    initial, deviation = prior(measured, units, tuning, len(memory.state) > sea.size, sea)
    z, P = predicted(memory.state, symmetric(memory.covariance), actions, step, o, coefficients, sea)
    P = _sum(P, excitation(o.dt, units, tuning, len(z), sea))
    change = [
        a - b for a, b in zip(expected_measurements(z, sea), expected_measurements(memory.state, sea), strict=True)
    ]
    past = [x + change[i % sensors] for i, x in enumerate(memory.past)]
    z = [SYMBOLS.where(first, a, b) for a, b in zip(initial, z, strict=True)]
    initial_P = diagonal([d * d for d in deviation])
    P = symmetric([SYMBOLS.where(first, a, b) for a, b in zip(triangle(initial_P), triangle(P), strict=True)])
    expected = expected_measurements(z, sea)
    fix = measured[:_FIX]
    measured = [*(SYMBOLS.where(no_fix, a, b) for a, b in zip(expected[:_FIX], fix, strict=True)), *measured[_FIX:]]
    innovation = [a - b for a, b in zip(measured, expected, strict=True)]
    innovation[psi] = wrap_angle(innovation[psi], SYMBOLS)
    measured[psi] = expected[psi] + innovation[psi]  # continuous, for the differences
    noise = _noise_variances(measured, past, memory.noise, memory.count[0], o.dt, no_fix, model)
    z, P, fits = measured_update(z, P, innovation, noise, no_fix, model)
    fit = SYMBOLS.where(first, 0.0, SYMBOLS.exp(-o.dt / FIT_MEMORY) * memory.fit[0] + fits)
    past = [*measured, *past[: 2 * sensors]]
    later = [a for pair in actions[:LATE] for a in pair] if memory.actions else []
    return Belief([memory.count[0] + 1.0], z, triangle(P), moving, fix, past, noise, [fit], later)


def split(z: Sequence[Any], sea: SeaModel = PLANE_SEA) -> tuple[Any, Faults]:
    """Return the two parts of a filter's state; `NO_FAULTS` if the filter does not estimate faults."""
    return sea.Estimate(*z[: sea.size]), Faults(*z[sea.size :]) if len(z) > sea.size else NO_FAULTS


def expected_measurements(z: Sequence[Any], sea: SeaModel = PLANE_SEA) -> list[Any]:
    """Return the measurements that a filter's state predicts, including the sensor biases."""
    estimate, faults = split(z, sea)
    ideal = measurement(estimate, SYMBOLS, sea)
    return [a + b for a, b in zip(ideal, biases(faults), strict=True)] if len(z) > sea.size else [*ideal]


def _reference_step(before: Sequence[Number], now: Sequence[Number], dt: Number) -> list[Number]:
    """Return the displacement of the reference since the last update, by Hermite's quadrature of fourth order."""
    half, twelfth, axes = 0.5 * dt, dt * dt / 12, len(now) // 2
    ends = zip(before[:axes], now[:axes], before[axes:], now[axes:], strict=True)
    return [half * (v + v_now) + twelfth * (a - a_now) for v, v_now, a, a_now in ends]


def predicted(
    z: Sequence[Any],
    P: _Matrix,
    actions: Sequence[Sequence[Number]],
    reference_step: Sequence[Number],
    o: Any,
    coefficients: Any,
    sea: SeaModel = PLANE_SEA,
) -> tuple[Sequence[Any], _Matrix]:
    """Return state and covariance one control period later, without excitation.

    The motion states depend on few variables only, in the plane on eleven. The covariance is first propagated to these
    variables and then to the motion states, which needs fewer operations.

    Args:
        z: the state.
        P: its covariance.
        actions: the last actions, the latest first; used only if the filter estimates faults.
        reference_step: displacement of the reference in the world during the period [m].
        o: the observation at the end of the period.
        coefficients: of the nominal vehicle.
        sea: the kind of motion.
    """
    estimate, faults = split(z, sea)
    estimate = estimate._replace(lag=SYMBOLS.clip(estimate.lag, SHORTEST_LAG, math.inf))  # it is zero at the start
    fault_rows = [*z[sea.size :]]
    command: Sequence[Number] = [getattr(o, f"a_{c}") * getattr(o, f"F_{c}_max") for c in sea.model.channels]
    if fault_rows:
        command = acting_forces(faults, actions, (o.F_u_max, o.F_r_max), SYMBOLS)
    after = transition(estimate, command, reference_step, o.dt, coefficients, SYMBOLS, sea)
    load, _ = mean_load(estimate, command, o.dt, coefficients, SYMBOLS, sea)
    others = [*after[sea.motion.stop :], *fault_rows]
    inputs = [*estimate[sea.motion], *load, *after[sea.current]]  # of the equations of motion
    P = congruence(jacobian([*inputs, *others], [*estimate, *fault_rows]), P)
    motion = [[*row, *[0.0] * len(others)] for row in jacobian(after[sea.motion], inputs)]
    return [*after, *fault_rows], congruence([*motion, *diagonal([1.0] * len(P))[len(inputs) :]], P)


def excitation(
    dt: Number, units: FilterUnits, tuning: Any, size: int = STATE_SIZE, sea: SeaModel = PLANE_SEA
) -> _Matrix:
    """Return the covariance of the process noise in one control period, shape (size, size)."""
    speed, drag, limits = units
    drift: list[Any] = [POSE_DRIFT] * sea.size
    surge = side = tuning.acceleration * speed
    drift[sea.motion] = _by_kind(sea.model.state, POSE_DRIFT, surge, side, tuning.acceleration)
    drift[sea.force] = [FORCE_DRIFT * limit for limit in limits]
    axes = len(sea.model.current)
    drift[sea.current] = [tuning.current * speed] * axes
    drift[sea.gust] = [tuning.gust * speed * math.sqrt(2 / GUST_MEMORY)] * axes
    drift[sea.bias] = _loads(tuning, "bias", drag, sea)
    drift[sea.place.lag] = LAG_DRIFT
    drift = [*drift, *DRIFT][:size]
    Q = diagonal([d * d * dt for d in drift])
    A = wave_transition(dt, SYMBOLS)
    for pair, deviation in zip(sea.wave_pairs, _loads(tuning, "waves", drag, sea), strict=True):
        for i, row in zip(range(pair.start, pair.stop), A, strict=True):
            for j, other in zip(range(pair.start, pair.stop), A, strict=True):
                Q[i][j] = deviation * deviation * (float(i == j) - dot(row, other))
    return Q


def _by_kind(names: Sequence[str], pose: Any, surge: Any, side: Any, turn: Any) -> list[Any]:
    """Return a number for each name of a state or a load, by its kind."""
    kinds = {"u": surge, "X": surge} | dict.fromkeys("vwYZ", side) | dict.fromkeys("qrMN", turn)
    return [kinds.get(name, pose) for name in names]


def _loads(tuning: Any, kind: str, drag: Sequence[Number], sea: SeaModel) -> list[Number]:
    """Return the standard deviations of the components of a load, for the entries of the tuning with this ending."""
    surge, sway, yaw = (getattr(tuning, f"{axis}_{kind}") for axis in ("surge", "sway", "yaw"))
    return [share * unit for share, unit in zip(_by_kind(sea.model.load, 0.0, surge, sway, yaw), drag, strict=True)]


def prior(
    measured: Sequence[Number], units: FilterUnits, tuning: Any, faults: bool, sea: SeaModel = PLANE_SEA
) -> tuple[Sequence[Any], Sequence[Number]]:
    """Return the initial state, whose motion states are the first measurements, and its standard deviations."""
    speed, drag, limits = units
    z: list[Any] = [0.0] * sea.size
    z[sea.motion], z[sea.place.lag] = measured, FIRST_LAG
    deviation: list[Any] = [FIRST_POSE] * sea.size
    deviation[sea.motion] = _by_kind(sea.model.state, FIRST_POSE, FIRST_SURGE * speed, FIRST_SWAY * speed, FIRST_TURN)
    deviation[sea.force] = [FORCE_DRIFT * limit for limit in limits]
    axes = len(sea.model.current)
    deviation[sea.current], deviation[sea.gust] = [FIRST_CURRENT * speed] * axes, [tuning.gust * speed] * axes
    deviation[sea.bias], deviation[sea.place.lag] = [FIRST_BIAS * unit for unit in drag], FIRST_LAG
    deviation[sea.waves] = [x for wave in _loads(tuning, "waves", drag, sea) for x in (wave, wave)]
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
    model: FilterModel,
) -> list[Number]:
    """Return the variances of the measurement noise, updated with one more measurement.

    The third difference of white noise has 20 times its variance. The motion hardly contributes to it, as the
    measurements in `past` include the motion that the model has predicted since then. Without a new fix (`no_fix`) the
    variance of the position stays unchanged.
    """
    sensors = len(measured)
    last, second, third = (past[i * sensors : (i + 1) * sensors] for i in range(3))
    difference = [a - 3 * b + 3 * c - d for a, b, c, d in zip(measured, last, second, third, strict=True)]
    square = [d * d / 20 for d in difference]
    for rows in model.alike:
        mean = 1 / len(rows) * sum((square[i] for i in rows[1:]), start=square[rows[0]])
        square = [mean if i in rows else x for i, x in enumerate(square)]
    weight = SYMBOLS.clip(1.0 / SYMBOLS.clip(count, 1.0, math.inf), dt / NOISE_MEMORY, math.inf)
    weight = SYMBOLS.where(count < 3.0, 0.0, SYMBOLS.clip(weight, 0.0, 1.0))
    weights = [SYMBOLS.where(no_fix, 0.0, weight)] * _FIX + [weight] * (sensors - _FIX)
    return [
        SYMBOLS.clip(variance + w * (new - variance), least * least, math.inf)
        for variance, new, least, w in zip(noise, square, model.least_noise, weights, strict=True)
    ]


def measured_update(
    z: Sequence[Any],
    P: _Matrix,
    innovation: Sequence[Number],
    noise: Sequence[Number],
    no_fix: Any,
    model: FilterModel = PLANE_FILTER,
) -> tuple[Sequence[Any], _Matrix, Any]:
    """Return state and covariance after measurements with independent errors, and their weighted log-likelihood.

    Args:
        z: the state.
        P: its covariance.
        innovation: measurements minus expected measurements.
        noise: variances of the measurement noise.
        no_fix: whether there is no new measurement of the position.
        model: the kind of motion.
    """
    size, sea = len(z), model.sea
    change: list[Any] = [0.0] * size
    fit: Any = 0.0
    for i, h in enumerate(jacobian(expected_measurements(z, sea), z)):
        Ph = [dot(h, column) for column in P]
        precision = 1.0 / (dot(h, Ph) + noise[i])  # of the innovation
        residual = innovation[i] - dot(h, change)
        coarseness = (noise[i] / model.fine_noise[i] ** 2) ** 2
        weight = coarseness / (1.0 + coarseness)
        fits = 0.5 * weight * (SYMBOLS.log(precision) - residual * residual * precision)
        if i < _FIX:
            precision, fits = SYMBOLS.where(no_fix, 0.0, precision), SYMBOLS.where(no_fix, 0.0, fits)
        gain, fit = [x * precision for x in Ph], fit + fits
        change = [x + k * residual for x, k in zip(change, gain, strict=True)]
        P = symmetric([P[i][j] - gain[i] * Ph[j] for i in range(size) for j in range(i + 1)])
    estimate, faults = split([x + d for x, d in zip(z, change, strict=True)], sea)
    estimate = estimate._replace(lag=SYMBOLS.clip(estimate.lag, SHORTEST_LAG, LONGEST_LAG))
    return [*estimate, *(within_bounds(faults, SYMBOLS) if size > sea.size else ())], P, fit


def _sum(A: _Matrix, B: _Matrix) -> _Matrix:
    return [[a + b for a, b in zip(*rows, strict=True)] for rows in zip(A, B, strict=True)]

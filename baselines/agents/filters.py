"""Kalman filters with scheduled gains, whose estimates of vehicle, actuators and disturbances are inputs of a network.

The model is that of `baselines.estimation.sea_model`. The gains depend on the reference's speed and on the levels of
the noise of position and velocity, which are measured online, so that the filters can be differentiated and compiled
with the rest of the closed loop. The first filter is designed for a rough sea, the second for a calm sea, the third for
a rough sea and faults: it also estimates a bias of the measured velocity, and its noise level of the position includes
slow errors. The network has all estimates as inputs. The gains solve the algebraic Riccati equation;
`research.trainings.filter_gains` writes their table. They are designed for the paper's vehicle and used for every
vehicle in the units of the paper's, while the prediction uses the vehicle's own model.
"""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from auv_gym.physics.errors import to_body, to_world
from auv_gym.physics.namespaces import Namespace, Number, sum_of_squares, wrap_angle
from auv_gym.physics.vehicle import PAPER_VEHICLE, Coefficients
from auv_gym.scenarios.presets import TYPICAL_NOISE
from auv_gym.task.observation import Observation
from baselines.estimation.sea_model import PLACE, PLANE_SEA, STATE_SIZE, Estimate, SeaModel, measurement, transition
from baselines.estimation.water_frame import reference_motion
from baselines.policy import CRUISE_SPEED, is_fast

FILTER_GAINS = Path(__file__).with_name("filter_gains.json")
"""File of the gains, see `gains`."""
LAGS = (0.24, 0.001, 0.24)
"""Time constants [s] of the actuators in the models of the filters, for a rough sea, a calm sea, and faults."""
BIASED = 2  # index of the filter that estimates a bias of the measured velocity
LEVELS = {speed_range: sensors.noise[1:4] for speed_range, sensors in TYPICAL_NOISE.items()}
"""Units of the noise levels by speed range: standard deviations of position [m], heading [rad] and velocity [m/s]."""
POSITION_LEVELS = (0.2, 0.5, 1.0, 2.5, 6.0, 20.0)
"""Levels of the noise of the position for which there are gains; gains between them are interpolated."""
VELOCITY_LEVELS = (0.3, 1.0, 3.0)
"""The same for the noise of the velocity."""
MIDDLE = CRUISE_SPEED  # [m/s] speed at which `speed_share` is zero
_HELD = 1e-4  # [m] change of the measured position in a period below which there was no new fix
_SAME = 1e-6  # [m/s] change of the measured velocities in a period below which there was no new measurement
_AVERAGE = 5.0  # [s] averaging time of the noise levels
_QUICK = 15.0  # control periods in which the levels rise to at most 1, so that first estimates converge quickly
_DRIFT = 4.0  # [s] decay time of the difference of position fixes and dead reckoning
_SLOW = 0.5  # [s] time constant of the low-pass on it: noise of a lower frequency has a slow level
_SLOW_AVERAGE = 15.0  # [s] averaging time of the slow level
LARGEST_LEVEL = 20.0
"""Largest level of the noise."""
_SETTLED = 50.0
"""Control periods in which the second filter is set to the estimate of the first one, in still water."""
LARGEST_DISTANCE = (0.05, 0.1, 0.1)
"""Largest difference of the two estimates: position [m] plus [s] times the speed, heading [rad].

A larger difference means that the sea is not calm. The second filter is then set to the estimate of the first one.
Without this its estimate could diverge, because its model is unstable in yaw at cruise."""
MEMORY_ENTRIES = tuple(name for name in Estimate._fields if name != "lag")
"""The entries of an `Estimate` that are in a filter's memory."""
LARGEST_ESTIMATE = dict.fromkeys("uvwqr", 100.0)
"""Largest magnitude of an entry [SI units], 1e6 for all others; a filter whose estimate exceeds it is reset.

With frozen or wrong observations the model may diverge. In six episodes or more of each case of the frozen suites, in
the filters' units, no velocity exceeded 5 m/s, no yaw rate 3 rad/s and no load 2000 N."""
MEASURED_ROWS = ("age", "x_e", "y_e", "psi", "u", "v", "waits")
"""Rows of the memory that belong to all filters: the age in control periods, the last measurements, and whether there
was no new position fix."""
LEVEL_ROWS = ("position", "heading", "velocity", "slow", "d_x", "d_y", "z_x", "z_y", "m_x", "m_y")
"""Rows of the noise: `MeasuredNoise`; position fixes minus dead reckoning [m], its low-pass, and the mean of this."""
BIAS_ROWS = ("b_u", "b_v")  # [m/s] of the filter `BIASED`
CONSTANT = len(MEASURED_ROWS) + len(LEVEL_ROWS)
"""Number of rows that count as constants in derivatives, the first ones: the gains follow the levels of the last
instant, and no gradient passes through them."""
SHARED = CONSTANT + len(BIAS_ROWS)
"""Number of rows before those of the single filters."""
ROWS = SHARED + len(LAGS) * len(MEMORY_ENTRIES)
"""Number of rows of the filters' memory, all zero at the start of an episode."""
ALONG = ("x_e", "u", "F_u", "V_x", "V_x_rate", "X", "X_wave", "X_swing")
"""Entries that the innovations of `ALONG_MEASURED` correct; of vectors in the world the component in surge."""
ACROSS = ("y_e", "psi", "v", "r", "F_r", "V_y", "V_y_rate", "Y", "N", "Y_wave", "Y_swing", "N_wave", "N_swing")
"""Entries that the innovations of `ACROSS_MEASURED` correct; of vectors in the world the component in sway."""
ALONG_MEASURED = ("x_e", "u")
"""Measurements along the surge axis."""
ACROSS_MEASURED = ("y_e", "psi", "v", "r")
"""Measurements along the sway axis and in yaw."""
VECTORS = (("x_e", "y_e"), ("V_x", "V_y"), ("V_x_rate", "V_y_rate"))
"""Entries of an `Estimate` that are vectors in the world."""


class MeasuredNoise(NamedTuple):
    """Squared levels of the noise in the units `LEVELS`, before the measurements of this instant."""

    position: Number  # white noise
    heading: Number
    velocity: Number
    slow: Number  # of white noise of the position with the same power at low frequencies


class FilterOutput(NamedTuple):
    """Output of the filters at a control instant."""

    estimates: tuple[Estimate, ...]  # of each filter
    bias: tuple[Number, Number]  # [m/s] of the measured velocities u, v, by the filter `BIASED`
    held: Number  # whether there was no new position fix
    velocity_held: Number  # whether there was no new measurement of the velocities
    levels: MeasuredNoise


def speed_share(speed: Number) -> Number:
    """Return (U - MIDDLE) / (U + MIDDLE), in [-1, 1); the gains are polynomials in it."""
    return (speed - MIDDLE) / (speed + MIDDLE)


@cache
def gains(speed_range: str) -> tuple[Any, ...]:
    """Return for each filter the coefficients of its gains in a speed range, in SI units: of `along`, then `across`.

    Each is a table with a row for each entry and a column for each measurement. A cell holds for each of
    `POSITION_LEVELS` and `VELOCITY_LEVELS` the coefficients of 1, s, s^2, ... with s = `speed_share`, one after the
    other.
    """
    record = json.loads(FILTER_GAINS.read_text(encoding="utf-8"))
    return tuple((tables["along"], tables["across"]) for tables in record[speed_range])


def entries_of(i: int) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the entries that the innovations along and across correct, of a filter by its index."""
    return (ALONG, ACROSS) if i != BIASED else ((*ALONG, BIAS_ROWS[0]), (*ACROSS, BIAS_ROWS[1]))


def filter_step(
    o: Observation,
    speed: Number,
    memory: Sequence[Number],
    ns: Namespace,
    coefficients: Coefficients = PAPER_VEHICLE.coefficients,
) -> tuple[FilterOutput, tuple[Number, ...]]:
    """Return the output of the filters after one more observation, and their new memory.

    Args:
        o: the observation in SI units.
        speed: of the reference [m/s].
        memory: `ROWS` rows from the previous call; zero at the start of an episode.
        ns: the namespace of the numbers.
        coefficients: of the nominal vehicle, in units in which it has the mass, length and speed of the paper's.
    """
    last = dict(zip((*MEASURED_ROWS, *LEVEL_ROWS, *BIAS_ROWS), memory, strict=False))
    rows, age, bias = memory[SHARED:], last["age"], (last["b_u"], last["b_v"])
    initial = age <= 0.0
    motion = reference_motion(o, coefficients, ns)
    step = reference_step((motion.v_x, motion.v_y), (motion.a_x, motion.a_y), o.dt)
    x_e, y_e = to_world(o.e_x, o.e_y, o.cos_psi, o.sin_psi)
    moved = x_e - last["x_e"] + step[0], y_e - last["y_e"] + step[1]
    held = is_held(moved, age)
    measured = x_e, y_e, motion.psi + o.psi_e, o.u_R + o.u_e, o.v_R + o.v_e, o.r_R + o.r_e
    du, dv = measured[3] - last["u"], measured[4] - last["v"]
    same = (du * du + dv * dv < _SAME * _SAME) & (age > 0.0)
    command = o.a_u * o.F_u_max, o.a_r * o.F_r_max
    size = len(MEMORY_ENTRIES)
    earlier = [estimate_of(rows[i * size : (i + 1) * size], lag) for i, lag in enumerate(LAGS)]
    predicted = [transition(z, command, step, o.dt, coefficients, ns) for z in earlier]
    levels = MeasuredNoise(*(ns.clip(last[name], 0.0, LARGEST_LEVEL**2) for name in LEVEL_ROWS[:4]))
    before, after = earlier[0], predicted[0]
    white = _white_levels(before, after, measured, last, (held, same), o, ns)
    level_rows = *white, *_slow_level(before, after, measured, moved, last, held | same, white[-1], o, ns)
    bases = _bases(levels, age, speed, ns)
    estimates: list[Estimate] = []
    for i, ahead in enumerate(predicted):
        z, corrected_bias = _corrected(i, ahead, bias, measured, (held, same), bases[i == BIASED], o, ns)
        diverged = is_diverged(z)
        new = settled(i, z, (initial, diverged), measured, (age, o.dt), estimates, (speed, levels.position), ns)
        if i == BIASED:
            bias = tuple(ns.where(initial | diverged, 0.0 * o.dt, ns.clip(b, -speed, speed)) for b in corrected_bias)
        estimates.append(Estimate._make(new))
    now = (ns.clip(age + 1.0, 0.0, 1e6), x_e, y_e, *measured[2:5], ns.where(held, 1.0 + 0.0 * o.dt, 0.0 * o.dt))
    entries = (getattr(z, name) for z in estimates for name in MEMORY_ENTRIES)
    return FilterOutput(tuple(estimates), bias, held, same, levels), (*now, *level_rows, *bias, *entries)


def _white_levels(
    earlier: Estimate,
    predicted: Estimate,
    measured: Sequence[Number],
    last: Mapping[str, Number],
    unchanged: tuple[Any, Any],
    o: Observation,
    ns: Namespace,
) -> tuple[Number, ...]:
    """Return the squared levels of the white noise of position, heading and velocity after one more measurement.

    The difference of two measurements, without that of the model's prediction, has twice the variance of white noise.

    Args:
        earlier: estimate of the first filter at the last instant.
        predicted: its prediction for this instant.
        measured: the measurements x_e, y_e, psi, u, v, r.
        last: the memory, by name.
        unchanged: whether there was no new position fix, and no new measurement of the velocities.
        o: the observation.
        ns: the namespace of the numbers.
    """
    (held, same), age, dt = unchanged, last["age"], o.dt
    change = [a - b for a, b in zip(measurement(predicted, ns), measurement(earlier, ns), strict=True)]
    names = "x_e", "y_e", "psi", "u", "v"
    d_x, d_y, d_psi, d_u, d_v = (m - last[n] - c for n, m, c in zip(names, measured, change, strict=False))
    d_psi = wrap_angle(d_psi, ns)
    squares = 0.25 * (d_x * d_x + d_y * d_y), 0.5 * d_psi * d_psi, 0.25 * (d_u * d_u + d_v * d_v)
    weight = level_share(age, dt, ns)
    weights = ns.where(_gap(held, last), 0.0, weight), weight, ns.where(same, 0.0, weight)
    before = (last[name] for name in LEVEL_ROWS)
    return next_levels(before, squares, level_units(is_fast(o.u_R, o.v_R), ns), weights, age, dt, ns)


def level_share(age: Number, dt: Number, ns: Namespace) -> Number:
    """Return the weight of a new measurement in a level after `age` control periods of dt [s]."""
    return ns.clip(1.0 / ns.clip(age, 1.0, 1e6), dt / _AVERAGE, 1.0)


def next_levels(
    before: Iterable[Number],
    squares: Sequence[Number],
    units: Sequence[Number],
    weights: Sequence[Number],
    age: Number,
    dt: Number,
    ns: Namespace,
) -> tuple[Number, ...]:
    """Return the squared levels after measurements whose noise has these squares, each with its weight."""
    found = []
    for level, square, unit, share in zip(before, squares, units, weights, strict=False):
        new = level + share * (ns.clip(square / (unit * unit), 0.0, LARGEST_LEVEL**2) - level)
        found.append(ns.where(age <= 0.0, 1.0 + 0.0 * dt, new))
    return tuple(found)


def _slow_level(
    earlier: Estimate,
    predicted: Estimate,
    measured: Sequence[Number],
    moved: Sequence[Number],
    last: Mapping[str, Number],
    unchanged: Any,
    velocity: Number,
    o: Observation,
    ns: Namespace,
) -> tuple[Number, ...]:
    """Return the other rows of `LEVEL_ROWS` after one more measurement.

    Noise of the position with a long correlation time hardly changes in a control period. It is seen in the difference
    d of position fixes and dead reckoning, which decays in `_DRIFT`, after a low-pass with the time constant `_SLOW`.
    The mean of the result, which a bias of the velocity causes, does not count. The variance is divided by that of
    white noise of the level 1, after that of the noise of the velocity is subtracted.

    Args:
        earlier: estimate of the first filter at the last instant.
        predicted: its prediction for this instant.
        measured: the measurements x_e, y_e, psi, u, v, r.
        moved: difference of the measured positions in the world [m].
        last: the memory, by name.
        unchanged: whether there was no new position fix, or no new measurement of the velocities.
        velocity: squared level of the noise of the velocity.
        o: the observation.
        ns: the namespace of the numbers.
    """
    age, dt, (position, _, speed) = last["age"], o.dt, level_units(is_fast(o.u_R, o.v_R), ns)
    middle = 0.5 * (earlier.psi + predicted.psi)
    u, v = 0.5 * (measured[3] + last["u"]) - last["b_u"], 0.5 * (measured[4] + last["v"]) - last["b_v"]
    reckoned = to_world(dt * u, dt * v, ns.cos(middle), ns.sin(middle))
    skip = _gap(unchanged, last) | (age <= 0.0)
    a, w = ns.exp(-dt / _DRIFT), 1.0 - ns.exp(-dt / _SLOW)
    share = ns.clip(1.0 / ns.clip(age, 1.0, 1e6), dt / _SLOW_AVERAGE, 1.0)
    rows, square = list[Any](), 0.0 * dt
    for axis, fix, reckoning in zip("xy", moved, reckoned, strict=True):
        d = ns.where(skip, 0.0 * dt, a * last[f"d_{axis}"] + fix - reckoning)
        z = last[f"z_{axis}"] + w * (d - last[f"z_{axis}"])
        mean = last[f"m_{axis}"] + share * (z - last[f"m_{axis}"])
        rows.append((d, z, mean))
        square = square + 0.5 * (z - mean) * (z - mean)
    of_position, of_velocity = _gains_of_white_noise(a, 1.0 - w)
    square = square / (w * w) - of_velocity * dt * dt * velocity * speed * speed
    square = square / (of_position * position * position)
    new = last["slow"] + share * (ns.clip(square, -(LARGEST_LEVEL**2), LARGEST_LEVEL**2) - last["slow"])
    slow = ns.where(age <= 0.0, 1.0 + 0.0 * dt, ns.where(skip, last["slow"], new))
    still = ns.where(age <= 0.0, 0.0 * dt, 1.0 + 0.0 * dt)
    return (slow, *(still * row for pair in zip(*rows, strict=True) for row in pair))


def _gains_of_white_noise(a: Number, b: Number) -> tuple[Number, Number]:
    """Return the variances of (1 - q) n / ((1 - a q) (1 - b q)) and of n / ((1 - a q) (1 - b q)), by partial fractions.

    n is white with variance 1, and q is the delay by a control period.
    """
    gains_ = []
    for A, B in (((a - 1.0) / (a - b), (b - 1.0) / (b - a)), (a / (a - b), b / (b - a))):
        gains_.append(A * A / (1.0 - a * a) + 2.0 * A * B / (1.0 - a * b) + B * B / (1.0 - b * b))
    return gains_[0], gains_[1]


def _gap(unchanged: Any, last: Mapping[str, Number]) -> Any:
    """Return whether there is no new measurement, or the first one after a gap."""
    return unchanged | (last["waits"] > 0.5)


def level_units(fast: Any, ns: Namespace) -> tuple[Number, ...]:
    """Return the units of the noise levels, see `LEVELS`."""
    return tuple(ns.where(fast, cruise, slow) for slow, cruise in zip(LEVELS["slow"], LEVELS["cruise"], strict=True))


def _bases(
    levels: MeasuredNoise, age: Number, speed: Number, ns: Namespace
) -> tuple[Sequence[Number], Sequence[Number]]:
    """Return the factors of the coefficients of the gains, for fast and then slow errors of the position."""
    most, share = most_level(age), speed_share(speed)
    velocity = weights(levels.velocity, VELOCITY_LEVELS, most, ns)
    squared = levels.position, ns.where(levels.slow > levels.position, levels.slow, levels.position)
    fast, slow = (basis(weights(x, POSITION_LEVELS, most, ns), velocity, share) for x in squared)
    return fast, slow


def most_level(age: Number) -> Number:
    """Return the largest level of the noise for which gains are used after `age` control periods."""
    return (age + 1.0) / _QUICK


def weights(squared: Number, knots: Sequence[float], most: Number, ns: Namespace) -> list[Number]:
    """Return the weights of the levels `knots` for a squared level of the noise, which is at most `most`."""
    return _hats(ns.clip(_level(squared, ns), 0.0, most), knots, ns)


def basis(position: Sequence[Number], velocity: Sequence[Number], share: Number) -> list[Number]:
    """Return the factors of the coefficients of the gains, see `gains`.

    Args:
        position: `weights` of the levels of the noise of the position.
        velocity: the same of the velocity.
        share: `speed_share` of the reference.
    """
    products = [p * v for p in position for v in velocity]
    powers = [1.0, share, share * share, share * share * share]
    return [product * power for product in products for power in powers]


def _level(squared: Number, ns: Namespace) -> Number:
    return ns.sqrt(ns.clip(squared, 1e-4, LARGEST_LEVEL**2))


def _hats(level: Number, knots: Sequence[float], ns: Namespace) -> list[Number]:
    """Return the weights of the knots in linear interpolation over the logarithm of a level."""
    at = [math.log(knot) for knot in knots]
    x = ns.clip(ns.log(ns.clip(level, knots[0], knots[-1])), at[0], at[-1])
    up = [ns.clip((x - a) / (b - a), 0.0, 1.0) for a, b in itertools.pairwise(at)]
    return [1.0 - up[0], *(a - b for a, b in itertools.pairwise(up)), up[-1]]


def settled(
    i: int,
    z: Any,
    new: tuple[Any, Any],
    measured: Sequence[Number],
    time: tuple[Number, Number],
    others: Sequence[Any],
    scale: tuple[Number, Number],
    ns: Namespace,
    sea: SeaModel = PLANE_SEA,
) -> list[Number]:
    """Return the rows of the estimate of filter i: those of the measurements at the start and where it has diverged.

    The second filter has those of the first one, in still water, where the two estimates are too far from each other.

    Args:
        i: index of the filter.
        z: its estimate after the measurements.
        new: whether an episode begins, and whether the estimate has diverged.
        measured: the measurements.
        time: control periods since the start, and control period [s].
        others: estimates of the filters before.
        scale: speed of the reference [m/s], and squared level of the noise of the position.
        ns: the namespace of the numbers.
        sea: the kind of motion.
    """
    (age, dt), (initial, diverged) = time, new
    first = (*measured, *[0.0 * dt] * (len(z) - len(measured)))
    rows = [ns.where(initial | diverged, a, b) for a, b in zip(first, z, strict=True)]
    if i != 1:
        return rows
    current = sea.current.start
    still = [*others[0][:current], *first[current:]]  # estimate of the first filter, in still water
    reset = (age < _SETTLED) | _far(others[0], z, *scale, ns, sea) | diverged
    return [ns.where(reset, a, b) for a, b in zip(still, rows, strict=True)]


def _far(a: Any, b: Any, speed: Number, level: Number, ns: Namespace, sea: SeaModel) -> Any:
    """Return whether two estimates differ by more than `LARGEST_DISTANCE` times the root of a squared noise level."""
    (base, per_speed, angle), axes, pose = LARGEST_DISTANCE, len(sea.model.position), sea.model.state.index("u")
    differences = [x - y for x, y in zip(a[:pose], b[:pose], strict=True)]
    wide = ns.sqrt(ns.sqrt(ns.clip(level, 1.0, 1e4)))
    distance = (base + per_speed * speed) * wide
    too_far = sum_of_squares(differences[:axes]) > distance * distance
    return too_far | (sum_of_squares(differences[axes:]) > angle * angle)


def is_diverged(z: Any) -> Any:
    """Return whether the magnitude of an entry exceeds `LARGEST_ESTIMATE`, or is nan."""
    within: Any = True
    for name in z._fields:
        if name != "lag":
            within = (abs(getattr(z, name)) <= LARGEST_ESTIMATE.get(name, 1e6)) & within
    return within ^ True


def is_held(moved: Sequence[Number], age: Number) -> Any:
    """Return whether there is no new position fix, from the change [m] of the measured x and y in the world."""
    return (sum_of_squares(moved) < _HELD * _HELD) & (age > 0.0)


def reference_step(velocity: Sequence[Number], acceleration: Sequence[Number], dt: Number) -> tuple[Number, ...]:
    """Return the displacement [m] of the reference in the last control period of dt [s], by its motion now."""
    half = 0.5 * dt * dt
    return tuple(dt * v - half * a for v, a in zip(velocity, acceleration, strict=True))


def estimate_of(rows: Sequence[Number], lag: float, kind: Any = Estimate) -> Any:
    """Return the estimate of which a memory holds all rows but the time constant of the actuators [s]."""
    place = kind._fields.index("lag")
    return kind(*rows[:place], lag, *rows[place:])


def _corrected(
    i: int,
    z: Estimate,
    bias: Sequence[Number],
    measured: Sequence[Number],
    unchanged: tuple[Any, Any],
    basis: Sequence[Number],
    o: Observation,
    ns: Namespace,
) -> tuple[Estimate, tuple[Number, ...]]:
    """Return the estimate of filter i and the bias of the velocity after the measurements; old ones do not count."""
    (held, same), known = unchanged, bias if i == BIASED else (0.0, 0.0)
    x, y, psi, u, v, r = (a - b for a, b in zip(measured, measurement(z, ns), strict=True))
    x, y = to_body(x, y, o.cos_psi, o.sin_psi)
    x, y, psi = ns.where(held, 0.0, x), ns.where(held, 0.0, y), wrap_angle(psi, ns)
    u, v = ns.where(same, 0.0, u - known[0]), ns.where(same, 0.0, v - known[1])
    changes: dict[str, Number] = {}
    fast = is_fast(o.u_R, o.v_R)
    tables = gains("slow")[i], gains("cruise")[i]
    for side, (names, innovations) in enumerate(zip(entries_of(i), ((x, u), (y, psi, v, r)), strict=True)):
        for name, slow, cruise in zip(names, *(table[side] for table in tables), strict=True):
            K = [ns.where(fast, dot(c, basis), dot(s, basis)) for s, c in zip(slow, cruise, strict=True)]
            changes[name] = sum(k * e for k, e in zip(K, innovations, strict=True))
    for a, b in VECTORS:
        changes[a], changes[b] = to_world(changes[a], changes[b], o.cos_psi, o.sin_psi)
    found = (
        tuple(b + changes.pop(name) for name, b in zip(BIAS_ROWS, bias, strict=True)) if i == BIASED else tuple(bias)
    )
    return z._replace(**{name: getattr(z, name) + change for name, change in changes.items()}), found


def corrections(
    i: int, side: int, innovations: Sequence[Number], basis: Sequence[Number], fast: Any, ns: Namespace
) -> list[Number]:
    """Return the corrections of the entries along (`side` 0) or across the surge axis (1), see `entries_of`.

    Args:
        i: index of the filter.
        side: whose gains are used.
        innovations: measurements minus predicted ones, along or across.
        basis: factors of the coefficients of the gains, see `basis`.
        fast: whether the gains are those of cruise.
        ns: the namespace of the numbers.
    """
    result = list[Number]()
    for slow, cruise in zip(gains("slow")[i][side], gains("cruise")[i][side], strict=True):
        K = [ns.where(fast, dot(c, basis), dot(s, basis)) for s, c in zip(slow, cruise, strict=True)]
        result.append(sum(k * e for k, e in zip(K, innovations, strict=True)))
    return result


def dot(coefficients: Sequence[float], basis: Sequence[Number]) -> Number:
    """Return the sum of products."""
    total: Number = coefficients[0] * basis[0]
    for c, x in zip(coefficients[1:], basis[1:], strict=True):
        total = total + c * x
    return total


assert len(ALONG) + len(ACROSS) == len(MEMORY_ENTRIES) == STATE_SIZE - 1
assert PLACE.x_e == 0

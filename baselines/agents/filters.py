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
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from auv_gym.physics.errors import to_body, to_world
from auv_gym.physics.namespaces import Namespace, Number, wrap_angle
from auv_gym.physics.vehicle import PAPER_VEHICLE, Coefficients
from auv_gym.scenarios.presets import TYPICAL_NOISE
from auv_gym.task.observation import Observation
from baselines.estimation.sea_model import PLACE, STATE_SIZE, Estimate, measurement, transition
from baselines.estimation.water_frame import ReferenceMotion, reference_motion
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
_LARGEST_LEVEL = 20.0
_SETTLED = 50.0
"""Control periods in which the second filter is set to the estimate of the first one, in still water."""
LARGEST_DISTANCE = (0.05, 0.1, 0.1)
"""Largest difference of the two estimates: position [m] plus [s] times the speed, heading [rad].

A larger difference means that the sea is not calm. The second filter is then set to the estimate of the first one.
Without this its estimate could diverge, because its model is unstable in yaw at cruise."""
MEMORY_ENTRIES = tuple(name for name in Estimate._fields if name != "lag")
"""The entries of an `Estimate` that are in a filter's memory."""
LARGEST_ESTIMATE = dict.fromkeys(MEMORY_ENTRIES, 1e6) | dict.fromkeys(("u", "v", "r"), 100.0)
"""Largest magnitude of an entry [SI units]; a filter whose estimate exceeds it is reset.

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
    step = reference_step(motion, o.dt)
    x_e, y_e = to_world(o.e_x, o.e_y, o.cos_psi, o.sin_psi)
    moved = x_e - last["x_e"] + step[0], y_e - last["y_e"] + step[1]
    held = (moved[0] * moved[0] + moved[1] * moved[1] < _HELD * _HELD) & (age > 0.0)
    measured = x_e, y_e, motion.psi + o.psi_e, o.u_R + o.u_e, o.v_R + o.v_e, o.r_R + o.r_e
    du, dv = measured[3] - last["u"], measured[4] - last["v"]
    same = (du * du + dv * dv < _SAME * _SAME) & (age > 0.0)
    command = o.a_u * o.F_u_max, o.a_r * o.F_r_max
    size = len(MEMORY_ENTRIES)
    earlier = [estimate_of(rows[i * size : (i + 1) * size], lag) for i, lag in enumerate(LAGS)]
    predicted = [transition(z, command, step, o.dt, coefficients, ns) for z in earlier]
    levels = MeasuredNoise(*(ns.clip(last[name], 0.0, _LARGEST_LEVEL**2) for name in LEVEL_ROWS[:4]))
    before, after = earlier[0], predicted[0]
    white = _white_levels(before, after, measured, last, (held, same), o, ns)
    level_rows = *white, *_slow_level(before, after, measured, moved, last, held | same, white[-1], o, ns)
    bases = _bases(levels, age, speed, ns)
    estimates: list[Estimate] = []
    for i, ahead in enumerate(predicted):
        z, corrected_bias = _corrected(i, ahead, bias, measured, (held, same), bases[i == BIASED], o, ns)
        first, diverged = (*measured, *[0.0 * o.dt] * (len(z) - len(measured))), _diverged(z)
        new = [ns.where(initial | diverged, a, b) for a, b in zip(first, z, strict=True)]
        if i == 1:
            still = [*estimates[0][: PLACE.V_x], *first[PLACE.V_x :]]  # estimate of the first filter, in still water
            reset = (age < _SETTLED) | _far(estimates[0], z, speed, levels.position, ns) | diverged
            new = [ns.where(reset, a, b) for a, b in zip(still, new, strict=True)]
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
    weight = ns.clip(1.0 / ns.clip(age, 1.0, 1e6), dt / _AVERAGE, 1.0)
    weights = ns.where(_gap(held, last), 0.0, weight), weight, ns.where(same, 0.0, weight)
    found = []
    for name, square, unit, share in zip(LEVEL_ROWS, squares, _units(o, ns), weights, strict=False):
        new = last[name] + share * (ns.clip(square / (unit * unit), 0.0, _LARGEST_LEVEL**2) - last[name])
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
    age, dt, (position, _, speed) = last["age"], o.dt, _units(o, ns)
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
    new = last["slow"] + share * (ns.clip(square, -(_LARGEST_LEVEL**2), _LARGEST_LEVEL**2) - last["slow"])
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


def _units(o: Observation, ns: Namespace) -> tuple[Number, ...]:
    """Return the units of the noise levels, see `LEVELS`."""
    fast = is_fast(o.u_R, o.v_R)
    return tuple(ns.where(fast, cruise, slow) for slow, cruise in zip(LEVELS["slow"], LEVELS["cruise"], strict=True))


def _bases(
    levels: MeasuredNoise, age: Number, speed: Number, ns: Namespace
) -> tuple[Sequence[Number], Sequence[Number]]:
    """Return the factors of the coefficients of the gains, for fast and then slow errors of the position."""
    early, share = (age + 1.0) / _QUICK, speed_share(speed)
    velocity = _hats(ns.clip(_level(levels.velocity, ns), 0.0, early), VELOCITY_LEVELS, ns)
    result = []
    for squared in (levels.position, ns.where(levels.slow > levels.position, levels.slow, levels.position)):
        position = _hats(ns.clip(_level(squared, ns), 0.0, early), POSITION_LEVELS, ns)
        products = [p * v for p in position for v in velocity]
        powers = [1.0, share, share * share, share * share * share]
        result.append([product * power for product in products for power in powers])
    return result[0], result[1]


def _level(squared: Number, ns: Namespace) -> Number:
    return ns.sqrt(ns.clip(squared, 1e-4, _LARGEST_LEVEL**2))


def _hats(level: Number, knots: Sequence[float], ns: Namespace) -> list[Number]:
    """Return the weights of the knots in linear interpolation over the logarithm of a level."""
    at = [math.log(knot) for knot in knots]
    x = ns.clip(ns.log(ns.clip(level, knots[0], knots[-1])), at[0], at[-1])
    up = [ns.clip((x - a) / (b - a), 0.0, 1.0) for a, b in itertools.pairwise(at)]
    return [1.0 - up[0], *(a - b for a, b in itertools.pairwise(up)), up[-1]]


def _far(a: Estimate, b: Estimate, speed: Number, level: Number, ns: Namespace) -> Any:
    """Return whether two estimates differ by more than `LARGEST_DISTANCE` times the root of a squared noise level."""
    base, per_speed, angle = LARGEST_DISTANCE
    x, y, psi, wide = a.x_e - b.x_e, a.y_e - b.y_e, a.psi - b.psi, ns.sqrt(ns.sqrt(ns.clip(level, 1.0, 1e4)))
    distance = (base + per_speed * speed) * wide
    return (x * x + y * y > distance * distance) | (psi * psi > angle * angle)


def _diverged(z: Estimate) -> Any:
    """Return whether the magnitude of an entry exceeds `LARGEST_ESTIMATE`, or is nan."""
    within: Any = True
    for name, most in LARGEST_ESTIMATE.items():
        within = (abs(getattr(z, name)) <= most) & within
    return within ^ True


def reference_step(motion: ReferenceMotion, dt: Number) -> tuple[Number, Number]:
    """Return the displacement x, y [m] of the reference in the last control period of dt [s], by its motion now."""
    half = 0.5 * dt * dt
    return dt * motion.v_x - half * motion.a_x, dt * motion.v_y - half * motion.a_y


def estimate_of(rows: Sequence[Number], lag: float) -> Estimate:
    """Return the estimate that the rows `MEMORY_ENTRIES` of a memory hold, for a time constant of the actuators [s]."""
    return Estimate(**dict(zip(MEMORY_ENTRIES, rows, strict=True)), lag=lag)


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


def dot(coefficients: Sequence[float], basis: Sequence[Number]) -> Number:
    """Return the sum of products."""
    total: Number = coefficients[0] * basis[0]
    for c, x in zip(coefficients[1:], basis[1:], strict=True):
        total = total + c * x
    return total


assert len(ALONG) + len(ACROSS) == len(MEMORY_ENTRIES) == STATE_SIZE - 1
assert PLACE.x_e == 0

"""Kalman filters with fixed gains, whose estimates of vehicle, actuators and disturbances are inputs of a network.

The model is that of `baselines.estimation.sea_model`. The gains depend on the reference's speed alone, so that the
filters can be differentiated and compiled with the rest of the closed loop. The first filter is designed for a rough
sea, the second for a calm sea. The network has both estimates as inputs. The gains solve the algebraic Riccati
equation; `research.trainings.filter_gains` writes their table. They are designed for the paper's vehicle and used for
every vehicle in the units of the paper's, while the prediction uses the vehicle's own model. For the published vehicles
the errors of position and heading are at most a third larger than with gains designed for the vehicle.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from auv_gym.physics.errors import to_body, to_world
from auv_gym.physics.namespaces import Namespace, Number, wrap_angle
from auv_gym.physics.vehicle import PAPER_VEHICLE, Coefficients
from auv_gym.task.observation import Observation
from baselines.estimation.sea_model import PLACE, STATE_SIZE, Estimate, measurement, transition
from baselines.estimation.water_frame import ReferenceMotion, reference_motion
from baselines.policy import CRUISE_SPEED, is_fast

FILTER_GAINS = Path(__file__).with_name("filter_gains.json")
"""File of the gains, see `gains`."""
LAGS = (0.24, 0.001)
"""Time constants [s] of the actuators in the models of the filters, for a rough and a calm sea."""
MIDDLE = CRUISE_SPEED  # [m/s] speed at which `speed_share` is zero
_HELD = 1e-4  # [m] change of the measured position in a period below which there was no new fix
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
SHARED = 3  # rows of the memory that belong to both filters: the age, and the last fix x_e, y_e [m]
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

FilterGainTable = Sequence[Sequence[Sequence[float]]]


class FilterOutput(NamedTuple):
    """Output of the filters at a control instant."""

    estimates: tuple[Estimate, ...]  # of each filter
    held: Number  # whether there was no new position fix


def speed_share(speed: Number) -> Number:
    """Return (U - MIDDLE) / (U + MIDDLE), in [-1, 1); the gains are polynomials in it."""
    return (speed - MIDDLE) / (speed + MIDDLE)


@cache
def gains(speed_range: str) -> tuple[tuple[FilterGainTable, FilterGainTable], ...]:
    """Return for each filter the coefficients of its gains in a speed range, in SI units: of `ALONG`, then `ACROSS`.

    Each is a table with a row for each entry and a column for each measurement. A cell holds the coefficients of
    1, s, s^2, ... with s = `speed_share`.
    """
    record = json.loads(FILTER_GAINS.read_text(encoding="utf-8"))
    return tuple((tables["along"], tables["across"]) for tables in record[speed_range])


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
    age, x_before, y_before, *rows = memory
    initial = age <= 0.0
    motion = reference_motion(o, coefficients, ns)
    step = reference_step(motion, o.dt)
    x_e, y_e = to_world(o.e_x, o.e_y, o.cos_psi, o.sin_psi)
    moved_x, moved_y = x_e - x_before + step[0], y_e - y_before + step[1]
    held = (moved_x * moved_x + moved_y * moved_y < _HELD * _HELD) & (age > 0.0)
    measured = x_e, y_e, motion.psi + o.psi_e, o.u_R + o.u_e, o.v_R + o.v_e, o.r_R + o.r_e
    estimates: list[Estimate] = []
    for i, (lag, *tables) in enumerate(zip(LAGS, gains("slow"), gains("cruise"), strict=True)):
        earlier = estimate_of(rows[i * len(MEMORY_ENTRIES) : (i + 1) * len(MEMORY_ENTRIES)], lag)
        command = o.a_u * o.F_u_max, o.a_r * o.F_r_max
        predicted = transition(earlier, command, step, o.dt, coefficients, ns)
        z = _corrected(predicted, measured, held, o, tables, speed_share(speed), ns)
        first, diverged = (*measured, *[0.0 * o.dt] * (len(z) - len(measured))), _diverged(z)
        new = [ns.where(initial | diverged, a, b) for a, b in zip(first, z, strict=True)]
        if estimates:
            still = [*estimates[0][: PLACE.V_x], *first[PLACE.V_x :]]  # estimate of the first filter, in still water
            reset = (age < _SETTLED) | _far(estimates[0], z, speed) | diverged
            new = [ns.where(reset, a, b) for a, b in zip(still, new, strict=True)]
        estimates.append(Estimate._make(new))
    entries = (getattr(z, name) for z in estimates for name in MEMORY_ENTRIES)
    after = (ns.clip(age + 1.0, 0.0, _SETTLED), x_e, y_e, *entries)
    return FilterOutput(tuple(estimates), held), after


def _far(a: Estimate, b: Estimate, speed: Number) -> Any:
    """Return whether two estimates differ by more than `LARGEST_DISTANCE`."""
    base, per_speed, angle = LARGEST_DISTANCE
    x, y, psi, distance = a.x_e - b.x_e, a.y_e - b.y_e, a.psi - b.psi, base + per_speed * speed
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
    z: Estimate,
    measured: Sequence[Number],
    held: Any,
    o: Observation,
    tables: Sequence[tuple[FilterGainTable, FilterGainTable]],
    share: Number,
    ns: Namespace,
) -> Estimate:
    """Return an estimate after the measurements; without a new position fix, position and heading do not count."""
    x, y, psi, u, v, r = (a - b for a, b in zip(measured, measurement(z, ns), strict=True))
    x, y = to_body(x, y, o.cos_psi, o.sin_psi)
    x, y, psi = ns.where(held, 0.0, x), ns.where(held, 0.0, y), wrap_angle(psi, ns)
    changes: dict[str, Number] = {}
    fast = is_fast(o.u_R, o.v_R)
    for i, (names, innovations) in enumerate(((ALONG, (x, u)), (ACROSS, (y, psi, v, r)))):
        for name, slow, cruise in zip(names, *(table[i] for table in tables), strict=True):
            K = [ns.where(fast, polynomial(c, share), polynomial(s, share)) for s, c in zip(slow, cruise, strict=True)]
            changes[name] = sum(k * e for k, e in zip(K, innovations, strict=True))
    for a, b in VECTORS:
        changes[a], changes[b] = to_world(changes[a], changes[b], o.cos_psi, o.sin_psi)
    return z._replace(**{name: getattr(z, name) + change for name, change in changes.items()})


def polynomial(coefficients: Sequence[float], x: Number) -> Number:
    """Return c_0 + c_1 x + c_2 x^2 + ..."""
    total: Number = coefficients[-1]
    for c in coefficients[-2::-1]:
        total = c + x * total
    return total


assert len(ALONG) + len(ACROSS) == len(MEMORY_ENTRIES) == STATE_SIZE - 1
assert PLACE.x_e == 0

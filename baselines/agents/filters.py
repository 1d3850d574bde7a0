"""Kalman filters with fixed gains among the inputs of a network: what the vehicle, its actuators and the sea do.

The model is that of `baselines.estimation.sea_model`, corrected at each control instant by gains that depend on the
reference's speed alone, so that the filters can be differentiated and compiled with the rest of a closed loop. The
first one believes in a rough sea, the second in a calm one; a network that sees what both believe can choose. The
gains are those of a steady Riccati equation, see `research.trainings.filter_gains`, which makes their table. It is made
for the paper's vehicle and serves every hull in that one's units, whose own model predicts: on the published vehicles
the errors of position and heading come out at most a third larger than with gains of their own.
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
from baselines.estimation.water_frame import reference_motion
from baselines.policy import CRUISE_SPEED, is_fast

FILTER_GAINS = Path(__file__).with_name("filter_gains.json")
"""File of the gains, see `gains`."""
LAGS = (0.24, 0.001)
"""Time constants [s] of the actuators that the filters believe in, for a rough and a calm sea."""
MIDDLE = CRUISE_SPEED  # [m/s] speed at which `speed_share` is zero
_HELD = 1e-4  # [m] of which a measured position moves less in a period: there was no new fix
_SETTLED = 50.0
"""Control periods after which the second filter goes its own way, from where the first one is, in still water."""
LEASH = (0.05, 0.1, 0.1)
"""How far the second filter may be from the first one: position [m] plus [s] times the speed, heading [rad].

Beyond that the sea is not calm; the filter begins again from where the first one is, or it might go anywhere: the hull
that it believes in is unstable in yaw at cruise."""
REMEMBERED = tuple(name for name in Estimate._fields if name != "lag")
"""The entries of an `Estimate` that a filter remembers."""
LARGEST_ESTIMATE = dict.fromkeys(REMEMBERED, 1e6) | dict.fromkeys(("u", "v", "r"), 100.0)
"""Magnitude [SI units] beyond which an entry of an estimate is none: the filter begins again.

Where observations are held back or wrong the model may run away. In six episodes or more of each case of the frozen
suites, in the filters' own units, no velocity was above 5 m/s, no yaw rate above 3 rad/s and no load above 2000 N."""
SHARED = 3  # rows that both filters remember: the age, and the last fix x_e, y_e [m]
ROWS = SHARED + len(LAGS) * len(REMEMBERED)
"""Rows that the filters remember, all zero at an episode's start."""
ALONG = ("x_e", "u", "F_u", "V_x", "V_x_rate", "X", "X_wave", "X_swing")
"""What is corrected by the innovations of `ALONG_MEASURED`; vectors in the world count along the body's surge axis."""
ACROSS = ("y_e", "psi", "v", "r", "F_r", "V_y", "V_y_rate", "Y", "N", "Y_wave", "Y_swing", "N_wave", "N_swing")
"""What is corrected by the innovations of `ACROSS_MEASURED`; vectors in the world count along the sway axis."""
ALONG_MEASURED = ("x_e", "u")
"""Measured along the surge axis."""
ACROSS_MEASURED = ("y_e", "psi", "v", "r")
"""Measured across it."""
VECTORS = (("x_e", "y_e"), ("V_x", "V_y"), ("V_x_rate", "V_y_rate"))
"""Entries of an `Estimate` that are vectors in the world."""

FilterGainTable = Sequence[Sequence[Sequence[float]]]


class Believed(NamedTuple):
    """What the filters say at a control instant."""

    estimates: tuple[Estimate, ...]  # of each of them
    held: Number  # whether there was no new position fix


def speed_share(speed: Number) -> Number:
    """Return (U - MIDDLE) / (U + MIDDLE), in [-1, 1), of whose powers the gains are made."""
    return (speed - MIDDLE) / (speed + MIDDLE)


@cache
def gains(speed_range: str) -> tuple[tuple[FilterGainTable, FilterGainTable], ...]:
    """Return for each filter the coefficients of its gains in a regime, in SI units: of `ALONG`, then of `ACROSS`.

    A row for each entry holds one for each measurement: the coefficients of 1, s, s^2, ... of s = `speed_share`.
    """
    record = json.loads(FILTER_GAINS.read_text(encoding="utf-8"))
    return tuple((own["along"], own["across"]) for own in record[speed_range])


def filtered(
    o: Observation,
    speed: Number,
    memory: Sequence[Number],
    ns: Namespace,
    hull: Coefficients = PAPER_VEHICLE.coefficients,
) -> tuple[Believed, tuple[Number, ...]]:
    """Return what the filters believe after one more observation, and the memory to hand in with the next one.

    Args:
        o: the observation in SI units.
        speed: of the reference [m/s].
        memory: `ROWS` rows, zero at an episode's start.
        ns: the namespace of the numbers.
        hull: the vehicle as it is known, in units in which it has the paper's vehicle's mass, length and speed.
    """
    age, x_before, y_before, *rows = memory
    held_out = age <= 0.0
    motion = reference_motion(o, hull, ns)
    half = 0.5 * o.dt * o.dt
    step = o.dt * motion.v_x - half * motion.a_x, o.dt * motion.v_y - half * motion.a_y
    x_e, y_e = to_world(o.e_x, o.e_y, o.cos_psi, o.sin_psi)
    moved_x, moved_y = x_e - x_before + step[0], y_e - y_before + step[1]
    held = (moved_x * moved_x + moved_y * moved_y < _HELD * _HELD) & (age > 0.0)
    measured = x_e, y_e, motion.psi + o.psi_e, o.u_R + o.u_e, o.v_R + o.v_e, o.r_R + o.r_e
    found: list[Estimate] = []
    for i, (lag, *tables) in enumerate(zip(LAGS, gains("slow"), gains("cruise"), strict=True)):
        own = _estimate(rows[i * len(REMEMBERED) : (i + 1) * len(REMEMBERED)], lag)
        command = o.a_u * o.F_u_max, o.a_r * o.F_r_max
        ahead = transition(own, command, step, o.dt, hull, ns)
        z = _corrected(ahead, measured, held, o, tables, speed_share(speed), ns)
        first, wild = (*measured, *[0.0 * o.dt] * (len(z) - len(measured))), _wild(z)
        begun = [ns.where(held_out | wild, a, b) for a, b in zip(first, z, strict=True)]
        if found:
            still = [*found[0][: PLACE.V_x], *first[PLACE.V_x :]]  # where the first one is, in still water
            joined = (age < _SETTLED) | _far(found[0], z, speed) | wild
            begun = [ns.where(joined, a, b) for a, b in zip(still, begun, strict=True)]
        found.append(Estimate._make(begun))
    after = (ns.clip(age + 1.0, 0.0, _SETTLED), x_e, y_e, *(getattr(z, name) for z in found for name in REMEMBERED))
    return Believed(tuple(found), held), after


def _far(a: Estimate, b: Estimate, speed: Number) -> Any:
    """Return whether two estimates differ by more than noise explains."""
    x, y, psi, leash = a.x_e - b.x_e, a.y_e - b.y_e, a.psi - b.psi, LEASH[0] + LEASH[1] * speed
    return (x * x + y * y > leash * leash) | (psi * psi > LEASH[2] * LEASH[2])


def _wild(z: Estimate) -> Any:
    """Return whether an entry of an estimate is beyond `LARGEST_ESTIMATE`, or no number."""
    within: Any = True
    for name, most in LARGEST_ESTIMATE.items():
        within = (abs(getattr(z, name)) <= most) & within
    return within ^ True


def _estimate(rows: Sequence[Number], lag: float) -> Estimate:
    """Return the estimate of the rows that are remembered of it."""
    return Estimate(**dict(zip(REMEMBERED, rows, strict=True)), lag=lag)


def _corrected(
    z: Estimate,
    measured: Sequence[Number],
    held: Any,
    o: Observation,
    tables: Sequence[tuple[FilterGainTable, FilterGainTable]],
    share: Number,
    ns: Namespace,
) -> Estimate:
    """Return an estimate after the measurements; those of a position that is held do not count."""
    x, y, psi, u, v, r = (a - b for a, b in zip(measured, measurement(z, ns), strict=True))
    x, y = to_body(x, y, o.cos_psi, o.sin_psi)
    x, y, psi = ns.where(held, 0.0, x), ns.where(held, 0.0, y), wrap_angle(psi, ns)
    changes: dict[str, Number] = {}
    fast = is_fast(o.u_R, o.v_R)
    for i, (names, innovations) in enumerate(((ALONG, (x, u)), (ACROSS, (y, psi, v, r)))):
        for name, slow, cruise in zip(names, *(own[i] for own in tables), strict=True):
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


assert len(ALONG) + len(ACROSS) == len(REMEMBERED) == STATE_SIZE - 1
assert PLACE.x_e == 0

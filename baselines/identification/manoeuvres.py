"""Manoeuvring characteristics of an identified vehicle: turning circle and zig-zag of IMO MSC.137(76) in the simulator.

International Maritime Organization, resolution MSC.137(76), "Standards for ship manoeuvrability", 2002, sections 5 and
6: advance and transfer of the turning circle at 90 degrees, its tactical diameter at 180 degrees, and the overshoots of
the heading after the second and third execute of the zig-zag. In logs of forces a yaw moment takes the place of the
rudder.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from auv_gym.physics.actuators import Response, respond
from auv_gym.physics.dynamics import State, rk4_step
from auv_gym.physics.namespaces import ARRAYS, Array
from baselines.identification.fit import Identified
from baselines.identification.initial_values import NEEDED
from baselines.identification.model import COEFFICIENTS, LIMIT_NAMES, is_current, load_of
from baselines.identification.uncertainty import NORMAL_QUANTILE

_DRAWS = 200  # vehicles that are drawn from the distribution of the fit, for the intervals
_MAX_STEPS = 4000  # integration steps of a manoeuvre
RATE = 0.05  # integration step in units of the shortest time constant of the drag
CIRCLE = ("advance", "transfer", "tactical diameter")
"""Names of the characteristics of a turning circle."""
ZIG_ZAGS = (10.0, 20.0)  # [degrees] headings at which the rudder is reversed


@dataclass(frozen=True)
class Characteristic:
    """A characteristic of a manoeuvre, with its interval."""

    name: str
    unit: str
    value: float  # nan if the manoeuvre does not reach it
    low: float  # 95 % confidence interval
    high: float


@dataclass(frozen=True)
class Approach:
    """The initial speed of the manoeuvres and the order to the rudder."""

    speed: float  # [m/s] straight ahead
    order: float  # yaw moment [N m], or rudder angle [rad]


def approach(found: Identified) -> Approach:
    """Return the mean speed of the log and the median of its orders, within the limit of the actuator."""
    log = found.model.log
    speeds, orders = np.abs(log.measured[:, 3]), np.abs(log.commands[:, 1])
    orders = orders[orders > 0] if orders.any() else np.ones(1)
    most = found["F_r_max"].value if log.kind == "force" else math.inf
    return Approach(float(speeds.mean()), float(min(np.median(orders), most)))


def characteristics(found: Identified, initial: Approach, seed: int = 0) -> tuple[Characteristic, ...]:
    """Return the manoeuvring characteristics of an identified vehicle; none if a parameter is not identified.

    Args:
        found: the identified vehicle, whose covariance gives the intervals.
        initial: speed and order.
        seed: of the vehicles that are drawn for the intervals.
    """
    if found.unknown:
        return ()
    kind, drawn = found.model.log.kind, _drawn(found, np.random.default_rng(seed))
    rows = [(name, "m", row) for name, row in zip(CIRCLE, _turning_circle(_Run(kind, drawn, initial)), strict=True)]
    for degrees in ZIG_ZAGS:
        overshoots = _zig_zag(_Run(kind, drawn, initial), math.radians(degrees))
        for which, row in zip(("first", "second"), overshoots, strict=True):
            rows.append((f"{which} overshoot, zig-zag at {degrees:g} degrees", "degrees", np.degrees(row)))
    return tuple(Characteristic(name, unit, *_interval(row)) for name, unit, row in rows)


def _drawn(found: Identified, rng: np.random.Generator) -> dict[str, Array]:
    """Return the fitted parameters and draws from the distribution of the fit by name, shape (1 + DRAWS,) each."""
    names = [name for name in found.model.names if name not in LIMIT_NAMES and not is_current(name)]
    free = [name for name in names if name in found.free]
    at = [found.free.index(name) for name in free]
    mean, covariance = np.zeros(len(at)), found.covariance[np.ix_(at, at)]
    noise = np.vstack((mean, rng.multivariate_normal(mean, covariance, _DRAWS, method="eigh")))
    rows = {name: np.full(1 + _DRAWS, found[name].value) for name in names}
    rows = {name: np.where(np.isnan(row), 0.0, row) for name, row in rows.items()}
    for name, change in zip(free, noise.T, strict=True):
        least = 1e-3 * abs(found[name].value) if name in (*NEEDED, "lag") else -math.inf
        rows[name] = np.maximum(rows[name] + change, least)
    return rows


def _interval(row: Array) -> tuple[float, float, float]:
    """Return the value of the fit, which is the first one, and its 95 % interval from the finite other values."""
    value, others = float(row[0]), row[1:][np.isfinite(row[1:])]
    if math.isnan(value) or len(others) < _DRAWS // 2:
        return value, math.nan, math.nan
    half = NORMAL_QUANTILE * float(others.std())
    return value, max(value - half, 0.0), value + half


class _Run:
    """Simultaneous simulations of several vehicles, which start straight ahead at the speed of the approach."""

    def __init__(self, kind: str, rows: Mapping[str, Array], initial: Approach) -> None:
        self.n, self.order, U = len(rows["lag"]), initial.order, initial.speed
        zero = np.zeros(self.n)
        self.kind, self.rows, self.coefficients = kind, rows, [rows[name] for name in COEFFICIENTS]
        masses, drags = self.coefficients[:3], self.coefficients[3:6]
        relaxations = [float(np.median(m / d)) for m, d in zip(masses, drags, strict=True)]
        crossing = float(np.median(rows["arm"])) / U if kind != "force" else math.inf
        self.dt = RATE * min(*relaxations, crossing)
        responses = [Response.of(lag, math.inf, math.inf, self.dt) for lag in rows["lag"].tolist()]
        self.response = Response(*(np.array(column) for column in zip(*responses, strict=True)))
        self.state: State = (zero, zero, zero, zero + U, zero, zero)
        self.ahead = (rows["d11"] + rows["X_uu"] * U) * U  # thrust, or revolutions, at constant speed
        if kind == "revolutions":
            loss, T_nn = rows["T_nu"] * U, rows["T_nn"]
            self.ahead = (loss + np.sqrt(loss**2 + 4 * T_nn * self.ahead)) / (2 * T_nn)
        self.acting: tuple[Array, Array] = (self.ahead, zero + (rows["neutral"] if kind != "force" else 0.0))

    def step(self, side: Array) -> None:
        """Simulate `dt` with an order to one side, 1 or -1, at constant thrust or revolutions."""
        acting, self.acting = respond(self.acting, (self.ahead, side * self.order), self.response, ARRAYS)
        load = load_of(self.kind, acting, self.state, self.rows, ARRAYS)
        self.state = rk4_step(self.state, load, self.coefficients, self.dt, (0.0, 0.0), ARRAYS)


def _turning_circle(run: _Run) -> tuple[Array, Array, Array]:
    """Return advance, transfer and tactical diameter [m]; nan where the heading is not reached."""
    advance, transfer, diameter = (np.full(run.n, np.nan) for _ in range(3))
    for _ in range(_MAX_STEPS):
        run.step(np.ones(run.n))
        x, y, psi = run.state[:3]
        quarter, half = np.isnan(advance) & (psi >= 0.5 * math.pi), np.isnan(diameter) & (psi >= math.pi)
        advance, transfer = np.where(quarter, x, advance), np.where(quarter, y, transfer)
        diameter = np.where(half, y, diameter)
        if not np.isnan(diameter).any():
            break
    return advance, transfer, diameter


def _zig_zag(run: _Run, band: float) -> tuple[Array, Array]:
    """Return first and second overshoot [rad] of the heading beyond the heading at which the rudder is reversed."""
    n = run.n
    side, executes, peak, overshoots = np.ones(n), np.ones(n), np.zeros(n), np.full((2, n), np.nan)
    for _ in range(_MAX_STEPS):
        run.step(side)
        peak = np.maximum(peak, -side * run.state[2])  # largest heading to the other side since the last execute
        turned = side * run.state[2] >= band
        for k in (0, 1):
            overshoots[k] = np.where(turned & (executes == k + 2), peak - band, overshoots[k])
        side, executes, peak = np.where(turned, -side, side), executes + turned, np.where(turned, band, peak)
        if (executes > 3).all():
            break
    return overshoots[0], overshoots[1]

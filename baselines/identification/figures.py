"""What seafarers ask of a vehicle: the turning circle and the zig-zag of IMO MSC.137(76), in the simulator.

International Maritime Organization, resolution MSC.137(76), "Standards for ship manoeuvrability", 2002, sections 5 and
6: of the turning circle advance and transfer, at 90 degrees, and tactical diameter, at 180 degrees; of the zig-zag the
overshoot of the heading behind the second and third execute. Where the log commands a yaw moment, it stands for the
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
from auv_gym.physics.steering import Stern, stern_load, thrust
from baselines.identification.begin import NEEDED, is_current
from baselines.identification.fit import Identified
from baselines.identification.model import COEFFICIENTS, LIMIT_NAMES
from baselines.identification.uncertainty import NORMAL_QUANTILE

_DRAWS = 200  # vehicles that the fit does not tell apart, for the intervals
_STEPS = 4000  # integration steps of a manoeuvre, at most
RATE = 0.05  # integration step, in the shortest time constant of the drag
CIRCLE = ("advance", "transfer", "tactical diameter")
"""The figures of a turning circle."""
ZIG_ZAGS = (10.0, 20.0)  # [degrees] headings at which the rudder is turned over


@dataclass(frozen=True)
class _Figure:
    """A figure of a manoeuvre, with what the fit leaves open."""

    name: str
    unit: str
    value: float  # nan where the manoeuvre does not get so far
    low: float  # 95 % interval
    high: float


@dataclass(frozen=True)
class Approach:
    """What the manoeuvres begin with, and the order to the rudder."""

    speed: float  # [m/s] straight ahead
    order: float  # [N m] of yaw moment, or [rad] of the rudder


def approach(found: Identified) -> Approach:
    """Return the mean speed of the log, and the median of the orders that it commands and the actuator gives."""
    log = found.model.log
    ahead = np.abs(log.measured[:, 3])
    orders = np.abs(log.commands[:, 1])
    orders = orders[orders > 0] if orders.any() else np.ones(1)
    most = found["F_r_max"].value if log.kind == "force" else math.inf
    return Approach(float(ahead.mean()), float(min(np.median(orders), most)))


def figures(found: Identified, begin: Approach, seed: int = 0) -> tuple[_Figure, ...]:
    """Return the figures of an identified vehicle; nothing where it lacks a parameter.

    Args:
        found: the fit, whose covariance makes the intervals.
        begin: speed and order.
        seed: of the vehicles that are drawn for the intervals.
    """
    if found.unknown:
        return ()
    kind, drawn = found.model.log.kind, _drawn(found, np.random.default_rng(seed))
    rows = [(name, "m", row) for name, row in zip(CIRCLE, _turning_circle(_Run(kind, drawn, begin)), strict=True)]
    for degrees in ZIG_ZAGS:
        overshoots = _zig_zag(_Run(kind, drawn, begin), math.radians(degrees))
        for which, row in zip(("first", "second"), overshoots, strict=True):
            rows.append((f"{which} overshoot, zig-zag at {degrees:g} degrees", "degrees", np.degrees(row)))
    return tuple(_Figure(name, unit, *_interval(row)) for name, unit, row in rows)


def _drawn(found: Identified, rng: np.random.Generator) -> dict[str, Array]:
    """Return the fitted parameters and those that the log does not tell from them, rows of shape (1 + DRAWS,)."""
    names = [name for name in found.model.names if name not in LIMIT_NAMES and not is_current(name)]
    at = [found.free.index(name) for name in names if name in found.free]
    spread = found.covariance[np.ix_(at, at)]
    noise = np.vstack((np.zeros(len(at)), rng.multivariate_normal(np.zeros(len(at)), spread, _DRAWS, method="eigh")))
    rows = {name: np.full(1 + _DRAWS, found[name].value) for name in names}
    rows = {name: np.where(np.isnan(row), 0.0, row) for name, row in rows.items()}
    for place, own in zip(at, noise.T, strict=True):
        name = found.free[place]
        least = 1e-3 * abs(found[name].value) if name in (*NEEDED, "lag") else -math.inf
        rows[name] = np.maximum(rows[name] + own, least)
    return rows


def _interval(row: Array) -> tuple[float, float, float]:
    """Return the first of the values, that of the fit, and an interval about it from all others that there are."""
    value, others = float(row[0]), row[1:][np.isfinite(row[1:])]
    if math.isnan(value) or len(others) < _DRAWS // 2:
        return value, math.nan, math.nan
    half = NORMAL_QUANTILE * float(others.std())
    return value, max(value - half, 0.0), value + half


class _Run:
    """Vehicles side by side that go straight ahead at the speed of the approach until an order is given."""

    def __init__(self, kind: str, rows: Mapping[str, Array], begin: Approach) -> None:
        self.n, self.order, U = len(rows["lag"]), begin.order, begin.speed
        zero = np.zeros(self.n)
        self.kind, self.coefficients = kind, [rows[name] for name in COEFFICIENTS]
        self.stern = Stern(*(rows.get(name, zero) for name in Stern._fields))
        masses, drags = self.coefficients[:3], self.coefficients[3:6]
        relaxations = [float(np.median(m / d)) for m, d in zip(masses, drags, strict=True)]
        crossing = float(np.median(rows["arm"])) / U if kind != "force" else math.inf
        self.dt = RATE * min(*relaxations, crossing)
        one = [Response.of(lag, math.inf, math.inf, self.dt) for lag in rows["lag"].tolist()]
        self.response = Response(*(np.array(column) for column in zip(*one, strict=True)))
        self.state: State = (zero, zero, zero, zero + U, zero, zero)
        self.ahead = (rows["d11"] + rows["X_uu"] * U) * U  # the thrust that holds the speed, or its revolutions
        if kind == "revolutions":
            failed = self.stern.T_nu * U
            self.ahead = (failed + np.sqrt(failed**2 + 4 * self.stern.T_nn * self.ahead)) / (2 * self.stern.T_nn)
        self.acting: tuple[Array, Array] = (self.ahead, zero + (rows["neutral"] if kind != "force" else 0.0))

    def step(self, side: Array) -> None:
        """Go on for `dt` with an order to one side, 1 or -1, and the thrust or the revolutions as before."""
        acting, self.acting = respond(self.acting, (self.ahead, side * self.order), self.response, ARRAYS)
        load = acting[0], 0.0 * self.ahead, acting[1]
        if self.kind != "force":
            _, _, _, u, v, r = self.state
            T = thrust(acting[0], u, self.stern) if self.kind == "revolutions" else acting[0]
            load = stern_load(T, acting[1], u, v, r, self.stern, ARRAYS)
        self.state = rk4_step(self.state, load, self.coefficients, self.dt, (0.0, 0.0), ARRAYS)


def _turning_circle(run: _Run) -> tuple[Array, Array, Array]:
    """Return advance, transfer and tactical diameter [m]; nan where the heading does not come so far."""
    advance, transfer, diameter = (np.full(run.n, np.nan) for _ in range(3))
    for _ in range(_STEPS):
        run.step(np.ones(run.n))
        x, y, psi = run.state[:3]
        quarter, half = np.isnan(advance) & (psi >= 0.5 * math.pi), np.isnan(diameter) & (psi >= math.pi)
        advance, transfer = np.where(quarter, x, advance), np.where(quarter, y, transfer)
        diameter = np.where(half, y, diameter)
        if not np.isnan(diameter).any():
            break
    return advance, transfer, diameter


def _zig_zag(run: _Run, band: float) -> tuple[Array, Array]:
    """Return first and second overshoot [rad] of the heading beyond the band at which the rudder is turned over."""
    n = run.n
    side, executes, peak, overshoots = np.ones(n), np.ones(n), np.zeros(n), np.full((2, n), np.nan)
    for _ in range(_STEPS):
        run.step(side)
        peak = np.maximum(peak, -side * run.state[2])  # how far it runs on to the side that the rudder has left
        turned = side * run.state[2] >= band
        for k in (0, 1):
            overshoots[k] = np.where(turned & (executes == k + 2), peak - band, overshoots[k])
        side, executes, peak = np.where(turned, -side, side), executes + turned, np.where(turned, band, peak)
        if (executes > 3).all():
            break
    return overshoots[0], overshoots[1]

"""What seafarers ask of a vehicle: the turning circle and the zig-zag of IMO MSC.137(76), in the simulator.

International Maritime Organization, resolution MSC.137(76), "Standards for ship manoeuvrability", 2002, sections 5 and
6: of the turning circle advance and transfer, at 90 degrees, and tactical diameter, at 180 degrees; of the zig-zag the
overshoot of the heading behind the second and third execute. The order to the rudder is one of yaw moment here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from auv_gym.physics.actuators import Response, respond
from auv_gym.physics.dynamics import State, rk4_step
from auv_gym.physics.namespaces import ARRAYS, Array
from auv_gym.physics.vehicle import Coefficients
from baselines.identification.fit import Identified
from baselines.identification.model import COEFFICIENTS
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
    moment: float  # [N m]


def approach(found: Identified) -> Approach:
    """Return the mean speed of the log, and the median of the yaw moments that it commands and the actuator gives."""
    log = found.model.log
    ahead = np.abs(log.measured[:, 3])
    moments = np.abs(log.commands[:, 1])
    moments = moments[moments > 0] if moments.any() else np.ones(1)
    return Approach(float(ahead.mean()), float(min(np.median(moments), found["F_r_max"].value)))


def figures(found: Identified, begin: Approach, seed: int = 0) -> tuple[_Figure, ...]:
    """Return the figures of an identified vehicle; nothing where it lacks a parameter.

    Args:
        found: the fit, whose covariance makes the intervals.
        begin: speed and order.
        seed: of the vehicles that are drawn for the intervals.
    """
    if found.unknown:
        return ()
    coefficients, lags = _drawn(found, np.random.default_rng(seed))
    rows = [(name, "m", row) for name, row in zip(CIRCLE, _turning_circle(coefficients, lags, begin), strict=True)]
    for degrees in ZIG_ZAGS:
        for which, row in zip(
            ("first", "second"), _zig_zag(coefficients, lags, begin, math.radians(degrees)), strict=True
        ):
            rows.append((f"{which} overshoot, zig-zag at {degrees:g} degrees", "degrees", np.degrees(row)))
    return tuple(_Figure(name, unit, *_interval(row)) for name, unit, row in rows)


def _drawn(found: Identified, rng: np.random.Generator) -> tuple[Coefficients, Array]:
    """Return the fitted vehicle and those that the log does not tell from it, rows of shape (1 + DRAWS,), and lags."""
    at = [found.free.index(name) for name in (*COEFFICIENTS, "lag") if name in found.free]
    names = [found.free[i] for i in at]
    spread = found.covariance[np.ix_(at, at)]
    noise = np.vstack((np.zeros(len(at)), rng.multivariate_normal(np.zeros(len(at)), spread, _DRAWS, method="eigh")))
    rows = {name: np.full(1 + _DRAWS, found[name].value) for name in (*COEFFICIENTS, "lag")}
    rows = {name: np.where(np.isnan(row), 0.0, row) for name, row in rows.items()}
    for name, own in zip(names, noise.T, strict=True):
        least = 1e-3 * abs(found[name].value) if name[0] in "mdl" else -math.inf
        rows[name] = np.maximum(rows[name] + own, least)
    return Coefficients(*(rows[name] for name in COEFFICIENTS)), rows["lag"]


def _interval(row: Array) -> tuple[float, float, float]:
    """Return the first of the values, that of the fit, and an interval about it from all others that there are."""
    value, others = float(row[0]), row[1:][np.isfinite(row[1:])]
    if math.isnan(value) or len(others) < _DRAWS // 2:
        return value, math.nan, math.nan
    half = NORMAL_QUANTILE * float(others.std())
    return value, max(value - half, 0.0), value + half


class _Run:
    """Vehicles side by side that go straight ahead at the speed of the approach until an order is given."""

    def __init__(self, coefficients: Coefficients, lags: Array, begin: Approach) -> None:
        zero = np.zeros(len(lags))
        self.coefficients = coefficients
        self.dt = RATE * min(float(np.median(m / d)) for m, d in zip(coefficients[:3], coefficients[3:6], strict=True))
        one = [Response.of(lag, math.inf, math.inf, self.dt) for lag in lags.tolist()]
        self.response = Response(*(np.array(column) for column in zip(*one, strict=True)))
        self.state: State = (zero, zero, zero, zero + begin.speed, zero, zero)
        drag = (coefficients.d11 + coefficients.X_uu * begin.speed) * begin.speed
        self.force: tuple[Array, Array] = (drag, zero)
        self.thrust = drag

    def step(self, moment: Array) -> None:
        """Go on for `dt` with an order of yaw moment [N m], the thrust as before."""
        acting, self.force = respond(self.force, (self.thrust, moment), self.response, ARRAYS)
        load = (acting[0], 0.0 * self.thrust, acting[1])
        self.state = rk4_step(self.state, load, self.coefficients, self.dt, (0.0, 0.0), ARRAYS)


def _turning_circle(coefficients: Coefficients, lags: Array, begin: Approach) -> tuple[Array, Array, Array]:
    """Return advance, transfer and tactical diameter [m]; nan where the heading does not come so far."""
    run = _Run(coefficients, lags, begin)
    advance, transfer, diameter = (np.full(len(lags), np.nan) for _ in range(3))
    for _ in range(_STEPS):
        run.step(np.full(len(lags), begin.moment))
        x, y, psi = run.state[:3]
        quarter, half = np.isnan(advance) & (psi >= 0.5 * math.pi), np.isnan(diameter) & (psi >= math.pi)
        advance, transfer = np.where(quarter, x, advance), np.where(quarter, y, transfer)
        diameter = np.where(half, y, diameter)
        if not np.isnan(diameter).any():
            break
    return advance, transfer, diameter


def _zig_zag(coefficients: Coefficients, lags: Array, begin: Approach, band: float) -> tuple[Array, Array]:
    """Return first and second overshoot [rad] of the heading beyond the band at which the rudder is turned over."""
    run, n = _Run(coefficients, lags, begin), len(lags)
    side, executes, peak, overshoots = np.ones(n), np.ones(n), np.zeros(n), np.full((2, n), np.nan)
    for _ in range(_STEPS):
        run.step(side * begin.moment)
        peak = np.maximum(peak, -side * run.state[2])  # how far it runs on to the side that the rudder has left
        turned = side * run.state[2] >= band
        for k in (0, 1):
            overshoots[k] = np.where(turned & (executes == k + 2), peak - band, overshoots[k])
        side, executes, peak = np.where(turned, -side, side), executes + turned, np.where(turned, band, peak)
        if (executes > 3).all():
            break
    return overshoots[0], overshoots[1]

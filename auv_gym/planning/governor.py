"""Reference governor: a time law of the path that leaves a reserve of force and torque in the mean current.

The paper's plan is for still water, and its loads may be as large as the limits of the actuators. In a current the
vehicle must move otherwise through the water, and fins give less torque where that motion is slow. The governor changes
how fast the path is followed. It knows what a forecast knows: the mean current and the root mean square of the wave
forces. References: E. Garone, S. Di Cairano and I. Kolmanovsky, "Reference and command governors for systems with
constraints", Automatica 75:306-328, 2017; O. Dahl and L. Nielsen, "Torque-limited path following by online trajectory
time scaling", IEEE Transactions on Robotics and Automation 6:554-561, 1990.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from auv_gym.physics.actuators import Actuators
from auv_gym.physics.disturbances import Waves
from auv_gym.physics.intervals import check_number
from auv_gym.physics.namespaces import ARRAYS, Array
from auv_gym.physics.vehicle import Vehicle
from auv_gym.planning.feasibility import sideslip_allowed, torque_limit
from auv_gym.planning.paths import Path, Retimed
from auv_gym.planning.paths.base import by_time
from auv_gym.planning.sideslip import RATES, in_sideslip, path_rates, steady_sideslip

WAVES = 2.0
"""Multiple of the root mean square of the wave forces that counts as a load."""
_SMOOTHING = 20.0  # standard deviation of the filter of the rate, in units of `Vehicle.time`
_KNOT = 5.0  # time between two rates, in the same units
_CHOICES = 20  # number of rates below 1 that are compared, and of rates above 1


@dataclass(frozen=True)
class Governor:
    """Bounds of a governed plan.

    At each place of the path the rate nearest to 1 is chosen at which the loads of steady motion, and twice the root
    mean square of the waves, leave the reserve; if there is none, the rate that leaves most. The rates are smoothed.

    Raises:
        ValueError: a number is out of range.
    """

    reserve: float = 0.4  # share of both limits that the loads leave
    slowest: float = 0.5  # smallest pace of the path, relative to its own
    fastest: float = 2.0  # largest pace

    def __post_init__(self) -> None:
        check_number("governor reserve", self.reserve, 0, 0.9)
        check_number("governor slowest", self.slowest, 0.05, 1)
        check_number("governor fastest", self.fastest, 1, 20)

    def governed(
        self,
        path: Path,
        vehicle: Vehicle,
        actuators: Actuators,
        current: tuple[float, float] = (0.0, 0.0),
        waves: Waves | None = None,
        *,
        duration: float,
    ) -> Path:
        """Return the path with the governed time law; the path itself if its own pace leaves the reserve everywhere.

        Args:
            path: the path, defined from 0 on.
            vehicle: the known vehicle model.
            actuators: limits of the actuators.
            current: mean velocity of the water [m/s], world axes.
            waves: forces of the waves, if there are any.
            duration: time that the plan must last [s].
        """
        interval = _KNOT * vehicle.time
        end = min(self.fastest * duration, path.end)
        s = np.linspace(0.0, end, 1 + math.ceil(end / (self.slowest * interval)))
        slower = np.linspace(math.log(self.slowest), 0, _CHOICES)
        rates = np.exp(np.append(slower, np.linspace(0, math.log(self.fastest), _CHOICES)[1:]))
        left = reserves(path.derivatives(s), rates, vehicle, actuators, current, waves)
        distance = np.where(left >= self.reserve, abs(np.log(rates))[:, None], math.inf)
        best = np.where(np.isfinite(distance.min(axis=0)), distance.argmin(axis=0), left.argmax(axis=0))
        if (rates[best] == 1.0).all():
            return path
        return _retimed(path, s, _smoothed(rates[best], s[1], vehicle), interval, duration)


def reserves(
    derivatives: Array,
    rates: Array,
    vehicle: Vehicle,
    actuators: Actuators,
    current: tuple[float, float],
    waves: Waves | None = None,
) -> Array:
    """Return the smaller share of the two limits that is left in steady motion on a path, shape (K, T).

    The share is negative where a load exceeds its limit, and -inf where the vehicle cannot move so.

    Args:
        derivatives: position and three time derivatives of the path at T places, shape (4, 2, T).
        rates: K rates at which the path is followed.
        vehicle: see `Governor.governed`.
        actuators: see `Governor.governed`.
        current: see `Governor.governed`.
        waves: see `Governor.governed`.
    """
    each = np.repeat(rates, derivatives.shape[2])
    moved = by_time(np.tile(derivatives, len(rates)), each, np.zeros_like(each), np.zeros_like(each))
    moved[1] -= np.reshape(current, (2, 1))  # through the water
    with np.errstate(all="ignore"):  # a motion that is impossible gives nan
        along: Any = path_rates(moved)
        if vehicle.has_cross_terms:
            # Imported here: it loads the compiler of equations, and scenarios without a governor need none of it.
            from auv_gym.planning.crossed import motion, steady_sideslips

            rows, acting = np.array([getattr(along, name) for name in RATES]), np.array(vehicle.acting)
            w = steady_sideslips(rows, acting)[0]
            (_, u, _, _, F_u, F_r, _), possible = motion(rows, w, acting)
        else:
            w = steady_sideslip(along, vehicle, ARRAYS)
            _, u, _, _, F_u, F_r, _ = in_sideslip(along, w, vehicle.coefficients, (0.0, 0.0), ARRAYS)
            possible = np.ones(len(each), dtype=bool)
        limits = actuators.F_u_max, actuators.F_r_max, actuators.fin
        surge = np.where(F_u < 0, actuators.astern, 1.0) * actuators.F_u_max
        by_waves = (WAVES * waves.surge, WAVES * waves.yaw) if waves else (0.0, 0.0)
        left = np.minimum(
            1 - (abs(F_u) + by_waves[0]) / surge, 1 - (abs(F_r) + by_waves[1]) / torque_limit(u, limits, ARRAYS)
        )
        possible = possible & np.asarray(sideslip_allowed(w)) & np.isfinite(left)
    return np.where(possible, left, -math.inf).reshape(len(rates), -1)


def _smoothed(rates: Array, step: float, vehicle: Vehicle) -> Array:
    """Return the rates at places of the path at intervals of `step` [s], smoothed."""
    from scipy.ndimage import gaussian_filter1d

    return np.asarray(np.exp(gaussian_filter1d(np.log(rates), _SMOOTHING * vehicle.time / step, mode="nearest")))


def _retimed(path: Path, s: Array, rates: Array, interval: float, duration: float) -> Path:
    """Return the path that is followed at these rates at the places s [s] of its own time law."""
    from scipy.integrate import cumulative_trapezoid

    knots = interval * np.arange(max(4, 2 + math.ceil(duration / interval)))
    at_knots = np.interp(knots, cumulative_trapezoid(1 / rates, s, initial=0), rates)
    if math.isfinite(path.end):  # a path that would end too early is followed more slowly
        at_knots *= min(1.0, path.end / (1.01 * interval * at_knots.sum()))
    return Retimed(path, interval, tuple(at_knots.tolist()))

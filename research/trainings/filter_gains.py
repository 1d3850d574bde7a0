"""Compute the gains of the agents' filters from a Riccati equation: `python -m research filter-gains`.

The model is linearised about straight motion at a speed U, in body axes. One step is z' = A z + w, and the measurement
is y = H z + n. The covariances of w and n are Q and R. The covariance P of the prediction error converges to the
solution of P = A P A^T + Q - A P H^T (H P H^T + R)^-1 H P A^T. The gain is K = P H^T (H P H^T + R)^-1. It is computed
at `_SPEEDS`, and each entry is fitted by a polynomial in `filters.speed_share`. The two speed ranges have their own
polynomials, because their sensors and control periods differ.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.linalg import solve_discrete_are

from auv_gym.physics.namespaces import FLOATS, Array
from auv_gym.physics.vehicle import PAPER_VEHICLE, Vehicle
from auv_gym.scenarios.presets import PRESETS, SPEED_RANGES
from auv_gym.scenarios.scenario import Scenario
from baselines.agents.filters import ACROSS, ACROSS_MEASURED, ALONG, ALONG_MEASURED, FILTER_GAINS, LAGS, speed_share
from baselines.estimation.filter_equations import FilterUnits, excitation
from baselines.estimation.kalman import Tuning
from baselines.estimation.sea_model import PLACE, STATE_SIZE, Estimate, measurement, transition
from baselines.policy import CRUISE_SPEED
from baselines.tools.files import write_atomically

_SPEEDS = {"slow": (0.06, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4), "cruise": (0.41, 0.5, 0.65, 0.8, 1.0, 1.25, 1.5, 2.0)}
"""Speeds [m/s] at which the Riccati equation is solved, by speed range."""
DEGREE = 3  # degree of the polynomials
TUNINGS = (
    Tuning(0.0045, 0.004, 0.014, 0.2, 0.1, 0.4, 0.23, 0.45, 0.15, 1.0),
    Tuning(0.00005, 0.00006, 0.00008, 0.0008, 0.0005, 0.0015, 0.00015, 0.00015, 0.00015, 1.0),
)
"""Process noise in a rough and in a calm sea, similar to that of the tuned filter of `nmpc`."""
FORCE_NOISE = 0.02
"""Standard deviation of the actuator forces after one second, relative to their limits; their lag is unknown."""
_STEP = 1e-6  # step of the central differences of the model, SI units


def model(speed: float, lag: float, vehicle: Vehicle = PAPER_VEHICLE) -> tuple[Array, Array, float]:
    """Return A (22, 22) and H (6, 22) about straight motion at a speed [m/s], and the control period [s]."""
    dt = storm_at(speed).control_dt
    steady = np.zeros(STATE_SIZE)
    steady[PLACE.u], steady[PLACE.lag] = speed, lag
    F_u = (vehicle.d11 + vehicle.X_uu * speed) * speed
    steady[PLACE.F_u] = F_u

    def predicted(z: Array) -> Any:
        return transition(Estimate(*z.tolist()), (F_u, 0.0), (0.0, 0.0), dt, vehicle.coefficients, FLOATS)

    def measured(z: Array) -> Any:
        return measurement(Estimate(*z.tolist()), FLOATS)

    A, H = (
        np.array([np.subtract(f(steady + d), f(steady - d)) / (2 * _STEP) for d in _STEP * np.eye(STATE_SIZE)]).T
        for f in (predicted, measured)
    )
    return A, H, dt


def storm_at(speed: float) -> Scenario:
    """Return the preset `storm` of the speed range that contains a speed [m/s]."""
    return PRESETS["cruise-storm" if speed > CRUISE_SPEED else "slow-storm"]


def problem(
    speed: float, lag: float, tuning: Tuning, vehicle: Vehicle = PAPER_VEHICLE
) -> tuple[Array, Array, Array, Array]:
    """Return A (21, 21), H (6, 21), Q (21, 21), R (6, 6) of the Riccati equation at a speed [m/s], without the lag."""
    A, H, dt = model(speed, lag, vehicle)
    storm = storm_at(speed)
    act, kept = storm.actuators, [i for i in range(STATE_SIZE) if i != PLACE.lag]
    c = vehicle.coefficients
    units = FilterUnits(speed, [d * speed for d in (c.d11, c.d22, c.d33)], (act.F_u_max, act.F_r_max))
    Q = np.array(excitation(dt, units, tuning), dtype=float)
    for i, limit in ((PLACE.F_u, act.F_u_max), (PLACE.F_r, act.F_r_max)):
        Q[i, i] = (FORCE_NOISE * tuning.acceleration / TUNINGS[0].acceleration * limit * speed) ** 2 * dt
    R = np.diag(np.square(storm.sensors.noise))
    return A[np.ix_(kept, kept)], H[:, kept], Q[np.ix_(kept, kept)], R


def gain(speed: float, lag: float, tuning: Tuning, vehicle: Vehicle = PAPER_VEHICLE) -> Array:
    """Return the steady-state gain K (22, 6) at a speed [m/s], in SI units. The row of the lag is zero."""
    A, H, Q, R = problem(speed, lag, tuning, vehicle)
    P = solve_discrete_are(A.T, H.T, Q, R)
    return np.insert(np.linalg.solve(H @ P @ H.T + R, H @ P).T, PLACE.lag, 0.0, axis=0)


def _table(speed_range: str, tuning: Tuning, lag: float) -> dict[str, Any]:
    """Return the polynomials of the gains of a filter in a speed range, in the format of `filters.gains`."""
    speeds, at = _SPEEDS[speed_range], Estimate._fields.index  # the six measured entries have the same indices
    K = np.array([gain(speed, lag, tuning) for speed in speeds])
    powers = np.vander([speed_share(U) for U in speeds], DEGREE + 1, increasing=True)
    fit = np.linalg.lstsq(powers, K.reshape(len(speeds), -1), rcond=None)[0].reshape(DEGREE + 1, *K.shape[1:])
    return {
        name: [[[float(f"{c:.6g}") for c in fit[:, at(a), at(b)]] for b in measured] for a in entries]
        for name, entries, measured in (("along", ALONG, ALONG_MEASURED), ("across", ACROSS, ACROSS_MEASURED))
    }


def text() -> str:
    """Return the text of the file with the gains of all filters."""
    known = list(zip(TUNINGS, LAGS, strict=True))
    record = {speed_range: [_table(speed_range, *own) for own in known] for speed_range in SPEED_RANGES}
    return json.dumps(record) + "\n"


def main(_: Sequence[str]) -> int:
    """Write the file of the gains and return the exit status."""
    write_atomically(FILTER_GAINS, text().encode())
    return 0

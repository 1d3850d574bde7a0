"""Compute the gains of the agents' filters from a Riccati equation: `python -m research filter-gains`.

The model is linearised about straight motion at a speed U, in body axes. One step is z' = A z + w, and the measurement
is y = H z + n. The covariances of w and n are Q and R. The covariance P of the prediction error converges to the
solution of P = A P A^T + Q - A P H^T (H P H^T + R)^-1 H P A^T. The gain is K = P H^T (H P H^T + R)^-1. It is computed
at `_SPEEDS` for each pair of noise levels, and each entry is fitted by a polynomial in `filters.speed_share`. The two
speed ranges have their own polynomials, because their sensors and control periods differ. The filter for faults has two
more states, the biases of the measured velocities u and v, which are random walks.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.linalg import block_diag, solve_discrete_are

from auv_gym.physics.namespaces import FLOATS, Array
from auv_gym.physics.vehicle import PAPER_VEHICLE, Vehicle
from auv_gym.scenarios.presets import PRESETS, SPEED_RANGES, TYPICAL_NOISE
from auv_gym.scenarios.scenario import Scenario
from baselines.agents.filters import (
    ACROSS_MEASURED,
    ALONG_MEASURED,
    BIAS_ROWS,
    BIASED,
    FILTER_GAINS,
    LAGS,
    POSITION_LEVELS,
    VELOCITY_LEVELS,
    entries_of,
    speed_share,
)
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
    Tuning(0.0045, 0.004, 0.014, 0.2, 0.1, 0.4, 0.23, 0.45, 0.15, 1.0),
)
"""Process noise in a rough sea, in a calm sea and with faults, similar to that of the tuned filter of `nmpc`."""
FORCE_NOISE = 0.02
"""Standard deviation of the actuator forces after one second, relative to their limits; their lag is unknown."""
BIAS_DRIFT = 0.003  # [1] drift of a bias of the velocity after one second, over the speed
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
    speed: float, i: int, levels: tuple[float, float] = (1.0, 1.0), vehicle: Vehicle = PAPER_VEHICLE
) -> tuple[Array, Array, Array, Array]:
    """Return A (n, n), H (6, n), Q (n, n), R (6, 6) of the Riccati equation at a speed [m/s], without the lag.

    Args:
        speed: of the motion [m/s].
        i: index of the filter; n is 21, and 23 for the filter `BIASED`.
        levels: of the noise of position and velocity.
        vehicle: of the model.
    """
    tuning, (A, H, dt) = TUNINGS[i], model(speed, LAGS[i], vehicle)
    storm = storm_at(speed)
    act, kept = storm.actuators, [i for i in range(STATE_SIZE) if i != PLACE.lag]
    c = vehicle.coefficients
    units = FilterUnits(speed, [d * speed for d in (c.d11, c.d22, c.d33)], (act.F_u_max, act.F_r_max))
    Q = np.array(excitation(dt, units, tuning), dtype=float)
    for j, limit in ((PLACE.F_u, act.F_u_max), (PLACE.F_r, act.F_r_max)):
        Q[j, j] = (FORCE_NOISE * tuning.acceleration / TUNINGS[0].acceleration * limit * speed) ** 2 * dt
    A, H, Q = A[np.ix_(kept, kept)], H[:, kept], Q[np.ix_(kept, kept)]
    if i == BIASED:
        A, Q = block_diag(A, np.eye(2)), block_diag(Q, (BIAS_DRIFT * speed) ** 2 * dt * np.eye(2))
        H = np.hstack((H, np.eye(6)[:, 3:5]))
    noise = np.array(TYPICAL_NOISE["cruise" if speed > CRUISE_SPEED else "slow"].noise)
    noise *= levels[0], levels[0], 1.0, levels[1], levels[1], 1.0
    return A, H, Q, np.diag(np.square(noise))


def gain(speed: float, i: int, levels: tuple[float, float] = (1.0, 1.0), vehicle: Vehicle = PAPER_VEHICLE) -> Array:
    """Return the steady-state gain K of filter i at a speed [m/s], in SI units, (22, 6), or (24, 6) with biases.

    The row of the lag is zero. The arguments are those of `problem`.
    """
    A, H, Q, R = problem(speed, i, levels, vehicle)
    P = solve_discrete_are(A.T, H.T, Q, R)
    return np.insert(np.linalg.solve(H @ P @ H.T + R, H @ P).T, PLACE.lag, 0.0, axis=0)


def _table(speed_range: str, i: int) -> dict[str, Any]:
    """Return the polynomials of the gains of filter i in a speed range, in the format of `filters.gains`."""
    speeds, names = _SPEEDS[speed_range], (*Estimate._fields, *BIAS_ROWS)
    powers = np.vander([speed_share(U) for U in speeds], DEGREE + 1, increasing=True)
    K = np.array([[gain(U, i, (p, v)) for U in speeds] for p in POSITION_LEVELS for v in VELOCITY_LEVELS])
    rows = K.swapaxes(0, 1).reshape(len(speeds), -1)
    fit = np.linalg.lstsq(powers, rows, rcond=None)[0].reshape(DEGREE + 1, *K.swapaxes(0, 1).shape[1:])
    cells = fit.swapaxes(0, 1).reshape(-1, *K.shape[2:])  # for each pair of levels the coefficients
    return {
        side: [
            [[float(f"{c:.4g}") for c in cells[:, names.index(a), names.index(b)]] for b in measured] for a in entries
        ]
        for side, entries, measured in zip(
            ("along", "across"), entries_of(i), (ALONG_MEASURED, ACROSS_MEASURED), strict=True
        )
    }


def _plain(row: Array) -> list[float]:
    return [float(f"{c:.4g}") for c in row]


def text() -> str:
    """Return the text of the file with the gains of all filters."""
    record = {speed_range: [_table(speed_range, i) for i in range(len(LAGS))] for speed_range in SPEED_RANGES}
    return json.dumps(record) + "\n"


def main(_: Sequence[str]) -> int:
    """Write the file of the gains and return the exit status."""
    write_atomically(FILTER_GAINS, text().encode())
    return 0

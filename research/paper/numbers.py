"""Numbers of the paper, printed and recomputed.

F. Repoulias and E. Papadopoulos, "Trajectory planning and tracking control of underactuated AUVs", ICRA 2005, sections
III and V.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

from auv_gym.physics.namespaces import Array
from auv_gym.physics.vehicle import PAPER_VEHICLE, Vehicle
from auv_gym.planning.paths import PAPER_CIRCLE, Circle
from auv_gym.planning.planner import plan
from auv_gym.planning.sideslip import path_rates
from baselines.control.backstepping import GAINS
from research.paper.closed_loop import TIMES, ClosedLoopResponse, closed_loop_response, last_outside
from research.paper.noise_study import POSITION_NOISE, NoiseRun, noise_study
from research.paper.stability import (
    closed_loop_eigenvalues,
    derived_sign_forces,
    first_instability,
    spectral_abscissa,
)

PAPER_GAINS = GAINS["paper"]  # gains that the paper prints
SIGNS = tuple(itertools.product((1, -1), repeat=3))
"""Signs of x_e, y_e, psi_e: the paper prints moduli only."""
_STARTS = np.array(SIGNS).T * np.array([[0.5], [1.0], [math.radians(20.0)]])
"""Initial errors of section V, x_e, y_e [m], psi_e [rad], shape (3, 8)."""
CHOSEN = SIGNS.index((1, -1, 1))
"""Start in the figures: it needs the least surge force of the eight, and the paper mentions low effort."""
FLOOR_TIME = 80.0
"""Time [s] after which the remaining error is taken as the error floor of the integrator."""


@dataclass(frozen=True)
class TableRow:
    """One quantity: printed and recomputed value."""

    quantity: str
    place: str  # in the paper
    paper: float | None  # None: the paper prints no number
    measured: float
    unit: str
    agrees: bool | None  # None: there is nothing to compare
    note: str = ""


class StartRow(NamedTuple):
    """Response of section V from the start with one combination of signs."""

    signs: str  # of x_e, y_e, psi_e
    settling_5cm_s: float
    settling_1deg_s: float
    peak_F_u_N: float
    peak_F_r_Nm: float
    error_100s_m: float


@dataclass(frozen=True)
class Reproduction:
    """All recomputed numbers and responses of the paper."""

    rows: list[TableRow]
    starts: list[StartRow]
    remarks: list[TableRow]
    response: ClosedLoopResponse  # of the closed loop from the eight starts


@cache
def reproduce_paper() -> Reproduction:
    """Return the reproduction."""
    response = closed_loop_response(_STARTS)
    rows = planner_rows() + printed_equation_rows() + closed_loop_rows(response) + stability_rows()
    return Reproduction(rows + noise_rows(noise_study()), start_rows(response), remarks(), response)


def _printed(
    quantity: str, place: str, paper: float, measured: float, unit: str, last_digit: float, note: str = ""
) -> TableRow:
    """Return a row that agrees if the numbers differ by less than one unit of the last digit printed."""
    return TableRow(quantity, place, paper, measured, unit, abs(measured - paper) < last_digit, note)


def planner_rows() -> list[TableRow]:
    """Return the rows of the example of section III: the planner on the paper's circle."""
    times = np.array([0.0, 1.0])
    along = path_rates(PAPER_CIRCLE.derivatives(times))
    u, v, r, F_u, F_r = plan(PAPER_CIRCLE, PAPER_VEHICLE, times).table[0, 3:].tolist()
    gamma = math.degrees(math.atan2(v, u))
    off = 100 * abs(F_r / -0.488 - 1)
    return [
        _printed("path speed v_p", "(3)", 0.1, float(along.v_p[0]), "m/s", 1e-6),
        _printed("path turn rate omega", "(5)", -0.01, float(along.omega[0]), "rad/s", 1e-6),
        _printed("sideslip gamma", "(8)", 1.23, gamma, "deg", 0.01),
        _printed("surge velocity u_R", "(15)", 0.099, u, "m/s", 0.001, "the paper truncates"),
        _printed("sway velocity v_R", "(11)", 0.0021, v, "m/s", 0.0001),
        _printed("yaw rate r_R", "(14)", -0.01, r, "rad/s", 1e-6),
        _printed("surge force F_uR", "(16a)", 7.004, F_u, "N", 0.001),
        _printed("yaw torque F_rR", "(16b)", -0.488, F_r, "N m", 0.001, f"{off:.1f} % off, more than a rounding"),
    ]


def printed_surge_rate(u_R: float, v_p: float, v_p_dot: float, omega: float, vehicle: Vehicle) -> float:
    """Return u_R' [m/s^2] by (15) as printed, with the norm v_p^3 in place of its v_R^3, as (15') confirms.

    It is for comparison only: it holds for clockwise curves (omega < 0) and is singular at u_R = v_p.
    """
    m11, m22, d22 = vehicle.m11, vehicle.m22, vehicle.d22
    root = math.sqrt(max(v_p * v_p - u_R * u_R, 0.0))
    bracket = d22 * u_R**2 * v_p - d22 * v_p**3 - m11 * omega * u_R * v_p * root
    return (bracket + m11 * u_R**2 * v_p_dot - m22 * v_p_dot * v_p**2) / (u_R * v_p * (m11 - m22))


def settled_surge(omega: float) -> float:
    """Return the u_R [m/s] that (15) as printed converges to from 1e-3 m/s, on a circle at the paper's speed."""
    v_p = PAPER_CIRCLE.speed

    def rate(_: float, u: Array) -> list[float]:
        return [printed_surge_rate(float(u[0]), v_p, 0.0, omega, PAPER_VEHICLE)]

    return float(solve_ivp(rate, (0.0, 20.0), [1e-3], rtol=1e-10, atol=1e-12).y[0, -1])


def printed_equation_rows() -> list[TableRow]:
    """Return the rows of (15'): its coefficients, which determine four parameters of the vehicle, and its solution."""
    v, v_p, omega = PAPER_VEHICLE, PAPER_CIRCLE.speed, PAPER_CIRCLE.turn_rate
    tenfold = "the bracket is printed divided by ten"
    return [
        _printed("factor 10 / (m22 - m11)", "(15')", 0.2, 10 / (v.m22 - v.m11), "1/kg", 1e-9, tenfold),
        _printed("coefficient d22 / 10", "(15')", 10.0, v.d22 / 10, "kg/s", 1e-9, tenfold),
        _printed("coefficient d22 v_p^2 / 10", "(15')", 0.1, v.d22 * v_p**2 / 10, "kg m^2/s^3", 1e-9, tenfold),
        _printed("coefficient m11 |omega| / 10", "(15')", 0.215, v.m11 * abs(omega) / 10, "kg/s", 1e-9, tenfold),
        _printed("u_R integrated from 1e-3 m/s", "(15')", 0.099, settled_surge(omega), "m/s", 0.001, "as planned"),
    ]


def start_rows(response: ClosedLoopResponse) -> list[StartRow]:
    """Return settling times, peaks and final error for each start."""
    distance, psi_e, (F_u, F_r) = response.position_error, response.errors[2], response.force
    return [
        StartRow(
            " ".join("+" if sign > 0 else "-" for sign in signs),
            last_outside(distance[i], 0.05),
            last_outside(psi_e[i], math.radians(1.0)),
            float(np.abs(F_u[i]).max()),
            float(np.abs(F_r[i]).max()),
            float(distance[i, -1]),
        )
        for i, signs in enumerate(SIGNS)
    ]


def integrator_floor() -> tuple[float, float, float]:
    """Return the remaining position [m], heading [deg] and velocity error [m/s] of RK45 with SciPy's tolerances."""
    loose = [closed_loop_response(start[:, None], "RK45", rtol=1e-3, atol=1e-6) for start in _STARTS.T]
    late = TIMES >= FLOOR_TIME
    errors = np.concatenate([response.errors[:, :, late] for response in loose], axis=1)
    position, velocity = np.hypot(errors[0], errors[1]), np.abs(errors[3:5])
    return float(position.max()), float(np.degrees(np.abs(errors[2]).max())), float(velocity.max())


def closed_loop_rows(response: ClosedLoopResponse) -> list[TableRow]:
    """Return the rows of the claims of section V about convergence; `start_rows` has the single starts."""
    floor_m, floor_deg, floor_v = integrator_floor()
    last = float(response.position_error[:, -1].max())
    loose = f"RK45 with rtol 1e-3 and atol 1e-6, largest after {FLOOR_TIME:.0f} s"
    in_rad = f"{math.radians(floor_deg):.2g} rad: the paper's 1e-5 deg is probably in rad"
    exact = "largest of eight starts; the paper's 1e-5 is its integrator's, not the law's"
    return [
        TableRow("position error at 100 s", "Fig. 6", 1e-5, last, "m", last < 1e-5, exact),
        TableRow("floor of the position error", "Fig. 6", 1e-5, floor_m, "m", _same_order(floor_m), loose),
        TableRow("floor of the velocity error", "Fig. 5", 1e-5, floor_v, "m/s", _same_order(floor_v), loose),
        TableRow("floor of the heading error", "Fig. 6", 1e-5, floor_deg, "deg", _same_order(floor_deg), in_rad),
    ]


def _same_order(value: float) -> bool:
    """Return whether a value has the order of the paper's 1e-5, within a factor of the square root of ten."""
    return abs(math.log10(value / 1e-5)) < 0.5


def stability_rows() -> list[TableRow]:
    """Return the rows of the linearised printed law with the paper's gains."""
    eigenvalues = closed_loop_eigenvalues(PAPER_VEHICLE, PAPER_GAINS, PAPER_CIRCLE.speed, PAPER_CIRCLE.turn_rate)
    listed = ", ".join(f"{e.real:.3f}" + (f" +- {e.imag:.3f}i" if e.imag else "") for e in eigenvalues if e.imag >= 0)
    limit = first_instability(PAPER_VEHICLE, PAPER_GAINS, 0.3, 0.8)
    slowest = float(eigenvalues[0].real)
    return [
        TableRow("largest real part on the circle", "section V", None, slowest, "1/s", None, f"eigenvalues {listed}"),
        TableRow("speed at which straight lines turn unstable", "section V", None, limit, "m/s", None, "paper's gains"),
    ]


def noise_rows(study: Sequence[NoiseRun]) -> list[TableRow]:
    """Return the rows of the noise study: noisy commands, a quiet vehicle, and less noise with low-pass filters."""
    raw, *filtered = study
    noisy, quiet, better = "noisy commands", "quiet vehicle, far below the noise of 10 cm", "less noise with a low-pass"

    def quiet_row(run: NoiseRun, name: str) -> TableRow:
        rms = float(np.sqrt(np.mean(np.square(run.error))))
        return TableRow(f"rms position error{name}", "section V", None, rms, "m", rms < POSITION_NOISE / 3, quiet)

    (F_u, F_r), (mean_u, mean_r) = raw.force_std.tolist(), np.abs(raw.force.mean(axis=(0, 1))).tolist()
    rows = [
        TableRow("std of F_u under noise", "section V", None, F_u, "N", F_u > mean_u, noisy),
        TableRow("std of F_r under noise", "section V", None, F_r, "N m", F_r > mean_r, noisy),
        quiet_row(raw, " under noise"),
    ]
    for run in filtered:
        std, name = float(run.force_std[0]), f", low-pass at {run.cut_off:g} Hz"
        rows += [TableRow(f"std of F_u{name}", "section V", None, std, "N", std < F_u, better), quiet_row(run, name)]
    return rows


def remarks() -> list[TableRow]:
    """Return the rows of the printed equations that do not hold, each with a number as evidence."""
    speeds = (0.05, 0.1, 0.3, 1.0, 2.0)
    turned = Circle(PAPER_CIRCLE.speed, -PAPER_CIRCLE.turn_rate)
    reference = plan(turned, PAPER_VEHICLE, np.array([0.0, 1.0]))
    u_R, sideslip, u_turned = float(reference.u[0]), math.degrees(reference.gamma[0]), settled_surge(turned.turn_rate)
    g = PAPER_VEHICLE.m11 / PAPER_VEHICLE.m22 * u_R
    saddle = min(spectral_abscissa(PAPER_VEHICLE, PAPER_GAINS, U, 0.0, derived_sign_forces) for U in speeds)
    compatible, tried = compatible_gains()
    return [
        TableRow(
            "u_R on the circle run counter-clockwise", "(15)", u_turned, u_R, "m/s", False,
            f"(15) holds for clockwise curves only: as printed it ends without sideslip, not at {sideslip:.4f} deg",
        ),
        TableRow(
            "factor of z_v in the bracket", "(46)", 1.0, -g, "m/s", False,
            "derived from (44a) it is -m11 u / m22, here at u_R; printed is + z_v",
        ),
        TableRow(
            "largest real part with the derived sign", "(47)", None, saddle, "1/s", None,
            "with + g z_v in (47) straight lines are a saddle, tried at 0.05 ... 2 m/s; the printed - z_v works",
        ),
        TableRow(
            "gains that meet both conditions", "after (48)", None, float(compatible), f"of {tried}", False,
            "c_r g^2 < k_psi and c_r g^2 > k_z + k_psi + ... exclude each other: (49)-(51) do not follow",
        ),
        TableRow(
            "width of the interval for k_2", "after (33)", None, PAPER_GAINS.k - 1 / (4 * PAPER_GAINS.cu), "1/s", False,
            "k_2 < k and k_2 > 1 / (4 c_u) leave nothing for section V's gains",
        ),
    ]  # fmt: skip


def compatible_gains(tries: int = 100_000) -> tuple[int, int]:
    """Return the number of random positive gains that meet both conditions after (48), and the number of tries."""
    rng = np.random.default_rng(0)
    c_r, g, k_z, k_psi, k_2, k_3 = 10 ** rng.uniform(-4, 4, (6, tries))
    third = c_r - (c_r * g) ** 2 / k_psi > 0
    fourth = c_r * g**2 - (k_z + k_psi + k_3 * (g**2 + 1) + 1 / (4 * k_2)) > 0
    return int(np.sum(third & fourth)), tries

"""The speed-normalised tracking law on the estimates of an extended Kalman filter.

It controls the vehicle in the water frame. Current and sway load enter the plan, the loads in surge and yaw are
cancelled, and the command compensates the estimated lag of the actuators.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from auv_gym.codegen.graph import SYMBOLS, Symbol
from auv_gym.codegen.kernel import Kernel
from auv_gym.physics.errors import to_body
from auv_gym.physics.namespaces import Array, Namespace, Number
from auv_gym.physics.vehicle import Coefficients, Vehicle, with_names
from auv_gym.task.observation import Observation
from baselines.control.backstepping import GAINS, UNDAMPED_GAINS, Gains, bounded_error, tracking_forces, undamped
from baselines.estimation.kalman import FILTER_TUNING, VEHICLE_ROWS, ExtendedKalmanFilter, repeated, tuning_of
from baselines.estimation.sea_model import STATE_SIZE, WAVE_FREQUENCY, Estimate, wave_transition, waves_after
from baselines.estimation.water_frame import PlannedReference, Sea, plan_in_water, reference_motion, water_errors
from baselines.policy import Memory, is_fast, squared_speed

_NEAR = 3.0  # [s] bound of the position error for the tuned gains, see `backstepping.bounded_error`
_FAR = 8.0  # [s] travel time of the position error at which the expert's gains have a weight of one half
FAR_HEADING = 1.0  # [rad] heading error at which the expert's gains have a weight of one half
EKF_LAW_GAINS = (*UNDAMPED_GAINS, "lead")  # names of the gains of the law
EKF_GAINS = (*EKF_LAW_GAINS, *FILTER_TUNING)
"""Names of the gains: those of the law, see `backstepping.undamped`; `lead` [1/s], the desired rate at which the
actuators' force approaches the commanded force; and the filter's `Tuning`."""


class EkfLaw:
    """The law with its filter, a `Controller`.

    Its memory is that of the filter, then that of the planner in the water frame: the rows of a
    `water_frame.PlannedReference`, shape (N, 7).
    """

    def __init__(self, gains: Mapping[str, float], vehicle: Vehicle) -> None:
        """Make the controller; the names of its gains are `EKF_GAINS`."""
        self.vehicle, self.gains = vehicle, undamped(gains)
        self.filter = ExtendedKalmanFilter(vehicle, tuning_of(gains))
        self._known = np.array((*vehicle.all_coefficients, *(gains[name] for name in EKF_LAW_GAINS)))[:, None]
        self._kernel = law_kernel(len(vehicle.all_coefficients))

    def start(self, n: int) -> Memory:
        """Return the memory at the start of n episodes."""
        return *self.filter.start(n), np.zeros((len(PlannedReference._fields), n)).T

    def forces(self, o: Observation, memory: Memory, extra: Array) -> tuple[Array, Array, Memory]:
        """Return F_u [N], F_r [N m], shape (N,), and the memory for the next call."""
        *filters, plan = memory
        terms = np.array(o)
        after, z = self.filter.update(tuple(filters), terms)
        result = self._kernel(o=terms, known=repeated(self._known, terms.shape[1]), z=z, plan=plan.T)
        F_u, F_r = result["force"]
        return F_u, F_r, (*after, result["plan"].T)


@cache
def law_kernel(size: int = VEHICLE_ROWS) -> Kernel:
    """Return the kernel of the law; its inputs are observation, vehicle and gains, state of the filter, and plan.

    Args:
        size: number of rows of the vehicle, see `Vehicle.all_coefficients`. Cross terms count in forces and
            predictions; the sideslip of the plan in water is that without them.
    """

    def equation(
        o: Sequence[Symbol], known: Sequence[Symbol], z: Sequence[Symbol], plan: Sequence[Symbol]
    ) -> Mapping[str, Sequence[Any]]:
        c, (*gains, lead) = with_names(known[:size]), known[size:]
        named = dict(zip(UNDAMPED_GAINS, gains, strict=True))
        law = cast(Gains, SimpleNamespace(k1=0.0, ku=0.0, kc=0.0, **named))  # as `undamped`
        terms, state = Observation(*o), Estimate(*z)
        X, N, sea = predicted_disturbances(state, terms.dt, SYMBOLS)
        motion = reference_motion(terms, c, SYMBOLS)
        after, R = plan_in_water(PlannedReference(*plan), motion, sea, terms.dt, c, SYMBOLS)
        e_x, e_y = to_body(state.x_e, state.y_e, SYMBOLS.cos(state.psi), SYMBOLS.sin(state.psi))
        errors = water_errors((e_x, e_y, state.psi, state.u, state.v, state.r), R, SYMBOLS)
        F_u, F_r = _blended_forces(errors, c, law, SYMBOLS)
        F_u, F_r = F_u - X, F_r - N
        ahead = lead * state.lag
        return {"plan": after, "force": (F_u + ahead * (F_u - state.F_u), F_r + ahead * (F_r - state.F_r))}

    rows = {"o": len(Observation._fields), "known": size + len(EKF_LAW_GAINS), "z": STATE_SIZE}
    return Kernel.traced(equation, {**rows, "plan": len(PlannedReference._fields)}, structural=True, blocked=True)


def _blended_forces(
    errors: Sequence[Number], coefficients: Coefficients, gains: Gains, ns: Namespace
) -> tuple[Number, Number]:
    """Return F_u [N], F_r [N m] of the law for errors in the water frame.

    With gains for small errors, large errors would make the vehicle spin or move astern. So the forces are a weighted
    mean of those with the tuned gains and those with the expert's gains, whose weight increases with the errors.
    """
    e_x, e_y, psi_e, _, _, _, u_R, v_R, *_ = errors
    far = (e_x * e_x + e_y * e_y) / (_FAR * _FAR * squared_speed(u_R, v_R, ns)) + (psi_e / FAR_HEADING) ** 2
    share = far * far / (1 + far * far)
    u, r = tracking_forces(bounded_error(errors, _NEAR, ns), coefficients, gains, ns)
    slow, fast = (tracking_forces(errors, coefficients, GAINS[name], ns) for name in ("paper", "cruise"))
    safe_u, safe_r = (ns.where(is_fast(u_R, v_R), b, a) for a, b in zip(slow, fast, strict=True))
    return u + share * (safe_u - u), r + share * (safe_r - r)


def predicted_disturbances(z: Estimate, dt: Number, ns: Namespace) -> tuple[Number, Number, Sea]:
    """Return the loads X [N], N [N m] in the middle of the next period, and the disturbances for the planner."""
    X_wave, _, Y_wave, Y_swing, N_wave, _ = waves_after(z, wave_transition(0.5 * dt, ns))
    Y_rate = WAVE_FREQUENCY * Y_swing
    return z.X + X_wave, z.N + N_wave, Sea(z.V_x, z.V_y, z.V_x_rate, z.V_y_rate, z.Y + Y_wave, Y_rate)

"""The speed-normalised tracking law on what an extended Kalman filter believes.

It steers in the water frame: current and sway load enter the plan, surge and yaw load are cancelled, and the command
runs ahead of the actuators by what they are behind, as far as their lag is known.
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
from auv_gym.physics.vehicle import Coefficients, Vehicle
from auv_gym.task.observation import Observation
from baselines.control.backstepping import GAINS, UNDAMPED_GAINS, Gains, bounded_error, tracking_forces, undamped
from baselines.estimation.faults import arrived
from baselines.estimation.kalman import (
    BELIEVED,
    FAULT_TUNING,
    FILTER_TUNING,
    VEHICLE_ROWS,
    ExtendedKalmanFilter,
    parts,
    repeated,
    tuning_of,
)
from baselines.estimation.sea_model import STATE_SIZE, WAVE_FREQUENCY, Estimate, wave_transition, waves_after
from baselines.estimation.water_frame import PlannedReference, Sea, planned, reference_motion, water_errors
from baselines.policy import Memory, is_fast, squared_speed

_NEAR = 3.0  # [s] bound of the position error that the tuned gains see, see `backstepping.bounded_error`
_FAR = 8.0  # [s] travel time of the position error from which the expert's gains have most of the say
FAR_HEADING = 1.0  # [rad] heading error from which they have
EKF_LAW_GAINS = (*UNDAMPED_GAINS, "lead")  # names of the law's own gains
EKF_GAINS = (*EKF_LAW_GAINS, *FILTER_TUNING)
"""Names of the gains: the law's, see `backstepping.undamped`; `lead` [1/s], how fast the actuators' force is to
approach what the law asks for; and the filter's `Tuning`."""
EKF_ADVERSE_GAINS = (*EKF_LAW_GAINS, *FAULT_TUNING)
"""Names of the gains where the filter believes in faults: its `FaultTuning` in place of the `Tuning`."""


class EkfLaw:
    """The law with its filter, a `Controller`.

    Its memory is that of the filter, then that of the planner in the water frame, the rows of a
    `water_frame.PlannedReference`, shape (N, 7).
    """

    def __init__(self, gains: Mapping[str, float], vehicle: Vehicle) -> None:
        """Make the controller; its gains are named in `EKF_GAINS`, or in `EKF_ADVERSE_GAINS`."""
        self.vehicle, self.gains = vehicle, undamped(gains)
        self.filter = ExtendedKalmanFilter(vehicle, tuning_of(gains))
        self._known = np.array((*vehicle.coefficients, *(gains[name] for name in EKF_LAW_GAINS)))[:, None]

    def start(self, n: int) -> Memory:
        """Return the memory at the start of n episodes."""
        return *self.filter.start(n), np.zeros((len(PlannedReference._fields), n)).T

    def forces(self, o: Observation, memory: Memory, extra: Array) -> tuple[Array, Array, Memory]:
        """Return F_u [N], F_r [N m], shape (N,), and the memory to hand in next."""
        *believed, plan = memory
        terms = np.array(o)
        after, z = self.filter.update(tuple(believed), terms)
        found = law_kernel(self.filter.faults)(o=terms, known=repeated(self._known, terms.shape[1]), z=z, plan=plan.T)
        F_u, F_r = found["force"]
        return F_u, F_r, (*after, found["plan"].T)


@cache
def law_kernel(faults: bool = False) -> Kernel:
    """Return the kernel of the law, which takes observation, vehicle and gains, the filter's state and the plan."""

    def equation(
        o: Sequence[Symbol], known: Sequence[Symbol], z: Sequence[Symbol], plan: Sequence[Symbol]
    ) -> Mapping[str, Sequence[Any]]:
        coefficients = Coefficients(*known[:VEHICLE_ROWS])
        *gains, lead = known[VEHICLE_ROWS:]
        law, memory = undamped_symbols(gains), PlannedReference(*plan)
        after, force = _law_forces(Observation(*o), z, memory, coefficients, law, lead, SYMBOLS)
        return {"plan": after, "force": force}

    rows = {
        "o": len(Observation._fields),
        "known": VEHICLE_ROWS + len(EKF_LAW_GAINS),
        "z": BELIEVED if faults else STATE_SIZE,
    }
    return Kernel.traced(equation, {**rows, "plan": len(PlannedReference._fields)}, structural=True, blocked=True)


def undamped_symbols(gains: Sequence[Symbol]) -> Gains:
    """Return what `backstepping.undamped` does for the gains `UNDAMPED_GAINS` as symbols."""
    named = dict(zip(UNDAMPED_GAINS, gains, strict=True))
    return cast(Gains, SimpleNamespace(k1=0.0, ku=0.0, kc=0.0, **named))


def _law_forces(
    o: Observation,
    state: Sequence[Number],
    plan: PlannedReference,
    coefficients: Coefficients,
    gains: Gains,
    lead: Number,
    ns: Namespace,
) -> tuple[PlannedReference, tuple[Number, Number]]:
    """Return what the planner remembers, and F_u [N], F_r [N m].

    Args:
        o: the observation in SI units.
        state: what the filter believes with it, an `Estimate` and perhaps `Faults`.
        plan: what the planner remembers.
        coefficients: of the vehicle.
        gains: of the law.
        lead: [1/s], see `EKF_GAINS`.
        ns: the namespace of the numbers.
    """
    z, faults, actions = parts(state)
    X, N, sea = foreseen_sea(z, o.dt, ns)
    motion = reference_motion(o, coefficients, ns)
    plan, R = planned(plan, motion, sea, o.dt, coefficients, ns)
    if actions:
        z = arrived(z, faults, actions, (o.F_u_max, o.F_r_max), o.dt, coefficients, ns)
    late = faults.delay * o.dt
    x_e, y_e = (
        z.x_e - late * (motion.v_x + 0.5 * late * motion.a_x),
        z.y_e - late * (motion.v_y + 0.5 * late * motion.a_y),
    )
    R = R._replace(psi=R.psi + late * R.r_R)
    e_x, e_y = to_body(x_e, y_e, ns.cos(z.psi), ns.sin(z.psi))
    errors = water_errors((e_x, e_y, z.psi, z.u, z.v, z.r), R, ns)
    F_u, F_r = _from_near_and_far(errors, coefficients, gains, ns)
    F_u, F_r = F_u - X, F_r - N
    ahead = lead * z.lag
    F_u, F_r = F_u + ahead * (F_u - z.F_u), F_r + ahead * (F_r - z.F_r)
    return plan, (F_u / faults.surge_share, F_r / faults.yaw_share)


def _from_near_and_far(
    errors: Sequence[Number], coefficients: Coefficients, gains: Gains, ns: Namespace
) -> tuple[Number, Number]:
    """Return F_u [N], F_r [N m] of the law on errors in the water frame.

    With gains that suit small errors it spins or goes astern where errors are large. There the expert's gains take
    over, and near by they have no share in it.
    """
    e_x, e_y, psi_e, _, _, _, u_R, v_R, *_ = errors
    vehicle = cast(Vehicle, coefficients)
    far = (e_x * e_x + e_y * e_y) / (_FAR * _FAR * squared_speed(u_R, v_R, ns)) + (psi_e / FAR_HEADING) ** 2
    share = far * far / (1 + far * far)
    u, r = tracking_forces(bounded_error(errors, _NEAR, ns), vehicle, gains, ns)
    slow, fast = (tracking_forces(errors, vehicle, GAINS[name], ns) for name in ("paper", "cruise"))
    safe_u, safe_r = (ns.where(is_fast(u_R, v_R), b, a) for a, b in zip(slow, fast, strict=True))
    return u + share * (safe_u - u), r + share * (safe_r - r)


def foreseen_sea(z: Estimate, dt: Number, ns: Namespace) -> tuple[Number, Number, Sea]:
    """Return surge load X [N] and yaw load N [N m] in the middle of the coming period, and what to plan for."""
    X_wave, _, Y_wave, Y_swing, N_wave, _ = waves_after(z, wave_transition(0.5 * dt, ns))
    Y_rate = WAVE_FREQUENCY * Y_swing
    return z.X + X_wave, z.N + N_wave, Sea(z.V_x, z.V_y, z.V_x_rate, z.V_y_rate, z.Y + Y_wave, Y_rate)

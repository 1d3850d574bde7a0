"""Nonlinear model predictive control on the estimates of an extended Kalman filter.

At each control instant the controller predicts the filter's model of vehicle, actuators and disturbances over the
horizon. It optimises commands that bring the vehicle to the future positions of the reference, which are in the
preview. The cost depends on positions only: in a current and in waves they determine heading and velocities.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from auv_gym.codegen.graph import SYMBOLS
from auv_gym.codegen.kernel import Kernel
from auv_gym.physics.namespaces import Array, Namespace, Number
from auv_gym.physics.vehicle import PAPER_VEHICLE, Vehicle
from baselines.control.nmpc.gauss_newton import optimised_plan
from baselines.control.nmpc.problem import (
    PLANE_SYSTEM,
    CostWeights,
    Horizon,
    OptimalControl,
    Plan,
    System,
    replaced,
    subset,
)
from baselines.estimation.faults import FAULTS, LATE, Faults
from baselines.estimation.kalman import (
    FAULT_TUNING,
    FILTER_TUNING,
    ExtendedKalmanFilter,
    estimate_after_delay,
    tuning_of,
)
from baselines.estimation.sea_model import (
    STATE_SIZE,
    current_after,
    lag_response,
    wave_transition,
    waves_after,
)
from baselines.gains.loading import tuned_policy
from baselines.policy import Memory, Remembering

ENDS = (1, 2, 4, 6, 8, 11, 14, 17, 20, 24, 28, 32, 36, 40, 45, 50)
"""Ends of the stages of the horizon; the unit is a number of control periods, see `paces`. The horizon is 5 s at
cruise, 10 s in slow motion."""
_PERIOD = 0.1  # [s] unit of `ENDS` if the control period is shorter, in the paper's units
_PACES = (1, 2, 3, 4, 5)
"""Values of the unit of `ENDS`; at control periods below `_PERIOD` / 5 the horizon is shorter."""
PREVIEW = (*ENDS, 60, 70, 80, 90, 100, 125, 150, 175, 200, 225, 250)
"""Control periods ahead at which the controller needs the position of the reference."""
_STEPS = 6  # most Gauss-Newton steps at an instant
FIRST_STEPS = 12  # most Gauss-Newton steps at the first instant of an episode
COST_GAINS = ("huber", "surge", "yaw", "sway", "terminal")  # names of the gains that are fields of `CostWeights`
NMPC_GAINS = (*COST_GAINS, *FILTER_TUNING)
"""Names of the gains: those of `CostWeights`, with `surge` and `yaw` for 100 N and 100 N m; and the filter's
`Tuning`."""
NMPC_ADVERSE_GAINS = (*COST_GAINS, *FAULT_TUNING)
"""Names of the gains with a filter that estimates faults: its `FaultTuning` replaces the `Tuning`."""


class PredictiveControl:
    """Model predictive control with its filter, a `Controller`.

    Its memory is that of the filter, then the last plan's commands, shape (N, K, C), one for each of the `ENDS` and of
    the C actuators, then that of `fin_model` for each moment, shape (N, C - 1, 3).
    """

    preview = PREVIEW

    def __init__(self, gains: Mapping[str, float], vehicle: Any, system: System = PLANE_SYSTEM) -> None:
        """Make the controller.

        Args:
            gains: with the names `NMPC_GAINS` or `NMPC_ADVERSE_GAINS`; faults are estimated in the plane alone.
            vehicle: the nominal one.
            system: the kind of motion.
        """
        self.vehicle, self.system, self.layout = vehicle, system, system.model.layout
        self.filter = ExtendedKalmanFilter(vehicle, tuning_of(gains), system.filter)
        scale = {"surge": 0.01, "yaw": 0.01}
        weights = CostWeights(**{name: scale.get(name, 1.0) * gains[name] for name in COST_GAINS})
        self.problem = OptimalControl(vehicle, weights, system)
        self.solve = partial(optimised_plan, self.problem)
        self._shifts = np.stack([shift_matrix(np.multiply(pace, ENDS)) for pace in _PACES])

    def start(self, n: int) -> Memory:
        """Return the memory at the start of n episodes."""
        return *self.filter.start(n), np.zeros((n, len(ENDS), c := self.system.commands)), np.zeros((n, c - 1, 3))

    def forces(self, o: Any, memory: Memory, extra: Array) -> tuple[Any, ...]:
        """Return the force of each actuator [N], [N m], shape (N,), and the memory for the next call."""
        *filters, planned, fins = memory
        first = filters[0].T[0] == 0  # number of updates of the filter
        _, *limits = self.system.model.limits(o)
        models = [fin_model(limit, o.u_R + o.u_e, fins[:, k]) for k, limit in enumerate(limits)]
        acting = np.concatenate([one for one, _, _ in models])
        planned = planned * np.stack((np.ones(len(first)), *(factor for _, factor, _ in models)), axis=1)[:, None]
        after, z = self.filter.update(tuple(filters), terms := np.array(o))
        pace = paces(o.dt)
        target, share = (
            targets(extra, pace, len(self.system.model.position)),
            np.ones((self.system.commands, len(first))),
        )
        if self.filter.faults:
            faults = Faults(*z[STATE_SIZE : STATE_SIZE + FAULTS])
            target = delayed_targets(target, faults.delay / pace)
            share = np.array((faults.surge_share, faults.yaw_share))
            z = estimate_after_delay(terms, z, self.vehicle)
        horizon = prediction_horizon(terms, z, target, share, acting, pace, self.system)
        warm = np.einsum("njk,nki->jin", self._shifts[pace - 1], planned)
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            guess = self._initial_plan(z, o, warm, first, horizon)
            plan = self.solve(guess, horizon, np.where(first, FIRST_STEPS, _STEPS))
        # The prediction diverges for a vehicle that spins fast; the normalised law is stable in this state.
        law = np.array(self.system.law(o, self.vehicle))
        commands = np.where(np.isfinite(plan.cost), plan.commands, law)
        fins = np.stack([known for _, _, known in models], axis=1)
        return *(commands[0] / share), (*after, np.ascontiguousarray(commands.transpose(2, 0, 1)), fins)

    def _initial_plan(self, z: Array, o: Any, warm: Array, first: NDArray[np.bool_], horizon: Horizon) -> Plan:
        """Return the better of two initial plans: the last plan, or constant commands with the reference's forces."""
        limits, sea = horizon.limits, self.system.filter.sea
        planned = np.array([getattr(o, f"F_{c}R") for c in sea.model.channels])
        steady = np.clip(planned - z[sea.bias][list(sea.driven)], -limits, limits)
        start = z[: self.system.states]
        plan = self.problem.predict(start, np.broadcast_to(steady, warm.shape), horizon)
        last = self.problem.predict(start, np.clip(warm, -limits, limits), horizon)
        better = (~first & (last.cost <= plan.cost)).nonzero()[0]
        return replaced(plan, better, subset(last, better))


def fin_model(limit: Array, u: Array, memory: Array) -> tuple[Array, Array, Array]:
    """Return how the torque of an actuator depends on the speed, identified from its observed limit.

    The torque limit of fins is c u^2 with the measured surge speed u. Two different limits with the same c identify
    fins. If the present limit is not c u^2, for example because fins never exceed a largest torque, it is predicted to
    be constant.

    Args:
        limit: observed [N m], shape (N,).
        u: measured surge speed [m/s], shape (N,).
        memory: the last limit [N m], the last limit over u^2 [kg], and c [kg], or 0 without fins, shape (N, 3).

    Returns:
        `Stage.torque` and `Stage.fin`, shape (2, N); the factor by which the limit has changed, shape (N,), with which
        planned torques are scaled; and the memory for the next call.
    """
    last, ratio, known = memory.T
    now = limit / np.maximum(np.square(u), 1e-12)
    known = np.where((limit != last) & (np.abs(now - ratio) <= 1e-6 * now), now, known)
    has_fins = (known > 0) & (np.abs(now - known) <= 1e-6 * known)
    factor = np.where(has_fins & (last > 0), limit / np.where(last > 0, last, 1.0), 1.0)
    return np.array((~has_fins, np.where(has_fins, known / limit, 0.0))), factor, np.stack((limit, now, known), axis=1)


def paces(dt: Array) -> NDArray[np.int64]:
    """Return the unit of `ENDS` in control periods, shape (N,), for control periods dt [s] in the paper's units.

    It is 1 at 0.1 s and above. With shorter control periods the horizon would otherwise be shorter in seconds than the
    vehicle's response.
    """
    return np.maximum(np.rint(_PERIOD / np.maximum(dt, _PERIOD / _PACES[-1])), 1).astype(np.int64)


def targets(extra: Array, pace: NDArray[np.int64], axes: int = 2) -> Array:
    """Return the reference's positions at the ends of the stages, shape (K, axes, N) [m].

    They are relative to the reference's position now, in the body frame.

    Args:
        extra: the columns of `PREVIEW`, shape (N, axes * len(PREVIEW)) or wider.
        pace: see `paces`, shape (N,).
        axes: 2 in the plane, 3 in space.
    """
    ahead = extra[:, : axes * len(PREVIEW)].reshape(len(extra), len(PREVIEW), axes)
    if (pace == 1).all():  # nearly always; the matrices cost as much as a tenth of a decision
        return ahead[:, : len(ENDS)].transpose(1, 2, 0)
    return np.asarray(np.einsum("nkj,nji->kin", _pace_matrices()[pace - 1], ahead))


@cache
def _pace_matrices() -> Array:
    """Return matrices from the positions of `PREVIEW` to those at the ends of the stages, one for each of `_PACES`."""
    return np.stack([_interpolation(PREVIEW, np.multiply(pace, ENDS)) for pace in _PACES])


def delayed_targets(target: Array, delay: Array) -> Array:
    """Return the reference's positions a delay after the ends of the stages, in the form of `targets`.

    Args:
        target: positions without the delay.
        delay: in the unit of `ENDS`, shape (N,), at most `LATE`; positions at fractions of it are interpolated.
    """
    weights = np.clip(1.0 - np.abs(delay - np.arange(LATE + 1.0)[:, None]), 0.0, 1.0)
    return np.asarray(np.einsum("dkj,jin,dn->kin", _delay_matrices(), target, weights))


@cache
def _delay_matrices() -> Array:
    """Return matrices from positions at the ends of the stages to positions d units later, shape (1 + LATE, K, K)."""
    return np.stack([_interpolation(ENDS, np.array(ENDS) + d) for d in range(LATE + 1)])


def _interpolation(known: Sequence[int], wanted: Array) -> Array:
    """Return the matrix from positions at known times to those at wanted times; the position at time zero is zero."""
    from scipy.interpolate import CubicSpline

    times = np.array((0.0, *known))
    return np.asarray(CubicSpline(times, np.eye(len(times)))(wanted)[:, 1:])


def prediction_horizon(
    o: Array,
    z: Array,
    target: Array,
    share: Array,
    acting: Array,
    pace: NDArray[np.int64],
    system: System = PLANE_SYSTEM,
) -> Horizon:
    """Return the stages of the horizon.

    Args:
        o: the rows of an `Observation`, shape (SIZE, N).
        z: the rows of an `Estimate`, shape (states, N).
        target: see `targets`.
        share: of the commanded forces that act, shape (C, N).
        acting: `Stage.torque` and `Stage.fin` of each moment, shape (2 (C - 1), N).
        pace: see `paces`, shape (N,).
        system: the kind of motion.
    """
    stages = len(ENDS)
    ends = np.array(ENDS, dtype=np.float64)[:, None] * pace
    lengths = np.diff(ends, prepend=0.0, axis=0)
    last = np.broadcast_to((np.arange(stages) == stages - 1)[:, None], ends.shape)
    periods = np.stack((lengths, ends - 0.5 * lengths, last), axis=1)
    inputs = {"o": o, "z": z, "target": target, "acting": acting, "periods": periods}
    first = system.model.Observation._fields.index("F_u_max")
    return Horizon(horizon_kernel(system)(stages, **inputs)["stages"], share * o[first : first + system.commands])


@cache
def horizon_kernel(system: System = PLANE_SYSTEM) -> Kernel:
    """Return the kernel of `predicted_stage`; `periods` are length, middle, and 1 for the last stage."""

    def equation(
        o: Sequence[Any], z: Sequence[Any], target: Sequence[Any], acting: Sequence[Any], periods: Sequence[Any]
    ) -> Mapping[str, Sequence[Any]]:
        length, middle, last = periods
        stage = predicted_stage(seen(*o), sea.Estimate(*z), target, length, middle, SYMBOLS, system)
        return {"stages": [*stage, last, *acting]}

    sea, seen = system.filter.sea, system.model.Observation
    axes, moments = len(system.model.position), system.commands - 1
    rows = {"o": len(seen._fields), "z": sea.size, "target": axes, "acting": 2 * moments, "periods": 3}
    return Kernel.traced(equation, rows, ("target", "periods", "stages"), blocked=True)


def predicted_stage(
    o: Any, z: Any, target: Sequence[Number], length: Number, middle: Number, ns: Namespace, system: System
) -> list[Number]:
    """Return the entries of a stage before `last`, with the disturbances predicted in its middle.

    Waves and current are predicted by the filter's model. The slowly varying load is constant: it is mostly the effect
    of model errors, which persist.

    Args:
        o: the observation in SI units.
        z: the filter's estimate for it.
        target: position of the reference at the end of the stage, see `targets` [m].
        length: of the stage in control periods.
        middle: of the stage, in control periods from now.
        ns: the namespace of the numbers.
        system: the kind of motion.
    """
    dt, ahead, sea = length * o.dt, middle * o.dt, system.filter.sea
    waves = waves_after(z, wave_transition(ahead, ns), sea)[::2]
    response = lag_response(z.lag, dt, ns)
    position, current = system.in_world(target, o, ns), current_after(z, ahead, ns, sea)
    load = (slow + wave for slow, wave in zip(z[sea.bias], waves, strict=True))
    return [dt, *position, *current, *load, response.gain, response.gain * response.mean]


def shift_matrix(ends: Array) -> Array:
    """Return the matrix from the commands of stages with these ends [periods] to their means one period later."""
    starts = np.append(0.0, ends[:-1])
    until = np.append(ends[:-1], np.inf)
    overlap = np.minimum(until, ends[:, None] + 1) - np.maximum(starts, starts[:, None] + 1)
    overlap = np.maximum(overlap, 0.0)
    return np.asarray(overlap / overlap.sum(axis=1, keepdims=True))


def make_nmpc(
    gains: Mapping[str, float] | None = None,
    vehicle: Vehicle | str | dict[str, Any] = PAPER_VEHICLE,
    adverse: bool = False,
) -> Remembering:
    """Return the controller as a policy; it requires the preview `PREVIEW`.

    Args:
        gains: used at every speed instead of the tuned gains, which depend on the speed; their names are `NMPC_GAINS`
            or `NMPC_ADVERSE_GAINS`.
        vehicle: nominal model; an object, a name or a dict.
        adverse: whether the filter estimates faults of sensors and actuators.

    Raises:
        ValueError: unknown vehicle or wrong gains.
    """
    name, names = ("nmpc-adverse", NMPC_ADVERSE_GAINS) if adverse else ("nmpc", NMPC_GAINS)
    return tuned_policy(name, names, PredictiveControl, gains, vehicle)

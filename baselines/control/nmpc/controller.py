"""Nonlinear model predictive control on what an extended Kalman filter believes.

At each instant the filter's model of vehicle, actuators and sea is predicted over the horizon, and commands are sought
that bring the vehicle to where its reference will be, which it reads from the preview. Only positions are aimed for:
in a current and in waves heading and velocities follow from them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from auv_gym.codegen.graph import SYMBOLS
from auv_gym.codegen.kernel import Kernel
from auv_gym.physics.errors import to_world
from auv_gym.physics.namespaces import ARRAYS, Array, Namespace, Number
from auv_gym.physics.vehicle import PAPER_VEHICLE, Vehicle
from auv_gym.task.observation import Observation
from baselines.control.backstepping import GAINS, tracking_forces
from baselines.control.nmpc.gauss_newton import improved_plan
from baselines.control.nmpc.problem import (
    COMMAND_SIZE,
    STATE_ROWS,
    CostWeights,
    Horizon,
    OptimalControl,
    Plan,
    Stage,
    replaced,
    taken,
)
from baselines.estimation.faults import FAULTS, LATE, Faults
from baselines.estimation.kalman import FAULT_TUNING, FILTER_TUNING, ExtendedKalmanFilter, arrival, tuning_of
from baselines.estimation.sea_model import (
    STATE_SIZE,
    Estimate,
    current_after,
    lag_response,
    wave_transition,
    waves_after,
)
from baselines.gains.loading import tuned_policy
from baselines.policy import Memory, Remembering

PREVIEW = (1, 2, 4, 6, 8, 11, 14, 17, 20, 24, 28, 32, 36, 40, 45, 50)
"""Where the stages of the horizon end, in control periods: 5 s ahead at cruise, 10 s in slow motion."""
_STEPS = 6  # most Gauss-Newton steps at an instant
FIRST_STEPS = 12  # most Gauss-Newton steps at the first instant of an episode
COST_GAINS = ("huber", "surge", "yaw", "sway", "terminal")  # names of the gains that are fields of `CostWeights`
NMPC_GAINS = (*COST_GAINS, *FILTER_TUNING)
"""Names of the gains: those of `CostWeights`, with `surge` and `yaw` for 100 N and 100 N m; and the filter's
`Tuning`."""
NMPC_ADVERSE_GAINS = (*COST_GAINS, *FAULT_TUNING)
"""Names of the gains where the filter believes in faults: its `FaultTuning` in place of the `Tuning`."""


class PredictiveControl:
    """The controller with its filter, a `Controller`; its memory is the filter's, then the commands planned last.

    Commands are planned at the stages of `PREVIEW`, shape (N, K, COMMAND_SIZE). Behind them is what `fins` remembers.
    """

    preview = PREVIEW

    def __init__(self, gains: Mapping[str, float], vehicle: Vehicle) -> None:
        """Make the controller.

        Args:
            gains: named in `NMPC_GAINS`, or in `NMPC_ADVERSE_GAINS`.
            vehicle: that it believes in.
        """
        self.vehicle = vehicle
        self.filter = ExtendedKalmanFilter(vehicle, tuning_of(gains))
        scale = {"surge": 0.01, "yaw": 0.01}
        weights = CostWeights(**{name: scale.get(name, 1.0) * gains[name] for name in COST_GAINS})
        self.problem = OptimalControl(vehicle, weights)
        self.solve = partial(improved_plan, self.problem)  # a better plan, after at most so many steps, shape (N,)
        self._next = one_period_on(np.array(PREVIEW, dtype=np.float64))

    def start(self, n: int) -> Memory:
        """Return the memory at the start of n episodes."""
        return *self.filter.start(n), np.zeros((n, len(PREVIEW), COMMAND_SIZE)), np.zeros((n, 3))

    def forces(self, o: Observation, memory: Memory, extra: Array) -> tuple[Array, Array, Memory]:
        """Return F_u [N], F_r [N m], shape (N,), and the memory to hand in next."""
        *believed, planned, seen = memory
        held_out = believed[0].T[0] == 0  # the filter's count of updates
        acting, kept, seen = fins(o, seen)
        planned = planned * np.stack((np.ones_like(kept), kept), axis=1)[:, None]
        after, z = self.filter.update(tuple(believed), terms := np.array(o))
        aim, share = aims(extra), np.ones((COMMAND_SIZE, len(held_out)))
        if self.filter.faults:
            faults = Faults(*z[STATE_SIZE : STATE_SIZE + FAULTS])
            aim, share = later(aim, faults.delay), np.array((faults.surge_share, faults.yaw_share))
            z = arrival(terms, z, self.vehicle)
        ahead = horizon(terms, z, aim, share, acting)
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            guess = self._guess(z, o, np.einsum("jk,nki->jin", self._next, planned), held_out, ahead)
            plan = self.solve(guess, ahead, np.where(held_out, FIRST_STEPS, _STEPS))
        # A vehicle that spins too fast for the prediction is left to the law that is safe from that.
        law = np.array(tracking_forces(o, self.vehicle, GAINS["normalised"], ARRAYS))
        commands = np.where(np.isfinite(plan.cost), plan.commands, law)
        F_u, F_r = commands[0] / share
        return F_u, F_r, (*after, np.ascontiguousarray(commands.transpose(2, 0, 1)), seen)

    def _guess(self, z: Array, o: Observation, warm: Array, held_out: NDArray[np.bool_], ahead: Horizon) -> Plan:
        """Return the better of two plans to begin with: what was planned, and what the reference takes as it is now."""
        limits, load = ahead.limits, Estimate(*z)
        steady = np.clip(np.array((o.F_uR - load.X, o.F_rR - load.N)), -limits, limits)
        plan = self.problem.planned(z[:STATE_ROWS], np.broadcast_to(steady, warm.shape), ahead)
        last = self.problem.planned(z[:STATE_ROWS], np.clip(warm, -limits, limits), ahead)
        few = (~held_out & (last.cost <= plan.cost)).nonzero()[0]
        return replaced(plan, few, taken(last, few))


def fins(o: Observation, seen: Array) -> tuple[Array, Array, Array]:
    """Return how the torque of the yaw actuator depends on the speed, as its limit has shown.

    The limit of fins is c u^2 with the measured surge speed u: two of them give them away. Where it is less than that,
    as where full fins would break off, it is taken to stay as it is.

    Args:
        o: the observation.
        seen: the last limit [N m], that over u^2 [kg], and c [kg], or 0 where no fins are known, shape (N, 3).

    Returns:
        `Stage.torque` and `Stage.fin`, shape (2, N); by what a torque planned at the last limit is to be multiplied so
        that it is the same share of this one, shape (N,); and what has been seen now.
    """
    limit, (last, ratio, known) = np.asarray(o.F_r_max), seen.T
    now = limit / np.maximum(np.square(o.u_R + o.u_e), 1e-12)
    known = np.where((limit != last) & (np.abs(now - ratio) <= 1e-6 * now), now, known)
    finned = (known > 0) & (np.abs(now - known) <= 1e-6 * known)
    kept = np.where(finned & (last > 0), limit / np.where(last > 0, last, 1.0), 1.0)
    return np.array((~finned, np.where(finned, known / limit, 0.0))), kept, np.stack((limit, now, known), axis=1)


def aims(extra: Array) -> Array:
    """Return where the reference will be at the stages' ends [m], shape (K, 2, N); from where it is now, in the body.

    Args:
        extra: the preview, shape (N, 2 K) or wider.
    """
    stages = len(PREVIEW)
    return extra[:, : 2 * stages].reshape(len(extra), stages, 2).transpose(1, 2, 0)


def later(aim: Array, delay: Array) -> Array:
    """Return where the reference will be at the stages' ends and a delay behind each, as `aims` does.

    Args:
        aim: without the delay.
        delay: [periods], shape (N,), at most `LATE`; between whole numbers of periods the place is interpolated.
    """
    weights = np.clip(1.0 - np.abs(delay - np.arange(LATE + 1.0)[:, None]), 0.0, 1.0)
    return np.asarray(np.einsum("dkj,jin,dn->kin", _shifts(), aim, weights))


@cache
def _shifts() -> Array:
    """Return the matrices that take places at the stages' ends to those d periods later, shape (1 + LATE, K, K)."""
    from scipy.interpolate import CubicSpline

    ends = np.array((0.0, *PREVIEW))
    spline = CubicSpline(ends, np.eye(len(ends)))  # of each place's share; that of now is the origin
    return np.stack([spline(ends[1:] + d)[:, 1:] for d in range(LATE + 1)])


def horizon(o: Array, z: Array, aim: Array, share: Array, acting: Array) -> Horizon:
    """Return the stages ahead.

    Args:
        o: the rows of an `Observation`, shape (SIZE, N).
        z: the rows of an `Estimate`, shape (22, N).
        aim: see `aims`.
        share: of the commanded forces that act, shape (2, N).
        acting: see `fins`, shape (2, N).
    """
    stages, n = len(PREVIEW), o.shape[1]
    ends = np.array(PREVIEW, dtype=np.float64)
    lengths = np.diff(ends, prepend=0.0)
    periods = np.array((lengths, ends - 0.5 * lengths, np.arange(stages) == stages - 1)).T[:, :, None]
    given = {"o": o, "z": z, "aim": aim, "acting": acting, "periods": np.broadcast_to(periods, (stages, 3, n))}
    known = horizon_kernel()(stages, **given)["known"]
    first = Observation._fields.index("F_u_max")
    return Horizon(known, share * o[first : first + COMMAND_SIZE])


@cache
def horizon_kernel() -> Kernel:
    """Return the kernel of `foreseen_stage`; `periods` are its length, middle and whether it is the last one."""

    def equation(
        o: Sequence[Any], z: Sequence[Any], aim: Sequence[Any], acting: Sequence[Any], periods: Sequence[Any]
    ) -> Mapping[str, Sequence[Any]]:
        length, middle, last = periods
        found = foreseen_stage(Observation(*o), Estimate(*z), aim, length, middle, SYMBOLS)
        return {"known": found._replace(last=last, torque=acting[0], fin=acting[1])}

    rows = {"o": len(Observation._fields), "z": STATE_SIZE, "aim": 2, "acting": 2, "periods": 3}
    return Kernel.traced(equation, rows, ("aim", "periods", "known"), blocked=True)


def foreseen_stage(
    o: Observation, z: Estimate, aim: Sequence[Number], length: Number, middle: Number, ns: Namespace
) -> Stage:
    """Return a stage with the sea as it is foreseen in its middle, not the last one, its torque that of no fins.

    Waves swing on and the current goes the way that the filter believes; but the slowly varying load stays as it is:
    most of it is what makes the model wrong, and that lasts.

    Args:
        o: the observation in SI units.
        z: what the filter believes with it.
        aim: where the reference will be at the stage's end, from the vehicle, in the body frame [m].
        length: of the stage in control periods.
        middle: of the stage, in control periods from now.
        ns: the namespace of the numbers.
    """
    dt, ahead = length * o.dt, middle * o.dt
    X, _, Y, _, N, _ = waves_after(z, wave_transition(ahead, ns))
    response = lag_response(z.lag, dt, ns)
    place, current = to_world(aim[0], aim[1], o.cos_psi, o.sin_psi), current_after(z, ahead, ns)
    return Stage(
        dt, *place, *current, z.X + X, z.Y + Y, z.N + N, response.gain, response.gain * response.mean, 0.0, 1.0, 0.0
    )


def one_period_on(ends: Array) -> Array:
    """Return the matrix that takes commands of stages with these ends [periods] to the means one period later."""
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
    """Return the controller as a policy; it needs the preview `PREVIEW`.

    Args:
        gains: at every speed, in place of the tuned ones, which depend on the speed; their names are in `NMPC_GAINS`,
            or in `NMPC_ADVERSE_GAINS`.
        vehicle: the vehicle that it believes in; an object, a name or a dict.
        adverse: whether its filter believes in faults of sensors and actuators.

    Raises:
        ValueError: unknown vehicle or wrong gains.
    """
    name, names = ("nmpc-adverse", NMPC_ADVERSE_GAINS) if adverse else ("nmpc", NMPC_GAINS)
    return tuned_policy(name, names, PredictiveControl, gains, vehicle)

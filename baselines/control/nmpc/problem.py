"""Optimal control problem of predictive control for many vehicles: data, prediction and cost."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass, fields
from functools import cache, cached_property
from types import SimpleNamespace
from typing import Any, NamedTuple, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from auv_gym.codegen.graph import SYMBOLS
from auv_gym.codegen.kernel import Kernel
from auv_gym.physics.dynamics import from_outside, rk4_step
from auv_gym.physics.intervals import check_number
from auv_gym.physics.namespaces import Array, Number
from auv_gym.physics.stiffness import MAX_STIFFNESS, fastest_rate
from auv_gym.physics.vehicle import PAPER_VEHICLE, Coefficients, Vehicle, with_names
from baselines.estimation.kalman import repeated
from baselines.estimation.sea_model import PLACE

Integers = NDArray[np.int64]

STATE_ROWS = PLACE.V_x
"""Size of the state: x, y [m], psi [rad] in the world, u, v [m/s] relative to the water, r [rad/s], forces of the
actuators F_u [N], F_r [N m]. These are the first rows of an `Estimate`."""
COMMAND_SIZE = 2  # F_u [N], F_r [N m]
_LONGEST_STAGE = 0.5  # [s] in the paper's units, at cruise
_HARD_TURN = (PAPER_VEHICLE.speed, 0.3, 0.3)
"""Surge, sway [m/s] and yaw rate [rad/s] at which a prediction must be stable, in the paper's units."""


@dataclass(frozen=True)
class CostWeights:
    """Weights of the cost: the integral over the horizon of H(e) + (surge dF_u)^2 + (yaw dF_r)^2 + (sway v)^2.

    e is the position error, and H(e) = 2 huber^2 (sqrt(1 + e^2/huber^2) - 1) the pseudo-Huber function, which is e^2
    for small e. dF is a command minus the force that the actuator applies. The cost of the sway velocity v avoids local
    minima in which the vehicle turns around or moves astern.
    """

    huber: float  # [m] error above which its cost grows linearly
    surge: float  # [m/N]
    yaw: float  # [1/N]
    sway: float  # [s]
    terminal: float  # [s] additional time for which the error at the end of the horizon is counted

    def __post_init__(self) -> None:
        for field in fields(self):
            least = 0.0 if field.name in ("sway", "terminal") else 1e-9
            check_number(f"weight {field.name}", getattr(self, field.name), least, 1e6)


_WEIGHTS = tuple(field.name for field in fields(CostWeights))
"""Names of the fields of `CostWeights`."""


class Stage(NamedTuple):
    """Data of one stage of the horizon."""

    dt: Number  # [s] length
    target_x: Number  # [m] desired position at the end, in the world
    target_y: Number  # [m]
    V_x: Number  # [m/s] current
    V_y: Number  # [m/s]
    X: Number  # [N] load on the vehicle
    Y: Number  # [N]
    N: Number  # [N m]
    gain: Number  # step response of the actuators at the end of the stage
    share: Number  # mean step response of the actuators in the stage
    last: Number  # 1 for the last stage of a horizon, 0 for the others
    torque: Number  # share of a commanded torque that acts at any speed: 0 for fins, else 1
    fin: Number  # [s^2/m^2] share of a commanded torque per squared surge speed, for fins; else 0


STAGE_ROWS = len(Stage._fields)  # number of entries of a stage


class Horizon(NamedTuple):
    """K future stages of N vehicles."""

    stages: Array  # the rows of a `Stage`, shape (K, STAGE_ROWS, N)
    limits: Array  # [N], [N m] of the commands, shape (2, N)


class Plan(NamedTuple):
    """Commands with the predicted states and cost."""

    commands: Array  # shape (K, COMMAND_SIZE, N)
    states: Array  # shape (K + 1, STATE_ROWS, N)
    cost: Array  # [m^2 s], shape (N,); infinite if the states are not finite


class GaussNewtonStep(NamedTuple):
    """Change of the commands of a plan: `step` + `feedback` (state - state of the plan)."""

    step: Array  # shape (K, COMMAND_SIZE, N)
    feedback: Array  # shape (K, COMMAND_SIZE * STATE_ROWS, N): the rows of K matrices one after the other
    decrease: Array  # [m^2 s] decrease of the cost predicted by the quadratic model, shape (N,)


_Rows = TypeVar("_Rows", bound=Any)
"""A named tuple of arrays whose last axis is that of the vehicles, such as `Horizon`, `Plan` and `GaussNewtonStep`."""


def subset(rows: _Rows, indices: Integers) -> _Rows:
    """Return the rows of some of the vehicles; if these are all vehicles, the arrays are not copied."""
    if len(indices) == rows[0].shape[-1]:
        return rows
    return cast(_Rows, rows._make(np.take(a, indices, axis=-1) for a in rows))


def replaced(rows: _Rows, indices: Integers, others: _Rows) -> _Rows:
    """Return a copy in which the rows of some of the vehicles are replaced."""
    if len(indices) == rows[0].shape[-1]:
        return others
    copies = [a.copy() for a in rows]
    for a, b in zip(copies, others, strict=True):
        a[..., indices] = b
    return cast(_Rows, rows._make(copies))


def _force_errors(state: Sequence[Number], command: Sequence[Number], stage: Stage) -> tuple[Number, Number]:
    """Return F_u [N], F_r [N m] of a command at the speed of the state, minus the forces that the actuators apply."""
    _, _, _, u, _, _, F_u, F_r = state
    return command[0] - F_u, command[1] * (stage.torque + stage.fin * u * u) - F_r


def actuated(state: Sequence[Number], command: Sequence[Number], stage: Stage) -> tuple[Number, Number, Number, Number]:
    """Return the mean loads X [N], N [N m] on the vehicle in a stage, and the actuators' F_u, F_r at its end."""
    *_, F_u, F_r = state
    error_u, error_r = _force_errors(state, command, stage)
    mean_u, mean_r = F_u + stage.share * error_u, F_r + stage.share * error_r
    return mean_u + stage.X, mean_r + stage.N, F_u + stage.gain * error_u, F_r + stage.gain * error_r


def next_state(
    state: Sequence[Number], command: Sequence[Number], stage: Stage, coefficients: Coefficients, substeps: int, ns: Any
) -> list[Number]:
    """Return the `STATE_ROWS` components of the state at the end of a stage, after `substeps` integration steps."""
    x, y, psi, u, v, r, *_ = state
    X, N, *force = actuated(state, command, stage)
    _, Y, _ = from_outside((stage.X, stage.Y, stage.N), coefficients)
    load, current, motion = (X, Y, N), (stage.V_x, stage.V_y), (x, y, psi, u, v, r)
    for _ in range(substeps):
        motion = rk4_step(motion, load, coefficients, stage.dt / substeps, current, ns)
    return [*motion, *force]


def stage_costs(
    state: Sequence[Number],
    command: Sequence[Number],
    after: Sequence[Number],
    stage: Stage,
    weights: CostWeights,
    ns: Any,
) -> tuple[Number, Number, Number]:
    """Return the costs [m^2 s] of a stage: of the position error and of the sway at its end, and of the commands."""
    x, y, _, _, v, *_ = after
    x_e, y_e = x - stage.target_x, y - stage.target_y
    error_u, error_r = _force_errors(state, command, stage)
    square = weights.huber * weights.huber
    error = 2 * square * (ns.sqrt(1 + (x_e * x_e + y_e * y_e) / square) - 1)
    effort = (weights.surge * error_u) ** 2 + (weights.yaw * error_r) ** 2
    return error_weight(stage, weights) * error, stage.dt * (weights.sway * v) ** 2, stage.dt * effort


def error_weight(stage: Stage, weights: CostWeights) -> Number:
    """Return the weight [s] of the position error at the end of a stage."""
    return stage.dt + stage.last * weights.terminal


def constants(rows: Sequence[Any]) -> tuple[Coefficients, Any]:
    """Return coefficients and weights from the rows of a kernel that describe the problem."""
    size = len(rows) - len(_WEIGHTS)
    return with_names(rows[:size]), SimpleNamespace(**dict(zip(_WEIGHTS, rows[size:], strict=True)))


@cache
def prediction_kernel(feedback: bool, substeps: int, size: int) -> Kernel:
    """Return the kernel that predicts states and cost for given commands, stage by stage.

    Args:
        feedback: whether to add the feedback of a Gauss-Newton step to the commands, and to clip them to the limits.
        substeps: see `next_state`.
        size: number of rows of vehicle and weights.
    """

    def equation(state: Any, cost: Any, stage: Any, constant: Any, commands: Any, **change: Any) -> Mapping[str, Any]:
        stage, (coefficients, weights) = Stage(*stage), constants(constant)
        command = [*commands]
        for i in range(COMMAND_SIZE if feedback else 0):
            limit, gains = change["limits"][i], change["gains"][i * STATE_ROWS : (i + 1) * STATE_ROWS]
            for gain, a, b in zip(gains, state, change["planned"], strict=True):
                command[i] = command[i] + gain * (a - b)
            command[i] = SYMBOLS.clip(command[i], -limit, limit)
        after = next_state(state, command, stage, coefficients, substeps, SYMBOLS)
        costs = stage_costs(state, command, after, stage, weights, SYMBOLS)
        applied = {"applied": command} if feedback else {}
        return {"state": after, "cost": [cost[0] + costs[0] + costs[1] + costs[2]], "states": after, **applied}

    rows = {"state": STATE_ROWS, "cost": 1, "stage": STAGE_ROWS, "constant": size, "commands": COMMAND_SIZE}
    if feedback:
        rows |= {"limits": COMMAND_SIZE, "planned": STATE_ROWS, "gains": COMMAND_SIZE * STATE_ROWS}
    over_time = ("stage", "commands", "states", "applied", "planned", "gains")
    return Kernel.traced(equation, rows, over_time, structural=True, blocked=True)


@dataclass(frozen=True)
class OptimalControl:
    """The problem for a nominal vehicle. The caller must silence warnings of overflow."""

    vehicle: Vehicle
    weights: CostWeights

    @cached_property
    def substeps(self) -> int:
        """Integration steps in a stage, with which the longest stage of a hard turn is stable."""
        rate = float(fastest_rate(self.vehicle.all_coefficients, (0.0, 0.0, 0.0), _HARD_TURN))
        return math.ceil(_LONGEST_STAGE * rate / MAX_STIFFNESS)

    def constant(self, n: int) -> Array:
        """Return the rows of vehicle and weights for n vehicles, shape (rows, n)."""
        return repeated(np.array((*self.vehicle.all_coefficients, *astuple(self.weights)))[:, None], n)

    def predict(
        self,
        start: Array,
        commands: Array,
        horizon: Horizon,
        plan: Plan | None = None,
        change: GaussNewtonStep | None = None,
    ) -> Plan:
        """Return the plan of commands, shape (K, COMMAND_SIZE, N), from a state, shape (STATE_ROWS, N).

        With a plan and a Gauss-Newton step from it, the feedback of the step is added to the commands, which are then
        clipped to the limits. The commands must include `step` already.
        """
        steps, _, n = commands.shape
        states, cost = np.empty((steps + 1, STATE_ROWS, n)), np.zeros((1, n))
        states[0], commands = start, np.ascontiguousarray(commands)
        arrays = {"state": states[0].copy(), "cost": cost, "stage": horizon.stages, "constant": self.constant(n)}
        arrays |= {"commands": commands, "states": states[1:]}
        if plan is not None and change is not None:
            arrays |= {"limits": horizon.limits, "planned": plan.states[:-1], "gains": change.feedback}
            kernel = prediction_kernel(True, self.substeps, len(arrays["constant"]))
            kernel.bound(**arrays, applied=(applied := np.empty_like(commands)))(0, steps)
        else:
            prediction_kernel(False, self.substeps, len(arrays["constant"])).bound(**arrays)(0, steps)
            applied = commands
        return Plan(applied, states, np.where(np.isfinite(cost[0]), cost[0], np.inf))

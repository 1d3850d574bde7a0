"""An optimal control problem for many vehicles at once: what is known, what is predicted, and what it costs.

`gauss_newton` solves it by kernels.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass, fields
from functools import cache
from types import SimpleNamespace
from typing import Any, NamedTuple, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from auv_gym.codegen.graph import SYMBOLS
from auv_gym.codegen.kernel import Kernel
from auv_gym.physics.dynamics import rk4_step
from auv_gym.physics.intervals import check_number
from auv_gym.physics.namespaces import Array, Number
from auv_gym.physics.vehicle import Coefficients, Vehicle
from baselines.estimation.kalman import VEHICLE_ROWS, repeated
from baselines.estimation.sea_model import PLACE

Integers = NDArray[np.int64]

STATE_ROWS = PLACE.V_x
"""Size of the state: x, y [m], psi [rad] in the world, u, v [m/s] relative to the water, r [rad/s], what the actuators
apply, F_u [N], F_r [N m]: the rows of an `Estimate` in front of the current, in its order."""
COMMAND_SIZE = 2  # how many values a command has: F_u [N], F_r [N m]


@dataclass(frozen=True)
class CostWeights:
    """What is minimised: the integral over the horizon of H(e) + (surge dF_u)^2 + (yaw dF_r)^2 + (sway v)^2.

    e is the position error; H(e) = 2 huber^2 (sqrt(1 + e^2/huber^2) - 1), the pseudo-Huber function, is e^2 where e is
    small; dF is a command less what the actuator applies. Speed through the water sideways is what the many bad minima
    have in common that turn or go astern.
    """

    huber: float  # [m] error from which its cost grows in proportion only
    surge: float  # [m/N]
    yaw: float  # [1/N]
    sway: float  # [s]
    terminal: float  # [s] how long the error at the end counts on

    def __post_init__(self) -> None:
        for field in fields(self):
            least = 0.0 if field.name in ("sway", "terminal") else 1e-9
            check_number(f"weight {field.name}", getattr(self, field.name), least, 1e6)


_WEIGHTS = tuple(field.name for field in fields(CostWeights))
"""Names of the fields of `CostWeights`."""


class Stage(NamedTuple):
    """One stage ahead, as it is known."""

    dt: Number  # [s] how long it lasts
    aim_x: Number  # [m] where the vehicle should be at its end, in the world
    aim_y: Number  # [m]
    V_x: Number  # [m/s] current
    V_y: Number  # [m/s]
    X: Number  # [N] load on the hull
    Y: Number  # [N]
    N: Number  # [N m]
    gain: Number  # share of the way to the command that the actuators' force has made at its end
    share: Number  # the same of its mean
    last: Number  # 1 for the last stage of a horizon, 0 for the others
    torque: Number  # share of a commanded torque that acts at any speed: 1, of fins 0
    fin: Number  # [s^2/m^2] share of it that acts per squared surge speed: that of fins, else 0


KNOWN = len(Stage._fields)  # how many numbers a stage is known by


class Horizon(NamedTuple):
    """K stages ahead of N vehicles."""

    known: Array  # the rows of a `Stage`, shape (K, KNOWN, N)
    limits: Array  # [N], [N m] of the commands, shape (2, N)


class Plan(NamedTuple):
    """Commands and what comes of them."""

    commands: Array  # shape (K, COMMAND_SIZE, N)
    states: Array  # shape (K + 1, STATE_ROWS, N)
    cost: Array  # [m^2 s], shape (N,); infinite where no finite states come of them


class Improvement(NamedTuple):
    """How commands should change: by `step` + `feedback` (state - state of the plan)."""

    step: Array  # shape (K, COMMAND_SIZE, N)
    feedback: Array  # shape (K, COMMAND_SIZE * STATE_ROWS, N): the rows of K matrices one after the other
    promise: Array  # [m^2 s] how much lower the cost would be if all were linear, shape (N,)


_Rows = TypeVar("_Rows", bound=Any)
"""A named tuple of arrays whose last axis goes through vehicles, as `Horizon`, `Plan` and `Improvement` are."""


def taken(rows: _Rows, few: Integers) -> _Rows:
    """Return what belongs to a few of the vehicles; the arrays may be the given ones where that is all of them."""
    if len(few) == rows[0].shape[-1]:
        return rows
    return cast(_Rows, rows._make(np.take(a, few, axis=-1) for a in rows))


def replaced(rows: _Rows, few: Integers, others: _Rows) -> _Rows:
    """Return a copy in which what belongs to a few of the vehicles is replaced."""
    if len(few) == rows[0].shape[-1]:
        return others
    copies = [a.copy() for a in rows]
    for a, b in zip(copies, others, strict=True):
        a[..., few] = b
    return cast(_Rows, rows._make(copies))


def _missing(state: Sequence[Number], command: Sequence[Number], known: Stage) -> tuple[Number, Number]:
    """Return F_u [N], F_r [N m] of a command less what the actuators apply; of fins at the speed of the state."""
    _, _, _, u, _, _, F_u, F_r = state
    return command[0] - F_u, command[1] * (known.torque + known.fin * u * u) - F_r


def actuated(state: Sequence[Number], command: Sequence[Number], known: Stage) -> tuple[Number, Number, Number, Number]:
    """Return the mean loads X [N], N [N m] on the hull over a stage, and the actuators' F_u, F_r at its end."""
    *_, F_u, F_r = state
    missing_u, missing_r = _missing(state, command, known)
    mean_u, mean_r = F_u + known.share * missing_u, F_r + known.share * missing_r
    return mean_u + known.X, mean_r + known.N, F_u + known.gain * missing_u, F_r + known.gain * missing_r


def stage(
    state: Sequence[Number], command: Sequence[Number], known: Stage, coefficients: Coefficients, ns: Any
) -> list[Number]:
    """Return the `STATE_ROWS` components of the state at a stage's end."""
    x, y, psi, u, v, r, *_ = state
    X, N, *force = actuated(state, command, known)
    load, current = (X, known.Y, N), (known.V_x, known.V_y)
    return [*rk4_step((x, y, psi, u, v, r), load, coefficients, known.dt, current, ns), *force]


def stage_costs(
    state: Sequence[Number],
    command: Sequence[Number],
    after: Sequence[Number],
    known: Stage,
    weights: CostWeights,
    ns: Any,
) -> tuple[Number, Number, Number]:
    """Return the costs [m^2 s] of a stage: of the position error and the sway at its end, and of the commands."""
    x, y, _, _, v, *_ = after
    x_e, y_e = x - known.aim_x, y - known.aim_y
    missing_u, missing_r = _missing(state, command, known)
    square = weights.huber * weights.huber
    error = 2 * square * (ns.sqrt(1 + (x_e * x_e + y_e * y_e) / square) - 1)
    effort = (weights.surge * missing_u) ** 2 + (weights.yaw * missing_r) ** 2
    return error_weight(known, weights) * error, known.dt * (weights.sway * v) ** 2, known.dt * effort


def error_weight(known: Stage, weights: CostWeights) -> Number:
    """Return the time [s] that the position error at a stage's end counts for."""
    return known.dt + known.last * weights.terminal


CONSTANTS = VEHICLE_ROWS + len(_WEIGHTS)
"""How many rows tell a kernel of the problem: vehicle, then weights."""


def constants(rows: Sequence[Any]) -> tuple[Coefficients, Any]:
    """Return coefficients and weights from the `CONSTANTS` rows of a kernel."""
    weights = SimpleNamespace(**dict(zip(_WEIGHTS, rows[VEHICLE_ROWS:], strict=True)))
    return Coefficients(*rows[:VEHICLE_ROWS]), weights


@cache
def prediction_kernel(feedback: bool) -> Kernel:
    """Return the kernel that predicts, stage by stage, what comes of commands.

    Args:
        feedback: whether to add what a descent wants for states that are not those of its plan, within the limits.
    """

    def equation(state: Any, cost: Any, known: Any, constant: Any, commands: Any, **descent: Any) -> Mapping[str, Any]:
        ahead, (coefficients, weights) = Stage(*known), constants(constant)
        command = [*commands]
        for i in range(COMMAND_SIZE if feedback else 0):
            limit, gains = descent["limits"][i], descent["gains"][i * STATE_ROWS : (i + 1) * STATE_ROWS]
            for gain, a, b in zip(gains, state, descent["planned"], strict=True):
                command[i] = command[i] + gain * (a - b)
            command[i] = SYMBOLS.clip(command[i], -limit, limit)
        after = stage(state, command, ahead, coefficients, SYMBOLS)
        costs = stage_costs(state, command, after, ahead, weights, SYMBOLS)
        applied = {"applied": command} if feedback else {}
        return {"state": after, "cost": [cost[0] + costs[0] + costs[1] + costs[2]], "states": after, **applied}

    rows = {"state": STATE_ROWS, "cost": 1, "known": KNOWN, "constant": CONSTANTS, "commands": COMMAND_SIZE}
    if feedback:
        rows |= {"limits": COMMAND_SIZE, "planned": STATE_ROWS, "gains": COMMAND_SIZE * STATE_ROWS}
    over_time = ("known", "commands", "states", "applied", "planned", "gains")
    return Kernel.traced(equation, rows, over_time, structural=True, blocked=True)


@dataclass(frozen=True)
class OptimalControl:
    """The problem of a vehicle as it is known; warnings of overflow are for the caller to silence."""

    vehicle: Vehicle
    weights: CostWeights

    def constant(self, n: int) -> Array:
        """Return the `CONSTANTS` of n vehicles."""
        return repeated(np.array((*self.vehicle.coefficients, *astuple(self.weights)))[:, None], n)

    def planned(
        self,
        start: Array,
        commands: Array,
        ahead: Horizon,
        plan: Plan | None = None,
        descent: Improvement | None = None,
    ) -> Plan:
        """Return what follows from commands, shape (K, COMMAND_SIZE, N), from a state, shape (STATE_ROWS, N).

        With a plan and a descent from it, whose step the commands hold already, its feedback is added to the commands,
        and they are kept within the limits.
        """
        steps, _, n = commands.shape
        states, cost = np.empty((steps + 1, STATE_ROWS, n)), np.zeros((1, n))
        states[0], commands = start, np.ascontiguousarray(commands)
        arrays = {"state": states[0].copy(), "cost": cost, "known": ahead.known, "constant": self.constant(n)}
        arrays |= {"commands": commands, "states": states[1:]}
        if plan is not None and descent is not None:
            following = {"limits": ahead.limits, "planned": plan.states[:-1], "gains": descent.feedback}
            prediction_kernel(True).bound(**arrays, **following, applied=(applied := np.empty_like(commands)))(0, steps)
        else:
            prediction_kernel(False).bound(**arrays)(0, steps)
            applied = commands
        return Plan(applied, states, np.where(np.isfinite(cost[0]), cost[0], np.inf))

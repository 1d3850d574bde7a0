"""An optimal control problem for many vehicles at once: what is known, what is predicted, and what it costs.

`gauss_newton` solves it on arrays, `casadi_solver` with CasADi.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from auv_gym.dynamics import rk4_step
from auv_gym.intervals import check_number
from auv_gym.namespaces import ARRAYS, Number
from auv_gym.vehicle import Vehicle
from baselines.estimation.sea_model import AT
from baselines.policy import Array

Integers = NDArray[np.int64]

STATES = AT.V_x
"""Size of the state: x, y [m], psi [rad] in the world, u, v [m/s] relative to the water, r [rad/s], what the actuators
apply, F_u [N], F_r [N m]: the rows of an `Estimate` in front of the current, in its order."""
POSITION = slice(AT.x_e, AT.psi)  # where x, y stand in the state
COMMANDS = 2  # how many values a command has: F_u [N], F_r [N m]


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


class Horizon(NamedTuple):
    """K stages ahead of N vehicles, as they are known."""

    dt: Array  # [s] how long they last, shape (K, N)
    aim: Array  # [m] where the vehicle should be at their ends, in the world, shape (K, 2, N)
    current: Array  # [m/s] V_x, V_y, shape (K, 2, N)
    load: Array  # X [N], Y [N], N [N m] on the hull, shape (K, 3, N)
    gain: Array  # share of the way to the command that the actuators' force has made at their ends, shape (K, N)
    share: Array  # the same of its mean, shape (K, N)
    limits: Array  # [N], [N m] of the commands, shape (2, N)


class Plan(NamedTuple):
    """Commands and what comes of them."""

    commands: Array  # shape (K, COMMANDS, N)
    states: Array  # shape (K + 1, STATES, N)
    cost: Array  # [m^2 s], shape (N,); infinite where no finite states come of them


class Descent(NamedTuple):
    """How commands should change: by `step` + `feedback` (state - state of the plan)."""

    step: Array  # shape (K, COMMANDS, N)
    feedback: Array  # shape (K, COMMANDS, STATES, N)
    promise: Array  # [m^2 s] how much lower the cost would be if all were linear, shape (N,)


Rows = TypeVar("Rows", Horizon, Plan, Descent)


def taken(rows: Rows, few: Integers) -> Rows:
    """Return what belongs to a few of the vehicles."""
    return type(rows)(*(a[..., few] for a in rows))


def replaced(rows: Rows, few: Integers, others: Rows) -> Rows:
    """Return a copy in which what belongs to a few of the vehicles is replaced."""
    copies = [a.copy() for a in rows]
    for a, b in zip(copies, others, strict=True):
        a[..., few] = b
    return type(rows)(*copies)


def stage(
    state: Sequence[Number], command: Sequence[Number], known: Sequence[Any], vehicle: Vehicle, ns: Any
) -> list[Number]:
    """Return the `STATES` components of the state at a stage's end; `known` are its rows of a `Horizon` but limits."""
    dt, _, (V_x, V_y), (X, Y, N), gain, share = known
    x, y, psi, u, v, r, F_u, F_r = state
    command_u, command_r = command
    missing_u, missing_r = command_u - F_u, command_r - F_r
    load = F_u + share * missing_u + X, Y, F_r + share * missing_r + N
    hull = rk4_step((x, y, psi, u, v, r), load, vehicle.coefficients, dt, (V_x, V_y), ns)
    return [*hull, F_u + gain * missing_u, F_r + gain * missing_r]


def stage_cost(
    state: Sequence[Number],
    command: Sequence[Number],
    after: Sequence[Number],
    aim: Sequence[Number],
    weights: CostWeights,
    ns: Any,
) -> tuple[Number, Number]:
    """Return the cost [m^2] of each second of a stage, and that of the position error alone at its end."""
    *_, F_u, F_r = state
    x, y, _, _, v, *_ = after
    command_u, command_r = command
    aim_x, aim_y = aim
    x_e, y_e = x - aim_x, y - aim_y
    missing_u, missing_r = command_u - F_u, command_r - F_r
    square = weights.huber * weights.huber
    error = 2 * square * (ns.sqrt(1 + (x_e * x_e + y_e * y_e) / square) - 1)
    effort = (weights.surge * missing_u) ** 2 + (weights.yaw * missing_r) ** 2
    return error + effort + (weights.sway * v) ** 2, error


@dataclass(frozen=True)
class OptimalControl:
    """The problem of a vehicle as it is known; warnings of overflow are for the caller to silence."""

    vehicle: Vehicle
    weights: CostWeights

    def planned(
        self, start: Array, commands: Array, ahead: Horizon, plan: Plan | None = None, descent: Descent | None = None
    ) -> Plan:
        """Return what comes of commands, shape (K, COMMANDS, N), from a state, shape (STATES, N).

        With a plan and a descent from it, whose step the commands hold already, its feedback is added to the commands,
        and they are kept within the limits.
        """
        states, applied = np.empty((len(commands) + 1, *start.shape)), commands.copy()
        states[0], cost = start, np.zeros(start.shape[1])
        for k, known in enumerate(zip(*ahead[:-1], strict=True)):
            duration, aim, *_ = known
            if plan is not None and descent is not None:
                off = states[k] - plan.states[k]
                wanted = commands[k] + (descent.feedback[k] * off).sum(axis=1)
                applied[k] = np.minimum(np.maximum(wanted, -ahead.limits), ahead.limits)
            states[k + 1] = stage(states[k], applied[k], known, self.vehicle, ARRAYS)
            each, end = stage_cost(states[k], applied[k], states[k + 1], aim, self.weights, ARRAYS)
            cost += duration * each
        cost += self.weights.terminal * end
        return Plan(applied, states, np.where(np.isfinite(cost), cost, np.inf))

"""Optimal control problem of predictive control for many vehicles: data, prediction and cost."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import astuple, dataclass, fields
from functools import cache, cached_property
from types import SimpleNamespace
from typing import Any, NamedTuple, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from auv_gym.codegen.graph import SYMBOLS
from auv_gym.codegen.kernel import Kernel
from auv_gym.physics.errors import to_world
from auv_gym.physics.intervals import check_number
from auv_gym.physics.namespaces import ARRAYS, Array, Namespace, Number, sum_of
from auv_gym.physics.stiffness import MAX_STIFFNESS, fastest_rate
from auv_gym.physics.vehicle import PAPER_VEHICLE, Vehicle, with_names
from auv_gym.task.model import PLANE, Model
from auv_gym.task.observation import Observation
from baselines.control.backstepping import GAINS, tracking_forces
from baselines.estimation.filter_equations import PLANE_FILTER, FilterModel
from baselines.estimation.kalman import repeated

Integers = NDArray[np.int64]

_LONGEST_STAGE = 0.5  # [s] in the paper's units, at cruise
_HARD_TURN = (PAPER_VEHICLE.speed, 0.3, 0.3)
"""Surge, sway [m/s] and yaw rate [rad/s] at which a prediction must be stable, in the paper's units."""


@dataclass(frozen=True)
class CostWeights:
    """Weights of the cost: the integral over the horizon of H(e) + (surge dF_u)^2 + (yaw dF_r)^2 + (sway v)^2.

    In space the pitch moment has the weight of the yaw moment; for the sway there see `baselines.space.nmpc`.

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
    """Data of one stage of the horizon in the plane; for any other motion see `System`."""

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


@dataclass(frozen=True)
class System:
    """What predictive control takes from a kind of motion.

    The state is that of the `model`, then the forces of the actuators: the first rows of an `Estimate`.

    Args:
        filter: the filter, which names the `model`.
        Stage: NamedTuple of a stage. In this order: length, target, current, load, `gain`, `share` and `last` of
            `Stage`, and `torque` and `fin` for each moment.
        in_world: returns a displacement along the measured body axes in the world, for (it, observation, namespace).
        sway_cost: returns the cost of a state per time [m^2], for (state, weight of the sway, namespace).
        law: returns the forces of a stable law for (observation, vehicle).
        planes: returns the planes of a vehicle, each a `Vehicle`.
    """

    filter: FilterModel
    Stage: Any
    in_world: Callable[..., Sequence[Number]]
    sway_cost: Callable[..., Number]
    law: Callable[..., Sequence[Number]]
    planes: Callable[[Any], Sequence[Vehicle]]

    @property
    def model(self) -> Model:
        """The kind of motion."""
        return self.filter.sea.model

    @cached_property
    def states(self) -> int:
        """Number of entries of a state."""
        return int(self.model.forces.stop)

    @cached_property
    def commands(self) -> int:
        """Number of entries of a command."""
        return len(self.model.channels)

    @cached_property
    def target(self) -> slice:
        """Rows of the desired position in a stage."""
        return slice(1, 1 + len(self.model.position))

    @cached_property
    def current(self) -> slice:
        """Rows of the current in a stage."""
        return slice(self.target.stop, self.target.stop + len(self.model.current))

    @cached_property
    def load(self) -> slice:
        """Rows of the load in a stage."""
        return slice(self.current.stop, self.current.stop + len(self.model.load))

    def torques(self, stage: Any) -> list[tuple[Number, Number]]:
        """Return `Stage.torque` and `Stage.fin` of each moment."""
        rows = stage[self.load.stop + 3 :]
        return [*zip(rows[::2], rows[1::2], strict=True)]


def _in_world(ahead: Sequence[Number], o: Observation, _: Namespace) -> tuple[Number, ...]:
    return to_world(ahead[0], ahead[1], o.cos_psi, o.sin_psi)


def _sway_cost(state: Sequence[Number], weight: Number, _: Any) -> Number:
    return (weight * state[PLANE.plant.v]) ** 2


def _law(o: Observation, vehicle: Vehicle) -> tuple[Number, ...]:
    return tracking_forces(o, vehicle, GAINS["normalised"], ARRAYS)


def _planes(vehicle: Vehicle) -> tuple[Vehicle]:
    return (vehicle,)


PLANE_SYSTEM = System(PLANE_FILTER, Stage, _in_world, _sway_cost, _law, _planes)
"""Motion in the horizontal plane."""
STATE_ROWS = PLANE_SYSTEM.states
"""Size of the state in the plane: x, y [m], psi [rad] in the world, u, v [m/s] relative to the water, r [rad/s], forces
of the actuators F_u [N], F_r [N m]."""
COMMAND_SIZE = PLANE_SYSTEM.commands  # F_u [N], F_r [N m]
STAGE_ROWS = len(Stage._fields)  # number of entries of a stage in the plane


class Horizon(NamedTuple):
    """K future stages of N vehicles; a state has S entries, a command C."""

    stages: Array  # the rows of a `Stage`, shape (K, rows, N)
    limits: Array  # [N], [N m] of the commands, shape (C, N)


class Plan(NamedTuple):
    """Commands with the predicted states and cost."""

    commands: Array  # shape (K, C, N)
    states: Array  # shape (K + 1, S, N)
    cost: Array  # [m^2 s], shape (N,); infinite if the states are not finite


class GaussNewtonStep(NamedTuple):
    """Change of the commands of a plan: `step` + `feedback` (state - state of the plan)."""

    step: Array  # shape (K, C, N)
    feedback: Array  # shape (K, C S, N): the rows of K matrices one after the other
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


def _force_errors(state: Sequence[Number], command: Sequence[Number], stage: Any, system: System) -> list[Number]:
    """Return the forces of a command at the speed of the state, minus those that the actuators apply."""
    u, (F_u, *forces) = state[system.model.plant.u], state[system.model.forces]
    each = zip(command[1:], forces, system.torques(stage), strict=True)
    return [command[0] - F_u, *(c * (torque + fin * u * u) - force for c, force, (torque, fin) in each)]


def actuated(
    state: Sequence[Number], command: Sequence[Number], stage: Any, system: System = PLANE_SYSTEM
) -> tuple[list[Number], list[Number]]:
    """Return the mean loads in a stage on which the actuators act, and the actuators' forces at its end."""
    errors, forces, load = _force_errors(state, command, stage, system), state[system.model.forces], stage[system.load]
    means = [force + stage.share * error for force, error in zip(forces, errors, strict=True)]
    return (
        [mean + load[row] for mean, row in zip(means, system.filter.sea.driven, strict=True)],
        [force + stage.gain * error for force, error in zip(forces, errors, strict=True)],
    )


def next_state(
    state: Sequence[Number],
    command: Sequence[Number],
    stage: Any,
    coefficients: Any,
    substeps: int,
    ns: Any,
    system: System = PLANE_SYSTEM,
) -> list[Number]:
    """Return the components of the state at the end of a stage, after `substeps` integration steps."""
    model, motion = system.model, tuple(state[: system.model.forces.start])
    driven, force = actuated(state, command, stage, system)
    load = [*model.from_outside(stage[system.load], coefficients)]
    for row, number in zip(system.filter.sea.driven, driven, strict=True):
        load[row] = number
    for _ in range(substeps):
        motion = model.advance(motion, load, coefficients, stage.dt / substeps, stage[system.current], ns)
    return [*motion, *force]


def stage_costs(
    state: Sequence[Number],
    command: Sequence[Number],
    after: Sequence[Number],
    stage: Any,
    weights: CostWeights,
    ns: Any,
    system: System = PLANE_SYSTEM,
) -> tuple[Number, Number, Number]:
    """Return the costs [m^2 s] of a stage: of the position error and of the sway at its end, and of the commands."""
    errors = position_errors(after, stage, system)
    surge, *moments = _force_errors(state, command, stage, system)
    square = weights.huber * weights.huber
    error = 2 * square * (ns.sqrt(1 + sum_of(e * e for e in errors) / square) - 1)
    effort = sum_of([(weights.surge * surge) ** 2, *((weights.yaw * moment) ** 2 for moment in moments)])
    return (
        error_weight(stage, weights) * error,
        stage.dt * system.sway_cost(after, weights.sway, ns),
        stage.dt * effort,
    )


def position_errors(after: Sequence[Number], stage: Any, system: System) -> list[Number]:
    """Return the position errors [m] at the end of a stage."""
    return [x - wanted for x, wanted in zip(after, stage[system.target], strict=False)]


def error_weight(stage: Any, weights: CostWeights) -> Number:
    """Return the weight [s] of the position error at the end of a stage."""
    return stage.dt + stage.last * weights.terminal


def constants(rows: Sequence[Any]) -> tuple[Any, Any]:
    """Return coefficients and weights from the rows of a kernel that describe the problem."""
    size = len(rows) - len(_WEIGHTS)
    return with_names(rows[:size]), SimpleNamespace(**dict(zip(_WEIGHTS, rows[size:], strict=True)))


@cache
def prediction_kernel(feedback: bool, substeps: int, size: int, system: System = PLANE_SYSTEM) -> Kernel:
    """Return the kernel that predicts states and cost for given commands, stage by stage.

    Args:
        feedback: whether to add the feedback of a Gauss-Newton step to the commands, and to clip them to the limits.
        substeps: see `next_state`.
        size: number of rows of vehicle and weights.
        system: the kind of motion.
    """
    states, controls = system.states, system.commands

    def equation(state: Any, cost: Any, stage: Any, constant: Any, commands: Any, **change: Any) -> Mapping[str, Any]:
        stage, (coefficients, weights) = system.Stage(*stage), constants(constant)
        command = [*commands]
        for i in range(controls if feedback else 0):
            limit, gains = change["limits"][i], change["gains"][i * states : (i + 1) * states]
            for gain, a, b in zip(gains, state, change["planned"], strict=True):
                command[i] = command[i] + gain * (a - b)
            command[i] = SYMBOLS.clip(command[i], -limit, limit)
        after = next_state(state, command, stage, coefficients, substeps, SYMBOLS, system)
        costs = stage_costs(state, command, after, stage, weights, SYMBOLS, system)
        applied = {"applied": command} if feedback else {}
        return {"state": after, "cost": [cost[0] + costs[0] + costs[1] + costs[2]], "states": after, **applied}

    rows = {"state": states, "cost": 1, "stage": len(system.Stage._fields), "constant": size, "commands": controls}
    if feedback:
        rows |= {"limits": controls, "planned": states, "gains": controls * states}
    over_time = ("stage", "commands", "states", "applied", "planned", "gains")
    return Kernel.traced(equation, rows, over_time, structural=True, blocked=True)


@dataclass(frozen=True)
class OptimalControl:
    """The problem for a nominal vehicle. The caller must silence warnings of overflow."""

    vehicle: Any
    weights: CostWeights
    system: System = PLANE_SYSTEM

    @cached_property
    def substeps(self) -> int:
        """Integration steps in a stage, with which the longest stage of a hard turn is stable."""
        planes = self.system.planes(self.vehicle)
        rates = (float(fastest_rate(plane.all_coefficients, (0.0, 0.0, 0.0), _HARD_TURN)) for plane in planes)
        return math.ceil(_LONGEST_STAGE * max(rates) / MAX_STIFFNESS)

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
        """Return the plan of commands, shape (K, C, N), from a state, shape (S, N).

        With a plan and a Gauss-Newton step from it, the feedback of the step is added to the commands, which are then
        clipped to the limits. The commands must include `step` already.
        """
        steps, _, n = commands.shape
        states, cost = np.empty((steps + 1, self.system.states, n)), np.zeros((1, n))
        states[0], commands = start, np.ascontiguousarray(commands)
        arrays = {"state": states[0].copy(), "cost": cost, "stage": horizon.stages, "constant": self.constant(n)}
        arrays |= {"commands": commands, "states": states[1:]}
        if plan is not None and change is not None:
            arrays |= {"limits": horizon.limits, "planned": plan.states[:-1], "gains": change.feedback}
            kernel = prediction_kernel(True, self.substeps, len(arrays["constant"]), self.system)
            kernel.bound(**arrays, applied=(applied := np.empty_like(commands)))(0, steps)
        else:
            kernel = prediction_kernel(False, self.substeps, len(arrays["constant"]), self.system)
            kernel.bound(**arrays)(0, steps)
            applied = commands
        return Plan(applied, states, np.where(np.isfinite(cost[0]), cost[0], np.inf))

"""A whole episode as an optimal control problem with full information.

The commands a_1 ... a_K of the K control periods minimise

    sum_k w_k |p_k - p_R,k|^2 + `EFFORT_WEIGHT` sum_k |a_k|^2        (1)

with the simulated position p and the position p_R of the reference. The commands are bounded by the limits at which the
actuators saturate, and by those that their rate limits allow. After the first third of the episode the weights w_k add
up to one; there the root mean square of the error is the steady-state error of the score. In the first third the
weights are small but positive, so that the solution is unique. Positions are in the paper's units
(`auv_gym.physics.units`): the same weights and tolerances apply to vehicles of all sizes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_gym.codegen.derivatives import jacobian
from auv_gym.codegen.graph import SYMBOLS
from auv_gym.codegen.kernel import Kernel
from auv_gym.codegen.matrices import congruence, dot, symmetric, triangle
from auv_gym.effects.actuators import Reach
from auv_gym.effects.space import MAX_PITCH
from auv_gym.physics.namespaces import Array, sum_of_squares
from auv_gym.physics.units import Units
from auv_gym.scenarios.episode import Episode
from auv_gym.scenarios.scenario import Scenario
from auv_gym.task.simulation import Parameters, Parts, constants_of, moved, parameter_row
from baselines.control.nmpc.gauss_newton import feedback_law
from baselines.control.privileged.truth import Truth

TRANSIENT_WEIGHT = 1e-3
"""Sum of the weights of the errors in the first third."""
STEEP, STEEP_WEIGHT = 0.9 * MAX_PITCH, 10.0
"""Pitch [rad] in space beyond which its excess costs this weight [m^2/rad^2] times the square: an episode ends at
`MAX_PITCH`."""
INSIDE = 1.0 - 1e-9
"""Largest change of a force as a share of its rate limit: so the change depends on the command."""
EFFORT_WEIGHT = 1e-9
"""Weight [m^2 of the paper's vehicle] of the commands: it makes the solution unique."""
STEADY_RMSE = 3
"""The steady-state error leaves out the first one of so many equal parts of an episode, as in `evaluation.metrics`."""


@dataclass(frozen=True)
class Problem:
    """Data of N episodes of K control periods."""

    parts: Parts  # of the simulation
    begun: Array  # initial state and forces, shape (states, N)
    samples: Array  # entries of the `Sample` at the end of each period, shape (K, `Parts.sample_rows`, N)
    parameters: Array  # entries of the `Parameters`, shape (`Parts.parameter_rows`, N)
    limits: Array  # of the commands; zero until the first command acts, shape (K, channels, N)
    weight: Array  # w_k in (1) [1/m^2 of this vehicle], shape (K, 1, N)
    delay: NDArray[np.int64]  # control periods until a command acts, shape (N,)
    unit: Array  # length of this vehicle [m] that corresponds to 1 m of the paper's vehicle, shape (N,)

    @classmethod
    def of(cls, scenario: Scenario, episodes: Sequence[Episode]) -> Problem:
        """Return the problem of N episodes of a scenario.

        Raises:
            InfeasibleReferenceError: an episode's path cannot be followed in still water.
        """
        truth, n, steps = Truth.of(scenario, episodes), len(episodes), scenario.steps
        p, samples = truth.parameters, truth.samples
        first, channels = samples[0, p.parts.model.reference].T.tolist(), len(p.parts.model.channels)
        begun = [e.initial_state(R) for e, R in zip(episodes, first, strict=True)]
        rows = np.array([np.broadcast_to(np.asarray(row, dtype=np.float64), n) for row in parameter_row(p)])
        delay = np.broadcast_to(np.asarray(truth.delay), n).astype(np.int64)
        reach = np.minimum(1.0, np.stack([np.broadcast_to(own.level, n) for own in constants_of(p, Reach)]))
        acts = np.arange(steps)[:, None] >= delay
        weight = np.full((steps, 1, n), TRANSIENT_WEIGHT / steps)
        weight[steps // STEADY_RMSE :] = 1.0 / (steps - steps // STEADY_RMSE)
        unit = Units.of(scenario.vehicle).length
        return cls(
            p.parts,
            np.concatenate((np.array(begun).T, np.zeros((channels, n)))),
            np.ascontiguousarray(samples[1:]),
            rows,
            np.ascontiguousarray(reach * acts[:, None]),
            weight / (unit * unit),
            delay,
            np.full(n, unit),
        )

    def subset(self, indices: Any) -> Problem:
        """Return the problem of some of the episodes."""
        arrays = {f.name: np.ascontiguousarray(getattr(self, f.name)[..., indices]) for f in fields(self)[1:]}
        return Problem(self.parts, **arrays)

    def between(self, first: int, end: int, begun: Array) -> Problem:
        """Return the problem of the periods from `first` to `end` with the initial states `begun`, (states, N).

        The errors in all its periods have the same weight.
        """
        weight = np.full((end - first, 1, len(self.unit)), 1.0 / (end - first)) / self.unit**2
        return replace(
            self,
            begun=np.ascontiguousarray(begun),
            samples=self.samples[first:end],
            limits=self.limits[first:end],
            weight=weight,
        )

    def simulated(
        self, trajectory: Trajectory, change: GaussNewtonStep | None = None, length: float = 1.0
    ) -> Trajectory:
        """Return the simulated trajectory after a change of the commands, with feedback about the given trajectory.

        Args:
            trajectory: commands, and states for the feedback.
            change: Gauss-Newton step from it. None: the commands are unchanged.
            length: fraction of the step.
        """
        steps, channels, n = trajectory.commands.shape
        size = len(self.begun)
        states, cost, error = np.empty((steps + 1, size, n)), np.zeros((1, n)), np.empty((steps, 1, n))
        states[0], applied = self.begun, np.empty_like(trajectory.commands)
        commands = trajectory.commands if change is None else trajectory.commands + length * change.step
        with np.errstate(over="ignore", invalid="ignore"):  # the cost of a diverged episode is infinite
            simulation_kernel(self.parts).bound(
                state=self.begun.copy(),
                cost=cost,
                command=commands,
                planned=trajectory.states[:-1],
                gains=np.zeros((steps, channels * size, n)) if change is None else change.feedback,
                limits=self.limits,
                sample=self.samples,
                weight=self.weight,
                parameters=self.parameters,
                states=states[1:],
                applied=applied,
                error=error,
            )(0, steps)
        steady_rmse = np.sqrt(error[steps // STEADY_RMSE :, 0].mean(axis=0)) / self.unit
        return Trajectory(applied, states, np.where(np.isfinite(cost[0]), cost[0], np.inf), steady_rmse)

    def gauss_newton_step(self, trajectory: Trajectory, damping: Array) -> GaussNewtonStep:
        """Return the Gauss-Newton step at a trajectory with a damping of shape (N,)."""
        steps, channels, n = trajectory.commands.shape
        size = len(self.begun)
        step, feedback = np.empty_like(trajectory.commands), np.empty((steps, channels * size, n))
        with np.errstate(all="ignore"):
            riccati_kernel(self.parts).bound(
                slope=np.zeros((size, n)),
                curvature=np.zeros((size * (size + 1) // 2, n)),
                state=trajectory.states[:-1],
                command=trajectory.commands,
                limits=self.limits,
                sample=self.samples,
                weight=self.weight,
                parameters=self.parameters,
                damping=damping[None].copy(),
                step=step,
                feedback=feedback,
            )(0, steps)
        return GaussNewtonStep(step, feedback)

    def open_loop(self, commands: Array) -> Trajectory:
        """Return the simulated trajectory of commands, shape (K, channels, N), without feedback."""
        steps, _, n = commands.shape
        states = np.zeros((steps + 1, len(self.begun), n))
        return self.simulated(Trajectory(commands, states, np.zeros(n), np.zeros(n)))


class Trajectory(NamedTuple):
    """Commands in N episodes with the simulated states and costs."""

    commands: Array  # that act in each period, shape (K, channels, N)
    states: Array  # shape (K + 1, states, N)
    cost: Array  # (1) [m^2 of the paper's vehicle], shape (N,); infinite if the states are not finite
    steady_rmse: Array  # [m of the paper's vehicle] steady-state error, shape (N,)


class GaussNewtonStep(NamedTuple):
    """Change of the commands of a trajectory: `step` + `feedback` (state - state of the trajectory)."""

    step: Array  # shape (K, channels, N)
    feedback: Array  # shape (K, channels * states, N): the rows of K matrices one after the other


def _next_state(state: Sequence[Any], command: Sequence[Any], sample: Any, parameters: Any, parts: Parts) -> list[Any]:
    """Return the components of state and forces one control period later."""
    p, first = parts.parameters(parameters), parts.model.forces.start
    body, force = moved(tuple(state[:first]), tuple(state[first:]), tuple(command), sample, p, SYMBOLS)
    return [*body, *force]


class _Range(NamedTuple):
    """The commands of an actuator with different effects: beyond them its limit or its rate limit acts."""

    low: Any
    high: Any
    per_force: Any  # command that asks for one unit of force

    @classmethod
    def of(cls, force: Any, thrust: Any, slew: Any, gain: Any, limit: Any) -> _Range:
        """Return the range of an actuator with a force [N], see `Parameters` and `Response`."""
        change = INSIDE * slew / (gain * thrust)
        low, high = (SYMBOLS.clip(force / thrust + side, -limit, limit) for side in (-change, change))
        return cls(low, high, 1.0 / thrust)

    def slope(self, command: Any, limit: Any) -> Any:
        """Return the derivative of a command with respect to the force: not zero at a bound of the rate."""
        at_low, at_high = (command <= self.low) & (self.low > -limit), (command >= self.high) & (self.high < limit)
        return SYMBOLS.where(at_low | at_high, self.per_force, 0.0)


def _ranges(state: Sequence[Any], limits: Sequence[Any], p: Parameters) -> list[_Range]:
    """Return the range of the command of each actuator.

    Commands beyond it have the same effect as its ends, so a gradient method could not leave them.
    """
    model, (_, _, *slews) = p.parts.model, p.response
    actuators = zip(state[model.forces.start :], model.thrusts(p), slews, limits, strict=True)
    return [_Range.of(force, thrust, slew, p.response.gain, limit) for force, thrust, slew, limit in actuators]


def _position_error(after: Sequence[Any], sample: Any, parts: Parts) -> list[Any]:
    """Return the position error [m] at the end of a period."""
    return [after[i] - sample[i] for i in range(len(parts.model.position))]


def _steepness(after: Sequence[Any], parts: Parts) -> dict[int, Any]:
    """Return the pitch beyond `STEEP` [rad] by its index; nothing in the plane."""
    steep = [i for i, name in enumerate(parts.model.state) if name == "theta"]
    return {i: after[i] - SYMBOLS.clip(after[i], -STEEP, STEEP) for i in steep}


def _sizes(parts: Parts) -> tuple[int, int]:
    """Return the number of states and forces, and that of the channels."""
    return parts.model.forces.stop, len(parts.model.channels)


@cache
def simulation_kernel(parts: Parts) -> Kernel:
    """Return the kernel that simulates an episode with feedback about a trajectory."""
    size, channels = _sizes(parts)

    def equation(
        state: Any, cost: Any, command: Any, planned: Any, gains: Any, limits: Any, weight: Any, **known: Any
    ) -> Mapping[str, Sequence[Any]]:
        deviation, a = [x - c for x, c in zip(state, planned, strict=True)], []
        for i, own in enumerate(_ranges(state, limits, parts.parameters(known["parameters"]))):
            unlimited = command[i] + dot(gains[i * size : (i + 1) * size], deviation)
            a.append(SYMBOLS.clip(unlimited, own.low, own.high))
        after = _next_state(state, a, known["sample"], known["parameters"], parts)
        error = sum_of_squares(_position_error(after, known["sample"], parts))
        stage_cost = weight[0] * error + EFFORT_WEIGHT * sum_of_squares(a)
        for excess in _steepness(after, parts).values():
            stage_cost = stage_cost + STEEP_WEIGHT * excess * excess
        return {"state": after, "cost": [cost[0] + stage_cost], "states": after, "applied": a, "error": [error]}

    rows = {
        "state": size,
        "cost": 1,
        "command": channels,
        "planned": size,
        "gains": channels * size,
    }
    rows |= {"limits": channels, "sample": parts.sample_rows, "weight": 1, "parameters": parts.parameter_rows}
    over_time = ("command", "planned", "gains", "limits", "sample", "weight", "states", "applied", "error")
    return Kernel.traced(equation, rows, over_time, structural=True, blocked=True)


@cache
def riccati_kernel(parts: Parts) -> Kernel:
    """Return the kernel of the Gauss-Newton step, which runs from the last period to the first."""
    size, channels = _sizes(parts)
    forces = parts.model.forces.start

    def equation(
        slope: Any, curvature: Any, state: Any, command: Any, limits: Any, weight: Any, damping: Any, **known: Any
    ) -> Mapping[str, Sequence[Any]]:
        both, w = [*state, *command], 2 * weight[0]
        after = _next_state(state, command, known["sample"], known["parameters"], parts)
        columns = list(zip(*jacobian(after, both), strict=True))
        ranges = _ranges(state, limits, parts.parameters(known["parameters"]))
        slopes = [own.slope(a, limit) for own, a, limit in zip(ranges, command, limits, strict=True)]
        for i, follows in enumerate(slopes):  # the free commands are the differences to bounds that move
            by_force, by_command = columns[forces + i], columns[size + i]
            columns[forces + i] = tuple(x + follows * y for x, y in zip(by_force, by_command, strict=True))
        V_x, V_xx = list(slope), [list(row) for row in symmetric(curvature)]
        for i, error in enumerate(_position_error(after, known["sample"], parts)):
            V_x[i], V_xx[i][i] = V_x[i] + w * error, V_xx[i][i] + w
        for i, excess in _steepness(after, parts).items():
            curved = SYMBOLS.where(abs(after[i]) > STEEP, 2 * STEEP_WEIGHT, 0.0)
            V_x[i], V_xx[i][i] = V_x[i] + 2 * STEEP_WEIGHT * excess, V_xx[i][i] + curved
        Q_1, Q_2 = [dot(column, V_x) for column in columns], [list(row) for row in congruence(columns, V_xx)]
        for i, a in enumerate(command, size):
            Q_1[i], Q_2[i][i] = Q_1[i] + 2 * EFFORT_WEIGHT * a, Q_2[i][i] + 2 * EFFORT_WEIGHT + damping[0]
        from_middle = [a - 0.5 * (own.low + own.high) for own, a in zip(ranges, command, strict=True)]
        half = [0.5 * (own.high - own.low) for own in ranges]
        slope, earlier, k, law, _ = feedback_law(Q_1, Q_2, from_middle, half)
        K = [list(row) for row in law]
        for i, follows in enumerate(slopes):
            K[i][forces + i] += follows
        return {"slope": slope, "curvature": triangle(earlier), "step": k, "feedback": [x for row in K for x in row]}

    rows = {
        "slope": size,
        "curvature": size * (size + 1) // 2,
        "state": size,
        "command": channels,
        "limits": channels,
    }
    rows |= {"sample": parts.sample_rows, "weight": 1, "parameters": parts.parameter_rows, "damping": 1}
    over_time = ("state", "command", "limits", "sample", "weight", "step", "feedback")
    return Kernel.traced(equation, rows, over_time, back=True, structural=True, blocked=True)

"""The whole of an episode as one optimal control problem: nothing about it is unknown.

Commands a_1 ... a_K of the K control periods are sought that make

    sum_k w_k |p_k - p_R,k|^2 + `PRICE` sum_k |a_k|^2        (1)

least, with p the position that the simulation itself gives for them, p_R that of the reference, and commands within
the limits at which the actuators really saturate. The weights w_k add up to one over the tail of the episode, whose
root mean square is what is scored; those before it are small, so that the way there is not arbitrary. Positions count
in the paper's units (`auv_gym.physics.units`), so that one price and one tolerance serve a torpedo and a ship.
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
from auv_gym.physics.namespaces import Array
from auv_gym.physics.rows import leaves
from auv_gym.physics.units import Units
from auv_gym.scenarios.episode import Episode
from auv_gym.scenarios.scenario import Scenario
from auv_gym.task.simulation import PARAMETER_ROWS, SAMPLE_ROWS, Parameters, Parts, Sample, moved
from baselines.control.nmpc.gauss_newton import feedback_law
from baselines.control.privileged.truth import Truth

PLANT_STATES = 8  # x, y, psi, u, v, r of the vehicle and F_u, F_r of its actuators
COMMAND_ROWS = 2  # a_u, a_r: commands as fractions of what action 1 gives
TRIANGLE = PLANT_STATES * (PLANT_STATES + 1) // 2  # entries of a symmetric matrix of that size
HEAD = 1e-3
"""Weight of the errors before the tail, all together."""
PRICE = 1e-9
"""Price [m^2 of the paper's vehicle] of a command at its limit all along: what the position does not mind is not
arbitrary."""
STEADY_RMSE = 3
"""The tail is what is left of the steps after the first one in so many, as in `evaluation.metrics`."""


@dataclass(frozen=True)
class Problem:
    """N episodes of K control periods, as they are known beforehand."""

    parts: Parts  # of the simulation that the commands depend on
    begun: Array  # state at the start, shape (PLANT_STATES, N)
    samples: Array  # the numbers of a `Sample` at the end of each period, shape (K, SAMPLE_ROWS, N)
    parameters: Array  # the numbers of the `Parameters`, shape (PARAMETER_ROWS, N)
    limits: Array  # of the commands, zero until the first one arrives, shape (K, COMMAND_ROWS, N)
    weight: Array  # w_k in (1) [1/m^2 of this vehicle], shape (K, 1, N)
    delay: NDArray[np.int64]  # control periods until a command acts, shape (N,)
    unit: Array  # metres of this vehicle that are one of the paper's, shape (N,)

    @classmethod
    def of(cls, scenario: Scenario, episodes: Sequence[Episode]) -> Problem:
        """Return the problem of N episodes of a scenario.

        Raises:
            InfeasibleReferenceError: an episode's path cannot be followed in still water.
        """
        truth, n, steps = Truth.of(scenario, episodes), len(episodes), scenario.steps
        p, samples = truth.parameters, truth.samples
        begun = [e.initial_state(R) for e, R in zip(episodes, samples[0, :4].T.tolist(), strict=True)]
        rows = np.array([np.broadcast_to(np.asarray(row, dtype=np.float64), n) for row in leaves(p)])
        delay = np.broadcast_to(np.asarray(p.delay), n).astype(np.int64)
        reach = np.minimum(1.0, np.stack((np.broadcast_to(p.reach_u, n), np.broadcast_to(p.reach_r, n))))
        arrived = np.arange(steps)[:, None] >= delay
        weight = np.full((steps, 1, n), HEAD / steps)
        weight[steps // STEADY_RMSE :] = 1.0 / (steps - steps // STEADY_RMSE)
        unit = Units.of(scenario.vehicle).length
        return cls(
            p.parts._replace(filtered=False, outages=False, delayed=False, weak=False, reckoned=False, span=1),
            np.concatenate((np.array(begun).T, np.zeros((2, n)))),
            np.ascontiguousarray(samples[1:]),
            rows,
            np.ascontiguousarray(reach * arrived[:, None]),
            weight / (unit * unit),
            delay,
            np.full(n, unit),
        )

    def taken(self, few: Any) -> Problem:
        """Return the problem of a few of the episodes, an index of which is given."""
        arrays = {f.name: np.ascontiguousarray(getattr(self, f.name)[..., few]) for f in fields(self)[1:]}
        return Problem(self.parts, **arrays)

    def between(self, first: int, end: int, begun: Array) -> Problem:
        """Return the problem of the periods from `first` to `end`, which begin in states (PLANT_STATES, N).

        The errors of all its periods count alike.
        """
        weight = np.full((end - first, 1, len(self.unit)), 1.0 / (end - first)) / self.unit**2
        return replace(
            self,
            begun=np.ascontiguousarray(begun),
            samples=self.samples[first:end],
            limits=self.limits[first:end],
            weight=weight,
        )

    def played(self, course: Trajectory, way: Way | None = None, length: float = 1.0) -> Trajectory:
        """Return what follows from the commands of a course, or of those that lie on the way from it; see `Way`.

        Args:
            course: the commands, and the states that feedback holds on to.
            way: where to go from there; None: the commands as they are.
            length: how far to go.
        """
        steps, _, n = course.commands.shape
        states, cost, error = np.empty((steps + 1, PLANT_STATES, n)), np.zeros((1, n)), np.empty((steps, 1, n))
        states[0], applied = self.begun, np.empty_like(course.commands)
        wanted = course.commands if way is None else course.commands + length * way.step
        with np.errstate(over="ignore", invalid="ignore"):  # what is lost costs too much
            played_kernel(self.parts).bound(
                state=self.begun.copy(),
                cost=cost,
                command=wanted,
                planned=course.states[:-1],
                gains=np.zeros((steps, COMMAND_ROWS * PLANT_STATES, n)) if way is None else way.feedback,
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

    def way(self, course: Trajectory, damping: Array) -> Way:
        """Return the Gauss-Newton step at a course, with its feedback; `damping` (N,) makes it shorter."""
        steps, _, n = course.commands.shape
        step, feedback = np.empty_like(course.commands), np.empty((steps, COMMAND_ROWS * PLANT_STATES, n))
        with np.errstate(all="ignore"):
            way_kernel(self.parts).bound(
                slope=np.zeros((PLANT_STATES, n)),
                curvature=np.zeros((TRIANGLE, n)),
                state=course.states[:-1],
                command=course.commands,
                limits=self.limits,
                sample=self.samples,
                weight=self.weight,
                parameters=self.parameters,
                damping=damping[None].copy(),
                step=step,
                feedback=feedback,
            )(0, steps)
        return Way(step, feedback)

    def standing(self, commands: Array) -> Trajectory:
        """Return the course of commands, shape (K, COMMAND_ROWS, N), as they are."""
        steps, _, n = commands.shape
        return self.played(Trajectory(commands, np.zeros((steps + 1, PLANT_STATES, n)), np.zeros(n), np.zeros(n)))


class Trajectory(NamedTuple):
    """Commands of N episodes and what comes of them."""

    commands: Array  # that act in each period, shape (K, COMMAND_ROWS, N)
    states: Array  # shape (K + 1, PLANT_STATES, N)
    cost: Array  # (1) [m^2 of the paper's vehicle], shape (N,); infinite where no finite states come of the commands
    steady_rmse: Array  # [m of the paper's vehicle] root mean square of the position error in the tail, shape (N,)


class Way(NamedTuple):
    """How commands should change: by `step` + `feedback` (state - state of the course)."""

    step: Array  # shape (K, COMMAND_ROWS, N)
    feedback: Array  # shape (K, COMMAND_ROWS * PLANT_STATES, N): the rows of K matrices one after the other


def _after(state: Sequence[Any], command: Sequence[Any], sample: Any, parameters: Any, parts: Parts) -> list[Any]:
    """Return the `PLANT_STATES` components one control period later."""
    x, y, psi, u, v, r, F_u, F_r = state
    p, a = Parameters.of(parameters, parts), (command[0], command[1])
    body, force = moved((x, y, psi, u, v, r), (F_u, F_r), a, sample, p, SYMBOLS)
    return [*body, *force]


def _missed(after: Sequence[Any], sample: Any) -> tuple[Any, Any]:
    """Return the position error [m] at the end of a period."""
    reference = Sample(*sample)
    return after[0] - reference.x_R, after[1] - reference.y_R


@cache
def played_kernel(parts: Parts) -> Kernel:
    """Return the kernel that goes through an episode with feedback about a course."""

    def equation(
        state: Any, cost: Any, command: Any, planned: Any, gains: Any, limits: Any, weight: Any, **known: Any
    ) -> Mapping[str, Sequence[Any]]:
        off, a = [x - c for x, c in zip(state, planned, strict=True)], []
        for i in range(COMMAND_ROWS):
            wanted = command[i] + dot(gains[i * PLANT_STATES : (i + 1) * PLANT_STATES], off)
            a.append(SYMBOLS.clip(wanted, -limits[i], limits[i]))
        after = _after(state, a, known["sample"], known["parameters"], parts)
        x_e, y_e = _missed(after, known["sample"])
        error = x_e * x_e + y_e * y_e
        paid = weight[0] * error + PRICE * (a[0] * a[0] + a[1] * a[1])
        return {"state": after, "cost": [cost[0] + paid], "states": after, "applied": a, "error": [error]}

    rows = {
        "state": PLANT_STATES,
        "cost": 1,
        "command": COMMAND_ROWS,
        "planned": PLANT_STATES,
        "gains": COMMAND_ROWS * PLANT_STATES,
    }
    rows |= {"limits": COMMAND_ROWS, "sample": SAMPLE_ROWS, "weight": 1, "parameters": PARAMETER_ROWS}
    over_time = ("command", "planned", "gains", "limits", "sample", "weight", "states", "applied", "error")
    return Kernel.traced(equation, rows, over_time, structural=True, blocked=True)


@cache
def way_kernel(parts: Parts) -> Kernel:
    """Return the kernel of the Gauss-Newton step, which goes from the last period to the first."""

    def equation(
        slope: Any, curvature: Any, state: Any, command: Any, limits: Any, weight: Any, damping: Any, **known: Any
    ) -> Mapping[str, Sequence[Any]]:
        both, w = [*state, *command], 2 * weight[0]
        after = _after(state, command, known["sample"], known["parameters"], parts)
        columns = list(zip(*jacobian(after, both), strict=True))
        V_x, V_xx = list(slope), [list(row) for row in symmetric(curvature)]
        for i, missed in enumerate(_missed(after, known["sample"])):
            V_x[i], V_xx[i][i] = V_x[i] + w * missed, V_xx[i][i] + w
        Q_1, Q_2 = [dot(column, V_x) for column in columns], [list(row) for row in congruence(columns, V_xx)]
        for i, a in enumerate(command, PLANT_STATES):
            Q_1[i], Q_2[i][i] = Q_1[i] + 2 * PRICE * a, Q_2[i][i] + 2 * PRICE + damping[0]
        slope, earlier, k, K, _ = feedback_law(Q_1, Q_2, command, limits)
        return {"slope": slope, "curvature": triangle(earlier), "step": k, "feedback": [x for row in K for x in row]}

    rows = {
        "slope": PLANT_STATES,
        "curvature": TRIANGLE,
        "state": PLANT_STATES,
        "command": COMMAND_ROWS,
        "limits": COMMAND_ROWS,
    }
    rows |= {"sample": SAMPLE_ROWS, "weight": 1, "parameters": PARAMETER_ROWS, "damping": 1}
    over_time = ("state", "command", "limits", "sample", "weight", "step", "feedback")
    return Kernel.traced(equation, rows, over_time, back=True, structural=True, blocked=True)

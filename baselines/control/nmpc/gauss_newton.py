"""Gauss-Newton steps for the optimal control of many vehicles at once, by a Riccati recursion.

The method is the control-limited differential dynamic programming of Y. Tassa, N. Mansard and E. Todorov (IEEE ICRA
2014, pp. 1168-1175) with the Gauss-Newton Hessian: a backward pass computes a feedback policy, a forward pass applies
it to the nonlinear model. Each control instant starts from the last commands and takes a few steps. This is the
real-time iteration of M. Diehl, H. G. Bock and J. P. Schloeder (SIAM J. Control Optim. 43(5):1714-1736, 2005).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np

from auv_gym.codegen.derivatives import gradient, jacobian
from auv_gym.codegen.graph import SYMBOLS
from auv_gym.codegen.kernel import Kernel
from auv_gym.codegen.matrices import Matrix, congruence, dot, product, solution, symmetric, triangle
from auv_gym.physics.namespaces import Array, Namespace, Number
from baselines.control.nmpc.problem import (
    PLANE_SYSTEM,
    CostWeights,
    GaussNewtonStep,
    Horizon,
    Integers,
    OptimalControl,
    Plan,
    System,
    actuated,
    constants,
    error_weight,
    next_state,
    position_errors,
    replaced,
    stage_costs,
    subset,
)

_LENGTHS = (1.0, 0.3, 0.05)
"""Fractions of a step in the line search, in this order. If none lowers the cost, the commands stay unchanged."""
_TOLERANCE = 0.2  # iteration ends if actual and predicted decrease differ by less than this fraction of the cost
_NEGLIGIBLE = 1e-6  # [m^2 s] added to the cost in this comparison, so that iteration ends at costs near zero


def optimised_plan(problem: OptimalControl, plan: Plan, horizon: Horizon, steps: Integers) -> Plan:
    """Return the plan after at most `steps`, shape (N,), Gauss-Newton steps."""
    active = (steps > 0).nonzero()[0]
    for i in range(int(steps.max(initial=0))):
        before = subset(plan, active)
        after, decrease = after_step(problem, before, subset(horizon, active))
        plan = replaced(plan, active, after)
        inexact = np.abs(before.cost - after.cost - decrease) > _TOLERANCE * (after.cost + _NEGLIGIBLE)
        active = active[inexact & (i + 1 < steps[active])]
        if not active.size:
            break
    return plan


def after_step(problem: OptimalControl, plan: Plan, horizon: Horizon) -> tuple[Plan, Array]:
    """Return the plan after one Gauss-Newton step with line search, and the predicted decrease of the full step."""
    full, best = gauss_newton_step(problem, plan, horizon), plan
    active = np.arange(len(plan.cost))
    for length in _LENGTHS:
        old, change = subset(plan, active), subset(full, active)
        commands = old.commands + length * change.step
        trial = problem.predict(old.states[0], commands, subset(horizon, active), old, change)
        better = trial.cost <= old.cost
        best = replaced(best, active[better], subset(trial, better.nonzero()[0]))
        active = active[~better]
        if not active.size:
            break
    return best, full.decrease


def gauss_newton_step(problem: OptimalControl, plan: Plan, horizon: Horizon) -> GaussNewtonStep:
    """Return the Gauss-Newton step at a plan, with commands within their limits, see `riccati_kernel`."""
    (steps, controls, n), size = plan.commands.shape, problem.system.states
    step, feedback = np.empty_like(plan.commands), np.empty((steps, controls * size, n))
    decrease, constant = np.zeros((1, n)), problem.constant(n)
    riccati_kernel(problem.substeps, len(constant), problem.system).bound(
        slope=np.zeros((size, n)),
        curvature=np.zeros((size * (size + 1) // 2, n)),
        decrease=decrease,
        state=plan.states[:-1],
        command=plan.commands,
        after=plan.states[1:],
        stage=horizon.stages,
        constant=constant,
        limits=horizon.limits,
        step=step,
        feedback=feedback,
    )(0, steps)
    return GaussNewtonStep(step, feedback, decrease[0])


@cache
def riccati_kernel(substeps: int, size: int, system: System = PLANE_SYSTEM) -> Kernel:
    """Return the kernel of the recursion, which runs from the last stage to the first.

    Its results are the derivatives V_x, V_xx of the cost to go one stage earlier, step and feedback of the command, and
    the predicted decrease. Notation and recursion are those of section II of Tassa et al. With f the Jacobian of a
    stage, Q_1 = l_1 + f^T V_x and Q_2 = l_2 + f^T V_xx f are the derivatives of the cost to go with respect to state x
    and command u. k is the step within the limits, and K = -Q_uu^-1 Q_ux the feedback of the commands that are not at a
    limit. V_x = Q_x + Q_xu k and V_xx = Q_xx + Q_xu K are the derivatives with respect to the state.

    Args:
        substeps: see `next_state`.
        size: number of rows of vehicle and weights.
        system: the kind of motion.
    """
    states, controls = system.states, system.commands

    def equation(
        slope: Any, curvature: Any, decrease: Any, state: Any, command: Any, after: Any, **data: Any
    ) -> Mapping[str, Sequence[Any]]:
        coefficients, weights = constants(data["constant"])
        V_xx, stage, both = symmetric(curvature), system.Stage(*data["stage"]), [*state, *command]
        error, sway, effort = stage_costs(state, command, after, stage, weights, SYMBOLS, system)
        V_x = _sum(slope, gradient([error, sway], [1.0, 1.0], after))
        V_xx = [_sum(*rows) for rows in zip(V_xx, _hessian(sway, after), strict=True)]
        of_error = _error_curvature(after, stage, weights, system)
        for axis in range(len(system.model.position)):
            V_xx[axis][axis] = V_xx[axis][axis] + of_error
        columns = list(zip(*stage_jacobian(state, command, stage, coefficients, substeps, system), strict=True))
        Q_1 = _sum([dot(column, V_x) for column in columns], gradient([effort], [1.0], both))
        Q_2 = [_sum(*rows) for rows in zip(congruence(columns, V_xx), _hessian(effort, both), strict=True)]
        slope, earlier, step, feedback, gained = feedback_law(Q_1, Q_2, command, data["limits"])
        results = {"slope": slope, "curvature": triangle(earlier), "decrease": [decrease[0] + gained], "step": step}
        return {**results, "feedback": [x for row in feedback for x in row]}

    rows = {"slope": states, "curvature": states * (states + 1) // 2, "decrease": 1, "state": states}
    rows |= {"command": controls, "after": states, "stage": len(system.Stage._fields), "constant": size}
    over_time = ("state", "command", "after", "stage", "step", "feedback")
    return Kernel.traced(equation, rows | {"limits": controls}, over_time, back=True, structural=True, blocked=True)


def feedback_law(
    Q_1: Sequence[Any], Q_2: Matrix, command: Sequence[Any], limits: Sequence[Any]
) -> tuple[list[Any], Matrix, Sequence[Any], Matrix, Any]:
    """Return V_x, V_xx, step and feedback of the command, and the predicted decrease, from Q_1 and Q_2; on symbols.

    See `riccati_kernel`. In Q_1 and Q_2 the n entries of the state come before the c of the command, two or three.

    Args:
        Q_1: first derivatives of the cost to go, n + c symbols.
        Q_2: second derivatives, n + c rows.
        command: c symbols.
        limits: largest absolute values of the command.
    """
    n = len(Q_1) - len(command)
    Q_u, Q_uu, Q_ux = Q_1[n:], [row[n:] for row in Q_2[n:]], [row[:n] for row in Q_2[n:]]
    low, high = [-limit - c for limit, c in zip(limits, command, strict=True)], _sum(limits, [-c for c in command])
    if len(command) == 2:
        k, free = bounded_minimum((Q_uu[0][0], Q_uu[0][1], Q_uu[1][1]), Q_u, low, high, SYMBOLS)
        K = _feedback_of(Q_uu, Q_ux, free)
    else:
        k, free = bounded_minimum_of_three(Q_uu, Q_u, low, high, SYMBOLS)
        K = _feedback_of_three(Q_uu, Q_ux, free)
    gained = -dot(_sum(Q_u, [0.5 * dot(row, k) for row in Q_uu]), k)
    Q_xu, followed = list(zip(*Q_ux, strict=True)), list(zip(*K, strict=True))
    V_x = [q + dot(row, k) for q, row in zip(Q_1[:n], Q_xu, strict=True)]
    V_xx = symmetric([Q_2[i][j] + dot(Q_xu[i], followed[j]) for i in range(n) for j in range(i + 1)])
    return V_x, V_xx, k, K, gained


def stage_jacobian(
    state: Sequence[Any],
    command: Sequence[Any],
    stage: Any,
    coefficients: Any,
    substeps: int,
    system: System = PLANE_SYSTEM,
) -> Matrix:
    """Return the Jacobian of `next_state` with respect to state and command; on symbols.

    The chain rule over the mean loads, on which the motion depends, needs fewer operations.
    """
    both, after = [*state, *command], next_state(state, command, stage, coefficients, substeps, SYMBOLS, system)
    moving, (loads, _) = system.model.forces.start, actuated(state, command, stage, system)
    acting = [*state[:moving], *loads]
    motion = product(jacobian(after[:moving], acting), jacobian(acting, both))
    return [*motion, *jacobian(after[moving:], both)]


def _error_curvature(after: Sequence[Any], stage: Any, weights: CostWeights, system: System) -> Any:
    """Return the curvature of the quadratic majorant that touches the cost of the position error."""
    errors = position_errors(after, stage, system)
    square = dot(errors, errors) / (weights.huber * weights.huber)
    return 2 * error_weight(stage, weights) / SYMBOLS.sqrt(1 + square)


def _hessian(cost: Any, by: Sequence[Any]) -> Sequence[Sequence[Any]]:
    return jacobian(gradient([cost], [1.0], by), by)


def _sum(a: Sequence[Any], b: Sequence[Any]) -> list[Any]:
    return [x + y for x, y in zip(a, b, strict=True)]


def bounded_minimum(
    H: tuple[Number, Number, Number],
    g: Sequence[Number],
    low: Sequence[Number],
    high: Sequence[Number],
    ns: Namespace,
) -> tuple[tuple[Number, Number], tuple[Any, Any]]:
    """Return the minimiser c of c^T H c / 2 + g^T c with low <= c <= high, and which of its entries are not at a bound.

    Args:
        H: the entries (0, 0), (0, 1) and (1, 1) of a positive definite matrix.
        g: two numbers, like the bounds and the result.
        low: lower bounds.
        high: upper bounds.
        ns: the namespace of the numbers.
    """
    a, b, d = H
    det = a * d - b * b
    c = (b * g[1] - d * g[0]) / det, (b * g[0] - a * g[1]) / det  # Cramer's rule
    outside = (c[0] < low[0]) | (c[0] > high[0]) | (c[1] < low[1]) | (c[1] > high[1])
    edge = _on_the_edge(H, g, low, high, ns)
    c = ns.where(outside, edge[0], c[0]), ns.where(outside, edge[1], c[1])
    return c, ((c[0] > low[0]) & (c[0] < high[0]), (c[1] > low[1]) & (c[1] < high[1]))


def _on_the_edge(
    H: tuple[Number, Number, Number],
    g: Sequence[Number],
    low: Sequence[Number],
    high: Sequence[Number],
    ns: Namespace,
) -> tuple[Number, Number]:
    """Return the minimiser on the four edges of the box."""
    a, b, d = H
    best_u, best_r, least = low[0], low[1], math.inf
    for i in range(2):
        for bound in (low[i], high[i]):
            if i == 0:
                c_u, c_r = bound, ns.clip(-(g[1] + b * bound) / d, low[1], high[1])
            else:
                c_u, c_r = ns.clip(-(g[0] + b * bound) / a, low[0], high[0]), bound
            value = (0.5 * (a * c_u + b * c_r) + g[0]) * c_u + (0.5 * (b * c_u + d * c_r) + g[1]) * c_r
            better = value < least
            best_u, best_r = ns.where(better, c_u, best_u), ns.where(better, c_r, best_r)
            least = ns.where(better, value, least)
    return best_u, best_r


def bounded_minimum_of_three(
    H: Matrix, g: Sequence[Number], low: Sequence[Number], high: Sequence[Number], ns: Namespace
) -> tuple[tuple[Number, ...], tuple[Any, ...]]:
    """Return what `bounded_minimum` returns, for a positive definite matrix H of three rows.

    If the unbounded minimiser is outside of the box, the minimiser is the best of those on its six faces.
    """
    c = [-x for (x,) in solution(H, [[x] for x in g])]
    inside = [(x >= a) & (x <= b) for x, a, b in zip(c, low, high, strict=True)]
    best, least = [*low], math.inf
    for i, j, k in ((0, 1, 2), (1, 0, 2), (2, 0, 1)):
        for bound in (low[i], high[i]):
            slopes = [g[row] + H[row][i] * bound for row in (j, k)]
            bounds = ((low[j], low[k]), (high[j], high[k]))
            (c_j, c_k), _ = bounded_minimum((H[j][j], H[j][k], H[k][k]), slopes, *bounds, ns)
            face = [x for _, x in sorted(((i, bound), (j, c_j), (k, c_k)), key=lambda entry: entry[0])]
            value = dot(face, [x + 0.5 * dot(row, face) for x, row in zip(g, H, strict=True)])
            best = [ns.where(value < least, x, y) for x, y in zip(face, best, strict=True)]
            least = ns.where(value < least, value, least)
    within = inside[0] & inside[1] & inside[2]
    c = [ns.where(within, x, y) for x, y in zip(c, best, strict=True)]
    return tuple(c), tuple((x > a) & (x < b) for x, a, b in zip(c, low, high, strict=True))


def _feedback_of_three(Q_uu: Matrix, Q_ux: Matrix, free: Sequence[Any]) -> list[list[Any]]:
    """Return the feedback matrix of the free commands; on symbols. A command at a limit has zero feedback."""
    where = SYMBOLS.where
    A = [
        [where(one & other, x, float(i == j)) for j, (x, other) in enumerate(zip(row, free, strict=True))]
        for i, (row, one) in enumerate(zip(Q_uu, free, strict=True))
    ]
    B = [[where(one, -x, 0.0) for x in row] for row, one in zip(Q_ux, free, strict=True)]
    return solution(A, B)


def _feedback_of(Q_uu: Matrix, Q_ux: Matrix, free: tuple[Any, Any]) -> list[list[Any]]:
    """Return the feedback matrix of the free commands in the plane; on symbols."""
    where, (free_u, free_r) = SYMBOLS.where, free
    first, second = [where(free_u, q, 0.0) for q in Q_ux[0]], [where(free_r, q, 0.0) for q in Q_ux[1]]
    a, d = where(free_u, Q_uu[0][0], 1.0), where(free_r, Q_uu[1][1], 1.0)  # a command at a limit has zero feedback
    b = where(free_u & free_r, Q_uu[0][1], 0.0)
    inverse = 1.0 / (a * d - b * b)
    a, b, d = a * inverse, b * inverse, d * inverse  # Cramer's rule
    return [
        [b * y - d * x for x, y in zip(first, second, strict=True)],
        [b * x - a * y for x, y in zip(first, second, strict=True)],
    ]

"""Gauss-Newton steps for the optimal control of many vehicles at once, by a Riccati recursion on arrays.

The method is the control-limited differential dynamic programming of Y. Tassa, N. Mansard and E. Todorov (IEEE ICRA
2014, pp. 1168-1175) with the Gauss-Newton Hessian: backward through the horizon to a policy, then forward with the
nonlinear model. A few steps from the last instant's commands at each instant are the real-time iteration of M. Diehl,
H. G. Bock and J. P. Schloeder (SIAM J. Control Optim. 43(5):1714-1736, 2005).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from baselines.control.nmpc.problem import (
    COMMANDS,
    POSITION,
    STATES,
    CostWeights,
    Descent,
    Horizon,
    Integers,
    OptimalControl,
    Plan,
    replaced,
    taken,
)
from baselines.estimation.sea_model import AT, FORCE, HULL, MOTION, hull_jacobian
from baselines.policy import Array

LENGTHS = (1.0, 0.3, 0.05)
"""Parts of a step that are tried until one lowers the cost; where none does, the commands stay as they are."""
TOLERANCE = 0.2  # steps go on while they break their promise by more than this share of the cost
NEGLIGIBLE = 1e-6  # [m^2 s] added to the cost in that comparison, so that steps end where nothing is left to gain


def solved(problem: OptimalControl, plan: Plan, ahead: Horizon, steps: Integers) -> Plan:
    """Return a better plan after up to `steps`, shape (N,), Gauss-Newton steps."""
    few = (steps > 0).nonzero()[0]
    for i in range(int(steps.max(initial=0))):
        before = taken(plan, few)
        after, promise = improved(problem, before, taken(ahead, few))
        plan = replaced(plan, few, after)
        broken = np.abs(before.cost - after.cost - promise) > TOLERANCE * (after.cost + NEGLIGIBLE)
        few = few[broken & (i + 1 < steps[few])]
        if not few.size:
            break
    return plan


def improved(problem: OptimalControl, plan: Plan, ahead: Horizon) -> tuple[Plan, Array]:
    """Return the plan after one Gauss-Newton step, or a part of one where the whole raises the cost; its promise."""
    way, best = descent(problem, plan, ahead), plan
    few = np.arange(len(plan.cost))
    for length in LENGTHS:
        old, change = taken(plan, few), taken(way, few)
        trial = problem.planned(old.states[0], old.commands + length * change.step, taken(ahead, few), old, change)
        better = trial.cost <= old.cost
        best = replaced(best, few[better], taken(trial, better.nonzero()[0]))
        few = few[~better]
        if not few.size:
            break
    return best, way.promise


def descent(problem: OptimalControl, plan: Plan, ahead: Horizon) -> Descent:
    """Return the Gauss-Newton step at a plan, with commands within their limits.

    Names and recursion are those of section II of Tassa et al., backward from the last stage. With f the derivative of
    a stage, Q_1 = l_1 + f^T V_x and Q_2 = l_2 + f^T V_xx f are those of the cost to go by state x and command u; k is
    the step within the limits, K = -Q_uu^-1 Q_ux the feedback of the commands that they leave free; and
    V_x = Q_x + Q_xu k, V_xx = Q_xx + Q_xu K are the derivatives by the state alone, one stage earlier.
    """
    f = state_derivatives(problem, plan, ahead)
    curvature, slope = _errors(problem, plan, ahead)
    effort = _effort(problem.weights)
    both = np.concatenate((plan.states[:-1], plan.commands), axis=1).transpose(0, 2, 1)
    duration = ahead.dt[:, :, None, None]
    n, x, u = len(plan.cost), slice(STATES), slice(STATES, None)
    step, feedback = np.empty_like(plan.commands), np.empty((len(f), COMMANDS, *plan.states.shape[1:]))
    V_xx, V_x = np.zeros((n, STATES, STATES)), np.zeros((n, STATES))
    side, promise = 2 * problem.weights.sway**2 * ahead.dt, np.zeros(n)
    for i in reversed(range(len(f))):
        for axis in (AT.x_e, AT.y_e):
            V_xx[:, axis, axis] += curvature[i]
        V_xx[:, AT.v, AT.v] += side[i]
        V_x[:, POSITION] += slope[i]
        V_x[:, AT.v] += side[i] * plan.states[i + 1, AT.v]
        transposed = f[i].transpose(0, 2, 1)
        Q_2 = transposed @ (V_xx @ f[i]) + duration[i] * effort
        Q_1 = (transposed @ V_x[:, :, None])[:, :, 0] + ahead.dt[i][:, None] * (both[i] @ effort)
        low, high = (-ahead.limits - plan.commands[i]).T, (ahead.limits - plan.commands[i]).T
        k, free = bounded_minimum(Q_2[:, u, u], Q_1[:, u], low, high)
        K = _feedback(Q_2[:, u], free)
        Q_xu = Q_2[:, x, u]
        V_xx = Q_2[:, x, x] + Q_xu @ K
        V_xx = 0.5 * (V_xx + V_xx.transpose(0, 2, 1))
        V_x = Q_1[:, x] + (Q_xu @ k[:, :, None])[:, :, 0]
        step[i], feedback[i] = k.T, K.transpose(1, 2, 0)
        promise -= ((Q_1[:, u] + 0.5 * (Q_2[:, u, u] @ k[:, :, None])[:, :, 0]) * k).sum(axis=1)
    return Descent(step, feedback, promise)


def _errors(problem: OptimalControl, plan: Plan, ahead: Horizon) -> tuple[Array, Array]:
    """Return curvature, shape (K, N), and slope, (K, N, 2), of the position errors' cost.

    The curvature is that of the parabola that touches the pseudo-Huber function from above: it is never too small.
    """
    e = plan.states[1:, POSITION] - ahead.aim
    duration = ahead.dt.copy()
    duration[-1] += problem.weights.terminal
    curvature = 2 * duration / np.sqrt(1 + (e * e).sum(axis=1) / problem.weights.huber**2)
    return curvature, (curvature[:, None] * e).transpose(0, 2, 1)


def state_derivatives(problem: OptimalControl, plan: Plan, ahead: Horizon) -> Array:
    """Return those of the states by the state and the command before, shape (K, N, STATES, STATES + COMMANDS)."""
    before, share, still = plan.states[:-1].transpose(1, 0, 2), ahead.share, 1 - ahead.share
    mean_u, mean_r = still * before[FORCE] + share * plan.commands.transpose(1, 0, 2)
    X, Y, N = ahead.load.transpose(1, 0, 2)
    rows = np.array((*before[MOTION], X + mean_u, Y, N + mean_r))
    flat = hull_jacobian(rows.reshape(len(rows), -1), ahead.dt.ravel(), problem.vehicle)
    by_motion, by_load = (a.reshape(*a.shape[:2], *share.shape) for a in flat)
    AB = np.zeros((STATES, STATES + COMMANDS, *share.shape))
    AB[AT.x_e, AT.x_e] = AB[AT.y_e, AT.y_e] = 1.0
    AB[HULL, MOTION] = by_motion
    commands = range(STATES, STATES + COMMANDS)
    for F, command, by_force in zip((AT.F_u, AT.F_r), commands, (by_load[:, 0], by_load[:, 2]), strict=True):
        AB[HULL, F], AB[HULL, command] = still * by_force, share * by_force
        AB[F, F], AB[F, command] = 1 - ahead.gain, ahead.gain
    return np.ascontiguousarray(AB.transpose(2, 3, 0, 1))


def _effort(weights: CostWeights) -> Array:
    """Return the second derivative of the commands' cost by state and command, for each second."""
    missing = np.zeros((COMMANDS, STATES + COMMANDS))
    missing[:, FORCE], missing[:, STATES:] = -np.eye(2), np.eye(2)
    missing *= np.array(((weights.surge,), (weights.yaw,)))
    return np.asarray(2 * missing.T @ missing)


def bounded_minimum(H: Array, g: Array, low: Array, high: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Return the minimum of c^T H c / 2 + g^T c with low <= c <= high, and which of its entries are free.

    Args:
        H: positive definite, shape (N, 2, 2).
        g: shape (N, 2), as the bounds and the result.
        low: least entries.
        high: largest entries.
    """
    (a, b), (_, d) = H.transpose(1, 2, 0)
    g_u, g_r = g.T
    c = np.stack((b * g_r - d * g_u, b * g_u - a * g_r), axis=1) / (a * d - b * b)[:, None]  # Cramer's rule
    if (outside := ((c < low) | (c > high)).any(axis=1)).any():
        c[outside] = _on_the_edge(H[outside], g[outside], low[outside], high[outside])
    return c, (c > low) & (c < high)


def _on_the_edge(H: Array, g: Array, low: Array, high: Array) -> Array:
    """Return the least of the minima on the four edges."""
    best, least = low, np.full(len(g), np.inf)
    for i, j in ((0, 1), (1, 0)):
        for bound in (low[:, i], high[:, i]):
            c = np.empty_like(g)
            c[:, i] = bound
            c[:, j] = np.clip(-(g[:, j] + H[:, 0, 1] * bound) / H[:, j, j], low[:, j], high[:, j])
            value = ((0.5 * (H @ c[:, :, None])[:, :, 0] + g) * c).sum(axis=1)
            best, least = np.where((value < least)[:, None], c, best), np.minimum(value, least)
    return best


def _feedback(Q: Array, free: NDArray[np.bool_]) -> Array:
    """Return how the free commands follow the state, shape (N, COMMANDS, STATES), for rows of the second derivative."""
    Q_ux, Q_uu = Q[:, :, :STATES], Q[:, :, STATES:]
    free_u, free_r = free.T
    first, second = (Q_ux * free[:, :, None]).transpose(1, 0, 2)
    a = Q_uu[:, 0, 0] * free_u + (1.0 - free_u)  # of a fixed command there remains c = 0
    d = Q_uu[:, 1, 1] * free_r + (1.0 - free_r)
    b = Q_uu[:, 0, 1] * free_u * free_r
    a, b, d = (x[:, None] / (a * d - b * b)[:, None] for x in (a, b, d))  # Cramer's rule
    return np.stack((b * second - d * first, b * first - a * second), axis=1)

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
    FORCE,
    STATES,
    SWAY,
    CostWeights,
    Horizon,
    Integers,
    OptimalControl,
    Plan,
    Policy,
    replaced,
    taken,
)
from baselines.estimation.sea_model import hull_jacobian
from baselines.policy import Array

LENGTHS = (1.0, 0.3, 0.05)
"""Parts of a step that are tried until one lowers the cost; where none does, the commands stay as they are."""
TOLERANCE, NEGLIGIBLE = 0.2, 1e-6
"""Steps go on while they break their promise by more than this share of the cost, and of so much [m^2 s]."""


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
    policy, best = descent(problem, plan, ahead), plan
    few = np.arange(len(plan.cost))
    for length in LENGTHS:
        old, change = taken(plan, few), taken(policy, few)
        trial = problem.planned(old.states[0], old.commands + length * change.step, taken(ahead, few), old, change)
        better = trial.cost <= old.cost
        best = replaced(best, few[better], taken(trial, better.nonzero()[0]))
        few = few[~better]
        if not few.size:
            break
    return best, policy.promise


def descent(problem: OptimalControl, plan: Plan, ahead: Horizon) -> Policy:
    """Return the Gauss-Newton step at a plan, with commands within their limits.

    V and p are second and first derivative of the cost to go by the state, Q and q by state and command before.
    """
    AB = state_derivatives(problem, plan, ahead)
    curvature, slope = _errors(problem, plan, ahead)
    effort = _effort(problem.weights)
    both = np.concatenate((plan.states[:-1], plan.commands), axis=1).transpose(0, 2, 1)
    duration = ahead.dt[:, :, None, None]
    step, feedback = np.empty_like(plan.commands), np.empty((len(AB), COMMANDS, *plan.states.shape[1:]))
    V, p = np.zeros((*ahead.dt.shape[1:], STATES, STATES)), np.zeros((*ahead.dt.shape[1:], STATES))
    side, promise = 2 * problem.weights.sway**2 * ahead.dt, np.zeros(ahead.dt.shape[1])
    for k in reversed(range(len(AB))):
        V[:, 0, 0] += curvature[k]
        V[:, 1, 1] += curvature[k]
        V[:, SWAY, SWAY] += side[k]
        p[:, :2] += slope[k]
        p[:, SWAY] += side[k] * plan.states[k + 1, SWAY]
        transposed = AB[k].transpose(0, 2, 1)
        Q = transposed @ (V @ AB[k]) + duration[k] * effort
        q = (transposed @ p[:, :, None])[:, :, 0] + ahead.dt[k][:, None] * (both[k] @ effort)
        low, high = (-ahead.limits - plan.commands[k]).T, (ahead.limits - plan.commands[k]).T
        c, free = bounded_minimum(Q[:, STATES:, STATES:], q[:, STATES:], low, high)
        G = _feedback(Q[:, STATES:], free)
        across = Q[:, :STATES, STATES:]
        V = Q[:, :STATES, :STATES] + across @ G
        V = 0.5 * (V + V.transpose(0, 2, 1))
        p = q[:, :STATES] + (across @ c[:, :, None])[:, :, 0]
        step[k], feedback[k] = c.T, G.transpose(1, 2, 0)
        promise -= ((q[:, STATES:] + 0.5 * (Q[:, STATES:, STATES:] @ c[:, :, None])[:, :, 0]) * c).sum(axis=1)
    return Policy(step, feedback, promise)


def _errors(problem: OptimalControl, plan: Plan, ahead: Horizon) -> tuple[Array, Array]:
    """Return curvature, shape (K, N), and slope, (K, N, 2), of the position errors' cost.

    The curvature is that of the parabola that touches the pseudo-Huber function from above: it is never too small.
    """
    e = plan.states[1:, :2] - ahead.aim
    duration = ahead.dt.copy()
    duration[-1] += problem.weights.terminal
    curvature = 2 * duration / np.sqrt(1 + (e * e).sum(axis=1) / problem.weights.huber**2)
    return curvature, (curvature[:, None] * e).transpose(0, 2, 1)


def state_derivatives(problem: OptimalControl, plan: Plan, ahead: Horizon) -> Array:
    """Return those of the states by the state and the command before, shape (K, N, STATES, STATES + COMMANDS)."""
    before, share, still = plan.states[:-1].transpose(1, 0, 2), ahead.share, 1 - ahead.share
    mean = still * before[FORCE] + share * plan.commands.transpose(1, 0, 2)
    X, Y, N = ahead.load.transpose(1, 0, 2)
    rows = np.array((*before[2:6], X + mean[0], Y, N + mean[1]))
    hull = hull_jacobian(rows.reshape(7, -1), ahead.dt.ravel(), problem.vehicle).reshape(6, 7, *share.shape)
    AB = np.zeros((STATES, STATES + COMMANDS, *share.shape))
    AB[0, 0] = AB[1, 1] = 1.0
    AB[:6, 2:6] = hull[:, :4]
    for i, by_force in enumerate((hull[:, 4], hull[:, 6])):
        AB[:6, 6 + i], AB[:6, 8 + i] = still * by_force, share * by_force
        AB[6 + i, 6 + i], AB[6 + i, 8 + i] = 1 - ahead.gain, ahead.gain
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
    cross = H[:, 0, 1]
    c = np.stack((cross * g[:, 1] - H[:, 1, 1] * g[:, 0], cross * g[:, 0] - H[:, 0, 0] * g[:, 1]), axis=1)
    c /= (H[:, 0, 0] * H[:, 1, 1] - cross * cross)[:, None]
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
    fixed = 1.0 - free
    a, d = Q[:, 0, STATES] * free[:, 0] + fixed[:, 0], Q[:, 1, STATES + 1] * free[:, 1] + fixed[:, 1]
    b = Q[:, 0, STATES + 1] * free[:, 0] * free[:, 1]
    first, second = (Q[:, i, :STATES] * free[:, i, None] for i in range(2))
    a, b, d = (x[:, None] / (a * d - b * b)[:, None] for x in (a, b, d))
    return np.stack((b * second - d * first, b * first - a * second), axis=1)

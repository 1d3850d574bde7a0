"""The optimal control problem of `nmpc` by CasADi: multiple shooting, solved to convergence, vehicle by vehicle.

An independent solver to compare with: J. A. E. Andersson et al., CasADi, Math. Program. Comput. 11:1-36, 2019;
A. Wächter and L. T. Biegler, Ipopt, Math. Program. 106:25-57, 2006.
"""

from __future__ import annotations

from typing import Any

import casadi
import numpy as np

from baselines.control.nmpc.problem import (
    COMMAND_SIZE,
    STAGE_ROWS,
    STATE_ROWS,
    Horizon,
    Integers,
    OptimalControl,
    Plan,
    Stage,
    next_state,
    stage_costs,
)

OPTIONS = {"print_time": False, "error_on_fail": False, "ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.tol": 1e-9}


class CasadiSolver:
    """Solves the problem of a `baselines.control.nmpc.controller.PredictiveControl` for any number of vehicles.

    Args:
        problem: vehicle and weights.
        stages: K, the number of stages.

    """

    def __init__(self, problem: OptimalControl, stages: int) -> None:
        self.problem = problem
        self._solve = _compiled(problem, stages)
        bound = np.append(np.tile([np.inf] * STATE_ROWS + [1.0] * COMMAND_SIZE, stages), [np.inf] * STATE_ROWS)
        self._bounds = {"lbx": -bound, "ubx": bound, "lbg": 0.0, "ubg": 0.0}

    def __call__(self, plan: Plan, horizon: Horizon, steps: Integers) -> Plan:
        """Return optimal plans, or the given ones where none was found; the number of steps is the solver's own."""
        commands = plan.commands.copy()
        for i in np.flatnonzero(np.isfinite(plan.cost)):
            limits = horizon.limits[:, i]
            guess = np.concatenate((plan.states[:-1, :, i], plan.commands[..., i] / limits), axis=1)
            data = np.concatenate((plan.states[0, :, i], limits, horizon.stages[..., i].ravel()))
            solution = self._solve(x0=np.append(guess, plan.states[-1, :, i]), p=data, **self._bounds)
            x = np.asarray(solution["x"]).ravel()[:-STATE_ROWS].reshape(len(commands), -1)
            commands[..., i] = np.clip(x[:, STATE_ROWS:], -1, 1) * limits
        best = self.problem.predict(plan.states[0], commands, horizon)
        return Plan(*(np.where(best.cost <= plan.cost, a, b) for a, b in zip(best, plan, strict=True)))


def _compiled(problem: OptimalControl, stages: int) -> Any:
    """Return the solver; its unknowns are the states and the commands as shares of their limits, stage by stage."""
    start, limits = casadi.SX.sym("start", STATE_ROWS), casadi.SX.sym("limits", COMMAND_SIZE)
    data = [casadi.SX.sym(f"stage{k}", STAGE_ROWS) for k in range(stages)]
    states = [casadi.SX.sym(f"x{k}", STATE_ROWS) for k in range(stages + 1)]
    shares = [casadi.SX.sym(f"c{k}", COMMAND_SIZE) for k in range(stages)]
    cost, constraints = 0.0, [states[0] - start]
    for k in range(stages):
        stage = Stage(*casadi.vertsplit(data[k]))
        command = casadi.vertsplit(shares[k] * limits)
        before, after = casadi.vertsplit(states[k]), casadi.vertsplit(states[k + 1])
        reached = next_state(before, command, stage, problem.vehicle.coefficients, problem.substeps, casadi)
        cost += sum(stage_costs(before, command, after, stage, problem.weights, casadi))
        constraints.append(states[k + 1] - casadi.vertcat(*reached))
    nlp = {
        "x": casadi.vertcat(*(v for pair in zip(states, shares, strict=False) for v in pair), states[-1]),
        "p": casadi.vertcat(start, limits, *data),
        "f": cost,
        "g": casadi.vertcat(*constraints),
    }
    return casadi.nlpsol("solver", "ipopt", nlp, OPTIONS)

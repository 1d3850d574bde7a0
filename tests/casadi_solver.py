"""The optimal control problem of `nmpc` by CasADi: multiple shooting, solved to convergence, vehicle by vehicle.

An independent solver to compare with: J. A. E. Andersson et al., CasADi, Math. Program. Comput. 11:1-36, 2019;
L. Vanroye et al., FATROP, IEEE/RSJ IROS 2023.
"""

from __future__ import annotations

from typing import Any

import casadi
import numpy as np

from auv_gym.physics.namespaces import Array
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


class CasadiSolver:
    """Solves the problem of a `baselines.control.nmpc.controller.PredictiveControl` for any number of vehicles.

    Args:
        problem: vehicle and weights.
        stages: K, the number of stages.
        method: CasADi's name of the solver, "fatrop" or "ipopt".

    """

    def __init__(self, problem: OptimalControl, stages: int, method: str = "fatrop") -> None:
        self.problem = problem
        self._solve = _compiled(problem, stages, method)
        self._bounds = _bounds(stages)

    def __call__(self, plan: Plan, horizon: Horizon, steps: Integers) -> Plan:
        """Return optimal plans, or the given ones where none was found; the number of steps is the solver's own."""
        commands = plan.commands.copy()
        for i in range(len(plan.cost)):
            if not np.isfinite(plan.cost[i]):
                continue
            limits = horizon.limits[:, i]
            guess = np.concatenate((plan.states[:-1, :, i], plan.commands[..., i] / limits), axis=1)
            given = np.concatenate((plan.states[0, :, i], limits, horizon.stages[..., i].ravel()))
            found = self._solve(x0=np.append(guess, plan.states[-1, :, i]), p=given, **self._bounds)
            x = np.asarray(found["x"]).ravel()[:-STATE_ROWS].reshape(len(commands), -1)
            commands[..., i] = np.clip(x[:, STATE_ROWS:], -1, 1) * limits
        best = self.problem.predict(plan.states[0], commands, horizon)
        return Plan(*(np.where(best.cost <= plan.cost, a, b) for a, b in zip(best, plan, strict=True)))


def _compiled(problem: OptimalControl, stages: int, method: str) -> Any:
    """Return the solver; its unknowns are the states and the commands as shares of their limits, stage by stage."""
    start, limits = casadi.SX.sym("start", STATE_ROWS), casadi.SX.sym("limits", COMMAND_SIZE)
    data = [casadi.SX.sym(f"stage{k}", STAGE_ROWS) for k in range(stages)]
    states = [casadi.SX.sym(f"x{k}", STATE_ROWS) for k in range(stages + 1)]
    shares = [casadi.SX.sym(f"c{k}", COMMAND_SIZE) for k in range(stages)]
    cost, constraints = 0.0, []
    for k in range(stages):
        stage = Stage(*casadi.vertsplit(data[k]))
        command = casadi.vertsplit(shares[k] * limits)
        before, after = casadi.vertsplit(states[k]), casadi.vertsplit(states[k + 1])
        reached = next_state(before, command, stage, problem.vehicle.coefficients, problem.substeps, casadi)
        cost += sum(stage_costs(before, command, after, stage, problem.weights, casadi))
        constraints.append(states[k + 1] - casadi.vertcat(*reached))
        if k == 0:
            constraints.append(states[0] - start)
        constraints.append(shares[k])
    nlp = {
        "x": casadi.vertcat(*(v for pair in zip(states, shares, strict=False) for v in pair), states[-1]),
        "p": casadi.vertcat(start, limits, *data),
        "f": cost,
        "g": casadi.vertcat(*constraints),
    }
    return casadi.nlpsol("solver", method, nlp, _options(stages, method))


def _options(stages: int, method: str) -> dict[str, Any]:
    """Return the solver's options: no output, and which constraints are the model's."""
    quiet: dict[str, Any] = {"print_time": False, "error_on_fail": False}
    if method == "ipopt":
        return {**quiet, "ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.tol": 1e-9}
    model: list[bool] = []
    for k in range(stages):
        model += [True] * STATE_ROWS + [False] * (STATE_ROWS * (k == 0) + COMMAND_SIZE)
    return {**quiet, "structure_detection": "auto", "equality": model, "fatrop.print_level": 0, "debug": False}


def _bounds(stages: int) -> dict[str, Array]:
    """Return the bounds of the constraints: 0 but for the commands' shares of their limits."""
    high: list[float] = []
    for k in range(stages):
        high += [0.0] * (STATE_ROWS + STATE_ROWS * (k == 0)) + [1.0] * COMMAND_SIZE
    return {"lbg": -np.array(high), "ubg": np.array(high)}

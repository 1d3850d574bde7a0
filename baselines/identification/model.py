"""What the simulator predicts of a log, and the exact derivatives of that: the equations themselves, traced.

The log is cut into segments. Each begins at a state of its own and is predicted from there by the commands alone; the
actuators go on from segment to segment. Short segments keep the fit good-natured where the vehicle itself is not: a
slender body turns away from a straight course by itself, and over a minute a small error would grow beyond all bounds.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from auv_gym.codegen.derivatives import directional
from auv_gym.codegen.graph import SYMBOLS
from auv_gym.codegen.kernel import Kernel
from auv_gym.physics.actuators import Response, respond
from auv_gym.physics.dynamics import rk4_step
from auv_gym.physics.errors import to_body
from auv_gym.physics.namespaces import Array
from auv_gym.physics.vehicle import Coefficients
from baselines.identification.log import Log

COEFFICIENTS = Coefficients._fields  # names of the parameters of the vehicle
LIMIT_NAMES = ("F_u_max", "F_r_max")  # [N], [N m] of the actuators
CURRENT_NAMES = ("V_x", "V_y")  # [m/s] in the world, constant
FITTED_PARAMETERS = (*COEFFICIENTS, *LIMIT_NAMES, *CURRENT_NAMES, "lag")
"""All that is fitted besides the states at which the segments begin. The current is that of the log, the lag is one for
both actuators, as in `auv_gym.physics.actuators.Actuators`."""
LOG_STATES = 6  # of a `dynamics.State`
_PLANT = LOG_STATES + 2  # with the forces of the actuators
_LANES = LOG_STATES + len(FITTED_PARAMETERS)
"""What a prediction is differentiated by: the state at which a segment begins, and the parameters. Each has a lane."""
_SHARED = len(FITTED_PARAMETERS) - 1  # the lag acts through the rows of the time steps
_TIMES = 8  # rows that differ from step to step, besides the states at which segments begin


@lru_cache(maxsize=8)
def _kernel(substeps: int, over_ground: bool) -> Kernel:
    """Return the kernel of a time step: what is `seen` before it, and its `change` along a lane's `seed`."""

    def equation(plant: Any, tangent: Any, times: Any, values: Any, seed: Any) -> Mapping[str, Sequence[Any]]:
        command_u, command_r, dt, gain, mean, d_gain, d_mean, begins, *first = times
        coefficients, (F_u_max, F_r_max, *current) = (
            values[: len(COEFFICIENTS)],
            values[len(COEFFICIENTS) :],
        )
        state = [SYMBOLS.where(begins > 0.5, a, b) for a, b in zip(first, plant[:LOG_STATES], strict=True)]
        command = SYMBOLS.clip(command_u, -F_u_max, F_u_max), SYMBOLS.clip(command_r, -F_r_max, F_r_max)
        response = Response(gain, mean, math.inf, math.inf)
        acting, after = respond(tuple(plant[LOG_STATES:]), command, response, SYMBOLS)
        moved = tuple(state)
        for _ in range(substeps):
            load = (acting[0], 0.0, acting[1])
            moved = rk4_step(moved, load, Coefficients(*coefficients), dt * (1 / substeps), tuple(current), SYMBOLS)
        x, y, psi, u, v, r = state
        V_u, V_v = to_body(current[0], current[1], SYMBOLS.cos(psi), SYMBOLS.sin(psi)) if over_ground else (0.0, 0.0)
        seen, following = [x, y, psi, u + V_u, v + V_v, r], [*moved, *after]
        d_first, d_values, d_lag = seed[:LOG_STATES], seed[LOG_STATES:-1], seed[-1]
        d_state = [SYMBOLS.where(begins > 0.5, a, b) for a, b in zip(d_first, tangent[:LOG_STATES], strict=True)]
        given = [*state, *plant[LOG_STATES:], *values, gain, mean]
        along = [*d_state, *tangent[LOG_STATES:], *d_values, d_gain * d_lag, d_mean * d_lag]
        directions = {symbol.index: d for symbol, d in zip(given, along, strict=True)}
        change = directional([*following, *seen], directions)
        return {"plant": following, "tangent": change[:_PLANT], "seen": seen, "change": change[_PLANT:]}

    sizes = {"plant": _PLANT, "tangent": _PLANT, "times": _TIMES + LOG_STATES, "values": _SHARED, "seed": _LANES}
    return Kernel.traced(equation, sizes, ["times", "seen", "change"], shared=["values"])


@dataclass(frozen=True)
class Prediction:
    """What the simulator says that the sensors should have seen, and how that depends on everything."""

    seen: Array  # as `Log.measured`, shape (T, 6)
    by_start: Array  # its derivatives by the state at which the segment begins, shape (T, 6, 6)
    by_value: Array  # its derivatives by `FITTED_PARAMETERS`, shape (T, 6, P)


@dataclass(frozen=True)
class LogModel:
    """The simulator on a log.

    Args:
        log: what was measured and commanded.
        starts: indices of the instants at which segments begin, the first one 0, shape (S,).
        substeps: Runge-Kutta steps from one row to the next.
        over_ground: whether the speeds u, v are those over ground; else through the water.
    """

    log: Log
    starts: NDArray[np.int64]
    substeps: int = 1
    over_ground: bool = True

    def predict(self, values: Array, states: Array) -> Prediction:
        """Return what the parameters and the segments' first states predict.

        Args:
            values: of `FITTED_PARAMETERS`, shape (P,).
            states: x, y, psi, u, v relative to the water, r at the segments' starts, shape (S, 6).
        """
        T = len(self.log.t)
        times = np.zeros((T, _TIMES + LOG_STATES))
        times[:, :2] = self.log.commands
        times[:, 2:7] = self._responses(float(values[-1]))
        times[self.starts, 7] = 1.0
        times[self.starts, _TIMES:] = states
        limits = values[len(COEFFICIENTS) : len(COEFFICIENTS) + len(LIMIT_NAMES)]
        plant = np.zeros((_PLANT, _LANES))
        plant[LOG_STATES:] = np.clip(self.log.commands[0], -limits, limits)[:, None]
        tangent = np.zeros((_PLANT, _LANES))
        for row, most in enumerate(limits):  # a command beyond a limit begins at the limit
            if abs(plant[LOG_STATES + row, 0]) == most:
                tangent[LOG_STATES + row, LOG_STATES + len(COEFFICIENTS) + row] = np.sign(plant[LOG_STATES + row, 0])
        results = _kernel(self.substeps, self.over_ground)(
            T,
            plant=plant,
            tangent=tangent,
            times=np.repeat(times[:, :, None], _LANES, axis=2),
            values=values[:-1],
            seed=np.eye(_LANES),
        )
        change = results["change"]
        return Prediction(results["seen"][:, :, 0], change[:, :, :LOG_STATES], change[:, :, LOG_STATES:])

    def _responses(self, lag: float) -> Array:
        """Return time step, gain and mean of the actuators' response, and their slopes by the lag, shape (T, 5)."""
        steps = np.append(np.diff(self.log.t), self.log.dt)
        h = 1e-5 * self.log.dt
        rows = {}
        for dt in np.unique(steps):
            low, mid, high = (Response.of(x, math.inf, math.inf, dt) for x in (max(lag - h, 0.0), lag, lag + h))
            width = h + min(lag, h)
            rows[dt] = (dt, mid.gain, mid.mean, (high.gain - low.gain) / width, (high.mean - low.mean) / width)
        return np.array([rows[dt] for dt in steps])

"""What the simulator predicts of a log, and the exact derivatives of that: the equations themselves, traced.

The log is cut into segments. Each begins at a state of its own and is predicted from there by the commands alone; the
actuators go on from segment to segment of a run. Short segments keep the fit good-natured where the vehicle itself is
not: a slender body turns away from a straight course by itself, and over a minute a small error would grow beyond all
bounds.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from auv_gym.codegen.derivatives import directional
from auv_gym.codegen.graph import SYMBOLS
from auv_gym.codegen.kernel import Kernel
from auv_gym.physics.actuators import Response, respond
from auv_gym.physics.dynamics import Load, State, rk4_step
from auv_gym.physics.errors import to_body
from auv_gym.physics.namespaces import Array, Indices
from auv_gym.physics.steering import Stern, stern_load, thrust
from auv_gym.physics.vehicle import Coefficients, CrossTerms
from auv_gym.physics.wind import WindDrag, wind_load
from baselines.identification.log import Log

CROSS_TERMS = CrossTerms._fields[:9]  # names of the quadratic cross terms of damping, which are fitted
COEFFICIENTS = (*Coefficients._fields, *CROSS_TERMS)  # names of the parameters of the vehicle
LIMIT_NAMES = ("F_u_max", "F_r_max")  # [N], [N m] of the actuators of forces
STERN_NAMES: Mapping[str, tuple[str, ...]] = {
    "force": (),
    "thrust": tuple(name for name in Stern._fields if name[0] != "T"),
    "revolutions": Stern._fields,
}
"""Names of the parameters of propeller and rudder, by the kind of the commands."""
WIND_NAMES = WindDrag._fields  # names of the parameters of the wind's force
AHEAD = "ahead"  # [m] how far the origin of the equations lies ahead of the point that the log measures
CURRENT_NAMES = ("V_x", "V_y")  # [m/s] in the world, constant in a run
LOG_STATES = 6  # of a `dynamics.State`
_PLANT = LOG_STATES + 2  # with the forces of the actuators
_TIMES = 13  # rows that differ from step to step, besides the states at which segments begin


def parameter_names(kind: str, wind: bool = False, runs: int = 1) -> tuple[str, ...]:
    """Return the names of what is fitted to a log besides the states at which segments begin.

    The lag is one for both actuators, as in `auv_gym.physics.actuators.Actuators`; each run has a current of its own.
    """
    own = (*STERN_NAMES[kind], AHEAD) if STERN_NAMES[kind] else LIMIT_NAMES
    currents = [f"{name}{'' if runs == 1 else f' {k + 1}'}" for k in range(runs) for name in CURRENT_NAMES]
    return (*COEFFICIENTS, *own, *(WIND_NAMES if wind else ()), *currents, "lag")


FITTED_PARAMETERS = parameter_names("force")
"""Those of a log of forces in one run."""


@lru_cache(maxsize=16)
def _kernel(kind: str, wind: bool, crossed: bool, substeps: int, over_ground: bool) -> Kernel:
    """Return the kernel of a time step: what is `seen` before it, and its `change` along a direction `seed`."""
    names = parameter_names(kind, wind, 0)[:-1]
    lanes = LOG_STATES + len(names) + len(CURRENT_NAMES) + 1

    def equation(plant: Any, tangent: Any, times: Any, values: Any, seed: Any) -> Mapping[str, Sequence[Any]]:
        one, other, dt, gain, mean, d_gain, d_mean, begins, held_out, V_x, V_y, W_x, W_y, *first = times
        named = dict(zip(names, values, strict=True))
        state = [SYMBOLS.where(begins > 0.5, a, b) for a, b in zip(first, plant[:LOG_STATES], strict=True)]
        command = one, other
        if kind == "force":
            command = tuple(SYMBOLS.clip(c, -named[n], named[n]) for c, n in zip(command, LIMIT_NAMES, strict=True))
        before = [SYMBOLS.where(held_out > 0.5, a, b) for a, b in zip(command, plant[LOG_STATES:], strict=True)]
        acting, after = respond((before[0], before[1]), command, Response(gain, mean, math.inf, math.inf), SYMBOLS)
        air = (V_x - W_x, V_y - W_y) if wind else None
        coefficients = [named[n] for n in (COEFFICIENTS if crossed else Coefficients._fields)]
        moved = tuple(state)
        for _ in range(substeps):
            load = _load(kind, acting, moved, air, named)
            moved = rk4_step(moved, load, coefficients, dt * (1 / substeps), (V_x, V_y), SYMBOLS)
        x, y, psi, u, v, r = state
        c, s = SYMBOLS.cos(psi), SYMBOLS.sin(psi)
        V_u, V_v = to_body(V_x, V_y, c, s) if over_ground else (0.0, 0.0)
        ahead = named.get(AHEAD, 0.0)
        seen, following = [x - ahead * c, y - ahead * s, psi, u + V_u, v + V_v - ahead * r, r], [*moved, *after]
        d_first, d_values, d_lag = seed[:LOG_STATES], seed[LOG_STATES:-1], seed[-1]
        d_state = [SYMBOLS.where(begins > 0.5, a, b) for a, b in zip(d_first, tangent[:LOG_STATES], strict=True)]
        given = [*state, *plant[LOG_STATES:], *values, V_x, V_y, gain, mean]
        along = [*d_state, *tangent[LOG_STATES:], *d_values, d_gain * d_lag, d_mean * d_lag]
        directions = {symbol.index: d for symbol, d in zip(given, along, strict=True)}
        change = directional([*following, *seen], directions)
        return {"plant": following, "tangent": change[:_PLANT], "seen": seen, "change": change[_PLANT:]}

    sizes = {"plant": _PLANT, "tangent": _PLANT, "times": _TIMES + LOG_STATES, "values": len(names), "seed": lanes}
    return Kernel.traced(equation, sizes, ["times", "seen", "change"], shared=["values"])


def _load(
    kind: str, acting: tuple[Any, Any], state: State, air: tuple[Any, Any] | None, named: Mapping[str, Any]
) -> Load:
    """Return the load [N], [N], [N m] of the actuators and, with the water's velocity through the air, of the wind."""
    _, _, psi, u, v, r = state
    X, Y, N = acting[0], 0.0, acting[1]
    if kind != "force":
        stern = Stern(*(named.get(name, 0.0) for name in Stern._fields))
        T = thrust(acting[0], u, stern) if kind == "revolutions" else acting[0]
        X, Y, N = stern_load(T, acting[1], u, v, r, stern, SYMBOLS)
    if air is not None:
        air_u, air_v = to_body(*air, SYMBOLS.cos(psi), SYMBOLS.sin(psi))
        drag = wind_load(u + air_u, v + air_v, WindDrag(*(named[name] for name in WIND_NAMES)), SYMBOLS)
        X, Y, N = X + drag[0], Y + drag[1], N + drag[2]
    return X, Y, N


@dataclass(frozen=True)
class Prediction:
    """What the simulator says that the sensors should have seen, and how that depends on everything."""

    seen: Array  # as `Log.measured`, shape (T, 6)
    by_start: Array  # its derivatives by the state at which the segment begins, shape (T, 6, 6)
    by_value: Array  # its derivatives by the free ones of `LogModel.names`, shape (T, 6, F)


@dataclass(frozen=True)
class LogModel:
    """The simulator on a log.

    Args:
        log: what was measured and commanded.
        starts: rows at which segments begin, among them those at which runs do, shape (S,).
        substeps: Runge-Kutta steps from one row to the next.
        over_ground: whether the speeds u, v are those over ground; else through the water.
    """

    log: Log
    starts: Indices
    substeps: int = 1
    over_ground: bool = True

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The names of the P parameters."""
        return parameter_names(self.log.kind, self.log.wind is not None, len(self.log.starts))

    @cached_property
    def _places(self) -> tuple[list[int], list[int]]:
        """Return the places of the parameters that are one for all runs, without the lag, and of the currents."""
        shared = parameter_names(self.log.kind, self.log.wind is not None, 0)[:-1]
        currents = range(len(shared), len(self.names) - 1)
        return list(range(len(shared))), list(currents)

    def predict(self, values: Array, states: Array, free: Indices) -> Prediction:
        """Return what the parameters and the segments' first states predict.

        Args:
            values: of `names`, shape (P,).
            states: x, y, psi, u, v relative to the water, r at the segments' starts, shape (S, 6).
            free: indices of the parameters that it is differentiated by, shape (F,).
        """
        log, T, (shared, currents) = self.log, len(self.log.t), self._places
        times = np.zeros((T, _TIMES + LOG_STATES))
        times[:, :2] = log.commands
        times[:, 2:7] = self._responses(float(values[-1]))
        times[self.starts, 7] = 1.0
        times[list(log.starts), 8] = 1.0
        for run, pair in zip(log.runs, values[currents].reshape(-1, 2), strict=True):
            times[run, 9:11] = pair
        if log.wind is not None:
            times[:, 11:13] = log.wind
        times[self.starts, _TIMES:] = states
        free = np.asarray(free, dtype=np.int64)
        lanes = [j for j in free if j < len(shared)]
        ends = LOG_STATES + len(shared)  # of the current, in a seed
        seed = np.zeros((ends + 3, LOG_STATES + len(lanes) + 3))
        seed[np.arange(LOG_STATES), np.arange(LOG_STATES)] = 1.0
        seed[[LOG_STATES + j for j in lanes], LOG_STATES + np.arange(len(lanes))] = 1.0
        seed[[ends, ends + 1, ends + 2], [-3, -2, -1]] = 1.0
        n = seed.shape[1]
        crossed = any(bool(values[j]) or j in lanes for j in range(len(Coefficients._fields), len(COEFFICIENTS)))
        results = _kernel(log.kind, log.wind is not None, crossed, self.substeps, self.over_ground)(
            T,
            plant=np.zeros((_PLANT, n)),
            tangent=np.zeros((_PLANT, n)),
            times=np.repeat(times[:, :, None], n, axis=2),
            values=values[shared],
            seed=seed,
        )
        change = results["change"]
        by_value = np.zeros((T, LOG_STATES, len(free)))
        for i, j in enumerate(free.tolist()):
            if j < len(shared):
                by_value[:, :, i] = change[:, :, LOG_STATES + lanes.index(j)]
            elif j == len(values) - 1:
                by_value[:, :, i] = change[:, :, -1]
            else:
                run, axis = divmod(j - len(shared), 2)
                by_value[log.runs[run], :, i] = change[log.runs[run], :, axis - 3]
        return Prediction(results["seen"][:, :, 0], change[:, :, :LOG_STATES], by_value)

    def _responses(self, lag: float) -> Array:
        """Return time step, gain and mean of the actuators' response, and their slopes by the lag, shape (T, 5)."""
        steps = self.log.steps
        h = 1e-5 * self.log.dt
        rows = {}
        for dt in np.unique(steps):
            low, mid, high = (Response.of(x, math.inf, math.inf, dt) for x in (max(lag - h, 0.0), lag, lag + h))
            width = h + min(lag, h)
            rows[dt] = (dt, mid.gain, mid.mean, (high.gain - low.gain) / width, (high.mean - low.mean) / width)
        return np.array([rows[dt] for dt in steps])

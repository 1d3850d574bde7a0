"""Predictions of a log by the simulator, with exact derivatives that are traced from the equations of motion.

The log is divided into segments. The prediction of a segment begins at its initial state and uses the commands alone.
The states of the actuators continue from segment to segment of a run. Short segments keep the problem well conditioned:
a slender body is unstable in yaw, so in a long prediction a small error grows without bound.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, fields
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np

from auv_gym.codegen.derivatives import directional
from auv_gym.codegen.graph import SYMBOLS
from auv_gym.codegen.kernel import Kernel
from auv_gym.effects.actuators import Response, respond
from auv_gym.physics.dynamics import Load, State, rk4_step
from auv_gym.physics.errors import to_body
from auv_gym.physics.namespaces import Array, Indices, Number
from auv_gym.physics.steering import Stern, stern_load, thrust
from auv_gym.physics.vehicle import SIGNED_PARAMETERS, Coefficients, CrossTerms, Vehicle
from baselines.identification.log import Log


class WindDrag(NamedTuple):
    """Coefficients of the force of the wind on the part of a vessel above the water; half the air's density is in them.

    They are floats, or rows of shape (N,).
    """

    X_air: Number  # [kg/m] surge force, about 0.6 kg/m^3 times the frontal area and its drag coefficient
    Y_air: Number  # [kg/m] sway force, the same of the lateral area
    N_air: Number  # [kg] yaw moment of a wind from the side: Y_air times how far ahead its force acts
    N_turn: Number  # [kg] yaw moment of a wind from ahead or astern of the side, positive where it turns across


CROSS_TERMS = CrossTerms._fields[:9]  # names of the quadratic cross terms of damping that are fitted
COEFFICIENTS = (*Coefficients._fields, *CROSS_TERMS)  # names of the parameters of the vehicle
NEEDED = tuple(f.name for f in fields(Vehicle) if f.name in COEFFICIENTS and f.default is MISSING)
"""Names of the coefficients that every vehicle has."""
OPTIONAL = tuple(name for name in COEFFICIENTS if name not in NEEDED)
"""Names of the coefficients that are 0 unless they differ significantly from 0."""
LIMIT_NAMES = ("F_u_max", "F_r_max")  # [N], [N m] of the actuators of forces
STERN_NAMES: Mapping[str, tuple[str, ...]] = {
    "force": (),
    "thrust": tuple(name for name in Stern._fields if name[0] != "T"),
    "revolutions": Stern._fields,
}
"""Names of the parameters of propeller and rudder, by the kind of the commands."""
WIND_NAMES = WindDrag._fields  # names of the parameters of the wind force
NOT_NEGATIVE = frozenset(
    (*COEFFICIENTS, *LIMIT_NAMES, "T_nn", "side", "drag", "wash", "wake", "straight", "X_air", "Y_air", "lag")
) - set(SIGNED_PARAMETERS)
"""Names of the parameters that cannot be negative."""
AHEAD = "ahead"  # [m] distance of the origin of the equations ahead of the measured point
CURRENT_NAMES = ("V_x", "V_y")  # [m/s] in the world, constant in a run
PREDICTION_TIME = 60.0  # [s] of a prediction of a vessel with propeller and rudder
LOG_STATES = 6  # number of states of a `dynamics.State`
_PLANT = LOG_STATES + 2  # the same with the forces of the actuators
_INPUTS = 13  # number of inputs of a time step, without the initial state of a segment


def parameter_names(kind: str, wind: bool = False, runs: int = 1) -> tuple[str, ...]:
    """Return the names of the parameters of a log, without the initial states of segments.

    Both actuators have the same lag, as in `auv_gym.effects.actuators.Actuators`. Each run has its own current.
    """
    actuators = (*STERN_NAMES[kind], AHEAD) if STERN_NAMES[kind] else LIMIT_NAMES
    currents = [f"{name}{'' if runs == 1 else f' {k + 1}'}" for k in range(runs) for name in CURRENT_NAMES]
    return (*COEFFICIENTS, *actuators, *(WIND_NAMES if wind else ()), *currents, "lag")


FITTED_PARAMETERS = parameter_names("force")
"""Names of the parameters of a log of forces with one run."""


def names_of(log: Log) -> tuple[str, ...]:
    """Return the names of the parameters of a log, see `parameter_names`."""
    return parameter_names(log.kind, log.wind is not None, len(log.starts))


def is_current(name: str) -> bool:
    """Return whether a parameter is the current of a run."""
    return name.split(maxsplit=1)[0] in CURRENT_NAMES


@lru_cache(maxsize=16)
def _kernel(kind: str, wind: bool, crossed: bool, substeps: int, over_ground: bool) -> Kernel:
    """Return the kernel of a time step: the `outputs` before it, and their `change` along a direction `seed`."""
    names = parameter_names(kind, wind, 0)[:-1]

    def equation(plant: Any, tangent: Any, inputs: Any, values: Any, seed: Any) -> Mapping[str, Sequence[Any]]:
        one, other, dt, gain, mean, d_gain, d_mean, new_segment, new_run, V_x, V_y, W_x, W_y, *initial = inputs
        named = dict(zip(names, values, strict=True))
        state = [SYMBOLS.where(new_segment > 0.5, a, b) for a, b in zip(initial, plant[:LOG_STATES], strict=True)]
        command = one, other
        if kind == "force":
            command = tuple(SYMBOLS.clip(c, -named[n], named[n]) for c, n in zip(command, LIMIT_NAMES, strict=True))
        before = [SYMBOLS.where(new_run > 0.5, a, b) for a, b in zip(command, plant[LOG_STATES:], strict=True)]
        after, response = (before[0], before[1]), Response(gain, mean, math.inf, math.inf)
        air = (V_x - W_x, V_y - W_y) if wind else None
        coefficients = [named[n] for n in (COEFFICIENTS if crossed else Coefficients._fields)]
        moved = tuple(state)
        for _ in range(substeps):
            acting, after = respond(after, command, response, SYMBOLS)
            load = load_of(kind, acting, moved, named, SYMBOLS, air)
            moved = rk4_step(moved, load, coefficients, dt * (1 / substeps), (V_x, V_y), SYMBOLS)
        x, y, psi, u, v, r = state
        c, s = SYMBOLS.cos(psi), SYMBOLS.sin(psi)
        V_u, V_v = to_body(V_x, V_y, c, s) if over_ground else (0.0, 0.0)
        ahead = named.get(AHEAD, 0.0)
        outputs, following = [x - ahead * c, y - ahead * s, psi, u + V_u, v + V_v - ahead * r, r], [*moved, *after]
        d_initial, d_values, d_lag = seed[:LOG_STATES], seed[LOG_STATES:-1], seed[-1]
        d_state = [SYMBOLS.where(new_segment > 0.5, a, b) for a, b in zip(d_initial, tangent[:LOG_STATES], strict=True)]
        variables = [*state, *plant[LOG_STATES:], *values, V_x, V_y, gain, mean]
        along = [*d_state, *tangent[LOG_STATES:], *d_values, d_gain * d_lag, d_mean * d_lag]
        directions = {symbol.index: d for symbol, d in zip(variables, along, strict=True)}
        change = directional([*following, *outputs], directions)
        return {"plant": following, "tangent": change[:_PLANT], "outputs": outputs, "change": change[_PLANT:]}

    sizes = {"plant": _PLANT, "tangent": _PLANT, "inputs": _INPUTS + LOG_STATES, "values": len(names)}
    sizes["seed"] = LOG_STATES + len(names) + len(CURRENT_NAMES) + 1
    return Kernel.traced(equation, sizes, ["inputs", "outputs", "change"], shared=["values"])


def load_of(
    kind: str, acting: Any, state: State, named: Mapping[str, Any], ns: Any, air: tuple[Any, Any] | None = None
) -> Load:
    """Return the surge force [N], sway force [N] and yaw moment [N m] of actuators and wind.

    Args:
        kind: kind of the commands.
        acting: the two commands, after the lag of the actuators.
        state: x, y, psi, u, v, r relative to the water.
        named: values of parameters by name.
        ns: namespace of the numbers.
        air: velocity of the water relative to the air [m/s] in the world; None: no wind force.
    """
    _, _, psi, u, v, r = state
    X, Y, N = acting[0], 0.0, acting[1]
    if kind != "force":
        stern = Stern(*(named.get(name, 0.0) for name in Stern._fields))
        T = thrust(acting[0], u, stern) if kind == "revolutions" else acting[0]
        X, Y, N = stern_load(T, acting[1], u, v, r, stern, ns)
    if air is not None:
        air_u, air_v = to_body(*air, ns.cos(psi), ns.sin(psi))
        drag = wind_load(u + air_u, v + air_v, WindDrag(*(named[name] for name in WIND_NAMES)), ns)
        X, Y, N = X + drag[0], Y + drag[1], N + drag[2]
    return X, Y, N


def wind_load(u: Number, v: Number, drag: WindDrag, ns: Any = math) -> Load:
    """Return surge force [N], sway force [N] and yaw moment [N m] of the wind.

    With the angle of attack of the relative wind they go as cosine, sine, and sine and sine of twice the angle (T. I.
    Fossen, Handbook of Marine Craft Hydrodynamics and Motion Control, 2nd ed., 2021, section 10.1).

    Args:
        u: surge velocity of the vessel through the air [m/s].
        v: its sway velocity through the air [m/s].
        drag: the coefficients.
        ns: the namespace of the numbers.
    """
    speed = ns.sqrt(u * u + v * v + 1e-12)  # has a slope at rest
    return -drag.X_air * speed * u, -drag.Y_air * speed * v, -(drag.N_air * speed + drag.N_turn * u) * v


@dataclass(frozen=True)
class Prediction:
    """Predicted measurements of a log, with their derivatives."""

    outputs: Array  # in the columns of `Log.measured`, shape (T, 6)
    by_state: Array  # derivatives with respect to the initial state of the segment, shape (T, 6, 6)
    by_value: Array  # derivatives with respect to the free parameters, shape (T, 6, F)


@dataclass(frozen=True)
class LogModel:
    """The simulator with the commands of a log.

    Args:
        log: the log with measurements and commands.
        starts: first rows of the segments, which include the first rows of the runs, shape (S,).
        substeps: number of Runge-Kutta steps from one row to the next.
        over_ground: whether the speeds u, v are those over ground; otherwise those through water.
    """

    log: Log
    starts: Indices
    substeps: int = 1
    over_ground: bool = True

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The names of the P parameters."""
        return names_of(self.log)

    def indices(self, names: Sequence[str]) -> Indices:
        """Return the positions of parameters in `names`."""
        return np.array([self.names.index(name) for name in names], dtype=np.int64)

    def predict(self, values: Array, states: Array, free: Indices) -> Prediction:
        """Return the predicted measurements for given parameters and initial states.

        Args:
            values: values of the parameters `names`, shape (P,).
            states: x, y, psi, u, v relative to the water, r at the first rows of the segments, shape (S, 6).
            free: positions of the parameters for which derivatives are computed, shape (F,).
        """
        log, T = self.log, len(self.log.t)
        shared = len(parameter_names(log.kind, log.wind is not None, 0)) - 1  # parameters before currents and lag
        inputs = np.zeros((T, _INPUTS + LOG_STATES))
        inputs[:, :2] = log.commands
        inputs[:, 2:7] = self._responses(float(values[-1]))
        inputs[self.starts, 7] = 1.0
        inputs[list(log.starts), 8] = 1.0
        for run, current in zip(log.runs, values[shared:-1].reshape(-1, 2), strict=True):
            inputs[run, 9:11] = current
        if log.wind is not None:
            inputs[:, 11:13] = log.wind
        inputs[self.starts, _INPUTS:] = states
        chosen = [j for j in free.tolist() if j < shared]
        rows = [*range(LOG_STATES), *(LOG_STATES + j for j in chosen), *(LOG_STATES + shared + k for k in range(3))]
        n = len(rows)  # derivatives by the initial state, the chosen parameters, the current and the lag
        seed = np.zeros((LOG_STATES + shared + 3, n))
        seed[rows, np.arange(n)] = 1.0
        crossed = any(bool(values[j]) or j in chosen for j in range(len(Coefficients._fields), len(COEFFICIENTS)))
        kernel = _kernel(log.kind, log.wind is not None, crossed, self.substeps, self.over_ground)
        rest, inputs = np.zeros((_PLANT, n)), np.repeat(inputs[:, :, None], n, axis=2)
        results = kernel(T, plant=rest, tangent=rest, inputs=inputs, values=values[:shared], seed=seed)
        change = results["change"]
        by_value = np.zeros((T, LOG_STATES, len(free)))
        columns = {j: LOG_STATES + i for i, j in enumerate(chosen)} | {len(values) - 1: -1}
        for i, j in enumerate(free.tolist()):
            if j in columns:
                by_value[:, :, i] = change[:, :, columns[j]]
            else:  # the current of a run
                run, axis = divmod(j - shared, 2)
                by_value[log.runs[run], :, i] = change[log.runs[run], :, axis - 3]
        return Prediction(results["outputs"][:, :, 0], change[:, :, :LOG_STATES], by_value)

    def _responses(self, lag: float) -> Array:
        """Return time step, gain and mean of the actuators in a substep, and their derivatives by the lag: (T, 5)."""
        steps, h = self.log.steps, 1e-5 * self.log.dt
        rows = {}
        for dt in np.unique(steps):
            part = dt / self.substeps
            low, mid, high = (Response.of(x, math.inf, math.inf, part) for x in (max(lag - h, 0.0), lag, lag + h))
            width = h + min(lag, h)
            rows[dt] = (dt, mid.gain, mid.mean, (high.gain - low.gain) / width, (high.mean - low.mean) / width)
        return np.array([rows[dt] for dt in steps])

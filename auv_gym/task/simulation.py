"""One control step of the simulation: vehicle, actuators, sensors, observation and reward.

It is a pure function of (plant, action, sample) on components, and is used by all environments. Values pass through the
effects of the scenario at the points of `auv_gym.effects.POINTS`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any, NamedTuple, TypeAlias

from auv_gym.effects import PACKAGE, Effect
from auv_gym.effects.actuators import Response, respond
from auv_gym.effects.base import At, Measured, Places, act, neutral, places_of
from auv_gym.physics.dynamics import CurrentVelocity, Force, State, rk4_step
from auv_gym.physics.errors import to_body, tracking_errors
from auv_gym.physics.namespaces import Namespace, Number
from auv_gym.physics.rows import flatten, numbered, unflatten
from auv_gym.physics.vehicle import Coefficients
from auv_gym.task.reward import failed, reward


class Plant(NamedTuple):
    """The states of vehicle, actuators and memory at one control instant: floats, arrays (N,) or tensors."""

    x: Number  # [m]
    y: Number  # [m]
    psi: Number  # [rad]
    u: Number  # [m/s] relative to the water
    v: Number  # [m/s]
    r: Number  # [rad/s]
    F_u: Number  # [N] of the actuators
    F_r: Number  # [N m]
    a_u: Number  # last action
    a_r: Number
    memory: tuple[Number, ...] = ()  # of the effects in use, rows after the others

    @classmethod
    def of(cls, rows: Sequence[Number]) -> Plant:
        """Return the plant of its rows, floats or rows of shape (N,)."""
        return cls._make((*rows[:PLANT_ROWS], tuple(rows[PLANT_ROWS:])))

    @property
    def rows(self) -> tuple[Number, ...]:
        """Its rows."""
        return *self[:PLANT_ROWS], *self.memory


class Sample(NamedTuple):
    """The exogenous inputs at one control instant; current and load act over the period that ends there."""

    x_R: Number  # [m] reference
    y_R: Number  # [m]
    psi_R: Number  # [rad]
    u_R: Number  # [m/s]
    v_R: Number  # [m/s]
    r_R: Number  # [rad/s]
    F_uR: Number  # [N]
    F_rR: Number  # [N m]
    V_x: Number  # [m/s] current without shear
    V_y: Number  # [m/s]
    X: Number  # [N] external load
    Y: Number  # [N]
    N: Number  # [N m]
    n_x: Number  # [m] measurement errors
    n_y: Number  # [m]
    n_psi: Number  # [rad]
    n_u: Number  # [m/s]
    n_v: Number  # [m/s]
    n_r: Number  # [rad/s]


class Parts(NamedTuple):
    """What a scenario uses of the simulation: constants of the compiled code, so that the rest costs no time."""

    substeps: int = 1  # integration steps per control period
    effects: tuple[type[Effect], ...] = ()  # in the order in which they act
    bound_factor: int = 1  # factor of the bounds of an observation, see `observation.bounds`

    def joined(self, other: Parts) -> Parts:
        """Return the union of both, with the larger number of integration steps; the package's effects come first."""
        both = dict.fromkeys((*self.effects, *other.effects))
        effects = (*(e for e in PACKAGE if e in both), *(e for e in both if e not in PACKAGE))
        return Parts(max(self.substeps, other.substeps), effects, max(self.bound_factor, other.bound_factor))

    @property
    def places(self) -> Places:
        """The places of the rows of the effects."""
        return places_of(self.effects)

    @property
    def plant_rows(self) -> int:
        """Number of rows of a plant."""
        return PLANT_ROWS + self.places.sizes[1]

    @property
    def sample_rows(self) -> int:
        """Number of rows of a sample with the inputs of the effects."""
        return SAMPLE_ROWS + self.places.sizes[2]

    @property
    def parameter_rows(self) -> int:
        """Number of rows of the parameters."""
        return PARAMETER_ROWS + self.places.sizes[0]


class Parameters(NamedTuple):
    """The constants of an episode: floats, or rows of shape (N,)."""

    h: Number  # [s] integration step
    coefficients: Coefficients  # of the true vehicle
    F_u_max: Number  # [N] force that action 1 commands, as observed
    F_r_max: Number  # [N m]
    response: Response
    error_scale: Number  # [m]
    rate_weight: Number
    lost_distance: Number  # [m]
    thrust_u: Number  # [N] true force at action 1
    thrust_r: Number  # [N m]
    parts: Parts = Parts()
    own: tuple[Number, ...] = ()  # constants of the effects, rows after the others

    @classmethod
    def of(cls, rows: Sequence[Number], parts: Parts) -> Parameters:
        """Return the parameters for their numbers in the order of the fields."""
        return unflatten(PARAMETERS, rows)._replace(parts=parts, own=tuple(rows[PARAMETER_ROWS:]))

    @property
    def rows(self) -> tuple[Number, ...]:
        """Its rows."""
        return *flatten(self), *self.own

    def constants(self, effect: type[Effect]) -> Any:
        """Return the constants of an effect, neutral ones if it is not in use."""
        place = self.parts.places.constants.get(effect)
        return neutral(effect.Constants) if place is None else effect.Constants(*self.own[place])


PLANT_ROWS = len(Plant._fields) - 1  # number of rows of a plant without effects
PLANT = numbered(Plant)  # index of each number of a plant
SAMPLE = numbered(Sample)  # index of each number of a sample: `SAMPLE.V_x` is that of the current V_x
PARAMETERS = numbered(Parameters)  # index of each number of the parameters
SAMPLE_ROWS = len(flatten(SAMPLE))  # number of rows of a sample without effects
PARAMETER_ROWS = len(flatten(PARAMETERS))  # number of rows of the parameters without effects
REFERENCE = slice(SAMPLE.x_R, SAMPLE.F_rR + 1)  # rows of the reference in a sample
CURRENT = slice(SAMPLE.V_x, SAMPLE.V_y + 1)  # rows of the current in a sample
LOAD = slice(SAMPLE.X, SAMPLE.N + 1)  # rows of the external load in a sample
NOISE = slice(SAMPLE.n_x, SAMPLE.n_r + 1)  # rows of the measurement errors in a sample

_new = tuple.__new__
"""Makes a named tuple of a tuple in a quarter of the time."""

Terms: TypeAlias = tuple[Number, ...]
"""The observation in SI units, in the order of `observation.TERMS`."""
StepOutcome: TypeAlias = tuple[Number, Number, Number, Number]
"""Reward; whether the episode has failed; squared position error [m^2]; whether a command was at its limit."""


@lru_cache(maxsize=1024)
def _acting(effects: tuple[type[Effect], ...], point: str) -> tuple[type[Effect], ...]:
    """Return the effects that act at a point."""
    return tuple(e for e in effects if hasattr(e, point))


class _Effects:
    """The effects in a control step: a value passes through those that act at a point, and their memories change."""

    def __init__(
        self,
        sample: Sequence[Number],
        p: Parameters,
        ns: Namespace,
        memory: Sequence[Number] | None = None,
        last_action: Any = (),
        begins: bool = False,
    ) -> None:
        self._sample, self._p, self._ns, self._begins = sample, p, ns, begins
        self._last_action = self.action = last_action
        self.noise: Any = sample[NOISE]
        self._memory: dict[type[Effect], Any] = {}
        self._last = Measured(*(None,) * 6)
        if memory is not None:
            places = p.parts.places
            self._memory = {e: e.Memory(*memory[place]) for e, place in places.memory.items()}
            self._last = self._last._replace(**{name: memory[place] for name, place in places.last.items()})

    def __call__(self, point: str, value: Any, state: Any, before: Any) -> Any:
        """Return the value after the effects at a point; `before` is the state one control period earlier."""
        p, inputs = self._p, self._sample[SAMPLE_ROWS:]
        for effect in _acting(p.parts.effects, point):
            rows = effect.Inputs(*inputs[p.parts.places.inputs[effect]])
            at = At(
                p.constants(effect), rows, state, before, self.action, self._last_action, self._last, self.noise,
                p.coefficients, (p.F_u_max, p.F_r_max), p.h * p.parts.substeps, self._begins, self._ns,
            )  # fmt: skip
            try:
                value, self._memory[effect] = act(effect, point, value, self._memory.get(effect), at)
            except TypeError as error:  # such as a branch on a value that is not known while the step is compiled
                raise TypeError(f"{effect.__name__}.{point}: {error}") from error
        return value

    def after(self, measured: Sequence[Number]) -> tuple[Number, ...]:
        """Return the memory after the step, for the measurements of this control instant."""
        places, known = self._p.parts.places, Measured(*measured)
        own = (x for effect in places.memory for x in self._memory[effect])
        return *own, *(getattr(known, name) for name in places.last)


def start(state: State, sample: Sequence[Number], p: Parameters, ns: Namespace) -> tuple[Plant, Terms]:
    """Return the plant with actuators at rest, and the first observation."""
    zero = state[0] * 0.0
    effects = _Effects(sample, p, ns, (zero,) * p.parts.places.sizes[1], (zero, zero), begins=True)
    measured, terms = _observe(state, state, effects, sample, p, ns)
    return Plant(*state, zero, zero, zero, zero, effects.after(measured)), terms


def moved(
    state: State, force: Force, command: Force, sample: Sequence[Number], p: Parameters, ns: Namespace
) -> tuple[State, Force]:
    """Return the state and the actuator forces [N], [N m] one control period later.

    Args:
        state: x, y, psi, u, v, r, relative to the water.
        force: of the actuators.
        command: of the actuators, as fractions of the force at action 1.
        sample: the numbers of a `Sample`, see `step`.
        p: the constants of the episode.
        ns: the namespace of the numbers.
    """
    X, Y, N = sample[LOAD]
    mean, force = respond(force, ordered(command, state, sample, p, ns), p.response, ns)
    load, current = (mean[0] + X, Y, mean[1] + N), current_at(state, sample, p, ns)
    coefficients = _Effects(sample, p, ns)("vehicle", p.coefficients.without_lift, state, state)
    for _ in range(p.parts.substeps):
        state = rk4_step(state, load, coefficients, p.h, current, ns)
    return state, force


def ordered(command: Force, state: State, sample: Sequence[Number], p: Parameters, ns: Namespace) -> Force:
    """Return the force [N] and torque [N m] that reach the actuators, before their lag; arguments as in `moved`."""
    effects = _Effects(sample, p, ns)
    share_u, share_r = effects("share", command, state, state)
    thrust_u, thrust_r = effects("thrust", (p.thrust_u, p.thrust_r), state, state)
    return share_u * thrust_u, share_r * thrust_r


def step(
    plant: Plant,
    action: Sequence[Number],
    sample: Sequence[Number],
    p: Parameters,
    ns: Namespace,
    move: Callable[..., tuple[State, Force]] = moved,
) -> tuple[Plant, Terms, StepOutcome]:
    """Return the plant one control period later, its observation, and the outcome of the step.

    Args:
        plant: the plant before the step.
        action: surge and yaw command as fractions of the limits; clipped to [-1, 1].
        sample: the exogenous inputs at the end of the period, the numbers of a `Sample` and those of the effects.
        p: the constants of the episode.
        ns: the namespace of the numbers.
        move: a function with the interface of `moved`, which moves vehicle and actuators.
    """
    before, (F_u, F_r, a_u0, a_r0, memory) = plant[:6], plant[6:]
    a_u, a_r = ns.clip(action[0], -1.0, 1.0), ns.clip(action[1], -1.0, 1.0)
    effects = _Effects(sample, p, ns, memory, (a_u0, a_r0))
    effects.action = a_u, a_r
    command = effects("command", (a_u, a_r), before, before)
    load = effects("load", tuple(sample[LOAD]), before, before)
    sample = (*sample[: LOAD.start], *load, *sample[LOAD.stop :])
    state, (F_u, F_r) = move(before, (F_u, F_r), command, sample, p, ns)
    measured, terms = _observe(state, before, effects, sample, p, ns)
    x, y, *_ = state
    e_x, e_y, d_u, d_r = x - sample[SAMPLE.x_R], y - sample[SAMPLE.y_R], a_u - a_u0, a_r - a_r0
    squared_error = e_x * e_x + e_y * e_y
    earned = reward(squared_error, d_u * d_u + d_r * d_r, p.error_scale, p.rate_weight, ns)
    outcome = (
        effects("reward", earned, state, before),
        effects("failed", failed(squared_error, p.lost_distance), state, before),
        squared_error,
        (abs(a_u) >= 1.0) | (abs(a_r) >= 1.0),
    )
    return _new(Plant, (*state, F_u, F_r, a_u, a_r, effects.after(measured))), terms, outcome


def current_at(state: Sequence[Number], sample: Sequence[Number], p: Parameters, ns: Namespace) -> CurrentVelocity:
    """Return the current V_x, V_y [m/s] at the position of a state, for a sample."""
    current: CurrentVelocity = _Effects(sample, p, ns)("current", tuple(sample[CURRENT]), state, state)
    return current


def _observe(
    state: State,
    before: State,
    effects: _Effects,
    sample: Sequence[Number],
    p: Parameters,
    ns: Namespace,
) -> tuple[State, Terms]:
    """Return the measurements and the observation; `before` is the state one control period earlier."""
    x, y, psi, u, v, r = state
    V_u, V_v = to_body(*current_at(state, sample, p, ns), ns.cos(psi), ns.sin(psi))
    effects.noise = n_x, n_y, n_psi, n_u, n_v, n_r = effects("noise", tuple(sample[NOISE]), state, before)
    u_m, v_m = effects("velocity", (u + V_u, v + V_v), state, before)
    x_m, y_m = effects("position", (x + n_x, y + n_y), state, before)
    measured: State = effects("measured", (x_m, y_m, psi + n_psi, u_m + n_u, v_m + n_v, r + n_r), state, before)
    errors = tracking_errors(measured, tuple(sample[:6]), ns)
    x_e, y_e, psi_e, u_e, v_e, r_e = effects("errors", errors, state, before)
    _, _, _, u_R, v_R, r_R, F_uR, F_rR = sample[REFERENCE]
    cos_psi, sin_psi = ns.cos(measured[2]), ns.sin(measured[2])
    e_x, e_y = to_body(x_e, y_e, cos_psi, sin_psi)
    a_u, a_r = effects.action
    F_u_max, F_r_max = effects("limits", (p.F_u_max, p.F_r_max), measured, before)
    return measured, (
        e_x, e_y, psi_e, u_e, v_e, r_e, u_R, v_R, r_R, F_uR, F_rR,
        cos_psi, sin_psi, F_u_max, F_r_max, a_u, a_r, p.h * p.parts.substeps,
    )  # fmt: skip


def measurement_errors(sample: Sequence[Number], p: Parameters, ns: Namespace) -> State:
    """Return the errors of the measurements x, y, psi, u, v, r in a sample, with those of the effects."""
    errors: State = _Effects(sample, p, ns)("noise", tuple(sample[NOISE]), (), ())
    return errors


def ground_state(plant: Plant, sample: Sequence[Number], p: Parameters, ns: Namespace) -> State:
    """Return x, y, psi, u, v over ground and r, for a sample."""
    x, y, psi, u, v, r, *_ = plant
    V_u, V_v = to_body(*current_at(plant[:6], sample, p, ns), ns.cos(psi), ns.sin(psi))
    return x, y, psi, u + V_u, v + V_v, r

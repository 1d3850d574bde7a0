"""One control step of the simulation: vehicle, actuators, sensors, observation and reward.

It is a pure function of (plant, action, sample) on components, and is used by all environments. Values pass through the
effects of the scenario at the points of `auv_gym.effects.POINTS`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any, NamedTuple, TypeAlias

from auv_gym.effects import PACKAGE, Effect
from auv_gym.effects.actuators import respond
from auv_gym.effects.base import At, Measured, Places, act, flat, made_of, neutral_constants, places_of
from auv_gym.physics.namespaces import Namespace, Number, sum_of_squares
from auv_gym.physics.rows import flatten, unflatten
from auv_gym.task.model import PLANE, Model, Parameters, Plant, Sample
from auv_gym.task.reward import failed, reward

__all__ = ["Parameters", "Plant", "Sample"]


class Parts(NamedTuple):
    """What a scenario uses of the simulation: constants of the compiled code, so that the rest costs no time."""

    substeps: int = 1  # integration steps per control period
    effects: tuple[type[Effect], ...] = ()  # in the order in which they act
    bound_factor: int = 1  # factor of the bounds of an observation, see `observation.bounds`
    model: Model = PLANE  # kind of motion

    def joined(self, other: Parts) -> Parts:
        """Return the union of both, with the larger number of integration steps; the package's effects come first.

        Raises:
            ValueError: their models differ.
        """
        if self.model != other.model:
            raise ValueError(
                f"scenarios of the models {self.model.name!r} and {other.model.name!r} cannot run together"
            )
        both = dict.fromkeys((*self.effects, *other.effects))
        effects = (*(e for e in PACKAGE if e in both), *(e for e in both if e not in PACKAGE))
        bound_factor = max(self.bound_factor, other.bound_factor)
        return Parts(max(self.substeps, other.substeps), effects, bound_factor, self.model)

    @property
    def places(self) -> Places:
        """The places of the rows of the effects."""
        return places_of(self.effects, self.model.state, len(self.model.channels))

    @property
    def plant_rows(self) -> int:
        """Number of rows of a plant."""
        return self.model.plant_rows + self.places.sizes[1]

    @property
    def sample_rows(self) -> int:
        """Number of rows of a sample with the inputs of the effects."""
        return self.model.sample_rows + self.places.sizes[2]

    @property
    def parameter_rows(self) -> int:
        """Number of rows of the parameters."""
        return self.model.parameter_rows + self.places.sizes[0]

    def plant(self, rows: Sequence[Number]) -> Any:
        """Return the plant of its rows, floats or rows of shape (N,)."""
        n = self.model.plant_rows
        return self.model.Plant._make((*rows[:n], tuple(rows[n:])))

    def parameters(self, rows: Sequence[Number]) -> Any:
        """Return the parameters of their rows, floats or rows of shape (N,)."""
        known, own = unflatten(self.model.parameters, rows), tuple(rows[self.model.parameter_rows :])
        return known._replace(parts=self, own=own)


def plant_row(plant: Any) -> tuple[Number, ...]:
    """Return the rows of a plant, see `Parts.plant`."""
    return *plant[:-1], *plant.memory


def parameter_row(p: Any) -> tuple[Number, ...]:
    """Return the rows of parameters, see `Parts.parameters`."""
    return *flatten(p), *p.own


def constants_of(p: Any, effect: type[Effect]) -> Any:
    """Return the constants of an effect in parameters, neutral ones if it is not in use."""
    place = p.parts.places.constants.get(effect)
    if place is None:
        return neutral_constants(effect, len(p.parts.model.channels))
    return made_of(effect, "Constants", p.own[place])


PLANT, SAMPLE, PARAMETERS = PLANE.plant, PLANE.sample, PLANE.parameters
"""Index of each number of plant, sample and parameters in the plane: `SAMPLE.V_x` is that of the current V_x."""
SAMPLE_ROWS, PARAMETER_ROWS = PLANE.sample_rows, PLANE.parameter_rows
"""Numbers of rows of samples and parameters in the plane without effects."""
REFERENCE, CURRENT, LOAD, NOISE = PLANE.reference, PLANE.current_rows, PLANE.load_rows, PLANE.noise_rows
"""Rows of reference, current, external load and measurement errors of a sample in the plane."""

State: TypeAlias = tuple[Any, ...]
"""The numbers of a state, in the order of the model."""
Force: TypeAlias = tuple[Any, ...]
"""A number for each channel."""
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
        p: Any,
        ns: Namespace,
        memory: Sequence[Number] | None = None,
        last_action: Any = (),
        begins: bool = False,
    ) -> None:
        self._sample, self._p, self._ns, self._begins = sample, p, ns, begins
        self._last_action = self.action = last_action
        self.noise: Any = sample[p.parts.model.noise_rows]
        self.squared_error: Number = 0.0
        self._memory: dict[type[Effect], Any] = {}
        self._last = Measured()
        if memory is not None:
            places = p.parts.places
            self._memory = {e: made_of(e, "Memory", memory[place]) for e, place in places.memory.items()}
            self._last = self._last._replace(**{name: memory[place] for name, place in places.last.items()})

    def __call__(self, point: str, value: Any, state: Any, before: Any) -> Any:
        """Return the value after the effects at a point; `before` is the state one control period earlier."""
        p, parts, model = self._p, self._p.parts, self._p.parts.model
        for effect in _acting(parts.effects, point):
            inputs = effect.Inputs(*self._sample[model.sample_rows :][parts.places.inputs[effect]])
            at = At(
                constants_of(p, effect), inputs, state, before, self.action, self._last_action, self._last, self.noise,
                p.coefficients, model.limits(p), p.h * parts.substeps, self._begins, model.channels, model.state,
                self._ns, self.squared_error,
            )  # fmt: skip
            try:
                value, self._memory[effect] = act(effect, point, value, self._memory.get(effect), at)
            except TypeError as error:  # such as a branch on a value that is not known while the step is compiled
                raise TypeError(f"{effect.__name__}.{point}: {error}") from error
        return value

    def after(self, measured: Sequence[Number]) -> tuple[Number, ...]:
        """Return the memory after the step, for the measurements of this control instant."""
        model, places = self._p.parts.model, self._p.parts.places
        own = (x for effect in places.memory for x in flat(effect, self._memory[effect]))
        return *own, *(measured[model.state.index(name)] for name in places.last)


def start(state: State, sample: Sequence[Number], p: Any, ns: Namespace) -> tuple[Any, Terms]:
    """Return the plant with actuators at rest, and the first observation."""
    zero, model = state[0] * 0.0, p.parts.model
    rest = (zero,) * len(model.channels)
    effects = _Effects(sample, p, ns, (zero,) * p.parts.places.sizes[1], rest, begins=True)
    measured, terms = _observe(state, state, effects, sample, p, ns)
    return model.Plant(*state, *rest, *rest, effects.after(measured)), terms


def moved(
    state: State, force: Force, command: Force, sample: Sequence[Number], p: Any, ns: Namespace
) -> tuple[State, Force]:
    """Return the state and the actuator forces [N], [N m] one control period later.

    Args:
        state: with velocities relative to the water; x, y, psi, u, v, r in the plane.
        force: of the actuators.
        command: of the actuators, as fractions of the force at action 1.
        sample: the numbers of a `Sample`, see `step`.
        p: the constants of the episode.
        ns: the namespace of the numbers.
    """
    model = p.parts.model
    mean, force = respond(force, ordered(command, state, sample, p, ns), p.response, ns)
    current = current_at(state, sample, p, ns)
    coefficients = _Effects(sample, p, ns)("vehicle", p.coefficients.without_lift, state, state)
    load = list(model.from_outside(sample[model.load_rows], coefficients))
    for component, share in zip(model.driven, mean, strict=True):
        load[model.load.index(component)] = share + load[model.load.index(component)]
    for _ in range(p.parts.substeps):
        state = model.advance(state, tuple(load), coefficients, p.h, current, ns)
    return state, force


def ordered(command: Force, state: State, sample: Sequence[Number], p: Any, ns: Namespace) -> Force:
    """Return the forces [N], [N m] that reach the actuators, before their lag; arguments as in `moved`."""
    effects = _Effects(sample, p, ns)
    shares = effects("share", command, state, state)
    thrusts = effects("thrust", p.parts.model.thrusts(p), state, state)
    return tuple(share * thrust for share, thrust in zip(shares, thrusts, strict=True))


def step(
    plant: Any,
    action: Sequence[Number],
    sample: Sequence[Number],
    p: Any,
    ns: Namespace,
    move: Callable[..., tuple[State, Force]] = moved,
) -> tuple[Any, Terms, StepOutcome]:
    """Return the plant one control period later, its observation, and the outcome of the step.

    Args:
        plant: a `Model.Plant`, before the step.
        action: a command for each channel as fraction of its limit; clipped to [-1, 1].
        sample: the exogenous inputs at the end of the period, the numbers of a `Model.Sample` and those of the effects.
        p: the constants of the episode, a `Model.Parameters`.
        ns: the namespace of the numbers.
        move: a function with the interface of `moved`, which moves vehicle and actuators.
    """
    model = p.parts.model
    states, channels = len(model.state), len(model.channels)
    before, force, last = plant[:states], plant[states : states + channels], plant[states + channels : -1]
    sent = tuple(ns.clip(a, -1.0, 1.0) for a in action)
    effects = _Effects(sample, p, ns, plant.memory, last)
    effects.action = sent
    command = effects("command", sent, before, before)
    load = effects("load", tuple(sample[model.load_rows]), before, before)
    sample = (*sample[: model.load_rows.start], *load, *sample[model.load_rows.stop :])
    state, force = move(before, force, command, sample, p, ns)
    measured, terms = _observe(state, before, effects, sample, p, ns)
    effects.squared_error = squared_error = sum_of_squares([state[i] - sample[i] for i in range(len(model.position))])
    squared_change = sum_of_squares([now - then for now, then in zip(sent, last, strict=True)])
    earned = reward(squared_error, squared_change, p.error_scale, p.rate_weight, ns)
    at_limit, *others = (abs(a) >= 1.0 for a in sent)
    for other in others:
        at_limit = at_limit | other
    outcome = (
        effects("reward", earned, state, before),
        effects("failed", failed(squared_error, p.lost_distance), state, before),
        squared_error,
        at_limit,
    )
    return model.Plant(*state, *force, *sent, effects.after(measured)), terms, outcome


def current_at(state: Sequence[Number], sample: Sequence[Number], p: Any, ns: Namespace) -> Any:
    """Return the current [m/s] at the position of a state, for a sample; V_x, V_y in the plane."""
    return _Effects(sample, p, ns)("current", tuple(sample[p.parts.model.current_rows]), state, state)


def _observe(
    state: State, before: State, effects: _Effects, sample: Sequence[Number], p: Any, ns: Namespace
) -> tuple[State, Terms]:
    """Return the measurements and the observation; `before` is the state one control period earlier."""
    model = p.parts.model
    names, reference = model.state, sample[model.reference]
    true = dict(zip(names, model.over_ground(state, current_at(state, sample, p, ns), ns), strict=True))
    errors = effects("noise", tuple(sample[model.noise_rows]), state, before)
    effects.noise, noise = errors, dict(zip(names, errors, strict=True))
    velocity = effects("velocity", tuple(true[name] for name in model.velocity), state, before)
    position = effects("position", tuple(true[name] + noise[name] for name in model.position), state, before)
    logged = true | dict(zip(model.velocity, velocity, strict=True))
    seen = {name: logged[name] + noise[name] for name in names} | dict(zip(model.position, position, strict=True))
    measured = effects("measured", tuple(seen[name] for name in names), state, before)
    tracking = model.errors(measured, tuple(reference[: len(names)]), ns)
    tracking = effects("errors", tracking, state, before)
    limits = effects("limits", model.limits(p), measured, before)
    return measured, model.terms(tracking, measured, reference, limits, effects.action, p.h * p.parts.substeps, ns)


def measurement_errors(sample: Sequence[Number], p: Any, ns: Namespace) -> Any:
    """Return the errors of the measured state in a sample, as at the first instant: effects remember nothing."""
    effects = _Effects(sample, p, ns, (0.0,) * p.parts.places.sizes[1], begins=True)
    return effects("noise", tuple(sample[p.parts.model.noise_rows]), (), ())


def ground_state(plant: Any, sample: Sequence[Number], p: Any, ns: Namespace) -> Any:
    """Return the state with velocities over ground, for a sample."""
    state = plant[: len(p.parts.model.state)]
    return p.parts.model.over_ground(state, current_at(state, sample, p, ns), ns)

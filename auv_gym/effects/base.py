"""What a physical effect is: a class that declares its numbers, and acts at named points of a control step.

A point is a static method with a name of `POINTS`: a pure function of components, which runs on floats, arrays, tensors
and symbols. It gets its numbers from `At` only. The compiled code of a scenario depends on the classes of its effects,
so scenarios that differ in numbers share it.
"""

from __future__ import annotations

import inspect
import zlib
from collections import namedtuple
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, fields
from functools import cache
from typing import Any, ClassVar, NamedTuple, TypeVar, get_args, get_type_hints

import numpy as np

from auv_gym.physics.dynamics import Force
from auv_gym.physics.intervals import Uniform, check_interval, draw
from auv_gym.physics.namespaces import FLOATS, Array, Namespace, Number
from auv_gym.physics.units import POWERS, Units
from auv_gym.physics.vehicle import PAPER_VEHICLE

T = TypeVar("T")
POINTS: Mapping[str, str] = {
    "command": "shares of the limits, surge and yaw, that are sent to the actuators",
    "load": "X, Y [N] and N [N m] on the vehicle from outside",
    "share": "shares of the limits at the actuators; without memory",
    "thrust": "force [N] and torque [N m] at action 1; without memory",
    "vehicle": "coefficients of the true vehicle; without memory",
    "current": "V_x, V_y [m/s] at the position; without memory",
    "noise": "errors of the measurements x, y, psi, u, v, r",
    "velocity": "measured u, v [m/s] over ground, before noise",
    "position": "measured x, y [m], with noise",
    "measured": "all measurements x, y, psi, u, v, r",
    "errors": "measured tracking errors x, y [m] in the world, psi, u, v, r",
    "limits": "limits [N], [N m] in the observation; the state is the measured one",
    "reward": "reward of the control step",
    "failed": "whether the episode has failed",
}
"""The points of a control step in their order, with the value that a method at the point takes and returns."""
_WITHOUT_MEMORY = frozenset(("share", "thrust", "vehicle", "current"))
_UNITS = ", ".join(POWERS)
_PLANE = ("x", "y", "psi", "u", "v", "r")  # states in the plane
_BITS = 2**64 - 1  # the integers of `uniform_of` have 64 bits


class Nothing(NamedTuple):
    """No numbers."""


class At(NamedTuple):
    """What a method at a point gets beside the value."""

    own: Any  # `Effect.Constants` of the episode
    inputs: Any  # `Effect.Inputs` at this control instant
    state: Any  # true x, y, psi, u, v, r, or those of `names` in space; velocities relative to the water
    before: Any  # the true state one control period earlier; the present one before the vehicle has moved
    action: Force  # of this control step, in [-1, 1]
    last_action: Force  # of the previous one
    last: Any  # `Measured` at the previous control instant, those that the effect remembers
    noise: Any  # errors of the measurements
    vehicle: Any  # coefficients of the true vehicle, `vehicle.Coefficients`
    limits: Force  # [N], [N m] that action 1 commands, nominally
    dt: Number  # [s] control period
    begins: bool  # whether an episode begins, so nothing is remembered
    channels: tuple[str, ...]  # names of the actuators, in the order of actions and limits
    names: tuple[str, ...]  # of the states, in the order of `state`, `before` and `noise`
    ns: Namespace
    squared_error: Number = 0.0  # [m^2] squared distance to the reference after the step, at `reward` and `failed`

    def true(self, name: str) -> Any:
        """Return a true state by its name, such as "u"."""
        return self.state[self.names.index(name)]


class Measured(NamedTuple):
    """The measurements by the names of the states, in the plane and in space; None for those that are not kept."""

    x: Any = None  # [m]
    y: Any = None  # [m]
    z: Any = None  # [m]
    theta: Any = None  # [rad]
    psi: Any = None  # [rad]
    u: Any = None  # [m/s] over ground
    v: Any = None  # [m/s]
    w: Any = None  # [m/s]
    q: Any = None  # [rad/s]
    r: Any = None  # [rad/s]


class Effect:
    """A physical effect, in a scenario if it is one of `Scenario.effects`, or of `auv_gym.effects.PACKAGE`.

    A subclass has static methods with names of `POINTS`. Such a method takes the value and an `At`, and returns the
    value. At points with memory, the method of a class with a `Memory` takes (value, memory, at), and returns both.

    A class outside of this package is made by the decorator `effect`. Its fields are the distribution in a scenario,
    each annotated with unit, least value, largest value and meaning. They are drawn once an episode.

    Attributes:
        Constants: the names of its numbers in an episode; defaults are those with which it does nothing.
        Memory: numbers that it remembers from one control step to the next, zero at the start.
        Inputs: numbers for each control instant; defaults are those with which it does nothing.
        normals: number of independent standard normals of each control instant, n_0, n_1, ... after the `Inputs`.
        repeated: "Constants" or "Memory", if each channel has one; then they are tuples of these.
        remembers: measurements of which it gets the last values, such as ("x", "y").
        neutral: values of fields with which it does nothing, if they are not zero.
        name: its name in scenario files; that of `DeadZone` is dead_zone.
        what: what an episode with it has, for messages.
        entry: of the package's effects, an entry of a scenario, such as "actuators.delay", and its value without the
            effect.
        drawn: an entry of an episode, and its value without the effect.
        numbers: the entry with the `Constants`, such as "episode.delay".
    """

    Constants: ClassVar[Any] = Nothing
    Memory: ClassVar[Any] = Nothing
    Inputs: ClassVar[Any] = Nothing
    normals: ClassVar[int] = 0
    repeated: ClassVar[tuple[str, ...]] = ()
    remembers: ClassVar[tuple[str, ...]] = ()
    neutral: ClassVar[Mapping[str, float]] = {}
    name: ClassVar[str]
    what: ClassVar[str] = ""
    entry: ClassVar[tuple[str, Any]] = "", None
    drawn: ClassVar[tuple[str, Any]] = "", None
    numbers: ClassVar[str] = ""
    entries: ClassVar[Mapping[str, tuple[str, float, float, str]]] = {}  # unit, bounds and meaning of each field

    def __init_subclass__(cls) -> None:
        for name, item in vars(cls).items():
            if isinstance(item, staticmethod) and name not in POINTS:
                raise TypeError(f"{cls.__name__} acts at {name!r}; the points are {', '.join(POINTS)}")
        if wrong := [name for name in cls.remembers if name not in Measured._fields]:
            raise TypeError(f"{cls.__name__} remembers {wrong[0]!r}; measurements are {', '.join(Measured._fields)}")
        cls.name = "".join(f"_{c.lower()}" if c.isupper() else c for c in cls.__name__).lstrip("_")
        if cls.normals:
            names = (*cls.Inputs._fields, *(f"n_{k}" for k in range(cls.normals)))
            cls.Inputs = namedtuple("Inputs", names, defaults=(*neutral(cls.Inputs), *(0.0,) * cls.normals))  # type: ignore[misc]
        cls.what = cls.what or f"the effect {cls.name!r}"

    def __post_init__(self) -> None:
        for name, (_, low, high, _) in self.entries.items():
            check_interval(f"{self.name} {name}", getattr(self, name), low, high)

    @classmethod
    def used(cls, scenario: Any) -> bool:
        """Return whether episodes of a scenario can have the effect."""
        if cls.entry[0]:
            return bool(_entry(scenario, *cls.entry) != cls.entry[1])
        return any(type(one) is cls for one in scenario.effects)

    @classmethod
    def there(cls, episode: Any) -> bool:
        """Return whether an episode has the effect."""
        if cls.entry[0]:
            return bool(_entry(episode, *cls.drawn) != cls.drawn[1])
        return cls.name in dict(episode.effects)

    @classmethod
    def constants(cls, scenario: Any, episode: Any) -> Sequence[Number]:
        """Return the numbers of an episode, or rows of them."""
        if cls.numbers:
            part, _, path = cls.numbers.partition(".")
            entry = _entry({"scenario": scenario, "episode": episode}[part], path, None)
            return entry if isinstance(entry, tuple) else (1.0 * entry,)
        found: Sequence[Number] = dict(episode.effects).get(cls.name, neutral(cls.Constants))
        return found

    @classmethod
    def series(cls, scenario: Any, episode: Any, table: Array) -> Array | None:
        """Return the rows of `Inputs` and normals at the instants of an episode, shape (rows, T); None: neutral ones.

        Args:
            scenario: of the episode.
            episode: the episode.
            table: its reference table, shape (T, 8).
        """
        own = [one for one in scenario.effects if type(one) is cls]
        if not own or not cls.Inputs._fields:
            return None
        rng = np.random.default_rng([episode.noise_seed, 2**32 + _number_of(cls.name)])
        times = scenario.control_dt * np.arange(len(table), dtype=np.float64)
        rows = np.asarray(own[0].inputs(cls.Constants(*cls.constants(scenario, episode)), times, rng))
        expected = len(cls.Inputs._fields) - cls.normals, len(table)
        if rows.shape != expected:
            raise ValueError(f"{cls.__name__}.inputs returns an array of shape {rows.shape}; it must be {expected}")
        return np.concatenate((rows, rng.standard_normal((cls.normals, len(table)))))

    def draw(self, uniform: Uniform) -> tuple[Number, ...]:
        """Return the numbers of one episode, or rows of them; every random number is one of `uniform()`."""
        return tuple(draw(getattr(self, name), uniform) for name in self.entries)

    def inputs(self, drawn: Any, times: Array, rng: np.random.Generator) -> Array:
        """Return the rows of `Inputs` in an episode, shape (rows, len(times)).

        Args:
            drawn: its `Constants`.
            times: of the control instants [s].
            rng: generator of the effect in this episode.
        """
        return np.zeros((len(self.Inputs._fields) - self.normals, len(times)))

    def scaled(self, units: Units) -> Effect:
        """Return the effect for another vehicle: each field times the factor of its unit."""
        scaled = copy(self)  # its numbers are not checked: the bounds are those of the paper's vehicle
        for name, (unit, *_) in self.entries.items():
            value, factor = getattr(self, name), units.factor(*POWERS[unit])
            both = tuple(x * factor for x in value) if isinstance(value, tuple) else value * factor
            object.__setattr__(scaled, name, both)
        return scaled


def _entry(part: Any, path: str, without: Any) -> Any:
    """Return an entry of a scenario or an episode; `without` if there is none."""
    for name in path.split(".") if path else ():
        part = without if part is None else getattr(part, name)
    return part if path else without


EFFECTS: dict[str, type[Effect]] = {}
"""The classes that `effect` has made, by their names in scenario files."""


def effect(cls: type[T]) -> type[T]:
    """Make a subclass of `Effect` a frozen dataclass, check it, and register its name for scenario files.

    Raises:
        TypeError: a field is not annotated as `Effect` says, a method at a point returns a value of another shape, or
            it changes the value although all numbers are neutral; the message has the name of the method.
    """
    made: Any = dataclass(frozen=True)(cls)
    hints = get_type_hints(made, include_extras=True)
    made.entries = units = {name: get_args(hint)[1:] for name, hint in hints.items() if len(get_args(hint)) == 5}
    if wrong := [f.name for f in fields(made) if f.name not in units]:
        raise TypeError(
            f"field {wrong[0]} of {made.__name__} must be annotated: Annotated[Interval, unit, least, largest, meaning]"
        )
    for name, (unit, *_) in units.items():
        if name in POINTS:
            raise TypeError(f"{made.__name__} has a field with the name of a point, {name!r}; choose another name")
        if unit not in POWERS:
            raise TypeError(f"the unit of {made.__name__}.{name} is {unit!r}; it must be one of {_UNITS}")
    if "Constants" not in vars(made):
        made.Constants = namedtuple("Constants", units, defaults=[made.neutral.get(name, 0.0) for name in units])  # type: ignore[misc]
    _check_points(made)
    EFFECTS[made.name] = made
    own: type[T] = made
    return own


def made_of(cls: type[Effect], kind: str, numbers: Sequence[Number]) -> Any:
    """Return the "Constants" or the "Memory" of a class for their numbers."""
    one = getattr(cls, kind)
    if kind not in cls.repeated:
        return one(*numbers)
    size = len(one._fields)
    return tuple(one(*numbers[i : i + size]) for i in range(0, len(numbers), size))


def flat(cls: type[Effect], memory: Any) -> tuple[Number, ...]:
    """Return the numbers of a memory, see `made_of`."""
    return tuple(x for one in memory for x in one) if "Memory" in cls.repeated else tuple(memory)


def neutral(numbers: Any) -> Any:
    """Return a NamedTuple of `Effect` with the values that do nothing: its defaults, or zero."""
    return numbers(*(numbers._field_defaults.get(name, 0.0) for name in numbers._fields))


def _check_points(cls: Any) -> None:
    """Check each method of a class on a few values, with neutral numbers."""
    rng = np.random.default_rng(0)
    scalar = {"reward": 1.0, "failed": False}
    sizes = {"load": 3, "vehicle": len(PAPER_VEHICLE.coefficients), "noise": 6, "measured": 6, "errors": 6}
    for point in (name for name in POINTS if hasattr(cls, name)):
        for _ in range(4):
            state, earlier, last = (tuple(rng.normal(size=len(_PLANE)).tolist()) for _ in range(3))
            two = [tuple(rng.uniform(-1.0, 1.0, 2).tolist()) for _ in range(3)]
            known = neutral(cls.Inputs)[: len(cls.Inputs._fields) - cls.normals]
            inputs = cls.Inputs(*known, *rng.normal(size=cls.normals).tolist())
            at = At(
                neutral_constants(cls, 2), inputs, state, earlier, two[0], two[1],
                Measured(**dict(zip(_PLANE, last, strict=True))), (0.0,) * 6, PAPER_VEHICLE.coefficients,
                (400.0, 200.0), 0.1, False, ("u", "r"), _PLANE, FLOATS,
            )  # fmt: skip
            value = scalar.get(point, tuple(rng.uniform(-1.0, 1.0, sizes.get(point, 2)).tolist()))
            where = f"{cls.__name__}.{point}"
            try:
                before = made_of(cls, "Memory", _repeated(cls, "Memory", (0.0,) * len(cls.Memory._fields)))
                found, memory = act(cls, point, value, before, at)
            except Exception as error:
                raise TypeError(f"{where} fails: {type(error).__name__}: {error}") from error
            if type(memory) is not type(before) or len(memory) != len(before):
                raise TypeError(f"{where} must return the value and its Memory")
            if np.shape(found) != np.shape(value):
                raise TypeError(f"{where} returns {found!r}; it must return {POINTS[point].partition(';')[0]}")
            if not np.allclose(np.asarray(found, float), np.asarray(value, float), rtol=1e-12):
                raise TypeError(
                    f"{where} changes the value {value} to {found} although its numbers are neutral, {at.own}; "
                    "name neutral values: neutral = {FIELD: VALUE}"
                )


def act(cls: type[Effect], point: str, value: Any, memory: Any, at: At) -> tuple[Any, Any]:
    """Return the value after an effect at a point, and its memory."""
    method = getattr(cls, point)
    if cls.Memory is Nothing or point in _WITHOUT_MEMORY:
        return method(value, at), memory
    after, memory = method(value, memory, at)
    return after, memory


def source_of(cls: type[Effect]) -> str:
    """Return the source of a class outside of this package, "" if it has none, as in an interactive session."""
    try:
        return inspect.getsource(cls)
    except (OSError, TypeError):
        return ""


def uniform_of(name: str, seeds: Any) -> Uniform:
    """Return the uniform stream of an effect by its name in the episode of a noise seed, or of N seeds, shape (N,).

    It is the generator SplitMix64 (G. L. Steele, D. Lea and C. H. Flood, "Fast splittable pseudorandom number
    generators", OOPSLA 2014), and depends on seed and name only: an effect changes no other number of an episode.
    """
    state = (np.asarray(seeds, dtype=np.uint64) if np.ndim(seeds) else int(seeds)) ^ (_number_of(name) << 32)

    def uniform() -> Number:
        nonlocal state
        state = (state + 0x9E3779B97F4A7C15) & _BITS
        z = ((state ^ (state >> 30)) * 0xBF58476D1CE4E5B9) & _BITS
        z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & _BITS
        return ((z ^ (z >> 31)) >> 11) * 2.0**-53

    return uniform


def _number_of(name: str) -> int:
    return zlib.crc32(name.encode())


class Places(NamedTuple):
    """The places of the rows of effects, after those that every scenario has."""

    constants: Mapping[type[Effect], slice]
    memory: Mapping[type[Effect], slice]
    inputs: Mapping[type[Effect], slice]
    last: Mapping[str, int]  # of remembered measurements, in the memory
    idle: Array  # inputs that do nothing
    sizes: tuple[int, int, int]  # numbers of constants, memory and inputs


def _repeated(cls: type[Effect], kind: str, numbers: Sequence[Number], channels: int = 2) -> Sequence[Number]:
    return tuple(numbers) * (channels if kind in cls.repeated else 1)


def neutral_constants(cls: type[Effect], channels: int) -> Any:
    """Return the `Constants` of a class with which it does nothing."""
    return made_of(cls, "Constants", _repeated(cls, "Constants", neutral(cls.Constants), channels))


@cache
def places_of(effects: tuple[type[Effect], ...], states: tuple[str, ...], channels: int) -> Places:
    """Return the places of the rows of effects, for the names of the states and the number of channels."""
    sizes = [0, 0, 0]

    def following(kind: int, count: int) -> slice:
        sizes[kind] += count
        return slice(sizes[kind] - count, sizes[kind])

    constants = {e: following(0, len(_repeated(e, "Constants", e.Constants._fields, channels))) for e in effects}
    memory = {e: following(1, len(_repeated(e, "Memory", e.Memory._fields, channels))) for e in effects}
    inputs = {e: following(2, len(e.Inputs._fields)) for e in effects}
    names = [name for name in states if any(name in e.remembers for e in effects)]
    last = {name: following(1, 1).start for name in names}
    idle = [x for e in effects for x in neutral(e.Inputs)]
    return Places(constants, memory, inputs, last, np.array(idle, dtype=np.float64), (sizes[0], sizes[1], sizes[2]))

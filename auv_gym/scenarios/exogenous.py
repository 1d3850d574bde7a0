"""The exogenous inputs of episodes, drawn ahead in blocks of control steps.

All random numbers of the simulation are drawn here, so a step is deterministic. Each episode has its own generator,
`numpy.random.SFC64` of its noise seed. Its samples do not depend on the sizes of the blocks.
"""

from __future__ import annotations

import ctypes
import math
from collections import namedtuple
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import count
from pathlib import Path as FilePath
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_gym.codegen.graph import SYMBOLS
from auv_gym.codegen.kernel import Kernel, address, library_digest, together
from auv_gym.effects.current import Current
from auv_gym.effects.waves import Waves
from auv_gym.physics.errors import to_world
from auv_gym.physics.namespaces import Array, Indices, Namespace, Number, sum_of_squares
from auv_gym.physics.rows import flatten, numbered, spread, unflatten
from auv_gym.scenarios.episode import Episode
from auv_gym.scenarios.scenario import Scenario
from auv_gym.task.model import PLANE, Model
from auv_gym.task.simulation import Parts

TILE = 16  # sub-environments whose samples are written together, which fills cache lines of the result
GRAVITY = 9.81  # [m/s^2]
UPWARD = 1 / 3
"""Vertical gusts over horizontal ones."""


class Weather(NamedTuple):
    """The constants of the current and the measurement errors of an episode: floats, or rows of shape (N,)."""

    mean: Sequence[Number]  # [m/s] mean current, V_x and V_y, in space V_z
    turn: Number  # [rad] rotation of the mean current per control step
    sigma: Number  # [m/s] standard deviation of the gusts
    cap: Number  # [m/s] largest speed of the current
    a: Number  # decay of the process of the gusts per control step
    excitation: Number  # gain of its standard normals, sqrt(1 - a^2)
    b: Number  # decay of the filter of the gusts per control step
    noise: Sequence[Number]  # standard deviations of the measurements
    bias: Sequence[Number]  # biases of the measurements


class Gust(NamedTuple):
    """The state of the gusts in units of sigma: floats, or rows of shape (N,)."""

    k: Number  # number of control instants so far
    process: Sequence[Number]  # on each axis
    filtered: Sequence[Number]

    @classmethod
    def of(cls, row: Sequence[Number]) -> Gust:
        """Return the state of its numbers."""
        k, *both = row
        return cls(k, both[: len(both) // 2], both[len(both) // 2 :])

    @property
    def row(self) -> tuple[Number, ...]:
        """Its numbers."""
        return self.k, *self.process, *self.filtered


@dataclass(frozen=True)
class Rows:
    """Sizes and places of the exogenous inputs of a model."""

    model: Model

    @cached_property
    def weather(self) -> Weather:
        """Index of each number of a `Weather`."""
        number = count()
        mean, noise = self.model.current, self.model.state
        parts: dict[str, Any] = {"mean": mean, **dict.fromkeys(Weather._fields[1:-2]), "noise": noise, "bias": noise}
        numbers: Any = [next(number) if names is None else _numbered(names, number) for names in parts.values()]
        return Weather(*numbers)

    @cached_property
    def weathers(self) -> int:
        """Number of rows of a `Weather`."""
        return len(flatten(self.weather))

    @cached_property
    def measured(self) -> slice:
        """The normals of the errors of the measurements, in a control step."""
        return slice(0, len(self.model.state))

    @cached_property
    def gusts(self) -> slice:
        """The normals of the gusts."""
        return slice(self.measured.stop, self.measured.stop + len(self.model.current))

    @cached_property
    def normals(self) -> int:
        """Number of standard normals of a control step."""
        return len(self.model.state) + len(self.model.current)

    @cached_property
    def gust(self) -> int:
        """Number of rows of a `Gust`."""
        return 1 + 2 * len(self.model.current)

    @cached_property
    def deep(self) -> bool:
        """Whether waves decay with the depth of the reference."""
        return "z" in self.model.position

    @cached_property
    def wave(self) -> int:
        """Number of numbers of a wave component, see `wave_components`."""
        return 1 + 2 * len(self.model.load) + int(self.deep)


def _numbered(names: Sequence[str], number: Iterator[int]) -> Any:
    """Return a NamedTuple with the next number for each of these names."""
    made: Any = namedtuple("Numbers", names)  # type: ignore[misc]
    return made(*(next(number) for _ in names))


@cache
def rows_of(model: Model) -> Rows:
    """Return the sizes and places of the exogenous inputs of a model."""
    return Rows(model)


_PLANE = rows_of(PLANE)
WEATHER, WEATHER_ROWS, GUST_ROWS, WAVE_ROWS = _PLANE.weather, _PLANE.weathers, _PLANE.gust, _PLANE.wave
"""Those of the plane."""
MEASUREMENT_NORMALS, GUSTS, NORMALS = _PLANE.measured, _PLANE.gusts, _PLANE.normals
"""Places of the normals of measurements and gusts in the plane, and their number."""


class ExogenousProgram(NamedTuple):
    """The integers of a sub-environment for compiled code."""

    table: Any  # address of the reference table
    instants: Any  # number of control instants of the reference
    next: Any  # next control instant
    first: Any  # first of the normals in use
    end: Any  # end of the normals in use; there are none if it equals `first`
    waves: Any  # number of wave components


_ENTRY = numbered(ExogenousProgram)  # index of each number of an `ExogenousProgram`


def next_gust(gust: Gust, normals: Sequence[Number], w: Weather, ns: Namespace) -> Gust:
    """Return the state of the gusts at a control instant, for that at the previous instant.

    The gust on each axis is an Ornstein-Uhlenbeck process n with a first-order filter s, see `current.Current`:
    n_k = a n_(k-1) + sqrt(1 - a^2) w_k,  s_k = b s_(k-1) + (1 - b) n_k,  starting from n_0 = s_0 = w_0.

    Args:
        gust: the previous state.
        normals: w_k of both axes.
        w: the constants.
        ns: the namespace of the numbers.
    """
    first = gust.k < 0.5
    new = [*zip(gust.process, normals, strict=True)]
    process = [ns.where(first, w_k, w.a * n + w.excitation * w_k) for n, w_k in new]
    filtered = [
        ns.where(first, w_k, w.b * s + (1.0 - w.b) * n)
        for s, n, w_k in zip(gust.filtered, process, normals, strict=True)
    ]
    return Gust(gust.k + 1.0, process, filtered)


def gusty_current(k: Number, filtered: Sequence[Number], w: Weather, ns: Namespace) -> list[Number]:
    """Return the current [m/s] at control instant k: mean plus gust, with a speed of at most the cap.

    `filtered` is s of each axis, see `next_gust`. The mean turns about the vertical. Vertical gusts are `UPWARD` of the
    others.
    """
    angle, (V_x, V_y, *up) = w.turn * k, w.mean
    V_x, V_y = to_world(V_x, V_y, ns.cos(angle), ns.sin(angle))
    swing = [w.sigma * s for s in filtered[:2]] + [w.sigma * UPWARD * s for s in filtered[2:]]
    current = [V + gust for V, gust in zip((V_x, V_y, *up), swing, strict=True)]
    speed = ns.sqrt(sum_of_squares(current))
    share = ns.where(speed > w.cap, w.cap / speed, 1.0)
    return [share * V for V in current]


def with_wave(
    load: Sequence[Number], k: Number, component: Sequence[Number], ns: Namespace, depth: Number | None = None
) -> list[Number]:
    """Return the load [N], [N m] at control instant k after the addition of a wave component, in space at a depth [m].

    By the addition theorem all axes use the same sine and cosine. For the numbers of a component see `wave_components`.
    """
    angle, *amplitudes = component
    s, c = ns.sin(angle * k), ns.cos(angle * k)
    if depth is not None:
        *amplitudes, number = amplitudes
        decay = ns.exp(-number * depth)
        s, c = decay * s, decay * c
    return [total + (p * s + q * c) for total, p, q in zip(load, amplitudes[::2], amplitudes[1::2], strict=True)]


def wave_load(k: Number, components: Sequence[Sequence[Number]], ns: Namespace) -> tuple[Number, Number, Number]:
    """Return the first-order wave forces X, Y [N] and N [N m] at control instant k, see `waves.Waves`."""
    load: list[Number] = [0.0, 0.0, 0.0]
    for component in components:
        load = with_wave(load, k, component, ns)
    X, Y, N = load
    return X, Y, N


def measurement_errors(normals: Sequence[Number], w: Weather) -> list[Number]:
    """Return the errors of the measurements for their standard normals."""
    return [s * n + b for s, n, b in zip(w.noise, normals, w.bias, strict=True)]


@cache
def kernels(model: Model = PLANE) -> Mapping[str, Kernel]:
    """Return the kernels of the samples of one sub-environment by the names of their functions in exogenous.c.

    A step of `gust_recursion` is a control instant, a step of `wave_loads` a wave component. The columns of
    `wave_loads` and `current_and_noise` are the control instants.
    """
    own = rows_of(model)

    def gust_recursion(gust: Any, normals: Any, weather: Any) -> dict[str, Any]:
        after = next_gust(Gust.of(gust), normals, unflatten(own.weather, weather), SYMBOLS)
        return {"gust": after.row, "swing": after.filtered}

    def wave_loads(load: Any, instant: Any, waves: Any) -> dict[str, Any]:
        return {"load": with_wave(load, instant[0], waves, SYMBOLS)}

    def deep_wave_loads(load: Any, instant: Any, depth: Any, waves: Any) -> dict[str, Any]:
        return {"load": with_wave(load, instant[0], waves, SYMBOLS, depth[0])}

    def current_and_noise(instant: Any, swing: Any, normals: Any, weather: Any) -> dict[str, Any]:
        w = unflatten(own.weather, weather)
        return {
            "current": gusty_current(instant[0], swing, w, SYMBOLS),
            "measured": measurement_errors(normals, w),
        }

    components, measurements = len(model.current), len(model.state)
    gust_rows = {"gust": own.gust, "normals": components, "weather": own.weathers}
    wave_rows = {"load": len(model.load), "instant": 1, **({"depth": 1} if own.deep else {}), "waves": own.wave}
    rows = {"instant": 1, "swing": components, "normals": measurements, "weather": own.weathers}
    loads = deep_wave_loads if own.deep else wave_loads
    return {
        "gust_recursion": Kernel.traced(gust_recursion, gust_rows, ["normals", "swing"], shared=["weather"]),
        "wave_loads": Kernel.traced(loads, wave_rows, ["waves"], shared=["waves"]),
        "current_and_noise": Kernel.traced(current_and_noise, rows, shared=["weather"]),
    }


class Compiled(NamedTuple):
    """The functions of exogenous.c."""

    seed_states: Callable[..., None]
    least_speeds: Callable[..., None]
    read_samples: Callable[..., None]
    normal: Any  # address of NumPy's function of standard normals


@cache
def compiled(model: Model = PLANE, many: bool = True) -> Compiled | None:
    """Return the functions of exogenous.c for the samples of a model, or None if they cannot be compiled.

    With `many` they are fast for several sub-environments, and their compilation takes twice the time.
    """
    try:
        normal = ctypes.CDLL(np.random._generator.__file__).random_standard_normal
    except (OSError, AttributeError):  # this build of NumPy does not export the function
        return None
    library = together(kernels(model), _code(model), many=many)
    if library is None:
        return None
    pointer, integer = ctypes.c_void_p, ctypes.c_long
    functions = library.seed_states, library.least_speeds, library.read_samples
    for function, integers, pointers in zip(functions, (1, 1, 5), (2, 3, 10), strict=True):
        function.argtypes, function.restype = [integer] * integers + [pointer] * pointers, None
    normal_address = ctypes.cast(normal, pointer)
    library.load_tables(normal_address)
    return Compiled(*functions, normal_address)


def _code(model: Model) -> str:
    """Return the C code that calls the kernels."""
    own = rows_of(model)
    sizes = {"SAMPLES": model.sample_rows, "NORMALS": own.normals, "GUSTS": own.gusts.start, "GUST": own.gust}
    sizes |= {"TILE": TILE, "WEATHER": own.weathers, "WAVE": own.wave, "ENTRIES": len(_ENTRY)}
    sizes |= {"REFERENCE": model.reference.stop, "CURRENT": len(model.current), "LOAD": len(model.load)}
    sizes |= {"VELOCITY": model.state.index(model.velocity[0]), "VELOCITIES": len(model.velocity)}
    if own.deep:
        sizes["HEIGHT"] = model.position.index("z")
    sizes |= {name.upper(): index for name, index in _ENTRY._asdict().items()}
    head = "".join(f"#define {name} {value}\n" for name, value in sizes.items())
    return head + FilePath(__file__).with_suffix(".c").read_text(encoding="utf-8")


def digest() -> str:
    """Return the hash of the C source of all exogenous inputs."""
    return library_digest(kernels(), _code(PLANE))


class ExogenousInputs:
    """The samples (`simulation.Sample`) and inputs of effects of the episodes of N sub-environments."""

    def __init__(self, num_envs: int, block: int, parts: Parts) -> None:
        """Allocate memory for `num_envs` sub-environments, and for reading up to `block` control steps at once."""
        self._parts, own = parts, rows_of(parts.model)
        memory = TILE * (parts.model.sample_rows + own.normals) + own.normals
        memory += 1 + len(parts.model.current) + own.deep
        self._memory = np.empty((memory, block))  # for compiled code
        empty: Array = np.zeros((1, parts.model.reference.stop))
        self._tables = [empty] * num_envs
        self._states = np.zeros((num_envs, 4), dtype=np.uint64)  # of the generators SFC64
        self._entries = np.tile(
            np.array(ExogenousProgram(address(empty), 1, 0, 0, 0, 0), dtype=np.int64), (num_envs, 1)
        )
        self._series: dict[int, Array] = {}  # inputs of the effects, of the sub-environments that have some
        self._gust, self._weather = (np.zeros((num_envs, n)) for n in (own.gust, own.weathers))
        self._waves = np.zeros((num_envs, 0, own.wave))

    def __getstate__(self) -> dict[str, Any]:
        """Return all attributes except addresses."""
        return {key: value for key, value in self.__dict__.items() if key != "_arrays"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Set all attributes; addresses are determined again."""
        self.__dict__.update(state)
        self._entries[:, _ENTRY.table] = [address(table) for table in self._tables]

    @property
    def _code(self) -> Compiled | None:
        return compiled(self._parts.model, many=len(self._tables) > 1)

    @cached_property
    def _arrays(self) -> list[int]:
        """Addresses of the arrays for compiled code."""
        return [address(a) for a in (self._entries, self._states, self._gust, self._weather, self._waves, self._memory)]

    def load(self, index: int, scenario: Scenario, episode: Episode, table: Array) -> None:
        """Load an episode into a sub-environment; `table` is its `Reference.table`, one row per control instant."""
        self.load_rows(np.array([index]), scenario, episode, [table], [episode.noise_seed])

    def load_rows(
        self,
        indices: Indices,
        scenario: Scenario,
        episodes: Episode,
        tables: Sequence[Array],
        noise_seeds: Sequence[int],
    ) -> None:
        """Load episodes of a scenario into n sub-environments.

        Args:
            indices: of the sub-environments, shape (n,).
            scenario: the scenario of the episodes.
            episodes: n episodes as one whose numbers are rows (n,), with a position fix in each control step; or a
                single episode.
            tables: their reference tables, see `load`.
            noise_seeds: their noise seeds.
        """
        noise, current, dt = scenario.noise_of(episodes), episodes.current, scenario.control_dt
        own = rows_of(self._parts.model)
        first = own.measured.start if any(map(np.any, noise)) else own.gusts.start
        end = own.gusts.stop if np.any(current.gust) else own.measured.stop
        if first < end:
            self._states[indices] = _states_of(noise_seeds, self._code)
        for index, table in zip(indices.tolist(), tables, strict=True):
            self._tables[index] = rows = np.ascontiguousarray(table, dtype=np.float64)
            self._entries[index, _ENTRY.table] = address(rows)
            self._series.pop(index, None)
        waves = wave_components(episodes.waves, dt, self._parts.model)
        self._entries[indices, _ENTRY.instants :] = len(tables[0]), 0, first, max(first, end), len(waves)
        slowest = self._least_speed(indices) if math.isfinite(current.cap) else 0.0
        weather = weather_of(current, dt, slowest, noise, episodes.bias, self._parts.model)
        self._weather[indices] = spread(weather, len(indices)).T
        if (more := len(waves) - self._waves.shape[1]) > 0:
            self._waves = np.pad(self._waves, ((0, 0), (0, more), (0, 0)))
            self.__dict__.pop("_arrays", None)
        self._waves[indices, : len(waves)] = waves if waves.ndim == 2 else waves.transpose(2, 0, 1)
        self._gust[indices] = 0.0
        series = [e.series(scenario, episodes, tables[0]) for e in self._parts.effects if e.Inputs._fields]
        if any(rows is not None for rows in series):  # then it is a single episode, see `drawing.drawn_as_rows`
            self._series[int(indices[0])] = self._with_idle(series, len(tables[0]))

    def _least_speed(self, indices: Indices) -> Any:
        """Return the `least_speed` of the references of sub-environments."""
        if (code := self._code) is None:
            return least_speed([self._tables[index] for index in indices.tolist()], self._parts.model)
        indices, speeds = np.ascontiguousarray(indices, dtype=np.int64), np.empty(len(indices))
        code.least_speeds(len(indices), address(indices), self._arrays[0], address(speeds))
        return speeds if len(indices) > 1 else float(speeds[0])

    def read(self, indices: Sequence[int] | Indices, n: int) -> Array:
        """Return the next n samples of sub-environments, shape (n, `Parts.sample_rows`, len(indices)).

        After the last instant of an episode the last reference is repeated.
        """
        out = np.empty((n, self._parts.sample_rows, len(indices)))
        self.read_into(out, np.asarray(indices), np.arange(len(indices)))
        return out

    def read_into(self, out: Array, indices: Indices, columns: Indices) -> None:
        """Write the next T samples of sub-environments to columns of an array (T, `Parts.sample_rows`, N), see `read`.

        Raises:
            ValueError: T is larger than `block`.
        """
        if (n := len(out)) > self._memory.shape[1]:
            raise ValueError(f"{n} samples are requested; at most {self._memory.shape[1]} can be read at once")
        indices, columns = (np.ascontiguousarray(a, dtype=np.int64) for a in (indices, columns))
        if (code := self._code) is None:
            self._in_python(out, indices, columns)
        else:
            time, row = (stride // out.itemsize for stride in out.strides[:2])
            sizes = len(indices), n, self._waves.shape[1], time, row
            code.read_samples(*sizes, address(indices), address(columns), *self._arrays, address(out), code.normal)
        if len(idle := self._parts.places.idle):
            own = self._parts.model.sample_rows
            out[:, own:, columns] = idle[:, None]
            ends = self._entries[indices, _ENTRY.next].tolist()
            for end, index, column in zip(ends, indices.tolist(), columns.tolist(), strict=True):
                if index in self._series:
                    rows = self._series[index][end - n : end]
                    out[: len(rows), own:, column] = rows

    def _with_idle(self, series: Sequence[Array | None], instants: int) -> Array:
        """Return the inputs of the effects in an episode, shape (T, rows); None stands for neutral ones."""
        places = self._parts.places
        rows = np.tile(places.idle, (instants, 1))
        for own, place in zip(series, (x for x in places.inputs.values() if x.start < x.stop), strict=True):
            if own is not None:
                rows[:, place] = own.T
        return rows

    def _in_python(self, out: Array, indices: Indices, columns: Indices) -> None:
        """Write the samples of `read_into` by the same kernels as `read_samples` of exogenous.c."""
        n, model, own = len(out), self._parts.model, rows_of(self._parts.model)
        run = kernels(model)
        for index, column in zip(indices.tolist(), columns.tolist(), strict=True):
            entry, weather = ExogenousProgram(*self._entries[index].tolist()), self._weather[index]
            time, waves = np.arange(entry.next, entry.next + n), self._waves[index, : entry.waves]
            normals, table = np.zeros((n, own.normals)), self._tables[index]
            reference = table[np.minimum(time, entry.instants - 1)]
            depth = {"depth": -reference[:, own.model.position.index("z")][None]} if own.deep else {}
            if entry.first < entry.end:
                normals[:, entry.first : entry.end] = _drawn(self._states[index], n, entry.end - entry.first)
            gusts, noise = normals[:, own.gusts, None], normals[:, own.measured].T
            gust = run["gust_recursion"](n, gust=self._gust[index, :, None], normals=gusts, weather=weather)
            self._gust[index], swing = gust["gust"][:, 0], gust["swing"][:, :, 0].T
            load = np.zeros((len(model.load), n))
            load = run["wave_loads"](entry.waves, load=load, instant=time[None], waves=waves, **depth)["load"]
            rest = run["current_and_noise"](instant=time[None], swing=swing, normals=noise, weather=weather)
            out[:, model.reference, column] = reference
            parts = (model.current_rows, rest["current"]), (model.load_rows, load), (model.noise_rows, rest["measured"])
            for part, rows in parts:
                out[:, part, column] = rows.T
        self._entries[indices, _ENTRY.next] += n


def _states_of(seeds: Sequence[int], code: Compiled | None) -> NDArray[np.uint64]:
    """Return the states of the generators SFC64 for n seeds, shape (n, 4)."""
    if code is None or max(seeds) >= 2**64:
        return np.array([np.random.SFC64(seed).state["state"]["state"] for seed in seeds])
    numbers, states = np.array(seeds, dtype=np.uint64), np.empty((len(seeds), 4), dtype=np.uint64)
    code.seed_states(len(seeds), address(numbers), address(states))
    return states


def _drawn(state: NDArray[np.uint64], n: int, width: int) -> Array:
    """Return the next standard normals of a generator, shape (n, width), and update its state."""
    bits = np.random.SFC64()
    bits.state = {"bit_generator": "SFC64", "state": {"state": state}, "has_uint32": 0, "uinteger": 0}
    normals = np.random.Generator(bits).standard_normal((n, width))
    state[:] = bits.state["state"]["state"]
    return normals


def least_speed(tables: Sequence[Array], model: Model = PLANE) -> Any:
    """Return the least speed [m/s] of each reference table, a row; a number for a single table."""
    columns = [model.state.index(name) for name in model.velocity]
    speeds = [math.sqrt(sum_of_squares([table[:, k] for k in columns]).min()) for table in tables]
    return np.array(speeds) if len(speeds) > 1 else speeds[0]


def weather_of(
    current: Current,
    dt: float,
    slowest: Number,
    noise: Sequence[Number],
    bias: Sequence[Number],
    model: Model = PLANE,
) -> tuple[Number, ...]:
    """Return the numbers of the `Weather` of an episode with control period dt [s].

    The cap of the current is a fraction of the least speed of the reference, `slowest` [m/s].
    """
    c, a = current, math.exp(-dt / current.gust_time)
    b = math.exp(-dt / c.smoothing) if c.smoothing > 0 else 0.0
    cap = c.cap * slowest if math.isfinite(c.cap) else c.cap
    mean = (c.V_x, c.V_y, c.V_z)[: len(model.current)]
    return *mean, c.turn * dt, c.gust, cap, a, math.sqrt(1 - a * a), b, *noise, *bias


def wave_components(waves: Waves | None, dt: float, model: Model = PLANE) -> Array:
    """Return the numbers of the wave components, shape (components, numbers), for a control period dt [s].

    A component has its angle per control step [rad], then for each axis of the load the amplitudes of sine and cosine
    [N], [N m]. In space the rate of its decay with depth [1/m] follows, that of deep water, w^2 / g. The shape is
    (components, numbers, N) for N episodes. Without waves there are no components.
    """
    own = rows_of(model)
    if waves is None:
        return np.zeros((0, own.wave))
    frequencies, phases = np.array(waves.frequencies), np.array(waves.phases)
    amplitudes = math.sqrt(2 / len(frequencies)) * np.array(waves.forces)[:, None]
    rows, end = np.empty((len(frequencies), own.wave, *phases.shape[2:])), 1 + 2 * len(model.load)
    rows[:, 0] = frequencies * dt
    rows[:, 1:end:2] = (amplitudes * np.cos(phases)).swapaxes(0, 1)
    rows[:, 2:end:2] = (amplitudes * np.sin(phases)).swapaxes(0, 1)
    if own.deep:
        rows[:, end] = frequencies * frequencies / GRAVITY
    return rows

"""The tape: all that the outside supplies to running episodes, drawn ahead in blocks of control steps.

Randomness enters the simulation here and nowhere else, so a step itself is deterministic. Each episode owns a
generator, `numpy.random.SFC64` of its noise's seed, and the numbers do not depend on how its tape is cut into blocks.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Mapping, Sequence
from functools import cache, cached_property
from pathlib import Path as FilePath
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_gym.codegen.graph import SYMBOLS
from auv_gym.codegen.kernel import Kernel, together
from auv_gym.physics.disturbances import Current, Waves
from auv_gym.physics.errors import to_world
from auv_gym.physics.namespaces import AnyArray, Array, Indices, Namespace, Number
from auv_gym.physics.navigation import FixFilter, Reckoning, heading_errors
from auv_gym.physics.rows import filled, leaves, numbered, spread
from auv_gym.scenarios.episode import Episode
from auv_gym.scenarios.scenario import Scenario
from auv_gym.task.simulation import CURRENT, LOAD, NOISE, REFERENCE, SAMPLE, SAMPLE_ROWS

TILE = 16  # lanes whose samples are written together: whole cache lines of the result
NORMALS = 8  # standard normals of a control step
MEASUREMENT_NORMALS = slice(0, 6)  # those of the normals that become errors of the six measurements
GUSTS = slice(6, 8)  # those of the normals that drive the gusts
SEA = slice(REFERENCE.stop, SAMPLE_ROWS)  # the part of a sample that is no reference


class Errors(NamedTuple):
    """A number for each measurement: floats, or rows of shape (N,)."""

    x: Number  # [m]
    y: Number  # [m]
    psi: Number  # [rad]
    u: Number  # [m/s]
    v: Number  # [m/s]
    r: Number  # [rad/s]


class Weather(NamedTuple):
    """What an episode's samples depend on besides chance, plan and waves: floats, or rows of shape (N,)."""

    V_x: Number  # [m/s] mean current
    V_y: Number  # [m/s]
    turn: Number  # [rad] by which it turns in a control step
    sigma: Number  # [m/s] of the gusts
    cap: Number  # [m/s] largest speed of the current
    a: Number  # what is left of the process behind the gusts after a control step
    excitation: Number  # what a standard normal adds to it, sqrt(1 - a^2)
    b: Number  # what is left of the filter behind it
    noise: Errors  # standard deviations of the measurements
    bias: Errors  # of the measurements


class Gust(NamedTuple):
    """Where the gusts are, in units of sigma: floats, or rows of shape (N,)."""

    k: Number  # control instants so far
    n_x: Number  # the process
    n_y: Number
    s_x: Number  # the filter behind it
    s_y: Number


WEATHER = numbered(Weather)  # the place of every number of a `Weather` in the row of them
_GUST = numbered(Gust)  # the place of every number of a `Gust` in the row of them
WEATHER_ROWS = len(leaves(WEATHER))  # how many numbers a `Weather` has
GUST_ROWS = len(_GUST)  # how many numbers a `Gust` has
WAVE_ROWS = 7
"""Numbers of a wave component: its angle in a control step [rad], and for each axis what multiplies the sine and the
cosine of the angle so far [N], [N], [N m]."""


class Entry(NamedTuple):
    """What compiled code finds of a lane besides its numbers; integers."""

    table: Any  # address of the reference's table
    instants: Any  # control instants of the reference
    next: Any  # the coming one
    first: Any  # of the normals that are used, of which there are none if `end` is the same
    end: Any
    waves: Any  # components


_ENTRY = numbered(Entry)  # the place of every number of an `Entry`


def next_gust(gust: Gust, normals: Sequence[Number], w: Weather, ns: Namespace) -> Gust:
    """Return the gusts at a control instant, for those at the one before it.

    The gust on each axis is an Ornstein-Uhlenbeck process n behind a first-order filter s, see `disturbances.Current`:
    n_k = a n_(k-1) + sqrt(1 - a^2) w_k,  s_k = b s_(k-1) + (1 - b) n_k,  starting from n_0 = s_0 = w_0.

    Args:
        gust: the state.
        normals: w_k of both axes.
        w: the constants.
        ns: the namespace of the numbers.
    """
    k, *last = gust
    first = k < 0.5
    n_x, n_y = (ns.where(first, new, w.a * n + w.excitation * new) for n, new in zip(last[:2], normals, strict=True))
    s_x, s_y = (
        ns.where(first, new, w.b * s + (1.0 - w.b) * n) for s, n, new in zip(last[2:], (n_x, n_y), normals, strict=True)
    )
    return Gust(k + 1.0, n_x, n_y, s_x, s_y)


def gusty_current(k: Number, swing: Sequence[Number], w: Weather, ns: Namespace) -> tuple[Number, Number]:
    """Return the current [m/s] at control instant k: mean and gust, s of both axes, together cut off at the cap."""
    angle = w.turn * k
    V_x, V_y = to_world(w.V_x, w.V_y, ns.cos(angle), ns.sin(angle))
    V_x, V_y = V_x + w.sigma * swing[0], V_y + w.sigma * swing[1]
    speed = ns.sqrt(V_x * V_x + V_y * V_y)
    share = ns.where(speed > w.cap, w.cap / speed, 1.0)
    return share * V_x, share * V_y


def with_wave(load: Sequence[Number], k: Number, component: Sequence[Number], ns: Namespace) -> list[Number]:
    """Return forces X, Y [N] and N [N m] at control instant k with one more component of the waves.

    The addition theorem makes one sine and one cosine serve all axes; a component has `WAVE_ROWS` numbers.
    """
    angle, *parts = component
    s, c = ns.sin(angle * k), ns.cos(angle * k)
    return [total + (p * s + q * c) for total, p, q in zip(load, parts[::2], parts[1::2], strict=True)]


def wave_load(k: Number, components: Sequence[Sequence[Number]], ns: Namespace) -> tuple[Number, Number, Number]:
    """Return the first-order wave forces X, Y [N] and N [N m] at control instant k, see `disturbances.Waves`."""
    load: list[Number] = [0.0, 0.0, 0.0]
    for component in components:
        load = with_wave(load, k, component, ns)
    X, Y, N = load
    return X, Y, N


def measurement_errors(normals: Sequence[Number], w: Weather) -> list[Number]:
    """Return the errors of the six measurements for their standard normals."""
    return [s * n + b for s, n, b in zip(w.noise, normals, w.bias, strict=True)]


@cache
def kernels() -> Mapping[str, Kernel]:
    """Return what makes the samples of one lane, by the names that exogenous.c calls them by.

    The gusts go from instant to instant. The lanes of the others are the instants, and the waves' steps the components.
    """

    def gust_recursion(gust: Any, normals: Any, weather: Any) -> dict[str, Any]:
        after = next_gust(Gust(*gust), normals, filled(WEATHER, weather), SYMBOLS)
        return {"gust": after, "swing": (after.s_x, after.s_y)}

    def wave_loads(load: Any, instant: Any, waves: Any) -> dict[str, Any]:
        return {"load": with_wave(load, instant[0], waves, SYMBOLS)}

    def current_and_noise(instant: Any, swing: Any, normals: Any, weather: Any) -> dict[str, Any]:
        w = filled(WEATHER, weather)
        return {
            "current": gusty_current(instant[0], swing, w, SYMBOLS),
            "measured": measurement_errors(normals, w),
        }

    gust_rows = {"gust": GUST_ROWS, "normals": 2, "weather": WEATHER_ROWS}
    wave_rows = {"load": 3, "instant": 1, "waves": WAVE_ROWS}
    rows = {"instant": 1, "swing": 2, "normals": 6, "weather": WEATHER_ROWS}
    return {
        "gust_recursion": Kernel.traced(gust_recursion, gust_rows, ["normals", "swing"], shared=["weather"]),
        "wave_loads": Kernel.traced(wave_loads, wave_rows, ["waves"], shared=["waves"]),
        "current_and_noise": Kernel.traced(current_and_noise, rows, shared=["weather"]),
    }


class Compiled(NamedTuple):
    """What exogenous.c does."""

    sow: Callable[..., None]
    slowest: Callable[..., None]
    read_ahead: Callable[..., None]
    normal: Any  # address of NumPy's standard normals


@cache
def compiled(many: bool = True) -> Compiled | None:
    """Return what exogenous.c does, to be fast for `many` lanes or compiled in half the time; None if it cannot be."""
    try:
        normal = ctypes.CDLL(np.random._generator.__file__).random_standard_normal
    except (OSError, AttributeError):  # NumPy was built in another way
        return None
    sizes = {"SAMPLES": SAMPLE_ROWS, "NORMALS": NORMALS, "GUSTS": GUSTS.start, "GUST": GUST_ROWS, "TILE": TILE}
    sizes |= {"WEATHER": WEATHER_ROWS, "WAVE": WAVE_ROWS, "ENTRIES": len(_ENTRY)}
    sizes |= {name.upper(): place for name, place in _ENTRY._asdict().items()}
    head = "".join(f"#define {name} {value}\n" for name, value in sizes.items())
    library = together(kernels(), head + FilePath(__file__).with_suffix(".c").read_text(encoding="utf-8"), many=many)
    if library is None:
        return None
    pointer, whole = ctypes.c_void_p, ctypes.c_long
    library.sow.argtypes, library.sow.restype = [whole] + [pointer] * 2, None
    library.slowest.argtypes, library.slowest.restype = [whole] + [pointer] * 3, None
    library.read_ahead.argtypes, library.read_ahead.restype = [whole] * 5 + [pointer] * 10, None
    address = ctypes.cast(normal, pointer)
    library.learn(address)
    return Compiled(library.sow, library.slowest, library.read_ahead, address)


class Tape:
    """The samples (`simulation.Sample`) of episodes that run side by side, each in its own lane."""

    def __init__(self, lanes: int, block: int) -> None:
        """Make a tape of that many empty lanes, to be read in up to `block` control steps at once."""
        self._memory = np.empty((TILE * (SAMPLE_ROWS + NORMALS) + NORMALS + 3, block))  # that compiled code works in
        nothing: Array = np.zeros((1, REFERENCE.stop))
        self._tables = [nothing] * lanes
        self._states = np.zeros((lanes, 4), dtype=np.uint64)  # of their generators, which are of the type SFC64
        self._entries = np.tile(np.array(Entry(_address(nothing), 1, 0, 0, 0, 0), dtype=np.int64), (lanes, 1))
        self._fixes: dict[int, Array] = {}  # of the lanes that lack some
        self._headings: dict[int, Array] = {}  # errors [rad] of a gyro that drifts, of the lanes that have one
        self._gust, self._weather = np.zeros((lanes, GUST_ROWS)), np.zeros((lanes, WEATHER_ROWS))
        self._waves = np.zeros((lanes, 0, WAVE_ROWS))

    def __getstate__(self) -> dict[str, Any]:
        """Return everything but addresses."""
        return {key: value for key, value in self.__dict__.items() if key != "_arrays"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take everything up, at new addresses."""
        self.__dict__.update(state)
        for lane in range(len(self._tables)):
            self._locate(lane)

    @property
    def _code(self) -> Compiled | None:
        return compiled(many=len(self._tables) > 1)

    def _locate(self, lane: int) -> None:
        """Note where the table of a lane is."""
        self._entries[lane, _ENTRY.table] = _address(self._tables[lane])

    @cached_property
    def _arrays(self) -> list[int]:
        """Where the numbers of all lanes are."""
        return [
            _address(a) for a in (self._entries, self._states, self._gust, self._weather, self._waves, self._memory)
        ]

    def load(self, lane: int, scenario: Scenario, episode: Episode, table: Array) -> None:
        """Wind a new episode into a lane; `table` is its `Reference.table`, one row per control instant."""
        self.load_rows(np.array([lane]), scenario, episode, [table], [episode.noise_seed])

    def load_rows(
        self,
        lanes: Indices,
        scenario: Scenario,
        episodes: Episode,
        tables: Sequence[Array],
        noise_seeds: Sequence[int],
    ) -> None:
        """Wind new episodes of a scenario into n lanes.

        Args:
            lanes: which of them, shape (n,).
            scenario: of the episodes.
            episodes: one whose numbers are rows (n,) and who always has a position fix, or a single one.
            tables: of their references, see `load`.
            noise_seeds: of the episodes.
        """
        noise, current, dt = scenario.sensors.noise, episodes.current, scenario.control_dt
        first = MEASUREMENT_NORMALS.start if any(noise) else GUSTS.start
        end = GUSTS.stop if np.any(current.gust) else MEASUREMENT_NORMALS.stop
        if first < end:
            self._states[lanes] = _states_of(noise_seeds, self._code)
        for lane, table in zip(lanes.tolist(), tables, strict=True):
            self._tables[lane] = np.ascontiguousarray(table, dtype=np.float64)
            self._locate(lane)
            self._fixes.pop(lane, None)
            self._headings.pop(lane, None)
        waves = wave_components(episodes.waves, dt)
        self._entries[lanes, _ENTRY.instants :] = len(tables[0]), 0, first, max(first, end), len(waves)
        slowest = self._least_speed(lanes) if math.isfinite(current.cap) else 0.0
        weather = weather_of(current, dt, slowest, Errors(*noise), Errors(*episodes.bias))
        self._weather[lanes] = spread(leaves(weather), len(lanes)).T
        if (more := len(waves) - self._waves.shape[1]) > 0:
            self._waves = np.pad(self._waves, ((0, 0), (0, more), (0, 0)))
            self.__dict__.pop("_arrays", None)
        self._waves[lanes, : len(waves)] = waves if waves.ndim == 2 else waves.transpose(2, 0, 1)
        self._gust[lanes] = 0.0
        if episodes.outages or episodes.reckoning:
            self._navigate(int(lanes[0]), scenario, episodes, tables[0])

    def _least_speed(self, lanes: Indices) -> Any:
        """Return the least speed [m/s] of the references of lanes, a row; of a single one, a number."""
        if (code := self._code) is None:
            return least_speed([self._tables[lane] for lane in lanes.tolist()])
        own, speeds = np.ascontiguousarray(lanes, dtype=np.int64), np.empty(len(lanes))
        code.slowest(len(own), _address(own), self._arrays[0], _address(speeds))
        return speeds if len(lanes) > 1 else float(speeds[0])

    def _navigate(self, lane: int, scenario: Scenario, episode: Episode, table: Array) -> None:
        """Wind in which position fixes an episode has, and how its gyro drifts."""
        sensors, reckoning, dt = scenario.sensors, episode.reckoning, scenario.control_dt
        if episode.outages or reckoning:
            self._fixes[lane] = _fixes(episode.outages, dt, len(table))
        if reckoning and sensors.reckoning:
            fix_filter, rng = sensors.fix_filter(dt, scenario.duration), np.random.default_rng([episode.noise_seed, 3])
            self._fixes[lane] = _shares(self._fixes[lane], reckoning, fix_filter, dt, table)
            walk = sensors.reckoning.walk
            self._headings[lane] = heading_errors(reckoning.drift, walk, dt, len(table), rng)

    def read(self, lanes: Sequence[int] | Indices, n: int) -> Array:
        """Return the next n samples of these lanes, shape (n, SAMPLE_ROWS, len(lanes)), and wind on.

        Behind an episode's last instant a lane repeats its last reference.
        """
        out = np.empty((n, SAMPLE_ROWS, len(lanes)))
        self.read_into(out, np.asarray(lanes), np.arange(len(lanes)))
        return out

    def read_into(self, out: Array, lanes: Indices, columns: Indices) -> None:
        """Write the next samples of lanes to columns of an array (T, SAMPLE_ROWS, N), T <= block; see `read`."""
        if (n := len(out)) > self._memory.shape[1]:
            raise ValueError(f"{n} samples are asked for; at most {self._memory.shape[1]} are read at once")
        lanes, columns = (np.ascontiguousarray(places, dtype=np.int64) for places in (lanes, columns))
        if (code := self._code) is None:
            self._in_python(out, lanes, columns)
        else:
            time, row = (stride // out.itemsize for stride in out.strides[:2])
            sizes = len(lanes), n, self._waves.shape[1], time, row
            code.read_ahead(*sizes, _address(lanes), _address(columns), *self._arrays, _address(out), code.normal)
        if self._fixes:
            ends = self._entries[lanes, _ENTRY.next].tolist()
            for end, lane, column in zip(ends, lanes.tolist(), columns.tolist(), strict=True):
                now = slice(end - n, end)
                if lane in self._fixes:
                    part = self._fixes[lane][now]
                    out[: len(part), SAMPLE.fix, column] = part
                if lane in self._headings:
                    part = self._headings[lane][now]
                    out[: len(part), SAMPLE.n_psi, column] += part

    def _in_python(self, out: Array, lanes: Indices, columns: Indices) -> None:
        """Do what the compiled reader does, from the same kernels."""
        run, n = kernels(), len(out)
        for lane, column in zip(lanes.tolist(), columns.tolist(), strict=True):
            entry, weather = Entry(*self._entries[lane].tolist()), self._weather[lane]
            time, waves = np.arange(entry.next, entry.next + n), self._waves[lane, : entry.waves]
            normals = np.zeros((n, NORMALS))
            if entry.first < entry.end:
                normals[:, entry.first : entry.end] = _drawn(self._states[lane], n, entry.end - entry.first)
            driven, noise = normals[:, GUSTS, None], normals[:, MEASUREMENT_NORMALS].T
            gust = run["gust_recursion"](n, gust=self._gust[lane, :, None], normals=driven, weather=weather)
            self._gust[lane], swing = gust["gust"][:, 0], gust["swing"][:, :, 0].T
            load = run["wave_loads"](entry.waves, load=np.zeros((3, n)), instant=time[None], waves=waves)["load"]
            sea = run["current_and_noise"](instant=time[None], swing=swing, normals=noise, weather=weather)
            out[:, REFERENCE, column] = self._tables[lane][np.minimum(time, entry.instants - 1)]
            for part, rows in ((CURRENT, sea["current"]), (LOAD, load), (NOISE, sea["measured"])):
                out[:, part, column] = rows.T
            out[:, SAMPLE.fix, column] = 1.0
        self._entries[lanes, _ENTRY.next] += n


def _address(array: AnyArray) -> int:
    address: int = array.__array_interface__["data"][0]  # half the cost of `array.ctypes`
    return address


def _states_of(seeds: Sequence[int], code: Compiled | None) -> NDArray[np.uint64]:
    """Return the states of the generators SFC64 of some seeds, shape (n, 4)."""
    if code is None or max(seeds) >= 2**64:
        return np.array([np.random.SFC64(seed).state["state"]["state"] for seed in seeds])
    given, states = np.array(seeds, dtype=np.uint64), np.empty((len(seeds), 4), dtype=np.uint64)
    code.sow(len(seeds), _address(given), _address(states))
    return states


def _drawn(state: NDArray[np.uint64], n: int, width: int) -> Array:
    """Return the next standard normals of a generator, shape (n, width), and take its state along."""
    bits = np.random.SFC64()
    bits.state = {"bit_generator": "SFC64", "state": {"state": state}, "has_uint32": 0, "uinteger": 0}
    normals = np.random.Generator(bits).standard_normal((n, width))
    state[:] = bits.state["state"]["state"]
    return normals


def least_speed(tables: Sequence[Array]) -> Any:
    """Return the least speed [m/s] of each reference table, a row; of one, a number."""
    speeds = [math.sqrt((table[:, SAMPLE.u_R] ** 2 + table[:, SAMPLE.v_R] ** 2).min()) for table in tables]
    return np.array(speeds) if len(speeds) > 1 else speeds[0]


def _fixes(outages: Sequence[tuple[float, float]], dt: float, instants: int) -> Array:
    """Return 1 for each control instant with a position fix, else 0; the first one always has it."""
    times = dt * np.arange(instants, dtype=np.float64)
    fixes = np.ones(instants)
    for begin, end in outages:
        fixes[(times >= begin) & (times < end)] = 0.0
    fixes[0] = 1.0
    return fixes


def _shares(fixes: Array, reckoning: Reckoning, fix_filter: FixFilter, dt: float, table: Array) -> Array:
    """Return which share of a position fix is taken on at each control instant: all of the first one, often none.

    Args:
        fixes: 1 for each control instant at which a fix does not fail, else 0.
        reckoning: of the episode.
        fix_filter: of its sensors.
        dt: control period [s].
        table: of its reference, shape (T, 8): how far it goes between fixes is what the filter reckons with.
    """
    instants = np.unique(np.ceil(np.array(reckoning.fixes) / dt - 1e-9).astype(int))
    used = [0, *(k for k in instants.tolist() if 0 < k < len(table) and fixes[k])]
    way = np.concatenate(([0.0], dt * np.cumsum(np.hypot(table[1:, SAMPLE.u_R], table[1:, SAMPLE.v_R]))))
    shares = np.zeros(len(table))
    shares[used] = [1.0, *fix_filter.gains(np.diff(way[used]).tolist(), (dt * np.diff(used)).tolist())]
    return shares


def weather_of(current: Current, dt: float, slowest: Number, noise: Errors, bias: Errors) -> Weather:
    """Return the constants of an episode's tape.

    Args:
        current: of the episode.
        dt: control period [s].
        slowest: least speed [m/s] of its reference, of which the cap is a share.
        noise: standard deviations of the measurements.
        bias: of the measurements.
    """
    a = math.exp(-dt / current.gust_time)
    b = math.exp(-dt / current.smoothing) if current.smoothing > 0 else 0.0
    cap = current.cap * slowest if math.isfinite(current.cap) else current.cap
    turn = current.turn * dt
    return Weather(current.V_x, current.V_y, turn, current.gust, cap, a, math.sqrt(1 - a * a), b, noise, bias)


def wave_components(waves: Waves | None, dt: float) -> Array:
    """Return the `WAVE_ROWS` numbers of each component for a control period dt [s], a row each; none without waves.

    Of N episodes it is an array (components, WAVE_ROWS, N).
    """
    if waves is None:
        return np.zeros((0, WAVE_ROWS))
    frequencies, phases = np.array(waves.frequencies), np.array(waves.phases)
    amplitudes = math.sqrt(2 / len(frequencies)) * np.array([waves.surge, waves.sway, waves.yaw])[:, None]
    rows = np.empty((len(frequencies), WAVE_ROWS, *phases.shape[2:]))
    rows[:, 0] = frequencies * dt
    rows[:, 1::2] = (amplitudes * np.cos(phases)).swapaxes(0, 1)
    rows[:, 2::2] = (amplitudes * np.sin(phases)).swapaxes(0, 1)
    return rows

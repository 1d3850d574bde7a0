"""The tape: all that the outside supplies to running episodes, drawn ahead in blocks of control steps.

Randomness enters the simulation here and nowhere else, so a step itself is deterministic. Each episode owns a
generator, and the numbers do not depend on how its tape is cut into blocks.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from auv_gym.codegen.graph import SYMBOLS
from auv_gym.codegen.kernel import Kernel
from auv_gym.physics.disturbances import Current, Waves
from auv_gym.physics.errors import to_world
from auv_gym.physics.namespaces import Array, Indices, Namespace, Number
from auv_gym.physics.navigation import FixFilter, Reckoning, heading_errors
from auv_gym.physics.rows import filled, leaves, numbered
from auv_gym.scenarios.episode import Episode
from auv_gym.scenarios.scenario import Scenario
from auv_gym.task.simulation import REFERENCE, SAMPLE, SAMPLE_ROWS

GROUP = 64  # lanes read together: few enough for the cache, many enough to pay for a call
TILE = 8  # lanes transposed together: one cache line of the result
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


def current_gust(
    gust: Gust, normals: Sequence[Number], w: Weather, ns: Namespace
) -> tuple[Gust, tuple[Number, Number]]:
    """Return the gusts' state at the next control instant and the current [m/s] at this one.

    The gust on each axis is an Ornstein-Uhlenbeck process n behind a first-order filter s, see `disturbances.Current`:
    n_k = a n_(k-1) + sqrt(1 - a^2) w_k,  s_k = b s_(k-1) + (1 - b) n_k,  starting from n_0 = s_0 = w_0. Mean and gust
    together are cut off at the cap.

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
    angle = w.turn * k
    V_x, V_y = to_world(w.V_x, w.V_y, ns.cos(angle), ns.sin(angle))
    V_x, V_y = V_x + w.sigma * s_x, V_y + w.sigma * s_y
    speed = ns.sqrt(V_x * V_x + V_y * V_y)
    share = ns.where(speed > w.cap, w.cap / speed, 1.0)
    return Gust(k + 1.0, n_x, n_y, s_x, s_y), (share * V_x, share * V_y)


def wave_load(k: Number, components: Sequence[Sequence[Number]], ns: Namespace) -> tuple[Number, Number, Number]:
    """Return the first-order wave forces X, Y [N] and N [N m] at control instant k, see `disturbances.Waves`.

    The addition theorem makes one sine and one cosine of each component serve all axes; `components` has `WAVE_ROWS`
    numbers of each.
    """
    load: list[Number] = [0.0, 0.0, 0.0]
    for angle, *parts in components:
        s, c = ns.sin(angle * k), ns.cos(angle * k)
        load = [total + (p * s + q * c) for total, p, q in zip(load, parts[::2], parts[1::2], strict=True)]
    X, Y, N = load
    return X, Y, N


@cache
def sea_kernel(components: int) -> Kernel:
    """Return the kernel of all that is no reference in a sample, for up to so many wave components."""

    def equation(gust: Any, normals: Any, weather: Any, waves: Any) -> Mapping[str, Sequence[Any]]:
        w = filled(WEATHER, weather)
        after, current = current_gust(Gust(*gust), normals[GUSTS], w, SYMBOLS)
        parts = [waves[i : i + WAVE_ROWS] for i in range(0, len(waves), WAVE_ROWS)]
        load = wave_load(gust[_GUST.k], parts, SYMBOLS)
        measured = [s * n + b for s, n, b in zip(w.noise, normals[MEASUREMENT_NORMALS], w.bias, strict=True)]
        return {"gust": after, "sea": (*current, *load, *measured, 1.0)}

    rows = {"gust": GUST_ROWS, "normals": NORMALS, "weather": WEATHER_ROWS, "waves": WAVE_ROWS * components}
    return Kernel.traced(equation, rows, ["normals", "sea"])


class Tape:
    """The samples (`simulation.Sample`) of episodes that run side by side, each in its own lane."""

    def __init__(self, lanes: int, block: int) -> None:
        """Make a tape of that many empty lanes, to be read in up to `block` control steps at once."""
        self._tables: list[Array] = [np.empty((0, 8))] * lanes
        self._drawn: list[tuple[np.random.Generator, int, int] | None] = [None] * lanes
        self._next = np.zeros(lanes, dtype=np.int64)
        self._fixes: dict[int, Array] = {}  # of the lanes that lack some
        self._headings: dict[int, Array] = {}  # errors [rad] of a gyro that drifts, of the lanes that have one
        self._gust, self._weather = np.zeros((GUST_ROWS, lanes)), np.zeros((WEATHER_ROWS, lanes))
        self._waves = np.zeros((0, lanes))

    def load(self, lane: int, scenario: Scenario, episode: Episode, table: Array) -> None:
        """Wind a new episode into a lane; `table` is its `Reference.table`, one row per control instant."""
        self._tables[lane] = table
        self._next[lane] = 0
        noise, gusty = scenario.sensors.noise, episode.current.gust > 0
        first = MEASUREMENT_NORMALS.start if any(noise) else GUSTS.start
        end = GUSTS.stop if gusty else MEASUREMENT_NORMALS.stop
        self._drawn[lane] = None
        if first < end:
            self._drawn[lane] = np.random.Generator(np.random.SFC64(episode.noise_seed)), first, end
        self._navigate(lane, scenario, episode, table)
        self._gust[:, lane] = 0.0
        weather = weather_of(episode.current, scenario.control_dt, table, Errors(*noise), Errors(*episode.bias))
        self._weather[:, lane] = leaves(weather)
        components = wave_components(episode.waves, scenario.control_dt)
        if (more := len(components) - len(self._waves)) > 0:
            self._waves = np.pad(self._waves, ((0, more), (0, 0)))  # what is not used has no amplitude
        self._waves[:, lane] = 0.0
        self._waves[: len(components), lane] = components

    def _navigate(self, lane: int, scenario: Scenario, episode: Episode, table: Array) -> None:
        """Wind in which position fixes an episode has, and how its gyro drifts."""
        self._fixes.pop(lane, None)
        self._headings.pop(lane, None)
        sensors, reckoning, dt = scenario.sensors, episode.reckoning, scenario.control_dt
        if episode.outages or reckoning:
            self._fixes[lane] = _fixes(episode.outages, dt, len(table))
        if reckoning and sensors.reckoning:
            fix_filter, rng = sensors.fix_filter(dt, scenario.duration), np.random.default_rng([episode.noise_seed, 3])
            self._fixes[lane] = _shares(self._fixes[lane], reckoning, fix_filter, dt, table)
            walk = sensors.reckoning.walk
            self._headings[lane] = heading_errors(reckoning.drift, walk, dt, len(table), rng)

    def read(self, lanes: Sequence[int] | Indices, n: int, out: Array | None = None) -> Array:
        """Return the next n <= block samples of these lanes, shape (n, SAMPLE_ROWS, len(lanes)), and wind on.

        Behind an episode's last instant a lane repeats its last reference. The samples are written to `out`, if given.
        """
        if out is None:
            out = np.empty((n, SAMPLE_ROWS, len(lanes)))
        for first in range(0, len(lanes), GROUP):
            self._read(np.asarray(lanes[first : first + GROUP]), out[:, :, first : first + GROUP])
        return out

    def _read(self, lanes: Indices, out: Array) -> None:
        first = self._next[lanes]
        _transpose(self._references(lanes, len(out)), out[:, REFERENCE])
        gust, weather, waves = (rows.take(lanes, axis=1) for rows in (self._gust, self._weather, self._waves))
        kernel, normals = sea_kernel(len(waves) // WAVE_ROWS), self._normals(lanes, len(out))
        kernel.bound(gust=gust, normals=normals, weather=weather, waves=waves, sea=out[:, SEA])(0, len(out))
        self._gust[:, lanes] = gust
        for i, lane in enumerate(lanes.tolist() if self._fixes else ()):
            now = slice(first[i], first[i] + len(out))
            if lane in self._fixes:
                part = self._fixes[lane][now]
                out[: len(part), SAMPLE.fix, i] = part
            if lane in self._headings:
                part = self._headings[lane][now]
                out[: len(part), SAMPLE.n_psi, i] += part
        self._next[lanes] += len(out)

    def _references(self, lanes: Indices, n: int) -> Array:
        """Return the next rows of the tables, shape (lanes, n, 8)."""
        rows = np.empty((len(lanes), n, REFERENCE.stop))
        for row, lane, k in zip(rows, lanes.tolist(), self._next[lanes].tolist(), strict=True):
            table = self._tables[lane]
            have = len(table) - k
            if have >= n:
                row[:] = table[k : k + n]
            else:
                row[: max(have, 0)] = table[k:]
                row[max(have, 0) :] = table[-1]
        return rows

    def _normals(self, lanes: Indices, n: int) -> Array:
        """Return standard normals, shape (n, NORMALS, lanes), zero where a lane uses none."""
        out = np.zeros((n, NORMALS, len(lanes)))
        normals = np.zeros((len(lanes), n, NORMALS))
        for i, lane in enumerate(lanes.tolist()):
            if drawn := self._drawn[lane]:
                generator, a, b = drawn
                if b - a == NORMALS:
                    generator.standard_normal(out=normals[i])
                else:
                    normals[i, :, a:b] = generator.standard_normal((n, b - a))
        _transpose(normals, out)
        return out


def _transpose(rows: Array, out: Array) -> None:
    """Copy rows of shape (lanes, n, m) into an array of shape (n, m, lanes)."""
    for first in range(0, len(rows), TILE):
        out[:, :, first : first + TILE] = rows[first : first + TILE].transpose(1, 2, 0)


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


def weather_of(current: Current, dt: float, table: Array, noise: Errors, bias: Errors) -> Weather:
    """Return the constants of an episode's tape.

    Args:
        current: of the episode.
        dt: control period [s].
        table: of its reference, shape (T, 8), whose least speed the cap is a share of.
        noise: standard deviations of the measurements.
        bias: of the measurements.
    """
    a = math.exp(-dt / current.gust_time)
    b = math.exp(-dt / current.smoothing) if current.smoothing > 0 else 0.0
    cap = current.cap
    if math.isfinite(cap):
        u_R, v_R = table[:, SAMPLE.u_R], table[:, SAMPLE.v_R]
        cap *= math.sqrt((u_R**2 + v_R**2).min())
    turn = current.turn * dt
    return Weather(current.V_x, current.V_y, turn, current.gust, cap, a, math.sqrt(1 - a * a), b, noise, bias)


def wave_components(waves: Waves | None, dt: float) -> Array:
    """Return the `WAVE_ROWS` numbers of each component in a row, for a control period dt [s]; none without waves."""
    if waves is None:
        return np.zeros(0)
    amplitudes = math.sqrt(2 / len(waves.frequencies)) * np.array([[waves.surge], [waves.sway], [waves.yaw]])
    sines, cosines = amplitudes * np.cos(waves.phases), amplitudes * np.sin(waves.phases)
    rows = np.empty((len(waves.frequencies), WAVE_ROWS))
    rows[:, 0], rows[:, 1::2], rows[:, 2::2] = np.array(waves.frequencies) * dt, sines.T, cosines.T
    return rows.ravel()

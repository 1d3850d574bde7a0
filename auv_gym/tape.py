"""The tape: all that the outside supplies to running episodes, drawn ahead in blocks of control steps.

Randomness enters the simulation here and nowhere else, so a step itself is deterministic. Each episode owns a
generator, and the numbers do not depend on how its tape is cut into blocks.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from auv_gym.disturbances import Current, Waves
from auv_gym.episode import Episode
from auv_gym.errors import to_world
from auv_gym.namespaces import ARRAYS
from auv_gym.scenario import Scenario
from auv_gym.simulation import CURRENT, LOAD, NOISE, REFERENCE, SAMPLE, SAMPLE_ROWS

Array = NDArray[np.float64]
Lanes = NDArray[np.int64]

GROUP = 128  # lanes read together: few enough for the cache, many enough for NumPy
TILE = 8  # lanes transposed together: one cache line of the result
NORMALS = 8  # standard normals of a control step
MEASURED = slice(0, 6)  # those of the normals that become errors of the six measurements
GUSTS = slice(6, 8)  # those of the normals that drive the gusts


class Tape:
    """The samples (`simulation.Sample`) of episodes that run side by side, each in its own lane."""

    def __init__(self, lanes: int, block: int) -> None:
        """Make a tape of that many empty lanes, to be read in up to `block` control steps at once."""
        self._tables: list[Array] = [np.empty((0, 8))] * lanes
        self._drawn: list[tuple[np.random.Generator, int, int] | None] = [None] * lanes
        self._next = np.zeros(lanes, dtype=np.int64)
        self._noise, self._bias = np.zeros((lanes, 6)), np.zeros((lanes, 6))
        self._fixes: dict[int, Array] = {}  # of the lanes that lack some
        self._gusts = _Gusts(lanes)
        self._waves = _Waves(lanes, block)

    def load(self, lane: int, scenario: Scenario, episode: Episode, table: Array) -> None:
        """Wind a new episode into a lane; `table` is its `Reference.table`, one row per control instant."""
        self._tables[lane] = table
        self._next[lane] = 0
        noise, gusty = scenario.sensors.noise, episode.current.gust > 0
        self._noise[lane], self._bias[lane] = noise, episode.bias
        first = MEASURED.start if any(noise) else GUSTS.start
        end = GUSTS.stop if gusty else MEASURED.stop
        self._drawn[lane] = None
        if first < end:
            self._drawn[lane] = np.random.Generator(np.random.SFC64(episode.noise_seed)), first, end
        self._fixes.pop(lane, None)
        if episode.outages:
            self._fixes[lane] = _fixes(episode.outages, scenario.control_dt, len(table))
        self._gusts.load(lane, episode.current, scenario.control_dt, table)
        self._waves.load(lane, episode.waves, scenario.control_dt)

    def read(self, lanes: Sequence[int] | Lanes, n: int, out: Array | None = None) -> Array:
        """Return the next n <= block samples of these lanes, shape (n, SAMPLE_ROWS, len(lanes)), and wind on.

        Behind an episode's last instant a lane repeats its last reference. The samples are written to `out`, if given.
        """
        if out is None:
            out = np.empty((n, SAMPLE_ROWS, len(lanes)))
        for first in range(0, len(lanes), GROUP):
            self._read(np.asarray(lanes[first : first + GROUP]), out[:, :, first : first + GROUP])
        return out

    def _read(self, lanes: Lanes, out: Array) -> None:
        first = self._next[lanes]
        _transpose(self._references(lanes, len(out)), out[:, REFERENCE])
        normals = self._normals(lanes, len(out))
        self._gusts.read(lanes, normals, first, out[:, CURRENT])
        self._waves.read(lanes, first, out[:, LOAD])
        bias = self._bias[lanes].T
        if normals is None:
            out[:, NOISE] = bias
        else:
            _transpose(normals[:, :, MEASURED], out[:, NOISE])
            out[:, NOISE] *= self._noise[lanes].T
            out[:, NOISE] += bias
        out[:, SAMPLE.fix] = 1.0
        if self._fixes:
            for i, lane in enumerate(lanes.tolist()):
                if lane in self._fixes:
                    part = self._fixes[lane][first[i] : first[i] + len(out)]
                    out[: len(part), SAMPLE.fix, i] = part
        self._next[lanes] += len(out)

    def _references(self, lanes: Lanes, n: int) -> Array:
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

    def _normals(self, lanes: Lanes, n: int) -> Array | None:
        """Return standard normals, shape (lanes, n, NORMALS), zero where a lane uses none; None if no lane does."""
        random = [(i, *drawn) for i, lane in enumerate(lanes.tolist()) if (drawn := self._drawn[lane])]
        if not random:
            return None
        normals = np.zeros((len(lanes), n, NORMALS))
        for i, generator, a, b in random:
            if b - a == NORMALS:
                generator.standard_normal(out=normals[i])
            else:
                normals[i, :, a:b] = generator.standard_normal((n, b - a))
        return normals


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


class _Gusts:
    """Mean current plus smoothed Ornstein-Uhlenbeck gusts, see `disturbances.Current`.

    Process n and smoothing filter s in one second-order filter, driven by white noise w:
    n_k = a n_(k-1) + sqrt(1 - a^2) sigma w_k,  s_k = b s_(k-1) + (1 - b) n_k,  starting from n_0 = s_0 = sigma w_0.
    """

    def __init__(self, lanes: int) -> None:
        self._mean, self._turn = np.zeros((lanes, 2)), np.zeros(lanes)  # [rad] per control step
        self._sigma, self._cap = np.zeros(lanes), np.full(lanes, np.inf)
        self._decay = np.zeros((lanes, 2))  # a and b
        self._state = np.zeros((lanes, 2, 2))  # of the filter, (order, axis)

    def load(self, lane: int, current: Current, dt: float, table: Array) -> None:
        self._mean[lane] = current.V_x, current.V_y
        self._turn[lane] = current.turn * dt
        self._sigma[lane] = current.gust
        smoothing = math.exp(-dt / current.smoothing) if current.smoothing > 0 else 0.0
        self._decay[lane] = math.exp(-dt / current.gust_time), smoothing
        u_R, v_R = table[:, SAMPLE.u_R], table[:, SAMPLE.v_R]
        self._cap[lane] = current.cap * (math.sqrt((u_R**2 + v_R**2).min()) if math.isfinite(current.cap) else 1.0)

    def read(self, lanes: Lanes, normals: Array | None, first: Lanes, out: Array) -> None:
        """Write the current from step `first` of each lane on, shape (n, 2, lanes).

        It is driven by the `GUSTS` of standard normals (lanes, n, NORMALS).
        """
        fresh = first == 0
        out[:] = self._mean[lanes].T
        if self._turn[lanes].any():
            angle = self._turn[lanes] * (first + np.arange(len(out))[:, None])
            out[:] = np.stack(to_world(out[:, 0], out[:, 1], np.cos(angle), np.sin(angle)), axis=1)
        windy = self._sigma[lanes].nonzero()[0]
        if normals is not None and len(windy):
            decay = self._decay[lanes[windy]]
            for a, b in set(map(tuple, decay.tolist())):  # lanes that share their time constants
                group = windy[(decay == (a, b)).all(axis=1)]
                part = _range(group)
                gusts = self._filtered(lanes[group], normals[part, :, GUSTS], fresh[group], a, b)
                out[:, :, part] += self._sigma[lanes[group]] * gusts.transpose(1, 2, 0)
        cap = self._cap[lanes]
        if np.isfinite(cap).any():
            V_x, V_y = out[:, 0], out[:, 1]
            speed = np.sqrt(V_x * V_x + V_y * V_y)  # a sixth of np.hypot's cost
            out *= np.minimum(1.0, cap / np.maximum(speed, 1e-300))[:, None]

    def _filtered(self, lanes: Lanes, normals: Array, fresh: NDArray[np.bool_], a: float, b: float) -> Array:
        """Return s / sigma for standard normals, both of shape (lanes, n, 2)."""
        gain = (1 - b) * math.sqrt(1 - a * a)
        if fresh.any():  # `lfilter` adds its first state to gain w_0, which gives s_0 = w_0, and its second to s_1
            first = normals[fresh, 0]
            self._state[lanes[fresh]] = np.stack(((1 - gain) * first, -a * b * first), axis=1)
        smooth, self._state[lanes] = lfilter([gain], [1.0, -a - b, a * b], normals, axis=1, zi=self._state[lanes])
        return np.asarray(smooth)


def _range(index: Lanes) -> Lanes | slice:
    """Return increasing indices as a slice where they have no gaps: NumPy copies those several times faster."""
    first, last = int(index[0]), int(index[-1])
    return slice(first, last + 1) if last - first + 1 == len(index) else index


class _Waves:
    """Sums of sines, see `disturbances.Waves`.

    Within a block sin(w (t0 + t) + phi) is split by the addition theorem into a basis in t that an episode computes
    once and coefficients that a block computes once, so that a sample costs a small matrix product and no sine.
    """

    def __init__(self, lanes: int, block: int) -> None:
        self._steps = np.arange(block)
        self._wavy = np.zeros(lanes, dtype=bool)
        self._angle = np.zeros((lanes, 0))  # [rad] per control step, shape (lanes, components)
        self._phase, self._amplitude = np.zeros((lanes, 3, 0)), np.zeros((lanes, 3, 0))
        self._basis = np.zeros((lanes, 2, 0, block))  # cosine and sine

    def _grow(self, more: int) -> None:
        """Make room for episodes of more components than any before; what is not used has amplitude zero."""
        if more <= 0:
            return
        pad = (0, more)
        self._angle = np.pad(self._angle, ((0, 0), pad))
        self._phase, self._amplitude = (np.pad(x, ((0, 0), (0, 0), pad)) for x in (self._phase, self._amplitude))
        self._basis = np.pad(self._basis, ((0, 0), (0, 0), pad, (0, 0)))

    def load(self, lane: int, waves: Waves | None, dt: float) -> None:
        self._wavy[lane] = waves is not None
        self._amplitude[lane] = 0.0
        if waves is None:
            return
        n = len(waves.frequencies)
        self._grow(n - self._angle.shape[1])
        self._angle[lane, :n] = np.array(waves.frequencies) * dt
        self._phase[lane, :, :n] = waves.phases
        self._amplitude[lane, :, :n] = math.sqrt(2 / n) * np.array([[waves.surge], [waves.sway], [waves.yaw]])
        angles = self._angle[lane, :, None] * self._steps
        self._basis[lane] = np.cos(angles), np.sin(angles)

    def read(self, lanes: Lanes, first: Lanes, out: Array) -> None:
        """Write the forces, shape (n, 3, lanes), from step `first` of each lane on."""
        if not self._wavy[lanes].any():
            out[:] = 0.0
            return
        angle = (self._angle[lanes] * first[:, None])[:, None] + self._phase[lanes]
        amplitude, basis = self._amplitude[lanes], self._basis[lanes, :, :, : len(out)]
        total = (amplitude * ARRAYS.sin(angle)) @ basis[:, 0] + (amplitude * ARRAYS.cos(angle)) @ basis[:, 1]
        out[:] = total.transpose(2, 1, 0)

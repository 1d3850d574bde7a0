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
from auv_gym.scenario import Scenario
from auv_gym.simulation import SAMPLE

Array = NDArray[np.float64]
Lanes = NDArray[np.int64]

TILE = 16  # lanes transposed at once, so that both sides of the copy stay in the cache


class Tape:
    """The samples (`simulation.Sample`) of episodes that run side by side, each in its own lane."""

    def __init__(self, lanes: int, block: int) -> None:
        """Make a tape of that many empty lanes, to be read in up to `block` control steps at once."""
        self._tables: list[Array] = [np.empty((0, 8))] * lanes
        self._generators: list[np.random.Generator | None] = [None] * lanes
        self._drawn = [(0, 8)] * lanes  # columns of normals in use: six measurements, two gusts
        self._next = np.zeros(lanes, dtype=np.int64)
        self._noise, self._bias = np.zeros((lanes, 6)), np.zeros((lanes, 6))
        self._gusts = _Gusts(lanes)
        self._waves = _Waves(lanes, block)

    def load(self, lane: int, scenario: Scenario, episode: Episode, table: Array) -> None:
        """Wind a new episode into a lane; `table` is its `Reference.table`, one row per control instant."""
        self._tables[lane] = table
        self._next[lane] = 0
        noise, gusty = scenario.sensors.noise, episode.current.gust > 0
        self._noise[lane], self._bias[lane] = noise, episode.bias
        self._drawn[lane] = first, end = 0 if any(noise) else 6, 8 if gusty else 6
        random = np.random.Generator(np.random.SFC64(episode.noise_seed)) if first < end else None
        self._generators[lane] = random
        self._gusts.load(lane, episode.current, scenario.control_dt, table)
        self._waves.load(lane, episode.waves, scenario.control_dt)

    def read(self, lanes: Sequence[int], n: int) -> Array:
        """Return the next n <= block samples of these lanes, shape (n, SAMPLE, len(lanes)), and wind on.

        Behind an episode's last instant a lane repeats its last reference.
        """
        index = np.asarray(lanes)
        first = self._next[index]
        out = np.empty((n, SAMPLE, len(index)))
        self._read_references(lanes, first.tolist(), out[:, :8])
        normals = self._normals(lanes, n)
        self._gusts.read(index, normals, first == 0, out[:, 8:10])
        self._waves.read(index, first, out[:, 10:13])
        errors = out[:, 13:]
        errors[:] = self._bias[index].T
        if normals is not None:
            white = np.empty_like(errors)
            _transpose(normals[:, :, :6], white)
            white *= self._noise[index].T
            errors += white
        self._next[index] += n
        return out

    def _read_references(self, lanes: Sequence[int], first: list[int], out: Array) -> None:
        n = len(out)
        rows = np.empty((len(lanes), n, 8))
        for row, lane, k in zip(rows, lanes, first, strict=True):
            table = self._tables[lane]
            have = min(n, max(len(table) - k, 0))
            row[:have] = table[k : k + have]
            if have < n:
                row[have:] = table[-1]
        _transpose(rows, out)

    def _normals(self, lanes: Sequence[int], n: int) -> Array | None:
        """Return standard normals, shape (lanes, n, 8), zero where a lane uses none; None if no lane does."""
        generators = [self._generators[lane] for lane in lanes]
        if not any(generators):
            return None
        normals = np.zeros((len(lanes), n, 8))
        for row, lane, generator in zip(normals, lanes, generators, strict=True):
            if generator:
                a, b = self._drawn[lane]
                if b - a == 8:
                    generator.standard_normal(out=row)
                else:
                    row[:, a:b] = generator.standard_normal((n, b - a))
        return normals


def _transpose(rows: Array, out: Array) -> None:
    """Copy rows of shape (lanes, n, m) into an array of shape (n, m, lanes)."""
    for first in range(0, len(rows), TILE):
        out[:, :, first : first + TILE] = rows[first : first + TILE].transpose(1, 2, 0)


class _Gusts:
    """Mean current plus smoothed Ornstein-Uhlenbeck gusts, see `disturbances.Current`.

    Process n and smoothing filter s in one second-order filter, driven by white noise w:
    n_k = a n_(k-1) + sqrt(1 - a^2) sigma w_k,  s_k = b s_(k-1) + (1 - b) n_k,  starting from n_0 = s_0 = sigma w_0.
    """

    def __init__(self, lanes: int) -> None:
        self._mean = np.zeros((lanes, 2))
        self._sigma, self._cap = np.zeros(lanes), np.full(lanes, np.inf)
        self._decay = np.zeros((lanes, 2))  # a and b
        self._state = np.zeros((lanes, 2, 2))  # of the filter, (order, axis)

    def load(self, lane: int, current: Current, dt: float, table: Array) -> None:
        self._mean[lane] = current.V_x, current.V_y
        self._sigma[lane] = current.gust
        smoothing = math.exp(-dt / current.smoothing) if current.smoothing > 0 else 0.0
        self._decay[lane] = math.exp(-dt / current.gust_time), smoothing
        slowest = math.sqrt((table[:, 3] ** 2 + table[:, 4] ** 2).min()) if math.isfinite(current.cap) else 1.0
        self._cap[lane] = current.cap * slowest

    def read(self, index: Lanes, normals: Array | None, fresh: NDArray[np.bool_], out: Array) -> None:
        """Write the current, shape (n, 2, lanes), driven by the last two of standard normals (lanes, n, 8)."""
        out[:] = self._mean[index].T
        windy = self._sigma[index].nonzero()[0]
        if normals is not None and len(windy):
            gusts = np.zeros((len(index), len(out), 2))
            decay = self._decay[index[windy]]
            for a, b in set(map(tuple, decay.tolist())):  # lanes that share their time constants
                group = windy[(decay[:, 0] == a) & (decay[:, 1] == b)]
                gusts[group] = self._filtered(index[group], normals[group, :, 6:], fresh[group], a, b)
            total = np.empty_like(out)
            _transpose(gusts, total)
            out += total
        cap = self._cap[index]
        if np.isfinite(cap).any():
            speed = np.hypot(out[:, 0], out[:, 1])
            out *= np.minimum(1.0, cap / np.maximum(speed, 1e-300))[:, None]

    def _filtered(self, lanes: Lanes, normals: Array, fresh: NDArray[np.bool_], a: float, b: float) -> Array:
        sigma = self._sigma[lanes, None, None]
        gain = (1 - b) * math.sqrt(1 - a * a)
        if fresh.any():
            first = sigma[fresh, 0] * normals[fresh, 0]
            self._state[lanes[fresh]] = np.stack(((1 - gain) * first, -a * b * first), axis=1)
        drive = sigma * normals
        smooth, self._state[lanes] = lfilter([gain], [1.0, -a - b, a * b], drive, axis=1, zi=self._state[lanes])
        return np.asarray(smooth)


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
        if waves is None:
            return
        n = len(waves.frequencies)
        self._grow(n - self._angle.shape[1])
        self._angle[lane, :n] = np.array(waves.frequencies) * dt
        self._phase[lane, :, :n] = waves.phases
        self._amplitude[lane] = 0.0
        self._amplitude[lane, :, :n] = math.sqrt(2 / n) * np.array([[waves.surge], [waves.sway], [waves.yaw]])
        angles = self._angle[lane, :, None] * self._steps
        self._basis[lane] = np.cos(angles), np.sin(angles)

    def read(self, index: Lanes, first: Lanes, out: Array) -> None:
        """Write the forces, shape (n, 3, lanes), from step `first` of each lane on."""
        out[:] = 0.0
        wavy = np.flatnonzero(self._wavy[index])
        if len(wavy):
            lanes = index[wavy]
            angle = (self._angle[lanes] * first[wavy, None])[:, None] + self._phase[lanes]
            amplitude, basis = self._amplitude[lanes], self._basis[lanes, :, :, : len(out)]
            total = (amplitude * np.sin(angle)) @ basis[:, 0] + (amplitude * np.cos(angle)) @ basis[:, 1]
            out[:, :, wavy] = total.transpose(2, 1, 0)

"""Errors of a Doppler log at sea beside those of the simulated instruments `INSTRUMENTS`, on the same tracks."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from auv_gym.effects.navigation import RandomReckoning, heading_errors
from auv_gym.effects.sensors import Sensors
from auv_gym.physics.errors import to_world
from auv_gym.physics.intervals import Interval, draw
from auv_gym.physics.namespaces import Array
from baselines.identification.columns import Format

SNAPIR = "snapir"
INSTRUMENTS = Sensors(
    position=1.5,  # [m] of a fix
    heading=0.002,  # [rad]
    velocity=0.01,  # [m/s]
    yaw_rate=0.001,  # [rad/s]
    heading_bias=(-0.02, 0.02),  # [rad] a gyro aligned to 1.1 deg
    velocity_bias=(-0.005, 0.005),  # [m/s]
    reckoning=RandomReckoning(),
)
"""The Doppler log and the gyro of the sources that `RandomReckoning` names, with their biases and alignment."""
_DELAYS = np.arange(-3.0, 3.01, 0.05)  # [s] by which the log may come late; negative: the truth does
INSTRUMENT_SETS = 200  # sets of simulated instruments for each track
_SEED = 20


def navigation_errors(folder: Path) -> dict[str, Any]:
    """Return the errors of the Doppler log in each section, and those of `INSTRUMENTS` on the same tracks.

    Raises:
        OSError: there are no sections.
        ValueError: one of their files is no table.
    """
    truths = sorted((folder / SNAPIR).glob("GT_*.csv"), key=lambda file: int(file.stem[3:]))
    if not truths:
        raise OSError(f"{folder / SNAPIR} has no files GT_*.csv")
    rng = np.random.default_rng(_SEED)
    truth, doppler = Format.named("snapir-truth"), Format.named("snapir-log")
    sections = []
    for file in truths:
        track = truth.read(file).columns
        section, measured = _section(track, doppler.read(file.with_name(f"DVL_{file.stem[3:]}.csv")).columns)
        for name, heading in (("suite_drift_m", False), ("suite_whole_drift_m", True)):
            section[name] = _rms([_drift(track, *_of_suite(track, rng, heading)) for _ in range(INSTRUMENT_SETS)])
        section["drift_m"] = _drift(track, *measured)
        sections.append(section)
    reckoning = INSTRUMENTS.reckoning
    assert reckoning is not None
    suite = {
        "scale": _size(reckoning.scale),
        "misalignment": _size(reckoning.misalignment),
        "bias": _size(INSTRUMENTS.velocity_bias),
        "noise": INSTRUMENTS.velocity,
    }
    return {"sections": sections, "suite": suite}


def _size(interval: Interval) -> float:
    """Return the median of the magnitude of what is drawn."""
    low, high = interval if isinstance(interval, tuple) else (interval, interval)
    return float(np.median(np.abs(np.linspace(low, high, 1001))))


def _rms(values: Any) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _section(track: Mapping[str, Array], log: Mapping[str, Array]) -> tuple[dict[str, float], tuple[Array, Array]]:
    """Return the parameters of the log's errors, and the velocities that it measured where and when it was.

    The log measures (1 + scale) R(misalignment) of the velocity at a place ahead of the reference point, late by a
    delay, with noise: linear least squares for each delay.
    """
    t, u, v = (track[name] for name in "tuv")
    r = np.gradient(np.unwrap(track["psi"]), t)
    used = (t - t[0] >= _DELAYS[-1]) & (t <= t[-1] - _DELAYS[-1])
    best: tuple[float, float, Array, Array] | None = None
    for delay in _DELAYS:
        u_0, v_0, r_0 = (np.interp(t - delay, t, x)[used] for x in (u, v, r))
        zero = np.zeros_like(u_0)
        matrix = np.column_stack((np.r_[u_0, v_0], np.r_[-v_0, u_0], np.r_[zero, r_0]))
        wanted = np.r_[log["u"][used], log["v"][used]]
        x = np.linalg.lstsq(matrix, wanted, rcond=None)[0]
        errors = wanted - matrix @ x
        if best is None or _rms(errors) < best[0]:
            best = _rms(errors), float(delay), x, errors.reshape(2, -1)
    assert best is not None
    _, delay, (scale, angle, ahead), errors = best
    centred = errors - errors.mean(axis=1)[:, None]
    section = {
        "way_m": float(np.sum(np.hypot(u, v)[:-1] * np.diff(t))),
        "delay_s": delay,
        "ahead_m": float(ahead),
        "scale": float(scale - 1),
        "misalignment": float(angle),
        "noise": _rms(centred),
        "related": float(np.sum(centred[:, 1:] * centred[:, :-1]) / np.sum(centred**2)),
        "raw_drift_m": _drift(track, log["u"], log["v"]),
    }
    late = (np.interp(t + delay, t, log[name]) for name in "uv")
    measured = next(late), next(late) - ahead * r
    return section, measured


def _of_suite(track: Mapping[str, Array], rng: np.random.Generator, heading: bool) -> tuple[Array, Array]:
    """Return the velocities of a track as `INSTRUMENTS` measure them, along the true or a wrong heading."""
    t, u, v = (track[name] for name in "tuv")
    reckoning = INSTRUMENTS.reckoning
    assert reckoning is not None
    bias = INSTRUMENTS.velocity_bias
    scale, angle, b_u, b_v = (draw(x, rng.random) for x in (reckoning.scale, reckoning.misalignment, bias, bias))
    n_u, n_v = INSTRUMENTS.velocity * rng.standard_normal((2, len(u)))
    if heading:
        drift, dt = draw(reckoning.drift, rng.random), float(np.mean(np.diff(t)))
        wrong = heading_errors(drift, reckoning.walk, dt, len(t), rng) + draw(INSTRUMENTS.heading_bias, rng.random)
        angle = angle + wrong
    return (1 + scale) * u - angle * v + b_u + n_u, (1 + scale) * v + angle * u + b_v + n_v


def _drift(track: Mapping[str, Array], u: Array, v: Array) -> float:
    """Return the final position error [m] of dead reckoning with the true heading."""
    t, psi = track["t"], track["psi"]
    errors = to_world(u - track["u"], v - track["v"], np.cos(psi), np.sin(psi))
    return float(np.hypot(*(np.trapezoid(e, t) for e in errors)))

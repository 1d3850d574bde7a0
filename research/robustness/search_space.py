"""The search space of the falsification: disturbances as coordinates, and the scenario at a point.

A coordinate is the position of a quantity in its range: 0 is calm water and the known vehicle, and +-1 are the ends of
the range in the storm of the presets, with slewing actuators. The severity of a point is its largest coordinate: all
points of severity s are in the ranges of the storm, each stretched s times about calm water. Gusts, phases of the waves
and noise are not coordinates: they are drawn for each episode.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from auv_gym.physics.disturbances import RandomCurrent, RandomMismatch, RandomWaves
from auv_gym.physics.intervals import Interval
from auv_gym.physics.namespaces import Array
from auv_gym.planning.paths import PATHS
from auv_gym.scenarios.mixtures import SLEW_TIMES
from auv_gym.scenarios.presets import PRESETS
from auv_gym.scenarios.scenario import RandomPath, Scenario, Start

TOP_SPEED = 2.0  # [m/s] largest speed of the path at any severity
_LEAST = 0.2  # [1] smallest factor of a mass, a drag or a limit


@dataclass(frozen=True)
class Range:
    """Range of a quantity: its value in calm water and at the two ends."""

    calm: float
    low: float  # value at -1
    high: float  # value at +1
    least: float = -math.inf  # smallest value at any severity
    most: float = math.inf  # largest value at any severity

    def at(self, x: float) -> float:
        """Return the value at a coordinate; in a range with one end, the sign of the coordinate has no effect."""
        if self.low == self.calm:
            x = abs(x)
        end = self.high if x >= 0 else self.low
        return min(max(self.calm + abs(x) * (end - self.calm), self.least), self.most)


def _symmetric(interval: Interval, least: float = -math.inf, most: float = math.inf) -> Range:
    """Return the range about the middle of an interval."""
    low, high = interval if isinstance(interval, tuple) else (interval, interval)
    return Range(0.5 * (low + high), low, high, least, most)


def _upwards(interval: Interval, most: float = math.inf) -> Range:
    """Return the range from 0 to the upper end of an interval."""
    high = interval[1] if isinstance(interval, tuple) else interval
    return Range(0.0, 0.0, high, 0.0, most)


def ranges(speed_range: str) -> dict[str, Range]:
    """Return the ranges of the coordinates by name, from the scenario of the storm."""
    storm = PRESETS[f"{speed_range}-storm"]
    current, waves, mismatch, path, start = storm.current, storm.waves, storm.mismatch, storm.path, storm.start
    assert isinstance(current, RandomCurrent)
    assert isinstance(waves, RandomWaves)
    assert isinstance(mismatch, RandomMismatch)
    assert isinstance(path, RandomPath)
    masses = {name: _symmetric(getattr(mismatch, name), _LEAST) for name in ("mass", "m33", "d11", "d22", "d33")}
    lowest = 1.01 * storm.vehicle.m11 / storm.vehicle.m22  # the sway mass stays above the surge mass
    return {
        "speed": _symmetric(path.speed, 0.05, TOP_SPEED),
        "turn_rate": Range(0.0, -path.turn_rate, path.turn_rate),
        "current": _upwards(current.speed),
        "gust": _upwards(current.gust),
        **{f"waves_{axis}": _upwards(getattr(waves, axis)) for axis in ("surge", "sway", "yaw")},
        **masses,
        "ratio": _symmetric(mismatch.ratio, lowest),
        "quadratic": _upwards(mismatch.quadratic),
        "noise": Range(0.0, 0.0, 1.0),
        "lag": _upwards(storm.actuators.lag),
        "slew": Range(0.0, 0.0, max(SLEW_TIMES), 0.0),
        "start_x": _symmetric(start.x_e),
        "start_y": _symmetric(start.y_e),
        "start_psi": _symmetric(start.psi_e, -math.pi, math.pi),
        "start_surge": Range(1.0, 1.0, float(np.min(start.surge)), 0.0),
    }


DIRECTION = "direction"
"""Coordinate of the current's direction, in half turns at any severity."""


def coordinate_names(speed_range: str) -> tuple[str, ...]:
    """Return the names of the coordinates; the last one is the direction of the current."""
    return (*ranges(speed_range), DIRECTION)


def scenario_at(speed_range: str, name: str, severity: float, towards: Sequence[float] | Array) -> Scenario:
    """Return the scenario at a point.

    Args:
        speed_range: "slow" or "cruise".
        name: the name of the scenario.
        severity: distance of the point from calm water, in units of the ranges.
        towards: direction of the point, a coordinate in [-1, 1] for each of `coordinate_names`.

    Raises:
        ValueError: there is no such scenario, for example because its vehicle is too stiff for the integration.
    """
    storm = PRESETS[f"{speed_range}-storm"]
    *place, direction = map(float, towards)
    v = {key: r.at(severity * x) for (key, r), x in zip(ranges(speed_range).items(), place, strict=True)}
    mismatch: dict[str, Any] = {key: v[key] for key in ("mass", "ratio", "m33", "d11", "d22", "d33", "quadratic")}
    turn = v["turn_rate"]
    path = PATHS["line"](v["speed"]) if abs(turn) < 1e-4 else PATHS["circle"](v["speed"], turn)
    changes: dict[str, Any] = {
        "path": path,
        "mismatch": RandomMismatch(**mismatch),
        "current": _current(storm, v, math.pi * direction),
        "waves": _waves(storm, v),
        "sensors": _sensors(storm, v),
        "actuators": _actuators(storm, v),
        "start": Start(v["start_x"], v["start_y"], v["start_psi"], v["start_surge"]),
    }
    return replace(storm, name=name, **changes)


def _current(storm: Scenario, v: Mapping[str, float], direction: float) -> RandomCurrent:
    """Return the current of the storm with the values of a point."""
    own = storm.current
    assert isinstance(own, RandomCurrent)
    return replace(own, speed=v["current"], direction=direction, gust=v["gust"])


def _waves(storm: Scenario, v: Mapping[str, float]) -> RandomWaves:
    own = storm.waves
    assert isinstance(own, RandomWaves)
    axes: dict[str, Any] = {axis: v[f"waves_{axis}"] for axis in ("surge", "sway", "yaw")}
    return replace(own, **axes)


def _sensors(storm: Scenario, v: Mapping[str, float]) -> Any:
    own = storm.sensors
    changes: dict[str, Any] = {
        name: v["noise"] * getattr(own, name) for name in ("position", "heading", "velocity", "yaw_rate")
    }
    return replace(own, **changes)


def _actuators(storm: Scenario, v: Mapping[str, float]) -> Any:
    own = storm.actuators
    slew = max(v["slew"], 1e-2)  # [s] from zero to full force
    rates = {"F_u_rate": own.F_u_max / slew, "F_r_rate": own.F_r_max / slew}
    return replace(own, lag=v["lag"], **rates)

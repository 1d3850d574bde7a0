"""The presets: scenarios by name, that of the paper and eight disturbance cases in two speed ranges."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from auv_gym.effects.actuators import Actuators
from auv_gym.effects.autopilot import Autopilot
from auv_gym.effects.current import RandomCurrent
from auv_gym.effects.mismatch import RandomMismatch
from auv_gym.effects.sensors import Sensors
from auv_gym.effects.waves import RandomWaves
from auv_gym.physics.intervals import Interval
from auv_gym.scenarios.fitting import changed
from auv_gym.scenarios.names import CASES, SPACE_CASES, SPEED_RANGES, STEPS
from auv_gym.scenarios.records import meant, table_file
from auv_gym.scenarios.scenario import RandomPath, Scenario, Start
from auv_gym.scenarios.vertical import Vertical

__all__ = [
    "CASES", "PAPER_SCENARIO", "PRESETS", "SETPOINTS", "SPACE_PRESETS", "SPEED_RANGES", "as_scenario", "is_preset",
    "list_scenarios", "preset_names", "with_setpoints",
]  # fmt: skip


@dataclass(frozen=True)
class _SpeedRange:
    """The numbers that depend on the speed range."""

    path: RandomPath
    control_dt: float
    limits: tuple[float, float]  # [N], [N m]
    tight_limits: tuple[float, float]
    start: float  # [m] position offset on each axis
    noise: Sensors
    yaw_waves: float
    quadratic: float
    error_scale: float
    lost_distance: float


TYPICAL_NOISE = {
    "slow": Sensors(position=0.03, heading=0.015, velocity=0.01, yaw_rate=0.004),
    "cruise": Sensors(position=0.05, heading=0.015, velocity=0.02, yaw_rate=0.005),
}
"""One level of noise within the ranges of the presets, by speed range."""
# The ranges are 0.2 to 6 times the typical position noise and 0.3 to 3 times the other levels.
_SPEED_RANGES = {
    "slow": _SpeedRange(
        RandomPath(speed=(0.1, 0.3), turn_rate=0.04), 0.2, (100.0, 50.0), (40.0, 20.0), 0.3,
        Sensors((0.006, 0.18), (0.0045, 0.045), (0.003, 0.03), (0.0012, 0.012)), 0.04, 1.0, 0.2, 10.0,
    ),
    "cruise": _SpeedRange(
        RandomPath(speed=(0.5, 1.5), turn_rate=0.12), 0.1, (400.0, 200.0), (250.0, 100.0), 1.0,
        Sensors((0.01, 0.3), (0.0045, 0.045), (0.006, 0.06), (0.0015, 0.015)), 0.12, 0.4, 0.5, 30.0,
    ),
}  # fmt: skip


def _preset(speed_range: str, case: str) -> Scenario:
    """Return the scenario of a disturbance case in a speed range."""
    g = _SPEED_RANGES[speed_range]
    limits = g.limits
    lag: Interval = 0.0
    changes: dict[str, Any] = {}
    if case in ("noise", "storm"):
        changes["sensors"] = g.noise
    if case == "current":
        changes["current"] = RandomCurrent(speed=(0.15, 0.4))
    if case in ("gauss-markov", "storm"):
        changes["current"] = RandomCurrent(speed=(0.105, 0.28), gust=0.12, cap=0.75)
    if case in ("waves", "storm"):
        share = 0.6 if case == "storm" else 1.0
        changes["waves"] = RandomWaves(surge=0.35 * share, sway=0.2 * share, yaw=g.yaw_waves * share)
    if case in ("mismatch", "storm"):
        changes["mismatch"] = RandomMismatch(
            (0.8, 1.2), (0.94, 1.06), (0.8, 1.2), (0.8, 1.2), (0.8, 1.2), (0.8, 1.2), (0.0, g.quadratic)
        )
    if case == "actuator":
        limits, lag = g.tight_limits, (0.2, 0.6)
    if case == "storm":
        lag = (0.12, 0.36)
    s = (-g.start, g.start)
    name = f"{speed_range}-{case}"
    return Scenario(
        name=name,
        path=g.path,
        actuators=Actuators(*limits, lag=lag),
        start=Start(x_e=s, y_e=s, psi_e=(-0.35, 0.35), surge=(0.3, 1.0)),
        control_dt=g.control_dt,
        steps=STEPS[name],
        error_scale=g.error_scale,
        lost_distance=g.lost_distance,
        **changes,
    )


PAPER_SCENARIO = Scenario(
    name="paper-circle",
    steps=STEPS["paper-circle"],
    start=Start(x_e=0.5, y_e=1.0, psi_e=math.radians(20.0), surge=0.0, random_signs=True),
    error_scale=0.2,
    lost_distance=10.0,
)
"""Section V: the 10 m circle at 0.1 m/s, from rest with errors of 0.5 m, 1 m and 20 deg, each of random sign."""

_VERTICAL = Vertical(climb=0.35, depth=(4.0, 30.0), z_e=(-0.5, 0.5), theta_e=(-0.15, 0.15))
_SPACE: Mapping[str, Mapping[str, Any]] = {
    "noise": {"depth_noise": (0.004, 0.12)},
    "current": {"current": (-0.1, 0.1), "veer": (-0.03, 0.03), "decay": (0.0, 0.03)},
    "mismatch": {"stiffness": (0.8, 1.2)},
}
"""Entries of the vertical part of the cases; a storm has all of them."""


def _in_space(case: str) -> Scenario:
    """Return the scenario of a disturbance case in space: that at cruise with a vertical part."""
    parts = _SPACE if case == "storm" else {case: _SPACE.get(case, {})}
    vertical = replace(_VERTICAL, **{name: x for entries in parts.values() for name, x in entries.items()})
    return replace(_preset("cruise", case), name=f"space-{case}", vertical=vertical)


SPACE_PRESETS = {s.name: s for s in map(_in_space, SPACE_CASES)}
"""Scenarios in space by name."""
PRESETS = {
    s.name: s for s in (PAPER_SCENARIO, *(_preset(speed_range, case) for speed_range in SPEED_RANGES for case in CASES))
}
"""Scenarios by name; a new entry can be used as `gym.make(..., scenario=NAME)`."""


SETPOINTS = "-setpoints"
"""Suffix of a preset's name: an `Autopilot` commands the actuators, and actions are its setpoints."""


def list_scenarios() -> list[str]:
    """Return the names of the presets, in the plane and in space."""
    return [*PRESETS, *SPACE_PRESETS]


def preset_names() -> list[str]:
    """Return the names of the presets, without and with `SETPOINTS`."""
    return [f"{name}{suffix}" for suffix in ("", SETPOINTS) for name in list_scenarios()]


def with_setpoints(scenario: Scenario) -> Scenario:
    """Return a scenario of the paper's vehicle whose actions are setpoints of an `Autopilot` with its usual gains."""
    return replace(scenario, name=f"{scenario.name}{SETPOINTS}", effects=(*scenario.effects, Autopilot()))


def is_preset(name: str) -> bool:
    """Return whether a name is that of a preset, perhaps with `SETPOINTS`, and then perhaps with `@` and a vehicle."""
    return name.partition("@")[0].removesuffix(SETPOINTS) in PRESETS | SPACE_PRESETS


def as_scenario(scenario: Scenario | str | os.PathLike[str] | Mapping[str, Any]) -> Scenario:
    """Return the scenario for an object, the name of a preset, a .toml or .json file, or a dict.

    PRESET@VEHICLE and FILE@VEHICLE are scenarios for another vehicle, see `fitting.changed`; in PRESET-setpoints
    actions are setpoints.

    Raises:
        OSError: the file cannot be read.
        ValueError: the preset does not exist, or an entry is wrong.
    """
    if isinstance(scenario, Scenario):
        return scenario
    if isinstance(scenario, Mapping):
        return Scenario.from_dict(scenario)
    presets = PRESETS | SPACE_PRESETS
    if isinstance(scenario, str):
        name, at, vehicle = scenario.partition("@")
        if is_preset(name):
            preset = presets[name.removesuffix(SETPOINTS)]
            return changed(with_setpoints(preset) if name.endswith(SETPOINTS) else preset, vehicle if at else None)
        if at and (file := table_file(name)) is not None:
            return changed(Scenario.load(file), vehicle)
    if (file := table_file(scenario)) is not None:
        return Scenario.load(file)
    allowed = (
        f"a Scenario, a dict, a .toml or .json file, or one of {', '.join(presets)}, optionally with {SETPOINTS} and "
        f"with a vehicle, such as cruise-storm@lauv or cruise-storm{SETPOINTS}@lauv"
    )
    raise ValueError(f"unknown scenario {scenario!r}{meant(scenario, preset_names())}; allowed are {allowed}")

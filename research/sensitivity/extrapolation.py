"""How errors grow outside of what was trained on: one thing at a time is stretched, everything else stays.

The episodes of all values of a parameter have the same paths, starts, seas and noise, since a number that is fixed
uses up as many random numbers as one that is drawn.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from auv_gym.physics.disturbances import RandomMismatch
from auv_gym.scenarios.fitting import MOST_SUBSTEPS
from auv_gym.scenarios.presets import PRESETS
from auv_gym.scenarios.scenario import Scenario
from baselines.control.backstepping import StabilityWarning
from baselines.evaluation.runner import Cell
from baselines.evaluation.score import LARGEST_TAIL, capped, losses
from baselines.evaluation.side_by_side import SideBySide
from research.sensitivity.episodes import acting, at_speed, episodes_of

_EPISODES = 12
"""Episodes of each value."""
_CASE = "storm"
"""What is stretched."""

Stretch = Callable[[Scenario, float], Scenario]


def _wrong(*names: str) -> Stretch:
    """Return what fixes factors between the true and the known vehicle."""

    def change(scenario: Scenario, value: float) -> Scenario:
        mismatch = scenario.mismatch or RandomMismatch()
        changes: dict[str, Any] = dict.fromkeys(names, value)
        return replace(scenario, mismatch=replace(mismatch, **changes))

    return change


def _speed(scenario: Scenario, value: float) -> Scenario:
    return at_speed(scenario.name, speed=value, substeps=scenario.substeps)


def _lag(scenario: Scenario, value: float) -> Scenario:
    return replace(scenario, actuators=replace(scenario.actuators, lag=value))


def _force(scenario: Scenario, value: float) -> Scenario:
    return replace(scenario, actuators=replace(scenario.actuators, effectiveness=value))


def _slew(scenario: Scenario, value: float) -> Scenario:
    act, rate = scenario.actuators, 1 / value if value else math.inf
    return replace(scenario, actuators=replace(act, F_u_rate=rate * act.F_u_max, F_r_rate=rate * act.F_r_max))


def _current(scenario: Scenario, value: float) -> Scenario:
    assert scenario.current is not None
    return replace(scenario, current=replace(scenario.current, speed=value, cap=math.inf))


def _noise(scenario: Scenario, value: float) -> Scenario:
    names, sensors = ("position", "heading", "velocity", "yaw_rate"), scenario.sensors
    return replace(scenario, sensors=replace(sensors, **{name: value * getattr(sensors, name) for name in names}))


def _waves(scenario: Scenario, value: float) -> Scenario:
    waves = PRESETS[scenario.name.replace(_CASE, "waves")].waves  # of the case in which they are alone
    assert waves is not None
    scaled = replace(waves, surge=value * waves.surge, sway=value * waves.sway, yaw=value * waves.yaw)
    return replace(scenario, waves=scaled)


class Parameter(NamedTuple):
    """Something that is stretched."""

    stretch: Stretch
    values: tuple[float, ...]
    trained: tuple[float, float]  # the range that helm was trained in
    says: str


STRETCHED: Mapping[str, Parameter] = {
    "mass": Parameter(_wrong("mass"), (0.4, 0.6, 0.8, 1.0, 1.2, 1.6, 2.2, 3.0), (0.8, 1.2), "true mass / known mass"),
    "ratio": Parameter(_wrong("ratio"), (0.83, 0.94, 1.0, 1.06, 1.2, 1.4, 1.7), (0.94, 1.06), "true m22/m11 / known"),
    "drag": Parameter(
        _wrong("d11", "d22", "d33"), (0.1, 0.4, 0.8, 1.2, 2.0, 4.0, 8.0), (0.8, 1.2), "true linear drag / known"
    ),
    "lag": Parameter(_lag, (0.0, 0.12, 0.36, 0.7, 1.0, 1.4, 2.0), (0.0, 0.7), "lag of the actuators [s]"),
    "slew": Parameter(_slew, (0.0, 0.5, 1.0, 2.0, 4.0, 8.0), (0.0, 1.0), "time from zero to full force [s]"),
    "force": Parameter(_force, (1.0, 0.8, 0.6, 0.45, 0.3, 0.2), (0.6, 1.0), "share of commanded forces that acts"),
    "current": Parameter(_current, (0.0, 0.2, 0.4, 0.55, 0.7, 0.85), (0.0, 0.4), "mean current / speed of the path"),
    "waves": Parameter(_waves, (0.0, 0.6, 1.0, 1.5, 2.0, 3.0), (0.0, 1.0), "wave forces / those of the case waves"),
    "noise": Parameter(_noise, (0.0, 0.5, 1.0, 2.0, 4.0, 8.0), (0.0, 1.0), "noise / that of the presets"),
}
"""What is stretched in both regimes; a storm has the value in place of what it usually draws."""
STRETCHED_SPEEDS: Mapping[str, Parameter] = {
    "slow": Parameter(_speed, (0.03, 0.05, 0.1, 0.2, 0.3, 0.4), (0.1, 0.3), "speed of the path [m/s]"),
    "cruise": Parameter(_speed, (0.3, 0.5, 1.0, 1.5, 1.75, 2.0, 2.5), (0.5, 1.6), "speed of the path [m/s]"),
}
"""The speed, by regime."""


def parameters_of(regime: str) -> dict[str, Parameter]:
    """Return what is stretched in a regime, by name."""
    return {**STRETCHED, "speed": STRETCHED_SPEEDS[regime]}


def stretched_storms(regime: str, parameter: Parameter) -> list[Scenario]:
    """Return a storm of a regime for each value, all with as many integration steps as the stiffest of them needs."""
    for substeps in range(1, MOST_SUBSTEPS):
        usual = replace(PRESETS[f"{regime}-{_CASE}"], substeps=substeps)
        try:
            return [parameter.stretch(usual, value) for value in parameter.values]
        except ValueError as error:
            if "raise substeps" not in str(error):
                raise
    raise ValueError(f"no integration step is short enough for {parameter.says} of {max(parameter.values):g}")


def stretched(name: str, regime: str, episodes: int | None = None) -> dict[str, Any]:
    """Return the tail errors of a policy at each value of each parameter, as plain numbers.

    Args:
        name: of the policy.
        regime: "slow" or "cruise".
        episodes: of each value. None: `_EPISODES`.

    Raises:
        ValueError: there is no such policy.
        PolicyError: its actions are not finite.
    """
    count, cap = episodes or _EPISODES, LARGEST_TAIL[regime]
    found: dict[str, Any] = {"episodes": count, "cap_m": cap, "parameters": {}}
    for key, parameter in parameters_of(regime).items():
        scenarios = stretched_storms(regime, parameter)
        with warnings.catch_warnings():  # that speeds are beyond law and training is what is asked here
            warnings.simplefilter("ignore", StabilityWarning)
            warnings.filterwarnings("ignore", "this policy was trained at reference speeds")
            cells = [Cell(scenario, episodes_of(scenario, count)) for scenario in scenarios]
            ended = SideBySide(cells).run(acting(name, scenarios[0].vehicle))
        tails = [np.round(capped(e, cap), 5).tolist() for e in ended]
        lost = [losses(e, cap) for e in ended]
        found["parameters"][key] = {"values": list(parameter.values), "tails_m": tails, "lost": lost}
    return found

"""Weighted mixtures of scenarios, on which agents are trained."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

from auv_gym.effects.actuators import Actuators
from auv_gym.effects.current import RandomCurrent
from auv_gym.effects.faults import RandomFaults
from auv_gym.effects.waves import RandomWaves
from auv_gym.scenarios.names import SPACE_CASES
from auv_gym.scenarios.presets import CASES, PRESETS, SPACE_PRESETS, SPEED_RANGES, TYPICAL_NOISE
from auv_gym.scenarios.scenario import RandomPath, Scenario

Mixture = tuple[tuple[Scenario, float], ...]

CASE_WEIGHTS: Mapping[str, float] = {"noise": 2.0, "actuator": 2.0, "storm": 3.0}
"""Weights of the cases with the largest errors and the most failures; the other cases have weight 1."""
_WAVELENGTHS = {"slow": (5.0, 20.0), "cruise": (20.0, 80.0)}  # [m] of a sheared current
LONG_OUTAGE_TIME = (5.0, 35.0)  # [s]
FAR = {"slow": 5.0, "cruise": 8.0}  # [m] largest distance of a start on each axis
OFFSETS = {"slow": 0.05, "cruise": 0.1}  # [m/s] largest error of the measured velocity
LAG_WEIGHTS = {"slow": 1.0, "cruise": 3.0}  # of storms with a large lag, in which fast vehicles are unstable
OUTAGE_TIMES = {"slow": (0.5, 3.0), "cruise": (0.3, 2.0)}  # [s] duration of an outage of position fixes


def speed_range_mixture(speed_range: str, weights: Mapping[str, float] = CASE_WEIGHTS) -> Mixture:
    """Return the eight cases of a speed range with weights by case; the default weight is 1."""
    return tuple((PRESETS[f"{speed_range}-{case}"], weights.get(case, 1.0)) for case in CASES)


def adverse(speed_range: str) -> Scenario:
    """Return a storm with sensor and actuator faults, delayed commands and a sheared current.

    The range of each fault includes none.
    """
    storm = PRESETS[f"{speed_range}-storm"]
    act, waves, current, largest = storm.actuators, storm.waves, storm.current, 3 * TYPICAL_NOISE[speed_range].noise[3]
    assert isinstance(waves, RandomWaves)
    assert isinstance(current, RandomCurrent)
    return replace(
        storm,
        name=f"{speed_range}-adverse",
        sensors=replace(
            storm.sensors,
            heading_bias=(-0.06, 0.06),
            velocity_bias=(-largest, largest),
            yaw_rate_bias=(-0.006, 0.006),
            outages=1.0,
            outage_time=OUTAGE_TIMES[speed_range],
        ),
        current=replace(current, shear=(0.0, 0.25), wavelength=_WAVELENGTHS[speed_range], speed=(0.05, 0.35)),
        waves=replace(waves, band=(0.15, 1.1)),
        actuators=Actuators(
            act.F_u_max, act.F_r_max, lag=(0.0, 0.7), effectiveness=(0.6, 1.0), reach=(0.45, 1.0), delay=(0.0, 3.0)
        ),
    )


def hard_sensors(speed_range: str) -> Mixture:
    """Return storms and noise with velocities that freeze, jump or are biased, and with noise of the position in time.

    A fault of the velocity begins at a random time and lasts for up to 40 s.
    """
    largest, parts = OFFSETS[speed_range], list[tuple[Scenario, float]]()
    for case in ("storm", "noise"):
        preset = PRESETS[f"{speed_range}-{case}"]
        faults = RandomFaults(
            ("velocity frozen", "velocity offset", "velocity offset", "velocity missing"),
            rate=90.0 / preset.duration,
            time=(3.0, min(0.7 * preset.duration, 40.0)),
            offset=(0.0, 1.5 * largest),
        )
        biased = replace(preset.sensors, velocity_bias=(-largest, largest))
        coloured = replace(preset.sensors, correlation=(0.5, 5.0))
        parts += [
            (replace(preset, name=f"{preset.name}-velocity", faults=faults), 1.5),
            (replace(preset, name=f"{preset.name}-biased", sensors=biased), 0.75),
            (replace(preset, name=f"{preset.name}-correlated", sensors=coloured), 1.25),
        ]
    return tuple(parts)


def sharp_and_slow(speed_range: str) -> Mixture:
    """Return storms with sharp turns, and storms with actuators of large lag."""
    storm = PRESETS[f"{speed_range}-storm"]
    assert isinstance(storm.path, RandomPath)
    sharp = replace(storm.path, turn_rate=3 * storm.path.turn_rate, families=("lawnmower", "random_smooth"))
    lagging = replace(storm.actuators, lag=(0.5, 2.5))
    return (
        (replace(storm, name=f"{speed_range}-sharp", path=sharp), 1.0),
        (replace(storm, name=f"{speed_range}-lag", actuators=lagging), LAG_WEIGHTS[speed_range]),
    )


def outages_and_far_starts(speed_range: str) -> Mixture:
    """Return storms with long outages of the position fix, and storms that begin far from the path, half of each.

    With the outages alone an agent unlearns to return from large initial errors.
    """
    storm = PRESETS[f"{speed_range}-storm"]
    sensors = replace(storm.sensors, outages=1.5, outage_time=LONG_OUTAGE_TIME)
    far = -FAR[speed_range], FAR[speed_range]
    start = replace(storm.start, x_e=far, y_e=far, psi_e=(-math.pi, math.pi), surge=(0.0, 1.0))
    return (
        (replace(storm, name=f"{speed_range}-outages", sensors=sensors), 0.5),
        (replace(storm, name=f"{speed_range}-far", start=start), 0.5),
    )


def slewing(scenario: Scenario, seconds: float) -> Scenario:
    """Return the scenario with limited rates of the actuators, `seconds` from zero to their limits."""
    act = scenario.actuators
    slow = replace(act, F_u_rate=act.F_u_max / seconds, F_r_rate=act.F_r_max / seconds)
    return replace(scenario, name=f"{scenario.name}-slew-{seconds:g}", actuators=slow)


def hasty() -> Scenario:
    """Return the case of slow actuators at cruise with larger lags and speeds, at which the vehicle is unstable."""
    preset = PRESETS["cruise-actuator"]
    assert isinstance(preset.path, RandomPath)
    path = replace(preset.path, speed=(1.2, 1.6))
    return replace(preset, name="cruise-hasty", path=path, actuators=replace(preset.actuators, lag=(0.45, 0.7)))


HARDEST: Mapping[str, float] = {"noise": 2.0, "actuator": 4.0, "storm": 4.0}
"""Weights of the cases in which errors remain large, or vehicles spin, when control effort has a small weight."""
SLEW_TIMES = (0.5, 1.0)  # [s] in which rate-limited actuators go from zero to their limits
SLEW_WEIGHT = 0.75  # for `helm`, of a case with limited actuator rates
ADVERSE_WEIGHTS = {"slow": 0.25, "cruise": 0.5}  # for `helm`, of adverse storms, and of those with limited rates
HASTY_WEIGHT = 3.0  # for `helm`, of `hasty`


def everything() -> Mixture:
    """Return the mixture for `helm`: all cases, and all that the functions above add."""
    parts: list[tuple[Scenario, float]] = []
    for speed_range in SPEED_RANGES:
        parts += speed_range_mixture(speed_range, {**HARDEST, "waves": 2.0})
    for speed_range in SPEED_RANGES:
        cases = (PRESETS[f"{speed_range}-{case}"] for case in ("storm", "actuator"))
        parts += [(slewing(scenario, seconds), SLEW_WEIGHT) for scenario in cases for seconds in SLEW_TIMES]
    for speed_range in SPEED_RANGES:
        storm, weight = adverse(speed_range), ADVERSE_WEIGHTS[speed_range]
        parts += [(storm, weight), *((slewing(storm, seconds), 0.5 * weight) for seconds in SLEW_TIMES)]
        parts += [(scenario, 3 * share) for scenario, share in outages_and_far_starts(speed_range)]
    parts.append((hasty(), HASTY_WEIGHT))
    for speed_range in SPEED_RANGES:
        parts += [*hard_sensors(speed_range), *sharp_and_slow(speed_range)]
    return tuple(parts)


SPACE_WEIGHTS: Mapping[str, float] = {"storm": 4.0, "noise": 2.0}
"""Weights of the cases in space; the other cases have weight 1."""
MIXTURES: Mapping[str, Mixture] = {
    "helm": everything(),
    **{f"{speed_range}-outages": outages_and_far_starts(speed_range) for speed_range in SPEED_RANGES},
    **{speed_range: speed_range_mixture(speed_range) for speed_range in SPEED_RANGES},
    "space": tuple((SPACE_PRESETS[f"space-{case}"], SPACE_WEIGHTS.get(case, 1.0)) for case in SPACE_CASES),
}
"""Mixtures by name."""

"""What agents are trained on when a command line names no single scenario: weighted mixtures of scenarios."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from auv_gym.physics.actuators import Actuators
from auv_gym.physics.disturbances import RandomCurrent, RandomWaves
from auv_gym.scenarios.presets import CASES, PRESETS, SPEED_RANGES
from auv_gym.scenarios.scenario import RandomPath, Scenario

Mixture = tuple[tuple[Scenario, float], ...]

CASE_WEIGHTS: Mapping[str, float] = {"noise": 2.0, "actuator": 2.0, "storm": 3.0}
"""Weights of a regime's cases, the others have 1: those where most of the error is, or where vehicles are lost."""
ADVERSE_WEIGHT = 8.0  # of the adverse scenario beside a regime's cases
_WAVELENGTHS = {"slow": (5.0, 20.0), "cruise": (20.0, 80.0)}  # [m] of a sheared current
OUTAGE_TIMES = {"slow": (0.5, 3.0), "cruise": (0.3, 2.0)}  # [s] how long an outage of the position fix lasts


def speed_range_mixture(speed_range: str, weights: Mapping[str, float] = CASE_WEIGHTS) -> Mixture:
    """Return the eight cases of a regime with weights by case, 1 for those that have none."""
    return tuple((PRESETS[f"{speed_range}-{case}"], weights.get(case, 1.0)) for case in CASES)


def weighed(mixture: Mixture, weight: float) -> Mixture:
    """Return a mixture whose weights are multiplied by a number."""
    return tuple((scenario, weight * share) for scenario, share in mixture)


def adverse(speed_range: str) -> Scenario:
    """Return a storm in which anything may be wrong, and mostly a little: sensors, commands, actuators and current.

    The kinds of trouble are those of unmodelled-v1, all at once and each down to none; the ranges are a little wider.
    """
    storm = PRESETS[f"{speed_range}-storm"]
    act, waves, current, noise = storm.actuators, storm.waves, storm.current, storm.sensors
    assert isinstance(waves, RandomWaves)
    assert isinstance(current, RandomCurrent)
    return replace(
        storm,
        name=f"{speed_range}-adverse",
        sensors=replace(
            noise,
            heading_bias=(-0.06, 0.06),
            velocity_bias=(-3 * noise.velocity, 3 * noise.velocity),
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


def slewing(scenario: Scenario, seconds: float) -> Scenario:
    """Return a scenario whose actuators take so many seconds from zero to their limits."""
    act = scenario.actuators
    slow = replace(act, F_u_rate=act.F_u_max / seconds, F_r_rate=act.F_r_max / seconds)
    return replace(scenario, name=f"{scenario.name}-slew-{seconds:g}", actuators=slow)


def hasty() -> Scenario:
    """Return the slow actuators of cruise where they are hardest: late ones on a fast and unstable vehicle."""
    preset = PRESETS["cruise-actuator"]
    assert isinstance(preset.path, RandomPath)
    path = replace(preset.path, speed=(1.2, 1.6))
    return replace(preset, name="cruise-hasty", path=path, actuators=replace(preset.actuators, lag=(0.45, 0.7)))


SLEW_TIMES = (0.5, 1.0)  # [s] in which slewing actuators go from zero to their limits
SLEWING: Mapping[str, Mixture] = {
    f"{speed_range}-slew": tuple(
        (slewing(PRESETS[f"{speed_range}-{case}"], seconds), 0.25)
        for case in ("storm", "actuator")
        for seconds in SLEW_TIMES
    )
    for speed_range in SPEED_RANGES
}
"""Storms, and the slow actuators of calm water, that also slew, by regime; their weights add up to 1."""
_WRONG: Mapping[str, Mixture] = {
    f"{speed_range}-wrong": (
        (adverse(speed_range), 0.5),
        *((slewing(adverse(speed_range), seconds), 0.25) for seconds in SLEW_TIMES),
    )
    for speed_range in SPEED_RANGES
}
"""Storms in which anything may be wrong, half of them on slewing actuators; the weights add up to 1."""
HARDEST: Mapping[str, float] = {"noise": 2.0, "actuator": 4.0, "storm": 4.0}
"""Weights of a regime's cases where commands cost little: what is left of the error, and what spins then."""
HASTY_WEIGHT = 3.0  # of `hasty` beside the regimes' cases, for `helm`
SLEW_WEIGHT = 3.0  # of slewing actuators beside a regime's cases, for `helm`
WRONG_WEIGHTS = {"slow": 0.5, "cruise": 1.0}  # of storms in which anything may be wrong, likewise


def everything() -> Mixture:
    """Return what `helm` learns: the cases of both regimes, slewing actuators, and storms where anything is wrong."""
    cases = (
        part for speed_range in SPEED_RANGES for part in speed_range_mixture(speed_range, {**HARDEST, "waves": 2.0})
    )
    slew = (part for speed_range in SPEED_RANGES for part in weighed(SLEWING[f"{speed_range}-slew"], SLEW_WEIGHT))
    wrong = (
        part
        for speed_range in SPEED_RANGES
        for part in weighed(_WRONG[f"{speed_range}-wrong"], WRONG_WEIGHTS[speed_range])
    )
    return (*cases, *slew, *wrong, (hasty(), HASTY_WEIGHT))


MIXTURES: Mapping[str, Mixture] = {
    "helm": everything(),
    **SLEWING,
    **_WRONG,
    **{speed_range: speed_range_mixture(speed_range) for speed_range in SPEED_RANGES},
    **{
        f"{speed_range}-adverse": (*speed_range_mixture(speed_range), (adverse(speed_range), ADVERSE_WEIGHT))
        for speed_range in SPEED_RANGES
    },
}
"""Mixtures by name."""

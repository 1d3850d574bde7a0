"""What may happen to a vehicle in mid-run, and the episodes that it happens in."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from auv_gym.physics.disturbances import RandomCurrent
from auv_gym.scenarios.episode import Episode
from auv_gym.scenarios.scenario import Scenario
from research.sensitivity.episodes import at_speed, episodes_of

_SPEED = {"slow": 0.2, "cruise": 1.0}
"""Nominal speed [m/s] of the paths, so that a length takes about the same time in all episodes of a regime."""
SEAS = ("noise", "storm")
"""Presets that the vehicle changes in: still water with noisy measurements, and everything at once."""
BEFORE = 300
"""Control periods until the vehicle changes."""
LENGTHS = 36
"""Lengths L behind the change that are looked at."""
SLACK = 1.6
"""Margin of time, since some paths are slower than their nominal speed in places."""
EVERYWHERE = 0.5 * math.pi
"""Phase [rad] of a shear of no wave number, with which it is the same current everywhere."""


def _payload(episode: Episode, _: float) -> Episode:
    v = episode.vehicle
    return replace(episode, vehicle=replace(v, m11=1.35 * v.m11, m22=1.35 * v.m22, m33=1.35 * v.m33))


def _fin(episode: Episode, _: float) -> Episode:
    surge, yaw = episode.effectiveness
    return replace(episode, effectiveness=(surge, 0.5 * yaw))


def _fouling(episode: Episode, _: float) -> Episode:
    v, names = episode.vehicle, ("d11", "d22", "d33", "X_uu", "Y_vv", "N_rr")
    return replace(episode, vehicle=replace(v, **{name: 2.0 * getattr(v, name) for name in names}))


def _current(episode: Episode, angle: float) -> Episode:
    step, c = 0.3 * episode.path.speed, episode.current
    shear = (step * math.cos(angle), step * math.sin(angle), 0.0, 0.0, EVERYWHERE)
    return replace(episode, current=replace(c, shear=shear))


class Change(NamedTuple):
    """Something that happens to a vehicle."""

    of: Callable[[Episode, float], Episode]  # of an episode and an angle [rad] drawn for it
    says: str


CHANGES: Mapping[str, Change] = {
    "payload": Change(_payload, "35 % more mass and inertia"),
    "fin": Change(_fin, "half of the yaw torque"),
    "fouling": Change(_fouling, "twice the drag"),
    "current": Change(_current, "a current of 0.3 U more, from one instant to the next"),
}
"""What happens to the vehicle."""


@dataclass(frozen=True)
class ChangeTrial:
    """A sea with its episodes, which never change, are changed on the way, or have been all along."""

    scenario: Scenario
    never: tuple[Episode, ...]

    @classmethod
    def of(cls, regime: str, sea: str, episodes: int) -> ChangeTrial:
        """Return the trial of a regime in one of `SEAS`."""
        scenario = at_speed(f"{regime}-{sea}", speed=_SPEED[regime])
        last = SLACK * LENGTHS * scenario.vehicle.length / _SPEED[regime]
        current = replace(scenario.current or RandomCurrent(), shear=(0.0, 0.0))  # so that the current may step
        steps = BEFORE + math.ceil(last / scenario.control_dt)
        scenario = replace(scenario, current=current, steps=steps)
        return cls(scenario, episodes_of(scenario, episodes))

    def changed(self, change: str) -> tuple[Episode, ...]:
        """Return the episodes as they are behind one of `CHANGES`."""
        rngs = (np.random.default_rng([e.noise_seed, 4]) for e in self.never)
        angles = (float(rng.uniform(-math.pi, math.pi)) for rng in rngs)
        return tuple(CHANGES[change].of(e, angle) for e, angle in zip(self.never, angles, strict=True))

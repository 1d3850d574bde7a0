"""Episode: the random data of one run of a scenario, and the options of `reset`."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from auv_gym.effects.current import Current
from auv_gym.effects.faults import Fault
from auv_gym.effects.navigation import Reckoning
from auv_gym.effects.waves import Waves


@dataclass(frozen=True)
class Episode:
    """All random data of one run of a scenario, with the seed of its noise."""

    path: Any  # a `Path`, in space a `SpacePath`
    vehicle: Any  # the true one, a `Vehicle`, in space a `SpaceVehicle`
    current: Current
    waves: Waves | None
    bias: tuple[float, ...]  # biases of the measurements, in the order of the states
    lag: float  # [s] of the actuators
    initial_error: tuple[float, ...]  # x_e, y_e [m] in the world, psi_e [rad]; in space x_e, y_e, z_e, theta_e, psi_e
    surge: float  # initial surge velocity as a fraction of that of the reference
    noise_seed: int
    initial_velocity: tuple[float, ...] | None = None  # u, v [m/s], r [rad/s], in space u, v, w, q, r; not `surge`
    effectiveness: tuple[float, ...] = (1.0, 1.0)  # actual over commanded force or moment of each channel
    reach: tuple[float, ...] = (1.0, 1.0)  # actions at which the actuators saturate
    delay: int = 0  # control periods until a command acts
    outages: tuple[tuple[float, float], ...] = ()  # [s] begin and end of each outage of position fixes
    faults: tuple[Fault, ...] = ()  # of actuators and measurements
    reckoning: Reckoning | None = None  # None: there is a position fix in each control step
    noise: tuple[float, ...] | None = None  # standard deviations of the measurements; None: those of the scenario
    correlation: float = 0.0  # [s] correlation time of the noise of the position; 0: white
    effects: tuple[tuple[str, tuple[Any, ...]], ...] = ()  # names and numbers of the effects of `Scenario.effects`
    profile: tuple[float, ...] = ()  # of the current over depth in space, see `effects.space.Veer`

    def initial_state(self, reference: Sequence[float]) -> tuple[Any, ...]:
        """Return the first state, with velocities relative to the water, for the first reference x, y, psi, u, ..."""
        error = self.initial_error
        pose, u_R = reference[: len(error)], reference[len(error)]
        velocity = self.initial_velocity or (self.surge * u_R, *(0.0,) * (len(error) - 1))
        return *(x_R + x_e for x_R, x_e in zip(pose, error, strict=True)), *velocity


RESET_OPTIONS = {
    "episode": "an Episode to run instead of drawing one",
    "initial_error": "x_e [m], y_e [m] in the world, psi_e [rad]; in space x_e, y_e, z_e, theta_e, psi_e",
    "initial_velocity": "u [m/s], v [m/s] relative to the water, r [rad/s]; in space u, v, w, q, r",
}
"""The options of `reset(options=...)`, with their meaning."""


def checked_mapping(options: Any) -> Mapping[str, Any]:
    """Return the options of `reset`, an empty dict for None; raise ValueError if they are not a dict."""
    if not isinstance(options, Mapping | None):
        raise ValueError(f"reset options are {options!r}; they must be a dict or None")
    return options or {}


def checked_options(options: Any, size: int = 3) -> dict[str, Any]:
    """Return the options of `reset` with vectors as tuples of floats, `size` numbers each: 3 in the plane, 5 in space.

    Raises:
        ValueError: they are not a dict, a key is unknown, or a value is not as `RESET_OPTIONS` says.
    """
    checked: dict[str, Any] = {}
    for key, value in checked_mapping(options).items():
        if key not in RESET_OPTIONS:
            raise ValueError(f"unknown reset option {key!r}; allowed are {', '.join(RESET_OPTIONS)}")
        if key == "episode":
            if not isinstance(value, Episode):
                raise ValueError(f"reset option episode is {value!r}; it must be an Episode, as Scenario.draw returns")
            checked[key] = value
            continue
        try:
            vector = np.asarray(value, dtype=np.float64)
        except (TypeError, ValueError, OverflowError):
            vector = np.array(math.nan)
        if vector.shape != (size,) or not np.isfinite(vector).all():
            raise ValueError(
                f"reset option {key} is {value!r}; it must be {({3: 'three', 5: 'five'})[size]} finite numbers: "
                + RESET_OPTIONS[key]
            )
        checked[key] = tuple(vector.tolist())
    return checked


def with_options(episode: Episode, options: Mapping[str, Any]) -> Episode:
    """Return the episode with its vectors replaced by those of `checked_options`."""
    if not options:
        return episode
    return replace(episode, **{key: value for key, value in options.items() if key != "episode"})

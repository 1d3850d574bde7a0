"""The vertical part of a scenario in space, and how it extends the episodes of the plane."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from auv_gym.effects.actuators import Actuators
from auv_gym.effects.base import uniform_of
from auv_gym.effects.mismatch import RandomMismatch
from auv_gym.effects.waves import SpaceWaves
from auv_gym.physics.intervals import Interval, Uniform, check_interval, check_number, draw, draw_log, signed, times
from auv_gym.physics.namespaces import Array
from auv_gym.physics.space import Limits, Pitch, SpaceVehicle
from auv_gym.physics.stiffness import substeps_for
from auv_gym.physics.units import Units
from auv_gym.physics.vehicle import Vehicle
from auv_gym.planning.paths import Path
from auv_gym.planning.paths.space import Climb, Height, SpacePath, Steps, Wave, WithHeight
from auv_gym.scenarios.episode import Episode

_START: Array = np.zeros(1)  # [s]
_SPARE = 0.4
_SLOWER = 0.85  # least speed of a random path over its mean
_RISE = 0.5
"""Largest rise of a random path, as a share of its first depth."""


@dataclass(frozen=True)
class Vertical:
    """What a scenario in space has beside a scenario in the plane.

    What is not here is the same in both planes: factors of a mismatch, forces of waves, noise of velocities and of
    turn rates, actuators. The pitch has the noise of the heading.
    """

    pitch: Pitch = field(default_factory=lambda: Pitch(stiffness=36.0))  # of the known vehicle, see `Pitch`
    climb: float = 0.0  # [rad] largest slope of a random path
    depth: Interval = 20.0  # [m] of the first point of a random or planar path
    z_e: Interval = 0.0  # [m] initial error
    theta_e: Interval = 0.0  # [rad] initial error
    depth_noise: Interval = 0.0  # [m] standard deviation of the measured depth, as `Sensors.position`
    depth_bias: Interval = 0.0  # [m] bias of the measured depth
    current: Interval = 0.0  # mean upward current, in the unit of `RandomCurrent.speed`
    veer: Interval = 0.0  # [rad/m] by which the current turns with height
    decay: Interval = 0.0  # [1/m] by which the current grows with height
    stiffness: Interval = 1.0  # factor of the true restoring moment

    def __post_init__(self) -> None:
        check_number("vertical climb", self.climb, 0, 1.3)
        check_interval("vertical depth", self.depth, 0.1, 900)
        check_interval("vertical z_e", self.z_e, -1e3, 1e3)
        check_interval("vertical theta_e", self.theta_e, -1.2, 1.2)
        check_interval("vertical depth_noise", self.depth_noise, 0, 1e3)
        check_interval("vertical depth_bias", self.depth_bias, -1e3, 1e3)
        check_interval("vertical current", self.current, -1e3, 1e3)
        for name in ("veer", "decay"):
            check_interval(f"vertical {name}", getattr(self, name), -1, 1)
        check_interval("vertical stiffness", self.stiffness, 1e-3, 1e3)

    def scaled(self, units: Units, pitch: Pitch) -> Vertical:
        """Return the vertical part for a vehicle with these units and this pitch."""
        m = units.length
        metres: Any = {name: times(getattr(self, name), m) for name in ("depth", "z_e", "depth_noise", "depth_bias")}
        rates: Any = {name: times(getattr(self, name), 1 / m) for name in ("veer", "decay")}
        return replace(self, pitch=pitch, **metres, **rates)

    def check(self, scenario: Any) -> None:
        """Raise ValueError if a scenario in space has what only the plane has, or if a step is too long."""
        sensors = scenario.sensors
        for name, value in (("low_pass", sensors.low_pass), ("reckoning", sensors.reckoning)):
            if value is not None:
                raise ValueError(f"sensors {name} is {value!r}; a scenario in space has none, so leave it out")
        if self.pitch.parameters and scenario.mismatch is not None and scenario.mismatch.vehicles:
            raise ValueError("an ensemble of vehicles needs equal planes; leave out the parameters of pitch")
        if scenario.substeps < (least := self.least_substeps(scenario)):
            raise ValueError(f"substeps is {scenario.substeps}; the vertical plane needs at least {least}")

    def least_substeps(self, scenario: Any) -> int:
        """Return the smallest valid `substeps` for the vertical plane."""
        vertical, mismatch = self.vehicle(scenario).vertical, scenario.mismatch
        rows = mismatch.extremes(vertical) if mismatch else vertical.all_coefficients
        surge, sway, yaw = scenario.largest_load
        moment = max(yaw, yaw + self.limits(scenario.actuators).F_q_max - scenario.actuators.F_r_max)
        return substeps_for(scenario.control_dt, rows, (surge, sway + abs(self.pitch.buoyancy), moment))

    def vehicle(self, scenario: Any) -> SpaceVehicle:
        """Return the known vehicle with five degrees of freedom."""
        return self.pitch.vehicle(scenario.vehicle)

    def planes(self, scenario: Any) -> tuple[Vehicle, Vehicle]:
        """Return both planes of the known vehicle."""
        known = self.vehicle(scenario)
        return known.horizontal, known.vertical

    def fins(self, actuators: Actuators) -> tuple[float, float]:
        """Return the moments [kg] of full fins over squared speed, in pitch and in yaw; 0 without fins."""
        limits = self.limits(actuators)
        return limits.fin_q, limits.fin_r

    def limits(self, actuators: Actuators) -> Limits:
        """Return the limits of the actuators; those of pitch are those of yaw unless `pitch` says otherwise."""
        return self.pitch.limits(actuators.F_u_max, actuators.F_r_max, actuators.fin)

    def steepest(self, actuators: Actuators, speed: float) -> float:
        """Return the slope [rad] that the fins hold at a speed [m/s], with `_SPARE` of their moment to spare."""
        limits, k = self.limits(actuators), self.pitch.stiffness
        moment = min(limits.F_q_max, limits.fin_q * speed * speed) if limits.fin_q else limits.F_q_max
        return math.asin(min(1.0, (1 - _SPARE) * moment / k)) if k else 0.5 * math.pi

    def path(self, path: Any, scenario: Any, uniform: Uniform) -> SpacePath:
        """Return the path in space for a drawn planar one, which gets a random height, or for that of the scenario."""
        depth = draw(self.depth, uniform)
        if isinstance(path, SpacePath):
            return path
        random = not isinstance(scenario.path, Path)
        height = self._height(path, scenario, depth, uniform) if random and self.climb else Climb(0.0)
        return WithHeight(path, height, -depth)

    def _height(self, path: Path, scenario: Any, depth: float, uniform: Uniform) -> Height:
        """Return a random height: a climb or a dive, one or two steps, or a wave, with slopes up to `climb`."""
        path_: Any = scenario.path
        slowest = path.speed * _SLOWER
        climb = min(self.climb, self.steepest(scenario.actuators, slowest))
        kind, turn = int(3 * uniform()), path_.turn_rate * (0.5 + 0.5 * uniform())
        rate, most = path.speed * math.tan(climb * (0.3 + 0.7 * uniform())), _RISE * depth
        up, half = signed(1.0, uniform), 0.5 * scenario.duration
        middles = (half * uniform(), half * (1 + uniform()))
        if slowest < self.vehicle(scenario).reversal_speed:
            return Climb(0.0)
        if kind == 0:
            return Climb(-rate if rate * scenario.duration > most else up * rate)
        if kind == 1:
            rise = min(2 * rate / turn, most)
            return Steps(((middles[0], up * rise), (middles[1], -up * rise)), rise / (2 * rate))
        return Wave(min(rate / turn, most), turn, 2 * math.pi * uniform())

    def extended(self, episode: Episode, scenario: Any, noise_seed: int) -> Episode:
        """Return the episode in space for one in the plane; all its further numbers come from a stream of their own."""
        uniform = uniform_of("vertical", noise_seed)
        path = self.path(episode.path, scenario, uniform)
        z_0, sensors, act = float(path.derivatives(_START)[0, 2, 0]), scenario.sensors, scenario.actuators
        x_e, y_e, psi_e = episode.initial_error
        n_x, n_y, n_psi, n_u, n_v, n_r = scenario.noise_of(episode)
        n_z = draw_log(self.depth_noise, uniform)
        b_x, b_y, b_psi, b_u, b_v, b_r = episode.bias
        b_z, b_theta, b_w, b_q = (
            draw(interval, uniform)
            for interval in (self.depth_bias, sensors.heading_bias, sensors.velocity_bias, sensors.yaw_rate_bias)
        )
        z_e, theta_e = draw(self.z_e, uniform), draw(self.theta_e, uniform)
        factor, upward = draw(self.stiffness, uniform), draw(self.current, uniform)
        profile = z_0, draw(self.veer, uniform), draw(self.decay, uniform)
        (f_u, f_r), (r_u, r_r) = episode.effectiveness, episode.reach
        f_q, r_q = draw(act.effectiveness, uniform), draw(act.reach, uniform)
        current, waves, known = episode.current, episode.waves, self.vehicle(scenario)
        if scenario.current is not None:
            unit = episode.path.speed if scenario.current.relative else 1.0
            current = replace(current, V_z=upward * unit)
        if waves is not None:
            more = tuple(tuple(2 * math.pi * uniform() for _ in waves.frequencies) for _ in range(2))
            (surge, sway, yaw), phases = waves.forces, waves.phases
            order = phases[0], phases[1], *more, phases[2]
            waves = SpaceWaves(surge, sway, yaw, waves.frequencies, order, heave=sway, pitch=yaw)
        return replace(
            episode,
            path=path,
            vehicle=_true(known, episode.vehicle, scenario.mismatch, factor),
            current=current,
            waves=waves,
            bias=(b_x, b_y, b_z, b_theta, b_psi, b_u, b_v, b_w, b_q, b_r),
            noise=(n_x, n_y, n_z, n_psi, n_psi, n_u, n_v, n_v, n_r, n_r),
            initial_error=(x_e, y_e, z_e, theta_e, psi_e),
            effectiveness=(f_u, f_q, f_r),
            reach=(r_u, r_q, r_r),
            profile=profile,
        )


def _true(known: SpaceVehicle, true: Vehicle, mismatch: RandomMismatch | None, factor: float) -> SpaceVehicle:
    """Return the true vehicle for its horizontal plane: the vertical plane has the same factors."""
    vertical = true
    if not known.has_equal_planes:
        vertical = mismatch.like(known.horizontal, true, known.vertical) if mismatch else known.vertical
    return replace(known, horizontal=true, vertical=vertical, stiffness=factor * known.stiffness)

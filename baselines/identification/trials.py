"""Trials for an identification, with surge steps, zig-zags and a turning circle, and simulated logs of them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from auv_gym.effects.actuators import Actuators, Response, respond
from auv_gym.effects.sensors import Sensors
from auv_gym.physics.dynamics import STILL_WATER, CurrentVelocity, Force, State, rk4_step
from auv_gym.physics.errors import to_body
from auv_gym.physics.namespaces import FLOATS
from auv_gym.physics.vehicle import Vehicle
from baselines.identification.log import Log

Segment = tuple[float, float, float, float]
SEGMENTS: tuple[Segment, ...] = (
    # end [s], share of the surge limit, share of the yaw limit, heading at which a zig-zag is reversed [rad]
    (1.0, 0.00, 0.00, 0.0),  # at rest: the forces at the start of the log must be known
    (6.0, 0.15, 0.00, 0.0),  # surge step
    (24.0, 0.15, 0.15, math.radians(20)),  # zig-zag 20/20
    (36.0, 0.20, 0.15, 0.0),  # turning circle
    (39.0, 1.25, 0.05, math.radians(10)),  # beyond the limit of the thruster, in a narrow zig-zag
    (42.0, 0.00, -1.25, 0.0),  # beyond the limit of the rudder
    (53.0, 0.30, 0.40, math.radians(30)),  # zig-zag 30/30, faster
    (60.0, -0.15, 0.10, math.radians(20)),  # astern
)
"""The trial of one minute. A zig-zag reverses the rudder whenever the heading has changed by the given angle."""

EXAMPLE_CURRENT: CurrentVelocity = (0.12, -0.08)  # [m/s] of the example
EXAMPLE_ACTUATORS = Actuators(lag=0.4)
"""Actuators of the vehicle in the example."""
FINER = 5  # integration steps of the simulated vehicle per row, more than in the fit

PlantStep = Callable[[State, Force, float], State]
"""Function that returns the state one time step later, `plant(state, command, dt)`; it may have internal states."""


@dataclass
class Trial:
    """Commands of a trial; those of a zig-zag depend on the heading.

    Args:
        F_u_max: limit of the surge force [N].
        F_r_max: limit of the yaw moment [N m].
        duration: length of the trial [s], to which its parts are scaled.
        segments: the parts, in the form of `SEGMENTS`.
    """

    F_u_max: float = 400.0
    F_r_max: float = 200.0
    duration: float = 60.0
    segments: tuple[Segment, ...] = SEGMENTS
    _part: int = field(default=0, init=False)
    _heading: float = field(default=0.0, init=False)  # [rad] heading at the start of the part
    _side: float = field(default=1.0, init=False)

    def command(self, t: float, psi: float) -> Force:
        """Return F_u [N] and F_r [N m] at a time [s] and heading [rad]; times must not decrease."""
        scale, last = self.duration / self.segments[-1][0], len(self.segments) - 1
        part = next((i for i, s in enumerate(self.segments) if t < s[0] * scale), last)
        if part != self._part:
            self._part, self._heading, self._side = part, psi, 1.0
        _, surge, yaw, band = self.segments[part]
        if band and self._side * (psi - self._heading) > band:
            self._side = -self._side
        return surge * self.F_u_max, self._side * yaw * self.F_r_max


@dataclass
class Simulated:
    """A simulated vehicle with its actuators in a current [m/s], as a `PlantStep`.

    With a finite `arm` [m] the yaw moment is caused by a side force at this distance behind the origin. The lag of the
    actuators must be a number.
    """

    vehicle: Vehicle
    actuators: Actuators
    current: CurrentVelocity = STILL_WATER
    arm: float = math.inf
    _force: Force = field(default=(0.0, 0.0), init=False)

    def __call__(self, state: State, command: Force, dt: float) -> State:
        """Return x, y, psi, u, v relative to the water, r after dt [s] of a command [N], [N m]."""
        act, h = self.actuators, dt / FINER
        assert not isinstance(act.lag, tuple)
        F_u, F_r = (FLOATS.clip(F, -most, most) for F, most in zip(command, (act.F_u_max, act.F_r_max), strict=True))
        response = Response.of(act.lag, act.F_u_rate, act.F_r_rate, h)
        for _ in range(FINER):
            acting, self._force = respond(self._force, (F_u, F_r), response, FLOATS)
            load = (acting[0], 0.0 - acting[1] / self.arm, acting[1])
            state = rk4_step(state, load, self.vehicle.all_coefficients, h, self.current)
        return state


def recorded(
    plant: PlantStep,
    trial: Trial,
    sensors: Sensors,
    rng: np.random.Generator,
    current: CurrentVelocity = STILL_WATER,
    dt: float = 0.1,
) -> Log:
    """Return the log of a trial, which starts at rest relative to the water.

    Args:
        plant: the vehicle.
        trial: the commands, which depend on the measured heading.
        sensors: the noise of the measurements; other sensor errors are not simulated.
        rng: of the noise.
        current: current [m/s] of the plant, which is added to the speeds over ground.
        dt: time [s] between rows.
    """
    t = np.linspace(0.0, trial.duration, round(trial.duration / dt) + 1)
    noise = rng.standard_normal((len(t), 6)) * np.array(sensors.noise)
    state: State = (0.0,) * 6
    measured, commands = np.empty((len(t), 6)), np.empty((len(t), 2))
    for k, time in enumerate(t.tolist()):
        x, y, psi, u, v, r = state
        V_u, V_v = to_body(*current, math.cos(psi), math.sin(psi))
        measured[k] = np.array((x, y, psi, u + V_u, v + V_v, r)) + noise[k]
        commands[k] = command = trial.command(time, float(measured[k, 2]))
        state = plant(state, command, dt)
    return Log(t, measured, commands)


def example(vehicle: Vehicle, actuators: Actuators, sensors: Sensors, seed: int) -> Log:
    """Return the log of the trial `SEGMENTS` of a simulated vehicle with noise, in the current `EXAMPLE_CURRENT`."""
    plant, trial = Simulated(vehicle, actuators, EXAMPLE_CURRENT), Trial(actuators.F_u_max, actuators.F_r_max)
    return recorded(plant, trial, sensors, np.random.default_rng(seed), EXAMPLE_CURRENT)

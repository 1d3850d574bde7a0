"""Discrete-time model of vehicle, actuators and disturbances for the extended Kalman filter.

It is written on components, so that predictive control can use it as well. The wave load on each axis is a lightly
damped oscillator driven by white noise (T. I. Fossen, Handbook of Marine Craft Hydrodynamics and Motion Control, 2nd
ed., 2021, section 10.2). Current, its rate and the slowly varying load are Gauss-Markov processes. The actuators' time
constant is a random walk.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, TypeAlias

from auv_gym.effects.actuators import Response, respond
from auv_gym.physics.namespaces import Namespace, Number
from auv_gym.task.model import PLANE, Model

WAVE_FREQUENCY = 0.8  # [rad/s] natural frequency of the wave oscillators
WAVE_DAMPING = 0.1  # [1] relative damping of the wave oscillators
GUST_MEMORY = 3.0  # [s] correlation time of the current's rate
CURRENT_MEMORY = 40.0
"""Correlation time [s] of the current. On a straight line only the sum of the effects of current and load is
observable. A finite correlation time keeps estimates of opposite signs from growing together."""
BIAS_MEMORY = 10.0  # [s] correlation time of the slowly varying load
SHORTEST_LAG = 1e-3  # [s] least time constant of the actuators; positive, so that the derivatives are finite
LONGEST_LAG = 2.0  # [s] largest time constant of the actuators

WaveTransition: TypeAlias = tuple[tuple[Number, Number], tuple[Number, Number]]
"""A matrix (2, 2), as two rows."""


class Estimate(NamedTuple):
    """The state of the model: floats, rows of shape (N,) or symbols."""

    x_e: Number  # [m] position minus that of the reference, in the world
    y_e: Number  # [m]
    psi: Number  # [rad] continuous in time
    u: Number  # [m/s] relative to the water
    v: Number  # [m/s]
    r: Number  # [rad/s]
    F_u: Number  # [N] force that the actuators apply
    F_r: Number  # [N m]
    V_x: Number  # [m/s] current, in the world
    V_y: Number  # [m/s]
    V_x_rate: Number  # [m/s^2]
    V_y_rate: Number  # [m/s^2]
    X: Number  # [N] slowly varying load on the vehicle; it includes the effect of model errors
    Y: Number  # [N]
    N: Number  # [N m]
    lag: Number  # [s] time constant of the actuators
    X_wave: Number  # [N] wave load ...
    X_swing: Number  # [N] ... and its rate divided by WAVE_FREQUENCY
    Y_wave: Number  # [N]
    Y_swing: Number  # [N]
    N_wave: Number  # [N m]
    N_swing: Number  # [N m]


@dataclass(frozen=True)
class SeaModel:
    """The states of the model for a kind of motion, and their rows.

    Args:
        model: the kind of motion.
        Estimate: NamedTuple of the state. In this order: the `model`'s state with the position relative to that of the
            reference, forces, current, its rate, load, time constant, and each component's wave load and swing.
    """

    model: Model
    Estimate: Any

    @cached_property
    def size(self) -> int:
        """Number of states."""
        return len(self.Estimate._fields)

    @cached_property
    def place(self) -> Any:
        """The row of each field: `place.lag` is that of the lag."""
        return self.Estimate._make(range(self.size))

    @cached_property
    def motion(self) -> slice:
        """Rows of position, angles and velocities; with velocities over ground they are the measurements."""
        return slice(0, len(self.model.state))

    @cached_property
    def force(self) -> slice:
        """Rows of the actuators' forces."""
        return self.model.forces

    @cached_property
    def current(self) -> slice:
        """Rows of the current."""
        return slice(self.force.stop, self.force.stop + len(self.model.current))

    @cached_property
    def gust(self) -> slice:
        """Rows of the current's rate."""
        return slice(self.current.stop, self.current.stop + len(self.model.current))

    @cached_property
    def bias(self) -> slice:
        """Rows of the slowly varying load."""
        return slice(self.gust.stop, self.gust.stop + len(self.model.load))

    @cached_property
    def waves(self) -> slice:
        """Rows of the wave loads and swings of all components."""
        return slice(self.bias.stop + 1, self.size)

    @cached_property
    def wave_pairs(self) -> tuple[slice, ...]:
        """Rows of load and swing of each component."""
        return tuple(slice(row, row + 2) for row in range(self.waves.start, self.size, 2))

    @cached_property
    def driven(self) -> tuple[int, ...]:
        """The component of the load on which each actuator acts."""
        return tuple(self.model.load.index(name) for name in self.model.driven)


PLANE_SEA = SeaModel(PLANE, Estimate)
"""The model in the horizontal plane."""
STATE_SIZE, PLACE = PLANE_SEA.size, PLANE_SEA.place  # number of states and the row of each in the plane


def lag_response(lag: Number, dt: Number, ns: Namespace) -> Response:
    """Return `Response.of` for positive time constants [s], without rate limits."""
    gain = 1.0 - ns.exp(-dt / lag)
    return Response(gain, (1.0 - lag / dt * gain) / gain, math.inf, math.inf)


def wave_transition(dt: Number, ns: Namespace) -> WaveTransition:
    """Return the transition matrix A of a wave load and its swing over dt [s] without excitation, as two rows.

    White noise for which both have the stationary variance s^2 adds the covariance s^2 (1 - A A^T) in this time.
    """
    root = math.sqrt(1 - WAVE_DAMPING**2)
    angle = root * WAVE_FREQUENCY * dt
    c, s = ns.cos(angle), ns.sin(angle) / root
    decay = ns.exp(-WAVE_DAMPING * WAVE_FREQUENCY * dt)
    a, b = WAVE_DAMPING * s, decay * s
    return (decay * (c + a), b), (-b, decay * (c - a))


def waves_after(z: Any, A: WaveTransition, sea: SeaModel = PLANE_SEA) -> tuple[Number, ...]:
    """Return the wave states after one transition by the matrix A of `wave_transition`."""
    (a, b), (c, d) = A
    pairs = (z[pair] for pair in sea.wave_pairs)
    return tuple(row for w, s in pairs for row in (a * w + b * s, c * w + d * s))


def current_transition(dt: Number, ns: Namespace) -> tuple[Number, Number, Number]:
    """Return the decay factors of the current and of its rate over dt [s], and the effective time [s] of the rate."""
    decay = ns.exp(-dt / GUST_MEMORY)
    return ns.exp(-dt / CURRENT_MEMORY), decay, GUST_MEMORY * (1 - decay)


def current_after(z: Any, dt: Number, ns: Namespace, sea: SeaModel = PLANE_SEA) -> tuple[Number, ...]:
    """Return the components of the current [m/s] after dt [s]."""
    decay, _, time = current_transition(dt, ns)
    return tuple(decay * V + time * rate for V, rate in zip(z[sea.current], z[sea.gust], strict=True))


def mean_load(
    z: Any, command: Sequence[Number], dt: Number, coefficients: Any, ns: Namespace, sea: SeaModel = PLANE_SEA
) -> tuple[tuple[Number, ...], tuple[Number, ...]]:
    """Return the mean load on the vehicle over one control period, and the actuators' force at its end."""
    gain, mean, *_ = lag_response(z.lag, dt, ns)
    means, force = respond(z[sea.force], command, (gain, mean, *(math.inf for _ in command)), ns)
    waves = waves_after(z, wave_transition(dt, ns), sea)[::2]
    outside = tuple(slow + wave for slow, wave in zip(z[sea.bias], waves, strict=True))
    load = [*sea.model.from_outside(outside, coefficients)]
    for row, middle in zip(sea.driven, means, strict=True):
        load[row] = middle + load[row]
    return tuple(load), force


def transition(
    z: Any,
    command: Sequence[Number],
    reference_step: Sequence[Number],
    dt: Number,
    coefficients: Any,
    ns: Namespace,
    sea: SeaModel = PLANE_SEA,
) -> Any:
    """Return the state one control period later, without excitation.

    Args:
        z: the state, an `Estimate`.
        command: of each actuator during the period [N], [N m].
        reference_step: displacement of the reference in the world during the period [m].
        dt: control period [s].
        coefficients: of the nominal vehicle.
        ns: the namespace of the numbers.
        sea: the kind of motion.
    """
    load, force = mean_load(z, command, dt, coefficients, ns, sea)
    current = current_after(z, dt, ns, sea)
    motion = sea.model.advance(z[sea.motion], load, coefficients, dt, current, ns)
    position = (x - step for x, step in zip(motion, reference_step, strict=False))
    vehicle = (*position, *motion[len(reference_step) :])
    _, decay, _ = current_transition(dt, ns)
    gust = tuple(decay * rate for rate in z[sea.gust])
    bias_decay = ns.exp(-dt / BIAS_MEMORY)
    bias = (bias_decay * load for load in z[sea.bias])
    waves = waves_after(z, wave_transition(dt, ns), sea)
    return sea.Estimate._make((*vehicle, *force, *current, *gust, *bias, z.lag, *waves))


def measurement(z: Any, ns: Namespace, sea: SeaModel = PLANE_SEA) -> tuple[Number, ...]:
    """Return the ideal measurements: the motion with velocities over ground, in the plane x_e, y_e, psi, u, v, r."""
    measured: tuple[Number, ...] = sea.model.over_ground(z[sea.motion], z[sea.current], ns)
    return measured

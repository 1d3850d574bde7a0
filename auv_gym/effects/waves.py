"""Waves as body forces."""

from __future__ import annotations

import math
from dataclasses import dataclass

from auv_gym.physics.intervals import Uniform, check_interval, check_number
from auv_gym.physics.namespaces import Number
from auv_gym.physics.vehicle import Vehicle


@dataclass(frozen=True)
class Waves:
    """First-order wave forces on the vehicle: a sum of sines of equal amplitude on each axis."""

    surge: float  # [N] root mean square
    sway: float  # [N]
    yaw: float  # [N m]
    frequencies: tuple[float, ...]  # [rad/s]
    phases: tuple[tuple[float, ...], ...]  # [rad], shape (axes, number of frequencies)

    @property
    def forces(self) -> tuple[float, ...]:
        """The root mean square of each axis."""
        return self.surge, self.sway, self.yaw


@dataclass(frozen=True)
class SpaceWaves(Waves):
    """Wave forces in space at the surface; they decay with depth."""

    heave: float  # [N] root mean square
    pitch: float  # [N m]

    @property
    def forces(self) -> tuple[float, ...]:
        """The root mean square of each axis."""
        return self.surge, self.sway, self.heave, self.pitch, self.yaw


@dataclass(frozen=True)
class RandomWaves:
    """Distribution of the waves. The RMS forces are fractions of d11 U, d22 U and d33 U / (1 m) at path speed U.

    Where the yaw moment exceeds `most_yaw` U^2, all three are reduced by the same factor: fins give a torque with U^2.
    """

    surge: float = 0.0
    sway: float = 0.0
    yaw: float = 0.0
    band: tuple[float, float] = (0.5, 1.1)  # [rad/s]; one frequency is drawn in each of `components` equal parts
    components: int = 6
    most_yaw: float = math.inf  # [kg] largest RMS yaw moment over the squared path speed

    def __post_init__(self) -> None:
        for name in ("surge", "sway", "yaw"):
            check_number(f"waves {name}", getattr(self, name), 0, 1e3)
        check_number("waves most_yaw", self.most_yaw, 0)
        if not isinstance(self.band, tuple):
            raise ValueError(f"waves band is {self.band!r}; it must be a pair (low, high)")
        check_interval("waves band", self.band, 1e-3, 1e2)
        if isinstance(self.components, bool) or not isinstance(self.components, int) or not 1 <= self.components <= 12:
            raise ValueError(f"waves components is {self.components!r}; it must be an integer in [1, 12]")

    def draw(self, uniform: Uniform, speed: Number, vehicle: Vehicle) -> Waves:
        """Return one sea state for a path of this nominal speed [m/s] and the vehicle whose drag scales it."""
        low, high = self.band
        n = self.components
        frequencies = tuple(low + (high - low) * (j + uniform()) / n for j in range(n))
        phases = tuple(tuple(2 * math.pi * uniform() for _ in range(n)) for _ in range(3))
        forces = self.surge * vehicle.d11 * speed, self.sway * vehicle.d22 * speed, self.yaw * vehicle.d33 * speed
        if self.yaw and self.most_yaw < math.inf:
            share = self.most_yaw * speed / (self.yaw * vehicle.d33)
            less = 1.0 - (1.0 - share) * (share < 1.0)
            forces = forces[0] * less, forces[1] * less, forces[2] * less
        return Waves(*forces, frequencies, phases)

"""Units of a vehicle's own: its mass m11, its length sqrt(m33/m11) and its time, the length over its design speed.

Seen in them, every vehicle has the mass, the length and the speed of the paper's vehicle, and differs from it only in
ratios: m22/m11, drag, lift, limits. What is made for the paper's vehicle by numbers with units, such as the gains of a
controller, then fits any other (E. Buckingham, "On physically similar systems", Physical Review 4:345-376, 1914).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from auv_gym.physics.vehicle import PAPER_VEHICLE, PARAMETER_NAMES, Vehicle

POWERS: Mapping[str, tuple[float, float, float]] = {
    "1": (0, 0, 0),
    "rad": (0, 0, 0),
    "m": (1, 0, 0),
    "s": (0, 1, 0),
    "kg": (0, 0, 1),
    "m/s": (1, -1, 0),
    "rad/s": (0, -1, 0),
    "1/m": (-1, 0, 0),
    "1/m^2": (-2, 0, 0),
    "1/s": (0, -1, 0),
    "kg m": (1, 0, 1),
    "kg/m": (-1, 0, 1),
    "kg m^2": (2, 0, 1),
    "kg/s": (0, -1, 1),
    "kg m/s": (1, -1, 1),
    "kg m^2/s": (2, -1, 1),
    "N": (1, -2, 1),
    "N m": (2, -2, 1),
    "N/s": (1, -3, 1),
    "N m/s": (2, -3, 1),
}
"""Powers of length, time and mass in SI units."""
DIMENSIONS: Mapping[str, str] = dict(
    zip(
        PARAMETER_NAMES,
        (
            *("kg", "kg", "kg m^2", "kg/s", "kg/s", "kg m^2/s", "kg/m", "kg/m", "kg m^2", "kg/m", "kg", "kg", "kg m"),
            *("kg/m", "kg", "kg m", "kg", "kg", "kg m", "kg", "kg m", "kg m"),
            *("kg m/s", "kg m/s", "m"),
        ),
        strict=True,
    )
)
"""The SI unit of each of a vehicle's coefficients."""


@dataclass(frozen=True)
class Units:
    """Ratios of a vehicle's units of length, time and mass to those of the paper's vehicle."""

    length: float = 1.0
    time: float = 1.0
    mass: float = 1.0

    @classmethod
    def of(cls, vehicle: Vehicle) -> Units:
        """Return the units of a vehicle; exactly 1 where mass, length and design speed are the paper's vehicle's."""
        paper = PAPER_VEHICLE
        return cls(vehicle.length / paper.length, vehicle.time / paper.time, vehicle.m11 / paper.m11)

    def factor(self, length: float = 0, time: float = 0, mass: float = 0) -> float:
        """Return the scale factor of a quantity with these powers of length, time and mass, see `POWERS`.

        A quantity of the paper's vehicle times the factor is the similar one of this vehicle; one of this vehicle over
        it is the similar one of the paper's.
        """
        return float(self.length**length * self.time**time * self.mass**mass)


def in_paper_units(vehicle: Vehicle) -> Vehicle:
    """Return a vehicle in units in which its m11, its m33 and its design speed are those of the paper's vehicle.

    Those three come out without a residue of rounding; a vehicle that has them already is returned as it is.

    Raises:
        ValueError: a ratio of its parameters is larger than a vehicle may have.
    """
    units, paper = Units.of(vehicle), PAPER_VEHICLE
    if units == Units():
        return vehicle
    similar = {name: getattr(vehicle, name) / units.factor(*POWERS[unit]) for name, unit in DIMENSIONS.items()}
    try:
        return replace(vehicle, **{**similar, "m11": paper.m11, "m33": paper.m33, "speed": paper.speed})
    except ValueError as error:
        raise ValueError(f"in units of its own mass, length and speed the vehicle is out of bounds: {error}") from error

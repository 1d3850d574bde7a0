"""Published vehicles, one TOML file each: parameters, actuators, and what the source says of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path as FilePath
from typing import Any

from auv_gym.physics.actuators import Actuators
from auv_gym.physics.intervals import check_number
from auv_gym.physics.units import Units, in_paper_units
from auv_gym.physics.vehicle import PAPER_VEHICLE, VEHICLES, Vehicle
from auv_gym.scenarios.records import from_record, guarded, read_table
from auv_gym.scenarios.vehicles.scaling import actuators_in

VEHICLES_FOLDER = FilePath(__file__).parent  # of the vehicles, NAME.toml


@dataclass(frozen=True)
class VehicleModel:
    """A vehicle with all that belongs to it: actuators, speed, and what is known about its numbers.

    Raises:
        ValueError: a number is not finite or not positive.
    """

    name: str
    about: str  # what it is, in a line
    source: str  # of the numbers
    left_out: str  # what the source has and the equations of motion have not
    ours: str  # what the source does not have
    vehicle: Vehicle
    actuators: Actuators
    turn_rate: float | None = None  # [rad/s] there, at most; None: as the paper's, 0.12 rad/s in its own time
    lag: float | None = None  # [s] of its actuators, about; None: as the paper's, 0.2 s in its own time
    slowest: float = 0.0  # [m/s] below which its fins do not steer it

    def __post_init__(self) -> None:
        for name in ("name", "about", "source", "left_out", "ours"):
            if not isinstance(getattr(self, name), str):
                raise ValueError(f"craft {name} is {getattr(self, name)!r}; it must be a string")
        check_number("craft slowest", self.slowest, 0, self.vehicle.speed)
        for name in ("turn_rate", "lag"):
            if getattr(self, name) is not None:
                check_number(f"craft {name}", getattr(self, name), 1e-6, 1e3)

    def drag(self, speed: float) -> tuple[float, float, float]:
        """Return what the drag is per velocity at a surge speed [m/s]: surge, sway [kg/s] and yaw [kg m^2/s]."""
        v = self.vehicle
        return v.d11 + v.X_uu * speed, v.d22 + v.Y_uv * speed, v.d33 + v.N_ur * speed

    @property
    def in_paper_units(self) -> VehicleModel:
        """The same in units in which mass, length and design speed are those of the paper's vehicle."""
        units = Units.of(self.vehicle)
        if units == Units():
            return self
        return replace(
            self,
            vehicle=in_paper_units(self.vehicle),
            actuators=actuators_in(units, self.actuators),
            turn_rate=None if self.turn_rate is None else self.turn_rate * units.time,
            lag=None if self.lag is None else self.lag / units.time,
            slowest=self.slowest / units.factor(length=1, time=-1),
        )

    @classmethod
    def load(cls, file: str | FilePath) -> VehicleModel:
        """Return the vehicle of a .toml or .json file.

        Raises:
            ValueError: the file is of another kind, is not valid, or has a wrong entry.
            OSError: the file cannot be read.
        """
        with guarded(str(file)):
            return from_record(cls, read_table(FilePath(file)), "vehicle file")


PAPER = VehicleModel(
    name="paper",
    about="the paper's vehicle",
    source="Repoulias and Papadopoulos 2005, see `auv_gym.physics.vehicle.PAPER_VEHICLE`",
    left_out="",
    ours="limits, speed and lag",
    vehicle=PAPER_VEHICLE,
    actuators=Actuators(F_u_max=400.0, F_r_max=200.0),
    turn_rate=0.12,
    lag=0.2,
)
"""The vehicle that the presets are made for."""


def vehicle_names() -> list[str]:
    """Return the names of the published vehicles that have a file of their own."""
    return sorted(file.stem for file in VEHICLES_FOLDER.glob("*.toml"))


def list_vehicles() -> list[str]:
    """Return the names that `gym.make(..., vehicle=NAME)` takes."""
    return [*VEHICLES, *vehicle_names()]


@cache
def vehicle_model(name: str) -> VehicleModel:
    """Return the vehicle of a name that `vehicle_names` lists, or of a file.

    Raises:
        ValueError: there is no such vehicle, or its file is wrong.
        OSError: the file cannot be read.
    """
    return VehicleModel.load(VEHICLES_FOLDER / f"{name}.toml" if name in vehicle_names() else name)


def as_vehicle_model(vehicle: Any) -> VehicleModel | None:
    """Return the vehicle with all that belongs to it for an object, a name or a file; None for a hull alone."""
    if isinstance(vehicle, VehicleModel):
        return vehicle
    named = isinstance(vehicle, str) and vehicle not in VEHICLES
    return (
        vehicle_model(vehicle)
        if named and (vehicle in vehicle_names() or vehicle.endswith((".toml", ".json")))
        else None
    )


def as_vehicle(vehicle: Vehicle | VehicleModel | str | Mapping[str, Any]) -> Vehicle:
    """Return a vehicle given as an object, by its name, as a file, or as a dict of its parameters."""
    if isinstance(vehicle, Vehicle):
        return vehicle
    if isinstance(vehicle, Mapping):
        return from_record(Vehicle, vehicle, "vehicle")
    if isinstance(vehicle, str) and vehicle in VEHICLES:
        return VEHICLES[vehicle]
    if (vehicle_model := as_vehicle_model(vehicle)) is not None:
        return vehicle_model.vehicle
    names = ", ".join(list_vehicles())
    raise ValueError(f"unknown vehicle {vehicle!r}; allowed are a Vehicle, a dict, a .toml file, or one of {names}")

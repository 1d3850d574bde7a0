"""Published vehicles, one TOML file each: parameters, actuators and sources."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cache
from pathlib import Path as FilePath
from typing import Any

from auv_gym.effects.actuators import Actuators
from auv_gym.effects.sensors import NoiseLevels
from auv_gym.physics.intervals import check_number
from auv_gym.physics.space import Limits, Pitch, SpaceVehicle
from auv_gym.physics.steering import Shaft
from auv_gym.physics.units import Units, in_paper_units
from auv_gym.physics.vehicle import PAPER_VEHICLE, VEHICLES, Vehicle
from auv_gym.scenarios.records import from_record, guarded, meant, read_table, table_file
from auv_gym.scenarios.vehicles.scaling import actuators_in, scaled_part

VEHICLES_FOLDER = FilePath(__file__).parent  # folder of the files NAME.toml
_LIMITS = ("F_u_max", "F_r_max", "fin", "astern")
"""Entries of `Actuators` that a vehicle has; scenarios have the others."""


@dataclass(frozen=True)
class VehicleModel:
    """A vehicle with its actuators, speeds and the sources of its numbers.

    Raises:
        ValueError: a number is not finite or not positive, or the actuators have an entry that scenarios have.
    """

    name: str
    about: str  # description in one line
    source: str  # source of the numbers
    left_out: str  # terms of the source that the equations of motion do not have
    assumed: str  # numbers that are not from the source
    vehicle: Vehicle
    actuators: Actuators
    turn_rate: float | None = None  # [rad/s] largest; None: 0.12 rad/s of the paper, scaled
    lag: float | None = None  # [s] approximate lag of the actuators; None: 0.2 s of the paper, scaled
    slowest: float = 0.0  # [m/s] least speed for steering by fins
    shaft: Shaft | None = None  # propeller and rudder, for `auv_gym.envs.shaft.ShaftAction`
    sensors: NoiseLevels | None = None  # of its instruments, in place of those of scenarios; None: scaled ones
    pitch: Pitch = field(default=Pitch(), compare=False)  # the vertical plane; not in records of planar scenarios
    surface: bool = field(default=False, compare=False)  # whether it is a surface vessel, which cannot dive

    def __post_init__(self) -> None:
        for name in ("name", "about", "source", "left_out", "assumed"):
            if not isinstance(getattr(self, name), str):
                raise ValueError(f"vehicle {name} is {getattr(self, name)!r}; it must be a string")
        if not isinstance(self.surface, bool):
            raise ValueError(f"vehicle surface is {self.surface!r}; it must be true or false")
        check_number("vehicle slowest", self.slowest, 0, self.vehicle.speed)
        for name in ("turn_rate", "lag"):
            if getattr(self, name) is not None:
                check_number(f"vehicle {name}", getattr(self, name), 1e-6, 1e3)
        for name, usual in ((f.name, f.default) for f in fields(Actuators) if f.name not in _LIMITS):
            if (value := getattr(self.actuators, name)) != usual:
                advice = "write lag before [vehicle]" if name == "lag" else f"{name} is an entry of scenarios"
                raise ValueError(f"vehicle actuators {name} is {value!r}; allowed are {', '.join(_LIMITS)}: {advice}")

    def drag(self, speed: float) -> tuple[float, float, float]:
        """Return drag over velocity at a surge speed [m/s], for surge and sway [kg/s] and yaw [kg m^2/s]."""
        v = self.vehicle
        return v.d11 + v.X_uu * speed, v.d22 + v.Y_uv * speed, v.d33 + v.N_ur * speed

    @property
    def in_space(self) -> SpaceVehicle:
        """The vehicle with five degrees of freedom."""
        return self.pitch.vehicle(self.vehicle)

    @property
    def space_limits(self) -> Limits:
        """The limits of its actuators in space; the fins of pitch are those of yaw unless `pitch` says otherwise."""
        return self.pitch.limits(self.actuators.F_u_max, self.actuators.F_r_max, self.actuators.fin)

    @property
    def in_paper_units(self) -> VehicleModel:
        """The vehicle model in units in which mass, length and design speed are those of the paper."""
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
            shaft=None,
            sensors=scaled_part("sensors", self.sensors, Units(1 / units.length, 1 / units.time, 1 / units.mass)),
            pitch=self.pitch.over(units),
        )

    @classmethod
    def load(cls, file: str | FilePath) -> VehicleModel:
        """Return the vehicle model of a .toml or .json file.

        Raises:
            ValueError: the file is of another kind, has a wrong entry or lacks one, or its thrust is below its drag.
            OSError: the file cannot be read.
        """
        record = read_table(FilePath(file))
        with guarded(str(file)):
            model = model_from(record, "vehicle file")
            for table, name in (("vehicle", "speed"), ("actuators", "F_u_max"), ("actuators", "F_r_max")):
                if name not in record[table]:
                    raise ValueError(
                        f"the table [{table}] lacks the entry {name!r}; a vehicle file has the fastest cruise speed "
                        "[m/s], and the limits F_u_max [N] and F_r_max [N m]"
                    )
            v, F_u_max = model.vehicle, model.actuators.F_u_max
            if (needed := model.drag(v.speed)[0] * v.speed) > F_u_max:
                held = 2 * F_u_max / (v.d11 + math.sqrt(v.d11**2 + 4 * v.X_uu * F_u_max))
                raise ValueError(
                    f"speed {v.speed:g} m/s needs {needed:.3g} N, but F_u_max is {F_u_max:g} N, which holds "
                    f"{held:.2g} m/s; lower the speed, or correct drag or F_u_max"
                )
            return model


def model_from(record: Any, where: str) -> VehicleModel:
    """Return the vehicle model of a record, see `auv_gym.scenarios.records.from_record`."""
    special: dict[str, Any] = {  # entries that are not in records
        "pitch": lambda part: part if isinstance(part, Pitch) else from_record(Pitch, part, "pitch"),
        "surface": lambda part: part,
    }
    return from_record(VehicleModel, record, where, special)


VehicleLike = Vehicle | VehicleModel | str | os.PathLike[str] | Mapping[str, Any]
"""A vehicle, its model, the dict of one of them, its file, or the name of a vehicle."""
PAPER_TURN_RATE = 0.12
"""Turn rate [rad/s] of the paths of the paper's vehicle at cruise."""
PAPER_LAG = 0.2
"""Nominal lag [s] of the actuators of the paper's vehicle."""
PAPER = VehicleModel(
    name="paper",
    about="the paper's vehicle",
    source="Repoulias and Papadopoulos 2005, see `auv_gym.physics.vehicle.PAPER_VEHICLE`",
    left_out="",
    assumed="limits, speed and lag",
    vehicle=PAPER_VEHICLE,
    actuators=Actuators(F_u_max=400.0, F_r_max=200.0),
    turn_rate=PAPER_TURN_RATE,
    lag=PAPER_LAG,
    pitch=Pitch(stiffness=36.0),  # [N m] assumed: a weight of 185 kg that acts 0.02 m below the buoyancy
)
"""The vehicle of the presets."""


def vehicle_names() -> list[str]:
    """Return the names of the vehicle files in the package."""
    return sorted(file.stem for file in VEHICLES_FOLDER.glob("*.toml"))


def list_vehicles() -> list[str]:
    """Return the names that `gym.make(..., vehicle=NAME)` accepts."""
    return [*VEHICLES, *vehicle_names()]


def vehicle_model(name: str) -> VehicleModel:
    """Return the vehicle model for a name of `vehicle_names`, or of a file, which is read again at each call.

    Raises:
        ValueError: the vehicle does not exist, or its file is wrong.
        OSError: the file cannot be read.
    """
    return _published().get(name) or VehicleModel.load(name)


@cache
def _published() -> dict[str, VehicleModel]:
    return {name: VehicleModel.load(VEHICLES_FOLDER / f"{name}.toml") for name in vehicle_names()}


def as_vehicle_model(vehicle: Any) -> VehicleModel | None:
    """Return the vehicle model for an object, its dict, a name or a file; None for anything else."""
    if isinstance(vehicle, VehicleModel):
        return vehicle
    if isinstance(vehicle, Mapping) and "vehicle" in vehicle:
        return model_from(vehicle, "vehicle")
    if isinstance(vehicle, str) and vehicle in vehicle_names():
        return vehicle_model(vehicle)
    return None if (file := table_file(vehicle)) is None else VehicleModel.load(file)


def vehicle_model_of(vehicle: Any) -> VehicleModel | None:
    """Return the vehicle model for an object, a name, a file, or a `Vehicle` with the parameters of a published one.

    None for anything else: then the limits and the lag of its actuators are not known.
    """
    published = (model for model in _published().values() if model.vehicle == vehicle)
    return next(published, None) or as_vehicle_model(vehicle)


def as_vehicle(vehicle: VehicleLike) -> Vehicle:
    """Return the vehicle for an object, a name, a file, or a dict of its parameters.

    Raises:
        ValueError: the vehicle is unknown, or a parameter is wrong.
    """
    if isinstance(vehicle, Vehicle):
        return vehicle
    if isinstance(vehicle, str) and vehicle in VEHICLES:
        return VEHICLES[vehicle]
    if (vehicle_model := as_vehicle_model(vehicle)) is not None:
        return vehicle_model.vehicle
    if isinstance(vehicle, Mapping):
        return from_record(Vehicle, vehicle, "vehicle")
    names, objects = list_vehicles(), "" if isinstance(vehicle, str) else "a Vehicle, a dict, "
    raise ValueError(
        f"unknown vehicle {vehicle!r}{meant(vehicle, names)}; allowed are {objects}a .toml file, or one of "
        + ", ".join(names)
    )

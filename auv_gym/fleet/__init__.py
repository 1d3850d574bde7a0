"""Published vehicles, a TOML file each, and how a scenario made for the paper's vehicle is made to fit another one.

A scenario fits another vehicle by dimensional analysis: lengths in it are multiplied by a factor of length, times by
one of time, speeds by their quotient, forces by what the vehicle's drag or actuators are beside those of the paper's
vehicle. What has no dimension stays. For the paper's vehicle every factor is 1.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Any

from auv_gym.actuators import Actuators
from auv_gym.disturbances import RandomMismatch, RandomWaves
from auv_gym.fleet.scaling import actuators_in, scaled, scaled_part
from auv_gym.intervals import Interval, check_number
from auv_gym.paths import Path
from auv_gym.records import from_record, read_table
from auv_gym.units import Units, in_paper_units
from auv_gym.vehicle import PAPER_VEHICLE, VEHICLES, Vehicle

if TYPE_CHECKING:
    from auv_gym.scenario import Scenario

FOLDER = FilePath(__file__).parent
MOST_SUBSTEPS = 64
"""Most integration steps in a control period that are tried for a vehicle."""


@dataclass(frozen=True)
class Craft:
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
    def in_paper_units(self) -> Craft:
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

    def adapted(self, scenario: Scenario) -> Scenario:
        """Return a scenario of the paper's vehicle as one of this vehicle; a path that is not drawn stays as it is.

        Raises:
            ValueError: paths are slower than its fins can steer it, or no integration step is short enough for it.
        """
        return _Fit(self).scenario(scenario)

    @classmethod
    def load(cls, file: str | FilePath) -> Craft:
        """Return the vehicle of a .toml or .json file.

        Raises:
            ValueError: the file is of another kind, is not valid, or has a wrong entry.
            OSError: the file cannot be read.
        """
        try:
            return from_record(cls, read_table(FilePath(file)), "vehicle file")
        except ValueError as error:
            raise ValueError(f"{file}: {error}") from error


PAPER = Craft(
    name="paper",
    about="the paper's vehicle",
    source="Repoulias and Papadopoulos 2005, see `auv_gym.vehicle.PAPER_VEHICLE`",
    left_out="",
    ours="limits, speed and lag",
    vehicle=PAPER_VEHICLE,
    actuators=Actuators(F_u_max=400.0, F_r_max=200.0),
    turn_rate=0.12,
    lag=0.2,
)
"""The vehicle that the presets are made for."""


@dataclass(frozen=True)
class _Fit:
    """The factors between the paper's vehicle and another one, and what they make of the parts of a scenario."""

    craft: Craft

    @property
    def units(self) -> Units:
        return Units.of(self.craft.vehicle)

    def scenario(self, scenario: Scenario) -> Scenario:
        length, time = self.units.length, self.units.time
        parts = "path", "start", "sensors", "current", "waves"
        changes = {name: self.part(name, getattr(scenario, name)) for name in parts}
        path: Any = changes["path"]
        if not isinstance(path, Path):
            path = replace(path, turn_rate=path.turn_rate * self.turn_rate)
            self.check_speed(path.speed, scenario.name)
        top = path.speed[1] if isinstance(path.speed, tuple) else path.speed
        changes |= {"path": path, "waves": self.waves(changes["waves"], top)}
        changes |= {"mismatch": self.mismatch(scenario.mismatch, top), "actuators": self.actuators(scenario.actuators)}
        return self.stepped(
            scenario,
            vehicle=self.craft.vehicle,
            control_dt=float(f"{scenario.control_dt * time:.2g}"),
            error_scale=scenario.error_scale * length,
            lost_distance=scenario.lost_distance * length,
            **changes,
        )

    def part(self, name: str, part: Any) -> Any:
        """Return a part of a scenario with its entries scaled by their dimensions."""
        return scaled_part(name, part, self.units)

    @property
    def turn_rate(self) -> float:
        """The factor of turn rates: one over time, or what the vehicle asks for."""
        own = self.craft.turn_rate
        return self.units.factor(time=-1) if own is None else own / 0.12

    def check_speed(self, speed: Interval, name: str) -> None:
        low = speed[0] if isinstance(speed, tuple) else speed
        if low < self.craft.slowest * (1 - 1e-9):
            raise ValueError(
                f"scenario {name!r} asks for {low:.3g} m/s of this vehicle, whose fins steer it from "
                f"{self.craft.slowest:g} m/s on; take a faster one, as those of the cruise regime"
            )

    def drag(self, top: float) -> tuple[float, float, float]:
        """Return the factors of the drag per velocity at the fastest speed [m/s] of a path."""
        mine, paper = self.craft.drag(top), PAPER.drag(0.0)
        return mine[0] / paper[0], mine[1] / paper[1], mine[2] / paper[2]

    def waves(self, waves: RandomWaves | None, top: float) -> RandomWaves | None:
        """Return waves whose forces are the same share of the drag, quadratic drag and lift included."""
        if waves is None:
            return None
        v, (d_u, d_v, d_r) = self.craft.vehicle, self.craft.drag(top)
        yaw = waves.yaw * d_r / v.d33 / self.units.length  # of d33 U / (1 m)
        return replace(waves, surge=waves.surge * d_u / v.d11, sway=waves.sway * d_v / v.d22, yaw=yaw)

    def mismatch(self, mismatch: RandomMismatch | None, top: float) -> RandomMismatch | None:
        """Return a mismatch that adds the same share of the drag as quadratic drag."""
        if mismatch is None:
            return None
        shares = zip(mismatch.quadratic_drag, self.drag(top), ((1, -1), (1, -1), (0, -1)), strict=True)
        X_uu, Y_vv, N_rr = (quadratic * drag / self.units.factor(*rate) for quadratic, drag, rate in shares)
        return replace(mismatch, quadratic_drag=(X_uu, Y_vv, N_rr))

    def actuators(self, given: Actuators) -> Actuators:
        """Return actuators with the same share of the vehicle's own limits, and of its own lag."""
        own, time = self.craft.actuators, self.units.time
        force, torque = (own.F_u_max / PAPER.actuators.F_u_max, own.F_r_max / PAPER.actuators.F_r_max)
        slow = time if self.craft.lag is None else self.craft.lag / 0.2
        return replace(
            given,
            F_u_max=given.F_u_max * force,
            F_r_max=given.F_r_max * torque,
            F_u_rate=given.F_u_rate * force / time,
            F_r_rate=given.F_r_rate * torque / time,
            lag=scaled(given.lag, slow),
            fin=own.fin,
            astern=own.astern,
        )

    def stepped(self, scenario: Scenario, **changes: Any) -> Scenario:
        """Return the scenario with these changes, and with as many integration steps as the vehicle needs."""
        substeps = scenario.substeps
        while True:
            try:
                return replace(scenario, substeps=substeps, **changes)
            except ValueError as error:
                if "raise substeps" not in str(error) or substeps >= MOST_SUBSTEPS:
                    raise
            substeps += 1


def fleet() -> list[str]:
    """Return the names of the published vehicles that have a file of their own."""
    return sorted(file.stem for file in FOLDER.glob("*.toml"))


def list_vehicles() -> list[str]:
    """Return the names that `gym.make(..., vehicle=NAME)` takes."""
    return [*VEHICLES, *fleet()]


@cache
def craft(name: str) -> Craft:
    """Return the vehicle of a name that `fleet` lists, or of a file.

    Raises:
        ValueError: there is no such vehicle, or its file is wrong.
        OSError: the file cannot be read.
    """
    return Craft.load(FOLDER / f"{name}.toml" if name in fleet() else name)


def as_craft(vehicle: Any) -> Craft | None:
    """Return the vehicle with all that belongs to it for an object, a name or a file; None for a hull alone."""
    if isinstance(vehicle, Craft):
        return vehicle
    named = isinstance(vehicle, str) and vehicle not in VEHICLES
    return craft(vehicle) if named and (vehicle in fleet() or vehicle.endswith((".toml", ".json"))) else None

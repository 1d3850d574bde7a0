"""A scenario for another vehicle: fitted to it by dimensional analysis, or seen in the vehicle's own units.

A scenario is made for the paper's vehicle. For another one its lengths are multiplied by a factor of length, times by
one of time, speeds by their quotient, forces by the ratio of drags or of actuator limits. Quantities without a
dimension stay. For the paper's vehicle every factor is 1.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from auv_gym.physics.actuators import Actuators
from auv_gym.physics.disturbances import RandomMismatch, RandomWaves
from auv_gym.physics.intervals import Interval, check_number
from auv_gym.physics.units import POWERS as UNITS
from auv_gym.physics.units import Units, in_paper_units
from auv_gym.physics.vehicle import Vehicle
from auv_gym.planning.paths import Path
from auv_gym.scenarios.scenario import Scenario
from auv_gym.scenarios.vehicles import PAPER, VehicleModel, as_vehicle, as_vehicle_model
from auv_gym.scenarios.vehicles.scaling import actuators_in, scaled, scaled_part

MOST_SUBSTEPS = 64
"""Largest number of integration steps in a control period that is tried for a vehicle."""


def changed(
    scenario: Scenario,
    vehicle: Vehicle | VehicleModel | str | Mapping[str, Any] | None = None,
    control_dt: float | None = None,
) -> Scenario:
    """Return a scenario with another known vehicle or control period.

    A vehicle with a file of its own brings its limits, speeds and clock, see `adapted`; a `Vehicle` or its dict changes
    nothing else. With another control period the duration stays the same.

    Args:
        scenario: the original.
        vehicle: an object, a dict, a name of `list_vehicles`, or a file; None keeps the scenario's vehicle.
        control_dt: control period [s]; None keeps the scenario's.

    Raises:
        ValueError: the vehicle is unknown, or the period is no number or longer than the episode.
    """
    if (vehicle_model := as_vehicle_model(vehicle)) is not None:
        scenario = replace(adapted(vehicle_model, scenario), name=f"{scenario.name}@{vehicle_model.name}")
    elif vehicle is not None:
        scenario = replace(scenario, vehicle=as_vehicle(vehicle))
    if control_dt is not None:
        check_number("control_dt", control_dt, 1e-3, min(10.0, scenario.duration))
        scenario = replace(scenario, control_dt=float(control_dt), steps=round(scenario.duration / control_dt))
    return scenario


def adapted(vehicle_model: VehicleModel, scenario: Scenario) -> Scenario:
    """Return a scenario of the paper's vehicle as one of another vehicle; a path that is not drawn stays as it is.

    Raises:
        ValueError: paths are slower than its fins can steer it, or no integration step is short enough for it.
    """
    return _Fit(vehicle_model).scenario(scenario)


@dataclass(frozen=True)
class _Fit:
    """The factors between the paper's vehicle and another one, and what they make of the parts of a scenario."""

    vehicle_model: VehicleModel

    @property
    def units(self) -> Units:
        return Units.of(self.vehicle_model.vehicle)

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
            vehicle=self.vehicle_model.vehicle,
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
        own = self.vehicle_model.turn_rate
        return self.units.factor(time=-1) if own is None else own / 0.12

    def check_speed(self, speed: Interval, name: str) -> None:
        low = speed[0] if isinstance(speed, tuple) else speed
        if low < self.vehicle_model.slowest * (1 - 1e-9):
            raise ValueError(
                f"scenario {name!r} asks for {low:.3g} m/s of this vehicle, whose fins steer it from "
                f"{self.vehicle_model.slowest:g} m/s on; take a faster one, as those of the cruise regime"
            )

    def drag(self, top: float) -> tuple[float, float, float]:
        """Return the factors of the drag per velocity at the fastest speed [m/s] of a path."""
        mine, paper = self.vehicle_model.drag(top), PAPER.drag(0.0)
        return mine[0] / paper[0], mine[1] / paper[1], mine[2] / paper[2]

    def waves(self, waves: RandomWaves | None, top: float) -> RandomWaves | None:
        """Return waves whose forces are the same share of the drag, quadratic drag and lift included."""
        if waves is None:
            return None
        v, (d_u, d_v, d_r) = self.vehicle_model.vehicle, self.vehicle_model.drag(top)
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
        own, time = self.vehicle_model.actuators, self.units.time
        force, torque = (own.F_u_max / PAPER.actuators.F_u_max, own.F_r_max / PAPER.actuators.F_r_max)
        slow = time if self.vehicle_model.lag is None else self.vehicle_model.lag / 0.2
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


def in_vehicle_units(scenario: Scenario) -> Scenario:
    """Return a scenario as it is in its vehicle's own units, which are the paper's for a vehicle like that one.

    Every episode drawn from it is the one drawn from the original, in other numbers; what has no dimension, such as an
    action, is the same. A scenario whose vehicle has the mass, length and design speed of the paper's is returned as it
    is.

    Raises:
        ValueError: its path is not drawn, so that it has no speed and turn rate to scale; or a number is out of bounds.
    """
    units = Units.of(scenario.vehicle)
    if units == Units():
        return scenario
    path: Any = scenario.path
    if isinstance(path, Path):
        raise ValueError(
            f"scenario {scenario.name!r} has one path of its own, which cannot be seen in the units of its vehicle; "
            "give it paths that are drawn: a path with speed and turn_rate"
        )
    back = Units(1 / units.length, 1 / units.time, 1 / units.mass)
    names = "start", "sensors", "current"
    changes = {name: scaled_part(name, getattr(scenario, name), back) for name in names}
    waves, mismatch = scaled_part("waves", scenario.waves, back), scenario.mismatch
    if waves is not None:
        waves = replace(waves, yaw=waves.yaw * units.length)  # of d33 U / (1 m)
    if mismatch is not None:
        dimensions = zip(mismatch.quadratic_drag, ("kg/m", "kg/m", "kg m^2"), strict=True)
        X_uu, Y_vv, N_rr = (drag / units.factor(*UNITS[unit]) for drag, unit in dimensions)
        mismatch = replace(mismatch, quadratic_drag=(X_uu, Y_vv, N_rr))
    return replace(
        scenario,
        path=replace(scaled_part("path", path, back), turn_rate=path.turn_rate * units.time),
        vehicle=in_paper_units(scenario.vehicle),
        waves=waves,
        mismatch=mismatch,
        actuators=actuators_in(units, scenario.actuators),
        control_dt=scenario.control_dt / units.time,
        error_scale=scenario.error_scale / units.length,
        lost_distance=scenario.lost_distance / units.length,
        **changes,
    )

"""Scenarios of other vehicles: a scenario adapted by dimensional analysis, or converted to the units of its vehicle.

The presets are made for the vehicle of the paper. For another vehicle lengths are multiplied by a factor of length,
times by one of time, speeds by their quotient, and forces by the ratio of drags or of actuator limits. Dimensionless
quantities do not change. For the vehicle of the paper all factors are 1.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from auv_gym.physics.actuators import Actuators
from auv_gym.physics.disturbances import RandomMismatch, RandomWaves
from auv_gym.physics.intervals import Interval, check_number
from auv_gym.physics.units import DIMENSIONS, Units, in_paper_units
from auv_gym.physics.units import POWERS as UNITS
from auv_gym.physics.vehicle import Vehicle
from auv_gym.planning.paths import Path
from auv_gym.scenarios.scenario import Scenario
from auv_gym.scenarios.vehicles import PAPER, PAPER_LAG, VehicleModel, as_vehicle, as_vehicle_model
from auv_gym.scenarios.vehicles.scaling import actuators_in, scaled, scaled_part

MOST_SUBSTEPS = 64
"""Largest number of integration steps per control period that is tried for a vehicle."""


def changed(
    scenario: Scenario,
    vehicle: Vehicle | VehicleModel | str | Mapping[str, Any] | None = None,
    control_dt: float | None = None,
) -> Scenario:
    """Return a scenario with another known vehicle or control period.

    A vehicle model or a vehicle file also changes actuators, speeds and times, see `adapted`; a `Vehicle` or a dict of
    its parameters changes nothing else. Another control period does not change the duration.

    Args:
        scenario: the original.
        vehicle: an object, a dict, a name of `list_vehicles`, or a file; None for that of the scenario.
        control_dt: control period [s]; None for that of the scenario.

    Raises:
        ValueError: the vehicle is unknown, or the period is not a number or longer than the episode.
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
    """Return a scenario for another vehicle, for one for the vehicle of the paper; a fixed path does not change.

    Raises:
        ValueError: paths are too slow for the fins of the vehicle, or no integration step is short enough.
    """
    return _Fit(vehicle_model).scenario(scenario)


@dataclass(frozen=True)
class _Fit:
    """The conversion of a scenario from the vehicle of the paper to another vehicle."""

    vehicle_model: VehicleModel

    @property
    def units(self) -> Units:
        return Units.of(self.vehicle_model.vehicle)

    def scenario(self, scenario: Scenario) -> Scenario:
        length, time = self.units.length, self.units.time
        parts = "path", "start", "sensors", "current", "waves", "faults"
        changes = {name: scaled_part(name, getattr(scenario, name), self.units) for name in parts}
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
            model=self.vehicle_model,
            control_dt=float(f"{scenario.control_dt * time:.2g}"),
            error_scale=scenario.error_scale * length,
            lost_distance=scenario.lost_distance * length,
            **changes,
        )

    @property
    def turn_rate(self) -> float:
        """The factor of turn rates: one over time, or that of the turn rate of the vehicle model."""
        own = self.vehicle_model.turn_rate
        return self.units.factor(time=-1) if own is None else own / 0.12

    def check_speed(self, speed: Interval, name: str) -> None:
        low = speed[0] if isinstance(speed, tuple) else speed
        if low < self.vehicle_model.slowest * (1 - 1e-9):
            raise ValueError(
                f"scenario {name!r} has speeds from {low:.3g} m/s, but the fins of this vehicle need at least "
                f"{self.vehicle_model.slowest:g} m/s; take a faster scenario, such as those of the range cruise"
            )

    def drag(self, top: float) -> tuple[float, float, float]:
        """Return the ratios of the drag per velocity to that of the paper, at the largest speed [m/s] of a path."""
        mine, paper = self.vehicle_model.drag(top), PAPER.drag(0.0)
        return mine[0] / paper[0], mine[1] / paper[1], mine[2] / paper[2]

    def waves(self, waves: RandomWaves | None, top: float) -> RandomWaves | None:
        """Return waves with the same ratio of forces to drag, including quadratic drag and lift."""
        if waves is None:
            return None
        v, (d_u, d_v, d_r) = self.vehicle_model.vehicle, self.vehicle_model.drag(top)
        yaw = waves.yaw * d_r / v.d33 / self.units.length  # of d33 U / (1 m)
        return replace(waves, surge=waves.surge * d_u / v.d11, sway=waves.sway * d_v / v.d22, yaw=yaw)

    def mismatch(self, mismatch: RandomMismatch | None, top: float) -> RandomMismatch | None:
        """Return a mismatch with the same ratio of quadratic drag to drag."""
        if mismatch is None:
            return None
        if mismatch.vehicles:
            raise ValueError("a scenario with an ensemble of vehicles is for its own vehicle; take one without")
        shares = zip(mismatch.quadratic_drag, self.drag(top), ((1, -1), (1, -1), (0, -1)), strict=True)
        X_uu, Y_vv, N_rr = (quadratic * drag / self.units.factor(*rate) for quadratic, drag, rate in shares)
        return replace(mismatch, quadratic_drag=(X_uu, Y_vv, N_rr))

    def actuators(self, given: Actuators) -> Actuators:
        """Return actuators with the same ratios to the limits and the lag of the vehicle."""
        own, time = self.vehicle_model.actuators, self.units.time
        force, torque = (own.F_u_max / PAPER.actuators.F_u_max, own.F_r_max / PAPER.actuators.F_r_max)
        slow = time if self.vehicle_model.lag is None else self.vehicle_model.lag / PAPER_LAG
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
        """Return the scenario with these changes and the smallest sufficient number of integration steps."""
        substeps = scenario.substeps
        while True:
            try:
                return replace(scenario, substeps=substeps, **changes)
            except ValueError as error:
                if "raise substeps" not in str(error) or substeps >= MOST_SUBSTEPS:
                    raise
            substeps += 1


def in_vehicle_units(scenario: Scenario) -> Scenario:
    """Return a scenario in units in which mass, length and design speed of its vehicle are those of the paper.

    The same random numbers give the same episodes in these units. Dimensionless quantities, such as actions, do not
    change. If the vehicle has the mass, length and design speed of the paper, the scenario is returned.

    Raises:
        ValueError: its path is fixed, so it has no turn rate to scale; or a number is out of bounds.
    """
    units = Units.of(scenario.vehicle)
    if units == Units():
        return scenario
    path: Any = scenario.path
    if isinstance(path, Path):
        raise ValueError(
            f"scenario {scenario.name!r} has a fixed path, which cannot be converted to the units of its vehicle; "
            "give it random paths: a path with speed and turn_rate"
        )
    back = Units(1 / units.length, 1 / units.time, 1 / units.mass)
    names = "start", "sensors", "current", "faults"
    changes = {name: scaled_part(name, getattr(scenario, name), back) for name in names}
    waves, mismatch = scaled_part("waves", scenario.waves, back), scenario.mismatch
    if waves is not None:
        waves = replace(waves, yaw=waves.yaw * units.length)  # of d33 U / (1 m)
    if mismatch is not None:
        dimensions = zip(mismatch.quadratic_drag, ("kg/m", "kg/m", "kg m^2"), strict=True)
        X_uu, Y_vv, N_rr = (drag / units.factor(*UNITS[unit]) for drag, unit in dimensions)
        dims = [units.factor(*UNITS[unit]) for unit in DIMENSIONS.values()]
        rows = tuple(tuple(x / d for x, d in zip(row, dims, strict=False)) for row in mismatch.vehicles)
        mismatch = replace(mismatch, quadratic_drag=(X_uu, Y_vv, N_rr), vehicles=rows)
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

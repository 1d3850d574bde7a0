"""Scenarios of other vehicles: a scenario adapted by dimensional analysis, or converted to the units of its vehicle.

The presets are made for the vehicle of the paper. For another vehicle lengths are multiplied by a factor of length,
times by one of time, speeds by their quotient, and forces by the ratio of drags or of actuator limits. Dimensionless
quantities do not change. For the vehicle of the paper all factors are 1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from auv_gym.effects.actuators import Actuators
from auv_gym.effects.current import RandomCurrent
from auv_gym.effects.mismatch import RandomMismatch
from auv_gym.effects.sensors import NOISES
from auv_gym.physics.intervals import Interval, check_number
from auv_gym.physics.intervals import times as scaled
from auv_gym.physics.units import DIMENSIONS, Units, in_paper_units
from auv_gym.physics.units import POWERS as UNITS
from auv_gym.physics.vehicle import PAPER_VEHICLE, Vehicle
from auv_gym.planning.paths import Path
from auv_gym.scenarios.scenario import Scenario
from auv_gym.scenarios.vehicles import (
    PAPER,
    PAPER_LAG,
    PAPER_TURN_RATE,
    VehicleLike,
    VehicleModel,
    as_vehicle,
    as_vehicle_model,
)
from auv_gym.scenarios.vehicles.scaling import actuators_in, scaled_part

MOST_SUBSTEPS = 64
"""Largest number of integration steps per control period that is chosen for a vehicle."""
FIN_WAVES = 0.25
"""Largest RMS yaw moment of waves in an adapted scenario, as a share of the torque of full fins at the path speed."""
FIN_SURGE = 0.8
"""Least initial surge velocity of a vehicle with fins in an adapted scenario, as a share of that of the reference: at
0.3 of it fins have a tenth of their torque."""
FIN_OFFSETS = 0.25
"""Factor of the initial errors of a vehicle with fins in an adapted scenario, on top of the scale of lengths."""


def changed(
    scenario: Scenario,
    vehicle: VehicleLike | None = None,
    control_dt: float | None = None,
) -> Scenario:
    """Return a scenario with another known vehicle or control period.

    A vehicle model, a vehicle file or a name also changes actuators, speeds and times, see `adapted`; a `Vehicle` or a
    dict of its parameters changes nothing of them. Another control period does not change the duration. The substeps
    are raised to what the integration needs, and the mismatch of m22/m11 is cut to what the vehicle allows.

    Args:
        scenario: the original.
        vehicle: an object, a dict, a name of `list_vehicles`, or a file; None for that of the scenario.
        control_dt: control period [s]; None for that of the scenario.

    Raises:
        ValueError: the vehicle is unknown, the scenario has its own vehicle and is to be adapted to another one, the
            period is not a number or longer than the episode, or no integration step is short enough.
    """
    if isinstance(vehicle, str):
        check_adaptable(scenario)
    if (vehicle_model := as_vehicle_model(vehicle)) is not None:
        scenario = replace(adapted(vehicle_model, scenario), name=f"{scenario.name}@{vehicle_model.name}")
    elif vehicle is not None:
        known = as_vehicle(vehicle)
        scenario = _integrable(scenario, vehicle=known, mismatch=scenario.mismatch and scenario.mismatch.cut(known))
        if isinstance(vehicle, str):
            scenario = replace(scenario, name=f"{scenario.name}@{vehicle}")
    if control_dt is not None:
        control_dt = control_dt.item() if isinstance(control_dt, np.generic) else control_dt
        check_number("control_dt", control_dt, 1e-3, min(10.0, scenario.duration))
        steps = round(scenario.duration / control_dt)
        scenario = _integrable(scenario, control_dt=float(control_dt), steps=steps)
    return scenario


@dataclass(frozen=True)
class Sea:
    """Current and waves in place of those of scenarios.

    Raises:
        ValueError: a number is out of bounds.
    """

    current: tuple[float, float] | None = None  # [m/s] least and largest mean speed; None: that of each scenario
    waves: float | None = None  # factor of the forces of the waves; None: 1

    def __post_init__(self) -> None:
        RandomCurrent(self.current or 0.0)  # raises
        if self.waves is not None:
            check_number("waves", self.waves, 0, 10)

    def of(self, scenario: Scenario) -> Scenario:
        """Return a scenario in this sea, with "-sea" in its name; unchanged if both entries are None.

        Every scenario has the current, in random directions, and is not limited by its `cap`. Gusts and shear, which
        are shares of the path speed, keep their speeds at the mean path speed. Waves act where the scenario has waves.
        """
        if self == Sea():
            return scenario
        name, at, vehicle = scenario.name.partition("@")
        current, waves, speed = scenario.current or RandomCurrent(), scenario.waves, scenario.path.speed
        if self.current is not None:
            unit = (sum(speed) / 2 if isinstance(speed, tuple) else speed) if current.relative else 1.0
            gust, shear = current.gust * unit, scaled(current.shear, unit)
            current = replace(current, speed=self.current, relative=False, cap=math.inf, gust=gust, shear=shear)
        if waves is not None and self.waves is not None:
            forces = {axis: getattr(waves, axis) * self.waves for axis in ("surge", "sway", "yaw", "most_yaw")}
            waves = replace(waves, **forces) if self.waves else None
        none = self.current == (0.0, 0.0) or (self.current is None and scenario.current is None)
        return _integrable(scenario, name=f"{name}-sea{at}{vehicle}", current=None if none else current, waves=waves)

    def in_paper_units(self, vehicle: Vehicle) -> Sea:
        """Return the sea in units in which mass, length and design speed of a vehicle are those of the paper."""
        speed = Units.of(vehicle).factor(length=1, time=-1)
        return replace(self, current=self.current and (self.current[0] / speed, self.current[1] / speed))


def check_adaptable(scenario: Scenario) -> None:
    """Raise ValueError if a scenario is not for the vehicle of the paper, so that scaling it has no meaning."""
    if scenario.known_plane not in (PAPER_VEHICLE, PAPER):
        raise ValueError(
            f"scenario {scenario.name!r} has its own vehicle, so it cannot be adapted to another one; leave out the "
            "vehicle, or use a scenario of the paper's vehicle"
        )


def _integrable(scenario: Scenario, **changes: Any) -> Scenario:
    """Return a scenario with changes, and with the substeps that they need, at most `MOST_SUBSTEPS`."""
    most = replace(scenario, substeps=max(scenario.substeps, MOST_SUBSTEPS), **changes)
    return replace(most, substeps=max(scenario.substeps, most.least_substeps))


def adapted(vehicle_model: VehicleModel, scenario: Scenario) -> Scenario:
    """Return a scenario for another vehicle, for one for the vehicle of the paper; a fixed path does not change.

    For a vehicle with fins waves are limited by `FIN_WAVES`, and it starts nearer to the reference, see `FIN_SURGE` and
    `FIN_OFFSETS`.

    Raises:
        ValueError: see `check_adaptable`; paths are too slow for the fins, or no integration step is short enough.
    """
    check_adaptable(scenario)
    units, v = Units.of(vehicle_model.vehicle), vehicle_model.vehicle
    parts = "path", "start", "sensors", "current", "waves", "faults"
    changes = {name: scaled_part(name, getattr(scenario, name), units) for name in parts}
    path, waves, own = changes["path"], changes["waves"], vehicle_model.sensors
    if own is not None:  # where the scenario has noise at all
        given = {name: getattr(own, name) for name in NOISES if getattr(scenario.sensors, name)}
        changes["sensors"] = replace(changes["sensors"], **{name: x for name, x in given.items() if x is not None})
    if not isinstance(path, Path):
        turn_rate = (
            units.factor(time=-1) if vehicle_model.turn_rate is None else vehicle_model.turn_rate / PAPER_TURN_RATE
        )
        changes["path"] = path = replace(path, turn_rate=path.turn_rate * turn_rate)
        low = path.speed[0] if isinstance(path.speed, tuple) else path.speed
        if low < vehicle_model.slowest * (1 - 1e-9):
            raise ValueError(
                f"scenario {scenario.name!r} has speeds from {low:.3g} m/s, but the fins of this vehicle need at least "
                f"{vehicle_model.slowest:g} m/s; take a faster scenario, such as those of the range cruise"
            )
    fastest = path.speed[1] if isinstance(path.speed, tuple) else path.speed
    drag, actuators = vehicle_model.drag(fastest), _adapted_actuators(scenario.actuators, vehicle_model, units)
    if waves is not None:  # the same ratio of forces to drag, including quadratic drag and lift
        surge, sway, yaw = waves.surge * drag[0] / v.d11, waves.sway * drag[1] / v.d22, waves.yaw * drag[2] / v.d33
        most = FIN_WAVES * min(actuators.fin, actuators.F_r_max / fastest**2) if actuators.fin else math.inf
        changes["waves"] = replace(
            waves, surge=surge, sway=sway, yaw=yaw / units.length, most_yaw=min(waves.most_yaw, most)
        )  # yaw is of d33 U / (1 m)
    if scenario.vertical is not None:
        if vehicle_model.surface:
            raise ValueError(f"{vehicle_model.name} is a surface vessel: scenarios in space are for vehicles that dive")
        changes["vertical"] = scenario.vertical.scaled(units, vehicle_model.pitch)
    if actuators.fin:
        start = changes["start"]
        errors = {name: scaled(getattr(start, name), FIN_OFFSETS) for name in ("x_e", "y_e", "psi_e")}
        changes["start"] = replace(start, **errors, surge=_at_least(FIN_SURGE, start.surge))
        if (vertical := changes.get("vertical")) is not None:
            errors = {name: scaled(getattr(vertical, name), FIN_OFFSETS) for name in ("z_e", "theta_e")}
            changes["vertical"] = replace(vertical, **errors)
    return _integrable(
        scenario,
        vehicle=v,
        model=vehicle_model,
        control_dt=float(f"{scenario.control_dt * units.time:.2g}"),
        error_scale=scenario.error_scale * units.length,
        lost_distance=scenario.lost_distance * units.length,
        mismatch=_adapted_mismatch(scenario.mismatch, drag, units, v),
        actuators=actuators,
        effects=tuple(one.scaled(units) for one in scenario.effects),
        **changes,
    )


def _at_least(least: float, value: Interval) -> Interval:
    """Return a number, or both ends of an interval, raised to a least value."""
    return (max(value[0], least), max(value[1], least)) if isinstance(value, tuple) else max(value, least)


def _adapted_mismatch(
    mismatch: RandomMismatch | None, drag: tuple[float, float, float], units: Units, vehicle: Vehicle
) -> RandomMismatch | None:
    """Return a mismatch with the same ratio of quadratic drag to drag, for the drag over velocity of a vehicle."""
    if mismatch is None:
        return None
    if mismatch.vehicles:
        raise ValueError("a scenario with an ensemble of vehicles is for its own vehicle; take one without")
    shares = zip(mismatch.quadratic_drag, drag, PAPER.drag(0.0), ((1, -1), (1, -1), (0, -1)), strict=True)
    X_uu, Y_vv, N_rr = (q * (mine / paper) / units.factor(*rate) for q, mine, paper, rate in shares)
    return replace(mismatch, quadratic_drag=(X_uu, Y_vv, N_rr)).cut(vehicle)


def _adapted_actuators(actuators: Actuators, vehicle_model: VehicleModel, units: Units) -> Actuators:
    """Return actuators with the same ratios to the limits and the lag of the vehicle."""
    limits, time = vehicle_model.actuators, units.time
    force, torque = limits.F_u_max / PAPER.actuators.F_u_max, limits.F_r_max / PAPER.actuators.F_r_max
    return replace(
        actuators,
        F_u_max=actuators.F_u_max * force,
        F_r_max=actuators.F_r_max * torque,
        F_u_rate=actuators.F_u_rate * force / time,
        F_r_rate=actuators.F_r_rate * torque / time,
        lag=scaled(actuators.lag, time if vehicle_model.lag is None else vehicle_model.lag / PAPER_LAG),
        fin=limits.fin,
        astern=limits.astern,
    )


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
    if scenario.vertical is not None:
        changes["vertical"] = scenario.vertical.scaled(back, scenario.vertical.pitch.over(units))
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
        model=scenario.model and scenario.model.in_paper_units,
        waves=waves,
        mismatch=mismatch,
        actuators=actuators_in(units, scenario.actuators),
        effects=tuple(one.scaled(back) for one in scenario.effects),
        control_dt=scenario.control_dt / units.time,
        error_scale=scenario.error_scale / units.length,
        lost_distance=scenario.lost_distance / units.length,
        **changes,
    )

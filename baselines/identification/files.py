"""An identified vehicle as files: its parameters, and a scenario that evaluations and trainings take."""

from __future__ import annotations

import inspect
import json
import math
import re
from functools import cache
from typing import Any

import numpy as np
import tomli_w

from auv_gym.physics.actuators import Actuators
from auv_gym.physics.sensors import Sensors
from auv_gym.physics.stiffness import MAX_STIFFNESS, fastest_rate
from auv_gym.physics.vehicle import Vehicle
from auv_gym.scenarios.scenario import RandomPath, Scenario
from baselines.identification import Identified, ParameterEstimate
from baselines.identification.fit import UNKNOWN
from baselines.identification.model import COEFFICIENTS, CURRENT_NAMES, LIMIT_NAMES

_TURN = 0.3  # turn rate of a scenario's paths, as a share of the log's root mean square


@cache
def meanings() -> dict[str, tuple[str, str]]:
    """Return unit and meaning of each parameter that is fitted; those of the vehicle stand beside its fields."""
    found = {
        m[1]: (m[2], m[3])
        for m in re.finditer(r"^    (\w+): float.*?# \[(.*?)\] (.*)$", inspect.getsource(Vehicle), re.MULTILINE)
    }
    found |= {name: ("N" if name == "F_u_max" else "N m", "limit of the actuator") for name in LIMIT_NAMES}
    found |= dict.fromkeys(CURRENT_NAMES, ("m/s", "current while the log was taken"))
    return found | {"lag": ("s", "time constant of both actuators")}


def number(value: float) -> str:
    """Return a number with five digits."""
    return f"{value:.5g}" if math.isfinite(value) else "-"


def interval(estimate: ParameterEstimate) -> str:
    """Return an interval, with words for an end that is open."""
    if estimate.verdict == UNKNOWN:
        return "-"
    if math.isinf(estimate.high):
        return f"above {number(estimate.low)}"
    return f"{number(estimate.low)} ... {number(estimate.high)}"


def vehicle_text(found: Identified, vehicle: Vehicle, log: str) -> str:
    """Return vehicle.toml, a file of `auv_gym.scenarios.vehicles.VehicleModel`, with intervals as comments.

    Args:
        found: the fit.
        vehicle: that was fitted.
        log: name of the log.
    """
    missing = ", ".join(found.unknown) or "nothing"
    lines = [
        'name = "identified"',
        f"about = {json.dumps(f'a vehicle fitted to the log {log}')}",
        'source = "auv-gym identify; 95 % intervals stand behind the values"',
        f"left_out = {json.dumps(f'rate limits, delay; not from the log: {missing}')}",
        'ours = "the speed, the mean of the log"',
    ]
    if found["lag"].value > 0:
        lines.append(f"lag = {found['lag'].value:.6g}  # [s] {interval(found['lag'])}")
    lines.append("\n[vehicle]")
    for name in COEFFICIENTS:
        estimate, value = found[name], getattr(vehicle, name)
        known = "not from the log" if estimate.verdict == UNKNOWN else interval(estimate)
        if value or estimate.verdict != UNKNOWN:
            lines.append(f"{name} = {float(f'{value:.6g}')!r}  # [{meanings()[name][0]}] {known}")
    lines.append(f"speed = {vehicle.speed:.6g}  # [m/s]")
    lines.append("\n[actuators]")
    for name, limit in zip(LIMIT_NAMES, _limits(found), strict=True):
        lines.append(f"{name} = {limit:.6g}  # [{meanings()[name][0]}] {interval(found[name])}")
    return "\n".join(lines) + "\n"


def _limits(found: Identified) -> tuple[float, float]:
    """Return the limits [N], [N m] that were found, or the largest commands where none was reached."""
    peaks = np.abs(found.model.log.commands).max(axis=0).tolist()
    F_u, F_r = (min(found[name].value, peak) for name, peak in zip(LIMIT_NAMES, peaks, strict=True))
    return F_u or F_r, F_r or F_u  # what was never commanded has no limit to know


def scenario(found: Identified, vehicle: Vehicle) -> Scenario:
    """Return a scenario with the vehicle, its actuators and its sensors, at speeds and turns like those of the log.

    Raises:
        ValueError: a limit or a speed is outside of what scenarios have.
    """
    log = found.model.log
    F_u_max, F_r_max = _limits(found)
    speed = vehicle.speed
    turn = _TURN * float(np.sqrt(np.mean(log.measured[:, 5] ** 2)))
    x, y, psi, u, v, r = found.noise.tolist()
    parts: dict[str, Any] = {
        "name": "identified",
        "path": RandomPath(speed=(0.5 * speed, speed), turn_rate=turn),
        "vehicle": vehicle,
        "actuators": Actuators(F_u_max, F_r_max, lag=found["lag"].value),
        "sensors": Sensors(max(x, y), psi, max(u, v), r),
        "steps": 600,
    }
    rate = float(fastest_rate(vehicle.coefficients, (F_u_max, 0.0, F_r_max)))
    return Scenario(**parts, substeps=max(1, math.ceil(Scenario.control_dt * rate / MAX_STIFFNESS)))


def scenario_text(found: Identified, vehicle: Vehicle) -> str:
    """Return scenario.toml; raises as `scenario`."""
    return tomli_w.dumps(scenario(found, vehicle).to_dict())

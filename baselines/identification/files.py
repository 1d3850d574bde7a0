"""The file of an identified vehicle, vehicle.toml, and its scenario."""

from __future__ import annotations

import inspect
import json
import math
import re
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np

from auv_gym.effects.actuators import Actuators
from auv_gym.effects.mismatch import RandomMismatch
from auv_gym.effects.sensors import NoiseLevels, Sensors
from auv_gym.physics.namespaces import ARRAYS
from auv_gym.physics.steering import Stern
from auv_gym.physics.stiffness import MAX_STIFFNESS, fastest_rate
from auv_gym.physics.vehicle import Vehicle
from auv_gym.scenarios.scenario import RandomPath, Scenario
from baselines.identification import Identified, ParameterEstimate
from baselines.identification.fit import LEFT_OUT, UNKNOWN
from baselines.identification.model import (
    AHEAD,
    COEFFICIENTS,
    CURRENT_NAMES,
    LIMIT_NAMES,
    STERN_NAMES,
    WindDrag,
    load_of,
)

_TURN = 0.3  # turn rate of the scenario's paths, as a share of the root mean square yaw rate of the log

_INVALID = "; model misfit: they are not valid"


@cache
def meanings() -> dict[str, tuple[str, str]]:
    """Return unit and meaning of each parameter, by the comments beside the fields of the classes."""
    texts: dict[str, tuple[str, str]] = {}
    for parts in (Vehicle, Stern, WindDrag):
        matches = re.finditer(
            r"^    (\w+): (?:float|Number).*?# \[(.*?)\] (.*)$", inspect.getsource(parts), re.MULTILINE
        )
        texts |= {m[1]: (m[2], m[3]) for m in matches}
    texts |= {name: ("N" if name == "F_u_max" else "N m", "limit of the actuator") for name in LIMIT_NAMES}
    texts |= dict.fromkeys(CURRENT_NAMES, ("m/s", "current during the log"))
    texts[AHEAD] = "m", "distance of the origin of the equations ahead of the measured point"
    return texts | {"lag": ("s", "time constant of both actuators")}


def number(value: float) -> str:
    """Return a number with five digits as text, "-" if it is not finite."""
    return f"{value:.5g}" if math.isfinite(value) else "-"


def interval(estimate: ParameterEstimate) -> str:
    """Return the interval of an estimate as text."""
    if estimate.verdict == UNKNOWN:
        return "-"
    if math.isinf(estimate.high):
        return f"above {number(estimate.low)}"
    return f"{number(estimate.low)} ... {number(estimate.high)}"


def vehicle_text(identified: Identified, vehicle: Vehicle, limits: tuple[float, float], log: str) -> str:
    """Return vehicle.toml, the file of a `auv_gym.scenarios.vehicles.VehicleModel`, with intervals as comments.

    Args:
        identified: the result of the identification.
        vehicle: the fitted vehicle.
        limits: of the actuators, see `limits_of`.
        log: name of the log.
    """

    def line(name: str, value: float, note: str) -> str:
        return f"{name} = {float(f'{value:.6g}')!r}  # [{meanings()[name][0]}] {note}"

    kind, about = identified.model.log.kind, f"a vehicle fitted to the log {log}"
    left_out = "rate limits, delay" if kind == "force" else "wind; in environments, drag of the rudder"
    left_out += f"; not from the log: {', '.join(identified.unknown) or 'nothing'}"
    lines = [
        'name = "identified"',
        f"about = {json.dumps(about, ensure_ascii=False)}",
        f'source = "auv-gym identify; 95 % intervals stand behind the values{_INVALID if identified.misfit else ""}"',
        f'left_out = "{left_out}"',
        'assumed = "the speed, the mean of the log"',
    ]
    if identified["lag"].value > 0:
        lines.append(line("lag", identified["lag"].value, interval(identified["lag"])))
    lines.append("\n[vehicle]")
    for name in COEFFICIENTS:
        estimate, value = identified[name], getattr(vehicle, name)
        if value or estimate.verdict not in (UNKNOWN, LEFT_OUT):
            lines.append(line(name, value, "not from the log" if estimate.verdict == UNKNOWN else interval(estimate)))
    if vehicle.eps:
        lines.append(line("eps", vehicle.eps, "m33 / (m22 arm)"))
    lines += [line("speed", vehicle.speed, "mean of the log"), "\n[actuators]"]
    peaks = np.abs(identified.model.log.commands).max(axis=0).tolist()
    for name, limit, peak in zip(LIMIT_NAMES, limits, peaks, strict=True):
        note = interval(identified[name]) if kind == "force" else "the largest of the log"
        lines.append(line(name, limit, note if peak else "not from the log"))
    levels = zip(vars(noise_levels(identified)).items(), ("m", "rad", "m/s", "rad/s"), strict=True)
    lines += ["\n[sensors]", *(f"{name} = {x:.3g}  # [{unit}] noise of the log" for (name, x), unit in levels)]
    if kind != "force":
        shaft = ["[shaft]"]
        most = zip(("n_max", "angle_max"), peaks, ("1/s", "rad"), strict=True)
        shaft += [f"{name} = {peak:.6g}  # [{unit}] the largest of the log" for name, peak, unit in most if peak]
        shaft += [line(name, identified[name].value, interval(identified[name])) for name in STERN_NAMES[kind]]
        mark = "" if kind == "revolutions" else "# "  # a shaft needs a propeller curve
        lines += ["", *(f"{mark}{text}" for text in shaft)]
    return "\n".join(lines) + "\n"


def noise_levels(identified: Identified) -> NoiseLevels:
    """Return the standard deviations of the noise of the log."""
    x, y, psi, u, v, r = identified.noise.tolist()
    return NoiseLevels(max(x, y), psi, max(u, v), r)


def limits_of(identified: Identified, like: Actuators | None = None) -> tuple[float, float]:
    """Return the identified limits [N], [N m], or the largest commands if a limit was not reached.

    Args:
        identified: the result of the identification.
        like: actuators whose limits replace those that were never commanded.

    Raises:
        ValueError: an actuator was never commanded, and `like` is None.
    """
    log = identified.model.log
    if log.kind == "force":
        peaks = np.abs(log.commands).max(axis=0).tolist()
        F_u, F_r = (min(identified[name].value, peak) for name, peak in zip(LIMIT_NAMES, peaks, strict=True))
    else:
        values = dict(zip(identified.model.names, identified.values, strict=True))
        X, _, N = load_of(log.kind, log.commands.T, tuple(log.measured.T), values, ARRAYS)
        F_u, F_r = float(np.abs(X).max()), float(np.abs(N).max())
    for name, limit in zip(LIMIT_NAMES, (F_u, F_r), strict=True):
        if limit == 0 and like is None:
            raise ValueError(f"{name.removesuffix('_max')} is never commanded, so the log shows no limit of it")
    return F_u or like.F_u_max, F_r or like.F_r_max  # type: ignore[union-attr]


def scenario(
    identified: Identified, vehicle: Vehicle, limits: tuple[float, float], ensemble: Sequence[Vehicle] = ()
) -> Scenario:
    """Return a scenario with the vehicle, its actuators and sensors, and paths with the speeds and turns of the log.

    Args:
        identified: the result of the identification.
        vehicle: the fitted vehicle.
        limits: of the actuators, see `limits_of`.
        ensemble: vehicles from which the true vehicle of each episode is drawn; empty: always the fitted one.

    Raises:
        ValueError: a limit or a speed is outside the range of scenarios.
    """
    (F_u_max, F_r_max), speed = limits, vehicle.speed
    turn = _TURN * float(np.sqrt(np.mean(identified.model.log.measured[:, 5] ** 2)))
    parts: dict[str, Any] = {
        "name": "identified",
        "path": RandomPath(speed=(0.5 * speed, speed), turn_rate=turn),
        "vehicle": vehicle,
        "actuators": Actuators(F_u_max, F_r_max, lag=identified["lag"].value),
        "sensors": Sensors(**vars(noise_levels(identified))),
        "steps": 600,
    }
    rows = tuple(one.all_coefficients for one in (ensemble or (vehicle,)))
    rate = max(float(fastest_rate(row, (F_u_max, 0.0, F_r_max))) for row in rows)
    if ensemble:
        parts["mismatch"] = RandomMismatch(vehicles=rows)
    return Scenario(**parts, substeps=max(1, math.ceil(Scenario.control_dt * rate / MAX_STIFFNESS)))

"""An identified vehicle as files: its parameters, and a scenario that evaluations and trainings take."""

from __future__ import annotations

import inspect
import json
import math
import re
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
import tomli_w

from auv_gym.physics.actuators import Actuators
from auv_gym.physics.disturbances import RandomMismatch
from auv_gym.physics.namespaces import ARRAYS
from auv_gym.physics.sensors import Sensors
from auv_gym.physics.steering import Stern, stern_load, thrust
from auv_gym.physics.stiffness import MAX_STIFFNESS, fastest_rate
from auv_gym.physics.vehicle import Vehicle
from auv_gym.physics.wind import WindDrag
from auv_gym.scenarios.scenario import RandomPath, Scenario
from baselines.identification import Identified, ParameterEstimate
from baselines.identification.fit import UNKNOWN
from baselines.identification.model import AHEAD, COEFFICIENTS, CURRENT_NAMES, LIMIT_NAMES, STERN_NAMES

_TURN = 0.3  # turn rate of a scenario's paths, as a share of the log's root mean square


@cache
def meanings() -> dict[str, tuple[str, str]]:
    """Return unit and meaning of each parameter that is fitted; those of the vehicle stand beside its fields."""
    found = {
        m[1]: (m[2], m[3])
        for m in re.finditer(r"^    (\w+): float.*?# \[(.*?)\] (.*)$", inspect.getsource(Vehicle), re.MULTILINE)
    }
    for parts in (Stern, WindDrag):
        of = re.finditer(r"^    (\w+): Number  # \[(.*?)\] (.*)$", inspect.getsource(parts), re.MULTILINE)
        found |= {m[1]: (m[2], m[3]) for m in of}
    found |= {name: ("N" if name == "F_u_max" else "N m", "limit of the actuator") for name in LIMIT_NAMES}
    found |= dict.fromkeys(CURRENT_NAMES, ("m/s", "current while the log was taken"))
    found[AHEAD] = "m", "how far the origin of the equations lies ahead of the point that the log measures"
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


def vehicle_text(found: Identified, vehicle: Vehicle, log: str, like: Actuators | None = None) -> str:
    """Return vehicle.toml, a file of `auv_gym.scenarios.vehicles.VehicleModel`, with intervals as comments.

    Args:
        found: the fit.
        vehicle: that was fitted.
        log: name of the log.
        like: actuators to take limits from that the log does not show.

    Raises:
        ValueError: an actuator was never commanded, and no other is given.
    """
    missing = ", ".join(found.unknown) or "nothing"
    kind = found.model.log.kind
    left_out = "rate limits, delay" if kind == "force" else "wind; in environments, drag of the rudder"
    lines = [
        'name = "identified"',
        f"about = {_quoted(f'a vehicle fitted to the log {log}')}",
        'source = "auv-gym identify; 95 % intervals stand behind the values"',
        f"left_out = {_quoted(f'{left_out}; not from the log: {missing}')}",
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
    if vehicle.eps:
        lines.append(f"eps = {float(f'{vehicle.eps:.6g}')!r}  # [m] m33 / (m22 arm)")
    lines.append(f"speed = {vehicle.speed:.6g}  # [m/s]")
    lines.append("\n[actuators]")
    peaks = np.abs(found.model.log.commands).max(axis=0).tolist()
    for name, limit, peak in zip(LIMIT_NAMES, _limits(found, like), peaks, strict=True):
        known = interval(found[name]) if kind == "force" else "the largest of the log"
        known = known if peak else "not from the log"
        lines.append(f"{name} = {limit:.6g}  # [{meanings()[name][0]}] {known}")
    if kind != "force":
        mark = "" if kind == "revolutions" else "# "  # without a propeller curve it is no shaft
        lines.append(f"\n{mark}[shaft]")
        most = zip(("n_max", "angle_max"), peaks, ("1/s", "rad"), strict=True)
        lines += [f"{mark}{name} = {peak:.6g}  # [{unit}] the largest of the log" for name, peak, unit in most if peak]
        own = [found[name] for name in STERN_NAMES[kind]]
        lines += [f"{mark}{e.name} = {e.value:.6g}  # [{meanings()[e.name][0]}] {interval(e)}" for e in own]
    return "\n".join(lines) + "\n"


def _quoted(text: str) -> str:
    """Return a text as a string of TOML."""
    return json.dumps(text, ensure_ascii=False)


def _limits(found: Identified, like: Actuators | None = None) -> tuple[float, float]:
    """Return the limits [N], [N m] that were found, or the largest commands where none was reached.

    Raises:
        ValueError: one of them was never commanded, and no other actuators are given.
    """
    log = found.model.log
    if log.kind == "force":
        peaks = np.abs(log.commands).max(axis=0).tolist()
        F_u, F_r = (min(found[name].value, peak) for name, peak in zip(LIMIT_NAMES, peaks, strict=True))
    else:
        stern = Stern(*(dict(zip(found.model.names, found.values, strict=True)).get(n, 0.0) for n in Stern._fields))
        one, angle = log.commands.T
        u, v, r = log.measured[:, 3:].T
        T = thrust(one, u, stern) if log.kind == "revolutions" else one
        X, _, N = stern_load(T, angle, u, v, r, stern, ARRAYS)
        F_u, F_r = float(np.abs(X).max()), float(np.abs(N).max())
    for name, limit in zip(LIMIT_NAMES, (F_u, F_r), strict=True):
        if limit == 0 and like is None:
            raise ValueError(f"{name.removesuffix('_max')} is never commanded, so the log shows no limit of it")
    return F_u or like.F_u_max, F_r or like.F_r_max  # type: ignore[union-attr]


def scenario(
    found: Identified, vehicle: Vehicle, like: Actuators | None = None, ensemble: Sequence[Vehicle] = ()
) -> Scenario:
    """Return a scenario with the vehicle, its actuators and its sensors, at speeds and turns like those of the log.

    With an ensemble the true vehicle of each episode is one of it.

    Raises:
        ValueError: a limit or a speed is outside of what scenarios have, or a limit is not known.
    """
    log = found.model.log
    F_u_max, F_r_max = _limits(found, like)
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
    rows = tuple(own.all_coefficients for own in (ensemble or (vehicle,)))
    rate = max(float(fastest_rate(row, (F_u_max, 0.0, F_r_max))) for row in rows)
    if ensemble:
        parts["mismatch"] = RandomMismatch(vehicles=rows)
    return Scenario(**parts, substeps=max(1, math.ceil(Scenario.control_dt * rate / MAX_STIFFNESS)))


def scenario_text(
    found: Identified, vehicle: Vehicle, like: Actuators | None = None, ensemble: Sequence[Vehicle] = ()
) -> str:
    """Return scenario.toml; raises as `scenario`."""
    return tomli_w.dumps(scenario(found, vehicle, like, ensemble).to_dict())

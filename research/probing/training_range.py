"""What an agent was trained on, in numbers without dimension, and where published vehicles lie beside it.

A vehicle in units of its own mass m11, length L = sqrt(m33/m11) and time L/U, with the speed U of a path, is told by
ratios alone: two vehicles that have the same ones move the same. What an agent has met is what its trainer drew: the
true vehicles of the scenarios that its file names.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import Any

import numpy as np

from auv_gym.physics.actuators import Actuators
from auv_gym.physics.namespaces import Array
from auv_gym.physics.vehicle import Vehicle
from auv_gym.scenarios.scenario import Scenario
from auv_gym.scenarios.vehicles import PAPER, Craft, craft, fleet
from baselines.agents.agent import RECORD
from baselines.agents.names import agent_folder
from baselines.tools.files import read_json

HULLS = "baselines.training.vehicle_models"  # the module that draws hulls, for agents that are told them
_LANES = 120
"""Vehicles side by side in the training whose episodes are drawn; each is of one scenario, its hulls take turns."""
_DRAWS = 4000
"""Episodes that are drawn of a training."""
SHOWN = 600
"""How many of them are kept one by one, to be drawn as points."""
_SLOWEST = 1 / 3
"""Slowest path of a vehicle of the fleet beside its own speed, as in the presets."""
RATIOS = {
    "mass": "m22/m11",
    "munk": "turning moment (m22 - m11 - N_uv)/m11, which turns the hull across the flow",
    "surge": "surge drag (d11 + X_uu U) L/(m11 U)",
    "sway": "sway drag (d22 + Y_uv U) L/(m22 U)",
    "yaw": "yaw drag (d33 + N_ur U) L/(m33 U)",
    "thrust": "thrust (F_u L/(m11 U^2))",
    "torque": "yaw torque (F_r/(m11 U^2))",
    "lag": "lag of the actuators (lag U/L)",
}
"""The ratios, and what they are."""


def ratios(v: Vehicle, act: Actuators, lag: float, U: float) -> dict[str, float]:
    """Return the `RATIOS` of a vehicle whose actuators have a lag [s], at a speed [m/s]."""
    L = v.length
    torque = min(act.F_r_max, act.fin * U * U) if act.fin else act.F_r_max
    return {
        "mass": v.m22 / v.m11,
        "munk": (v.m22 - v.m11 - v.N_uv) / v.m11,
        "surge": (v.d11 + v.X_uu * U) * L / (v.m11 * U),
        "sway": (v.d22 + v.Y_uv * U) * L / (v.m22 * U),
        "yaw": (v.d33 + v.N_ur * U) * L / (v.m33 * U),
        "thrust": act.F_u_max * L / (v.m11 * U * U),
        "torque": torque / (v.m11 * U * U),
        "lag": lag * U / L,
    }


def trained(name: str, draws: int = _DRAWS) -> Array:
    """Return the ratios of episodes as an agent's training draws them, shape (draws, ratios).

    Raises:
        ValueError: there is no such agent, or its file does not say what it was trained on.
    """
    folder = agent_folder(name)
    config = read_json(folder / RECORD)["training"].get("config", {}) if folder else {}
    parts = config.get("scenarios", [])
    if not parts:
        raise ValueError(f"policy {name!r} is no agent whose file says what it was trained on")
    rng, weights = np.random.default_rng(0), np.array([part["weight"] for part in parts])
    chosen = rng.choice(len(parts), _LANES, p=weights / weights.sum()).tolist()
    lanes = [[Scenario.from_dict(parts[i]["scenario"])] for i in chosen]
    if share := config.get("hyperparameters", {}).get("hulls", 0.0):
        lanes = import_module(HULLS).turns([own for (own,) in lanes], share, 0)
    rows = []
    for i in range(draws):
        own = lanes[i % _LANES]
        scenario = own[i // _LANES % len(own)]
        episode = scenario.draw(rng)
        rows.append(list(ratios(episode.vehicle, scenario.actuators, episode.lag, episode.path.speed).values()))
    return np.array(rows)


def ranged(name: str, draws: int | None = None) -> dict[str, Any]:
    """Return the range of an agent's training and the ratios of every published vehicle, as plain numbers.

    Raises:
        ValueError: see `trained`.
    """
    seen = trained(name, draws or _DRAWS)
    low, high = seen.min(axis=0), seen.max(axis=0)
    vehicles = {
        c.name: [_of(c, U) for U in (_SLOWEST * c.vehicle.speed, c.vehicle.speed)]
        for c in [PAPER, *map(craft, fleet())]
    }
    return {
        "draws": len(seen),
        "low": _short(low),
        "high": _short(high),
        "points": [_short(row) for row in seen[:SHOWN]],
        "vehicles": {key: [_short(row) for row in rows] for key, rows in vehicles.items()},
    }


def _of(c: Craft, U: float) -> list[float]:
    lag = 0.2 * c.vehicle.time / PAPER.vehicle.time if c.lag is None else c.lag
    return list(ratios(c.vehicle, c.actuators, lag, U).values())


def _short(row: Any) -> list[float]:
    return [float(f"{round(x, 9) + 0.0:.3g}") for x in row]


def outside(record: Mapping[str, Any], vehicle: str) -> list[str]:
    """Return the ratios in which a vehicle at its speed is outside of what was drawn, with their values."""
    found = []
    for i, says in enumerate(RATIOS.values()):
        value, low, high = record["vehicles"][vehicle][1][i], record["low"][i], record["high"][i]
        if not low <= value <= high:
            found.append(f"{says.partition(' (')[0]} {value:.2g}")
    return found

"""The data of the live page: references, constants of episodes, gains and weights, written as a script."""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from auv_gym.physics.rows import flatten
from auv_gym.planning.paths import PATHS, Path
from auv_gym.scenarios.episode import Episode
from auv_gym.scenarios.exogenous import (
    GUST_ROWS,
    MEASUREMENT_NORMALS,
    NORMALS,
    WAVE_ROWS,
    WEATHER,
    least_speed,
    wave_components,
    weather_of,
)
from auv_gym.scenarios.presets import CASES, PRESETS, SPEED_RANGES, TYPICAL_NOISE
from auv_gym.scenarios.scenario import Scenario
from auv_gym.task.kernels import OUTCOMES
from auv_gym.task.model import PLANE
from auv_gym.task.observation import SIZE
from auv_gym.task.preview import Preview
from auv_gym.task.simulation import PARAMETERS, PLANT, SAMPLE, SAMPLE_ROWS
from baselines.control.ekf_law import EKF_GAINS, EKF_LAW_GAINS
from baselines.estimation.kalman import ExtendedKalmanFilter, tuning_of
from baselines.estimation.sea_model import PLACE
from baselines.export.parts import Exported
from baselines.gains.loading import load_gains
from baselines.tools.figure_style import COLOURS
from research.site.live.equations import COMPONENTS, shape_of

_SPEEDS = {"slow": 0.2, "cruise": 1.0}
"""Speed [m/s] of the paths, by speed range."""
_FAMILIES = {"figure_eight": 3, "random_smooth": 8, "circle": 4, "sine": 2, "line": 1}
"""Families of the paths, with the seed of the path."""
TITLES = {
    "figure_eight": "Figure eight",
    "random_smooth": "Wandering",
    "circle": "Circle",
    "sine": "Sine",
    "line": "Straight",
}
"""Names of the families on the page."""
_SEEDS = 8
"""Number of episodes of each speed range: starts, true vehicles, waves and a direction of the current."""
LIVE_STEPS = 600
"""Number of control steps of an episode."""
_VEHICLES = {"plain": "calm", "mismatch": "mismatch", "actuator": "actuator", "both": "storm"}
"""Cases of the vehicles: as the known model, with model error, with slow actuators, and with both."""


def data(agents: Mapping[str, Exported]) -> str:
    """Return the script that defines the page's object `DATA`, with some agents by name."""
    ahead = max((max(agent.preview, default=0) for agent in agents.values()), default=0)
    record = {
        "steps": LIVE_STEPS,
        "sizes": {
            "plant": PLANE.plant_rows,
            "seen": SIZE,
            "sample": SAMPLE_ROWS,
            "outcome": OUTCOMES,
            "state": len(PLANE.state),
            "gust": GUST_ROWS,
            "normals": NORMALS,
            "waveRows": WAVE_ROWS,
        },
        "at": {
            "plant": _places(PLANT),
            "sample": _places(SAMPLE),
            "weather": {**WEATHER.mean._asdict(), **_places(WEATHER)},  # type: ignore[attr-defined]
            "estimate": _places(PLACE),
        },
        "limits": [PARAMETERS.F_u_max, PARAMETERS.F_r_max],
        "measured": [MEASUREMENT_NORMALS.start, MEASUREMENT_NORMALS.stop],
        "speed_ranges": {speed_range: _speed_range(speed_range, ahead) for speed_range in SPEED_RANGES},
        "agents": {name: _agent(agent) for name, agent in agents.items()},
        "colours": dict(zip(("backstepping", "ekf", "open-loop", *agents), COLOURS, strict=False)),
    }
    return f'"use strict";\nconst DATA = {json.dumps(record, separators=(",", ":"), allow_nan=False)};\n'


def _places(row: Any) -> dict[str, int]:
    """Return the index of each field of a row, by name; of a nested field the index of its first number."""
    places = ((name, place) for name, place in row._asdict().items() if place != ())
    return {name: place if isinstance(place, int) else flatten(place)[0] for name, place in places}


def scenario_of(speed_range: str, case: str, path: Path) -> Scenario:
    """Return a preset on a path of the page."""
    return replace(PRESETS[f"{speed_range}-{case}"], path=path)


def path_of(speed_range: str, family: str) -> Path:
    """Return the path of a family at the speed of a speed range."""
    drawn = PRESETS[f"{speed_range}-calm"].path
    rng, cls = np.random.default_rng(_FAMILIES[family]), PATHS[family]
    path: Path = cls.drawn(_SPEEDS[speed_range], drawn.turn_rate, rng.random)  # type: ignore[union-attr, attr-defined]
    return path


def episode_of(speed_range: str, case: str, path: Path, seed: int) -> Episode:
    """Return an episode of a preset on a path."""
    return scenario_of(speed_range, case, path).draw(np.random.default_rng([seed, 1]))


def _speed_range(speed_range: str, ahead: int) -> dict[str, Any]:
    """Return the data of a speed range, with the references up to `ahead` control periods beyond the end."""
    calm = PRESETS[f"{speed_range}-calm"]
    paths = {family: path_of(speed_range, family) for family in _FAMILIES}
    return {
        "dt": calm.control_dt,
        "speed": _SPEEDS[speed_range],
        "errorScale": calm.error_scale,
        "failed": calm.lost_distance,
        "cases": {case: _case(speed_range, case) for case in CASES},
        "seeds": [_seed(speed_range, paths["line"], seed) for seed in range(_SEEDS)],
        "paths": {name: {"title": TITLES[name]} | _path(speed_range, path, ahead) for name, path in paths.items()},
        "ekf": _ekf(speed_range),
    }


def _path(speed_range: str, path: Path, ahead: int) -> dict[str, Any]:
    """Return the reference table of a path and its positions after the end, in double precision as base64."""
    tightest = scenario_of(speed_range, "actuator", path)  # it has the tightest limits
    table = replace(tightest, steps=LIVE_STEPS).planner.table(path)
    preview = Preview(1, tuple(range(1, ahead + 1)), LIVE_STEPS)
    preview.load((0,), (path,), PRESETS[f"{speed_range}-calm"].control_dt, (table,))
    storm, current = PRESETS[f"{speed_range}-storm"], episode_of(speed_range, "storm", path, 0).current
    noise = TYPICAL_NOISE[speed_range].noise
    weather = weather_of(current, storm.control_dt, least_speed([table]), noise, [0.0] * 6)
    return {
        "table": _encoded(table, np.float64),
        "beyond": _encoded(table[-1, :2] + preview.ahead((0,), LIVE_STEPS)[:, :, 0], np.float64),
        "weather": weather,  # with the typical noise; the controls of the page scale it
    }


def _case(speed_range: str, case: str) -> dict[str, Any]:
    """Return the settings of the controls for a case: centres of its intervals, relative to the speed of the path."""
    scenario, mean = PRESETS[f"{speed_range}-{case}"], PRESETS[f"{speed_range}-waves"].waves
    current, waves = scenario.current, scenario.waves
    assert mean is not None
    return {
        "current": float(np.mean(current.speed)) if current else 0.0,
        "gust": current.gust if current else 0.0,
        "waves": waves.surge / mean.surge if waves else 0.0,
        "noise": 1.0 if any(scenario.sensors.noise) else 0.0,
        "mismatch": scenario.mismatch is not None,
        "actuator": scenario.actuators.lag != 0,
    }


def _seed(speed_range: str, path: Path, seed: int) -> dict[str, Any]:
    """Return an episode of a speed range: its vehicles, the waves at full height, its start and current direction."""
    waves, calm = (episode_of(speed_range, case, path, seed) for case in ("waves", "calm"))
    components = wave_components(waves.waves, PRESETS[f"{speed_range}-waves"].control_dt).ravel()
    assert len(components) == COMPONENTS * WAVE_ROWS
    vehicles = {}
    for name, case in _VEHICLES.items():
        parameters = scenario_of(speed_range, case, path).parameters(episode_of(speed_range, case, path, seed))
        vehicles[name] = np.nan_to_num(np.array(flatten(parameters)), posinf=np.finfo(float).max).tolist()
    return {
        "vehicles": vehicles,  # infinite parameters are the largest finite number
        "waves": components.tolist(),
        "start": [*calm.initial_error, calm.surge],
        "direction": float(np.random.default_rng([seed, 2]).uniform(0, 2 * np.pi)),
    }


def _ekf(speed_range: str) -> dict[str, Any]:
    """Return the parameters of the `ekf` law and of its filters, and the initial state of a filter."""
    vehicle, gains = PRESETS[f"{speed_range}-calm"].vehicle, load_gains("ekf", speed_range, EKF_GAINS)
    kalman = ExtendedKalmanFilter(vehicle, tuning_of(gains))
    return {
        "filters": [known[:, 0].tolist() for known in kalman.known],  # in a rough sea, in a calm sea
        "law": [*vehicle.coefficients, *(gains[name] for name in EKF_LAW_GAINS)],
        "memory": kalman.start(1)[0][0].tolist(),  # of each filter
        "plan": 7,
    }


def _agent(agent: Exported) -> dict[str, Any]:
    """Return the weights of an agent, in single precision, and the sizes that its equations need."""
    return {
        "shape": shape_of(agent),
        "authority": list(agent.agent.authority),
        "preview": list(agent.preview),
        "features": agent.agent.network.inputs,
        "hidden": agent.agent.network.memory,
        "integrals": agent.memory["integrals"],
        "weights": {name: _encoded(array, np.float32) for name, array in agent.network.constants.items()},
    }


def _encoded(array: Any, kind: Any) -> str:
    """Return the bytes of an array as base64."""
    return base64.b64encode(np.ascontiguousarray(array, kind).tobytes()).decode()

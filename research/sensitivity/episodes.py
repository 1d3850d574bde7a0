"""The episodes and policies of the studies of sensitivity."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from auv_gym.physics.vehicle import Vehicle
from auv_gym.scenarios.episode import Episode
from auv_gym.scenarios.presets import PRESETS
from auv_gym.scenarios.scenario import RandomPath, Scenario
from auv_gym.task.policy import Policy
from baselines.agents.agent import Agent
from baselines.agents.names import agent_folder
from baselines.evaluation.runner import drawn
from baselines.policies import make_policy
from baselines.similar import made_for
from research.robustness.situations import PRECISION
from research.seeds import SENSITIVITY

SENSITIVITY_SEED = SENSITIVITY.first  # of the first episode of each scenario


def episodes_of(scenario: Scenario, count: int) -> tuple[Episode, ...]:
    """Return so many episodes of a scenario that nothing was trained, tuned or compared on; raises as `drawn`."""
    return drawn(scenario, count, SENSITIVITY_SEED).episodes


def at_speed(name: str, speed: float, **changes: Any) -> Scenario:
    """Return a preset whose paths have a nominal speed [m/s], with other entries."""
    preset = PRESETS[name]
    assert isinstance(preset.path, RandomPath)
    return replace(preset, path=replace(preset.path, speed=speed), **changes)


def acting(name: str, vehicle: Vehicle) -> Policy:
    """Return a policy by name for a known vehicle; the network of an agent computes in `PRECISION`.

    Raises:
        OSError: an agent cannot be read.
        ValueError: there is no such policy.
    """
    if (folder := agent_folder(name)) is None:
        return make_policy(name, vehicle)
    return made_for(vehicle, lambda known: Agent.load(folder).policy(vehicle=known, precision=PRECISION))

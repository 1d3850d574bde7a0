"""Situations in which agents are compared: a network that fails, speeds and thrusters that nothing was trained on."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from auv_gym.physics.namespaces import Array
from auv_gym.physics.vehicle import Vehicle
from auv_gym.scenarios.presets import CASES, PRESETS
from auv_gym.scenarios.scenario import RandomPath, Scenario
from auv_gym.task.policy import Policy
from baselines.agents.agent import Agent
from baselines.agents.features import STANDARD
from baselines.agents.names import agent_folder
from baselines.agents.networks import Gru
from baselines.control.backstepping import StabilityWarning
from baselines.evaluation.runner import drawn
from baselines.evaluation.score import EXPERT, LARGEST_TAIL, capped, losses
from baselines.evaluation.side_by_side import SideBySide
from baselines.policies import make_policy
from baselines.similar import made_for
from research.robustness.failures import FAILURES, Failing
from research.seeds import HELD_OUT

FASTER: Mapping[str, tuple[float, float]] = {"slow": (0.3, 0.4), "cruise": (1.5, 2.0)}
"""Speeds [m/s] above those of a regime's training."""
SLOWER: Mapping[str, tuple[float, float]] = {"slow": (0.05, 0.1), "cruise": (0.2, 0.5)}
"""Speeds [m/s] below those of a regime's training."""
_SLEW = (0.5, 1.0)  # [s] in which thrusters go from zero to full force
PRECISION = "float32"  # of the networks here: a fifth of the time, and errors that differ by 1e-6
_World = Callable[[Scenario], Scenario]


def _at(speeds: Mapping[str, tuple[float, float]]) -> _World:
    def change(scenario: Scenario) -> Scenario:
        assert isinstance(scenario.path, RandomPath)
        return replace(scenario, path=replace(scenario.path, speed=speeds[scenario.name.partition("-")[0]]))

    return change


def _slewing(seconds: float) -> _World:
    """Return what gives a scenario thrusters that take so long [s] from zero to full force."""

    def change(scenario: Scenario) -> Scenario:
        act = scenario.actuators
        rates = {"F_u_rate": act.F_u_max / seconds, "F_r_rate": act.F_r_max / seconds}
        return replace(scenario, actuators=replace(act, **rates))

    return change


WORLDS: Mapping[str, _World] = {
    "as trained": lambda scenario: scenario,
    "faster": _at(FASTER),
    "slower": _at(SLOWER),
    **{f"slew {seconds:g} s": _slewing(seconds) for seconds in _SLEW},
}
"""What becomes of each case, by situation; where the network fails it is as trained."""
AS_TRAINED = "as trained"
"""The situation in which nothing is wrong."""
SITUATIONS = (AS_TRAINED, *FAILURES, *(name for name in WORLDS if name != AS_TRAINED))
"""Names of the situations. Networks fail after a third of each episode."""


@dataclass(frozen=True)
class _Outcome:
    """What a policy does in M episodes, case by case."""

    tail: Array  # [m] tail RMSE, cut at the largest of the regime, shape (M,)
    lost: int  # how many were


@lru_cache(maxsize=8)
def situation_episodes(regime: str, world: str, episodes: int) -> SideBySide:
    """Return so many fresh episodes of each of a regime's cases in a world, case after case."""
    return SideBySide([drawn(WORLDS[world](PRESETS[f"{regime}-{case}"]), episodes, HELD_OUT.first) for case in CASES])


def situations_of(name: str) -> tuple[str, ...]:
    """Return the situations that a policy can be in: what is no agent has no network that could fail."""
    return SITUATIONS if agent_folder(name) else tuple(WORLDS)


def silent(authority: float) -> Agent:
    """Return an agent whose network says nothing, so that it is the law until the network fails."""
    network = Gru(len(STANDARD.features), 1, 1, 1)
    weights = {name: np.zeros(shape) for name, shape in network.shapes.items()}
    return Agent(network, weights, EXPERT, (authority, authority))


def outcome(who: str | Agent, regime: str, situation: str, episodes: int) -> _Outcome:
    """Return what a policy does in a situation, in fresh episodes of a regime.

    Args:
        who: the name of the policy, the folder of an agent, or an agent.
        regime: "slow" or "cruise".
        situation: one of `SITUATIONS`; for what is no agent one of `WORLDS`.
        episodes: of each case.

    Raises:
        OSError: the agent cannot be read.
        PolicyError: its actions are not finite.
        ValueError: there is no such policy.
    """
    place = situation_episodes(regime, situation if situation in WORLDS else AS_TRAINED, episodes)
    cap, first = LARGEST_TAIL[regime], place.cells[0].scenario
    with warnings.catch_warnings():  # that speeds are beyond law and training is what is asked here
        warnings.simplefilter("ignore", StabilityWarning)
        warnings.filterwarnings("ignore", "this agent was trained at reference speeds")
        found = place.run(_policy(who, situation, first))
    tails: Sequence[Array] = [capped(ended, cap) for ended in found]
    return _Outcome(np.concatenate(tails), sum(losses(e, cap) for e in found))


def _policy(who: str | Agent, situation: str, scenario: Scenario) -> Policy:
    agent = who
    if isinstance(agent, str):
        if (folder := agent_folder(agent)) is None:
            return make_policy(agent, scenario.vehicle)
        agent = Agent.load(folder)

    def make(vehicle: Vehicle | None) -> Policy:
        if situation in FAILURES:
            return Failing(agent, situation, scenario.steps // 3, vehicle, PRECISION)
        return agent.policy(vehicle=vehicle, precision=PRECISION)

    return made_for(scenario.vehicle, make)

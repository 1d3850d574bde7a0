"""Train an agent further, and train for a vehicle.

The inputs of an agent are in the units of its vehicle (`auv_gym.physics.units`). For a training the scenarios are
adapted to the vehicle and converted to its units.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from auv_gym.physics.vehicle import Vehicle
from auv_gym.scenarios.fitting import changed, check_adaptable, in_vehicle_units
from auv_gym.scenarios.mixtures import Mixture
from auv_gym.scenarios.records import meant
from auv_gym.scenarios.scenario import Scenario
from auv_gym.scenarios.vehicles import VehicleModel
from baselines.agents.agent import WEIGHTS, Agent
from baselines.agents.names import agent_folder, shipped_agents
from baselines.evaluation.cells import drawn
from baselines.tools.files import read_bytes
from baselines.training.config import Config, Origin

_TRIED = 16  # episodes of a scenario that a vehicle must be able to follow
ALGO = "apg"  # the algorithm that can train an agent further
OF_AGENT = ("hidden_size", "memory", "preview", "integrals", "fine", "filters")
"""Hyper-parameters that the shapes of an agent's weights depend on."""


@dataclass(frozen=True)
class InitialAgent:
    """The agent that a training starts from."""

    origin: Origin
    agent: Agent
    config: Config  # of its own training

    @classmethod
    def of(cls, name: str) -> InitialAgent:
        """Return the agent of a name or a folder.

        Raises:
            OSError: a file cannot be read.
            ValueError: the agent does not exist, or was trained by another algorithm than `ALGO`.
        """
        if (folder := agent_folder(name)) is None:
            hint, known = meant(name, shipped_agents()), ", ".join(shipped_agents())
            raise ValueError(f"unknown agent {name!r}{hint}; allowed are the folder of an agent, or {known}")
        agent = Agent.load(folder)
        algo = agent.training.get("config", {}).get("algo")
        if algo != ALGO:
            raise ValueError(
                f"agent {name!r} was trained by {algo or 'another algorithm'}; a training can start only from an agent "
                f"of {ALGO}, such as helm"
            )
        return cls(Origin(name, weights_digest(folder)), agent, Config.from_dict(agent.training["config"]))

    def check(self, expert: str | None, authority: Sequence[float], changes: Mapping[str, Any]) -> None:
        """Raise ValueError if options contradict the agent.

        Args:
            expert: of `--expert`, None if it is not given.
            authority: of `--authority`, empty if it is not given.
            changes: of `--set`, by name.
        """
        name, values = self.origin.agent, self.config.hyperparameters
        if expert not in (None, self.agent.expert):
            raise ValueError(f"agent {name!r} corrects {self.agent.expert}; leave out --expert {expert}")
        if authority and {*authority} != {*self.agent.authority}:
            raise ValueError(f"agent {name!r} has the authority {self.agent.authority}; leave out --authority")
        for key in OF_AGENT:
            if key in changes and changes[key] != values.get(key, changes[key]):
                raise ValueError(f"agent {name!r} was trained with {key} {values[key]}; leave out {key}={changes[key]}")


def weights_digest(folder: Path) -> str:
    """Return the SHA-256 of the weights in an agent's folder."""
    return hashlib.sha256(read_bytes(folder / WEIGHTS)).hexdigest()


def loaded(origin: Origin) -> Agent:
    """Return the agent that a training starts from.

    Raises:
        OSError: a file cannot be read.
        ValueError: the agent does not exist any more, or has other weights.
    """
    folder = agent_folder(origin.agent)
    if folder is None or weights_digest(folder) != origin.weights_sha256:
        raise ValueError(f"the agent {origin.agent!r} that this training starts from has changed or was deleted")
    return Agent.load(folder)


def fitted(mixture: Mixture, vehicle: VehicleModel | str) -> tuple[Mixture, tuple[str, ...]]:
    """Return the scenarios of a mixture adapted to a vehicle, and the reasons for those that are left out.

    Raises:
        ValueError: the vehicle is unknown, a scenario is not of the paper's vehicle, or no scenario can be adapted.
    """
    scenarios: list[tuple[Scenario, float]] = []
    reasons: list[str] = []
    for scenario, weight in mixture:
        check_adaptable(scenario)
        try:
            adapted = changed(scenario, vehicle)
            drawn(adapted, _TRIED, 0)  # raises if it cannot follow its paths, such as turns too sharp for fins
            scenarios.append((adapted, weight))
        except ValueError as error:
            reasons.append(str(error))
    if not scenarios:
        raise ValueError(reasons[0])
    return tuple(scenarios), tuple(reasons)


def in_own_units(mixture: Mixture) -> tuple[Mixture, Vehicle | None]:
    """Return a mixture in the units of its vehicles, with equal integration steps, and the vehicle of all scenarios.

    The vehicle is None for the paper's vehicle, and if the scenarios have several. If all scenarios are of the paper's
    vehicle, the mixture is returned unchanged.

    Raises:
        ValueError: see `auv_gym.scenarios.fitting.in_vehicle_units`.
    """
    converted = tuple((in_vehicle_units(scenario), weight) for scenario, weight in mixture)
    if all(new is old for (new, _), (old, _) in zip(converted, mixture, strict=True)):
        return mixture, None
    steps = max(scenario.substeps for scenario, _ in converted)
    first = mixture[0][0].vehicle
    one = first if all(scenario.vehicle == first for scenario, _ in mixture) else None
    return tuple((replace(scenario, substeps=steps), weight) for scenario, weight in converted), one

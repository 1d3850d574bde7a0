"""The configuration of a training run, checked and convertible to JSON."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from auv_gym.physics.space import SpaceVehicle
from auv_gym.physics.vehicle import Vehicle
from auv_gym.scenarios.records import from_record
from auv_gym.scenarios.scenario import Scenario
from auv_gym.scenarios.vehicles import VehicleModel
from auv_gym.task.policy import Policy, checked_authority
from baselines.agents.agent import make_expert
from baselines.control.open_loop import NO_EXPERT
from baselines.evaluation.score import EXPERT
from baselines.policies import check_actions, common_vehicle
from baselines.tools.seeds import TRAINING

ALGORITHMS: Mapping[str, str] = {
    "apg": "baselines.training.apg.trainer",
    "ppo": "baselines.training.sb3.trainer",
    "sac": "baselines.training.sb3.trainer",
    "td3": "baselines.training.sb3.trainer",
}
"""Module of each algorithm. Its `check(config)` raises ValueError for a wrong configuration; `train(run)` trains.

apg is the analytic policy gradient, back-propagation through the simulator; the others are from Stable-Baselines3.
"""
LARGEST_SEED = 10_000  # of a run
_SEEDS_PER_RUN = 2**20  # seeds reserved for the vehicles of one run


@dataclass(frozen=True)
class Origin:
    """The agent that a training starts from."""

    agent: str  # its name or folder
    weights_sha256: str  # identifies its weights, in case the agent is replaced before the run is resumed


@dataclass(frozen=True)
class Config:
    """The configuration of a training run; it determines the agent for given libraries and number of threads.

    Raises:
        ValueError: an entry is wrong; the message says what is allowed.
    """

    algo: str = "apg"  # one of `ALGORITHMS`
    scenarios: tuple[tuple[Scenario, float], ...] = ()  # training scenarios with weights
    expert: str = EXPERT  # name of the policy whose action is corrected, or `open_loop.NO_EXPERT`
    authority: tuple[float, ...] = (0.5, 0.5)  # largest correction of each channel, fractions of the limits, (0, 2]
    seed: int = 0
    timesteps: int = 1_000_000  # control steps, summed over vehicles
    hyperparameters: Mapping[str, Any] = field(default_factory=dict)  # of the algorithm, plain JSON values
    origin: Origin | None = None  # the initial agent; None: a new network, whose correction is zero
    steers: Vehicle | None = None  # vehicle in SI units in whose units the scenarios are; None: the paper's
    whole_model: bool = False  # see `baselines.agents.agent.Agent`

    def __post_init__(self) -> None:
        if self.algo not in ALGORITHMS:
            raise ValueError(f"unknown algorithm {self.algo!r}; allowed are {', '.join(ALGORITHMS)}")
        _check_scenarios(self.scenarios)
        channels = len(self.scenarios[0][0].parts.model.channels)
        object.__setattr__(self, "authority", checked_authority(self.authority, channels))
        for name, least, most in (("seed", 0, LARGEST_SEED), ("timesteps", 1, 10**12)):
            check_integer(name, getattr(self, name), least, most)
        if not isinstance(self.whole_model, bool):
            raise ValueError(f"whole_model is {self.whole_model!r}; it must be true or false")
        try:
            json.dumps(dict(self.hyperparameters), allow_nan=False)
        except (TypeError, ValueError) as error:
            raise ValueError(f"the hyper-parameters must be numbers, strings, lists and tables: {error}") from error
        if self.expert != NO_EXPERT:
            check_actions(self.expert, [scenario for scenario, _ in self.scenarios])
        self.make_expert()

    def make_expert(self) -> Policy:
        """Return the policy whose action is corrected; raises as `baselines.agents.agent.make_expert`."""
        return make_expert(self.expert, vehicle=self.known)

    @property
    def vehicle(self) -> Vehicle | None:
        """The nominal vehicle of all scenarios, in their units; None if they differ."""
        return common_vehicle([scenario for scenario, _ in self.scenarios])

    @property
    def known(self) -> Vehicle | VehicleModel | SpaceVehicle | None:
        """What the expert is made for: `vehicle`, with its limits and lag if `whole_model`."""
        known = self.scenarios[0][0].known
        same = all(scenario.known == known for scenario, _ in self.scenarios)
        return known if same and (self.whole_model or isinstance(known, SpaceVehicle)) else self.vehicle

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the scenarios."""
        return tuple(scenario.name for scenario, _ in self.scenarios)

    @property
    def episode_seed(self) -> int:
        """Seed of the training environment; vehicle i has this + i. No other run or suite has the same seeds."""
        return TRAINING.first + self.seed * _SEEDS_PER_RUN

    def env_scenarios(self, n: int) -> list[Scenario]:
        """Return the scenarios of n sub-environments, in proportion to their weights, each at least once.

        Raises:
            ValueError: n is smaller than the number of scenarios.
        """
        if n < len(self.scenarios):
            raise ValueError(f"{n} vehicles are too few for {len(self.scenarios)} scenarios; raise n_envs")
        total = math.fsum(weight for _, weight in self.scenarios)
        counts = [1] * len(self.scenarios)
        while sum(counts) < n:  # largest remainder first
            missing = [n * weight / total - count for (_, weight), count in zip(self.scenarios, counts, strict=True)]
            counts[missing.index(max(missing))] += 1
        return [scenario for (scenario, _), count in zip(self.scenarios, counts, strict=True) for _ in range(count)]

    def to_dict(self) -> dict[str, Any]:
        """Return the configuration as plain dicts, lists, numbers and strings."""
        record = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}
        own = [(s.record if self.whole_model else s.to_dict(), weight) for s, weight in self.scenarios]
        record["scenarios"] = [{"weight": weight, "scenario": scenario} for scenario, weight in own]
        record["authority"] = list(self.authority)
        for name in ("origin", "steers"):
            record[name] = None if record[name] is None else dataclasses.asdict(record[name])
        plain: dict[str, Any] = json.loads(json.dumps(record | {"hyperparameters": dict(self.hyperparameters)}))
        return plain

    @classmethod
    def from_dict(cls, record: Mapping[str, Any]) -> Config:
        """Return the configuration of a dict from `to_dict`.

        Raises:
            ValueError: an entry is unknown or wrong; the message says what is allowed.
        """
        same = {"hyperparameters": dict, "expert": str, "algo": str}
        return from_record(cls, record, "configuration", {"scenarios": _scenarios_of, "authority": tuple, **same})


def check_integer(name: str, value: object, least: int, most: int) -> None:
    """Raise ValueError unless a value is an integer in [least, most]."""
    if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
        raise ValueError(f"{name} is {value!r}; it must be an integer in [{least}, {most}]")


def _check_scenarios(scenarios: Sequence[tuple[Scenario, float]]) -> None:
    if not scenarios:
        raise ValueError("there is no scenario to train on; name at least one")
    names = [scenario.name for scenario, _ in scenarios]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"scenario {name!r} is given twice; give it once, with a weight, or rename one of them")
    for scenario, weight in scenarios:
        if isinstance(weight, bool) or not isinstance(weight, (int, float)) or not 0 < weight <= 1000:
            raise ValueError(f"the weight of scenario {scenario.name} is {weight!r}; it must be a number in (0, 1000]")
    if len({scenario.substeps for scenario, _ in scenarios}) > 1:
        raise ValueError("the scenarios differ in substeps; all training scenarios must have the same number")


def _scenarios_of(entries: Any) -> tuple[tuple[Scenario, float], ...]:
    try:
        return tuple((Scenario.from_dict(entry["scenario"]), entry["weight"]) for entry in entries)
    except (KeyError, TypeError) as error:
        raise ValueError(f"configuration scenarios is {entries!r}; it must be a list of scenario and weight") from error

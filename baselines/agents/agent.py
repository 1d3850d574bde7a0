"""Trained agents and their folders. Loading an agent runs no code.

weights.safetensors   the network's weights
agent.json            network, features, observation, expert, authority, scenarios, training
card.md               the same as text; learning_curve.png beside it, if there is one
"""

from __future__ import annotations

import hashlib
import json
import math
import shutil
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from auv_gym.physics.space import SpaceVehicle
from auv_gym.physics.vehicle import PAPER_VEHICLE, Vehicle
from auv_gym.scenarios.presets import SETPOINTS
from auv_gym.scenarios.records import from_record, guarded, to_record
from auv_gym.scenarios.vehicles import PAPER, VehicleModel, as_vehicle
from auv_gym.task.policy import Policy, checked_authority
from baselines.agents.features import STANDARD, Inputs
from baselines.agents.model_card import CURVE_FILE, model_card
from baselines.agents.names import PolicyName, agent_folder, is_in_space, shipped_agents
from baselines.agents.networks import Network, Weights, check_weights, network_of, network_record
from baselines.agents.residual_policy import ResidualPolicy
from baselines.agents.space_features import SpaceInputs
from baselines.control import POLICIES, make_controller
from baselines.control.open_loop import NO_EXPERT, Zero
from baselines.space import make_in_space
from baselines.tools.files import read_bytes, read_json, synchronise, write_atomically

_FORMAT = 3
"""Version of the folder's layout."""
WEIGHTS = "weights.safetensors"  # file of the network's arrays
AGENT_FILE = "agent.json"  # file of everything else, see `ENTRIES`
_SPEEDS = {"slow": (0.0, 0.5), "cruise": (0.2, math.inf)}
"""Reference speeds [m/s] for which agents of a speed range are trained; both cover 0.2 to 0.5 m/s."""
CARD = "card.md"  # file of the description
ENTRIES = (
    "format", "network", "inputs", "features", "observation", "expert", "authority", "scenarios", "weights_sha256",
    "training",
)  # fmt: skip
"""The entries of agent.json."""
WHOLE_MODEL = "whole_model"  # entry of an agent with this property


@dataclass(frozen=True)
class Agent:
    """A network that corrects an expert, with a record of its training.

    Raises:
        ValueError: the weights do not fit the network, the expert is a path, or an authority is not in (0, 2].
    """

    network: Network
    weights: Weights  # see `network.shapes`
    expert: str  # the name of a policy, or `NO_EXPERT`
    authority: tuple[float, ...]  # largest correction of each channel, fractions of the limits
    scenarios: tuple[str, ...] = ()  # names of the training scenarios
    training: Mapping[str, Any] = field(default_factory=dict)  # command, configuration, versions, scores: plain JSON
    inputs: Inputs | SpaceInputs = STANDARD
    whole_model: bool = False  # the expert is made for limits and lag of the vehicle too, not for its parameters only

    def __post_init__(self) -> None:
        if self.network.inputs != (features := len(self.inputs.features)):
            raise ValueError(f"the network has {self.network.inputs} inputs; there are {features} features")
        check_expert(self.expert)
        object.__setattr__(self, "authority", checked_authority(self.authority, len(self.inputs.model.channels)))
        check_weights(self.network, self.weights)

    def policy(
        self, vehicle: Vehicle | VehicleModel | SpaceVehicle | None = None, precision: str = "float64"
    ) -> Policy:
        """Return the policy: expert plus correction of the network.

        Args:
            vehicle: nominal model of the expert, see `whole_model`, and an input of a network with
                `Inputs.nominal_vehicle`. None: the paper's.
            precision: of the network's numbers, "float64", or "float32", which takes a fifth of the time in batches.

        Raises:
            ValueError: see `make_expert`; or the agent is one in space and the vehicle in the plane, or reversed.
        """
        in_space = isinstance(self.inputs, SpaceInputs)
        if vehicle is not None and in_space != isinstance(vehicle, SpaceVehicle):
            kinds = ("motion in space", "motion in the plane")[:: 1 if in_space else -1]
            raise ValueError("the agent is for {}; the scenario or vehicle is for {}".format(*kinds))
        if in_space:
            steered: Any = vehicle or PAPER.in_space
            expert, network = make_in_space(self.expert, steered), (self.network, self.weights, self.authority)
            return ResidualPolicy(expert, *network, self.inputs, precision, vehicle=steered)
        known = as_vehicle(vehicle or PAPER_VEHICLE)  # type: ignore[arg-type]
        expert = make_expert(self.expert, vehicle=vehicle if self.whole_model else known)
        ranges = {name.partition("-")[0] for name in self.scenarios}
        speeds = _SPEEDS[ranges.pop()] if len(ranges) == 1 and ranges <= set(_SPEEDS) else (0.0, math.inf)
        network = self.network, self.weights, self.authority
        return ResidualPolicy(expert, *network, self.inputs, precision, speeds, known)

    @property
    def setpoints(self) -> bool:
        """Whether its commands are setpoints: those of its expert, without one those of its training scenarios."""
        if self.expert != NO_EXPERT:
            return self.expert in POLICIES and POLICIES[self.expert].setpoints
        return any(name.partition("@")[0].endswith(SETPOINTS) for name in self.scenarios)

    def save(self, folder: str | Path, curve: bytes | None = None) -> None:
        """Write the agent to a folder and replace an older one; the folder is never incomplete.

        Args:
            folder: an agent's, or one that does not exist yet.
            curve: the learning curve, a PNG image.

        Raises:
            OSError: the folder cannot be written.
            ValueError: the folder holds something other than an agent.
        """
        from safetensors.numpy import save

        folder = Path(folder)
        if folder.exists() and not (folder / AGENT_FILE).is_file():
            raise ValueError(f"{folder} exists and is not an agent's folder; choose another one")
        weights = save({name: np.ascontiguousarray(w, dtype=np.float32) for name, w in self.weights.items()})
        record = self._record(weights)
        files = {
            WEIGHTS: weights,
            AGENT_FILE: (json.dumps(record, indent=2, allow_nan=False) + "\n").encode(),
            CARD: model_card(folder.name, record, curve is not None).encode(),
        }
        _replace(folder, files | ({CURVE_FILE: curve} if curve else {}))

    def _record(self, weights: bytes) -> dict[str, Any]:
        return {
            "format": _FORMAT,
            "network": network_record(self.network),
            "inputs": to_record(self.inputs),
            "features": feature_layout(self.inputs),
            "observation": observation_layout(self.inputs),
            "expert": self.expert,
            "authority": list(self.authority),
            "scenarios": list(self.scenarios),
            "weights_sha256": hashlib.sha256(weights).hexdigest(),
            "training": dict(self.training),
            **({WHOLE_MODEL: True} if self.whole_model else {}),
        }

    @classmethod
    def load(cls, folder: str | Path) -> Agent:
        """Return the agent of a folder.

        Raises:
            OSError: a file cannot be read.
            ValueError: a file is damaged, or of another version; the message names it.
        """
        folder = Path(folder)
        with guarded(f"agent {folder}"):
            record = _checked_record(read_json(folder / AGENT_FILE))
            data = read_bytes(folder / WEIGHTS)
            if hashlib.sha256(data).hexdigest() != record["weights_sha256"]:
                raise ValueError(f"{WEIGHTS} does not belong to {AGENT_FILE}: its SHA-256 differs")
            return cls(
                network_of(record["network"]),
                _weights(data),
                record["expert"],
                _numbers(record["authority"]),
                tuple(record["scenarios"]),
                record["training"],
                _inputs_of(record),
                record.get(WHOLE_MODEL, False),
            )


def check_expert(name: Any) -> None:
    """Raise ValueError unless a name may be that of an agent's expert."""
    if not isinstance(name, str) or (PolicyName.of(name).kind != "controller" and name not in shipped_agents()):
        raise ValueError(f"expert is {name!r}; an agent's expert must be a policy's name, since paths run code")
    if name in POLICIES and POLICIES[name].privileged:
        raise ValueError(f"expert {name!r} needs full information; choose one that uses the observation only")


def make_expert(name: str, vehicle: Vehicle | VehicleModel | SpaceVehicle | None = None) -> Policy:
    """Return the expert of a name: a controller, an agent, or for `NO_EXPERT` a policy whose action is zero.

    Args:
        name: of the policy.
        vehicle: nominal model of the policy; gains depend on the limits and the lag of a `VehicleModel`.
            None: the paper's.

    Raises:
        ValueError: the name is unknown, or the policy may not be an expert: a path, or one that needs full information.
    """
    check_expert(name)
    if isinstance(vehicle, SpaceVehicle):
        return make_in_space(name, vehicle)
    if name == NO_EXPERT:
        return Zero()
    if (folder := agent_folder(name)) is not None:
        return Agent.load(folder).policy(vehicle)
    return make_controller(name, vehicle)


def observation_layout(inputs: Inputs | SpaceInputs) -> list[list[Any]]:
    """Return name and scale of each term of the observation, as in an agent's description."""
    return [[t.name, t.scale] for t in inputs.model.layout.terms]


def _inputs_of(record: Mapping[str, Any]) -> Inputs | SpaceInputs:
    """Return the inputs of a description; the terms of its observation tell whether they are those in space."""
    kind: Any = SpaceInputs if is_in_space(record) else Inputs
    inputs: Inputs | SpaceInputs = from_record(kind, record["inputs"], "inputs")
    return inputs


def feature_layout(inputs: Inputs | SpaceInputs) -> list[list[str]]:
    """Return name and scale of each feature, as in an agent's description."""
    return [[f.name, f.scale] for f in inputs.features]


def _checked_record(record: Any) -> dict[str, Any]:
    """Return an agent's description; raise ValueError if it is damaged or of another version."""
    if not isinstance(record, dict) or set(record) - {WHOLE_MODEL} != set(ENTRIES):
        raise ValueError(f"{AGENT_FILE} must have the entries {', '.join(ENTRIES)}, and no others")
    if record["format"] != _FORMAT:
        raise ValueError(f"its format is {record['format']!r}; this version reads {_FORMAT}")
    inputs = _inputs_of(record)
    for name, layout in (("features", feature_layout(inputs)), ("observation", observation_layout(inputs))):
        if record[name] != layout:
            raise ValueError(f"it was trained with other {name} than those of this version; train it again")
    if record.get(WHOLE_MODEL, True) is not True:
        raise ValueError(f"{AGENT_FILE}: {WHOLE_MODEL} must be true, or be left out")
    if not isinstance(record["training"], dict):
        raise ValueError(f"{AGENT_FILE}: training must be a table")
    if not isinstance(record["scenarios"], list) or not all(isinstance(s, str) for s in record["scenarios"]):
        raise ValueError(f"{AGENT_FILE}: scenarios must be a list of names")
    return record


def _numbers(value: Any) -> tuple[float, ...]:
    if not isinstance(value, list):
        raise ValueError(f"authority is {value!r}; it must be a list of numbers")
    return tuple(value)


def _weights(data: bytes) -> dict[str, NDArray[np.float32]]:
    from safetensors import SafetensorError
    from safetensors.numpy import load

    try:
        weights: dict[str, NDArray[np.float32]] = load(data)
    except (SafetensorError, ValueError, KeyError, TypeError) as error:
        raise ValueError(f"{WEIGHTS} is not a safetensors file: {error}") from error
    return weights


def _replace(folder: Path, files: Mapping[str, bytes]) -> None:
    """Replace a folder by one with these files."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=f".{folder.name}.", dir=folder.parent) as temporary:
        new, old = Path(temporary) / "new", Path(temporary) / "old"
        new.mkdir()
        for name, data in files.items():
            write_atomically(new / name, data)
        if folder.exists():
            folder.replace(old)
        new.replace(folder)
        synchronise(folder.parent)
        shutil.rmtree(old, ignore_errors=True)

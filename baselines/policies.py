"""Policies by name or path, all with Stable-Baselines3's `predict`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from auv_gym.physics.vehicle import Vehicle
from auv_gym.scenarios.scenario import Scenario
from auv_gym.task.policy import Policy
from baselines.agents.guard import Guarded, bounded_law
from baselines.agents.loading import load_policy
from baselines.agents.names import COMMAND, FADING, agent_folder, guarded_name, is_path, shipped_agents
from baselines.control import POLICIES, make_controller
from baselines.policy import Privileged
from baselines.similar import made_for


def list_policies() -> dict[str, str]:
    """Return the names of the policies with a line about each."""
    agents = {name: f"a trained agent, see baselines/agents/shipped/{name}/card.md" for name in shipped_agents()}
    return {name: text for name, (_, _, text) in POLICIES.items()} | agents


def make_policy(name: str, vehicle: Vehicle | str | Mapping[str, Any] | None = None, **options: Any) -> Policy:
    """Return a policy by name or path; options override those of the entry.

    A path is FILE.py:FACTORY, a FILE.zip of Stable-Baselines3, or "cmd:" and the words of a command, all of which can
    run any code; or a FILE.onnx or the folder of a trained agent, which cannot. An agent's name or folder may be
    followed by `FADING`. Behind any but a command there may be `GUARD`, and "=" and the policy that takes over.

    Args:
        name: one of `list_policies`, FILE.py:FACTORY, a FILE.zip, a FILE.onnx, the folder of an agent, or cmd:COMMAND.
        vehicle: the one that the task knows. None: the paper's. A controller or an agent is made for it in the paper's
            units, see `baselines.similar`, so that its gains follow from the vehicle; what looks behind the observation
            or comes from a file of code is told it as it is, if its factory takes a `vehicle`.
        options: of the factory; numbers with units among them are for the vehicle in the paper's units.

    Raises:
        OSError: the file cannot be read.
        ValueError: the name is unknown, the file holds no policy, or the policy does not take such options.
    """
    if (parts := guarded_name(name)) is not None:
        bare, other = parts

        def guarded(known: Any) -> Policy:
            fallback = make_policy(other, known) if other else bounded_law(known)
            return Guarded(make_policy(bare, known, **options), fallback, known)

        return made_for(vehicle, guarded)
    if name.endswith(FADING) and not name.startswith(COMMAND):
        return make_policy(name.removesuffix(FADING), vehicle, **{"fade": True, **options})
    if is_path(name) or agent_folder(name) is not None:
        return load_policy(name, vehicle, **options)
    if name not in POLICIES:
        known = ", ".join(list_policies())
        raise ValueError(
            f"unknown policy {name!r}; allowed are {known}, FILE.py:FACTORY, a FILE.zip, a FILE.onnx, an "
            "agent's folder or cmd:COMMAND"
        )
    if isinstance(POLICIES[name][0], Privileged):
        return make_controller(name, vehicle, **options)
    return made_for(vehicle, lambda known: make_controller(name, known, **options))


def common_vehicle(scenarios: Sequence[Scenario]) -> Vehicle | None:
    """Return the vehicle that all scenarios know; None where they differ: one policy cannot believe in several."""
    first = scenarios[0].vehicle
    return first if all(scenario.vehicle == first for scenario in scenarios) else None

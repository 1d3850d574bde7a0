"""Makes policies by name or path; all have the `predict` of Stable-Baselines3."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from auv_gym.physics.space import SpaceVehicle
from auv_gym.physics.vehicle import Vehicle
from auv_gym.scenarios.records import meant
from auv_gym.scenarios.scenario import Scenario
from auv_gym.scenarios.vehicles import VehicleLike
from auv_gym.task.policy import Policy
from baselines.agents.agent import Agent
from baselines.agents.guard import Guarded, bounded_law
from baselines.agents.loading import load_policy
from baselines.agents.names import GUARD, PolicyName, shipped_agents
from baselines.control import POLICIES, make_controller
from baselines.scaling import scaled_for
from baselines.space import SPACE_POLICIES, make_in_space
from baselines.tools.files import read_json


def list_policies(space: bool | None = False) -> dict[str, str]:
    """Return a one-line description of each policy by its name: of those in the plane, in `space`, or of all (None).

    Those whose actions are setpoints are left out.
    """
    agents = dict.fromkeys(shipped_agents(space), "a trained agent, described in its agent.json")
    forces = {name: entry.about for name, entry in POLICIES.items() if not entry.setpoints}
    return {name: about for name, about in forces.items() if not space or name in SPACE_POLICIES} | agents


def make_policy(name: str, vehicle: VehicleLike | SpaceVehicle | None = None, **options: Any) -> Policy:
    """Return a policy by name or path.

    These paths can run any code: FILE.py:FACTORY, a FILE.zip of Stable-Baselines3, and "cmd:" with a command. These
    cannot: a FILE.onnx, a FILE.json of `auv-gym tune`, and the folder of a trained agent. Every name but a command may
    end in ":guard", which may be followed by "=" and the name of the fallback policy, see `baselines.agents.guard`.

    Args:
        name: one of `list_policies`, FILE.py:FACTORY, a FILE.zip, a FILE.onnx, a FILE.json with gains, the
            folder of an agent, or cmd:COMMAND.
        vehicle: the known vehicle; None: the paper's. A controller or agent is made for it in the paper's units, see
            `baselines.scaling`, so its gains depend on the vehicle. A privileged policy, or one from a file of code,
            gets the vehicle in SI units, if its factory has a parameter `vehicle`. A `SpaceVehicle` makes a policy in
            space.
        options: options of the factory, in place of those of the registry. Numbers with units are for the vehicle in
            the paper's units.

    Raises:
        OSError: the file cannot be read.
        ValueError: the name is unknown, there is no policy in the file, or the policy has no such option.
    """
    if not isinstance(name, str):
        raise TypeError(f"name is {name!r}; it must be a string; run_episode and check_policy take a policy itself")
    parts, space = PolicyName.of(name), isinstance(vehicle, SpaceVehicle)
    if vehicle is not None and parts.kind != "controller" and parts.base in shipped_agents(not space):
        kinds = ("the plane", "space") if space else ("space", "the plane")
        others = ", ".join(shipped_agents(space))
        raise ValueError("agent {} is for motion in {}; agents for motion in {}: {}".format(name, *kinds, others))
    if isinstance(vehicle, SpaceVehicle):
        if parts.fallback is not None:
            raise ValueError(f"policy {name!r}: there is no guard in space; leave out {GUARD}")
        if parts.kind != "controller":
            return load_policy(parts, vehicle, **options)
        if name in POLICIES and POLICIES[name].privileged:
            return make_in_space(name, vehicle, **options)
        return scaled_for(vehicle, lambda known: make_in_space(name, known, **options))
    if (fallback := parts.fallback) is not None:

        def guarded(known: Any) -> Policy:
            simple = make_policy(fallback, known) if fallback else bounded_law(known)
            return Guarded(make_policy(parts.base, known, **options), simple, known)

        return scaled_for(vehicle, guarded)
    if parts.kind != "controller":
        return load_policy(parts, vehicle, **options)
    if name not in POLICIES:
        if name.endswith(".py"):
            raise ValueError(f"policy {name!r} names no class or factory; write {name}:NAME")
        known = [*POLICIES, *shipped_agents()]
        hint = meant(name, [one + suffix for suffix in ("", GUARD) for one in known])
        raise ValueError(
            f"unknown policy {name!r}{hint}; allowed are {', '.join(known)}, FILE.py:FACTORY, "
            "a FILE.zip, a FILE.onnx, a FILE.json with gains, an agent's folder or cmd:COMMAND"
        )
    if POLICIES[name].privileged:
        return make_controller(name, vehicle, **options)
    return scaled_for(vehicle, lambda known: make_controller(name, known, **options))


def common_vehicle(scenarios: Sequence[Scenario]) -> Vehicle | None:
    """Return the known vehicle of all scenarios; None if they differ, since a policy is made for one vehicle."""
    first = scenarios[0].vehicle
    return first if all(scenario.vehicle == first for scenario in scenarios) else None


def takes_setpoints(name: str) -> bool | None:
    """Return whether a policy's actions are setpoints, see `Scenario.takes_setpoints`; None if it is not known.

    Raises:
        OSError: the file of an agent or of gains cannot be read.
        ValueError: it is damaged.
    """
    base = PolicyName.of(name)
    if base.folder is not None:
        return Agent.load(base.folder).setpoints
    known = read_json(Path(base.base)).get("controller", "") if base.kind == "gains" else base.base
    return POLICIES[known].setpoints if known in POLICIES else None


def check_actions(name: str, scenarios: Iterable[Scenario]) -> None:
    """Raise ValueError if a policy gives forces and the actions of a scenario are setpoints, or the reverse."""
    actions = takes_setpoints(name)
    other = next((s.name for s in scenarios if actions not in (None, s.takes_setpoints)), None)
    if other is not None:
        given, needed = ("setpoints", "forces") if actions else ("forces", "setpoints")
        advice = "" if actions else "; los-setpoints gives setpoints"
        raise ValueError(f"{name} gives {given}, the actions of {other} are {needed}{advice}")

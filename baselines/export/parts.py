"""The parts of an agent for code generation: expert, features, network and command, as graphs and programs.

The graphs are those of the kernels that the policy itself runs, and the program of the network is traced from the
function that computes it, so there is one copy of each equation.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from typing import Any, cast

from auv_gym.codegen.graph import SYMBOLS, Symbol
from auv_gym.codegen.kernel import Kernel
from auv_gym.physics.units import Units, in_paper_units
from auv_gym.physics.vehicle import PAPER_VEHICLE, Vehicle
from auv_gym.scenarios.fitting import changed
from auv_gym.scenarios.presets import PRESETS
from auv_gym.scenarios.records import to_record
from auv_gym.scenarios.vehicles import VehicleModel, as_vehicle
from auv_gym.task.observation import TERMS, Observation, decode, encode
from auv_gym.task.policy import Law, traceable
from auv_gym.task.preview import preview_columns
from auv_gym.task.simulation import PARAMETER_ROWS, PARAMETERS, SAMPLE_ROWS, Parts, start
from baselines.agents.agent import AGENT_FILE, Agent, make_expert
from baselines.agents.names import AGENT_FOLDER, agent_folder, shipped_agents
from baselines.agents.networks import OUTPUTS
from baselines.agents.residual_policy import command_kernel, feature_kernel
from baselines.export.vectors import Program
from baselines.tools.files import read_json

MEASURED_NAMES = ("x [m]", "y [m]", "psi [rad]", "u [m/s]", "v [m/s]", "r [rad/s]")
"""The measured state of the vehicle; velocities are over ground, in body axes."""
REFERENCE_NAMES = ("x [m]", "y [m]", "psi [rad]", "u [m/s]", "v [m/s]", "r [rad/s]", "F_u [N]", "F_r [N m]")
"""The reference at this instant."""
SETTING = ("F_u_max [N]", "F_r_max [N m]", "control period [s]")
"""The limits, which are the commands for an action of 1, and the control period."""


@dataclass(frozen=True, eq=False)
class Exported:
    """The parts of an agent for code generation."""

    name: str
    agent: Agent
    weights_sha256: str
    see: Kernel  # from the observation to features, integrals and the expert's action, `base`
    network: Program  # from features and hidden to correction and next_hidden
    command: Kernel  # from base, authority and correction to the command
    vehicle: Vehicle = PAPER_VEHICLE
    bound_factor: int = 1  # largest `Scenario.bound_factor` of the vehicle's presets

    @property
    def preview(self) -> tuple[int, ...]:
        """Numbers of control periods ahead at which the agent observes the reference."""
        return self.agent.inputs.preview

    @property
    def columns(self) -> tuple[str, ...]:
        """Name, unit and scale of each entry of an observation."""
        terms = tuple(f"{term.name} [{term.unit}] / {term.scale:g}" for term in TERMS)
        return terms + tuple(f"ahead_{n}_{axis} [m]" for n in self.preview for axis in "xy")

    @property
    def encode(self) -> Kernel:
        """The kernel from measurements to an observation, see `measurement_kernel`."""
        return measurement_kernel(self.preview, self.bound_factor)

    @property
    def memory(self) -> dict[str, int]:
        """The size of each array of the memory; all are zero at the start of an episode."""
        sizes = {"integrals": self.agent.inputs.memory, "correction": OUTPUTS, "hidden": self.agent.network.memory}
        return {name: size for name, size in sizes.items() if size}

    @property
    def seen(self) -> dict[str, Sequence[Symbol]]:
        """The results of the kernel `see` that the agent uses."""
        return {name: self.see.results[name] for name in ("integrals", "features", "base")}

    @property
    def periods(self) -> tuple[float, ...]:
        """Control periods [s] of the scenarios on which the agent was trained."""
        time = Units.of(self.vehicle).time
        return tuple(sorted({time * PRESETS[name].control_dt for name in self.agent.scenarios if name in PRESETS}))

    @property
    def facts(self) -> dict[str, str]:
        """The description of the agent in the exported files, by key."""
        return {
            "name": self.name,
            "expert": self.agent.expert,
            "authority": ", ".join(f"{a:g}" for a in self.agent.authority),
            "observation": "; ".join(self.columns),
            "control_period_s": ", ".join(f"{dt:g}" for dt in self.periods),
            "weights_sha256": self.weights_sha256,
            **({} if self.vehicle == PAPER_VEHICLE else {"vehicle": json.dumps(to_record(self.vehicle))}),
        }


def exported(name: str, vehicle: Vehicle | VehicleModel | str = PAPER_VEHICLE) -> Exported:
    """Return the parts of an agent, by its name or its folder, for a vehicle; see `baselines.scaling`.

    The bounds of the observations are those of the vehicle model if a name or a file is given, and the paper's for a
    `Vehicle`.

    Raises:
        OSError: a file of the agent cannot be read.
        ValueError: there is no such agent or vehicle, or the agent cannot be exported because its expert has a memory.
    """
    if (folder := agent_folder(name)) is None:
        raise ValueError(f"{name!r} is no agent; there are {', '.join(shipped_agents())}, or give an agent's folder")
    agent = Agent.load(folder)
    known = as_vehicle(vehicle)
    scaled = in_paper_units(known)
    expert = make_expert(agent.expert, vehicle=scaled)
    if not traceable(expert):
        raise ValueError(f"{name!r} cannot be exported: its expert {agent.expert!r} must be a law without memory")
    record = read_json(folder / AGENT_FILE)
    see, network = feature_kernel(agent.inputs, cast(Law, expert), scaled, Units.of(known)), network_program(agent)
    factors = [1]
    for preset in PRESETS.values():
        with suppress(ValueError):  # the path is too slow for the fins of this vehicle
            factors.append(changed(preset, vehicle).bound_factor)
    here = folder.resolve()
    called = here.parent.name if here.name == AGENT_FOLDER else here.name
    return Exported(called, agent, record["weights_sha256"], see, network, command_kernel(), known, max(factors))


def network_program(agent: Agent, prefix: str = "") -> Program:
    """Return an agent's network as a program on vectors; the names of its constants have the prefix."""
    network = agent.network
    layers = network.prepared(agent.weights)
    constants = {
        f"{prefix}{kind}{i}": array
        for i, layer in enumerate(layers)
        for kind, array in zip(("weight", "bias"), layer, strict=True)
    }
    inputs = {"features": network.inputs, "hidden": network.memory}
    return Program.traced(
        lambda x, hidden: network.forward(layers, x, hidden), constants, inputs, ("correction", "next_hidden")
    )


@cache
def measurement_kernel(preview: tuple[int, ...], bound_factor: int) -> Kernel:
    """Return the kernel from measurements in SI units to an observation, traced from the environment's equations.

    Its arguments are measured (`MEASURED_NAMES`), reference (`REFERENCE_NAMES`), last (the previous command), setting
    (`SETTING`), and with a preview ahead: the displacements x, y, x, y, ... [m] of the reference, in world axes, from
    now to each time of the preview. For the bound factor see `auv_gym.task.observation.bounds`.
    """

    def equation(measured: Any, reference: Any, last: Any, setting: Any, ahead: Any = ()) -> Mapping[str, Any]:
        sample, constants = [0.0] * SAMPLE_ROWS, [0.0] * PARAMETER_ROWS
        sample[: len(reference)] = reference
        constants[PARAMETERS.F_u_max], constants[PARAMETERS.F_r_max], constants[PARAMETERS.h] = setting
        _, terms = start(tuple(measured), sample, Parts().parameters(constants), SYMBOLS)
        rows = encode(Observation(*terms)._replace(a_u=last[0], a_r=last[1]), SYMBOLS, bound_factor)
        o = Observation._make(decode(rows, SYMBOLS))
        return {"observation": [*rows, *preview_columns(ahead, o, SYMBOLS, bound_factor)]}

    rows = {
        "measured": len(MEASURED_NAMES),
        "reference": len(REFERENCE_NAMES),
        "last": OUTPUTS,
        "setting": len(SETTING),
    }
    return Kernel.traced(equation, rows | ({"ahead": 2 * len(preview)} if preview else {}), structural=True)

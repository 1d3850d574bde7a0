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
from auv_gym.effects.autopilot import LARGEST_RISE
from auv_gym.physics.space import SpaceVehicle
from auv_gym.physics.units import Units, in_paper_units
from auv_gym.physics.vehicle import PAPER_VEHICLE, Vehicle
from auv_gym.scenarios.fitting import changed
from auv_gym.scenarios.presets import PRESETS, SPACE_PRESETS
from auv_gym.scenarios.records import meant, to_record
from auv_gym.scenarios.vehicles import PAPER, VehicleModel, as_vehicle, vehicle_model_of
from auv_gym.task.model import Model
from auv_gym.task.policy import Law, traceable
from auv_gym.task.preview import preview_columns
from auv_gym.task.simulation import Parts, start
from baselines.agents.agent import AGENT_FILE, Agent, make_expert
from baselines.agents.names import AGENT_FOLDER, agent_folder, shipped_agents
from baselines.agents.residual_policy import command_kernel, feature_kernel
from baselines.export.vectors import Program
from baselines.tools.files import read_json

_UNITS = {"x": "m", "y": "m", "z": "m", "theta": "rad", "psi": "rad", "u": "m/s", "v": "m/s", "w": "m/s"}
"""Units of states; turn rates have rad/s."""


def _with_units(model: Model) -> tuple[str, ...]:
    return tuple(f"{name} [{_UNITS.get(name, 'rad/s')}]" for name in model.state)


def _forces(model: Model, suffix: str = "") -> tuple[str, ...]:
    return tuple(f"F_{c}{suffix} [{'N' if c == 'u' else 'N m'}]" for c in model.channels)


@dataclass(frozen=True, eq=False)
class Exported:
    """The parts of an agent for code generation."""

    name: str
    agent: Agent
    weights_sha256: str
    see: Kernel  # from the observation to features, integrals and the expert's action, `base`
    network: Program  # from features and hidden to correction and next_hidden
    command: Kernel  # from base, authority and correction to the command
    vehicle: Vehicle | SpaceVehicle = PAPER_VEHICLE
    bound_factor: int = 1  # largest `Scenario.bound_factor` of the vehicle's presets

    @property
    def preview(self) -> tuple[int, ...]:
        """Numbers of control periods ahead at which the agent observes the reference."""
        return self.agent.inputs.preview

    @property
    def model(self) -> Model:
        """The kind of motion."""
        return self.agent.inputs.model

    @property
    def measured(self) -> tuple[str, ...]:
        """The measured state of the vehicle; velocities are over ground, in body axes."""
        return _with_units(self.model)

    @property
    def reference(self) -> tuple[str, ...]:
        """The reference at this instant."""
        return *_with_units(self.model), *_forces(self.model)

    @property
    def setting(self) -> tuple[str, ...]:
        """The limits, which are the commands for an action of 1, and the control period."""
        return *_forces(self.model, "_max"), "control period [s]"

    @property
    def columns(self) -> tuple[str, ...]:
        """Name, unit and scale of each entry of an observation."""
        terms = tuple(f"{term.name} [{term.unit}] / {term.scale:g}" for term in self.model.layout.terms)
        return terms + tuple(f"ahead_{n}_{axis} [m]" for n in self.preview for axis in self.model.position)

    @property
    def encode(self) -> Kernel:
        """The kernel from measurements to an observation, see `measurement_kernel`."""
        return measurement_kernel(self.model, self.preview, self.bound_factor)

    @property
    def memory(self) -> dict[str, int]:
        """The size of each array of the memory; all are zero at the start of an episode."""
        channels, hidden = len(self.model.channels), self.agent.network.memory
        sizes = {"integrals": self.agent.inputs.memory, "correction": channels, "hidden": hidden}
        return {name: size for name, size in sizes.items() if size}

    @property
    def seen(self) -> dict[str, Sequence[Symbol]]:
        """The results of the kernel `see` that the agent uses."""
        return {name: self.see.results[name] for name in ("integrals", "features", "base")}

    @property
    def meaning(self) -> str:
        """What the command means: forces, or setpoints of `auv_gym.effects.autopilot`."""
        if not self.agent.setpoints:
            return ", ".join(f"F_{c} = command[{i}] F_{c}_max" for i, c in enumerate(self.model.channels))
        said = {
            "u": "surge speed u_R (1 + command[{}]) [m/s]",
            "q": f"depth: that of the reference plus {LARGEST_RISE:g} s u_R command[{{}}]",
            "r": "heading psi_R + pi/2 command[{}] [rad]",
        }
        return "setpoints: " + ", ".join(said[c].format(i) for i, c in enumerate(self.model.channels))

    @property
    def periods(self) -> tuple[float, ...]:
        """Control periods [s] of the scenarios on which the agent was trained."""
        known, plane = PRESETS | SPACE_PRESETS, getattr(self.vehicle, "horizontal", self.vehicle)
        time = Units.of(plane).time  # type: ignore[arg-type]
        return tuple(sorted({time * known[name].control_dt for name in self.agent.scenarios if name in known}))

    @property
    def facts(self) -> dict[str, str]:
        """The description of the agent in the exported files, by key."""
        return {
            "name": self.name,
            "expert": self.agent.expert,
            "command": self.meaning,
            "authority": ", ".join(f"{a:g}" for a in self.agent.authority),
            "observation": "; ".join(self.columns),
            "control_period_s": ", ".join(f"{dt:g}" for dt in self.periods),
            "weights_sha256": self.weights_sha256,
            **(
                {}
                if self.vehicle in (PAPER_VEHICLE, PAPER.in_space)
                else {"vehicle": json.dumps(to_record(self.vehicle))}
            ),
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
        names = shipped_agents()
        raise ValueError(
            f"{name!r} is no agent{meant(name, names)}; there are {', '.join(names)}, or an agent's folder"
        )
    agent = Agent.load(folder)
    presets = SPACE_PRESETS if (in_space := agent.inputs.model.name == "space") else PRESETS
    plane = as_vehicle(vehicle)
    known: Any = (vehicle_model_of(vehicle) or PAPER).in_space if in_space else plane
    scaled = known.over(Units.of(plane)) if in_space else in_paper_units(plane)
    expert = make_expert(agent.expert, vehicle=scaled)
    if not traceable(expert):
        raise ValueError(f"{name!r} cannot be exported: its expert {agent.expert!r} must be a law without memory")
    record, units = read_json(folder / AGENT_FILE), Units.of(plane)
    see = feature_kernel(agent.inputs, cast(Law, expert), scaled, units)
    network = network_program(agent)
    factors = [1]
    for preset in presets.values():
        with suppress(ValueError):  # the path is too slow for the fins of this vehicle
            factors.append(changed(preset, vehicle).bound_factor)
    here = folder.resolve()
    called = here.parent.name if here.name == AGENT_FOLDER else here.name
    command = command_kernel(len(agent.authority))
    return Exported(called, agent, record["weights_sha256"], see, network, command, known, max(factors))


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
def measurement_kernel(model: Model, preview: tuple[int, ...], bound_factor: int) -> Kernel:
    """Return the kernel from measurements in SI units to an observation, traced from the environment's equations.

    Its arguments are measured, reference and setting, see `Exported`, last, the previous command, and with a preview
    ahead: the displacements x, y, x, y, ... [m] of the reference, in world axes, from now to each time of the preview,
    in space x, y, z, ... For the bound factor see `auv_gym.task.observation.bounds`.
    """
    layout, channels = model.layout, len(model.channels)

    def equation(measured: Any, reference: Any, last: Any, setting: Any, ahead: Any = ()) -> Mapping[str, Any]:
        sample, constants = [0.0] * model.sample_rows, [0.0] * model.parameter_rows
        sample[: len(reference)] = reference
        for place, number in zip((*model.limits(model.parameters), model.parameters.h), setting, strict=True):
            constants[place] = number
        _, seen = start(tuple(measured), sample, Parts(model=model).parameters(constants), SYMBOLS)
        terms = [*seen]
        for place, command in zip(layout.last, last, strict=True):
            terms[place] = command
        rows = layout.encode(terms, SYMBOLS, bound_factor)
        o = layout.named(layout.decode(rows, SYMBOLS))
        return {"observation": [*rows, *preview_columns(ahead, o, SYMBOLS, bound_factor, model)]}

    rows = {"measured": len(model.state), "reference": model.reference.stop, "last": channels, "setting": channels + 1}
    further = {"ahead": layout.axes * len(preview)} if preview else {}
    return Kernel.traced(equation, rows | further, structural=True)

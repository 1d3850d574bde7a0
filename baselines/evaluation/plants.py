"""Vehicles that another simulator moves, for instance a program: `auv-gym evaluate --plant "cmd:COMMAND"`.

A plant replaces the motion of vehicle and actuators. Task, plan, current, waves, sensors, delays and faults are still
those of the scenario. docs/plants.md has the protocol of programs and examples.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np

from auv_gym.physics.namespaces import ARRAYS, Array, Number
from auv_gym.scenarios.episode import Episode
from auv_gym.scenarios.records import guarded, to_record
from auv_gym.scenarios.scenario import Scenario
from auv_gym.task.kernels import OUTCOMES, MakeSimulator, Outcome, Side
from auv_gym.task.model import Model
from auv_gym.task.simulation import Force, Parts, State, current_at, ordered, plant_row, step
from baselines.tools.programs import COMMAND, Program, ProgramError, cut

PROTOCOL = 1
"""Version of the protocol."""
ANSWER = 60.0
"""Time [s] that a program has for an answer."""


class Plant(Protocol):
    """N vehicles of another simulator; its own actuators have their own lag."""

    def place(self, indices: Any, states: Array, true: Any) -> None:
        """Set the states of n of the vehicles, with their actuators at rest or in equilibrium.

        Args:
            indices: of the vehicles.
            states: rows of `Model.state`, shape (states, n); velocities are relative to the water.
            true: coefficients of the vehicles with their model errors, numbers or rows of shape (n,).
        """

    def advance(self, inputs: Array, dt: float) -> tuple[Array, Array]:
        """Return states and forces of the actuators, shape (channels, N), after dt [s].

        Args:
            inputs: rows of `input_names`, shape (inputs, N): ordered forces, current in the world, external load.
            dt: control period [s].
        """


def input_names(model: Model) -> tuple[str, ...]:
    """Return the names of the inputs of a plant: ordered forces [N], [N m], current [m/s], external load [N], [N m]."""
    return *(f"F_{channel}" for channel in model.channels), *model.current, *model.load


def _rows(coefficients: Any, prefix: str = "") -> dict[str, Number]:
    """Return coefficients by name; those of the planes of a vehicle in space have `level_` or `upright_` before it."""
    rows = dict[str, Number]()
    for name, value in coefficients._asdict().items():
        rows |= _rows(value, f"{name}_") if hasattr(value, "_asdict") else {prefix + name: value}
    return rows


class PlantVehicles:
    """N vehicles of a plant with the interface `kernels.Simulator`; the actuator lag of an episode is ignored.

    Args:
        plant: the vehicles.
        parts: optional parts of the simulation that are in use.
        samples: array for the rows of `simulation.Sample`, shape (T, `Parts.sample_rows`, N).
        parameters: array for the rows of `simulation.Parameters`, shape (`Parts.parameter_rows`, N).
    """

    def __init__(self, plant: Plant, parts: Parts, samples: Array, parameters: Array) -> None:
        n = samples.shape[-1]
        self.parts, self.action, self.outcome = parts, np.zeros((len(parts.model.channels), n)), np.zeros((OUTCOMES, n))
        self.now = Side(np.zeros((parts.plant_rows, n)), np.zeros((parts.model.layout.size, n)))
        self._samples, self._rows, self._plant = samples, parameters, plant

    @property
    def plant(self) -> Any:
        """The present state of the plant: rows of shape (N,)."""
        return self.parts.plant(tuple(self.now.plant))

    def place(self, indices: Any, plant: Array, observation: Array) -> None:
        """Set the plant and the observation of the vehicles with these indices, see `kernels.started`."""
        self.now.plant[:, indices], self.now.observation[:, indices] = plant, observation
        true = self.parts.parameters(tuple(self._rows[:, indices])).coefficients
        self._plant.place(indices, plant[: len(self.parts.model.state)], true)

    def step(self, row: int) -> None:
        """Advance by a control step with `action` and a row of the samples."""
        p = self.parts.parameters(tuple(self._rows))
        with np.errstate(all="ignore"):  # vehicles that have failed may have NaN states
            plant, terms, (reward, failed, squared, saturated) = step(
                self.plant, tuple(self.action), tuple(self._samples[row]), p, ARRAYS, self._moved
            )
            observation = self.parts.model.layout.encode(terms, ARRAYS, self.parts.bound_factor)
        error = np.where(np.isfinite(squared), np.sqrt(squared), p.lost_distance)  # a state of null is a failed vehicle
        self.outcome[:] = Outcome(np.where(np.isfinite(squared), reward, 0.0), failed, error, saturated)
        self.now = Side(np.stack(plant_row(plant)), np.asarray(observation))

    def undo(self) -> None:
        """Raise RuntimeError. Only an environment that cannot plan an episode undoes a step; `rollout` plans none."""
        raise RuntimeError("a step of another simulator cannot be undone")

    def _moved(
        self, state: State, force: Force, command: Force, sample: Sequence[Number], p: Any, ns: Any
    ) -> tuple[State, Force]:
        """Return state and actuator forces one control period later, see `simulation.moved`."""
        del force
        orders, current = ordered(command, state, sample, p, ns), current_at(state, sample, p, ns)
        inputs = np.array(np.broadcast_arrays(*orders, *current, *sample[p.parts.model.load_rows]))
        after, forces = self._plant.advance(inputs, float(np.max(p.h)) * p.parts.substeps)
        return tuple(after), tuple(forces)


def moved_by(factory: Callable[[int], Plant]) -> MakeSimulator:
    """Return the argument `simulator` of `rollout` for the function that makes a plant of N vehicles."""
    return lambda parts, samples, parameters: PlantVehicles(factory(samples.shape[-1]), parts, samples, parameters)


class PlantCommand(NamedTuple):
    """A program that moves the vehicles."""

    command: str  # program and arguments, after `COMMAND`
    most: int  # largest number of vehicles that it moves at once

    def simulator(self, scenario: Scenario, episodes: Sequence[Episode]) -> MakeSimulator:
        """Return the argument `simulator` of `rollout`; the seed of the program is that of the first episode."""
        return moved_by(lambda n: ProgramPlant(self.command, scenario, n, episodes[0].noise_seed))


class ProgramPlant:
    """A program as a `Plant`.

    Attributes:
        most: largest number of vehicles that it moves at once.
    """

    def __init__(self, command: str, scenario: Scenario, n: int, seed: int, most: int = 512) -> None:
        """Start a program and send the greeting.

        Args:
            command: program and arguments.
            scenario: of the episodes.
            n: number of vehicles.
            seed: for random numbers of the program.
            most: default of the largest number of vehicles.

        Raises:
            ProgramError: the program cannot be started, or an answer is wrong.
        """
        self._model, self._n, self._program = scenario.parts.model, n, Program(command)
        with self._program.errors():
            answer = self._program.ask(greeting(scenario, n, seed), ANSWER)
            if unknown := sorted(set(answer) - {"most"}):
                raise ProgramError(f"its greeting has the entry {unknown[0]!r}; allowed is only 'most'")
            self.most = answer.get("most", most)
            if not isinstance(self.most, int) or not 1 <= self.most <= most:
                raise ProgramError(f"its greeting has most {self.most!r}; it must be an integer in [1, {most}]")

    def place(self, indices: Any, states: Array, true: Any) -> None:
        """Set states, see `Plant`."""
        parameters = np.array([np.broadcast_to(x, states.shape[1]) for x in _rows(true).values()])
        places = np.broadcast_to(indices, states.shape[1])
        with self._program.errors():
            question = {"place": places.tolist(), "states": states.T.tolist(), "parameters": parameters.T.tolist()}
            if answer := self._program.ask(question, ANSWER):
                raise ProgramError(f"it answers {cut(str(answer))} to new states; it must be {{}}")

    def advance(self, inputs: Array, dt: float) -> tuple[Array, Array]:
        """Return states and forces, see `Plant`; without an answer on forces they are the ordered ones."""
        del dt
        channels = len(self._model.channels)
        with self._program.errors():
            answer = self._program.ask({"inputs": np.nan_to_num(inputs).T.tolist()}, ANSWER)
            if not {"states"} <= set(answer) <= {"states", "forces"}:
                raise ProgramError(f"it answers {sorted(answer)}; it must be states, with or without forces")
            states = self._table("states", answer["states"], len(self._model.state))
            forces = self._table("forces", answer["forces"], channels) if "forces" in answer else inputs[:channels]
        return states, forces

    def _table(self, name: str, rows: Any, columns: int) -> Array:
        """Return rows of numbers as an array, shape (columns, n); null becomes nan."""
        with guarded(f"its {name}"):
            table = np.array(rows)
            if table.dtype.kind not in "ifO":  # numbers, or numbers and null
                raise TypeError(f"{cut(str(rows))} has entries that are no numbers")
            table = table.astype(np.float64)
        if table.shape != (self._n, columns):
            raise ProgramError(f"its {name} have shape {table.shape}; it must be ({self._n}, {columns})")
        return table.T


def greeting(scenario: Scenario, n: int, seed: int) -> dict[str, Any]:
    """Return the first message to a plant."""
    model, known = scenario.parts.model, scenario.bare
    return {
        "auv_gym": PROTOCOL,
        "motion": model.name,
        "name": scenario.model.name if scenario.model else "",
        "vehicles": n,
        "dt": scenario.control_dt,
        "seed": seed,
        "states": list(model.state),
        "inputs": list(input_names(model)),
        "parameters": list(_rows(known.coefficients)),
        "vehicle": to_record(known),
    }


def checked_plant(name: str, scenarios: Iterable[Scenario]) -> PlantCommand:
    """Return the program of `--plant` after one step of a vehicle at rest in each kind of scenario.

    Raises:
        ValueError: the name is no command, or the program cannot be used.
    """
    if not name.startswith(COMMAND):
        raise ValueError(f"the plant is {name!r}; it must be {COMMAND!r} and a command")
    command, most = name.removeprefix(COMMAND), list[int]()
    for scenario in {(s.parts.model, s.control_dt): s for s in scenarios}.values():
        plant, model = ProgramPlant(command, scenario, 1, 0), scenario.parts.model
        plant.place(np.arange(1), np.zeros((len(model.state), 1)), scenario.bare.coefficients)
        plant.advance(np.zeros((len(input_names(model)), 1)), scenario.control_dt)
        most.append(plant.most)
    return PlantCommand(command, min(most))

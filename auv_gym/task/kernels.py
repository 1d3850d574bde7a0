"""The simulation as kernels, and the vehicles whose memory compiled code reads and writes.

The equations are those of `simulation`, `observation` and `policy`, which are traced here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from typing import Any, NamedTuple, Protocol

import numpy as np

from auv_gym.codegen.graph import SYMBOLS, single
from auv_gym.codegen.kernel import Kernel, KernelRun, together
from auv_gym.physics.namespaces import Array
from auv_gym.physics.rows import flatten, unflatten
from auv_gym.task.observation import SIZE, action_of, decode, encode
from auv_gym.task.policy import Forces, corrected
from auv_gym.task.simulation import (
    PARAMETER_ROWS,
    PLANT,
    PLANT_ROWS,
    SAMPLE_ROWS,
    Parameters,
    Parts,
    Plant,
    start,
    step,
)

ACTIONS = 2  # number of actions, surge and yaw
STATES = 6  # number of rows of a `dynamics.State`


class Outcome(NamedTuple):
    """The outcome of a control step: floats, or rows of shape (N,)."""

    reward: Any
    failed: Any  # 1 where the episode has failed, else 0
    error: Any  # [m] position error
    saturated: Any  # 1 where an actuator was commanded to its limit, else 0


OUTCOMES = len(Outcome._fields)  # number of rows of an outcome


def _observed(terms: Sequence[Any], forces: Forces | None, parts: Parts) -> list[Any]:
    """Return the rows of an observation, with the action of a control law appended if there is one."""
    rows: list[Any] = encode(terms, SYMBOLS, parts.span)
    if forces is None:
        return rows
    o = decode(rows, SYMBOLS)
    return [*rows, *map(single, action_of(forces(o, SYMBOLS), o, SYMBOLS))]  # single precision, as `Law.predict`


@lru_cache(maxsize=64)
def step_kernel(parts: Parts, forces: Forces | None = None, *, carried: bool = False) -> Kernel:
    """Return the kernel of a control step, from plant and observation to the next ones, with the outcome.

    Args:
        parts: the parts of the simulation in use.
        forces: of the control law that actions correct, see `policy.corrected`; None if actions are commands.
        carried: whether the next plant and observation replace the present ones.
    """
    after = "" if carried else "next_"

    def equation(
        plant: Any, seen: Any, action: Any, authority: Any, samples: Any, parameters: Any
    ) -> Mapping[str, Sequence[Any]]:
        if forces is not None:
            base = seen[SIZE:]
            action = [corrected(*three, SYMBOLS) for three in zip(base, authority, action, strict=True)]
        p = Parameters.of(parameters, parts)
        moved, terms, (reward, failed, squared_error, saturated) = step(
            unflatten(PLANT, plant), action, samples, p, SYMBOLS
        )
        outcome = Outcome(reward, failed, SYMBOLS.sqrt(squared_error), saturated)
        return {f"{after}plant": flatten(moved), f"{after}seen": _observed(terms, forces, parts), "outcome": outcome}

    rows = {"plant": PLANT_ROWS, "seen": columns(forces), "action": ACTIONS, "authority": ACTIONS}
    return Kernel.traced(equation, {**rows, "samples": SAMPLE_ROWS, "parameters": PARAMETER_ROWS}, ["samples"])


@lru_cache(maxsize=64)
def start_kernel(parts: Parts, forces: Forces | None = None) -> Kernel:
    """Return the kernel of `simulation.start`, from a state to the plant and the first observation."""

    def equation(state: Any, sample: Any, parameters: Any) -> Mapping[str, Sequence[Any]]:
        plant, terms = start(tuple(state), sample, Parameters.of(parameters, parts), SYMBOLS)
        return {"plant": flatten(plant), "seen": _observed(terms, forces, parts)}

    return Kernel.traced(equation, {"state": STATES, "sample": SAMPLE_ROWS, "parameters": PARAMETER_ROWS})


def started(
    parts: Parts, states: Array, sample: Array, parameters: Array, forces: Forces | None = None
) -> tuple[Array, Array]:
    """Return plants, shape (PLANT_ROWS, n), and observations, shape (columns, n), at the start of n episodes.

    Args:
        parts: the parts of the simulation in use.
        states: x, y [m], psi [rad], u, v [m/s] relative to the water, r [rad/s], shape (STATES, n).
        sample: rows of the first `simulation.Sample`, shape (SAMPLE_ROWS, n).
        parameters: rows of the `simulation.Parameters`, shape (PARAMETER_ROWS, n).
        forces: of the control law whose action is appended to observations; None without one.
    """
    results = start_kernel(parts, forces)(state=states, sample=sample, parameters=parameters)
    return results["plant"], results["seen"]


def columns(forces: Forces | None) -> int:
    """Return the number of columns of an observation, with the action of a control law if there is one."""
    return SIZE if forces is None else SIZE + ACTIONS


class Side(NamedTuple):
    """The arrays of N vehicles at one control instant."""

    plant: Array  # shape (PLANT_ROWS, N)
    seen: Array  # observation, shape (columns, N)
    outcome: Array  # outcome of the last step, shape (OUTCOMES, N)


class Bodies(Protocol):
    """The interface of the N vehicles of an environment; `Vehicles` implements it by the equations of motion."""

    action: Array
    now: Side

    @property
    def plant(self) -> Plant:
        """The present plants, rows of shape (N,)."""

    def place(self, indices: Any, plant: Array, seen: Array) -> None:
        """Set the plants and observations of n vehicles to those of `started`."""

    def step(self, row: int) -> None:
        """Advance by a control step with `action` and the sample of an index."""

    def undo(self) -> None:
        """Undo the last step."""


MadeBodies = Callable[[Parts, Array, Array], Bodies]
"""Makes vehicles, for the parts in use and the arrays of samples and parameters, see `Vehicles`."""


class Vehicles:
    """N vehicles; a step writes to a second set of arrays, so the last step can be undone.

    Attributes:
        action: actions of the next step, shape (ACTIONS, N); commands, or corrections to a control law.
        now: the present plants, observations and outcomes.
    """

    def __init__(
        self,
        parts: Parts,
        samples: Array,
        parameters: Array,
        forces: Forces | None = None,
        authority: Sequence[float] = (0.0, 0.0),
    ) -> None:
        """Make N vehicles.

        Args:
            parts: the parts of the simulation in use.
            samples: array for the rows of `simulation.Sample`, shape (T, SAMPLE_ROWS, N).
            parameters: array for the rows of `simulation.Parameters`, shape (PARAMETER_ROWS, N).
            forces: of the control law that actions correct; None if actions are commands.
            authority: largest corrections of surge and yaw.

        Raises:
            TypeError: the law branches on values of the observation.
        """
        n = samples.shape[-1]
        self.parts, self.forces, self.action = parts, forces, np.zeros((ACTIONS, n))
        self._run: KernelRun
        self._run_back: KernelRun
        self._samples, self._parameters = samples, parameters
        self._authority = np.repeat(np.array(authority, dtype=np.float64)[:, None], n, axis=1)
        sizes = PLANT_ROWS, columns(forces), OUTCOMES
        self.now, self._other = (Side(*(np.zeros((rows, n)) for rows in sizes)) for _ in range(2))
        self._run = self._run_back = self._first_run
        if forces is not None:
            step_kernel(parts, forces)  # raises TypeError for a law that cannot be traced

    def _first_run(self, first: int, steps: int) -> None:
        """Compile and run the first step; these vehicles may be replaced before it, so it is not compiled earlier."""
        kernel = step_kernel(self.parts, self.forces)
        self._run, self._run_back = (
            kernel.bound(
                plant=now.plant,
                seen=now.seen,
                action=self.action,
                authority=self._authority,
                samples=self._samples,
                parameters=self._parameters,
                next_plant=after.plant,
                next_seen=after.seen,
                outcome=after.outcome,
            )
            for now, after in ((self.now, self._other), (self._other, self.now))
        )
        self._run(first, steps)

    def __getstate__(self) -> dict[str, Any]:
        """Return all attributes except addresses."""
        return {key: value for key, value in self.__dict__.items() if key not in ("_run", "_run_back")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Set all attributes; addresses are determined again."""
        self.__dict__.update(state)
        self._run = self._run_back = self._first_run

    def place(self, indices: Any, plant: Array, seen: Array) -> None:
        """Set the plants and observations of n vehicles to those of `started`."""
        self.now.plant[:, indices], self.now.seen[:, indices] = plant, seen

    def step(self, row: int) -> None:
        """Advance by a control step with `action` and the sample of an index."""
        self._run(row, 1)
        self.now, self._other, self._run, self._run_back = self._other, self.now, self._run_back, self._run

    def undo(self) -> None:
        """Undo the last step."""
        self.now, self._other, self._run, self._run_back = self._other, self.now, self._run_back, self._run

    @property
    def plant(self) -> Plant:
        """The present plants, rows of shape (N,)."""
        return unflatten(PLANT, tuple(self.now.plant))


class OneVehicle:
    """A single vehicle with a fast step, which cannot be undone.

    Attributes:
        action: actions of the next step, `ACTIONS` numbers; commands, or corrections to a control law.
        outcome: the numbers of the `Outcome` of the last step.
        seen: the present observation, shape (columns,).
        step: advances by several control steps, for the index of the first sample and the number of steps.
    """

    def __init__(
        self,
        parts: Parts,
        samples: Array,
        parameters: Array,
        forces: Forces | None = None,
        authority: Sequence[float] = (0.0, 0.0),
    ) -> None:
        """Make a vehicle; the arguments are those of `Vehicles`.

        Raises:
            TypeError: the law branches on values of the observation.
        """
        self._parts, self._forces = parts, forces
        sizes = {"plant": PLANT_ROWS, "seen": columns(forces), "outcome": OUTCOMES, "action": ACTIONS, "state": STATES}
        self._arrays = {name: np.zeros((rows, 1)) for name, rows in sizes.items()}
        self._arrays |= {"authority": np.array(authority)[:, None], "samples": samples, "parameters": parameters}
        if forces is not None:
            step_kernel(parts, forces, carried=True)  # raises TypeError for a law that cannot be traced
        self._make_views()

    def _make_views(self) -> None:
        self.action, self.outcome = (self._arrays[name].ravel().data for name in ("action", "outcome"))
        self.seen = self._arrays["seen"][:, 0]
        self.step: Callable[[int, int], None] = self._first_step
        self._start: Callable[[int, int], None] | None = None

    def __getstate__(self) -> dict[str, Any]:
        """Return all attributes except views and addresses."""
        return {key: self.__dict__[key] for key in ("_parts", "_forces", "_arrays")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Set all attributes; addresses are determined again."""
        self.__dict__.update(state)
        self._make_views()

    def _bind(self) -> None:
        """Compile the kernels; this vehicle may be replaced before its first use, so they are not compiled earlier."""
        kernels = {
            "step": step_kernel(self._parts, self._forces, carried=True),
            "start": start_kernel(self._parts, self._forces),
        }
        together(kernels, many=False)
        arrays = {**self._arrays, "sample": self._arrays["samples"][0]}
        self.step, self._start = (
            kernel.bound(**{name: arrays[name] for name in kernel.rows}) for kernel in kernels.values()
        )

    def _first_step(self, first: int, steps: int) -> None:
        self._bind()
        self.step(first, steps)

    def start(self, state: Array) -> None:
        """Start an episode in a state, shape (STATES, 1), with the first of the samples; see `started`."""
        self._arrays["state"][:] = state
        if self._start is None:
            self._bind()
        assert self._start is not None
        self._start(0, 1)

    @property
    def plant(self) -> Array:
        """The numbers of its `simulation.Plant`, shape (PLANT_ROWS,)."""
        plant: Array = self._arrays["plant"][:, 0]
        return plant

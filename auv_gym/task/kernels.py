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
from auv_gym.task.policy import Law, corrected
from auv_gym.task.simulation import Parts, plant_row, start, step


class Outcome(NamedTuple):
    """The outcome of a control step: floats, or rows of shape (N,)."""

    reward: Any
    failed: Any  # 1 where the episode has failed, else 0
    error: Any  # [m] position error
    saturated: Any  # 1 where an actuator was commanded to its limit, else 0


OUTCOMES = len(Outcome._fields)  # number of rows of an outcome


def _observed(terms: Sequence[Any], law: Law | None, parts: Parts) -> list[Any]:
    """Return the rows of an observation, with the action of a control law appended if there is one."""
    layout = parts.model.layout
    rows: list[Any] = layout.encode(terms, SYMBOLS, parts.bound_factor)
    if law is None:
        return rows
    o = layout.decode(rows, SYMBOLS)
    action = layout.action_of(law.forces(o, SYMBOLS), o, SYMBOLS)
    return [*rows, *map(single, action)]  # single precision, as `Law.predict`


@lru_cache(maxsize=64)
def step_kernel(parts: Parts, law: Law | None = None, *, carried: bool = False) -> Kernel:
    """Return the kernel of a control step, from plant and observation to the next ones, with the outcome.

    Args:
        parts: the parts of the simulation in use.
        law: the control law that actions correct, see `policy.corrected`; None if actions are commands.
        carried: whether the next plant and observation replace the present ones.
    """
    after = "" if carried else "next_"

    def equation(
        plant: Any, seen: Any, action: Any, authority: Any, samples: Any, parameters: Any
    ) -> Mapping[str, Sequence[Any]]:
        if law is not None:
            base = seen[parts.model.layout.size :]
            action = [corrected(*three, SYMBOLS) for three in zip(base, authority, action, strict=True)]
        before, p = parts.plant(plant), parts.parameters(parameters)
        moved, terms, (reward, failed, squared_error, saturated) = step(before, action, samples, p, SYMBOLS)
        outcome = Outcome(reward, failed, SYMBOLS.sqrt(squared_error), saturated)
        return {f"{after}plant": plant_row(moved), f"{after}seen": _observed(terms, law, parts), "outcome": outcome}

    actions = len(parts.model.channels)
    rows = {"plant": parts.plant_rows, "seen": columns(parts, law), "action": actions, "authority": actions}
    rows |= {"samples": parts.sample_rows, "parameters": parts.parameter_rows}
    return Kernel.traced(equation, rows, ["samples"])


@lru_cache(maxsize=64)
def start_kernel(parts: Parts, law: Law | None = None) -> Kernel:
    """Return the kernel of `simulation.start`, from a state to the plant and the first observation."""

    def equation(state: Any, sample: Any, parameters: Any) -> Mapping[str, Sequence[Any]]:
        plant, terms = start(tuple(state), sample, parts.parameters(parameters), SYMBOLS)
        return {"plant": plant_row(plant), "seen": _observed(terms, law, parts)}

    rows = {"state": len(parts.model.state), "sample": parts.sample_rows, "parameters": parts.parameter_rows}
    return Kernel.traced(equation, rows)


def started(
    parts: Parts, states: Array, sample: Array, parameters: Array, law: Law | None = None
) -> tuple[Array, Array]:
    """Return plants, shape (`Parts.plant_rows`, n), and observations, shape (columns, n), at the start of n episodes.

    Args:
        parts: the parts of the simulation in use.
        states: x, y [m], psi [rad], u, v [m/s] relative to the water, r [rad/s], shape (states, n).
        sample: rows of the first `simulation.Sample`, shape (`Parts.sample_rows`, n).
        parameters: rows of the `simulation.Parameters`, shape (`Parts.parameter_rows`, n).
        law: the control law whose action is appended to observations; None without one.
    """
    results = start_kernel(parts, law)(state=states, sample=sample, parameters=parameters)
    return results["plant"], results["seen"]


def columns(parts: Parts, law: Law | None) -> int:
    """Return the number of columns of an observation, with the action of a control law if there is one."""
    return parts.model.layout.size + (0 if law is None else len(parts.model.channels))


class Side(NamedTuple):
    """The arrays of N vehicles at one control instant."""

    plant: Array  # shape (`Parts.plant_rows`, N)
    observation: Array  # shape (columns, N)


class Simulator(Protocol):
    """The interface of N simulated vehicles; `Vehicles` implements it by the equations of motion."""

    action: Array
    outcome: Array
    now: Side

    @property
    def plant(self) -> Any:
        """The present plants, rows of shape (N,)."""

    def place(self, indices: Any, plant: Array, observation: Array) -> None:
        """Set the plants and observations of n vehicles to those of `started`."""

    def step(self, row: int) -> None:
        """Advance by a control step with `action` and the sample of an index."""

    def undo(self) -> None:
        """Undo the last step, except for `outcome`."""


MakeSimulator = Callable[[Parts, Array, Array], Simulator]
"""Makes N simulated vehicles, for the parts in use and the arrays of samples and parameters, see `Vehicles`."""


class Vehicles:
    """N vehicles, whose memory compiled code reads and writes.

    Args:
        parts: the parts of the simulation in use.
        samples: array for the rows of `simulation.Sample`, shape (T, `Parts.sample_rows`, N).
        parameters: array for the rows of `simulation.Parameters`, shape (`Parts.parameter_rows`, N).
        law: the control law that actions correct; None if actions are commands.
        authority: largest corrections of the channels; none without a law.
        undoable: whether the last step can be undone: each step then writes to a second set of arrays.

    Attributes:
        action: actions of the next step, shape (channels, N); commands, or corrections to a control law.
        outcome: rows of the `Outcome` of the last step, shape (OUTCOMES, N).
        now: the present plants and observations; if steps cannot be undone, these arrays stay the same.
        run: if steps cannot be undone, advances by several of them in less time than `step`; it takes the index of the
            first sample and the number of steps.

    Raises:
        TypeError: the law branches on values of the observation.
    """

    def __init__(
        self,
        parts: Parts,
        samples: Array,
        parameters: Array,
        law: Law | None = None,
        authority: Sequence[float] = (),
        *,
        undoable: bool = True,
    ) -> None:
        n = samples.shape[-1]
        self.parts, self.law = parts, law
        self.action, self.outcome = np.zeros((len(parts.model.channels), n)), np.zeros((OUTCOMES, n))
        now, other = (Side(np.zeros((parts.plant_rows, n)), np.zeros((columns(parts, law), n))) for _ in range(2))
        self.now, self._other = now, other if undoable else now
        self._inputs = {
            "action": self.action,
            "authority": np.repeat(np.array(authority or [0.0] * len(self.action))[:, None], n, axis=1),
            "samples": samples,
            "parameters": parameters,
            "state": np.zeros((len(parts.model.state), n)),
        }
        self._unbind()
        if law is not None:
            _ = self._step_kernel  # raises TypeError for a law that cannot be traced

    @property
    def _step_kernel(self) -> Kernel:
        return step_kernel(self.parts, self.law, carried=self._other is self.now)

    def _unbind(self) -> None:
        """Forget all addresses. The vehicles may be replaced before their first step, so it compiles the kernels."""
        self.run: KernelRun = self._first_run
        self._run_back: KernelRun = self._first_run
        self._start: KernelRun | None = None

    def _first_run(self, first: int, steps: int) -> None:
        kernel = self._step_kernel
        self.run, self._run_back = (
            self._bound(kernel, *sides) for sides in ((self.now, self._other), (self._other, self.now))
        )
        self.run(first, steps)

    def _bound(self, kernel: Kernel, before: Side, after: Side) -> KernelRun:
        """Return the function of a kernel that reads and writes the arrays of these vehicles."""
        arrays = {
            **self._inputs,
            "sample": self._inputs["samples"][0],
            "plant": before.plant,
            "seen": before.observation,
            "next_plant": after.plant,
            "next_seen": after.observation,
            "outcome": self.outcome,
        }
        return kernel.bound(**{name: arrays[name] for name in kernel.rows})

    def __getstate__(self) -> dict[str, Any]:
        """Return all attributes except addresses."""
        return {key: value for key, value in self.__dict__.items() if key not in ("run", "_run_back", "_start")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Set all attributes; addresses are determined again."""
        self.__dict__.update(state)
        self._unbind()

    def start(self, states: Array) -> None:
        """Place all vehicles as `started` does for the first of the samples; steps must not be undoable.

        Args:
            states: see `started`.
        """
        if self._start is None:
            kernels = {"step": self._step_kernel, "start": start_kernel(self.parts, self.law)}
            together(kernels, many=False)
            self._start = self._bound(kernels["start"], self.now, self.now)
        self._inputs["state"][:] = states
        self._start(0, 1)

    def place(self, indices: Any, plant: Array, observation: Array) -> None:
        """Set the plants and observations of n vehicles to those of `started`."""
        self.now.plant[:, indices], self.now.observation[:, indices] = plant, observation

    def step(self, row: int) -> None:
        """Advance by a control step with `action` and the sample of an index."""
        self.run(row, 1)
        self.now, self._other, self.run, self._run_back = self._other, self.now, self._run_back, self.run

    def undo(self) -> None:
        """Undo the last step, except for `outcome`."""
        self.now, self._other, self.run, self._run_back = self._other, self.now, self._run_back, self.run

    @property
    def plant(self) -> Any:
        """The present plants, rows of shape (N,)."""
        return self.parts.plant(tuple(self.now.plant))

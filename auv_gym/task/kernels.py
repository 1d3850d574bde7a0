"""The simulation as kernels: vehicles in memory that compiled code reads and writes, one control step at a time.

The equations are those of `simulation`, `task` and `policy`, traced here and written nowhere else.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from typing import Any, NamedTuple, Protocol

import numpy as np

from auv_gym.codegen.graph import SYMBOLS, single
from auv_gym.codegen.kernel import Kernel, KernelRun, together
from auv_gym.physics.namespaces import Array
from auv_gym.physics.rows import filled, leaves
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

ACTIONS = 2  # surge and yaw
STATES = 6  # rows of a `dynamics.State`


class Outcome(NamedTuple):
    """What the task makes of a control step: floats, or rows of shape (N,)."""

    reward: Any
    failed: Any  # 1 where the vehicle is lost, else 0
    error: Any  # [m] of the position
    saturated: Any  # 1 where an actuator was commanded to its limit, else 0


OUTCOMES = len(Outcome._fields)  # how many rows an outcome has


def _observed(terms: Sequence[Any], forces: Forces | None, parts: Parts) -> list[Any]:
    """Return the rows of an observation, and behind them the action of a law, if there is one."""
    rows: list[Any] = encode(terms, SYMBOLS, parts.span)
    if forces is None:
        return rows
    o = decode(rows, SYMBOLS)
    return [*rows, *map(single, action_of(forces(o, SYMBOLS), o, SYMBOLS))]  # as `Law.predict` gives it


@lru_cache(maxsize=64)
def step_kernel(parts: Parts, forces: Forces | None = None, *, carried: bool = False) -> Kernel:
    """Return the kernel of a control step: from plant and observation `now` to those of `next`, with the outcome.

    Args:
        parts: what is in use of the simulation.
        forces: of the law that actions correct by up to an authority, see `policy.corrected`; None: actions command.
        carried: whether those of `next` take the place of those of now.
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
            filled(PLANT, plant), action, samples, p, SYMBOLS
        )
        outcome = Outcome(reward, failed, SYMBOLS.sqrt(squared_error), saturated)
        return {f"{after}plant": leaves(moved), f"{after}seen": _observed(terms, forces, parts), "outcome": outcome}

    rows = {"plant": PLANT_ROWS, "seen": columns(forces), "action": ACTIONS, "authority": ACTIONS}
    return Kernel.traced(equation, {**rows, "samples": SAMPLE_ROWS, "parameters": PARAMETER_ROWS}, ["samples"])


@lru_cache(maxsize=64)
def start_kernel(parts: Parts, forces: Forces | None = None) -> Kernel:
    """Return the kernel of `simulation.start`, from a state to a plant and its first observation."""

    def equation(state: Any, sample: Any, parameters: Any) -> Mapping[str, Sequence[Any]]:
        plant, terms = start(tuple(state), sample, Parameters.of(parameters, parts), SYMBOLS)
        return {"plant": leaves(plant), "seen": _observed(terms, forces, parts)}

    return Kernel.traced(equation, {"state": STATES, "sample": SAMPLE_ROWS, "parameters": PARAMETER_ROWS})


def begun(
    parts: Parts, states: Array, sample: Array, parameters: Array, forces: Forces | None = None
) -> tuple[Array, Array]:
    """Return plants, shape (PLANT_ROWS, n), and observations, shape (columns, n), at the start of n episodes.

    Args:
        parts: what is in use of the simulation.
        states: x, y [m], psi [rad], u, v [m/s] relative to the water, r [rad/s], shape (STATES, n).
        sample: rows of their `simulation.Sample` there, shape (SAMPLE_ROWS, n).
        parameters: rows of their `simulation.Parameters`, shape (PARAMETER_ROWS, n).
        forces: of a law whose action is observed as well.
    """
    results = start_kernel(parts, forces)(state=states, sample=sample, parameters=parameters)
    return results["plant"], results["seen"]


def columns(forces: Forces | None) -> int:
    """Return how many numbers an observation has, the action of a law included."""
    return SIZE if forces is None else SIZE + ACTIONS


class Side(NamedTuple):
    """What is known at one control instant, rows of N vehicles."""

    plant: Array  # shape (PLANT_ROWS, N)
    seen: Array  # the observation, shape (columns, N)
    outcome: Array  # of the step that led here, shape (OUTCOMES, N)


class Bodies(Protocol):
    """N vehicles that an environment steps; see `Vehicles`, which are those of the equations of motion."""

    action: Array
    now: Side

    @property
    def plant(self) -> Plant:
        """What is now: rows of shape (N,)."""

    def place(self, lanes: Any, plant: Array, seen: Array) -> None:
        """Put n of the vehicles, an index of which is given, where `begun` says, now."""

    def step(self, row: int) -> None:
        """Go on by a control step, with `action` and a row of the samples."""

    def undo(self) -> None:
        """Take the last step back."""


MadeBodies = Callable[[Parts, Array, Array], Bodies]
"""Makes vehicles of the parts in use, and where samples and parameters will be, see `Vehicles`."""


class Vehicles:
    """N vehicles, stepped by a kernel from one side of a memory to the other, so that the last step can be undone.

    Attributes:
        action: what they do in the next step, shape (ACTIONS, N); commands, or corrections to a law.
        now: the plants, shape (PLANT_ROWS, N), what is `seen` of them, shape (columns, N), and the `outcome` of the
            step that led here, the rows of an `Outcome`.
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
            parts: what is in use of the simulation.
            samples: where the rows of `simulation.Sample` will be, shape (T, SAMPLE_ROWS, N).
            parameters: where the rows of `simulation.Parameters` will be, shape (PARAMETER_ROWS, N).
            forces: of a law that actions correct; None: they command.
            authority: largest corrections of surge and yaw.

        Raises:
            TypeError: the law branches on what is observed.
        """
        n = samples.shape[-1]
        self.parts, self.forces, self.action = parts, forces, np.zeros((ACTIONS, n))
        self._run: KernelRun
        self._run_back: KernelRun
        self._samples, self._parameters = samples, parameters
        self._authority = np.repeat(np.array(authority, dtype=np.float64)[:, None], n, axis=1)
        sizes = PLANT_ROWS, columns(forces), OUTCOMES
        self.now, self._other = (Side(*(np.zeros((rows, n)) for rows in sizes)) for _ in range(2))
        self._run = self._run_back = self._begin
        if forces is not None:
            step_kernel(parts, forces)  # refuses a law that cannot be traced

    def _begin(self, first: int, steps: int) -> None:
        """Compile the step when it is first taken: until then a law may come, and other vehicles with it."""
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
        """Return everything but the addresses of this memory."""
        return {key: value for key, value in self.__dict__.items() if key not in ("_run", "_run_back")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take everything up, at new addresses."""
        self.__dict__.update(state)
        self._run = self._run_back = self._begin

    def place(self, lanes: Any, plant: Array, seen: Array) -> None:
        """Put n of the vehicles, an index of which is given, where `begun` says, now."""
        self.now.plant[:, lanes], self.now.seen[:, lanes] = plant, seen

    def step(self, row: int) -> None:
        """Go on by a control step, with `action` and a row of the samples."""
        self._run(row, 1)
        self.now, self._other, self._run, self._run_back = self._other, self.now, self._run_back, self._run

    def undo(self) -> None:
        """Take the last step back."""
        self.now, self._other, self._run, self._run_back = self._other, self.now, self._run_back, self._run

    @property
    def plant(self) -> Plant:
        """What is now: rows of shape (N,)."""
        return filled(PLANT, tuple(self.now.plant))


class OneVehicle:
    """One of the `Vehicles`, whose step costs little more than a call; it cannot be undone.

    Attributes:
        action: what it does in the next step, `ACTIONS` numbers; commands, or corrections to a law.
        outcome: the numbers of the `Outcome` of the last step.
        seen: what is observed now, shape (columns,).
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
            TypeError: the law branches on what is observed.
        """
        self._parts, self._forces = parts, forces
        sizes = {"plant": PLANT_ROWS, "seen": columns(forces), "outcome": OUTCOMES, "action": ACTIONS, "state": STATES}
        self._arrays = {name: np.zeros((rows, 1)) for name, rows in sizes.items()}
        self._arrays |= {"authority": np.array(authority)[:, None], "samples": samples, "parameters": parameters}
        if forces is not None:
            step_kernel(parts, forces, carried=True)  # refuses a law that cannot be traced
        self._show()

    def _show(self) -> None:
        self.action, self.outcome = (self._arrays[name].ravel().data for name in ("action", "outcome"))
        self.seen = self._arrays["seen"][:, 0]
        self.step: Callable[[int, int], None] = self._first_step
        """Goes on by control steps, given the first of the samples and how many there are."""
        self._start: Callable[[int, int], None] | None = None

    def __getstate__(self) -> dict[str, Any]:
        """Return everything but views and addresses of this memory."""
        return {key: self.__dict__[key] for key in ("_parts", "_forces", "_arrays")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take everything up, at new addresses."""
        self.__dict__.update(state)
        self._show()

    def _bind(self) -> None:
        """Compile what has not been needed before: until then a law may come, and another vehicle with it."""
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
        """Begin an episode in a state, see `begun`, whose first sample is the first of the samples."""
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

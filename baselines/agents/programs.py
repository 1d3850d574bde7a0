"""Policies that are separate programs in any language: `cmd:./my_controller --option`.

The program reads lines of JSON from its standard input and answers each with a line on its standard output. The first
line is a greeting, then there is a batch of observations per control instant. `docs/programs.md` has the protocol and
examples.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from auv_gym.physics.vehicle import PAPER_VEHICLE, Vehicle
from auv_gym.scenarios.records import guarded, to_record
from auv_gym.task.observation import SIZE, TERMS, Observation, encode_observation
from auv_gym.task.preview import checked_preview
from baselines.policy import Batched, Memory, Starts
from baselines.tools.programs import Program, ProgramError, cut

PROTOCOL = 1
"""Version of the protocol."""
START = 10.0
"""Time [s] that a program has for its first answer, and for every answer in addition to the time for its decisions."""
DECISION = 0.1
"""Default time limit of a decision [s]."""

_EXAMPLE = Observation(*(0.0 for _ in Observation._fields))._replace(
    e_x=0.1, e_y=-0.1, psi_e=0.05, u_R=0.5, F_uR=35.0, cos_psi=1.0, F_u_max=400.0, F_r_max=200.0, dt=0.1
)
"""Observation that is sent once at the start as a test: a vehicle that moves straight ahead, close to its path."""


class ProgramPolicy(Batched):
    """A program as a policy. The memory is in the program, so it can control one set of vehicles at a time.

    Attributes:
        preview: the control periods ahead at which the observation holds the position of the reference.
        step_limit: time limit [s] for the decision of one vehicle, in addition to `START` for each answer.
    """

    def __init__(self, command: str, vehicle: Vehicle | None = None) -> None:
        """Start a program, send the greeting, and request a first action.

        Args:
            command: program and arguments.
            vehicle: the nominal one, which the greeting describes; None: the paper's.

        Raises:
            ProgramError: the program cannot be started, or an answer is wrong.
        """
        self.step_limit = DECISION
        self._program = Program(command)
        nominal = PAPER_VEHICLE if vehicle is None else vehicle
        with self._program.errors():
            answer = self._program.ask(greeting(nominal), START)
            if unknown := sorted(set(answer) - {"preview"}):
                raise ProgramError(f"its greeting has the entry {unknown[0]!r}; allowed is only 'preview'")
            self.preview = checked_preview(answer.get("preview", []))
        ahead = [x for n in self.preview for x in (_EXAMPLE.u_R * _EXAMPLE.dt * n, 0.0)]
        self.predict(np.append(encode_observation(_EXAMPLE), ahead))

    def actions(
        self, rows: NDArray[Any], state: Memory | None, episode_start: Starts, deterministic: bool
    ) -> tuple[NDArray[np.float32], Memory | None]:
        """Ask the program; it is informed of the start of an episode if `state` is None or `episode_start` is True.

        The memory has no columns, since the program has its own. Raises ProgramError if there is no usable answer.
        """
        del deterministic
        n, width = len(rows), SIZE + 2 * len(self.preview)
        if rows.shape[1] != width:
            raise ValueError(f"observation has shape {rows.shape}; it must be ({width},) or (N, {width})")
        if state is not None and len(state[0]) != n:
            raise ValueError(f"state is of {len(state[0])} vehicles, the observation of {n}")
        begins = state is None or (False if episode_start is None else episode_start)
        starts = np.broadcast_to(np.asarray(begins, dtype=bool), n)
        question = {"observations": rows.tolist(), "starts": starts.tolist()}
        with self._program.errors():
            return _actions(self._program.ask(question, START + n * self.step_limit), n), (np.zeros((n, 0)),)


def greeting(vehicle: Vehicle) -> dict[str, Any]:
    """Return the first message to a program: version, observation, action and nominal vehicle."""
    return {
        "auv_gym": PROTOCOL,
        "observation": [term._asdict() for term in TERMS],
        "action": [{"name": name, "low": -1.0, "high": 1.0} for name in ("a_u", "a_r")],
        "vehicle": to_record(vehicle),
    }


def _actions(answer: Mapping[str, Any], n: int) -> NDArray[np.float32]:
    """Return the actions of an answer, shape (n, 2), finite or not."""
    rows = answer.get("actions")
    if not isinstance(rows, list) or set(answer) != {"actions"}:
        raise ProgramError(f"it answers {cut(json.dumps(answer))}; it must be {{'actions': [[a_u, a_r], ...]}}")
    if len(rows) != n:
        raise ProgramError(f"it answers {len(rows)} actions for {n} observations")
    for i, row in enumerate(rows):
        pair = isinstance(row, list) and len(row) == 2
        if not pair or not all(isinstance(x, (int, float)) and not isinstance(x, bool) for x in row):
            raise ProgramError(f"its action {i} of {n} is {cut(json.dumps(row))}; it must be two numbers")
    with guarded("its actions"), np.errstate(over="ignore"):  # too large floats become infinite: `Batched` rejects them
        return np.array(rows, dtype=np.float64).astype(np.float32)

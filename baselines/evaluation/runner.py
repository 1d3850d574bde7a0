"""Runs policies through cells of episodes: worker processes, the same numbers for any number of them."""

from __future__ import annotations

import hashlib
import itertools
import json
import math
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
from gymnasium.utils import seeding
from numpy.typing import NDArray

from auv_gym import __version__
from auv_gym.envs.lanes import plan_of, reference_tables
from auv_gym.physics.vehicle import CrossFlow, Vehicle
from auv_gym.scenarios.episode import Episode
from auv_gym.scenarios.scenario import Scenario
from baselines.evaluation.fingerprints import fingerprint, simulator_fingerprint
from baselines.evaluation.metrics import Measures, Track
from baselines.evaluation.rollout import PolicyError, Rollout, rollout
from baselines.policies import make_policy
from baselines.tools.command_line import printable
from baselines.tools.workers import Workers

LANES = 512
"""Most episodes side by side. Fixed, so that no number depends on the number of workers."""
QUANTILES = (0.1, 0.5, 0.9)
"""Of the position error over episodes, at each control step."""
STEP_LIMIT = 0.1
"""Default for the largest time of a decision [s]: a control period at cruise."""

NOTE_INTERVAL = 0.5
"""Seconds after which a task says again how far it is."""


@dataclass(frozen=True)
class Cell:
    """Some episodes of one scenario, the same for every policy."""

    scenario: Scenario
    episodes: tuple[Episode, ...]

    @cached_property
    def hash(self) -> str:
        """SHA-256 of scenario and episodes."""
        record = [self.scenario.to_dict(), [[type(e.path).__name__, e] for e in self.episodes]]
        return hashlib.sha256(json.dumps(record, sort_keys=True, default=_plain).encode()).hexdigest()


def _plain(part: Any) -> dict[str, Any]:
    """Return fields of an episode or a part; what came later is left out where it is as before, so that hashes stay."""
    record = {f.name: getattr(part, f.name) for f in fields(part)}
    if isinstance(part, Episode) and part.reckoning is None:
        del record["reckoning"]
    if isinstance(part, Vehicle):
        later = "speed", *CrossFlow._fields
        record = {name: x for name, x in record.items() if name not in later or x != getattr(Vehicle, name)}
    return record


def drawn(scenario: Scenario, episodes: int, seed: int) -> Cell:
    """Return a cell whose episode i is the one of an environment reset with `seed + i`, drawn anew where it must be.

    Raises:
        ValueError: no path of the scenario can be followed.
    """
    given = plan_of(scenario)
    generators = (seeding.np_random(seed + i)[0] for i in range(episodes))
    return Cell(scenario, tuple(scenario.drawn(rng, lambda e: reference_tables([e], *given))[0] for rng in generators))


@dataclass(frozen=True)
class Recorded:
    """When and with what the episodes of a run were run, if not now."""

    date: str  # ISO 8601
    versions: Mapping[str, str]

    def __str__(self) -> str:
        return f"{self.date}, auv_gym {self.versions['auv_gym']}"


@dataclass(frozen=True)
class Run:
    """The episodes of one policy in one cell; or the reason why there are none."""

    policy: str
    scenario: Scenario
    cell_hash: str
    measures: Measures | None = None
    bands: NDArray[np.float32] | None = None  # [m] `QUANTILES` of the position error, shape (3, K)
    tracks: tuple[Track, ...] = ()  # of the first episodes
    seconds: float = math.nan  # wall time of all episodes, added up over workers
    decision_seconds: float = math.nan  # wall time of the policy for one vehicle and control step
    slowest_decision: float = 0.0  # [s] the largest mean that was compared with the limit, see `rollout.Watch`
    error: str | None = None
    warnings: tuple[str, ...] = ()
    recorded: Recorded | None = None  # None: the episodes ran now
    fingerprint: str = ""  # of the policy's files, see `fingerprints.fingerprint`
    simulator: str = ""  # hash of the code that simulated, see `fingerprints.simulator_fingerprint`
    known: bool = False  # left by an evaluation that was interrupted

    @property
    def key(self) -> str:
        """What tells it from other runs: a hash of policy, its files, cell and version of the simulator."""
        return run_key(self.policy, self.fingerprint, self.cell_hash)


def run_key(policy: str, digest: str, cell_hash: str) -> str:
    """Return the key of the run, in a cell of that hash, of a policy whose files have that fingerprint."""
    return hashlib.sha256(f"{policy} {digest} {cell_hash} {__version__}".encode()).hexdigest()[:20]


@dataclass(frozen=True)
class TaskPart:
    """What one task gives: a rollout, or the reason why there is none."""

    rollout: Rollout | None
    error: str | None
    warnings: tuple[str, ...]


@dataclass(frozen=True)
class Task:
    """What a worker does at a time: some episodes of one policy in one scenario.

    It makes the policy anew, so that no result depends on what the worker did before.
    """

    policy: str
    scenario: Scenario
    episodes: Sequence[Episode]
    step_limit: float = STEP_LIMIT  # [s] largest time of a decision
    note: Callable[[str, int], None] = lambda *_: (
        None
    )  # told the task's number and how many steps its vehicles have done
    number: tuple[int, int] = (0, 0)  # of the run, and of the part of it

    def run(self) -> tuple[tuple[int, int], TaskPart]:
        """Return the number and what comes out; an exception of the policy ends it and becomes the `error`."""
        result, error = None, None
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            try:
                policy = make_policy(self.policy, self.scenario.vehicle)
                result = rollout(policy, self.scenario, self.episodes, self.step_limit, self._progress())
            except PolicyError as exception:
                error = printable(str(exception))
            except (Exception, SystemExit) as exception:  # noqa: BLE001, whatever it raises costs it its row, not the others theirs
                error = printable(" ".join(f"{type(exception).__name__}: {exception}".split()))
        self._tell(self.scenario.steps)
        messages = tuple(dict.fromkeys(printable(" ".join(str(warning.message).split())) for warning in caught))
        return self.number, TaskPart(result, error, messages)

    def _progress(self) -> Callable[[int], None]:
        """Return what tells now and then how many control steps are done."""
        last = time.monotonic()

        def on_step(k: int) -> None:
            nonlocal last
            if time.monotonic() - last > NOTE_INTERVAL:
                self._tell(k)
                last = time.monotonic()

        return on_step

    def _tell(self, k: int) -> None:
        self.note("-".join(map(str, self.number)), len(self.episodes) * k)


def runs(
    pairs: Sequence[tuple[str, Cell]],
    workers: Workers = Workers(),  # noqa: B008, it is frozen
    step_limit: float = STEP_LIMIT,
    note: Callable[[str, int], None] = lambda *_: None,
    known: Callable[[str], Run | None] = lambda _: None,
) -> Iterator[Run]:
    """Yield the run of each policy in its cell when it is complete.

    Args:
        pairs: policies by name, see `baselines.make_policy`, and what they run in.
        workers: where they run.
        step_limit: largest time of a decision [s].
        note: called, wherever a task runs, with its name and the control steps that its vehicles have done.
        known: returns the run of a key if it is there already. One of another simulator does not count, nor one that
            took longer for a decision than the limit.
    """
    prints, simulator = {policy: fingerprint(policy) for policy in dict(pairs)}, simulator_fingerprint()
    tasks: list[Task] = []
    for i, (policy, cell) in enumerate(pairs):
        run = known(run_key(policy, prints[policy], cell.hash))
        if run is not None and run.simulator == simulator and run.slowest_decision <= step_limit:
            note(f"{i}-0", len(cell.episodes) * cell.scenario.steps)
            yield replace(run, known=True)
            continue
        chunks = enumerate(_chunks(cell.episodes))
        tasks += [Task(policy, cell.scenario, chunk, step_limit, note, (i, j)) for j, chunk in chunks]
    missing = Counter(task.number[0] for task in tasks)
    parts: dict[int, dict[int, TaskPart]] = {}
    for (i, j), part in workers.results(Task.run, [(task,) for task in tasks]):
        parts.setdefault(i, {})[j] = part
        if len(parts[i]) == missing[i]:
            policy, cell = pairs[i]
            run = _joined(policy, cell, [part for _, part in sorted(parts.pop(i).items())])
            if fingerprint(policy) != prints[policy]:
                run = replace(run, measures=None, error="its files changed while it ran")
            yield replace(run, fingerprint=prints[policy], simulator=simulator)


def run_all(policies: Sequence[str], cells: Sequence[Cell], *options: Any, **named: Any) -> list[Run]:
    """Return a run of each policy in each cell, cell by cell; the options are those of `runs`."""
    pairs = [(policy, cell) for cell in cells for policy in policies]
    order = [(policy, cell.scenario.name) for policy, cell in pairs]
    return sorted(runs(pairs, *options, **named), key=lambda run: order.index((run.policy, run.scenario.name)))


def _chunks(episodes: Sequence[Episode]) -> list[Sequence[Episode]]:
    """Return the episodes in even parts of at most `LANES`."""
    bounds = np.linspace(0, len(episodes), math.ceil(len(episodes) / LANES) + 1).astype(int).tolist()
    return [episodes[a:b] for a, b in itertools.pairwise(bounds)]


def _joined(policy: str, cell: Cell, parts: Sequence[TaskPart]) -> Run:
    messages = tuple(dict.fromkeys(message for part in parts for message in part.warnings))
    rollouts = [part.rollout for part in parts if part.rollout is not None]
    if len(rollouts) < len(parts):
        error = next(part.error for part in parts if part.error)
        return Run(policy, cell.scenario, cell.hash, error=error, warnings=messages)
    errors = np.concatenate([r.errors for r in rollouts], axis=1)
    return Run(
        policy,
        cell.scenario,
        cell.hash,
        Measures.joined([r.measures for r in rollouts]),
        np.quantile(errors, QUANTILES, axis=1).astype(np.float32),
        rollouts[0].tracks,
        sum(r.seconds for r in rollouts),
        float(np.mean([r.decision_seconds for r in rollouts])),
        max(r.slowest_decision for r in rollouts),
        warnings=messages,
    )

"""Runs policies in cells of episodes, in worker processes; the results do not depend on the number of processes."""

from __future__ import annotations

import hashlib
import itertools
import json
import math
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
from auv_gym.envs.sub_environments import plan_of, reference_tables
from auv_gym.physics.vehicle import CrossTerms, Vehicle
from auv_gym.scenarios.episode import Episode
from auv_gym.scenarios.scenario import Scenario
from baselines.evaluation.fingerprints import fingerprint, simulator_fingerprint
from baselines.evaluation.metrics import Measures, Track
from baselines.evaluation.rollout import PolicyError, Rollout, rollout
from baselines.policies import make_policy
from baselines.tools.command_line import described, printable
from baselines.tools.workers import Workers

MOST_PARALLEL = 512
"""Largest number of parallel episodes. It is fixed, so that results do not depend on the number of workers."""
QUANTILES = (0.1, 0.5, 0.9)
"""Quantiles of the position error over episodes, at each control step."""
STEP_LIMIT = 0.1
"""Default for the largest mean time of a decision [s]: the control period in cruise."""


@dataclass(frozen=True)
class Cell:
    """Episodes of one scenario, the same for every policy."""

    scenario: Scenario
    episodes: tuple[Episode, ...]

    @cached_property
    def hash(self) -> str:
        """SHA-256 of scenario and episodes."""
        record = [self.scenario.to_dict(), [[type(e.path).__name__, e] for e in self.episodes]]
        return hashlib.sha256(json.dumps(record, sort_keys=True, default=_plain).encode()).hexdigest()


def _plain(part: Any) -> dict[str, Any]:
    """Return the fields of an episode or a part, without newer fields of default value, which keeps old hashes."""
    record = {f.name: getattr(part, f.name) for f in fields(part)}
    if isinstance(part, Episode):
        record = {name: x for name, x in record.items() if name not in ("reckoning", "faults") or x}
    if isinstance(part, Vehicle):
        later = "speed", *CrossTerms._fields
        record = {name: x for name, x in record.items() if name not in later or x != getattr(Vehicle, name)}
    return record


def drawn(scenario: Scenario, episodes: int, seed: int) -> Cell:
    """Return a cell of drawn episodes; episode i is that of an environment reset with `seed + i`.

    Raises:
        ValueError: no path of the scenario is feasible.
    """
    given = plan_of(scenario)
    generators = (seeding.np_random(seed + i)[0] for i in range(episodes))
    return Cell(scenario, tuple(scenario.drawn(rng, lambda e: reference_tables([e], *given))[0] for rng in generators))


@dataclass(frozen=True)
class Recorded:
    """Date and versions of recorded episodes."""

    date: str  # ISO 8601
    versions: Mapping[str, str]

    def __str__(self) -> str:
        return f"{self.date}, auv_gym {self.versions['auv_gym']}"


@dataclass(frozen=True)
class Run:
    """The results of one policy in one cell, or the reason why there are none."""

    policy: str
    scenario: Scenario
    cell_hash: str
    measures: Measures | None = None
    bands: NDArray[np.float32] | None = None  # [m] `QUANTILES` of the position error, shape (3, K)
    tracks: tuple[Track, ...] = ()  # of the first episodes
    seconds: float = math.nan  # wall time of all episodes, added up over workers
    decision_seconds: float = math.nan  # wall time of the policy for one vehicle and control step
    slowest_decision: float = 0.0  # [s] largest mean time that was compared with the limit, see `rollout.Stopwatch`
    error: str | None = None
    warnings: tuple[str, ...] = ()
    recorded: Recorded | None = None  # None: the episodes ran now
    fingerprint: str = ""  # of the policy's files, see `fingerprints.fingerprint`
    simulator: str = ""  # fingerprint of the simulator, see `fingerprints.simulator_fingerprint`
    known: bool = False  # taken from an interrupted evaluation

    @property
    def key(self) -> str:
        """The identifier of the run: a hash of policy, fingerprint, cell and version of the package."""
        return run_key(self.policy, self.fingerprint, self.cell_hash)


def run_key(policy: str, digest: str, cell_hash: str) -> str:
    """Return the identifier of a run for a policy, its fingerprint and the hash of a cell."""
    return hashlib.sha256(f"{policy} {digest} {cell_hash} {__version__}".encode()).hexdigest()[:20]


@dataclass(frozen=True)
class TaskPart:
    """The result of one task: a rollout, or the reason why there is none."""

    rollout: Rollout | None
    error: str | None
    warnings: tuple[str, ...]


@dataclass(frozen=True)
class Task:
    """A task of a worker: some episodes of one policy in one scenario.

    Each task makes its own policy, so that no result depends on the earlier tasks of the worker.
    """

    policy: str
    scenario: Scenario
    episodes: Sequence[Episode]
    step_limit: float = STEP_LIMIT  # [s] largest mean time of a decision
    number: tuple[int, int] = (0, 0)  # number of the run, and of the part of it

    def run(self) -> tuple[tuple[int, int], TaskPart]:
        """Return number and result; an exception of the policy ends the task and becomes the `error`."""
        result, error = None, None
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            try:
                policy = make_policy(self.policy, self.scenario.known)
                result = rollout(policy, self.scenario, self.episodes, self.step_limit)
            except PolicyError as exception:
                error = printable(str(exception))
            except KeyboardInterrupt:
                raise
            except BaseException as exception:  # noqa: BLE001, other policies must still run
                error = described(exception)
        messages = tuple(dict.fromkeys(printable(" ".join(str(warning.message).split())) for warning in caught))
        return self.number, TaskPart(result, error, messages)


def runs(
    pairs: Sequence[tuple[str, Cell]],
    workers: Workers = Workers(),  # noqa: B008, it is frozen
    step_limit: float = STEP_LIMIT,
    known: Callable[[str], Run | None] = lambda _: None,
) -> Iterator[Run]:
    """Yield the run of each policy in its cell, in the order of completion.

    Args:
        pairs: names of policies, see `baselines.make_policy`, each with a cell.
        workers: number of parallel tasks.
        step_limit: largest mean time of a decision [s].
        known: returns the finished run of a key, or None. A run of another simulator is not used, nor one whose
            decisions took longer than the limit.
    """
    prints, simulator = {policy: fingerprint(policy) for policy in dict(pairs)}, simulator_fingerprint()
    tasks: list[Task] = []
    for i, (policy, cell) in enumerate(pairs):
        run = known(run_key(policy, prints[policy], cell.hash))
        if run is not None and run.simulator == simulator and run.slowest_decision <= step_limit:
            yield replace(run, known=True)
            continue
        chunks = enumerate(_chunks(cell.episodes))
        tasks += [Task(policy, cell.scenario, chunk, step_limit, (i, j)) for j, chunk in chunks]
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
    """Return the run of each policy in each cell, cell by cell; the options are those of `runs`."""
    pairs = [(policy, cell) for cell in cells for policy in policies]
    order = [(policy, cell.scenario.name) for policy, cell in pairs]
    return sorted(runs(pairs, *options, **named), key=lambda run: order.index((run.policy, run.scenario.name)))


def _chunks(episodes: Sequence[Episode]) -> list[Sequence[Episode]]:
    """Return the episodes in equal parts of at most `MOST_PARALLEL`."""
    bounds = np.linspace(0, len(episodes), math.ceil(len(episodes) / MOST_PARALLEL) + 1).astype(int).tolist()
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

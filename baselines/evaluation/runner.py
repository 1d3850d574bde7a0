"""Runs policies in cells of episodes, in worker processes; the results do not depend on the number of processes."""

from __future__ import annotations

import hashlib
import itertools
import math
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_gym import __version__
from auv_gym.scenarios.episode import Episode
from auv_gym.scenarios.scenario import Scenario
from baselines.agents.names import PolicyName
from baselines.evaluation.cells import Cell
from baselines.evaluation.fingerprints import fingerprint, simulator_fingerprint
from baselines.evaluation.metrics import Measures, Track
from baselines.evaluation.plants import PlantCommand
from baselines.evaluation.rollout import PolicyError, Rollout, rollout
from baselines.policies import make_policy
from baselines.tools.command_line import described, printable
from baselines.tools.files import versions
from baselines.tools.workers import Workers

MOST_PARALLEL = 512
"""Largest number of parallel episodes. It is fixed, so that results do not depend on the number of workers."""
QUANTILES = (0.1, 0.5, 0.9)
"""Quantiles of the position error over episodes, at each control step."""
STEP_LIMIT = 0.1
"""Default for the largest mean time of a decision [s]: the control period in cruise."""


@dataclass(frozen=True)
class Recorded:
    """Date and versions of recorded episodes."""

    date: str  # ISO 8601
    versions: Mapping[str, str]

    @classmethod
    def now(cls) -> Recorded:
        """Return today's date and the present versions."""
        return cls(datetime.now(timezone.utc).date().isoformat(), versions())

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
        """The identifier of the run: a hash of policy, cell, fingerprints and version of the package."""
        parts = self.policy, self.cell_hash, self.fingerprint, self.simulator, __version__
        return hashlib.sha256(" ".join(parts).encode()).hexdigest()[:20]

    @classmethod
    def planned(cls, policy: str, cell: Cell, plant: PlantCommand | None = None) -> Run:
        """Return a run without results, with the present fingerprints."""
        scenarios = [cell.scenario]
        prints = fingerprint(policy, scenarios), simulator_fingerprint(scenarios, plant and plant.command)
        return cls(policy, cell.scenario, cell.hash, fingerprint=prints[0], simulator=prints[1])


class Part(NamedTuple):
    """The results of some episodes of a policy in a scenario, or the reason why there are none."""

    rollout: Rollout | None
    error: str | None
    warnings: tuple[str, ...]


def part_of(
    policy: str,
    scenario: Scenario,
    episodes: Sequence[Episode],
    step_limit: float = STEP_LIMIT,
    plant: PlantCommand | None = None,
) -> Part:
    """Return the results of a policy in some episodes; an exception of the policy becomes the `error`.

    Each call makes its own policy, so that no result depends on the earlier calls in a worker process.
    """
    result, error = None, None
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            simulator = plant and plant.simulator(scenario, episodes)
            result = rollout(make_policy(policy, scenario.known), scenario, episodes, step_limit, simulator)
        except KeyboardInterrupt:
            raise
        except BaseException as exception:  # noqa: BLE001, other policies must still run
            error = failure(exception, policy)
    messages = (printable(" ".join(str(warning.message).split())) for warning in caught)
    return Part(result, error, tuple(dict.fromkeys(messages)))


def failure(error: BaseException, policy: str) -> str:
    """Return on one line why a policy failed, with the place in its own file if that has raised the exception."""
    if isinstance(error, PolicyError):
        return printable(str(error))
    file = PolicyName.of(policy).base.rpartition(":")[0]
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(Path(file))]
    return described(error) + (f" ({printable(file)}, line {lines[-1]})" if lines else "")


def _numbered(number: tuple[int, int], *task: Any) -> tuple[tuple[int, int], Part]:
    """Return the number of a task and its result."""
    return number, part_of(*task)


def runs(
    pairs: Sequence[tuple[str, Cell]],
    workers: Workers = Workers(),  # noqa: B008, it is frozen
    step_limit: float = STEP_LIMIT,
    finished: Callable[[str], Run | None] = lambda _: None,
    plant: PlantCommand | None = None,
) -> Iterator[Run]:
    """Yield the run of each policy in its cell, in the order of completion.

    Args:
        pairs: names of policies, see `baselines.make_policy`, each with a cell.
        workers: number of parallel tasks.
        step_limit: largest mean time of a decision [s].
        finished: returns the finished run of a key, or None. A run whose decisions took longer than the limit is not
            used.
        plant: the program that moves the vehicles; None: the equations of motion.
    """
    planned = [Run.planned(policy, cell, plant) for policy, cell in pairs]
    tasks: list[tuple[Any, ...]] = []
    for i, ((policy, cell), plan) in enumerate(zip(pairs, planned, strict=True)):
        run = finished(plan.key)
        if run is not None and run.slowest_decision <= step_limit:
            yield replace(run, known=True)
            continue
        chunks = enumerate(_chunks(cell.episodes, plant.most if plant else MOST_PARALLEL))
        tasks += [((i, j), policy, cell.scenario, chunk, step_limit, plant) for j, chunk in chunks]
    missing = Counter(i for (i, _), *_ in tasks)
    parts: dict[int, dict[int, Part]] = {}
    for (i, j), part in workers.results(_numbered, tasks):
        parts.setdefault(i, {})[j] = part
        if len(parts[i]) == missing[i]:
            run = _joined(planned[i], [part for _, part in sorted(parts.pop(i).items())])
            if fingerprint(run.policy, [run.scenario]) != run.fingerprint:
                run = replace(run, measures=None, error="its files changed while it ran")
            yield run


def run_all(policies: Sequence[str], cells: Sequence[Cell], step_limit: float = STEP_LIMIT) -> list[Run]:
    """Return the run of each policy in each cell, cell by cell."""
    return list(runs([(policy, cell) for cell in cells for policy in policies], step_limit=step_limit))


def _chunks(episodes: Sequence[Episode], most: int) -> list[Sequence[Episode]]:
    """Return the episodes in equal parts of at most `most`."""
    bounds = np.linspace(0, len(episodes), math.ceil(len(episodes) / most) + 1).astype(int).tolist()
    return [episodes[a:b] for a, b in itertools.pairwise(bounds)]


def _joined(planned: Run, parts: Sequence[Part]) -> Run:
    """Return the run with the results of its parts."""
    messages = tuple(dict.fromkeys(message for part in parts for message in part.warnings))
    rollouts = [part.rollout for part in parts if part.rollout is not None]
    if len(rollouts) < len(parts):
        return replace(planned, error=next(part.error for part in parts if part.error), warnings=messages)
    errors = np.concatenate([r.errors for r in rollouts], axis=1)
    return replace(
        planned,
        measures=Measures.joined([r.measures for r in rollouts]),
        bands=np.quantile(errors, QUANTILES, axis=1).astype(np.float32),
        tracks=rollouts[0].tracks,
        seconds=sum(r.seconds for r in rollouts),
        decision_seconds=float(np.mean([r.decision_seconds for r in rollouts])),
        slowest_decision=max(r.slowest_decision for r in rollouts),
        warnings=messages,
    )

"""Runs policies through cells of episodes: worker processes, the same numbers for any number of them."""

from __future__ import annotations

import hashlib
import itertools
import json
import math
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property

import numpy as np
from gymnasium.utils import seeding
from numpy.typing import NDArray

from auv_gym import __version__
from auv_gym.episode import Episode
from auv_gym.scenario import Scenario
from baselines import make_policy
from baselines.agents.loading import fingerprint
from baselines.evaluation.metrics import Measures, Track
from baselines.evaluation.rollout import PolicyError, Rollout, rollout
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
        record = [self.scenario.to_dict(), [[type(e.path).__name__, asdict(e)] for e in self.episodes]]
        return hashlib.sha256(json.dumps(record, sort_keys=True).encode()).hexdigest()


def drawn(scenario: Scenario, episodes: int, seed: int) -> Cell:
    """Return a cell whose episode i is the one of an environment reset with `seed + i`."""
    return Cell(scenario, tuple(scenario.draw(seeding.np_random(seed + i)[0]) for i in range(episodes)))


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
    track: Track | None = None  # of the first episode
    seconds: float = math.nan  # wall time of all episodes, added up over workers
    decision_seconds: float = math.nan  # wall time of the policy for one vehicle and control step
    error: str | None = None
    warnings: tuple[str, ...] = ()
    recorded: Recorded | None = None  # None: the episodes ran now
    fingerprint: str = ""  # of the policy's files, see `agents.loading.fingerprint`
    known: bool = False  # left by an evaluation that was interrupted

    @property
    def key(self) -> str:
        """What tells it from other runs: a hash of policy, its files, cell and version of the simulator."""
        return run_key(self.policy, self.fingerprint, self.cell_hash)


def run_key(policy: str, digest: str, cell_hash: str) -> str:
    """Return the key of the run, in a cell of that hash, of a policy whose files have that fingerprint."""
    return hashlib.sha256(f"{policy} {digest} {cell_hash} {__version__}".encode()).hexdigest()[:20]


@dataclass(frozen=True)
class Part:
    """What one task gives: a rollout, or the reason why there is none."""

    rollout: Rollout | None
    error: str | None
    warnings: tuple[str, ...]


def run_all(
    policies: Sequence[str],
    cells: Sequence[Cell],
    workers: Workers = Workers(),  # noqa: B008, it is frozen
    on_run: Callable[[Run], None] = lambda _: None,
    note: Callable[[str, int], None] = lambda *_: None,
    step_limit: float = STEP_LIMIT,
    known: Callable[[str], Run | None] = lambda _: None,
) -> list[Run]:
    """Return a run of each policy in each cell, cell by cell.

    Args:
        policies: their names, see `baselines.make_policy`.
        cells: what they run in.
        workers: where they run.
        on_run: called with each run when it is complete.
        note: called, wherever a task runs, with its name and the control steps that its vehicles have done.
        step_limit: largest time of a decision [s].
        known: returns the run of a key if it is there already.
    """
    prints = {policy: fingerprint(policy) for policy in policies}
    pairs = [(policy, cell) for cell in cells for policy in policies]
    runs: dict[int, Run] = {}
    for i, (policy, cell) in enumerate(pairs):
        if (run := known(run_key(policy, prints[policy], cell.hash))) is not None:
            runs[i] = replace(run, known=True)
            note(f"{i}-0", len(cell.episodes) * cell.scenario.steps)
            on_run(runs[i])
    tasks = [
        (i, j, policy, cell.scenario, chunk, step_limit, note)
        for i, (policy, cell) in enumerate(pairs)
        if i not in runs
        for j, chunk in enumerate(_chunks(cell.episodes))
    ]
    parts: dict[int, dict[int, Part]] = {}
    for i, j, part in workers.results(_indexed, tasks):
        policy, cell = pairs[i]
        parts.setdefault(i, {})[j] = part
        count = len(_chunks(cell.episodes))
        if len(parts[i]) == count:
            done = parts.pop(i)
            run = replace(_joined(policy, cell, [done[k] for k in range(count)]), fingerprint=prints[policy])
            changed = fingerprint(policy) != prints[policy]
            runs[i] = replace(run, measures=None, error="its files changed while it ran") if changed else run
            on_run(runs[i])
    return [runs[i] for i in range(len(pairs))]


def _chunks(episodes: Sequence[Episode]) -> list[Sequence[Episode]]:
    """Return the episodes in even parts of at most `LANES`."""
    bounds = np.linspace(0, len(episodes), math.ceil(len(episodes) / LANES) + 1).astype(int).tolist()
    return [episodes[a:b] for a, b in itertools.pairwise(bounds)]


def _indexed(
    i: int,
    j: int,
    policy: str,
    scenario: Scenario,
    episodes: Sequence[Episode],
    step_limit: float,
    note: Callable[[str, int], None],
) -> tuple[int, int, Part]:
    n, last = len(episodes), time.monotonic()

    def on_step(k: int) -> None:
        nonlocal last
        if time.monotonic() - last > NOTE_INTERVAL:
            note(f"{i}-{j}", n * k)
            last = time.monotonic()

    part = run_task(policy, scenario, episodes, step_limit, on_step)
    note(f"{i}-{j}", n * scenario.steps)
    return i, j, part


def run_task(
    policy: str,
    scenario: Scenario,
    episodes: Sequence[Episode],
    step_limit: float = STEP_LIMIT,
    on_step: Callable[[int], None] = lambda _: None,
) -> Part:
    """Return some episodes of a policy. An exception of the policy ends them and becomes the `error`."""
    result, error = None, None
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            result = rollout(make_policy(policy, scenario.vehicle), scenario, episodes, step_limit, on_step)
        except PolicyError as exception:
            error = str(exception)
        except Exception as exception:  # noqa: BLE001, whatever a policy raises costs it its row, not the others theirs
            error = " ".join(f"{type(exception).__name__}: {exception}".split())
    return Part(result, error, tuple(dict.fromkeys(str(warning.message) for warning in caught)))


def _joined(policy: str, cell: Cell, parts: Sequence[Part]) -> Run:
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
        rollouts[0].track,
        sum(r.seconds for r in rollouts),
        float(np.mean([r.decision_seconds for r in rollouts])),
        warnings=messages,
    )

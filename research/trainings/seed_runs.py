"""Results of agents that differ only in the training seed, on the frozen suites: research/data/trainings/SUITE.npz.

The files are files of results. The policy of a run is NAME#SEED, with the name of its training.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from auv_gym.physics.namespaces import Array
from baselines.evaluation.metrics import Measures
from baselines.evaluation.recorded import read_recorded
from baselines.evaluation.results import ResultFile
from baselines.evaluation.runner import Run
from baselines.evaluation.score import capped, count_failures, error_cap, in_paper_metres
from baselines.evaluation.suites import Suite, load_suite
from baselines.tools.command_line import WorkerError
from research import DATA

SEED_RUNS = DATA / "trainings"
"""Folder of the files."""


@dataclass(frozen=True)
class SeedRuns:
    """Results of S agents in the M episodes of each cell."""

    measures: Mapping[str, Sequence[Measures]]  # of each agent, by scenario, in metres of the paper's vehicle

    @property
    def seeds(self) -> int:
        """Number of agents."""
        return len(next(iter(self.measures.values())))

    @cached_property
    def capped(self) -> dict[str, Array]:
        """Steady-state errors [m] by scenario, failed episodes with the error cap, shape (S, M)."""
        return {cell: np.stack([capped(m, error_cap(cell)) for m in own]) for cell, own in self.measures.items()}

    @property
    def failed(self) -> int:
        """Number of failures of all agents, see `score.has_failed`."""
        return sum(count_failures(m, error_cap(cell)) for cell, agents in self.measures.items() for m in agents)

    @property
    def episodes(self) -> int:
        """Number of episodes of all agents."""
        return sum(len(m) for agents in self.measures.values() for m in agents)

    @property
    def smoothness(self) -> float:
        """Mean squared change of the command over all episodes."""
        return float(np.mean([np.concatenate([m.smoothness for m in agents]) for agents in self.measures.values()]))


def trained(suite: str) -> dict[str, SeedRuns]:
    """Return the results on a frozen suite, by the name of the training.

    Raises:
        OSError: the file cannot be read.
        ValueError: it is damaged, or belongs to another suite of the same name.
    """
    by_name: dict[str, dict[str, list[Measures]]] = {}
    for run in read_recorded(load_suite(suite), SEED_RUNS / f"{suite}.npz").runs:
        if run.measures is not None:
            cells = by_name.setdefault(run.policy.partition("#")[0], {})
            cells.setdefault(run.scenario.name, []).append(in_paper_metres(run.measures, run.scenario))
    return {name: SeedRuns(cells) for name, cells in by_name.items()}


def keep_seed_runs(suite: Suite, name: str, agents: Sequence[Sequence[Run]], command: str) -> None:
    """Write the runs of the agents of a training, seed by seed, in place of the earlier ones of the same name.

    Raises:
        WorkerError: a run failed.
    """
    if broken := [run for runs in agents for run in runs if run.measures is None]:
        raise WorkerError(f"{broken[0].policy} failed in {broken[0].scenario.name}: {broken[0].error}")
    file = SEED_RUNS / f"{suite.name}.npz"
    content = read_recorded(suite, file) if file.exists() else ResultFile((), suite.name, suite.hash)
    for seed, runs in enumerate(agents):
        content = content.with_runs([replace(r, policy=f"{name}#{seed}", tracks=(), bands=None) for r in runs])
    replace(content, command=command).write(file, single=True)

"""What learning buys: agents of several seeds, and what becomes of them without one thing or another.

`python -m baselines.training.study` trains every agent of `VARIANTS` with several seeds, runs them on the frozen suites
and keeps the tail errors of every episode in `baselines/evaluation/studies/`, which the results page is made from.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import yaml
from tyro.conf import Positional, arg

from baselines.command_line import DONE, UsageError, parse, run
from baselines.evaluation import suites
from baselines.evaluation.progress import progress
from baselines.evaluation.runner import Cell, Run, run_all
from baselines.evaluation.score import regime_of
from baselines.evaluation.study_files import SUITES, Study, save
from baselines.training.command import train
from baselines.training.hyperparameters import ENV_ID, shipped
from baselines.training.request import Request
from baselines.training.run import AGENT, read_progress
from baselines.workers import Workers

PROGRAM = "python -m baselines.training.study"


@dataclass(frozen=True)
class Variant:
    """Agents that differ in the seed alone."""

    about: str  # one line for the results page
    algo: str
    regime: str
    scenario: str | None = None  # what is trained on, as `train.py --scenario` takes it; None: the regime
    expert: str | None = None  # None: as the algorithm's file of hyper-parameters says, like the next
    authority: tuple[float, ...] = ()
    timesteps: int | None = None
    changes: Mapping[str, Any] = field(default_factory=dict)  # of the hyper-parameters
    seeds: int = 5
    suites: tuple[str, ...] = SUITES

    def request(self, name: str, out: Path, jobs: int) -> Request:
        """Return the training; its file of hyper-parameters lies beside its folder.

        Raises:
            UsageError: the folder holds another training.
        """
        tables = yaml.safe_load(shipped(self.algo).read_text(encoding="utf-8"))
        tables[ENV_ID] |= self.changes
        file = out / f"{name}.yml"
        out.mkdir(parents=True, exist_ok=True)
        file.write_text(yaml.safe_dump(tables, sort_keys=False), encoding="utf-8")
        more = [f"--seeds {self.seeds}", f"--hyperparameters {file}"]
        more += [f"--expert {self.expert}"] if self.expert else []
        more += [f"--authority {' '.join(map(str, self.authority))}"] if self.authority else []
        more += [f"--timesteps {self.timesteps}"] if self.timesteps else []
        scenario = self.scenario or self.regime
        command = f"python train.py --algo {self.algo} --scenario {scenario} {' '.join(more)}"
        return Request.of(
            self.algo,
            (scenario,),
            self.expert,
            self.authority,
            seeds=self.seeds,
            jobs=jobs,
            timesteps=self.timesteps,
            hyperparameters=file,
            out=out / name,
            resume=True,
            command=command,
        )


VARIANTS: Mapping[str, Variant] = {
    "apg-cruise": Variant("The expert corrected, with memory, by the analytic gradient.", "apg", "cruise", seeds=3),
    "apg-scratch-cruise": Variant(
        "As `apg-cruise`, without an expert: the network commands alone.",
        "apg",
        "cruise",
        expert="none",
        authority=(1.0, 1.0),
        seeds=2,
        suites=("benchmark-v1",),
    ),
    "apg-slow": Variant(
        "The expert corrected, with memory, by the analytic gradient.", "apg", "slow", authority=(0.6, 1.6), seeds=2
    ),
    "apg-adverse-cruise": Variant(
        "As `apg-cruise`, trained also where sensors, commands, actuators and current are not as told.",
        "apg",
        "cruise",
        "cruise-adverse",
        seeds=1,
    ),
    "apg-adverse-slow": Variant(
        "As `apg-slow`, trained also where sensors, commands, actuators and current are not as told.",
        "apg",
        "slow",
        "slow-adverse",
        authority=(0.6, 1.6),
        seeds=1,
    ),
}
"""The agents of the study, by name."""


@dataclass(frozen=True)
class Options:
    """Train the agents of the study with several seeds, run them on the frozen suites and keep what they did.

    A second call goes on where the first was interrupted. Exit status: 0 done, 1 a training failed, 2 wrong usage.
    """

    name: Annotated[Positional[tuple[str, ...]], arg(metavar="[NAME ...]")] = ()
    """Which of them; without any, all."""
    out: Path = Path("runs/study")
    """Folder of the runs."""
    jobs: int = 2
    """Trainings at the same time."""


def main(arguments: Sequence[str]) -> int:
    """Train and evaluate as the arguments say and return the exit status.

    Raises:
        UsageError: the arguments do not make sense.
    """
    options = parse(Options, arguments, PROGRAM)
    if unknown := [name for name in options.name if name not in VARIANTS]:
        raise UsageError(f"the study has no {unknown[0]!r}; allowed are {', '.join(VARIANTS)}")
    for name in options.name or VARIANTS:
        variant = VARIANTS[name]
        request = variant.request(name, options.out, options.jobs)
        if (status := train(request)) != DONE:
            return status
        save(name, studied(variant, request, options.jobs))
    return DONE


def studied(variant: Variant, request: Request, jobs: int) -> Study:
    """Return what the trained agents of a request do on the suites of a variant."""
    agents = [str(folder / AGENT) for folder in request.folders]
    results = {name: _rolled_out(agents, cells_of(name, variant.regime), jobs) for name in variant.suites}
    curves = [[row for row in read_progress(folder) if "score" in row] for folder in request.folders]
    return Study.of(variant.about, variant.regime, request.command, results, curves)


def cells_of(suite: str, regime: str) -> list[Cell]:
    """Return the cells of a frozen suite in a regime."""
    return [cell for cell in suites.load(suite).cells if regime_of(cell.scenario.name) == regime]


def _rolled_out(agents: Sequence[str], cells: Sequence[Cell], jobs: int) -> list[list[Run]]:
    """Return the runs of each agent in the cells."""
    steps = sum(len(cell.episodes) * cell.scenario.steps for cell in cells)
    with progress(len(agents) * len(cells), len(agents) * steps) as report:
        runs = run_all(agents, cells, Workers(jobs), report.run, report.board.note)
    names = [cell.scenario.name for cell in cells]
    found = {(r.policy, r.scenario.name): r for r in runs}
    return [[found[agent, name] for name in names] for agent in agents]


if __name__ == "__main__":
    sys.exit(run(main, PROGRAM))

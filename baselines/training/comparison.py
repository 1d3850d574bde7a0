"""Compare agents that were trained for a vehicle with controllers and with the full-information optimum, on storms."""

from __future__ import annotations

import math
import os
import shlex
import sys
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from auv_gym.scenarios.fitting import Sea, changed
from auv_gym.scenarios.presets import SETPOINTS, as_scenario
from auv_gym.scenarios.scenario import Scenario
from auv_gym.scenarios.vehicles import VehicleModel
from baselines.agents.names import GUARD
from baselines.control.backstepping import StabilityWarning
from baselines.evaluation.metrics import bootstrap_interval
from baselines.evaluation.options import Options
from baselines.evaluation.request import Request
from baselines.evaluation.runner import Run
from baselines.evaluation.score import OPTIMUM_POLICY, SETPOINT_EXPERT, cap_of, capped, has_failed
from baselines.gains.loading import adapted_gains
from baselines.space import SPEED_RANGE
from baselines.tools.files import json_text, read_json, write_atomically
from baselines.tools.workers import Workers
from baselines.training.run_folder import TrainingError, locked
from baselines.tuning.objective import SPACE_TUNABLES, TUNABLES, TuningEpisodes
from baselines.tuning.search import Budget, search_record

CONTROLLERS = {"los-pid": Budget(), "nmpc": Budget(60, 16)}
"""Controllers whose gains are searched for the vehicle, and the size of the search, which takes a minute or less."""
WITH_SETPOINTS = {SETPOINT_EXPERT: Budget()}
"""The same if actions are setpoints."""
CHECKED = 128  # episodes on which the controllers with the gains found are compared, a multiple of 8
EPISODES = 48  # of the comparison; they have the seeds from 0 on
RESULT = "comparison.json"  # file of the results; comparison.md has the same as a table
STORM = "storm.toml"  # file of the scenario
GAINS_FOLDER = "gains"  # folder with a file of gains for each controller, which is a policy


@dataclass(frozen=True)
class Comparison:
    """The vehicle and the sea of a comparison, and an agent to compare with."""

    vehicle_model: VehicleModel
    sea: Sea
    agent: str | None  # None: actions are setpoints
    in_space: bool = False  # else in the plane

    @property
    def controllers(self) -> Mapping[str, Budget]:
        """The controllers of the comparison, with the size of their searches."""
        return CONTROLLERS if self.agent else WITH_SETPOINTS

    @property
    def speed_range(self) -> str:
        """Name of that of the storms, and of the cases on which gains are searched."""
        return SPEED_RANGE if self.in_space else "cruise"

    @property
    def scenario(self) -> Scenario:
        """The storms; raises ValueError if they are too slow for the fins of the vehicle."""
        name = f"{self.speed_range}-storm{'' if self.agent else SETPOINTS}"
        return self.sea.of(changed(as_scenario(name), self.vehicle_model))


def compare(comparison: Comparison, agents: Sequence[Path], out: Path, workers: Workers) -> str:
    """Compare agents, write the results to a folder, and return them as a table in Markdown.

    What an interrupted comparison has finished is used again.

    Args:
        comparison: what is compared with.
        agents: folders of agents.
        out: folder of the results.
        workers: for the searches of gains, and for the episodes.

    Raises:
        OSError: the folder cannot be written to.
        TrainingError: a policy failed.
        UsageError: another process writes to the folder.
        WorkerError: a worker process has died.
    """
    from baselines.evaluation.evaluate import run_request  # with its reports, which take long to import

    with locked(out):
        files = {name: out / GAINS_FOLDER / f"{name}.json" for name in comparison.controllers}
        tasks = [(name, comparison, file) for name, file in files.items() if not file.exists()]
        for name in workers.results(search, tasks):
            print(f"searched the gains of {name} for the vehicle", file=sys.stderr)
        own, others = [str(agent) for agent in agents], [str(file) for file in files.values()]
        if comparison.agent:
            guarded = [] if comparison.in_space else [f"{agent}{GUARD}={better_gains(out)}" for agent in own]
            others = [*guarded, comparison.agent, *others, OPTIMUM_POLICY]
        comparison.scenario.save(out / STORM)
        options = Options(
            (*own, *others),
            scenario=(str(out / STORM),),
            episodes=EPISODES,
            out=out / "comparison",
            step_limit=math.inf,
            resume=True,
        )
        runs = run_request(replace(Request.of(options), workers=workers))
        if failed := [f"{run.policy}: {run.error}" for run in runs if run.error]:
            raise TrainingError(f"the comparison failed: {failed[0]}")
        record = results(runs, out)
        text = table(record)
        write_atomically(out / "comparison.md", text)
        write_atomically(out / RESULT, json_text(record))
    return text


def better_gains(out: Path) -> Path:
    """Return the file of gains in a folder of results whose controller has the smallest error on other episodes."""
    files = (out / GAINS_FOLDER / f"{name}.json" for name in CONTROLLERS)
    return min(files, key=lambda file: float(read_json(file)["validation"]["error_m"]))


def search(name: str, comparison: Comparison, file: Path) -> str:
    """Search the gains of a controller, write them to a file as `auv-gym tune` does, and return the name."""
    own, speed_range = comparison.vehicle_model.in_paper_units, comparison.speed_range
    tunable = (SPACE_TUNABLES if comparison.in_space else TUNABLES)[name]
    vehicle: Any = own.in_space if comparison.in_space else own.vehicle
    start = adapted_gains(name, speed_range, tunable.names, own)

    def draw(episodes: int, seed: int) -> TuningEpisodes:
        world, model, sea = tunable.world, comparison.vehicle_model, comparison.sea
        return TuningEpisodes(speed_range, episodes, seed, world, model, sea)

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", StabilityWarning)  # of the expert, which the record compares with
        record = search_record(
            tunable, draw, start, comparison.controllers[name], vehicle, CHECKED, show=lambda *_: None
        )
    write_atomically(file, json_text({"controller": name, **record}))
    return name


def results(runs: Sequence[Run], out: Path) -> dict[str, Any]:
    """Return the results of policies on the same episodes; a failure is avoidable if another policy does not fail.

    Errors are steady-state RMSEs, with the error cap for failures; their interval (95 %) is over episodes.

    Args:
        runs: of the policies.
        out: folder from which the paths of policies are shown.
    """
    scenario = runs[0].scenario
    cap = cap_of(scenario)
    ended = [run.measures for run in runs if run.measures is not None]
    failed = np.array([has_failed(measures, cap) for measures in ended])
    inevitable = np.asarray(failed.all(axis=0))
    errors = [capped(measures, cap) for measures in ended]
    rows: list[dict[str, Any]] = [
        {
            "policy": run.policy.replace(f"{out}{os.sep}", ""),
            "error_m": float(error.mean()),
            "ci95": bootstrap_interval(error),
            "failed": int(lost.sum()),
            "avoidable": int((lost & ~inevitable).sum()),
        }
        for run, error, lost in zip(runs, errors, failed, strict=True)
    ]
    rows.sort(key=lambda row: row["error_m"])
    policies = shlex.join(run.policy for run in runs)
    storm, episodes = shlex.quote(str(out / STORM)), len(inevitable)
    command = f"auv-gym evaluate --scenario {storm} --episodes {episodes} --policy {policies}"
    return {"scenario": scenario.name, "episodes": episodes, "cap_m": cap, "rows": rows, "evaluate": command}


def table(record: dict[str, Any]) -> str:
    """Return the record of `results` as text with a table in Markdown."""
    lines = [
        f"| {row['policy']} | {row['error_m']:.3g} ({' ... '.join(f'{end:.3g}' for end in row['ci95'])}) | "
        f"{row['failed']} | {row['avoidable']} |"
        for row in record["rows"]
    ]
    has_optimum = any(row["policy"] == OPTIMUM_POLICY for row in record["rows"])
    optimum = f"`{OPTIMUM_POLICY}` has full information. " if has_optimum else ""
    about = (
        f"{record['episodes']} episodes of {record['scenario']}: mean steady-state error with 95 % interval, where a "
        f"failure counts as {record['cap_m']:.3g} m. A failure is avoidable if another policy of the table does "
        f"not fail. {optimum}The gains of gains/*.json are searched for this vehicle."
    )
    head = "| policy | error [m] | failures | avoidable |\n| --- | --- | --: | --: |"
    return "\n".join((about, "", head, *lines, "", f"All metrics: `{record['evaluate']}`", ""))

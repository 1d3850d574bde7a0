"""Fine-tune an agent to vehicles, and compare it with controllers: `python -m research fine-tuning`.

For each vehicle an agent is fine-tuned as by `auv-gym train --vehicle VEHICLE`. It runs the same
held-out episodes of the cruise cases with a disturbance as the original agent and the controllers. All policies are
given the vehicle model. docs/fine-tuning.md has the results.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from auv_gym.scenarios.presets import CASES, as_scenario
from auv_gym.scenarios.scenario import Scenario
from auv_gym.scenarios.vehicles import vehicle_names
from baselines.agents.names import AGENT_FOLDER
from baselines.evaluation.cells import drawn
from baselines.evaluation.fingerprints import fingerprint
from baselines.evaluation.rollout import rollout
from baselines.evaluation.score import RIVAL, Score, capped, count_failures, error_cap, in_paper_metres, relative_error
from baselines.policies import make_policy
from baselines.tools.command_line import DONE, WorkerError
from baselines.tools.workers import DEFAULT_JOBS
from baselines.training.command import (
    BASE_AGENT,
    FINE_TUNING_METHOD,
    hyperparameter_words,
    read_hyperparameters,
    shipped,
)
from baselines.training.command import Options as Training
from baselines.training.train import train_all
from research.pages import table, with_interval
from research.seeds import FINE_TUNING
from research.study import Study, stamp
from research.trainings.trainings import request_of

CONTROLLERS = ("backstepping", "los-pid", "ilos", "lqi", "ekf", RIVAL, "nmpc-adverse")
"""The controllers of the comparison; their gains are for the vehicle's parameters."""
TUNED_AGENT = "tuned"  # agent that is fine-tuned to a vehicle
_DISTURBED = tuple(case for case in CASES if case != "calm")
_EPISODES = 32  # of each case
_RUNS = Path("runs/fine-tuning")
"""Folder for the trainings, which continue if they were interrupted."""


def recipe() -> list[str]:
    """Return the settings that define a fine-tuning, as words NAME=VALUE."""
    return hyperparameter_words(read_hyperparameters(shipped(FINE_TUNING_METHOD)))


def vehicle_scenarios(vehicle: str) -> list[Scenario]:
    """Return the cruise cases with a disturbance for a vehicle."""
    return [as_scenario(f"cruise-{case}@{vehicle}") for case in _DISTURBED]


def _measure(vehicle: str, policy: str, quick: bool = False) -> dict[str, Any]:
    """Return the errors of a policy on a vehicle; the policy is trained first if it is `TUNED_AGENT`.

    Returns:
        `steady_rmses`: for each case the steady-state errors, in metres of the paper's vehicle, at most the error cap;
        `failed`: the number of failures; `command_rate`: the mean squared change of the command; `seconds` of training.
    """
    more = {}
    if policy == TUNED_AGENT:
        # A fine-tuning that started from another agent must not be resumed.
        folder, begin = _RUNS / f"{'quick-' * quick}{vehicle}-{fingerprint(BASE_AGENT)[-8:]}", time.monotonic()
        resumed = folder.exists()
        training = replace(Training(), vehicle=vehicle, timesteps=20_000 if quick else None, no_compare=True)
        if train_all(request_of(training, folder, DEFAULT_JOBS)) != DONE:
            raise WorkerError(f"the training for {vehicle} failed: {folder}")
        policy = str(folder / AGENT_FOLDER)
        more = {} if resumed else {"seconds": round(time.monotonic() - begin, 1)}
    steady_rmses, failed, rates = [], 0, []
    for scenario in vehicle_scenarios(vehicle):
        cell, cap = drawn(scenario, 2 if quick else _EPISODES, FINE_TUNING.first), error_cap(scenario.name)
        measures = in_paper_metres(
            rollout(make_policy(policy, scenario.known), scenario, cell.episodes).measures, scenario
        )
        steady_rmses.append([float(f"{x:.4g}") for x in capped(measures, cap)])
        failed += count_failures(measures, cap)
        rates.append(float(measures.smoothness.mean()))
    return {"steady_rmses": steady_rmses, "failed": failed, "command_rate": float(f"{np.mean(rates):.4g}")} | more


def _stamp(vehicle: str, policy: str) -> str:
    if policy == TUNED_AGENT:
        return stamp(BASE_AGENT, vehicle_scenarios(vehicle), _EPISODES, *recipe())
    return stamp(policy, vehicle_scenarios(vehicle), _EPISODES)


STUDY = Study(
    "fine-tuning",
    [(vehicle, policy) for vehicle in vehicle_names() for policy in (*CONTROLLERS, BASE_AGENT, TUNED_AGENT)],
    _measure,
    _stamp,
)
main = STUDY.main


def fine_tuning_section() -> str:
    """Return the section of docs/fine-tuning.md with the results."""
    vehicles: dict[str, dict[str, Any]] = {}
    for (vehicle, policy), value in STUDY.values().items():
        vehicles.setdefault(vehicle, {})[policy] = value
    count = _EPISODES * len(_DISTURBED)
    heads = [
        "vehicle", "best controller", f"`{BASE_AGENT}`", "tuned", f"tuned / `{BASE_AGENT}`",
        f"failures of {count}: best, `{RIVAL}`, `{BASE_AGENT}`, tuned", f"command rate / `{RIVAL}`", "training [s]",
    ]  # fmt: skip
    controllers = ", ".join(f"`{name}`" for name in CONTROLLERS)
    least, *_, most = sorted(
        np.mean(rows[TUNED_AGENT]["steady_rmses"]) / np.mean(rows[best_controller(rows)]["steady_rmses"])
        for rows in vehicles.values()
    )
    return (
        f"The seven cruise cases with a disturbance, {_EPISODES} held-out episodes each, one training seed. "
        f"The *best controller* is that with the smallest error among {controllers}, chosen on these episodes. The "
        "next two columns are the errors of the agents over that of this controller: geometric means over the cases "
        "of the ratios of mean errors, with failures at the error cap. So a case with small errors has the same "
        "weight as one with large errors. Intervals (95 %) are over episodes. Only the agent is trained for the "
        "vehicle; gains of the controllers follow from its parameters. The mean error over all cases of the tuned "
        f"agent is {least:.2f} to {most:.2f} times that of the best controller. The *command rate* is that of the "
        "tuned agent. The training ran in two processes.\n\n"
        f"{table(heads, [row_of(vehicle, rows) for vehicle, rows in vehicles.items()], right=False)}"
    )


def best_controller(rows: Mapping[str, Any]) -> str:
    """Return the controller with the smallest error of a vehicle's rows, see `error_ratio`."""
    return min((name for name in CONTROLLERS if name in rows), key=lambda name: error_ratio(rows, name, RIVAL).mean)


def error_ratio(rows: Mapping[str, Any], policy: str, other: str) -> Score:
    """Return the error of a policy over that of another one."""
    return relative_error(*([np.array(case) for case in rows[name]["steady_rmses"]] for name in (other, policy)))


def row_of(vehicle: str, rows: Mapping[str, Any]) -> list[str]:
    """Return the row of the table about a vehicle from its recorded rows, by policy."""
    best = best_controller(rows)
    ratios = [
        with_interval(error_ratio(rows, *pair))
        for pair in ((BASE_AGENT, best), (TUNED_AGENT, best), (TUNED_AGENT, BASE_AGENT))
    ]
    failures = ", ".join(str(rows[name]["failed"]) for name in (best, RIVAL, BASE_AGENT, TUNED_AGENT))
    rate = rows[TUNED_AGENT]["command_rate"] / rows[RIVAL]["command_rate"]
    seconds = f"{rows[TUNED_AGENT]['seconds']:.0f}" if "seconds" in rows[TUNED_AGENT] else "-"
    return [f"`{vehicle}`", f"`{best}`", *ratios, failures, f"{rate:.2f}", seconds]

"""Fine-tune an agent to vehicles, and compare it with controllers: `python -m research fine-tuning --help`.

For each vehicle an agent is fine-tuned as by `auv-gym train --from AGENT --vehicle VEHICLE`. It runs the same held-out
episodes of the cruise cases with a disturbance as the original agent and the controllers. All policies are given the
vehicle model. docs/fine-tuning.md has the results.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from tyro.conf import arg

from auv_gym.scenarios.presets import CASES
from auv_gym.scenarios.presets import as_scenario as preset
from auv_gym.scenarios.vehicles import vehicle_names
from baselines.agents.names import AGENT_FOLDER
from baselines.evaluation.fingerprints import fingerprint
from baselines.evaluation.rollout import rollout
from baselines.evaluation.runner import drawn
from baselines.evaluation.score import (
    RIVAL,
    capped,
    count_failures,
    error_cap,
    fixed,
    fixed_ends,
    in_paper_metres,
    relative_error,
)
from baselines.policies import make_policy
from baselines.tools.command_line import DONE, UsageError, check_words, parse
from baselines.tools.files import json_text, read_json, write_atomically
from baselines.tools.workers import DEFAULT_JOBS
from baselines.training.command import train
from baselines.training.hyperparameters import (
    FINE_TUNING_FILE_NAME,
    hyperparameter_words,
    load_hyperparameters,
    shipped,
)
from baselines.training.initial_agent import ALGO
from baselines.training.options import Options as Training
from research import DATA
from research.pages import table
from research.seeds import FINE_TUNING
from research.trainings.trainings import SHIPPED_TRAININGS, request_of

PROGRAM = "python -m research fine-tuning"
CONTROLLERS = ("backstepping", "los-pid", "ilos", "lqi", "ekf", RIVAL, "nmpc-adverse")
"""The controllers of the comparison; their gains are for the vehicle's parameters."""
TUNED = "tuned"  # agent that is fine-tuned to a vehicle
FINE_TUNING_FILE = DATA / "fine_tuning.json"  # record of the results
_DISTURBED = tuple(case for case in CASES if case != "calm")


@dataclass(frozen=True)
class Options:
    """Fine-tune an agent to vehicles and compare it with the agent and with controllers on held-out episodes.

    Rows in the file are not measured again, unless the policy has changed. Interrupted trainings continue.

    Exit status: 0 done, 1 a training failed, 2 wrong usage.
    """

    vehicle: Annotated[tuple[str, ...], arg(metavar="V [V ...]", help_behavior_hint="")] = tuple(vehicle_names())
    """Names of published vehicles."""
    agent: str = "helm-any"
    """Shipped agent that is fine-tuned."""
    policy: Annotated[tuple[str, ...], arg(metavar="P [P ...]", help_behavior_hint="")] = ()
    """Policies to measure: "tuned", or names. Default: this one, the agent and the controllers."""
    episodes: int = 32
    """Number of episodes of each case."""
    timesteps: Annotated[int | None, arg(metavar="INT", help_behavior_hint="")] = None
    """Control steps of each training, for a trial run."""
    runs: Path = Path("runs/fine-tuning")
    """Folder for the trainings."""
    out: Path = FINE_TUNING_FILE
    """File for the results."""


def recipe(timesteps: int | None = None) -> list[str]:
    """Return the settings that define a fine-tuning, as words NAME=VALUE."""
    table = load_hyperparameters(shipped(ALGO), FINE_TUNING_FILE_NAME)
    return hyperparameter_words({"timesteps": timesteps or table.timesteps, **table.values})


def errors(policy: str, vehicle: str, episodes: int) -> dict[str, Any]:
    """Return the errors of a policy in the cruise cases of a vehicle.

    Returns:
        `steady_rmses`: for each case the steady-state errors, in metres of the paper's vehicle, at most the error cap;
        `failed`: the number of failures; `command_rate`: the mean squared change of the command.
    """
    steady_rmses, failed, rates = [], 0, []
    for case in _DISTURBED:
        scenario = preset(f"cruise-{case}@{vehicle}")
        found = drawn(scenario, episodes, FINE_TUNING.first)
        measures = rollout(make_policy(policy, scenario.known), scenario, found.episodes).measures
        own, cap = in_paper_metres(measures, scenario), error_cap(scenario.name)
        steady_rmses.append([float(f"{x:.4g}") for x in capped(own, cap)])
        failed += count_failures(own, cap)
        rates.append(float(measures.smoothness.mean()))
    return {"steady_rmses": steady_rmses, "failed": failed, "command_rate": float(f"{np.mean(rates):.4g}")}


def main(arguments: Sequence[str]) -> int:
    """Train the agents, measure the errors, record them, and return the exit status.

    Raises:
        UsageError: the arguments are invalid.
    """
    options = parse(Options, arguments, PROGRAM)
    check_words("vehicle", options.vehicle, vehicle_names())
    check_words("agent", [options.agent], SHIPPED_TRAININGS)
    if not fingerprint(options.agent):
        train = f"python -m research train-all {options.agent} --install"
        raise UsageError(f"--agent {options.agent} is not installed: {train} trains it")
    if options.episodes < 2:
        raise UsageError(f"--episodes is {options.episodes}; it must be 2 or more")
    names = options.policy or _compared(options.agent)
    record = still_valid(options)
    status = DONE
    for vehicle in options.vehicle:
        kept = record["vehicles"].setdefault(vehicle, {})
        for name in names:
            if name not in kept:
                found = _measured(name, vehicle, options)
                if own := found.pop("status", DONE):
                    status = max(status, own)
                    continue
                kept[name] = found | {"fingerprint": row_fingerprint(name, options.agent)}
                write_atomically(options.out, json_text(record))
                print(f"{vehicle}: {name}", flush=True)
    return status


def still_valid(options: Options) -> dict[str, Any]:
    """Return the record of a file, without the rows that are out of date.

    A row is out of date if its policy has another `row_fingerprint`, or if it was tuned by another `recipe`. If the
    agent or the number of episodes differs, no row stays.
    """
    record = read_json(options.out) if options.out.exists() else {}
    if record.get("agent") != options.agent or record.get("episodes") != options.episodes:
        return {"agent": options.agent, "episodes": options.episodes, "vehicles": {}}
    chosen = recipe(options.timesteps)
    for vehicle, found in record["vehicles"].items():
        record["vehicles"][vehicle] = {
            name: row
            for name, row in found.items()
            if row.get("fingerprint") == row_fingerprint(name, options.agent) and row.get("set", chosen) == chosen
        }
    return record


def row_fingerprint(name: str, agent: str) -> str:
    """Return the fingerprint of a policy; for `TUNED` that of the agent that is tuned."""
    return fingerprint(agent if name == TUNED else name)


def _compared(agent: str) -> tuple[str, ...]:
    """Return the policies of a comparison."""
    return *CONTROLLERS, agent, TUNED


def _measured(name: str, vehicle: str, options: Options) -> dict[str, Any]:
    """Return the row of a policy, which is trained first if necessary; {"status": ...} if its training failed."""
    if name != TUNED:
        return errors(name, vehicle, options.episodes)
    # A fine-tuning that started from another agent must not be resumed.
    folder, begin = options.runs / f"{vehicle}-{fingerprint(options.agent)[:8]}", time.monotonic()
    resumed = folder.exists()
    training = replace(Training(), from_=options.agent, vehicle=vehicle, timesteps=options.timesteps)
    if status := train(request_of(training, folder, DEFAULT_JOBS)):
        return {"status": status}
    took = {} if resumed else {"seconds": round(time.monotonic() - begin, 1)}
    found = errors(str(folder / AGENT_FOLDER), vehicle, options.episodes)
    return found | took | {"set": recipe(options.timesteps)}


def fine_tuning_section() -> str:
    """Return the section of docs/fine-tuning.md with the results."""
    record = read_json(FINE_TUNING_FILE)
    agent, vehicles = record["agent"], record["vehicles"]
    count = record["episodes"] * len(_DISTURBED)
    rows = [_row(vehicle, found, agent) for vehicle, found in vehicles.items() if TUNED in found]
    heads = [
        "vehicle", "best controller", f"`{agent}`", "tuned", f"tuned / `{agent}`",
        f"failures of {count}: best, `{RIVAL}`, `{agent}`, tuned", f"command rate / `{RIVAL}`", "training [s]",
    ]  # fmt: skip
    controllers = ", ".join(f"`{name}`" for name in CONTROLLERS)
    return (
        f"The seven cruise cases with a disturbance, {record['episodes']} held-out episodes each, one training seed. "
        f"The *best controller* is that with the smallest error among {controllers}, chosen on these episodes. The "
        "next two columns are the errors of the agents over that of this controller: geometric means over the cases "
        "of the ratios of mean errors, with failures at the error cap. So a case with small errors has the same "
        "weight as one with large errors. Intervals (95 %) are over episodes. Only the agent is trained for the "
        f"vehicle; gains of the controllers follow from its parameters. {_plain_means(vehicles)} The *command rate* "
        "is that of the tuned agent. The training ran in two processes.\n\n"
        f"{table(heads, rows, right=False)}"
    )


def _plain_means(vehicles: Mapping[str, Any]) -> str:
    """Return a sentence with the ratios of the mean errors over all cases, which the largest errors dominate."""
    means = [
        [np.mean([np.mean(case) for case in found[name]["steady_rmses"]]) for name in (TUNED, best_controller(found))]
        for found in vehicles.values()
        if TUNED in found
    ]
    ratios = sorted(own / best for own, best in means)
    return (
        f"The mean error over all cases of the tuned agent is {ratios[0]:.2f} to {ratios[-1]:.2f} times that of the "
        "best controller."
    )


def best_controller(found: Mapping[str, Any]) -> str:
    """Return the controller with the smallest error of a vehicle's rows, see `ratio`."""
    return min((name for name in CONTROLLERS if name in found), key=lambda name: ratio(found, name, RIVAL)[0])


def ratio(found: Mapping[str, Any], policy: str, other: str) -> tuple[float, tuple[float, float]]:
    """Return the error of a policy over that of another one, and its 95 % interval."""
    sides = ([np.array(case) for case in found[name]["steady_rmses"]] for name in (other, policy))
    found_ratio = relative_error(*sides)
    return found_ratio.mean, found_ratio.ci95


def _row(vehicle: str, found: Mapping[str, Any], agent: str) -> list[str]:
    best = best_controller(found)
    pairs: Sequence[tuple[str, str]] = (agent, best), (TUNED, best), (TUNED, agent)
    ratios = [f"{fixed(mean, 2)} ({fixed_ends(ends, 2)})" for mean, ends in (ratio(found, *pair) for pair in pairs)]
    failures = ", ".join(str(found[name]["failed"]) for name in (best, RIVAL, agent, TUNED))
    rate = found[TUNED]["command_rate"] / found[RIVAL]["command_rate"]
    seconds = f"{found[TUNED]['seconds']:.0f}" if "seconds" in found[TUNED] else "-"
    return [f"`{vehicle}`", f"`{best}`", *ratios, failures, fixed(rate, 2), seconds]

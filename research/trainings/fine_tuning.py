"""Compare fine-tuning to a vehicle with training from the start: `python -m research fine-tuning --help`.

For each vehicle one agent is fine-tuned as by `auv-gym train --from AGENT --vehicle VEHICLE`, and another one is
trained from the start for this vehicle alone. Both run the same held-out episodes of the cruise cases as the original
agent, the expert and predictive control. All policies are given the vehicle model. docs/fine-tuning.md has the results.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from tyro.conf import arg

from auv_gym.physics.namespaces import Array
from auv_gym.physics.units import Units
from auv_gym.scenarios.presets import CASES
from auv_gym.scenarios.presets import as_scenario as preset
from auv_gym.scenarios.vehicles import vehicle_names
from baselines.agents.names import agent_folder
from baselines.evaluation.metrics import resamplings
from baselines.evaluation.rollout import rollout
from baselines.evaluation.runner import drawn
from baselines.evaluation.score import EXPERT, RIVAL, capped, count_failures, error_cap, in_paper_metres, relative_error
from baselines.policies import make_policy
from baselines.tools.command_line import DONE, UsageError, check_words, parse
from baselines.tools.files import json_text, read_json, write_atomically
from baselines.tools.workers import DEFAULT_JOBS
from baselines.training.beginning import ALGO, weights_digest
from baselines.training.command import train
from baselines.training.hyperparameters import (
    FINE_TUNING_FILE_NAME,
    changes_of,
    hyperparameter_words,
    load_hyperparameters,
    shipped,
)
from baselines.training.options import Options as Training
from baselines.training.run_folder import AGENT_FOLDER
from research import DOCS
from research.pages import table
from research.seeds import FINE_TUNING
from research.trainings.trainings import SHIPPED_TRAININGS, request_of

PROGRAM = "python -m research fine-tuning"
_GOAL = 1.05
"""Largest error of a tuned agent that meets the goal, relative to the agent trained for the vehicle alone."""
_VEHICLES = ("lauv", "otter", "remus100", "cybership2", "nps-auv2")
"""The vehicles of the study."""
_TUNED = "tuned"  # agent that is fine-tuned to a vehicle
ALONE = "alone"  # agent that is trained from the start for a vehicle
FINE_TUNING_FILE = "fine-tuning.json"  # record of the results, in docs/
SHARED = ("hull",)
"""Hyper-parameters of the agent that the training from the start takes over; the learning rates are not among them."""
LENGTH = 12_000_000
"""Control steps of the training from the start."""
PIECES = 6
"""Number of validations; an interrupted training resumes at the last one."""
SAYS = {
    EXPERT: "the expert",
    RIVAL: "predictive control",
    "": "the original agent",
    _TUNED: "tuned to the vehicle",
    ALONE: "trained for it alone",
}
"""Names of the policies in the table; "" is the original agent."""


@dataclass(frozen=True)
class Options:
    """Fine-tune an agent to vehicles, train one from the start for each, and compare them on held-out episodes.

    Rows in the file are not measured again. If the weights of the agent have changed, the rows of the agent and of
    the agents tuned from it are. Interrupted trainings continue.

    Exit status: 0 done, 1 a training failed, 2 wrong usage.
    """

    vehicle: Annotated[tuple[str, ...], arg(metavar="V [V ...]", help_behavior_hint="")] = _VEHICLES
    """Names of published vehicles."""
    agent: str = "helm-any"
    """Shipped agent that is fine-tuned."""
    policy: Annotated[tuple[str, ...], arg(metavar="P [P ...]", help_behavior_hint="")] = ()
    """Policies to measure: "tuned", "alone", or names. Default: these two, the agent, the expert and nmpc."""
    episodes: int = 32
    """Number of episodes of each case."""
    timesteps: Annotated[int | None, arg(metavar="INT", help_behavior_hint="")] = None
    """Control steps of each training, for a trial run."""
    runs: Path = Path("runs/fine-tuning")
    """Folder for the trainings."""
    out: Path = DOCS / FINE_TUNING_FILE
    """File for the results."""


def trainings(agent: str, vehicle: str, timesteps: int | None = None) -> dict[str, Training]:
    """Return the two trainings for a vehicle: the fine-tuning of an agent, and the training from the start.

    The training from the start is that of the agent, in one worker group, with `PIECES` validations. If the agent was
    itself trained further from another agent, it is the training of that other agent, with the values `SHARED` of this
    one.

    Args:
        agent: one of `trainings.SHIPPED_TRAININGS`.
        vehicle: name of the vehicle.
        timesteps: control steps of both trainings; None: the default of `train.py --from`, and `LENGTH`.
    """
    own = SHIPPED_TRAININGS[agent]
    first = SHIPPED_TRAININGS.get(own.from_ or "", own)  # the learning rates of `own` are for fine-tuning
    shared = {name: value for name, value in changes_of(own.set).items() if own.from_ and name in SHARED}
    words = hyperparameter_words({**changes_of(first.set), **shared, "groups": 1, "validations": PIECES})
    return {
        _TUNED: replace(Training(), from_=agent, vehicle=vehicle, timesteps=timesteps),
        ALONE: replace(first, set=tuple(words), vehicle=vehicle, timesteps=timesteps or LENGTH),
    }


def recipe(name: str, agent: str, vehicle: str, timesteps: int | None = None) -> list[str]:
    """Return the settings that define one of the two `trainings`, as words NAME=VALUE."""
    if name == ALONE:
        own = trainings(agent, vehicle, timesteps)[ALONE]
        return [*own.set, *hyperparameter_words({"timesteps": own.timesteps})]
    table = load_hyperparameters(shipped(ALGO), FINE_TUNING_FILE_NAME)
    return hyperparameter_words({"timesteps": timesteps or table.timesteps, **table.values})


def errors(policy: str, vehicle: str, episodes: int) -> dict[str, Any]:
    """Return the errors of a policy in the cruise cases of a vehicle.

    Returns:
        `steady_rmses`: for each case the steady-state errors, in metres of the paper's vehicle, at most the error cap;
        `failed`: for each case the number of failures.
    """
    steady_rmses, failed = [], []
    for case in CASES:
        scenario = preset(f"cruise-{case}@{vehicle}")
        found = drawn(scenario, episodes, FINE_TUNING.first)
        measures = rollout(make_policy(policy, scenario.vehicle), scenario, found.episodes).measures
        own, cap = in_paper_metres(measures, scenario), error_cap(scenario.name)
        steady_rmses.append([float(f"{x:.4g}") for x in capped(own, cap)])
        failed.append(count_failures(own, cap))
    return {"steady_rmses": steady_rmses, "failed": failed}


def main(arguments: Sequence[str]) -> int:
    """Train the agents, measure the errors, record them, and return the exit status.

    Raises:
        UsageError: the arguments are invalid.
    """
    options = parse(Options, arguments, PROGRAM)
    check_words("vehicle", options.vehicle, vehicle_names())
    check_words("agent", [options.agent], SHIPPED_TRAININGS)
    if options.episodes < 2:
        raise UsageError(f"--episodes is {options.episodes}; it must be 2 or more")
    names = options.policy or _compared(options.agent)
    record = still_valid(options, shipped_digest(options.agent))
    status = DONE
    for vehicle in options.vehicle:
        kept = record["vehicles"].setdefault(vehicle, {})
        for name in names:
            if name not in kept:
                found = _measured(name, vehicle, options, record["weights"])
                if own := found.pop("status", DONE):
                    status = max(status, own)
                    continue
                kept[name] = found
                options.out.parent.mkdir(parents=True, exist_ok=True)
                write_atomically(options.out, json_text(record))
                print(f"{vehicle}: {name}", flush=True)
    return status


def shipped_digest(agent: str) -> str:
    """Return the SHA-256 of the weights of an agent that ships.

    Raises:
        OSError: the weights cannot be read.
        UsageError: the agent is not installed.
    """
    if (folder := agent_folder(agent)) is None:
        raise UsageError(f"--agent {agent} is not installed: python -m research train-all {agent} --install trains it")
    return weights_digest(folder)


def still_valid(options: Options, weights: str) -> dict[str, Any]:
    """Return the record of a file, without the rows that are out of date.

    If the agent or the number of episodes differs, no row stays. If the weights of the agent have changed, its own rows
    and those of the agents tuned from it go. Rows of a training whose `recipe` has changed go.
    """
    record = read_json(options.out) if options.out.exists() else {}
    if record.get("agent") != options.agent or record.get("episodes") != options.episodes:
        return {"agent": options.agent, "weights": weights, "episodes": options.episodes, "vehicles": {}}
    stale = (options.agent, _TUNED) if record.get("weights") != weights else ()
    for vehicle, found in record["vehicles"].items():
        own = {name: recipe(name, options.agent, vehicle, options.timesteps) for name in (_TUNED, ALONE)}
        record["vehicles"][vehicle] = {
            name: row
            for name, row in found.items()
            if name not in stale and ("set" not in row or row["set"] == own[name])
        }
    return {**record, "weights": weights}


def _compared(agent: str) -> tuple[str, ...]:
    """Return the policies of a comparison, in the order of the table."""
    return EXPERT, RIVAL, agent, _TUNED, ALONE


def _measured(name: str, vehicle: str, options: Options, weights: str) -> dict[str, Any]:
    """Return the row of a policy, which is trained first if necessary; {"status": ...} if its training failed."""
    if name not in (_TUNED, ALONE):
        return errors(name, vehicle, options.episodes)
    # A fine-tuning that started from other weights must not be resumed.
    run_name = f"{name}-{weights[:8]}" if name == _TUNED else name
    folder, begin = options.runs / f"{vehicle}-{run_name}", time.monotonic()
    resumed = folder.exists()
    training = trainings(options.agent, vehicle, options.timesteps)[name]
    request = request_of(training, folder, DEFAULT_JOBS)
    if status := train(request):
        return {"status": status}
    # Imported here: it takes seconds to load, and --help needs none of it.
    from baselines.training.apg.settings import check

    processors = min(DEFAULT_JOBS, check(request.configs[0]).groups)
    took = {} if resumed else {"seconds": round(time.monotonic() - begin, 1), "processors": processors}
    own = {"set": recipe(name, options.agent, vehicle, options.timesteps)}
    return errors(str(folder / AGENT_FOLDER), vehicle, options.episodes) | took | own


def error_ratio(policy: Mapping[str, Any], other: Mapping[str, Any]) -> tuple[float, float, float]:
    """Return the geometric mean over paired episodes of the ratio of two policies' errors, and its 95 % interval."""
    logs = [
        np.log(np.array(a) / np.array(b)) for a, b in zip(policy["steady_rmses"], other["steady_rmses"], strict=True)
    ]
    weights = resamplings(tuple(map(len, logs)))
    sums: Array = sum((w @ own / len(own) for w, own in zip(weights, logs, strict=True)), np.zeros(1))
    values = np.exp(sums / len(logs))
    low, high = np.quantile(values[1:], (0.025, 0.975)).tolist()
    return float(values[0]), low, high


def fine_tuning_section() -> str:
    """Return the section of docs/fine-tuning.md with the results."""
    record = read_json(DOCS / FINE_TUNING_FILE)
    policies, vehicles = _compared(record["agent"]), record["vehicles"].items()
    gaps = [f"{name} for {vehicle}" for vehicle, found in vehicles for name in policies if name not in found]
    missing = f" Not measured yet: {', '.join(gaps)}." if gaps else ""
    return (
        f"`{record['agent']}` in the cruise cases of published vehicles, {record['episodes']} held-out episodes each, "
        "one training seed. All policies are given the vehicle model. The *typical error* is the geometric mean of the "
        "steady-state errors, with failures at the error cap. *Typical ratio*: the geometric mean of the ratios to the "
        "agent trained for the vehicle alone. *Mean ratio*: the same with mean errors, which large errors dominate. "
        f"Intervals (95 %) are over episodes.{missing}\n\n"
        f"{fine_tuning_table(record)}{tuned_table(record)}"
    )


def fine_tuning_table(record: Mapping[str, Any]) -> str:
    """Return the results of all policies as a table in Markdown."""
    count = record["episodes"] * len(CASES)
    lines = [
        f"| vehicle | policy | typical error [cm] | typical ratio | mean ratio | failures of {count} |",
        "|---|---|---|---|---|---|",
    ]
    policies = _compared(record["agent"])
    for vehicle, found in record["vehicles"].items():
        length = Units.of(preset(f"cruise-calm@{vehicle}").vehicle).length
        for name in sorted(found, key=lambda name: policies.index(name) if name in policies else -1):
            own = found[name]
            typical = 100 * length * math.exp(float(np.mean(np.log(own["steady_rmses"]))))
            says = f"`{name}`, {SAYS[name]}" if name in (EXPERT, RIVAL) else SAYS.get(name, f"`{name}`, {SAYS['']}")
            shares = [_share(ends) for ends in _over_alone(own, found)] if name != ALONE else ["1", "1"]
            lines.append(
                f"| `{vehicle}` | {says}{_took(own)} | {typical:.2f} | {' | '.join(shares)} | {sum(own['failed'])} |"
            )
    return "\n".join(lines) + "\n"


def _took(own: Mapping[str, Any]) -> str:
    if "seconds" not in own:
        return ""
    return f", {own['seconds']:.0f} s on {own['processors']} processor{'s' if own['processors'] > 1 else ''}"


def _over_alone(own: Mapping[str, Any], found: Mapping[str, Any]) -> list[tuple[float, float, float] | None]:
    """Return the ratios of the typical and of the mean error to those of `ALONE`, with intervals; None without it."""
    if ALONE not in found:
        return [None, None]
    mean = relative_error(*([np.array(case) for case in of["steady_rmses"]] for of in (found[ALONE], own)))
    return [error_ratio(own, found[ALONE]), (mean.mean, *mean.ci95)]


def _share(ends: tuple[float, float, float] | None) -> str:
    return "-" if ends is None else "{:.2f} ({:.2f} ... {:.2f})".format(*ends)


def tuned_table(record: Mapping[str, Any]) -> str:
    """Return the ratios of the tuned agents' errors to those of other policies as a table; "" without tuned agents."""
    rows = []
    for vehicle, found in record["vehicles"].items():
        if _TUNED in found:
            others = (record["agent"], RIVAL)
            ratios = [_share(error_ratio(found[_TUNED], found[name]) if name in found else None) for name in others]
            rows.append([f"`{vehicle}`", *ratios, *map(_verdict, _over_alone(found[_TUNED], found))])
    if not rows:
        return ""
    heads = ["vehicle", f"ratio to `{record['agent']}`", f"ratio to `{RIVAL}`", "by typical ratio", "by mean ratio"]
    return (
        "\nTypical ratios of the tuned agent, and whether its error is within "
        f"{_GOAL:g} times that of the agent trained for the vehicle alone, with the whole interval:\n\n"
        f"{table(heads, rows, right=False)}"
    )


def _verdict(ratio: tuple[float, float, float] | None) -> str:
    if ratio is None:
        return "-"
    _, low, high = ratio
    return "within" if high <= _GOAL else "beyond" if low > _GOAL else "undecided"

"""What fine-tuning to a vehicle is worth: `python -m research fine-tuning --help`.

For each vehicle an agent is tuned as by `auv-gym train --from AGENT --vehicle VEHICLE`, and another one is trained for
the vehicle alone. Both run the same held-out episodes of the cruise cases as the original agent, the expert and
predictive control. All of them are given the vehicle model. docs/fine-tuning.md has the results.
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
"""What the error of a tuned agent may be at most, over that of one trained alone."""
_VEHICLES = ("lauv", "otter", "remus100", "cybership2", "nps-auv2")
"""The vehicles of the study."""
_TUNED = "tuned"  # the agent that begins with another one and is trained for a vehicle
ALONE = "alone"  # the one that begins with nothing
FINE_TUNING_FILE = "fine-tuning.json"  # of what was measured, in docs/
SHARED = ("hull",)
"""Hyper-parameters of an agent that are also used where a vehicle's agent is trained from the start: not its rates."""
LENGTH = 12_000_000
"""Control steps of the training for a vehicle alone."""
PIECES = 6
"""How often it is validated: it goes on from there when it is interrupted."""
SAYS = {
    EXPERT: "the expert",
    RIVAL: "predictive control",
    "": "the original agent",
    _TUNED: "tuned to the vehicle",
    ALONE: "trained for it alone",
}
"""Their names in the table."""


@dataclass(frozen=True)
class Options:
    """Tune an agent to vehicles, train one for each alone, and compare them on held-out episodes.

    Rows in the file are not measured again, except those of the agent and of what was tuned from it when its weights
    have changed. Interrupted trainings continue.

    Exit status: 0 done, 1 a training failed, 2 wrong usage.
    """

    vehicle: Annotated[tuple[str, ...], arg(metavar="V [V ...]", help_behavior_hint="")] = _VEHICLES
    """Published vehicles by name."""
    agent: str = "helm-any"
    """The agent that is tuned, one that ships with the package."""
    policy: Annotated[tuple[str, ...], arg(metavar="P [P ...]", help_behavior_hint="")] = ()
    """Who is measured: "tuned", "alone", or policies by name. Default: these two, the agent, the expert and nmpc."""
    episodes: int = 32
    """Episodes of each case."""
    timesteps: Annotated[int | None, arg(metavar="INT", help_behavior_hint="")] = None
    """Control steps of each training, to try it out."""
    runs: Path = Path("runs/fine-tuning")
    """Folder for the trainings."""
    out: Path = DOCS / FINE_TUNING_FILE
    """File for what is measured."""


def trainings(agent: str, vehicle: str, timesteps: int | None = None) -> dict[str, Training]:
    """Return the two trainings for a vehicle: what begins with the agent, and one from nothing.

    That is the agent's own, or that of the agent which it began with, with `SHARED` of the agent's own, `LENGTH` and
    `PIECES`, in one group.

    Args:
        agent: one of `trainings.SHIPPED_TRAININGS`.
        vehicle: its name.
        timesteps: of both, None: what `train.py --from` takes, and `LENGTH`.
    """
    own = SHIPPED_TRAININGS[agent]
    first = SHIPPED_TRAININGS.get(own.from_ or "", own)  # an agent that began with another has its rates for going on
    shared = {name: value for name, value in changes_of(own.set).items() if own.from_ and name in SHARED}
    words = hyperparameter_words({**changes_of(first.set), **shared, "groups": 1, "validations": PIECES})
    return {
        _TUNED: replace(Training(), from_=agent, vehicle=vehicle, timesteps=timesteps),
        ALONE: replace(first, set=tuple(words), vehicle=vehicle, timesteps=timesteps or LENGTH),
    }


def recipe(name: str, agent: str, vehicle: str, timesteps: int | None = None) -> list[str]:
    """Return what makes one of the two `trainings` what it is, as words NAME=VALUE."""
    if name == ALONE:
        own = trainings(agent, vehicle, timesteps)[ALONE]
        return [*own.set, *hyperparameter_words({"timesteps": own.timesteps})]
    table = load_hyperparameters(shipped(ALGO), FINE_TUNING_FILE_NAME)
    return hyperparameter_words({"timesteps": timesteps or table.timesteps, **table.values})


def errors(policy: str, vehicle: str, episodes: int) -> dict[str, Any]:
    """Return the errors of a policy in the cruise cases of a vehicle.

    Returns:
        `steady_rmses`, the steady-state errors in metres of the paper's vehicle, those of failures at the error
        cap; `failed`, the number of failures.
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
    """Train and measure as the arguments say and return the exit status.

    Raises:
        UsageError: the arguments do not make sense.
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
        OSError: they cannot be read.
        UsageError: it is not here.
    """
    if (folder := agent_folder(agent)) is None:
        raise UsageError(f"--agent {agent} is not here: python -m research train-all {agent} --install trains it")
    return weights_digest(folder)


def still_valid(options: Options, weights: str) -> dict[str, Any]:
    """Return the record of a file with what still counts in it.

    That is nothing of another agent or of other episodes; of an agent with other weights all but the rows of the agent
    itself and of what was tuned from it; and nothing that was trained by another `recipe`.
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
    """Return who is compared where an agent is tuned, in the order of the table."""
    return EXPERT, RIVAL, agent, _TUNED, ALONE


def _measured(name: str, vehicle: str, options: Options, weights: str) -> dict[str, Any]:
    """Return what one of them does, once it is trained; only a status where that has failed."""
    if name not in (_TUNED, ALONE):
        return errors(name, vehicle, options.episodes)
    of = f"{name}-{weights[:8]}" if name == _TUNED else name  # no run is gone on with that began with other weights
    folder, begin = options.runs / f"{vehicle}-{of}", time.monotonic()
    there = folder.exists()
    training = trainings(options.agent, vehicle, options.timesteps)[name]
    request = request_of(training, folder, DEFAULT_JOBS)
    if status := train(request):
        return {"status": status}
    # Imported here: it takes seconds to load, and --help needs none of it.
    from baselines.training.apg.settings import check

    processors = min(DEFAULT_JOBS, check(request.configs[0]).groups)
    took = {} if there else {"seconds": round(time.monotonic() - begin, 1), "processors": processors}
    own = {"set": recipe(name, options.agent, vehicle, options.timesteps)}
    return errors(str(folder / AGENT_FOLDER), vehicle, options.episodes) | took | own


def error_ratio(policy: Mapping[str, Any], other: Mapping[str, Any]) -> tuple[float, float, float]:
    """Return the geometric mean over paired episodes of one policy's error over another's, with its 95 % interval."""
    logs = [
        np.log(np.array(a) / np.array(b)) for a, b in zip(policy["steady_rmses"], other["steady_rmses"], strict=True)
    ]
    drawn_again = resamplings(tuple(map(len, logs)))
    sums: Array = sum((w @ own / len(own) for w, own in zip(drawn_again, logs, strict=True)), np.zeros(1))
    values = np.exp(sums / len(logs))
    low, high = np.quantile(values[1:], (0.025, 0.975)).tolist()
    return float(values[0]), low, high


def fine_tuning_section() -> str:
    """Return the part of docs/fine-tuning.md with the results."""
    record = read_json(DOCS / FINE_TUNING_FILE)
    asked, vehicles = _compared(record["agent"]), record["vehicles"].items()
    gaps = [f"{name} for {vehicle}" for vehicle, found in vehicles for name in asked if name not in found]
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
    """Return what was measured as a table in Markdown."""
    count = record["episodes"] * len(CASES)
    lines = [
        f"| vehicle | policy | typical error [cm] | typical ratio | mean ratio | failures of {count} |",
        "|---|---|---|---|---|---|",
    ]
    asked = _compared(record["agent"])
    for vehicle, found in record["vehicles"].items():
        length = Units.of(preset(f"cruise-calm@{vehicle}").vehicle).length
        for name in sorted(found, key=lambda name: asked.index(name) if name in asked else -1):
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
    """Return the typical and the mean error over that of the agent trained alone, with intervals; None without one."""
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

"""Train an agent for each vehicle with fins, and compare it with searched gains: `python -m research fine-tuning`.

The agents are trained as by `auv-gym train --vehicle VEHICLE` in one sea. They run held-out storms beside the
controllers with the gains that this command has searched, and the full-information optimum. docs/fine-tuning.md has the
results. Agents whose actions are setpoints run beside the guidance, see docs/setpoints.md.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from auv_gym.scenarios.presets import SETPOINTS, as_scenario
from baselines.agents.agent import Agent
from baselines.agents.names import AGENT_FOLDER, GUARD
from baselines.evaluation.cells import drawn
from baselines.evaluation.fingerprints import fingerprint
from baselines.evaluation.rollout import rollout
from baselines.evaluation.score import OPTIMUM_POLICY, SETPOINT_EXPERT, capped, error_cap, has_failed, relative_error
from baselines.policies import make_policy
from baselines.tools.command_line import DONE, WorkerError
from baselines.tools.workers import DEFAULT_JOBS
from baselines.training.command import (
    BASE_AGENT,
    FINE_TUNING_METHOD,
    SETPOINT_METHOD,
    hyperparameter_words,
    read_hyperparameters,
    shipped,
)
from baselines.training.command import Options as Training
from baselines.training.comparison import GAINS_FOLDER, STORM, better_gains
from baselines.training.train import train_all
from research.pages import table, with_interval
from research.seeds import FINE_TUNING
from research.study import Study, stamp
from research.trainings.trainings import request_of

VEHICLES = ("eca-a9", "lauv", "nps-auv2", "remus100")
"""The published vehicles with fins."""
TUNED_AGENT, GUARDED = "tuned", f"tuned{GUARD}"
"""The agent that is trained for a vehicle, and the same with the better controller as the fallback of its guard."""
SETPOINT_VEHICLES = ("lauv", "remus100")
"""Vehicles of the agents whose actions are setpoints, and the second word of their rows."""
_SETPOINTS = "setpoints"
_CURRENT = (0.0, 0.5)  # [m/s]
_EPISODES = 144
_RUNS = Path("runs/fine-tuning")
"""Folder for the trainings, which continue if they were interrupted."""


def recipe(method: str = FINE_TUNING_METHOD) -> list[str]:
    """Return the settings that define a training for a vehicle, as words NAME=VALUE."""
    return hyperparameter_words(read_hyperparameters(shipped(method)))


def _measure(vehicle: str, actions: str = "", quick: bool = False) -> dict[str, Any]:
    """Return the results of all policies on a vehicle, after the training, for forces or setpoints as actions.

    Returns:
        `best`: the controller with the smaller error on the validation episodes of its search; `seconds` of the
        training; `errors`: by policy the steady-state errors [m], at most the error cap; `failed`: by policy the
        episodes that failed.
    """
    # A training that started from another agent must not be resumed.
    training = Training(vehicle=vehicle, current=_CURRENT, waves=1.0, timesteps=20_000 if quick else None)
    folder = _RUNS / f"{'quick-' * quick}{vehicle}-{actions or fingerprint(BASE_AGENT)[-8:]}"
    if actions:
        training = replace(training, scenario=(f"cruise{SETPOINTS}",))
    if train_all(request_of(training, folder, DEFAULT_JOBS)) != DONE:
        raise WorkerError(f"the training for {vehicle} failed: {folder}")
    agent, scenario = folder / AGENT_FOLDER, as_scenario(str(folder / STORM))
    policies = {TUNED_AGENT: str(agent)}
    policies |= {file.stem: str(file) for file in sorted((folder / GAINS_FOLDER).iterdir())}
    best = Path(SETPOINT_EXPERT)
    if not actions:
        best = better_gains(folder)
        policies |= {GUARDED: f"{agent}{GUARD}={best}", BASE_AGENT: BASE_AGENT, OPTIMUM_POLICY: OPTIMUM_POLICY}
    cell = drawn(scenario, 2 if quick else _EPISODES, FINE_TUNING.first)
    ended = {
        name: rollout(make_policy(policy, scenario.known), scenario, cell.episodes).measures
        for name, policy in policies.items()
    }
    cap = error_cap(scenario.name)
    return {
        "best": best.stem,
        "seconds": Agent.load(agent).training["seconds"],
        "errors": {name: [float(f"{x:.4g}") for x in capped(m, cap)] for name, m in ended.items()},
        "failed": {name: np.flatnonzero(has_failed(m, cap)).tolist() for name, m in ended.items()},
    }


def _stamp(vehicle: str, actions: str = "") -> str:
    storm = as_scenario(f"cruise-storm{SETPOINTS if actions else ''}@{vehicle}")
    policies, method = ((SETPOINT_EXPERT,), SETPOINT_METHOD) if actions else ((BASE_AGENT, "nmpc"), FINE_TUNING_METHOD)
    return " ".join(stamp(policy, [storm], _EPISODES, *recipe(method)) for policy in policies)


STUDY = Study(
    "fine-tuning",
    [*((vehicle,) for vehicle in VEHICLES), *((vehicle, _SETPOINTS) for vehicle in SETPOINT_VEHICLES)],
    _measure,
    _stamp,
)
main = STUDY.main


def fine_tuning_section() -> str:
    """Return the section of docs/fine-tuning.md with the results."""
    heads = [
        "vehicle", "better controller", f"`{BASE_AGENT}` / controller", "tuned / controller", "tuned / optimum",
        f"failures of {_EPISODES}: controller, `{BASE_AGENT}`, tuned, tuned with guard, optimum",
        "avoidable failures, tuned", "training [s]",
    ]  # fmt: skip
    rows = [row_of(vehicle, value) for (vehicle, *actions), value in STUDY.values().items() if not actions]
    return (
        f"{_EPISODES} held-out storms of each vehicle with a current of {_CURRENT[0]:g} to {_CURRENT[1]:g} m/s, "
        "one training seed. The *better controller* is `los-pid` or `nmpc` with gains that were searched for this "
        "vehicle and sea, chosen on the validation episodes of the search. Errors are means over the episodes in "
        f"which `{OPTIMUM_POLICY}` does not fail, failures at the error cap; intervals (95 %) are over episodes. A "
        "failure is *avoidable* if another policy of the table does not fail in this episode. The training ran in two "
        "processes, without the time of the comparison.\n\n"
        f"{table(heads, rows, right=False)}"
    )


def setpoints_section() -> str:
    """Return the section of docs/setpoints.md with the results."""
    values, rows = STUDY.values(), []
    for vehicle in SETPOINT_VEHICLES:
        value = values[vehicle, _SETPOINTS]
        guidance, agent = (np.array(value["errors"][name]) for name in (SETPOINT_EXPERT, TUNED_AGENT))
        ratio = with_interval(relative_error([guidance], [agent]))
        failures = ", ".join(str(len(value["failed"][name])) for name in (SETPOINT_EXPERT, TUNED_AGENT))
        errors = (f"{errors.mean():.3f}" for errors in (guidance, agent))
        rows.append([f"`{vehicle}`", *errors, ratio, failures, f"{value['seconds']:.0f}"])
    heads = ["vehicle", "guidance [m]", "agent [m]", "agent / guidance", "failures: guidance, agent", "training [s]"]
    return (
        f"{_EPISODES} held-out storms of each vehicle with a current of {_CURRENT[0]:g} to {_CURRENT[1]:g} m/s, one "
        f"training seed, by `auv-gym train --vehicle VEHICLE --scenario cruise{SETPOINTS}`: mean steady-state errors "
        "and their ratio with its 95 % interval over episodes. The guidance is `los-setpoints` with gains that were "
        "searched for this vehicle and sea. It has no memory, and the agent has Kalman filters and a preview of the "
        f"path.\n\n{table(heads, rows, right=False)}"
    )


def row_of(vehicle: str, value: dict[str, Any]) -> list[str]:
    """Return the row of the table about a vehicle from its recorded value."""
    failed = {name: set(episodes) for name, episodes in value["failed"].items()}
    errors = {name: np.delete(own, sorted(failed[OPTIMUM_POLICY])) for name, own in value["errors"].items()}
    best = value["best"]
    pairs = (best, BASE_AGENT), (best, TUNED_AGENT), (OPTIMUM_POLICY, TUNED_AGENT)
    ratios = [with_interval(relative_error([errors[rival]], [errors[own]])) for rival, own in pairs]
    counts = ", ".join(str(len(failed[name])) for name in (best, BASE_AGENT, TUNED_AGENT, GUARDED, OPTIMUM_POLICY))
    avoidable = failed[TUNED_AGENT] - set.intersection(*failed.values())
    return [f"`{vehicle}`", f"`{best}`", *ratios, counts, str(len(avoidable)), f"{value['seconds']:.0f}"]

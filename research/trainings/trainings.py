"""The trainings of the shipped agents and of the study that compares trainings, as options of `train.py`."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from auv_gym.scenarios.presets import CASES
from baselines.control.open_loop import NO_EXPERT
from baselines.evaluation.score import EXPERT
from baselines.tools.command_line import words_of
from baselines.training.command import PROGRAM, Options, checked_request, hyperparameter_words
from baselines.training.train import TrainingRequest
from baselines.tuning.objective import RATE_PRICE

UNNAMED = Options(algo="", scenario=())
"""Default options, without algorithm and scenario, which a command always contains."""


def training(
    algo: str,
    scenario: str,
    authority: tuple[float, ...] = (),
    expert: str | None = None,
    timesteps: int | None = None,
    changes: Mapping[str, Any] = MappingProxyType({}),
    from_: str | None = None,
) -> Options:
    """Return the options of a training.

    Args:
        algo: algorithm, see `Options`.
        scenario: words of the option `--scenario`, separated by blanks.
        authority: one number, or one each for surge and yaw; (), as None below: that of the hyper-parameters.
        expert: name of a policy.
        timesteps: number of control steps, summed over vehicles.
        changes: values of hyper-parameters that differ from the defaults, by name.
        from_: agent from which the training starts.
    """
    words = tuple(hyperparameter_words(changes))
    return Options(algo, tuple(scenario.split()), expert, authority, from_, timesteps=timesteps, set=words)


def request_of(training: Options, folder: Path, jobs: int = 1) -> TrainingRequest:
    """Return the request to start or resume a training in a folder. Several seeds have a subfolder each.

    Raises:
        UsageError: the folder contains something else.
    """
    command = f"python {PROGRAM} {shlex.join(words_of(training, UNNAMED))}"
    return checked_request(replace(training, out=folder, jobs=jobs, resume=True), command)


def weighted(speed_range: str, **weights: float) -> str:
    """Return the cases of a speed range, some with weights, in the format of `train.py --scenario`."""
    return " ".join(
        f"{speed_range}-{case}:{weights[case]:g}" if case in weights else f"{speed_range}-{case}" for case in CASES
    )


SPINS: Mapping[str, float] = {"actuator": 3, "storm": 2}
"""Weights of the cases for PPO, which makes fast vehicles with slow actuators spin."""
PPO_AUTHORITY: Mapping[str, tuple[float, float]] = {"slow": (0.6, 1.0), "cruise": (1.0, 0.6)}
"""Authority of PPO: a larger one makes fast vehicles with slow actuators spin."""
WIDE: Mapping[str, Any] = {"n_envs": 512, "n_steps": 64, "batch_size": 4096, "n_epochs": 4}
"""Changes for PPO that is trained until its score stops rising: larger batches, so less noise in each update."""
RELATIVE_ERRORS: Mapping[str, Any] = {
    "n_envs": 96,
    "n_steps": 100,
    "derivative_bound": 3,
    "final_share": 0.01,
    "error_exponent": 0.75,
}
"""Changes for the analytic gradient if the episodes differ much in difficulty: long windows; a low bound of
derivatives, because they are chaotic in some episodes; errors weighted mostly by their ratios, so that the largest do
not dominate."""
BOTH: Mapping[str, Any] = {
    "preview": [5, 10, 20, 40],
    "hidden_size": 128,
    "effort_weight": 0.02,
    "rate_weight": RATE_PRICE["slow"],
    "cruise_effort_weight": 0.0012,
    "cruise_rate_weight": RATE_PRICE["cruise"],
    "cruise_share": 0.4,
    "fine": True,
    "filters": True,
    "validations": 4,
}
"""Changes for agents for both speed ranges: finer inputs for small errors, filters, and commands as smooth as those of
`nmpc`."""
HELM: Mapping[str, Any] = {
    **BOTH,
    **RELATIVE_ERRORS,
    "groups": 2,
    "learning_rate": 0.002,
    "matrix_learning_rate": 0.013,
}
"""Changes for `helm`, which has no expert."""
SMALL_AGENT: Mapping[str, Any] = {**BOTH, "matrix_learning_rate": 0.02, "derivative_bound": 12, "hidden_size": 11}
"""Changes for `helm-small`, for a microcontroller: about 2,000 weights, shorter windows, errors without weighting."""
IN_SPACE: Mapping[str, Any] = {
    **RELATIVE_ERRORS,
    "preview": [5, 10, 20, 40],
    "hidden_size": 128,
    "effort_weight": 0.0012,
    "rate_weight": RATE_PRICE["space"],
    "fine": True,
    "filters": True,
    "learning_rate": 0.002,
    "matrix_learning_rate": 0.013,
    "validations": 4,
}
"""Changes for `helm-3d`, which corrects the law in space."""
ANY_VEHICLE: Mapping[str, Any] = {
    **RELATIVE_ERRORS,
    "groups": 2,
    "nominal_vehicle": True,
    "drawn_share": 0.67,
    "learning_rate": 0.001,
    "matrix_learning_rate": 0.006,
    "warm_up": 0.1,
    "validations": 4,
}
"""Changes for `helm-any`, which starts from `helm`: its inputs contain the vehicle model, and two thirds of the
training vehicles are random."""
SHIPPED_TRAININGS = {
    "helm": training("apg", "helm", (1.0,), NO_EXPERT, 38_000_000, {**HELM, "restart": 0.63}),
    "helm-any": training("apg", "helm", timesteps=80_000_000, changes=ANY_VEHICLE, from_="helm"),
    "helm-small": training("apg", "helm", (1.0, 1.6), None, 12_000_000, SMALL_AGENT),
    "helm-3d": training("apg", "space", (1.0,), None, 24_000_000, {**IN_SPACE, "restart": 0.63}),
    "ppo-cruise": training("ppo", weighted("cruise", **SPINS), PPO_AUTHORITY["cruise"], None, 6_000_000, WIDE),
    "ppo-slow": training("ppo", weighted("slow", **SPINS), PPO_AUTHORITY["slow"], None, 6_000_000, WIDE),
}
"""The trainings of the shipped agents, by name."""


class SeedTraining(NamedTuple):
    """A training of the study, with several seeds."""

    training: Options
    seeds: int
    suites: tuple[str, ...] = ("benchmark-v3",)  # frozen suites on which the agents run


def _ablation(expert: str = NO_EXPERT, **changes: Any) -> SeedTraining:
    """Return the training of `helm` in a sixth of the steps, with one part changed."""
    return SeedTraining(training("apg", "helm", (1.0,), expert, 6_000_000, {**HELM, **changes}), 1)


ABLATIONS: Mapping[str, tuple[str, SeedTraining]] = {
    "helm-short": ("nothing", _ablation()),
    "helm-without-filters": ("without the estimates of Kalman filters", _ablation(filters=False)),
    "helm-without-preview": ("without a preview of the path", _ablation(preview=[])),
    "helm-without-memory": ("without recurrent units", _ablation(memory=False)),
    "helm-with-expert": ("as a correction of `backstepping`", _ablation(EXPERT)),
}
"""Short trainings of `helm` with one part changed, and what is changed, by name."""
SEED_TRAININGS: Mapping[str, SeedTraining] = {
    "helm": SeedTraining(SHIPPED_TRAININGS["helm"], 5),
    "helm-any": SeedTraining(SHIPPED_TRAININGS["helm-any"], 3, ("benchmark-v3", "vehicles-v3")),
    "helm-3d": SeedTraining(SHIPPED_TRAININGS["helm-3d"], 3, ("space-v1",)),
    **{name: own for name, (_, own) in ABLATIONS.items()},
}
"""The trainings of the study, by name."""

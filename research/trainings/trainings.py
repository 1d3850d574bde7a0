"""The trainings of the shipped agents and of the study that compares trainings, as options of `train.py`."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from auv_gym.scenarios.mixtures import HARDEST
from auv_gym.scenarios.presets import CASES, SPEED_RANGES
from baselines.control.open_loop import NO_EXPERT
from baselines.tools.command_line import words_of
from baselines.training.command import PROGRAM, Options, checked_request, hyperparameter_words
from baselines.training.train import TrainingRequest

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


SLOW_AUTHORITY = (0.6, 1.6)
"""Authority in slow motion: the commands of the expert are large relative to the limits, and a correction must be able
to cancel them."""
SLOW_TRAINING: Mapping[str, Any] = {"effort_weight": 0.15}
"""Changes for the analytic gradient in slow motion, where currents and waves are strong relative to the limits."""
ERROR_ONLY: Mapping[str, Any] = {
    "preview": [5, 10, 20, 40],
    "hidden_size": 128,
    "matrix_learning_rate": 0.02,
    "effort_weight": 0.002,
    "rate_weight": 0.002,
}
"""Changes for the analytic gradient if only the error counts: a preview, a larger network, nearly free commands."""
_FREE: Mapping[str, Any] = {**ERROR_ONLY, "effort_weight": 0.0003, "rate_weight": 0.0003}
"""`ERROR_ONLY` at cruise, where smooth commands increase the error more."""
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
    "preview": ERROR_ONLY["preview"],
    "hidden_size": 128,
    "effort_weight": 0.02,
    "rate_weight": 0.0025,
    "cruise_effort_weight": 0.0012,
    "cruise_rate_weight": 0.0007,
    "cruise_share": 0.3,
    "fine": True,
    "filters": True,
    "validations": 1,
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
"""Changes for `helm`."""
SMALL_AGENT: Mapping[str, Any] = {**BOTH, "matrix_learning_rate": 0.02, "derivative_bound": 12, "hidden_size": 11}
"""Changes for `helm-small`, for a microcontroller: about 2,000 weights, shorter windows, errors without weighting."""
ANY_VEHICLE: Mapping[str, Any] = {
    **RELATIVE_ERRORS,
    "groups": 2,
    "nominal_vehicle": True,
    "drawn_share": 0.67,
    "learning_rate": 0.001,
    "matrix_learning_rate": 0.006,
    "warm_up": 0.1,
    "validations": 1,
}
"""Changes for the first training of `helm-any`, which starts from `helm`: its inputs contain the vehicle model, and two
thirds of the training vehicles are random."""
LONG_WINDOWS: Mapping[str, Any] = {
    **ANY_VEHICLE,
    "n_envs": 256,
    "n_steps": 200,
    "learning_rate": 0.0005,
    "matrix_learning_rate": 0.003,
    "warm_up": 0.05,
}
"""Changes for the second training of `helm-any`: longer windows, in which a vehicle with weak fins can return to its
path, of more vehicles at a time, since the small errors grow with noisier gradients."""
ANY_SCENARIOS = "helm slow-outages:3 cruise-outages:3"
"""Scenarios of `helm-any`: those of `helm`, and long outages of the position fix."""
FIRST_TRAININGS = {
    "helm-any-first": training("apg", ANY_SCENARIOS, timesteps=124_000_000, changes=ANY_VEHICLE, from_="helm"),
}
"""Trainings of agents that are not shipped, from which other trainings start, by name."""
SHIPPED_TRAININGS = {
    "helm": training("apg", "helm", (1.0, 1.6), None, 20_000_000, HELM),
    "helm-any": training("apg", ANY_SCENARIOS, timesteps=80_000_000, changes=LONG_WINDOWS, from_="helm-any-first"),
    "helm-small": training("apg", "helm", (1.0, 1.6), None, 12_000_000, SMALL_AGENT),
    "apg-cruise": training("apg", "cruise"),
    "apg-slow": training("apg", "slow", SLOW_AUTHORITY, changes=SLOW_TRAINING),
    "ppo-cruise": training("ppo", weighted("cruise", **SPINS), PPO_AUTHORITY["cruise"], None, 12_000_000, WIDE),
    "ppo-slow": training("ppo", weighted("slow", **SPINS), PPO_AUTHORITY["slow"], None, 12_000_000, WIDE),
}
"""The trainings of the shipped agents, by name."""


class SeedTraining(NamedTuple):
    """A training of the study, with several seeds."""

    training: Options
    seeds: int = 5
    suites: tuple[str, ...] = ("benchmark-v2",)  # frozen suites on which the agents run
    about: str = ""  # description of a short training for the results page

    def recorded_names(self, name: str) -> dict[str, str]:
        """Return the speed ranges in which agents run, by the name with which the results in each are recorded."""
        words = self.training.scenario
        trained = [r for r in SPEED_RANGES if any(word.startswith(r) for word in words)] or SPEED_RANGES
        return {name if len(trained) == 1 else f"{name}-{r}": r for r in trained}


def _short(about: str, expert: str | None = None, authority: tuple[float, ...] = (), **changes: Any) -> SeedTraining:
    return SeedTraining(training("apg", "cruise", authority, expert, 3_000_000, changes), seeds=2, about=about)


SHORT_TRAININGS: Mapping[str, SeedTraining] = {
    "short-cruise": _short("As `apg-cruise`, with fewer steps: the reference for the following trainings."),
    "short-preview": _short("A preview of the reference, 0.5, 1, 2 and 4 s ahead.", preview=ERROR_ONLY["preview"]),
    "short-no-memory": _short("Two tanh layers instead of the recurrent units.", memory=False),
    "short-no-integrals": _short("No integrals of the error as inputs.", integrals=False),
    "short-little-authority": _short("Half the authority.", authority=(0.3, 0.3)),
    "short-scratch": _short("Without an expert: the network gives the whole command.", NO_EXPERT, (1.0, 1.0)),
    "short-ekf": _short("The control law on an extended Kalman filter as the expert.", "ekf"),
    "short-free": _short("Nearly no cost of the commands.", effort_weight=0.002, rate_weight=0.001),
    "short-horizon": _short("Backpropagation through 10 steps (1 s) instead of 50.", n_steps=10),
    "short-adam": _short("Adam for all weights, also for the matrices.", matrix_learning_rate=0.0),
}
"""Trainings that differ from `short-cruise` in one setting each."""
_OF_ALL_VEHICLES = FIRST_TRAININGS | {"helm-any": SHIPPED_TRAININGS["helm-any"]}
_OTHERS = {name: SHIPPED_TRAININGS[name] for name in ("helm", "apg-cruise", "apg-slow")} | {
    "apg-preview-cruise": training("apg", weighted("cruise", **HARDEST), (1.0, 1.6), None, 16_000_000, _FREE),
    "apg-preview-slow": training("apg", weighted("slow", **HARDEST), SLOW_AUTHORITY, changes=ERROR_ONLY),
    "apg-adverse-cruise": training("apg", "cruise-adverse"),
    "apg-adverse-slow": training("apg", "slow-adverse", SLOW_AUTHORITY, changes=SLOW_TRAINING),
    "apg-scratch-cruise": training("apg", "cruise", (1.0, 1.0), NO_EXPERT),
    "apg-scratch-slow": training("apg", "slow", (1.0, 1.0), NO_EXPERT, changes=SLOW_TRAINING),
    "ppo-3m-cruise": training("ppo", weighted("cruise", **SPINS), PPO_AUTHORITY["cruise"]),
    "ppo-3m-slow": training("ppo", weighted("slow", **SPINS), PPO_AUTHORITY["slow"]),
    "sac-cruise": training("sac", "cruise"),
    "sac-slow": training("sac", "slow", (0.6, 1.0)),
    "td3-cruise": training("td3", "cruise"),
    "td3-slow": training("td3", "slow", (0.6, 0.6)),
}
SEED_TRAININGS: Mapping[str, SeedTraining] = {
    **{name: SeedTraining(t, 3, ("benchmark-v2", "vehicles-v2")) for name, t in _OF_ALL_VEHICLES.items()},
    **{name: SeedTraining(t) for name, t in _OTHERS.items()},
    **SHORT_TRAININGS,
}
"""The trainings of the study, by name."""

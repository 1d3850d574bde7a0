"""The trainings of the shipped agents by name, as options of `train.py`."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

from auv_gym.scenarios.mixtures import HARDEST
from auv_gym.scenarios.presets import CASES
from baselines.control.open_loop import NO_EXPERT
from baselines.tools.command_line import words_of
from baselines.training.hyperparameters import hyperparameter_words as changed_words
from baselines.training.options import PROGRAM, Options
from baselines.training.request import Request

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
    """Return the options of a training. Values that are None or empty are those of the algorithm's hyper-parameters.

    Args:
        algo: algorithm, see `Options`.
        scenario: words of the option `--scenario`, separated by blanks.
        authority: one number, or one each for surge and yaw.
        expert: name of a policy.
        timesteps: number of control steps, summed over vehicles.
        changes: values of hyper-parameters that differ from the defaults, by name.
        from_: agent from which the training starts.
    """
    words = tuple(changed_words(changes))
    return Options(algo, tuple(scenario.split()), expert, authority, from_, timesteps=timesteps, set=words)


def request_of(training: Options, folder: Path, jobs: int = 1) -> Request:
    """Return the request to start or resume a training in a folder. Several seeds have a subfolder each.

    Raises:
        UsageError: the folder contains something else.
    """
    words = words_of(training, UNNAMED)
    return Request.of(replace(training, out=folder, jobs=jobs, resume=True), f"python {PROGRAM} {shlex.join(words)}")


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
"""Authority of PPO, with or without memory: a larger one makes fast vehicles with slow actuators spin."""
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
_MEAN: Mapping[str, Any] = {**BOTH, "matrix_learning_rate": 0.02, "derivative_bound": 12}
"""Changes for the variants of `helm`: shorter windows, and errors without weighting."""
_SMALL: Mapping[str, Any] = {**_MEAN, "hidden_size": 11}
"""Changes for `helm-small`, for a microcontroller: about 2,000 weights."""
BLIND: Mapping[str, Any] = {**_MEAN, "preview": []}
"""Changes for `helm-blind`, without a preview of the reference."""
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
FIRST_TRAININGS: dict[str, Options] = {
    "helm-any-first": training("apg", ANY_SCENARIOS, timesteps=124_000_000, changes=ANY_VEHICLE, from_="helm"),
}
"""Trainings of agents that are not shipped, from which other trainings start, by name."""
SHIPPED_TRAININGS: dict[str, Options] = {
    "helm": training("apg", "helm", (1.0, 1.6), None, 20_000_000, HELM),
    "helm-any": training("apg", ANY_SCENARIOS, timesteps=80_000_000, changes=LONG_WINDOWS, from_="helm-any-first"),
    "helm-blind": training("apg", "helm", (1.0, 1.6), None, 12_000_000, BLIND),
    "helm-small": training("apg", "helm", (1.0, 1.6), None, 12_000_000, _SMALL),
    "apg-cruise": training("apg", "cruise"),
    "apg-slow": training("apg", "slow", SLOW_AUTHORITY, changes=SLOW_TRAINING),
    "apg-preview-cruise": training("apg", weighted("cruise", **HARDEST), (1.0, 1.6), None, 16_000_000, _FREE),
    "apg-preview-slow": training("apg", weighted("slow", **HARDEST), SLOW_AUTHORITY, changes=ERROR_ONLY),
    "apg-adverse-cruise": training("apg", "cruise-adverse"),
    "apg-adverse-slow": training("apg", "slow-adverse", SLOW_AUTHORITY, changes=SLOW_TRAINING),
    "apg-scratch-cruise": training("apg", "cruise", (1.0, 1.0), NO_EXPERT),
    "apg-scratch-slow": training("apg", "slow", (1.0, 1.0), NO_EXPERT, changes=SLOW_TRAINING),
    **{
        f"ppo-{speed_range}": training("ppo", weighted(speed_range, **SPINS), authority, None, 12_000_000, WIDE)
        for speed_range, authority in PPO_AUTHORITY.items()
    },
    "ppo-lstm-cruise": training("ppo_lstm", weighted("cruise", **SPINS), PPO_AUTHORITY["cruise"], None, 6_000_000),
    "ppo-lstm-slow": training("ppo_lstm", weighted("slow", **SPINS), PPO_AUTHORITY["slow"], None, 6_000_000),
    "sac-cruise": training("sac", "cruise"),
    "sac-slow": training("sac", "slow", (0.6, 1.0)),
    "td3-cruise": training("td3", "cruise"),
    "td3-slow": training("td3", "slow", (0.6, 0.6)),
}
"""The trainings of the shipped agents, by name."""

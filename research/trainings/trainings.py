"""Trainings by name: those of the agents that ship with the package, as `train.py` runs them."""

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
"""What the command of a training is without words: algorithm and scenario are always named."""


def training(
    algo: str,
    scenario: str,
    authority: tuple[float, ...] = (),
    expert: str | None = None,
    timesteps: int | None = None,
    changes: Mapping[str, Any] = MappingProxyType({}),
    from_: str | None = None,
) -> Options:
    """Return what an agent is trained on and how; what is None or empty is as the algorithm's hyper-parameters say.

    Args:
        algo: see `Options`, as all but the last.
        scenario: the words of the option, with blanks between them.
        authority: one number, or one each for surge and yaw.
        expert: a policy's name.
        timesteps: control steps, summed over vehicles.
        changes: of the hyper-parameters, by name.
        from_: an agent to begin with.
    """
    words = tuple(changed_words(changes))
    return Options(algo, tuple(scenario.split()), expert, authority, from_, timesteps=timesteps, set=words)


def request_of(training: Options, folder: Path, jobs: int = 1) -> Request:
    """Return a training in a folder, or in one of its folders for each seed, to begin or to go on with.

    Raises:
        UsageError: the folder holds something else.
    """
    words = words_of(training, UNNAMED)
    return Request.of(replace(training, out=folder, jobs=jobs, resume=True), f"python {PROGRAM} {shlex.join(words)}")


def weighted(speed_range: str, **weights: float) -> str:
    """Return a regime's cases, some of them with weights, as `train.py --scenario` takes them."""
    return " ".join(
        f"{speed_range}-{case}:{weights[case]:g}" if case in weights else f"{speed_range}-{case}" for case in CASES
    )


SLOW_AUTHORITY = (0.6, 1.6)
"""In slow motion the limits are small beside the law's own commands: a correction must be able to undo those."""
SLOW_TRAINING: Mapping[str, Any] = {"effort_weight": 0.15}
"""Of the analytic gradient in slow motion, where currents and waves are strong beside the limits."""
ERROR_ONLY: Mapping[str, Any] = {
    "preview": [5, 10, 20, 40],
    "hidden_size": 128,
    "matrix_learning_rate": 0.02,
    "effort_weight": 0.002,
    "rate_weight": 0.002,
}
"""Of the analytic gradient where nothing counts but the error: sight ahead, a larger network, cheap commands."""
_FREE: Mapping[str, Any] = {**ERROR_ONLY, "effort_weight": 0.0003, "rate_weight": 0.0003}
"""`ERROR_ONLY` at cruise, where calm commands cost more of the error."""
SPINS: Mapping[str, float] = {"actuator": 3, "storm": 2}
"""Weights of the cases for PPO: fast vehicles with slow actuators spin under it."""
PPO_AUTHORITY: Mapping[str, tuple[float, float]] = {"slow": (0.6, 1.0), "cruise": (1.0, 0.6)}
"""Of PPO, with memory or without: more lets fast vehicles with slow actuators spin."""
WIDE: Mapping[str, Any] = {"n_envs": 512, "n_steps": 64, "batch_size": 4096, "n_epochs": 4}
"""Of PPO where it is trained until its score has stopped to rise: less noise in each update."""
EVEN: Mapping[str, Any] = {"n_envs": 96, "n_steps": 100, "cut": 3, "final_share": 0.01, "evenness": 0.75}
"""Of the analytic gradient where vehicles are of very different difficulty: a long sight back, derivatives that are cut
soon, as that makes chaos of some, and errors that count mostly by their ratios, or the worst would drown all others."""
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
"""Of agents for both regimes: small errors seen as well as large ones, filters, and commands no rougher than those of
`nmpc`."""
HELM: Mapping[str, Any] = {**BOTH, **EVEN, "groups": 2, "learning_rate": 0.002, "matrix_learning_rate": 0.013}
"""Of the agent for both regimes."""
_MEAN: Mapping[str, Any] = {**BOTH, "matrix_learning_rate": 0.02, "cut": 12}
"""Of its kin: shorter windows, and errors count as they are."""
_SMALL: Mapping[str, Any] = {**_MEAN, "hidden_size": 11}
"""Of one for a microcontroller: about 2,000 weights."""
BLIND: Mapping[str, Any] = {**_MEAN, "preview": []}
"""Of one that is shown nothing of the reference ahead."""
ANY_HULL: Mapping[str, Any] = {
    **EVEN,
    "groups": 2,
    "hull": True,
    "hulls": 0.67,
    "hull_weight": 1.0,
    "learning_rate": 0.001,
    "matrix_learning_rate": 0.006,
    "warm_up": 0.1,
    "validations": 1,
}
"""Of the agent for every vehicle, which begins as `helm`: it is told the hull, which is drawn for two thirds of the
vehicles that it learns on."""
SHIPPED_TRAININGS: Mapping[str, Options] = {
    "helm": training("apg", "helm", (1.0, 1.6), None, 20_000_000, HELM),
    "helm-any": training("apg", "helm", timesteps=64_000_000, changes=ANY_HULL, from_="helm"),
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
"""The trainings of the agents that ship with the package, by their names."""

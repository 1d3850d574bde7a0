"""Trainings by name: those of the agents that ship with the package, as `train.py` runs them."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from auv_gym.presets import CASES
from baselines.control.open_loop import NO_EXPERT
from baselines.training.hyperparameters import words_of
from baselines.training.request import Request


@dataclass(frozen=True)
class Training:
    """What an agent is trained on and how; what is None or empty is as the algorithm's hyper-parameters say."""

    algo: str
    scenario: str  # what `train.py --scenario` takes, words apart
    authority: tuple[float, ...] = ()
    expert: str | None = None
    timesteps: int | None = None
    changes: Mapping[str, Any] = field(default_factory=dict)  # of the hyper-parameters

    def request(self, folder: Path, seeds: int = 1, jobs: int = 1, timesteps: int | None = None) -> Request:
        """Return the training in a folder, to begin or to go on with.

        Args:
            folder: of the run, or of the runs of several seeds.
            seeds: how many trainings, which differ in the seed alone.
            jobs: how many of them at the same time.
            timesteps: control steps, in place of the training's own.

        Raises:
            UsageError: the folder holds something else.
        """
        steps, changes = timesteps or self.timesteps, words_of(self.changes)
        words = [f"--algo {self.algo} --scenario {self.scenario}"]
        if changes:
            words.append(f"--set {shlex.join(changes)}")
        if self.expert:
            words.append(f"--expert {self.expert}")
        if self.authority:
            words.append(f"--authority {' '.join(map(str, self.authority))}")
        if steps:
            words.append(f"--timesteps {steps}")
        if seeds > 1:
            words.append(f"--seeds {seeds}")
        return Request.of(
            self.algo,
            self.scenario.split(),
            self.expert,
            self.authority,
            seeds=seeds,
            jobs=jobs,
            timesteps=steps,
            changes=changes,
            out=folder,
            resume=True,
            command=f"python train.py {' '.join(words)}",
        )


def weighted(regime: str, **weights: int) -> str:
    """Return a regime's cases, some of them with weights, as `train.py --scenario` takes them."""
    return " ".join(f"{regime}-{case}:{weights[case]}" if case in weights else f"{regime}-{case}" for case in CASES)


SLOW_AUTHORITY = (0.6, 1.6)
"""In slow motion the limits are small beside the law's own commands: a correction must be able to undo those."""
SLOW: Mapping[str, Any] = {"effort_weight": 0.15}
"""Of the analytic gradient in slow motion, where currents and waves are strong beside the limits."""
EXACT: Mapping[str, Any] = {
    "preview": [5, 10, 20, 40],
    "hidden_size": 128,
    "matrix_learning_rate": 0.02,
    "effort_weight": 0.002,
    "rate_weight": 0.002,
}
"""Of the analytic gradient where nothing counts but the error: sight ahead, a larger network, cheap commands."""
FREE: Mapping[str, Any] = {**EXACT, "effort_weight": 0.0003, "rate_weight": 0.0003}
"""The same at cruise, where calm commands cost more of the error."""
SPINS: Mapping[str, int] = {"actuator": 3, "storm": 2}
"""Weights of the cases for PPO: fast vehicles with slow actuators spin under it."""
HARDEST: Mapping[str, int] = {"noise": 2, "actuator": 4, "storm": 4}
"""Weights of the cases where commands cost next to nothing: what is left of the error, and what spins then."""
SHIPPED: Mapping[str, Training] = {
    "apg-cruise": Training("apg", "cruise"),
    "apg-slow": Training("apg", "slow", SLOW_AUTHORITY, changes=SLOW),
    "apg-preview-cruise": Training("apg", weighted("cruise", **HARDEST), (1.0, 1.6), None, 16_000_000, FREE),
    "apg-preview-slow": Training("apg", weighted("slow", **HARDEST), SLOW_AUTHORITY, changes=EXACT),
    "apg-adverse-cruise": Training("apg", "cruise-adverse"),
    "apg-adverse-slow": Training("apg", "slow-adverse", SLOW_AUTHORITY, changes=SLOW),
    "apg-scratch-cruise": Training("apg", "cruise", (1.0, 1.0), NO_EXPERT),
    "apg-scratch-slow": Training("apg", "slow", (1.0, 1.0), NO_EXPERT, changes=SLOW),
    "ppo-cruise": Training("ppo", weighted("cruise", **SPINS)),
    "ppo-slow": Training("ppo", weighted("slow", **SPINS), (0.6, 1.0)),
    "sac-cruise": Training("sac", "cruise"),
    "sac-slow": Training("sac", "slow", (0.6, 1.0)),
    "td3-cruise": Training("td3", "cruise"),
    "td3-slow": Training("td3", "slow", (0.6, 0.6)),
}
"""The trainings of the agents that ship with the package, by their names."""

"""PPO of Stable-Baselines3 with its own settings on the environments as registered: `python -m research registered`.

It gets the observations and rewards of the environment, without the features, the cost of the error and the validation
of `auv-gym train`. So its agents tell what the environment gives to a user who brings a learner of his own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecMonitor

from auv_gym.effects import Effect, FineReward
from auv_gym.scenarios.presets import CASES, PRESETS
from baselines.evaluation.report.terminal import run_and_show
from baselines.evaluation.suites import load_suite
from baselines.tools.command_line import DONE
from baselines.tools.workers import DEFAULT_JOBS, Workers
from baselines.training.sb3.vec_env import SB3VecEnv
from research.trainings.seed_runs import keep_seed_runs

RUNS = Path("runs/registered")
SUITE, RANGE, SEEDS, VEHICLES, STEPS = "benchmark-v2", "cruise", 5, 64, 3_000_000
TRAININGS: dict[str, tuple[str, tuple[Effect, ...]]] = {
    f"ppo-registered-{RANGE}": ("UnderactuatedAUVTrack-v0", ()),
    f"ppo-registered-residual-{RANGE}": ("UnderactuatedAUVTrackResidual-v0", ()),
    f"ppo-registered-residual-fine-{RANGE}": ("UnderactuatedAUVTrackResidual-v0", (FineReward(),)),
}
"""Id of the environment and effects of each training."""


def train(name: str, seed: int, steps: int, folder: Path) -> str:
    """Train one model, unless its file is there; return the file."""
    if (file := folder / f"{name}-{seed}.zip").exists():
        return str(file)
    env_id, effects = TRAININGS[name]
    cases = [replace(PRESETS[f"{RANGE}-{case}"], effects=effects) for case in CASES]
    made: Any = {"scenario": cases * (VEHICLES // len(cases)), "vectorization_mode": "vector_entry_point"}
    env = VecMonitor(SB3VecEnv(gym.make_vec(f"auv_gym:{env_id}", num_envs=VEHICLES, **made)))
    model = PPO("MlpPolicy", env, n_steps=128, batch_size=1024, device="cpu", seed=seed)
    model.learn(steps).save(file)
    return str(file)


def main(_: Sequence[str]) -> int:
    """Train, run and record all models; return the exit status."""
    workers, suite = Workers(DEFAULT_JOBS), load_suite(SUITE)
    RUNS.mkdir(parents=True, exist_ok=True)
    list(workers.results(train, [(name, seed, STEPS, RUNS) for name in TRAININGS for seed in range(SEEDS)]))
    for name in TRAININGS:
        models = [train(name, seed, STEPS, RUNS) for seed in range(SEEDS)]
        runs = run_and_show([(model, cell) for cell in suite.cells_in((RANGE,)) for model in models], workers)
        by_seed = [[run for run in runs if run.policy == model] for model in models]
        keep_seed_runs(suite, name, by_seed, "python -m research registered")
    return DONE

"""How fast learning goes: gradients through the simulation, an agent from nothing, and what others need of it."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import closing
from functools import partial
from pathlib import Path
from unittest import mock

import gymnasium as gym
import numpy as np
import torch

from auv_gym.codegen import native
from auv_gym.envs.torch_sim import TorchSimulator
from auv_gym.scenarios.mixtures import MIXTURES
from baselines.policies import make_policy
from baselines.training.apg.groups import Groups
from baselines.training.apg.settings import Settings, check
from baselines.training.apg.torch_network import torch_network, weights_of
from baselines.training.config import Config
from baselines.training.run_folder import PROGRESS, read_progress
from research.throughput.eager import Setting
from research.throughput.environments import EPISODE, NATIVE, RESIDUAL_ENV, track, vector_run
from research.throughput.figures import SCENARIO, Figure, faster, takes
from research.throughput.timing import TimedRun, cpu_time, interleaved, mean_time, timed, typical_time
from research.trainings.trainings import HELM

_WINDOW = 32  # control steps that a gradient goes back over
_GOOD = 0.95
"""Score on the validation episodes at which a training counts as done."""


def on_torch(n: int, steps: int, *, compiled: bool) -> TimedRun:
    """Return `environments.track` on torch."""
    expert = make_policy("backstepping-normalised")
    return vector_run(
        TorchSimulator(n, SCENARIO, compiled=compiled), lambda o: torch.from_numpy(expert.predict(o.numpy())[0]), steps
    )


def torch_cases(quick: bool) -> Iterator[Figure]:
    """The simulator on torch, in a quick run not compiled; the host draws its tapes and plans its paths."""
    n, steps, rounds = (64, _WINDOW, 1) if quick else (4096, EPISODE, 3)
    compiled, plain = interleaved(rounds, on_torch(n, steps, compiled=not quick), track(n, steps))
    yield faster(
        f"torch, N = {n}, {steps} steps with the host's tape, against ours on arrays",
        mean_time(compiled),
        mean_time(plain),
    )
    yield faster("  a step alone", typical_time(compiled), typical_time(plain))


def gradient_run(n: int, *, compiled: bool) -> TimedRun:
    """Return a gradient through the simulator with a network in the loop; the tape is read as it falls due.

    Each window begins a new batch of episodes, outside of what is timed: no vehicle is lost and nothing is planned.
    """
    env = TorchSimulator(n, SCENARIO, compiled=compiled)
    first, _ = env.reset(seed=0)
    torch.manual_seed(0)
    layers = torch.nn.Linear(first.shape[1], 64), torch.nn.Tanh(), torch.nn.Linear(64, 2), torch.nn.Tanh()
    network = torch.nn.Sequential(*layers)

    def run() -> list[float]:
        (observation, _), total, begin = env.reset(seed=0), torch.zeros(()), cpu_time()
        for _ in range(_WINDOW):
            observation, reward, *_ = env.step(network(observation))
            total = total + reward.mean()
        network.zero_grad()
        total.backward()  # type: ignore[no-untyped-call]
        return [(cpu_time() - begin) / (_WINDOW * n)]

    for _ in range(2):
        run()  # compiles
    return run


def gradient_cases(quick: bool) -> Iterator[Figure]:
    """A window of forward and backward steps of the public simulator, compiled (but in a quick run) against eager."""
    n = 16 if quick else 256
    runs = gradient_run(n, compiled=not quick), gradient_run(n, compiled=False)
    compiled, eager = interleaved(1 if quick else 9, *runs)
    case = f"gradient through {_WINDOW} steps of TorchSimulator, N = {n}, against eager"
    yield faster(case, typical_time(compiled), typical_time(eager))


def sb3_cases(quick: bool) -> Iterator[Figure]:
    """PPO on 64 residual environments: how much of its time the environment takes."""
    from stable_baselines3 import PPO

    from baselines.training.sb3.vec_env import SB3VecEnv

    n, steps = 64, 64 if quick else 320
    first, second = (SB3VecEnv(gym.make_vec(RESIDUAL_ENV, n, NATIVE, scenario=SCENARIO)) for _ in range(2))
    model = PPO("MlpPolicy", first, n_steps=64, batch_size=1024, seed=0, device="cpu")
    zero = np.zeros((n, 2), dtype=np.float32)
    second.reset()

    def alone() -> None:
        for _ in range(steps):
            second.step(zero)

    inside, all_of_it = interleaved(1, timed(alone, steps * n), timed(lambda: model.learn(steps * n), steps * n))
    yield Figure(f"the environment in PPO, N = {n}", typical_time(inside) / typical_time(all_of_it), "share")


def window_cases(quick: bool) -> Iterator[Figure]:
    """A window of the closed loop that trains, forward and back, by kernels and by eager torch; and its first build."""
    n, steps = (8, 5) if quick else (128, 50)
    names = ["cruise-storm"] * n

    def setting() -> Setting:
        return Setting(names, torch_network(Settings().network), steps=steps, precision="float32")

    mine, theirs = setting(), setting()

    def eager() -> None:
        theirs.by_torch().backward()  # type: ignore[no-untyped-call]

    mine.run()
    own, other = interleaved(1 if quick else 7, timed(mine.run, n * steps), timed(eager, n * steps))
    yield faster(
        f"training window, {n} vehicles, {steps} steps, against eager torch", typical_time(own), typical_time(other), 14
    )
    if native.wanted() and native.compiler():
        with tempfile.TemporaryDirectory() as cache, mock.patch.dict(os.environ, {native.CACHE: cache}):
            native.library.cache_clear()
            begin = cpu_time()
            setting().run()
            yield takes("  its kernels built for the first time", cpu_time() - begin, 3)


def group_cases(quick: bool) -> Iterator[Figure]:
    """A window of `helm`'s training in two groups, a process for each against one for both, by the time that passes."""
    sizes = {"n_envs": 32, "n_steps": 5} if quick else {}
    config = Config(scenarios=MIXTURES["helm"], hyperparameters={**HELM, **sizes})
    settings = check(config)
    weights = weights_of(torch_network(settings.network))
    with closing(Groups(config, settings, 2)) as apart, closing(Groups(config, settings)) as together:
        runs = [timed(partial(groups.learn, weights), clock=time.perf_counter) for groups in (apart, together)]
        for run in runs:
            run()  # waits for the other process
        two, one = interleaved(1 if quick else 25, *runs)
    case = f"training window, {settings.n_envs} vehicles, two processes against one, time that passes"
    yield faster(case, typical_time(two), typical_time(one))


def training_cases(quick: bool) -> Iterator[Figure]:
    """`python train.py` as a user runs it: processor time, start and validations included."""
    with tempfile.TemporaryDirectory() as out:
        command = [sys.executable, "-m", "baselines", "train", "--out", out]
        command += ["--timesteps", "6400"] if quick else []
        begin = cpu_time()
        subprocess.run(command, check=True, capture_output=True)
        seconds, rows = cpu_time() - begin, read_progress(next(Path(out).rglob(PROGRESS)).parent)
    yield takes("python train.py", seconds, None if quick else 60)
    if reached := [row["seconds"] for row in rows if row.get("score", 0.0) >= _GOOD]:
        case = f"  to a score of {_GOOD} on validation episodes, start included"
        yield takes(case, seconds - (rows[-1]["seconds"] - reached[0]), 45)

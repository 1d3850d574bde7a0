"""Measure the speed of the environments: `make bench`, or `python benchmarks/bench.py [--quick] [--out DIR]`.

Each case takes the CPU time of two or more things in turn, round after round, so that a busy machine slows all of them
alike; what counts are the medians' ratios. It prints a table and writes bench.json and bench.png.
"""

from __future__ import annotations

import argparse
import json
import logging
import os
import platform
import resource
import statistics
import subprocess
import sys
import time
import warnings
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch

import auv_gym
from auv_gym.dynamics import rk4_step
from auv_gym.envs.torch_sim import TENSORS, TorchSimulator
from auv_gym.simulation import Parameters
from auv_gym.task import SIZE
from baselines import make_policy

TRACK = "UnderactuatedAUVTrack-v0"
RESIDUAL = "UnderactuatedAUVTrackResidual-v0"
SCENARIO = "cruise-storm"  # every disturbance at once
EPISODE = auv_gym.PRESETS[SCENARIO].steps
BLOCK = 64  # control steps of tape that are read at once
Run = Callable[[], float]
"""Does some work and returns its CPU time [s] per unit."""


@dataclass
class Row:
    """One measured ratio."""

    case: str
    ours: float  # [s] a unit
    peer: float  # [s] a unit
    ratio: float  # peer / ours: how many times faster, or the share where the case says so
    unit: str


def cpu_time() -> float:
    """Return the CPU time [s] of this process and its children: other users of the machine count little in it."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def per_unit(work: Callable[[], Any], units: int) -> Run:
    """Return the run that does all of the work."""

    def run() -> float:
        begin = cpu_time()
        work()
        return (cpu_time() - begin) / units

    return run


def interleaved(rounds: int, *runs: Run) -> list[float]:
    """Return the median of each run, taken in turn."""
    times = [[run() for run in runs] for _ in range(rounds)]
    return [statistics.median(column) for column in zip(*times, strict=True)]


def scalar_run(env_id: str, steps: int, expert: bool = False, **options: Any) -> Run:
    """Return steps of a scalar environment, the expert's actions and the resets of ended episodes included."""
    env = gym.make(env_id, **options)
    policy = make_policy("backstepping") if expert else None
    observation, _ = env.reset(seed=0)
    action = np.zeros(env.action_space.shape, dtype=np.float32)

    def work() -> None:
        nonlocal observation
        for _ in range(steps):
            a = policy.predict(observation)[0] if policy else action
            observation, _, terminated, truncated, _ = env.step(a)
            if terminated or truncated:
                observation, _ = env.reset()

    return per_unit(work, steps)


def vector_run(env: Any, act: Callable[[Any], Any], steps: int) -> Run:
    """Return steps of a vector environment per vehicle, autoresets as they fall; the actor's time is left out."""
    observation, _ = env.reset(seed=0)

    def run() -> float:
        nonlocal observation
        total = 0.0
        for _ in range(steps):
            action = act(observation)
            begin = cpu_time()
            observation, *_ = env.step(action)
            total += cpu_time() - begin
        return total / (steps * env.num_envs)

    return run


def ours(n: int, steps: int) -> Run:
    """Return steps of our vector environment under an expert, so that no vehicle is lost."""
    expert = make_policy("backstepping-normalised")
    env = gym.make_vec(TRACK, n, "vector_entry_point", scenario=SCENARIO)
    return vector_run(env, lambda observation: expert.predict(observation)[0], steps)


def ours_on_torch(sim: TorchSimulator, steps: int) -> Run:
    """Return the same steps of the torch environment."""
    expert = make_policy("backstepping-normalised")
    return vector_run(sim, lambda observation: torch.from_numpy(expert.predict(observation.numpy())[0]), steps)


def peer(env_id: str, n: int, steps: int, mode: str) -> Run:
    """Return steps of one of Gymnasium's own environments."""
    env = gym.make_vec(env_id, n, mode)
    discrete = isinstance(env.single_action_space, gym.spaces.Discrete)
    action = np.zeros(n, dtype=int) if discrete else np.zeros((n, *env.single_action_space.shape), dtype=np.float32)
    return vector_run(env, lambda _: action, steps)


def scalar_cases(quick: bool) -> list[Row]:
    """Scalar environments against Pendulum-v1, both through gym.make; the reset's share of an episode."""
    steps, rounds = (100, 5) if quick else (EPISODE, 15)
    track, residual, pendulum = interleaved(
        rounds,
        scalar_run(TRACK, steps, expert=True, scenario=SCENARIO),
        scalar_run(RESIDUAL, steps, scenario=SCENARIO),
        scalar_run("Pendulum-v1", steps),
    )
    env = gym.make(TRACK, scenario=SCENARIO)

    (once,) = interleaved(3 * rounds, per_unit(env.reset, 1))
    return [
        Row("scalar, expert acting, vs Pendulum-v1", track, pendulum, pendulum / track, "step"),
        Row("scalar residual, zero action, vs Pendulum-v1", residual, pendulum, pendulum / residual, "step"),
        Row("share of the reset in a scalar episode", once, track * EPISODE, once / (track * EPISODE), "episode"),
    ]


def import_case(quick: bool) -> list[Row]:
    """Importing the package against importing what it needs, each in a fresh process."""

    def importing(modules: str) -> Run:
        return per_unit(lambda: subprocess.run([sys.executable, "-c", f"import {modules}"], check=True), 1)

    a, b = interleaved(3 if quick else 9, importing("auv_gym"), importing("gymnasium, numpy"))
    return [Row("import auv_gym vs import gymnasium, numpy", a, b, b / a, "import")]


def vector_cases(quick: bool) -> list[Row]:
    """NumPy vector environments against the peers Gymnasium ships: whole episodes of the expert, then steps alone."""
    rows = []
    rounds = 3 if quick else 7  # at most EPISODE // BLOCK, so that no episode ends in the runs without resets
    for n, name, mode in (
        (64, "Pendulum-v1", "sync"),
        (1024, "Pendulum-v1", "sync"),
        (64, "CartPole-v1", "vector_entry_point"),
    ):
        other = peer(name, n, max(5, 6400 // n), mode)
        whole, b = interleaved(max(3, rounds // 2), ours(n, EPISODE), other)
        rows.append(Row(f"NumPy, N={n}, tape and resets, vs {name} ({mode})", whole, b, b / whole, "vehicle step"))
        taped, b = interleaved(rounds, ours(n, BLOCK), other)
        rows.append(Row("  the same without resets", taped, b, b / taped, "vehicle step"))
        bare, b = interleaved(rounds * BLOCK // 8, ours(n, 8), other)
        rows.append(Row("  the same without tape and resets", bare, b, b / bare, "vehicle step"))
    return rows


def torch_cases(quick: bool) -> list[Row]:
    """The compiled step against NumPy and against the bare plant, at N = 4096; resets excluded."""
    n, steps, rounds = 4096, BLOCK, 3 if quick else 7
    sim = TorchSimulator(n, SCENARIO)
    sim_run, numpy_run = ours_on_torch(sim, steps), ours(n, steps)
    state, constants = sim.state, sim._constants
    action, sample = torch.zeros(2, n), sim._samples[0]

    def bare(state: torch.Tensor, load: torch.Tensor, constants: torch.Tensor) -> torch.Tensor:
        p = Parameters.of(constants.unbind(), False, 1)
        return torch.stack(rk4_step(state.unbind(), load.unbind(), p.coefficients, p.h, (0.0, 0.0), TENSORS))

    fused = torch.compile(bare, dynamic=True, fullgraph=True)

    def repeated(function: Callable[..., Any], *inputs: torch.Tensor) -> Run:
        @torch.no_grad()
        def work() -> None:
            for _ in range(steps):
                function(*inputs)

        work()
        return per_unit(work, steps * n)

    step = repeated(sim._step, state, action, sample, constants)
    plant = repeated(fused, state[:6].contiguous(), sample[10:13].contiguous(), constants)
    whole, numpy_, graph, only = interleaved(rounds, sim_run, numpy_run, step, plant)
    return [
        Row("torch environment, N=4096, vs NumPy", whole, numpy_, numpy_ / whole, "vehicle step"),
        Row("torch compiled step alone, N=4096, vs NumPy", graph, numpy_, numpy_ / graph, "vehicle step"),
        Row("torch compiled step alone vs its RK4 alone", graph, only, only / graph, "vehicle step"),
    ]


def gradient_case(quick: bool) -> list[Row]:
    """Forward and backward through 32 steps with a policy in the loop, compiled against eager, N = 256."""
    n, steps = 256, 32
    torch.manual_seed(0)
    policy = torch.nn.Sequential(
        torch.nn.Linear(SIZE, 64),
        torch.nn.Tanh(),
        torch.nn.Linear(64, 64),
        torch.nn.Tanh(),
        torch.nn.Linear(64, 2),
    )

    def training(compiled: bool) -> Run:
        sim = TorchSimulator(n, SCENARIO, compiled=compiled)
        sim.reset(seed=0)

        def work() -> None:
            observation, total = sim.detach(), torch.zeros(())
            for _ in range(steps):
                observation, reward, *_ = sim.step(policy(observation))
                total = total + reward.mean()
            policy.zero_grad()
            total.backward()

        work()
        return per_unit(work, steps * n)

    a, b = interleaved(3 if quick else 9, training(True), training(False))
    return [Row("gradients through 32 steps, N=256, vs eager", a, b, b / a, "vehicle step")]


def sb3_case(quick: bool) -> list[Row]:
    """PPO on 64 residual environments: how much of the wall-clock the environment takes."""
    from stable_baselines3 import PPO

    from baselines.training.sb3.vec_env import SB3VecEnv

    env = SB3VecEnv(gym.make_vec(RESIDUAL, 64, "vector_entry_point", scenario=SCENARIO))
    inside, wait = 0.0, env.step_wait

    def timed() -> Any:
        nonlocal inside
        begin = time.perf_counter()
        result = wait()
        inside += time.perf_counter() - begin
        return result

    env.step_wait = timed  # type: ignore[method-assign]
    steps = 64 * (64 if quick else 320)
    model = PPO("MlpPolicy", env, n_steps=64, batch_size=1024, seed=0, device="cpu")
    begin = time.perf_counter()
    model.learn(steps)
    total = time.perf_counter() - begin
    return [
        Row(
            "share of the environment in PPO's wall-clock, N=64",
            inside / steps,
            total / steps,
            inside / total,
            "vehicle step",
        )
    ]


def curve(quick: bool) -> dict[str, list[tuple[int, float]]]:
    """Return vehicle steps per second against N for our back ends and the peers; tape included, resets not."""
    sizes = (1, 16, 256) if quick else (1, 4, 16, 64, 256, 1024, 4096, 16384)
    makers: dict[str, tuple[int, Callable[[int, int], Run]]] = {
        "auv_gym, NumPy": (sizes[-1], ours),
        "auv_gym, torch": (sizes[-1], lambda n, k: ours_on_torch(TorchSimulator(n, SCENARIO), k)),
        "Pendulum-v1, SyncVectorEnv": (1024, lambda n, k: peer("Pendulum-v1", n, k, "sync")),
        "CartPole-v1, native": (sizes[-1], lambda n, k: peer("CartPole-v1", n, k, "vector_entry_point")),
    }
    return {
        label: [(n, 1 / interleaved(3, maker(n, max(4, min(64, 8192 // n))))[0]) for n in sizes if n <= largest]
        for label, (largest, maker) in makers.items()
    }


def plot(curves: dict[str, list[tuple[int, float]]], file: Path) -> None:
    """Draw the curves."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(7, 4.5), layout="constrained")
    for label, points in curves.items():
        axes.loglog(*zip(*points, strict=True), marker="o", label=label)
    axes.set(xlabel="sub-environments N", ylabel="vehicle steps per second")
    axes.grid(visible=True, which="both", alpha=0.3)
    axes.legend()
    figure.savefig(file, dpi=150)


CASES = (scalar_cases, import_case, vector_cases, torch_cases, gradient_case, sb3_case)


def main() -> None:
    """Run every case, print the table and write the files."""
    parser = argparse.ArgumentParser(description="Measure the speed of the environments.")
    parser.add_argument("--quick", action="store_true", help="fewer and shorter rounds")
    parser.add_argument("--out", type=Path, default=Path(), help="folder of bench.json and bench.png")
    options = parser.parse_args()
    logging.basicConfig(format="%(message)s")
    logging.getLogger("auv_gym").setLevel(logging.INFO)
    warnings.filterwarnings("ignore", module="gymnasium")
    torch.set_num_threads(1)
    print(f"{platform.processor() or platform.machine()}, {os.cpu_count()} cores; CPU time on one thread")
    print(f"scenario {SCENARIO}: every disturbance at once. ratio = peer / ours, or the share\n")
    print(f"{'case':<62} {'ours [us]':>10} {'peer [us]':>10} {'ratio':>7}  per")
    rows = []
    for case in CASES:
        for row in case(options.quick):
            rows.append(row)
            print(
                f"{row.case:<62} {1e6 * row.ours:>10.3f} {1e6 * row.peer:>10.3f} {row.ratio:>7.3f}  {row.unit}",
                flush=True,
            )
    curves = curve(options.quick)
    options.out.mkdir(parents=True, exist_ok=True)
    record = {"rows": [asdict(row) for row in rows], "steps_per_second": curves, "quick": options.quick}
    (options.out / "bench.json").write_text(json.dumps(record, indent=2) + "\n")
    plot(curves, options.out / "bench.png")
    print(f"\nwritten: {options.out / 'bench.json'}, {options.out / 'bench.png'}")


if __name__ == "__main__":
    main()

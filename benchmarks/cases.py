"""What is measured: our environments, and those that Gymnasium ships beside them."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
import torch

from auv_gym import PRESETS
from auv_gym.envs.torch_sim import TorchSimulator
from baselines import make_policy
from benchmarks.timing import Array, Run, cpu_time, interleaved, timed, typical, whole

TRACK = "auv_gym:UnderactuatedAUVTrack-v0"  # under a policy's own commands
RESIDUAL = "auv_gym:UnderactuatedAUVTrackResidual-v0"  # under corrections to the expert
NATIVE = "vector_entry_point"  # the mode of Gymnasium's `make_vec` in which an environment is its own vector
SCENARIO = "cruise-storm"  # every disturbance at once
EPISODE = PRESETS[SCENARIO].steps  # control steps of an episode
WINDOW = 32  # control steps that a gradient goes back over


@dataclass(frozen=True)
class Row:
    """One measured ratio."""

    case: str
    ours: float  # [s] a unit
    peer: float  # [s] a unit
    ratio: float  # how many times faster ours is; where the case is a share, ours / peer
    unit: str


def faster(case: str, ours: float, peer: float, unit: str = "vehicle step") -> Row:
    """Return the row of something that is compared with a peer."""
    return Row(case, ours, peer, peer / ours, unit)


def share(case: str, part: float, all_of_it: float, unit: str) -> Row:
    """Return the row of something that is a part of something else."""
    return Row(case, part, all_of_it, part / all_of_it, unit)


def scalar_run(env_id: str, expert: bool = False, **options: Any) -> Run:
    """Return an episode's number of steps of a scalar environment, the expert's actions and a reset included."""
    env = gym.make(env_id, **options)
    policy = make_policy("backstepping") if expert else None
    still = np.zeros(env.action_space.shape or (), dtype=np.float32)

    def work() -> None:
        observation, _ = env.reset(seed=0)
        for _ in range(EPISODE):
            observation, _, terminated, truncated, _ = env.step(policy.predict(observation)[0] if policy else still)
            if terminated or truncated:
                observation, _ = env.reset()

    return timed(work, EPISODE)


def vector_run(env: Any, act: Callable[[Any], Any], steps: int = EPISODE, staggered: bool = False) -> Run:
    """Return steps of a vector environment, a piece each, per vehicle; the actor's time is left out.

    Args:
        env: what is stepped; episodes that end begin anew.
        act: returns the actions for observations.
        steps: of a round.
        staggered: whether the vehicles' episodes end one after the other in place of all at once.
    """
    observation, _ = env.reset(seed=0)
    if staggered:
        phase = np.arange(env.num_envs) * EPISODE // env.num_envs
        for k in range(EPISODE):
            observation, *_ = env.step(act(observation))
            if (phase == k).any():
                observation, _ = env.reset(options={"reset_mask": phase == k})

    def run() -> list[float]:
        nonlocal observation
        times = []
        for _ in range(steps):
            action = act(observation)
            begin = cpu_time()
            observation, *_ = env.step(action)
            times.append((cpu_time() - begin) / env.num_envs)
        return times

    return run


def track(n: int, steps: int = EPISODE, staggered: bool = False) -> Run:
    """Return our vector environment on NumPy under an expert, so that no vehicle is lost."""
    expert = make_policy("backstepping-normalised")
    env = gym.make_vec(TRACK, n, NATIVE, scenario=SCENARIO)
    return vector_run(env, lambda observation: expert.predict(observation)[0], steps, staggered)


def residual(n: int) -> Run:
    """Return our residual vector environment on NumPy with zero corrections; its expert's time is a part of it."""
    env, zero = gym.make_vec(RESIDUAL, n, NATIVE, scenario=SCENARIO), np.zeros((n, 2), dtype=np.float32)
    return vector_run(env, lambda _: zero, EPISODE)


def on_torch(n: int, steps: int, compiled: bool) -> Run:
    """Return `track` on torch."""
    expert = make_policy("backstepping-normalised")
    return vector_run(
        TorchSimulator(n, SCENARIO, compiled=compiled), lambda o: torch.from_numpy(expert.predict(o.numpy())[0]), steps
    )


def peer(env_id: str, n: int, mode: str, steps: int) -> Run:
    """Return one of Gymnasium's own vector environments under an action that never changes."""
    env = gym.make_vec(env_id, n, mode)
    still = np.zeros_like(env.action_space.sample())
    return vector_run(env, lambda _: still, steps)


def import_case(quick: bool) -> Iterator[Row]:
    """Importing the package against importing what it needs, each in a fresh process."""

    def importing(modules: str) -> Run:
        return timed(lambda: subprocess.run([sys.executable, "-c", f"import {modules}"], check=True))

    own, needed = interleaved(1 if quick else 9, importing("auv_gym"), importing("gymnasium, numpy"))
    yield faster("import auv_gym vs import gymnasium, numpy", typical(own), typical(needed), "import")


def scalar_cases(quick: bool) -> Iterator[Row]:
    """Scalar environments, and how much of an episode its reset takes."""
    rounds, env = 1 if quick else 15, gym.make(TRACK, scenario=SCENARIO)
    own, corrected, pendulum, reset = map(
        whole,
        interleaved(
            rounds,
            scalar_run(TRACK, expert=True, scenario=SCENARIO),
            scalar_run(RESIDUAL, scenario=SCENARIO),
            scalar_run("Pendulum-v1"),
            timed(env.reset),
        ),
    )
    yield faster("scalar, the expert's actions included, vs Pendulum-v1", own, pendulum, "step")
    yield faster("scalar residual, zero action, vs Pendulum-v1", corrected, pendulum, "step")
    yield share("share of the reset in a scalar episode", reset, own * EPISODE, "episode")


def vector_cases(quick: bool) -> Iterator[Row]:
    """NumPy vector environments: whole episodes with tapes and resets, then a step that reads no tape and ends none."""
    rounds = 1 if quick else 5
    for n, name, mode in (
        (64, "Pendulum-v1", "sync"),
        (1024, "Pendulum-v1", "sync"),
        (64, "CartPole-v1", NATIVE),
    )[: 1 if quick else None]:
        runs = track(n), residual(n), track(n, staggered=True), peer(name, n, mode, max(5, 6400 // n))
        times: list[Array] = interleaved(rounds, *runs)
        other = whole(times[-1])
        yield faster(f"NumPy, N={n}, whole episodes, vs {name} ({mode})", whole(times[0]), other)
        yield faster("  the same, a step alone", typical(times[0]), other)
        yield faster("  residual, zero action, whole episodes", whole(times[1]), other)
        yield faster("  episodes that end one after the other", whole(times[2]), other)


def torch_cases(quick: bool) -> Iterator[Row]:
    """The compiled environment, in a quick run not compiled; the host draws its tapes and plans its paths."""
    n, steps, rounds = (64, WINDOW, 1) if quick else (4096, EPISODE, 3)
    compiled, plain = interleaved(rounds, on_torch(n, steps, not quick), track(n, steps))
    yield faster(f"torch, N={n}, {steps} steps with the host's tape, vs NumPy", whole(compiled), whole(plain))
    yield faster("  the same, a step alone", typical(compiled), typical(plain))


def gradient_run(n: int, compiled: bool) -> Run:
    """Return a gradient through the environment with a network in the loop; the tape is read as it falls due.

    Each window begins a new batch of episodes, outside of what is timed: no vehicle is lost and nothing is planned.
    """
    env = TorchSimulator(n, SCENARIO, compiled=compiled)
    first, _ = env.reset(seed=0)
    torch.manual_seed(0)
    layers = torch.nn.Linear(first.shape[1], 64), torch.nn.Tanh(), torch.nn.Linear(64, 2), torch.nn.Tanh()
    network = torch.nn.Sequential(*layers)

    def run() -> list[float]:
        (observation, _), total, begin = env.reset(seed=0), torch.zeros(()), cpu_time()
        for _ in range(WINDOW):
            observation, reward, *_ = env.step(network(observation))
            total = total + reward.mean()
        network.zero_grad()
        total.backward()  # type: ignore[no-untyped-call]
        return [(cpu_time() - begin) / (WINDOW * n)]

    for _ in range(2):
        run()  # compiles
    return run


def gradient_case(quick: bool) -> Iterator[Row]:
    """A window of forward and backward steps, compiled (but in a quick run) against eager."""
    n = 16 if quick else 256
    compiled, eager = interleaved(1 if quick else 9, gradient_run(n, not quick), gradient_run(n, False))
    case = f"gradient through {WINDOW} steps with the host's tape, N={n}, vs eager"
    yield faster(case, typical(compiled), typical(eager))


def sb3_case(quick: bool) -> Iterator[Row]:
    """PPO on 64 residual environments: how much of its time the environment takes."""
    from stable_baselines3 import PPO

    from baselines.training.sb3.vec_env import SB3VecEnv

    n, steps = 64, 64 if quick else 320
    first, second = (SB3VecEnv(gym.make_vec(RESIDUAL, n, NATIVE, scenario=SCENARIO)) for _ in range(2))
    model = PPO("MlpPolicy", first, n_steps=64, batch_size=1024, seed=0, device="cpu")
    zero = np.zeros((n, 2), dtype=np.float32)
    second.reset()

    def alone() -> None:
        for _ in range(steps):
            second.step(zero)

    inside, all_of_it = interleaved(1, timed(alone, steps * n), timed(lambda: model.learn(steps * n), steps * n))
    yield share(f"share of the environment in PPO, N={n}", typical(inside), typical(all_of_it), "vehicle step")


CASES = (import_case, scalar_cases, vector_cases, torch_cases, gradient_case, sb3_case)
"""What `make bench` runs, in this order."""


def curves(quick: bool) -> dict[str, list[tuple[int, float]]]:
    """Return vehicle steps per second against N, by what is stepped; tapes and resets are left out."""
    sizes = (1, 16, 64) if quick else (1, 4, 16, 64, 256, 1024, 4096, 16384)
    runs: dict[str, tuple[int, Callable[[int, int], Run]]] = {
        "auv_gym, NumPy": (sizes[-1], track),
        "auv_gym, torch": (sizes[-1], lambda n, k: on_torch(n, k, not quick)),
        "Pendulum-v1, SyncVectorEnv": (1024, lambda n, k: peer("Pendulum-v1", n, "sync", k)),
        "CartPole-v1, native": (sizes[-1], lambda n, k: peer("CartPole-v1", n, NATIVE, k)),
    }
    return {
        label: [(n, 1 / typical(interleaved(3, run(n, max(4, min(64, 8192 // n))))[0])) for n in sizes if n <= largest]
        for label, (largest, run) in runs.items()
    }

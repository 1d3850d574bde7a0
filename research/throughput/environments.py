"""How fast the environments are, beside those that Gymnasium ships."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from typing import Any

import gymnasium as gym
import numpy as np

from auv_gym import PRESETS
from auv_gym.scenarios.fitting import changed
from baselines.policies import make_policy
from research.throughput.figures import SCENARIO, Figure, faster, takes
from research.throughput.timing import TimedRun, cpu_time, interleaved, mean_time, timed, typical_time

TRACK = "auv_gym:UnderactuatedAUVTrack-v0"  # under a policy's own commands
RESIDUAL_ENV = "auv_gym:UnderactuatedAUVTrackResidual-v0"  # under corrections to the expert
NATIVE = "vector_entry_point"  # the mode of Gymnasium's `make_vec` in which an environment is its own vector
EPISODE = PRESETS[SCENARIO].steps  # control steps of an episode


def steps_run(env_id: str, steps: int, *, resets: bool, **options: Any) -> TimedRun:
    """Return up to that many steps of a scalar environment under an action that never changes, until the episode ends.

    With `resets` the reset in front of them counts as well.
    """
    env = gym.make(env_id, **options)
    still = np.zeros(env.action_space.shape or (), dtype=env.action_space.dtype)

    def run() -> list[float]:
        begin = cpu_time()
        env.reset()
        if not resets:
            begin = cpu_time()
        done = 0
        while done < steps:
            done += 1
            _, _, terminated, _, _ = env.step(still)
            if terminated:
                break
        return [(cpu_time() - begin) / done]

    env.reset(seed=0)
    return run


def vector_run(env: Any, act: Callable[[Any], Any], steps: int = EPISODE, *, staggered: bool = False) -> TimedRun:
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


def track(n: int, steps: int = EPISODE, *, staggered: bool = False) -> TimedRun:
    """Return our vector environment on NumPy under an expert, so that no vehicle is lost."""
    expert = make_policy("backstepping-normalised")
    env = gym.make_vec(TRACK, n, NATIVE, scenario=SCENARIO)
    return vector_run(env, lambda observation: expert.predict(observation)[0], steps, staggered=staggered)


def residual(n: int, *, staggered: bool = False) -> TimedRun:
    """Return our residual vector environment with zero corrections; its expert's time is a part of it."""
    env, zero = gym.make_vec(RESIDUAL_ENV, n, NATIVE, scenario=SCENARIO), np.zeros((n, 2), dtype=np.float32)
    return vector_run(env, lambda _: zero, EPISODE, staggered=staggered)


def peer(env_id: str, n: int, mode: str, steps: int) -> TimedRun:
    """Return one of Gymnasium's own vector environments under an action that never changes."""
    env = gym.make_vec(env_id, n, mode)
    still = np.zeros_like(env.action_space.sample())
    return vector_run(env, lambda _: still, steps)


def fresh_process(code: str) -> TimedRun:
    """Return the run of some Python in a process of its own."""
    return timed(lambda: subprocess.run([sys.executable, "-c", code], check=True))


def first_cases(quick: bool) -> Iterator[Figure]:
    """What a process pays before its first step."""
    rounds = 1 if quick else 9
    begun = f"import gymnasium as gym; gym.make({TRACK!r}, scenario={SCENARIO!r})"
    imports, needed, made = interleaved(
        rounds,
        fresh_process("import auv_gym"),
        fresh_process("import gymnasium, numpy"),
        fresh_process(begun),
    )
    yield faster("import auv_gym, against import gymnasium and numpy", typical_time(imports), typical_time(needed))
    yield takes("first gym.make of a process, everything imported", typical_time(made), 0.4)


def scalar_cases(quick: bool) -> Iterator[Figure]:
    """Scalar environments against Gymnasium's Pendulum, and the begin of an episode."""
    rounds, pendulum = 1 if quick else 15, 200  # steps of Pendulum's episodes
    own = {"scenario": SCENARIO}
    alone, plain, peer_alone, with_resets, peer_with_resets = interleaved(
        rounds,
        steps_run(RESIDUAL_ENV, EPISODE - 1, resets=False, **own),
        steps_run(TRACK, EPISODE - 1, resets=False, **own),
        steps_run("Pendulum-v1", pendulum - 1, resets=False),
        steps_run(RESIDUAL_ENV, EPISODE - 1, resets=True, **own),
        steps_run("Pendulum-v1", pendulum - 1, resets=True),
    )
    yield faster("scalar residual, steps alone, against Pendulum-v1", typical_time(alone), typical_time(peer_alone), 4)
    yield faster("scalar residual, with resets", typical_time(with_resets), typical_time(peer_with_resets), 2)
    yield faster("scalar, commands, steps alone", typical_time(plain), typical_time(peer_alone))
    env, rounds = gym.make_vec(TRACK, 64, NATIVE, scenario=SCENARIO), 3 if quick else 100
    env.reset(seed=0)
    for n, name, goal in ((1, "alone", 4e-4), (11, "eleven at once, a lane", 2e-4)):
        mask = np.arange(64) < n
        begins = interleaved(rounds, timed(lambda mask=mask: env.reset(options={"reset_mask": mask}), n))  # type: ignore[misc]
        yield takes(f"begin of an episode, {name}", typical_time(begins[0]), goal)


def vector_cases(quick: bool) -> Iterator[Figure]:
    """Vector environments: whole episodes with tapes and beginnings, then a step that reads no tape and ends none."""
    rounds = 1 if quick else 5
    for n, name, mode, goal in (
        (64, "Pendulum-v1", "sync", 10.0),
        (64, "CartPole-v1", NATIVE, 0.5),
        (1024, "Pendulum-v1", "sync", 25.0),
    )[: 1 if quick else None]:
        runs = track(n), residual(n), track(n, staggered=True), residual(n, staggered=True)
        *own, other = interleaved(rounds, *runs, peer(name, n, mode, max(5, 6400 // n)))
        against = f"N = {n} against {name}, {'native' if mode == NATIVE else 'SyncVectorEnv'}"
        yield faster(f"{against}, whole episodes", mean_time(own[0]), mean_time(other), goal)
        yield faster("  residual, the expert's time included", mean_time(own[1]), mean_time(other))
        yield faster("  episodes that end one after the other", mean_time(own[2]), mean_time(other))
        yield faster("  the same, residual", mean_time(own[3]), mean_time(other))
        between = np.delete(own[0], np.s_[EPISODE - 1 :: EPISODE], axis=1)  # where no episode ends
        yield faster("  step and tape, no ends", mean_time(between), mean_time(other), 50.0 if n > 64 else None)
        yield faster("  a step alone", typical_time(own[0]), mean_time(other))


def drawing_run(env_id: str, frames: int, **options: Any) -> TimedRun:
    """Return pictures of a scalar environment under an action that never changes; its steps are left out."""
    env = gym.make(env_id, render_mode="rgb_array", **options)
    still = np.zeros(env.action_space.shape or (), dtype=env.action_space.dtype)
    env.reset(seed=0)

    def run() -> list[float]:
        times = []
        for _ in range(frames):
            if any(env.step(still)[2:4]):
                env.reset()
            begin = cpu_time()
            env.render()
            times.append(cpu_time() - begin)
        return times

    return run


def drawing_cases(quick: bool) -> Iterator[Figure]:
    """A picture, as an array, beside one of Gymnasium's CartPole."""
    rounds, frames = (1, 5) if quick else (9, 60)
    small, large, peer_frames = interleaved(
        rounds,
        drawing_run(TRACK, frames, scenario=SCENARIO, render_size=(480, 360)),
        drawing_run(TRACK, frames, scenario=SCENARIO),
        drawing_run("CartPole-v1", frames),
    )
    yield takes("a frame of 480x360", typical_time(small), 5e-3)
    yield faster("  against CartPole-v1, 600x400", typical_time(small), typical_time(peer_frames))
    yield takes("  960x720", typical_time(large))


def scaling_cases(quick: bool) -> Iterator[Figure]:
    """Cost against the length of episodes, and the memory of many vehicles."""
    short, long = (changed(PRESETS[SCENARIO], control_dt=dt) for dt in (0.1, 0.02))
    runs = [steps_run(TRACK, s.steps - 1, resets=True, scenario=s) for s in (short, long)]
    brief, lengthy = interleaved(1 if quick else 9, *runs)
    yield faster("a step of an episode of 3,000 steps, against one of 600", typical_time(lengthy), typical_time(brief))
    n = 256 if quick else 16384
    code = (
        "import resource, gymnasium as gym, numpy as np\n"
        f"env = gym.make_vec({TRACK!r}, {n}, {NATIVE!r}, scenario={SCENARIO!r})\n"
        f"env.reset(seed=0)\nfor _ in range(3): env.step(np.zeros(({n}, 2)))\n"
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)"
    )
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    yield Figure(f"memory of a process with {n:,} vehicles", float(done.stdout), "MiB", 1024)

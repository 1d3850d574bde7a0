"""Ids of the presets, and vector environments in all autoreset modes, compared with those of Gymnasium."""

import subprocess
import sys

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers import vector as wrappers
from marks import slow_except

from auv_gym.scenarios.names import STEPS
from auv_gym.scenarios.presets import PRESETS
from baselines import make_policy

TASKS = ("auv_gym:UnderactuatedAUVTrack", "auv_gym:UnderactuatedAUVTrackResidual")
SHORT = [{**PRESETS[name].to_dict(), "steps": steps} for name, steps in (("cruise-storm", 7), ("slow-storm", 11))]
FAILED_START = {**PRESETS["cruise-storm"].to_dict(), "steps": 40, "lost_distance": 1.0}
MIXED = [*SHORT, FAILED_START]


def both(task, mode, backend="numpy", **options):
    """Return the vector environment, and that of Gymnasium around scalar environments."""
    native = gym.make_vec(
        f"{task}-v0",
        num_envs=len(MIXED),
        vectorization_mode="vector_entry_point",
        scenario=MIXED,
        autoreset_mode=mode,
        **({"backend": "torch", "dtype": "float64"} if backend == "torch" else {}),
        **options,
    )

    def maker(scenario):
        return lambda: gym.make(f"{task}-v0", scenario=scenario, **options)

    return native, SyncVectorEnv([maker(scenario) for scenario in MIXED], autoreset_mode=mode)


def as_array(value):
    return value.numpy() if isinstance(value, torch.Tensor) else np.asarray(value)


def assert_same(native, own):
    """Compare the results of `reset` or `step`: observation, reward, ends and info."""
    for a, b in zip(native[:-1], own[:-1], strict=True):
        np.testing.assert_allclose(as_array(a).astype(float), np.asarray(b, dtype=float), rtol=0, atol=1e-12)
    infos, own_infos = native[-1], own[-1]
    for key in ("position_error", "saturated", "time"):
        np.testing.assert_allclose(as_array(infos[key]).astype(float), own_infos[key].astype(float), rtol=0, atol=1e-12)
    assert ("final_obs" in infos) == ("final_obs" in own_infos)
    if "final_obs" in own_infos:
        for i in np.flatnonzero(own_infos["_final_obs"]):
            np.testing.assert_allclose(as_array(infos["final_obs"][i]), own_infos["final_obs"][i], rtol=0, atol=1e-12)


@pytest.mark.parametrize("mode", list(AutoresetMode))
@pytest.mark.parametrize(
    ("task", "backend", "options"),
    [
        (TASKS[0], "numpy", {}),
        (TASKS[1], "numpy", {"authority": 0.3}),
        (TASKS[1], "numpy", {"expert": "integral"}),  # an expert with memory
        pytest.param(TASKS[0], "torch", {}, marks=pytest.mark.slow),
        pytest.param(TASKS[1], "torch", {"authority": 0.3}, marks=pytest.mark.slow),
    ],
)
def test_equals_the_vector_environment_of_gymnasium_in_every_mode(task, backend, options, mode):
    native, own = both(task, mode, backend, **options)
    assert native.metadata["autoreset_mode"] is native.autoreset_mode is mode
    assert_same(native.reset(seed=5), own.reset(seed=5))
    rng, ends = np.random.default_rng(0), 0
    for _ in range(45):
        actions = rng.uniform(-1, 1, (len(MIXED), 2)).astype(np.float32)
        stepped = native.step(actions)
        assert_same(stepped, own.step(actions))
        over = (as_array(stepped[2]) | as_array(stepped[3])).astype(bool)
        ends += over.sum()
        if over.any() and mode is AutoresetMode.DISABLED:
            with pytest.raises(ResetNeeded, match=str(np.flatnonzero(over).tolist()[0])):
                native.step(actions)
            started, own_started = (env.reset(options={"reset_mask": over}) for env in (native, own))
            np.testing.assert_allclose(as_array(started[0]), own_started[0], rtol=0, atol=1e-12)
    assert ends >= 8


def test_modes_by_name_and_unknown_modes():
    env = gym.make_vec(f"{TASKS[0]}-v0", 2, "vector_entry_point", autoreset_mode="NextStep")
    assert env.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    assert type(env.unwrapped).metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    with pytest.raises(ValueError, match="unknown autoreset_mode 'Later'; allowed are 'NextStep'"):
        gym.make_vec(f"{TASKS[0]}-v0", 2, "vector_entry_point", autoreset_mode="Later")


@pytest.mark.parametrize(
    "wrap",
    [
        wrappers.RecordEpisodeStatistics,
        wrappers.NormalizeObservation,
        wrappers.NormalizeReward,
        lambda env: wrappers.RescaleObservation(env, -1.0, 1.0),
        lambda env: wrappers.ClipReward(env, 0.0, 0.5),
        wrappers.ClipAction,
    ],
)
def test_vector_wrappers_of_gymnasium(wrap):
    native, own = (wrap(env) for env in both(TASKS[0], AutoresetMode.NEXT_STEP))
    np.testing.assert_allclose(native.reset(seed=3)[0], own.reset(seed=3)[0], rtol=0, atol=1e-10)
    for _ in range(30):
        actions = np.full((len(MIXED), 2), 0.2, dtype=np.float32)
        for a, b in zip(native.step(actions)[:4], own.step(actions)[:4], strict=True):
            np.testing.assert_allclose(a, b, rtol=0, atol=1e-10)


def test_each_preset_has_an_id_with_its_length():
    assert {name: scenario.steps for name, scenario in PRESETS.items()} == STEPS
    for task in TASKS:
        for name, steps in STEPS.items():
            spec = gym.spec(f"{task}-{name}-v0".removeprefix("auv_gym:"))
            assert (spec.max_episode_steps, spec.kwargs) == (steps, {"scenario": name})
    env, same = gym.make(f"{TASKS[0]}-cruise-storm-v0"), gym.make(f"{TASKS[0]}-v0", scenario="cruise-storm")
    assert (env.reset(seed=4)[0] == same.reset(seed=4)[0]).all()
    assert env.spec.max_episode_steps == same.spec.max_episode_steps == 600
    expert = make_policy("backstepping")
    observation, ends = env.reset(seed=4)[0], []
    while not ends or not any(ends[-1]):
        observation, *_, terminated, truncated, _ = env.step(expert.predict(observation)[0])
        ends.append((terminated, truncated))
    assert (len(ends), ends[-1]) == (600, (False, True))


def test_an_id_of_a_preset_makes_vector_environments():
    options = {"num_envs": 2, "vectorization_mode": "vector_entry_point"}
    for task in TASKS:
        env, same = (
            gym.make_vec(f"{task}-slow-calm-v0", **options),
            gym.make_vec(f"{task}-v0", scenario="slow-calm", **options),
        )
        assert (env.reset(seed=4)[0] == same.reset(seed=4)[0]).all()
        assert env.spec.max_episode_steps == 600


@pytest.mark.parametrize("backend", slow_except(["numpy"], ["numpy", "torch"]))
def test_max_episode_steps_truncates_vector_environments(backend):
    env = gym.make_vec(f"{TASKS[0]}-slow-calm-v0", 2, "vector_entry_point", max_episode_steps=3, backend=backend)
    env.reset(seed=0)
    ends = [bool(env.step(np.zeros((2, 2), dtype=np.float32))[3].all()) for _ in range(6)]
    assert ends == [False, False, True] * 2
    with pytest.raises(ValueError, match="max_episode_steps is 0"):
        gym.make_vec(f"{TASKS[0]}-v0", 2, "vector_entry_point", max_episode_steps=0)


def test_ids_are_registered_once_without_import_of_scenarios():
    code = (
        "import importlib, sys, auv_gym; importlib.reload(auv_gym); print('auv_gym.scenarios.scenario' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"

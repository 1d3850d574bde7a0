"""What two environments that must do the same are compared by: resets, steps, ends of episodes, autoresets, info."""

import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from auv_gym.codegen import native
from baselines.control.backstepping import Backstepping

COMPILED = native.wanted() and native.compiler() is not None
TOLERANCE = 0.0 if COMPILED else 1e-9
"""Largest difference of two numbers: compiled code gives the same bits for one vehicle and for many."""


def together(envs, mode=AutoresetMode.SAME_STEP):
    """Return scalar environments as the vector environment of Gymnasium, each in its own observation space."""
    return SyncVectorEnv([lambda env=env: env for env in envs], autoreset_mode=mode, observation_mode="different")


def assert_close(value, other, tolerance):
    """Compare two arrays of numbers or truth values."""
    value, other = np.asarray(value, dtype=float), np.asarray(other, dtype=float)
    np.testing.assert_allclose(value, other, rtol=0, atol=tolerance)


def assert_same(results, others, tolerance=TOLERANCE, bounds=np.inf):
    """Compare what `reset` or `step` of two vector environments returns.

    The first ones' observations are clipped to the bounds, for a mixture of scenarios with different bounds.
    """
    *values, info = results
    *other_values, other_info = others
    assert_close(values[0].clip(-bounds, bounds), other_values[0], tolerance)
    for value, other in zip(values[1:], other_values[1:], strict=True):
        assert_close(value, other, tolerance)
    assert_same_info(info, other_info, tolerance)
    assert ("final_obs" in info) == ("final_obs" in other_info)
    if "final_obs" in info:
        over = np.flatnonzero(info["_final_obs"])
        assert over.tolist() == np.flatnonzero(other_info["_final_obs"]).tolist()
        limits = np.broadcast_to(bounds, values[0].shape)
        for i in over:
            assert_close(info["final_obs"][i].clip(-limits[i], limits[i]), other_info["final_obs"][i], tolerance)
        assert_same_info(info["final_info"], other_info["final_info"], tolerance)


def assert_same_info(info, other, tolerance):
    """Compare the entries of two infos that are valid."""
    for key in ("position_error", "saturated", "time"):
        valid = np.asarray(other[f"_{key}"])
        assert_close(info[f"_{key}"], valid, 0.0)
        assert_close(np.asarray(info[key])[valid], np.asarray(other[key])[valid], tolerance)


def assert_same_runs(env, other, steps, *, seed=10, scale=0.6, tolerance=TOLERANCE, attributes=()):
    """Compare two vector environments for the same seeds and actions; return the number of ended episodes.

    Attributes of `env` are compared with those of the scalar environments of the other one.
    """
    mode, rng, ends = env.metadata["autoreset_mode"], np.random.default_rng(0), 0
    assert env.unwrapped.autoreset_mode is mode is other.metadata["autoreset_mode"]
    results = env.reset(seed=seed)
    assert_same(results, other.reset(seed=seed), tolerance)
    for _ in range(steps):
        actions = rng.uniform(-scale, scale, (env.num_envs, 2)).astype(np.float32)
        results = env.step(actions)
        assert_same(results, other.step(actions), tolerance)
        assert env.observation_space.contains(results[0])
        for name in attributes:
            assert_close(getattr(env.unwrapped, name), [getattr(e.unwrapped, name) for e in other.envs], 1e-9)
        over = results[2] | results[3]
        ends += over.sum()
        if over.any() and mode is AutoresetMode.DISABLED:
            with pytest.raises(ResetNeeded, match=str(np.flatnonzero(over)[0])):
                env.step(actions)
            assert_same(*(e.reset(options={"reset_mask": over.copy()}) for e in (env, other)), tolerance)
    return ends


class WithMemory:
    """An expert with memory: the backstepping law plus a slow average of the position error."""

    def __init__(self):
        self.law = Backstepping()

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        rows = np.atleast_2d(observation)
        mean = np.zeros((len(rows), 2)) if state is None else np.where(episode_start[:, None], 0.0, state[0])
        mean = 0.9 * mean + 0.1 * rows[:, :2]
        action = np.clip(self.law.predict(rows)[0] - 0.05 * mean, -1, 1).astype(np.float32)
        return (action[0] if observation.ndim == 1 else action), (mean,)

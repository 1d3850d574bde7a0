"""Comparison of the vector environments, on arrays or tensors, with scalar environments."""

import numpy as np
import pytest


def assert_equals_scalars(env, scalars, steps, *, scale=0.6, seed=10, atol=1e-10, attributes=()):
    """Compare both for the same actions, also after autoresets; return the number of ended episodes.

    `attributes` of the environments are compared in each step, too.
    """
    observation, info = env.reset(seed=seed)
    converted = np.asarray
    if not isinstance(observation, np.ndarray):
        from torch import from_numpy as converted
    firsts = [scalar.reset(seed=seed + i) for i, scalar in enumerate(scalars)]
    np.testing.assert_allclose(np.asarray(observation), [first for first, _ in firsts], rtol=0, atol=0.01 * atol)
    rng, ends = np.random.default_rng(0), 0
    for _ in range(steps):
        actions = rng.uniform(-scale, scale, (len(scalars), 2)).astype(np.float32)
        observation, reward, terminated, truncated, info = env.step(converted(actions))
        assert env.observation_space.contains(np.asarray(observation))
        for i, scalar in enumerate(scalars):
            last, r, t, u, last_info = scalar.step(actions[i])
            assert (t, u) == (bool(terminated[i]), bool(truncated[i]))
            assert float(reward[i]) == pytest.approx(r, abs=atol)
            if t or u:
                ends += 1
                np.testing.assert_allclose(np.asarray(info["final_obs"][i]), last, rtol=0, atol=atol)
                for key, value in last_info.items():
                    assert np.asarray(info["final_info"][key])[i] == pytest.approx(value, abs=atol)
                last, last_info = scalar.reset()
            np.testing.assert_allclose(np.asarray(observation[i]), last, rtol=0, atol=atol)
            for key, value in last_info.items():
                assert np.asarray(info[key])[i] == pytest.approx(value, abs=atol)
        for name in attributes:
            own = [getattr(scalar.unwrapped, name) for scalar in scalars]
            np.testing.assert_allclose(getattr(env.unwrapped, name), own, rtol=0, atol=atol)
    return ends

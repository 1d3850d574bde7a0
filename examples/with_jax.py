"""JAX: a compiled policy acts in the vector environment, step by step and inside of `lax.scan`."""

from typing import Any

import gymnasium as gym
import jax
import jax.numpy as jnp
import numpy as np
from common import IDS, steps, works
from jax.experimental import io_callback

N = 64


def make(env_id: str) -> Any:
    """Return a vector environment of N vehicles."""
    return gym.make_vec(env_id, N, vectorization_mode="vector_entry_point")


def policy(weights: jax.Array, observations: jax.Array) -> jax.Array:
    """Return the actions of a linear policy, shape (N, 2)."""
    return jnp.tanh(observations @ weights)


def rollout(env: Any, weights: jax.Array, length: int) -> jax.Array:
    """Return the mean reward of each step, from one compiled function that calls the environment."""
    first, _ = env.reset(seed=0)
    like = jax.ShapeDtypeStruct(first.shape, jnp.float32), jax.ShapeDtypeStruct((N,), jnp.float32)

    def step(action: Any) -> Any:
        observation, reward, *_ = env.step(np.asarray(action))
        return observation.astype(np.float32), reward.astype(np.float32)

    def body(observation: jax.Array, _: None) -> Any:
        observation, reward = io_callback(step, like, policy(weights, observation), ordered=True)
        return observation, reward.mean()

    return jax.jit(lambda o: jax.lax.scan(body, o, length=length)[1])(jnp.asarray(first, jnp.float32))


if __name__ == "__main__":
    for env_id in IDS:
        env, length = make(env_id), steps(600, 60)
        observation, _ = env.reset(seed=0)
        weights, act = jnp.zeros((observation.shape[1], 2)), jax.jit(policy)
        rewards = []
        for _ in range(length):
            observation, reward, *_ = env.step(np.asarray(act(weights, observation)))
            rewards.append(reward.mean())
        np.testing.assert_allclose(rollout(env, weights, length), rewards, rtol=1e-5)
    works("a jitted policy in a loop and in lax.scan with io_callback, with equal rewards; both ids")

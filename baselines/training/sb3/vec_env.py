"""Adapter from the vector environment to `VecEnv` of Stable-Baselines3, which neither library provides."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from stable_baselines3.common.vec_env.base_vec_env import VecEnv, VecEnvIndices, VecEnvObs, VecEnvStepReturn


class SB3VecEnv(VecEnv):
    """A vector environment with SAME_STEP autoreset as a `VecEnv` of Stable-Baselines3.

    Use it instead of a `DummyVecEnv`; wrap it in `VecMonitor` for episode statistics. There are no objects of the
    sub-environments: attributes and methods are those of the vector environment, the same for each, except `scenario`.

    Args:
        env: a vector environment of this package, from `gym.make_vec(..., vectorization_mode="vector_entry_point")`.

    Raises:
        ValueError: it is no vector environment, or has another autoreset mode.
    """

    def __init__(self, env: gym.vector.VectorEnv[Any, Any, Any]) -> None:
        if not isinstance(env, gym.vector.VectorEnv):
            raise ValueError(f"{env} is not a vector environment; make one by gym.make_vec")
        mode = env.metadata.get("autoreset_mode")
        if mode != AutoresetMode.SAME_STEP:
            raise ValueError(
                f"the vector environment has autoreset mode {getattr(mode, 'name', mode)}; Stable-Baselines3 needs "
                "SAME_STEP: gym.make_vec(..., autoreset_mode='SameStep'), or with vectorization_mode='sync' "
                "vector_kwargs={'autoreset_mode': gym.vector.AutoresetMode.SAME_STEP}"
            )
        self.env = env
        self._actions: NDArray[Any] | None = None
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)

    def reset(self) -> VecEnvObs:
        """Reset all sub-environments with the seeds and options set since the last reset; return the observations."""
        options = self._options[0]
        if any(o != options for o in self._options):
            raise ValueError("the options differ between sub-environments; set the same for all")
        seeds = None if all(s is None for s in self._seeds) else self._seeds
        observation, info = self.env.reset(seed=seeds, options=options)  # type: ignore[arg-type]
        self.reset_infos = self._split(info)
        self._reset_seeds()
        self._reset_options()
        return np.asarray(observation)

    def step_async(self, actions: NDArray[Any]) -> None:
        """Store the actions for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        """Advance every sub-environment; return observations, rewards, dones and infos."""
        if self._actions is None:
            raise RuntimeError("step_wait without step_async")
        observation, reward, terminated, truncated, info = self.env.step(self._actions)
        self._actions = None
        done = terminated | truncated
        infos = self._split(info)
        for i in done.nonzero()[0].tolist():
            last = {key: value[i] for key, value in info["final_info"].items() if not key.startswith("_")}
            infos[i] = {**last, "terminal_observation": info["final_obs"][i]}
        for i, cut in enumerate((truncated & ~terminated).tolist()):
            infos[i]["TimeLimit.truncated"] = cut
        return np.asarray(observation), reward.astype(np.float32), done, infos

    def _split(self, info: dict[str, Any]) -> list[dict[str, Any]]:
        keys = [key for key in info if not key.startswith("_") and key not in ("final_obs", "final_info")]
        columns = [info[key].tolist() for key in keys]
        return [dict(zip(keys, row, strict=True)) for row in zip(*columns, strict=True)]

    def close(self) -> None:
        """Close the vector environment."""
        self.env.close()

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Return an attribute of the vector environment, once for each index, or the scenario of each."""
        base: Any = self.env.unwrapped
        if attr_name == "scenario":
            each = getattr(base, "scenarios", None) or base.get_attr(attr_name)  # of Gymnasium's `SyncVectorEnv`
            return [each[i] for i in self._get_indices(indices)]
        owner = self.env if hasattr(self.env, attr_name) else base
        return [getattr(owner, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Set an attribute of the vector environment; one value serves all sub-environments."""
        if len(list(self._get_indices(indices))) != self.num_envs:
            raise ValueError("an attribute can only be set for all sub-environments; leave out the indices")
        setattr(self.env if hasattr(self.env, attr_name) else self.env.unwrapped, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: VecEnvIndices = None, **kwargs: Any) -> list[Any]:
        """Call a method of the vector environment once; return its result for each index."""
        owner = self.env if hasattr(self.env, method_name) else self.env.unwrapped
        result = getattr(owner, method_name)(*args, **kwargs)
        return [result for _ in self._get_indices(indices)]

    def env_is_wrapped(
        self, wrapper_class: type[gym.Wrapper[Any, Any, Any, Any]], indices: VecEnvIndices = None
    ) -> list[bool]:
        """Return False for each index: there are no scalar environments that could be wrapped."""
        return [False for _ in self._get_indices(indices)]

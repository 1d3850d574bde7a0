"""Residual control on torch tensors: the action of an expert plus a bounded, differentiable correction."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from gymnasium.vector.utils import batch_space
from torch import Tensor

from auv_gym.envs.spaces import with_action
from auv_gym.envs.torch_sim import TENSORS, TorchSimulator
from auv_gym.envs.vector_api import VectorWrapper
from auv_gym.task.observation import SIZE, Observation, action_of, decode
from auv_gym.task.policy import Law, checked_authority, corrected


class TorchResidualAction(VectorWrapper[Tensor, Tensor, Tensor, Tensor, Tensor]):
    """`VectorResidualAction` on tensors, with gradients through the expert.

    Args:
        env: the simulator.
        expert: a control law that computes on tensors.
        authority: see `auv_gym.envs.residual.ResidualAction`.

    Raises:
        ValueError: the expert does not compute on tensors, or an authority is not in (0, 2].
    """

    env: TorchSimulator

    def __init__(self, env: TorchSimulator, expert: Law, authority: float | Sequence[float] = 0.5) -> None:
        super().__init__(env)
        if not hasattr(expert, "forces"):
            raise ValueError(
                f"expert {type(expert).__name__} does not compute on tensors; choose a backstepping policy, "
                "or backend='numpy'"
            )
        self.expert = expert
        self.autoreset_mode = env.autoreset_mode
        self.authority = torch.tensor(checked_authority(authority), dtype=env.dtype, device=env.device)
        self.single_observation_space = with_action(env.single_observation_space)
        self.observation_space = batch_space(self.single_observation_space, env.num_envs)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Tensor, dict[str, Any]]:
        """Start episodes; see `TorchSimulator.reset`."""
        observation, info = self.env.reset(seed=seed, options=options)
        observation, self._base = self._extended(observation)
        return observation, info

    def step(self, actions: Any) -> tuple[Tensor, Tensor, Tensor, Tensor, dict[str, Any]]:
        """Advance one control period with the expert's actions plus the corrections; see `TorchSimulator.step`."""
        command = corrected(self._base, self.authority, self.env.checked(actions), TENSORS)
        observation, reward, terminated, truncated, info = self.env.step(command)
        if "final_obs" in info:
            info["final_obs"], _ = self._extended(info["final_obs"])
        observation, self._base = self._extended(observation)
        return observation, reward, terminated, truncated, info

    def detach(self) -> Tensor:
        """Detach the graph of gradients and return the last observation; see `TorchSimulator.detach`."""
        observation, self._base = self._extended(self.env.detach())
        return observation

    def _extended(self, observation: Tensor) -> tuple[Tensor, Tensor]:
        """Return observations with the expert's actions appended, (N, columns + 2), and these actions (N, 2)."""
        o = Observation._make(decode(observation[:, :SIZE].unbind(dim=1), TENSORS))
        base = torch.stack(action_of(self.expert.forces(o, TENSORS), o, TENSORS), dim=1)
        base = base.to(torch.float32).to(observation.dtype)  # rounded as the actions of every policy
        return torch.cat((observation, base), dim=1), base

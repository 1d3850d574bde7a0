"""TorchRL: the scalar and the native vector environments in TorchRL's wrappers, and updates of PPO."""

import gymnasium as gym
import torch
from common import IDS, steps, works
from tensordict.nn import TensorDictModule
from tensordict.nn.distributions import NormalParamExtractor
from torch import nn
from torchrl.collectors import Collector
from torchrl.envs import GymEnv, GymWrapper, check_env_specs
from torchrl.modules import ProbabilisticActor, TanhNormal, ValueOperator
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE


def vector(env_id: str) -> GymWrapper:
    """Return the native vector environment without automatic reset, since TorchRL resets finished episodes."""
    env = gym.make_vec(env_id, num_envs=4, vectorization_mode="vector_entry_point", autoreset_mode="Disabled")
    return GymWrapper(env)


def learn(env: GymWrapper, frames: int) -> float:
    """Collect steps, make one update of PPO and return the mean reward."""
    size = env.observation_spec["observation"].shape[-1]
    net = nn.Sequential(nn.Linear(size, 16), nn.Tanh(), nn.Linear(16, 4), NormalParamExtractor())
    module = TensorDictModule(net.double(), in_keys=["observation"], out_keys=["loc", "scale"])
    actor = ProbabilisticActor(
        module,
        spec=env.action_spec,
        in_keys=["loc", "scale"],
        distribution_class=TanhNormal,
        distribution_kwargs={"low": -1.0, "high": 1.0},
        return_log_prob=True,
    )
    critic = ValueOperator(nn.Sequential(nn.Linear(size, 16), nn.Tanh(), nn.Linear(16, 1)).double(), ["observation"])
    loss = ClipPPOLoss(actor, critic)
    advantage = GAE(gamma=0.99, lmbda=0.95, value_network=critic)
    optimizer = torch.optim.Adam(loss.parameters(), 1e-3)
    collector = Collector(env, actor, frames_per_batch=frames, total_frames=frames)
    for batch in collector:
        advantage(batch)
        terms = loss(batch.reshape(-1))
        total = terms["loss_objective"] + terms["loss_critic"] + terms["loss_entropy"]
        optimizer.zero_grad()
        total.backward()
        optimizer.step()
        assert torch.isfinite(total)
        reward = float(batch["next", "reward"].mean())
    collector.shutdown(close_env=False)
    return reward


if __name__ == "__main__":
    torch.manual_seed(0)
    frames = steps(4800, 256)
    for env_id in IDS:
        scalar = GymEnv(env_id)
        check_env_specs(scalar)
        rollout = scalar.rollout(620)
        assert rollout["next", "done"][-1].all()
        assert 0 < learn(GymEnv(env_id), frames) <= 1
        assert -1 < learn(vector(env_id), frames) <= 1
    works("GymEnv; GymWrapper of the native vector environment (autoreset Disabled); PPO; both ids")

"""Residual control on tensors: compared with the NumPy environment, and gradients."""

import gymnasium as gym
import numpy as np
import pytest
import torch

from auv_gym.envs import torch_sim
from auv_gym.envs.torch_residual import TorchResidualAction
from auv_gym.envs.torch_sim import TorchSimulator
from auv_gym.task.observation import SIZE
from baselines import make_policy

RESIDUAL = "auv_gym:UnderactuatedAUVTrackResidual-v0"
SCENARIOS = ["paper-circle", "slow-noise", "cruise-storm", "cruise-actuator"]


def residual(n=4, scenario="cruise-storm", expert="backstepping", **options):
    simulator = TorchSimulator(n, scenario, dtype="float64", compiled=False)
    return TorchResidualAction(simulator, make_policy(expert), **options)


@pytest.mark.parametrize("expert", ["backstepping", "backstepping-normalised"])
def test_equals_numpy_across_autoresets(expert):
    env = residual(len(SCENARIOS), SCENARIOS, expert, authority=(0.2, 0.4))
    peer = gym.make_vec(
        RESIDUAL,
        len(SCENARIOS),
        vectorization_mode="vector_entry_point",
        scenario=SCENARIOS,
        expert=expert,
        authority=(0.2, 0.4),
    )
    rng = np.random.default_rng(0)
    (mine, _), (theirs, _) = env.reset(seed=3), peer.reset(seed=3)
    ends = 0
    for _ in range(650):
        np.testing.assert_allclose(mine.numpy(), theirs, atol=1e-6)  # the expert's action is in float32
        actions = rng.uniform(-1.5, 1.5, (len(SCENARIOS), 2)).astype(np.float32)
        mine, r1, d1, t1, i1 = env.step(torch.from_numpy(actions))
        theirs, r2, d2, t2, i2 = peer.step(actions)
        np.testing.assert_allclose(r1, r2, atol=1e-6)
        assert (d1.numpy() == d2).all()
        assert (t1.numpy() == t2).all()
        for i in (d2 | t2).nonzero()[0]:
            ends += 1
            np.testing.assert_allclose(i1["final_obs"][i], i2["final_obs"][i], atol=1e-6)
    assert ends


def test_gradients_flow_through_expert_and_correction():
    env = residual()
    env.reset(seed=0)
    actions = torch.zeros(4, 2, dtype=torch.float64, requires_grad=True)
    for _ in range(5):
        _, reward, *_ = env.step(actions)
    reward.sum().backward()
    assert torch.isfinite(actions.grad).all()
    assert (actions.grad != 0).all()
    assert not env.detach().requires_grad


def test_bad_input_is_refused():
    with pytest.raises(ValueError, match="expert Remembering does not compute on tensors"):
        residual(expert="ekf")
    env = residual()
    before = env.reset(seed=0)[0]
    for bad in (
        torch.zeros(3, 2),
        np.zeros((4, 2), dtype=str),
        torch.tensor([[0.0, 0.0], [0.0, torch.nan], [0.0, 0.0], [0.0, 0.0]]),
    ):
        with pytest.raises(ValueError, match=r"they must be a tensor or array of shape|action of sub-environment 1"):
            env.step(bad)
    assert (env.detach() == before).all()


def test_make_vec_with_backend_torch(monkeypatch):
    step_of = torch_sim.step_function
    monkeypatch.setattr(torch_sim, "step_function", lambda *of: step_of(*of[:-1], False))  # compilation takes long
    env = gym.make_vec(RESIDUAL, 2, vectorization_mode="vector_entry_point", backend="torch", dtype="float64")
    assert isinstance(env, TorchResidualAction)
    assert env.observation_space.shape == (2, SIZE + 2)

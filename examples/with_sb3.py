"""Stable-Baselines3 and sb3-contrib: all algorithms for continuous actions on both ids, VecNormalize, and scores."""

from pathlib import Path

import numpy as np
import sb3_contrib
import stable_baselines3
from common import IDS, RESIDUAL, TRACK, steady_error, steps, works
from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import VecNormalize

ON_POLICY = {"A2C": 8, "PPO": 64, "TRPO": 64, "RecurrentPPO": 64}
OFF_POLICY = ("DDPG", "TD3", "SAC", "TQC", "CrossQ")
SMALL = {"net_arch": [16]}


def train(name: str, env_id: str, folder: Path) -> Path:
    """Train with an algorithm and return the file of the model; statistics of VecNormalize are in the same folder."""
    algorithm = getattr(stable_baselines3, name, None) or getattr(sb3_contrib, name)
    env = make_vec_env(env_id, n_envs=2, seed=0)
    options = {"device": "cpu", "seed": 0, "policy_kwargs": SMALL}
    policy = "MlpLstmPolicy" if name == "RecurrentPPO" else "MlpPolicy"
    if name in ON_POLICY:
        env = VecNormalize(env)
        model = algorithm(policy, env, n_steps=ON_POLICY[name], **options)
    elif name == "ARS":
        model = algorithm("LinearPolicy", env, n_delta=1, n_eval_episodes=1, device="cpu", seed=0)
    else:
        model = algorithm(policy, env, learning_starts=16, batch_size=16, **options)
    model.learn(steps(20_000, 128))
    folder.mkdir(parents=True, exist_ok=True)
    model.save(folder / "model.zip")
    if isinstance(env, VecNormalize):
        env.save(str(folder / "vecnormalize.pkl"))
    observation = env.reset()
    action, _ = model.predict(observation, deterministic=True)
    assert action.shape == (2, 2)
    assert np.isfinite(action).all()
    assert np.isfinite(env.step(action)[1]).all()
    return folder / "model.zip"


if __name__ == "__main__":
    import gymnasium as gym
    from stable_baselines3.common.utils import set_random_seed

    set_random_seed(0)
    for env_id in IDS:
        check_env(gym.make(env_id).unwrapped)
    names = (*ON_POLICY, *OFF_POLICY, "ARS")
    models = {(n, e): train(n, e, Path(n, "residual" if e == RESIDUAL else "track")) for n in names for e in IDS}
    errors = [steady_error(str(models["PPO", RESIDUAL])), steady_error(str(models["SAC", TRACK]))]
    works(f"{', '.join(names)} on both ids; VecNormalize; evaluate.py scores what was saved ({len(errors)} models)")

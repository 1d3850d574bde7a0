"""Optuna: search for the authority and the learning rate of a residual agent, and for the best policy in a scenario."""

import gymnasium as gym
import numpy as np
import optuna
from common import RESIDUAL, steps, works
from stable_baselines3 import PPO
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor

from baselines import run_episodes


def learned(trial: optuna.Trial) -> float:
    """Return the return of an agent after a short training."""
    env = Monitor(gym.make(RESIDUAL, authority=trial.suggest_float("authority", 0.05, 0.5)))
    rate = trial.suggest_float("learning_rate", 1e-5, 1e-3, log=True)
    model = PPO("MlpPolicy", env, learning_rate=rate, n_steps=64, device="cpu", seed=0)
    model.learn(steps(10_000, 128))
    return float(evaluate_policy(model, env, n_eval_episodes=1)[0])


def chosen(trial: optuna.Trial) -> float:
    """Return the mean error [m] of a policy without learning."""
    policy = trial.suggest_categorical("policy", ["backstepping", "integral", "lqi"])
    return float(np.mean([r.errors.mean() for r in run_episodes(policy, "cruise-current", 2)]))


if __name__ == "__main__":
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    first = optuna.create_study(direction="maximize", sampler=optuna.samplers.TPESampler(seed=0))
    first.optimize(learned, n_trials=steps(20, 2))
    second = optuna.create_study(sampler=optuna.samplers.TPESampler(seed=0))
    second.optimize(chosen, n_trials=steps(10, 5))
    assert np.isfinite(first.best_value)
    assert second.best_value < 1.0
    works(f"studies over a residual training and over policies ({second.best_params['policy']} in cruise-current)")

"""What happens beside the learning of a Stable-Baselines3 model: validation, logging, checkpoints, the best agent."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger

from baselines.agents.agent import Agent
from baselines.training.run_folder import VALIDATIONS, Run, TrainingError
from baselines.training.sb3.export import exported
from baselines.training.sb3.snapshot import restore_exploration, snapshot
from baselines.training.validation import PRECISION

LARGEST_WEIGHT = 1e6  # beyond that, and where a weight is no number at all, training has diverged


class Tracker(BaseCallback):
    """Validates a model at the start, `VALIDATIONS` times a run and at the end; each time keeps a checkpoint.

    Args:
        run: where it is told.
        state: the checkpoint that the model has been put back to, if any.
    """

    def __init__(self, run: Run, state: Mapping[str, Any] | None = None) -> None:
        super().__init__()
        self.run = run
        self._agent: Agent | None = state["agent"] if state else None
        self._validated: int = state["timesteps"] if state else -1
        self._resumed = state

    @property
    def agent(self) -> Agent:
        """The agent that validated best."""
        assert self._agent is not None
        return self._agent

    def _init_callback(self) -> None:
        self.model.set_logger(Logger(None, []))

    def _on_training_start(self) -> None:
        if self._resumed is None:
            self._validate()
        else:  # the model has just begun its noise anew, and hands it to the first rollout before that starts
            vars(self.model)["action_noise"] = self._resumed["action_noise"]

    def _on_rollout_start(self) -> None:
        if self._resumed is not None:
            restore_exploration(self.model, self._resumed)
            self._resumed = None
        every = self.run.config.timesteps / VALIDATIONS
        if self.num_timesteps // every > self._validated // every:
            self._validate()
        else:
            self.run.report(self.num_timesteps)

    def _on_training_end(self) -> None:
        if self.num_timesteps > self._validated:
            self._validate()

    def _on_step(self) -> bool:
        return True

    def _validate(self) -> None:
        if not sound(self.model):
            raise TrainingError(f"training diverged after {self.num_timesteps} steps: lower learning_rate")
        self.run.log(self.num_timesteps, **self._learned())
        agent = exported(self.model.policy, self.run.config)
        policy = agent.policy(vehicle=self.run.config.vehicle, precision=PRECISION)
        if self.run.validate(policy, self.num_timesteps):
            self._agent = agent
        self._validated = self.num_timesteps
        self.run.save_checkpoint({**snapshot(self.model), "agent": self._agent})

    def _learned(self) -> dict[str, float]:
        """Return what the algorithm has logged since the last time, and the mean return of the latest episodes."""
        values = {k: float(v) for k, v in self.logger.name_to_value.items() if isinstance(v, (int, float, np.number))}
        self.logger.dump()
        if self.model.ep_info_buffer:
            values["return"] = float(np.mean([episode["r"] for episode in self.model.ep_info_buffer]))
        return values


def sound(model: BaseAlgorithm) -> bool:
    """Return whether all weights of a model are numbers that it can go on with."""
    return all(bool((p.abs() < LARGEST_WEIGHT).all()) for p in model.policy.parameters())

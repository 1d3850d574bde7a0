"""The simulation on torch tensors, for gradients through control steps.

`episodes` draws and plans episodes of N vehicles, `simulate` is a pure control step, so back-propagation through time
works directly:

    drawn = episodes([PRESETS["cruise-storm"]] * 256, steps=32, seed=0)
    state, observation, total = drawn.state, drawn.observation, 0.0
    for sample in drawn.samples:
        state, observation, reward, *_ = simulate(state, policy(observation), sample, drawn.parameters, drawn.parts)
        total = total + reward.mean()
    (-total).backward()
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from auv_gym.envs.sub_environments import SubEnvironments
from auv_gym.physics.namespaces import tensors
from auv_gym.scenarios.scenario import Scenario
from auv_gym.task import simulation
from auv_gym.task.simulation import Parts

TENSORS = tensors()
"""The namespace of tensors."""


class Episodes(NamedTuple):
    """The first states and the exogenous inputs of N episodes, in double precision."""

    state: Tensor  # rows of the `simulation.Plant` at the start, shape (`Parts.plant_rows`, N)
    observation: Tensor  # first observations, shape (SIZE, N)
    samples: (
        Tensor  # rows of the `simulation.Sample` at the end of each control step, shape (T, `Parts.sample_rows`, N)
    )
    parameters: Tensor  # rows of the `simulation.Parameters`, shape (`Parts.parameter_rows`, N)
    parts: Parts  # the parts of the simulation in use


class Transition(NamedTuple):
    """The results of a control step."""

    state: Tensor  # shape (`Parts.plant_rows`, N)
    observation: Tensor  # shape (SIZE, N)
    reward: Tensor  # shape (N,)
    failed: Tensor  # whether the distance to the reference exceeds `lost_distance`, shape (N,)
    squared_error: Tensor  # [m^2] of the position, shape (N,)
    saturated: Tensor  # whether an actuator was commanded to its limit, shape (N,)


def episodes(scenarios: Sequence[Scenario], steps: int, seed: int) -> Episodes:
    """Return one episode for each of N vehicles.

    Args:
        scenarios: the scenario of each vehicle, with equal `substeps`.
        steps: number T of control steps.
        seed: vehicle i has the first episode of an environment after a reset with `seed` + i.

    Raises:
        ValueError: an episode cannot be planned.
    """
    sub_envs = SubEnvironments(scenarios)
    started = sub_envs.reset(seed, None)
    samples = np.empty((steps, *sub_envs.sample.shape))
    for sample in samples:
        sample[:] = sub_envs.next_sample()
        sub_envs.advance()
    state, observation, inputs, parameters = map(
        torch.from_numpy, (started.plant, started.observation, samples, sub_envs.constants)
    )
    return Episodes(state, observation, inputs, parameters, sub_envs.parts)


def simulate(state: Tensor, action: Tensor, sample: Tensor, parameters: Tensor, parts: Parts) -> Transition:
    """Return the results of `simulation.step` for N vehicles, differentiable with respect to state and action.

    Args:
        state: the rows of a `simulation.Plant`, shape (`Parts.plant_rows`, N).
        action: surge and yaw command as fractions of the limits, shape (2, N).
        sample: the rows of a `simulation.Sample`, shape (`Parts.sample_rows`, N).
        parameters: the rows of `simulation.Parameters`, shape (`Parts.parameter_rows`, N).
        parts: the parts of the simulation in use.
    """
    plant, p = parts.plant(state.unbind()), parts.parameters(parameters.unbind())
    plant, terms, outcome = simulation.step(plant, action.unbind(), sample.unbind(), p, TENSORS)
    observation = parts.model.layout.encode(terms, TENSORS, parts.bound_factor)
    return Transition(torch.stack(simulation.plant_row(plant)), observation, *outcome)

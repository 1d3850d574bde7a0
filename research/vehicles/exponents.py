"""Fit the exponents with which gains follow the ratios of a vehicle: `python -m research gain-exponents NAME`.

A gain at cruise is that of the paper's vehicle times powers of `baselines.gains.loading.RATIOS`. The exponents minimise
the mean over random vehicles of the logarithm of the error. The vehicles are those that agents train on, so no
published vehicle is among them. The gradient is that of an evolution strategy (T. Salimans et al., "Evolution
strategies as a scalable alternative to reinforcement learning", arXiv:1703.03864, 2017): the logarithms of the gains of
each vehicle are changed at random, in both directions, on the same episodes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from tyro.conf import Positional, arg

from auv_gym.physics.namespaces import Array
from auv_gym.scenarios.presets import PRESETS
from baselines.gains.loading import load_gains, vehicle_ratios, write_gains
from baselines.tools.command_line import DONE, check_words, parse, typed
from baselines.tools.seeds import TUNING
from baselines.training.vehicle_models import SUBSTEPS, drawn_model
from baselines.tuning.objective import TUNABLES, Tunable, TuningEpisodes

PROGRAM = "python -m research gain-exponents"
_SPEED_RANGE = "cruise"
_SCENARIO = replace(PRESETS["cruise-storm"], substeps=SUBSTEPS)
"""Scenario whose paths a random vehicle must be able to follow."""
_EPISODES = 8  # of a vehicle in an evaluation, one in each case
_VEHICLES, _SETS = 64, 8  # random vehicles of a step, and their sets, which the steps use in turn
_STEPS = 100  # of the fit
_RATE = 0.03  # learning rate at the start; it decreases linearly to zero
_CHANGE = 0.2  # standard deviation of the changes of the logarithms
_DECAY = 0.03  # weight decay
_STEEPEST = 3.0  # bound of a vehicle's slope, so that one that fails does not count too much
_CHECK = (64, 100)  # number of vehicles, and index of the set, on which exponents are compared with none


@dataclass(frozen=True)
class Options:
    """Fit the exponents of a controller's gains and write them to baselines/gains/gains.json. It takes hours.

    Exit status: 0 done, 2 wrong usage.
    """

    name: Annotated[Positional[str], arg(metavar="NAME")]
    """Name of the controller."""


class RandomVehicles:
    """A set of random vehicles with episodes.

    Attributes:
        ratios: of the vehicles, see `vehicle_ratios`, shape (vehicles, 2 len(RATIOS)).
    """

    def __init__(self, number: int, index: int) -> None:
        """Draw a number of vehicles; sets of another index have other vehicles and episodes."""
        rng = np.random.default_rng([TUNING.first, index])
        self._models = [drawn_model(_SCENARIO, rng)[0] for _ in range(number)]
        self.ratios = np.array([vehicle_ratios(model) for model in self._models])
        first = TUNING.first + index * number * _EPISODES
        self._episodes = [
            TuningEpisodes(_SPEED_RANGE, _EPISODES, first + i * _EPISODES, vehicle_model=model)
            for i, model in enumerate(self._models)
        ]

    def losses(self, tunable: Tunable, start: Mapping[str, float], changes: Array) -> Array:
        """Return the logarithm of each vehicle's error, for changes (vehicles, gains) of the logarithms of gains."""
        losses = []
        for model, episodes, factors in zip(self._models, self._episodes, np.exp(changes).tolist(), strict=True):
            gains = {name: gain * factor for (name, gain), factor in zip(start.items(), factors, strict=True)}
            losses.append(np.log(episodes.run(tunable.factory(gains, vehicle=model.vehicle)).error_m))
        return np.array(losses)


def fitted_exponents(name: str, steps: int, sets: Sequence[RandomVehicles]) -> NDArray[np.float64]:
    """Return the exponents of a controller's gains, shape (gains, 2 len(RATIOS)).

    Args:
        name: of the controller.
        steps: of the optimiser Adam (D. P. Kingma and J. Ba, arXiv:1412.6980, 2015).
        sets: random vehicles, which the steps use in turn.
    """
    import torch

    tunable, rng = TUNABLES[name], np.random.default_rng(0)
    start = load_gains(name, _SPEED_RANGE, tunable.names)
    exponents = torch.zeros((sets[0].ratios.shape[1], len(start)), dtype=torch.float64, requires_grad=True)
    optimiser = torch.optim.Adam([exponents], lr=_RATE, weight_decay=_DECAY)
    schedule = torch.optim.lr_scheduler.LinearLR(optimiser, 1.0, 0.0, steps)
    for step in range(steps):
        vehicles = sets[step % len(sets)]
        changes = vehicles.ratios @ exponents.detach().numpy()
        tried = rng.standard_normal(changes.shape)
        up, down = (vehicles.losses(tunable, start, changes + side * _CHANGE * tried) for side in (1.0, -1.0))
        slopes = np.clip((up - down) / (2 * _CHANGE), -_STEEPEST, _STEEPEST)
        exponents.grad = torch.from_numpy(vehicles.ratios.T @ (slopes[:, None] * tried) / len(slopes))
        optimiser.step()
        schedule.step()
        print(f"{step + 1:4d} of {steps}  mean logarithm of the error {np.mean(up + down) / 2:.3f}", flush=True)
    return np.asarray(exponents.detach().numpy().T)


def error_ratios(name: str, exponents: Array, vehicles: RandomVehicles) -> dict[str, float]:
    """Return how the errors with exponents, shape (gains, 2 len(RATIOS)), compare with those without any.

    Returns:
        `ratio`, the geometric mean over the vehicles of the ratio of the errors, the `largest` ratio, and `worse`, the
        share of vehicles whose error grows by more than 2 %.
    """
    tunable = TUNABLES[name]
    start, changes = load_gains(name, _SPEED_RANGE, tunable.names), vehicles.ratios @ exponents.T
    growth = vehicles.losses(tunable, start, changes) - vehicles.losses(tunable, start, 0.0 * changes)
    values = {"ratio": np.exp(growth.mean()), "largest": np.exp(growth.max()), "worse": np.mean(growth > np.log(1.02))}
    return {"vehicles": len(growth), **{key: round(float(value), 3) for key, value in values.items()}}


def main(arguments: Sequence[str]) -> int:
    """Fit the exponents, record them, and return the exit status."""
    options = parse(Options, arguments, PROGRAM)
    check_words("controller", [options.name], TUNABLES)
    sets = [RandomVehicles(_VEHICLES, index) for index in range(_SETS)]
    exponents = fitted_exponents(options.name, _STEPS, sets).round(3)
    entry = {
        "command": typed(PROGRAM, arguments),
        "check": error_ratios(options.name, exponents, RandomVehicles(*_CHECK)),
        "exponents": dict(zip(TUNABLES[options.name].names, exponents.tolist(), strict=True)),
    }
    write_gains("exponents", options.name, entry)
    return DONE

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
from auv_gym.scenarios.vehicles import VehicleModel
from baselines.gains.loading import EXPONENTS, load_gains, vehicle_ratios
from baselines.tools.command_line import DONE, UsageError, check_words, parse, typed
from baselines.tools.files import json_text, read_json, write_atomically
from baselines.tools.seeds import TUNING
from baselines.training.vehicle_models import SUBSTEPS, drawn_model
from baselines.tuning.objective import TuningEpisodes
from baselines.tuning.tunables import TUNABLES, Tunable

PROGRAM = "python -m research gain-exponents"
_SPEED_RANGE = "cruise"
_SCENARIO = replace(PRESETS["cruise-storm"], substeps=SUBSTEPS)
"""Scenario whose paths a random vehicle must be able to follow."""
_EPISODES = 8  # of a vehicle in an evaluation, one in each case
_CHANGE = 0.2  # standard deviation of the changes of the logarithms
_DECAY = 0.03  # weight decay
_STEEPEST = 3.0  # bound of a vehicle's slope, so that one that fails does not count too much
_CHECK = (64, 100)  # number of vehicles, and index of the set, on which exponents are compared with none


@dataclass(frozen=True)
class Options:
    """Fit the exponents of a controller's gains and write them to baselines/gains/exponents.json. It takes hours.

    Exit status: 0 done, 2 wrong usage.
    """

    name: Annotated[Positional[str], arg(metavar="NAME")]
    """Name of the controller."""
    steps: int = 100
    """Steps of the fit."""
    vehicles: int = 64
    """Random vehicles of a step."""
    sets: int = 8
    """Sets of vehicles, which the steps use in turn."""
    rate: float = 0.03
    """Learning rate at the start; it decreases linearly to zero."""


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
        each = zip(self._models, self._episodes, np.exp(changes), strict=True)
        return np.array([_loss(tunable, start, model, episodes, factors) for model, episodes, factors in each])


def _loss(
    tunable: Tunable, start: Mapping[str, float], model: VehicleModel, episodes: TuningEpisodes, factors: Array
) -> float:
    gains = {name: gain * factor for (name, gain), factor in zip(start.items(), factors.tolist(), strict=True)}
    return float(np.log(episodes.run(tunable.factory(gains, vehicle=model.vehicle)).error_m))


def fitted(name: str, steps: int, sets: Sequence[RandomVehicles], rate: float) -> NDArray[np.float64]:
    """Return the exponents of a controller's gains, shape (gains, 2 len(RATIOS)).

    Args:
        name: of the controller.
        steps: of the optimiser Adam (D. P. Kingma and J. Ba, arXiv:1412.6980, 2015).
        sets: random vehicles, which the steps use in turn.
        rate: learning rate at the start; it decreases linearly to zero.
    """
    import torch

    tunable, rng = TUNABLES[name], np.random.default_rng(0)
    start = load_gains(name, _SPEED_RANGE, tunable.names)
    exponents = torch.zeros((sets[0].ratios.shape[1], len(start)), dtype=torch.float64, requires_grad=True)
    optimiser = torch.optim.Adam([exponents], lr=rate, weight_decay=_DECAY)
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


def checked(name: str, exponents: Array, vehicles: RandomVehicles) -> dict[str, float]:
    """Return how the errors with exponents, shape (gains, 2 len(RATIOS)), compare with those without any.

    Returns:
        `ratio`, the geometric mean over the vehicles of the ratio of the errors, the `largest` ratio, and `worse`, the
        share of vehicles whose error grows by more than 2 %.
    """
    tunable = TUNABLES[name]
    start, changes = load_gains(name, _SPEED_RANGE, tunable.names), vehicles.ratios @ exponents.T
    growth = vehicles.losses(tunable, start, changes) - vehicles.losses(tunable, start, 0.0 * changes)
    found = {"ratio": np.exp(growth.mean()), "largest": np.exp(growth.max()), "worse": np.mean(growth > np.log(1.02))}
    return {"vehicles": len(growth), **{key: round(float(value), 3) for key, value in found.items()}}


def main(arguments: Sequence[str]) -> int:
    """Fit the exponents, record them, and return the exit status.

    Raises:
        UsageError: the arguments are invalid.
    """
    options = parse(Options, arguments, PROGRAM)
    check_words("controller", [options.name], TUNABLES)
    for word in ("steps", "vehicles", "sets"):
        if getattr(options, word) < 1:
            raise UsageError(f"--{word} is {getattr(options, word)}; it must be at least 1")
    if not 0 < options.rate <= 1:
        raise UsageError(f"--rate is {options.rate}; it must be in (0, 1]")
    sets = [RandomVehicles(options.vehicles, index) for index in range(options.sets)]
    exponents = fitted(options.name, options.steps, sets, options.rate).round(3)
    entry = {
        "command": typed(PROGRAM, arguments),
        "check": checked(options.name, exponents, RandomVehicles(*_CHECK)),
        "exponents": dict(zip(TUNABLES[options.name].names, exponents.tolist(), strict=True)),
    }
    write_atomically(EXPONENTS, json_text(read_json(EXPONENTS) | {options.name: entry}))
    return DONE

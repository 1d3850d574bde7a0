"""Whether what is in a memory is used: vehicles that differ in one thing alone exchange their memories on the way.

Twins run the same path from the same start with the same noise and differ in one trait. Half-way each goes on with the
other's memory. Where the error grows, what the memory held of this trait was in use. The twins of `noise` differ in
their measurements alone: what an exchange costs that has nothing to do with vehicle and sea.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from auv_gym.physics.namespaces import Array
from auv_gym.scenarios.episode import Episode
from auv_gym.scenarios.presets import PRESETS
from auv_gym.scenarios.scenario import Scenario
from auv_gym.task.policy import preview_of
from baselines.evaluation.metrics import resamplings
from baselines.evaluation.rollout import beginning, play
from baselines.policy import Memory
from research.probing.collect import agent_of, episodes_of
from research.probing.watching import HIDDEN, REMEMBERED, Swap, Tapped

_AT = 300
"""Control instant of the exchange."""
FOR = 50
"""Control periods behind it whose errors count."""
_EPISODES = 32
"""Pairs of twins for each trait."""
CASE = "storm"
"""Where they run."""


def heavier(episode: Episode, share: float) -> Episode:
    """Return an episode whose vehicle has that share of its masses."""
    v = episode.vehicle
    return replace(episode, vehicle=replace(v, m11=share * v.m11, m22=share * v.m22, m33=share * v.m33))


def rougher(episode: Episode, share: float) -> Episode:
    """Return an episode whose vehicle has that share of its drag, linear and quadratic."""
    v = episode.vehicle
    names = ("d11", "d22", "d33", "X_uu", "Y_vv", "N_rr")
    return replace(episode, vehicle=replace(v, **{name: share * getattr(v, name) for name in names}))


def _lag(episode: Episode, seconds: float) -> Episode:
    return replace(episode, lag=seconds)


def _current(episode: Episode, sign: float) -> Episode:
    c = episode.current
    return replace(episode, current=replace(c, V_x=sign * c.V_x, V_y=sign * c.V_y))


def _waves(episode: Episode, shift: float) -> Episode:
    waves = episode.waves
    assert waves is not None
    return replace(episode, waves=replace(waves, phases=tuple(tuple(p + shift for p in row) for row in waves.phases)))


def _noise(episode: Episode, key: float) -> Episode:
    return replace(episode, noise_seed=episode.noise_seed ^ int(key))


class Trait(NamedTuple):
    """Something in which twins differ."""

    change: Callable[[Episode, float], Episode]
    values: tuple[float, float]  # of the one and of the other
    says: str


TRAITS: Mapping[str, Trait] = {
    "noise": Trait(_noise, (0, 1), "other measurement noise and gusts, nothing else: the control"),
    "mass": Trait(heavier, (0.8, 1.25), "masses of 0.8 and 1.25 times the drawn ones"),
    "drag": Trait(rougher, (0.6, 1.6), "drag of 0.6 and 1.6 times the drawn one"),
    "lag": Trait(_lag, (0.05, 0.5), "actuators with a lag of 0.05 and 0.5 s"),
    "current": Trait(_current, (1.0, -1.0), "mean current in opposite directions"),
    "waves": Trait(_waves, (0.0, math.pi), "waves of opposite phase"),
}
"""In what twins differ."""


def _twins(memory: Memory, part: int) -> Memory:
    """Return a memory in which neighbours, the first and the second, the third and the fourth, exchange a part."""
    order = np.arange(len(memory[part])) ^ 1
    return tuple(a[order] if i == part else a for i, a in enumerate(memory))


def _emptied(memory: Memory, part: int) -> Memory:
    return tuple(np.zeros_like(a) if i == part else a for i, a in enumerate(memory))


SWAPS: Mapping[str, tuple[Callable[[Memory, int], Memory], int]] = {
    "network": (_twins, HIDDEN),
    "inputs": (_twins, REMEMBERED),
    "emptied": (_emptied, HIDDEN),
}
"""What is done: twins exchange the network's memory, or what its inputs remember; or the network's is set to zero."""


def swapped(name: str, regime: str, episodes: int | None = None) -> dict[str, Any]:
    """Return how an agent's error grows by each exchange, trait by trait, as plain numbers.

    Args:
        name: of the agent.
        regime: "slow" or "cruise".
        episodes: pairs for each trait. None: `_EPISODES`.

    Raises:
        ValueError: the policy is unknown, or no agent that remembers.
        PolicyError: its actions are not finite.
    """
    scenario, count = PRESETS[f"{regime}-{CASE}"], episodes or _EPISODES
    drawn = episodes_of(scenario, count)
    every = [trait.change(episode, value) for trait in TRAITS.values() for episode in drawn for value in trait.values]
    usual = _errors(name, scenario, every, {})
    found: dict[str, Any] = {"pairs": count, "seconds": FOR * scenario.control_dt, "traits": {}}
    grown = {
        how: _errors(name, scenario, every, {_AT: lambda m, f=change, p=part: f(m, p)})  # type: ignore[misc]
        for how, (change, part) in SWAPS.items()
    }
    for i, trait in enumerate(TRAITS):
        own = slice(2 * count * i, 2 * count * (i + 1))
        before = usual[own].reshape(count, 2).mean(axis=1)
        rows = {how: _growth(before, errors[own].reshape(count, 2).mean(axis=1)) for how, errors in grown.items()}
        found["traits"][trait] = {"error_m": round(float(before.mean()), 5), **rows}
    return found


def _errors(name: str, scenario: Scenario, episodes: Sequence[Episode], swaps: Mapping[int, Swap]) -> Array:
    """Return the root mean square of each episode's error [m] behind the exchange, shape (N,)."""
    policy, _ = agent_of(name, scenario.vehicle)
    begun = beginning([(scenario, episodes)], preview_of(policy))
    squares = np.zeros(len(episodes))
    for k, moment in enumerate(play(Tapped(policy, swaps=swaps), begun, _AT + FOR)):
        if k >= _AT:
            squares += np.where(moment.running, np.square(moment.error), scenario.lost_distance**2)
    return np.sqrt(squares / FOR)


def _growth(before: Array, after: Array) -> list[float]:
    """Return the mean error behind an exchange as a multiple of that without, with its 95 % interval."""
    (counts,) = resamplings((len(before),))
    ratios = counts @ after / (counts @ before)
    return [round(float(x), 3) for x in (ratios[0], *np.quantile(ratios[1:], (0.025, 0.975)))]

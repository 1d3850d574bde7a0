"""The controllers whose gains can be tuned, by name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Protocol

from auv_gym.physics.vehicle import PAPER_VEHICLE, Vehicle
from auv_gym.task.policy import Policy
from baselines.control import POLICIES, TUNED
from baselines.control.backstepping import LAW_GAINS, SCALED_GAINS, Backstepping, Gains
from baselines.control.nmpc.controller import NMPC_ADVERSE_GAINS, NMPC_GAINS


class Maker(Protocol):
    """Factory of a policy with the same gains at every speed."""

    def __call__(self, gains: dict[str, float], vehicle: Vehicle = ...) -> Policy:
        """Return the policy for a nominal vehicle, by default the paper's."""


@dataclass(frozen=True)
class Tunable:
    """A controller whose gains can be tuned."""

    factory: Maker
    names: Sequence[str]  # of the gains
    world: str = "plain"  # one of `objective._WORLDS`


def _printed(gains: dict[str, float], vehicle: Vehicle = PAPER_VEHICLE) -> Backstepping:
    return Backstepping(Gains(**gains), vehicle)


def _tunable(name: str, names: Sequence[str]) -> Tunable:
    """Return the entry of a controller whose factory takes gains; a fault-tolerant one is tuned with faults."""
    factory, options, _ = POLICIES[name]
    world = "adverse" if name.endswith("-adverse") else "plain"
    return Tunable(partial(factory, **options), names, world)


TUNABLES: dict[str, Tunable] = {
    "backstepping-tuned": Tunable(_printed, LAW_GAINS),
    "backstepping-normalised-tuned": Tunable(_printed, SCALED_GAINS),
    **{name: _tunable(name, names) for name, (names, _) in TUNED.items()},
    "nmpc": _tunable("nmpc", NMPC_GAINS),
    "nmpc-adverse": _tunable("nmpc-adverse", NMPC_ADVERSE_GAINS),
}
"""The controllers that can be tuned, by name: add an entry here. It includes those of `TUNED`."""

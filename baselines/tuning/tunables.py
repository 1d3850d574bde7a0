"""What can be tuned, by name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Protocol

from auv_gym.physics.vehicle import PAPER_VEHICLE, Vehicle
from auv_gym.task.policy import Policy
from baselines.control import POLICIES, TUNED
from baselines.control.backstepping import LAW_GAINS, SCALED_GAINS, Backstepping, Gains
from baselines.control.nmpc.controller import NMPC_ADVERSE_GAINS, NMPC_GAINS


class Maker(Protocol):
    """Makes the policy that has these gains at every speed."""

    def __call__(self, gains: dict[str, float], vehicle: Vehicle = ...) -> Policy:
        """Return it for the vehicle that it is to believe in, the paper's by default."""


@dataclass(frozen=True)
class Tunable:
    """A controller whose gains can be tuned."""

    factory: Maker  # the policy with these gains at every speed
    names: Sequence[str]  # of the gains
    world: str = "plain"  # that it is tuned in, one of `objective.WORLDS`
    sweep: Mapping[str, float] = field(default_factory=dict)  # powers of a factor that make its commands calmer


def _printed(gains: dict[str, float], vehicle: Vehicle = PAPER_VEHICLE) -> Backstepping:
    return Backstepping(Gains(**gains), vehicle)


def _tunable(name: str, names: Sequence[str]) -> Tunable:
    """Return the entry of a controller whose factory takes gains; one that knows of faults is tuned among them."""
    factory, options, _ = POLICIES[name]
    world = "adverse" if name.endswith("-adverse") else "plain"
    return Tunable(partial(factory, **options), names, world, SWEEPS.get(name, {}))


SWEEPS: Mapping[str, Mapping[str, float]] = {
    "lqi": dict.fromkeys(("surge_effort", "surge_rate", "yaw_effort", "yaw_rate"), 1.0),  # weights of the commands
    "ekf": dict.fromkeys(("k", "cu", "c", "cr"), -0.25),  # it has no such weights: all rates of its law go down
    "nmpc": dict.fromkeys(("surge", "yaw"), 1.0),  # weights of the commands
}
"""By name, the powers of a sweep's factor that gains follow."""
TUNABLES: dict[str, Tunable] = {
    "backstepping-tuned": Tunable(_printed, LAW_GAINS),
    "backstepping-normalised-tuned": Tunable(_printed, SCALED_GAINS),
    **{name: _tunable(name, names) for name, (names, _) in TUNED.items()},
    "nmpc": _tunable("nmpc", NMPC_GAINS),
    "nmpc-adverse": _tunable("nmpc-adverse", NMPC_ADVERSE_GAINS),
}
"""What can be tuned, by name: add an entry here; a controller of `TUNED` is among them."""

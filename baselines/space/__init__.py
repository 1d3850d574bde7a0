"""Controllers in space, each made of its form in the plane, and the table of their names."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from auv_gym.physics.space import SpaceVehicle
from auv_gym.scenarios.vehicles import PAPER
from auv_gym.task.policy import Policy
from baselines.control.ekf_law import EKF_GAINS
from baselines.control.los_pid import PIDGains
from baselines.control.lqi import LqiWeights
from baselines.control.nmpc.controller import NMPC_GAINS
from baselines.control.open_loop import NO_EXPERT
from baselines.control.privileged.optimum import FullInformationOptimum
from baselines.gains.loading import checked_gains, load_gains
from baselines.policy import Remembering
from baselines.space.backstepping import SpaceBackstepping
from baselines.space.ekf import SpaceEkfLaw
from baselines.space.los_pid import SpaceLineOfSight
from baselines.space.los_setpoints import space_los_setpoints
from baselines.space.lqi import SpaceLQI
from baselines.space.nmpc import space_nmpc
from baselines.space.open_loop import SpaceOpenLoop

SPEED_RANGE = "space"
"""Name of the gains in space, beside those of the speed ranges in the plane."""
TUNED: Mapping[str, tuple[tuple[str, ...], Callable[..., Any]]] = {
    "los-pid": (PIDGains._fields, SpaceLineOfSight),
    "lqi": (LqiWeights._fields, SpaceLQI),
    "ekf": (EKF_GAINS, SpaceEkfLaw),
    "nmpc": (NMPC_GAINS, space_nmpc),
}
"""Controllers with memory by name: names of their gains, and a function that returns one for gains and a vehicle."""


def tuned(name: str, gains: Mapping[str, float] | None = None, vehicle: SpaceVehicle = PAPER.in_space) -> Remembering:
    """Return a controller of `TUNED`; by default with the recorded gains.

    Raises:
        ValueError: `gains` are not those of the controller.
    """
    names, make = TUNED[name]
    chosen = load_gains(name, SPEED_RANGE, names) if gains is None else checked_gains(gains, names, name)
    return Remembering(make(chosen, vehicle))


def _made(name: str) -> Callable[..., Policy]:
    return lambda vehicle, gains=None: tuned(name, gains, vehicle)


SPACE_POLICIES: Mapping[str, Callable[..., Policy]] = {
    "backstepping": lambda vehicle, **options: SpaceBackstepping(vehicle=vehicle, **options),
    "backstepping-normalised": lambda vehicle: SpaceBackstepping("normalised", vehicle),
    **{name: _made(name) for name in TUNED},
    "los-setpoints": lambda _, gains=None: space_los_setpoints(gains),
    "open-loop": lambda _: SpaceOpenLoop(),
    "clairvoyant": lambda _: FullInformationOptimum(),
}
"""Controllers by name: functions of the known vehicle in the paper's units."""


def make_in_space(name: str, vehicle: SpaceVehicle, **options: Any) -> Policy:
    """Return a controller in space, or the expert `NO_EXPERT`, for a vehicle in the paper's units.

    Raises:
        ValueError: there is no controller of this name in space, or it does not take these options.
    """
    if name == NO_EXPERT:
        return SpaceOpenLoop(0.0)
    if name not in SPACE_POLICIES:
        raise ValueError(f"there is no policy {name!r} in space; allowed are {', '.join(SPACE_POLICIES)}")
    try:
        return SPACE_POLICIES[name](vehicle, **options)
    except TypeError as error:
        raise ValueError(f"policy {name!r} does not take these options: {error}") from error

"""Control laws, one per file, and the table of their names."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from functools import partial
from types import MappingProxyType
from typing import Any, NamedTuple

from auv_gym.physics.vehicle import Vehicle
from auv_gym.scenarios.vehicles import VehicleLike
from auv_gym.task.policy import Policy
from baselines.control.backstepping import Backstepping
from baselines.control.ekf_law import EKF_GAINS, EkfLaw
from baselines.control.ilos import Ilos, IlosGains
from baselines.control.integral import INTEGRAL_GAINS, IntegralLaw
from baselines.control.los_pid import LineOfSightPID, PIDGains
from baselines.control.los_setpoints import make_los_setpoints
from baselines.control.lqi import LQI, LqiWeights
from baselines.control.nmpc.controller import make_nmpc
from baselines.control.open_loop import OpenLoop
from baselines.control.privileged.optimum import FullInformationOptimum
from baselines.control.privileged.oracle import Oracle
from baselines.gains.loading import tuned_policy
from baselines.policy import Controller

TUNED: dict[str, tuple[tuple[str, ...], Callable[[Mapping[str, float], Vehicle], Controller]]] = {
    "integral-normalised": (INTEGRAL_GAINS, IntegralLaw),
    "los-pid": (PIDGains._fields, LineOfSightPID),
    "lqi": (LqiWeights._fields, LQI),
    "ilos": (IlosGains._fields, Ilos),
    "ekf": (EKF_GAINS, EkfLaw),
}
"""Controllers with memory by name: names of their gains, and a function that returns one for gains and a vehicle."""


def _tuned(name: str) -> Callable[..., Policy]:
    """Return the factory of a controller of `TUNED`; it has the arguments `gains` and `vehicle` of `tuned_policy`."""
    return partial(tuned_policy, name, *TUNED[name])


class Registration(NamedTuple):
    """An entry of the registry."""

    make: Callable[..., Policy]
    about: str  # description in one line
    options: Mapping[str, Any] = MappingProxyType({})  # of `make`
    privileged: bool = False  # whether it needs full information, see `policy.Privileged`
    setpoints: bool = False  # whether its actions are setpoints of an autopilot


POLICIES: dict[str, Registration] = {
    "backstepping": Registration(
        Backstepping,
        "the paper's law with the paper's gains in slow motion and retuned gains at cruise; the expert of the agents",
    ),
    "backstepping-normalised": Registration(
        Backstepping, "the speed-normalised law with gains that prevent spinning", {"gains": "normalised"}
    ),
    "integral-normalised": Registration(
        _tuned("integral-normalised"), "the speed-normalised law with integral action on the position error"
    ),
    "ilos": Registration(_tuned("ilos"), "integral line-of-sight guidance with a sway observer, for trajectories"),
    "los-pid": Registration(_tuned("los-pid"), "line-of-sight guidance, PID autopilots and the planner's feed-forward"),
    "lqi": Registration(
        _tuned("lqi"), "linear-quadratic control with integral action, gains scheduled with speed and turn rate"
    ),
    "ekf": Registration(
        _tuned("ekf"),
        "the speed-normalised law on an extended Kalman filter of vehicle, actuators and disturbances",
    ),
    "nmpc": Registration(
        make_nmpc, "nonlinear model predictive control on the filter of ekf, with a preview of the path"
    ),
    "nmpc-adverse": Registration(
        make_nmpc,
        "nmpc with a filter that also estimates sensor biases, weak actuators and a delay",
        {"adverse": True},
    ),
    "oracle": Registration(
        Oracle,
        "a regulator with full information about vehicle, current, waves and lag; for evaluation only",
        privileged=True,
    ),
    "clairvoyant": Registration(
        FullInformationOptimum,
        "the full-information optimum over the whole episode, which scores 1; for evaluation only",
        privileged=True,
    ),
    "los-setpoints": Registration(
        make_los_setpoints, "line-of-sight guidance for the autopilots of a scenario with setpoints", setpoints=True
    ),
    "open-loop": Registration(OpenLoop, "the planner's forces without feedback"),
}
"""Controllers by name. An entry here makes a name known everywhere."""


def make_controller(name: str, vehicle: VehicleLike | None = None, **options: Any) -> Policy:
    """Return a controller of `POLICIES`; options override those of the entry.

    Args:
        name: the controller's.
        vehicle: nominal model, for a factory with an argument `vehicle`. None: the paper's vehicle.
        options: of the factory.

    Raises:
        ValueError: the name is unknown, or the factory does not take such options.
    """
    if name not in POLICIES:
        raise ValueError(f"unknown policy {name!r}; allowed are {', '.join(POLICIES)}")
    make, _, defaults, *_ = POLICIES[name]
    try:
        return make(**{**defaults, **vehicle_option(make, vehicle), **options})
    except TypeError as error:
        raise ValueError(f"policy {name!r} does not take these options: {error}") from error


def vehicle_option(factory: Callable[..., Any], vehicle: Any, name: str = "vehicle") -> dict[str, Any]:
    """Return the option `name` of a factory; empty if the vehicle is None or the factory has no such argument."""
    try:
        accepted = vehicle is not None and name in inspect.signature(factory).parameters
    except (TypeError, ValueError):  # the factory has no signature
        accepted = False
    return {name: vehicle} if accepted else {}

"""Control laws, one per file, and the table of their names."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from auv_gym.physics.vehicle import Vehicle
from auv_gym.scenarios.vehicles import VehicleModel
from auv_gym.task.policy import Policy
from baselines.control.adaptive import Adaptive, AdaptiveGains
from baselines.control.backstepping import LAW_GAINS, SCALED_GAINS, Backstepping, make_tuned
from baselines.control.current_observer import CurrentObserver, ObserverGains
from baselines.control.ekf_law import EKF_ADVERSE_GAINS, EKF_GAINS, EkfLaw
from baselines.control.ilos import Ilos, IlosGains
from baselines.control.integral import NORMALISED_GAINS, PRINTED_GAINS, IntegralLaw
from baselines.control.los_pid import LineOfSightPID, PIDGains
from baselines.control.lqi import LQI, LqiWeights
from baselines.control.nmpc.controller import make_nmpc
from baselines.control.open_loop import OpenLoop
from baselines.control.privileged.optimum import FullInformationOptimum
from baselines.control.privileged.oracle import Oracle
from baselines.control.smc_dob import SmcDob, SmcGains
from baselines.gains.loading import tuned_policy
from baselines.policy import Controller

TUNED: dict[str, tuple[tuple[str, ...], Callable[[Mapping[str, float], Vehicle], Controller]]] = {
    "integral": (PRINTED_GAINS, IntegralLaw),
    "integral-normalised": (NORMALISED_GAINS, IntegralLaw),
    "los-pid": (PIDGains._fields, LineOfSightPID),
    "lqi": (LqiWeights._fields, LQI),
    "current-observer": (ObserverGains._fields, CurrentObserver),
    "ilos": (IlosGains._fields, Ilos),
    "adaptive": (AdaptiveGains._fields, Adaptive),
    "smc-dob": (SmcGains._fields, SmcDob),
    "ekf": (EKF_GAINS, EkfLaw),
    "ekf-adverse": (EKF_ADVERSE_GAINS, EkfLaw),
}
"""Controllers with memory by name: names of their gains, and a function that returns one for gains and a vehicle."""


def _tuned(name: str) -> Callable[..., Policy]:
    """Return the factory of a controller of `TUNED`; it has the arguments `gains` and `vehicle` of `tuned_policy`."""
    return partial(tuned_policy, name, *TUNED[name])


POLICIES: dict[str, tuple[Callable[..., Policy], dict[str, Any], str]] = {
    "backstepping": (
        Backstepping,
        {},
        "the paper's law with the paper's gains in slow motion and retuned gains at cruise; the expert of the agents",
    ),
    "backstepping-paper": (Backstepping, {"gains": "paper"}, "the paper's law with the paper's gains at every speed"),
    "backstepping-robust": (Backstepping, {"gains": "robust"}, "the paper's law with gains for damping up to 2 m/s"),
    "backstepping-normalised": (
        Backstepping,
        {"gains": "normalised"},
        "the speed-normalised law with gains that prevent spinning",
    ),
    "backstepping-tuned": (
        partial(make_tuned, "backstepping-tuned", LAW_GAINS),
        {},
        "the paper's law, tuned with the common budget",
    ),
    "backstepping-normalised-tuned": (
        partial(make_tuned, "backstepping-normalised-tuned", SCALED_GAINS),
        {},
        "the speed-normalised law, tuned with the common budget",
    ),
    "integral": (_tuned("integral"), {}, "the paper's law with integral action on the position error"),
    "integral-normalised": (
        _tuned("integral-normalised"),
        {},
        "the speed-normalised law with integral action on the position error",
    ),
    "ilos": (_tuned("ilos"), {}, "integral line-of-sight guidance with a sway observer, for trajectories"),
    "los-pid": (_tuned("los-pid"), {}, "line-of-sight guidance, PID autopilots and the planner's feed-forward"),
    "smc-dob": (_tuned("smc-dob"), {}, "sliding-mode control with a disturbance observer and boundary layers"),
    "lqi": (
        _tuned("lqi"),
        {},
        "linear-quadratic control with integral action, gains scheduled with speed and turn rate",
    ),
    "adaptive": (_tuned("adaptive"), {}, "the speed-normalised law in the water frame with L1 adaptive augmentation"),
    "current-observer": (
        _tuned("current-observer"),
        {},
        "the speed-normalised law in the water frame with a simple current observer",
    ),
    "ekf": (
        _tuned("ekf"),
        {},
        "the speed-normalised law on an extended Kalman filter of vehicle, actuators and disturbances",
    ),
    "nmpc": (make_nmpc, {}, "nonlinear model predictive control on the filter of ekf, with a preview of the path"),
    "ekf-adverse": (
        _tuned("ekf-adverse"),
        {},
        "ekf with a filter that also estimates sensor biases, weak actuators and a delay",
    ),
    "nmpc-adverse": (make_nmpc, {"adverse": True}, "nmpc with the filter of ekf-adverse"),
    "oracle": (
        Oracle,
        {},
        "a regulator with full information about vehicle, current, waves and lag; for evaluation only",
    ),
    "clairvoyant": (
        FullInformationOptimum,
        {},
        "the full-information optimum over the whole episode, which scores 1; for evaluation only",
    ),
    "open-loop": (OpenLoop, {}, "the planner's forces without feedback"),
}
"""Controllers by name: factory, its options, a short description. An entry here makes a name known everywhere."""


def make_controller(
    name: str, vehicle: Vehicle | VehicleModel | str | Mapping[str, Any] | None = None, **options: Any
) -> Policy:
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
    factory, defaults, _ = POLICIES[name]
    try:
        return factory(**{**defaults, **vehicle_option(factory, vehicle), **options})
    except TypeError as error:
        raise ValueError(f"policy {name!r} does not take these options: {error}") from error


def vehicle_option(factory: Callable[..., Any], vehicle: Any) -> dict[str, Any]:
    """Return the option `vehicle` of a factory; empty if the vehicle is None or the factory has no such argument."""
    try:
        accepted = vehicle is not None and "vehicle" in inspect.signature(factory).parameters
    except (TypeError, ValueError):  # the factory has no signature
        accepted = False
    return {"vehicle": vehicle} if accepted else {}

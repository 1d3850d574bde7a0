"""Control laws, one a file, and their names."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from auv_gym.physics.vehicle import Vehicle
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
from baselines.control.privileged.clairvoyant import Clairvoyant
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
"""Controllers with memory by name: the names of their gains, and what makes them from gains for a vehicle."""


def _tuned(name: str) -> Callable[..., Policy]:
    """Return the factory of a controller of `TUNED`, with the arguments `gains` and `vehicle` of `tuned_policy`."""
    return partial(tuned_policy, name, *TUNED[name])


POLICIES: dict[str, tuple[Callable[..., Policy], dict[str, Any], str]] = {
    "backstepping": (
        Backstepping,
        {},
        "the paper's law; its gains in slow motion, re-tuned ones at cruise: the expert",
    ),
    "backstepping-paper": (Backstepping, {"gains": "paper"}, "the paper's law with the paper's gains at every speed"),
    "backstepping-robust": (Backstepping, {"gains": "robust"}, "the paper's law, gains tuned for decay up to 2 m/s"),
    "backstepping-normalised": (Backstepping, {"gains": "normalised"}, "the speed-normalised law, spin-safe gains"),
    "backstepping-tuned": (
        partial(make_tuned, "backstepping-tuned", LAW_GAINS),
        {},
        "the paper's law, its gains tuned as everybody's",
    ),
    "backstepping-normalised-tuned": (
        partial(make_tuned, "backstepping-normalised-tuned", SCALED_GAINS),
        {},
        "the speed-normalised law, its gains tuned as everybody's",
    ),
    "integral": (_tuned("integral"), {}, "the paper's law with the position error's integral"),
    "integral-normalised": (
        _tuned("integral-normalised"),
        {},
        "the speed-normalised law with the position error's integral",
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
        "the speed-normalised law in the water frame, a simple observer",
    ),
    "ekf": (_tuned("ekf"), {}, "the same on an extended Kalman filter of vehicle, actuators and sea"),
    "nmpc": (make_nmpc, {}, "nonlinear model predictive control on the same filter, with a preview of the path"),
    "ekf-adverse": (
        _tuned("ekf-adverse"),
        {},
        "the law of ekf on a filter of biased sensors and weak, late actuators too",
    ),
    "nmpc-adverse": (make_nmpc, {"adverse": True}, "the control of nmpc on that filter"),
    "oracle": (Oracle, {}, "knows plant, current, waves and lag, now and in future: a regulator; evaluation only"),
    "clairvoyant": (
        Clairvoyant,
        {},
        "the best that anybody could do, optimised over the whole episode: the score's 1; evaluation only",
    ),
    "open-loop": (OpenLoop, {}, "the planner's forces alone"),
}
"""Controllers by name: (factory, its options, one line about it). Add an entry here to use it everywhere by name."""


def make_controller(name: str, vehicle: Vehicle | str | Mapping[str, Any] | None = None, **options: Any) -> Policy:
    """Return a controller of `POLICIES`; options override those of the entry.

    Args:
        name: the controller's.
        vehicle: the one that it believes in, if its factory takes one. None: the paper's.
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
    """Return the option that tells a factory of the known vehicle; none if there is none, or it takes no `vehicle`."""
    try:
        takes = vehicle is not None and "vehicle" in inspect.signature(factory).parameters
    except (TypeError, ValueError):  # of something without a signature
        takes = False
    return {"vehicle": vehicle} if takes else {}

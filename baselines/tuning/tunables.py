"""What can be tuned, by name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from auv_gym.physics.vehicle import PAPER_VEHICLE, Vehicle
from auv_gym.task.policy import Policy
from baselines.control import ekf_law
from baselines.control.adaptive import AdaptiveGains, make_adaptive
from baselines.control.backstepping import LAW_GAINS, SCALED_GAINS, Backstepping, Gains
from baselines.control.current_observer import OBSERVER_GAINS, make_current_observer
from baselines.control.ekf_law import EKF_GAINS, make_ekf_adverse, make_ekf_law
from baselines.control.ilos import IlosGains, make_ilos
from baselines.control.integral import NORMALISED_GAINS, PRINTED_GAINS, make_integral, make_integral_normalised
from baselines.control.los_pid import PIDGains, make_los_pid
from baselines.control.lqi import LqiWeights, make_lqi
from baselines.control.nmpc import controller as nmpc
from baselines.control.nmpc.controller import NMPC_GAINS, make_nmpc, make_nmpc_adverse
from baselines.control.smc_dob import SmcGains, make_smc_dob


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


LQI_SWEEP = dict.fromkeys(("surge_effort", "surge_rate", "yaw_effort", "yaw_rate"), 1.0)
"""The weights of the commands of `lqi` follow the factor of a sweep."""
EKF_SWEEP = dict.fromkeys(("k", "cu", "c", "cr"), -0.25)
"""The law of `ekf` has no weights: all of its rates go down."""
NMPC_SWEEP = dict.fromkeys(("surge", "yaw"), 1.0)
"""The weights of the commands of `nmpc` follow the factor of a sweep."""

TUNABLES: dict[str, Tunable] = {
    "backstepping-tuned": Tunable(_printed, LAW_GAINS),
    "backstepping-normalised-tuned": Tunable(_printed, SCALED_GAINS),
    "integral": Tunable(make_integral, PRINTED_GAINS),
    "integral-normalised": Tunable(make_integral_normalised, NORMALISED_GAINS),
    "los-pid": Tunable(make_los_pid, PIDGains._fields),
    "lqi": Tunable(make_lqi, LqiWeights._fields, sweep=LQI_SWEEP),
    "current-observer": Tunable(make_current_observer, OBSERVER_GAINS),
    "ilos": Tunable(make_ilos, IlosGains._fields),
    "adaptive": Tunable(make_adaptive, AdaptiveGains._fields),
    "smc-dob": Tunable(make_smc_dob, SmcGains._fields),
    "ekf": Tunable(make_ekf_law, EKF_GAINS, sweep=EKF_SWEEP),
    "ekf-adverse": Tunable(make_ekf_adverse, ekf_law.ADVERSE_GAINS, "adverse"),
    "nmpc": Tunable(make_nmpc, NMPC_GAINS, sweep=NMPC_SWEEP),
    "nmpc-adverse": Tunable(make_nmpc_adverse, nmpc.ADVERSE_GAINS, "adverse"),
}
"""What can be tuned, by name: add an entry here."""

"""What is made for the paper's vehicle, for any other: it is shown everything in units in which that one is similar.

Gains have units, so they fit one vehicle. In the units of `auv_gym.physics.units` every vehicle has the mass, length
and speed of the paper's, so a controller or an agent made there for its ratios, and shown what is observed in those
units, has gains that are functions of the vehicle. Actions are shares of the limits and need no change.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from auv_gym.physics.namespaces import FLOATS, Namespace, Number
from auv_gym.physics.units import POWERS, Units, in_paper_units
from auv_gym.physics.vehicle import Vehicle
from auv_gym.scenarios.vehicles import as_vehicle
from auv_gym.task.observation import TERMS
from auv_gym.task.policy import Law, Policy, preview_of, traceable
from baselines.policy import ALL_SPEEDS, Batched, Memory, Starts


def made_for(vehicle: Vehicle | str | Mapping[str, Any] | None, make: Callable[[Any], Policy]) -> Policy:
    """Return a policy for a vehicle: made for it in the paper's units, and shown what is observed in those.

    Args:
        vehicle: an object, a name, a file or a dict of its parameters. None: the paper's.
        make: returns the policy for a vehicle, an argument like that one; called once. A vehicle that has the mass,
            length and design speed of the paper's is handed on as it is, and what comes out is not changed.

    Raises:
        ValueError: there is no such vehicle, or none like it in the paper's units.
    """
    if vehicle is None:
        return make(None)
    known = as_vehicle(vehicle)
    units = Units.of(known)
    if units == Units():
        return make(known)
    policy = make(in_paper_units(known))
    return SimilarLaw(policy, units) if isinstance(policy, Law) and traceable(policy) else Similar(policy, units)


def shown_factors(units: Units) -> list[float]:
    """Return by what each term of an observation in SI units is multiplied to be seen in a vehicle's own units."""
    return [1 / units.factor(*POWERS[term.unit]) for term in TERMS]


class Similar(Batched):
    """A policy for the paper's units as one for SI units, with Stable-Baselines3's `predict`; its memory is the same.

    Args:
        policy: the one that acts; it stays reachable as `policy`.
        units: of the vehicle that it steers.
    """

    def __init__(self, policy: Policy, units: Units) -> None:
        self.policy, self.units, self.preview = policy, units, preview_of(policy)
        if isinstance(policy, Batched):  # its warning of speeds is given here, in SI units
            low, high = policy.speeds
            rate, policy.speeds = units.factor(length=1, time=-1), ALL_SPEEDS
            self.speeds = low * rate, high * rate
        self._factors = np.array(shown_factors(units) + [1 / units.length] * (2 * len(self.preview)))

    def actions(
        self, rows: NDArray[Any], state: Memory | None, episode_start: Starts, deterministic: bool
    ) -> tuple[NDArray[np.float32], Memory | None]:
        """Return actions and memory, see `Batched`.

        Columns behind the terms and the preview, such as the residual environment's, are handed on as they are. The
        bounds of an observation do not cut what is shown.
        """
        shown = rows.astype(np.float64)
        shown[:, : len(self._factors)] *= self._factors
        return self.policy.predict(shown, state, episode_start, deterministic)


class SimilarLaw(Law):
    """A law for the paper's units as one for SI units: a pure function of the observation's terms again.

    Args:
        law: the one that acts; it stays reachable as `policy`.
        units: of the vehicle that it steers.
    """

    def __init__(self, law: Law, units: Units) -> None:
        self.policy, self.units = law, units
        self._factors = shown_factors(units)
        self._force, self._torque = (units.factor(*POWERS[unit]) for unit in ("N", "N m"))

    def forces(self, o: Sequence[Number], ns: Namespace = FLOATS) -> tuple[Number, Number]:
        """Return F_u [N], F_r [N m] for a `task.Observation` in SI units, or its terms in that order."""
        F_u, F_r = self.policy.forces(self._shown(o), ns)
        return F_u * self._force, F_r * self._torque

    def check(self, terms: Any) -> None:
        """Look at what is observed, the terms as a list or as rows, and warn if the law is not made for it."""
        self.policy.check(self._shown(terms) if isinstance(terms, list) else np.array(self._shown(terms)))

    def _shown(self, terms: Sequence[Number]) -> list[Number]:
        return [term * factor for term, factor in zip(terms, self._factors, strict=False)]

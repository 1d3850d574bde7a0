"""Dimensional scaling: adapts policies for the paper's vehicle to any other vehicle.

Gains have units, so they fit one vehicle. In the units of `auv_gym.physics.units` every vehicle has the mass, length
and design speed of the paper's vehicle. A controller or an agent that is made in these units, and gets its observations
in them, therefore has gains that are functions of the vehicle. Actions are fractions of the limits and do not change.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from auv_gym.physics.namespaces import FLOATS, Namespace, Number
from auv_gym.physics.space import SpaceVehicle
from auv_gym.physics.units import POWERS, Units, in_paper_units
from auv_gym.scenarios.vehicles import VehicleLike, as_vehicle, vehicle_model_of
from auv_gym.task.observation import PLANE_LAYOUT, Layout
from auv_gym.task.policy import Law, Policy, preview_of, traceable
from baselines.policy import ALL_SPEEDS, Batched, Memory, Starts


def scaled_for(vehicle: VehicleLike | SpaceVehicle | None, make: Callable[[Any], Policy]) -> Policy:
    """Return a policy for a vehicle: made in the paper's units, with observations scaled to these units.

    Args:
        vehicle: an object, a name, a file or a dict of its parameters; in space a `SpaceVehicle`. None: the paper's.
        make: function that returns the policy for a vehicle; called once, with a `VehicleModel` if the actuators are
            known, see `vehicle_model_of`, else with a `Vehicle`. If the vehicle has the mass, length and design
            speed of the paper's, it is passed unchanged, and so is the policy.

    Raises:
        ValueError: there is no such vehicle, or it cannot be scaled to the paper's units.
    """
    if vehicle is None:
        return make(None)
    if isinstance(vehicle, SpaceVehicle):
        units = Units.of(vehicle.horizontal)
        return make(vehicle) if units == Units() else _scaled(make(vehicle.over(units)), units)
    vehicle_model, known = vehicle_model_of(vehicle), as_vehicle(vehicle)
    units = Units.of(known)
    if units == Units():
        return make(vehicle_model or known)
    return _scaled(make(vehicle_model.in_paper_units if vehicle_model else in_paper_units(known)), units)


def _scaled(policy: Policy, units: Units) -> Policy:
    return ScaledLaw(policy, units) if isinstance(policy, Law) and traceable(policy) else ScaledPolicy(policy, units)


def shown_factors(units: Units, layout: Layout = PLANE_LAYOUT) -> list[float]:
    """Return the factor of each term of an observation, from SI units to the given units."""
    return [1 / units.factor(*POWERS[term.unit]) for term in layout.terms]


class ScaledPolicy(Batched):
    """A policy in the paper's units as a policy in SI units, with the `predict` of Stable-Baselines3 and its memory.

    Args:
        policy: the policy in the paper's units, also the attribute `policy`.
        units: units of the vehicle.
    """

    def __init__(self, policy: Policy, units: Units) -> None:
        self.policy, self.units, self.preview = policy, units, preview_of(policy)
        self.layout = getattr(policy, "layout", PLANE_LAYOUT)
        if isinstance(policy, Batched):  # this wrapper warns of other speeds, in SI units
            low, high = policy.speeds
            rate, policy.speeds = units.factor(length=1, time=-1), ALL_SPEEDS
            self.speeds = low * rate, high * rate
        ahead = [1 / units.length] * (self.layout.axes * len(self.preview))
        self._factors = np.array(shown_factors(units, self.layout) + ahead)

    def actions(
        self, rows: NDArray[Any], state: Memory | None, episode_start: Starts, deterministic: bool
    ) -> tuple[NDArray[np.float32], Memory | None]:
        """Return actions and memory, see `Batched`.

        Columns after the terms and the preview, such as those of the residual environment, are not scaled. Scaled
        observations are not clipped to the bounds of the observation space.
        """
        scaled = rows.astype(np.float64)
        scaled[:, : len(self._factors)] *= self._factors
        return self.policy.predict(scaled, state, episode_start, deterministic)


@dataclass(frozen=True)
class ScaledLaw(Law):
    """A control law in the paper's units as a control law in SI units.

    Args:
        policy: the law in the paper's units.
        units: units of the vehicle.
    """

    policy: Law
    units: Units

    @property
    def layout(self) -> Layout:  # type: ignore[override]
        """Layout of the observations."""
        return self.policy.layout

    def forces(self, o: Sequence[Number], ns: Namespace = FLOATS) -> tuple[Number, ...]:
        """Return F_u [N], F_r [N m] for a `task.Observation` in SI units, or its terms in that order."""
        F_u, *moments = self.policy.forces(self._scaled(o), ns)
        return F_u * self.units.factor(*POWERS["N"]), *(F * self.units.factor(*POWERS["N m"]) for F in moments)

    def check(self, terms: Any) -> None:
        """Check an observation, its terms as a list or as rows, and warn if it is outside of the law's range."""
        self.policy.check(self._scaled(terms) if isinstance(terms, list) else np.array(self._scaled(terms)))

    @cached_property
    def _factors(self) -> list[float]:
        return shown_factors(self.units, self.layout)

    def _scaled(self, terms: Sequence[Number]) -> list[Number]:
        return [term * factor for term, factor in zip(terms, self._factors, strict=False)]

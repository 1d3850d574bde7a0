"""Predictive control in space: `baselines.control.nmpc` for motion in space, on the filter in space.

The heave velocity costs as much as the sway velocity. A large pitch has a cost too, since an episode ends at
`MAX_PITCH`: a vehicle that turns around would pass through it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from auv_gym.physics.namespaces import ARRAYS, Namespace, Number
from auv_gym.physics.space import SpaceVehicle
from auv_gym.physics.vehicle import Vehicle
from auv_gym.task.space import SPACE, Observation, in_world
from baselines.control.nmpc.controller import PredictiveControl
from baselines.control.nmpc.problem import System
from baselines.space.backstepping import SpaceBackstepping
from baselines.space.kalman import SPACE_FILTER

_STEEP, _PITCH_WEIGHT = 1.2, 10.0  # pitch [rad] above which it has a cost, and its weight [m^2]


class SpaceStage(NamedTuple):
    """Data of one stage of the horizon, see `baselines.control.nmpc.problem.Stage`."""

    dt: Number  # [s]
    target_x: Number  # [m]
    target_y: Number  # [m]
    target_z: Number  # [m]
    V_x: Number  # [m/s]
    V_y: Number  # [m/s]
    V_z: Number  # [m/s]
    X: Number  # [N]
    Y: Number  # [N]
    Z: Number  # [N]
    M: Number  # [N m]
    N: Number  # [N m]
    gain: Number
    share: Number
    last: Number
    torque_q: Number
    fin_q: Number  # [s^2/m^2]
    torque_r: Number
    fin_r: Number  # [s^2/m^2]


def _in_world(ahead: Sequence[Number], o: Observation, _: Namespace) -> tuple[Number, ...]:
    return in_world(ahead, o)


def _sway_cost(state: Sequence[Number], weight: Number, ns: Any) -> Number:
    v, w = state[SPACE.plant.v], state[SPACE.plant.w]
    steep = ns.clip(abs(state[SPACE.plant.theta]) - _STEEP, 0.0, math.inf)
    return weight * weight * (v * v + w * w) + _PITCH_WEIGHT * steep * steep


def _law(o: Observation, vehicle: SpaceVehicle) -> tuple[Number, ...]:
    return SpaceBackstepping("normalised", vehicle).forces(o, ARRAYS)


def _planes(vehicle: SpaceVehicle) -> tuple[Vehicle, Vehicle]:
    return vehicle.horizontal, vehicle.vertical


SPACE_SYSTEM = System(SPACE_FILTER, SpaceStage, _in_world, _sway_cost, _law, _planes)
"""Motion in space."""


def space_nmpc(gains: Mapping[str, float], vehicle: SpaceVehicle) -> PredictiveControl:
    """Return the controller in space; the names of its gains are `NMPC_GAINS`."""
    return PredictiveControl(gains, vehicle, SPACE_SYSTEM)

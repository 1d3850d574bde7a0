"""What a plan leaves of the limits of the actuators in a current."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from auv_gym.physics.dynamics import CurrentVelocity
from auv_gym.physics.namespaces import ARRAYS, Array
from auv_gym.physics.vehicle import Vehicle
from auv_gym.planning.feasibility import InfeasibleReferenceError, torque_limit
from auv_gym.planning.paths import Path
from auv_gym.planning.paths.base import OfPath
from auv_gym.planning.planner import plan


class Reserves(NamedTuple):
    """The smallest 1 - |F|/F_max of each actuator on a path; -inf if no motion follows the path."""

    surge: float
    yaw: float


@dataclass(frozen=True)
class ThroughWater(OfPath):
    """A path over ground as a `Path` relative to water that flows with a constant current."""

    path: Path
    current: CurrentVelocity  # [m/s]

    def derivatives(self, t: Array) -> Array:
        """Return position [m] and its first three time derivatives at times of shape (T,), see `Path.derivatives`."""
        derivatives, flow = np.array(self.path.derivatives(t)), np.array(self.current)[:, None]
        derivatives[0] -= flow * t
        derivatives[1] -= flow
        return derivatives


def reserves(
    path: Path,
    vehicle: Vehicle,
    times: Array,
    force_limits: tuple[float, float],
    fin: float = 0.0,
    current: CurrentVelocity = (0.0, 0.0),
) -> Reserves:
    """Return what the steady motion of a vehicle on a path in a constant current leaves of the limits.

    In a constant current the vehicle moves relative to the water as in still water, so `plan` of `ThroughWater` gives
    the forces. Waves, gusts and the way from the initial errors to the path need reserves of their own.

    Args:
        path: see `plan`, over ground.
        vehicle: the vehicle.
        times: see `plan`.
        force_limits: largest |F_u| [N] and |F_r| [N m].
        fin: see `plan`; then the limit of F_r is that at the speed through water.
        current: V_x, V_y [m/s] of the water.

    Raises:
        ValueError: see `plan`.
    """
    try:
        R = plan(ThroughWater(path, current), vehicle, times)
    except InfeasibleReferenceError:
        return Reserves(-math.inf, -math.inf)
    torque = torque_limit(R.u, (*force_limits, fin), ARRAYS)
    with np.errstate(divide="ignore"):
        surge, yaw = np.max(np.abs(R.F_u)) / force_limits[0], np.max(np.abs(R.F_r) / torque)
    return Reserves(1 - float(surge), 1 - float(yaw))

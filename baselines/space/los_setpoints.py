"""Line-of-sight guidance in space for the autopilots of a vehicle: that of the plane, at the depth of the reference."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from auv_gym.physics.namespaces import FLOATS, Namespace, Number
from auv_gym.task.observation import Layout
from auv_gym.task.space import SPACE, Observation
from baselines.control.los_setpoints import LosSetpoints, los_gains


@dataclass(frozen=True)
class SpaceLosSetpoints(LosSetpoints):
    """The guidance; the depth autopilot follows the planned depth and pitch."""

    layout: ClassVar[Layout] = SPACE.layout

    def forces(self, o: Sequence[Number], ns: Namespace = FLOATS) -> tuple[Number, ...]:
        """Return the setpoints, see `LosSetpoints.forces`."""
        seen = Observation._make(o)
        surge, yaw = self.setpoints(seen, ns)
        return surge, 0.0 * seen.F_q_max, yaw


def space_los_setpoints(gains: Mapping[str, float] | None = None, vehicle: Any = None) -> SpaceLosSetpoints:
    """Return the guidance in space, see `los_setpoints.make_los_setpoints`."""
    del vehicle
    return SpaceLosSetpoints(*(los_gains("space", gains, None),) * 2)

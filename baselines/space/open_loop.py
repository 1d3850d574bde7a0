"""Policies without feedback in space, see `baselines.control.open_loop`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from auv_gym.physics.namespaces import FLOATS, Namespace, Number
from auv_gym.task.observation import Layout
from auv_gym.task.policy import Law
from auv_gym.task.space import SPACE, Observation


@dataclass(frozen=True)
class SpaceOpenLoop(Law):
    """The forces of the reference times `share`: 1 without feedback, 0 for learning from scratch."""

    layout: ClassVar[Layout] = SPACE.layout
    share: float = 1.0

    def forces(self, o: Sequence[Number], ns: Namespace = FLOATS) -> tuple[Number, Number, Number]:
        """Return F_u [N], F_q [N m], F_r [N m]."""
        seen = Observation._make(o)
        return self.share * seen.F_uR, self.share * seen.F_qR, self.share * seen.F_rR

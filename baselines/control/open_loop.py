"""Policies without feedback: the planner's forces, or zero, for learning from scratch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from auv_gym.physics.namespaces import FLOATS, Namespace, Number
from auv_gym.task.observation import Observation
from auv_gym.task.policy import Law

NO_EXPERT = "none"
"""Name of `Zero` as an expert."""
F_UR = Observation._fields.index("F_uR")  # index of the reference's surge force among the terms
F_RR = Observation._fields.index("F_rR")  # index of the reference's yaw torque


@dataclass(frozen=True)
class OpenLoop(Law):
    """The forces of the reference, F_uR and F_rR (16), without feedback."""

    def forces(self, o: Sequence[Number], ns: Namespace = FLOATS) -> tuple[Number, Number]:
        """Return F_uR [N], F_rR [N m]."""
        return o[F_UR], o[F_RR]


@dataclass(frozen=True)
class Zero(Law):
    """Zero forces."""

    def forces(self, o: Sequence[Number], ns: Namespace = FLOATS) -> tuple[Number, Number]:
        """Return zeros [N], [N m], of the shape of the terms."""
        return 0.0 * o[F_UR], 0.0 * o[F_RR]

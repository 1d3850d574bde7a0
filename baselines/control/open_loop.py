"""Without feedback: the planner's forces, or none at all, for learning from scratch."""

from __future__ import annotations

from collections.abc import Sequence

from auv_gym.physics.namespaces import FLOATS, Namespace, Number
from auv_gym.task.observation import Observation
from auv_gym.task.policy import Law

NO_EXPERT = "none"
"""Name of `Zero` where an expert is named."""
F_UR = Observation._fields.index("F_uR")  # where the reference's surge force stands among the terms
F_RR = Observation._fields.index("F_rR")  # where its yaw torque stands


class OpenLoop(Law):
    """Applies F_uR and F_rR (16), whatever the errors are."""

    def forces(self, o: Sequence[Number], ns: Namespace = FLOATS) -> tuple[Number, Number]:
        """Return F_uR [N], F_rR [N m]."""
        return o[F_UR], o[F_RR]


class Zero(Law):
    """Commands nothing."""

    def forces(self, o: Sequence[Number], ns: Namespace = FLOATS) -> tuple[Number, Number]:
        """Return zeros [N], [N m], of the shape that the terms have."""
        return 0.0 * o[F_UR], 0.0 * o[F_RR]

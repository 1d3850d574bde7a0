"""What a teacher knows of vehicle, actuators and disturbances, and a student has to estimate.

Kumar et al. (2021), "RMA: rapid motor adaptation for legged robots", call it the extrinsics. Nothing in it
depends on what the vehicle does, so no slope goes through it; of a sheared current it is the mean.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from auv_gym.physics.errors import to_body
from auv_gym.physics.namespaces import ARRAYS, AnyArray
from auv_gym.physics.rows import filled
from auv_gym.physics.vehicle import LIFT, Coefficients, Vehicle
from auv_gym.task.simulation import SAMPLE, Parameters, Parts
from baselines.agents.features import LARGEST_FEATURE
from baselines.policy import reference_speed

EXTRINSICS = (
    *(name for name in Coefficients._fields if name not in LIFT),  # of the true vehicle, against the known one's
    *("V_u", "V_v"),  # current, along and across the reference's heading
    *("X", "Y", "N"),  # external load
    *("lag", "effect_u", "effect_r", "reach_u", "reach_r", "delay"),  # of the actuators
)
"""What the rows are, in their order; each is of the size of 1."""


def extrinsics(samples: AnyArray, constants: AnyArray, known: Vehicle) -> AnyArray:
    """Return the extrinsics of every instant of a window, shape (T, len(EXTRINSICS), N).

    Args:
        samples: what acts from each instant to the next, rows of `simulation.Sample`, shape (T, SAMPLE_ROWS, N).
        constants: the rows of `simulation.Parameters`, shape (PARAMETER_ROWS, N).
        known: the vehicle that expert and planner believe in.
    """
    s, p = filled(SAMPLE, tuple(samples.swapaxes(0, 1))), Parameters.of(tuple(constants), Parts())
    U = reference_speed(s.u_R, s.v_R, ARRAYS)
    along, across = to_body(s.V_x, s.V_y, np.cos(s.psi_R), np.sin(s.psi_R))
    rows = (
        *_against(p.coefficients.without_lift, known.coefficients.without_lift),
        *(2 * along / U, 2 * across / U),
        *(8 * s.X / p.F_u_max, 8 * s.Y / p.F_u_max, 8 * s.N / p.F_r_max),
        1 - p.response.gain,
        *(4 * (1 - p.thrust_u / p.F_u_max), 4 * (1 - p.thrust_r / p.F_r_max)),
        *(2 * (1 - np.minimum(p.reach_u, 1.0)), 2 * (1 - np.minimum(p.reach_r, 1.0)), p.delay / 3),
    )
    return np.stack(
        [np.broadcast_to(np.clip(row, -LARGEST_FEATURE, LARGEST_FEATURE), s.X.shape) for row in rows], axis=1
    )


def _against(true: Sequence[Any], known: Sequence[Any]) -> list[Any]:
    """Return masses and drag against the known ones; quadratic drag against the linear one, at 1 m/s."""
    ratios = [5 * (a / b - 1) for a, b in zip(true[:6], known[:6], strict=True)]
    return ratios + [(a - b) / linear for a, b, linear in zip(true[6:], known[6:], known[3:6], strict=True)]

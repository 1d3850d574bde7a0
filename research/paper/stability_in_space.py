"""Local stability of the law in space: the closed loop, linearised about steady motion on a helix or a straight line.

The derivatives are exact: those of the code generator, not differences.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from auv_gym.codegen.derivatives import directional, jacobian
from auv_gym.codegen.graph import SYMBOLS
from auv_gym.codegen.kernel import Kernel
from auv_gym.physics.namespaces import Array
from auv_gym.physics.space import SpaceVehicle, state_rates, tracking_errors
from auv_gym.planning.paths import Circle, Line
from auv_gym.planning.paths.space import Climb, WithHeight
from auv_gym.planning.space import plan
from baselines.control.backstepping import Gains
from baselines.space.backstepping import Wanted, tracking_forces


def steady_motion(vehicle: SpaceVehicle, speed: float, turn_rate: float, climb: float) -> Array:
    """Return the reference of steady motion at one instant, a row of `SpaceReference.table`, shape (13,).

    Args:
        vehicle: the vehicle.
        speed: path speed [m/s], positive.
        turn_rate: [rad/s], counter-clockwise seen from above; 0 for a straight line.
        climb: angle [rad] of the path above the horizontal plane.
    """
    level = speed * math.cos(climb)
    path = WithHeight(Circle(level, turn_rate) if turn_rate else Line(level), Climb(speed * math.sin(climb)))
    row: Array = plan(path, vehicle, np.array([0.0, 1.0])).table[0]
    return row


def closed_loop_eigenvalues(
    vehicle: SpaceVehicle, gains: Gains, speed: float, turn_rate: float, climb: float
) -> NDArray[np.complex128]:
    """Return the ten eigenvalues [1/s] of the loop with the law, whose nominal vehicle is the true one.

    The least stable comes first. For the arguments see `steady_motion`.
    """

    def equation(state: Sequence[Any], reference: Sequence[Any]) -> Mapping[str, Sequence[Any]]:
        pose, forces = reference[:10], reference[10:]
        errors = tracking_errors(state, pose, SYMBOLS)
        wanted = Wanted(pose[3], *pose[5:], *forces)
        F_u, F_q, F_r = tracking_forces(errors, state[3], wanted, vehicle, gains, ns=SYMBOLS)
        rates = state_rates(state, (F_u, 0.0, 0.0, F_q, F_r), vehicle.acting, ns=SYMBOLS)
        moving = state_rates(pose, (forces[0], 0.0, 0.0, *forces[1:]), vehicle.acting, ns=SYMBOLS)
        by_time = {x.index: rate for x, rate in zip((*state, *pose), (*rates, *moving), strict=True)}
        after = directional(errors, by_time)
        return {name: [x for row in jacobian(of, state) for x in row] for name, of in (("A", after), ("E", errors))}

    reference = steady_motion(vehicle, speed, turn_rate, climb)
    kernel = Kernel.traced(equation, {"state": 10, "reference": 13})
    matrices = kernel(state=reference[:10, None], reference=reference[:, None])
    by_state, errors = (matrices[name].reshape(10, 10) for name in ("A", "E"))
    values = np.linalg.eigvals(by_state @ np.linalg.inv(errors)).astype(np.complex128)
    return values[np.lexsort((values.imag, -values.real))]


def spectral_abscissa(vehicle: SpaceVehicle, gains: Gains, speed: float, turn_rate: float, climb: float) -> float:
    """Return the largest real part [1/s] of `closed_loop_eigenvalues`; it is negative for a stable loop."""
    return float(closed_loop_eigenvalues(vehicle, gains, speed, turn_rate, climb)[0].real)

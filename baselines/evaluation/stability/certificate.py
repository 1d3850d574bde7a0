"""A certificate of stability: one quadratic Lyapunov function for all references in a box, by a semidefinite solver.

With the path's speed U, the errors e = (e_x/U, e_y/U, psi_e, u_e/U, v_e/U, r_e) about a reference with yaw rate r_R,
sideslip gamma and U'/U = a obey, linearised, e' = A(r_R, gamma, a) e. If P > 0 satisfies the linear matrix inequality

    A^T P + P A + 2 rate P <= 0    for all (r_R, gamma, a) in the box,

small errors fade at least as exp(-rate t) in the norm of P, however fast the reference varies within the box: S. Boyd
et al., *Linear Matrix Inequalities in System and Control Theory*, SIAM, 1994, section 5.1. The speed-normalised law has
the same A at every speed. The inequality is solved on a coarse grid and then checked by eigenvalues on a finer one:
evidence at its points, and local, as every statement about a linearisation is. Where A depends on the speed, a
certificate is of references at that speed, and none is given for U' other than 0.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_continuous_lyapunov

from auv_gym.installation import install
from auv_gym.physics.namespaces import Array
from auv_gym.physics.vehicle import Vehicle
from auv_gym.task.policy import Policy
from baselines.control.linearisation import linearise_about
from baselines.evaluation.stability.analysis import feedback_of

MISSING = f"the certificate needs a semidefinite solver: {install('certificate')}"  # message of an error
COARSE = 3  # points on each axis of r_R and gamma of the grid that a certificate is searched on
FINE = 21  # points of the grid that it is checked on; A is affine in U'/U, whose two ends are enough
SAME = 0.01
"""Largest difference between the loops at two speeds of a law that acts alike at all: single precision makes some."""
HALVINGS = 12
"""Of the interval that holds the largest rate."""
BY_SPEED = np.diag((1.0, 1.0, 0.0, 1.0, 1.0, 0.0))
"""What of the errors is divided by the speed."""


@dataclass(frozen=True)
class Box:
    """What references may do."""

    turn_rate: float  # [rad/s] largest |r_R|
    sideslip: float  # [rad] largest |gamma|
    acceleration: float = 0.0  # [1/s] largest |U'/U|

    def __str__(self) -> str:
        return f"|r_R| <= {self.turn_rate:g}, |gamma| <= {self.sideslip:g}, |U'/U| <= {self.acceleration:g}"


BOXES = (Box(0.1, 0.22), Box(0.1, 0.22, 0.05), Box(0.3, 0.57))  # those that are certified


@dataclass(frozen=True)
class Certificate:
    """What is certified of a policy for references of one speed in a box."""

    box: Box
    speed: float  # [m/s] U
    rate: float | None  # [1/s] verified on the fine grid; None: no quadratic function was found
    P: list[list[float]] | None  # of the scaled errors, its trace 6


def installed() -> bool:
    """Return whether the solver is there."""
    try:
        import cvxpy  # noqa: F401
    except ImportError:
        return False
    return True


def certify(vehicle: Vehicle, policy: Policy, speed: float, box: Box, dt: float) -> Certificate:
    """Return the certificate of the largest rate.

    Args:
        vehicle: the vehicle, known exactly.
        policy: what acts, without memory.
        speed: U [m/s].
        box: what the references may do.
        dt: control period that the policy is told [s].

    Raises:
        ImportError: the solver is missing.
        ValueError: the policy has a memory.
    """
    coarse = loops(vehicle, policy, speed, box, dt, COARSE)
    alike = box.acceleration == 0 or np.allclose(coarse, loops(vehicle, policy, 2 * speed, box, dt, COARSE), atol=SAME)
    P = largest_rate(coarse) if alike else None
    rate = 0.0 if P is None else decay_rate(P, loops(vehicle, policy, speed, box, dt, FINE))
    return Certificate(box, speed, None, None) if P is None or rate <= 0 else Certificate(box, speed, rate, P.tolist())


def loops(vehicle: Vehicle, policy: Policy, speed: float, box: Box, dt: float, points: int) -> Array:
    """Return A(r_R, gamma, a) on a grid over the box, shape (N, 6, 6); the arguments are those of `certify`."""
    feedback, step = feedback_of(policy, dt)
    scale = np.diag(1 + (speed - 1) * np.diag(BY_SPEED))
    found: list[Array] = []
    axes = (np.linspace(-end, end, points).tolist() for end in (box.turn_rate, box.sideslip))
    for r_R, gamma in itertools.product(*axes):
        reference = (speed * np.cos(gamma), speed * np.sin(gamma), r_R, 0.0, 0.0)
        loop = linearise_about(vehicle, feedback, reference, step)
        A = np.linalg.solve(scale, (loop.A + loop.B @ loop.K) @ scale)
        found += [A - a * BY_SPEED for a in {box.acceleration, -box.acceleration}]
    return np.array(found)


def decay_rate(P: Array, A: Array) -> float:
    """Return the largest rate [1/s] with A_i^T P + P A_i + 2 rate P <= 0 for all A of shape (N, 6, 6), P > 0."""
    inverse = np.linalg.inv(np.linalg.cholesky(P))
    symmetric = inverse @ (A.transpose(0, 2, 1) @ P + P @ A) @ inverse.T
    return -0.5 * float(np.linalg.eigvalsh(symmetric).max())


def largest_rate(A: Array) -> Array | None:
    """Return the P, shape (6, 6), that certifies the largest rate for all A of shape (N, 6, 6); None if none does.

    Raises:
        ImportError: the solver is missing.
    """
    middle = A.mean(axis=0)  # stable if there is such a P
    least = min(-_abscissa(matrix) for matrix in (*A, middle))
    if least <= 0:
        return None
    # In coordinates where the middle of the box is well conditioned, the solver needs no help with units.
    start = solve_continuous_lyapunov((middle + 0.5 * least * np.eye(6)).T, -np.eye(6))
    T = np.linalg.cholesky(start).T
    feasible = _Feasibility(T @ A @ np.linalg.inv(T))
    low, high, best = 0.0, least, feasible.at(0.0)
    for _ in range(HALVINGS):
        rate = 0.5 * (low + high)
        if (P := feasible.at(rate)) is None:
            high = rate
        else:
            low, best = rate, P
    if best is None:
        return None
    P = T.T @ best @ T
    return np.asarray(6 * P / np.trace(P))


def _abscissa(matrix: Array) -> float:
    return float(np.linalg.eigvals(matrix).real.max())


class _Feasibility:
    """The inequality as a semidefinite program in P, its rate a parameter."""

    def __init__(self, A: Array) -> None:
        try:
            import cvxpy as cp
        except ImportError as error:
            raise ImportError(MISSING) from error
        self._A, self._errors = A, cp.SolverError
        self._P, self._rate, margin = cp.Variable((6, 6), symmetric=True), cp.Parameter(nonneg=True), cp.Variable()
        identity = np.eye(6)
        constraints = [cp.trace(self._P) == 6, self._P >> margin * identity]
        constraints += [
            -(matrix.T @ self._P + self._P @ matrix + 2 * self._rate * self._P) >> margin * identity for matrix in A
        ]
        self._problem: Any = cp.Problem(cp.Maximize(margin), constraints)

    def at(self, rate: float) -> Array | None:
        """Return a P for a rate [1/s], checked by its eigenvalues; None if the solver finds none."""
        self._rate.value = rate
        try:
            self._problem.solve(solver="CLARABEL")
        except self._errors:
            return None
        P: NDArray[np.float64] | None = self._P.value
        if P is None or np.linalg.eigvalsh(P)[0] <= 0:
            return None
        return P if decay_rate(P, self._A) >= rate else None


def certificates(
    vehicle: Vehicle, policy: Policy, speeds: Sequence[float], boxes: Sequence[Box], dt: float
) -> list[Certificate]:
    """Return the certificates in each box, at each speed; see `certify`."""
    return [certify(vehicle, policy, speed, box, dt) for box in boxes for speed in speeds]

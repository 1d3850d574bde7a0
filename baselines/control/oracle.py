"""The oracle: plant, current, waves and actuators are known, now and in future; the score's 1.

It plans in the water frame with the true vehicle: where the water moves with c(t), the vehicle has to move through it
with p_R' - c, whose rates are p_R'' - c', p_R''' - c''. The waves' sway force enters the equation of the sideslip,
the rest of them is cancelled by the forces. Errors of the true state are fed back by a linear-quadratic regulator for
the true vehicle. A command is such that the mean force over the period is the wanted one in spite of the lag; where it
comes late, it is made for the state foretold. The current of a shear is that on the path.

It is a reference, not a bound: others may be better in single episodes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from auv_gym.episode import Episode
from auv_gym.errors import to_body, tracking_errors
from auv_gym.namespaces import ARRAYS
from auv_gym.paths import evaluate
from auv_gym.planner import PathRates, assemble, path_rates, sideslip_rest, sideslip_step, sideslip_terms, slow_sideslip
from auv_gym.scenario import Scenario
from auv_gym.vehicle import Coefficients, Vehicle
from baselines.control.truth import Array, Truth, nothing_sent
from baselines.policy import is_fast


@dataclass(frozen=True)
class Weights:
    """What the regulator thinks equally bad: an error of the position, a force, a torque."""

    position: float  # [m] on each axis
    F_u: float  # [N]
    F_r: float  # [N m]


WEIGHTS = {"slow": Weights(0.1, 50.0, 25.0), "cruise": Weights(0.9, 200.0, 90.0)}
"""Weights in each regime, for a small tail error on the validation split of benchmark-v1 without losing an episode."""
BLIND = "the oracle needs prepare() before the reset and observe() before predict(), as evaluate.py calls them"
NEGLIGIBLE = 1e-6
"""Weight of the other errors, for a Riccati equation that is well posed."""
LARGEST_SINE = 0.93
"""Largest sine of the sideslip: 1.2 rad."""
HARDEST_BRAKING = 0.35
"""Largest braking -V'/V through the water [1/s]."""


SMOOTHING = 0.2
"""Width [s] of the Gauss filter on the current, whose gusts are too rough to be differentiated twice."""


@dataclass(frozen=True)
class TruePlan:
    """What keeps N vehicles on their paths: at K + 1 instants, and in the middle of the K periods between them."""

    state: Array  # x, y, psi, u, v, r relative to the water at the instants, shape (K + 1, 6, N)
    force: Array  # F_u [N], F_r [N m], means over the periods, shape (K, 2, N)
    truth: Truth


class Oracle:
    """The oracle as a privileged policy, see `baselines.evaluation.rollout.Privileged`."""

    def __init__(self) -> None:
        self._plan: TruePlan | None = None
        self._action = np.zeros((0, 2), dtype=np.float32)

    def prepare(self, scenario: Scenario, episodes: Sequence[Episode]) -> None:
        """Plan for N episodes that are to run side by side."""
        self._plan = true_plan(scenario, episodes)
        speeds = np.hypot(self._plan.state[:, 3], self._plan.state[:, 4]).mean(axis=0)
        self._gains = np.array(
            [
                regulator(e.vehicle, V, WEIGHTS["cruise" if is_fast(e.path.speed, 0.0) else "slow"])
                for e, V in zip(episodes, speeds.tolist(), strict=True)
            ]
        )
        self._dt = scenario.control_dt
        p = self._plan.truth.parameters
        self._limits, self._reach = np.stack((p.thrust_u, p.thrust_r)), np.stack((p.reach_u, p.reach_r))
        self._sent = nothing_sent(len(episodes))

    def observe(self, env: Any) -> None:
        """Decide on the true state of the vector environment."""
        if self._plan is None:
            raise RuntimeError(BLIND)
        plan, p = self._plan, self._plan.truth.parameters
        k = np.rint(env.time / self._dt).astype(int)
        lanes = np.arange(len(k))
        x, y, psi, u, v, r = env.state.T
        V_x, V_y = env.current.T
        V_u, V_v = to_body(V_x, V_y, np.cos(psi), np.sin(psi))
        now = x, y, psi, u - V_u, v - V_v, r
        *state, F_u, F_r = plan.truth.foretell(now, env.force.T, self._sent, k)
        then = np.minimum(k + p.delay.astype(int), len(plan.force) - 1)
        reference, F_R = plan.state[then, :, lanes].T, plan.force[then, :, lanes].T
        x_e, y_e, *others = tracking_errors(cast(Any, tuple(state)), cast(Any, tuple(reference)), ARRAYS)
        errors = np.stack((*to_body(x_e, y_e, np.cos(state[2]), np.sin(state[2])), *others))
        wanted = F_R + np.einsum("nij,jn->in", self._gains, errors)
        force = np.stack((F_u, F_r))
        command = force + (wanted - force) / (p.response.gain * p.response.mean)
        action = np.clip(command / self._limits, -self._reach, self._reach)
        self._sent = np.concatenate((action[None], self._sent[:-1]))
        self._action = action.T.astype(np.float32)

    def predict(
        self,
        observation: NDArray[Any],
        state: tuple[NDArray[Any], ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[NDArray[Any], ...] | None]:
        """Return the actions (N, 2) decided by the last `observe`, whatever the observation (N, 18) is.

        Raises:
            RuntimeError: nobody has let it look behind the observation.
        """
        if self._plan is None:
            raise RuntimeError(BLIND)
        return self._action, state


def true_plan(scenario: Scenario, episodes: Sequence[Episode]) -> TruePlan:
    """Return the plan of the oracle for N episodes.

    Raises:
        InfeasibleReferenceError: an episode's path cannot be followed in still water.
    """
    from scipy.ndimage import gaussian_filter1d

    dt, truth = scenario.control_dt, Truth.of(scenario, episodes)
    vehicle = fleet([e.vehicle for e in episodes])
    outside = truth.samples[:, 8:13]
    V, load = _halfway(outside[:, :2]), _halfway(outside[:, 2:])  # on a grid of half periods
    V = gaussian_filter1d(V, SMOOTHING / (0.5 * dt), axis=0, mode="nearest")
    times: Array = 0.5 * dt * np.arange(len(V), dtype=np.float64)
    motion = evaluate([e.path for e in episodes], times)
    V += np.stack(truth.parameters.shear.velocity(motion[0, 0], motion[0, 1], ARRAYS), axis=1)
    for order in range(1, 4):
        motion[order] -= V.transpose(1, 0, 2)
        V = np.gradient(V, 0.5 * dt, axis=0)
    along = path_rates(motion)
    along = replace(along, v_p_dot=np.maximum(along.v_p_dot, -HARDEST_BRAKING * along.v_p))
    Y = load[:, 1]
    w = _sine_of_sideslip(along, vehicle, Y, 0.5 * dt)
    R = assemble(times, motion[0], along, w, vehicle, (Y, np.gradient(Y, 0.5 * dt, axis=0)))
    return TruePlan(
        np.stack((R.x, R.y, R.psi, R.u, R.v, R.r), axis=1)[::2],
        np.stack((R.F_u - load[:, 0], R.F_r - load[:, 2]), axis=1)[1::2],
        truth,
    )


def regulator(vehicle: Vehicle, speed: float, w: Weights) -> Array:
    """Return the gains, shape (2, 6), from errors in the body frame to forces, on a straight line at a speed [m/s]."""
    from scipy.linalg import solve_continuous_are

    from baselines.evaluation.stability.analysis import linearise

    loop = linearise(vehicle, lambda o: (0.0 * o[0], 0.0 * o[0]), speed, 0.0)
    Q = np.diag([w.position**-2, w.position**-2, *(NEGLIGIBLE,) * 4])
    R = np.diag([w.F_u**-2, w.F_r**-2])
    P = solve_continuous_are(loop.A, loop.B, Q, R)
    return np.asarray(-np.linalg.solve(R, loop.B.T @ P))


def fleet(vehicles: Sequence[Vehicle]) -> Vehicle:
    """Return N vehicles as one whose parameters are rows (N,), for equations that work on rows."""
    rows = Coefficients(*np.array([vehicle.coefficients for vehicle in vehicles]).T)
    return cast(Vehicle, SimpleNamespace(coefficients=rows, **rows._asdict()))


def _halfway(rows: Array) -> Array:
    """Return what is held over the periods that end at K + 1 instants, at instants and in between: 2 K + 1 rows."""
    half = np.empty((2 * len(rows) - 1, *rows.shape[1:]))
    half[1::2] = rows[1:]
    half[2:-1:2] = 0.5 * (rows[1:-1] + rows[2:])
    half[0], half[-1] = rows[1], rows[-1]
    return half


def _sine_of_sideslip(along: PathRates, vehicle: Vehicle, Y: Array, h: float) -> Array:
    """Integrate Dm w' = -d22 w + rest(w) + Y/v_p over rows h [s] apart; `planner` says how it comes about."""
    Dm = vehicle.m22 - vehicle.m11
    slope, square, turn = (h / Dm * term for term in sideslip_terms(along, vehicle))
    push = h / Dm * Y / along.v_p

    def rest_of(w: Array, j: int) -> Array:
        return np.asarray(sideslip_rest(slope[j], square[j], turn[j], w, np.sqrt) + push[j])

    w = np.empty_like(push)
    w[0] = np.clip(slow_sideslip(along, vehicle), -LARGEST_SINE, LARGEST_SINE)
    rest = rest_of(w[0], 0)
    for j in range(1, len(w)):
        w[j], rest = sideslip_step(w[j - 1], rest, partial(rest_of, j=j), vehicle.d22 / Dm * h, LARGEST_SINE)
    return w

"""The oracle: a regulator with full information about vehicle, actuators, current and waves.

It has score 1 in the oldest suites.

It plans in the water frame with the true vehicle: in water that moves with c(t), the velocity through the water is
p_R' - c, with the rates p_R'' - c' and p_R''' - c''. The sway force of the waves enters the equation of the sideslip;
their other loads are cancelled by the actuators' forces. A linear-quadratic regulator for the true vehicle feeds back
errors of the true state. The command compensates the actuators' lag, so that the mean force in the period is the
desired one. With a delay, the command is computed for the predicted state. In a shear the plan uses the current on the
path. Each episode is simulated beforehand; if it diverges, its regulator is replaced by one with lower gains.

Numbers with units are for the paper's vehicle; for another vehicle they are scaled by `auv_gym.physics.units`.

The oracle is a reference and not a bound: other policies can have lower errors in single episodes. The policy
`clairvoyant` is a bound.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from types import SimpleNamespace
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from auv_gym.codegen.graph import SYMBOLS
from auv_gym.codegen.kernel import Kernel
from auv_gym.effects.actuators import LEAST_SHARE, Fins, Reach, fin_share
from auv_gym.effects.current import Shear
from auv_gym.physics.dynamics import State
from auv_gym.physics.errors import to_body, tracking_errors
from auv_gym.physics.namespaces import ARRAYS, Array
from auv_gym.physics.units import POWERS, Units
from auv_gym.physics.vehicle import Coefficients, Vehicle
from auv_gym.planning.paths import evaluate_paths
from auv_gym.planning.planner import BETA, Reference
from auv_gym.planning.sideslip import (
    RATES,
    PathRates,
    in_sideslip,
    path_rates,
    sideslip_rest,
    sideslip_step,
    sideslip_terms,
    steady_sideslip,
)
from auv_gym.scenarios.episode import Episode
from auv_gym.scenarios.scenario import Scenario
from auv_gym.task.simulation import CURRENT, LOAD, constants_of, start, step
from baselines.control.linearisation import error_dynamics
from baselines.control.privileged.truth import FullInformationPolicy, Truth, no_actions
from baselines.estimation.water_frame import with_limited_braking
from baselines.policy import is_fast


@dataclass(frozen=True)
class RegulatorWeights:
    """Position error, force and torque that have the same cost (Bryson's rule)."""

    position: float  # [m] on each axis
    F_u: float  # [N]
    F_r: float  # [N m]


REGULATORS = {"slow": RegulatorWeights(0.1, 50.0, 25.0), "cruise": RegulatorWeights(0.9, 200.0, 90.0)}
"""Weights for each speed range. They minimise the steady-state error on validation episodes, of which none fails."""
_NEGLIGIBLE = 1e-6  # weight of the other states, for a well-posed Riccati equation
SOFTER = (2.0, 4.0)
"""Factors on `RegulatorWeights.position`, tried in turn if an episode diverges under the regulator."""
DIVERGED = 5.0  # [m] root mean square of the predicted position error from which an episode counts as diverged
_LARGEST_SINE = 0.93
"""Largest sine of the sideslip in a plan; a little less than that of `water_frame`."""
_HARDEST_BRAKING = 0.35
"""Largest deceleration -V'/V through the water [1/s]; a little less than that of `water_frame` for the paper's
vehicle."""
SMOOTHING = 0.2
"""Standard deviation [s] of the Gaussian filter on the current, whose gusts cannot be differentiated twice."""


@dataclass(frozen=True)
class TruePlan:
    """Plan for N vehicles in their true disturbances, with states at K + 1 instants and forces in the K periods."""

    state: Array  # x, y, psi, u, v, r relative to the water at the instants, shape (K + 1, 6, N)
    force: Array  # F_u [N], F_r [N m], means over the periods, shape (K, 2, N)
    truth: Truth
    units: Units  # of the nominal vehicle


class Oracle(FullInformationPolicy):
    """The oracle as a privileged policy, see `baselines.policy.Privileged`."""

    def _prepared(self, scenario: Scenario, episodes: Sequence[Episode]) -> Truth:
        self._plan = true_plan(scenario, episodes)
        self._gains = stable_gains(scenario, episodes, self._plan)
        return self._plan.truth

    def _actions(self, state: State, force: Array, sent: Array, k: NDArray[np.int64]) -> Array:
        return regulator_actions(self._plan, self._gains, state, force, sent, k)


def regulator_actions(
    plan: TruePlan, gains: Array, state: State, force: Array, sent: Array, k: NDArray[np.int64]
) -> Array:
    """Return the actions of N vehicles, shape (2, N).

    The desired mean force over the period in which the command acts is that of the plan, plus the gains times the
    errors predicted for the beginning of this period. The command compensates the actuators' lag.

    Args:
        plan: of the vehicles' episodes.
        gains: of their regulators, shape (N, 2, 6).
        state: x, y, psi, u, v, r relative to the water, rows (N,).
        force: F_u [N], F_r [N m] of the actuators, shape (2, N).
        sent: the last actions, see `Truth.state_after_delay`.
        k: the control step of each episode, shape (N,).
    """
    p, columns = plan.truth.parameters, np.arange(len(k))
    *then, F_u, F_r = plan.truth.state_after_delay(state, force, sent, k)
    acting = np.minimum(k + np.asarray(plan.truth.delay, dtype=np.int64), len(plan.force) - 1)
    target, feedforward = plan.state[acting, :, columns].T, plan.force[acting, :, columns].T
    x_e, y_e, psi_e, *velocity_errors = tracking_errors(cast(Any, tuple(then)), cast(Any, tuple(target)), ARRAYS)
    psi = then[2]
    errors = np.stack((*to_body(x_e, y_e, np.cos(psi), np.sin(psi)), psi_e, *velocity_errors))
    mean, applied = feedforward + np.einsum("nij,jn->in", gains, errors), np.stack((F_u, F_r))
    command = applied + (mean - applied) / (p.response.gain * p.response.mean)
    share = fin_share(then[3], np.asarray(constants_of(p, Fins).fin), p.F_r_max, ARRAYS)
    torque = p.thrust_r * np.maximum(share, LEAST_SHARE)
    limits = np.stack((p.thrust_u, torque))
    reach = np.stack([np.broadcast_to(own.level, len(k)) for own in constants_of(p, Reach)])
    return np.asarray(np.clip(command / limits, -reach, reach))


def stable_gains(scenario: Scenario, episodes: Sequence[Episode], plan: TruePlan) -> Array:
    """Return the gains of N regulators, shape (N, 2, 6), lower in episodes that would diverge otherwise.

    High gains with a saturated torque and a slow actuator can make a fast vehicle spin without end. A simulation of the
    whole episode shows this beforehand.
    """
    gains = regulators(episodes, plan)
    error = oracle_run(plan, gains, episodes).error
    for softer in SOFTER:
        diverged = np.flatnonzero(error > DIVERGED * plan.units.length)
        if not diverged.size:
            break
        chosen = [episodes[i] for i in diverged.tolist()]
        part = true_plan(scenario, chosen)
        tried = regulators(chosen, part, softer)
        tried_error = oracle_run(part, tried, chosen).error
        stable = tried_error < DIVERGED * plan.units.length
        gains[diverged[stable]], error[diverged[stable]] = tried[stable], tried_error[stable]
    return gains


def regulators(episodes: Sequence[Episode], plan: TruePlan, softer: float = 1.0) -> Array:
    """Return the gains of N regulators, shape (N, 2, 6); `softer` multiplies `RegulatorWeights.position`."""
    gains, unit = [], plan.units.factor(*POWERS["m/s"])
    for episode, speed in zip(
        episodes, np.hypot(plan.state[:, 3], plan.state[:, 4]).mean(axis=0).tolist(), strict=True
    ):
        w = REGULATORS["cruise" if is_fast(episode.path.speed / unit, 0.0) else "slow"]
        gains.append(regulator(episode.vehicle, speed, replace(w, position=softer * w.position), plan.units))
    return np.array(gains)


class OracleRun(NamedTuple):
    """Results of a simulation of N whole episodes, K control periods each."""

    error: Array  # [m] root mean square of the position errors, shape (N,)
    actions: Array  # shape (K, 2, N)


def oracle_run(plan: TruePlan, gains: Array, episodes: Sequence[Episode]) -> OracleRun:
    """Return the results of regulators with these gains, shape (N, 2, 6), in N simulated episodes."""
    p, samples = plan.truth.parameters, plan.truth.samples
    initial = [e.initial_state(R) for e, R in zip(episodes, samples[0, :4].T.tolist(), strict=True)]
    plant, _ = start(cast(State, tuple(np.array(initial).T)), tuple(samples[0]), p, ARRAYS)
    sent, square, actions = no_actions(len(episodes)), np.zeros(len(episodes)), np.empty_like(plan.force)
    with np.errstate(over="ignore", invalid="ignore"):  # a failed episode does not end here
        for k in range(len(plan.force)):
            x, y, psi, u, v, r, F_u, F_r, *_ = plant
            now = np.full(len(episodes), k)
            action = regulator_actions(plan, gains, (x, y, psi, u, v, r), np.stack((F_u, F_r)), sent, now)
            sent, actions[k] = np.concatenate((action[None], sent[:-1])), action
            plant, _, _ = step(plant, tuple(action), tuple(samples[k + 1]), p, ARRAYS)
            square += ((np.stack(plant[:2]) - plan.state[k + 1, :2]) ** 2).sum(axis=0)
    return OracleRun(np.where(np.isfinite(square), np.sqrt(square / len(plan.force)), np.inf), actions)


def true_plan(scenario: Scenario, episodes: Sequence[Episode]) -> TruePlan:
    """Return the plan of the oracle for N episodes.

    Raises:
        InfeasibleReferenceError: an episode's path cannot be followed in still water.
    """
    from scipy.ndimage import gaussian_filter1d

    dt, truth, units = scenario.control_dt, Truth.of(scenario, episodes), Units.of(scenario.vehicle)
    vehicle = stacked_vehicles([e.vehicle for e in episodes])
    V, load = _half_periods(truth.samples[:, CURRENT]), _half_periods(truth.samples[:, LOAD])
    V = gaussian_filter1d(V, SMOOTHING * units.time / (0.5 * dt), axis=0, mode="nearest")
    times: Array = 0.5 * dt * np.arange(len(V), dtype=np.float64)
    motion = evaluate_paths([e.path for e in episodes], times)
    x, y = motion[0]
    V += np.stack(constants_of(truth.parameters, Shear).velocity(x, y, ARRAYS), axis=1)
    for order in range(1, 4):
        motion[order] -= V.transpose(1, 0, 2)
        V = np.gradient(V, 0.5 * dt, axis=0)
    along = with_limited_braking(path_rates(motion), _HARDEST_BRAKING / units.time)
    X, Y, N = load.transpose(1, 0, 2)
    w = _sine_of_sideslip(along, vehicle, Y, 0.5 * dt)
    R = assemble(times, motion[0], along, w, vehicle, (Y, np.gradient(Y, 0.5 * dt, axis=0)))
    return TruePlan(
        np.stack((R.x, R.y, R.psi, R.u, R.v, R.r), axis=1)[::2],
        np.stack((R.F_u - X, R.F_r - N), axis=1)[1::2],
        truth,
        units,
    )


def regulator(vehicle: Vehicle, speed: float, w: RegulatorWeights, units: Units) -> Array:
    """Return the gains, shape (2, 6), from errors in the body frame to forces, on a straight line at a speed [m/s].

    The weights are for the paper's vehicle. The Riccati equation is solved in its units, as it would be badly scaled
    for a ship otherwise.
    """
    from scipy.linalg import solve_continuous_are

    x = np.array([units.factor(*POWERS[unit]) for unit in ("m", "m", "rad", "m/s", "m/s", "rad/s")])
    f = np.array([units.factor(*POWERS[unit]) for unit in ("N", "N m")])
    A, B = error_dynamics(vehicle, speed, 0.0, 0.0)
    A, B = units.time * A * x / x[:, None], units.time * B * f / x[:, None]
    Q = np.diag([w.position**-2, w.position**-2, *(_NEGLIGIBLE,) * 4])
    R = np.diag([w.F_u**-2, w.F_r**-2])
    P = solve_continuous_are(A, B, Q, R)
    return np.asarray(-np.linalg.solve(R, B.T @ P) * f[:, None] / x)


def stacked_vehicles(vehicles: Sequence[Vehicle]) -> Vehicle:
    """Return N vehicles as one object with parameters of shape (N,), for equations that accept rows."""
    rows = Coefficients(*np.array([vehicle.coefficients for vehicle in vehicles]).T)
    return cast(Vehicle, SimpleNamespace(coefficients=rows, **rows._asdict()))


def assemble(
    times: Array, position: Array, along: PathRates, w: Array, vehicle: Vehicle, sway_load: tuple[Array, Array]
) -> Reference:
    """Return the states and forces (16) of N vehicles on their paths, for the sines of their sideslips.

    Args:
        times: T times [s].
        position: x, y of the paths at these times [m], shape (2, T, N).
        along: rates of the paths, of shape (T, N).
        w: sine of the sideslip, shape (T, N).
        vehicle: N vehicles as one, whose coefficients are rows of shape (N,).
        sway_load: external force Y along the sway axis [N] in (2b), and its time derivative [N/s], of shape (T, N).
    """
    rows = np.array([getattr(along, name) for name in RATES])
    turns = np.round(np.diff(rows[BETA], axis=0) / (2 * math.pi))
    rows[BETA, 1:] -= 2 * math.pi * np.cumsum(turns, axis=0)  # make the direction continuous
    spread = [np.broadcast_to(number, w.shape) for number in (*vehicle.coefficients, *sway_load)]
    arrays = (np.reshape(part, (len(part), -1)) for part in (rows, w[None], spread[:-2], spread[-2:]))
    motion = _motion_kernel()(**dict(zip(("along", "w", "coefficients", "load"), arrays, strict=True)))["motion"]
    psi, u, v, r, F_u, F_r, gamma = motion.reshape(-1, *w.shape)
    return Reference(times, position[0], position[1], psi, u, v, r, F_u, F_r, gamma, along.v_p, along.omega)


@cache
def _motion_kernel() -> Kernel:
    """Return the kernel of `in_sideslip` for several vehicles."""

    def equation(along: Any, w: Any, coefficients: Any, load: Any) -> dict[str, Any]:
        return {"motion": in_sideslip(PathRates(*along), w[0], Coefficients(*coefficients), tuple(load), SYMBOLS)}

    return Kernel.traced(equation, {"along": len(RATES), "w": 1, "coefficients": len(Coefficients._fields), "load": 2})


def _half_periods(rows: Array) -> Array:
    """Return samples that are constant in the period before each of K + 1 instants on a grid of half periods.

    Values at the instants are the means of both periods. The result has 2 K + 1 rows.
    """
    half = np.empty((2 * len(rows) - 1, *rows.shape[1:]))
    half[1::2] = rows[1:]
    half[2:-1:2] = 0.5 * (rows[1:-1] + rows[2:])
    half[0], half[-1] = rows[1], rows[-1]
    return half


def _sine_of_sideslip(along: PathRates, vehicle: Vehicle, Y: Array, h: float) -> Array:
    """Integrate Dm w' = -d22 w + rest(w) + Y/v_p over rows h [s] apart; `planner` has the derivation."""
    Dm = vehicle.coefficients.slip_mass
    terms = [h / Dm * term for term in sideslip_terms(along, vehicle)]
    push = h / Dm * Y / along.v_p

    def rest_of(w: Array, j: int) -> Array:
        return np.asarray(sideslip_rest([term[j] for term in terms], w, np.sqrt) + push[j])

    w = np.empty_like(push)
    first = PathRates(*(getattr(along, name)[0] for name in RATES))
    w[0] = np.clip(steady_sideslip(first, vehicle, ARRAYS), -_LARGEST_SINE, _LARGEST_SINE)
    rest = rest_of(w[0], 0)
    for j in range(1, len(w)):
        w[j], rest = sideslip_step(w[j - 1], rest, partial(rest_of, j=j), vehicle.d22 / Dm * h, _LARGEST_SINE)
    return np.asarray(w)

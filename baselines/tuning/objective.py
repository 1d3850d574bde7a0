"""The controllers that can be tuned, and the objective: the error on a batch of episodes of several scenarios."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from auv_gym.envs.space import UnderactuatedAUVTrack3DVectorEnv
from auv_gym.envs.track_vector_env import UnderactuatedAUVTrackVectorEnv
from auv_gym.physics.namespaces import Array
from auv_gym.scenarios.fitting import Sea, changed
from auv_gym.scenarios.mixtures import adverse
from auv_gym.scenarios.names import CASES, SPACE_CASES
from auv_gym.scenarios.presets import as_scenario, with_setpoints
from auv_gym.scenarios.scenario import Scenario
from auv_gym.scenarios.vehicles import PAPER, VehicleModel
from auv_gym.task.policy import Policy
from baselines.control import POLICIES, TUNED
from baselines.control.los_setpoints import LosGains
from baselines.control.nmpc.controller import NMPC_ADVERSE_GAINS, NMPC_GAINS
from baselines.evaluation.metrics import Ended, effort, smoothness, steady_rmse
from baselines.evaluation.rollout import Begun, Repeatable
from baselines.evaluation.score import ERROR_CAPS, capped, has_failed
from baselines.space import SPEED_RANGE
from baselines.space import TUNED as TUNED_IN_SPACE
from baselines.space import tuned as tuned_in_space
from baselines.space.los_setpoints import space_los_setpoints


class Maker(Protocol):
    """Factory of a policy with the same gains at every speed."""

    def __call__(self, gains: dict[str, float], vehicle: Any = ...) -> Policy:
        """Return the policy for a nominal vehicle, by default the paper's."""


@dataclass(frozen=True)
class Tunable:
    """A controller whose gains can be tuned."""

    factory: Maker
    names: Sequence[str]  # of the gains
    world: str = "plain"  # see `tuning_scenarios`


def _tunable(name: str, names: Sequence[str]) -> Tunable:
    """Return the entry of a controller whose factory takes gains; a fault-tolerant one is tuned with faults."""
    factory, _, options, *_ = POLICIES[name]
    world = "adverse" if name.endswith("-adverse") else "setpoints" if POLICIES[name].setpoints else "plain"
    return Tunable(partial(factory, **options), names, world)


TUNABLES: dict[str, Tunable] = {
    **{name: _tunable(name, names) for name, (names, _) in TUNED.items()},
    "nmpc": _tunable("nmpc", NMPC_GAINS),
    "nmpc-adverse": _tunable("nmpc-adverse", NMPC_ADVERSE_GAINS),
    "los-setpoints": _tunable("los-setpoints", LosGains._fields),
}
"""The controllers that can be tuned, by name: add an entry here. It includes those of `TUNED`."""


SPACE_TUNABLES: dict[str, Tunable] = {
    **{name: Tunable(partial(tuned_in_space, name), names) for name, (names, _) in TUNED_IN_SPACE.items()},
    "los-setpoints": Tunable(space_los_setpoints, LosGains._fields, "setpoints"),
}
"""The controllers in space that can be tuned, by name."""
RATE_PRICE = {"slow": 0.0025, "cruise": 0.0007, "space": 0.0007}
"""Weight [s^2] of the squared rate of the command, beside the error in units of the scenario's `error_scale`. The loss
of the agent `helm` has the same. Without a price a search makes commands rough for a small gain."""


@dataclass(frozen=True)
class TuningResult:
    """The results of a policy in a speed range."""

    cost_m: float  # the objective: mean error plus the price of the command's rate
    error_m: float  # mean over the episodes of the capped steady-state RMSE
    case_error_m: dict[str, float]  # the same by case
    failed: float  # share of failed episodes
    effort: float  # mean square command
    smoothness: float  # mean squared change of the command


MORE = {"storm": 5, "noise": 3}
"""Further scenarios of a cycle in the plane. Most of the error is that of storms, and most of it is that of rare
divergence."""
MORE_IN_SPACE = {"storm": 6, "noise": 4}
"""The same in space."""


def tuning_scenarios(
    speed_range: str,
    world: str,
    vehicle_model: VehicleModel = PAPER,
    sea: Sea = Sea(),  # noqa: B008, it is frozen
) -> tuple[Scenario, ...]:
    """Return the scenarios to tune on; the episodes cycle through them in this order.

    Args:
        speed_range: "slow" or "cruise", or "space".
        world: "plain" for the eight cases of the speed range and `MORE`; "adverse" for these and as many storms with
            faults; "setpoints" for the first ones with an autopilot.
        vehicle_model: the vehicle. The scenarios are in the paper's units, so that caps and gains are comparable.
        sea: current and waves in place of those of the scenarios, in SI units.

    Raises:
        ValueError: its fins have no effect at the speeds of the scenarios.
    """
    in_space = speed_range == SPEED_RANGE
    known, more = (SPACE_CASES, MORE_IN_SPACE) if in_space else (CASES, MORE)
    names = (*known, *(case for case, times in more.items() for _ in range(times)))
    cases = tuple(as_scenario(f"{speed_range}-{case}") for case in names)
    if world == "setpoints":
        cases = tuple(replace(with_setpoints(case), name=case.name) for case in cases)
    every = (*cases, *(adverse(speed_range),) * len(cases)) if world == "adverse" else cases
    if vehicle_model == PAPER and sea == Sea():
        return every
    changed(cases[0], vehicle_model)  # its errors are in SI units
    own, sea = vehicle_model.in_paper_units, sea.in_paper_units(vehicle_model.vehicle)
    adapted = [replace(sea.of(changed(s, own)), name=s.name) for s in every]
    return tuple(replace(s, substeps=max(other.substeps for other in adapted)) for s in adapted)


class TuningEpisodes:
    """A batch of episodes of a speed range, which different policies run repeatedly.

    Args:
        speed_range: "slow" or "cruise", or "space".
        episodes: their number; they cycle through `tuning_scenarios`.
        seed: episode i is drawn with seed + i.
        world: see `tuning_scenarios`.
        vehicle_model: see `tuning_scenarios`.
        sea: see `tuning_scenarios`.
        priced: whether the objective has the price of the command's rate.
    """

    def __init__(
        self,
        speed_range: str,
        episodes: int,
        seed: int,
        world: str = "plain",
        vehicle_model: VehicleModel = PAPER,
        sea: Sea = Sea(),  # noqa: B008, it is frozen
        priced: bool = True,
    ) -> None:
        cycle = tuning_scenarios(speed_range, world, vehicle_model, sea)
        self._names = [cycle[i % len(cycle)].name.removeprefix(f"{speed_range}-") for i in range(episodes)]
        self.cap = ERROR_CAPS[speed_range]
        self.steps, self.lost_distance = cycle[0].steps, cycle[0].lost_distance
        price = RATE_PRICE[speed_range] if priced else 0.0
        channels = len(cycle[0].parts.model.channels)
        self._price = channels * cycle[0].error_scale * price / cycle[0].control_dt ** 2
        # In the plane no episode ends or begins during a run: it has more steps, and a larger `lost_distance`.
        longer = [replace(s, steps=s.steps + 1, lost_distance=64.0) for s in cycle]
        scenarios = [longer[i % len(cycle)] for i in range(episodes)]

        def begin(preview: tuple[int, ...]) -> Begun:
            make = UnderactuatedAUVTrack3DVectorEnv if cycle[0].vertical else UnderactuatedAUVTrackVectorEnv
            env = make(len(scenarios), scenarios, preview=preview)
            return env, env.reset(seed=seed)[0]

        self._episodes = Repeatable(begin)

    def run(self, policy: Policy) -> TuningResult:
        """Return the results of a policy.

        Raises:
            PolicyError: its actions are not finite.
        """
        steady_rmse, failed, actions = self.steady_rmses(policy)
        error, rate = float(steady_rmse.mean()), smoothness(actions)
        return TuningResult(
            cost_m=error + self._price * rate,
            error_m=error,
            case_error_m={name: float(errors.mean()) for name, errors in self.by_case(steady_rmse).items()},
            failed=float(np.mean(failed)),
            effort=effort(actions),
            smoothness=rate,
        )

    def by_case(self, values: Array) -> dict[str, Array]:
        """Return values of the episodes, shape (N,), grouped by case."""
        names = np.array(self._names)
        return {name: values[names == name] for name in dict.fromkeys(self._names)}

    def steady_rmses(self, policy: Policy) -> tuple[Array, NDArray[np.bool_], Array]:
        """Return the capped steady-state RMSE [m] and the failure of each episode, and the commands (steps, N, 2).

        Raises:
            PolicyError: the policy's actions are not finite.
        """
        moments = list(self._episodes.play(policy, self.steps))
        errors, actions = (np.array([getattr(m, key) for m in moments]) for key in ("error", "command"))
        failed = np.any([m.failed for m in moments], axis=0) | (errors.max(axis=0) > self.lost_distance)
        ended = Ended(steady_rmse(errors), failed)
        return capped(ended, self.cap), has_failed(ended, self.cap), actions


def compared(result: TuningResult, expert: TuningResult) -> dict[str, Any]:
    """Return a result as a dict, with the score and the ratios of effort and smoothness relative to the expert."""
    return {
        **asdict(result),
        "expert_error_m": expert.error_m,
        "score": 1 - result.error_m / expert.error_m,
        "effort_ratio": result.effort / expert.effort,
        "smoothness_ratio": result.smoothness / expert.smoothness,
    }

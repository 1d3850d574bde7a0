"""The vector environment: thousands of vehicles side by side on NumPy arrays, through the same step as the scalar one."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from auv_gym.envs.track_env import ReferencePoint
from auv_gym.episode import Episode, checked_options, with_options
from auv_gym.namespaces import ARRAYS
from auv_gym.planner import plan
from auv_gym.scenario import Scenario, as_scenario
from auv_gym.simulation import PARAMETERS, SAMPLE, Parameters, Plant, ground_state, start, step
from auv_gym.tape import Tape
from auv_gym.task import BOUNDS, check_reference, encode_rows
from auv_gym.vehicle import Vehicle

Array = NDArray[np.float64]
Lanes = NDArray[np.int64]

LARGEST_BLOCK = 64  # control steps of tape read at once ...
BLOCK_SAMPLES = 2**18  # ... fewer where that many vehicles times steps are exceeded: it bounds the memory
PLANNED_AT_ONCE = 256  # references planned in one batch, for the same reason


class UnderactuatedAUVTrackVectorEnv(gym.vector.VectorEnv[Array, NDArray[np.float32], NDArray[Any]]):
    """N independent vehicles in one environment; see `UnderactuatedAUVTrackEnv` for the task itself.

    Sub-environment i, reset with seed s, runs the episodes of a scalar environment reset with seed s + i, step by step
    and across autoresets. Autoreset is SAME_STEP: where an episode ends, the observation returned is the first of the
    next one, and `info["final_obs"]`, `info["final_info"]` hold the last of the old.

    Args:
        num_envs: N, the number of vehicles.
        scenario: a scenario, or a sequence of N, one each, with the same number of integration steps a period; each
            may be an object, a dict or a preset's name.
        vehicle: in place of the scenarios' known vehicle.
        control_dt: control period [s] in place of the scenarios'.

    `reset(options=...)` takes what the scalar environment does: `initial_error` and `initial_velocity` of shape (3,) for
    all or (N, 3), `episode` as a sequence of N; and Gymnasium's `reset_mask` (N,).

    Whoever measures reads `env.unwrapped`: `state` (N, 6), `reference` with fields of shape (N,), `force` (N, 2),
    `current` (N, 2) and `time` (N,), as the scalar environment's.

    Raises:
        ValueError: whatever is unknown, impossible or cannot be planned, with the place where.
    """

    metadata: dict[str, Any] = {"render_modes": [], "autoreset_mode": AutoresetMode.SAME_STEP}  # noqa: RUF012 - as in VectorEnv

    def __init__(
        self,
        num_envs: int = 1,
        scenario: Scenario | str | Mapping[str, Any] | Sequence[Scenario | str | Mapping[str, Any]] = "paper-circle",
        vehicle: Vehicle | str | Mapping[str, Any] | None = None,
        control_dt: float | None = None,
        render_mode: str | None = None,
    ) -> None:
        """See the class."""
        if isinstance(num_envs, bool) or not isinstance(num_envs, int) or num_envs < 1:
            raise ValueError(f"num_envs is {num_envs!r}; it must be an integer of at least 1")
        if render_mode is not None:
            raise ValueError(f"render_mode is {render_mode!r}; the vector environment does not draw, the scalar one does")
        self.num_envs = num_envs
        self.render_mode = None
        self.scenarios = _scenarios(scenario, num_envs, vehicle, control_dt)
        self.single_action_space = gym.spaces.Box(-1.0, 1.0, (2,), np.float32)
        self.single_observation_space = gym.spaces.Box(-BOUNDS, BOUNDS, dtype=np.float64)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self._generators = [seeding.np_random(None)[0] for _ in range(num_envs)]
        self._dt = np.array([s.control_dt for s in self.scenarios])
        self._steps = np.array([s.steps for s in self.scenarios])
        self._k = np.zeros(num_envs, dtype=np.int64)
        block = max(1, min(LARGEST_BLOCK, BLOCK_SAMPLES // num_envs))
        self._tape = Tape(num_envs, block)
        self._samples = np.zeros((block, SAMPLE, num_envs))
        self._row = 0
        self._constants = np.ones((PARAMETERS, num_envs))
        filtered = any(s.sensors.low_pass is not None for s in self.scenarios)
        self._parameters = Parameters.of(self._constants, filtered, self.scenarios[0].substeps)
        self._all = np.arange(num_envs)
        self._plant: Plant | None = None
        self._observation = np.zeros((num_envs, len(BOUNDS)))

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Start new episodes everywhere, or where `options["reset_mask"]` says; sub-environment i gets seed + i.

        Raises:
            ValueError: unknown or wrong options, or a wrong number of seeds; nothing has changed then.
        """
        lanes, choices = self._checked_options(options or {})
        seeds = list(seed) if isinstance(seed, Sequence) else [None if seed is None else seed + i for i in self._all.tolist()]
        if len(seeds) != self.num_envs:
            raise ValueError(f"seed has {len(seeds)} entries; it must be one integer, or {self.num_envs} of them")
        for i in lanes.tolist():
            if seeds[i] is not None:
                self._generators[i], _ = seeding.np_random(seeds[i])
        self._observation = self._observation.copy()
        errors = np.zeros(self.num_envs)
        self._observation[lanes], errors[lanes] = self._begin(lanes, choices)
        begun = np.isin(self._all, lanes)
        return self._observation.copy(), self._info(errors, np.zeros(self.num_envs, dtype=bool), begun)

    def _checked_options(self, options: dict[str, Any]) -> tuple[Lanes, list[dict[str, Any]]]:
        """Return the lanes to reset and each one's options."""
        lanes, rest = self._all, dict(options)
        if "reset_mask" in rest:
            mask = np.asarray(rest.pop("reset_mask"))
            if mask.shape != (self.num_envs,) or mask.dtype != np.bool_ or not mask.any():
                raise ValueError(f"reset_mask is {mask!r}; it must be a boolean array ({self.num_envs},) with a True")
            if self._plant is None and not mask.all():
                raise ValueError("the first reset must be of all sub-environments, without reset_mask")
            lanes = mask.nonzero()[0]
        checked_options(dict.fromkeys(set(rest) - {"episode"}, (0, 0, 0)))  # the names alone
        choices: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for key, value in rest.items():
            shared = key != "episode" and np.ndim(value) == 1
            if not shared and len(value) != self.num_envs:
                raise ValueError(f"reset option {key} has {len(value)} entries; it must have one for each of {self.num_envs}")
            for i, choice in enumerate(choices):
                choice.update(checked_options({key: value if shared else value[i]}))
        return lanes, choices

    def _begin(self, lanes: Lanes, choices: list[dict[str, Any]]) -> tuple[Array, Array]:
        """Start an episode in each lane; return its first observations (n, SIZE) and position errors (n,)."""
        episodes = []
        for i in lanes.tolist():
            chosen: Episode | None = choices[i].get("episode") if choices else None
            episode = chosen or self.scenarios[i].draw(self._generators[i])
            episodes.append(with_options(episode, choices[i]) if choices else episode)
        for i, episode, table in zip(lanes.tolist(), episodes, self._tables(lanes, episodes), strict=True):
            self._tape.load(i, self.scenarios[i], episode, table)
            self._constants[:, i] = self.scenarios[i].parameters(episode)
        if self._plant is None:
            self._row = 0
        rest = len(self._samples) - self._row
        self._samples[self._row :, :, lanes] = self._tape.read(lanes.tolist(), rest)
        sample = self._samples[self._row][:, lanes]
        state = np.array([e.initial_state(column) for e, column in zip(episodes, sample.T.tolist(), strict=True)]).T
        p = self._parameters
        begun, terms = start(tuple(state), sample, Parameters.of(self._constants[:, lanes], p.filtered, p.substeps), ARRAYS)  # type: ignore[arg-type]
        self._k[lanes] = 0
        if self._plant is None:
            self._plant = begun
        else:
            self._plant = (*(_put(old, lanes, new) for old, new in zip(self._plant[:-1], begun[:-1], strict=True)),
                           tuple(_put(old, lanes, new) for old, new in zip(self._plant[-1], begun[-1], strict=True)))
        errors = np.hypot(*np.array([e.initial_error[:2] for e in episodes]).T)
        return encode_rows(terms), errors

    def _tables(self, lanes: Lanes, episodes: Sequence[Episode]) -> list[Array]:
        """Return the reference table of each episode, planning those of one clock and vehicle together."""
        tables: list[Array] = [np.empty(0)] * len(episodes)
        groups: dict[Any, list[int]] = {}
        for j, i in enumerate(lanes.tolist()):
            s = self.scenarios[i]
            groups.setdefault((s.control_dt, s.steps, s.vehicle, s.actuators.F_u_max, s.actuators.F_r_max), []).append(j)
        for (dt, steps, vehicle, *limits), members in groups.items():
            times = dt * np.arange(steps + 1)
            for first in range(0, len(members), PLANNED_AT_ONCE):
                batch = members[first : first + PLANNED_AT_ONCE]
                reference = plan([episodes[j].path for j in batch], vehicle, times, (limits[0], limits[1])).table
                check_reference(reference)
                for column, j in enumerate(batch):
                    tables[j] = reference[:, :, column].copy()
        return tables

    def step(self, actions: NDArray[Any]) -> tuple[Array, Array, NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Advance every vehicle by one control period; start the next episode where one ends.

        Raises:
            ValueError: an action is not two finite numbers; the first bad sub-environment is named, none has advanced.
            ResetNeeded: no episode has begun.
        """
        commands = self._checked_actions(actions)
        if self._plant is None:
            raise ResetNeeded("no episode has begun: call reset() before step()")
        self._row += 1
        if self._row == len(self._samples):
            self._samples = self._tape.read(self._all.tolist(), len(self._samples))
            self._row = 0
        self._k += 1
        sample = self._samples[self._row]
        self._plant, terms, (reward, lost, squared, saturated) = step(self._plant, commands, sample, self._parameters, ARRAYS)
        observation = encode_rows(terms)
        truncated = self._k == self._steps
        errors = np.sqrt(squared)
        done = lost | truncated
        info: dict[str, Any] = {}
        if done.any():
            lanes = done.nonzero()[0]
            final = np.full(self.num_envs, None, dtype=object)
            for i in lanes.tolist():
                final[i] = observation[i].copy()
            info["final_obs"], info["_final_obs"] = final, done
            info["final_info"], info["_final_info"] = self._info(errors, saturated, done), done
            saturated = saturated & ~done
            observation[lanes], errors[lanes] = self._begin(lanes, [])
        info.update(self._info(errors, saturated, np.ones(self.num_envs, dtype=bool)))
        self._observation = observation
        return observation, reward, lost, truncated, info

    def _checked_actions(self, actions: NDArray[Any]) -> Array:
        """Return the actions as rows (2, N)."""
        array = np.asarray(actions)
        if array.dtype.kind not in "fiu" or array.shape != (self.num_envs, 2):
            raise ValueError(
                f"actions have shape {array.shape} and type {array.dtype}; they must be numbers of shape ({self.num_envs}, 2)"
            )
        finite = np.isfinite(array)
        if not finite.all():
            i = int(np.argmin(finite.all(axis=1)))
            raise ValueError(f"action of sub-environment {i} is {array[i]}; it must be two finite numbers in [-1, 1]")
        return array.T.astype(np.float64)

    def _info(self, errors: Array, saturated: NDArray[np.bool_], mask: NDArray[np.bool_]) -> dict[str, Any]:
        """Return the scalar environment's info in Gymnasium's vector form, zero where the mask is False."""
        values = {"position_error": errors * mask, "saturated": saturated & mask, "time": self._k * self._dt * mask}
        return {k: v for key, value in values.items() for k, v in ((key, value), (f"_{key}", mask))}

    @property
    def np_random_seed(self) -> tuple[int, ...]:  # type: ignore[override]
        """Not kept: sub-environment i owns the generator that its seed made."""
        return (-1,) * self.num_envs

    @property
    def state(self) -> Array:
        """x, y [m], psi [rad], u, v [m/s] over ground, r [rad/s]; shape (N, 6)."""
        return np.stack(ground_state(self._running, self._samples[self._row], ARRAYS), axis=1)

    @property
    def reference(self) -> ReferencePoint:
        """The references at this time, SI units, fields of shape (N,)."""
        return ReferencePoint(*self._samples[self._row][:8])

    @property
    def force(self) -> Array:
        """F_u [N], F_r [N m] that the actuators apply at this time; shape (N, 2)."""
        return np.stack(self._running[6:8], axis=1)

    @property
    def current(self) -> Array:
        """V_x, V_y [m/s] of the water in the world; shape (N, 2)."""
        return self._samples[self._row][8:10].T.copy()

    @property
    def time(self) -> Array:
        """Time since each reset [s]; shape (N,)."""
        return self._k * self._dt

    @property
    def _running(self) -> Plant:
        if self._plant is None:
            raise ResetNeeded("no episode has begun: call reset() first")
        return self._plant


def _put(old: Array, lanes: Lanes, new: Array) -> Array:
    result = old.copy()
    result[lanes] = new
    return result


def _scenarios(
    scenario: Any, num_envs: int, vehicle: Vehicle | str | Mapping[str, Any] | None, control_dt: float | None
) -> list[Scenario]:
    several = isinstance(scenario, Iterable) and not isinstance(scenario, (str, Mapping))
    given = list(scenario) if several else [scenario]
    if several and len(given) != num_envs:
        raise ValueError(f"{len(given)} scenarios are given for {num_envs} sub-environments; give one, or one for each")
    made = [as_scenario(s).changed(vehicle, control_dt) for s in given]
    if len({s.substeps for s in made}) > 1:
        raise ValueError("the scenarios differ in substeps; side by side they must have the same number")
    return made if several else made * num_envs

"""The vector environment: many vehicles on NumPy arrays, with the step of the scalar environment."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.envs.registration import EnvSpec
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from auv_gym.envs.arguments import ScenarioLike, completed, scenarios_of
from auv_gym.envs.spaces import checked_actions, with_action
from auv_gym.envs.sub_environments import StartedEpisodes, SubEnvironments
from auv_gym.physics.namespaces import ARRAYS, Array
from auv_gym.scenarios.vehicles import VehicleLike
from auv_gym.task.kernels import MakeSimulator, Simulator, Vehicles
from auv_gym.task.model import PLANE, Model
from auv_gym.task.policy import Law
from auv_gym.task.preview import observation_bounds
from auv_gym.task.simulation import current_at, ground_state

Mask = NDArray[np.bool_]


class UnderactuatedAUVTrackVectorEnv(VectorEnv[Array, NDArray[np.float32], NDArray[Any]]):
    """A vector environment of N vehicles; see `UnderactuatedAUVTrackEnv` for the task.

    Sub-environment i after a reset with seed s runs the same episodes as a scalar environment after a reset with seed
    s + i, also after autoresets. The default autoreset mode is SAME_STEP: at the end of an episode the observation is
    the first one of the next episode, and `info["final_obs"]` and `info["final_info"]` hold the last ones of the old
    episode. In mode NEXT_STEP the step after the end of an episode ignores the action and returns the first observation
    of the next episode with reward 0. In mode DISABLED `reset(options={"reset_mask": ...})` starts the next episode.

    Args:
        num_envs: N, the number of sub-environments.
        scenario: a scenario, or a sequence of N with the same number of integration steps per control period; an
            object, a dict or the name of a preset each.
        vehicle: replaces the known vehicle of the scenarios.
        control_dt: control period [s], replaces that of the scenarios.
        render_mode: None; only the scalar environment draws.
        preview: control periods ahead, see the scalar environment.
        autoreset_mode: an `AutoresetMode` of Gymnasium, its name or its value: "SAME_STEP" or "SameStep", and so on.
        max_episode_steps: control steps after which episodes are truncated, if fewer than those of the scenario.

    `reset(options=...)` accepts the options of the scalar environment: `initial_error` and `initial_velocity` of shape
    (3,) or (N, 3), `episode` as a sequence of N; and `reset_mask` (N,) of Gymnasium.

    `env.unwrapped` has the true values of the scalar environment: `state` (N, 6), `reference` with fields of shape
    (N,), `force` (N, 2), `current` (N, 2) and `time` (N,).

    Raises:
        ValueError: an argument is unknown or wrong, or a path cannot be planned.
    """

    kind: Model = PLANE
    metadata: dict[str, Any] = {"render_modes": [], "autoreset_mode": AutoresetMode.SAME_STEP}  # noqa: RUF012 - as in VectorEnv

    def __init__(
        self,
        num_envs: int = 1,
        scenario: ScenarioLike | Sequence[ScenarioLike] = "paper-circle",
        vehicle: VehicleLike | None = None,
        control_dt: float | None = None,
        render_mode: str | None = None,
        preview: Sequence[int] = (),
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
        max_episode_steps: int | None = None,
    ) -> None:
        """See the class."""
        if render_mode is not None:
            raise ValueError(
                f"render_mode is {render_mode!r}; the vector environment does not draw, the scalar one does"
            )
        meant = [mode for mode in AutoresetMode if autoreset_mode in (mode, mode.name, mode.value)]
        if not meant:
            allowed = ", ".join(repr(mode.value) for mode in AutoresetMode)
            raise ValueError(f"unknown autoreset_mode {autoreset_mode!r}; allowed are {allowed}, or an AutoresetMode")
        (self.autoreset_mode,) = meant
        self.scenarios = scenarios_of(scenario, num_envs, vehicle, control_dt, self.kind)
        self._sub_envs = SubEnvironments(self.scenarios, preview, max_episode_steps)
        self.metadata = {**self.metadata, "autoreset_mode": self.autoreset_mode}
        self.num_envs = num_envs
        self.render_mode = None
        parts = self._sub_envs.parts
        bounds = observation_bounds(self._sub_envs.preview.periods, parts.bound_factor, parts.model)
        self._model = self._sub_envs.parts.model
        self.single_action_space = gym.spaces.Box(-1.0, 1.0, (len(self._model.channels),), np.float32)
        self.single_observation_space = gym.spaces.Box(-bounds, bounds, dtype=np.float64)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.use_simulator(Vehicles)
        self._spec: EnvSpec | None = None
        self._all = np.ones(num_envs, dtype=bool)
        self._over = ~self._all  # whether an episode is over and the next one has not begun; not in mode SAME_STEP

    @property
    def spec(self) -> EnvSpec | None:
        """The spec of `gym.make_vec`; `max_episode_steps` is that of the longest episodes."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        """Set by `gym.make_vec`."""
        self._spec = spec and completed(spec, int(self._sub_envs.lengths.max()))

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Start new episodes in all sub-environments, or in those of `options["reset_mask"]`; i has seed + i.

        Raises:
            ValueError: unknown or wrong options, or a wrong number of seeds; nothing has changed then.
        """
        started = self._sub_envs.reset(seed, options)
        self._begin(started)
        self._over[started.indices] = False
        errors = np.zeros(self.num_envs)
        errors[started.indices] = started.errors
        mask = ~self._all
        mask[started.indices] = True
        return self._observed(), self._info(errors, ~self._all, mask)

    def add_residual(self, law: Law, authority: tuple[float, ...]) -> None:
        """Interpret actions as corrections to a control law, and append the law's actions to observations.

        This is `VectorResidualAction` in the compiled step. The next call must be `reset`.

        Raises:
            TypeError: the law branches on values of the observation.
        """
        self.use_simulator(partial(Vehicles, law=law, authority=authority))
        self._sub_envs.law = law
        self.single_observation_space = with_action(self.single_observation_space, len(self._model.channels))
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)

    def use_simulator(self, make: MakeSimulator) -> None:
        """Use another simulator of the vehicles. The next call must be `reset`."""
        sub_envs = self._sub_envs
        self._vehicles = make(sub_envs.parts, sub_envs.samples, sub_envs.constants)
        sub_envs.started = False

    def _begin(self, started: StartedEpisodes) -> Array:
        """Set the first states of n episodes; return their observations, shape (n, columns)."""
        self._vehicles.place(started.indices, started.plant, started.observation)
        rows = self._sub_envs.with_preview(started.observation, started.indices)
        if (law := self._sub_envs.law) is not None:
            law.check(self._model.layout.decode(rows[: self._model.layout.size], ARRAYS))
        return rows.T

    def step(self, actions: NDArray[Any]) -> tuple[Array, Array, Mask, Mask, dict[str, Any]]:
        """Advance all vehicles by one control period, and start the next episode after the end of one.

        Raises:
            ValueError: an action is not two finite numbers; the message names the first bad sub-environment, and no
                vehicle has advanced.
            ResetNeeded: no episode has begun, or an episode is over in mode DISABLED; no vehicle has advanced.
        """
        commands = checked_actions(actions, self.num_envs, len(self._model.channels))
        vehicles, sub_envs = self._running, self._sub_envs
        over, same = self._over, self.autoreset_mode == AutoresetMode.SAME_STEP
        resetting = not same and over.any()
        if resetting and self.autoreset_mode == AutoresetMode.DISABLED:
            ended = np.flatnonzero(over).tolist()
            raise ResetNeeded(f"the episodes of sub-environments {ended} are over: reset them with 'reset_mask'")
        sub_envs.next_sample()
        vehicles.action[:] = commands.T
        vehicles.step(sub_envs.row + 1)
        reward, failed, errors, saturations = vehicles.outcome.copy()
        terminated, saturated, truncated = failed > 0, saturations > 0, sub_envs.truncating
        if resetting:
            reward = np.where(over, 0.0, reward)
            terminated, truncated = terminated & ~over, truncated & ~over
        done = terminated | truncated
        to_reset = (done if same else over).nonzero()[0]
        try:
            planned = sub_envs.next_episodes(to_reset) if len(to_reset) else []
        except ValueError:
            vehicles.undo()
            raise
        sub_envs.advance()
        if not same:
            self._over = done.copy()
        observation = self._observed()
        info: dict[str, Any] = {}
        if planned:
            if same:
                final = np.empty(self.num_envs, dtype=object)  # None for the other sub-environments
                for i in to_reset.tolist():
                    final[i] = observation[i].copy()
                last = {"final_info": self._info(errors * done, saturated & done, done), "_final_info": done.copy()}
                info = {"final_obs": final, "_final_obs": done, **last}
            started = sub_envs.begin(to_reset, planned)
            observation[to_reset], errors[to_reset] = self._begin(started), started.errors
            saturated[to_reset] = False
        info.update(self._info(errors, saturated))
        return observation, reward, terminated, truncated, info

    def _observed(self) -> Array:
        """Return a copy of the present observations with previews, shape (N, columns)."""
        sub_envs, rows = self._sub_envs, self._vehicles.now.observation
        if sub_envs.preview.periods:
            rows = sub_envs.with_preview(rows, sub_envs.all)
        return rows.T.copy()

    def _info(self, errors: Array, saturated: Mask, mask: Mask | None = None) -> dict[str, Any]:
        """Return the info of the scalar environment in Gymnasium's vector form; it is zero outside of the mask."""
        valid, time = (self._all, self.time) if mask is None else (mask, self.time * mask)
        return {
            "position_error": errors,
            "_position_error": valid.copy(),
            "saturated": saturated,
            "_saturated": valid.copy(),
            "time": time,
            "_time": valid.copy(),
        }

    @property
    def np_random_seed(self) -> tuple[int, ...]:  # type: ignore[override]
        """N times -1, since each sub-environment has its own generator and its seed is not stored."""
        return (-1,) * self.num_envs

    @property
    def state(self) -> Array:
        """x, y [m], psi [rad], u, v [m/s] over ground, r [rad/s]; shape (N, 6)."""
        sub_envs = self._sub_envs
        return np.stack(ground_state(self._running.plant, sub_envs.sample, sub_envs.parameters, ARRAYS), axis=1)

    @property
    def pose(self) -> Array:
        """x, y [m], psi [rad], in space also z [m], as in `state` in less time; shape (N, 3) or (N, 4)."""
        names = [name for name in ("x", "y", "psi", "z") if name in self._model.state]
        return self._running.now.plant[[self._model.state.index(name) for name in names]].T

    @property
    def reference(self) -> Any:
        """The references at this time in SI units, fields of shape (N,)."""
        return self._model.Reference(*self._sub_envs.sample[self._model.reference].copy())

    @property
    def force(self) -> Array:
        """F_u [N], F_r [N m] of the actuators at this time; shape (N, 2)."""
        forces: Array = self._running.now.plant[self._model.forces].T.copy()
        return forces

    @property
    def current(self) -> Array:
        """Current V_x, V_y [m/s] in the world frame at the positions of the vehicles; shape (N, 2)."""
        sub_envs = self._sub_envs
        state = self._running.plant[: len(self._model.state)]
        return np.array(current_at(state, sub_envs.sample, sub_envs.parameters, ARRAYS)).T

    @property
    def load(self) -> Array:
        """Wave forces X, Y [N] and moment N [N m] at this time; shape (N, 3)."""
        loads: Array = self._sub_envs.sample[self._model.load_rows].T.copy()
        return loads

    @property
    def time(self) -> Array:
        """Time since each reset [s]; shape (N,)."""
        return self._sub_envs.time

    @property
    def _running(self) -> Simulator:
        if not self._sub_envs.started:
            raise ResetNeeded("no episode has begun: call reset() first")
        return self._vehicles

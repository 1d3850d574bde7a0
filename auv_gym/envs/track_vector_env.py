"""The vector environment: thousands of vehicles side by side on NumPy arrays, through the scalar one's step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from auv_gym.envs.lanes import Begun, Lanes, ScenarioLike
from auv_gym.envs.spaces import ReferencePoint, checked_actions, with_action
from auv_gym.envs.vector_api import AutoresetMode, VectorEnv
from auv_gym.physics.errors import to_body
from auv_gym.physics.namespaces import ARRAYS, Array
from auv_gym.physics.vehicle import Vehicle
from auv_gym.scenarios.episode import Episode
from auv_gym.scenarios.vehicles import VehicleModel
from auv_gym.task.kernels import Bodies, MadeBodies, Vehicles
from auv_gym.task.observation import SIZE, decode
from auv_gym.task.policy import Forces, Law
from auv_gym.task.preview import observation_bounds
from auv_gym.task.simulation import CURRENT, LOAD, PLANT, REFERENCE, current_at, ground_state

Mask = NDArray[np.bool_]


class UnderactuatedAUVTrackVectorEnv(VectorEnv[Array, NDArray[np.float32], NDArray[Any]]):
    """N independent vehicles in one environment; see `UnderactuatedAUVTrackEnv` for the task itself.

    Sub-environment i, reset with seed s, runs the episodes of a scalar environment reset with seed s + i, step by step
    and across autoresets. By default autoreset is SAME_STEP: where an episode ends, the observation returned is the
    first of the next one, and `info["final_obs"]`, `info["final_info"]` hold the last of the old. With NEXT_STEP the
    step after an episode's end ignores the action and returns the first observation of the next one, with reward 0.
    With DISABLED the next episode begins by `reset(options={"reset_mask": ...})` alone.

    Args:
        num_envs: N, the number of vehicles.
        scenario: a scenario, or a sequence of N, one each, with the same number of integration steps a period; each
            may be an object, a dict or a preset's name.
        vehicle: in place of the scenarios' known vehicle.
        control_dt: control period [s] in place of the scenarios'.
        render_mode: None; the scalar environment draws.
        preview: control periods ahead, see the scalar environment.
        autoreset_mode: an `AutoresetMode` of Gymnasium, or its value: "SameStep", "NextStep" or "Disabled".
        max_episode_steps: control steps after which episodes are truncated, if that is sooner than the scenario says.

    `reset(options=...)` takes what the scalar environment does: `initial_error` and `initial_velocity` of shape (3,)
    for all or (N, 3), `episode` as a sequence of N; and Gymnasium's `reset_mask` (N,).

    Whoever measures reads `env.unwrapped`: `state` (N, 6), `reference` with fields of shape (N,), `force` (N, 2),
    `current` (N, 2) and `time` (N,), as the scalar environment's.

    Raises:
        ValueError: whatever is unknown, impossible or cannot be planned, with the place where.
    """

    metadata: dict[str, Any] = {"render_modes": [], "autoreset_mode": AutoresetMode.SAME_STEP}  # noqa: RUF012 - as in VectorEnv

    def __init__(
        self,
        num_envs: int = 1,
        scenario: ScenarioLike | Sequence[ScenarioLike] = "paper-circle",
        vehicle: Vehicle | VehicleModel | str | Mapping[str, Any] | None = None,
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
        self._lanes = Lanes(num_envs, scenario, vehicle, control_dt, preview, autoreset_mode, max_episode_steps)
        self.autoreset_mode = self._lanes.ends.mode
        self.metadata = {**self.metadata, "autoreset_mode": self.autoreset_mode}
        self.num_envs = num_envs
        self.render_mode = None
        self.scenarios = self._lanes.scenarios
        bounds = observation_bounds(self._lanes.preview.periods, self._lanes.parts.span)
        self.single_action_space = gym.spaces.Box(-1.0, 1.0, (2,), np.float32)
        self.single_observation_space = gym.spaces.Box(-bounds, bounds, dtype=np.float64)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self._law: Law | None = None
        self._vehicles: Bodies = self._made()
        self._everywhere = np.ones(num_envs, dtype=bool)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Start new episodes everywhere, or where `options["reset_mask"]` says; sub-environment i gets seed + i.

        Raises:
            ValueError: unknown or wrong options, or a wrong number of seeds; nothing has changed then.
        """
        beginning = self._lanes.reset(seed, options)
        self._begin(beginning)
        errors = np.zeros(self.num_envs)
        errors[beginning.lanes] = beginning.errors
        begun = ~self._everywhere
        begun[beginning.lanes] = True
        return self._observed(), self._info(errors, ~self._everywhere, begun)

    def _made(self, forces: Forces | None = None, authority: tuple[float, float] = (0.0, 0.0)) -> Vehicles:
        lanes = self._lanes
        return Vehicles(lanes.parts, lanes.samples, lanes.constants, forces, authority)

    def correct(self, law: Law, authority: tuple[float, float]) -> None:
        """Take actions as corrections to a law from now on, and append the law's actions to observations.

        It is what `VectorResidualAction` does, in the compiled step; all episodes must begin anew.

        Raises:
            TypeError: the law branches on what is observed.
        """
        self._vehicles = self._made(law.forces, authority)
        self._law, self._lanes.forces = law, law.forces
        self._lanes.begun = False
        self.single_observation_space = with_action(self.single_observation_space)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)

    def embody(self, bodies: MadeBodies) -> None:
        """Let another simulator move the vehicles from now on; all episodes must begin anew."""
        lanes = self._lanes
        self._vehicles = bodies(lanes.parts, lanes.samples, lanes.constants)
        lanes.begun = False

    def _begin(self, beginning: Begun) -> Array:
        """Put vehicles at the start of their episodes; return their observations, shape (n, columns)."""
        lanes, vehicles = beginning.lanes, self._vehicles
        vehicles.place(lanes, beginning.plant, beginning.seen)
        rows = self._lanes.with_preview(beginning.seen, lanes)
        if self._law is not None:
            self._law.check(decode(rows[:SIZE], ARRAYS))
        return rows.T

    def step(self, actions: NDArray[Any]) -> tuple[Array, Array, Mask, Mask, dict[str, Any]]:
        """Advance every vehicle by one control period; start the next episode where one ends.

        Raises:
            ValueError: an action is not two finite numbers; the first bad sub-environment is named, none has advanced.
            ResetNeeded: no episode has begun, or with DISABLED one is over; none has advanced.
        """
        commands, vehicles, lanes = checked_actions(actions, self.num_envs), self._running, self._lanes
        waiting = lanes.ends.waiting
        lanes.coming()
        vehicles.action[:] = commands.T
        vehicles.step(lanes.row + 1)
        reward, failed, errors, saturations = vehicles.now.outcome.copy()
        terminated, saturated, truncated = failed > 0, saturations > 0, lanes.truncating
        if waiting is not None:
            reward, terminated, truncated = np.where(waiting, 0.0, reward), terminated & ~waiting, truncated & ~waiting
        done = terminated | truncated
        renewed = lanes.ends.renewed(done)
        try:
            planned = lanes.planned(renewed) if len(renewed) else []
        except ValueError:
            vehicles.undo()  # nothing has changed
            raise
        lanes.advance()
        lanes.ends.advance(done)
        observation = self._observed()
        info: dict[str, Any] = {}
        if planned:
            if lanes.ends.mode == AutoresetMode.SAME_STEP:
                final = np.empty(self.num_envs, dtype=object)  # None where no episode ends
                for i in renewed.tolist():
                    final[i] = observation[i].copy()
                ended = {"final_info": self._info(errors * done, saturated & done, done), "_final_info": done.copy()}
                info = {"final_obs": final, "_final_obs": done, **ended}
            beginning = lanes.begin(renewed, planned)
            observation[renewed], errors[renewed] = self._begin(beginning), beginning.errors
            saturated[renewed] = False
        info.update(self._info(errors, saturated))
        return observation, reward, terminated, truncated, info

    def _observed(self) -> Array:
        """Return what is observed now, previews included, in memory of its own, shape (N, columns)."""
        seen = self._vehicles.now.seen
        rows = self._lanes.with_preview(seen, self._lanes.all) if self._lanes.preview.periods else seen
        return rows.T.copy()

    def _info(self, errors: Array, saturated: Mask, mask: Mask | None = None) -> dict[str, Any]:
        """Return the scalar environment's info in Gymnasium's vector form; where the mask is False, it is zero."""
        there, time = (self._everywhere, self.time) if mask is None else (mask, self.time * mask)
        return {
            "position_error": errors,
            "_position_error": there.copy(),
            "saturated": saturated,
            "_saturated": there.copy(),
            "time": time,
            "_time": there.copy(),
        }

    def change(self, episodes: Sequence[Episode]) -> None:
        """Go on with the constants of other episodes: a payload is taken up, a fin breaks, other water begins.

        What changes is the true vehicle with its actuators, and the shear, which is a step of the current where its
        wave number is zero. Path, waves, noise and what has been drawn of the current stay, and so do positions and
        velocities over ground: where the water differs, the velocities relative to it do.

        Args:
            episodes: one for each vehicle, of its scenario.

        Raises:
            ValueError: not N episodes, or one that the vehicle's scenario cannot have; nothing has changed then.
        """
        vehicles, current = self._running, self.current
        self._lanes.change(episodes)
        V_x, V_y = (current - self.current).T
        psi = vehicles.plant.psi
        gained = to_body(V_x, V_y, np.cos(psi), np.sin(psi))
        vehicles.now.plant[PLANT.u] += gained[0]
        vehicles.now.plant[PLANT.v] += gained[1]

    @property
    def np_random_seed(self) -> tuple[int, ...]:  # type: ignore[override]
        """Not kept: sub-environment i owns the generator that its seed made."""
        return (-1,) * self.num_envs

    @property
    def state(self) -> Array:
        """x, y [m], psi [rad], u, v [m/s] over ground, r [rad/s]; shape (N, 6)."""
        lanes = self._lanes
        return np.stack(ground_state(self._running.plant, lanes.sample[CURRENT], lanes.parameters, ARRAYS), axis=1)

    @property
    def position(self) -> Array:
        """x, y [m], as in `state` but sooner; shape (N, 2)."""
        return self._running.now.plant[[PLANT.x, PLANT.y]].T

    @property
    def reference(self) -> ReferencePoint:
        """The references at this time, SI units, fields of shape (N,)."""
        return ReferencePoint(*self._lanes.sample[REFERENCE].copy())

    @property
    def force(self) -> Array:
        """F_u [N], F_r [N m] that the actuators apply at this time; shape (N, 2)."""
        plant = self._running.plant
        return np.stack((plant.F_u, plant.F_r), axis=1)

    @property
    def current(self) -> Array:
        """V_x, V_y [m/s] of the water in the world, where the vehicles are; shape (N, 2)."""
        lanes, plant = self._lanes, self._running.plant
        return np.stack(current_at(plant.x, plant.y, lanes.sample[CURRENT], lanes.parameters, ARRAYS), axis=1)

    @property
    def load(self) -> Array:
        """X, Y [N], N [N m] of the waves on the hulls at this time; shape (N, 3)."""
        loads: Array = self._lanes.sample[LOAD].T.copy()
        return loads

    @property
    def time(self) -> Array:
        """Time since each reset [s]; shape (N,)."""
        return self._lanes.time

    @property
    def _running(self) -> Bodies:
        if not self._lanes.begun:
            raise ResetNeeded("no episode has begun: call reset() first")
        return self._vehicles

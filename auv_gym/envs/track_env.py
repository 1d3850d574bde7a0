"""The scalar environment, of one vehicle."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.envs.registration import EnvSpec
from gymnasium.error import ResetNeeded
from gymnasium.utils import seeding
from numpy.typing import NDArray

from auv_gym.envs.arguments import ScenarioLike, checked_seed, completed, scenarios_of
from auv_gym.envs.spaces import checked_action, with_action
from auv_gym.envs.sub_environments import SubEnvironments
from auv_gym.physics.namespaces import FLOATS, Array
from auv_gym.planning.paths import Path
from auv_gym.rendering import PICTURE, Plane, Renderer, View, checked_size, two_planes
from auv_gym.scenarios.episode import checked_options
from auv_gym.scenarios.vehicles import VehicleLike
from auv_gym.task.kernels import Vehicles
from auv_gym.task.model import PLANE, Model
from auv_gym.task.policy import Law
from auv_gym.task.preview import observation_bounds, with_preview
from auv_gym.task.simulation import current_at, ground_state

_TRAIL = 1000  # largest number of past positions in a picture
_ARRAY, _REAL = np.ndarray, (np.dtype(np.float32), np.dtype(np.float64))  # of an action


class UnderactuatedAUVTrackEnv(gym.Env[NDArray[np.float64], NDArray[np.float32]]):
    """Trajectory tracking in the plane by a torpedo-shaped AUV without a side thruster.

    ## Description
    The equations of motion are (1)-(2) of F. Repoulias and E. Papadopoulos, "Trajectory planning and tracking control
    of underactuated AUVs", ICRA 2005. At every reset the planner of their section III computes a dynamically feasible
    reference for the path of the scenario, so zero error is possible in calm water. The scenario can add current,
    waves, model error, sensor errors and slow actuators.

    ## Action Space
    `Box(-1, 1, (2,), float32)`: commands as fractions of the actuator limits. Values outside are clipped.

    | Num | Action        | Min | Max | Unit at 1 |
    |-----|---------------|-----|-----|-----------|
    | 0   | surge force F_u | -1 | 1  | `actuators.F_u_max` [N] |
    | 1   | yaw torque F_r  | -1 | 1  | `actuators.F_r_max` [N m] |

    ## Observation Space
    `Box(-bound, bound, (18,), float64)`: the measured tracking errors in the body frame, the reference, heading, limits
    and previous action. Each term is divided by a fixed scale; `auv_gym.decode_observation` returns SI units.

    | Num | Term    | Unit  | Scale | Min    | Max   | Meaning |
    |-----|---------|-------|-------|--------|-------|---------|
    | 0   | e_x     | m     | 1     | -64    | 64    | position error along the surge axis |
    | 1   | e_y     | m     | 1     | -64    | 64    | position error along the sway axis |
    | 2   | psi_e   | rad   | 0.5   | -2 pi  | 2 pi  | heading error, wrapped to [-pi, pi) |
    | 3   | u_e     | m/s   | 0.5   | -32    | 32    | surge velocity error over ground |
    | 4   | v_e     | m/s   | 0.5   | -32    | 32    | sway velocity error over ground |
    | 5   | r_e     | rad/s | 0.125 | -64    | 64    | yaw rate error |
    | 6   | u_R     | m/s   | 0.5   | -32    | 32    | reference surge velocity |
    | 7   | v_R     | m/s   | 0.5   | -32    | 32    | reference sway velocity |
    | 8   | r_R     | rad/s | 0.125 | -64    | 64    | reference yaw rate |
    | 9   | F_uR    | N     | 128   | -64    | 64    | reference surge force |
    | 10  | F_rR    | N m   | 64    | -64    | 64    | reference yaw torque |
    | 11  | cos_psi | 1     | 1     | -1     | 1     | cosine of the measured heading |
    | 12  | sin_psi | 1     | 1     | -1     | 1     | sine of the measured heading |
    | 13  | F_u_max | N     | 128   | -64    | 64    | surge force that action 1 commands |
    | 14  | F_r_max | N m   | 64    | -64    | 64    | yaw torque that action 1 commands |
    | 15  | a_u     | 1     | 1     | -1     | 1     | previous action, surge |
    | 16  | a_r     | 1     | 1     | -1     | 1     | previous action, yaw |
    | 17  | dt      | s     | 0.125 | -80    | 80    | control period |

    ## Rewards
    `1 / sqrt(1 + (e / error_scale)^2) - rate_weight |a_k - a_(k-1)|^2` with the true position error e. The reward is 1
    for zero error and positive for a constant action. It does not depend on the heading, since a current requires a
    crab angle.

    ## Starting State
    The reference at t = 0 plus the errors of position and heading of the scenario's `start`, with its surge velocity.

    ## Episode End
    - Termination: the distance to the reference exceeds `lost_distance`.
    - Truncation: after `steps` control steps. No `TimeLimit` wrapper is needed. `env.spec.max_episode_steps` has this
      number; `gym.make(..., max_episode_steps=)` can reduce it.

    ## Information
    `reset` and `step` return `position_error` [m] (true, of the centre of mass), `saturated` (whether an actuator was
    commanded to its limit) and `time` [s]. `env.unwrapped` has the true values `state`, `reference`, `force`,
    `current` and `time`.

    ## Arguments
    - `scenario`: a `Scenario`, a dict of one, or the name of a preset (`auv_gym.list_scenarios()`); the default is
      `paper-circle`.
    - `vehicle`: replaces the known vehicle of the scenario. A `Vehicle` or a dict of one changes nothing else. A name
      of `auv_gym.list_vehicles()` or a .toml file also scales the limits, speeds and times of the paper's vehicle.
    - `control_dt`: control period [s], replaces that of the scenario; the duration of episodes does not change.
    - `render_mode`: `"human"`, `"rgb_array"` or None.
    - `render_size`: width and height of pictures [px], from 16 to 4096; the default is 960 x 720. Pictures below
      320 x 240 have no text.
    - `preview`: ascending numbers of control periods. Each appends two columns to the observation: the displacement
      x, y [m] of the reference from now to this time, along the measured body axes, clipped to +-64.

    `reset(options=...)` accepts `initial_error` (x_e, y_e [m], psi_e [rad]), `initial_velocity` (u, v [m/s] relative to
    the water, r [rad/s]) and `episode` (an `Episode` that is run).

    ## Version History
    - v0: initial version.
    """

    kind: Model = PLANE
    metadata: dict[str, Any] = {  # noqa: RUF012 - Gymnasium's own declaration is no ClassVar
        "render_modes": ["human", "rgb_array"],
        "render_fps": 10,
    }

    def __init__(
        self,
        scenario: ScenarioLike = "paper-circle",
        vehicle: VehicleLike | None = None,
        control_dt: float | None = None,
        render_mode: str | None = None,
        preview: Sequence[int] = (),
        render_size: Sequence[int] = PICTURE,
    ) -> None:
        """See the class.

        Raises:
            ValueError: an argument is wrong, or the path cannot be planned.
        """
        (self.scenario,) = scenarios_of(scenario, 1, vehicle, control_dt, self.kind)
        if render_mode is not None and render_mode not in self.metadata["render_modes"]:
            raise ValueError(
                f"unknown render_mode {render_mode!r}; allowed are {self.metadata['render_modes']} and None"
            )
        self.render_mode: Any = render_mode
        self._size = checked_size(render_size)
        self.metadata = {**self.metadata, "render_fps": 1 / self.scenario.control_dt}
        self._model = self.scenario.parts.model
        self._shape = (len(self._model.channels),)  # of an action
        self._channels = range(*self._shape)
        self.action_space = gym.spaces.Box(-1.0, 1.0, self._shape, np.float32)
        self._sub_envs = SubEnvironments([self.scenario], preview)
        bounds = observation_bounds(self._sub_envs.preview.periods, self.scenario.bound_factor, self._model)
        self.observation_space = gym.spaces.Box(-bounds, bounds, dtype=np.float64)
        self._dt, self._steps = self.scenario.control_dt, self.scenario.steps
        if isinstance(self.scenario.path, Path) and self.scenario.vertical is None:
            self._sub_envs.table(self.scenario, self.scenario.path)
        self._set_vehicle()
        self._spec: EnvSpec | None = None
        self._k, self._row, self._block = self._steps, 0, len(self._sub_envs.samples)  # no episode yet
        self._over = True
        self._renderer: Renderer | None = None
        self._trail: Array = np.zeros((0, 2))  # past states, if pictures are drawn
        self._path: Array = self._trail  # poses of the reference

    @property
    def spec(self) -> EnvSpec | None:
        """The spec of `gym.make`; `max_episode_steps` is that of the scenario unless it was given."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        """Set by `gym.make`."""
        self._spec = spec and completed(spec, self._steps)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Start a new episode; see the class for the options, `gymnasium.Env.reset` for the seed.

        Raises:
            ValueError: wrong options or a wrong seed, or an episode that cannot be planned; nothing has changed then.
        """
        checked = checked_options(options, len(self._model.state) // 2)
        seed, sub_envs = checked_seed(seed), self._sub_envs
        rng, self_seed = (self.np_random, None) if seed is None else seeding.np_random(seed)
        ready = sub_envs.next_episodes(sub_envs.all, [rng], [checked])
        if self_seed is not None:
            self._np_random, self._np_random_seed = rng, self_seed
        sub_envs.row = 0
        states, errors = sub_envs.load(sub_envs.all, ready)
        self._vehicle.start(states)
        self._k, self._row, self._over = 0, 0, False
        self._info = {"position_error": errors.item(), "saturated": False, "time": 0.0}
        if self.render_mode is not None:
            table = ready[0].tables[0]
            size = len(self._model.state)
            self._path, self._trail = table[:, : size // 2], np.empty((self._steps + 1, size))
            self._record_state()
        observation = self._observed()
        if self._law is not None:
            self._law.check(self._model.layout.terms_of(observation))
        return observation, self._info

    def _set_vehicle(self, law: Law | None = None, authority: tuple[float, ...] = ()) -> None:
        """Make the vehicle; its actions are corrections to a control law if there is one."""
        samples, constants = self._sub_envs.samples, self._sub_envs.constants
        self._vehicle = Vehicles(self.scenario.parts, samples, constants, law, authority, undoable=False)
        self._law = law
        self._set_views()

    def _set_views(self) -> None:
        """Set the views of the arrays of the vehicle that a step reads and writes."""
        self._commands = self._vehicle.action[:, 0].data  # written in half the time of an array
        self._outcome, self._observation = self._vehicle.outcome[:, 0], self._vehicle.now.observation[:, 0]

    def add_residual(self, law: Law, authority: tuple[float, ...]) -> None:
        """Interpret actions as corrections to a control law, and append the law's action to observations.

        This is `ResidualAction` in the compiled step. The next call must be `reset`.

        Raises:
            TypeError: the law branches on values of the observation.
        """
        self._set_vehicle(law, authority)
        self.observation_space = with_action(self.observation_space, *self._shape)
        self._k, self._over = self._steps, True

    def _observed(self) -> Array:
        """Return a copy of the present observation with its preview."""
        preview = self._sub_envs.preview
        if not preview.periods:
            return self._observation.copy()
        rows = self._observation[:, None]
        return with_preview(rows, preview.ahead((0,), self._k), self.scenario.bound_factor, self._model)[:, 0]

    def _record_state(self) -> None:
        """Append the state to the trail, and draw it in a window."""
        self._trail[self._k] = self.state
        if self.render_mode == "human":
            self.render()

    def _truth(self) -> tuple[Any, list[float], Any]:
        """Return plant, sample and constants at this time."""
        sub_envs = self._sub_envs
        return (
            self.scenario.parts.plant(self._vehicle.now.plant.ravel().tolist()),
            sub_envs.samples[self._row].ravel().tolist(),
            self.scenario.parts.parameters(sub_envs.constants.ravel().tolist()),
        )

    def step(self, action: NDArray[np.floating[Any]]) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Advance one control period; see `gymnasium.Env.step`.

        Raises:
            ValueError: the action is not two finite numbers; nothing has changed then.
            ResetNeeded: the episode is over, or none has begun.
        """
        finite = False
        if type(action) is _ARRAY and action.dtype in _REAL and action.shape == self._shape:
            command = action.tolist()  # the same as `checked_action` in half the time
            total = sum(command)
            finite = total - total == 0.0  # false for nan and infinity
        if not finite:
            command = checked_action(action, *self._shape)
        if self._over:
            raise ResetNeeded("the episode is over, or none has begun: call reset() before step()")
        self._k = k = self._k + 1
        self._row = row = self._row + 1
        if row == self._block:
            self._sub_envs.read()
            self._row = row = 0
        commands = self._commands
        for i in self._channels:
            commands[i] = command[i]
        self._vehicle.run(row, 1)
        reward, failed, error, saturated = self._outcome.tolist()
        truncated, terminated = k >= self._steps, failed > 0.0
        self._over = truncated or terminated
        self._info = {"position_error": error, "saturated": saturated > 0.0, "time": k * self._dt}
        if self.render_mode is not None:
            self._record_state()
        return self._observed(), reward, terminated, truncated, self._info

    @property
    def state(self) -> Array:
        """x, y [m], psi [rad], u, v [m/s] over ground, r [rad/s]; shape (6,)."""
        plant, sample, parameters = self._truth()
        return np.array(ground_state(plant, sample, parameters, FLOATS))

    @property
    def reference(self) -> Any:
        """The reference at this time in SI units, `model.ReferencePoint`."""
        return self._model.Reference(*self._truth()[1][self._model.reference])

    @property
    def force(self) -> Array:
        """F_u [N], F_r [N m] of the actuators at this time; shape (2,)."""
        return self._vehicle.now.plant[self._model.forces, 0].copy()

    @property
    def current(self) -> Array:
        """Current V_x, V_y [m/s] in the world frame at the position of the vehicle; shape (2,)."""
        plant, sample, parameters = self._truth()
        return np.array(current_at(plant[: len(self._model.state)], sample, parameters, FLOATS))

    @property
    def time(self) -> float:
        """Time since the reset [s]."""
        return self._k * self._dt

    def render(self) -> NDArray[np.uint8] | None:
        """Draw the scene; return an array (H, W, 3) of uint8, or None in mode "human"."""
        if self.render_mode is None:
            gym.logger.warn('render() needs render_mode="human" or "rgb_array" in gym.make')
            return None
        if len(self._trail) == 0:
            raise ResetNeeded("nothing to draw yet: call reset() before render()")
        if self._renderer is None:
            self._renderer = Renderer(self.render_mode, self.metadata["render_fps"], self._size)
        first = max(0, self._k + 1 - _TRAIL)
        shown = self._trail[first : self._k + 1], self._path, self.current[None]
        planes = (Plane(*shown),) if self.scenario.vertical is None else two_planes(*shown, first)
        return self._renderer.draw(*map(self._view, planes))

    def _view(self, plane: Plane) -> View:
        """Return what is seen in a plane."""
        return View(
            time=self.time,
            state=tuple(plane.states[-1].tolist()),
            reference=tuple(plane.path[self._k].tolist()),
            path=plane.path[:, :2],
            travelled=self._k,
            trail=plane.states[:, :2],
            current=tuple(plane.vectors[-1].tolist()),
            force=tuple(self.force.tolist()),
            force_limits=self._model.limits(self._truth()[2]),
            position_error=self._info["position_error"],
            title=self.scenario.name,
        )

    def __getstate__(self) -> dict[str, Any]:
        """Return all attributes except the renderer and the views."""
        return {**self.__dict__, "_renderer": None, "_commands": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Set all attributes; views are made again."""
        self.__dict__.update(state)
        self._set_views()

    def close(self) -> None:
        """Close the window, if any."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

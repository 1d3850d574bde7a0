"""The scalar environment: one vehicle."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.envs.registration import EnvSpec
from gymnasium.error import ResetNeeded
from numpy.typing import NDArray

from auv_gym.envs.spaces import ReferencePoint, checked_action, with_action
from auv_gym.physics.namespaces import ARRAYS, FLOATS, Array
from auv_gym.physics.rows import filled, leaves
from auv_gym.physics.vehicle import Vehicle
from auv_gym.planning.paths import Path
from auv_gym.planning.planner import Reference, plan
from auv_gym.rendering import PICTURE, Renderer, View, checked_size
from auv_gym.scenarios.episode import checked_options, with_options
from auv_gym.scenarios.exogenous import Tape
from auv_gym.scenarios.fitting import changed
from auv_gym.scenarios.presets import as_scenario
from auv_gym.scenarios.scenario import Scenario
from auv_gym.scenarios.vehicles import VehicleModel
from auv_gym.task.kernels import STATES, Vehicles, begun
from auv_gym.task.observation import Observation, check_reference, decoded_terms
from auv_gym.task.policy import Law
from auv_gym.task.preview import Preview, encode_preview, observation_bounds
from auv_gym.task.simulation import (
    CURRENT,
    PARAMETER_ROWS,
    PLANT,
    REFERENCE,
    SAMPLE_ROWS,
    Parameters,
    Plant,
    current_at,
    ground_state,
)

_BLOCK = 256  # control steps of tape read at once
_TRAIL = 1000  # past positions drawn at most


class UnderactuatedAUVTrackEnv(gym.Env[NDArray[np.float64], NDArray[np.float32]]):
    """A torpedo-shaped AUV without a side thruster follows a trajectory in the plane, on time.

    ## Description
    The vehicle of (1)-(2) in F. Repoulias and E. Papadopoulos, "Trajectory planning and tracking control of
    underactuated AUVs", ICRA 2005. At every reset the planner of their section III makes a dynamically feasible
    reference for the scenario's path, so that in calm water zero error is possible; current, waves, a vehicle other
    than the known one, sensor errors and slow actuators stand against that as the scenario says.

    ## Action Space
    `Box(-1, 1, (2,), float32)`: commands as fractions of the actuators' limits. Values beyond are clipped.

    | Num | Action        | Min | Max | Unit at 1 |
    |-----|---------------|-----|-----|-----------|
    | 0   | surge force F_u | -1 | 1  | `actuators.F_u_max` [N] |
    | 1   | yaw torque F_r  | -1 | 1  | `actuators.F_r_max` [N m] |

    ## Observation Space
    `Box(-bound, bound, (18,), float64)`: the measured tracking errors in the body frame, the reference, and what the
    controller knows of itself. Each term is divided by a fixed scale; `auv_gym.decode_observation` gives SI units back.

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
    `1 / sqrt(1 + (e / error_scale)^2) - rate_weight |a_k - a_(k-1)|^2` with the true position error e: 1 for a perfect
    step, positive everywhere at a steady action. The heading is not judged: under a current the crab angle is part of
    the solution.

    ## Starting State
    On the reference at t = 0 plus the scenario's `start`: position and heading errors, and a surge velocity.

    ## Episode End
    - Termination: the vehicle is lost, farther than `lost_distance` from the reference.
    - Truncation: `steps` control steps are over. It is counted inside; no `TimeLimit` wrapper is needed. `env.spec`
      says how many, for wrappers that ask; `gym.make(..., max_episode_steps=)` may ask for fewer.

    ## Information
    `reset` and `step` return `position_error` [m] (true, of the centre of mass), `saturated` (an actuator was
    commanded to its limit) and `time` [s]. Whoever measures reads `env.unwrapped`: `state`, `reference`, `force`,
    `current`, `time`.

    ## Arguments
    - `scenario`: a `Scenario`, a dict of one, or a preset's name (`auv_gym.list_scenarios()`); default `paper-circle`.
    - `vehicle`: in place of the scenario's known vehicle a `Vehicle` or a dict of one, which change nothing else, or a
      name of `auv_gym.list_vehicles()` or a .toml file, which bring limits, speeds and clock of their own.
    - `control_dt`: control period [s] in place of the scenario's; the episode's duration stays.
    - `render_mode`: `"human"`, `"rgb_array"` or None.
    - `render_size`: width and height of pictures [px], from 16 to 4096; default 960 x 720. Below 320 x 240 nothing is
      written on them.
    - `preview`: for policies that look ahead, ascending numbers of control periods. For each of them two columns are
      appended to the observation: the displacement x, y [m] of the reference from now to then, along the measured body
      axes, clipped to +-64.

    `reset(options=...)` takes `initial_error` (x_e, y_e [m], psi_e [rad]), `initial_velocity` (u, v [m/s] relative to
    the water, r [rad/s]) and `episode` (an `Episode` to run as it is).

    ## Version History
    - v0: initial version.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - Gymnasium's own declaration is no ClassVar
        "render_modes": ["human", "rgb_array"],
        "render_fps": 10,
    }

    def __init__(
        self,
        scenario: Scenario | str | Mapping[str, Any] = "paper-circle",
        vehicle: Vehicle | VehicleModel | str | Mapping[str, Any] | None = None,
        control_dt: float | None = None,
        render_mode: str | None = None,
        preview: Sequence[int] = (),
        render_size: Sequence[int] = PICTURE,
    ) -> None:
        """See the class; raises ValueError for whatever it does not know or cannot plan."""
        self.scenario = changed(as_scenario(scenario), vehicle, control_dt)
        if render_mode is not None and render_mode not in self.metadata["render_modes"]:
            raise ValueError(
                f"unknown render_mode {render_mode!r}; allowed are {self.metadata['render_modes']} and None"
            )
        self.render_mode: Any = render_mode
        self._size = checked_size(render_size)
        self.metadata = {**self.metadata, "render_fps": max(1, round(1 / self.scenario.control_dt))}
        self.action_space = gym.spaces.Box(-1.0, 1.0, (2,), np.float32)
        self._preview = Preview(1, preview, self.scenario.steps)
        bounds = observation_bounds(self._preview.periods, self.scenario.span)
        self.observation_space = gym.spaces.Box(-bounds, bounds, dtype=np.float64)
        self._dt, self._steps = self.scenario.control_dt, self.scenario.steps
        self._times: Array = self._dt * np.arange(self._steps + 1, dtype=np.float64)
        self._planned: tuple[Path, Reference] | None = None
        if isinstance(self.scenario.path, Path):
            self._plan(self.scenario.path)
        self._tape, self._samples = Tape(1, _BLOCK), np.zeros((_BLOCK, SAMPLE_ROWS, 1))
        self._constants = np.ones((PARAMETER_ROWS, 1))
        self._law: Law | None = None
        self._vehicle = Vehicles(self.scenario.parts, self._samples, self._constants)
        self._spec: EnvSpec | None = None
        self._k = self._steps  # no episode yet
        self._over = True
        self._renderer: Renderer | None = None
        self._trail: Array = np.zeros((0, 2))  # [m] where the vehicle has been, if it is drawn

    @property
    def spec(self) -> EnvSpec | None:
        """What it was made from; `max_episode_steps` is the scenario's unless `gym.make` was given fewer."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        """Set by `gym.make`."""
        if spec is not None and spec.max_episode_steps is None:
            spec = replace(spec, max_episode_steps=self._steps)
        self._spec = spec

    def _plan(self, path: Path) -> Reference:
        """Return the reference for a path, remembering the last one: scenarios with a fixed path plan once."""
        if self._planned is None or self._planned[0] != path:
            act = self.scenario.actuators
            reference = plan(path, self.scenario.vehicle, self._times, (act.F_u_max, act.F_r_max), act.fin)
            check_reference(reference.table, self.scenario.span)
            self._planned = path, reference
        return self._planned[1]

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Start a new episode; see the class for the options, `gymnasium.Env.reset` for the seed."""
        checked = checked_options(options)
        super().reset(seed=seed)
        if "episode" in checked:
            episode, reference = checked["episode"], self._plan(checked["episode"].path)
        else:
            episode, reference = self.scenario.drawn(self.np_random, lambda episode: self._plan(episode.path))
        episode = with_options(episode, checked)
        self._constants[:, 0] = leaves(self.scenario.parameters(episode))
        self._tape.load(0, self.scenario, episode, reference.table)
        self._preview.load((0,), (episode.path,), (self._dt,))
        self._read()
        state = np.reshape(episode.initial_state(self._sample), (STATES, 1))
        forces = None if self._law is None else self._law.forces
        start = begun(self.scenario.parts, state, self._samples[0], self._constants, forces)
        self._vehicle.place(slice(None), *start)
        self._k, self._over = 0, False
        error = math.hypot(episode.initial_error[0], episode.initial_error[1])
        self._info = {"position_error": error, "saturated": False, "time": 0.0}
        if self.render_mode is not None:
            self._trail = np.empty((self._steps + 1, 2))
            self._drawn()
        observation = self._observed()
        if self._law is not None:
            self._law.check(decoded_terms(observation))
        return observation, self._info

    def correct(self, law: Law, authority: tuple[float, float]) -> None:
        """Take actions as corrections to a law from now on, and append the law's action to observations.

        It is what `ResidualAction` does, in the compiled step; a new episode must begin.
        """
        self._law, parts = law, self.scenario.parts
        self.observation_space = with_action(self.observation_space)
        self._vehicle = Vehicles(parts, self._samples, self._constants, law.forces, authority)
        self._k, self._over = self._steps, True

    def _observed(self) -> Array:
        """Return a copy of what is observed now, its preview included."""
        observation: Array = self._vehicle.now.seen[:, 0]
        if not self._preview.periods:
            return observation.copy()
        o = Observation._make(decoded_terms(observation))
        return np.append(observation, encode_preview(self._preview.ahead((0,), self._k), o, ARRAYS, self.scenario.span))

    def _drawn(self) -> None:
        """Take up where the vehicle is now, and draw it if a window is to follow."""
        self._trail[self._k] = self._vehicle.now.plant[[PLANT.x, PLANT.y], 0]
        if self.render_mode == "human":
            self.render()

    @property
    def _plant(self) -> Plant:
        return filled(PLANT, self._vehicle.now.plant.ravel().tolist())

    @property
    def _sample(self) -> list[float]:
        numbers: list[float] = self._samples[self._row].ravel().tolist()
        return numbers

    @property
    def _V(self) -> tuple[float, float]:
        """The current of the sample, without its shear."""
        V_x, V_y = self._sample[CURRENT]
        return V_x, V_y

    @property
    def _parameters(self) -> Parameters:
        return Parameters.of(self._constants.ravel().tolist(), self.scenario.parts)

    def _read(self) -> None:
        self._tape.read((0,), _BLOCK, self._samples)
        self._row = 0

    def step(self, action: NDArray[np.floating[Any]]) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Advance one control period; see `gymnasium.Env.step`.

        Raises:
            ValueError: the action is not two finite numbers; nothing has changed then.
            ResetNeeded: the episode is over, or none has begun.
        """
        command = checked_action(action)
        if self._over:
            raise ResetNeeded("the episode is over, or none has begun: call reset() before step()")
        self._k += 1
        self._row += 1
        if self._row == _BLOCK:
            self._read()
        vehicle = self._vehicle
        vehicle.action[0, 0], vehicle.action[1, 0] = command
        vehicle.step(self._row)
        (reward,), (failed,), (error,), (saturated,) = vehicle.now.outcome.tolist()
        truncated = self._k >= self._steps
        terminated = failed > 0.0
        self._over = truncated or terminated
        self._info = {"position_error": error, "saturated": saturated > 0.0, "time": self._k * self._dt}
        if self.render_mode is not None:
            self._drawn()
        return self._observed(), reward, terminated, truncated, self._info

    @property
    def state(self) -> Array:
        """x, y [m], psi [rad], u, v [m/s] over ground, r [rad/s]; shape (6,)."""
        return np.array(ground_state(self._plant, self._V, self._parameters, FLOATS))

    @property
    def reference(self) -> ReferencePoint:
        """The reference at this time, SI units."""
        return ReferencePoint(*self._sample[REFERENCE])

    @property
    def force(self) -> Array:
        """F_u [N], F_r [N m] that the actuators apply at this time; shape (2,)."""
        return np.array((self._plant.F_u, self._plant.F_r))

    @property
    def current(self) -> Array:
        """V_x, V_y [m/s] of the water in the world, where the vehicle is; shape (2,)."""
        plant = self._plant
        return np.array(current_at(plant.x, plant.y, self._V, self._parameters, FLOATS))

    @property
    def time(self) -> float:
        """Time since the reset [s]."""
        return self._k * self._dt

    def render(self) -> NDArray[np.uint8] | None:
        """Draw the vehicle, its plan and the sea: an array (H, W, 3) of uint8, or None for a window."""
        if self.render_mode is None:
            gym.logger.warn('render() needs render_mode="human" or "rgb_array" in gym.make')
            return None
        if self._planned is None or len(self._trail) == 0:
            raise ResetNeeded("nothing to draw yet: call reset() before render()")
        if self._renderer is None:
            self._renderer = Renderer(self.render_mode, self.metadata["render_fps"], self._size)
        plan_, act = self._planned[1], self.scenario.actuators
        view = View(
            time=self.time,
            state=tuple(self.state.tolist()),
            reference=self.reference[:3],
            path=np.stack((plan_.x, plan_.y), axis=1),
            trail=self._trail[max(0, self._k + 1 - _TRAIL) : self._k + 1],
            current=tuple(self.current.tolist()),
            force=tuple(self.force.tolist()),
            force_limits=(act.F_u_max, act.F_r_max),
            position_error=self._info["position_error"],
            title=self.scenario.name,
        )
        return self._renderer.draw(view)

    def close(self) -> None:
        """Close the window, if any."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

"""Commands as they are sent to a vehicle: an environment whose actions are revolutions and a rudder angle."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import VectorActionWrapper, VectorEnv
from numpy.typing import NDArray

from auv_gym.effects.actuators import fin_share
from auv_gym.envs.spaces import checked_action, checked_actions
from auv_gym.physics.errors import to_body
from auv_gym.physics.namespaces import ARRAYS, Array, sum_of
from auv_gym.physics.space import Limits, axes
from auv_gym.physics.steering import thrust
from auv_gym.scenarios.scenario import Scenario
from auv_gym.scenarios.vehicles import VehicleModel, as_vehicle_model

_LEAST = 1e-6
"""Least share of the fins' torque that is divided by; below, fins give none."""


class ShaftAction(gym.ActionWrapper[NDArray[np.float64], NDArray[np.float32], NDArray[np.float32]]):
    """An environment of this package whose action is (revolutions, rudder angle), as shares of their largest values.

    In space it is (revolutions, angle of the planes, rudder angle); a positive angle of the planes turns the nose down.
    Propeller and rudder turn them into a force and a moment at the velocities through water at the start of the control
    period, see `auv_gym.physics.steering`. Limits, lag and delay of the scenario's actuators act on these, and the
    observation still has the force and the moment as its last action.

    Args:
        env: a scalar environment of this package.
        vehicle: a vehicle model, a name or a file with a table [shaft]; its `Vehicle` is that of the environment.

    Raises:
        ValueError: the vehicle has no shaft, or the environment has another vehicle.
    """

    def __init__(self, env: gym.Env[Any, Any], vehicle: VehicleModel | str) -> None:
        super().__init__(env)
        self._shafts = _Shafts(vehicle, [env.unwrapped.scenario])  # type: ignore[attr-defined]

    def action(self, action: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the action of the wrapped environment for revolutions and rudder angle."""
        env: Any = self.env.unwrapped
        command = np.array(checked_action(action, self._shafts.channels))
        actions = self._shafts.action(command[None], env.state[None], env.current[None])
        first: NDArray[np.float32] = actions[0]
        return first


class VectorShaftAction(VectorActionWrapper):
    """`ShaftAction` for a vector environment of this package; arguments and errors are the same."""

    def __init__(self, env: VectorEnv[Any, Any, Any], vehicle: VehicleModel | str) -> None:
        super().__init__(env)
        self._shafts = _Shafts(vehicle, env.unwrapped.scenarios)  # type: ignore[attr-defined]

    def actions(self, actions: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the actions of the wrapped environment for revolutions and angles, shape (N, channels)."""
        env: Any = self.env.unwrapped
        commands = checked_actions(actions, self.num_envs, self._shafts.channels)
        return self._shafts.action(commands, env.state, env.current)


class _Shafts:
    """The shaft of a vehicle in N scenarios; arguments and errors are those of `ShaftAction`."""

    def __init__(self, vehicle: VehicleModel | str, scenarios: Sequence[Scenario]) -> None:
        model = as_vehicle_model(vehicle)
        if model is None or model.shaft is None:
            raise ValueError(f"vehicle {vehicle!r} has no propeller and rudder; its file needs a table [shaft]")
        if any(scenario.vehicle != model.vehicle for scenario in scenarios):
            raise ValueError(
                f"the environment has another vehicle than {model.name!r}; make it with vehicle={model.name!r}"
            )
        self._shaft, self._eps = model.shaft, model.vehicle.eps
        self._pitch = model.pitch if scenarios[0].vertical else None
        limits = [model.pitch.limits(s.actuators.F_u_max, s.actuators.F_r_max, s.actuators.fin) for s in scenarios]
        self._limits = Limits(*np.array(limits).T)

    @property
    def channels(self) -> int:
        """Number of commands: revolutions and rudder, in space also the planes."""
        return 2 if self._pitch is None else 3

    def action(self, commands: NDArray[Any], states: Array, currents: Array) -> NDArray[np.float32]:
        """Return the actions (N, channels) for commands of this shape at states over ground in currents, a row each."""
        n, *planes, rudder = commands.T
        limits, shaft = self._limits, self._shaft
        if self._pitch is None:
            (_, _, psi, u, v, r), (V_x, V_y) = states.T, currents.T
            V_u, V_v = to_body(V_x, V_y, np.cos(psi), np.sin(psi))
        else:
            _, _, _, theta, psi, u, v, w, q, r = states.T
            V_u, V_v, V_w = (
                sum_of(a * b for a, b in zip(axis, currents.T, strict=True)) for axis in axes(theta, psi, ARRAYS)
            )
        u, v = u - V_u, v - V_v - self._eps * r
        F_u, F_r = shaft.forces((n, rudder), u, v, r, ARRAYS)
        moments = [self._share(F_r, u, limits.fin_r, limits.F_r_max)]
        if self._pitch is not None:  # the planes are a rudder of the vertical plane, whose turn rate is -q
            X, S = shaft.forces((n, -planes[0]), u, w - V_w + self._eps * q, -q, ARRAYS)
            F_u = F_u + X - thrust(np.clip(n, -1.0, 1.0) * shaft.n_max, u, shaft.stern)  # the thrust counts once
            moments.insert(0, self._share(-S, u, limits.fin_q, limits.F_q_max))
        shares = np.stack((F_u / limits.F_u_max, *moments), axis=1)
        actions: NDArray[np.float32] = np.clip(shares, -1.0, 1.0).astype(np.float32)
        return actions

    @staticmethod
    def _share(moment: Array, u: Array, fin: Any, most: Any) -> Array:
        """Return a moment as a share of what full fins give."""
        share: Array = moment / (most * np.maximum(fin_share(u, fin, most, ARRAYS), _LEAST))
        return share

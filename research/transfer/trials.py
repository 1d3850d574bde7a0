"""What the vehicles of six degrees of freedom do on command: logs to identify them from, and turning circles."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from auv_gym.physics.actuators import Actuators
from auv_gym.physics.dynamics import STILL_WATER, CurrentVelocity, Force, State
from auv_gym.scenarios.fitting import adapted
from auv_gym.scenarios.presets import PRESETS
from auv_gym.scenarios.vehicles import VehicleModel, vehicle_model
from baselines.identification.log import Log
from baselines.identification.trials import EXAMPLE_CURRENT, PlantStep, Segment, Simulated, Trial, recorded
from research.transfer.six_dof import AS_PUBLISHED, Outside
from research.transfer.worlds import Own, World

DURATION = {"remus100": 240.0, "otter": 90.0}
"""Length [s] of a log."""
UNDER_WAY: tuple[Segment, ...] = (
    # end [s], share of the surge limit, share of the yaw limit, heading at which a zig-zag turns back [rad]
    (1.0, 0.00, 0.00, 0.0),
    (12.0, 0.15, 0.00, 0.0),  # surge step: fins need a flow
    (60.0, 0.15, 0.50, math.radians(10)),  # zig-zag 10/10
    (100.0, 0.15, 0.40, 0.0),  # turning circle
    (115.0, 0.60, 0.00, 0.0),  # surge step
    (160.0, 0.60, 0.90, math.radians(20)),  # zig-zag 20/20, faster
    (200.0, 0.30, -0.90, 0.0),  # the other circle
    (210.0, 0.08, 0.00, 0.0),  # slower
    (240.0, 0.40, 0.60, math.radians(10)),
)
"""A trial of a vehicle that fins steer: never without a flow."""
_FREE = 0.6
"""Share of their limits that two propellers can give ahead and in yaw at the same time, in the trial."""
_TURN = 600.0  # [s] after which a turn is steady
_SAMPLE = 0.1  # [s] between commands
_SHARES = (0.1, 0.25, 0.5, 1.0)
"""Shares of the limits at which straight runs and turns are compared."""


class Commanded:
    """One vehicle of a `World` as a `PlantStep` of the trials; it remembers itself, whatever state it is handed.

    Args:
        world: one vehicle, which is placed at rest at the origin.
        current: that it is in [m/s].
        speed: surge velocity [m/s] at the beginning.
    """

    def __init__(self, world: World, current: CurrentVelocity = STILL_WATER, speed: float = 0.0) -> None:
        self._world, self._current = world, current
        states = np.zeros((6, 1))
        states[3] = speed
        world.place(np.array([0]), states, np.array(AS_PUBLISHED)[:, None])

    def __call__(self, state: State, command: Force, dt: float) -> State:
        """Return x, y, psi, u, v relative to the water, r after dt [s] of a command [N], [N m]."""
        level, _ = self._world.advance(np.array(Outside(*command, *self._current, 0.0, 0.0, 0.0))[:, None], dt)
        x, y, psi, u, v, r = level[:, 0].tolist()
        return x, y, psi, u, v, r


def _limits(vehicle: VehicleModel) -> Actuators:
    """Return actuators with the most that a vehicle gives at its design speed, fins included, and its own lag."""
    own = vehicle.actuators
    torque = min(own.F_r_max, own.fin * vehicle.vehicle.speed**2) if own.fin else own.F_r_max
    return replace(own, F_r_max=torque, lag=vehicle.lag or 0.0)


def log(name: str, seed: int = 0, current: CurrentVelocity = EXAMPLE_CURRENT) -> Log:
    """Return the log of a trial of a vehicle in six degrees of freedom: steps, zig-zags and a turning circle.

    Its noise is that of `cruise-noise` for this vehicle, its currents are those of the examples.

    Args:
        name: of the vehicle, one of `worlds.SIX_DOF_MODELS`.
        seed: of the noise.
        current: that it is in [m/s].

    Raises:
        ValueError: there is no such vehicle.
    """
    own = vehicle_model(name)
    plant, most = Commanded(Own(name, 1), current), _limits(own)
    sensors = adapted(own, PRESETS["cruise-noise"]).sensors
    if own.actuators.fin:
        trial = Trial(most.F_u_max, most.F_r_max, DURATION[name], UNDER_WAY)
    else:
        trial = Trial(_FREE * most.F_u_max, _FREE * most.F_r_max, DURATION[name])
    return recorded(plant, trial, sensors, np.random.default_rng(seed), current)


def steady(make: Callable[[], PlantStep], F_u: float, F_r: float, speed: float) -> tuple[float, float, float]:
    """Return surge, sway velocity [m/s] and yaw rate [rad/s] in which a vehicle settles under a force in still water.

    Args:
        make: returns the vehicle.
        F_u: surge force [N].
        F_r: yaw moment [N m].
        speed: surge velocity [m/s] at the beginning.
    """
    plant, state = make(), (0.0, 0.0, 0.0, speed, 0.0, 0.0)
    for _ in range(round(_TURN / _SAMPLE)):
        state = plant(state, (F_u, F_r), _SAMPLE)
    return state[3], state[4], state[5]


def in_the_plane(name: str) -> PlantStep:
    """Return the fleet's vehicle of a name as a `PlantStep`."""
    own = vehicle_model(name)
    return Simulated(own.vehicle, _limits(own))


def turned(name: str) -> dict[str, list[dict[str, float]]]:
    """Return how fast a vehicle gets and how tightly it turns under the same forces in the plane and in space.

    Turns are at the plane's surge force of the design speed.

    Args:
        name: of the vehicle.
    """
    own = vehicle_model(name)
    speed, most = own.vehicle.speed, _limits(own)
    cruise = own.drag(speed)[0] * speed
    makers = (lambda: in_the_plane(name)), (lambda: Commanded(Own(name, 1), speed=speed))
    straight, turns = [], []
    for share in _SHARES:
        u = [steady(make, share * most.F_u_max, 0.0, speed)[0] for make in makers]
        straight.append({"F_u": share * most.F_u_max, "plane": u[0], "space": u[1]})
        found = [steady(make, cruise, share * most.F_r_max, speed) for make in makers]
        D = [2 * math.hypot(u, v) / r for u, v, r in found]
        turns.append({"F_r": share * most.F_r_max, "plane": D[0], "space": D[1]})
    return {"straight": straight, "turns": turns}

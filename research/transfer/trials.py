"""Trials of the vehicles with six degrees of freedom: logs for an identification, and steady motion."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from auv_gym.effects.actuators import Actuators
from auv_gym.physics.dynamics import STILL_WATER, CurrentVelocity, Force, State
from auv_gym.scenarios.fitting import adapted
from auv_gym.scenarios.presets import PRESETS, TYPICAL_NOISE
from auv_gym.scenarios.vehicles import VehicleModel, vehicle_model
from baselines.identification.log import Log
from baselines.identification.trials import EXAMPLE_CURRENT, Segment, Simulated, Trial, recorded
from research.transfer.simulators import SixDofSimulator

DURATION = {"remus100": 240.0, "otter": 90.0}
"""Length [s] of a log."""
FIN_TRIAL: tuple[Segment, ...] = (
    # end [s], share of the surge limit, share of the yaw limit, heading at which a zig-zag turns back [rad]
    (1.0, 0.00, 0.00, 0.0),
    (12.0, 0.15, 0.00, 0.0),  # surge step: fins need a flow
    (60.0, 0.15, 0.50, math.radians(10)),  # zig-zag 10/10
    (100.0, 0.15, 0.40, 0.0),  # turning circle
    (115.0, 0.60, 0.00, 0.0),  # surge step
    (160.0, 0.60, 0.90, math.radians(20)),  # zig-zag 20/20, faster
    (200.0, 0.30, -0.90, 0.0),  # turning circle to the other side
    (210.0, 0.08, 0.00, 0.0),  # slower
    (240.0, 0.40, 0.60, math.radians(10)),
)
"""Trial of a vehicle with fins, which always has a flow past the fins."""
_THRUST_SHARE = 0.6
"""Share of the surge and yaw limits in the trial of a vehicle with two propellers: both at the same time."""
_TURN = 600.0  # [s] after which a turn is steady
_SAMPLE = 0.1  # [s] between commands
_SHARES = (0.1, 0.25, 0.5, 1.0)
"""Shares of the limits at which straight runs and turns are compared."""


class SimulatedVehicle:
    """One vehicle of a simulator as a `PlantStep` of the trials; its own state counts, not the given one.

    Args:
        simulator: simulator with one vehicle, which is placed at the origin.
        current: current [m/s].
        speed: initial surge velocity [m/s].
    """

    def __init__(self, simulator: SixDofSimulator, current: CurrentVelocity = STILL_WATER, speed: float = 0.0) -> None:
        self._simulator, self._current = simulator, current
        states = np.zeros((6, 1))
        states[3] = speed
        simulator.place(np.array([0]), states)

    def __call__(self, state: State, command: Force, dt: float) -> State:
        """Return x, y, psi, u, v relative to the water, r after dt [s] of a command [N], [N m]."""
        inputs = np.array([*command, *self._current, 0.0, 0.0, 0.0])[:, None]
        x, y, psi, u, v, r = self._simulator.advance(inputs, dt)[0][:, 0].tolist()
        return x, y, psi, u, v, r


def _limits(vehicle: VehicleModel) -> Actuators:
    """Return actuators with the limits of a vehicle at its design speed, fins included, and with its lag."""
    own = vehicle.actuators
    torque = min(own.F_r_max, own.fin * vehicle.vehicle.speed**2) if own.fin else own.F_r_max
    return replace(own, F_r_max=torque, lag=vehicle.lag or 0.0)


def log(name: str) -> Log:
    """Return the log of a trial of a vehicle in six degrees of freedom: steps, zig-zags and a turning circle.

    The noise has the typical level for this vehicle, the current is `EXAMPLE_CURRENT`.

    Args:
        name: name of the vehicle, one of `simulators.SIX_DOF_MODELS`.

    Raises:
        ValueError: there is no such vehicle.
    """
    own = vehicle_model(name)
    plant, limits = SimulatedVehicle(SixDofSimulator(name, 1), EXAMPLE_CURRENT), _limits(own)
    sensors = adapted(own, replace(PRESETS["cruise-noise"], sensors=TYPICAL_NOISE["cruise"])).sensors
    if own.actuators.fin:
        trial = Trial(limits.F_u_max, limits.F_r_max, DURATION[name], FIN_TRIAL)
    else:
        trial = Trial(_THRUST_SHARE * limits.F_u_max, _THRUST_SHARE * limits.F_r_max, DURATION[name])
    return recorded(plant, trial, sensors, np.random.default_rng(0), EXAMPLE_CURRENT)


def steady_motion(name: str) -> dict[str, list[dict[str, float]]]:
    """Return steady speeds and turning diameters of a vehicle under the same forces in both simulators.

    In turns the surge force is that of the design speed in the plane.

    Args:
        name: name of the vehicle.
    """
    own = vehicle_model(name)
    speed, limits = own.vehicle.speed, _limits(own)

    def velocities(force: Force) -> list[tuple[float, float, float]]:
        """Return the steady u, v [m/s], r [rad/s] under a force in still water, in the plane and in 6-DOF."""
        results = []
        for plant in (Simulated(own.vehicle, limits), SimulatedVehicle(SixDofSimulator(name, 1), speed=speed)):
            state: State = (0.0, 0.0, 0.0, speed, 0.0, 0.0)
            for _ in range(round(_TURN / _SAMPLE)):
                state = plant(state, force, _SAMPLE)
            results.append((state[3], state[4], state[5]))
        return results

    straight, turns = [], []
    for share in _SHARES:
        F_u, F_r = share * limits.F_u_max, share * limits.F_r_max
        plane, space = (u for u, _, _ in velocities((F_u, 0.0)))
        straight.append({"F_u": F_u, "plane": plane, "space": space})
        plane, space = (2 * math.hypot(u, v) / r for u, v, r in velocities((own.drag(speed)[0] * speed, F_r)))
        turns.append({"F_r": F_r, "plane": plane, "space": space})
    return {"straight": straight, "turns": turns}

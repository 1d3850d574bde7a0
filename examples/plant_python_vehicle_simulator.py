"""The REMUS 100 of T. I. Fossen's PythonVehicleSimulator as a plant, in the plane, on your copy of that simulator.

    git clone https://github.com/cybergalactic/PythonVehicleSimulator
    export PYTHONPATH=$PWD/PythonVehicleSimulator/src
    auv-gym evaluate --policy helm-any --scenario cruise-current@remus100 \
        --plant "cmd:python examples/plant_python_vehicle_simulator.py"

Its depth autopilot holds the depth. Inverse models of its propeller and rudder turn forces into commands.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from plant import serve
from python_vehicle_simulator.lib.gnc import attitudeEuler
from python_vehicle_simulator.vehicles.remus100 import remus100

DEPTH = 20.0  # [m]
LONGEST_STEP = 0.02  # [s] of its Euler method
KT_0, KT_MAX, J_MAX, DIAMETER, WAKE, THRUST = 0.4566, 0.1798, 0.6632, 0.14, 0.944, 0.9  # of its propeller


class Remus:
    """One vehicle; x, y, psi, u, v, r are those of the tracked point, `eps` ahead of its origin."""

    def __init__(self, hello: dict[str, Any]) -> None:
        """Make the vehicle for the greeting."""
        if (hello["motion"], hello["name"]) != ("plane", "remus100"):
            raise ValueError("this plant is the REMUS 100 in the plane; choose a scenario such as cruise-calm@remus100")
        self.eps = hello["vehicle"]["eps"]

    def place(self, state: dict[str, float]) -> None:
        """Set the state; the actuators begin at the first command."""
        self.auv = remus100("depthHeadingAutopilot", DEPTH, 0.0, 0.0)
        self.auv.z_d, self.actuators = DEPTH, None
        x, y, psi, u, v, r = state.values()
        x, y, v = x - self.eps * math.cos(psi), y - self.eps * math.sin(psi), v - self.eps * r
        self.eta = np.array([x, -y, DEPTH, 0.0, 0.0, -psi])
        self.through_water = np.array([u, -v, 0.0, 0.0, 0.0, -r])

    def advance(self, inputs: dict[str, float], dt: float) -> list[float]:
        """Return the state after dt [s]."""
        F_u, F_r, V_x, V_y, X, Y, N = inputs.values()
        auv, speed = self.auv, float(np.linalg.norm(self.through_water[:2]))
        auv.V_c, auv.beta_c = math.hypot(V_x, V_y), math.atan2(-V_y, V_x)
        load = auv.Minv @ np.array([X, -Y, 0.0, 0.0, 0.0, -N])
        rudder = -F_r / (-auv.x_r * 0.5 * auv.rho * max(speed, 0.05) ** 2 * auv.A_r * auv.CL_delta_r)
        rudder, turns = float(np.clip(rudder, -auv.deltaMax_r, auv.deltaMax_r)), self.revolutions(F_u, speed)
        nu = self.through_water + self.drift()
        for _ in range(steps := math.ceil(dt / LONGEST_STEP - 1e-9)):
            h = dt / steps
            planes = auv.depthHeadingAutopilot(self.eta, nu, h)[1]
            if self.actuators is None:
                self.actuators = np.array([rudder, 0.0, turns])
            commands = np.array([rudder, planes, turns])
            moved, self.actuators = auv.dynamics(self.eta, nu.copy(), self.actuators, commands, h)
            self.eta, nu = attitudeEuler(self.eta, nu, h), moved + h * load
        self.through_water = nu - self.drift()
        u, v, _, _, _, r = self.through_water
        x, y, psi = self.eta[0], -self.eta[1], -self.eta[5]
        ahead = self.eps * np.array([math.cos(psi), math.sin(psi)])
        return [float(a) for a in (x + ahead[0], y + ahead[1], psi, u, -v - self.eps * r, -r)]

    def drift(self) -> Any:
        """Return the velocity of the water along the axes of the body, as the simulator computes it."""
        angle = self.auv.beta_c - self.eta[5]
        return np.array([self.auv.V_c * math.cos(angle), self.auv.V_c * math.sin(angle), 0.0, 0.0, 0.0, 0.0])

    def revolutions(self, F_u: float, speed: float) -> float:
        """Return the revolutions [1/min] for a surge force [N]."""
        thrust = F_u / (THRUST * self.auv.rho * DIAMETER**4)
        slope = (KT_MAX - KT_0) / J_MAX * WAKE * speed / DIAMETER
        root = math.sqrt(slope * slope + 4 * KT_0 * abs(thrust))
        turns = (root - slope) / (2 * KT_0) if thrust > 0 else -math.sqrt(-thrust / KT_0)
        return float(np.clip(60 * turns, -self.auv.nMax, self.auv.nMax))


if __name__ == "__main__":
    serve(Remus)

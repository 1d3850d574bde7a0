"""MCSimPython: R/V Gunnerus of NTNU, a ship of 600 t, as a plant in its own process, see docs/plants.md."""

from __future__ import annotations

import math
import sys
from typing import Any

import numpy as np
from common import steady_error, works
from MCSimPython.simulator import GunnerusManeuvering3DoF
from plant import serve


class Gunnerus:
    """The ship in the plane, with forces in surge and yaw."""

    def __init__(self, hello: dict[str, Any]) -> None:
        """Make the ship for the greeting."""
        self.steps = math.ceil(hello["dt"] / 0.05)
        self.ship = GunnerusManeuvering3DoF(hello["dt"] / self.steps, method="RK4")

    def place(self, state: dict[str, float]) -> None:
        """Set the state."""
        x, y, psi, u, v, r = state.values()
        self.ship.set_eta(np.array([x, -y, -psi]))
        self.through_water = np.array([u, -v, -r])

    def advance(self, inputs: dict[str, float], dt: float) -> list[float]:
        """Return the state after dt [s]."""
        del dt
        F_u, F_r, V_x, V_y, X, Y, N = inputs.values()
        current, direction = math.hypot(V_x, V_y), math.atan2(-V_y, V_x)

        def drift() -> Any:
            angle = direction - self.ship.get_eta()[2]
            return np.array([current * math.cos(angle), current * math.sin(angle), 0.0])

        self.ship.set_nu(self.through_water + drift())
        for _ in range(self.steps):
            self.ship.integrate(current, direction, np.array([F_u + X, -Y, -F_r - N]))
        self.through_water = self.ship.get_nu() - drift()
        (x, y, psi), (u, v, r) = self.ship.get_eta(), self.through_water
        return [float(a) for a in (x, -y, -psi, u, -v, -r)]


if __name__ == "__main__":
    if "--serve" in sys.argv:
        serve(Gunnerus)
    else:
        plant = f"cmd:{sys.executable} {__file__} --serve"
        error = steady_error("nmpc", "cruise-current@gunnerus", "--plant", plant)
        works(f"R/V Gunnerus is a plant in its own process; nmpc in cruise-current@gunnerus ({error:.2g} m)")

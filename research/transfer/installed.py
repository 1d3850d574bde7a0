"""The same vehicles in the user's own copy of PythonVehicleSimulator, cybergalactic's repository.

A vehicle there is an object with `dynamics(eta, nu, u_actual, u_control, sampleTime)`, which returns velocities over
ground and actuators a sample later, and takes the current from its `V_c` and `beta_c`.
"""

from __future__ import annotations

import importlib
import math
from typing import Any

import numpy as np

from auv_gym.physics.errors import to_body
from auv_gym.physics.namespaces import FLOATS, Array
from research.transfer.six_dof import AS_PUBLISHED, Motion, Outside, level, place_rates
from research.transfer.worlds import MODELS, STEP

PACKAGE = "python_vehicle_simulator"  # what the user installs
ACTUATORS = {"remus100": 3, "otter": 2}
"""How many actuators each vehicle has there, in the order of ours."""


def vehicle_of(name: str) -> Any:
    """Return a new vehicle of the user's copy.

    Raises:
        ValueError: there is no such vehicle, or no such package.
    """
    if name not in ACTUATORS:
        raise ValueError(f"{name!r} is no vehicle of {PACKAGE} here; allowed are {', '.join(ACTUATORS)}")
    try:
        module = importlib.import_module(f"{PACKAGE}.vehicles.{name}")
    except ModuleNotFoundError as error:
        raise ValueError(
            f"{error.name} is not installed; clone and install cybergalactic/PythonVehicleSimulator, or "
            "take --simulator own"
        ) from error
    return getattr(module, name)()


class Installed:
    """N vehicles of the user's copy, one after the other; inner loops, kinematics and what it takes for level are ours.

    Args:
        name: of the vehicle.
        n: N.

    Raises:
        ValueError: there is no such vehicle, or no such package.
    """

    def __init__(self, name: str, n: int) -> None:
        self._vehicle, self._model, self._count = vehicle_of(name), MODELS[name], ACTUATORS[name]
        self.rows = np.zeros((self._model.size, n))

    def place(self, lanes: Any, states: Array, deviations: Array) -> None:
        """See `World.place`.

        Raises:
            ValueError: a vehicle is to differ from the published one.
        """
        if not np.allclose(deviations, np.array(AS_PUBLISHED)[:, None]):
            raise ValueError("the installed simulator has the published vehicle alone; take cases without mismatch")
        self.rows[:, lanes] = self._model.placed(states)

    def advance(self, outside: Array, dt: float) -> tuple[Array, Array]:
        """See `World.advance`."""
        steps = math.ceil(dt / STEP - 1e-9)
        seen = []
        for lane in range(self.rows.shape[1]):
            row, acting = self.rows[:, lane].tolist(), Outside(*outside[:, lane].tolist())
            for _ in range(steps):
                row = self._stepped(row, acting, dt / steps)
            self.rows[:, lane] = row
            place, forces = self._model.seen(row, FLOATS)
            seen.append((*place, *forces))
        level_rows, force_rows = np.split(np.array(seen).T, [6])
        return level_rows, force_rows

    def _stepped(self, row: list[float], acting: Outside, h: float) -> list[float]:
        """Return the row of one vehicle after an Euler step of h [s]."""
        simulated, s = self._vehicle, Motion(*row[:12])
        orders = np.array(self._model.orders(row, acting, FLOATS))
        actual, loops = np.array(row[12 : 12 + self._count]), row[12 + self._count :]
        turned = math.cos(s.psi), math.sin(s.psi)
        nu = np.array(row[6:12])
        nu[:2] += to_body(acting.V_x, acting.V_y, *turned)
        simulated.V_c, simulated.beta_c = math.hypot(acting.V_x, acting.V_y), math.atan2(acting.V_y, acting.V_x)
        nu, actual = simulated.dynamics(np.array(row[:6]), nu, actual, orders, h)
        nu = nu + h * np.asarray(simulated.Minv) @ (acting.X, acting.Y, 0.0, 0.0, 0.0, acting.N)
        psi = s.psi + h * level(s, FLOATS)[5]
        nu[:2] -= to_body(acting.V_x, acting.V_y, math.cos(psi), math.sin(psi))
        after = s._replace(u=nu[0], v=nu[1], w=nu[2], p=nu[3], q=nu[4], r=nu[5])
        eta = [
            x + h * x_dot for x, x_dot in zip(row, place_rates(after, (acting.V_x, acting.V_y), FLOATS), strict=False)
        ]
        rates = self._model.rates(row, orders.tolist(), acting, AS_PUBLISHED, FLOATS) if loops else []
        remembered = [x + h * x_dot for x, x_dot in zip(loops, rates[12 + self._count :], strict=True)]
        return [*map(float, eta), *map(float, nu), *map(float, actual), *remembered]

    def kept(self) -> Any:
        """See `World.kept`."""
        return self.rows.copy()

    def restore(self, kept: Any) -> None:
        """See `World.restore`."""
        self.rows = kept.copy()

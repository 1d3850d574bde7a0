"""The paper's vehicle in other units."""

from dataclasses import replace

from auv_gym.effects.actuators import Actuators
from auv_gym.physics.units import DIMENSIONS, POWERS
from auv_gym.physics.vehicle import PAPER_VEHICLE, Vehicle
from auv_gym.scenarios.vehicles import PAPER


def similar_vehicle(units):
    """Return the paper's vehicle in other units."""
    similar = {n: getattr(PAPER_VEHICLE, n) * units.factor(*POWERS[unit]) for n, unit in DIMENSIONS.items()}
    return Vehicle(**similar, speed=1.5 * units.length / units.time)


def twin(units):
    """Return the paper's vehicle in other units, with all that belongs to it."""
    limits = Actuators(400.0 * units.factor(*POWERS["N"]), 200.0 * units.factor(*POWERS["N m"]))
    rate = {"turn_rate": 0.12 / units.time, "lag": 0.2 * units.time}
    return replace(PAPER, name="twin", vehicle=similar_vehicle(units), actuators=limits, **rate)

"""The physical effects of a scenario, one class each, and what a user needs for an effect of his own."""

from auv_gym.effects.actuators import Astern, Delay, Fins, Reach
from auv_gym.effects.autopilot import Autopilot
from auv_gym.effects.base import EFFECTS, POINTS, At, Effect, effect
from auv_gym.effects.current import Shear
from auv_gym.effects.faults import Faults, OffsetFaults
from auv_gym.effects.mismatch import CrossFlow, Lift
from auv_gym.effects.navigation import DeadReckoning, Outages
from auv_gym.effects.reward import FineReward
from auv_gym.effects.sensors import CorrelatedNoise, LowPass
from auv_gym.physics.dynamics import Force, State
from auv_gym.physics.intervals import Interval
from auv_gym.physics.namespaces import Number

PACKAGE: tuple[type[Effect], ...] = (
    Autopilot, Delay, Reach, CorrelatedNoise, Faults, OffsetFaults, Astern, Fins, Lift, CrossFlow, Shear, DeadReckoning,
    Outages, LowPass,
)  # fmt: skip
"""The effects of the package, in the order in which they act at a point."""

__all__ = [
    "EFFECTS", "PACKAGE", "POINTS", "At", "Autopilot", "Effect", "FineReward", "Force", "Interval", "Number", "State",
    "effect",
]  # fmt: skip

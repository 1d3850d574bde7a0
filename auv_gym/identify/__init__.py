"""From a log to a vehicle: masses, drag, lag and limits with intervals, by the simulator's own derivatives."""

from auv_gym.identify.fit import Estimate, Identified, identify
from auv_gym.identify.log import Log

__all__ = ["Estimate", "Identified", "Log", "identify"]

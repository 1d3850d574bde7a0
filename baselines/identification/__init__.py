"""From a log to a vehicle: masses, drag, lag and limits with intervals, by the simulator's own derivatives."""

from baselines.identification.fit import Identified, ParameterEstimate, identify
from baselines.identification.log import Log

__all__ = ["Identified", "Log", "ParameterEstimate", "identify"]

"""Identification of a vehicle from a log: parameters with confidence intervals, by nonlinear least squares."""

from baselines.identification.fit import Identified, ParameterEstimate, identify
from baselines.identification.log import Log

__all__ = ["Identified", "Log", "ParameterEstimate", "identify"]

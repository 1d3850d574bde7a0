"""Reward and failure, for all environments."""

from __future__ import annotations

from auv_gym.physics.namespaces import Namespace, Number


def reward(
    squared_error: Number, squared_change: Number, error_scale: Number, rate_weight: Number, ns: Namespace
) -> Number:
    """Return 1 / sqrt(1 + (e / error_scale)^2) - rate_weight |a_k - a_(k-1)|^2.

    The maximum is 1, at zero position error e. For large errors the reward decreases as 1/e, so its gradient does not
    vanish. It is positive for a constant action, so it is never better to end an episode early. It does not depend on
    the heading, since a current requires a crab angle.
    """
    return 1 / ns.sqrt(1 + squared_error / (error_scale * error_scale)) - rate_weight * squared_change


def failed(squared_error: Number, lost_distance: Number) -> Number:
    """Return whether the distance to the reference exceeds lost_distance [m]."""
    return (squared_error <= lost_distance * lost_distance) ^ True  # True for nan as well

"""A reward that tells millimetres from centimetres."""

from __future__ import annotations

from typing import Annotated, ClassVar

from auv_gym.effects.base import At, Effect, effect
from auv_gym.physics.intervals import Interval
from auv_gym.physics.namespaces import Number


@effect
class FineReward(Effect):
    """A share of the reward depends on a smaller scale than `Scenario.error_scale`.

    With the position error e it is `weight / sqrt(1 + (e / scale)^2)`, beside `1 - weight` of the task's reward.
    """

    scale: Annotated[Interval, "m", 1e-6, 1e3, "position error at which this share has fallen to 0.71"] = 0.01
    weight: Annotated[Interval, "1", 0.0, 1.0, "share of the reward"] = 0.5
    neutral: ClassVar = {"scale": 1.0}

    @staticmethod
    def reward(reward: Number, at: At) -> Number:
        """Return the reward with the share."""
        own = at.own
        return (1 - own.weight) * reward + own.weight / at.ns.sqrt(1 + at.squared_error / (own.scale * own.scale))

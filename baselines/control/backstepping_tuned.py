"""The paper's law, as printed and speed-normalised, with gains that were tuned with the budget of every controller.

The expert is the same law with the paper's gains in slow motion; here is what the law can do in these tasks.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

from auv_gym.physics.vehicle import PAPER_VEHICLE, Vehicle
from auv_gym.scenarios.presets import REGIMES
from baselines.control.backstepping import LAW_GAINS, SCALED_GAINS, Backstepping, Gains
from baselines.gains.loading import load_gains


def make_tuned(
    name: str, names: Sequence[str], vehicle: Vehicle | str | dict[str, Any] = PAPER_VEHICLE
) -> Backstepping:
    """Return the law with the gains of a name's files, by the speed of the reference.

    Args:
        name: that the files begin with.
        names: of its gains.
        vehicle: the vehicle that the law believes in; an object, a name or a dict.

    Raises:
        ValueError: unknown vehicle, or a file is not what it must be, see `load_gains`.
    """
    slow, cruise = (Gains(**load_gains(name, regime, names)) for regime in REGIMES)
    return Backstepping((slow, cruise), vehicle)


make_backstepping_tuned = partial(make_tuned, "backstepping-tuned", LAW_GAINS)
make_normalised_tuned = partial(make_tuned, "backstepping-normalised-tuned", SCALED_GAINS)
"""Return the law as printed, and in its speed-normalised form; the argument `vehicle` is that of `make_tuned`."""

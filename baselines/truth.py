"""What no competitor may know: all that the outside supplies to episodes, from the first step to the last."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from auv_gym.episode import Episode
from auv_gym.planner import plan
from auv_gym.scenario import Scenario
from auv_gym.tape import Tape

Array = NDArray[np.float64]


def samples(scenario: Scenario, episodes: Sequence[Episode]) -> Array:
    """Return the samples (`simulation.Sample`) of N episodes at K + 1 control instants, shape (K + 1, SAMPLE, N).

    Raises:
        InfeasibleReferenceError: an episode's path cannot be followed.
    """
    n, act = len(episodes), scenario.actuators
    times = scenario.control_dt * np.arange(scenario.steps + 1, dtype=np.float64)
    table = plan([e.path for e in episodes], scenario.vehicle, times, (act.F_u_max, act.F_r_max)).table
    tape = Tape(n, len(times))
    for i, episode in enumerate(episodes):
        tape.load(i, scenario, episode, np.ascontiguousarray(table[:, :, i]))
    return tape.read(np.arange(n), len(times))

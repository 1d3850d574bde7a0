"""What no competitor may know: all that the outside supplies to episodes, from the first step to the last."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from auv_gym.envs.lanes import reference_tables
from auv_gym.episode import Episode
from auv_gym.scenario import Scenario
from auv_gym.tape import Tape

Array = NDArray[np.float64]


def samples(scenario: Scenario, episodes: Sequence[Episode]) -> Array:
    """Return the samples (`simulation.Sample`) of N episodes at K + 1 control instants, shape (K + 1, SAMPLE, N).

    Raises:
        InfeasibleReferenceError: an episode's path cannot be followed.
    """
    n, act = len(episodes), scenario.actuators
    instants = scenario.steps + 1
    tables = reference_tables(episodes, scenario.control_dt, scenario.steps, scenario.vehicle, act.F_u_max, act.F_r_max)
    tape = Tape(n, instants)
    for i, (episode, table) in enumerate(zip(episodes, tables, strict=True)):
        tape.load(i, scenario, episode, table)
    return tape.read(np.arange(n), instants)

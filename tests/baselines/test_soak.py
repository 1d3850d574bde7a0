"""A few rounds of `python tests/soak.py`."""

import numpy as np
import pytest
import soak as module
from soak import ROUND, VEHICLES, soak


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:these gains", "ignore:this policy was trained at")
def test_numbers_stay_finite_in_random_scenarios():
    done = soak(4 * VEHICLES * ROUND, seed=1)
    assert done["environments"] >= 4
    assert done["steps"] >= 4 * VEHICLES * ROUND
    assert done["episodes"] > VEHICLES


def test_only_expected_refusals_of_a_scenario_are_counted(monkeypatch):
    messages = ["infeasible at t = 0 s, (x, y) = (0, 0) m: F_u = 2 N is beyond its limit of 1 N", "control_dt is nan"]

    def refused(*_):
        raise ValueError(messages[0])

    monkeypatch.setattr(module, "scenario", refused)
    assert module.begun(np.random.default_rng(0), ()) is None
    del messages[0]
    with pytest.raises(ValueError, match="control_dt is nan"):
        soak(1, seed=0)

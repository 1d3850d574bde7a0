"""A few rounds of `python tests/soak.py`."""

import pytest
from soak import ROUND, VEHICLES, soak


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.filterwarnings("ignore:these gains", "ignore:this policy was trained at")
def test_numbers_stay_finite_in_random_scenarios():
    done = soak(4 * VEHICLES * ROUND, seed=1)
    assert done["environments"] >= 4
    assert done["steps"] >= 4 * VEHICLES * ROUND
    assert done["episodes"] > VEHICLES

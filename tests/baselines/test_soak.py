"""A few rounds of `python tests/soak.py`, which steps millions of times."""

import pytest
from soak import LANES, ROUND, soak


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:these gains", "ignore:this policy was trained at")
def test_numbers_stay_finite_in_random_scenarios():
    done = soak(4 * LANES * ROUND, seed=1)
    assert done["environments"] >= 4
    assert done["steps"] >= 4 * LANES * ROUND
    assert done["episodes"] > LANES

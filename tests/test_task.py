"""Observation, reward and termination."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from auv_gym import task
from auv_gym.namespaces import FLOATS

inside = st.tuples(*(st.floats(-t.scale * t.bound, t.scale * t.bound, allow_subnormal=False) for t in task.TERMS))


@given(inside)
def test_decoding_returns_the_encoded_numbers_exactly(terms):
    assert tuple(task.decode_observation(task.encode_observation(terms))) == pytest.approx(terms, rel=1e-15, abs=1e-300)


@given(st.tuples(*[st.floats(-1e6, 1e6)] * 6))
def test_observation_stays_in_its_bounds(errors):
    observation = task.encode_observation((*errors, *[0.0] * 12))
    assert (np.abs(observation[[0, 1, 3, 4, 5]]) <= task.BOUNDS[[0, 1, 3, 4, 5]]).all()


def test_names_agree():
    assert task.Observation._fields == tuple(term.name for term in task.TERMS)


def test_batch_decodes_as_single_observations_do():
    rows = np.random.default_rng(0).uniform(-1, 1, (5, task.SIZE + 2))
    batch = task.decode_observation(rows)
    for i, row in enumerate(rows):
        assert tuple(column[i] for column in batch) == tuple(task.decode_observation(row))


@pytest.mark.parametrize("shape", [(), (3,), (2, 3), (1, 2, task.SIZE)])
def test_wrong_shape_is_refused(shape):
    with pytest.raises(ValueError, match="it must be"):
        task.decode_observation(np.zeros(shape))


@given(st.floats(0, 1e3), st.floats(0, 1e3), st.floats(1e-2, 10))
def test_reward_peaks_at_zero_error_and_falls_with_distance(near, far, scale):
    near, far = sorted((near, far))
    rewards = [task.reward(e * e, 0.0, scale, 0.05, FLOATS) for e in (0.0, near, far)]
    assert rewards[0] == 1.0
    assert rewards[0] >= rewards[1] >= rewards[2] > 0


def test_change_of_the_action_costs():
    assert task.reward(0.0, 2.0, 1.0, 0.05, FLOATS) == pytest.approx(0.9)


def test_lost_is_beyond_the_distance():
    assert not task.lost(100.0, 10.0)
    assert task.lost(math.nextafter(100.0, math.inf), 10.0)


def test_reference_beyond_the_bounds_is_refused():
    table = np.zeros((4, 8))
    task.check_reference(table)
    table[2, 5] = 9.0
    with pytest.raises(ValueError, match=r"reference r_R reaches 9 rad/s; at most 8"):
        task.check_reference(table)

"""Observation, reward and termination."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from auv_gym import decode_observation
from auv_gym.physics.namespaces import FLOATS
from auv_gym.task import observation as task
from auv_gym.task.reward import failed, reward

inside = st.tuples(*(st.floats(-t.scale * t.bound, t.scale * t.bound, allow_subnormal=False) for t in task.TERMS))


@given(inside)
def test_decoding_returns_the_encoded_numbers_exactly(terms):
    assert tuple(decode_observation(task.encode_observation(terms))) == pytest.approx(terms, rel=1e-15, abs=1e-300)


@given(st.tuples(*[st.floats(-1e6, 1e6)] * 6))
def test_observation_stays_in_its_bounds(errors):
    observation = task.encode_observation((*errors, *[0.0] * (task.SIZE - 6)))
    assert (np.abs(observation[[0, 1, 3, 4, 5]]) <= task.bounds(1)[[0, 1, 3, 4, 5]]).all()


SCALES = {
    "e_x": 1, "e_y": 1, "psi_e": 0.5, "u_e": 0.5, "v_e": 0.5, "r_e": 0.125, "u_R": 0.5, "v_R": 0.5, "r_R": 0.125,
    "F_uR": 128, "F_rR": 64, "cos_psi": 1, "sin_psi": 1, "F_u_max": 128, "F_r_max": 64, "a_u": 1, "a_r": 1, "dt": 0.125,
}  # fmt: skip
"""The interface of all trained agents, which must not change. New terms are appended."""


def test_terms_and_scales_are_those_of_trained_agents():
    known = len(SCALES)
    assert {term.name: term.scale for term in task.TERMS[:known]} == SCALES
    assert task.Observation._fields[:known] == tuple(SCALES)
    np.testing.assert_array_equal(decode_observation(np.ones(task.SIZE))[:known], list(SCALES.values()))


def test_the_table_in_the_docstring_is_that_of_the_terms():
    from auv_gym.envs.track_env import UnderactuatedAUVTrackEnv

    document = UnderactuatedAUVTrackEnv.__doc__ or ""
    lines = [line for line in document.splitlines() if line.count("|") == 8 and line.strip()[2].isdigit()]
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines]
    for i, (row, term) in enumerate(zip(rows, task.TERMS, strict=True)):
        bound = "2 pi" if term.name == "psi_e" else f"{term.bound:g}"
        assert row[:6] == [str(i), term.name, term.unit, f"{term.scale:g}", f"-{bound}", bound]


def test_floats_rows_and_tensors_are_encoded_alike():
    torch = pytest.importorskip("torch")
    from auv_gym.physics.namespaces import ARRAYS, tensors

    terms = np.random.default_rng(0).normal(size=(task.SIZE, 5)) * np.repeat([100.0, 0.5], [6, task.SIZE - 6])[:, None]
    rows = task.encode(tuple(terms), ARRAYS, bound_factor=1)
    singles = np.array([task.encode_observation(tuple(column)) for column in terms.T.tolist()]).T
    encoded = task.encode(torch.tensor(terms).unbind(), tensors(), bound_factor=1)
    np.testing.assert_array_equal(rows, singles)
    np.testing.assert_array_equal(rows, encoded.numpy())
    decoded = torch.stack(list(task.decode(encoded.unbind(), tensors())))
    np.testing.assert_array_equal(task.decode(rows, ARRAYS), decoded.numpy())


def test_forces_become_actions_within_their_limits():
    o = task.Observation._make([0.0] * task.SIZE)._replace(F_u_max=400.0, F_r_max=200.0)
    assert task.action_of((100.0, -300.0), o, FLOATS) == (0.25, -1.0)
    assert task.action_of((-900.0, 30.0), o, FLOATS) == (-1.0, 0.15)


def test_a_batch_is_decoded_as_single_observations():
    rows = np.random.default_rng(0).uniform(-1, 1, (5, task.SIZE + 2))
    batch = decode_observation(rows)
    for i, row in enumerate(rows):
        assert tuple(column[i] for column in batch) == tuple(decode_observation(row))


@pytest.mark.parametrize("shape", [(), (3,), (2, 3), (1, 2, task.SIZE)])
def test_wrong_shape_is_refused(shape):
    with pytest.raises(ValueError, match="it must be"):
        decode_observation(np.zeros(shape))


@given(st.floats(0, 1e3), st.floats(0, 1e3), st.floats(1e-2, 10))
def test_reward_is_largest_at_zero_error_and_decreases_with_distance(near, far, scale):
    near, far = sorted((near, far))
    rewards = [reward(e * e, 0.0, scale, 0.05, FLOATS) for e in (0.0, near, far)]
    assert rewards[0] == 1.0
    assert rewards[0] >= rewards[1] >= rewards[2] > 0


def test_reward_of_a_change_of_the_action():
    assert reward(0.0, 2.0, 1.0, 0.05, FLOATS) == pytest.approx(0.9)


def test_failure_is_beyond_the_lost_distance():
    assert not failed(100.0, 10.0)
    assert failed(math.nextafter(100.0, math.inf), 10.0)
    assert failed(math.nan, 10.0)
    assert failed(np.array([0.0, math.nan, math.inf]), 10.0).tolist() == [False, True, True]

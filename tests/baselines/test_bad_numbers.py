"""Observations with invalid numbers: the last command is repeated once, and the memory stays unchanged."""

import math

import numpy as np
import pytest
from marks import slow_except

from auv_gym.envs.track_vector_env import UnderactuatedAUVTrackVectorEnv
from auv_gym.task.observation import PLANE_LAYOUT, SIZE, Observation, encode_observation
from auv_gym.task.policy import LARGEST, last_commands, measured, preview_of, usable
from baselines import list_policies, make_policy
from baselines.policy import Privileged, Remembering

PLAIN = [name for name in list_policies() if not isinstance(make_policy(name), Privileged)]
WRAPPED = ["helm:guard", "ppo-cruise:guard=ekf"]
GUARDED = [*PLAIN, *WRAPPED, "helm:guard=nmpc-adverse"]
BAD = (math.nan, math.inf, -math.inf, 1e30, -1e30)
NOT_POSITIVE = (0.0, -1.0)  # invalid for limits and control period
LAST = slice(15, 17)  # the last action among the terms
N = 3
pytestmark = pytest.mark.filterwarnings("ignore:this policy was trained at", "ignore:these gains are stable")


def environment(policy):
    return UnderactuatedAUVTrackVectorEnv(N, "cruise-storm", preview=preview_of(policy))


def started(name, steps=4):
    """Return a policy, its memory after some control periods, and the next two observations of each vehicle."""
    policy = make_policy(name)
    env = environment(policy)
    observation, memory = env.reset(seed=3)[0], None
    for _ in range(steps):
        action, memory = policy.predict(observation, memory)
        observation = env.step(action)[0]
    following = env.step(policy.predict(observation, memory)[0])[0]
    return policy, memory, observation, following


def assert_same(one, other):
    """Assert that two memories are equal to the last bit."""
    assert (one is None) == (other is None)
    for a, b in zip(one or (), other or (), strict=True):
        np.testing.assert_array_equal(a, b)


def of_vehicle(memory, i):
    return memory and tuple(array[i : i + 1].copy() for array in memory)


@pytest.mark.parametrize("name", [*PLAIN, *WRAPPED])
def test_one_vehicle_repeats_its_command(name):
    """For every entry of the observation, and every invalid value."""
    policy, memory, observation, following = started(name)
    own, good, after = of_vehicle(memory, 1), observation[1], following[1]
    expected, kept = policy.predict(after, own)
    for column in range(len(good)):
        for value in (*BAD, *NOT_POSITIVE) if column in PLANE_LAYOUT.positive else BAD:
            bad = good.copy()
            bad[column] = value
            action, held = policy.predict(bad, own)
            commanded = good[LAST].astype(np.float32)
            if column in (15, 16):
                commanded[column - 15] = 0.0
            np.testing.assert_array_equal(action, commanded, err_msg=f"{value} in column {column}")
            assert (action.dtype, action.shape) == (np.float32, (2,))
            assert_same(held, own)
    again, remembered = policy.predict(after, held)
    np.testing.assert_array_equal(again, expected)
    assert_same(remembered, kept)
    assert policy.repeated == len(good) * len(BAD) + len(PLANE_LAYOUT.positive) * len(NOT_POSITIVE)


@pytest.mark.parametrize("name", [*PLAIN, *WRAPPED])
def test_the_others_of_a_batch_are_not_affected(name):
    policy, memory, observation, following = started(name)
    expected, after = policy.predict(observation, memory)
    numbers = ((math.nan, 0), (math.inf, 4), (1e30, 12), (0.0, 13), (-1.0, 14), (0.0, 17), (math.nan, -1))
    for value, column in numbers:
        bad = observation.copy()
        bad[1, column] = value
        action, held = policy.predict(bad, memory)
        np.testing.assert_array_equal(action[[0, 2]], expected[[0, 2]])
        np.testing.assert_array_equal(action[1], observation[1, LAST].astype(np.float32))
        for i in range(N):
            assert_same(of_vehicle(held, i), of_vehicle(memory if i == 1 else after, i))
    assert np.isfinite(policy.predict(following, held)[0]).all()


@pytest.mark.parametrize("name", [*PLAIN, *WRAPPED])
def test_an_episode_with_an_invalid_first_observation_begins_with_the_second(name):
    """For one vehicle, for a batch, and for an episode of one vehicle that begins later than those of the others."""
    policy = make_policy(name)
    env = environment(policy)
    first = env.reset(seed=3)[0]
    second = env.step(np.zeros((N, 2)))[0]
    bad = first.copy()
    bad[1, 0] = math.nan
    action, memory = policy.predict(bad[1])
    np.testing.assert_array_equal(action, [0.0, 0.0])
    action, memory = policy.predict(second[1], memory)
    expected, after = policy.predict(second[1])
    np.testing.assert_array_equal(action, expected)
    assert_same(memory, after)

    _, memory = policy.predict(first)
    start = np.array([False, True, False])
    expected, after = policy.predict(second, memory, start)
    for state, begins in ((None, None), (memory, start)):
        action, waiting = policy.predict(bad, state, begins)
        np.testing.assert_array_equal(action[1], [0.0, 0.0])
        action, waiting = policy.predict(bad, waiting) if state else (action, waiting)
        found, remembered = policy.predict(second, waiting)
        np.testing.assert_array_equal(found[1], expected[1])
        assert_same(of_vehicle(remembered, 1), of_vehicle(after, 1))
        if state is None:
            np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("name", [*PLAIN, *WRAPPED])
def test_memory_and_actions_stay_finite_after_one_distant_position(name):
    """The position is a valid number, so policies use it."""
    policy, memory = make_policy(name), None
    env = environment(policy)
    observation = env.reset(seed=5)[0]
    for k in range(60):
        seen = observation.copy()
        seen[:, 0] = 3e3 if k == 10 else seen[:, 0]
        action, memory = policy.predict(seen, memory)
        assert np.isfinite(action).all()
        assert all(np.isfinite(array).all() for array in memory or ())
        observation = env.step(action)[0]


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("name", slow_except({*GUARDED} - {"lqi"}, GUARDED))  # lqi solves many Riccati equations
def test_commands_are_finite_for_every_observation_of_the_space(name):
    """For random, extreme, tiny and zero entries, of which four of five observations are repeated."""
    policy, rng, n = make_policy(name), np.random.default_rng(0), 32
    space = environment(policy).single_observation_space
    low, high, shape = space.low, space.high, (n, *space.shape)
    seen, memory = np.zeros(shape), None
    for _ in range(60):
        usual = rng.uniform(low, high, shape)
        extreme = np.where(rng.random(shape) < 0.5, low, high)
        tiny = usual * 10.0 ** rng.uniform(-300, 0, shape)
        entries = np.choose(rng.integers(4, size=shape), [usual, extreme, tiny, np.zeros(shape)])
        drawn = np.choose(rng.integers(4, size=(n, 1)), [usual, extreme, tiny, entries])
        seen = np.where(rng.random((n, 1)) < 0.2, drawn, seen)
        action, memory = policy.predict(seen, memory)
        assert (np.abs(action) <= 1.0).all()


class Counter(Remembering):
    """A controller that counts its calls; its command depends on the count by a given law."""

    def __init__(self, law):
        super().__init__(self)
        self.law = law

    def start(self, n):
        return (np.zeros((n, 2)),)

    def forces(self, o, memory, extra):
        (count,) = memory
        with np.errstate(all="ignore"):
            return 10.0 + self.law(count[:, 0]), np.zeros(len(count)), (count + 1.0,)


@pytest.mark.parametrize("law", [lambda x: x, lambda x: 0.0 * np.where(x < 1e9, x, 0.0)])
def test_a_memory_that_is_not_finite_is_reset(law):
    """Whether the command is finite or not; the memory of other vehicles is unchanged."""
    policy = Counter(law)
    rows = np.tile(encode_observation(Observation(*np.ones(SIZE))._replace(F_u_max=100.0, F_r_max=100.0)), (3, 1))
    memory = (np.array([[1.0, 1.0], [math.nan, 1.0], [3.0, math.inf]]),)
    action, after = policy.predict(rows, memory, np.zeros(3, dtype=bool))
    first, _ = policy.predict(rows, None, np.ones(3, dtype=bool))
    np.testing.assert_array_equal(after[0], [[2.0, 2.0], [1.0, 1.0], [1.0, 1.0]])
    np.testing.assert_array_equal(action[1:], first[1:])
    assert action[0, 0] == pytest.approx(0.01 * (10.0 + law(np.ones(1))[0]))
    assert policy.repeated == 0


def test_usable_observations():
    rows = np.tile(encode_observation(Observation(*np.full(SIZE, 0.5))), (6, 1))
    assert measured(rows)
    assert usable(rows).all()
    rows[1, 3], rows[2, 13], rows[3, 17], rows[4, 6], rows[5, 0] = LARGEST * 1.1, 0.0, -1.0, math.nan, LARGEST * 0.9
    assert usable(rows).tolist() == [True, False, False, False, False, True]
    assert not measured(rows)
    rows[:, LAST] = [[0.5, -0.5], [1.5, 0.1], [math.nan, -1.0], [0.0, math.inf], [1.0, 1.0], [-1.0, 0.25]]
    expected = [[0.5, -0.5], [0.0, 0.1], [0.0, -1.0], [0.0, 0.0], [1.0, 1.0], [-1.0, 0.25]]
    np.testing.assert_array_equal(last_commands(rows), np.array(expected, np.float32))


def test_large_valid_numbers_are_used():
    """The sum of their squares exceeds the fast check, so each number is checked."""
    policy, memory, observation, _ = started("helm:guard")
    observation[1, :2] = 0.9 * LARGEST
    action, _ = policy.predict(observation, memory)
    assert np.isfinite(action).all()
    assert (action[1] != last_commands(observation)[1]).any()

"""The guard of an agent: its alarms by hand and its handover."""

import itertools
import math

import gymnasium as gym
import numpy as np
import pytest

from auv_gym.physics.namespaces import ARRAYS
from auv_gym.physics.vehicle import PAPER_VEHICLE
from auv_gym.scenarios.presets import PRESETS
from auv_gym.task.observation import Observation, encode_observation
from baselines import make_policy
from baselines.agents import guard
from baselines.agents.guard import ALARMS, GUARD_SHARE, LEFT, MEAN, Guarded, Thresholds, bounded_law
from baselines.control.backstepping import GAINS, lyapunov_terms
from baselines.evaluation.cells import drawn
from baselines.evaluation.rollout import rollout


def observed(**terms):
    """Return an observation at cruise with the given terms; all other errors are zero."""
    usual = {"u_R": 1.0, "cos_psi": 1.0, "F_u_max": 400.0, "F_r_max": 200.0, "dt": 0.1}
    return encode_observation(Observation(**{**dict.fromkeys(Observation._fields, 0.0), **usual, **terms}))


class Constant:
    """A policy with a constant action."""

    def __init__(self, *action):
        self.action = np.array(action, dtype=np.float32)

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.tile(self.action, (len(observation), 1)) if observation.ndim > 1 else self.action, state


def guard_steps(observations):
    """Return the commands and the memory of a guard for a sequence of observations."""
    policy, state, found = Guarded(Constant(0.5, -0.5), Constant(-1.0, 1.0)), None, []
    for o in observations:
        action, state = policy.predict(o, state)
        found.append((action, state[0][0].copy()))
    return found


def test_energy_is_the_scaled_lyapunov_function():
    """At 1 m/s and in units of T = 1/(k + k1), against V4 of errors that are scaled by hand."""
    gains, rate = GAINS["cruise"], GAINS["cruise"].k + GAINS["cruise"].k1
    o = Observation(*np.zeros((18, 1)))._replace(e_x=np.array([1.0 / rate]), u_R=np.array([1.0]))
    found, found_rate = guard.energy(o, PAPER_VEHICLE)
    assert found_rate[0] == rate
    assert found[0] == pytest.approx(0.5 * (1.0 + 1.0))  # e and z_u = (k + k1) e; z_v, psi_e and z_r are 0
    turned = o._replace(e_x=np.zeros(1), psi_e=np.array([0.3]))
    V4 = lyapunov_terms(turned, PAPER_VEHICLE, gains, ARRAYS)[3]
    z_r = gains.cr * 0.3
    assert V4[0] == pytest.approx(0.5 * (0.09 + z_r**2))
    assert guard.energy(turned, PAPER_VEHICLE)[0][0] == pytest.approx(0.5 * (0.09 + (z_r / rate) ** 2))


def test_errors_that_do_not_grow_raise_no_alarm():
    """Small ones that decrease; a far start; and a current that is too strong for the law."""
    for action, memory in guard_steps([observed(e_x=0.5 * math.exp(-0.02 * k), a_r=1.0) for k in range(100)]):
        np.testing.assert_array_equal(action, np.float32([0.5, -0.5]))
        assert (memory[ALARMS], memory[GUARD_SHARE], memory[LEFT]) == (0, 1, 0)
    assert guard_steps([observed(e_x=12 * math.exp(-0.01 * k), a_r=1.0) for k in range(200)])[-1][1][ALARMS] == 0
    assert guard_steps([observed(e_x=12.0, a_r=1.0) for _ in range(300)])[-1][1][ALARMS] == 0


def test_a_growing_error_raises_an_alarm_and_the_fallback_takes_over_smoothly():
    """The error grows linearly: its energy (rate e)^2 reaches the threshold, and it is twice its mean."""
    t, rate = Thresholds(), GAINS["cruise"].k + GAINS["cruise"].k1
    found = guard_steps([observed(e_x=0.1 * k) for k in range(200)])
    first = next(k for k, (_, own) in enumerate(found) if own[ALARMS])
    assert (rate * 0.1 * first) ** 2 > t.most > (rate * 0.1 * (first - 1)) ** 2
    shares = [own[GUARD_SHARE] for _, own in found[first : first + 10]]
    assert all(0 <= a - b <= 0.1 * rate / t.take + 1e-9 for a, b in itertools.pairwise(shares))
    for action, own in found:
        expected = np.float32([0.5, -0.5]) * own[GUARD_SHARE] + np.float32([-1.0, 1.0]) * (1 - own[GUARD_SHARE])
        np.testing.assert_allclose(action, expected, atol=1e-6)
    assert found[first + 10][1][GUARD_SHARE] == 0
    np.testing.assert_array_equal(found[first + 10][0], np.float32([-1.0, 1.0]))


def test_the_threshold_is_lower_while_the_yaw_command_is_saturated():
    """The energy rises from 1 to 36: an alarm only if the command has been saturated."""
    errors = [0.8 + 4.0 * min(1.0, max(0.0, k / 20 - 5)) for k in range(200)]
    assert not any(own[ALARMS] for _, own in guard_steps([observed(e_x=e, a_r=0.9) for e in errors]))
    assert guard_steps([observed(e_x=e, a_r=-1.0) for e in errors])[-1][1][ALARMS] == 1


def test_the_policy_regains_control_and_later_after_each_alarm():
    """The error is zero while the fallback has control, and grows again afterwards."""
    t, rate = Thresholds(hold=4.0, longer=3.0), GAINS["cruise"].k + GAINS["cruise"].k1
    policy, state, held, e = Guarded(Constant(0.5, -0.5), Constant(-1.0, 1.0), thresholds=t), None, [], 0.0
    for _ in range(900):
        e = 0.0 if state is not None and state[0][0, LEFT] > 0 else e + 0.2
        _, state = policy.predict(observed(e_x=e), state)
        held.append(state[0][0, LEFT])
    begins = [h for before, h in itertools.pairwise(held) if h > before]
    np.testing.assert_allclose(begins[:3], [4.0 / rate, 12.0 / rate, 36.0 / rate])


def test_the_memory_is_reset_with_the_episode():
    policy = Guarded(Constant(0.5, -0.5), Constant(-1.0, 1.0))
    state = None
    for k in range(100):
        rows = np.stack([observed(e_x=0.2 * k)] * 2)
        _, state = policy.predict(rows, state)
    assert state[0][:, ALARMS].tolist() == [1, 1]
    _, state = policy.predict(rows, state, np.array([True, False]))
    assert state[0][:, ALARMS].tolist() == [0, 1]
    assert state[0][0, MEAN] > state[0][1, MEAN]


def test_without_an_alarm_an_agent_with_a_guard_is_the_agent():
    scenario = PRESETS["cruise-noise"]
    episodes = drawn(scenario, 3, 7).episodes
    own, guarded = (rollout(make_policy(name), scenario, episodes) for name in ("ppo-cruise", "ppo-cruise:guard"))
    np.testing.assert_array_equal(own.errors, guarded.errors)


class Saturated:
    """An agent whose commands are saturated after some control steps."""

    def __init__(self, policy, after):
        self._policy, self.preview, self._left = policy, policy.preview, after

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        self._left -= 1
        actions, state = self._policy.predict(observation, state, episode_start)
        return actions if self._left >= 0 else np.ones_like(actions), state


def test_the_law_takes_over_from_a_saturated_agent():
    """Without a guard the vehicle turns in circles until the end; with one it returns to the path."""
    scenario = PRESETS["cruise-calm"]
    episodes = drawn(scenario, 2, 7).episodes
    plain, inner = (Saturated(make_policy("ppo-cruise"), scenario.steps // 3) for _ in range(2))
    without, guarded = (rollout(p, scenario, episodes).errors[-1] for p in (plain, Guarded(inner, bounded_law())))
    assert (without > 2.0).all()
    assert (guarded < 2.0).all()


def test_after_the_handover_the_commands_are_those_of_the_fallback_bit_for_bit():
    """With a very low threshold the fallback takes over within the first second."""
    eager = Guarded(make_policy("helm"), make_policy("ekf"), thresholds=Thresholds(most=1e-3, start=1e-3, growth=1e-3))
    env = gym.make("auv_gym:UnderactuatedAUVTrack-v0", scenario="cruise-storm", preview=eager.preview)
    state, law, memory, taken = None, make_policy("ekf"), None, 0
    observation, _ = env.reset(seed=3)
    for _ in range(60):
        action, state = eager.predict(observation, state)
        alone, memory = law.predict(observation[:18], memory)
        if state[0][0, GUARD_SHARE] == 0:
            np.testing.assert_array_equal(action, alone)
            taken += 1
        observation, *_ = env.step(action)
    assert taken > 40


def test_the_suffix_works_for_another_vehicle():
    policy = make_policy("helm-small:guard", "lauv")
    rows = np.concatenate((observed(e_x=1.0), np.zeros(2 * len(policy.preview))))
    assert np.isfinite(policy.predict(rows)[0]).all()

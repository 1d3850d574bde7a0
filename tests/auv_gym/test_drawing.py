"""The noise of episodes equals that of NumPy, and samples by compiled code those in Python."""

from dataclasses import replace

import numpy as np
import pytest

from auv_gym.effects.current import RandomCurrent
from auv_gym.effects.sensors import Sensors
from auv_gym.envs.sub_environments import SubEnvironments
from auv_gym.scenarios import exogenous
from auv_gym.scenarios.exogenous import ExogenousInputs
from auv_gym.scenarios.presets import PRESETS
from auv_gym.task.simulation import NOISE, SAMPLE_ROWS

STORM = PRESETS["cruise-storm"]


@pytest.mark.parametrize("gust", [0.0, 0.1])
def test_noise_equals_that_of_numpy(gust):
    """Hundreds of thousands of numbers, read in blocks, to the last bit."""
    sensors, n_envs, steps = Sensors(1.0, 1.0, 1.0, 1.0), 40, 900
    scenario = replace(STORM, sensors=sensors, current=RandomCurrent(speed=0.1, gust=gust) if gust else None)
    inputs, width = ExogenousInputs(n_envs, 300, scenario.parts), 8 if gust else 6
    rng = np.random.default_rng(1)
    episodes = [scenario.draw(rng) for _ in range(n_envs)]
    for i, episode in enumerate(episodes):
        inputs.load(i, scenario, episode, np.ones((steps, 8)))
    noise = np.concatenate([inputs.read(np.arange(n_envs), n)[:, NOISE] for n in (1, 299, 300, 7, 293)])
    for i, episode in enumerate(episodes):
        expected = np.random.Generator(np.random.SFC64(episode.noise_seed)).standard_normal((steps, width))[:, :6]
        np.testing.assert_array_equal(noise[:, :, i], expected)


@pytest.mark.parametrize("seed", [0, 1, 2**32 - 1, 2**32, 2**63 - 1, 2**64 - 1, 2**80 + 5])
def test_states_equal_those_of_the_generator_of_numpy(seed):
    (state,) = exogenous._states_of([seed], exogenous.compiled())
    np.testing.assert_array_equal(state, np.random.SFC64(seed).state["state"]["state"])


def test_compiled_samples_equal_those_in_python(monkeypatch):
    """With gusts, a cap, waves, noise and biases, in any order of the sub-environments."""
    sensors = replace(STORM.sensors, heading_bias=(-0.05, 0.05), velocity_bias=0.01)
    scenario = replace(STORM, sensors=sensors, current=replace(STORM.current, turn=(-0.05, 0.05)))
    envs, other = SubEnvironments([scenario] * 12), SubEnvironments([scenario] * 12)
    envs.reset(0, None)
    with monkeypatch.context() as patch:
        patch.setattr(exogenous, "compiled", lambda *_, **__: None)
        other.reset(0, None)
        expected = np.empty((64, SAMPLE_ROWS, 12))
        other._exogenous.read_into(expected, other.all, other.all[::-1])
    found = np.empty((64, SAMPLE_ROWS, 12))
    envs._exogenous.read_into(found, envs.all, envs.all[::-1])
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)

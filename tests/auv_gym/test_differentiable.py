"""The simulation on tensors: the same values as the vector environment, and gradients as by finite differences."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from auv_gym.effects.actuators import Actuators
from auv_gym.effects.faults import FAULT_KINDS, RandomFaults
from auv_gym.effects.navigation import RandomReckoning
from auv_gym.effects.sensors import Sensors
from auv_gym.envs.differentiable import TENSORS, episodes, simulate
from auv_gym.envs.track_vector_env import UnderactuatedAUVTrackVectorEnv
from auv_gym.physics.vehicle import PAPER_VEHICLE
from auv_gym.scenarios.presets import PRESETS, as_scenario
from auv_gym.task.model import PLANE
from auv_gym.task.observation import SCALES
from auv_gym.task.simulation import SAMPLE_ROWS
from baselines.control.backstepping import GAINS, tracking_forces

STORM = PRESETS["cruise-storm"]
FILTERED = replace(STORM, name="filtered", sensors=Sensors(position=0.05, low_pass=1.0))
LIMITED = replace(STORM, actuators=Actuators(250.0, 100.0, 0.3, 100.0, 50.0, delay=2.0, reach=(0.3, 0.6), astern=0.7))
RECKONED = replace(STORM, sensors=replace(STORM.sensors, reckoning=RandomReckoning((1.0, 3.0)), outages=10.0))
COLOURED = replace(STORM, sensors=replace(STORM.sensors, position=(0.01, 0.1), correlation=(1.0, 5.0)))
FAULTY = replace(STORM, faults=RandomFaults(FAULT_KINDS, rate=10.0))


@pytest.mark.parametrize(
    "scenarios",
    [[*PRESETS.values(), FILTERED], [LIMITED, FAULTY, COLOURED], [RECKONED, STORM], [as_scenario("cruise-storm@lauv")]],
    ids=["presets", "actuators-and-sensors", "dead-reckoning", "lift"],
)
def test_equals_the_vector_environment(scenarios):
    steps, env = 100, UnderactuatedAUVTrackVectorEnv(len(scenarios), scenarios, autoreset_mode="NextStep")
    run = episodes(scenarios, steps, seed=3)
    expected, _ = env.reset(seed=3)
    np.testing.assert_allclose(run.observation.T, expected, rtol=0, atol=1e-9)
    state, running, rng = run.state, np.ones(len(scenarios), dtype=bool), np.random.default_rng(0)
    for sample in run.samples:
        actions = rng.uniform(-0.6, 0.6, (len(scenarios), 2))
        mine = simulate(state, torch.from_numpy(actions.T), sample, run.parameters, run.parts)
        expected, reward, terminated, _, info = env.step(actions)
        for found, wanted in (
            (mine.observation.T, expected),
            (mine.reward, reward),
            (mine.failed, terminated),
            (mine.squared_error.sqrt(), info["position_error"]),
            (mine.saturated, info["saturated"]),
        ):
            np.testing.assert_allclose(found.numpy()[running], wanted[running], rtol=0, atol=1e-9)
        state, running = mine.state, running & ~terminated
    assert running.sum() > 0.7 * len(scenarios)


@pytest.mark.parametrize(
    "scenario", [STORM, PRESETS["paper-circle"], RECKONED, LIMITED], ids=["storm", "paper", "reckoned", "limited"]
)
def test_gradients_of_one_step_pass_gradcheck(scenario):
    run = episodes([scenario] * 2, 30, seed=0)
    state = run.state
    for sample in run.samples[:-1]:
        state = simulate(state, torch.full((2, 2), 0.1), sample, run.parameters, run.parts).state
    action = torch.tensor([[0.3, 0.1], [-0.2, 0.7]], dtype=torch.float64)
    inputs = [x.detach().clone().requires_grad_() for x in (state, action, run.samples[-1])]

    def outputs(*x):
        step = simulate(*x, run.parameters, run.parts)
        return step.state, step.observation, step.reward

    assert torch.autograd.gradcheck(outputs, inputs, eps=1e-6, atol=1e-6, rtol=1e-5)


def test_no_nan_gradients_at_zero_error():
    """All values are zero, where square roots and absolute values are not differentiable."""
    run = episodes([PRESETS["slow-calm"]] * 2, 1, seed=0)
    state = torch.zeros(PLANE.plant_rows, 2, dtype=torch.float64, requires_grad=True)
    action = torch.zeros(2, 2, dtype=torch.float64, requires_grad=True)
    sample = torch.zeros(SAMPLE_ROWS, 2, dtype=torch.float64)
    step = simulate(state, action, sample, run.parameters, run.parts)
    terms = (step.observation * torch.from_numpy(SCALES)[:, None]).unbind()
    for gains in ("paper", "normalised"):
        F_u, F_r = tracking_forces(terms, PAPER_VEHICLE, GAINS[gains], TENSORS)
        grads = torch.autograd.grad((step.reward + F_u + F_r).sum(), (state, action), retain_graph=True)
        assert all(torch.isfinite(g).all() for g in grads)

"""The torch simulation: comparison with NumPy, gradients, compilation."""

import logging
import os
import pickle
import subprocess
import sys

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium.error import ResetNeeded

from auv_gym.envs.torch_sim import TorchSimulator, simulate, step_function
from auv_gym.physics.namespaces import ARRAYS, tensors
from auv_gym.physics.rows import unflatten
from auv_gym.physics.vehicle import PAPER_VEHICLE
from auv_gym.scenarios.presets import PRESETS
from auv_gym.task import simulation
from auv_gym.task.observation import SCALES, SIZE
from auv_gym.task.simulation import PLANT, PLANT_ROWS, SAMPLE_ROWS, Parameters, Parts
from baselines.control.backstepping import GAINS, tracking_forces

TRACK = "auv_gym:UnderactuatedAUVTrack-v0"
FILTERED = {**PRESETS["cruise-storm"].to_dict(), "name": "filtered", "sensors": {"position": 0.05, "low_pass": 1.0}}
LIMITED = {**PRESETS["cruise-actuator"].to_dict(), "name": "rate-limited"}
LIMITED["actuators"] = {"F_u_max": 250.0, "F_r_max": 100.0, "lag": 0.3, "F_u_rate": 100.0, "F_r_rate": 50.0}
MIXED = [*PRESETS, FILTERED, LIMITED]


def eager(n=3, scenario="cruise-storm", dtype="float64"):
    return TorchSimulator(n, scenario, dtype=dtype, compiled=False)


def test_equals_numpy_over_whole_episodes_of_every_preset():
    n = len(MIXED)
    ours, numpy = eager(n, MIXED), gym.make_vec(TRACK, n, "vector_entry_point", scenario=MIXED)
    observation, expected = ours.reset(seed=3)[0], numpy.reset(seed=3)[0]
    rng, worst, ends = np.random.default_rng(0), 0.0, 0
    for _ in range(1010):
        worst = max(worst, np.abs(observation.numpy() - expected).max())
        actions = rng.uniform(-0.6, 0.6, (n, 2))
        observation, reward, terminated, truncated, info = ours.step(torch.from_numpy(actions))
        expected, r, t, u, numpy_info = numpy.step(actions)
        worst = max(worst, np.abs(reward.numpy() - r).max())
        assert (terminated.numpy() == t).all()
        assert (truncated.numpy() == u).all()
        assert ("final_obs" in info) == ("final_obs" in numpy_info)
        for key in ("position_error", "saturated", "time"):
            np.testing.assert_allclose(info[key].numpy(), numpy_info[key], rtol=0, atol=1e-9)
        if (t | u).any():
            ends += (t | u).sum()
            final = np.stack(numpy_info["final_obs"][t | u])
            np.testing.assert_allclose(info["final_obs"][info["_final_obs"]].numpy(), final, rtol=0, atol=1e-9)
    assert ends >= n
    assert worst < 1e-9


def test_float32_stays_close_over_an_episode():
    ours, exact = eager(8, dtype="float32"), eager(8)
    ours.reset(seed=0)
    exact.reset(seed=0)
    for _ in range(100):
        observation, expected = ours.step(torch.zeros(8, 2))[0], exact.step(torch.zeros(8, 2))[0]
    assert observation.dtype == torch.float32
    np.testing.assert_allclose(observation.numpy(), expected.numpy(), rtol=0, atol=2e-3)


def test_reset_mask_and_options():
    sim = eager()
    with pytest.raises(ResetNeeded):
        sim.step(torch.zeros(3, 2))
    sim.reset(seed=0)
    before = sim.step(torch.zeros(3, 2))[0]
    mask = np.array([False, True, False])
    after, info = sim.reset(options={"reset_mask": mask, "initial_error": (3.0, 4.0, 0.0)})
    assert (after[~mask] == before[~mask]).all()
    assert info["position_error"][1] == 5.0
    assert (info["time"] > 0).tolist() == [True, False, True]


@pytest.mark.parametrize(
    ("actions", "message"),
    [
        (torch.zeros(2, 2), r"shape \(2, 2\)"),
        ([[0.0, 0.0]] * 3, "type list"),
        (np.zeros((3, 2), dtype=bool), "type ndarray"),
        (torch.tensor([[0, 0], [0, np.nan], [0, 0]]), "sub-environment 1"),
    ],
)
def test_bad_actions_advance_nothing(actions, message):
    sim, twin = eager(), eager()
    for s in (sim, twin):
        s.reset(seed=2)
    with pytest.raises(ValueError, match=message):
        sim.step(actions)
    assert (sim.step(torch.zeros(3, 2))[0] == twin.step(torch.zeros(3, 2))[0]).all()


def test_actions_may_be_arrays_and_observations_are_copies():
    sim, twin = eager(), eager()
    for s in (sim, twin):
        s.reset(seed=2)[0].fill_(1e3)
    for k in range(3):
        actions = np.full((3, 2), 0.1 * k, dtype=np.float32)
        mine, theirs = sim.step(actions)[0], twin.step(torch.from_numpy(actions))[0]
        assert (mine == theirs).all()
        mine.fill_(1e3)
    mask = {"reset_mask": np.array([True, False, False])}
    assert (sim.reset(options=mask)[0] == twin.reset(options=mask)[0]).all()


def test_pickling_keeps_the_state():
    sim = eager()
    sim.reset(seed=1)
    twin = pickle.loads(pickle.dumps(sim))
    actions = np.full((3, 2), 0.3, dtype=np.float32)
    assert (sim.step(actions)[0] == twin.step(actions)[0]).all()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"device": "cuda:7"}, "choose 'cpu'"),
        ({"device": "abacus"}, "choose 'cpu'"),
        ({"dtype": "float16"}, "float32 or float64"),
        ({"num_envs": 0}, "num_envs is 0"),
        ({"render_mode": "human"}, "do not draw"),
    ],
)
def test_bad_arguments_are_refused(arguments, message):
    arguments = {"num_envs": 2, **arguments}
    with pytest.raises(ValueError, match=message):
        gym.make_vec(TRACK, vectorization_mode="vector_entry_point", backend="torch", **arguments)


def started(n, scenario="cruise-storm", seed=0):
    """Return state, sample and parameters of n running episodes in float64."""
    sim = eager(n, scenario)
    sim.reset(seed=seed)
    for _ in range(5):
        sim.step(torch.full((n, 2), 0.1))
    return sim.state, sim._samples[sim._sub_envs.row + 1], sim._constants


@pytest.mark.parametrize("scenario", ["cruise-storm", "slow-calm", "paper-circle"])
def test_gradients_of_one_step_pass_gradcheck(scenario):
    state, sample, constants = started(2, scenario)
    action = torch.tensor([[0.3, -0.2], [0.1, 0.7]], dtype=torch.float64)
    inputs = [x.detach().clone().requires_grad_() for x in (state, action, sample, constants)]
    inputs[3].requires_grad_(False)

    def outputs(*x):
        step = simulate(*x)
        return step.state, step.observation, step.reward

    assert torch.autograd.gradcheck(outputs, inputs, eps=1e-6, atol=1e-6, rtol=1e-5)


def test_gradients_through_50_steps_equal_finite_differences_of_numpy():
    """With the expert in the loop: through actuators, sensors, observation, tracking law and reward."""
    n, steps, gains = 2, 50, GAINS["cruise"]
    sim = eager(n, FILTERED)
    sim.reset(seed=1)
    start = sim.state.clone()
    samples = torch.stack([sim._samples[k] for k in range(steps + 1)])
    constants = sim._constants.clone()

    def total(state, samples, rows, ns, x, stack):
        """Return the sum of rewards, where x is added to each command; rows of any kind of number."""
        p = Parameters.of(rows, Parts(filtered=True))
        plant, action, result = state, (x[0] * 0, x[1] * 0), 0.0
        for sample in samples[1:]:
            plant, terms, (reward, *_) = simulation.step(plant, action, sample, p, ns)
            F_u, F_r = tracking_forces(terms, PAPER_VEHICLE, gains, ns)
            action = (F_u / terms[13] + x[0], F_r / terms[14] + x[1])
            result = result + stack(reward)
        return result

    def unpacked(state):
        return unflatten(PLANT, state)

    x = torch.full((2, n), 0.02, dtype=torch.float64, requires_grad=True)
    value = total(unpacked(start), samples, constants, tensors(), x, torch.sum)
    value.backward()
    arrays = [a.numpy() for a in (start, samples, constants)]

    def at(x):
        return float(total(unpacked(arrays[0]), arrays[1], tuple(arrays[2]), ARRAYS, x, np.sum))

    assert float(value.detach()) == pytest.approx(at(x.detach().numpy()), abs=1e-9)
    eps = 1e-6
    for index in np.ndindex(2, n):
        shift = np.zeros((2, n))
        shift[index] = eps
        slope = (at(x.detach().numpy() + shift) - at(x.detach().numpy() - shift)) / (2 * eps)
        assert float(x.grad[index]) == pytest.approx(slope, rel=1e-5, abs=1e-7)


def test_no_nan_gradients_at_zero_error():
    """All values are zero, where square roots and absolute values are not differentiable."""
    constants = started(2, "slow-calm")[2]
    state = torch.zeros(PLANT_ROWS, 2, dtype=torch.float64, requires_grad=True)
    action = torch.zeros(2, 2, dtype=torch.float64, requires_grad=True)
    step = simulate(state, action, torch.zeros(SAMPLE_ROWS, 2, dtype=torch.float64), constants)
    terms = (step.observation * torch.from_numpy(SCALES)[:, None]).unbind()
    for gains in ("paper", "normalised"):
        F_u, F_r = tracking_forces(terms, PAPER_VEHICLE, GAINS[gains], tensors())
        grads = torch.autograd.grad((step.reward + F_u + F_r).sum(), (state, action), retain_graph=True)
        assert all(torch.isfinite(g).all() for g in grads)


def test_gradients_end_at_detach_and_at_the_end_of_episodes():
    sim = eager(3, {**PRESETS["cruise-storm"].to_dict(), "steps": 6})
    sim.reset(seed=0)
    actions = torch.zeros(10, 3, 2, dtype=torch.float64, requires_grad=True)
    total = torch.zeros(())
    for k in range(10):
        total = total + sim.step(actions[k])[1].sum()
    total.backward()
    assert torch.isfinite(actions.grad).all()
    assert (actions.grad[[0, 7]].abs().sum(dim=(1, 2)) > 0).all()
    assert sim.state.requires_grad
    assert not sim.detach().requires_grad
    assert not sim.state.requires_grad
    assert not sim.step(torch.zeros(3, 2))[0].requires_grad


def test_gradients_through_the_end_of_a_block_of_samples():
    sim = eager(2)
    sim.reset(seed=0)
    actions = torch.zeros(80, 2, 2, dtype=torch.float64, requires_grad=True)
    sum(sim.step(a)[1].sum() for a in actions).backward()
    assert torch.isfinite(actions.grad).all()


@pytest.fixture(scope="session")
def compiled():
    return TorchSimulator(2, dtype="float32")._step


@pytest.mark.slow
def test_compiled_equals_eager_at_several_sizes(compiled):
    assert not hasattr(compiled, "func"), "compilation fell back to the eager function"
    for n in (5, 70):
        inputs = [x.to(torch.float32) for x in started(n)]
        inputs.insert(1, torch.full((2, n), 0.2))
        with torch.no_grad():
            for ours, exact in zip(compiled(*inputs), simulate(*inputs), strict=True):
                np.testing.assert_allclose(ours.numpy(), exact.numpy(), rtol=1e-5, atol=1e-5)


@pytest.mark.slow
def test_make_vec_returns_the_compiled_environment(compiled):
    env = gym.make_vec(TRACK, 5, "vector_entry_point", backend="torch", scenario="cruise-storm")
    assert env.unwrapped._step is compiled
    observation, _ = env.reset(seed=0)
    assert observation.shape == (5, SIZE)
    for _ in range(70):
        observation, reward, terminated, truncated, info = env.step(torch.zeros(5, 2))
    assert reward.dtype == torch.float32
    assert (terminated.dtype, truncated.dtype) == (torch.bool, torch.bool)
    assert env.observation_space.contains(observation.numpy())
    np.testing.assert_allclose(info["time"].numpy(), 7.0, rtol=1e-5)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:The .grad attribute of a Tensor")  # torch reads it, and hides its own warning
def test_compiled_gradients_equal_eager_gradients(compiled):
    grads = []
    for fast in (True, False):
        sim = TorchSimulator(6, "cruise-storm", compiled=fast)
        sim.reset(seed=0)
        actions = torch.full((4, 6, 2), 0.2, requires_grad=True)
        for action in actions:
            observation, reward, *_ = sim.step(action)
        (observation.sum() + reward.sum()).backward()
        grads.append(actions.grad.numpy())
    np.testing.assert_allclose(*grads, rtol=1e-4, atol=1e-5)


WITHOUT_COMPILER = """
import warnings, torch
from auv_gym.envs.torch_sim import TorchSimulator
with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always")
    for dtype in ("float32", "float64"):
        sim = TorchSimulator(2, dtype=dtype)
        sim.reset(seed=0)
        sim.step(torch.zeros(2, 2))
print(sum("C++ compiler" in str(w.message) for w in caught))
"""


@pytest.mark.slow
def test_without_a_compiler_there_is_one_warning_and_the_step_is_eager(tmp_path):
    kept = {k: v for k, v in os.environ.items() if k not in ("CXX", "CC")}
    hidden = {**kept, "PATH": str(tmp_path), "TORCHINDUCTOR_CACHE_DIR": str(tmp_path)}
    run = subprocess.run(
        [sys.executable, "-c", WITHOUT_COMPILER], env=hidden, capture_output=True, text=True, check=True
    )
    assert run.stdout.strip() == "1", run.stderr


def test_compiling_is_announced(caplog, monkeypatch):
    monkeypatch.setattr(torch, "compile", lambda function, **_: function)
    with caplog.at_level(logging.INFO, logger="auv_gym"):
        step_function.__wrapped__(torch.device("cpu"), torch.float64, Parts(), compiled=True)
    assert "compiling the simulation step" in caplog.text

"""Training by the analytic gradient: gradients, windows as the environment, optimisers, and groups of vehicles."""

import math
import os
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from native_cache import forget
from torch.nn.utils import parameters_to_vector, vector_to_parameters
from window_by_torch import AUTHORITY, LOSS, Setting, group_of

from auv_gym.codegen.native import SWITCH
from auv_gym.envs.differentiable import TENSORS
from auv_gym.envs.track_vector_env import UnderactuatedAUVTrackVectorEnv
from auv_gym.physics.namespaces import ARRAYS, FLOATS
from auv_gym.scenarios.presets import PRESETS
from auv_gym.task.observation import TERMS, Observation
from auv_gym.task.preview import preview_columns
from auv_gym.task.simulation import PARAMETER_ROWS
from baselines import make_policy
from baselines.agents.agent import Agent
from baselines.agents.features import FEATURES, Inputs
from baselines.agents.networks import Gru, Mlp
from baselines.control.open_loop import Zero
from baselines.tools.command_line import WorkerError
from baselines.tools.workers import ProcessObjects, Workers
from baselines.training import vehicle_models
from baselines.training.apg.closed_loop import LINEAR_FROM, SQUARE_WEIGHT, ClosedLoop, Loss, law_of
from baselines.training.apg.muon import Muon, orthogonalised
from baselines.training.apg.network import gates_back, torch_network, weights_of
from baselines.training.apg.settings import Settings, check
from baselines.training.apg.trainer import ApgTrainer, summed, train
from baselines.training.apg.vehicle_group import VehicleGroup, WindowGradient, divided
from baselines.training.apg.window import SMALLEST, divided_by_error
from baselines.training.config import Config
from baselines.training.run_folder import RunFolder, TrainingError, read_progress
from baselines.training.validation import VALIDATION_PRECISION

SIZES = Gru(len(FEATURES), 8, 8, 8)
INPUTS = [Inputs(), Inputs((3, 20)), Inputs((40,), integrals=False), Inputs((3,), fine=True, filters=True)]
WITH_MODEL = Inputs((3,), nominal_vehicle=True)
CASES = [  # expert, whether the network has a memory, and what it sees
    ("backstepping", True, INPUTS[0]),
    ("backstepping", False, INPUTS[1]),
    ("none", True, INPUTS[2]),
    ("ekf", True, INPUTS[1]),
    pytest.param("backstepping", True, INPUTS[3], marks=pytest.mark.slow),
    ("integral-normalised", False, INPUTS[0]),
]


@pytest.fixture(autouse=True)
def one_thread():
    torch.set_num_threads(1)
    torch.manual_seed(0)


def network(head=0.5, sizes=SIZES, dtype=torch.float64):
    made = torch_network(sizes).to(dtype)
    torch.nn.init.normal_((made.head if isinstance(sizes, Gru) else made.layers[-1]).weight, std=head)
    return made


def gradient_of(net):
    return torch.cat([p.grad.ravel() for p in net.parameters()])


@pytest.fixture(params=["compiled", "interpreted"])
def native(request, monkeypatch):
    """With a compiler, and without."""
    if request.param == "interpreted":
        monkeypatch.setenv(SWITCH, "0")
    for clear in (forget, gates_back.cache_clear):
        clear()
    yield
    for clear in (forget, gates_back.cache_clear):
        clear()


@pytest.mark.usefixtures("native")
@pytest.mark.parametrize(
    ("expert", "memory", "inputs"), [*CASES, pytest.param("backstepping", False, WITH_MODEL, marks=pytest.mark.slow)]
)
def test_gradient_equals_that_of_torch(expert, memory, inputs):
    n = len(inputs.features)
    sizes = Gru(n, 8, 6, 7) if memory else Mlp(n, (8, 6), bound="tanh")
    for precision, tolerance in (("float64", 1e-9), ("float32", 1e-6)):
        torch.manual_seed(0)
        net = network(sizes=sizes, dtype=getattr(torch, precision))
        names = ["slow-storm", "cruise-actuator", "cruise-storm", "cruise-noise"]
        mine, theirs = (Setting(names, net, expert, inputs, 12, precision) for _ in range(2))
        value, _ = mine.run()
        found = gradient_of(net)
        net.zero_grad()
        expected = theirs.by_torch()
        expected.backward()
        near = tolerance if mine.exact else 1e-5  # its actions are in float32
        assert value == pytest.approx(float(expected.detach()), rel=near)
        assert float((found - gradient_of(net)).norm()) <= near * float(gradient_of(net).norm())


def test_initial_action_is_that_of_the_expert():
    for sizes in (SIZES, Mlp(4, (8, 8))):
        last = [*torch_network(sizes).named_parameters()]
        assert [bool(p.any()) for name, p in last if name.startswith(("head", "layers.2"))] == [False, False]


@pytest.mark.parametrize(("expert", "memory", "inputs"), CASES)
def test_equals_the_policy_in_the_environment(expert, memory, inputs):
    """Expert, features, network and vehicle in one window do what the policy does in the environment."""
    n = len(inputs.features)
    sizes = Gru(n, 8, 8, 8) if memory else Mlp(n, (8, 8), bound="tanh")
    names, net = ["slow-storm", "cruise-actuator", "cruise-storm"], network(sizes=sizes)
    setting = Setting(names, net, expert, inputs)
    policy = Agent(sizes, weights_of(net), expert, AUTHORITY, inputs=inputs).policy()
    env = UnderactuatedAUVTrackVectorEnv(3, names, preview=policy.preview)
    (observation, _), memory = env.reset(seed=7), None
    for _ in range(8):
        _, squared_error = setting.run()
        for _ in range(5):
            action, memory = policy.predict(observation, memory)
            observation, *_, info = env.step(action)
        terms = observation[:, : len(TERMS)]
        np.testing.assert_allclose(setting.carried.observation.T, terms, atol=3e-5)  # actions are in float32
        np.testing.assert_allclose(np.sqrt(squared_error), info["position_error"], atol=1e-5)


def test_gradient_equals_finite_differences():
    """Along a random direction in the space of all weights."""
    names, net, step = ["cruise-storm", "slow-mismatch", "cruise-gauss-markov"], network(0.1), 1e-5

    def loss(weights):
        vector_to_parameters(weights, net.parameters())
        return Setting(names, net, steps=12).run()[0]

    weights = parameters_to_vector(net.parameters()).detach().clone()
    loss(weights)
    direction, gradient = torch.randn_like(weights), gradient_of(net).clone()
    sides = [loss(weights + sign * step * direction) for sign in (1, -1)]
    assert float(gradient @ direction) == pytest.approx((sides[0] - sides[1]) / (2 * step), rel=1e-4)


def test_gradient_with_an_error_exponent():
    """The gradient is that of the mean loss with other shares, which by ratios are one over the errors."""
    names, net = ["cruise-storm", "slow-mismatch", "cruise-gauss-markov"], network(0.1)

    def found(**options):
        setting = Setting(names, net, steps=12, **options)
        setting.run()
        return gradient_of(net), setting.window._errors()

    even, errors = found(error_exponent=0.5)
    assert errors.max() > 1.5 * errors.min() > 0
    shares = 1 / np.sqrt(errors + SMALLEST)
    expected, _ = found(shares=shares / shares.sum())
    assert float((even - expected).norm()) <= 1e-12 * float(expected.norm())
    assert float((even - found()[0]).norm()) > 0.01 * float(expected.norm())


@given(st.lists(st.floats(0, 1e30) | st.just(math.nan) | st.just(math.inf), min_size=1, max_size=6), st.floats(0, 1))
def test_even_shares_keep_their_sum_and_decrease_with_the_error(errors, error_exponent):
    errors = np.array(errors)
    shares = divided_by_error(np.full(len(errors), 1 / len(errors)), errors, error_exponent)
    assert shares.sum() == pytest.approx(1)
    order = np.argsort(errors)  # what is no number comes last
    assert (np.diff(shares[order]) <= 1e-12).all()


def test_loss_has_a_continuous_positive_slope():
    e = torch.tensor([0.0, 1e-3, LINEAR_FROM - 1e-6, LINEAR_FROM + 1e-6, 50.0], dtype=torch.float64, requires_grad=True)
    still, one = torch.zeros(2, 5, dtype=torch.float64), torch.ones(5, dtype=torch.float64)
    values = Loss().of(e * e, one, still, still, one, TENSORS)
    values.sum().backward()
    values = values.detach()
    assert torch.isfinite(e.grad).all()
    assert (e.grad[1:] > 0).all()
    assert float(e.grad[2]) == pytest.approx(float(e.grad[3]), rel=1e-4)
    assert float(values[2]) == pytest.approx(LINEAR_FROM + SQUARE_WEIGHT * LINEAR_FROM**2, rel=1e-4)
    moved = Loss(effort=0.5, rate=0.08).of(0.0, 1.0, (0.1, 0.1), (0.0, 0.0), 0.2, FLOATS)
    assert moved == pytest.approx(1e-3 + 0.5 * 0.02 + 2 * 0.02, rel=1e-4)


def test_derivatives_of_diverging_vehicles_are_bounded():
    """A high bound changes nothing; a low one shortens the gradient; a derivative that is no number counts nothing."""
    names, found = ["cruise-storm", "cruise-actuator", "cruise-noise"], {}
    for bound in (0.0, 1e9, 0.01):
        torch.manual_seed(0)
        setting = Setting(names, network(), "backstepping", steps=12, derivative_bound=bound)
        setting.run()
        found[bound] = gradient_of(setting.net).clone()
    assert torch.equal(found[0.0], found[1e9])
    assert float(found[0.01].norm()) < 0.9 * float(found[0.0].norm())
    setting.window._d["d_state"][:, 1] = np.nan
    setting.window._bound(12.0)
    assert (setting.window._d["d_state"][:, 1] == 0).all()


def test_each_speed_range_has_its_weights():
    settings = Settings(effort_weight=0.2, cruise_effort_weight=0.1, rate_weight=0.3, cruise_share=0.25)
    objective = settings.objective(["slow-calm", "slow-storm", "cruise-calm"])
    assert np.array(objective.loss.effort).tolist() == [0.2, 0.2, 0.1]
    assert np.array(objective.loss.rate).tolist() == [0.3, 0.3, 0.3]
    assert objective.shares.tolist() == [0.375, 0.375, 0.25]
    assert settings.objective(["cruise-calm"] * 4).shares.tolist() == [0.25] * 4


def test_a_batch_begins_episodes_between_windows():
    short = replace(PRESETS["slow-calm"], steps=20)
    group = group_of([[short]] * 4, n_steps=6)
    assert group.sub_envs.constants.shape == (PARAMETER_ROWS, 4)
    begun = []
    for _ in range(9):
        assert [len(rows) for rows in group.exogenous_inputs()] == [6, 6]
        marked = group.carried._replace(hidden=np.ones((64, 4)), integrals=np.ones((4, 4)))
        group.renew(marked, np.zeros(4))
        begins = group.carried.hidden[0] == 0
        assert begins.tolist() == group.begins.tolist()
        assert (group.carried.integrals[0] == 0).tolist() == begins.tolist()
        assert (group.carried.state[:, begins] != marked.state[:, begins]).any(axis=0).all()
        assert (group.carried.state[:, ~begins] == marked.state[:, ~begins]).all()
        begun.append(begins.nonzero()[0].tolist())
    # The first episodes are 6, 12, 18 and 6 steps long, all others 18: three windows.
    assert begun == [[0, 3], [1], [2], [0, 3], [1], [2], [0, 3], [1], [2]]
    group.exogenous_inputs()
    group.renew(group.carried, np.array([0.0, 0.0, 1e6, np.nan]))
    assert group.begins.tolist() == [True, False, True, True]  # the last two have failed


def test_windows_and_their_renewal_are_steps_of_the_environment():
    """Observations, previews and the beginnings of episodes are those of the environment."""
    scenario = replace(PRESETS["cruise-storm"], steps=8)
    group = group_of([[scenario]] * 3, 5, n_steps=4, preview=(1, 4))
    env = UnderactuatedAUVTrackVectorEnv(3, scenario, preview=(1, 4))
    group._left[:] = 8
    loop, (observation, _) = ClosedLoop(law_of(Zero())[0], parts=group.sub_envs.parts), env.reset(seed=5)
    rng = np.random.default_rng(0)
    for ends in (False, True, False, True):
        state, terms, constants = group.carried.state, group.carried.observation, group.sub_envs.constants
        for ahead, sample in zip(*group.exogenous_inputs(), strict=True):
            columns = preview_columns(ahead, Observation._make(terms), ARRAYS, bound_factor=1)
            np.testing.assert_allclose(np.transpose(columns), observation[:, len(TERMS) :], rtol=0, atol=1e-12)
            actions = rng.uniform(-0.3, 0.3, (3, 2))
            moved = loop.move(state, actions.T, np.zeros((2, 3)), sample, constants, AUTHORITY, LOSS, ARRAYS)
            state, terms = np.array(moved.state), np.array(moved.observation)
            observation, _, _, truncated, _ = env.step(actions)
        assert truncated.tolist() == [ends] * 3
        group.renew(group.carried._replace(state=state, observation=terms), moved.squared_error)
        np.testing.assert_allclose(group.carried.observation.T, observation[:, : len(TERMS)], rtol=0, atol=1e-12)


def configuration(**changes):
    scenarios = tuple((replace(PRESETS[name], steps=50), 1.0) for name in ("cruise-current", "cruise-storm"))
    settings = {"n_envs": 8, "n_steps": 10, "hidden_size": 16, "learning_rate": 5e-3}
    usual = {"authority": (0.5, 0.5), "timesteps": 8 * 10 * 50, "hyperparameters": settings, "scenarios": scenarios}
    return Config(**(usual | changes))


@pytest.mark.slow
def test_training_improves_and_returns_the_best_agent(tmp_path):
    run = RunFolder(configuration(), tmp_path)
    agent = train(run)
    run.close()
    scores, losses = ([row[name] for row in read_progress(tmp_path) if name in row] for name in ("score", "loss"))
    assert len(scores) == 21
    assert max(scores) > 0.01
    assert np.mean(losses[-10:]) < np.mean(losses[:10])
    assert run.validation.run(agent.policy(precision=VALIDATION_PRECISION)).score == max(scores)
    assert run.validation.run(agent.policy()).score == pytest.approx(max(scores), abs=1e-5)


@pytest.mark.parametrize("shape", [(12, 30), (30, 12), (16, 16)])
def test_muon_is_that_of_torch_in_single_precision(shape):
    """The reference computes in bfloat16, which has three digits."""
    rng = torch.Generator().manual_seed(0)
    own, theirs = (torch.nn.Parameter(torch.zeros(shape)) for _ in range(2))
    ours, reference = Muon([own], 0.1, 0.2), torch.optim.Muon([theirs], lr=0.1, weight_decay=0.2)
    for _ in range(5):
        own.grad = theirs.grad = torch.randn(shape, generator=rng)
        ours.step()
        reference.step()
    torch.testing.assert_close(own, theirs, rtol=0, atol=0.05 * float(theirs.detach().abs().max()))
    values = torch.linalg.svdvals(orthogonalised(torch.randn(shape, generator=rng)))
    assert ((values > 0.6) & (values < 1.3)).all()
    assert not orthogonalised(torch.zeros(shape)).any()


@pytest.mark.parametrize("sizes", [SIZES, Mlp(4, (8, 8))])
def test_updates_of_matrices_are_orthogonal(sizes):
    """Under a gradient that is a thousand times steeper in one direction than in another; all other weights by Adam."""
    net = torch_network(sizes)
    before = {name: p.detach().clone() for name, p in net.named_parameters()}
    for p in net.parameters():
        p.grad = torch.randn_like(p)
        if p.ndim == 2:
            u, s, v = torch.linalg.svd(p.grad, full_matrices=False)
            p.grad = u @ torch.diag(torch.logspace(0, -3, len(s))) @ v
    for optimizer in Settings(learning_rate=1e-3, matrix_learning_rate=0.1, weight_decay=0.0).optimizers(net):
        optimizer.step()
    for name, p in net.named_parameters():
        change = (p - before[name]).detach()
        if p.ndim == 2 and not name.startswith(("head", "layers.2")):
            sizes_of = torch.linalg.svdvals(change)
            assert 0.05 < float(sizes_of[0]) < 0.25, name
            assert float(sizes_of[-1]) > 0.2 * float(sizes_of[0]), name
        else:
            np.testing.assert_allclose(change.abs(), 1e-3, rtol=1e-3)  # Adam's first step


def test_adam_updates_matrices_without_a_rate_for_muon():
    net = torch_network(SIZES)
    [optimizer] = Settings(matrix_learning_rate=0.0).optimizers(net)
    assert isinstance(optimizer, torch.optim.Adam)
    assert len(optimizer.param_groups[0]["params"]) == len([*net.parameters()])


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ({"n_env": 8}, "no entry 'n_env'"),
        ({"n_envs": 1}, "1 vehicles are too few for 2 scenarios"),
        ({"n_steps": 51}, "at most 50"),
        ({"hidden_size": 0}, "is 0; it must be an integer"),
        ({"memory": 1}, "memory is 1"),
        ({"preview": [0]}, "preview is"),
        ({"n_envs": 8, "groups": 5}, "groups is 5; with n_envs 8 it must be at most 4"),
    ],
)
def test_refuses_settings(settings, says):
    with pytest.raises(ValueError, match=says):
        check(configuration(hyperparameters=settings))


def test_expert_and_network_have_separate_previews(tmp_path):
    """Expert and network ask for different times; in training as in use each gets its own."""
    settings = configuration().hyperparameters | {"preview": (3, 20)}
    trainer = ApgTrainer(RunFolder(configuration(expert="nmpc", hyperparameters=settings), tmp_path))
    policy, nmpc = trainer.agent(trainer.weights).policy(), make_policy("nmpc")
    assert policy.preview == (1, 2, 3, *nmpc.preview[2:])
    actions = []
    for preview in (policy.preview, nmpc.preview):
        env = UnderactuatedAUVTrackVectorEnv(8, trainer.run.config.env_scenarios(8), preview=preview)
        observation, _ = env.reset(seed=trainer.run.config.episode_seed)
        actions.append((policy if preview == policy.preview else nmpc).predict(observation)[0])
    np.testing.assert_array_equal(*actions)
    [members] = divided(trainer.run.config, trainer.settings)
    group = VehicleGroup(trainer.run.config, trainer.settings, members)
    ahead, _ = group.exogenous_inputs()
    action = group.expert_action(group.carried.observation, ahead[0], np.ones(8, dtype=bool))
    np.testing.assert_allclose(action.T, actions[0], atol=1e-6)


def test_gradients_that_are_not_finite_are_skipped(tmp_path, monkeypatch):
    run = RunFolder(configuration(), tmp_path)
    trainer = ApgTrainer(run)
    before = weights_of(trainer.network)
    diverged = WindowGradient(0.0, 0.0, {name: np.full_like(w, np.nan) for name, w in before.items()})
    monkeypatch.setattr(VehicleGroup, "learn", lambda self, weights: diverged)
    trainer.update()
    run.close()
    assert trainer.skipped == 1
    for name, weights in weights_of(trainer.network).items():
        np.testing.assert_array_equal(weights, before[name])
    monkeypatch.setattr("baselines.training.apg.trainer.PATIENCE", 1)
    with pytest.raises(TrainingError, match="1 gradients in a row were not finite; lower learning_rate"):
        trainer.update()


# Groups of vehicles, which processes compute.

GROUPED = {"n_envs": 20, "n_steps": 10, "hidden_size": 16, "groups": 3, "derivative_bound": 3, "error_exponent": 0.75}


def grouped(**changes):
    """Return a training whose vehicles are in groups, and its settings."""
    scenarios = tuple((replace(PRESETS[name], steps=50), 1.0) for name in ("slow-current", "cruise-storm"))
    config = configuration(scenarios=scenarios, hyperparameters=GROUPED | changes)
    return config, check(config)


@pytest.fixture
def weights():
    return weights_of(network(sizes=grouped()[1].network, dtype=torch.float32))


def test_groups_have_all_vehicles_and_their_shares():
    config, settings = grouped()
    groups = divided(config, settings)
    assert [len(group.variants) for group in groups] == [8, 6, 6]
    scenarios = config.env_scenarios(settings.n_envs)
    names = [scenario.name for group in groups for [scenario] in group.variants]
    assert sorted(names) == sorted(scenario.name for scenario in scenarios)
    seeds = [group.seed + i for group in groups for i in range(len(group.variants))]
    assert seeds == list(range(config.episode_seed, config.episode_seed + 20))
    whole = settings.objective([scenario.name for scenario in scenarios])
    shares = np.concatenate([group.objective.shares for group in groups])
    assert sorted(shares) == sorted(whole.shares)
    for group in groups:
        of = settings.objective([scenario.name for [scenario] in group.variants])
        np.testing.assert_array_equal(group.objective.loss.rate, of.loss.rate)
        even = divided_by_error(group.objective.shares, np.geomspace(0.01, 1, len(group.variants)), 0.75)
        assert even.sum() == pytest.approx(group.objective.shares.sum())


def test_half_of_each_group_has_drawn_models(monkeypatch):
    monkeypatch.setattr(vehicle_models, "SEVERAL", 2)
    for group in divided(*grouped(n_envs=8, groups=2, nominal_vehicle=True, drawn_share=0.5)):
        assert sorted(len(own) for own in group.variants) == [1, 1, 2, 2]


@pytest.mark.slow
def test_gradients_do_not_depend_on_the_number_of_processes(weights):
    """To the last bit, and also after a checkpoint that another number of processes resumes."""
    config, settings = grouped()
    members, learned = divided(config, settings), []
    for before, after in ((1, 1), (2, 1), (1, 4)):
        states, windows = [None] * 3, []
        for processes, count in ((before, 2), (after, 1)):
            arguments = [(config, settings, *group) for group in zip(members, states, strict=True)]
            with closing(ProcessObjects(VehicleGroup, arguments, processes)) as groups:
                windows += [summed(groups.call("learn", weights)) for _ in range(count)]
                states = groups.call("state")
        learned.append(windows)
    for windows in zip(*learned, strict=True):
        assert len({(window.loss, window.error) for window in windows}) == 1
        for name, gradient in windows[0].gradients.items():
            assert all(np.array_equal(window.gradients[name], gradient) for window in windows)


def test_the_gradient_of_groups_is_the_sum_of_theirs(weights):
    """Each weighed as in the mean over all vehicles: against a window of the group alone, whose shares add up to 1."""
    config, settings = grouped()
    together = summed([VehicleGroup(config, settings, members).learn(weights) for members in divided(config, settings)])
    loss, error, gradients = 0.0, 0.0, {name: np.zeros_like(w) for name, w in weights.items()}
    for members in divided(config, settings):
        share = members.objective.shares.sum()
        alone = replace(members, objective=replace(members.objective, shares=members.objective.shares / share))
        part = VehicleGroup(config, settings, alone).learn(weights)
        loss, error = loss + share * part.loss, error + part.error
        for name, gradient in part.gradients.items():
            gradients[name] += share * gradient
    assert (together.loss, together.error) == (pytest.approx(loss), pytest.approx(error))
    for name, gradient in together.gradients.items():
        np.testing.assert_allclose(gradients[name], gradient, rtol=1e-4, atol=1e-6 * np.abs(gradient).max())


class Counter:
    def __init__(self, count):
        if count < 0:
            raise ValueError("none can be there")
        self.count = count

    def add(self, more):
        self.count += more
        return self.count, os.getpid()

    def end(self, parent):
        if os.getpid() != parent:
            os._exit(3)


def test_objects_in_several_processes_answer_in_their_order():
    with closing(ProcessObjects(Counter, [(count,) for count in range(5)], 2)) as objects:
        counts, processes = zip(*objects.call("add", 10), strict=True)
        assert counts == (10, 11, 12, 13, 14)
        assert processes[0] == processes[2] == processes[4] == os.getpid() != processes[1] == processes[3]
        assert [count for count, _ in objects.call("add", 1)] == [11, 12, 13, 14, 15]
        with pytest.raises(WorkerError, match="a worker process ended unexpectedly"):
            objects.call("end", os.getpid())
    with closing(ProcessObjects(Counter, [(1,), (-1,)], 2)) as objects, pytest.raises(ValueError, match="none can be"):
        objects.call("add", 1)


def test_parallel_trainings_share_the_processes():
    assert [Workers(5).each_of(tasks) for tasks in (1, 2, 5, 9)] == [5, 2, 1, 1]

"""Training by the analytic gradient: gradients, what the network becomes on NumPy, determinism, and going on."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from window_by_torch import AUTHORITY, LOSS, Setting

from auv_gym.codegen.native import SWITCH, library
from auv_gym.envs.torch_sim import TENSORS
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
from baselines.training.apg.closed_loop import LINEAR_FROM, SQUARE_WEIGHT, ClosedLoop, Loss, law_of
from baselines.training.apg.groups import Groups, WindowGradient
from baselines.training.apg.muon import Muon, orthogonalised
from baselines.training.apg.passes import gates_back
from baselines.training.apg.settings import Settings, check
from baselines.training.apg.torch_network import torch_network, weights_of
from baselines.training.apg.trainer import ApgTrainer, train
from baselines.training.apg.vehicles import TrainingVehicles
from baselines.training.apg.window import SMALLEST, divided_by_error
from baselines.training.config import Config
from baselines.training.run_folder import RunFolder
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
    ("current-observer", False, INPUTS[0]),
]


@pytest.fixture(autouse=True)
def one_thread():
    torch.set_num_threads(1)
    torch.manual_seed(0)


def network(head=0.5, sizes=SIZES, dtype=torch.float64):
    made = torch_network(sizes).to(dtype)
    torch.nn.init.normal_((made.head if isinstance(sizes, Gru) else made.layers[-1]).weight, std=head)
    return made


def trainer_of(run):
    return ApgTrainer(run, Groups(run.config, check(run.config)))


def gradient_of(net):
    return torch.cat([p.grad.ravel() for p in net.parameters()])


@pytest.fixture(params=["compiled", "interpreted"])
def native(request, monkeypatch):
    """With a compiler, and without."""
    if request.param == "interpreted":
        monkeypatch.setenv(SWITCH, "0")
    for cached in (library, gates_back):
        cached.cache_clear()
    yield
    for cached in (library, gates_back):
        cached.cache_clear()


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
    names, net = ["cruise-storm", "slow-mismatch", "cruise-gauss-markov"], network(0.1)

    def loss():
        return Setting(names, net, steps=12).run()[0]

    loss()
    gradients = {name: p.grad.clone() for name, p in net.named_parameters()}
    rng = np.random.default_rng(0)
    for name, parameter in net.named_parameters():
        direction = torch.tensor(rng.standard_normal(parameter.shape))
        slope, step = float((gradients[name] * direction).sum()), 1e-5
        with torch.no_grad():
            sides = []
            for sign in (1, -1):
                parameter.add_(sign * step * direction)
                sides.append(loss())
                parameter.sub_(sign * step * direction)
        assert slope == pytest.approx((sides[0] - sides[1]) / (2 * step), rel=1e-4, abs=1e-7), name


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
    vehicles = TrainingVehicles([short] * 4, 0, 6)
    carried = vehicles.reset(3)
    assert vehicles.constants.shape == (PARAMETER_ROWS, 4)
    begun = []
    for _ in range(9):
        assert [len(rows) for rows in vehicles.window()] == [6, 6]
        marked = carried._replace(hidden=np.ones((3, 4)), integrals=np.ones((4, 4)))
        carried = vehicles.renew(marked, np.zeros(4))
        begins = carried.hidden[0] == 0
        assert begins.tolist() == vehicles.begins.tolist()
        assert (carried.integrals[0] == 0).tolist() == begins.tolist()
        assert (carried.state[:, begins] != marked.state[:, begins]).any(axis=0).all()
        assert (carried.state[:, ~begins] == marked.state[:, ~begins]).all()
        begun.append(begins.nonzero()[0].tolist())
    # The first episodes are 6, 12, 18 and 6 steps long, all others 18: three windows.
    assert begun == [[0, 3], [1], [2], [0, 3], [1], [2], [0, 3], [1], [2]]


def test_a_failed_vehicle_begins_a_new_episode():
    vehicles = TrainingVehicles([PRESETS["slow-calm"]] * 4, 0, 6)
    carried = vehicles.reset(3)
    vehicles.window()
    begun = vehicles.renew(carried, np.array([0.0, 0.0, 1e6, np.nan]))
    assert (begun.state != carried.state).any(axis=0).tolist() == [True, False, True, True]  # the first was to end here


def test_windows_and_their_renewal_are_steps_of_the_environment():
    """What trains in windows is the environment that steps: observations and beginnings agree, previews as well."""
    scenario = replace(PRESETS["cruise-storm"], steps=8)
    vehicles = TrainingVehicles([scenario] * 3, 5, 4, (1, 4))
    env = UnderactuatedAUVTrackVectorEnv(3, scenario, preview=(1, 4))
    vehicles._left[:] = 8
    loop, carried, (observation, _) = (
        ClosedLoop(law_of(Zero())[0], parts=vehicles.parts),
        vehicles.reset(0),
        env.reset(seed=5),
    )
    state, terms, rng = carried.state, carried.observation, np.random.default_rng(0)
    for ends in (False, True, False, True):
        for ahead, sample in zip(*vehicles.window(), strict=True):
            columns = preview_columns(ahead, Observation._make(terms), ARRAYS, span=1)
            np.testing.assert_allclose(np.transpose(columns), observation[:, len(TERMS) :], rtol=0, atol=1e-12)
            actions = rng.uniform(-0.3, 0.3, (3, 2))
            given = state, actions.T, np.zeros((2, 3)), sample, vehicles.constants, AUTHORITY, LOSS
            moved = loop.move(*given, ARRAYS)
            state, terms = np.array(moved.state), np.array(moved.observation)
            observation, _, _, truncated, _ = env.step(actions)
        assert truncated.tolist() == [ends] * 3
        carried = vehicles.renew(carried._replace(state=state, observation=terms), moved.squared_error)
        state, terms = carried.state, carried.observation
        np.testing.assert_allclose(terms.T, observation[:, : len(TERMS)], rtol=0, atol=1e-12)


def configuration(**changes):
    scenarios = tuple((replace(PRESETS[name], steps=50), 1.0) for name in ("cruise-current", "cruise-storm"))
    settings = {"n_envs": 8, "n_steps": 10, "hidden_size": 16, "learning_rate": 5e-3}
    given = {"authority": (0.5, 0.5), "timesteps": 8 * 10 * 50, "hyperparameters": settings}
    return Config(scenarios=scenarios, **(given | changes))


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """One whole run."""
    torch.set_num_threads(1)
    run = RunFolder(configuration(), tmp_path_factory.mktemp("run"))
    agent = train(run)
    run.close()
    return run, agent


def rows(run):
    return [{k: v for k, v in row.items() if k != "seconds"} for row in run._rows]


@pytest.mark.slow
def test_training_improves(trained):
    run, _ = trained
    scores = [row["score"] for row in rows(run) if "score" in row]
    count_failures = [row["loss"] for row in rows(run) if "loss" in row]
    assert len(scores) == 21
    assert max(scores) > 0.01
    assert np.mean(count_failures[-10:]) < np.mean(count_failures[:10])


@pytest.mark.slow
def test_best_agent_is_returned(trained):
    run, agent = trained
    best = max(row["score"] for row in rows(run) if "score" in row)
    assert run.validation.run(agent.policy(precision=VALIDATION_PRECISION)).score == best
    assert run.validation.run(agent.policy()).score == pytest.approx(best, abs=1e-5)


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
        ({"n_envs": 0}, "n_envs is 0"),
        ({"n_steps": 51}, "at most 50"),
        ({"learning_rate": -1.0}, "learning_rate is -1.0"),
        ({"matrix_learning_rate": -0.1}, "matrix_learning_rate is -0.1"),
        ({"final_share": 1.5}, "final_share is 1.5"),
        ({"hidden_size": 0}, "is 0; it must be an integer"),
        ({"compiled": True}, "no entry 'compiled'"),
        ({"preview": [0]}, "preview is"),
        ({"memory": 1}, "memory is 1"),
        ({"groups": 0}, "groups is 0"),
        ({"n_envs": 8, "groups": 5}, "groups is 5; with n_envs 8 it must be at most 4"),
    ],
)
def test_refuses_settings(settings, says):
    with pytest.raises(ValueError, match=says):
        check(configuration(hyperparameters=settings))


def test_expert_and_network_have_separate_previews(tmp_path):
    """Expert and network ask for different times; in training as in use each gets its own."""
    settings = configuration().hyperparameters | {"preview": (3, 20)}
    trainer = trainer_of(RunFolder(configuration(expert="nmpc", hyperparameters=settings), tmp_path))
    policy, nmpc = trainer.agent(trainer.weights).policy(), make_policy("nmpc")
    assert policy.preview == (1, 2, 3, *nmpc.preview[2:])
    actions = []
    for preview in (policy.preview, nmpc.preview):
        env = UnderactuatedAUVTrackVectorEnv(8, trainer.run.config.env_scenarios(8), preview=preview)
        observation, _ = env.reset(seed=trainer.run.config.episode_seed)
        actions.append((policy if preview == policy.preview else nmpc).predict(observation)[0])
    np.testing.assert_array_equal(*actions)
    [group] = trainer.groups.own.groups.values()
    ahead, _ = group.vehicles.window()
    mine = group._act(group.carried.observation, ahead[0], np.ones(8, dtype=bool))
    np.testing.assert_allclose(mine.T, actions[0], atol=1e-6)


def test_gradients_that_are_not_finite_are_skipped(tmp_path, monkeypatch):
    run = RunFolder(configuration(), tmp_path)
    trainer = trainer_of(run)

    def diverged(self, weights):
        return WindowGradient(0.0, 0.0, {name: np.full_like(w, np.nan) for name, w in weights.items()})

    monkeypatch.setattr(Groups, "learn", diverged)
    before = weights_of(trainer.network)
    trainer.update()
    run.close()
    assert trainer.skipped == 1
    for name, weights in weights_of(trainer.network).items():
        np.testing.assert_array_equal(weights, before[name])

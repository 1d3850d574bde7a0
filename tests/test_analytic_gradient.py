"""Training by the analytic gradient: gradients, what the network becomes on NumPy, determinism, and going on."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from auv_gym.envs.track_vector_env import UnderactuatedAUVTrackVectorEnv
from auv_gym.presets import PRESETS
from auv_gym.simulation import PARAMETER_ROWS
from auv_gym.task import TERMS
from baselines import make_policy
from baselines.agents.agent import Agent
from baselines.agents.features import FEATURES, Inputs
from baselines.agents.networks import Gru, Mlp
from baselines.control.open_loop import Zero
from baselines.training.apg.closed_loop import CURVE, NEAR, Carried, ClosedLoop, Loss, law_of
from baselines.training.apg.fleet import Fleet
from baselines.training.apg.torch_network import torch_network, weights_of
from baselines.training.apg.trainer import Settings, Trainer, check, train
from baselines.training.config import Config
from baselines.training.run_folder import Run

SIZES = Gru(len(FEATURES), 8, 8, 8)
AUTHORITY = (0.3, 0.6)


@pytest.fixture(autouse=True)
def one_thread():
    torch.set_num_threads(1)
    torch.manual_seed(0)


def network(head=0.5, sizes=SIZES):
    made = torch_network(sizes).double()
    torch.nn.init.normal_((made.head if isinstance(sizes, Gru) else made.layers[-1]).weight, std=head)
    return made


def fleet(names, window=5, preview=()):
    return Fleet([PRESETS[name] for name in names], 7, window, preview, torch.float64)


def unrolled(loop, net, vehicles, carried, past=None):
    """Return the mean loss of a window, and where it ends; `past` has an expert on NumPy, and its memory."""
    total, outside = torch.zeros((), dtype=torch.float64), None
    for ahead, sample in zip(*vehicles.window(), strict=True):
        if past:
            action, past[1] = past[0].predict(carried.observation.detach().numpy().T, past[1])
            outside = torch.tensor(action.T.astype(float))
        carried, loss, squared_error = loop.step(net, carried, ahead, sample, vehicles.simulator.constants, outside)
        total = total + loss.mean()
    return total, carried, squared_error


def test_begins_as_its_expert():
    for sizes in (SIZES, Mlp(4, (8, 8))):
        last = [*torch_network(sizes).named_parameters()]
        assert [bool(p.any()) for name, p in last if name.startswith(("head", "layers.2"))] == [False, False]


INPUTS = [Inputs(), Inputs((3, 20)), Inputs((40,), integrals=False)]


@pytest.mark.parametrize("inputs", INPUTS, ids=["plain", "preview", "no-integrals"])
@pytest.mark.parametrize("memory", [True, False], ids=["gru", "mlp"])
@pytest.mark.parametrize("expert", ["backstepping", "none", "ekf", "current-observer"])
def test_equals_the_policy_in_the_environment(expert, memory, inputs):
    """Expert, features, network and vehicle in one graph do what the NumPy policy does in the NumPy environment."""
    n = len(inputs.features)
    sizes = Gru(n, 8, 8, 8) if memory else Mlp(n, (8, 8), bound="tanh")
    names, net = ["slow-storm", "cruise-actuator", "cruise-storm"], network(sizes=sizes)
    known = Zero() if expert == "none" else make_policy(expert)
    law, exact = law_of(known)
    past = None if exact else [known, None]
    loop = ClosedLoop(law, torch.tensor(AUTHORITY, dtype=torch.float64), Loss.weighted(), inputs=inputs)
    vehicles = fleet(names, preview=inputs.preview)
    policy = Agent(sizes, weights_of(net), expert, AUTHORITY, inputs=inputs).policy()
    env = UnderactuatedAUVTrackVectorEnv(3, names, preview=policy.preview)
    carried, (observation, _), memory = vehicles.reset(sizes.memory), env.reset(seed=7), None
    for _ in range(8):
        with torch.no_grad():
            _, carried, squared_error = unrolled(loop, net, vehicles, carried, past)
        for _ in range(5):
            action, memory = policy.predict(observation, memory)
            observation, *_, info = env.step(action)
        terms = observation[:, : len(TERMS)]
        np.testing.assert_allclose(carried.observation.numpy().T, terms, atol=1e-5)  # actions are in float32
        np.testing.assert_allclose(squared_error.sqrt().numpy(), info["position_error"], atol=1e-5)


def test_gradient_equals_finite_differences():
    names = ["cruise-storm", "slow-mismatch", "cruise-gauss-markov"]
    loop, net = (
        ClosedLoop(
            law_of(make_policy("backstepping"))[0],
            torch.tensor(AUTHORITY, dtype=torch.float64),
            Loss.weighted(effort=0.1, rate=0.01),
        ),
        network(0.1),
    )

    def loss():
        vehicles = fleet(names, 12)
        return unrolled(loop, net, vehicles, vehicles.reset(8))[0]

    net.zero_grad()
    loss().backward()
    rng = np.random.default_rng(0)
    for name, parameter in net.named_parameters():
        direction = torch.tensor(rng.standard_normal(parameter.shape))
        slope, step = float((parameter.grad * direction).sum()), 1e-5
        with torch.no_grad():
            sides = []
            for sign in (1, -1):
                parameter.add_(sign * step * direction)
                sides.append(float(loss()))
                parameter.sub_(sign * step * direction)
        assert slope == pytest.approx((sides[0] - sides[1]) / (2 * step), rel=1e-4, abs=1e-7), name


def test_loss_has_no_kink_and_a_slope_everywhere():
    e = torch.tensor([0.0, 1e-3, NEAR - 1e-6, NEAR + 1e-6, 50.0], dtype=torch.float64, requires_grad=True)
    still = torch.zeros(2, 5, dtype=torch.float64)
    one = torch.ones(5, dtype=torch.float64)
    values = Loss.weighted().of(e * e, one, still, still, one)
    values.sum().backward()
    values = values.detach()
    assert torch.isfinite(e.grad).all()
    assert (e.grad[1:] > 0).all()
    assert float(e.grad[2]) == pytest.approx(float(e.grad[3]), rel=1e-4)
    assert float(values[2]) == pytest.approx(NEAR + CURVE * NEAR**2, rel=1e-4)
    moved = Loss.weighted(effort=0.5, rate=0.08).of(torch.zeros(5), one, still + 0.1, still, 0.2 * one)
    assert float(moved[0]) == pytest.approx(1e-3 + 0.5 * 0.02 + 2 * 0.02, rel=1e-4)


def test_fleet_begins_episodes_between_windows():
    short = replace(PRESETS["slow-calm"], steps=20)
    vehicles = Fleet([short] * 4, 0, 6)
    carried = vehicles.reset(3)._replace(hidden=torch.ones(4, 3), integrals=torch.ones(4, 4))
    assert vehicles.simulator.constants.shape == (PARAMETER_ROWS, 4)
    begun = []
    for _ in range(9):
        assert [len(rows) for rows in vehicles.window()] == [6, 6]
        marked = carried._replace(hidden=torch.ones(4, 3), integrals=torch.ones(4, 4))
        carried = vehicles.renew(marked, torch.zeros(4))
        fresh = carried.hidden[:, 0] == 0
        assert (carried.integrals[0] == 0).tolist() == fresh.tolist()
        assert (carried.state[:, fresh] != marked.state[:, fresh]).any(dim=0).all()
        assert (carried.state[:, ~fresh] == marked.state[:, ~fresh]).all()
        begun.append(fresh.nonzero()[:, 0].tolist())
    # The first episodes are 6, 12, 18 and 6 steps long, all others 18: three windows.
    assert begun == [[0, 3], [1], [2], [0, 3], [1], [2], [0, 3], [1], [2]]


def test_fleet_begins_anew_where_a_vehicle_is_lost():
    vehicles = Fleet([PRESETS["slow-calm"]] * 4, 0, 6)
    carried = vehicles.reset(3)
    vehicles.window()
    begun = vehicles.renew(carried, torch.tensor([0.0, 0.0, 1e6, torch.nan]))
    assert (begun.state != carried.state).any(dim=0).tolist() == [True, False, True, True]  # the first was to end here


def configuration(**changes):
    scenarios = tuple((replace(PRESETS[name], steps=50), 1.0) for name in ("cruise-current", "cruise-storm"))
    settings = {"n_envs": 8, "n_steps": 10, "hidden_size": 16, "compiled": False, "learning_rate": 5e-3}
    given = {"authority": (0.5, 0.5), "timesteps": 8 * 10 * 50, "hyperparameters": settings}
    return Config(scenarios=scenarios, **(given | changes))


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """One whole run."""
    torch.set_num_threads(1)
    run = Run(configuration(), tmp_path_factory.mktemp("run"))
    agent = train(run)
    run.close()
    return run, agent


def rows(run):
    return [{k: v for k, v in row.items() if k != "seconds"} for row in run._rows]


def test_training_improves(trained):
    run, _ = trained
    scores = [row["score"] for row in rows(run) if "score" in row]
    losses = [row["loss"] for row in rows(run) if "loss" in row]
    assert len(scores) == 21
    assert max(scores) > 0.01
    assert np.mean(losses[-10:]) < np.mean(losses[:10])


def test_interrupted_run_gives_the_same_agent(trained, tmp_path):
    run, agent = trained

    class StopRunError(Exception):
        pass

    class Interrupted(Run):
        def save_checkpoint(self, state):
            super().save_checkpoint(state)
            if state["updates"] == 15:
                raise StopRunError

    first = Interrupted(configuration(), tmp_path)
    with pytest.raises(StopRunError):
        train(first)
    first.close()
    torch.rand(3)  # another state of torch's generator
    second = Run(configuration(), tmp_path)
    again = train(second)
    second.close()
    assert rows(second) == rows(run)
    for name, weights in agent.weights.items():
        np.testing.assert_array_equal(again.weights[name], weights)


def test_best_agent_is_returned(trained):
    run, agent = trained
    best = max(row["score"] for row in rows(run) if "score" in row)
    assert run.validation.run(agent.policy()).score == best


@pytest.mark.parametrize("sizes", [SIZES, Mlp(4, (8, 8))])
def test_matrices_change_alike_in_every_direction(sizes):
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


def test_without_a_rate_of_their_own_matrices_follow_adam():
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
        ({"compiled": "yes"}, "true or false"),
        ({"preview": [0]}, "preview is"),
        ({"memory": 1}, "memory is 1"),
    ],
)
def test_refuses_settings(settings, says):
    with pytest.raises(ValueError, match=says):
        check(configuration(hyperparameters=settings))


def test_expert_that_looks_ahead_sees_its_own_preview(tmp_path):
    """Expert and network ask for different times; in training as in use each gets its own."""
    settings = configuration().hyperparameters | {"preview": (3, 20)}
    trainer = Trainer(Run(configuration(expert="nmpc", hyperparameters=settings), tmp_path))
    policy, nmpc = trainer.agent(trainer.best).policy(), make_policy("nmpc")
    assert policy.preview == (1, 2, 3, *nmpc.preview[2:])
    actions = []
    for preview in (policy.preview, nmpc.preview):
        env = UnderactuatedAUVTrackVectorEnv(8, trainer.run.config.lanes(8), preview=preview)
        observation, _ = env.reset(seed=trainer.run.config.episode_seed)
        actions.append((policy if preview == policy.preview else nmpc).predict(observation)[0])
    np.testing.assert_array_equal(*actions)
    ahead, _ = trainer.fleet.window()
    mine = trainer._act(trainer.carried.observation, ahead[0], np.ones(8, dtype=bool))
    np.testing.assert_allclose(mine.numpy().T, actions[0], atol=1e-3)  # the observation is in float32


def test_gradients_that_are_not_finite_are_skipped(tmp_path, monkeypatch):
    run = Run(configuration(), tmp_path)
    trainer = Trainer(run)
    monkeypatch.setattr(
        Trainer, "_window", lambda self: (sum(p.sum() for p in self.network.parameters()) * torch.nan, 0.0)
    )
    before = weights_of(trainer.network)
    trainer.update()
    run.close()
    assert trainer.skipped == 1
    for name, weights in weights_of(trainer.network).items():
        np.testing.assert_array_equal(weights, before[name])


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:The .grad attribute of a Tensor")  # torch looks, and hides its own warning
def test_compiled_step_equals_eager():
    from baselines.training.apg.trainer import compiled

    loop, net = (
        ClosedLoop(
            law_of(make_policy("backstepping"))[0], torch.tensor(AUTHORITY, dtype=torch.float64), Loss.weighted()
        ),
        network(),
    )
    gradients = []
    for step in (loop.step, compiled(loop)):
        vehicles = fleet(["cruise-storm", "slow-current"])
        carried = Carried(*(x.requires_grad_() for x in vehicles.reset(8)))
        net.zero_grad()
        for ahead, sample in zip(*vehicles.window(), strict=True):
            carried, loss, _ = step(net, carried, ahead, sample, vehicles.simulator.constants)
        loss.sum().backward()
        gradients.append([p.grad.clone() for p in net.parameters() if p.grad is not None])
    for mine, theirs in zip(*gradients, strict=True):
        torch.testing.assert_close(mine, theirs)

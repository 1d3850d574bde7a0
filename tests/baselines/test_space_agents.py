"""Agents in space: features, gradients through control steps, a short training, tuning, the suite's file."""

import json
from dataclasses import replace

import numpy as np
import pytest

from auv_gym.envs.space import UnderactuatedAUVTrack3DVectorEnv
from auv_gym.envs.sub_environments import SubEnvironments
from auv_gym.physics.namespaces import ARRAYS
from auv_gym.physics.units import DIMENSIONS, POWERS, Units
from auv_gym.physics.vehicle import PAPER_VEHICLE, Vehicle
from auv_gym.scenarios.presets import PRESETS, SPACE_PRESETS, as_scenario
from auv_gym.scenarios.vehicles import PAPER
from auv_gym.task.space import SPACE
from baselines.agents.agent import Agent
from baselines.agents.space_features import SpaceInputs
from baselines.control.backstepping import GAINS
from baselines.evaluation.cells import drawn
from baselines.evaluation.rollout import rollout
from baselines.evaluation.suites import check_cell, load_suite, rounded, save_suite
from baselines.policies import make_policy
from baselines.scaling import shown_factors
from baselines.space import SPACE_POLICIES
from baselines.space.backstepping import SpaceBackstepping
from baselines.space.lqi import error_dynamics
from baselines.tuning.objective import TuningEpisodes
from research.paper.stability_in_space import closed_loop_eigenvalues

STORM = SPACE_PRESETS["space-storm"]
CASES = drawn(STORM, 6, 50)


def test_the_features_are_named_and_do_not_depend_on_the_size_of_the_vehicle():
    """A similar vehicle, twice as long, has the same features for similar observations."""
    inputs = SpaceInputs((5, 20), fine=True, filters=True)
    names = [feature.name for feature in inputs.features]
    assert len(set(names)) == len(names)
    env = UnderactuatedAUVTrack3DVectorEnv(8, STORM, preview=[5, 20])
    rows = env.reset(seed=0)[0].T
    o = SPACE.layout.named(SPACE.layout.decode(rows[:31], ARRAYS))
    zero = np.zeros((3, 8))
    features, memory = inputs.update(o, rows[31:], zero, zero, np.zeros((inputs.memory, 8)), ARRAYS)
    assert (len(features), len(memory)) == (len(names), inputs.memory)
    assert np.abs(np.array(features)).max() <= 8
    again, _ = inputs.update(o, rows[31:], zero, zero, memory, ARRAYS)
    before = names.index("held")
    changed = [name for name, a, b in zip(names, features, again, strict=True) if not np.array_equal(a, b)]
    assert [name for name in changed if names.index(name) < before] == [
        f"{kind}_{axis}" for kind in ("fast", "slow") for axis in "xyz"
    ]


@pytest.mark.parametrize("inputs", [SpaceInputs(), SpaceInputs(filters=True)], ids=["plain", "filters"])
def test_a_training_window_has_the_gradient_of_its_loss(inputs):
    """Compared with differences of the mean loss, for weights of all three outputs."""
    torch = pytest.importorskip("torch")
    from baselines.agents.networks import Mlp
    from baselines.training.apg.closed_loop import ClosedLoop, Loss
    from baselines.training.apg.kernels import LoopKernels
    from baselines.training.apg.network import torch_network
    from baselines.training.apg.window import Carried, Objective, TrainingWindow

    torch.manual_seed(0)
    n, steps = 3, 5
    envs = SubEnvironments([STORM] * n)
    started = envs.reset(7, None)
    samples = np.empty((steps, *envs.sample.shape))
    for sample in samples:
        sample[:] = envs.next_sample()
        envs.advance()
    kernels = LoopKernels(ClosedLoop(SpaceBackstepping().forces, inputs, envs.parts), True, "float64")
    network = torch_network(Mlp(len(inputs.features), (8,), bound="tanh", outputs=3)).double()
    with torch.no_grad():
        for p in network.parameters():
            p.copy_(0.3 * torch.randn_like(p))
    window = TrainingWindow(kernels, network, steps, (0.3, 0.2, 0.1), Objective(Loss(0.1, 0.1), np.full(n, 1 / n)))

    def loss():
        rows = (np.zeros((size, n)) for size in (inputs.memory, 3, 0))
        carried = Carried(started.plant, started.observation, *rows)
        value, *_ = window.run(carried, np.zeros((steps, 0, n)), samples, envs.constants, None, np.zeros((0, n)))
        return value

    loss()
    head = network.layers[-1]
    gradient = head.bias.grad.clone()
    for i in range(3):
        around = []
        for side in (1e-5, -1e-5):
            with torch.no_grad():
                head.bias[i] += side
            around.append(loss())
            with torch.no_grad():
                head.bias[i] -= side
        assert gradient[i].item() == pytest.approx((around[0] - around[1]) / 2e-5, rel=1e-4, abs=1e-9)
        assert gradient[i].abs() > 1e-6


def test_a_short_training_gives_an_agent_that_loads(tmp_path):
    pytest.importorskip("torch")
    from baselines.training.command import Options, checked_request
    from baselines.training.train import train_all

    options = Options(
        algo="apg", scenario=("space-calm",), authority=(0.4, 0.3), timesteps=1600, out=tmp_path / "run",
        set=("n_envs=8", "n_steps=50", "validations=1", "hidden_size=8", "preview=[5]"),
    )  # fmt: skip
    assert train_all(checked_request(options, "")) == 0
    agent = Agent.load(tmp_path / "run" / "agent")
    assert (agent.authority, agent.inputs) == ((0.4, 0.3, 0.3), SpaceInputs((5,)))
    folder, scenario = str(tmp_path / "run" / "agent"), SPACE_PRESETS["space-calm"]
    policy = make_policy(folder, scenario.known)
    measures = rollout(policy, scenario, drawn(scenario, 2, 0).episodes).measures
    assert measures.steady_rmse.max() < 0.2
    with pytest.raises(ValueError, match="is for motion in space"):
        make_policy(folder, PRESETS["cruise-calm"].vehicle)
    with pytest.raises(ValueError, match="is for motion in the plane"):
        make_policy("helm", scenario.known)
    lauv = as_scenario("space-calm@lauv")
    env = UnderactuatedAUVTrack3DVectorEnv(2, lauv, preview=[5])
    action, _ = make_policy(folder, lauv.known).predict(env.reset(seed=0)[0])
    assert np.abs(action).max() <= 1


@pytest.mark.parametrize("name", [name for name in SPACE_POLICIES if name != "clairvoyant"])
def test_a_controller_acts_on_one_vehicle_as_on_many(name):
    law, rng = make_policy(name, PAPER.in_space), np.random.default_rng(0)
    env = UnderactuatedAUVTrack3DVectorEnv(4, STORM, preview=getattr(law, "preview", ()))
    first, memory = law.predict(env.reset(seed=0)[0])
    assert first.shape == (4, 3)
    rows, *_ = env.step(rng.uniform(-0.3, 0.3, (4, 3)))
    again, _ = law.predict(rows, memory)
    one, _ = law.predict(rows[2], None if memory is None else tuple(m[2:3] for m in memory))
    np.testing.assert_allclose(one, again[2], atol=1e-6)


@pytest.mark.parametrize("name", ["backstepping", "los-pid", "lqi"])
def test_controllers_are_made_in_the_units_of_a_vehicle(name):
    """The actions of a similar vehicle are those of the paper's, for similar observations."""
    units = Units(length=2.0, time=3.0, mass=5.0)
    paper, similar = PAPER.in_space, PAPER.pitch.over(Units(1 / 2.0, 1 / 3.0, 1 / 5.0))
    plane = Vehicle(
        **{n: getattr(PAPER_VEHICLE, n) * units.factor(*POWERS[u]) for n, u in DIMENSIONS.items()},
        speed=PAPER_VEHICLE.speed * 2 / 3,
    )
    env = UnderactuatedAUVTrack3DVectorEnv(4, STORM)
    rows = env.reset(seed=0)[0]
    scaled = rows / shown_factors(units, SPACE.layout)
    one, other = (make_policy(name, vehicle) for vehicle in (paper, similar.vehicle(plane)))
    np.testing.assert_allclose(one.predict(rows)[0], other.predict(scaled)[0], atol=1e-5)


def test_linear_dynamics_in_space_are_those_of_the_laws_eigenvalues():
    """The open loop of `lqi` closed by the derivatives of the law has the eigenvalues of the study of stability."""
    law = SpaceBackstepping("cruise", horizon=None)
    A, B = error_dynamics(PAPER.in_space, 1.0)
    layout, names = SPACE.layout, [term.name for term in SPACE.layout.terms]

    def forces(errors):
        o = np.zeros(layout.size)
        o[:10] = errors
        o[names.index("u_R")], o[names.index("F_uR")] = 1.0, 70.0
        o[names.index("cos_theta")], o[names.index("sin_theta")] = np.cos(errors[3]), np.sin(errors[3])
        return np.array(law.forces(o.tolist()))

    K = np.array([(forces(1e-6 * row) - forces(-1e-6 * row)) / 2e-6 for row in np.eye(10)]).T
    found = np.sort_complex(np.linalg.eigvals(A + B @ K))
    known = closed_loop_eigenvalues(PAPER.in_space, GAINS["cruise"], 1.0, 0.0, 0.0)
    np.testing.assert_allclose(found, np.sort_complex(known), atol=1e-5)


@pytest.mark.parametrize("name", ["los-pid", "lqi"])
def test_tuned_controllers_in_a_storm(name):
    law, tuned = (rollout(make_policy(p, STORM.known), STORM, CASES.episodes).measures for p in ("backstepping", name))
    assert np.median(tuned.steady_rmse) < 0.5 * np.median(law.steady_rmse)


def test_the_optimum_is_a_bound_in_a_storm():
    """With full information a calm has the error of the discretisation; a storm less than that of any controller."""
    calm = SPACE_PRESETS["space-calm"]
    optimum = rollout(make_policy("clairvoyant", calm.known), calm, drawn(calm, 4, 50).episodes).measures
    assert optimum.steady_rmse.max() < 1e-5
    errors = {n: rollout(make_policy(n, STORM.known), STORM, CASES.episodes).measures for n in ("clairvoyant", "nmpc")}
    assert (errors["clairvoyant"].steady_rmse < 0.1 * errors["nmpc"].steady_rmse).all()


def test_tuning_episodes_count_a_vehicle_that_tips_over_as_failed():
    class Dive(SpaceBackstepping):
        def forces(self, o, ns=ARRAYS):
            return 0.0 * o[0], 1e3 + 0.0 * o[0], 0.0 * o[0]

    episodes = TuningEpisodes("space", 16, 0)
    errors, failed, _ = episodes.steady_rmses(Dive())
    assert failed.all()
    np.testing.assert_array_equal(errors, episodes.cap)
    assert set(episodes.by_case(errors)) == {"calm", "noise", "current", "waves", "mismatch", "storm"}


def test_a_suite_in_space_is_read_as_it_was_written(tmp_path, monkeypatch):
    cells = [rounded(drawn(as_scenario(name), 3, 4)) for name in ("space-storm", "space-mismatch@remus100")]
    save_suite("mine", cells, tmp_path)
    monkeypatch.setattr("baselines.evaluation.suites.data_files", lambda _: [tmp_path / "SHA256SUMS"])
    suite = load_suite("mine")
    for cell, own, digests in zip(cells, suite.cells, suite.digests, strict=True):
        assert (own.hash, own.episodes) == (cell.hash, cell.episodes)
        check_cell(own, digests)
    deeper = replace(suite.cells[0].episodes[0], path=replace(suite.cells[0].episodes[0].path, z0=-40.0))
    assert json.dumps(deeper.profile) == json.dumps(suite.cells[0].episodes[0].profile)


def test_ppo_trains_in_space(tmp_path):
    pytest.importorskip("torch")
    from baselines.training.command import Options, checked_request
    from baselines.training.train import train_all

    options = Options(
        algo="ppo", scenario=("space-calm",), authority=(0.3,), timesteps=512, out=tmp_path / "run",
        set=("n_envs=8", "n_steps=32", "batch_size=64", "n_epochs=1", "error_weight=0.1"),
    )  # fmt: skip
    assert train_all(checked_request(options, "")) == 0
    agent = Agent.load(tmp_path / "run" / "agent")
    assert (agent.inputs, agent.network.outputs) == (SpaceInputs(), 3)


def test_an_exported_agent_in_space_acts_as_the_agent(tmp_path):
    """The ONNX model and the C code, from observations and from measurements, for an untrained network."""
    pytest.importorskip("onnxruntime")
    from baselines.agents.networks import Gru
    from baselines.agents.onnx_models import OnnxModel
    from baselines.export.onnx_model import onnx_model
    from baselines.export.parts import exported

    inputs, rng = SpaceInputs((5, 20), fine=True, filters=True), np.random.default_rng(0)
    network = Gru(len(inputs.features), 8, 8, 8, outputs=3)
    weights = {name: rng.normal(scale=0.3, size=shape).astype(np.float32) for name, shape in network.shapes.items()}
    Agent(network, weights, "backstepping", (0.5, 0.4, 0.3), ("space-storm",), inputs=inputs).save(tmp_path / "mine")
    parts = exported(str(tmp_path / "mine"))
    model, policy = (
        OnnxModel(onnx_model(parts).SerializeToString()),
        make_policy(str(tmp_path / "mine"), PAPER.in_space),
    )
    assert (parts.setting[1], parts.columns[-1]) == ("F_q_max [N m]", "ahead_20_z [m]")
    env = UnderactuatedAUVTrack3DVectorEnv(4, STORM, preview=[5, 20])
    rows, memory, other = env.reset(seed=0)[0], None, None
    for _ in range(5):
        action, memory = policy.predict(rows, memory)
        same, other = model.predict(rows, other)
        np.testing.assert_allclose(same, action, atol=2e-6)
        rows, *_ = env.step(action)
    setting = np.tile([[400.0], [200.0], [200.0], [0.1]], 4)
    calm = UnderactuatedAUVTrack3DVectorEnv(4, SPACE_PRESETS["space-calm"], preview=[5, 20])
    calm.reset(seed=0)
    calm.step(action)
    seen = calm._observed()
    state, R = calm.state.T, np.array(calm.reference)
    ahead = calm._sub_envs.preview.ahead(calm._sub_envs.all, calm._sub_envs.k).reshape(6, 4)
    found = parts.encode(measured=state, reference=R, last=action.T.astype(float), setting=setting, ahead=ahead)
    np.testing.assert_allclose(found["observation"].T, seen, atol=1e-9)

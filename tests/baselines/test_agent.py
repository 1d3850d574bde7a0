"""Agents as artefacts: networks against torch, round trips, refusals, and a zero correction."""

import copy
import hashlib
import json
import pickle

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from safetensors.numpy import save_file
from torch import nn

from auv_gym.envs.track_vector_env import UnderactuatedAUVTrackVectorEnv
from auv_gym.physics.namespaces import ARRAYS
from auv_gym.task.observation import SIZE, decoded_terms
from auv_gym.task.policy import corrected
from baselines import make_policy
from baselines.agents.agent import Agent, make_expert
from baselines.agents.features import FEATURES, Inputs
from baselines.agents.networks import Gru, Mlp, network_of, network_record

N = len(FEATURES)
SIZES = Gru(N, encoder=12, hidden=10, decoder=8)


def weights_of(network, seed=0, scale=0.5):
    rng = np.random.default_rng(seed)
    return {name: scale * rng.standard_normal(shape).astype(np.float32) for name, shape in network.shapes.items()}


def agent(network=SIZES, expert="backstepping", **changes):
    return Agent(network, weights_of(network), expert, (0.3, 0.5), ("cruise-storm",), {"seed": 3}, **changes)


def loaded(module, weights, prefix):
    module.load_state_dict(
        {k.removeprefix(prefix): torch.tensor(w) for k, w in weights.items() if k.startswith(prefix)}
    )
    return module.double()


@torch.no_grad()
def test_gru_equals_torch():
    w, rng = weights_of(SIZES), np.random.default_rng(1)
    encoder, decoder, head = (
        loaded(nn.Linear(a, b), w, name) for a, b, name in ((N, 12, "encoder."), (10, 8, "decoder."), (8, 2, "head."))
    )
    cell = loaded(nn.GRUCell(12, 10), w, "gru.")
    hidden, peer = np.zeros((5, 10)), torch.zeros(5, 10, dtype=torch.float64)
    for _ in range(20):
        x = rng.standard_normal((5, N))
        action, hidden = (y.T for y in SIZES.forward(SIZES.prepared(w), x.T, hidden.T))
        peer = cell(torch.tanh(encoder(torch.tensor(x))), peer)
        np.testing.assert_allclose(hidden, peer.numpy(), atol=1e-6)
        np.testing.assert_allclose(action, torch.tanh(head(torch.tanh(decoder(peer)))).numpy(), atol=1e-6)


@pytest.mark.parametrize(("activation", "layer"), [("tanh", nn.Tanh()), ("relu", nn.ReLU())])
@torch.no_grad()
def test_mlp_equals_torch(activation, layer):
    network = Mlp(N, (16, 8), activation, "clip")
    w = weights_of(network)
    modules = [loaded(nn.Linear(a, b), w, f"layers.{i}.") for i, (a, b) in enumerate(((N, 16), (16, 8), (8, 2)))]
    peer = nn.Sequential(modules[0], layer, modules[1], layer, modules[2], nn.Hardtanh())
    x = np.random.default_rng(1).standard_normal((6, N))
    action = network.forward(network.prepared(w), x.T, np.zeros((0, 6)))[0].T
    np.testing.assert_allclose(action, peer(torch.tensor(x)).numpy(), atol=1e-6)
    assert np.abs(action).max() <= 1


NETWORKS = st.builds(
    Gru, st.integers(1, 30), st.integers(1, 9), st.integers(1, 9), st.integers(1, 9), st.sampled_from(["tanh", "clip"])
)
LAYERS = st.lists(st.integers(1, 9), max_size=3).map(tuple)
CHOICES = st.sampled_from(["tanh", "relu"]), st.sampled_from(["tanh", "clip"])
NETWORKS |= st.builds(Mlp, st.integers(1, 30), LAYERS, *CHOICES)


@given(NETWORKS, st.integers(0, 9), st.floats(0.0, 30.0))
def test_networks_are_bounded_in_batches_and_have_a_json_record(network, seed, scale):
    w, rng = weights_of(network, seed, scale), np.random.default_rng(seed)
    x, hidden = rng.standard_normal((4, network.inputs)), rng.uniform(-1, 1, (4, network.memory))
    action, after = (y.T for y in network.forward(network.prepared(w), x.T, hidden.T))
    assert action.shape == (4, 2)
    assert np.abs(action).max() <= 1
    assert after.shape == hidden.shape
    assert np.abs(after).max(initial=0) <= 1
    alone, its = (y.T for y in network.forward(network.prepared(w), x[2:3].T, hidden[2:3].T))
    np.testing.assert_allclose(alone[0], action[2], rtol=0, atol=1e-9)
    np.testing.assert_allclose(its[0], after[2], rtol=0, atol=1e-9)
    assert network_of(json.loads(json.dumps(network_record(network)))) == network


@pytest.mark.parametrize("network", [SIZES, Mlp(N, (16,), "relu", "tanh")])
def test_round_trip(network, tmp_path):
    mine = agent(network)
    mine.save(tmp_path / "a", curve=b"png")
    theirs = Agent.load(tmp_path / "a")
    assert theirs.network == network
    assert (theirs.expert, theirs.authority, theirs.scenarios) == (mine.expert, mine.authority, mine.scenarios)
    assert theirs.training == mine.training
    for name, w in mine.weights.items():
        np.testing.assert_array_equal(theirs.weights[name], w)
    card = (tmp_path / "a" / "card.md").read_text()
    assert all(text in card for text in ("backstepping", "cruise-storm", "learning_curve.png"))
    mine.save(tmp_path / "a")  # in place of the first
    assert sorted(file.name for file in (tmp_path / "a").iterdir()) == ["agent.json", "card.md", "weights.safetensors"]
    assert [file.name for file in tmp_path.iterdir()] == ["a"]


def test_saving_does_not_replace_another_folder(tmp_path):
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(ValueError, match="is not an agent's folder"):
        agent().save(tmp_path)
    assert (tmp_path / "thesis.tex").exists()


def edited(folder, **changes):
    record = json.loads((folder / "agent.json").read_text())
    (folder / "agent.json").write_text(json.dumps(record | changes))


def reweighted(folder, weights):
    """Write other weights, with their right hash."""
    file = folder / "weights.safetensors"
    save_file(weights, file)
    edited(folder, weights_sha256=hashlib.sha256(file.read_bytes()).hexdigest())


NOT_FINITE = weights_of(SIZES) | {"head.bias": np.array([0, np.nan], np.float32)}
REFUSALS = {
    "damaged weights": (lambda f: save_file(NOT_FINITE, f / "weights.safetensors"), "SHA-256 differs"),
    "missing": (lambda f: reweighted(f, {"x": np.zeros(1)}), "missing or unknown weights"),
    "not finite": (lambda f: reweighted(f, NOT_FINITE), "not finite"),
    "format": (lambda f: edited(f, format=1), "its format is 1"),
    "features": (lambda f: edited(f, features=[["e_x", "1 m"]]), "other features"),
    "network kind": (lambda f: edited(f, network={"kind": "cnn"}), "one of gru, mlp"),
    "authority": (lambda f: edited(f, authority=[0, 1]), "authority is"),
    "expert runs code": (lambda f: edited(f, expert="evil.py:run"), "must be a policy's name"),
    "expert with full information": (lambda f: edited(f, expert="oracle"), "needs full information"),
    "entries": (lambda f: edited(f, more=1), "must have the entries"),
}


@pytest.mark.parametrize("damage", REFUSALS)
def test_refuses(damage, tmp_path):
    agent().save(tmp_path / "a")
    edit, says = REFUSALS[damage]
    edit(tmp_path / "a")
    with pytest.raises(ValueError, match=says) as error:
        make_policy(str(tmp_path / "a"))
    assert "\n" not in str(error.value)


def test_what_is_no_agent_is_refused():
    with pytest.raises(FileNotFoundError):
        make_policy("runs/nothing-here")
    with pytest.raises(ValueError, match="takes no option 'gains'"):
        make_policy("ppo-cruise", gains="paper")


@pytest.mark.parametrize("inputs", [Inputs(), Inputs((2, 9), integrals=False)], ids=["plain", "preview"])
@pytest.mark.parametrize("expert", ["backstepping", "ekf", "none"])
@pytest.mark.parametrize("n", [1, 5, 300])
def test_actions_equal_those_of_the_separate_equations(n, expert, inputs):
    """Expert, features, network and command one after the other; one vehicle, several, and more than one block."""
    network = Gru(len(inputs.features), encoder=12, hidden=10, decoder=8)
    policy, law = agent(network, expert, inputs=inputs).policy(), make_expert(expert)
    layers, authority = network.prepared(weights_of(network)), np.array([[0.3], [0.5]])
    env = UnderactuatedAUVTrackVectorEnv(n, "cruise-storm", preview=inputs.preview)
    observation, _ = env.reset(seed=0)
    sums, correction, hidden, memory, its = np.zeros((4, n)), np.zeros((2, n)), np.zeros((10, n)), None, None
    for _ in range(4):
        action, memory = policy.predict(observation[0] if n == 1 else observation, memory)
        base, its = law.predict(observation, its)
        o, ahead = decoded_terms(observation), tuple(observation[:, SIZE:].T)
        features, sums = inputs.update(o, ahead, base.T.astype(float), correction, sums, ARRAYS)
        correction, hidden = network.forward(layers, np.array(features), hidden)
        command = corrected(base.T.astype(float), authority, correction, ARRAYS)
        np.testing.assert_allclose(np.reshape(action, (n, 2)), command.T, rtol=0, atol=1e-7)
        np.testing.assert_allclose(memory[0], np.transpose(sums), rtol=0, atol=1e-12)
        np.testing.assert_allclose(memory[2], hidden.T, rtol=0, atol=1e-9)
        observation, *_ = env.step(np.reshape(action, (n, 2)))


def test_actions_of_single_precision_and_of_a_pickled_copy():
    env = UnderactuatedAUVTrackVectorEnv(3, "cruise-storm")
    observation, _ = env.reset(seed=0)
    exact, single = (agent().policy(precision=precision) for precision in ("float64", "float32"))
    twin, memories = pickle.loads(pickle.dumps(copy.deepcopy(exact))), [None] * 3
    for _ in range(20):
        results = [p.predict(observation, m) for p, m in zip((exact, twin, single), memories, strict=True)]
        (action, _), (same, _), (near, _) = results
        memories = [memory for _, memory in results]
        np.testing.assert_array_equal(same, action)
        np.testing.assert_allclose(near, action, rtol=0, atol=1e-5)
        observation, *_ = env.step(action)


def test_inputs_go_with_the_agent(tmp_path):
    inputs = Inputs((2, 30, 40), integrals=False)
    made = agent(Gru(len(inputs.features), 6, 5, 4), inputs=inputs)
    made.save(tmp_path / "mine")
    assert Agent.load(tmp_path / "mine").inputs == inputs
    with pytest.raises(ValueError, match=r"the policy needs a preview of 6: make the environment with"):
        made.policy().predict(np.zeros((1, 18)))
    with pytest.raises(ValueError, match=f"has {made.network.inputs} inputs; there are {N} features"):
        agent(made.network)

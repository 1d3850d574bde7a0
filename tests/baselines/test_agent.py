"""Agents as artefacts: networks against torch, round trips, refusals, and a zero correction."""

import copy
import json
import pickle
import shutil
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from safetensors.numpy import save_file
from torch import nn

import baselines
from auv_gym.envs.track_env import UnderactuatedAUVTrackEnv
from auv_gym.envs.track_vector_env import UnderactuatedAUVTrackVectorEnv
from auv_gym.physics.namespaces import ARRAYS
from auv_gym.task.observation import SIZE, decoded_terms
from auv_gym.task.policy import corrected
from baselines import list_policies, make_policy
from baselines.agents.agent import Agent
from baselines.agents.features import ERROR_FEATURES, FEATURES, Inputs
from baselines.agents.networks import Gru, Lstm, Mlp, network_of, network_record
from baselines.evaluation import entry as evaluation
from baselines.tools.command_line import UsageError

N = len(FEATURES)
LEAF = st.none() | st.booleans() | st.integers(-3, 200) | st.integers() | st.just(10**309) | st.floats() | st.text()
FLAT = LEAF | st.lists(LEAF, max_size=4) | st.dictionaries(st.text() | st.just("kind"), LEAF, max_size=4)
JSON = FLAT | st.lists(FLAT, max_size=3) | st.dictionaries(st.text() | st.just("kind"), FLAT, max_size=3)
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


@torch.no_grad()
def test_lstm_equals_torch():
    network = Lstm(N, 10, (8,), "tanh", "tanh")
    w, rng = weights_of(network), np.random.default_rng(1)
    inner, head = (loaded(nn.Linear(a, b), w, f"layers.{i}.") for i, (a, b) in enumerate(((10, 8), (8, 2))))
    cell = nn.LSTMCell(N, 10).double()
    own = {"weight_ih": "weight_ih", "weight_hh": "weight_hh", "bias_ih": "bias"}
    parts = {to: torch.tensor(w[f"lstm.{name}"]) for to, name in own.items()}
    cell.load_state_dict(parts | {"bias_hh": torch.zeros(40)})
    hidden, peer = np.zeros((5, 20)), (torch.zeros(5, 10, dtype=torch.float64),) * 2
    for _ in range(20):
        x = rng.standard_normal((5, N))
        action, hidden = (y.T for y in network.forward(network.prepared(w), x.T, hidden.T))
        peer = cell(torch.tensor(x), peer)
        np.testing.assert_allclose(hidden, torch.cat(peer, -1).numpy(), atol=1e-6)
        np.testing.assert_allclose(action, torch.tanh(head(torch.tanh(inner(peer[0])))).numpy(), atol=1e-6)


NETWORKS = st.builds(
    Gru, st.integers(1, 30), st.integers(1, 9), st.integers(1, 9), st.integers(1, 9), st.sampled_from(["tanh", "clip"])
)
LAYERS = st.lists(st.integers(1, 9), max_size=3).map(tuple)
CHOICES = st.sampled_from(["tanh", "relu"]), st.sampled_from(["tanh", "clip"])
NETWORKS |= st.builds(Mlp, st.integers(1, 30), LAYERS, *CHOICES)
NETWORKS |= st.builds(Lstm, st.integers(1, 30), st.integers(1, 9), LAYERS, *CHOICES)


@given(NETWORKS, st.integers(0, 9), st.floats(0.0, 30.0))
def test_networks_are_bounded_in_batches_and_have_a_json_record(network, seed, scale):
    w, rng = weights_of(network, seed, scale), np.random.default_rng(seed)
    x, hidden = rng.standard_normal((4, network.inputs)), rng.uniform(-1, 1, (4, network.memory))
    action, after = (y.T for y in network.forward(network.prepared(w), x.T, hidden.T))
    assert action.shape == (4, 2)
    assert np.abs(action).max() <= 1
    assert after.shape == hidden.shape
    assert np.abs(after).max(initial=0) <= 1 + isinstance(network, Lstm)  # a cell may grow by 1 in a step
    alone, its = (y.T for y in network.forward(network.prepared(w), x[2:3].T, hidden[2:3].T))
    np.testing.assert_allclose(alone[0], action[2], rtol=0, atol=1e-9)
    np.testing.assert_allclose(its[0], after[2], rtol=0, atol=1e-9)
    assert network_of(json.loads(json.dumps(network_record(network)))) == network


@pytest.mark.parametrize("network", [SIZES, Mlp(N, (16,), "relu", "tanh"), Lstm(N, 6, (5,))])
def test_round_trip(network, tmp_path):
    mine = agent(network)
    mine.save(tmp_path / "a", curve=b"png")
    theirs = Agent.load(tmp_path / "a")
    assert network_of(json.loads(json.dumps(network_record(network)))) == theirs.network == network
    assert (theirs.expert, theirs.authority, theirs.scenarios) == (mine.expert, mine.authority, mine.scenarios)
    assert theirs.training == mine.training
    for name, w in mine.weights.items():
        np.testing.assert_array_equal(theirs.weights[name], w)
    card = (tmp_path / "a" / "card.md").read_text()
    assert "backstepping" in card
    assert "cruise-storm" in card
    assert "learning_curve.png" in card
    mine.save(tmp_path / "a")  # in place of the first
    assert sorted(file.name for file in (tmp_path / "a").iterdir()) == ["agent.json", "card.md", "weights.safetensors"]
    assert [file.name for file in tmp_path.iterdir()] == ["a"]


@settings(max_examples=30)
@given(
    NETWORKS.map(lambda network: replace(network, inputs=N)),
    st.sampled_from(["backstepping", "ekf", "lqi", "none"]),
    st.tuples(*[st.floats(0, 2, exclude_min=True)] * 2),
    st.none() | st.tuples(*[st.floats(0, exclude_min=True, allow_infinity=False)] * ERROR_FEATURES),
    st.lists(st.text(st.characters(exclude_categories=["Cs"]))).map(tuple),
)
def test_saved_agents_equal_the_loaded_ones(tmp_path_factory, network, expert, authority, region, scenarios):
    mine = Agent(network, weights_of(network), expert, authority, scenarios, {"seed": 3}, region)
    folder = tmp_path_factory.getbasetemp() / "kept"
    mine.save(folder)
    theirs = Agent.load(folder)
    assert {**vars(theirs), "weights": 0} == {**vars(mine), "weights": 0}
    assert all((theirs.weights[name] == weights).all() for name, weights in mine.weights.items())


def test_saving_does_not_replace_another_folder(tmp_path):
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(ValueError, match="is not an agent's folder"):
        agent().save(tmp_path)
    assert (tmp_path / "thesis.tex").exists()


def edited(**changes):
    def edit(folder):
        record = json.loads((folder / "agent.json").read_text())
        (folder / "agent.json").write_text(json.dumps(record | changes))

    return edit


def damaged(folder):
    data = bytearray((folder / "weights.safetensors").read_bytes())
    data[-3] ^= 1
    (folder / "weights.safetensors").write_bytes(bytes(data))


def reweighted(**changes):
    """Other weights, with their right hash."""

    def edit(folder):
        save_file({**weights_of(SIZES), **changes}, folder / "weights.safetensors")
        rehashed(folder)

    return edit


def truncated(folder):
    data = (folder / "weights.safetensors").read_bytes()
    (folder / "weights.safetensors").write_bytes(data[: len(data) // 2])
    rehashed(folder)


def rehashed(folder):
    import hashlib

    digest = hashlib.sha256((folder / "weights.safetensors").read_bytes()).hexdigest()
    edited(weights_sha256=digest)(folder)


REFUSALS = {
    "damaged weights": (damaged, "SHA-256 differs"),
    "truncated weights": (truncated, "not a safetensors file"),
    "no weights": (lambda folder: (folder / "weights.safetensors").write_bytes(b""), "SHA-256 differs"),
    "shape": (reweighted(**{"head.weight": np.zeros((2, 9), np.float32)}), "weight head.weight has shape"),
    "missing": (
        lambda f: (save_file({"x": np.zeros(1)}, f / "weights.safetensors"), rehashed(f)),
        "missing or unknown weights",
    ),
    "not finite": (reweighted(**{"head.bias": np.array([0, np.nan], np.float32)}), "not finite"),
    "integers": (reweighted(**{"head.bias": np.zeros(2, np.int32)}), "not finite numbers"),
    "format": (edited(format=1), "its format is 1"),
    "features": (edited(features=[["e_x", "1 m"]]), "other features"),
    "observation": (edited(observation=[]), "other observation"),
    "network kind": (edited(network={"kind": "cnn"}), "one of gru, lstm, mlp"),
    "network sizes": (edited(network={"kind": "gru", "inputs": N, "hidden": -1}), "network hidden is -1"),
    "network size unknown": (edited(network={"kind": "gru", "inputs": N, "depth": 2}), "its sizes are"),
    "network inputs": (edited(network={"kind": "gru", "inputs": 3}), "has 3 inputs"),
    "authority": (edited(authority=[0, 1]), "authority is"),
    "authority's type": (edited(authority="all"), "list of two numbers"),
    "expert's type": (edited(expert=3), "must be a policy's name"),
    "expert runs code": (edited(expert="evil.py:run"), "must be a policy's name"),
    "expert with full information": (edited(expert="oracle"), "needs full information"),
    "unknown expert": (edited(expert="magic"), "unknown policy 'magic'"),
    "scenarios": (edited(scenarios=[1]), "list of names"),
    "entries": (edited(more=1), "must have the entries"),
    "no JSON": (lambda folder: (folder / "agent.json").write_bytes(b"\xff{"), "not valid JSON"),
    "a list": (lambda folder: (folder / "agent.json").write_text("[]"), "must have the entries"),
}


@settings(deadline=None, max_examples=300)
@given(st.data())
def test_every_wrong_description_raises_value_error(tmp_path_factory, data):
    """One entry of agent.json, or of the tables in it, is any JSON."""
    folder = tmp_path_factory.getbasetemp() / "fuzzed"
    if not folder.exists():
        agent().save(folder)
        shutil.copy(folder / "agent.json", folder / "whole.json")
    record = json.loads((folder / "whole.json").read_text())
    table = data.draw(st.sampled_from([record, record["network"], record["inputs"], record["training"]]))
    table[data.draw(st.sampled_from([*table, "kind", "preview", "more"]))] = data.draw(JSON)
    (folder / "agent.json").write_text(json.dumps(record))
    try:
        policy = make_policy(str(folder))
    except ValueError as error:
        assert "\n" not in str(error)  # noqa: PT017, some values are fine
    else:
        assert policy.preview == ()


@pytest.mark.parametrize("damage", REFUSALS)
def test_refuses(damage, tmp_path):
    agent().save(tmp_path / "a")
    edit, says = REFUSALS[damage]
    edit(tmp_path / "a")
    with pytest.raises(ValueError, match=says) as error:
        make_policy(str(tmp_path / "a"))
    assert "\n" not in str(error.value)


def test_missing_folder():
    with pytest.raises(FileNotFoundError):
        make_policy("runs/nothing-here")


@pytest.mark.parametrize("expert", ["backstepping", "ekf", "none"])
def test_zero_head_reproduces_the_expert(expert):
    weights = weights_of(SIZES) | {"head.weight": np.zeros((2, 8)), "head.bias": np.zeros(2)}
    policy = Agent(SIZES, weights, expert, (0.5, 0.5)).policy()
    peer = baselines.control.open_loop.Zero() if expert == "none" else make_policy(expert)
    env = UnderactuatedAUVTrackVectorEnv(3, ["cruise-storm", "slow-noise", "cruise-actuator"])
    observation, _ = env.reset(seed=0)
    state, other, first = None, None, np.ones(3, dtype=bool)
    for k in range(20):
        action, state = policy.predict(observation, state, first)
        wanted, other = peer.predict(observation, other, first)
        np.testing.assert_array_equal(action, wanted)
        assert action.dtype == np.float32
        observation, *_ = env.step(action)
        first = np.array([k == 7, False, False])


@pytest.mark.parametrize("inputs", [Inputs(), Inputs((2, 9), integrals=False)], ids=["plain", "preview"])
@pytest.mark.parametrize("expert", ["backstepping", "current-observer"])
@pytest.mark.parametrize("n", [1, 5, 300])
def test_actions_equal_those_of_the_separate_equations(n, expert, inputs):
    """Expert, features, network and command one after the other; one vehicle, several, and more than one block."""
    network = Gru(len(inputs.features), encoder=12, hidden=10, decoder=8)
    policy, law = agent(network, expert, inputs=inputs).policy(), make_policy(expert)
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


def test_shipped_agents_are_policies_by_name(tmp_path, monkeypatch):
    from baselines.agents import names

    agent().save(tmp_path / "mine")
    monkeypatch.setattr(names, "SHIPPED_FOLDER", tmp_path)
    assert "card.md" in list_policies()["mine"]
    observation = UnderactuatedAUVTrackEnv("cruise-storm").reset(seed=0)[0]
    mine = make_policy("mine").predict(observation)[0]
    np.testing.assert_array_equal(mine, make_policy(str(tmp_path / "mine")).predict(observation)[0])
    with pytest.raises(ValueError, match="takes no option 'gains'"):
        make_policy("mine", gains="paper")
    shutil.rmtree(tmp_path / "mine")
    assert "mine" not in list_policies()


REGION = (1.0, 1.0, 0.8, 2.0, 2.0, 1.5)


def test_corrections_fade_only_outside_of_the_region(tmp_path):
    """An observation is scaled up: the correction is whole inside the region, and gone at twice its size."""
    whole, fading = agent(region=REGION).policy(), agent(region=REGION).policy(fade=True)
    expert = make_policy("backstepping")
    env = UnderactuatedAUVTrackEnv("cruise-calm")
    calm, _ = env.reset(seed=0, options={"initial_error": (0.0, 0.0, 0.0)})
    calm[:6] = 0.0
    U = np.hypot(*(0.5 * calm[6:8]))
    for size, share in ((0.0, 1.0), (0.99, 1.0), (1.5, 0.5), (2.0, 0.0), (7.0, 0.0)):
        observation = calm.copy()
        observation[1] = size * U  # e_y [m]
        base, bent, faded = (p.predict(observation)[0].astype(float) for p in (expert, whole, fading))
        if np.abs(bent).max() < 1:  # where nothing is clipped
            np.testing.assert_allclose(faded - base, share * (bent - base), atol=1e-6)
        if share == 0:
            np.testing.assert_array_equal(faded, base)
    agent(region=REGION).save(tmp_path / "a")
    assert Agent.load(tmp_path / "a").region == REGION
    np.testing.assert_array_equal(make_policy(f"{tmp_path}/a:fade").predict(observation)[0], faded)


@pytest.mark.parametrize("region", [(1.0,) * 5, (1.0, 1.0, 1.0, 0.0, 1.0, 1.0), (1.0, 1.0, np.inf, 1.0, 1.0, 1.0)])
def test_impossible_regions_are_rejected(region):
    with pytest.raises(ValueError, match=r"region is .*; it must be 6 positive numbers"):
        agent(region=region)


def test_fading_requires_an_expert():
    with pytest.raises(ValueError, match="the agent has no expert"):
        agent(expert="none", region=REGION).policy(fade=True)


def test_fading_requires_a_region(tmp_path):
    agent().save(tmp_path / "a")
    with pytest.raises(ValueError, match="has no region of its training"):
        make_policy(f"{tmp_path}/a:fade")
    with pytest.raises(ValueError, match="takes no option 'gains', only fade"):
        make_policy(str(tmp_path / "a"), gains="paper")


def test_inputs_go_with_the_agent_and_evaluate_runs_its_folder(tmp_path, monkeypatch):
    inputs = Inputs((2, 30, 40), integrals=False)
    network = Gru(len(inputs.features), 6, 5, 4)
    made = agent(network, inputs=inputs)
    made.save(tmp_path / "mine")
    assert Agent.load(tmp_path / "mine").inputs == inputs
    with pytest.raises(ValueError, match=r"the policy needs a preview of 6: make the environment with"):
        made.policy().predict(np.zeros((1, 18)))
    with pytest.raises(ValueError, match=f"has {network.inputs} inputs; there are {N} features"):
        agent(network)
    monkeypatch.chdir(tmp_path)
    episodes = ["--scenario", "cruise-calm", "--episodes", "1", "--jobs", "1", "--out", "out"]
    with pytest.raises(UsageError, match="has no region of its training"):
        evaluation.main(["--policy", "./mine:fade", *episodes])
    assert evaluation.main(["--policy", "./mine", *episodes]) == 0
    found = json.loads((tmp_path / "out/results.json").read_text())["results"]
    assert [r["error"] for r in found] == [None, None]

"""Properties of all policies: names, batches equal single vehicles, memory, compiled and plain code agree."""

import warnings

import gymnasium as gym
import numpy as np
import pytest

from auv_gym import decode_observation
from auv_gym.codegen import native
from auv_gym.codegen.kernel import Kernel
from auv_gym.envs.track_vector_env import UnderactuatedAUVTrackVectorEnv
from auv_gym.physics.errors import to_world
from auv_gym.physics.namespaces import ARRAYS
from auv_gym.physics.vehicle import PAPER_VEHICLE
from auv_gym.scenarios.vehicles import PAPER
from auv_gym.task.observation import SIZE, Observation, action_of
from auv_gym.task.policy import preview_of
from baselines import list_policies, make_policy
from baselines.agents.names import PolicyName, shipped_agents
from baselines.evaluation import recorded
from baselines.policy import Privileged

PLAIN = [name for name in list_policies() if not isinstance(make_policy(name), Privileged)]
WRAPPED = ["helm:guard", "ppo-cruise:guard=ekf"]
COMPILED = native.compiler() is not None and native.wanted()
LOOSE = {"nmpc": 1e-4, "nmpc-adverse": 1e-4}
"""Largest difference of actions between a batch and single vehicles, 1e-5 for all others: solvers have a tolerance."""


@pytest.mark.filterwarnings("ignore:this policy was trained at", "ignore:these gains are stable")
@pytest.mark.parametrize("name", [*PLAIN, *WRAPPED])
def test_vehicles_of_a_batch_are_independent(name):
    """Actions of a batch equal those for each vehicle alone, also if one episode begins later."""
    policy = make_policy(name)
    names = ["cruise-storm", "slow-storm", "cruise-actuator", "slow-calm"]
    envs = [UnderactuatedAUVTrackVectorEnv(1, scenario, preview=preview_of(policy)) for scenario in names]
    observation = np.concatenate([env.reset(seed=i)[0] for i, env in enumerate(envs)])
    memory, single, first = None, [None] * 4, np.ones(4, dtype=bool)
    for k in range(20):
        if k == 12:
            observation[1] = envs[1].reset(seed=77)[0][0]
            first[1], single[1] = True, None
        action, memory = policy.predict(observation, memory, first)
        assert (action.shape, action.dtype) == ((4, 2), np.float32)
        assert (np.abs(action) <= 1).all()
        alone = []
        for i in range(4):
            one, single[i] = policy.predict(observation[i], single[i], first[i : i + 1])
            alone.append(one)
        if COMPILED and name == "ekf":
            np.testing.assert_array_equal(action, alone)
        np.testing.assert_allclose(action, alone, atol=LOOSE.get(name, 1e-5))
        first = np.zeros(4, dtype=bool)
        observation = np.concatenate([env.step(action[i : i + 1])[0] for i, env in enumerate(envs)])
    if memory:
        with pytest.raises(ValueError, match="of 4 vehicles"):
            policy.predict(observation[:2], memory)


@pytest.mark.filterwarnings("ignore:this policy was trained at", "ignore:these gains are stable")
@pytest.mark.parametrize("name", [*PLAIN, *WRAPPED])
def test_decisions_do_not_depend_on_where_north_is(name):
    """Of what is observed only the heading knows it: the same episode is seen in worlds that are turned."""
    policy, angles = make_policy(name), np.array([0.0, 1.0, 3.0, -1.7])
    env = UnderactuatedAUVTrackVectorEnv(1, "cruise-storm", preview=preview_of(policy))
    heading = [Observation._fields.index(part) for part in ("cos_psi", "sin_psi")]
    observation, memory, first = env.reset(seed=3)[0], None, np.ones(4, dtype=bool)
    for _ in range(40):
        rows = np.tile(observation, (4, 1))
        rows[:, heading] = np.transpose(to_world(*observation[0, heading], np.cos(angles), np.sin(angles)))
        action, memory = policy.predict(rows, memory, first)
        np.testing.assert_allclose(action - action[0], 0, atol=LOOSE.get(name, 1e-5))
        first, (observation, *_) = np.zeros(4, dtype=bool), env.step(action[:1])


@pytest.mark.parametrize(("name", "steps"), [("ekf", 120), ("nmpc", 25)])
def test_without_a_compiler_decisions_are_the_same(name, steps, monkeypatch):
    """The generated Python code, for several vehicles and for one, on the observations of an episode."""
    controller = make_policy(name).controller.cruise
    scenarios = ["cruise-storm", "slow-storm", "cruise-actuator"]
    env = UnderactuatedAUVTrackVectorEnv(3, scenarios, preview=preview_of(controller))
    observation, _ = env.reset(seed=5)
    memory, inputs, outputs = controller.start(3), [], []
    for _ in range(steps):
        o, extra = decode_observation(observation), observation[:, SIZE:]
        F_u, F_r, memory = controller.forces(o, memory, extra)
        inputs.append((o, extra))
        outputs.append((F_u, F_r))
        observation, *_ = env.step(np.stack(action_of((F_u, F_r), o, ARRAYS), axis=1))
    monkeypatch.setattr(Kernel, "_native", lambda *_: None)
    for rows in (slice(0, 3), slice(1, 2)):
        memory = controller.start(len(range(3)[rows]))
        for (o, extra), forces in zip(inputs, outputs, strict=True):
            *found, memory = controller.forces(Observation(*(row[rows] for row in o)), memory, extra[rows])
            np.testing.assert_allclose(found, np.array(forces)[:, rows], rtol=1e-9, atol=1e-6)


@pytest.mark.parametrize("name", ["oracle", "clairvoyant"])
def test_full_information_is_required(name):
    policy = make_policy(name)
    assert isinstance(policy, Privileged)
    with pytest.raises(RuntimeError, match="needs prepare"):
        policy.predict(np.zeros((1, 18)))
    with pytest.raises(RuntimeError, match="needs prepare"):
        policy.observe(None)


@pytest.mark.parametrize(
    ("name", "parts", "kind"),
    [
        ("a.py:f:guard=ekf", ("a.py:f", "ekf"), "python"),
        ("helm:guard", ("helm", ""), "agent"),
        ("model.zip", ("model.zip", None), "sb3"),
        ("runs/a/agent", ("runs/a/agent", None), "agent"),
        ("model.onnx", ("model.onnx", None), "onnx"),
        *((name, (name, None), "controller") for name in (":guard", "helm:guards", "helm:guard=")),
        *((line, (line, None), "program") for line in ("cmd:x:guard", "cmd:a.py:b", "cmd:x.zip")),
    ],
)
def test_parts_and_kind_of_a_name(name, parts, kind):
    assert PolicyName.of(name) == parts
    assert PolicyName.of(name).kind == kind


def test_names_with_a_suffix_are_policies():
    assert recorded.speed_ranges_of("ppo-slow:guard=ekf") == ("slow",)
    with pytest.raises(ValueError, match="unknown policy 'dog'"):
        make_policy("helm:guard=dog")


def messages_of(policy, keeps_memory, scenario="cruise-storm", **options):
    """Drive four steps, with the memory or without, and return the messages of warnings."""
    env = gym.make("auv_gym:UnderactuatedAUVTrack-v0", scenario=scenario)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        observation, memory = env.reset(seed=1)[0], None
        for _ in range(4):
            action, after = policy.predict(observation, memory, **options)
            memory = after if keeps_memory else None
            observation, *_ = env.step(action)
    return [str(w.message) for w in caught if w.filename == __file__]


@pytest.mark.parametrize("name", ["integral-normalised", "ekf", "ppo-cruise"])
def test_dropped_memory_is_a_warning(name):
    """At every step but the first, except where an episode starts."""
    policy = make_policy(name)
    messages = messages_of(policy, False)
    assert len(messages) == 3
    assert all("its memory was dropped" in message for message in messages)
    assert messages_of(policy, True) == messages_of(policy, False, episode_start=np.array([True])) == []


def test_an_agent_in_the_other_speed_range_warns_once():
    for name, scenario in (("ppo-slow", "cruise-calm"), ("ppo-cruise", "paper-circle")):
        policy = make_policy(name)
        (message,) = messages_of(policy, True, scenario)
        assert "choose the agent for that speed range" in message
        assert messages_of(policy, True, scenario) == []


@pytest.mark.parametrize("name", shipped_agents())
def test_an_agent_needs_no_vehicle(name):
    """Without one it is for the paper's, in the plane or in space."""
    space = make_policy(name).layout.axes == 3
    assert space == (name in shipped_agents(True))
    kinds = ("space", "the plane")[:: 1 if space else -1]
    with pytest.raises(ValueError, match="agent {} is for motion in {}; agents for motion in {}".format(name, *kinds)):
        make_policy(name, PAPER_VEHICLE if space else PAPER.in_space)

"""Policies as ONNX models: actions, memory, and error messages."""

import os
import re
from pathlib import Path

import numpy as np
import pytest

from auv_gym.scenarios.presets import PRESETS
from baselines import make_policy
from baselines.agents import loading
from baselines.evaluation.cells import drawn
from baselines.evaluation.fingerprints import fingerprint
from baselines.evaluation.rollout import rollout
from baselines.export.onnx_model import onnx_model
from baselines.export.parts import exported

REASON = "onnx and onnxruntime are not installed"
try:
    import onnx
    from onnx import TensorProto, helper, numpy_helper
except ImportError:
    if os.environ.get("CI"):
        raise
    pytest.skip(REASON, allow_module_level=True)
pytest.importorskip("onnxruntime") if not os.environ.get("CI") else __import__("onnxruntime")

WEIGHTS = np.random.default_rng(0).normal(0.0, 0.3, (18, 2))
"""Of a model whose action is the observation times them, plus what it remembers: half the sum of its last actions."""


@pytest.fixture(autouse=True)
def _here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def model(width=18, batch="batch", names=("observation", "sum", "action", "next_sum"), actions=2, **metadata):
    """Write a model with a memory and return the name of the policy."""
    real = TensorProto.DOUBLE
    constants = {"W": np.resize(WEIGHTS, (width, actions)), "half": np.array(0.5)}
    observed, memory, action, following = names
    nodes = [
        helper.make_node("MatMul", [observed, "W"], ["product"]),
        helper.make_node("Add", ["product", memory], [action]),
        helper.make_node("Add", [action, memory], ["total"]),
        helper.make_node("Mul", ["total", "half"], [following]),
    ]
    value = helper.make_tensor_value_info
    inputs = [value(observed, real, [batch, width]), value(memory, real, [batch, actions])]
    outputs = [value(action, real, [batch, actions]), value(following, real, [batch, actions])]
    given = [numpy_helper.from_array(array, name) for name, array in constants.items()]
    made = helper.make_model(
        helper.make_graph(nodes, "linear", inputs, outputs, given), opset_imports=[helper.make_opsetid("", 17)]
    )
    made.ir_version = 8
    helper.set_model_props(made, metadata)
    onnx.save(made, "model.onnx")
    return "model.onnx"


def test_actions_and_memory():
    policy = make_policy(model())
    first, second = np.abs(np.random.default_rng(1).normal(size=(2, 3, 18)))
    action, memory = policy.predict(first)
    np.testing.assert_allclose(action, first @ WEIGHTS, rtol=1e-6)
    then, _ = policy.predict(second, memory, np.array([False, True, False]))
    kept = np.where([[False], [True], [False]], 0.0, 0.5 * (first @ WEIGHTS))
    np.testing.assert_allclose(then, second @ WEIGHTS + kept, rtol=1e-5)
    alone, own = policy.predict(first[0])
    assert (alone.shape, alone.dtype, own[0].shape) == ((2,), np.float32, (1, 2))
    np.testing.assert_allclose(alone, action[0])
    with pytest.raises(ValueError, match="state is of 3 vehicles, the observation of 2"):
        policy.predict(first[:2], memory)


@pytest.mark.parametrize(
    "metadata", [{"preview": "10, 20"}, {"observation": "e_x; ahead_10_x; ahead_10_y; ahead_20_x [m]"}]
)
def test_preview(metadata):
    policy = make_policy(model(width=22, **metadata))
    assert policy.preview == (10, 20)
    scenario = PRESETS["cruise-calm"]
    assert np.isfinite(rollout(policy, scenario, drawn(scenario, 2, 0).episodes).measures.steady_rmse).all()


@pytest.mark.parametrize("name", ["helm-small", "ppo-slow"])
def test_an_exported_agent_has_the_same_actions(name):
    onnx.save(onnx_model(exported(name)), "agent.onnx")
    agent, policy = make_policy(name), make_policy("agent.onnx")
    assert policy.preview == agent.preview
    scenario = PRESETS["cruise-storm" if name.endswith("cruise") else "slow-storm"]
    cell = drawn(scenario, 2, 0)
    expected, found = (rollout(p, scenario, cell.episodes).measures.steady_rmse for p in (agent, policy))
    np.testing.assert_allclose(found, expected, rtol=1e-3)


def test_the_fingerprint_is_that_of_the_file():
    before = fingerprint(model())
    assert len(before.strip(".")) == 20
    assert fingerprint(model(note="another")) != before


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"width": 20}, "its observation has shape (20,); it must be (18,)"),
        ({"width": 22, "preview": "20, 10"}, "ascending"),
        ({"actions": 3}, "returns arrays of shapes [(2, 3), (2, 3)] for 2 observations"),
        ({"batch": 1}, "fixed batch size of 1"),
        ({"names": ("observation", "sum", "action", "sum_after")}, "an output next_NAME"),
        ({"names": ("observation", "sum", "command", "next_sum")}, "required are observation and action"),
    ],
)
def test_other_models_are_rejected(changes, says):
    with pytest.raises(ValueError, match=re.escape(says)) as caught:
        make_policy(model(**changes))
    assert "model.onnx is not a usable ONNX model" in str(caught.value)


def test_damaged_and_missing_files_are_named(monkeypatch):
    Path("text.onnx").write_text("no model")
    with pytest.raises(ValueError, match=r"text\.onnx is not a usable ONNX model"):
        make_policy("text.onnx")

    def absent(_):
        raise ImportError

    monkeypatch.setattr(loading, "OnnxModel", absent)
    with pytest.raises(ValueError, match=r"needs ONNX Runtime: pip install .*\[export\]"):
        make_policy("model.onnx")


def test_external_weights_are_rejected():
    name = model()
    made = onnx.load(name)
    big = numpy_helper.from_array(np.ones((18, 2)), "W")
    del made.graph.initializer[0]
    made.graph.initializer.insert(0, big)
    onnx.save(made, name, save_as_external_data=True, size_threshold=0, location="weights.bin")
    with pytest.raises(ValueError, match="is not a usable ONNX model"):
        make_policy(name)

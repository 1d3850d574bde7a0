"""Exported agents give the actions of the agents: as an ONNX model, as a C header, and on an emulated Cortex-M4."""

import ctypes
import json
import math
import os
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from marks import slow_except
from native_cache import compiled

from auv_gym import decode_observation
from auv_gym.codegen import native
from auv_gym.envs.track_env import UnderactuatedAUVTrackEnv
from auv_gym.physics.vehicle import PAPER_VEHICLE
from auv_gym.scenarios.fitting import changed
from auv_gym.scenarios.missions import mission_scenario, read_mission
from auv_gym.scenarios.presets import PRESETS, as_scenario
from auv_gym.scenarios.scenario import Start
from auv_gym.task.observation import PLANE_LAYOUT, SIZE
from baselines import __main__ as program
from baselines import make_policy
from baselines.agents.agent import Agent
from baselines.agents.features import FEATURES
from baselines.agents.names import agent_folder, shipped_agents
from baselines.agents.networks import Mlp
from baselines.control.open_loop import NO_EXPERT
from baselines.evaluation.cells import drawn
from baselines.evaluation.rollout import Repeatable, beginning
from baselines.export import command
from baselines.export.c_header import c_header, quantised
from baselines.export.onnx_model import onnx_model
from baselines.export.parts import exported, network_program
from baselines.export.sums import long_sums
from baselines.tools.command_line import UsageError
from research.deployment import emulator
from research.deployment.players import HeaderPolicy, onnx_policy

KINDS = ("ppo-slow", "helm", "alone")
"""Agents of all kinds: recurrent, two layers, with filters and a preview; `alone` has relu layers and no expert."""
STRICT = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-Wshadow", "-Wmissing-prototypes", "-O2")


def require(*programs):
    """Skip the test if a program is not installed; on CI the test fails."""
    if missing := [name for name in programs if shutil.which(name) is None]:
        (pytest.fail if os.environ.get("CI") else pytest.skip)(f"not installed: {', '.join(missing)}")


@pytest.fixture
def agent(request, tmp_path):
    """The name of an agent of `KINDS`, or the folder of the one that is not shipped."""
    if request.param != "alone":
        return request.param
    network, rng = Mlp(len(FEATURES), (16,), "relu", "tanh"), np.random.default_rng(0)
    weights = {name: rng.normal(0, 0.3, shape).astype(np.float32) for name, shape in network.shapes.items()}
    Agent(network, weights, NO_EXPERT, (1.0, 1.0), ("slow-storm",)).save(tmp_path / "alone")
    return str(tmp_path / "alone")


def run_program(folder, *words):
    """Run a program, check that it succeeds and return its output."""
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def require_compiler():
    if native.compiler() is None or not native.wanted():
        pytest.skip("a header needs a compiler")


def episodes(name):
    """Return two episodes with all disturbances, in which each policy runs in closed loop."""
    scenario = PRESETS[f"{'cruise' if 'cruise' in name else 'slow'}-storm"]
    cell = scenario, drawn(scenario, 2, seed=11).episodes
    return Repeatable(lambda preview: beginning([cell], preview))


def commands(repeatable, policy):
    return np.array([moment.command for moment in repeatable.play(policy, 600)])


@pytest.mark.parametrize("agent", slow_except(["helm", "alone"], [*shipped_agents(False), "alone"]), indirect=True)
def test_model_and_header_give_the_actions_of_the_agent_in_closed_loop(agent):
    require_compiler()
    run, expected = episodes(agent), commands(episodes(agent), make_policy(agent))
    assert expected.shape[1:] == (2, 2)
    assert len(expected) == 600 or agent not in shipped_agents()  # without an expert it leaves the path
    for policy in (onnx_policy(exported(agent)), HeaderPolicy(exported(agent), "float64")):
        assert np.abs(commands(run, policy) - expected).max() < 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("name", ["helm", "helm-any"])
def test_model_and_header_give_the_actions_of_the_agent_for_another_vehicle(name):
    """With and without the vehicle's parameters as inputs of the agent; measurements are in SI units."""
    require_compiler()
    scenario = as_scenario("cruise-storm@lauv")
    agent = exported(name, scenario.vehicle)
    cell = scenario, drawn(scenario, 2, seed=11).episodes
    policy, memory, theirs, past = make_policy(name, scenario.vehicle), None, None, [None, None]
    players = onnx_policy(agent), HeaderPolicy(agent, "float64")
    for moment in Repeatable(lambda preview: beginning([cell], preview)).play(policy, 80):
        theirs, memory = policy.predict(moment.observation, memory)
        for i, player in enumerate(players):
            mine, past[i] = player.predict(moment.observation, past[i])
            np.testing.assert_allclose(mine, theirs, atol=1e-6)
    slower = scenario.vehicle.time / PAPER_VEHICLE.time
    assert agent.periods == pytest.approx([slower * dt for dt in exported(name).periods])


@pytest.mark.parametrize("agent", slow_except(["ppo-slow", "alone"], KINDS), indirect=True)
def test_single_precision_changes_actions_by_rounding_errors_only(agent):
    require_compiler()
    numpy, memory = make_policy(agent), None
    model, header = onnx_policy(exported(agent), "float32"), HeaderPolicy(exported(agent))
    for moment in episodes(agent).play(make_policy(agent), 60):
        parts = [a.astype(np.float32) for a in memory or () if a.size]
        rows = (np.hstack([*parts, np.zeros((2, 2), np.float32)]),) if parts else None  # the last command is not read
        mine, theirs = model.predict(moment.observation, tuple(parts) or None), header.predict(moment.observation, rows)
        expected, memory = numpy.predict(moment.observation, memory)
        np.testing.assert_array_equal(expected, moment.command)
        for action, _ in (mine, theirs):
            assert np.abs(action - expected).max() < 5e-6


@pytest.mark.parametrize("compiler", slow_except(["gcc"], ["gcc", "clang"]))
@pytest.mark.parametrize(
    ("precision", "weights"), [("float32", "float32"), ("float64", "float32"), ("float32", "int8")]
)
def test_headers_compile_without_a_warning(tmp_path, compiler, precision, weights):
    require(compiler)
    large = compiler == "gcc" and precision == weights  # takes longer
    names = ("helm-small" if large else "ppo-cruise", "ppo-slow")
    for i, name in enumerate(names):  # all in one program
        (tmp_path / f"{name}.h").write_text(c_header(exported(name), precision, weights, f"agent{i}"), encoding="utf-8")
    both = [f'#define AGENT{i}_IMPLEMENTATION\n#include "{name}.h"\n' for i, name in enumerate(names)]
    (tmp_path / "agents.c").write_text("".join(both), encoding="utf-8")
    use = '#include "ppo-slow.h"\nint main(void) { agent1_memory m; agent1_start(&m); return m.command[0] != 0; }\n'
    (tmp_path / "main.c").write_text(use, encoding="utf-8")
    run_program(tmp_path, compiler, *STRICT, "agents.c", "main.c", "-o", "program", "-lm")
    run_program(tmp_path, tmp_path / "program")
    run_program(tmp_path, compiler, *STRICT, "-c", "agents.c", "-o", "agents.o")
    called = set(re.findall(r"\bU (\w+)", run_program(tmp_path, "nm", "agents.o")))
    compiler_needs = {"_GLOBAL_OFFSET_TABLE_", "__stack_chk_fail", "memcpy", "memset"}
    assert called <= {*compiler_needs, "floor", "floorf", "log", "logf", "sqrt", "sqrtf"}


@pytest.mark.parametrize("compiler", ["g++", "clang++"])
def test_headers_are_cpp_too(tmp_path, compiler):
    """As programs for Arduino or ROS include the header: in one source file, or in two."""
    require(compiler)
    (tmp_path / "agent.h").write_text(c_header(exported("helm-small")), encoding="utf-8")
    (tmp_path / "agent.cpp").write_text('#define AUV_AGENT_IMPLEMENTATION\n#include "agent.h"\n', encoding="utf-8")
    use = '#include "agent.h"\nint main() { auv_agent_memory m; auv_agent_start(&m); return m.command[0] != 0; }\n'
    (tmp_path / "main.cpp").write_text(use, encoding="utf-8")
    run_program(tmp_path, compiler, "-fsyntax-only", "-Wall", "-Wextra", "-Werror", "agent.cpp", "main.cpp")
    run_program(tmp_path, compiler, "agent.cpp", "main.cpp", "-o", "program", "-lm")
    run_program(tmp_path, tmp_path / "program")


def test_the_documented_program_gives_the_commands_of_the_policy(tmp_path, monkeypatch):
    """Of docs/on-a-vehicle.md: the vehicle, the mission, its reference, the header, and the program."""
    require_compiler()
    monkeypatch.chdir(tmp_path)
    for page in ("vehicles", "missions", "on-a-vehicle"):
        text = (Path(__file__).parents[2] / "docs" / f"{page}.md").read_text(encoding="utf-8")
        for block, name in re.findall(r"(?ms)^```(?:toml|csv|c)\n((?:# |/\* )(\w+\.\w+).*?)^```$", text):
            Path(name).write_text(block, encoding="utf-8")
    words = [line.split()[1:] for line in text.splitlines() if "my.toml" in line and line.startswith("auv-gym")]
    for name, *options in words:
        assert program.call(program.COMMANDS[name], options, f"auv-gym {name}") == 0
    run_program(tmp_path, *next(line.split() for line in text.splitlines() if line.startswith("cc ")))

    scenario = mission_scenario(read_mission("survey.csv"), vehicle="my.toml", radius=4.0)
    policy, states, forces = make_policy("helm-any", scenario.known), [], []
    env = UnderactuatedAUVTrackEnv(replace(scenario, start=Start(0.3, -0.4, 0.1)), preview=policy.preview)
    (observation, _), memory, first, over = env.reset(seed=0), None, np.array([True]), False
    while not over:
        states.append(env.state)
        action, memory = policy.predict(observation, memory, first)
        limits = decode_observation(observation)[13:15]
        forces.append(action * limits)
        observation, _, terminated, over, _ = env.step(action)
        first = np.array([False])
        assert not terminated
    lines = "\n".join(" ".join(f"{x:.9g}" for x in state) for state in states)
    done = subprocess.run([tmp_path / "survey"], input=lines, capture_output=True, text=True, check=True)
    theirs = np.array([line.split() for line in done.stdout.splitlines()], dtype=float)
    assert len(theirs) == len(forces)
    np.testing.assert_allclose(theirs, np.array(forces)[: len(theirs)], atol=0.05)


BAD = (math.nan, math.inf, -math.inf, 1e30)


class CompiledHeader:
    """A compiled header, its memory, and the measurements of a vehicle close to a straight path."""

    def __init__(self, name, precision):
        self.agent = exported(name)
        self.real = np.dtype(precision)
        library = compiled(f"#define AUV_AGENT_IMPLEMENTATION\n{c_header(self.agent, precision)}")
        self.functions = {kind: library[f"auv_agent_{kind}"] for kind in ("start", "observe", "step", "steer")}
        self.memory = np.full(sum(self.agent.memory.values()) + 2, 7.0, self.real)
        self.command = np.full(2, 7.0, self.real)
        self.call("start", self.memory)
        assert not self.memory.any()

    def call(self, kind, *arrays):
        return self.functions[kind](*(ctypes.c_void_p(array.ctypes.data) for array in arrays))

    def view(self, k):
        reference = (0.1 * k, 0.0, 0.0, 1.0, 0.0, 0.0, 70.0, 0.0)
        measured = (0.1 * k + 0.2, 0.1 * np.sin(k), 0.05, 0.9, 0.02, 0.01)
        ahead = [x for n in self.agent.preview for x in (0.1 * n, 0.0)]
        return np.array([*measured, *reference, 400.0, 200.0, 0.1, *ahead], self.real)

    def observation(self, k):
        observation = np.zeros(len(self.agent.columns), self.real)
        self.call("observe", self.memory, self.view(k), observation)
        return observation

    def steer(self, view):
        return self.call("steer", self.memory, view, self.command)


@pytest.mark.parametrize("precision", slow_except(["float64"], ["float32", "float64"]))
@pytest.mark.parametrize("agent", KINDS, indirect=True)
def test_a_header_repeats_one_command_for_a_bad_input(agent, precision):
    """For each measurement and each setting: the header repeats the last command, reports it, and keeps its memory."""
    require_compiler()
    it = CompiledHeader(agent, precision)
    bad = it.view(0)
    bad[0] = math.nan
    assert it.steer(bad) == 1
    assert not it.command.any()
    assert not it.memory.any()
    assert [it.steer(it.view(k)) for k in range(5)] == [0] * 5
    assert it.command.any()
    memory, command = it.memory.copy(), it.command.copy()
    encoded = it.observation, lambda row: it.call("step", it.memory, row, it.command), PLANE_LAYOUT.positive
    for make, call, positive in ((it.view, it.steer, (14, 15, 16)), encoded):  # limits and control period
        for i in range(len(make(5))):
            for value in (*BAD, 0.0, -1.0) if i in positive else BAD:
                bad = make(5)
                bad[i] = value
                it.command[:] = 7.0
                assert call(bad) == 1, f"{value} in entry {i}"
                np.testing.assert_array_equal(it.command, command)
                np.testing.assert_array_equal(it.memory, memory)
    assert it.steer(it.view(5)) == 0
    other = CompiledHeader(agent, precision)
    assert [other.steer(other.view(k)) for k in range(6)] == [0] * 6
    np.testing.assert_array_equal(it.command, other.command)
    np.testing.assert_array_equal(it.memory, other.memory)


@pytest.mark.parametrize("agent", slow_except(["ppo-slow", "alone"], KINDS), indirect=True)
def test_a_model_repeats_one_command_for_a_bad_input(agent):
    """In ONNX Runtime; the other row of the batch is not affected."""
    import onnxruntime

    precision = "float32"
    session = onnxruntime.InferenceSession(onnx_model(exported(agent), precision).SerializeToString())
    shapes = {value.name: (2, value.shape[1]) for value in session.get_inputs()}
    given = {value: np.zeros(shape, precision) for value, shape in shapes.items() if value != "observation"}
    observations = [moment.observation.astype(precision) for moment in episodes(agent).play(make_policy(agent), 6)]
    for observation in observations[:4]:
        _, *memory, _ = session.run(None, {"observation": observation, **given})
        given = dict(zip(given, memory, strict=True))
    good = observations[4]
    *expected, repeated = session.run(None, {"observation": good, **given})
    assert not repeated.any()
    for i in range(good.shape[1]):
        for value in (*BAD, 0.0, -1.0) if i in PLANE_LAYOUT.positive else BAD:
            bad = good.copy()
            bad[0, i] = value
            action, *memory, repeated = session.run(None, {"observation": bad, **given})
            assert repeated.tolist() == [[True], [False]]
            last = good[0, 15:17].copy()
            last[np.arange(15, 17) == i] = 0.0
            np.testing.assert_array_equal(action[0], last, err_msg=f"{value} in column {i}")
            for old, new in zip(given.values(), memory, strict=True):
                np.testing.assert_array_equal(new[0], old[0])
            for new, usual in zip((action, *memory), expected, strict=True):
                np.testing.assert_array_equal(new[1], usual[1])


@pytest.mark.parametrize(("name", "vehicle"), [("ppo-cruise", "paper"), ("helm", "paper"), ("helm-any", "supply")])
def test_a_header_computes_the_observation_of_the_environment(name, vehicle):
    """The preview of a supply ship is farther than the bounds of the paper vehicle's observations."""
    require_compiler()
    agent, scenario = exported(name, vehicle), changed(as_scenario("cruise-storm"), vehicle)
    source = f"#define AUV_AGENT_IMPLEMENTATION\n{c_header(agent, 'float64')}"
    library = compiled(source)
    library.auv_agent_observe.restype = None
    env = UnderactuatedAUVTrackEnv(scenario, preview=agent.preview)
    ahead, rng = env._sub_envs.preview, np.random.default_rng(2)
    observation, _ = env.reset(seed=4)
    assert np.abs(observation[SIZE:]).max(initial=0) > 64 or vehicle == "paper"
    last, seen = np.zeros(2), np.zeros(len(agent.columns))
    memory = np.zeros(sum(agent.memory.values()) + 2)
    for k in range(20):
        o, R = decode_observation(observation), env.reference
        turn = np.array([[o.cos_psi, -o.sin_psi], [o.sin_psi, o.cos_psi]])
        x, y = np.array([R.x, R.y]) + turn @ (o.e_x, o.e_y)
        measured = x, y, np.arctan2(o.sin_psi, o.cos_psi), R.u + o.u_e, R.v + o.v_e, R.r + o.r_e
        ways = ahead.ahead((0,), k).ravel() if agent.preview else ()
        setting = o.F_u_max, o.F_r_max, o.dt
        view = np.array([*measured, R.x, R.y, R.psi, R.u, R.v, R.r, R.F_u, R.F_r, *setting, *ways])
        memory[-2:] = last
        library.auv_agent_observe(*(ctypes.c_void_p(a.ctypes.data) for a in (memory, view, seen)))
        np.testing.assert_allclose(seen, observation, rtol=1e-12, atol=1e-10 if agent.bound_factor > 1 else 1e-12)
        last = rng.uniform(-1, 1, 2).astype(np.float32).astype(np.float64)
        observation, *_ = env.step(last)


def test_description_of_the_model():
    agent = exported("helm-small")
    model = onnx_model(agent, "float32")
    facts = {p.key: p.value for p in model.metadata_props}
    record = json.loads((agent_folder("helm-small") / "agent.json").read_text())
    assert facts["name"] == "helm-small"
    assert facts["expert"] == "backstepping"
    assert facts["authority"] == "1, 1.6"
    assert facts["control_period_s"] == "0.1, 0.2"
    assert facts["weights_sha256"] == record["weights_sha256"]
    assert facts["observation"].split("; ")[2] == "psi_e [rad] / 0.5"
    assert facts["observation"].split("; ")[-1] == "ahead_40_y [m]"
    shapes = {i.name: i.type.tensor_type.shape.dim[1].dim_value for i in model.graph.input}
    assert shapes == {"observation": 26, "integrals": 86, "correction": 2, "hidden": 11}
    names = ["action", "next_integrals", "next_correction", "next_hidden", "repeated"]
    assert [o.name for o in model.graph.output] == names


def test_integers_are_within_half_a_step_of_the_weights():
    weight = network_program(exported("helm-small").agent).constants["weight1"]
    integers, scale = quantised(weight)
    assert integers.dtype == np.int8
    assert np.abs(integers).max() == 127
    assert (np.abs(integers * scale[:, None] - weight) <= 0.5001 * scale[:, None]).all()
    assert quantised(np.zeros((1, 2)))[0].tolist() == [[0, 0]]


def see_results(agent):
    """Return the nodes of the results of the features."""
    return [symbol.index for symbols in agent.seen.values() for symbol in symbols]


@pytest.mark.parametrize("name", ["helm-small", "ppo-slow"])
def test_an_emulated_cortex_m4_gives_the_same_commands(name):
    require_compiler()
    require(*emulator.PROGRAMS)
    agent = exported(name)
    policy, memory = HeaderPolicy(agent), None
    observations, memories, expected = [], [], []
    for moment in episodes(name).play(make_policy(name), 20):
        observations.append(moment.observation[0])
        memories.append(np.zeros(policy.numbers) if memory is None else memory[0][0])
        action, memory = policy.predict(observations[-1], memory)
        expected.append(action)
    there = emulator.emulated(agent, np.array(observations), np.array(memories))
    assert np.abs(there.commands - np.array(expected)).max() < 1e-6
    multiplications = sum(a.size for a in agent.network.constants.values())
    gains = sum(np.size(p.matrix) for p in long_sums(agent.see.graph, see_results(agent))[0])
    assert multiplications < there.instructions < 20 * multiplications + 6 * gains + 20_000
    assert there.code > 4 * multiplications > 0
    assert there.memory == 4 * policy.numbers


def test_the_command_writes_files_with_the_names_of_run_and_vehicle(tmp_path, capsys):
    run, out = tmp_path / "runs" / "mine" / "agent", tmp_path / "out"
    shutil.copytree(agent_folder("ppo-slow"), run)
    assert command.main(["ppo-slow", "--out", str(out)]) == 0
    assert str(out / "ppo-slow.onnx") in capsys.readouterr().out
    assert '#include "ppo-slow.h"' in (out / "ppo-slow.h").read_text()
    for words in ([str(run)], [str(run.parent)], [str(run), "--vehicle", "otter"]):
        assert command.main([*words, "--format", "c", "--out", str(out)]) == 0
    assert {file.name for file in out.iterdir()} == {"ppo-slow.h", "ppo-slow.onnx", "mine.h", "mine-otter.h"}


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["ekf"], "'ekf' is no agent; there are helm"),
        (["ppo-cruise", "--prefix", "No"], "prefix is 'No'"),
        (["ppo-cruise", "--format", "pdf"], "invalid choice"),
    ],
)
def test_wrong_arguments_raise_usage_errors(tmp_path, words, message):
    with pytest.raises(UsageError, match=re.escape(message)):
        command.main([*words, "--out", str(tmp_path)])
    assert not list(tmp_path.iterdir())


def test_message_names_a_missing_library(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(__import__("sys").modules, "onnx", None)
    monkeypatch.delitem(__import__("sys").modules, "baselines.export.onnx_model", raising=False)
    assert program.call(program.COMMANDS["export"], ["ppo-slow", "--out", str(tmp_path)], "auv-gym export") == 2
    assert re.search(r"auv-gym export needs onnx: pip install .*\[export\]'", capsys.readouterr().err)
    assert not list(tmp_path.iterdir())
    assert command.main(["ppo-slow", "--format", "c", "--out", str(tmp_path)]) == 0

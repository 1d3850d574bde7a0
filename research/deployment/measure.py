"""Measure accuracy, time and size of exported agents: `python -m research deployment --help`."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from tyro.conf import Positional, arg

from auv_gym.scenarios.presets import PRESETS
from auv_gym.task.policy import Policy
from baselines.agents.names import shipped_agents
from baselines.evaluation import recorded, suites
from baselines.evaluation.fingerprints import fingerprint
from baselines.evaluation.metrics import Measures
from baselines.evaluation.rollout import ControlStep, Repeatable, beginning, rollout
from baselines.evaluation.runner import drawn
from baselines.evaluation.score import Score, capped, error_cap, lead, speed_range_of
from baselines.export.c_header import c_header
from baselines.export.onnx_model import onnx_model
from baselines.export.parts import Exported, exported
from baselines.tools.command_line import DONE, check_words, parse
from baselines.tools.files import json_text, write_atomically
from research.deployment.emulator import emulated
from research.deployment.page import MEASURED_FILE
from research.deployment.players import HeaderPolicy, onnx_policy

PROGRAM = "python -m research deployment"
_SUITE = "benchmark-v1"  # suite of the score
_CASE = "storm"  # case in which commands are compared: all disturbances together
_SEED = 5  # seed of the episodes in which commands are compared
_DECISIONS = 200  # number of decisions on the emulated processor
AGENTS = ("apg-cruise", "helm", "helm-any", "helm-small", "ppo-cruise", "sac-cruise")
"""Agents by default: networks of several sizes and kinds."""


@dataclass(frozen=True)
class Options:
    """Measure exported agents: difference from the agent over whole episodes, speed, size, and loss of score.

    Exit status: 0 done, 1 a program is missing, 2 wrong usage.
    """

    name: Annotated[Positional[tuple[str, ...]], arg(metavar="[AGENT ...]", help_behavior_hint="")] = AGENTS
    """Names of shipped agents. Default: six of them."""
    episodes: int = 24
    """Episodes of each cell of the suite for the score."""
    out: Path = MEASURED_FILE
    """File for the measurements; `python -m research pages export-cost` shows them."""


@dataclass(frozen=True)
class Measured:
    """Measurements of one agent."""

    name: str
    fingerprint: str
    onnx32: float  # largest difference of a command over whole episodes, each in its own closed loop
    c32: float
    numpy_us: float  # processor time of a decision
    onnx_us: float
    c_us: float
    header: int  # [bytes]
    model: int  # [bytes]
    score: float  # score of the agent on NumPy, in the same episodes
    lost8: tuple[float, float, float]  # loss of score of the header with int8 weights, mean and interval
    instructions: float  # for a decision on the emulated processor
    code: int  # [bytes] code and constants on the emulated processor
    code8: int  # the same with int8 weights
    memory: int  # [bytes]
    stack: int  # [bytes]


def _measured(name: str, episodes: int) -> Measured:
    """Measure an agent and return the results.

    Raises:
        ImportError: onnx or onnxruntime is not installed.
        OSError: a compiler or the emulator is missing.
    """
    agent = exported(name)
    policy = agent.agent.policy()
    header, header8, model = HeaderPolicy(agent), HeaderPolicy(agent, weights="int8"), onnx_policy(agent, "float32")
    moments = {key: _moments(agent, each) for key, each in (("numpy", policy), ("onnx32", model), ("c32", header))}
    commands = {key: np.array([m.command for m in own]) for key, own in moments.items()}
    differences = {key: float(np.abs(own - commands["numpy"]).max()) for key, own in commands.items()}
    observations = np.array([m.observation[0] for m in moments["numpy"]])
    score, lost8 = _scores(name, header8, episodes)
    return Measured(
        name=name,
        fingerprint=fingerprint(name),
        onnx32=differences["onnx32"],
        c32=differences["c32"],
        numpy_us=1e6 * _seconds(policy, observations),
        onnx_us=1e6 * _seconds(model, observations),
        c_us=1e6 * header.seconds(observations[-1]),
        header=len(c_header(agent)),
        model=len(onnx_model(agent, "float32").SerializeToString()),
        score=score.mean,
        lost8=(lost8.mean, *lost8.ci95),
        **_on_m4(agent, header, observations[:_DECISIONS]),
    )


def _moments(agent: Exported, policy: Policy) -> list[ControlStep]:
    """Return the control steps of a policy in the episodes in which commands are compared."""
    scenario = PRESETS[f"{speed_range_of(agent.agent.scenarios[0])}-{_CASE}"]
    cell = scenario, drawn(scenario, 4, _SEED).episodes
    return list(Repeatable(lambda preview: beginning([cell], preview)).play(policy, scenario.steps))


def _seconds(policy: Policy, observations: NDArray[Any]) -> float:
    """Return the processor time [s] of a decision for one vehicle."""
    memory, begin = None, time.process_time()
    for observation in observations:
        _, memory = policy.predict(observation, memory)
    return (time.process_time() - begin) / len(observations)


def _on_m4(agent: Exported, header: HeaderPolicy, observations: NDArray[Any]) -> Mapping[str, Any]:
    """Run the header on the emulated processor, for the observations of an episode, and return the measurements."""
    memory, memories = None, []
    for observation in observations:
        memories.append(np.zeros(header.numbers) if memory is None else memory[0][0])
        _, memory = header.predict(observation, memory)
    found = emulated(agent, observations, np.array(memories))
    small = emulated(agent, observations[:1], np.array(memories[:1]), "int8")
    return {
        "instructions": found.instructions,
        "code": found.code,
        "code8": small.code,
        "memory": found.memory,
        "stack": found.stack,
    }


def _scores(name: str, policy: Policy, episodes: int) -> tuple[Score, Score]:
    """Return the recorded score of an agent, and the loss of score of a policy that stands for it."""
    suite = suites.load_suite(_SUITE)
    kept = [{r.scenario.name: r.measures for r in recorded.read_recorded(suite, p)} for p in (*suite.anchors, name)]
    cells = [cell for cell in suite.cells if cell.scenario.name in kept[-1]]

    def steady_rmses(rows: Mapping[str, Measures | None]) -> list[NDArray[np.float64]]:
        found = ((c.scenario.name, rows[c.scenario.name]) for c in cells)
        return [capped(m[:episodes], error_cap(cell)) for cell, m in found if m is not None]

    expert, oracle, own = (steady_rmses(rows) for rows in kept)
    runs = [rollout(policy, c.scenario, c.episodes[:episodes]).measures for c in cells]
    theirs = [capped(m, error_cap(c.scenario.name)) for c, m in zip(cells, runs, strict=True)]
    seed = [t[None] for t in own]
    return lead(expert, expert, seed, oracle), lead(expert, theirs, seed, oracle)


def main(arguments: Sequence[str]) -> int:
    """Measure agents and return the exit status.

    Raises:
        UsageError: the arguments are invalid.
        OSError: a compiler or the emulator is missing.
    """
    options = parse(Options, arguments, PROGRAM)
    check_words("agent", options.name, shipped_agents())
    found = []
    for name in options.name:
        found.append(_measured(name, options.episodes))
        last = found[-1]
        print(f"{name}: {last.c_us:.1f} us, {last.instructions:,.0f} instructions", flush=True)
    record = {"episodes": options.episodes, "agents": [asdict(measured) for measured in found]}
    write_atomically(options.out, json_text(record))
    return DONE

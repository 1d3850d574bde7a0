"""Measure accuracy, time and size of exported agents: `python -m research deployment`; docs/export-cost.md shows them.

It needs a C compiler, onnxruntime and the programs of `emulator.PROGRAMS`.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from auv_gym.scenarios.presets import PRESETS
from auv_gym.task.policy import Policy
from baselines.evaluation.cells import Cell, drawn
from baselines.evaluation.fingerprints import code_fingerprint
from baselines.evaluation.recorded import speed_ranges_of
from baselines.evaluation.rollout import ControlStep, Repeatable, beginning, rollout
from baselines.evaluation.score import capped, error_cap, fixed, fixed_ends, relative_error, speed_range_of
from baselines.evaluation.suites import load_suite
from baselines.export.c_header import c_header
from baselines.export.onnx_model import onnx_model
from baselines.export.parts import Exported, exported
from research.deployment.emulator import emulated
from research.deployment.players import HeaderPolicy, onnx_policy
from research.pages import table
from research.study import Study, stamp

_SUITE = "benchmark-v3"  # suite in which errors with small weights are compared
_EPISODES = 24  # of each cell
_CASE = "storm"  # case in which commands are compared: all disturbances together
_SEED = 5  # seed of the episodes in which commands are compared
_DECISIONS = 200  # number of decisions on the emulated processor
_AGENTS = ("helm", "helm-any", "helm-small", "ppo-cruise")


def _measure(name: str, quick: bool = False) -> dict[str, Any]:
    """Return the measurements of an agent.

    Returns:
        `onnx32`, `c32`: largest difference of a command over whole episodes, each in its own closed loop; `numpy_us`,
        `onnx_us`, `c_us`: processor time of a decision; `header`, `model`: sizes [bytes]; `int8`: ratio of the errors
        with weights of int8 to the agent's, mean and interval; see also `_on_m4`.

    Raises:
        ImportError: onnx or onnxruntime is not installed.
        OSError: a compiler or the emulator is missing.
    """
    agent = exported(name)
    policy = agent.agent.policy()
    header, header8, model = HeaderPolicy(agent), HeaderPolicy(agent, weights="int8"), onnx_policy(agent, "float32")
    steps, of_onnx, of_header = (_steps(agent, player) for player in (policy, model, header))
    onnx32, c32 = (
        max(float(np.abs(ours.command - theirs.command).max()) for ours, theirs in zip(steps, other, strict=True))
        for other in (of_onnx, of_header)
    )
    observations = np.array([step.observation[0] for step in steps])
    cells = _cells(name)[: 2 if quick else None]
    before, after = ([_errors(p, cell, 2 if quick else _EPISODES) for cell in cells] for p in (policy, header8))
    growth = relative_error(before, after)
    return {
        "onnx32": onnx32,
        "c32": c32,
        "numpy_us": 1e6 * _seconds(policy, observations),
        "onnx_us": 1e6 * _seconds(model, observations),
        "c_us": 1e6 * header.seconds(observations[-1]),
        "header": len(c_header(agent)),
        "model": len(onnx_model(agent, "float32").SerializeToString()),
        "int8": [growth.mean, *growth.ci95],
        **_on_m4(agent, header, observations[: 20 if quick else _DECISIONS]),
    }


def _cells(name: str) -> list[Cell]:
    return load_suite(_SUITE).cells_in(speed_ranges_of(name))


def _errors(policy: Policy, cell: Cell, episodes: int) -> NDArray[np.float64]:
    """Return the capped steady-state errors [m] of the first episodes of a cell."""
    measures = rollout(policy, cell.scenario, cell.episodes[:episodes]).measures
    return capped(measures, error_cap(cell.scenario.name))


def _steps(agent: Exported, policy: Policy) -> list[ControlStep]:
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
    run = emulated(agent, observations, np.array(memories))
    small = emulated(agent, observations[:1], np.array(memories[:1]), "int8")
    numbers = {key: getattr(run, key) for key in ("instructions", "code", "memory", "stack")}
    return {**numbers, "code8": small.code}


STUDY = Study(
    "deployment",
    [(name,) for name in _AGENTS],
    _measure,
    lambda name: stamp(
        name,
        [cell.scenario for cell in _cells(name)],
        code_fingerprint("export", Path(__file__).parent),
        load_suite(_SUITE).hash[:20],
        _EPISODES,
    ),
)
main = STUDY.main


def agreement_section() -> str:
    """Return the table of the largest differences of commands and of the growth of errors with int8 weights."""
    values = {name: value for (name,), value in STUDY.values().items()}
    rows = [
        (name, *(f"{value[k]:.1e}" for k in ("onnx32", "c32")), fixed(value["int8"][0]), fixed_ends(value["int8"][1:]))
        for name, value in values.items()
    ]
    return table(("agent", "ONNX", "header", "error ratio with int8", "interval"), rows)


def latency_section() -> str:
    """Return the table of the processor time of a decision on a computer, and of the sizes of the exported files."""
    heads = ("agent", "NumPy", "ONNX Runtime", "header", "header's size", "model's size")
    return _table(heads, ("numpy_us", "onnx_us", "c_us"), "{:.1f} us", ("header", "model"))


def cortex_m4_section() -> str:
    """Return the table of the cost of a decision on the emulated Cortex-M4."""
    heads = ("on the Cortex-M4", "instructions", "code", "code, int8", "memory", "stack")
    return _table(heads, ("instructions",), "{:,.0f}", ("code", "code8", "memory", "stack"))


def _table(heads: Sequence[str], numbers: Sequence[str], form: str, sizes: Sequence[str]) -> str:
    rows = [
        (name, *(form.format(value[k]) for k in numbers), *(f"{value[k] / 1024:.1f} KiB" for k in sizes))
        for (name,), value in STUDY.values().items()
    ]
    return table(heads, rows)

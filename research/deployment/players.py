"""Exported agents as policies: a compiled C header or an ONNX model with Stable-Baselines3's `predict`."""

from __future__ import annotations

import ctypes
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from auv_gym.codegen import native
from baselines.agents.onnx_models import OnnxModel
from baselines.export.c_header import PREFIX, c_header
from baselines.export.onnx_model import onnx_model
from baselines.export.parts import Exported
from baselines.policy import Memory, renewed

_BATCH = f"""
void auv_batch(long n, {PREFIX}_memory *memory, const {PREFIX}_real *observation, {PREFIX}_real *command)
{{
    for (long i = 0; i < n; i++)
        {PREFIX}_step(memory + i, observation + i * {PREFIX.upper()}_OBSERVATION, command + 2 * i);
}}

void auv_repeat(long n, {PREFIX}_memory *memory, const {PREFIX}_real *observation, {PREFIX}_real *command)
{{
    for (long i = 0; i < n; i++) {PREFIX}_step(memory, observation, command);
}}
"""


class HeaderPolicy:
    """A compiled C header with Stable-Baselines3's `predict`."""

    def __init__(self, agent: Exported, precision: str = "float32", weights: str = "float32") -> None:
        """Print, compile and load a header, see `c_header.c_header`.

        Raises:
            OSError: there is no compiler.
        """
        source = f"#define {PREFIX.upper()}_IMPLEMENTATION\n{c_header(agent, precision, weights)}{_BATCH}"
        library = native.library(source, lambda: source)
        if library is None:
            raise OSError("no C compiler is installed to compile the header: install gcc or clang")
        self.preview, self.precision = agent.preview, precision
        self._columns, self.numbers = len(agent.columns), sum(agent.memory.values()) + 2
        self._batch, self._repeat = library["auv_batch"], library["auv_repeat"]
        for function in (self._batch, self._repeat):
            function.restype, function.argtypes = None, (ctypes.c_long, *(ctypes.c_void_p,) * 3)

    def predict(
        self,
        observation: NDArray[Any],
        state: Memory | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], Memory | None]:
        """Return the action (2,) or actions (N, 2), and the memory: one array with a row for each vehicle."""
        rows = np.ascontiguousarray(np.atleast_2d(observation)[:, : self._columns], self.precision)
        n = len(rows)
        (memory,) = renewed(state, (np.zeros((n, self.numbers), self.precision),), episode_start)
        memory, command = memory.copy(), np.empty((n, 2), self.precision)
        self._batch(n, memory.ctypes.data, rows.ctypes.data, command.ctypes.data)
        action = command.astype(np.float32)
        return (action[0] if observation.ndim == 1 else action), (memory,)

    def seconds(self, observation: NDArray[Any], decisions: int = 2000) -> float:
        """Return the processor time [s] of a decision in C for an observation (n,), without the cost of the call."""
        row = np.ascontiguousarray(observation[: self._columns], self.precision)
        memory, command = np.zeros(self.numbers, self.precision), np.empty(2, self.precision)
        begin = time.process_time()
        self._repeat(decisions, memory.ctypes.data, row.ctypes.data, command.ctypes.data)
        return (time.process_time() - begin) / decisions


def onnx_policy(agent: Exported, precision: str = "float64") -> OnnxModel:
    """Return an agent's ONNX model on ONNX Runtime, with Stable-Baselines3's `predict`; see `onnx_model.onnx_model`.

    Raises:
        ImportError: onnx or onnxruntime is not installed.
    """
    return OnnxModel(onnx_model(agent, precision).SerializeToString())

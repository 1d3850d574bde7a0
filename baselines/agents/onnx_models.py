"""Policies as ONNX models, from any framework: run by ONNX Runtime on one thread, they can do nothing but compute.

Inputs: `observation`, shape (batch, 18 + 2 P), and arrays of memory (batch, ...), zero where an episode starts.
Outputs: `action`, shape (batch, 2), and for each memory `NAME` the one to hand in next, `next_NAME`. The metadata entry
`preview` names the P control periods ahead at which the model sees the reference, such as "10, 20".
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from auv_gym.scenarios.records import guarded
from auv_gym.task.observation import SIZE
from auv_gym.task.preview import checked_preview
from baselines.policy import Batched, Memory, Starts, renewed
from baselines.tools.files import read_bytes

SUFFIX = ".onnx"
"""What the name of such a file ends with."""
TYPES = {"tensor(float)": np.float32, "tensor(double)": np.float64}
"""Numbers that a model may take and give."""
NEXT = "next_"
"""What the name of an output begins with that is a memory."""


class OnnxModel(Batched):
    """A model as a policy; it wants to see `preview`."""

    def __init__(self, source: Path | bytes) -> None:
        """Load a model from a file, or from what is in one.

        Raises:
            ImportError: ONNX Runtime is not installed.
            OSError: the file cannot be read.
            ValueError: it is damaged, or the model's inputs and outputs are not those of a policy.
        """
        import onnxruntime

        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.log_severity_level = 4  # what is wrong is raised
        data = source if isinstance(source, bytes) else read_bytes(source)  # a model in memory names no other files
        where = "this" if isinstance(source, bytes) else source
        with guarded(f"{where} is no ONNX model that can be used"):
            self._session = onnxruntime.InferenceSession(data, options, providers=["CPUExecutionProvider"])
            told = self._session.get_modelmeta().custom_metadata_map
            self.preview = _preview(told)
            inputs = {value.name: value for value in self._session.get_inputs()}
            outputs = {value.name: value for value in self._session.get_outputs()}
            self._memory = [name for name in inputs if name != "observation"]
            wanted = ["action", *(NEXT + name for name in self._memory)]
            if "observation" not in inputs or not set(wanted) <= set(outputs):
                raise ValueError(
                    f"its inputs are {', '.join(inputs)} and its outputs {', '.join(outputs)}; there must be "
                    f"observation and action, and for each input that is a memory an output {NEXT}NAME"
                )
            self._wanted, self._types, self._sizes = wanted, {}, {}
            for name, value in inputs.items():
                self._types[name], self._sizes[name] = _taken(name, value)
            width = (SIZE + 2 * len(self.preview),)
            if self._sizes["observation"] != width:
                raise ValueError(
                    f"it takes observations {self._sizes['observation']}; here they are {width}, with two columns for "
                    "each control period that its metadata entry preview names"
                )
            self.predict(np.zeros((2, *width)))

    def actions(
        self, rows: NDArray[Any], state: Memory | None, episode_start: Starts, deterministic: bool
    ) -> tuple[NDArray[np.float32], Memory | None]:
        """Return actions and the memory, an array for each input that is one, see `Batched`.

        Raises:
            ValueError: the model gives no two numbers for each vehicle.
        """
        del deterministic
        n, width = len(rows), self._sizes["observation"][0]
        held_out = tuple(np.zeros((n, *self._sizes[name]), self._types[name]) for name in self._memory)
        memory = renewed(state, held_out, episode_start)
        given = {"observation": rows[:, :width].astype(self._types["observation"])}
        with guarded("the ONNX model fails"):
            action, *after = self._session.run(self._wanted, given | dict(zip(self._memory, memory, strict=True)))
        if any(a.shape != b.shape for a, b in zip((action, *after), (np.empty((n, 2)), *held_out), strict=True)):
            shapes = [a.shape for a in (action, *after)]
            raise ValueError(f"the ONNX model gives arrays of shapes {shapes} for {n} observations")
        return action.astype(np.float32), tuple(after)


def _preview(metadata: dict[str, str]) -> tuple[int, ...]:
    """Return the preview that metadata name, by themselves or in the names of an observation's columns."""
    named = re.findall(r"\d+", metadata.get("preview", ""))
    periods = named or re.findall(r"\bahead_(\d+)_x\b", metadata.get("observation", ""))
    return checked_preview([int(n) for n in periods])


def _taken(name: str, value: Any) -> tuple[Any, tuple[int, ...]]:
    """Return the type of an input and its shape behind the batch."""
    batch, *sizes = value.shape or [None]
    if value.type not in TYPES or not all(isinstance(size, int) for size in sizes):
        kinds = " or ".join(TYPES)
        raise ValueError(f"its input {name} is {value.type} of shape {value.shape}; it must be {kinds}, (batch, n)")
    if isinstance(batch, int):
        raise ValueError(f"its input {name} takes batches of {batch} alone; export it with a batch of any size")
    return TYPES[value.type], tuple(sizes)

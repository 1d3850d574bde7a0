"""Policies as ONNX models from any framework. ONNX Runtime runs them on one thread; they cannot run other code.

Inputs: `observation`, shape (batch, 18 + 2 P), in space (batch, 31 + 3 P), and arrays of memory (batch, ...), zero at
the start of an episode. Outputs: `action`, shape (batch, 2), in space (batch, 3), and for each memory `NAME` its next
value `next_NAME`. The metadata entry `preview` lists the P times of the preview in control periods ahead, such as
"10, 20".
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from auv_gym.scenarios.records import guarded
from auv_gym.task.observation import PLANE_LAYOUT
from auv_gym.task.preview import checked_preview
from auv_gym.task.space import SPACE
from baselines.policy import Batched, Memory, Starts, renewed
from baselines.tools.files import read_bytes

TYPES = {"tensor(float)": np.float32, "tensor(double)": np.float64}
"""Allowed types of inputs."""
NEXT = "next_"
"""Prefix of the name of an output that is a memory."""


class OnnxModel(Batched):
    """An ONNX model as a policy."""

    def __init__(self, source: Path | bytes) -> None:
        """Load a model from a file, or from the contents of one.

        Raises:
            ImportError: ONNX Runtime is not installed.
            OSError: the file cannot be read.
            ValueError: it is damaged, or the model's inputs and outputs are not those of a policy.
        """
        import onnxruntime

        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.log_severity_level = 4  # errors are raised as exceptions
        data = source if isinstance(source, bytes) else read_bytes(source)  # from bytes no external file can be read
        where = "this" if isinstance(source, bytes) else source
        with guarded(f"{where} is not a usable ONNX model"):
            self._session = onnxruntime.InferenceSession(data, options, providers=["CPUExecutionProvider"])
            self.preview = _preview(self._session.get_modelmeta().custom_metadata_map)
            inputs = {value.name: value for value in self._session.get_inputs()}
            outputs = {value.name: value for value in self._session.get_outputs()}
            self._memory = [name for name in inputs if name != "observation"]
            self._outputs = ["action", *(NEXT + name for name in self._memory)]
            if "observation" not in inputs or not set(self._outputs) <= set(outputs):
                raise ValueError(
                    f"its inputs are {', '.join(inputs)} and its outputs {', '.join(outputs)}; required are "
                    f"observation and action, and an output {NEXT}NAME for each other input NAME"
                )
            self._types, self._sizes = {}, {}
            for name, value in inputs.items():
                self._types[name], self._sizes[name] = _type_and_shape(name, value)
            given, times = self._sizes["observation"], len(self.preview)
            widths = {(layout.size + layout.axes * times,): layout for layout in (PLANE_LAYOUT, SPACE.layout)}
            if given not in widths:
                raise ValueError(
                    f"its observation has shape {given}; it must be {' or '.join(map(str, widths))}, with two columns "
                    "for each time in its metadata entry preview, in space with three"
                )
            self.layout = widths[given]
            self.predict(np.ones((2, *given)))

    def actions(
        self, rows: NDArray[Any], state: Memory | None, episode_start: Starts, deterministic: bool
    ) -> tuple[NDArray[np.float32], Memory | None]:
        """Return actions and memory, one array for each input of memory, see `Batched`.

        Raises:
            ValueError: the model fails, or returns arrays of wrong shapes.
        """
        del deterministic
        n, width = len(rows), self._sizes["observation"][0]
        initial = tuple(np.zeros((n, *self._sizes[name]), self._types[name]) for name in self._memory)
        memory = renewed(state, initial, episode_start)
        inputs = {"observation": rows[:, :width].astype(self._types["observation"])}
        with guarded("the ONNX model fails"):
            action, *after = self._session.run(self._outputs, inputs | dict(zip(self._memory, memory, strict=True)))
        if any(
            a.shape != b.shape
            for a, b in zip((action, *after), (np.empty((n, len(self.layout.last))), *initial), strict=True)
        ):
            shapes = [a.shape for a in (action, *after)]
            raise ValueError(f"the ONNX model returns arrays of shapes {shapes} for {n} observations")
        return action.astype(np.float32), tuple(after)


def _preview(metadata: dict[str, str]) -> tuple[int, ...]:
    """Return the preview from the metadata entry `preview`, or from the columns' names in the entry `observation`."""
    listed = re.findall(r"\d+", metadata.get("preview", ""))
    periods = listed or re.findall(r"\bahead_(\d+)_x\b", metadata.get("observation", ""))
    return checked_preview([int(n) for n in periods])


def _type_and_shape(name: str, value: Any) -> tuple[Any, tuple[int, ...]]:
    """Return the type of an input and its shape without the batch axis."""
    batch, *sizes = value.shape or [None]
    if value.type not in TYPES or not all(isinstance(size, int) for size in sizes):
        kinds = " or ".join(TYPES)
        raise ValueError(f"its input {name} is {value.type} of shape {value.shape}; it must be {kinds}, (batch, n)")
    if isinstance(batch, int):
        raise ValueError(f"its input {name} has a fixed batch size of {batch}; export it with a variable batch size")
    return TYPES[value.type], tuple(sizes)

"""The page of the documentation about export, docs/export.md, made of what was measured."""

from __future__ import annotations

from collections.abc import Mapping
from string import Template
from typing import Any

from baselines.evaluation.score import fixed, fixed_ends
from research.pages import table

_TEXT = Template("""# Export

<!-- Made by `python -m research deployment --record`; do not edit. -->

An agent, its expert inside, for programs that have nothing of this package: a C99 header without dependencies, or an
ONNX model. Both are printed from the graphs that the agent itself runs ([From equation to code](codegen.md)); the
network's program is recorded from the function that computes it.

```bash
auv-gym export apg-cruise --out runs/export
auv-gym export apg-cruise --format c --precision float64
auv-gym export sac-slow --format c --weights int8 --prefix slow_agent
auv-gym export helm-any --vehicle lauv --format c
```

An agent's name or the folder of a trained one is taken. Experts without memory are printed, which are all that the
shipped agents have; corrections that fade (`:fade`) are not. With `--vehicle`, a published one's name or a file, what
is written takes the observations of that vehicle in SI units, and an agent that is told its vehicle has it inside.

## The header

`apg-cruise.h` is included in one C file behind `#define AUV_AGENT_IMPLEMENTATION`, and wherever it is called without
it. It needs a C99 compiler and `sqrt`, `floor` and `fabs` of the C library; nothing is allocated, and all that is
remembered is in a struct of the caller's.

```c
#define AUV_AGENT_IMPLEMENTATION
#include "apg-cruise.h"

auv_agent_memory memory;
auv_agent_view view = {
    .measured = {0.2, -0.1, 0.05, 0.9, 0.0, 0.01},              /* x, y, psi, u, v over ground, r */
    .reference = {0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 70.0, 0.0},     /* x, y, psi, u, v, r, F_u, F_r */
    .setting = {400.0, 200.0, 0.1},                             /* limits [N], [N m]; control period [s] */
};
float command[2];
auv_agent_start(&memory);                                       /* an episode begins */
auv_agent_steer(&memory, &view, command);                       /* in each control period */
```

`auv_agent_steer` makes the observation itself, by what the environment does; who has it encoded calls
`auv_agent_step`. An agent with a preview finds a further field, `ahead`, in the view. Two agents in one program differ
in `--prefix`.

## The model

`apg-cruise.onnx` takes `observation` (batch, n) and what the agent remembers, `integrals`, `correction` and, for
recurrent networks, `hidden`, zeros at an episode's start; it gives `action`, commands in [-1, 1], and the memory to
hand in next as `next_integrals` and so on. Columns, scales, expert, authority, control period and the weights' hash
are in its metadata. Any runtime with opset 17 runs it:

```python
import numpy as np
import onnxruntime

from baselines.export.onnx_model import onnx_model
from baselines.export.parts import exported

model = onnx_model(exported("apg-cruise"), "float32").SerializeToString()  # or the path of a file
session = onnxruntime.InferenceSession(model)
given = {i.name: np.zeros((1, i.shape[1]), np.float32) for i in session.get_inputs()}
given["observation"][0, 11] = given["observation"][0, 13] = given["observation"][0, 14] = 1.0  # heading, limits
given["observation"][0, 17] = 0.8  # 0.1 s over its scale
action, *memory = session.run(None, given)
print(action.shape, [array.shape for array in memory])
```

```text
(1, 2) [(1, 4), (1, 2), (1, 64)]
```

## Is it the same?

The largest difference of any command from that of the agent on NumPy, in whole episodes with every disturbance at once,
each in a closed loop of its own. Commands are numbers of single precision everywhere: 6e-8 is one rounding. The score
is that of `benchmark-v1`, on the first $episodes episodes of each cell, and what the header in single precision loses
of it, with 95 % intervals over episodes; a negative loss is a gain.

$same

Weights of int8 are rounded row by row, and the sums are of single precision. They are offered for where memory is
short: the last columns say what they cost.

$small

## Speed and size

Processor time of one decision of one vehicle on a shared machine, in single precision: NumPy and ONNX Runtime as they
are called from Python, the header compiled by `gcc -O3` and called from C. On the emulated Cortex-M4 (QEMU's board
mps2-an386, `arm-none-eabi-gcc -O2`, floating-point unit on) **instructions** are counted, not cycles: QEMU has no
model of the processor's clock; a Cortex-M4 needs one to a few cycles for each. Code holds the weights; the stack is the
sum over all functions.

$fast

$m4
""")
"""The page, with places for what was measured."""


def page(record: Mapping[str, Any]) -> str:
    """Return the text of the page for what `measure` has recorded."""
    agents = record["agents"]
    same = table(
        ("agent", "ONNX, double", "ONNX, single", "header, double", "header, single", "score", "lost in single"),
        [
            (
                a["name"],
                *(f"{a[key]:.1e}" for key in ("onnx64", "onnx32", "c64", "c32")),
                fixed(a["score"]),
                _lost(a["lost32"], 5),
            )
            for a in agents
        ],
    )
    small = table(
        ("agent", "score", "lost with int8", "interval"),
        [(a["name"], fixed(a["score"]), fixed(a["lost8"][0], 4), fixed_ends(a["lost8"][1:], 4)) for a in agents],
    )
    fast = table(
        ("agent", "NumPy", "ONNX Runtime", "header", "header's size", "model's size"),
        [
            (
                a["name"],
                *(f"{a[key]:.1f} us" for key in ("numpy_us", "onnx_us", "c_us")),
                *(_kilo(a[key]) for key in ("header", "model")),
            )
            for a in agents
        ],
    )
    m4 = table(
        ("on the Cortex-M4", "instructions", "difference", "code", "code, int8", "memory", "stack"),
        [
            (
                a["name"],
                f"{a['instructions']:,.0f}",
                f"{a['m4']:.1e}",
                *(_kilo(a[key]) for key in ("code", "code8", "memory", "stack")),
            )
            for a in agents
        ],
    )
    return _TEXT.substitute(episodes=record["episodes"], same=same, small=small, fast=fast, m4=m4)


def _lost(triple: tuple[float, float, float], digits: int) -> str:
    return f"{fixed(triple[0], digits)} ({fixed_ends(triple[1:], digits)})"


def _kilo(size: int) -> str:
    return f"{size / 1024:.1f} KiB"

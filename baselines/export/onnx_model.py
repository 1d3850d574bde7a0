"""Generates an agent as an ONNX model: operators on columns for its graphs, and on matrices for its network."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from onnx import TensorProto, checker, helper, numpy_helper

from auv_gym.codegen.elementary import lowered
from auv_gym.codegen.graph import Graph, Symbol
from auv_gym.task.policy import LARGEST
from baselines.export.parts import Exported
from baselines.export.sums import long_sums
from baselines.export.vectors import Program

OPSET = 17
"""Version of the operator set; runtimes of the last years support it."""
IR_VERSION = 9
"""Version of the file format for this operator set."""
OPERATORS = {
    "add": "Add", "sub": "Sub", "mul": "Mul", "div": "Div", "neg": "Neg", "abs": "Abs", "log": "Log", "sqrt": "Sqrt",
    "floor": "Floor", "clip": "Clip", "where": "Where", "lt": "Less", "le": "LessOrEqual", "and": "And", "or": "Or",
    "not": "Not", "maximum": "Max", "tanh": "Tanh",
}  # fmt: skip
"""ONNX operators by operation of a graph or of a `Program`; `lowered` removes all other operations of graphs."""


class _Writer:
    """Collects the nodes and constants of a model."""

    def __init__(self, precision: str) -> None:
        self.precision = precision
        self.real = TensorProto.FLOAT if precision == "float32" else TensorProto.DOUBLE
        self.single, self.truth = TensorProto.FLOAT, TensorProto.BOOL
        self.nodes: list[Any] = []
        self.constants: dict[str, Any] = {}
        self.positive: Sequence[int] = ()  # columns of the observation that must be positive

    def node(self, operator: str, inputs: Sequence[str], outputs: Sequence[str], **attributes: Any) -> None:
        """Add an operator."""
        self.nodes.append(helper.make_node(operator, list(inputs), list(outputs), **attributes))

    def constant(self, name: str, value: Any, kind: Any = None) -> str:
        """Add a constant and return its name."""
        self.constants.setdefault(name, numpy_helper.from_array(np.array(value, kind or self.precision), name))
        return name

    def number(self, value: float | bool) -> str:
        """Add a constant number or truth value and return its name."""
        return self.constant(f"c_{value!r}", value, np.bool_ if isinstance(value, bool) else None)

    def split(self, array: str, names: Sequence[str]) -> None:
        """Split an array into columns of these names."""
        self.node("Split", [array, self.constant(f"ones_{len(names)}", [1] * len(names), np.int64)], names, axis=1)

    def slice(self, array: str, first: int, size: int, name: str) -> None:
        """Add the columns of an array from `first` on under a name."""
        ends = [self.constant(f"at_{k}", [k], np.int64) for k in (first, first + size, 1)]
        self.node("Slice", [array, *ends], [name])

    def equation(self, prefix: str, graph: Graph, wanted: Sequence[Symbol], given: Mapping[str, str]) -> list[str]:
        """Add the nodes for some results of a graph and return their names; `given` has the names of its inputs."""
        flat = lowered(graph, wanted, self.precision)
        names: dict[int, str] = {}
        products, needed = long_sums(graph, {s.index for s in flat})
        first = {product.sums[0]: product for product in products}
        of_product = {i for product in products for i in product.sums}
        for i in needed:
            operation, *arguments = graph.nodes[i]
            names[i] = f"{prefix}{i}"
            if i in first:
                factors, sums = first[i].factors, [f"{prefix}{j}" for j in first[i].sums]
                self.product(f"{prefix}{i}", [names[f] for f in factors], first[i].matrix, sums)
            elif i in of_product:
                continue
            elif operation == "input":
                names[i] = given[arguments[0]]
            elif operation == "constant":
                names[i] = self.number(arguments[0])
            elif operation == "single":
                self.node("Cast", [names[arguments[0]]], [f"{names[i]}_single"], to=self.single)
                self.node("Cast", [f"{names[i]}_single"], [names[i]], to=self.real)
            elif operation == "clip" and any(graph.nodes[a][0] != "constant" for a in arguments[1:]):
                value, low, high = (names[a] for a in arguments)
                self.node("Max", [value, low], [f"{names[i]}_above"])  # the bounds of Clip are single numbers
                self.node("Min", [f"{names[i]}_above", high], [names[i]])
            else:
                self.node(OPERATORS[operation], [names[a] for a in arguments], [names[i]])
        columns = [names[s.index] for s in flat]
        for j, symbol in enumerate(flat):
            if symbol.value is not None:  # a number becomes a column
                self.node("Shape", [next(iter(given.values()))], [f"{prefix}_{j}_shape"])
                self.node("Expand", [columns[j], f"{prefix}_{j}_shape"], [f"{prefix}_{j}"])
                columns[j] = f"{prefix}_{j}"
        return columns

    def product(self, name: str, factors: Sequence[str], matrix: Any, sums: Sequence[str]) -> None:
        """Add the products of a matrix, with a row for each sum, with a column of factors."""
        self.node("Concat", factors, [f"{name}_factors"], axis=1)
        turned = self.constant(f"{name}_T", np.transpose(matrix))
        self.node("MatMul", [f"{name}_factors", turned], [f"{name}_sums"])
        self.split(f"{name}_sums", sums)

    def within(self, array: str, most: float) -> str:
        """Add the mask of the entries of an array whose magnitude is at most `most`, and return its name."""
        self.node("Abs", [array], [f"{array}_size"])
        self.node("LessOrEqual", [f"{array}_size", self.number(most)], [f"{array}_within"])
        return f"{array}_within"

    def usable(self, arrays: Sequence[str]) -> str:
        """Add the mask of the rows in which all entries of some arrays are usable, and return its name.

        The limits and the control period in the observation must be positive.
        """
        self.node("Gather", ["observation", self.constant("positive", self.positive, np.int64)], ["settings"], axis=1)
        self.node("Greater", ["settings", self.number(0.0)], ["settings_positive"])
        masks = [self.within(array, LARGEST) for array in arrays] + ["settings_positive"]
        for mask in masks:  # ONNX has no minimum of truth values
            self.node("Cast", [mask], [f"{mask}_ones"], to=self.real)
            self.node("ReduceMin", [f"{mask}_ones"], [f"{mask}_least"], axes=[1], keepdims=1)
        self.node("Min", [f"{mask}_least" for mask in masks], ["least"])
        self.node("Cast", ["least"], ["usable"], to=self.truth)
        return "usable"

    def program(self, program: Program, given: Mapping[str, str]) -> dict[str, str]:
        """Add a network and return the names of its results; its vectors become rows of the batch."""
        names: dict[int, str] = {}

        def named(argument: Any) -> str:
            if isinstance(argument, float):
                return self.number(argument)
            if isinstance(argument, int):
                return names[argument]
            return self.constant(argument, program.constants[argument])

        for i, node in enumerate(program.nodes):
            operation, arguments, names[i] = node.operation, node.arguments, f"network{i}"
            if operation == "input":
                names[i] = given.get(arguments[0], "")
            elif operation == "slice":
                self.slice(names[arguments[0]], arguments[1], node.size, names[i])
            elif operation == "concatenate":
                self.node("Concat", [names[a] for a in arguments], [names[i]], axis=1)
            elif operation == "dot":
                turned = self.constant(f"{arguments[0]}_T", program.constants[arguments[0]].T)
                self.node("MatMul", [names[arguments[1]], turned], [names[i]])
            else:
                self.node(OPERATORS[operation], [named(a) for a in arguments], [names[i]])
        return {result: names[i] for result, i in program.results.items()}


def onnx_model(agent: Exported, precision: str = "float64") -> Any:
    """Return an agent as a checked `onnx.ModelProto`.

    The inputs are the observation (batch, n) and the memory: arrays (batch, size), zero at the start of an episode. The
    outputs are the action (batch, channels), with names next_... the memory for the next call, and repeated (batch, 1).
    If a number in a row of the inputs or results is not finite or larger than `LARGEST` in magnitude, or a limit or the
    control period is not positive, the action is the last one, which is in the observation, or zero where that is not
    in [-1, 1], and the memory is the input memory. Then `repeated` is true.

    Args:
        agent: the agent.
        precision: type of all numbers, including inputs and outputs, "float32" or "float64".
    """
    writer, layout, channels = _Writer(precision), agent.model.layout, len(agent.model.channels)
    writer.positive = layout.positive
    results = _add_agent(writer, agent)
    writer.slice("observation", layout.last[0], channels, "last")
    writer.node("Where", [writer.within("last", 1.0), "last", writer.number(0.0)], ["last_command"])
    before = {"action": "last_command", **{f"next_{name}": name for name in agent.memory}}
    usable = writer.usable(["observation", *(results[name] for name in before)])
    sizes = {"observation": len(agent.columns), **agent.memory}
    ends = {"action": channels} | {f"next_{name}": size for name, size in agent.memory.items()}
    for name in ends:
        writer.node("Where", [usable, results[name], before[name]], [name])
    writer.node("Not", [usable], ["repeated"])
    value = helper.make_tensor_value_info
    inputs = [value(name, writer.real, ["batch", size]) for name, size in sizes.items()]
    outputs = [value(name, writer.real, ["batch", size]) for name, size in ends.items()]
    outputs.append(value("repeated", writer.truth, ["batch", 1]))
    graph = helper.make_graph(writer.nodes, agent.name, inputs, outputs, list(writer.constants.values()))
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)], producer_name="auv_gym")
    model.ir_version = IR_VERSION
    model.doc_string = f"{agent.name}: command for an observation, with the expert {agent.agent.expert}"
    helper.set_model_props(model, agent.facts)
    checker.check_model(model, full_check=True)
    return model


def _add_agent(writer: _Writer, agent: Exported) -> dict[str, str]:
    """Add features, network and command, and return the names of the results by the names of the outputs."""
    see = agent.see
    given = {s.node[1]: s.node[1] for symbols in see.arguments.values() for s in symbols}
    columns = [s.node[1] for s in see.arguments["observation"]] + [s.node[1] for s in see.arguments["ahead"]]
    writer.split("observation", columns)
    for name in ("integrals", "correction"):
        writer.split(name, [s.node[1] for s in see.arguments[name]])
    names = writer.equation("see", see.graph, [s for symbols in agent.seen.values() for s in symbols], given)
    seen: dict[str, list[str]] = {}
    for name, symbols in agent.seen.items():
        seen[name], names = names[: len(symbols)], names[len(symbols) :]
        writer.node("Concat", seen[name], [f"{name}_now"], axis=1)
    network = writer.program(agent.network, {"features": "features_now", "hidden": "hidden"})
    changes = [f"change_{j}" for j in range(len(agent.model.channels))]
    writer.split(network["correction"], changes)
    rule, authority = agent.command, [writer.number(a) for a in agent.agent.authority]
    columns = [*seen["base"], *authority, *changes]
    entries = [s.node[1] for name in ("base", "authority", "correction") for s in rule.arguments[name]]
    command = writer.equation("command", rule.graph, rule.results["command"], dict(zip(entries, columns, strict=True)))
    writer.node("Concat", command, ["command"], axis=1)
    return {
        "action": "command",
        "next_integrals": "integrals_now",
        "next_correction": network["correction"],
        "next_hidden": network["next_hidden"],
    }

"""The equations of the live page in JavaScript, printed from the kernels."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

from auv_gym.codegen.graph import SYMBOLS, Symbol, single
from auv_gym.codegen.kernel import Kernel
from auv_gym.codegen.printing import ARITHMETIC, Language
from auv_gym.physics.rows import unflatten
from auv_gym.scenarios.exogenous import (
    GUST_ROWS,
    GUSTS,
    MEASUREMENT_NORMALS,
    NORMALS,
    WAVE_ROWS,
    WEATHER,
    WEATHER_ROWS,
    Gust,
    gusty_current,
    measurement_errors,
    next_gust,
    wave_load,
)
from auv_gym.task.kernels import start_kernel, step_kernel
from auv_gym.task.observation import SIZE, Observation, action_of, decode
from auv_gym.task.policy import Law
from auv_gym.task.preview import preview_columns
from auv_gym.task.simulation import Parts
from baselines.control.backstepping import Backstepping
from baselines.control.ekf_law import law_kernel
from baselines.control.open_loop import OpenLoop
from baselines.estimation.filter_equations import Belief
from baselines.estimation.kalman import averaged, filter_kernel
from baselines.export.parts import Exported, network_program
from baselines.export.plain import plain_function, tangent_function
from baselines.export.vectors import plain_program

COMPONENTS = 6
"""Number of sines of the waves."""
_PARTS = Parts()
"""Parts of the simulation: those of the presets, with one integration step."""
LAWS: Mapping[str, Law] = {"backstepping": Backstepping(), "openLoop": OpenLoop()}
"""Control laws without memory, by the names of their functions."""
FILTER = sum(Belief.sizes())  # size of the state of a filter
TANGENT = "tangent"
"""Name of the function of the hyperbolic tangent."""


def _javascript_number(value: float | bool) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if not math.isfinite(value):
        return "NaN" if math.isnan(value) else "Infinity" if value > 0 else "(-Infinity)"
    text = repr(value).removesuffix(".0")
    return f"({text})" if text[0] == "-" else text


LANGUAGE = Language(
    {
        **ARITHMETIC,
        **{name: f"Math.{name}({{0}})" for name in ("sin", "cos", "exp", "log", "sqrt", "floor", "abs")},
        "arctan2": "Math.atan2({0}, {1})",
        "single": "Math.fround({0})",
        "clip": "({0} < {1} ? {1} : {0} > {2} ? {2} : {0})",
        "where": "({0} ? {1} : {2})",
        "and": "({0} && {1})",
        "or": "({0} || {1})",
        "not": "(!{0})",
    },
    frozenset(("clip",)),
    _javascript_number,
)
"""JavaScript. Its numbers are of double precision, and it does not contract a product with a sum."""
_DECLARATIONS = (
    (r"\(void\)\w+;\n", ""),
    (r"static (?:void|real) ", "function "),
    (r"(?:const )?real \*(\w+)", r"\1"),  # an array as a parameter
    (r"\(real x\)", "(x)"),  # a number as a parameter
    (r"real (\w+)\[(\d+)\];", r"const \1 = new Float64Array(\2);"),
    (r"const (?:real|int) ", "const "),
    (r"\b(?:real|int) ", "let "),
)
"""The declarations of C and those of JavaScript, in the order of their replacement."""


def javascript(source: str) -> str:
    """Return JavaScript functions from plain C functions whose expressions are those of `LANGUAGE`."""
    for pattern, replacement in _DECLARATIONS:
        source = re.sub(pattern, replacement, source)
    return source


def equations(agents: Sequence[Exported]) -> str:
    """Return the script that defines the page's object `EQUATIONS`, a function for each equation.

    Args:
        agents: agents of the page. Those with the same `shape_of` share their functions.
    """
    functions = {name: printed(name, kernel) for name, kernel in page_kernels().items()}
    functions["command"] = printed("command", agents[0].command)
    functions |= agent_functions(agents)
    body = "\n".join(functions.values())
    names = ", ".join(functions)
    tangent = javascript(tangent_function(TANGENT, LANGUAGE, "float64"))
    return f'"use strict";\nconst EQUATIONS = (() => {{\n{tangent}\n{body}\nreturn {{ {names} }};\n}})();\n'


def printed(name: str, kernel: Kernel, results: Mapping[str, Sequence[Symbol]] | None = None) -> str:
    """Return a JavaScript function that computes all or some results of a kernel."""
    results = results or kernel.results
    return javascript(plain_function(name, kernel.graph, kernel.arguments, results, LANGUAGE, "float64"))


def page_kernels() -> dict[str, Kernel]:
    """Return the kernels of the simulation and of the controllers without agents, by the names of their functions."""
    return {
        "start": start_kernel(_PARTS),
        "step": step_kernel(_PARTS),
        "sea": _sea_kernel(),
        "decoded": Kernel.traced(lambda seen: {"terms": decode(seen, SYMBOLS)}, {"seen": SIZE}),
        "forcesToAction": Kernel.traced(_action, {"terms": SIZE, "force": 2}),
        "filter": filter_kernel(),
        "combined": Kernel.traced(_combined, {"rough": FILTER, "calm": FILTER}),
        "ekfLaw": law_kernel(),
        **{name: _law_kernel(law) for name, law in LAWS.items()},
    }


def _sea_kernel() -> Kernel:
    """Return the kernel of the disturbances and measurement errors of a sample, from the gusts of the sample before."""

    def equation(gust: Any, normals: Any, weather: Any, waves: Any) -> dict[str, Any]:
        w, k = unflatten(WEATHER, weather), gust[0]
        new = next_gust(Gust.of(gust), normals[GUSTS], w, SYMBOLS)
        current = gusty_current(k, new.filtered, w, SYMBOLS)
        load = wave_load(k, [waves[i : i + WAVE_ROWS] for i in range(0, len(waves), WAVE_ROWS)], SYMBOLS)
        return {"gust": new.row, "sea": (*current, *load, *measurement_errors(normals[MEASUREMENT_NORMALS], w), 1.0)}

    rows = {"gust": GUST_ROWS, "normals": NORMALS, "weather": WEATHER_ROWS, "waves": WAVE_ROWS * COMPONENTS}
    return Kernel.traced(equation, rows)


def _combined(rough: Any, calm: Any) -> dict[str, Any]:
    """Return the weighted mean of the estimates of the filters for a rough and a calm sea."""
    filters = Belief.of(rough), Belief.of(calm)
    return {"state": averaged([f.fit[0] for f in filters], [f.state for f in filters], SYMBOLS)}


def _action(terms: Any, force: Any) -> dict[str, Any]:
    """Return the action for a pair of forces, in single precision as the actions of policies."""
    return {"action": [single(a) for a in action_of(tuple(force), terms, SYMBOLS)]}


def _law_kernel(law: Law) -> Kernel:
    """Return the kernel of the action of a control law for an observation."""

    def equation(seen: Any) -> dict[str, Any]:
        o = decode(seen, SYMBOLS)
        return _action(o, law.forces(o, SYMBOLS))

    return Kernel.traced(equation, {"seen": SIZE})


def preview_kernel(columns: int) -> Kernel:
    """Return the kernel of the columns of a preview, from displacements of the reference in the world frame."""

    def equation(seen: Any, ways: Any) -> dict[str, Any]:
        return {"ahead": preview_columns(ways, Observation._make(decode(seen, SYMBOLS)), SYMBOLS, bound_factor=1)}

    return Kernel.traced(equation, {"seen": SIZE, "ways": columns})


def agent_functions(agents: Sequence[Exported]) -> dict[str, str]:
    """Return the functions of agents by name; the names of the functions of an agent contain its `shape_of`.

    The function of a network is made from its weights: `NETWORK(weights)(features, hidden, correction, next_hidden)`.
    """
    functions: dict[str, str] = {}
    for agent in agents:
        shape = shape_of(agent)
        functions[f"see_{shape}"] = printed(f"see_{shape}", agent.see, agent.seen)
        program = network_program(agent.agent, "weights.")
        inside = javascript(plain_program("run", program, TANGENT, LANGUAGE, {}))
        functions[f"network_{shape}"] = f"function network_{shape}(weights)\n{{\n{inside}return run;\n}}\n"
        if agent.preview:
            functions[f"preview_{shape}"] = printed(f"preview_{shape}", preview_kernel(2 * len(agent.preview)))
    return functions


def shape_of(agent: Exported) -> str:
    """Return the part of the function names that is the same for agents with the same equations."""
    network = agent.agent.network
    sizes = [entry for name, shape in network.shapes.items() if name.endswith("weight") for entry in shape]
    inputs = agent.agent.inputs
    seen = [f"p{n}" for n in agent.preview] + [f for f in ("integrals", "fine", "filters") if getattr(inputs, f)]
    return "_".join((network.kind, agent.agent.expert, *map(str, sizes), *seen)).replace("-", "_")

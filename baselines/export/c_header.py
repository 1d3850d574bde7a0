"""Generates an agent as one C99 header: graphs become statements, the network loops, and the weights tables."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from typing import Any

import numpy as np

from auv_gym.codegen.printing import c_language
from auv_gym.task.policy import LARGEST
from baselines.export.parts import Exported, network_program
from baselines.export.plain import parameters, plain_function, tangent_function
from baselines.export.vectors import plain_program

PREFIX = "auv_agent"
"""Default prefix of the names in a header."""
_WIDTH = 120  # [characters] of a line

_USE = """
In one C file of the program, write both of these lines, and in the other files that call it only the second line:

    #define {CAPITALS}_IMPLEMENTATION
    #include "{file}"

Call {prefix}_start at the start of an episode. In each control period call {prefix}_steer with the measurements, or
{prefix}_step with an encoded observation. The code does not allocate memory. It calls sqrt, log, floor and fabs of the
C library only.

Both functions return {CAPITALS}_OK. They return {CAPITALS}_REPEATED if no command can be computed because an
input or a result is not finite or larger than {largest} in magnitude, or a limit or the control period is not positive.
In that case the last command is repeated (zero at the start of an episode) and the memory does not change, so the bad
input has no effect on later commands.
The code is valid C99 and C++. Do not compile it with -ffast-math or -ffinite-math-only, which remove these checks.
"""

_DECLARED = """\
#ifndef {CAPITALS}_H
#define {CAPITALS}_H

#ifdef __cplusplus
extern "C" {{
#endif

typedef {real} {prefix}_real;

enum {{ {CAPITALS}_OBSERVATION = {size} }}; /* size of an observation */
enum {{ {CAPITALS}_OK = 0, {CAPITALS}_REPEATED = 1 }}; /* a new command, or the last command repeated */

/* The memory of the agent. */
typedef struct {{
{memory}
    {prefix}_real command[{channels}]; /* the last one */
}} {prefix}_memory;

/* Measurements, reference and settings of a control period, in SI units. */
typedef struct {{
    {prefix}_real measured[{states}]; /* {measured}; {velocities} over ground, in body axes */
    {prefix}_real reference[{references}]; /* {reference} */
    {prefix}_real setting[{settings}]; /* {setting} */
{ahead}}} {prefix}_view;

/* Reset the memory at the start of an episode. */
void {prefix}_start({prefix}_memory *memory);

/* Write the observation of a view; it contains the last command, which is in the memory. */
void {prefix}_observe(const {prefix}_memory *memory, const {prefix}_view *view, {prefix}_real *observation);

/* Write the command for an observation: {actuators}, -1 to 1. Returns {CAPITALS}_OK or {CAPITALS}_REPEATED. */
int {prefix}_step({prefix}_memory *memory, const {prefix}_real *observation, {prefix}_real *command);

/* Write the command for a view; {forces}. Returns as {prefix}_step. */
int {prefix}_steer({prefix}_memory *memory, const {prefix}_view *view, {prefix}_real *command);

#ifdef __cplusplus
}}
#endif

#endif

#ifdef {CAPITALS}_IMPLEMENTATION

#include <math.h>

#define real {prefix}_real

"""

_DEFINED = """\
static int {prefix}_usable(const real *numbers, int count)
{{
    const real largest = (real){largest};
    int i;
    for (i = 0; i < count; i++)
        if (!(numbers[i] >= -largest && numbers[i] <= largest)) return 0;
    return 1;
}}

void {prefix}_start({prefix}_memory *memory)
{{
    int i;
{forget}
}}

void {prefix}_observe(const {prefix}_memory *memory, const {prefix}_view *view, real *observation)
{{
    {prefix}_encode({encoded});
}}

int {prefix}_step({prefix}_memory *memory, const real *observation, real *command)
{{
    static const real authority[{channels}] = {{{authority}}};
    {prefix}_memory next = *memory;
    real features[{features}], base[{channels}];
    int i, good = {prefix}_usable(observation, {CAPITALS}_OBSERVATION){positive};
    if (good) {{
        {prefix}_see({seen});
        {prefix}_network({computed});
        {prefix}_command(base, authority, next.correction, next.command);
        good = {finite};
    }}
    if (good) *memory = next;
    for (i = 0; i < {channels}; i++) command[i] = memory->command[i];
    return good ? {CAPITALS}_OK : {CAPITALS}_REPEATED;
}}

int {prefix}_steer({prefix}_memory *memory, const {prefix}_view *view, real *command)
{{
    real observation[{CAPITALS}_OBSERVATION];
    int i, good = {given};
    if (good) {{
        {prefix}_observe(memory, view, observation);
        return {prefix}_step(memory, observation, command);
    }}
    for (i = 0; i < {channels}; i++) command[i] = memory->command[i];
    return {CAPITALS}_REPEATED;
}}

#undef real

#endif
"""


def c_header(agent: Exported, precision: str = "float32", weights: str = "float32", prefix: str = PREFIX) -> str:
    """Return the text of an agent's header.

    Args:
        agent: the agent.
        precision: type of all numbers, "float32" or "float64".
        weights: type of the network's matrices, "float32" or "int8".
        prefix: prefix of every name in the header.
    """
    ahead, model = "", agent.model
    if agent.preview:
        times = ", ".join(map(str, agent.preview))
        axes = ", ".join(model.position)
        meaning = f"displacement {axes} [m] of the reference, in world axes, after {times} control periods"
        ahead = f"    {prefix}_real ahead[{len(model.position) * len(agent.preview)}]; /* {meaning} */\n"
    names = {
        "prefix": prefix,
        "file": f"{agent.name}.h",
        "CAPITALS": prefix.upper(),
        "real": "float" if precision == "float32" else "double",
        "size": str(len(agent.columns)),
        "memory": "\n".join(f"    {prefix}_real {name}[{size}];" for name, size in agent.memory.items()),
        "channels": str(len(model.channels)),
        "states": str(len(agent.measured)),
        "references": str(len(agent.reference)),
        "settings": str(len(agent.setting)),
        "measured": ", ".join(agent.measured),
        "reference": ", ".join(agent.reference),
        "setting": ", ".join(agent.setting),
        "velocities": ", ".join(model.velocity),
        "actuators": "surge and yaw" if len(model.channels) == 2 else "surge, pitch and yaw",
        "forces": agent.meaning,
        "ahead": ahead,
        "largest": f"{LARGEST:g}",
    }
    facts = [f"{key}: {text}" for key, text in agent.facts.items()]
    about = [line for fact in facts for line in textwrap.wrap(fact, _WIDTH, subsequent_indent="  ")]
    title = "An agent of auv_gym with its expert, written by auv-gym export."
    comment = "\n".join(("/*", title, "", _USE.format(**names).strip(), "", *about, "*/"))
    declared = _DECLARED.format(**names) + _functions(agent, precision, weights, prefix)
    return "\n".join((comment, declared, _DEFINED.format(**names, **_calls(agent, precision, prefix))))


def _functions(agent: Exported, precision: str, weights: str, prefix: str) -> str:
    """Return the tables of the weights, and the functions generated from graphs and network."""
    language, tangent = c_language(precision), f"{prefix}_tanh"
    parts: list[str] = []
    scales: dict[str, str] = {}
    program = network_program(agent.agent, f"{prefix}_")
    for name, array in program.constants.items():
        if array.ndim > 1 and weights == "int8":
            integers, scale = quantised(array)
            scales[name] = f"{name}_scale"
            parts += [_table("signed char", name, integers), _table("float", scales[name], scale)]
        else:
            parts.append(_table("float", name, array))
    parts.append(tangent_function(tangent, language, precision))
    parts.append(plain_program(f"{prefix}_network", program, tangent, language, scales))
    for name, kernel, results in (
        ("see", agent.see, agent.seen),
        ("command", agent.command, agent.command.results),
        ("encode", agent.encode, agent.encode.results),
    ):
        function = f"{prefix}_{name}"
        parts.append(plain_function(function, kernel.graph, kernel.arguments, results, language, precision, loops=True))
    return "\n".join(parts)


def quantised(weight: Any) -> tuple[Any, Any]:
    """Return a matrix as integers in [-127, 127] and the scale factor of each row."""
    scale = np.abs(weight).max(axis=1) / 127
    scale = np.where(scale > 0, scale, 1.0).astype(np.float32)
    return np.rint(weight / scale[:, None]).astype(np.int8), scale


def _table(kind: str, name: str, array: Any) -> str:
    """Return the declaration of a constant array, row by row, with enough digits to restore each number exactly."""
    entries = [f"{x}" if kind == "signed char" else _single(x) for x in np.ravel(array).tolist()]
    return f"static const {kind} {name}[{len(entries)}] = {{\n{textwrap.fill(', '.join(entries), _WIDTH)}\n}};\n"


def _single(x: float) -> str:
    text = np.format_float_positional(np.float32(x), trim="0") if 1e-4 < abs(x) < 1e6 else repr(float(f"{x:.9g}"))
    return f"{text}f"


def _calls(agent: Exported, precision: str, prefix: str) -> dict[str, str]:
    """Return the arguments and sizes with which the template `_DEFINED` calls the generated functions."""
    seen = {"observation": "observation", "ahead": f"observation + {agent.model.layout.size}"}
    seen |= {"correction": "memory->correction", "integrals": "next.integrals"}
    encode = parameters(agent.encode.arguments, agent.encode.results)
    encoded = {"observation": "observation", "last": "memory->command"}
    views = {name: len(entries) for name, entries in agent.encode.arguments.items() if name != "last"}
    sizes, hidden = {**agent.memory, "command": len(agent.model.channels)}, bool(agent.agent.network.memory)

    def usable(where: str, arrays: Mapping[str, int], indent: int) -> str:
        checks = (f"{prefix}_usable({where}{name}, {n})" for name, n in arrays.items())
        return f"\n{' ' * indent}    && ".join(checks)

    return {
        "encoded": ", ".join(encoded.get(name, f"view->{name}") for name in encode),
        "authority": ", ".join(map(c_language(precision).number, agent.agent.authority)),
        "features": str(agent.agent.network.inputs),
        "seen": ", ".join(seen.get(name, name) for name in parameters(agent.see.arguments, agent.seen)),
        "computed": ", ".join(("features", *["memory->hidden"] * hidden, "next.correction", *["next.hidden"] * hidden)),
        "forget": "\n".join(f"    for (i = 0; i < {n}; i++) memory->{name}[i] = 0;" for name, n in sizes.items()),
        "positive": "".join(f" && observation[{i}] > 0" for i in agent.model.layout.positive),
        "finite": usable("next.", sizes, 8),
        "given": usable("view->", views, 4),
    }

"""Sine and cosine made of additions and products: the same bits on every machine, for one vehicle or thousands.

The C library's differ from machine to machine and keep a compiler from computing several vehicles at once. An angle is
brought into [-pi/4, pi/4] by the multiple of pi/2 in three parts (W. J. Cody and W. Waite, Software Manual for the
Elementary Functions, 1980) and the polynomials of fdlibm (Sun Microsystems, 1993) take it from there. In double
precision they are within 1e-15 of the exact ones for angles up to 10,000 rad.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from auv_gym.codegen.graph import SYMBOLS, Graph, Symbol
from auv_gym.namespaces import Namespace, Number

HALF_PI = {
    "float64": (1.57079632673412561417, 6.07710050630396597660e-11, 2.02226624871116645580e-21),
    "float32": (1.5703125, 4.837512969970703125e-4, 7.54978995489188216e-8),
}
"""pi/2 in three parts, by precision; a product of the first two with a small integer is exact."""
SINE = (
    -1.66666666666666324348e-01,
    8.33333333332248946124e-03,
    -1.98412698298579493134e-04,
    2.75573137070700676789e-06,
    -2.50507602534068634195e-08,
    1.58969099521155010221e-10,
)
COSINE = (
    4.16666666666666019037e-02,
    -1.38888888888741095749e-03,
    2.48015872894767294178e-05,
    -2.75573143513906633035e-07,
    2.08757232129817482790e-09,
    -1.13596475577881948265e-11,
)


def _polynomial(z: Number, coefficients: Sequence[float]) -> Number:
    total: Number = coefficients[-1]
    for c in coefficients[-2::-1]:
        total = c + z * total
    return total


def sine_cosine(angle: Number, precision: str, ns: Namespace) -> tuple[Number, Number]:
    """Return the sine and the cosine of an angle [rad].

    Args:
        angle: of any size; precision is lost with it, as always, and beyond 1e6 rad the result is only bounded.
        precision: "float64" or "float32", of the numbers that it will be computed with.
        ns: the namespace of the numbers.
    """
    first, second, third = HALF_PI[precision]
    k = ns.floor(angle * (2 / math.pi) + 0.5)
    r = ns.clip(angle - k * first - k * second - k * third, -1.0, 1.0)
    z = r * r
    half = 0.5 * z
    s = r + r * z * _polynomial(z, SINE)
    one = 1.0 - half
    c = one + ((1.0 - one - half) + z * z * _polynomial(z, COSINE))
    pairs = ns.floor(0.5 * k)
    odd, turned = k > 2.0 * pairs, pairs > 2.0 * ns.floor(0.5 * pairs)
    s, c = ns.where(odd, c, s), ns.where(odd, -s, c)
    return ns.where(turned, -s, s), ns.where(turned, -c, c)


def lowered(graph: Graph, outputs: Sequence[Symbol], precision: str) -> list[Symbol]:
    """Return the outputs with every sine and cosine made of `sine_cosine`, in the same graph."""
    new: dict[int, Symbol] = {}
    for i in graph.needed(s.index for s in outputs):
        old = Symbol(graph, i)
        arguments = [new[a.index] for a in old.arguments]
        if old.node[0] in ("sin", "cos"):
            new[i] = sine_cosine(arguments[0], precision, SYMBOLS)[old.node[0] == "cos"]
        else:
            new[i] = graph.apply(old.node[0], *arguments) if arguments else old
    return [new[s.index] for s in outputs]

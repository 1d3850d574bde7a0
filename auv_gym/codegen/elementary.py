"""Elementary functions made of additions and products: the same bits on every machine, for one vehicle or thousands.

The functions of the C library differ between machines, and a compiler cannot vectorise them. Sine and cosine reduce the
angle to [-pi/4, pi/4] with pi/2 in three parts (W. J. Cody and W. Waite, Software Manual for the Elementary Functions,
1980) and then use the polynomials of fdlibm (Sun Microsystems, 1993). In double precision their error is below 1e-15
for angles up to 10,000 rad. The exponential function is that of fdlibm. The arctangent is that of Cephes (S. L.
Moshier, Methods and Programs for Mathematical Functions, 1989).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from auv_gym.codegen.graph import SYMBOLS, Graph, Symbol
from auv_gym.physics.namespaces import Namespace, Number

HALF_PI = {
    "float64": (1.57079632673412561417, 6.07710050630396597660e-11, 2.02226624871116645580e-21),
    "float32": (1.5703125, 4.837512969970703125e-4, 7.54978995489188216e-8),
}
"""pi/2 as a sum of three parts, by precision; products of the first two with small integers are exact."""
SINE = (
    -1.66666666666666324348e-01,
    8.33333333332248946124e-03,
    -1.98412698298579493134e-04,
    2.75573137070700676789e-06,
    -2.50507602534068634195e-08,
    1.58969099521155010221e-10,
)
"""Coefficients of (sin(r) - r) / r^3 in powers of r^2."""
COSINE = (
    4.16666666666666019037e-02,
    -1.38888888888741095749e-03,
    2.48015872894767294178e-05,
    -2.75573143513906633035e-07,
    2.08757232129817482790e-09,
    -1.13596475577881948265e-11,
)
"""Coefficients of (cos(r) - 1 + r^2 / 2) / r^4 in powers of r^2."""

LN_2 = {
    "float64": (6.93147180369123816490e-01, 1.90821492927058770002e-10),
    "float32": (0.693359375, -2.12194440e-4),
}
"""ln(2) as a sum of two parts, by precision."""
EXPONENTIAL = (
    1.66666666666666019037e-01,
    -2.77777777770155933842e-03,
    6.61375632143793436117e-05,
    -1.65339022054652515390e-06,
    4.13813679705723846039e-08,
)
"""Coefficients of r coth(r/2) - 2 in powers of r^2, beginning with r^2."""
LEAST_POWER = {"float64": -1022, "float32": -126}
"""Exponent of the smallest normal number, by precision. The largest exponent is 1 minus it."""
ARCTANGENT = (
    -6.485021904942025371773e01,
    -1.228866684490136173410e02,
    -7.500855792314704667340e01,
    -1.615753718733365076637e01,
    -8.750608600031904122785e-01,
)
"""Coefficients in powers of t^2 of the numerator of (arctan(t)/t - 1)/t^2, a rational function for t up to 0.66."""
ARCTANGENT_DENOMINATOR = (
    1.945506571482613964425e02,
    4.853903996359136964868e02,
    4.328810604912902668951e02,
    1.650270098316988542046e02,
    2.485846490142306297962e01,
    1.0,
)
"""Coefficients in powers of t^2 of the denominator."""


def polynomial(z: Number, coefficients: Sequence[float]) -> Number:
    """Return sum_k coefficients[k] z^k by Horner's rule."""
    total: Number = coefficients[-1]
    for c in coefficients[-2::-1]:
        total = c + z * total
    return total


def sine_cosine(angle: Number, precision: str, ns: Namespace) -> tuple[Number, Number]:
    """Return the sine and the cosine of an angle [rad].

    Args:
        angle: [rad]; the error grows with its magnitude, and beyond 1e6 rad the result is only bounded.
        precision: "float64" or "float32", the precision of the computation.
        ns: the namespace of the numbers.
    """
    first, second, third = HALF_PI[precision]
    k = ns.floor(angle * (2 / math.pi) + 0.5)
    r = ns.clip(angle - k * first - k * second - k * third, -1.0, 1.0)
    z = r * r
    half = 0.5 * z
    s = r + r * z * polynomial(z, SINE)
    one = 1.0 - half
    c = one + ((1.0 - one - half) + z * z * polynomial(z, COSINE))
    pairs = ns.floor(0.5 * k)
    odd, opposite = k > 2.0 * pairs, pairs > 2.0 * ns.floor(0.5 * pairs)
    s, c = ns.where(odd, c, s), ns.where(odd, -s, c)
    return ns.where(opposite, -s, s), ns.where(opposite, -c, c)


def exponential(x: Number, precision: str, ns: Namespace) -> Number:
    """Return exp(x); zero or infinity outside of the range of normal numbers. See `sine_cosine` for the arguments."""
    least = LEAST_POWER[precision]
    low, high = (least - 0.5) * math.log(2), (0.5 - least) * math.log(2)
    first, second = LN_2[precision]
    bounded = ns.clip(x, low, high)
    k = ns.floor(bounded * (1 / math.log(2)) + 0.5)
    above, below = bounded - k * first, k * second
    r = above - below
    z = r * r
    c = r - z * polynomial(z, EXPONENTIAL)
    y = 1.0 - ((below - (r * c) / (2.0 - c)) - above)
    return ns.where(x < low, 0.0, ns.where(x > high, math.inf, y * _power_of_two(k, least, ns)))


def _power_of_two(k: Number, least: int, ns: Namespace) -> Number:
    """Return 2^k for an integer k from `least` to 1 - `least`.

    It is a product of one factor for each bit of k - `least`. With a selection gcc would not vectorise.
    """
    rest, power, bits = k - float(least), 2.0**least, (1 - least).bit_length()
    for j in range(bits + 1):
        half = ns.floor(0.5 * rest)
        bit, rest = rest - 2.0 * half, half
        for _ in range(1 + (j == bits)):  # the highest factor would overflow: multiply twice by its root
            power = power * (1.0 + bit * (2.0**2 ** min(j, bits - 1) - 1.0))
    return power


def hyperbolic_tangent(x: Number, precision: str, ns: Namespace) -> Number:
    """Return tanh(x); its error is a rounding error of 1. See `sine_cosine` for the arguments."""
    e = exponential(-2.0 * abs(x), precision, ns)
    size = (1.0 - e) / (1.0 + e)
    return ns.where(x < 0.0, -size, size)


def arctangent(y: Number, x: Number, ns: Namespace) -> Number:
    """Return the angle [rad] of the vector (x, y) in (-pi, pi]; 0 for the zero vector. Signs of zeros are ignored."""
    a, b = abs(y), abs(x)
    steep = a > b
    small, large = ns.where(steep, b, a), ns.where(steep, a, b)
    diagonal = small > 0.66 * large
    above, below = ns.where(diagonal, small - large, small), ns.where(diagonal, small + large, large)
    t = above / ns.where(below > 0.0, below, ns.where(below <= 0.0, 1.0, below))  # nan stays nan
    z = t * t
    angle = t + t * (z * polynomial(z, ARCTANGENT) / polynomial(z, ARCTANGENT_DENOMINATOR))
    angle = ns.where(diagonal, angle + 0.25 * math.pi, angle)
    angle = ns.where(steep, 0.5 * math.pi - angle, angle)
    angle = ns.where(x < 0.0, math.pi - angle, angle)
    return ns.where(y < 0.0, -angle, angle)


def lowered(graph: Graph, outputs: Sequence[Symbol], precision: str) -> list[Symbol]:
    """Return the outputs, in the same graph, with the functions of this module expanded to arithmetic."""
    new: dict[int, Symbol] = {}
    for i in graph.needed(s.index for s in outputs):
        old = Symbol(graph, i)
        arguments = [new[a.index] for a in old.arguments]
        if old.node[0] in ("sin", "cos"):
            new[i] = sine_cosine(arguments[0], precision, SYMBOLS)[old.node[0] == "cos"]
        elif old.node[0] == "exp":
            new[i] = exponential(arguments[0], precision, SYMBOLS)
        elif old.node[0] == "arctan2":
            new[i] = arctangent(arguments[0], arguments[1], SYMBOLS)
        else:
            new[i] = graph.apply(old.node[0], *arguments) if arguments else old
    return [new[s.index] for s in outputs]

"""What `evaluate.py --stability` finds, in sentences."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence

from baselines.control.linearisation import LONGEST_PERIOD
from baselines.evaluation.stability.certificate import Certificate
from baselines.evaluation.stability.tables import DISTANCE, Stability


def verdicts(s: Stability) -> list[str]:
    """Return what was found of a policy in sentences, straight lines first."""
    return [_lines(s), *_turns(s), *_decay(s), *_swings(s), *_periods(s), _starts(s), *_certified(s)]


def stable(rate: float) -> bool:
    """Return whether small errors that grow at a rate [1/s] fade."""
    return rate < 0


def held(s: Stability) -> list[list[bool]]:
    """Return whether the policy stays with each motion, a row for each speed: errors fade, or it swings about it."""
    rows = zip(s.abscissa, s.swing, strict=True)
    return [[stable(rate) or swing > 0 for rate, swing in zip(*row, strict=True)] for row in rows]


def _word(s: Stability) -> str:
    """Return what a motion is called that the policy stays with."""
    return "held" if any(swing > 0 for row in s.swing for swing in row) else "stable"


def _lines(s: Stability) -> str:
    """Return the verdict on straight lines."""
    first, last, word = s.speeds[0], s.speeds[-1], _word(s)
    found = [row[0] for row in held(s)]
    span = f"from {first:g} to {last:g} m/s" if len(s.speeds) > 1 else f"{first:g} m/s"
    if all(found):
        return f"Straight lines are {word} at every speed looked at, {span}."
    if not any(found):
        return f"Straight lines are {word} at no speed looked at, {span}."
    if len(s.limiting_speeds) == 1:
        (limit,) = s.limiting_speeds
        below, above = (word, "unstable") if found[0] else ("unstable", word)
        return f"Straight lines are {below} below {limit:.3g} m/s and {above} above; looked at {span}."
    bounds = (first, *s.limiting_speeds, last)
    pieces = [f"from {a:.3g} to {b:.3g} m/s" for a, b in itertools.pairwise(bounds)]
    return f"Straight lines are {word} {' and '.join(pieces[0 if found[0] else 1 :: 2])}, and unstable in between."


def _turns(s: Stability) -> Iterator[str]:
    """Yield the verdict on turns."""
    word, rows = _word(s), zip(s.speeds, s.abscissa, s.swing, held(s), strict=True)
    cells = [
        (U, w, stays)
        for U, rates, swings, row in rows
        for w, rate, swing, stays in list(zip(s.turn_rates, rates, swings, row, strict=True))[1:]
        if swing > 0 or not math.isnan(rate)  # else the limits forbid it
    ]
    if not cells:
        return
    good = [(U, w) for U, w, stays in cells if stays]
    span = f"of {s.turn_rates[1]:g} to {s.turn_rates[-1]:g} rad/s"
    if len(good) in (0, len(cells)):
        yield f"Turns {span} are {word} at {'every' if good else 'no'} speed looked at."
        return
    by_rate = {w: [U for U, rate in good if rate == w] for w in s.turn_rates[1:]}
    fastest = {w: max(speeds) for w, speeds in by_rate.items() if speeds}
    if len(set(fastest.values())) == 1 and len(fastest) == len(by_rate):
        where = f"none faster than {max(fastest.values()):g} m/s"
    else:
        where = "the fastest at " + ", ".join(f"{U:g} m/s with {w:g} rad/s" for w, U in fastest.items())
    yield f"Turns {span} are {word} in {len(good)} of {len(cells)} motions looked at, {where}."


def _decay(s: Stability) -> Iterator[str]:
    """Yield how long the slowest stable straight line takes to forget."""
    rates = [(row[0], U) for U, row in zip(s.speeds, s.abscissa, strict=True) if stable(row[0])]
    if rates:
        (slow, at), (fast, where) = max(rates), min(rates)
        more = f", and in {math.log(2) / -fast:.2g} s at {where:g} m/s" if fast < 0.8 * slow else ""
        slowest = f"{math.log(2) / -slow:.2g} s at {at:g} m/s, the slowest"
        yield f"On a straight line a small error halves in {slowest}{more}."


def _swings(s: Stability) -> Iterator[str]:
    """Yield where the policy comes to no rest."""
    swings = [swing for row in s.swing for swing in row if swing > 0]
    if swings:
        share = f"{len(swings)} of {len(s.speeds) * len(s.turn_rates)} motions"
        span = f"{1e3 * min(swings):.2g} to {1e3 * max(swings):.2g} mm"
        yield f"In {share} it stays near but comes to no rest: it swings by {span}."
    left = sum(math.isinf(rate) for row in s.abscissa for rate in row)
    if left:
        yield f"In {left} motions it leaves the reference."


def _periods(s: Stability) -> Iterator[str]:
    """Yield how slow the policy's computer may be."""
    if s.largest_period is None:
        return
    cells = [(T, U, w) for U, row in zip(s.speeds, s.largest_period, strict=True)
             for T, w in zip(row, s.turn_rates, strict=True) if T > 0]  # fmt: skip
    if cells:
        T, U, w = min(cells)
        where = f"at {U:g} m/s" + (f" in a turn of {w:g} rad/s" if w else " on a straight line")
        shortest = f"more than {LONGEST_PERIOD:g} s" if math.isinf(T) else f"{T:.2f} s, {where}"
        yield f"Where it is stable, it stays so with commands held for up to {shortest}."


def _starts(s: Stability) -> str:
    """Return from where it converges."""
    shares = " and ".join(
        f"{_all_or(share)} {label if label.startswith('without') else f'with {label}'}"
        for label, share in s.success.items()
    )
    return f"Of {s.starts} random starts up to {DISTANCE:g} m off, with any heading, {shares} reach the paper's circle."


def _all_or(share: float) -> str:
    return "all" if share == 1 else "none" if share == 0 else f"{100 * share:.0f} %"


def _certified(s: Stability) -> Iterator[str]:
    """Yield what one Lyapunov function certifies."""
    if s.certificates is None:
        return
    found = [c for c in s.certificates if c.rate is not None]
    if not found:
        yield "No quadratic Lyapunov function was found for references that vary."
        return
    best = _widest(found)
    speeds = ", ".join(f"{c.speed:g}" for c in found if c.box == best.box)
    yield (
        f"For references that vary, in {best.box}, one quadratic Lyapunov function certifies that small errors fade at "
        f"{best.rate:.3f} 1/s or faster, at {speeds} m/s."
    )


def _widest(found: Sequence[Certificate]) -> Certificate:
    """Return the slowest certificate of the box with the largest turn rate and acceleration."""
    box = max((c.box for c in found), key=lambda b: (b.turn_rate, b.acceleration))
    return min((c for c in found if c.box == box), key=lambda c: c.rate or 0.0)

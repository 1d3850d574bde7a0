"""The tables of docs/paper.md: the numbers of the paper, the responses from its starts, its errors."""

from __future__ import annotations

from functools import cache

from research.pages import table
from research.paper.numbers import Reproduction, reproduce_paper

_VERDICTS = {True: "yes", False: "no", None: "-"}
_reproduction = cache(reproduce_paper)


def numbers_section(found: Reproduction | None = None) -> str:
    """Return the printed and the recomputed numbers as a table in Markdown."""
    rows = [
        (_escaped(r.quantity), r.place, _shown(r.paper), _shown(r.measured), r.unit, _VERDICTS[r.agrees], r.note)
        for r in (found or _reproduction()).rows
    ]
    return table(("quantity", "place", "printed", "recomputed", "unit", "agrees", "note"), rows, right=False)


def starts_section(found: Reproduction | None = None) -> str:
    """Return the responses from the eight starts of section V as a table in Markdown."""
    heads = (
        "signs of x_e, y_e, psi_e", "within 5 cm [s]", "within 1 deg [s]", "peak F_u [N]", "peak F_r [N m]",
        "error at 100 s [m]",
    )  # fmt: skip
    rows = [
        (f"`{s.signs}`", *(f"{x:.3g}" for x in
         (s.settling_5cm_s, s.settling_1deg_s, s.peak_F_u_N, s.peak_F_r_Nm, s.error_100s_m)))
        for s in (found or _reproduction()).starts
    ]  # fmt: skip
    return table(heads, rows, right=False)


def remarks_section(found: Reproduction | None = None) -> str:
    """Return the printed equations that do not hold as a table in Markdown."""
    rows = [
        (r.place, _escaped(r.quantity), _shown(r.paper), _shown(r.measured), r.unit, r.note)
        for r in (found or _reproduction()).remarks
    ]
    return table(("place", "what", "printed", "what holds", "unit", "why"), rows, right=False)


def _escaped(text: str) -> str:
    return text.replace("|", "\\|")


def _shown(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"

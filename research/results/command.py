"""Write the pages of results and findings from the recorded rows: `python -m research results --help`."""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from auv_gym.installation import checkout, left_out
from baselines.evaluation.score import BOUND, ORACLE
from baselines.tools.command_line import DONE, FAILED, UsageError, called, parse
from baselines.tools.figure_style import to_png
from baselines.tools.files import write_atomically
from research.results import front_files, fronts, robust, vehicles, vehicles_figure
from research.results.collection import ROUNDING, SUITES, TOLERANCE, Results, better_than, collected
from research.results.figures import results_figures
from research.results.findings import findings, fresh_results
from research.results.page import page
from research.results.residual import FIGURE, what_it_is_for
from research.results.residual_figure import residual_figure
from research.results.residual_file import FILE, load
from research.results.studies import curves_figure, figures_of, section
from research.results.study_files import Study, load_all

PROGRAM = "python -m research results"
DOCS = (checkout() or Path()) / "docs"  # where the pages lie
PAGE = "results.md"  # every policy on every suite
FINDINGS = "findings.md"  # what they come to


@dataclass(frozen=True)
class Options:
    """Write docs/results.md, its figures and docs/findings.md from the recorded rows and studies.

    Exit status: 0 done, 1 the oracle is worse than another policy, rows do not count, or nothing could be written, 2
    wrong usage.
    """

    out: Path = DOCS
    """Folder for the pages and, in images/, their figures."""


def main(arguments: Sequence[str]) -> int:
    """Write the pages and their figures and return the exit status.

    Raises:
        UsageError: the arguments do not make sense.
    """
    options, program = parse(Options, arguments, PROGRAM), called(PROGRAM)
    if checkout() is None:
        raise UsageError(left_out("the rows and studies that the pages are written from are"))
    try:
        found, missing, fleet, failed = _checked(program)
        (options.out / "images").mkdir(parents=True, exist_ok=True)
        _write(found, missing, fleet, options.out)
    except OSError as error:
        print(f"{program}: cannot write to {options.out}: {error.strerror}", file=sys.stderr)
        return FAILED
    except ValueError as error:
        print(f"{program}: {error}", file=sys.stderr)
        return FAILED
    print(f"Wrote {options.out / PAGE} with its figures, and {options.out / FINDINGS}")
    return FAILED if failed else DONE


def _checked(program: str) -> tuple[list[Results], list[str], Results | None, bool]:
    """Return what is recorded of suites, names of those without rows, the suite of vehicles, and if a row is wrong."""
    every: dict[str, Results | None] = {}
    wrong = []
    for name in (*SUITES, vehicles.SUITE):
        results, refused = collected(name)
        every[name] = results
        wrong += [f"{policy} in {name}: {reason}; left out" for policy, reason in refused.items()]
        wrong += [
            f"{policy} is better than {best} in {case} by {gain:.3g} m"
            for best, tolerance in ((ORACLE, TOLERANCE.get(name, math.inf)), (BOUND, ROUNDING))
            for case, policy, gain in (better_than(best, results) if results else ())
            if gain > tolerance
        ]
    for line in wrong:
        print(f"{program}: {line}", file=sys.stderr)
    fleet = every.pop(vehicles.SUITE)
    found = [results for results in every.values() if results is not None]
    return found, [name for name, results in every.items() if results is None], fleet, bool(wrong)


def _write(found: Sequence[Results], missing: Sequence[str], fleet: Results | None, out: Path) -> None:
    """Write the pages and their figures."""
    studies, groups = load_all(), load(FILE)
    write_atomically(out / PAGE, page(found, missing, sections(found, studies, fleet), what_it_is_for(groups)))
    write_atomically(out / "images" / FIGURE, to_png(residual_figure(groups)))
    write_atomically(out / FINDINGS, findings(found, fresh_results(), studies))
    for name, own in figures_of(studies).items():
        write_atomically(out / "images" / name, to_png(curves_figure(own)))
    if kept := front_files.load_all():
        for results in filter(_has_fronts, found):
            write_atomically(out / "images" / fronts.FIGURE, to_png(fronts.figure(kept, results, studies)))
    for results in found:
        for figure, png in results_figures(results).items():
            write_atomically(out / "images" / f"results-{results.suite.name}-{figure}.png", png)
    if vehicles.shown(fleet):
        write_atomically(out / "images" / vehicles.FIGURE, vehicles_figure.figure(fleet))


def sections(found: Sequence[Results], studies: Mapping[str, Study], fleet: Results | None) -> str:
    """Return the sections of the page behind the suites: other vehicles, how robust leads are, fronts, agents.

    `fleet` is what is recorded of the suite of vehicles, None without its anchors.
    """
    parts, kept = [vehicles.section(fleet, studies)], front_files.load_all()
    for results in filter(_has_fronts, found):
        parts += [robust.section(results, studies), fronts.section(kept, results, studies)]
    return "\n\n".join(filter(None, [*parts, section(studies, found)]))


def _has_fronts(results: Results) -> bool:
    """Return whether fronts run the episodes of a suite."""
    return results.suite.source[0] == front_files.SUITE

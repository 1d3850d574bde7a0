"""Write the pages of results and findings from the recorded rows: `auv-gym results --help`."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from auv_gym.installation import checkout, left_out
from baselines.evaluation import front_files
from baselines.evaluation.residual_file import FILE, load
from baselines.evaluation.results import fronts, robust
from baselines.evaluation.results.collection import ROUNDING, SUITES, TOLERANCE, Results, better_than, collected
from baselines.evaluation.results.figures import results_figures
from baselines.evaluation.results.findings import findings, fresh_results
from baselines.evaluation.results.page import page
from baselines.evaluation.results.residual import FIGURE, what_it_is_for
from baselines.evaluation.results.residual_figure import residual_figure
from baselines.evaluation.results.studies import curves_figure, figures_of, section
from baselines.evaluation.score import BOUND, ORACLE
from baselines.evaluation.study_files import Study, load_all
from baselines.tools.command_line import DONE, FAILED, UsageError, called, parse
from baselines.tools.figure_style import to_png
from baselines.tools.files import write_atomically

PROGRAM = "python -m baselines.evaluation.results"
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
    options, failed, program = parse(Options, arguments, PROGRAM), False, called(PROGRAM)
    if checkout() is None:
        raise UsageError(left_out("the rows and studies that the pages are written from are"))
    found, missing = [], []
    for name in SUITES:
        results, refused = collected(name)
        for policy, reason in refused.items():
            print(f"{program}: {policy} in {name}: {reason}; left out", file=sys.stderr)
        failed |= bool(refused)
        if results is None:
            missing.append(name)
            continue
        found.append(results)
        for best, tolerance in ((ORACLE, TOLERANCE[name]), (BOUND, ROUNDING)):
            for case, policy, gain in better_than(best, results):
                if gain > tolerance:
                    print(f"{program}: {policy} is better than {best} in {case} by {gain:.3g} m", file=sys.stderr)
                    failed = True
    try:
        (options.out / "images").mkdir(parents=True, exist_ok=True)
        studies = load_all()
        groups = load(FILE)
        write_atomically(options.out / PAGE, page(found, missing, sections(found, studies), what_it_is_for(groups)))
        write_atomically(options.out / "images" / FIGURE, to_png(residual_figure(groups)))
        write_atomically(options.out / FINDINGS, findings(found, fresh_results(), studies))
        for name, own in figures_of(studies).items():
            write_atomically(options.out / "images" / name, to_png(curves_figure(own)))
        if kept := front_files.load_all():
            for results in filter(_has_fronts, found):
                write_atomically(options.out / "images" / fronts.FIGURE, to_png(fronts.figure(kept, results, studies)))
        for results in found:
            for figure, png in results_figures(results).items():
                write_atomically(options.out / "images" / f"results-{results.suite.name}-{figure}.png", png)
    except OSError as error:
        print(f"{program}: cannot write to {options.out}: {error.strerror}", file=sys.stderr)
        return FAILED
    except ValueError as error:
        print(f"{program}: {error}", file=sys.stderr)
        return FAILED
    print(f"Wrote {options.out / PAGE} with its figures, and {options.out / FINDINGS}")
    return FAILED if failed else DONE


def sections(found: Sequence[Results], studies: Mapping[str, Study]) -> str:
    """Return the sections of the page behind the suites: how robust leads are, fronts, learned agents."""
    parts, kept = [], front_files.load_all()
    for results in filter(_has_fronts, found):
        parts += [robust.section(results, studies), fronts.section(kept, results, studies)]
    return "\n\n".join(filter(None, [*parts, section(studies, found)]))


def _has_fronts(results: Results) -> bool:
    """Return whether fronts run the episodes of a suite."""
    return results.suite.source[0] == front_files.SUITE

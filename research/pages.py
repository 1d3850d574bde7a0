"""Write the pages of the documentation that show measurements: `python -m research pages --help`.

A page is a template, research/templates/NAME.md.jinja, filled with the values that the `context` of its module
returns. Rendering is deterministic: a page that differs from its template and data is stale.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from textwrap import TextWrapper
from typing import Annotated, Any

import jinja2
from tyro.conf import Positional, arg

from baselines.evaluation.score import Score, fixed, fixed_ends
from baselines.evaluation.suites import SuiteError
from baselines.tools.command_line import DONE, FAILED, UsageError, check_words, parse
from baselines.tools.files import write_atomically
from research import DOCS
from research.suites.sealed import seals

PROGRAM = "python -m research pages"
TEMPLATES = Path(__file__).parent / "templates"
WIDTH = 120
"""Most characters in a line of prose."""
SUITE_PAGES = ("benchmark-v3", "hard-v1", "space-v1", *(name for name, seal in seals().items() if seal.secret))
"""Suites with a page of the same kind; a sealed one gets it when it is opened."""
PAGES = {
    "results": "research.results.overview",
    **{f"results/{suite}": "research.results.suite_page" for suite in SUITE_PAGES},
    "results/vehicles-v3": "research.results.vehicles",
    "safety": "research.robustness.failure_rate",
    "transfer": "research.transfer.comparison",
    "validation": "research.validation.predictions",
    "sensitivity": "research.robustness.model_error",
}
"""Module of each page: `context(page)` returns the values of its template; the optional `figures(page)` returns its
figures as PNG, by name."""
PARTS = {
    "vehicles": {"published vehicles": "research.vehicles.gains:published_vehicles"},
    "speed": {"speed": "research.speed:speed_section"},
    "vehicle-gains": {
        "exponents": "research.vehicles.gains:exponents_section",
        "gains": "research.vehicles.gains:gains_section",
    },
    "fine-tuning": {"fine-tuning": "research.trainings.fine_tuning:fine_tuning_section"},
    "setpoints": {"setpoints": "research.trainings.fine_tuning:setpoints_section"},
    "identify": {"coverage": "research.vehicles.coverage:coverage_section"},
    "paper": {
        "numbers": "research.paper.command:numbers_section",
        "starts": "research.paper.command:starts_section",
        "remarks": "research.paper.command:remarks_section",
    },
    "theory": {"held commands": "research.paper.command:held_section"},
    "policies": {"tuned gains": "research.vehicles.gains:tuned_gains"},
    "export-cost": {
        "agreement": "research.deployment.measure:agreement_section",
        "speed on a computer": "research.deployment.measure:latency_section",
        "cost on a Cortex-M4": "research.deployment.measure:cortex_m4_section",
    },
}
"""Pages that are written by hand except for some parts: the `module:function` that returns a part, by page and name."""


@dataclass(frozen=True)
class Options:
    """Write the pages of measurements from their templates and data.

    Exit status: 0 done, 1 a page cannot be made, or with --check is stale, 2 wrong usage.
    """

    page: Annotated[Positional[tuple[str, ...]], arg(metavar="[PAGE ...]")] = ()
    """Names of pages, such as results. Default: all."""
    check: bool = False
    """Write nothing; print which pages are stale."""
    out: Path = DOCS
    """Folder of the pages."""


def table(heads: Sequence[str], rows: Iterable[Sequence[Any]], right: bool = True) -> str:
    """Return a Markdown table; with `right`, all columns except the first are aligned right."""
    lines = [heads, ["---", *("--:" if right else "---" for _ in heads[1:])], *rows]
    return "\n".join(f"| {' | '.join(map(str, cells))} |" for cells in lines)


def with_interval(value: Score) -> str:
    """Return a ratio with its 95 % interval as text."""
    return f"{fixed(value.mean, 2)} ({fixed_ends(value.ci95, 2)})"


def render(page: str) -> str:
    """Return the text of a page, from its template and the measurements."""
    if page in PARTS:
        return _with_parts(page)
    context = import_module(PAGES[page]).context(page)
    template = _environment().get_template(f"{context.get('template', page)}.md.jinja")
    return _wrapped(template.render(context))


def _wrapped(text: str) -> str:
    """Return a page with its prose wrapped to at most `WIDTH` characters in a line."""
    lines, code = [], False
    for line in text.split("\n"):
        code ^= line.startswith("```")
        if len(line) <= WIDTH or code or line.startswith(("|", "#", "<!--", "!")):
            lines.append(line)
        else:
            indent = "  " if line.startswith(("- ", "  ")) else ""
            wrap = TextWrapper(WIDTH, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)
            lines += wrap.wrap(line)
    return "\n".join(lines)


def _with_parts(page: str) -> str:
    """Return a page with its parts made again; each part is between two comments with its name."""
    text = (DOCS / f"{page}.md").read_text(encoding="utf-8")
    for name, maker in PARTS[page].items():
        module, _, function = maker.partition(":")
        part: str = getattr(import_module(module), function)()
        begin, end = f"<!-- {name}: made by `{PROGRAM} {page}` -->", f"<!-- end of {name} -->"
        before, rest = text.split(begin)  # raises ValueError unless the page has the comment once
        _, after = rest.split(end)
        text = f"{before}{begin}\n\n{_wrapped(part.strip())}\n\n{end}{after}"
    return text


@cache
def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATES), undefined=jinja2.StrictUndefined, keep_trailing_newline=True,
        trim_blocks=True, lstrip_blocks=True, autoescape=False,
    )  # fmt: skip
    environment.globals["table"] = table
    return environment


def main(arguments: Sequence[str]) -> int:
    """Write or check the pages and return the exit status."""
    options = parse(Options, arguments, PROGRAM)
    check_words("page", options.page, (*PAGES, *PARTS))
    stale, missing = [], False
    for page in options.page or (*PAGES, *PARTS):
        try:
            text, file = render(page), options.out / f"{page}.md"
        except (SuiteError, UsageError) as error:
            print(f"page {page} cannot be made: {error}", file=sys.stderr)
            missing = True
            continue
        if not file.exists() or file.read_text(encoding="utf-8") != text:
            stale.append(page)
            if not options.check:
                write_atomically(file, text)
        if not options.check and page in PAGES and hasattr(module := import_module(PAGES[page]), "figures"):
            for name, png in module.figures(page).items():
                write_atomically(options.out / "images" / name, png)
    if stale or not missing:
        done = "stale" if options.check else "wrote"
        print(f"{done}: {', '.join(stale)}" if stale else "all pages are up to date")
    return FAILED if missing or (stale and options.check) else DONE

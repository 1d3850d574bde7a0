"""The report as one page that opens from disk: tables, figures, definitions, versions and the command."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from itertools import groupby
from string import Template

from baselines.evaluation.report.columns import definitions, ranked, used
from baselines.evaluation.report.numbers import Entry, Result, recordings
from baselines.evaluation.report.page import figure, page, table
from baselines.evaluation.request import Request
from baselines.tools.files import versions

_CAPTIONS = {
    "score_by_case": "Scores in each scenario, 95 % intervals of a paired bootstrap over episodes.",
    "tail_error": "Mean tail error with its 95 % interval.",
    "error_distribution": "Distribution of the tail error over episodes.",
    "error_over_time": "Position error over time: median and 10-90 % band of the episodes.",
    "trajectories": "The first episode of each scenario.",
}
_BODY = Template("""<p><code>$command</code></p>
<p class="note">$setting</p>
$scores
$figures
<h2>Every scenario</h2>
$results
$recorded
$notes
<h2>Definitions</h2>
<dl>$definitions</dl>
<h2>Versions</h2>
<p>$versions</p>""")


def report_html(
    request: Request, results: Sequence[Result], pooled: Sequence[Entry], figures: Mapping[str, bytes]
) -> str:
    """Return the text of report.html."""
    episodes = sum(len(cell.episodes) for cell in request.cells)
    setting = f"{len(request.cells)} scenarios, {episodes} episodes of each policy, hash {request.hash}"
    when = recordings(results)
    body = _BODY.substitute(
        command=escape(request.command),
        setting=escape(setting),
        scores=f"<h2>Score</h2>\n{_table(pooled)}" if any(entry.score for entry in pooled) else "",
        figures="\n".join(figure(_CAPTIONS.get(name, name.replace("_", " ")), png) for name, png in figures.items()),
        results=_table([result.entry for result in results]),
        recorded=f'<p class="note">* recorded, not run now: {escape(when)}</p>' if when else "",
        notes=_notes(request, results),
        definitions="".join(f"<dt>{escape(k)}</dt><dd>{escape(v)}</dd>" for k, v in definitions().items()),
        versions=escape(", ".join(f"{name} {version}" for name, version in versions().items())),
    )
    return page(f"Evaluation: {request.suite or 'scenarios'}", body)


def _table(entries: Sequence[Entry]) -> str:
    columns, rows = used(entries), []
    for place, own in groupby(entries, key=lambda entry: entry.place):
        for i, entry in enumerate(ranked(list(own))):
            cells = [column.text(entry) for column in columns]
            if entry.summary is None:
                cells[0] = "failed"
            rows.append((i == 0, (place, entry.policy + ("*" if entry.recorded else ""), *cells)))
    headings = ("scenario", "policy", *(column.heading for column in columns))
    return f'<div class="wide">{table(headings, rows, 2)}</div>'


def _notes(request: Request, results: Sequence[Result]) -> str:
    failed = [f"{r.run.policy} in {r.run.scenario.name}: {r.run.error}" for r in results if r.run.error]
    warned = dict.fromkeys(f"{r.run.policy}: {text}" for r in results for text in r.run.warnings)
    items = [f'<li class="failed">{escape(text)}</li>' for text in failed]
    items += [f"<li>{escape(text)}</li>" for text in (*request.notes, *warned)]
    return f"<h2>Notes</h2>\n<ul>{''.join(items)}</ul>" if items else ""

"""The report as one page that opens from disk: tables, figures, definitions, versions and the command."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from string import Template

from baselines.evaluation.metrics import WORST
from baselines.evaluation.report.numbers import Result, recordings, to_record
from baselines.evaluation.report.page import figure, number, page, table
from baselines.evaluation.request import Request
from baselines.evaluation.score import LARGEST_TAIL, Pooled, interval_text, score_text
from baselines.tools.files import versions

CAPTIONS = {
    "score_by_case": "Scores in each scenario, 95 % intervals of a paired bootstrap over episodes.",
    "tail_error": "Mean tail error with its 95 % interval.",
    "error_distribution": "Distribution of the tail error over episodes.",
    "error_over_time": "Position error over time: median and 10-90 % band of the episodes.",
    "trajectories": "The first episode of each scenario.",
}
DEFINITIONS = {
    "tail [m]": "root mean square of the distance to the reference after the first third of an episode; one that was "
    "lost keeps the error at which it ended. Mean over episodes.",
    "score": "(E_expert - E_policy) / (E_expert - E_oracle), E the mean tail error over the same episodes: 0 is the "
    "paper's law, 1 an oracle that knows plant, current, waves and lag. Errors are pooled over cases before dividing.",
    "capped": "the score with no tail error counted above "
    + " or ".join(f"{cap:g} m ({regime})" for regime, cap in LARGEST_TAIL.items())
    + ".",
    "lost": "share of episodes that ended beyond the lost distance or whose tail error reaches that cap.",
    "worst 5 %": f"mean of the worst {100 * WORST:g} % of the tail errors (conditional value at risk).",
    "settled [s]": "time of the last position error above the scenario's error scale; mean over episodes.",
    "effort, rate": "mean square of the normalised command and of its change, relative to the expert's.",
    "saturated": "share of the steps with an actuator commanded to its limit.",
    "ms": "time of the policy for one decision of one vehicle, many vehicles side by side.",
}
BODY = Template("""<p><code>$command</code></p>
<p class="note">$setting</p>
$scores
$figures
<h2>Every scenario</h2>
<div class="wide">$results</div>
$recorded
$notes
<h2>Definitions</h2>
<dl>$definitions</dl>
<h2>Versions</h2>
<p>$versions</p>""")


def report_html(
    request: Request, results: Sequence[Result], scores: Sequence[Pooled], figures: Mapping[str, bytes]
) -> str:
    """Return the text of report.html."""
    episodes = sum(len(cell.episodes) for cell in request.cells)
    setting = f"{len(request.cells)} scenarios, {episodes} episodes of each policy, hash {request.hash}"
    when = recordings(results)
    body = BODY.substitute(
        command=escape(request.command),
        setting=escape(setting),
        scores=_scores(scores),
        figures="\n".join(figure(CAPTIONS.get(name, name.replace("_", " ")), png) for name, png in figures.items()),
        results=_results(results),
        recorded=f'<p class="note">* recorded, not run now: {escape(when)}</p>' if when else "",
        notes=_notes(results),
        definitions="".join(f"<dt>{escape(k)}</dt><dd>{escape(v)}</dd>" for k, v in DEFINITIONS.items()),
        versions=escape(", ".join(f"{name} {version}" for name, version in versions().items())),
    )
    return page(f"Evaluation: {request.suite or 'scenarios'}", body)


def _scores(scores: Sequence[Pooled]) -> str:
    if not any(entry.score for entry in scores):
        return ""
    names = ("regime", "policy", "episodes", "tail [m]", "score", "95 % interval", "capped", "lost")
    rows, previous = [], ""
    for s in scores:
        cells = (score_text(s.score), interval_text(s.score), score_text(s.capped), f"{100 * s.lost:.2f} %")
        rows.append((s.regime != previous, (s.regime, s.policy, str(s.episodes), number(s.tail_m), *cells)))
        previous = s.regime
    return f"<h2>Score</h2>\n<div class='wide'>{table(names, rows, 2)}</div>"


def _results(results: Sequence[Result]) -> str:
    names = ("scenario", "policy", "tail [m]", "95 % interval", "p95 [m]", "worst 5 %", "score", "settled [s]",
             "effort", "rate", "saturated", "lost", "ms")  # fmt: skip
    rows, previous = [], ""
    for result in results:
        r = to_record(result)
        first = r["scenario"] != previous
        previous = r["scenario"]
        name = result.run.policy + ("*" if result.run.recorded else "")
        tail = r["tail_rmse_m"]
        if tail is None:
            rows.append((first, (previous, name, "failed", *("-",) * 10)))
            continue
        low, high = (number(end) for end in tail["ci95"])
        cells = [number(tail["mean"]), f"{low} ... {high}", number(tail["p95"]), number(tail["cvar95"])]
        cells += [score_text(result.score), number(r["settling_s"])]
        cells += [number(r["effort_ratio"]), number(r["smoothness_ratio"]), f"{100 * r['saturation']:.1f} %"]
        rows.append((first, (previous, name, *cells, f"{100 * r['lost']:.1f} %", number(r["decision_ms"], 2))))
    return table(names, rows, 2)


def _notes(results: Sequence[Result]) -> str:
    failed = [f"{r.run.policy} in {r.run.scenario.name}: {r.run.error}" for r in results if r.run.error]
    warned = dict.fromkeys(f"{r.run.policy}: {text}" for r in results for text in r.run.warnings)
    items = [f'<li class="failed">{escape(text)}</li>' for text in failed]
    items += [f"<li>{escape(text)}</li>" for text in warned]
    return f"<h2>Notes</h2>\n<ul>{''.join(items)}</ul>" if items else ""

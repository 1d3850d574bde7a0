"""Writes a page for each preset to docs/scenarios/: disturbances, parameters with units, results by score.

The pages are written before Sphinx collects its sources, and are not kept in git.
"""

import re
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

from module_pages import replace_folder
from sphinx.application import Sphinx
from sphinx.pycode import ModuleAnalyzer

from auv_gym.scenarios.presets import PRESETS, SPACE_PRESETS
from auv_gym.scenarios.scenario import Scenario
from baselines.evaluation.recorded import recorded_runs
from baselines.evaluation.report.columns import COLUMNS, ranked
from baselines.evaluation.report.numbers import Entry, compare
from baselines.evaluation.score import speed_range_of
from baselines.evaluation.suites import load_suite
from research.pages import table

SHOWN = ("steady [m]", "p95 [m]", "score", "failures", "settled [s]", "effort")
"""The columns of the table of results."""
SUITES = "benchmark-v3", "space-v1"
"""The suites with results of presets."""
PAGE = """# {name}

{case}

```python
env = gym.make("auv_gym:UnderactuatedAUVTrack{kind}-{name}-v0")
```

```{{video}} {name}
```
{standings}
## Parameters

Fields of the [`Scenario`](../api/auv_gym.scenarios.md) and of its parts. Parts that are off are left out. Each episode
draws its value from an interval.

{parameters}
"""
STANDINGS = """
## Results

All policies on the episodes of this case in `{suite}`. [Evaluation](../metrics.md#what-is-measured) defines the
columns. A score means little where the expert is already accurate, as in still water.

{table}
"""


def page(scenario: Scenario, case: str, entries: dict[str, list[Entry]]) -> str:
    """Return the page of a preset, for its entries by suite."""
    standings = "".join(STANDINGS.format(suite=suite, table=standing(own)) for suite, own in entries.items() if own)
    kind = "3D" if scenario.vertical else ""
    return PAGE.format(name=scenario.name, kind=kind, case=case, standings=standings, parameters=parameters(scenario))


def standing(entries: list[Entry]) -> str:
    """Return the table of the policies in a case."""
    columns = [column for column in COLUMNS if column.heading in SHOWN]
    rows = [[f"`{entry.policy}`", *(column.text(entry) for column in columns)] for entry in ranked(entries)]
    return table(["policy", *(column.heading for column in columns)], rows)


def parameters(scenario: Scenario) -> str:
    """Return the table of a scenario's numbers."""
    rows = [[f"`{name}`", text(value), meaning] for name, value, meaning in numbers(scenario)]
    return "\n".join(f"| {' | '.join(row)} |" for row in (["field", "value", "unit, meaning"], ["---"] * 3, *rows))


def numbers(part: Any, prefix: str = "") -> list[tuple[str, Any, str]]:
    """Return name, value and comment of the fields of a dataclass and of its parts; of a part only changed fields."""
    comments = ModuleAnalyzer.for_module(type(part).__module__).find_attr_docs()
    found = []
    for field in fields(part):
        value, meaning = getattr(part, field.name), comments[type(part).__name__, field.name][0]
        if is_dataclass(value):
            found += numbers(value, f"{prefix}{field.name}.")
        elif value is not None and field.name != "name" and not (prefix and value == field.default):
            found.append((prefix + field.name, value, meaning or f"see `{type(part).__name__}`"))
    return found


def text(value: Any) -> str:
    """Return a value as text; a tuple of two numbers is an interval."""
    if isinstance(value, tuple):
        is_interval = len(value) == 2 and not any(isinstance(end, str) for end in value)
        return ("\N{NO-BREAK SPACE}...\N{NO-BREAK SPACE}" if is_interval else ", ").join(text(part) for part in value)
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def write(app: Sphinx) -> None:
    """Write all pages."""
    source = Path(app.srcdir)
    rows = re.findall(
        r"^\| `([\w-]+)` \| (.+) \|$", (source / "scenarios.md").read_text(encoding="utf-8"), re.MULTILINE
    )
    cases, texts = {name: line.replace("](", "](../") for name, line in rows}, {}
    results = {suite: compare(recorded_runs(load_suite(suite)).runs) for suite in SUITES}
    for name, scenario in (PRESETS | SPACE_PRESETS).items():
        own = {suite: [r.entry for r in found if r.entry.place == name] for suite, found in results.items()}
        case = cases.get(name) or cases[name.removeprefix(f"{speed_range_of(name)}-")]
        texts[f"{name}.md"] = page(scenario, case, own)
    replace_folder(source / "scenarios", texts)


def setup(app: Sphinx) -> dict[str, bool]:
    """Connect the event handler; it must run after that of the modules' pages, which reads the comments of fields."""
    app.connect("builder-inited", write, priority=600)
    return {"parallel_read_safe": True, "parallel_write_safe": True}

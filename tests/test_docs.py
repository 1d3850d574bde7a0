"""The documentation: its examples run, its names and links exist, and its tables equal the output of commands."""

import importlib
import re
import shutil
import sys
import types
from dataclasses import dataclass, fields
from pathlib import Path

import pytest

from auv_gym.effects import EFFECTS
from auv_gym.physics.vehicle import VEHICLES
from auv_gym.planning.paths import PATHS
from auv_gym.scenarios.presets import PRESETS, list_scenarios
from auv_gym.scenarios.vertical import Vertical
from baselines import POLICIES, list_policies
from baselines.agents.agent import Agent
from baselines.agents.names import agent_folder
from baselines.evaluation import command as evaluation
from baselines.evaluation.report import terminal
from baselines.evaluation.report.columns import COLUMNS

ROOT = Path(__file__).parents[1]
TUTORIALS = ROOT / "docs" / "tutorials"
MADE = {"api", "scenarios"}  # folders of pages that the build writes
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md"]
PAGES += [p for p in sorted((ROOT / "docs").rglob("*.md")) if p.parent.name not in MADE]
FENCE = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
BETWEEN = ["```", "```text"]  # between a block and a following block of text


@dataclass
class Block:
    """A fenced block of a page."""

    language: str
    text: str
    start: int  # position of its text in the page
    end: int  # position after its text


def blocks(page):
    text = page.read_text(encoding="utf-8")
    return [Block(m[1], m[2], m.start(2), m.end(2)) for m in FENCE.finditer(text)]


def name_of(page):
    return page.relative_to(ROOT).as_posix().removeprefix("docs/")


@pytest.fixture
def registries():
    """Remove the entries that an example registers."""
    tables = (EFFECTS, PATHS, PRESETS, VEHICLES, POLICIES)
    before = [dict(table) for table in tables]
    yield
    for table, entries in zip(tables, before, strict=True):
        table.clear()
        table.update(entries)


@pytest.mark.usefixtures("registries")
@pytest.mark.parametrize(
    "page",
    [
        pytest.param(p, marks=pytest.mark.slow if p.stem == "log-to-agent" else ())
        for p in PAGES
        if any(b.language == "python" for b in blocks(p))
    ],
    ids=name_of,
)
def test_python_runs_and_prints_the_shown_output(page, tmp_path, monkeypatch, capsys):
    """The blocks of a page run in order in one namespace; a `toml` or `csv` block is a file, named in its first line.

    A `text` block after a Python block is its output; functions called `test_...` are run as tests.
    """
    monkeypatch.chdir(tmp_path)
    shutil.copytree(TUTORIALS, TUTORIALS.relative_to(ROOT))  # with the log that one of them reads
    module = types.ModuleType("page")
    monkeypatch.setitem(sys.modules, "page", module)  # where dataclasses look for their module
    page_text, found, outputs = page.read_text(encoding="utf-8"), blocks(page), []
    for block, following in zip(found, [*found[1:], None], strict=True):
        if block.language in ("toml", "csv"):
            (tmp_path / block.text.split("\n", 1)[0].removeprefix("# ")).write_text(block.text, encoding="utf-8")
        if block.language != "python":
            continue
        run(block, page, module)
        printed = capsys.readouterr().out
        if following and following.language == "text" and page_text[block.end : following.start].split() == BETWEEN:
            outputs.append((following, printed))
    for block, printed in outputs:
        assert printed == block.text


def run(block, page, module):
    """Execute a block as part of a module, at its lines of the page, and call the tests that it defines."""
    known = set(vars(module))
    lines = page.read_text(encoding="utf-8").count("\n", 0, block.start)
    exec(compile("\n" * lines + block.text, page.name, "exec"), vars(module))
    for name in sorted(set(vars(module)) - known):
        if name.startswith("test_"):
            getattr(module, name)()


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_links_exist(page):
    text = page.read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if not target.startswith(("http", "#", "api/")):  # the build writes and checks those of api/
            assert (page.parent / target.split("#")[0]).exists(), target


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_names_exist(page):
    text = page.read_text(encoding="utf-8")
    for name in re.findall(r"`((?:auv_gym|baselines)(?:\.\w+)+)[`(]", text):
        assert resolves(name), name
    for file in re.findall(r"`((?:auv_gym|baselines|tests|docs)/[\w/]+\.\w+)`", text):
        assert (ROOT / file).exists() or "NAME" in file, file
    for file, test in re.findall(r"`(test_\w+\.py)::(\w+)`", text):
        assert f"def {test}(" in next((ROOT / "tests").rglob(file)).read_text(encoding="utf-8"), (file, test)


def resolves(name):
    """Return whether a dotted name is a module, or an attribute of one or of a class in one."""
    parts = name.split(".")
    for cut in range(len(parts), 0, -1):
        try:
            thing = importlib.import_module(".".join(parts[:cut]))
        except ModuleNotFoundError:
            continue
        for part in parts[cut:]:
            if not hasattr(thing, part):
                return False
            thing = getattr(thing, part)
        return True
    return False


def test_pages_name_every_policy_and_scenario():
    policies, scenarios = (
        (ROOT / "docs" / name).read_text(encoding="utf-8") for name in ("policies.md", "scenarios.md")
    )
    for name in list_policies(None):
        assert f"`{name}`" in policies
    for name in list_scenarios():
        assert f"| `{name}` |" in scenarios or f"| `{name.split('-', 1)[1]}` |" in scenarios


def test_the_table_of_the_vertical_part_equals_its_class():
    page = (ROOT / "docs" / "environments" / "space.md").read_text(encoding="utf-8")
    rows = dict(re.findall(r"^\| `(\w+)` \| .+ \| (.+) \|$", page, re.MULTILINE))
    source = (ROOT / "auv_gym" / "scenarios" / "vertical.py").read_text(encoding="utf-8")
    assert rows == dict(re.findall(r"^    (\w+): .*?  # (.+)$", source, re.MULTILINE))
    assert [*rows] == [field.name for field in fields(Vertical)]


def compared(page, width, tmp_path, capsys, monkeypatch):
    """Run the first comparison of a page, and check its table for a terminal of the given width."""
    monkeypatch.setattr(terminal, "_WIDTH", width)
    command = re.search(
        r"^(?:python evaluate\.py|auv-gym evaluate) (--policy .+)$", page.read_text("utf-8"), re.MULTILINE
    )
    assert evaluation.main([*command[1].split(), "--jobs", "1", "--out", str(tmp_path)]) == 0
    lines = [line.rstrip() for line in capsys.readouterr().out.splitlines()]
    (block,) = (block for block in blocks(page) if "steady [m]" in block.text)
    assert block.text in "\n".join(lines)


def test_table_of_the_quickstart_equals_the_output_of_the_command(tmp_path, capsys, monkeypatch):
    compared(ROOT / "docs" / "quickstart.md", 80, tmp_path, capsys, monkeypatch)


@pytest.mark.slow
def test_numbers_of_the_readme_equal_the_output_of_the_command(tmp_path, capsys, monkeypatch):
    compared(ROOT / "README.md", 100, tmp_path, capsys, monkeypatch)


def test_the_readme_is_short():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 130
    assert len(re.findall(r"(?<!!)\[(?:!\[[^\]]*\]\([^)]*\)|[^\]!])*\]\(", text)) <= 14


def test_training_times_of_the_shipped_agents():
    """The page has minutes, the descriptions have seconds."""
    page = (ROOT / "docs" / "policies.md").read_text(encoding="utf-8")
    for name in ("helm", "helm-any"):
        [minutes] = re.findall(rf"research train-all {name}` trains it in (\d+)\s", page)
        assert int(minutes) == round(Agent.load(agent_folder(name)).training["seconds"] / 60)


def test_documented_columns_equal_their_definitions():
    page = ROOT / "docs" / "metrics.md"
    text = page.read_text(encoding="utf-8")
    written = re.search(r"^\| column \| in `results.json` \|.*?(?=\n\n)", text, re.MULTILINE | re.DOTALL)[0]
    rows = [f"| {c.heading or '-'} | `{c.key}` | {c.definition} |" for c in COLUMNS]
    defined = "\n".join(["| column | in `results.json` | definition |", "|---|---|---|", *rows])
    assert written == defined

"""The documentation: its Python runs and prints what it shows, its names and links exist, its table is measured."""

import importlib
import re
import types
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from auv_gym.paths import PATHS
from auv_gym.scenario import PRESETS
from auv_gym.vehicle import VEHICLES
from baselines import POLICIES, list_policies
from baselines.evaluation.metrics import summarise
from baselines.evaluation.runner import run_all

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
FENCE = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
README = (ROOT / "README.md").read_text(encoding="utf-8")


@dataclass
class Block:
    """A fenced block of a page."""

    language: str
    text: str
    line: int  # of its first line
    end: int  # position behind it in the page


def blocks(page):
    text = page.read_text(encoding="utf-8")
    return [Block(m[1], m[2], text.count("\n", 0, m.start()) + 2, m.end()) for m in FENCE.finditer(text)]


def name_of(page):
    return page.name


@pytest.fixture
def registries():
    """Undo what an example registers."""
    tables = (PATHS, PRESETS, VEHICLES, POLICIES)
    before = [dict(table) for table in tables]
    yield
    for table, entries in zip(tables, before, strict=True):
        table.clear()
        table.update(entries)


@pytest.mark.usefixtures("registries")
@pytest.mark.parametrize("page", [p for p in PAGES if any(b.language == "python" for b in blocks(p))], ids=name_of)
def test_python_runs_and_prints_what_is_shown(page, tmp_path, monkeypatch, capsys):
    """The blocks of a page run one after the other in one namespace; a `toml` block is the file its first line names.

    A `text` block right behind a Python block is what that prints; functions called `test_...` are run as tests.
    """
    monkeypatch.chdir(tmp_path)
    module = types.ModuleType("page")
    monkeypatch.setitem(__import__("sys").modules, "page", module)  # where dataclasses look for their module
    text = page.read_text(encoding="utf-8")
    found = blocks(page)
    for block, following in zip(found, [*found[1:], None], strict=True):
        if block.language == "toml":
            (tmp_path / block.text.split("\n", 1)[0].removeprefix("# ")).write_text(block.text, encoding="utf-8")
        if block.language != "python":
            continue
        known = set(vars(module))
        exec(compile("\n" * (block.line - 1) + block.text, page.name, "exec"), vars(module))
        for name in set(vars(module)) - known:
            if name.startswith("test_"):
                getattr(module, name)()
        printed = capsys.readouterr().out
        if following and following.language == "text" and text[block.end : following.end].lstrip().startswith("```"):
            assert printed == following.text


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_links_lead_somewhere(page):
    text = page.read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if not target.startswith(("http", "#")):
            assert (page.parent / target.split("#")[0]).exists(), target


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_names_exist(page):
    text = page.read_text(encoding="utf-8")
    for name in re.findall(r"`((?:auv_gym|baselines)(?:\.\w+)+)[`(]", text):
        assert resolves(name), name
    for file, test in re.findall(r"`(?:tests/)?(test_\w+\.py)(?:::(\w+))?`", text):
        if (ROOT / "tests" / file).exists() or file not in page.read_text(encoding="utf-8").split("## Add")[-1]:
            assert not test or f"def {test}(" in (ROOT / "tests" / file).read_text(encoding="utf-8"), (file, test)


def resolves(name):
    """Return whether a dotted name is a module, or an attribute of one or of a class in one."""
    parts = name.split(".")
    for cut in range(len(parts), 0, -1):
        try:
            thing = importlib.import_module(".".join(parts[:cut]))
        except ModuleNotFoundError:
            continue
        return all(hasattr(thing, part) and (thing := getattr(thing, part), True)[1] for part in parts[cut:])
    return False


def test_readme_names_every_policy_and_family_of_scenarios():
    for name in list_policies():
        assert f"`{name}`" in README
    for name in PRESETS:
        assert f"`{name}`" in README or f"`{name.split('-', 1)[1]}`" in README


def test_readme_table_is_what_the_command_prints():
    command = re.search(r"evaluate.py --policy (.+) --scenario (.+) --episodes (\d+)", README)
    rows = re.findall(r"^ +(?:\S+ +)?([a-z-]+) +([\d.e-]+) +[\d.e-]+ \.\.\. ", README, re.MULTILINE)
    scenarios = [PRESETS[name] for name in command[2].split()]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        runs = run_all(("backstepping", *command[1].split()), scenarios, int(command[3]), 0, 1, lambda _: None)
    assert [policy for policy, _ in rows] == [run.policy for run in runs]
    measured = [summarise(run.records, run.scenario.steps).tail_rmse_m.mean for run in runs]
    np.testing.assert_allclose([float(value) for _, value in rows], measured, rtol=0.02)

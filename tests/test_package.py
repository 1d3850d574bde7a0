"""The package: content and metadata of the wheel, its command, and messages about missing parts.

`make package` also builds the package in another environment, installs it and uses it.
"""

import ast
import os
import re
import shlex
import shutil
import subprocess
import sys
from email import message_from_bytes
from importlib import import_module, metadata

import package
import pytest

import auv_gym
from auv_gym import installation
from baselines import __main__ as product
from baselines.evaluation import recorded, suites
from baselines.evaluation.options import Options
from baselines.evaluation.request import Request
from baselines.tools.command_line import called, parse, run, typed
from research import __main__ as research

HERE = ("--no-isolation", "--skip-dependency-check")
"""Options of a build in the present environment."""


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Wheel and source distribution of a copy of the repository, and the wheel built from the source distribution."""
    folder = tmp_path_factory.mktemp("package")
    shutil.copytree(package.ROOT, folder / "source", ignore=shutil.ignore_patterns(*package.LEFT))
    for name in ("dist", "again"):
        (folder / name).mkdir()
    wheel, sdist = package.build(folder / "source", folder / "dist", *HERE)
    return wheel, sdist, package.wheel_of(sdist, folder / "again", *HERE)


@pytest.mark.slow
def test_the_package_is_small_and_equal_to_that_of_the_source_distribution(built, capsys):
    package.checked(*built)
    assert "MB of at most 3" in capsys.readouterr().out


@pytest.mark.slow
def test_the_wheel_holds_both_packages(built):
    names = {name for name in package.contents(built[0]) if ".dist-info/" not in name}
    there = {
        path.relative_to(package.ROOT).as_posix()
        for room in ("auv_gym", "baselines")
        for path in (package.ROOT / room).rglob("*")
        if path.is_file() and path.suffix != ".pyc"
    }
    assert {name for name in there if not (name.startswith("baselines/agents") and name.endswith(".png"))} == names


@pytest.mark.slow
def test_metadata(built):
    found = package.contents(built[0])
    [text] = (content for name, content in found.items() if name.endswith(".dist-info/METADATA"))
    [entry] = (content for name, content in found.items() if name.endswith(".dist-info/entry_points.txt"))
    about = message_from_bytes(text)
    assert about["Version"] == auv_gym.__version__
    assert about["Metadata-Version"] == "2.4"  # the action that publishes the package accepts no newer one
    assert entry.decode().split() == ["[console_scripts]", "auv-gym", "=", "baselines.__main__:main"]
    urls = dict(url.split(", ") for url in about.get_all("Project-URL"))
    assert {"Homepage", "Documentation", "Source", "Changelog", "Issues"} <= set(urls)
    readme = about.get_payload()
    links = re.findall(r"\]\(([^)\s]+)|(?:src|href)=\"([^\"]+)\"", readme)
    assert len(links) > 10
    for link in filter(None, (a or b for a, b in links)):
        assert link.startswith(("https://", "#")), link
        file = re.match(rf"{re.escape(urls['Source'])}/(?:blob|raw)/v{about['Version']}/([^#]*)", link)
        assert file is None or (package.ROOT / file[1]).exists(), link


@pytest.mark.parametrize("commands", [product.COMMANDS, research.COMMANDS], ids=["product", "research"])
def test_all_commands_have_a_description_and_a_main_function(commands):
    text = product.usage("auv-gym", commands)
    for name, (module, extras) in commands.items():
        assert re.search(rf"^  {name} +\w[^`]{{15,90}}$", text, re.MULTILINE), name
        for extra in extras.split(","):
            assert f"\n{extra} = [" in (package.ROOT / "pyproject.toml").read_text(encoding="utf-8")
        file = package.ROOT.joinpath(*module.split(".")).with_suffix(".py")
        tree = ast.parse(file.read_text(encoding="utf-8"))
        named = {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
        named |= {alias.name for node in tree.body if isinstance(node, ast.ImportFrom) for alias in node.names}
        assert "main" in named, module


@pytest.mark.parametrize(
    ("words", "status", "out", "err"),
    [
        (["--help"], 0, "usage: auv-gym COMMAND", ""),
        (["--version"], 0, auv_gym.__version__, ""),
        ([], 2, "", "auv-gym: no command; allowed are evaluate, train"),
        (
            ["evalute"],
            2,
            "",
            "auv-gym: unknown command 'evalute' (did you mean 'evaluate'?); allowed are evaluate, train",
        ),
        (["evaluate", "--episodes", "0"], 2, "", "auv-gym evaluate: --episodes is 0; it must be 1 or more"),
        (["train", "--seeds", "0"], 2, "", "auv-gym train: --seeds is 0; it must be 1 or more"),
        (["tune", "lqi", "--episodes", "3"], 2, "", "auv-gym tune: --episodes is 3"),
    ],
)
def test_the_command(words, status, out, err, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["/anywhere/bin/auv-gym", *words])
    assert product.main() == status
    printed = capsys.readouterr()
    assert printed.out.startswith(out)
    assert printed.err.startswith(err)
    assert printed.err.count("\n") == (1 if err else 0)


def test_help_and_results_have_the_typed_name_of_the_program(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["baselines/__main__.py", "evaluate", "--help"])
    with pytest.raises(SystemExit, match="0"):
        product.main()
    assert capsys.readouterr().out.startswith("usage: python -m baselines evaluate ")
    lines = []
    assert run(lambda words: lines.append(typed("evaluate.py", words)) or 0, "auv-gym evaluate", ["--seed", "1"]) == 0
    assert lines == ["auv-gym evaluate --seed 1"]
    assert typed("evaluate.py", ["--out", "a b"]) == "python evaluate.py --out 'a b'"
    assert called("evaluate.py") == "evaluate.py"


@pytest.mark.parametrize("name", ["tune", "identify", "export", "video", "dataset"])
def test_the_example_in_the_help_of_a_command_is_valid(name):
    options = import_module(product.COMMANDS[name].module).Options
    program, command, *words = shlex.split(re.search(r"Example: (.*)", options.__doc__)[1])
    assert (program, command) == ("auv-gym", name)
    assert isinstance(parse(options, words, program), options)


def test_the_list_of_commands_does_not_import_them():
    code = "import sys, baselines.__main__ as m; m.usage('x', m.COMMANDS); print(*sys.modules)"
    environment = os.environ | {"PYTHONPATH": str(package.ROOT)}
    loaded = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert not {"torch", "tyro", "matplotlib", "rich", "joblib"} & {
        name.partition(".")[0] for name in loaded.stdout.split()
    }


def test_messages_of_missing_extras(monkeypatch, tmp_path):
    monkeypatch.chdir(package.ROOT)
    assert installation.install("train") == "pip install -e '.[train]'"
    monkeypatch.chdir(tmp_path)
    assert installation.install("eval", "render") == f"pip install -e '{package.ROOT}[eval,render]'"
    assert installation.sources() == str(package.ROOT)
    monkeypatch.setattr(installation, "ROOT", tmp_path)
    for noted, origin in (
        (None, ""),
        ('{"url": "file:///a/auv_gym.whl", "archive_info": {}}', " @ file:///a/auv_gym.whl"),
        ('{"url": "https://x/y.git", "vcs_info": {"vcs": "git", "commit_id": "12ab"}}', " @ git+https://x/y.git@12ab"),
    ):
        monkeypatch.setattr(metadata.PathDistribution, "read_text", lambda *_, text=noted: text)
        assert installation.install("train") == f"pip install 'auv-gym[train]{origin}'"


def test_one_module_makes_all_messages_about_extras():
    files = (p for name in ("auv_gym", "baselines") for p in (package.ROOT / name).rglob("*.py"))
    saying = {p.name for p in files if "pip install" in p.read_text(encoding="utf-8")}
    assert saying == {"installation.py"}


def test_messages_of_an_installed_package_without_recorded_rows(monkeypatch, tmp_path, capsys):
    for module in (recorded, suites):
        monkeypatch.setattr(module, "checkout", lambda: None)
    monkeypatch.setattr(installation, "ROOT", tmp_path)
    monkeypatch.setattr(recorded, "RECORDED_FOLDER", tmp_path)
    assert recorded.missing("benchmark-v1") is None
    assert "the recorded rows of ood-v1 are not part of" in recorded.missing("ood-v1", tmp_path)
    (tmp_path / suites.SUMS).write_text("0  ood-v1.json\n")
    with pytest.raises(suites.SuiteError, match="the episodes of ood-v1 are not part of the installed package"):
        suites.load_suite("ood-v1", tmp_path)
    monkeypatch.setattr(recorded, "missing", lambda suite: f"no rows of {suite}")
    options = Options(suite="benchmark-v1", episodes=1, out=tmp_path / "out")
    assert Request.of(options).notes[0] == "no rows of benchmark-v1"
    assert suites.list_suites()

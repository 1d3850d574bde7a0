"""The package: content and metadata of the wheel, its command, and messages about missing parts.

`make package` also builds the package in another environment, installs it and uses it.
"""

import re
import shlex
import shutil
import sys
from email import message_from_bytes
from importlib import import_module, metadata

import package
import pytest

import auv_gym
from auv_gym import installation
from baselines import __main__ as product
from baselines import list_policies
from baselines.evaluation import recorded, suites
from baselines.evaluation.results import ResultFile
from baselines.tools import files
from baselines.tools.command_line import parse
from baselines.tuning.objective import SPACE_TUNABLES, TUNABLES
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
def test_the_package_is_small_and_equal_to_that_of_the_source_distribution(built):
    package.checked(*built)


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
    assert entry.decode().split() == ["[console_scripts]", "auv-gym", "=", "baselines.__main__:script"]
    urls = dict(url.split(", ") for url in about.get_all("Project-URL"))
    assert {"Homepage", "Documentation", "Source", "Changelog", "Issues"} <= set(urls)
    readme = about.get_payload()
    links = re.findall(r"\]\(([^)\s]+)|(?:src|href)=\"([^\"]+)\"", readme)
    assert len(links) > 10
    for link in filter(None, (a or b for a, b in links)):
        assert link.startswith(("https://", "#")), link
        file = re.match(rf"{re.escape(urls['Source'])}/(?:blob|raw)/v{about['Version']}/([^#]*)", link)
        assert file is None or (package.ROOT / file[1]).exists(), link


@pytest.mark.parametrize("commands", [product.COMMANDS, research.RESEARCH_COMMANDS], ids=["product", "research"])
def test_all_commands_have_a_description_and_a_main_function(commands):
    text = product.usage("auv-gym", commands)
    for name, (module, extras) in commands.items():
        assert re.search(rf"^  {name} +\w[^`]{{15,90}}$", text, re.MULTILINE), name
        for extra in extras.split(","):
            assert f"\n{extra} = [" in (package.ROOT / "pyproject.toml").read_text(encoding="utf-8")
        assert callable(import_module(module).main), module


@pytest.mark.parametrize(
    ("words", "status", "out", "err"),
    [
        (["--help"], 0, "usage: auv-gym COMMAND", ""),
        (["--version"], 0, auv_gym.__version__, ""),
        ([], 2, "", "auv-gym: no command; allowed are evaluate, train"),
        (["evalute"], 2, "", "auv-gym: unknown command 'evalute' (did you mean 'evaluate'?); allowed are evaluate, tr"),
        (["evaluate", "--episodes", "0"], 2, "", "auv-gym evaluate: --episodes is 0; it must be 1 or more"),
    ],
)
def test_the_command(words, status, out, err, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["/anywhere/bin/auv-gym", *words])
    assert product.main() == status
    printed = capsys.readouterr()
    assert printed.out.startswith(out)
    assert printed.err.startswith(err)
    assert printed.err.count("\n") == (1 if err else 0)


@pytest.mark.parametrize("name", product.COMMANDS)
def test_the_example_in_the_help_of_a_command_is_valid(name):
    options = import_module(product.COMMANDS[name].module).Options
    program, command, *words = shlex.split(re.search(r"Example: (.*)", options.__doc__)[1])
    assert (program, command) == ("auv-gym", name)
    assert isinstance(parse(options, words, program), options)


def test_the_help_has_all_controllers_that_can_be_tuned_and_all_suites(capsys):
    folders = (package.ROOT / name / "data" / "suites" for name in ("research", "baselines/evaluation"))
    suites = [file.name.split(".")[0] for folder in folders for file in folder.glob("*.bz2")]
    assert len(suites) >= 6
    for name, words in (("tune", {*TUNABLES, *SPACE_TUNABLES}), ("evaluate", suites)):
        with pytest.raises(SystemExit):
            parse(import_module(product.COMMANDS[name].module).Options, ["--help"], name)
        shown = capsys.readouterr().out
        assert [word for word in words if word not in shown] == []


def test_the_list_of_commands_does_not_import_them():
    code = "import sys, baselines.__main__ as m; m.usage('x', m.COMMANDS); print(*sys.modules)"
    loaded = package.run(sys.executable, "-c", code, cwd=package.ROOT).split()
    assert not {"torch", "tyro", "matplotlib", "rich", "joblib"} & {name.partition(".")[0] for name in loaded}


def test_messages_of_missing_extras(monkeypatch, tmp_path):
    monkeypatch.chdir(package.ROOT)
    assert installation.install("train") == "pip install -e '.[train]'"
    monkeypatch.chdir(tmp_path)
    assert installation.install("eval", "render") == f"pip install -e '{package.ROOT}[eval,render]'"
    monkeypatch.setattr(installation, "ROOT", tmp_path)
    git = '{"url": "https://x/y.git", "vcs_info": {"vcs": "git", "commit_id": "12ab"}}'
    kind = type(metadata.distribution("auv-gym"))  # that of the backport, if another library has imported it
    for source, origin in ((None, ""), (git, " @ git+https://x/y.git@12ab")):
        monkeypatch.setattr(kind, "read_text", lambda *_, text=source: text)
        assert installation.install("train") == f"pip install 'auv-gym[train]{origin}'"


def test_suites_of_an_installed_package(monkeypatch):
    """Only a checkout has those of the studies."""
    monkeypatch.setattr(files, "DATA_FOLDERS", files.DATA_FOLDERS[:1])
    assert suites.list_suites() == ["benchmark-v3", "benchmark-v3-validation"]
    (file,) = recorded.recorded_files("benchmark-v3")
    assert {run.policy for run in ResultFile.read(file).runs} >= set(list_policies())
    with pytest.raises(suites.SuiteError, match="unknown suite 'hard-v1'; allowed are benchmark-v3, benchmark-v3-va"):
        suites.load_suite("hard-v1")

"""What the Makefile and the pages tell a user to type: each verb and each line runs, where it is long in a quick form.

Verbs run in a copy of the repository whose environment is the one that runs the tests, so nothing is installed.
"""

import os
import re
import shlex
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest
from built_pages import check_links, check_pages, check_search, check_sorting
from package import LEFT, ROOT

from auv_gym.scenarios.presets import PRESETS
from baselines.__main__ import COMMANDS, call
from baselines.agents.names import agent_folder

MAKEFILE = (ROOT / "Makefile").read_text(encoding="utf-8")
VERBS = re.search(r"^\.PHONY: (.*)$", MAKEFILE, re.MULTILINE)[1].split()
TINY = "--algo ppo --scenario tiny.toml --timesteps 512 --set n_envs=8 n_steps=16 batch_size=64"
QUICK = {
    "help": "",
    "demo": "--episodes 1 --jobs 1",
    "video": "--seconds 0.5 --out video.webp",
    "format": "",
    "bench": "--quick",
    "train": f"{TINY} --out run",
    "train-all": "ppo-cruise --timesteps 512",
    "pages": "policies --check",
    "verify": "vehicles-v3 --policy open-loop --cells slow-calm@otter",
    "examples": "--help",
    "docs": "-t quick -D toc_object_entries=0 -D html_show_search_summary=0",
    "clean": "",
}
"""Options of the verbs that are run here."""
BY_CI = {"test", "commands", "lint", "typecheck"}
"""Verbs that `.ci/run` itself runs."""
BY_WORKFLOW = {"test-all", "package", "oldest", "matrix", "damage"}
"""Verbs that only the workflows run: they take long, or build and install in environments of their own."""
MADE = {"api", "scenarios"}  # folders of pages that the build writes
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md"]
PAGES += [p for p in sorted((ROOT / "docs").rglob("*.md")) if p.parent.name not in MADE]
FENCE = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
ELSEWHERE = {
    r"make( .*)?": "the verbs, below",
    r"git clone .*": "needs the network",
    r"(uv )?pip install .*": "`make`'s stamps, and the extras exist, below",
    r"auv-gym --help": "test_package.py::test_the_command",
    r"(dask|auv-gym) .*(scheduler.json).*": "test_cluster.py",
    r"auv-gym evaluate --policy runs/train/storm .*": "test_user_policies.py::test_all_seeds_of_a_training_...",
    r"auv-gym identify .*": "test_identify.py::test_the_command_writes_a_vehicle_that_scenarios_take",
    r"auv-gym train .*--(from|vehicle) .*": "test_initial_agent.py::test_documented_commands_run",
    r"auv-gym train.*": "test_training.py::test_documented_commands_run",
    r"(auv-gym export .* --vehicle my\.toml|cc -O2) .*": "test_export.py::test_the_documented_program_gives_the_...",
    r"auv-gym tune .*": "test_tuning.py, with few evaluations",
    r"auv-gym verify .*": "test_result_files.py::test_equal_results_are_repeated",
    r"(auv-gym evaluate .* --plant|export PYTHONPATH=|c\+\+ -std).*": "test_plants.py",
    r'auv-gym evaluate --policy "cmd:.*': "test_programs.py::test_the_examples_equal_the_class",
    r"python -m research paper": "`make demo`, below",
    r"python -m research speed .*": "`make bench`, below",
    r"python -m research suites .*": "test_suites.py::test_the_command_records_policies_and_verifies_them",
    r"python -m research (?!pages|study|web-demo).*": "test_study.py::test_a_quick_form_of_each_study",
}
"""Lines of the pages that do not run one by one here, and where they do."""
EVALUATES = r"auv-gym evaluate|python evaluate\.py"
RUN_HERE = r"auv-gym (?!evaluate)|python -m research "
"""How lines begin that run here, those that evaluate and the others."""
SUITES, OF_A_CLONE = (
    [f.name.split(".")[0] for f in folder.glob("*.bz2")]
    for folder in (ROOT / "baselines" / "evaluation" / "data" / "suites", ROOT / "research" / "data" / "suites")
)


def lines():
    """Return the shell lines of all pages, without comments."""
    blocks = [m for page in PAGES for m in FENCE.finditer(page.read_text(encoding="utf-8")) if m[1] in ("bash", "sh")]
    found = [line.split(" #")[0].strip() for block in blocks for line in block[2].splitlines()]
    return list(dict.fromkeys(line for line in found if line and not line.startswith("#")))


def quick(line):
    """Return the words behind `python` with which a line is run: one episode of one short scenario."""
    words = shlex.split(line.replace("evaluate.py", "-m baselines evaluate").replace("auv-gym", "python -m baselines"))[
        1:
    ]
    if words[2] == "video":
        return [*words, "--seconds", "0.2"]
    if words[2] == "evaluate":
        for option in ("--suite", "--episodes", "--jobs"):
            if option in words:
                at = words.index(option)
                assert option != "--suite" or words[at + 1] in (SUITES if "auv-gym" in line else (*SUITES, *OF_A_CLONE))
                del words[at : at + 2]
        scenario = [] if {"--scenario", "--mission"} & {*words} else ["--scenario", "cruise-calm"]
        return [*words, *scenario, "--episodes", "1", "--jobs", "1"]
    return words


def elsewhere(line):
    return next((where for pattern, where in ELSEWHERE.items() if re.fullmatch(pattern, line)), None)


@pytest.fixture(scope="module")
def copy(tmp_path_factory):
    """Return a copy of the repository with an environment in which nothing is left to install."""
    folder = tmp_path_factory.mktemp("verbs") / "auv_gym"
    shutil.copytree(ROOT, folder, ignore=shutil.ignore_patterns(*LEFT))
    (folder / ".venv").mkdir()
    (folder / ".venv" / "bin").symlink_to(Path(sys.executable).parent)
    if sys.prefix != sys.base_prefix:  # without these two the python in bin is not the environment's
        (folder / ".venv" / "lib").symlink_to(Path(sys.prefix) / "lib")
        shutil.copy(Path(sys.prefix) / "pyvenv.cfg", folder / ".venv")
    soon = time.time() + 3600  # the same for all: none is older than what it was made from
    for name in ("venv", *re.findall(r"\$\(VENV\)/(\w+)\.stamp", MAKEFILE)):
        stamp = folder / ".venv" / f"{name}.stamp"
        stamp.touch()
        os.utime(stamp, (soon, soon))

    tiny = 'name = "tiny"\nsteps = 15\n\n[path]\nspeed = 1.0\nturn_rate = 0.1\n'
    (folder / "tiny.toml").write_text(tiny, encoding="utf-8")
    return folder


def called(folder, *command):
    """Run a command in a folder and return what it prints; make's own variables are not handed on."""
    kept = {key: value for key, value in os.environ.items() if not key.startswith(("MAKE", "MFLAGS"))}
    environment = {**kept, "PYTHONPATH": str(folder)}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{shlex.join(command)}\n{done.stdout}\n{done.stderr}"
    return done.stdout


def made(copy, verb):
    return called(copy, "make", verb, f"ARGS={QUICK[verb]}")


def test_every_verb_is_run():
    assert set(VERBS) == {*QUICK, *BY_CI, *BY_WORKFLOW}
    workflows = [file.read_text(encoding="utf-8") for file in (ROOT / ".github" / "workflows").glob("*.yml")]
    assert set(re.findall(r"^      - run: make ([\w-]+)$", "".join(workflows), re.MULTILINE)) >= BY_WORKFLOW
    assert set(re.findall(r"^([a-z-]+):.*## ", MAKEFILE, re.MULTILINE)) == set(VERBS)
    assert re.search(r"^test: lint typecheck ##", MAKEFILE, re.MULTILINE)
    assert re.search(r"^test-all: test ##", MAKEFILE, re.MULTILINE)
    assert "\nexec make test commands " in (ROOT / ".ci" / "run").read_text(encoding="utf-8")


def test_help_lists_the_verbs(copy):
    assert set(re.findall(r"^  (\S+)", made(copy, "help"), re.MULTILINE)) == set(VERBS)
    assert called(copy, "make") == made(copy, "help")


@pytest.mark.slow
def test_demo_recomputes_the_paper_runs_every_preset_and_makes_videos_of_plane_and_space(copy):
    said = made(copy, "demo").splitlines()
    demo = copy / "runs" / "demo"
    for page in ("paper/fig3_trajectory.png", "scenarios/report.html", "storm/report.html", "space/report.html"):
        assert (demo / page).exists()
    for folder in ("storm", "space"):
        assert any(line.startswith(f"written: runs/demo/{folder}/video.webp") for line in said)
        assert (demo / folder / "video.webp").stat().st_size > 10_000
    assert "runs/demo/s*/video.webp" in said[-1]


@pytest.mark.slow
@pytest.mark.long
def test_docs_are_built_without_a_warning(copy, browser):
    pytest.importorskip("sphinx")
    pytest.importorskip("furo")
    made(copy, "docs")
    built = copy / "build" / "docs"
    html = (built / "theory.html").read_text(encoding="utf-8")
    assert "<math" in html
    assert "\\frac" not in html
    check_links(built)
    check_pages(browser, built)
    check_sorting(browser, built)
    check_search(browser, built)


@pytest.mark.parametrize(
    ("verb", "says", "file"),
    [
        ("examples", "rl_zoo", ""),
        ("pages", "all pages are up to date", ""),
        pytest.param("video", "written: ", "video.webp", marks=pytest.mark.slow),
        pytest.param("bench", r"(\d+) of \1 rows measured: runs/quick/speed.json", "", marks=pytest.mark.slow),
        pytest.param("train", "agent: run/agent", "run/agent/agent.json", marks=pytest.mark.slow),
        pytest.param("train-all", "", "runs/shipped/ppo-cruise", marks=[pytest.mark.slow, pytest.mark.long]),
        pytest.param("verify", r"equal +open-loop in vehicles-v3: \d+ numbers of 1 cells", "", marks=pytest.mark.slow),
    ],
)
def test_verb_runs_in_a_quick_form(verb, says, file, copy):
    assert re.search(says, made(copy, verb))
    assert (copy / file).exists()


def test_format_mends_what_lint_complains_about(copy):
    file = copy / "auv_gym" / "untidy.py"
    file.write_text('"""Untidy."""\nimport os\nx = [ 1,2 ]\n', encoding="utf-8")
    made(copy, "format")
    assert file.read_text(encoding="utf-8") == '"""Untidy."""\n\nx = [1, 2]\n'
    file.unlink()


def test_clean_leaves_what_was_not_built(tmp_path):
    shutil.copy(ROOT / "Makefile", tmp_path)
    for name in (".venv/bin", "build/docs", "dist", "auv_gym/__pycache__", ".pytest_cache", "runs/train"):
        (tmp_path / name).mkdir(parents=True)
    for name in ("auv_gym/kept.py", ".venv/made-by-make"):
        (tmp_path / name).touch()
    made(tmp_path, "clean")
    left = {str(p.relative_to(tmp_path)) for p in tmp_path.rglob("*")}
    assert left == {"Makefile", "auv_gym", "auv_gym/kept.py", "runs", "runs/train"}


@pytest.mark.parametrize("begun", [False, True])
def test_an_environment_that_make_did_not_make_stays(begun, tmp_path):
    """One whose making was interrupted is completed."""
    shutil.copy(ROOT / "Makefile", tmp_path)
    (tmp_path / ".venv").mkdir()
    (tmp_path / ".venv" / "mine").touch()
    if begun:
        (tmp_path / ".venv" / "made-by-make").touch()
    make = ["make", ".venv/venv.stamp", f"PYTHON={sys.executable}"]
    process = subprocess.run(make, check=False, cwd=tmp_path, capture_output=True, text=True)
    assert (process.returncode, (tmp_path / ".venv" / "bin").exists()) == (0 if begun else 2, begun)
    if not begun:
        assert "error: make did not make .venv, so it stays as it is: make VENV=another-folder" in process.stderr
        made(tmp_path, "clean")
    assert (tmp_path / ".venv" / "mine").exists()


def test_every_line_of_the_pages_is_run_or_listed():
    for line in lines():
        assert elsewhere(line) or re.match(f"{EVALUATES}|{RUN_HERE}", line), line
    for pattern, where in ELSEWHERE.items():
        assert any(re.fullmatch(pattern, line) for line in lines()), pattern
        if match := re.match(r"(test_\w+\.py)(?:::(\w+))?", where):
            assert f"def {match[2] or ''}" in next((ROOT / "tests").rglob(match[1])).read_text(encoding="utf-8"), where


def test_verbs_and_extras_that_the_pages_name_exist():
    project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    extras = set(re.findall(r"^(\w+) = \[", project.split("[project.optional-dependencies]")[1], re.MULTILINE))
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        assert set(re.findall(r"(?:^|`)make ([a-z][\w-]*)", text, re.MULTILINE)) <= set(VERBS), page
        for names in re.findall(r"\.\[([\w,]+)\]", text):
            assert set(names.split(",")) <= extras, page


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a folder with the files that the pages' lines name."""
    from stable_baselines3 import PPO

    from baselines.evaluation.rollout import make_env

    folder = tmp_path_factory.mktemp("lines")
    for page in PAGES:
        for language, text in FENCE.findall(page.read_text(encoding="utf-8")):
            name = text.split("\n", 1)[0].removeprefix("# ")
            if re.fullmatch(r"\w+\.(py|toml|csv)", name) and language in ("python", "toml", "csv"):
                (folder / name).write_text(text, encoding="utf-8")
    trained = {"ppo-cruise-storm": "ppo-cruise", "helm-any-vehicle": "helm-any"}
    for run, agent in {"apg-cruise": "ppo-cruise", "ppo-slow": "ppo-slow", **trained}.items():
        shutil.copytree(agent_folder(agent), folder / "runs" / "train" / run / "agent")
    (folder / "runs" / "ppo").mkdir()
    model = PPO("MlpPolicy", make_env(PRESETS["cruise-calm"]), n_steps=8, batch_size=8, device="cpu")
    for name in ("model.zip", "runs/ppo/model.zip"):
        model.save(folder / name)
    return folder


@pytest.mark.parametrize("line", [x for x in lines() if re.match(EVALUATES, x) and not elsewhere(x)])
@pytest.mark.slow
def test_line_of_evaluate_runs(line, folder, monkeypatch):
    monkeypatch.chdir(folder)
    assert call(COMMANDS["evaluate"], quick(line)[3:], "auv-gym evaluate") == 0


@pytest.mark.parametrize(
    "line", sorted({shlex.join(quick(x)) for x in lines() if re.match(RUN_HERE, x) and not elsewhere(x)})
)
@pytest.mark.slow
def test_line_of_a_module_runs(line, copy):
    called(copy, sys.executable, *shlex.split(line))

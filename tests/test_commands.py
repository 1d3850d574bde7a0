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

from auv_gym.scenarios.presets import PRESETS
from baselines.agents.names import agent_folder
from baselines.evaluation import entry as evaluation

ROOT = Path(__file__).parents[1]
MAKEFILE = (ROOT / "Makefile").read_text(encoding="utf-8")
VERBS = re.search(r"^\.PHONY: (.*)$", MAKEFILE, re.MULTILINE)[1].split()
TINY = "--algo ppo --scenario tiny.toml --timesteps 512 --set n_envs=8 n_steps=16 batch_size=64"
QUICK = {
    "help": "",
    "demo": "--episodes 1 --jobs 1",
    "video": "--episodes 2 --jobs 1 --seconds 0.5 --out video.webp",
    "format": "",
    "bench": "--quick",
    "train": f"{TINY} --out run",
    "train-all": "ppo-cruise --timesteps 512",
    "pages": "vehicle-gains --check",
    "verify": "unmodelled-v1 --policy open-loop --cells slow-everything",
    "examples": "--help",
    "docs": "-t quick -D toc_object_entries=0 -D html_show_search_summary=0",
    "clean": "",
}
"""Options of the verbs that are run here."""
BY_CI = {"test", "commands", "lint", "typecheck"}
"""Verbs that `.ci/run` itself runs."""
BY_WORKFLOW = {"test-all", "package", "oldest", "matrix", "soak"}
"""Verbs that only the workflows run: they take long, or build and install in environments of their own."""
MADE = {"api", "scenarios"}  # folders of pages that the build writes
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md"]
PAGES += [p for p in sorted((ROOT / "docs").rglob("*.md")) if p.parent.name not in MADE]
FENCE = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
FROZEN = ("benchmark-v2", "benchmark-v1", "ood-v1", "unmodelled-v1", "faults-v1", "governed-v1", "vehicles-v2")
ELSEWHERE = {
    r"make( .*)?": "the verbs, below",
    r"auv-gym identify .*": "test_identify.py::test_the_command_writes_a_vehicle_that_scenarios_take",
    r"python -m research faults .*": "test_faults.py::test_a_quick_form_of_the_command",
    r"python -m research governed .*": "test_governed.py::test_a_quick_form_of_the_command",
    r"python -m research failure-rate .*": "test_safety.py::test_failures_are_counted_and_later_runs_continue",
    r"auv-gym --help": "test_package.py::test_the_command",
    r"python -m research model-error .*": "test_model_error.py::test_command_keeps_what_it_measures",
    r"python -m research suites record .* --held-out .*": "test_held_out.py::test_the_command_keeps_rows",
    r"python -m research suites check .*": "test_suites.py::test_generated_episodes_are_unchanged",
    r"python -m research validation .*": "test_validation.py::test_the_command_writes_what_it_measures",
    r"python -m research transfer .*": "test_transfer.py::test_the_command_compares",
    r"python -m research throughput.*": "`make bench`, below",
    r"git clone .*": "needs the network",
    r"pip install .*": "`make`'s stamps, and the extras exist, below",
    r"(python train\.py|auv-gym train) .*--(from|vehicle) .*": "test_initial_agent.py::test_documented_commands_run",
    r"(python train\.py|auv-gym train).*": "test_training.py::test_documented_commands_run",
    r"auv-gym tune .*": "test_tuning.py, with few evaluations",
    r"python -m rl_zoo3\.train .*": "test_sb3.py reads its format; rl_zoo3 itself is no dependency",
    r"(python evaluate\.py --suite presets|python -m research paper)": "`make demo`, below",
    r"auv-gym evaluate .*--submit .*": "test_submission.py::test_commands_of_the_tutorial",
    r"(auv-gym submit|python -m research leaderboard) .*": "test_submission.py::test_commands_of_the_tutorial",
    r'auv-gym evaluate --policy "cmd:.*': "test_programs.py::test_the_examples_equal_the_class",
    r"python -m research screenshots": "test_report_page.py::test_pictures_of_the_pages",
}
"""Lines of the pages that do not run one by one here, and where they do."""


EVALUATE = ("python evaluate.py", "auv-gym evaluate")
"""How lines begin that evaluate."""


OTHERS = r"auv-gym (?!evaluate)|python -m research "
"""How other lines begin that run here."""


def lines():
    """Return the shell lines of all pages, without comments."""
    blocks = [m for page in PAGES for m in FENCE.finditer(page.read_text(encoding="utf-8")) if m[1] in ("bash", "sh")]
    found = [line.split(" #")[0].strip() for block in blocks for line in block[2].splitlines()]
    return list(dict.fromkeys(line for line in found if line and not line.startswith("#")))


def quick(line):
    """Return the words behind `python` with which a line is run: one episode of one short scenario."""
    words = shlex.split(
        line.replace("auv-gym evaluate", "python evaluate.py").replace("auv-gym", "python -m baselines")
    )
    del words[0]
    name = words[2] if words[:2] == ["-m", "research"] or words[:2] == ["-m", "baselines"] else ""
    if name == "suites":
        rest = QUICK["verify"] if words[3] == "verify" else "unmodelled-v1 --policy open-loop --episodes 1"
        return [*words[:4], *rest.split()]
    if name == "estimation-bound":
        return [*words, "--episodes", "1", "--out", "bounds.json"]
    if name == "dataset":
        return [*words, "--episodes", "1"]
    if name == "video":
        return [*words, *(["--episodes", "1", "--jobs", "1"] if "--episodes" in words else []), "--seconds", "0.2"]
    if words == ["evaluate.py"] or (words[0] == "evaluate.py" and "--help" not in words):
        for option, count in (("--suite", 2), ("--episodes", 2), ("--jobs", 2)):
            if option in words:
                at = words.index(option)
                assert option != "--suite" or words[at + 1] in FROZEN
                del words[at : at + count]
        scenario = [] if "--scenario" in words else ["--scenario", "cruise-calm"]
        return [*words, *scenario, "--episodes", "1", "--jobs", "1"]
    return words


def elsewhere(line):
    return next((where for pattern, where in ELSEWHERE.items() if re.fullmatch(pattern, line)), None)


@pytest.fixture(scope="module")
def copy(tmp_path_factory):
    """Return a copy of the repository with an environment in which nothing is left to install."""
    folder = tmp_path_factory.mktemp("verbs") / "auv_gym"
    left = (".git", ".venv", "build", "dist", "runs", "__pycache__", ".*_cache", ".hypothesis")
    shutil.copytree(ROOT, folder, ignore=shutil.ignore_patterns(*left))
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
def test_demo_recomputes_the_paper_runs_every_preset_and_shows_what_an_agent_wins(copy):
    printed = made(copy, "demo").splitlines()[-4:]
    for page in ("paper/paper.json", "paper/fig3_trajectory.png", "scenarios/report.html", "storm/report.html"):
        assert (copy / "runs" / "demo" / page).exists()
    for policy, line in zip(("nmpc", "helm"), printed, strict=False):
        expected = rf"steady-state RMSE of {policy}: 0\.\d+ m, of backstepping: 0\.\d+ m \(1 paired episode .*"
        assert re.fullmatch(expected, line)
    assert printed[2].startswith("written: runs/demo/storm/video.webp")
    assert "runs/demo/storm/video.webp" in printed[3]
    assert (copy / "runs" / "demo" / "storm" / "video.webp").stat().st_size > 10_000


@pytest.mark.slow
def test_video_is_made_in_a_quick_form(copy):
    printed = made(copy, "video").splitlines()[-3:]
    assert [line.split()[0] for line in printed] == ["steady-state", "steady-state", "written:"]
    assert (copy / "video.webp").exists()


@pytest.mark.slow
def test_bench_measures_in_a_quick_form(copy):
    text = made(copy, "bench")
    for case in ("with resets", "different times", "eleven of 64", "first use", "decision of one vehicle: nmpc"):
        assert case in text


@pytest.mark.slow
def test_train_makes_an_agent(copy):
    made(copy, "train")
    assert (copy / "run" / "agent" / "agent.json").exists()


@pytest.mark.slow
@pytest.mark.long
def test_train_all_trains_those_that_are_named(copy):
    made(copy, "train-all")
    assert [run.name for run in (copy / "runs" / "shipped").iterdir()] == ["ppo-cruise"]


def test_pages_are_up_to_date(copy):
    assert made(copy, "pages").splitlines()[-1] == "all pages are up to date"


@pytest.mark.slow
def test_verify_says_what_is_equal(copy):
    assert re.search(r"^equal +open-loop in unmodelled-v1: \d+ numbers of 1 cells$", made(copy, "verify"), re.MULTILINE)


def test_examples_are_listed(copy):
    assert "rl_zoo" in made(copy, "examples")


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
    (tmp_path / "auv_gym" / "kept.py").touch()
    made(tmp_path, "clean")
    left = {str(p.relative_to(tmp_path)) for p in tmp_path.rglob("*")}
    assert left == {"Makefile", "auv_gym", "auv_gym/kept.py", "runs", "runs/train"}


def test_every_line_of_the_pages_is_run_or_listed():
    for line in lines():
        assert elsewhere(line) or line.startswith(
            (*EVALUATE, "auv-gym ", "python -m baselines", "python -m research ")
        ), line
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
            if re.fullmatch(r"\w+\.(py|toml|yml)", name) and language in ("python", "toml", "yaml"):
                (folder / name).write_text(text, encoding="utf-8")
    trained = {"ppo-cruise-storm": "ppo-cruise", "helm-any-vehicle": "helm-any"}
    for run, agent in {"apg-cruise": "apg-cruise", "ppo-slow": "ppo-slow", **trained}.items():
        shutil.copytree(agent_folder(agent), folder / "runs" / "train" / run / "agent")
    (folder / "runs" / "ppo").mkdir()
    model = PPO("MlpPolicy", make_env(PRESETS["cruise-calm"]), n_steps=8, batch_size=8, device="cpu")
    for name in ("model.zip", "runs/ppo/model.zip"):
        model.save(folder / name)
    return folder


@pytest.mark.parametrize(
    "line",
    [line for line in lines() if line.startswith(EVALUATE) and not elsewhere(line)],
)
@pytest.mark.slow
def test_line_of_evaluate_runs(line, folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    if "--help" in line:
        with pytest.raises(SystemExit, match="0"):
            evaluation.main(quick(line)[1:])
    else:
        assert evaluation.main(quick(line)[1:]) == 0


@pytest.mark.parametrize(
    "line", sorted({shlex.join(quick(x)) for x in lines() if re.match(OTHERS, x) and not elsewhere(x)})
)
@pytest.mark.slow
def test_line_of_a_module_runs(line, copy):
    called(copy, sys.executable, *shlex.split(line))

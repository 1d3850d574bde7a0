"""Policies that are programs: the documentation's examples in every language, and whatever goes wrong, in one line."""

import gc
import itertools
import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from auv_gym.physics.vehicle import Vehicle
from auv_gym.scenarios.presets import PRESETS
from auv_gym.task.observation import TERMS
from baselines import make_policy
from baselines.agents import programs
from baselines.agents.programs import ProgramPolicy
from baselines.evaluation import rollout as rollout_module
from baselines.evaluation.cells import drawn
from baselines.evaluation.fingerprints import fingerprint
from baselines.evaluation.rollout import PolicyError, Stopwatch, make_env, rollout
from baselines.evaluation.runner import run_all
from baselines.tools.programs import ProgramError

ROOT = Path(__file__).parents[2]
PAGE, TUTORIAL = (
    (ROOT / "docs" / name).read_text(encoding="utf-8") for name in ("programs.md", "tutorials/controller.md")
)
PYTHON = shlex.quote(sys.executable)
COMPILED = ("cc", "-std=c99", "-Wall", "-Wextra", "-Werror", "-O2", "-o", "my_controller", "my_controller.c", "-lm")
EXAMPLES = {
    f"cmd:{PYTHON} my_controller_alone.py": sys.executable,
    "cmd:node my_controller.js": "node",
    "cmd:./my_controller": "cc",
}
"""The programs of the page, and what each of them needs."""
LOOP = """
import json, sys
hello = json.loads(sys.stdin.readline())
print("{}", flush=True)
for k, line in enumerate(sys.stdin):
    n = len(json.loads(line)["observations"])
    answer = {"actions": [[0.0, 0.0]] * n}
"""
"""The beginning of a program that answers with zeros, once it prints."""
TELL = "    print(json.dumps(answer), flush=True)\n"


def program(text, name="program.py"):
    """Return the name of a policy that is a program of this text."""
    Path(name).write_text(text, encoding="utf-8")
    return f"cmd:{PYTHON} {name}"


@pytest.fixture(autouse=True)
def _here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def alive(pid):
    """Return whether a process runs."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def wait_for(condition, seconds=150):
    """Wait until a condition holds."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it takes too long"
        time.sleep(0.05)


def pids_in(file):
    return [int(pid) for pid in Path(file).read_text().split()]


@pytest.mark.parametrize("name", EXAMPLES, ids=["python", "node", "c"])
def test_the_examples_equal_the_class(name):
    if shutil.which(EXAMPLES[name]) is None:
        (pytest.fail if os.environ.get("CI") else pytest.skip)(f"{EXAMPLES[name]} is not installed")
    for _, text in re.findall(r"^```(\w+)\n(.*?)^```$", PAGE + TUTORIAL, re.MULTILINE | re.DOTALL):
        if file := re.match(r"(?:#|//|/\*) (\w+\.\w+)", text):
            Path(file[1]).write_text(text, encoding="utf-8")
    if EXAMPLES[name] == "cc":
        subprocess.run(COMPILED, check=True)
    scenario = PRESETS["cruise-storm"]
    episodes = drawn(scenario, 4, seed=0).episodes
    expected, result = (rollout(make_policy(p), scenario, episodes) for p in ("line_of_sight.py:LineOfSight", name))
    np.testing.assert_allclose(result.measures.steady_rmse, expected.measures.steady_rmse, rtol=1e-5)
    np.testing.assert_allclose(result.measures.effort, expected.measures.effort, rtol=1e-5)
    assert result.decision_seconds > 0


def test_the_page_names_them():
    names = re.findall(r'"(cmd:[^"]*my_[^"]*)"', PAGE.partition("In Python, without any package")[2])
    assert [name.replace("python3", PYTHON) for name in names] == list(EXAMPLES)
    assert " ".join(COMPILED).replace(" -std=c99 -Wall -Wextra -Werror", "") in PAGE


def test_the_greeting_says_what_an_observation_is():
    name = program(LOOP.replace("print", "json.dump(hello, open('hello.json', 'w'))\nprint", 1) + TELL)
    heavy = Vehicle(m11=600.0, m22=840.0, m33=300.0, d11=160.0, d22=320.0, d33=180.0, X_uu=40.0)
    policy = make_policy(name, heavy)
    action, _ = policy.predict(make_env(PRESETS["slow-calm"]).reset(seed=0)[0])
    assert (action.shape, action.dtype) == ((2,), np.float32)
    assert policy.predict(np.ones((3, 18)))[0].shape == (3, 2)
    hello = json.loads(Path("hello.json").read_text())
    assert hello["auv_gym"] == programs.PROTOCOL
    assert [term["scale"] for term in hello["observation"]] == [term.scale for term in TERMS]
    assert [term["name"] for term in hello["action"]] == ["a_u", "a_r"]
    assert hello["vehicle"]["m11"] == 600.0
    assert hello["vehicle"]["X_uu"] == 40.0


def test_questions_mark_the_starts_of_episodes():
    text = LOOP + "    begins = [float(s) for s in json.loads(line)['starts']]\n"
    policy = make_policy(program(text + "    answer = {'actions': [[b, -1.0] for b in begins]}\n" + TELL))
    rows = np.ones((3, 18))

    def starts(*memory):
        action, state = policy.predict(rows, *memory)
        assert (action[:, 1] == -1).all()
        return action[:, 0].tolist(), state

    begun, state = starts(None, np.ones(3, dtype=bool))
    assert begun == [1, 1, 1]
    assert starts(state, np.array([False, True, False]))[0] == [0, 1, 0]
    assert starts(state)[0] == [0, 0, 0]
    assert starts()[0] == [1, 1, 1]


def test_a_program_with_a_preview():
    """Its columns are those that the environment shows to any policy with that preview."""
    text = LOOP.replace('"{}"', "'{\"preview\": [10, 20]}'")
    text += "    ahead = [row[18:] for row in json.loads(line)['observations']]\n"
    policy = make_policy(program(text + "    answer = {'actions': [[a[0] / 64, a[3] / 64] for a in ahead]}\n" + TELL))
    assert policy.preview == (10, 20)
    observation = np.arange(22.0)
    np.testing.assert_allclose(policy.predict(observation)[0], [18 / 64, 21 / 64])
    assert rollout(policy, PRESETS["cruise-calm"], drawn(PRESETS["cruise-calm"], 1, 0).episodes).errors.shape[1] == 1


WRONG = {
    "no such program": ("cmd:./nothing --option", r"cannot start cmd:\./nothing --option: No such file"),
    "fails": ("1 / 0", "ended with status 1; the last line of its stderr: ZeroDivisionError"),
    "is killed": ("import os\nos.kill(os.getpid(), 9)", "ended by signal SIGKILL"),
    "is silent": ("import time\ntime.sleep(60)", "it has not answered for 0.5 s"),
    "remarks": ("print('ready')\nimport time\ntime.sleep(9)", "answers ready, which is not JSON; write other"),
    "without end": ("import sys\nwhile True: sys.stdout.write('a' * 2**16)", "longer than 4194304 bytes"),
    "no preview": ("print('{\"preview\": [3, 2]}')\ninput()\ninput()", "preview is .*ascending"),
    "says why": (LOOP + "    answer = {'error': 'no licence'}\n" + TELL, "it reports: no licence"),
    "too many": (LOOP + "    answer['actions'] *= 2\n" + TELL, "answers 2 actions for 1 observations"),
    "no pair": (LOOP + "    answer['actions'][0] = [1]\n" + TELL, r"action 0 of 1 is \[1\]; it must be two numbers"),
    "two lines": (LOOP + TELL.replace("answer)", "answer) + '\\n{}'"), "more than one line"),
}
"""Programs that do not answer as they should, or commands; and what is said of them."""


@pytest.mark.parametrize("case", WRONG)
def test_errors_are_one_line_and_end_the_program(case, monkeypatch):
    text, says = WRONG[case]
    monkeypatch.setattr(programs, "START", 0.5 if case == "is silent" else 20.0)
    name = text if text.startswith("cmd:") else program(f"import os\nopen('pid', 'w').write(str(os.getpid()))\n{text}")
    with pytest.raises(ProgramError, match=says) as caught:
        make_policy(name)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 700
    if Path("pid").exists():
        wait_for(lambda: not alive(*pids_in("pid")))


def test_a_failure_in_an_episode_only_affects_its_row():
    """By its end, its silence, or actions that are no numbers, in the middle of an episode."""
    late = "    if k == 50: {}\n" + TELL
    for i, what in enumerate(("sys.exit('out of fuel')", "answer = {'actions': [[float('nan'), 1e999]]}")):
        name = program(LOOP + late.format(what), f"late{i}.py")
        runs = run_all(("open-loop", name), [drawn(PRESETS["cruise-calm"], 1, 0)])
        assert runs[0].error is None
        assert ("out of fuel", "it must be two finite numbers")[i] in runs[1].error


def test_slow_programs_are_rejected():
    name = program(LOOP + "    import time; time.sleep(0.02)\n" + TELL)
    policy, scenario = make_policy(name), PRESETS["cruise-calm"]
    with pytest.raises(PolicyError, match=r"a decision takes .* allowed are 0\.001 s"):
        rollout(policy, scenario, drawn(scenario, 2, 0).episodes, step_limit=0.001)


@pytest.mark.parametrize(("pauses", "slow"), [([0.5], False), ([0.5] * 3, True)])
def test_one_pause_of_the_machine_is_no_slow_decision(pauses, slow, monkeypatch):
    times = [0.0] * 10 + pauses + [0.001] * 20  # [s] of the decisions
    readings = itertools.accumulate(itertools.chain.from_iterable((0.0, seconds) for seconds in times))
    monkeypatch.setattr(rollout_module, "time", SimpleNamespace(perf_counter=lambda: next(readings)))
    stopwatch = Stopwatch(limit=0.1)
    with pytest.raises(PolicyError) if slow else nullcontext():
        for k in range(len(times)):
            with stopwatch:
                pass
            stopwatch.count(1, k)


CHILD = """
import os, signal, subprocess, time
signal.signal(signal.SIGTERM, signal.SIG_IGN)
child = subprocess.Popen(["sleep", "1000"])
open("pids", "w").write(f"{os.getpid()} {child.pid}")
"""
"""The beginning of a program that starts another one, which has its pipes too."""


def test_no_process_is_left_behind():
    """Not even of a program that stays when its input ends, and has started another one."""
    policy = make_policy(program(CHILD + LOOP + TELL + "while True: signal.pause()\n"))
    assert all(map(alive, pids_in("pids")))
    del policy
    gc.collect()
    wait_for(lambda: not any(map(alive, pids_in("pids"))))


@pytest.mark.parametrize("rows", [1, 4096], ids=["waits for the answer", "the question does not fit the pipe"])
def test_the_time_of_an_answer_is_bounded(rows, monkeypatch):
    policy = make_policy(program(CHILD + LOOP + TELL.rstrip() + "; time.sleep(1000)\n"))
    monkeypatch.setattr(programs, "START", 0.3)
    policy.step_limit = 0.1 / rows
    with pytest.raises(ProgramError, match=r"it has not answered for 0\.4 s"):
        policy.predict(np.ones((rows, 18)))
    wait_for(lambda: not any(map(alive, pids_in("pids"))))


@pytest.mark.slow
def test_no_process_is_left_after_evaluate_is_ended(tmp_path):
    """By SIGTERM, with the program in a worker process."""
    name = program(LOOP.replace("hello =", "import os; open(f'pid{os.getpid()}', 'w'); hello =", 1) + TELL)
    words = ["--scenario", "slow-calm", "cruise-calm", "--episodes", "500", "--jobs", "2", "--out", "out"]
    command = [sys.executable, str(ROOT / "evaluate.py"), "--policy", name, *words]
    process = subprocess.Popen(command, env={**os.environ, "PYTHONPATH": str(ROOT)}, stderr=subprocess.PIPE)
    try:
        wait_for(lambda: len(list(tmp_path.glob("pid*"))) >= 3)  # the first one is the rehearsal's
    finally:
        process.send_signal(signal.SIGTERM)
        process.communicate(timeout=30)
    pids = [int(file.name.removeprefix("pid")) for file in tmp_path.glob("pid*")]
    wait_for(lambda: not any(map(alive, pids)))


def test_its_fingerprint_is_the_command_and_the_files_that_it_names():
    """Behind "=" too, but not the files of a folder."""
    files = {"w.txt": {"cmd:x --weights=w.txt", "cmd:x w.txt"}, "model/w.txt": set(), "other.txt": set()}
    for file in files:
        Path(file).parent.mkdir(parents=True, exist_ok=True)
        Path(file).write_text("1")
    names = {"cmd:x model", "cmd:x model --option"}.union(*files.values())
    assert len({fingerprint(name) for name in names}) == len(names)
    for file, changed in files.items():
        before = {name: fingerprint(name) for name in names}
        Path(file).write_text("2")
        assert {name for name in names if fingerprint(name) != before[name]} == changed


def test_a_large_batch_passes_through_the_pipes():
    """Larger than any pipe's buffer, both ways, and in the digits that were sent."""
    text = LOOP + "    answer = {'actions': [row[:2] for row in json.loads(line)['observations']]}\n" + TELL
    policy = make_policy(program(text))
    assert isinstance(policy, ProgramPolicy)
    rows = 1.0 - np.random.default_rng(0).random((4096, 18))
    np.testing.assert_array_equal(policy.predict(rows)[0], rows[:, :2].astype(np.float32))

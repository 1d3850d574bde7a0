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
from baselines.agents.names import agent_folder, is_path
from baselines.agents.programs import ProgramError, ProgramPolicy
from baselines.evaluation import entry as evaluation
from baselines.evaluation import rollout as rollout_module
from baselines.evaluation.fingerprints import fingerprint
from baselines.evaluation.rollout import PolicyError, Stopwatch, make_env, rollout
from baselines.evaluation.runner import drawn, run_all
from baselines.tools.command_line import UsageError

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


def written():
    """Write the named blocks of the pages into the working directory."""
    for _, text in re.findall(r"^```(\w+)\n(.*?)^```$", PAGE + TUTORIAL, re.MULTILINE | re.DOTALL):
        if name := re.match(r"(?:#|//|/\*) (\w+\.\w+)", text):
            Path(name[1]).write_text(text, encoding="utf-8")


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


def gone(*pids):
    """Return whether processes end within a while."""
    for _ in range(100):
        if not any(map(alive, pids)):
            return True
        time.sleep(0.05)
    return False


@pytest.mark.parametrize("name", EXAMPLES, ids=["python", "node", "c"])
def test_the_examples_equal_the_class(name):
    if shutil.which(EXAMPLES[name]) is None:
        (pytest.fail if os.environ.get("CI") else pytest.skip)(f"{EXAMPLES[name]} is not installed")
    written()
    if EXAMPLES[name] == "cc":
        subprocess.run(COMPILED, check=True)
    scenario = PRESETS["cruise-storm"]
    episodes = drawn(scenario, 4, seed=0).episodes
    expected, found = (rollout(make_policy(p), scenario, episodes) for p in ("line_of_sight.py:LineOfSight", name))
    np.testing.assert_allclose(found.measures.steady_rmse, expected.measures.steady_rmse, rtol=1e-5)
    np.testing.assert_allclose(found.measures.effort, expected.measures.effort, rtol=1e-5)
    assert found.decision_seconds > 0


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

    first, state = starts(None, np.ones(3, dtype=bool))
    assert first == [1, 1, 1]
    assert starts(state, np.array([False, True, False]))[0] == [0, 1, 0]
    assert starts(state)[0] == [0, 0, 0]
    assert starts()[0] == [1, 1, 1]
    with pytest.raises(ValueError, match="state is of 3 vehicles, the observation of 2"):
        policy.predict(np.ones((2, 18)), state)
    with pytest.raises(ValueError, match=r"it must be \(18,\) or \(N, 18\)"):
        policy.predict(np.ones((2, 20)))


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
    "no words": ("cmd:", "there is no command after cmd:"),
    "open quotation": ("cmd:./a 'b", "No closing quotation"),
    "no such program": ("cmd:./nothing --option", r"cannot start cmd:\./nothing --option: No such file"),
    "ends": ("import sys\nsys.exit(3)", "it has ended with status 3"),
    "fails": ("1 / 0", "ended with status 1; the last line of its stderr: ZeroDivisionError"),
    "is killed": ("import os\nos.kill(os.getpid(), 9)", "ended by signal SIGKILL"),
    "is silent": ("import time\ntime.sleep(60)", "it has not answered for 0.5 s"),
    "closes": ("import os, time\nos.close(1)\ntime.sleep(60)", "closed its standard output"),
    "babbles": ("while True: print('ready')", "more than one line|'ready'|answers ready"),
    "remarks": (
        "print('ready')\nimport time\ntime.sleep(9)",
        "answers ready, which is not JSON; write other output to stderr",
    ),
    "no table": ("print(3)\ninput()\ninput()", "answers 3, which is not a JSON object"),
    "deep": ("print('[' * 10**5)\ninput()\ninput()", "which is not JSON"),
    "without end": ("import sys\nwhile True: sys.stdout.write('a' * 2**16)", "longer than 4194304 bytes"),
    "another greeting": (
        "print('{\"hello\": 1}')\ninput()\ninput()",
        "has the entry 'hello'; allowed is only 'preview'",
    ),
    "no preview": ("print('{\"preview\": [3, 2]}')\ninput()\ninput()", "preview is .*ascending"),
    "says why": (LOOP + "    answer = {'error': 'no licence'}\n" + TELL, "it reports: no licence"),
    "too many": (LOOP + "    answer['actions'] *= 2\n" + TELL, "answers 2 actions for 1 observations"),
    "no pair": (LOOP + "    answer['actions'][0] = [1]\n" + TELL, r"action 0 of 1 is \[1\]; it must be two numbers"),
    "null": (LOOP + "    answer['actions'][0] = [None, 1]\n" + TELL, r"\[null, 1\]; it must be two numbers"),
    "true": (LOOP + "    answer['actions'][0] = [True, 1]\n" + TELL, "must be two numbers"),
    "text": (LOOP + "    answer['actions'][0] = ['1', 1]\n" + TELL, "must be two numbers"),
    "more": (LOOP + "    answer['step'] = 3\n" + TELL, "it must be {'actions'"),
    "two lines": (LOOP + TELL.replace("answer)", "answer) + '\\n{}'"), "more than one line"),
}
"""Programs that do not answer as they should, or commands; and what is said of them."""


@pytest.mark.parametrize("case", WRONG)
def test_errors_are_one_line(case, monkeypatch):
    text, says = WRONG[case]
    monkeypatch.setattr(programs, "START", 0.5 if case in ("is silent", "closes") else 20.0)
    name = text if text.startswith("cmd:") else program(f"import os\nopen('pid', 'w').write(str(os.getpid()))\n{text}")
    with pytest.raises(UsageError, match=says) as caught:
        evaluation.main(
            ["--policy", name, "--scenario", "cruise-calm", "--episodes", "1", "--jobs", "1", "--out", "out"]
        )
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 700
    if Path("pid").exists():
        assert gone(int(Path("pid").read_text()))
    assert not Path("out").exists()


def test_a_failure_in_an_episode_only_affects_its_row():
    """By its end, its silence, or actions that are no numbers, in the middle of an episode."""
    late = "    if k == 50: {}\n" + TELL
    for i, what in enumerate(("sys.exit('out of fuel')", "answer = {'actions': [[float('nan'), 1e999]]}")):
        name = program(LOOP + late.format(what), f"late{i}.py")
        runs = run_all(("open-loop", name), [drawn(PRESETS["cruise-calm"], 1, 0)])
        assert runs[0].error is None
        assert ("out of fuel", "it must be two finite numbers")[i] in runs[1].error


def test_the_time_of_an_answer_is_bounded(monkeypatch):
    name = program(LOOP + "    if k == 5: import time; time.sleep(60)\n" + TELL)
    policy, scenario = make_policy(name), PRESETS["cruise-calm"]
    monkeypatch.setattr(programs, "START", 0.4)
    since = time.monotonic()
    with pytest.raises(ProgramError, match=r"has not answered for 0\.6 s"):
        rollout(policy, scenario, drawn(scenario, 2, 0).episodes, step_limit=0.1)
    assert time.monotonic() - since < 30


def test_slow_programs_are_rejected():
    name = program(LOOP + "    import time; time.sleep(0.02)\n" + TELL)
    policy, scenario = make_policy(name), PRESETS["cruise-calm"]
    with pytest.raises(Exception, match=r"a decision takes .* allowed are 0\.001 s"):
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


STUBBORN = """
import os, signal, subprocess
signal.signal(signal.SIGTERM, signal.SIG_IGN)
child = subprocess.Popen(["sleep", "1000"])
open("pids", "w").write(f"{os.getpid()} {child.pid}")
""" + LOOP + TELL + "while True: signal.pause()\n"  # fmt: skip


def test_no_process_is_left_behind():
    """Not even of a program that stays when its input ends, and has started another one."""
    policy = make_policy(program(STUBBORN))
    pids = [int(pid) for pid in Path("pids").read_text().split()]
    assert all(map(alive, pids))
    del policy
    gc.collect()
    assert gone(*pids)


SPAWNING = """
import json, os, subprocess, sys, time
for options in {}:
    child = subprocess.Popen(["sleep", "1000"], **options)
    open("pids", "a").write(f"{{os.getpid()}} {{child.pid}} ")
hello = json.loads(sys.stdin.readline())
print("{{}}", flush=True)
sys.stdin.readline()
print('{{"actions": [[0, 0]]}}', flush=True)
time.sleep(1000)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not show the environment of a process")
@pytest.mark.parametrize("rows", [1, 4096], ids=["waits for the answer", "the question does not fit the pipe"])
def test_the_time_of_an_answer_is_bounded_if_a_child_holds_the_pipes(rows, monkeypatch):
    """It has been started in the program's session, in one of its own, and by a process that has ended."""
    text = SPAWNING.format('[{"stdin": 0}, {"stdin": 0, "start_new_session": True}]')
    orphan = """subprocess.run(["sh", "-c", "setsid sleep 1000 & echo $! > orphan"], stdin=0)"""
    text = text.replace("hello =", f"{orphan}\nhello =", 1)
    policy = make_policy(program(text))
    pids = [int(pid) for file in ("pids", "orphan") for pid in Path(file).read_text().split()]
    assert all(map(alive, pids))
    monkeypatch.setattr(programs, "START", 0.3)
    policy.step_limit = 0.0
    with pytest.raises(ProgramError, match=r"it has not answered for 0\.3 s"):
        policy.predict(np.ones((rows, 18)))
    assert gone(*pids)


@pytest.mark.slow
def test_no_process_is_left_after_evaluate_is_killed(tmp_path):
    """By SIGTERM, with the program in a worker process."""
    name = program(LOOP.replace("hello =", "import os; open(f'pid{os.getpid()}', 'w'); hello =", 1) + TELL)
    command = [sys.executable, str(ROOT / "evaluate.py"), "--policy", name, "--scenario", "slow-calm", "cruise-calm"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    run = [*command, "--episodes", "500", "--jobs", "2", "--out", str(tmp_path / "out")]
    process = subprocess.Popen(run, env=environment, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
    try:
        for _ in range(3000):  # the first one is the rehearsal's
            if len(list(tmp_path.glob("pid*"))) >= 3 or process.poll() is not None:
                break
            time.sleep(0.05)
    finally:
        process.send_signal(signal.SIGTERM)
        process.wait(30)
    pids = [int(file.name.removeprefix("pid")) for file in tmp_path.glob("pid*")]
    assert len(pids) >= 3
    assert gone(*pids)


def test_its_fingerprint_is_the_command_and_its_files():
    name = program(LOOP + TELL)
    before = fingerprint(name)
    assert fingerprint(f"{name} --option") != before == fingerprint(name)
    program(LOOP + TELL + "# another\n")
    assert fingerprint(name) != before


def test_files_that_a_command_names_belong_to_its_fingerprint(tmp_path, monkeypatch):
    """Behind "=", and in a folder or the folders in it; of caches, and of what is not named, nothing does."""
    files = {
        "w.txt": "cmd:x --weights=w.txt",
        "model/deep/w.txt": "cmd:x model",
        "model/w.txt": "cmd:x --model=model",
        "model/.hidden": None,
        "model/__pycache__/x.pyc": None,
        "other.txt": None,
    }
    for file in files:
        Path(file).parent.mkdir(parents=True, exist_ok=True)
        Path(file).write_text("1")
    names = [name for name in files.values() if name]
    for file, name in files.items():
        before = {name: fingerprint(name) for name in names}
        Path(file).write_text("2")
        changed = {name for name in names if fingerprint(name) != before[name]}
        assert changed == ({name for name in names if "model" in name} if file[0] == "m" and name else {name} - {None})
    before = fingerprint("cmd:x model")
    Path("model/w.txt").rename("model/v.txt")
    assert fingerprint("cmd:x model") != before
    monkeypatch.setattr(programs, "MOST_FILES", 1)
    with pytest.raises(UsageError, match="names the folder model, which holds more than 1 files"):
        evaluation.main(["--policy", program(LOOP + TELL) + " model", "--scenario", "slow-calm", "--out", "out"])


def test_a_command_is_not_another_kind_of_path():
    for name in ("cmd:a.py:b", "cmd:model.zip", "cmd:x.onnx", "cmd:x:fade", "cmd:" + "x" * 5000):
        assert is_path(name)
        assert agent_folder(name) is None
        with pytest.raises(ProgramError, match="cannot start"):
            make_policy(name)
    with pytest.raises(ValueError, match="takes no option 'gains'"):
        make_policy("cmd:true", gains="paper")


def test_invalid_observations_are_not_sent():
    """It has seen nothing of it: its next question is the next good observation."""
    text = LOOP + "    answer = {'actions': [[k / 64, -k / 64]]}\n" + TELL
    policy = make_policy(program(text))
    row = make_env(PRESETS["slow-calm"]).reset(seed=0)[0]
    action, memory = policy.predict(row)
    np.testing.assert_array_equal(action, [1 / 64, -1 / 64])
    row[15:17] = action
    bad = row.copy()
    bad[2] = np.nan
    held, memory = policy.predict(bad, memory)
    np.testing.assert_array_equal(held, action)
    np.testing.assert_array_equal(policy.predict(row, memory)[0], [2 / 64, -2 / 64])


def test_a_large_batch_passes_through_the_pipes():
    """Larger than any pipe's buffer, both ways, and in the digits that were sent."""
    text = LOOP + "    answer = {'actions': [row[:2] for row in json.loads(line)['observations']]}\n" + TELL
    policy = make_policy(program(text))
    assert isinstance(policy, ProgramPolicy)
    rows = 1.0 - np.random.default_rng(0).random((4096, 18))
    np.testing.assert_array_equal(policy.predict(rows)[0], rows[:, :2].astype(np.float32))

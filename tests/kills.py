"""Kills and interrupts commands, and checks that they can be repeated.

`python tests/kills.py [--kills N] [--seed S]` kills trainings, evaluations and compilations at N random moments,
repeats the commands and compares the results, to the bit, with those of undisturbed commands. No process may remain.
Signals follow, once for each command. `tests/baselines/test_damage.py` has a few of them.
"""

import argparse
import csv
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
PATIENCE = 600  # [s] time limit of a command
GONE = 30  # [s] time limit for the end of all processes
IN_A_ROW = 3  # kills of a command before it runs to its end
TIMES = ("seconds", "decision_ms", "recorded")  # columns with times
IGNORING = "SIGTERM, where the parent process ignores SIGINT"
TERMINAL = "SIGINT to all processes, as from a terminal"
ENDS = {"SIGINT": signal.SIGINT, "SIGTERM": signal.SIGTERM, IGNORING: signal.SIGTERM, TERMINAL: signal.SIGINT}
"""Ways to end a command, with their signals."""


class Work(NamedTuple):
    """A command and its result."""

    words: list
    again: tuple  # further words that resume it
    result: callable  # returns the reproducible part of the result from the folder of the run


class Undisturbed(NamedTuple):
    """What an undisturbed command has done."""

    result: object
    seconds: float


def table(file):
    """Return the rows of a CSV file without times."""
    with file.open(encoding="utf-8") as stream:
        return [{k: v for k, v in row.items() if k not in TIMES} for row in csv.DictReader(stream)]


def names(folder):
    """Return the names of all files, without those of TensorBoard, one for each start."""
    files = (str(file.relative_to(folder)) for file in folder.rglob("*"))
    return sorted(name for name in files if "tfevents" not in name)


def of_training(folder):
    record = json.loads((folder / "out/agent/agent.json").read_text(encoding="utf-8"))
    del record["training"]["seconds"], record["training"]["command"]
    return names(folder / "out"), record, table(folder / "out/progress.csv")


def of_evaluation(folder):
    return names(folder / "out"), table(folder / "out/results.csv")


def of_compilation(folder):
    return sorted(file.name for file in (folder / "out").glob("*.so")), (folder / "seen").read_text(encoding="utf-8")


COMPILE = (
    "import auv_gym, gymnasium; from pathlib import Path; env = gymnasium.make('UnderactuatedAUVTrack-v0'); "
    "env.reset(seed=0); Path('seen').write_text(str(env.step([0.1, 0.2])[0].tolist()))"
)
TRAIN = "train.py --scenario cruise-calm --set n_envs=8 hidden_size=8 groups=2 --jobs 2 --timesteps 8000 --out out"
EVALUATE = "evaluate.py --scenario cruise-calm slow-calm --policy lqi helm --episodes 20 --jobs 2 --out out"
WORKS = {
    "training": Work(TRAIN.split(), ("--resume",), of_training),
    "evaluation": Work(EVALUATE.split(), ("--resume",), of_evaluation),
    "compilation": Work(["-c", COMPILE], (), of_compilation),
}


def started(kind, folder, again=False, **options):
    """Start a command in a folder; only `compilation` has an empty cache."""
    cache = {"AUV_GYM_CACHE": str(folder / "out")} if kind == "compilation" else {}
    words = [str(ROOT / word) if word.endswith(".py") else word for word in WORKS[kind].words]
    return subprocess.Popen(
        [sys.executable, *words, *(WORKS[kind].again if again else ())],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(ROOT), **cache},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        **options,
    )


def ended(process):
    """Wait for a command, and return its exit status and its last line; raise AssertionError for a traceback."""
    _, err = process.communicate(timeout=PATIENCE)
    assert "Traceback" not in err, err
    return process.returncode, (err.splitlines() or [""])[-1]


def left(folder):
    """Return the processes that work in a folder."""
    pids = []
    for place in Path("/proc").glob("[0-9]*/cwd"):
        with suppress(OSError):
            if place.resolve() == folder.resolve():
                pids.append(int(place.parent.name))
    return pids


def none_left(folder):
    """Wait until no process works in a folder; raise AssertionError if one does not end."""
    end = time.monotonic() + GONE
    while pids := left(folder):
        assert time.monotonic() < end, f"processes are left: {pids}"
        time.sleep(0.1)


@contextmanager
def place():
    """Yield an empty folder, and check at the end that no process works in it."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        try:
            yield Path(folder)
            none_left(Path(folder))
        finally:
            for pid in left(Path(folder)):
                with suppress(OSError):
                    os.kill(pid, signal.SIGKILL)


def undisturbed(kind):
    """Run a command without a fault."""
    with place() as folder:
        begin = time.monotonic()
        status, line = ended(started(kind, folder))
        assert status == 0, line
        return Undisturbed(WORKS[kind].result(folder), time.monotonic() - begin)


def lost(folder):
    """Return the number of validations of a training after its last checkpoint."""
    from baselines.training.run_folder import read_checkpoint, read_progress

    steps = [row["timesteps"] for row in read_progress(folder) if "score" in row]
    kept = read_checkpoint(folder)["state"]["timesteps"] if (folder / "checkpoint.pt").exists() else -1
    return sum(step > kept for step in steps)


def check_result(kind, folder, whole, when):
    """Run a command to its end; raise AssertionError if its result is not that of the undisturbed command."""
    status, line = ended(started(kind, folder, again=True))
    assert status == 0, (status, line)
    result = WORKS[kind].result(folder)
    parts = [(str(a)[:300], str(b)[:300]) for a, b in zip(result, whole.result, strict=True) if a != b]
    assert not parts, f"{kind} {when}: {parts}"


def killed(kind, kills, rng, whole):
    """Kill a command several times, each at a random moment, run it to its end, and compare the results."""
    with place() as folder:
        moments = []
        for number in range(kills):
            moments.append(rng.uniform(0, whole.seconds if number == 0 else whole.seconds / 2))
            process = started(kind, folder, again=number > 0)
            with suppress(subprocess.TimeoutExpired):
                process.wait(moments[-1])
            process.kill()
            process.communicate()
            none_left(folder)
            if kind == "training":
                assert lost(folder / "out") <= 1, "more than one checkpoint is lost"
        check_result(kind, folder, whole, f"after kills at {[round(m, 1) for m in moments]} s")


def interrupted(kind, end, rng, whole):
    """End a command by a signal; a terminal sends it to all processes, others to the first one."""
    with place() as folder:
        ignore = {"preexec_fn": lambda: signal.signal(signal.SIGINT, signal.SIG_IGN)} if end == IGNORING else {}
        process = started(kind, folder, **ignore)
        with suppress(subprocess.TimeoutExpired):
            process.wait(rng.uniform(0.3, 0.8) * whole.seconds)
        if end == TERMINAL:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, ENDS[end])
        else:
            process.send_signal(ENDS[end])
        _, err = process.communicate(timeout=PATIENCE)
        if kind != "compilation":  # a script of the user's, which ends with a traceback
            assert "Traceback" not in err, err
            assert process.returncode == 0 or "interrupted" in err, err
        none_left(folder)
        check_result(kind, folder, whole, f"after {end}")


def main():
    """Run all faults and print their numbers; the exit status is 1 if a check fails."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--quick", action="store_true", help="one kill of a command before it runs to its end")
    options = parser.parse_args()
    rng, counts, wrong = random.Random(options.seed), {}, []
    wholes = {kind: undisturbed(kind) for kind in WORKS}

    def tried(what, amount, check, *arguments):
        counts[what] = counts.get(what, 0) + amount
        try:
            check(*arguments)
        except (AssertionError, OSError, subprocess.SubprocessError) as error:
            wrong.append(f"{what}: {error}")
            print(wrong[-1], flush=True)

    done, turn = 0, 0
    while done < options.kills:
        kind = [*WORKS][turn % len(WORKS)]
        kills = min(1 if options.quick else IN_A_ROW, options.kills - done)
        tried(f"{kind}, kill -9", kills, killed, kind, kills, rng, wholes[kind])
        done, turn = done + kills, turn + 1
    for kind, whole in wholes.items():
        for end in ENDS:
            tried(f"{kind}, {end}", 1, interrupted, kind, end, rng, whole)
    for what, count in counts.items():
        print(f"{what}: {count}, {sum(line.startswith(f'{what}:') for line in wrong)} failures")
    print(f"{sum(counts.values())} faults, {len(wrong)} failures")
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()

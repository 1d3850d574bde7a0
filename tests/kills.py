"""Kills and interrupts commands, fills their disk, runs them twice at once, and checks that they can be repeated.

`python tests/kills.py [--kills N] [--seed S]` kills trainings, evaluations, recordings of datasets and compilations
at N random moments, repeats the commands and compares the results, to the bit, with those of undisturbed commands. The
other faults follow, once for each command. `tests/baselines/test_kills.py` has a few kills.
"""

import argparse
import csv
import hashlib
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
PATIENCE = 600  # [s] time limit of a command
GONE = 30  # [s] time limit for the end of all processes
IN_A_ROW = 3  # kills of a command before it runs to its end
TIMES = ("seconds", "decision_ms", "recorded")  # columns with times


@dataclass(frozen=True)
class Work:
    """A command and its result.

    Attributes:
        words: the command.
        again: further words that resume it.
        result: returns the reproducible part of the result from the folder of the run.
    """

    words: list
    again: tuple
    result: callable


def table(file):
    """Return the rows of a CSV file without times."""
    with file.open(encoding="utf-8") as stream:
        return [{k: v for k, v in row.items() if k not in TIMES} for row in csv.DictReader(stream)]


def names(folder):
    """Return the names of all files, without those of TensorBoard, one for each start, and of unfinished datasets.

    A later command removes unfinished datasets after an hour.
    """
    files = (str(file.relative_to(folder)) for file in folder.rglob("*"))
    return sorted(name for name in files if "tfevents" not in name and not name.startswith(".unfinished-"))


def of_training(folder):
    record = json.loads((folder / "out/agent/agent.json").read_text(encoding="utf-8"))
    del record["training"]["seconds"], record["training"]["command"]
    return names(folder / "out"), record, table(folder / "out/progress.csv")


def of_evaluation(folder):
    return names(folder / "out"), table(folder / "out/results.csv")


def of_dataset(folder):
    import h5py

    digest = hashlib.sha256()
    with h5py.File(folder / "out/auv/kept-v0/data/main_data.hdf5") as file:
        file.visititems(
            lambda name, x: digest.update(name.encode() + (x[()].tobytes() if hasattr(x, "dtype") else b""))
        )
    return names(folder / "out"), digest.hexdigest()


def of_compilation(folder):
    return sorted(file.name for file in (folder / "out").glob("*.so")), (folder / "seen").read_text(encoding="utf-8")


COMPILE = (
    "import auv_gym, gymnasium; from pathlib import Path; env = gymnasium.make('UnderactuatedAUVTrack-v0'); "
    "env.reset(seed=0); Path('seen').write_text(str(env.step([0.1, 0.2])[0].tolist()))"
)
TRAIN = "train.py --scenario cruise-calm --set n_envs=8 hidden_size=8 groups=2 --jobs 2 --timesteps 8000 --out out"
EVALUATE = "evaluate.py --scenario cruise-calm slow-calm --policy lqi helm --episodes 20 --jobs 2 --out out"
RECORD = "-m baselines dataset --scenario cruise-calm --episodes 40 --id auv/kept-v0 --out out"
WORKS = {
    "training": Work(TRAIN.split(), ("--resume",), of_training),
    "evaluation": Work(EVALUATE.split(), ("--resume",), of_evaluation),
    "dataset": Work(RECORD.split(), (), of_dataset),
    "compilation": Work(["-c", COMPILE], (), of_compilation),
}


def started(kind, folder, again, **options):
    """Start a command in a folder; only `compilation` has an empty cache."""
    own = {"AUV_GYM_CACHE": str(folder / "out")} if kind == "compilation" else {}
    words = [str(ROOT / word) if word.endswith(".py") else word for word in WORKS[kind].words]
    return subprocess.Popen(
        [sys.executable, *words, *(WORKS[kind].again if again else ())],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(ROOT), **own},
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
    found = []
    for place in Path("/proc").glob("[0-9]*/cwd"):
        with suppress(OSError):
            if place.resolve() == folder.resolve():
                found.append(int(place.parent.name))
    return found


def none_left(folder):
    """Wait until no process works in a folder; raise AssertionError if one does not end."""
    end = time.monotonic() + GONE
    while found := left(folder):
        assert time.monotonic() < end, f"processes are left: {found}"
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
    """Return the result of an undisturbed command, its duration [s] and the number of bytes that it writes."""
    with place() as folder:
        begin = time.monotonic()
        status, line = ended(started(kind, folder, again=False))
        assert status == 0, line
        size = sum(file.stat().st_size for file in (folder / "out").rglob("*"))
        return WORKS[kind].result(folder), time.monotonic() - begin, size


def lost(folder):
    """Return the number of validations of a training after its last checkpoint."""
    from baselines.training.checkpoint import unpacked
    from baselines.training.run_folder import read_progress

    steps = [row["timesteps"] for row in read_progress(folder) if "score" in row]
    file = folder / "checkpoint.pt"
    kept = unpacked(file.read_bytes())["timesteps"] if file.exists() else -1
    return sum(step > kept for step in steps)


def finished(kind, folder, again=True):
    """Run a command to its end and return its result."""
    status, line = ended(started(kind, folder, again))
    assert status == 0 or "exists; choose another --id" in line, (status, line)  # a dataset was complete already
    return WORKS[kind].result(folder)


def killed(kind, kills, rng, whole):
    """Kill a command several times, each at a random moment, run it to its end, and compare the results."""
    expected, seconds, _ = whole
    with place() as folder:
        moments = []
        for number in range(kills):
            moments.append(rng.uniform(0, seconds if number == 0 else seconds / 2))
            process = started(kind, folder, again=number > 0)
            with suppress(subprocess.TimeoutExpired):
                process.wait(moments[-1])
            process.kill()
            process.communicate()
            none_left(folder)
            if kind == "training":
                assert lost(folder / "out") <= 1, "more than one checkpoint is lost"
        assert_same(kind, finished(kind, folder), expected, f"after kills at {[round(m, 1) for m in moments]} s")


def assert_same(kind, found, expected, when):
    assert found == expected, f"{kind} {when}: {difference(found, expected)}"


def difference(found, expected):
    """Return the first parts of two results that differ."""
    for own, other in zip(found, expected, strict=True):
        if own != other:
            if isinstance(own, list):
                return [x for x in own if x not in other][:3], [x for x in other if x not in own][:3]
            return str(own)[:300], str(other)[:300]
    return None


def interrupted(kind, end, ignoring, rng, whole):
    """End a command by a signal, with or without a parent that ignores SIGINT."""
    expected, seconds, _ = whole
    with place() as folder:
        ignore = (lambda: signal.signal(signal.SIGINT, signal.SIG_IGN)) if ignoring else None
        process = started(kind, folder, again=False, preexec_fn=ignore)
        with suppress(subprocess.TimeoutExpired):
            process.wait(rng.uniform(0.3, 0.8) * seconds)
        process.send_signal(end)
        ended(process)
        none_left(folder)
        assert_same(kind, finished(kind, folder), expected, f"after {end.name}")


@contextmanager
def disk(folder, size):
    """Mount a file system of `size` bytes at a folder."""
    folder.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"mode=700,size={size // 1024 + 1}k", "none", folder], check=True)
    try:
        yield
    finally:
        subprocess.run(["umount", "-l", folder], check=True)


def without_space(kind, fraction, whole):
    """Run a command on a disk that becomes full, and again with more space."""
    expected, _, size = whole
    with place() as folder, disk(folder / "out", int(fraction * size)):
        status, line = ended(started(kind, folder, again=False))
        assert status != 0 or kind == "compilation", "it has not noticed that the disk is full"  # that runs elsewhere
        subprocess.run(["mount", "-o", "remount,size=1g", folder / "out"], check=True)
        assert_same(kind, finished(kind, folder), expected, f"after a full disk ({line})")


def read_only(kind, whole):
    """Run a command on a read-only disk, and again on a writable one."""
    expected, _, _ = whole
    with place() as folder, disk(folder / "out", 2**30):
        subprocess.run(["mount", "-o", "remount,ro", folder / "out"], check=True)
        status, line = ended(started(kind, folder, again=False))
        assert status != 0 or kind == "compilation", "it has not noticed that nothing can be written"
        subprocess.run(["mount", "-o", "remount,rw", folder / "out"], check=True)
        assert_same(kind, finished(kind, folder, again=False), expected, f"after a disk to read only ({line})")


def twice(kind, whole):
    """Run a command twice at the same time; one of them may be refused."""
    expected, _, _ = whole
    with place() as folder:
        both = [started(kind, folder, again=False) for _ in range(2)]
        ends = [ended(process) for process in both]
        assert any(status == 0 for status, _ in ends), ends
        assert_same(kind, WORKS[kind].result(folder), expected, f"twice at once ({ends})")


def main():
    """Run all faults and print their numbers; the exit status is 1 if a check fails."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--quick", action="store_true", help="only kills, of the shortest commands")
    options = parser.parse_args()
    rng, counts, wrong = random.Random(options.seed), {}, []
    kinds = ["evaluation", "dataset", "compilation"] if options.quick else [*WORKS]
    wholes = {kind: undisturbed(kind) for kind in kinds}

    def tried(what, amount, check, *arguments):
        counts[what] = counts.get(what, 0) + amount
        try:
            check(*arguments)
        except (AssertionError, OSError, subprocess.SubprocessError) as error:
            wrong.append(f"{what}: {error}")
            print(wrong[-1], flush=True)

    done, turn = 0, 0
    while done < options.kills:
        kind, kills = kinds[turn % len(kinds)], min(1 if options.quick else IN_A_ROW, options.kills - done)
        tried(f"{kind}, kill -9", kills, killed, kind, kills, rng, wholes[kind])
        done, turn = done + kills, turn + 1
    for kind in () if options.quick else kinds:
        for end, ignoring in ((signal.SIGINT, False), (signal.SIGTERM, False), (signal.SIGTERM, True)):
            name = f"{kind}, {end.name}{', SIGINT ignored' if ignoring else ''}"
            tried(name, 1, interrupted, kind, end, ignoring, rng, wholes[kind])
        tried(f"{kind}, twice at once", 1, twice, kind, wholes[kind])
        if os.geteuid() == 0:
            for fraction in (0.05, 0.4, 0.8):
                tried(f"{kind}, full disk", 1, without_space, kind, fraction, wholes[kind])
            tried(f"{kind}, read-only disk", 1, read_only, kind, wholes[kind])
    for what, count in counts.items():
        print(f"{what}: {count}, {sum(line.startswith(f'{what}:') for line in wrong)} failures")
    print(f"{sum(counts.values())} faults, {len(wrong)} failures")
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()

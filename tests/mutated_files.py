"""Damages files of every format at random, and checks that they are refused in one line, little time and memory.

`python tests/mutated_files.py [FORMAT ...] [--count N] [--seed S]` reads N damaged files of each format, each in a
process of its own, and prints what went wrong. `tests/baselines/test_mutated_files.py` reads a few.
"""

import argparse
import bz2
import hashlib
import io
import json
import os
import random
import re
import resource
import shutil
import signal
import struct
import sys
import tempfile
import time
import traceback
import warnings
import zipfile
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[1]
BOMB = 2**28  # [bytes]
SECONDS = 1.0  # of processor time that a file may take
MEMORY = 200  # [MiB] that it may take
LONGEST = 3000  # characters of a message
PATIENCE = 20  # [s] until a process is killed
ALLOWED = 4096  # [MiB] of address space, so that a bomb does not take the machine down
ODD = (
    "1e999",
    "-1",
    "0",
    "NaN",
    '"x"',
    "[]",
    "{}",
    "true",
    "null",
    "9" * 400,
    "1e-320",
    "1e20",
    "[[[]]]",
    '"\\ud800"',
    "2",
    "[1, 2]",
)
"""What stands in the place of a number or a word."""


# What is done to bytes.


def cut(data, rng):
    return data[: rng.randrange(len(data))]


def flipped(data, rng):
    damaged = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 8))):
        bit = rng.randrange(8 * len(data))
        damaged[bit // 8] ^= 1 << bit % 8
    return bytes(damaged)


def spliced(data, rng):
    """A part is left out, or stands there twice, or zeros or noise stand in its place."""
    a, b = sorted(rng.randrange(len(data) + 1) for _ in range(2))
    b = min(b, a + rng.choice((1, 10, 1000)))
    return data[:a] + rng.choice((b"", 2 * data[a:b], bytes(b - a), rng.randbytes(b - a))) + data[b:]


def appended(data, rng):
    return data + rng.choice((b"\0", b"\xff\xfe", data, rng.randbytes(100)))


BYTES = (cut, flipped, spliced, appended)


# What is done to text.

LARGE = (
    lambda n: "9" * n,
    lambda n: '"' + "a" * n + '"',
    lambda n: "[" + "1," * (n // 2) + "1]",
    lambda n: "[" + "[]," * (n // 3) + "1]",
    lambda n: "[" * n + "]" * n,
    lambda n: "[" * n,
    lambda n: '{"a":' * (n // 6) + "1" + "}" * (n // 6),
    lambda n: "{" + ",".join(f'"{k}":1' for k in range(n // 8)) + "}",
    lambda n: "a." * (n // 2) + "a",
    lambda n: "[a]\n" * (n // 4),
    lambda n: "\n" * n,
    lambda n: "&a [*a, *a]\n" * (n // 12),
)
"""Values of about n characters."""
SIZES = (60, 1000, 100_000, 1_000_000, 10_000_000)


def odd(rng):
    """Return a value that is seldom what it should be."""
    return rng.choice(LARGE)(rng.choice(SIZES)) if rng.random() < 0.2 else rng.choice(ODD)


def odd_value(data, rng):
    """Another value stands behind a name, or in a list or a column."""
    tokens = [*re.finditer(rb'(?<=[=:,\[\s])(?:[-+]?\d[\d.e+-]*|"[^"\n]*"|true|false|null)(?=\s*[,\]}\n])', data)]
    if not tokens:
        return cut(data, rng)
    token = rng.choice(tokens)
    return data[: token.start()] + odd(rng).encode() + data[token.end() :]


def other_value(data, rng):
    """One value of the file stands in the place of another one."""
    tokens = [*re.finditer(rb'[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?|"[^"\n]*"|\w+', data)]
    if not tokens:
        return cut(data, rng)
    token, other = rng.choice(tokens), rng.choice(tokens)
    return data[: token.start()] + other[0] + data[token.end() :]


def doubled_line(data, rng):
    lines = data.splitlines(keepends=True) or [b""]
    k = rng.randrange(len(lines))
    return b"".join((*lines[: k + 1], lines[k], *lines[k + 1 :]))


def huge(data, rng):
    """There is nothing but a large value, or it stands somewhere."""
    value, place = rng.choice(LARGE)(rng.choice(SIZES)).encode(), rng.randrange(len(data))
    return rng.choice((value, b"a = " + value, b"a: " + value, data[:place] + value + data[place:]))


TEXT = (*BYTES, odd_value, odd_value, odd_value, odd_value, other_value, other_value, doubled_line, huge)


def odd_entry(data, rng):
    """An entry of a JSON file is another value, or one more stands there, or the same one twice."""
    record, place = json.loads(data), None
    tables = [record]
    for table in tables:  # which grow
        tables += [
            x for x in (table.values() if isinstance(table, dict) else table) if isinstance(x, (dict, list)) and x
        ]
    table, mark = rng.choice(tables), "@"
    if isinstance(table, dict):
        place = rng.choice([*table, *table, "more"])
        table[place] = mark
    else:
        table[rng.randrange(len(table))] = mark
    text, value = json.dumps(record), odd(rng)
    if place in record and rng.random() < 0.2:
        value = f'{value}, "{place}": {value}'
    return text.replace(f'"{mark}"', value).encode()


JSON = (*TEXT, *[odd_entry] * 8)


# What is done to archives of arrays: their content, so that every sum of the archive is right.


def odd_member(data, rng):
    """An array is of another type, shape or size, or holds what is no number; a record has an odd entry."""
    with np.load(io.BytesIO(data)) as archive:
        arrays = {name: archive[name] for name in archive.files}
    name = rng.choice([*arrays, "record"])
    array = arrays[name]
    if name == "record":
        text = odd_entry(str(array).encode(), rng).decode(errors="replace")
        arrays[name] = np.array(rng.choice((text, text, "[]", "1", "[" * 100_000, '{"policy": ' + "9" * 5000 + "}")))
    else:
        arrays[name] = rng.choice(
            (
                array[:0],
                array.ravel()[:1],
                np.zeros(()),
                np.full(array.shape, np.nan),
                np.full(array.shape, -1e300),
                array.astype("U8"),
                array.astype(complex),
                np.concatenate((array, array)),
                np.zeros(10**7, dtype=np.int8),
            )
        )
        if rng.random() < 0.1:
            del arrays[name]
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    return buffer.getvalue()


@cache
def _bomb(name, method):
    """Return an archive whose one array unpacks to `BOMB` bytes."""
    text = f"{{'descr': '|i1', 'fortran_order': False, 'shape': ({BOMB},), }}\n"
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", method) as archive, archive.open(name, "w") as member:
        member.write(np.lib.format.magic(1, 0) + struct.pack("<H", len(text)) + text.encode())
        for _ in range(BOMB // 2**22):
            member.write(bytes(2**22))
    return buffer.getvalue()


def bomb(data, rng):
    """An archive is a few kilobytes that unpack to `BOMB`, and perhaps say that they are few."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        name = rng.choice(archive.namelist())
    made = bytearray(_bomb(name, rng.choice((zipfile.ZIP_DEFLATED, zipfile.ZIP_LZMA, zipfile.ZIP_BZIP2))))
    if rng.random() < 0.7:  # both of its headers
        for mark, place in ((b"PK\3\4", 22), (b"PK\1\2", 24)):
            at = made.rindex(mark) + place
            made[at : at + 4] = struct.pack("<I", 1000)
    return bytes(made)


def huge_shape(data, rng):
    """An array says that it is larger than any memory."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    name = rng.choice([*members])
    shape = b"'shape': (%d,), " % rng.choice((10**9, 10**15, 2**63))
    members[name] = re.sub(rb"'shape': \([^)]*\), ", shape, members[name])
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for member, content in members.items():
            archive.writestr(member, content)
    return buffer.getvalue()


ARCHIVE = (*BYTES, odd_member, odd_member, odd_member, bomb, huge_shape)


# Of each format a whole file, and what reads it.


@dataclass(frozen=True)
class Format:
    """A kind of file.

    Attributes:
        make: writes whole files to a folder and returns the one that is damaged.
        read: reads what `make` has written, as a command does.
        mutations: what may happen to it.
        mend: changes other files so that the damaged one is what they describe.
    """

    make: callable
    read: callable
    mutations: tuple
    mend: callable = lambda file, rng: None


def scenario(suffix):
    """Return a maker of a scenario's file, with an entry of each part."""

    def make(folder):
        from auv_gym import PRESETS, Scenario

        parts = {"sensors": {"low_pass": 1.0, "outages": 1.0, "reckoning": {"drift": 1e-5}}, "start": {"x_e": [-1, 1]}}
        path = {"family": "spline", "waypoints": [[0, 0], [100, 20], [300, 0]], "speed": 1.0}
        whole = {**PRESETS["cruise-storm"].to_dict(), **parts, "path": path}
        Scenario.from_dict(whole).save(folder / f"scenario{suffix}")
        return folder / f"scenario{suffix}"

    return make


def read_scenario(file):
    from auv_gym import Scenario

    Scenario.load(file)


def vehicle(folder):
    from auv_gym.scenarios.vehicles import VEHICLES_FOLDER

    return Path(shutil.copy(VEHICLES_FOLDER / "remus100.toml", folder))


def read_vehicle(file):
    from auv_gym.scenarios.vehicles import VehicleModel

    VehicleModel.load(file)


def log(folder):
    return Path(shutil.copy(ROOT / "docs" / "tutorials" / "otter.csv", folder))


def read_log(file):
    from baselines.identification.log import Log

    Log.load(file)


def agent(name):
    """Return a maker of an agent's folder, in which a file is damaged."""

    def make(folder):
        from baselines.agents.names import SHIPPED_FOLDER

        shutil.copytree(SHIPPED_FOLDER / "apg-cruise", folder / "agent")
        return folder / "agent" / name

    return make


def read_agent(file):
    from baselines import make_policy

    make_policy(str(file.parent))


def described(file, rng):
    """Make the description that of the damaged weights, two times out of three."""
    if rng.random() < 2 / 3:
        description = file.with_name("agent.json")
        record = json.loads(description.read_text())
        record["weights_sha256"] = hashlib.sha256(file.read_bytes()).hexdigest()
        description.write_text(json.dumps(record))


def suite(folder):
    from auv_gym import PRESETS
    from baselines.evaluation.runner import drawn
    from baselines.evaluation.suites import save_suite

    save_suite(
        "small", [drawn(replace(PRESETS[name], steps=20), 2, 0) for name in ("cruise-storm", "slow-calm")], folder
    )
    return folder / "small.json.bz2"


def read_suite(file):
    from baselines.evaluation.suites import _loaded, load_suite

    _loaded.cache_clear()
    load_suite("small", file.parent)


def unpacked(mutate):
    """Return a mutation of what a compressed text unpacks to."""
    return lambda data, rng: bz2.compress(mutate(bz2.decompress(data), rng))


def bz2_bomb(data, rng):
    return bz2.compress(bytes(2**22)) * (BOMB // 2**22)


def summed(file, rng):
    """Write down the hash of the damaged file, two times out of three."""
    if rng.random() < 2 / 3:
        with suppress(OSError, EOFError, ValueError):
            content = bz2.BZ2Decompressor().decompress(file.read_bytes(), 2**25)
            file.with_name("SHA256SUMS").write_text(f"{hashlib.sha256(content).hexdigest()}  small.json\n")


def recorded(folder):
    from baselines.evaluation.recorded import RECORDED_FOLDER
    from baselines.evaluation.suites import load_suite

    load_suite("benchmark-v1")
    (folder / "benchmark-v1").mkdir()
    return Path(shutil.copy(RECORDED_FOLDER / "benchmark-v1" / "backstepping.npz", folder / "benchmark-v1"))


def read_recorded(file):
    from baselines.evaluation import recorded as rows
    from baselines.evaluation.suites import load_suite

    rows.read_recorded(load_suite("benchmark-v1"), "backstepping", file.parent.parent)


def row(folder):
    from auv_gym import PRESETS
    from baselines.evaluation.rows import RowStore
    from baselines.evaluation.runner import drawn, run_all
    from baselines.tools.workers import Workers

    cell = drawn(replace(PRESETS["cruise-calm"], steps=20), 2, 0)
    [run] = run_all(["backstepping"], [cell], Workers(1))
    RowStore(folder).save(run)
    return folder / f"{run.key}.npz"


def read_row(file):
    """One that is damaged does not count, so the episodes run again."""
    from baselines.evaluation.rows import RowStore

    RowStore(file.parent).load(file.stem)


def submission(folder):
    from baselines.evaluation.suites import load_suite

    load_suite("benchmark-v2")
    return Path(shutil.copy(ROOT / "leaderboard" / "benchmark-v2" / "backstepping.npz", folder))


def read_submission(file):
    from baselines.evaluation.submission.files import read_submission as read

    read(file)


def run_folder(name):
    """Return a maker of a training's folder, in which a file is damaged."""

    def make(folder):
        import torch

        run = _training(folder)
        run.log(10, score=0.5)
        run.save_checkpoint({"timesteps": 10, "weights": torch.arange(100.0)})
        run.close()
        return folder / name

    return make


def _training(folder):
    from auv_gym import PRESETS
    from baselines.training.config import Config
    from baselines.training.run_folder import RunFolder

    return RunFolder(Config("ppo", ((PRESETS["cruise-calm"], 1.0),)), folder)


def read_run_folder(file):
    _training(file.parent).load_checkpoint()


def hyperparameters(folder):
    from baselines.training.hyperparameters import shipped

    return Path(shutil.copy(shipped("apg"), folder))


def read_hyperparameters(file):
    from baselines.training.hyperparameters import load_hyperparameters

    load_hyperparameters(file)


FORMATS = {
    "scenario.toml": Format(scenario(".toml"), read_scenario, TEXT),
    "scenario.json": Format(scenario(".json"), read_scenario, JSON),
    "vehicle.toml": Format(vehicle, read_vehicle, TEXT),
    "log.csv": Format(log, read_log, TEXT),
    "agent.json": Format(agent("agent.json"), read_agent, JSON),
    "weights.safetensors": Format(agent("weights.safetensors"), read_agent, (*BYTES, odd_value), described),
    "suite.json.bz2": Format(suite, read_suite, (*BYTES, bz2_bomb, *map(unpacked, JSON)), summed),
    "recorded.npz": Format(recorded, read_recorded, ARCHIVE),
    "row.npz": Format(row, read_row, ARCHIVE),
    "submission.npz": Format(submission, read_submission, ARCHIVE),
    "checkpoint.pt": Format(run_folder("checkpoint.pt"), read_run_folder, BYTES),
    "config.json": Format(run_folder("config.json"), read_run_folder, JSON),
    "progress.csv": Format(run_folder("progress.csv"), read_run_folder, TEXT),
    "hyperparameters.yml": Format(hyperparameters, read_hyperparameters, TEXT),
}


# One file at a time.


def verdict(kind, file):
    """Read a file in a process of its own; return what was wrong about that, and whether it was refused.

    The process is a fork of this one, so that what it imports is there already.
    """
    receive, send = os.pipe()
    if (child := os.fork()) == 0:
        try:
            os.close(receive)
            os.write(send, json.dumps(_read(kind, file)).encode()[:60_000])
        finally:
            os._exit(0)
    os.close(send)
    signal.alarm(PATIENCE)
    try:
        with os.fdopen(receive, "rb") as answer:
            told = answer.read()
    except TimeoutError:
        os.kill(child, signal.SIGKILL)
        told = json.dumps([f"it is not done after {PATIENCE} s", False]).encode()
    finally:
        signal.alarm(0)
        _, status = os.waitpid(child, 0)
    return json.loads(told) if told else (f"the process ends with status {status}", False)


def _alarm(*_):
    raise TimeoutError


def _peak():
    """Return the most memory that this process has had [MiB]."""
    return int(re.search(r"VmHWM:\s*(\d+)", Path("/proc/self/status").read_text())[1]) / 1024


def _read(kind, file):
    resource.setrlimit(resource.RLIMIT_AS, (ALLOWED * 2**20, ALLOWED * 2**20))
    before, start, message, wrong = _peak(), time.process_time(), None, ""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            FORMATS[kind].read(file)
    except REFUSALS as error:
        message = str(error)
        if "\n" in message or len(message) > LONGEST:
            wrong = f"the reason has {len(message)} characters and {message.count(chr(10)) + 1} lines: {message[:300]}"
    except Exception:  # noqa: BLE001
        wrong = traceback.format_exc(-6)
    seconds, memory = time.process_time() - start, _peak() - before
    if seconds > SECONDS or memory > MEMORY:
        wrong += f" it takes {seconds:.2f} s and {memory:.0f} MiB; {message and message[:200]}"
    return wrong, message is not None


def tried(kind, count, seed):
    """Read damaged files; return how many were refused, and what went wrong with which of them."""
    rng, wrong, refused = random.Random(seed), [], 0
    with tempfile.TemporaryDirectory() as folder:
        file = FORMATS[kind].make(Path(folder))
        FORMATS[kind].read(file)  # imports what it needs, and shows that it takes whole files
        whole = {path: path.read_bytes() for path in Path(folder).rglob("*") if path.is_file()}
        for number in range(count):
            mutate = rng.choice(FORMATS[kind].mutations)
            damaged = mutate(whole[file], rng)
            file.write_bytes(damaged)
            FORMATS[kind].mend(file, rng)
            says, taken = verdict(kind, file)
            refused += taken
            if says:
                wrong.append(f"{kind} {number}, {getattr(mutate, '__name__', mutate)}, {len(damaged)} bytes: {says}")
            for path, content in whole.items():
                path.write_bytes(content)
    return refused, wrong


def main():
    """Read damaged files of some formats and print what was wrong."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("formats", nargs="*", metavar="FORMAT", help=", ".join(FORMATS))
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    failures = 0
    for kind in options.formats or FORMATS:
        refused, wrong = tried(kind, options.count, options.seed)
        failures += len(wrong)
        print(f"{kind}: {options.count} damaged files, {refused} refused, {len(wrong)} failures", flush=True)
        for line in wrong:
            print(f"  {line}", flush=True)
    sys.exit(failures > 0)


if __name__ == "__main__":
    from baselines.tools.command_line import UsageError
    from baselines.training.run_folder import TrainingError

    REFUSALS = (OSError, ValueError, UsageError, TrainingError)
    signal.signal(signal.SIGALRM, _alarm)
    main()

"""Damages files that a user may get from others, and checks that each is read, or refused with an error of one line.

`python tests/mutated_files.py [FORMAT ...] [--count N] [--seed S]` reads N damaged files of each format and prints what
went wrong. `tests/baselines/test_damage.py` reads a few.
"""

import argparse
import hashlib
import io
import json
import random
import re
import shutil
import sys
import tempfile
import traceback
import warnings
from dataclasses import replace
from importlib import import_module
from operator import attrgetter
from pathlib import Path
from typing import NamedTuple

import numpy as np

ROOT = Path(__file__).parents[1]
LONGEST = 3000  # characters of a message
ODD = (
    *("1e999", "-1", "0", "NaN", '"x"', "[]", "{}", "true", "null", "9" * 400, "1e-320", "1e20", "[[[]]]", "2"),
    *("[1, 2]", '"\\ud800"'),
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


def odd_value(data, rng):
    """Another value stands behind a name, or in a list or a column."""
    tokens = [*re.finditer(rb'(?<=[=:,\[\s])(?:[-+]?\d[\d.e+-]*|"[^"\n]*"|true|false|null)(?=\s*[,\]}\n])', data)]
    if not tokens:
        return cut(data, rng)
    token = rng.choice(tokens)
    return data[: token.start()] + rng.choice(ODD).encode() + data[token.end() :]


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


TEXT = (*BYTES, odd_value, odd_value, odd_value, odd_value, other_value, other_value, doubled_line)


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
    text, value = json.dumps(record), rng.choice(ODD)
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
        arrays[name] = np.array(rng.choice((text, text, "[]", "1")))
    else:
        full = [np.full(array.shape, value) for value in (np.nan, -1e300)]
        types = [array.astype("U8"), array.astype(complex)]
        arrays[name] = rng.choice([array[:0], array.ravel()[:1], np.concatenate((array, array)), *full, *types])
        if rng.random() < 0.1:
            del arrays[name]
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    return buffer.getvalue()


ARCHIVE = (*BYTES, odd_member, odd_member, odd_member)


# Of each format a whole file, and what reads it.


class Format(NamedTuple):
    """A kind of file."""

    make: callable  # writes whole files to a folder and returns the one that is damaged
    read: callable  # reads what `make` has written, as a command does
    mutations: tuple  # what may happen to it
    mend: callable = lambda file, rng: None  # changes other files so that the damaged one is what they describe


def copied(place):
    """Return a maker that copies a file of the repository."""
    return lambda folder: Path(shutil.copy(ROOT / place, folder))


def reader(module, function):
    """Return a function of a module that reads a file; the module is imported at the first call."""

    def read(file):
        attrgetter(function)(import_module(module))(file)

    return read


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


def agent(name):
    """Return a maker of an agent's folder, in which a file is damaged."""

    def make(folder):
        shutil.copytree(ROOT / "baselines/agents/shipped/ppo-cruise", folder / "agent")
        return folder / "agent" / name

    return make


def model(folder):
    import gymnasium as gym
    import stable_baselines3 as sb3

    env = gym.make("auv_gym:UnderactuatedAUVTrack-v0")
    sb3.PPO("MlpPolicy", env, device="cpu", policy_kwargs={"net_arch": [4]}).save(folder / "model.zip")
    return folder / "model.zip"


def onnx(folder):
    from baselines.export.onnx_model import onnx_model
    from baselines.export.parts import exported

    (folder / "model.onnx").write_bytes(onnx_model(exported("ppo-cruise")).SerializeToString())
    return folder / "model.onnx"


def read_policy(file):
    from baselines import make_policy

    make_policy(str(file if file.stem == "model" else file.parent))


def described(file, rng):
    """Make the description that of the damaged weights, two times out of three."""
    if rng.random() < 2 / 3:
        description = file.with_name("agent.json")
        record = json.loads(description.read_text())
        record["weights_sha256"] = hashlib.sha256(file.read_bytes()).hexdigest()
        description.write_text(json.dumps(record))


def only_suites_of(folder):
    """Make the suites of a folder the only ones, and forget those that were loaded."""
    from baselines.evaluation import suites
    from baselines.tools import files

    suites._loaded.cache_clear()
    files.DATA_FOLDERS[:] = [folder]
    return suites


def results(folder):
    """Write the results of a policy in a frozen suite of two cells, as one shows them to others."""
    from auv_gym import PRESETS
    from baselines.evaluation.cells import drawn
    from baselines.evaluation.results import ResultFile
    from baselines.evaluation.runner import run_all
    from baselines.evaluation.suites import save_suite

    cells = [drawn(replace(PRESETS[name], steps=20), 2, 0) for name in ("cruise-storm", "slow-calm")]
    save_suite("small", cells, folder / "suites")
    small = only_suites_of(folder).load_suite("small")
    ResultFile(tuple(run_all(["backstepping"], small.cells)), "small", small.hash).write(folder / "results.npz")
    return folder / "results.npz"


def read_results(file):
    from baselines.evaluation.verify import checked_results

    only_suites_of(file.parent)
    checked_results(file)


VEHICLE = "auv_gym/scenarios/vehicles/remus100.toml"
FORMATS = {
    "scenario.toml": Format(scenario(".toml"), reader("auv_gym", "Scenario.load"), TEXT),
    "scenario.json": Format(scenario(".json"), reader("auv_gym", "Scenario.load"), JSON),
    "vehicle.toml": Format(copied(VEHICLE), reader("auv_gym.scenarios.vehicles", "VehicleModel.load"), TEXT),
    "log.csv": Format(copied("docs/tutorials/otter.csv"), reader("baselines.identification.log", "Log.load"), TEXT),
    "agent.json": Format(agent("agent.json"), read_policy, JSON),
    "weights.safetensors": Format(agent("weights.safetensors"), read_policy, (*BYTES, odd_value), described),
    "model.zip": Format(model, read_policy, BYTES),
    "model.onnx": Format(onnx, read_policy, BYTES),
    "results.npz": Format(results, read_results, ARCHIVE),
}


# One file at a time.


def problem(kind, file):
    """Return what is wrong about the reading of a damaged file, "" if nothing is, and whether the file was refused."""
    from baselines.tools.command_line import UsageError

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            FORMATS[kind].read(file)
    except (OSError, ValueError, UsageError) as error:
        message = str(error)
        long = "\n" in message or len(message) > LONGEST
        return f"the message is not one short line: {message[:300]}" if long else "", True
    except Exception:  # noqa: BLE001
        return traceback.format_exc(-6), False
    return "", False


def tried(kind, count, seed):
    """Read damaged files; return how many were refused, and what went wrong with which of them."""
    rng, wrong, refused = random.Random(seed), [], 0
    with tempfile.TemporaryDirectory() as folder:
        file = FORMATS[kind].make(Path(folder))
        FORMATS[kind].read(file)  # a whole file is read
        whole = {path: path.read_bytes() for path in Path(folder).rglob("*") if path.is_file()}
        for number in range(count):
            mutate = rng.choice(FORMATS[kind].mutations)
            file.write_bytes(mutate(whole[file], rng))
            FORMATS[kind].mend(file, rng)
            text, is_refused = problem(kind, file)
            refused += is_refused
            if text:
                wrong.append(f"{kind} {number}, {getattr(mutate, '__name__', mutate)}: {text}")
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
    main()

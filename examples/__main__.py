"""Run examples of other libraries, in virtual environments with their requirements.

`python -m examples` needs only Python. It makes the virtual environments under build/examples with pip, runs the
scripts, and writes their rows of the table in docs/tools.md.
"""

from __future__ import annotations

import argparse
import datetime as dt
import hashlib
import json
import os
import re
import subprocess
import sys
import venv
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
BUILD = ROOT / "build" / "examples"
PAGE = ROOT / "docs" / "tools.md"
TORCH = next(
    line for line in (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines() if line.startswith("torch==")
)
VERSIONS = "import importlib.metadata as m, json, sys; print(json.dumps({n: m.version(n) for n in sys.argv[1:]}))"


@dataclass(frozen=True)
class Example:
    """The example of a library: title and requirements."""

    title: str
    packages: tuple[str, ...]  # the packages whose versions the table has
    requires: tuple[str, ...]  # requirements for pip, in addition to this package with `extras`
    extras: str = "train"
    alone: str = ""  # reason for versions other than those of constraints.txt; "" without
    unresolved: tuple[str, ...] = ()  # requirements that pip installs without dependencies


EXAMPLES = {
    "sb3": Example("Stable-Baselines3, sb3-contrib", ("stable-baselines3", "sb3-contrib"), ("sb3-contrib",)),
    "rl_zoo": Example(
        "rl_zoo3", ("rl_zoo3",), ("rl_zoo3", "pandas<3", "requests"), alone="its commands need pandas < 3"
    ),
    "torchrl": Example("TorchRL", ("torchrl", "tensordict"), ("torchrl",)),
    "jax": Example("JAX", ("jax",), ("jax",)),
    "skrl": Example("skrl", ("skrl",), ("skrl",)),
    "tianshou": Example("Tianshou", ("tianshou",), ("tianshou[eval]",), alone="it needs pandas < 3"),
    "rllib": Example("RLlib", ("ray",), ("ray[rllib]",), alone="it pins gymnasium 1.2.2"),
    "minari": Example("Minari", ("minari",), ("minari[create,hdf5]",)),
    "d3rlpy": Example(
        "d3rlpy",
        ("d3rlpy", "minari"),
        ("click", "colorama", "dataclasses-json", "gym", "minari[create,hdf5]", "scikit-learn", "structlog"),
        alone="it pins gymnasium 1.0.0, so its requirements are installed without it",
        unresolved=("d3rlpy==2.8.1",),
    ),
    "wandb": Example("Weights & Biases", ("wandb",), ("wandb",)),
    "optuna": Example("Optuna", ("optuna",), ("optuna",)),
    "mcsimpython": Example("MCSimPython", ("MCSimPython",), ("MCSimPython",)),
    "pymavlink": Example("pymavlink", ("pymavlink",), ("pymavlink",), "export"),
    "onnxruntime": Example("ONNX Runtime", ("onnxruntime", "onnx"), (), "train,export"),
}


def python_of(name: str) -> Path:
    """Return the Python of an example's virtual environment; make the environment first if it does not exist."""
    example = EXAMPLES[name]
    folder = BUILD / (name if example.alone else "shared")
    python = folder / ("Scripts" if os.name == "nt" else "bin") / "python"
    needed = [*example.requires, TORCH]
    words = ["--editable", f".[{example.extras}]", *needed, *([] if example.alone else ["-c", "constraints.txt"])]
    stamp = folder / f"{name}-{hashlib.sha256(' '.join([*words, *example.unresolved]).encode()).hexdigest()[:12]}.stamp"
    if not stamp.exists():
        print(f"{name}: installing {', '.join(needed)} into {folder.relative_to(ROOT)}", flush=True)
        if not python.exists():
            venv.create(folder, with_pip=True)
        pip = [str(python), "-m", "pip", "install", "--quiet"]
        subprocess.run([*pip, *words], cwd=ROOT, check=True)
        for requirement in example.unresolved:
            subprocess.run([*pip, "--no-deps", "--ignore-requires-python", requirement], cwd=ROOT, check=True)
        stamp.touch()
    return python


def run(name: str, quick: bool) -> str:
    """Run an example and return its row of the table.

    Raises:
        RuntimeError: the script fails.
    """
    example, python = EXAMPLES[name], python_of(name)
    folder = BUILD / "work" / name
    subprocess.run([sys.executable, "-c", f"import shutil; shutil.rmtree({str(folder)!r}, True)"], check=True)
    folder.mkdir(parents=True)
    environment = {"OMP_NUM_THREADS": "1", "MPLBACKEND": "Agg", "SDL_VIDEODRIVER": "dummy", **os.environ}
    done = subprocess.run(
        [str(python), str(ROOT / "examples" / f"with_{name}.py"), *(["--quick"] if quick else [])],
        cwd=folder,
        env={**environment, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    shown = [line.removeprefix("works: ") for line in done.stdout.splitlines() if line.startswith("works: ")]
    if done.returncode or not shown:
        raise RuntimeError(f"{name} fails with status {done.returncode}:\n{done.stdout[-4000:]}")
    wanted = (*example.packages, "gymnasium")
    found = subprocess.run([str(python), "-c", VERSIONS, *wanted], capture_output=True, text=True, check=True).stdout
    versions = ", ".join(f"{package} {version}" for package, version in json.loads(found).items())
    today = dt.datetime.now(tz=dt.timezone.utc).date().isoformat()
    works = f"{shown[-1]}{' (short run)' if quick else ''}"
    return f"| {example.title} | {versions} | {today} | {works} | `with_{name}.py` |"


def main(arguments: list[str] | None = None) -> int:
    """Run the named examples, or all, and return the exit status: 1 if one fails, otherwise 0."""
    parser = argparse.ArgumentParser(prog="python -m examples", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"one of {', '.join(EXAMPLES)}; default: all")
    parser.add_argument("--quick", action="store_true", help="short runs, which only show that the scripts work")
    chosen = parser.parse_args(arguments)
    if unknown := [name for name in chosen.names if name not in EXAMPLES]:
        parser.error(f"unknown example {unknown[0]!r}; allowed are {', '.join(EXAMPLES)}")
    failed = 0
    for name in chosen.names or EXAMPLES:
        try:
            row = run(name, chosen.quick)
        except (RuntimeError, subprocess.CalledProcessError) as error:
            print(f"{name}: {error}", file=sys.stderr, flush=True)
            failed += 1
            continue
        print(row, flush=True)
        page = PAGE.read_text(encoding="utf-8")
        page = re.sub(rf"^\|.*\| `with_{name}\.py` \|$", lambda _, row=row: row, page, flags=re.MULTILINE)
        PAGE.write_text(page, encoding="utf-8")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())

"""Fingerprints: hashes of the code and data of a policy and of the simulator, which show if results are outdated."""

from __future__ import annotations

import ast
import hashlib
import importlib.util
import inspect
import json
import shlex
from collections.abc import Iterable, Iterator, Sequence
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import auv_gym
from baselines.agents.agent import AGENT_FILE, WEIGHTS
from baselines.agents.names import COMMAND, FADING, agent_folder, checked_name, guarded_name
from baselines.agents.onnx_models import SUFFIX
from baselines.agents.programs import files_of
from baselines.agents.sb3_models import statistics_file
from baselines.control import POLICIES
from baselines.control.open_loop import NO_EXPERT
from baselines.gains.loading import EXPONENTS
from baselines.gains.loading import GAINS_FOLDER as GAINS

POLICY_PACKAGES = (
    "baselines.agents",
    "baselines.control",
    "baselines.estimation",
    "baselines.gains",
    "baselines.policy",
)
"""Packages and modules with the code of policies; the code that tunes, trains and evaluates them does not count."""
_AGENT_CODE = "baselines.agents.residual_policy"  # the module that runs trained agents
_GUARD_CODE = "baselines.agents.guard"  # the module of guards
_CHECK_CODE = "baselines.agents.checked"  # the module of the check of measurements
_GUARD_LAW = "backstepping"  # the default fallback of a guard, whose gains its thresholds use
AGENT_KEYS = ("format", "network", "inputs", "features", "observation", "expert", "authority")
"""Keys of agent.json that affect an agent's actions; with gated corrections `region` affects them too."""
LARGEST_POLICY_FILE = 2**28  # [bytes] largest file that is read


def fingerprint(name: str) -> str:
    """Return the SHA-256 of everything that determines a policy's actions; "" if there is no such policy.

    The hash covers:

    - FILE.py:FACTORY, FILE.zip and FILE.onnx: the file, without the modules that it imports;
    - a program: the words of its command and the files in them, see `files_of`;
    - an agent: its weights, `AGENT_KEYS` of its description, its expert and the code that runs it;
    - a policy with checked measurements: its fingerprint, and the code of the check;
    - a policy with a guard: the fingerprints of both policies, and the code of the guard;
    - a controller: its options, its gains and the code of its modules.

    Docstrings, comments and formatting of the code do not count.

    Raises:
        ValueError: a file is larger than `LARGEST_POLICY_FILE`, or a folder has too many files.
    """
    if (inner := checked_name(name)) is not None:
        own = fingerprint(inner)
        return _hash([own, *(module.digest for module in _imported(_CHECK_CODE))]) if own else ""
    if (parts := guarded_name(name)) is not None:
        both = fingerprint(parts[0]), fingerprint(parts[1] or _GUARD_LAW)
        return _hash([*both, *(module.digest for module in _imported(_GUARD_CODE))]) if all(both) else ""
    bare = name.removesuffix(FADING)
    try:
        if name.startswith(COMMAND):
            words = shlex.split(name.removeprefix(COMMAND))
            return _hash([*words, *(part for file in files_of(words) for part in (str(file), _bytes(file)))])
        if bare.endswith(SUFFIX):
            return _hash([_bytes(Path(bare))])
        if ".py:" in bare:
            return _hash([_bytes(Path(bare.rpartition(":")[0]))])
        if bare.endswith(".zip"):
            statistics = statistics_file(Path(bare))
            return _hash([_bytes(Path(bare)), *([_bytes(statistics)] if statistics else [])])
        if bare in POLICIES:
            return _of_controller(bare)
        if (folder := agent_folder(bare)) is not None:
            return _of_agent(folder, bare != name)
    except OSError:
        pass
    return ""


def covered_files(name: str) -> str | None:
    """Return a text that lists what the fingerprint of a policy covers; None if it covers everything."""
    parts = []
    bare = checked_name(name) or name
    for part in guarded_name(bare) or (bare,):
        if part.startswith(COMMAND):
            files = [str(file) for file in files_of(shlex.split(part.removeprefix(COMMAND)))]
            more = f" and {len(files) - _NAMED} more" if len(files) > _NAMED else ""
            parts.append(f"the words of {part!r} and the files {', '.join(files[:_NAMED]) or '(none)'}{more}")
        elif ".py:" in part:
            parts.append(f"the file {part.rpartition(':')[0]}")
    return f"{' and '.join(parts)}, and nothing else that {name!r} reads or imports" if parts else None


_NAMED = 5
"""Largest number of files in the text of `covered_files`."""
SIMULATOR = "auv_gym.envs.track_vector_env"  # the module of the environment of evaluations
SIMULATOR_PACKAGES = ("codegen", "envs", "physics", "planning", "scenarios", "task")
"""Packages of auv_gym that determine an episode, together with the actions."""
NOT_SIMULATOR = ("auv_gym.codegen.native", "auv_gym.codegen.cache")
"""Modules that choose the compiler and the place of compiled code, which do not affect results."""
MEASURES = ("baselines.evaluation.rollout", "baselines.evaluation.metrics")
"""Modules that run the episodes and compute the metrics."""


def simulator_fingerprint() -> str:
    """Return the SHA-256 of the code that determines results: the environment, what it imports, C code and `MEASURES`.

    Docstrings, comments, formatting and the names of modules do not count; in C code everything counts.
    """
    packages = (*(f"auv_gym.{package}" for package in SIMULATOR_PACKAGES), *MEASURES)
    modules = _imported(SIMULATOR, *MEASURES, packages=packages, without=NOT_SIMULATOR)
    folder = Path(auv_gym.__file__).parent
    sources = [file for package in SIMULATOR_PACKAGES for file in sorted((folder / package).rglob("*.c"))]
    return _hash([*(module.digest for module in modules), *map(_bytes, sources)])


def _of_agent(folder: Path, gated: bool) -> str:
    record = json.loads(_bytes(folder / AGENT_FILE))
    description = {key: record.get(key) for key in (*AGENT_KEYS, *(("region",) if gated else ()))}
    expert = record["expert"]
    parts = [json.dumps(description, sort_keys=True), "" if expert == NO_EXPERT else fingerprint(expert)]
    return _hash([_bytes(folder / WEIGHTS), *parts, *(module.digest for module in _imported(_AGENT_CODE))])


def _of_controller(name: str) -> str:
    factory, options, _ = POLICIES[name]
    parts = (factory.func, *factory.args, *factory.keywords.values()) if isinstance(factory, partial) else (factory,)
    code = list(_imported(*(part.__module__ for part in parts if callable(part))))
    if not code and (file := inspect.getsourcefile(inspect.getmodule(factory) or type(factory))):
        code = [_module(Path(file))]
    words = {part for part in parts if isinstance(part, str)}.union(*(module.words for module in code))
    gains = [file for file in sorted(GAINS.glob("*.json")) if file.stem.rpartition("-")[0] in words]
    numbers = [json.dumps([file.name, _gains(file)], sort_keys=True) for file in gains]
    powers = {word: own for word, own in json.loads(_bytes(EXPONENTS)).items() if word in words}
    numbers += [json.dumps(powers, sort_keys=True)] if powers else []
    settings = [repr(part) for part in parts if not callable(part)] + [repr(sorted(options.items()))]
    return _hash([*settings, *numbers, *(module.digest for module in code)])


def _gains(file: Path) -> Any:
    record = json.loads(_bytes(file))
    return record.get("gains", record) if isinstance(record, dict) else record


class Module(NamedTuple):
    """A module of Python code."""

    digest: str
    imports: frozenset[str]  # full names of imported modules and objects
    words: frozenset[str]  # its string constants


def _imported(*names: str, packages: Sequence[str] = POLICY_PACKAGES, without: Sequence[str] = ()) -> Iterator[Module]:
    """Yield modules and all modules of some packages that they import, also indirectly, ordered by digest."""
    prefixes = tuple(f"{package}." for package in packages)
    modules: dict[str, Module] = {}
    remaining = set(names)
    while remaining:
        name = remaining.pop()
        if name in modules or name in without or not f"{name}.".startswith(prefixes):
            continue
        try:
            spec = importlib.util.find_spec(name)
        except ModuleNotFoundError:  # the name of an object in a module
            spec = None
        if spec is not None and spec.origin is not None:
            modules[name] = _module(Path(spec.origin))
            remaining |= modules[name].imports
    return iter(sorted(modules.values(), key=lambda module: module.digest))


def _module(file: Path) -> Module:
    state = file.stat()
    return _parsed(file, state.st_mtime_ns, state.st_size)


@lru_cache(maxsize=256)
def _parsed(file: Path, *_: int) -> Module:
    """Return the module of a file; the other arguments are its time and size, so that a changed file is read again."""
    tree = ast.parse(_bytes(file))
    imports: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module and not node.level:
            imports |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
        elif isinstance(node, ast.Import):
            imports |= {alias.name for alias in node.names}
    words = {node.value for node in ast.walk(tree) if isinstance(node, ast.Constant) and isinstance(node.value, str)}
    return Module(_hash([repr(_plain(tree))]), frozenset(imports), frozenset(words))


def _plain(node: Any) -> Any:
    """Return a syntax tree as lists, which are the same in every version of Python.

    Docstrings are left out, and so are the modules of `from` imports, so that moved code has the same hash.
    """
    if isinstance(node, list):
        return [_plain(item) for item in node if not _is_docstring(item)]
    if not isinstance(node, ast.AST):
        return repr(node)
    entries = (
        (name, value) for name, value in ast.iter_fields(node) if value is not None and value != [] and name != "module"
    )
    return [type(node).__name__, *((name, _plain(value)) for name, value in entries)]


def _is_docstring(node: Any) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def _bytes(file: Path) -> bytes:
    if not file.is_file():
        raise FileNotFoundError(file)
    if file.stat().st_size > LARGEST_POLICY_FILE:
        raise ValueError(f"{file} is larger than {LARGEST_POLICY_FILE} bytes, the limit for files of policies")
    return file.read_bytes()


def _hash(parts: Iterable[str | bytes]) -> str:
    digest = hashlib.sha256()
    for part in parts:
        digest.update(hashlib.sha256(part.encode() if isinstance(part, str) else part).digest())
    return digest.hexdigest()

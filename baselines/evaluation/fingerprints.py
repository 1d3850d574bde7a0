"""What makes a policy's numbers, as a hash: rows that were made by something else do not count."""

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

from baselines.agents.agent import AGENT_FILE, WEIGHTS
from baselines.agents.names import COMMAND, FADING, agent_folder, guarded_name
from baselines.agents.onnx_models import SUFFIX
from baselines.agents.programs import files_of
from baselines.agents.sb3_models import statistics_file
from baselines.control import POLICIES
from baselines.control.open_loop import NO_EXPERT
from baselines.gains.loading import GAINS_FOLDER as GAINS

ROOMS = ("baselines.agents", "baselines.control", "baselines.estimation", "baselines.gains", "baselines.policy")
"""Modules that policies are made of; what tunes, trains and measures them stands elsewhere."""
_AGENT_CODE = "baselines.agents.residual_policy"  # the module that trained agents act by
_GUARD_CODE = "baselines.agents.guard"  # the module that guards act by
_GUARD_LAW = "backstepping"  # whose gains a guard watches, and hands over to
ACTING = ("format", "network", "inputs", "features", "observation", "expert", "authority")
"""Entries of agent.json that an agent's actions depend on; `region` does where corrections fade."""
LARGEST_POLICY_FILE = 2**28  # [bytes] of a file that is read


def fingerprint(name: str) -> str:
    """Return a SHA-256 of what makes a policy's numbers; "" where there is nothing of that name.

    Of FILE.py:FACTORY, FILE.zip and FILE.onnx that is the file; what it imports does not count. Of a program the words
    of its command and the files that they name, see `files_of`. Of an agent the weights, what acts in its description,
    its expert and the code that runs it. Of a policy with a guard what that is of it and of the one that takes over,
    and the guard's code. Of a controller its options, its gains and the code of the modules that it is made of, without
    docstrings, comments and format.

    Raises:
        ValueError: a file is larger than `LARGEST_POLICY_FILE`, or a folder has too many files.
    """
    if (parts := guarded_name(name)) is not None:
        both = fingerprint(parts[0]), fingerprint(parts[1] or _GUARD_LAW)
        return _hash([*both, *(unit.digest for unit in _closure(_GUARD_CODE))]) if all(both) else ""
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
            beside = statistics_file(Path(bare))
            return _hash([_bytes(Path(bare)), *([_bytes(beside)] if beside else [])])
        if bare in POLICIES:
            return _of_controller(bare)
        if (folder := agent_folder(bare)) is not None:
            return _of_agent(folder, bare != name)
    except OSError:
        pass
    return ""


def watched(name: str) -> str | None:
    """Return what of a policy is in its fingerprint, where that is not all that it is made of; else None."""
    parts = []
    for part in guarded_name(name) or (name,):
        if part.startswith(COMMAND):
            files = [str(file) for file in files_of(shlex.split(part.removeprefix(COMMAND)))]
            more = f" and {len(files) - _NAMED} more" if len(files) > _NAMED else ""
            parts.append(f"the words of {part!r} and the files {', '.join(files[:_NAMED]) or '(none)'}{more}")
        elif ".py:" in part:
            parts.append(f"the file {part.rpartition(':')[0]}")
    return f"{' and '.join(parts)}, and nothing else that {name!r} reads or imports" if parts else None


_NAMED = 5
"""Most files that are named in a line."""
SIMULATOR = "auv_gym.envs.track_vector_env"  # the module of the environment that policies are run in
SIMULATOR_ROOMS = ("codegen", "envs", "physics", "planning", "scenarios", "task")
"""Folders of the modules that make an episode's numbers, with a policy's actions."""
NOT_SIMULATOR = ("auv_gym.codegen.native", "auv_gym.codegen.cache")
"""Modules that only decide where and by which compiler code is built; results do not depend on that."""


def simulator_fingerprint() -> str:
    """Return a SHA-256 of the code that simulates: of the environment and all that it imports of the package.

    Docstrings, comments, format and the names of modules do not count.
    """
    rooms = tuple(f"auv_gym.{room}" for room in SIMULATOR_ROOMS)
    return _hash([unit.digest for unit in _closure(SIMULATOR, rooms=rooms, without=NOT_SIMULATOR)])


def _of_agent(folder: Path, fades: bool) -> str:
    record = json.loads(_bytes(folder / AGENT_FILE))
    acting = {key: record.get(key) for key in (*ACTING, *(("region",) if fades else ()))}
    expert = record["expert"]
    parts = [json.dumps(acting, sort_keys=True), "" if expert == NO_EXPERT else fingerprint(expert)]
    return _hash([_bytes(folder / WEIGHTS), *parts, *(unit.digest for unit in _closure(_AGENT_CODE))])


def _of_controller(name: str) -> str:
    factory, options, _ = POLICIES[name]
    parts = (factory.func, *factory.args, *factory.keywords.values()) if isinstance(factory, partial) else (factory,)
    code = list(_closure(*(part.__module__ for part in parts if callable(part))))
    if not code and (file := inspect.getsourcefile(inspect.getmodule(factory) or type(factory))):
        code = [_unit(Path(file))]
    words = {part for part in parts if isinstance(part, str)}.union(*(unit.words for unit in code))
    gains = [file for file in sorted(GAINS.glob("*.json")) if file.stem.rpartition("-")[0] in words]
    numbers = [json.dumps([file.name, _gains(file)], sort_keys=True) for file in gains]
    settings = [repr(part) for part in parts if not callable(part)] + [repr(sorted(options.items()))]
    return _hash([*settings, *numbers, *(unit.digest for unit in code)])


def _gains(file: Path) -> Any:
    record = json.loads(_bytes(file))
    return record.get("gains", record) if isinstance(record, dict) else record


class Unit(NamedTuple):
    """A module of Python code."""

    digest: str
    imports: frozenset[str]  # names of modules, or of something in them
    words: frozenset[str]  # its string constants


def _closure(*modules: str, rooms: Sequence[str] = ROOMS, without: Sequence[str] = ()) -> Iterator[Unit]:
    """Yield modules and all that they import within some packages, in the order of their digests."""
    units: dict[str, Unit] = {}
    waiting = set(modules)
    while waiting:
        name = waiting.pop()
        if name in units or name in without or not f"{name}.".startswith(tuple(f"{room}." for room in rooms)):
            continue
        try:
            spec = importlib.util.find_spec(name)
        except ModuleNotFoundError:  # its parent is a module: the name is of something in it
            spec = None
        if spec is not None and spec.origin is not None:
            units[name] = _unit(Path(spec.origin))
            waiting |= units[name].imports
    return iter(sorted(units.values(), key=lambda unit: unit.digest))


def _unit(file: Path) -> Unit:
    state = file.stat()
    return _parsed(file, state.st_mtime_ns, state.st_size)


@lru_cache(maxsize=256)
def _parsed(file: Path, *_: int) -> Unit:
    """Return the unit of a file, read again where its time or size are others."""
    tree = ast.parse(_bytes(file))
    imports: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module and not node.level:
            imports |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
        elif isinstance(node, ast.Import):
            imports |= {alias.name for alias in node.names}
    words = {node.value for node in ast.walk(tree) if isinstance(node, ast.Constant) and isinstance(node.value, str)}
    return Unit(_hash([repr(_plain(tree))]), frozenset(imports), frozenset(words))


def _plain(node: Any) -> Any:
    """Return a syntax tree as lists, the same in every version of Python.

    Strings that stand alone are left out, and the names of modules that something is imported from: code that has moved
    is the same code.
    """
    if isinstance(node, list):
        return [_plain(item) for item in node if not _stands_alone(item)]
    if not isinstance(node, ast.AST):
        return repr(node)
    entries = (
        (name, value) for name, value in ast.iter_fields(node) if value is not None and value != [] and name != "module"
    )
    return [type(node).__name__, *((name, _plain(value)) for name, value in entries)]


def _stands_alone(node: Any) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def _bytes(file: Path) -> bytes:
    if not file.is_file():
        raise FileNotFoundError(file)
    if file.stat().st_size > LARGEST_POLICY_FILE:
        raise ValueError(f"{file} is larger than {LARGEST_POLICY_FILE} bytes, so it is no policy's")
    return file.read_bytes()


def _hash(parts: Iterable[str | bytes]) -> str:
    digest = hashlib.sha256()
    for part in parts:
        digest.update(hashlib.sha256(part.encode() if isinstance(part, str) else part).digest())
    return digest.hexdigest()

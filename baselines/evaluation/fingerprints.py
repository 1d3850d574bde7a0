"""Fingerprints: what can change the numbers of a policy or of the simulator, as hashes that show outdated results.

Results depend on compiled equations, on data, and on code that runs as Python. So a fingerprint has three parts:

- the C sources of the kernels that are used, which do not change if the code is only reorganised;
- the data: weights, gains and options, or the file of a user's policy;
- the text of the packages that run as Python, without docstrings, comments, blank lines and imports.
"""

from __future__ import annotations

import ast
import hashlib
import json
import re
import shlex
import warnings
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

from auv_gym.codegen.graph import SYMBOLS
from auv_gym.codegen.kernel import Kernel, recorded_digests
from auv_gym.effects import PACKAGE
from auv_gym.effects.base import source_of
from auv_gym.planning import kernels as planning
from auv_gym.scenarios import exogenous
from auv_gym.scenarios.presets import PRESETS
from auv_gym.scenarios.scenario import Scenario
from auv_gym.task.policy import Law, Policy, traceable
from baselines.agents.agent import AGENT_FILE, WEIGHTS, WHOLE_MODEL
from baselines.agents.names import PolicyName
from baselines.agents.sb3_models import statistics_file
from baselines.control import POLICIES
from baselines.control.open_loop import NO_EXPERT, OpenLoop
from baselines.control.traced import TracedController
from baselines.evaluation.cells import drawn
from baselines.evaluation.rollout import rollout
from baselines.gains.loading import numbers_of
from baselines.policies import make_policy
from baselines.policy import BySpeed, Remembering
from baselines.scaling import ScaledPolicy
from baselines.space.open_loop import SpaceOpenLoop
from baselines.tools.programs import COMMAND, files_of

BASELINES = Path(__file__).parents[1]  # folder of the package
POLICY_CODE = ("agents", "control", "estimation")
"""Packages of `baselines` with policies that run partly as Python."""
MEASURES = ("evaluation/rollout.py", "evaluation/metrics.py")
"""Modules of `baselines` that run the episodes and compute the metrics."""
_STEPS = 4  # control steps after which a policy has used all of its kernels
_GUARD_LAW = "backstepping"  # the default fallback of a guard, whose gains its thresholds use
AGENT_KEYS = ("network", "inputs", "features", "observation", "expert", "authority", WHOLE_MODEL)
"""Keys of agent.json that affect an agent's actions."""


def fingerprint(policy: str, scenarios: Sequence[Scenario] = ()) -> str:
    """Return the fingerprint of everything that determines a policy's actions; "" if there is no such policy.

    Args:
        policy: name or path of the policy. For FILE.py:FACTORY, FILE.zip, FILE.onnx and programs the data are the
            file, or the words of the command and the files that these name. Of the modules that a Python file
            imports, those beside it count.
        scenarios: the scenarios in which it runs. Its equations can depend on their vehicles. Default: the paper's.
    """
    name = PolicyName.of(policy)
    policies = [PolicyName(name.base)]
    if name.fallback is not None:
        policies.append(PolicyName.of(name.fallback or _GUARD_LAW))
    in_space = any(scenario.vertical for scenario in scenarios)
    parts = [_data(part, in_space) for part in policies]
    if not all(parts):
        return ""
    data = _hash(" ".join(_hash(entry) for part in parts for entry in part))
    if any(part.kind not in ("controller", "agent", "gains") for part in policies):
        return f".{data[:20]}."
    results = [_used(policy, data, scenario) for scenario in scenarios or [PRESETS["cruise-storm"]]]
    kernels = sorted({digest for digests, _ in results for digest in digests})
    modules = (*POLICY_CODE, "space") if any(scenario.vertical for scenario in scenarios) else POLICY_CODE
    code = "" if all(compiled for _, compiled in results) else code_fingerprint(*modules)
    return f"{_hash(' '.join(kernels))[:20]}.{data[:20]}.{code}"


def simulator_fingerprint(scenarios: Iterable[Scenario], plant: str | None = None) -> str:
    """Return the fingerprint of the simulation of some scenarios, with the command of a plant, and of the metrics."""
    parts = {scenario.parts: scenario for scenario in scenarios}
    kernels = {digest for scenario in parts.values() for digest in _simulation(scenario)}
    own = sorted({source_of(effect) for used in parts for effect in used.effects if effect not in PACKAGE})
    own += [_hash(part) for part in _program(plant)] if plant else []
    sources = " ".join((*sorted(kernels), planning.planning_digest(), exogenous.digest(), *own))
    return f"{_hash(sources)[:20]}.{code_fingerprint(*MEASURES)}"


def changed_parts(before: str, now: str) -> list[str]:
    """Return the parts of a policy's fingerprint that have changed: "equations", "data" and "code"."""
    if len(parts := before.split(".")) != 3 or not now:
        return ["data"]
    return [name for name, a, b in zip(("equations", "data", "code"), parts, now.split("."), strict=True) if a != b]


def _with_neighbours(file: Path) -> list[Path]:
    """Return a Python file and those that it imports, directly or not, from its own folder."""
    found, rest = list[Path](), [file]
    while rest:
        if (one := rest.pop()) in found:
            continue
        found.append(one)
        with suppress(SyntaxError, ValueError):
            nodes = [*ast.walk(ast.parse(one.read_bytes()))]
            names = [alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names]
            names += [node.module or "" for node in nodes if isinstance(node, ast.ImportFrom)]
            beside = [file.with_name(f"{name.partition('.')[0]}.py") for name in names if name]
            rest += [path for path in beside if path.is_file()]
    return found


def _data(name: PolicyName, in_space: bool = False) -> list[str | bytes]:
    """Return the data of a policy without its suffixes, in the plane or in space; empty if there is no such policy."""
    base, kind = name.base, name.kind
    try:
        if kind == "program":
            return _program(base.removeprefix(COMMAND))
        if kind == "python":
            return [file.read_bytes() for file in _with_neighbours(Path(base.rpartition(":")[0]))]
        if kind in ("onnx", "sb3", "gains"):
            statistics = statistics_file(Path(base)) if kind == "sb3" else None
            return [file.read_bytes() for file in (Path(base), statistics) if file is not None]
        if kind == "controller":
            entry = POLICIES.get(base)
            return [repr(sorted(entry.options.items())), json.dumps(numbers_of(base, in_space))] if entry else []
        if name.folder is not None:
            record = json.loads((name.folder / AGENT_FILE).read_bytes())
            description = json.dumps({key: record[key] for key in AGENT_KEYS if key in record}, sort_keys=True)
            expert = [] if record["expert"] == NO_EXPERT else _data(PolicyName.of(record["expert"]), in_space)
            return [(name.folder / WEIGHTS).read_bytes(), description, *expert]
    except OSError:
        pass
    return []


def _program(command: str) -> list[str | bytes]:
    """Return the words of a command, and the files that they name; with those that a Python file imports beside it."""
    words = shlex.split(command)
    files = (one for file in files_of(words) for one in (_with_neighbours(file) if file.suffix == ".py" else [file]))
    return [*words, *(part for file in files for part in (str(file), file.read_bytes()))]


def _used(policy: str, data: str, scenario: Scenario) -> tuple[frozenset[str], bool]:
    """Return the digests of a policy's kernels, and whether they do all of its arithmetic.

    They are those of a few control steps of a scenario. A change of Python code then has no effect on the policy.
    """
    privileged = policy in POLICIES and POLICIES[policy].privileged
    key = policy, data, scenario.known, scenario.parts if privileged else None
    if key not in _known_kernels:
        made, digests = _digests(lambda: make_policy(policy, scenario.known), scenario)
        if isinstance(made, Law) and traceable(made):  # it computes on NumPy arrays, by the same equation
            size = scenario.parts.model.layout.size
            digests.add(Kernel.traced(lambda o: {"force": made.forces(o, SYMBOLS)}, {"o": size}).digest)
        _known_kernels[key] = frozenset(digests - _simulation(scenario)), _is_compiled(made)
    return _known_kernels[key]


_known_kernels: dict[tuple[Any, ...], tuple[frozenset[str], bool]] = {}
"""Results of `_used` by policy, data and vehicle, and for a privileged policy by the parts of the simulation."""


@cache
def _simulation(scenario: Scenario) -> set[str]:
    """Return the digests of the kernels of the simulation of a scenario, without those of `together`."""
    return _digests(SpaceOpenLoop if scenario.vertical else OpenLoop, scenario)[1]


def _digests(make: Callable[[], Policy], scenario: Scenario) -> tuple[Policy, set[str]]:
    """Return a policy, and the digests of the kernels that it and the simulation use in a few control steps."""
    brief = replace(scenario, steps=_STEPS)
    episodes = drawn(brief, 1, 0).episodes
    with recorded_digests() as digests, warnings.catch_warnings():  # of an agent for slow motion
        warnings.simplefilter("ignore")
        policy = make()
        try:
            rollout(policy, brief, episodes)
        except KeyboardInterrupt:
            raise
        except BaseException:  # noqa: BLE001, it fails in its own evaluation too
            pass
    return policy, digests


def _is_compiled(policy: Any) -> bool:
    """Return whether all arithmetic of a policy is in kernels."""
    if isinstance(policy, ScaledPolicy):
        return _is_compiled(policy.policy)
    if isinstance(policy, Remembering):
        return _is_compiled(policy.controller)
    if isinstance(policy, BySpeed):
        return _is_compiled(policy.slow) and _is_compiled(policy.cruise)
    return isinstance(policy, Law | TracedController)


@cache
def code_fingerprint(*parts: str | Path) -> str:
    """Return the hash of the statements in modules and folders, in no order; a text is a path in `baselines`."""
    paths = [BASELINES / part for part in parts]
    files = (file for path in paths for file in (path.rglob("*.py") if path.is_dir() else [path]))
    return _hash(" ".join(sorted({digest for file in files for digest in statements(file.read_bytes())})))[:20]


_IGNORED = re.compile(
    rb'^ *"""(?s:.*?)"""$'  # docstrings
    rb"|^(?:import|from)\b[^(\n]*(?:\([^)]*\))?"
    rb"|(?:^|  )#.*$",
    re.MULTILINE,
)
"""Parts of a module that do not count."""


def statements(source: bytes) -> list[str]:
    """Return the hash of each function, class and assignment of a module, so that these can be moved."""
    lines = [line for line in _IGNORED.sub(b"", source).splitlines() if line.strip()]
    return [_hash(part) for part in re.split(rb"\n(?=[\w@])", b"\n".join(lines))]


def _hash(part: str | bytes) -> str:
    return hashlib.sha256(part.encode() if isinstance(part, str) else part).hexdigest()

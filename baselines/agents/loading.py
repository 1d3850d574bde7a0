"""Policies from files: `path/to/module.py:factory`, a `model.zip` of Stable-Baselines3, or the folder of an agent."""

from __future__ import annotations

import importlib.util
import inspect
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from auv_gym.residual import Policy
from baselines.agents.sb3_models import load_model, statistics_file

AGENTS = Path(__file__).parent / "shipped"
"""Where the agents are that ship with the package, a folder each."""


FADING = ":fade"
"""Behind an agent's name: its corrections fade where it leaves what it has seen, see `Agent.policy`."""


def shipped_agents() -> list[str]:
    """Return the names of the agents in `AGENTS`."""
    return sorted(file.parent.name for file in AGENTS.glob("*/agent.json"))


def agent_folder(name: str) -> Path | None:
    """Return the folder of an agent, by its name, its path or that of the run that trained it; None for no agent."""
    places = (AGENTS / name,) if name in shipped_agents() else (Path(name), Path(name, "agent"))
    return next((place for place in places if (place / "agent.json").is_file()), None)


def is_path(name: str) -> bool:
    """Return whether a policy's name is a path to one."""
    known = name.endswith(".zip") or ".py:" in name or "/" in name or "\\" in name
    return known or (name not in shipped_agents() and agent_folder(name) is not None)


def is_privileged(name: str) -> bool:
    """Return whether a policy of the registry looks behind the observation, see `evaluation.rollout.Privileged`."""
    from baselines import POLICIES

    factory = POLICIES[name][0] if name in POLICIES else None
    return hasattr(factory, "prepare") and hasattr(factory, "observe")


def caution(name: str) -> str | None:
    """Return what a user should know before a policy is loaded, if anything."""
    if name.endswith(".zip"):
        text = f"{name} holds pickled objects, which can run any code when they are loaded: only load what you trust"
        return f"{text}; it sees what {beside} normalises" if (beside := statistics_file(Path(name))) else text
    return None


def told(factory: Callable[..., Any], vehicle: Any) -> dict[str, Any]:
    """Return the option that tells a factory of the known vehicle; none if there is none, or it takes no `vehicle`."""
    try:
        takes = vehicle is not None and "vehicle" in inspect.signature(factory).parameters
    except (TypeError, ValueError):  # of something without a signature
        takes = False
    return {"vehicle": vehicle} if takes else {}


def load_policy(path: str, vehicle: Any = None, **options: Any) -> Policy:
    """Return the policy of a path, see the module.

    Args:
        path: "FILE.py:FACTORY", whose factory is called with the options, "FILE.zip", or an agent's folder.
        vehicle: the known one, see `baselines.make_policy`.
        options: of the factory, `fade` of an agent, see `baselines.agents.agent.Agent.policy`, or `authority` of a
            model that was trained on the residual environment.

    Raises:
        OSError: the file cannot be read.
        ValueError: it holds no such policy.
    """
    if ".py:" not in path:
        model = path.endswith(".zip")
        allowed = "authority" if model else "fade"
        if unknown := [name for name in options if name != allowed]:
            raise ValueError(f"policy {path!r} takes no option {unknown[0]!r}, only {allowed}")
        return load_model(Path(path), _expert(vehicle), **options) if model else _agent(Path(path), vehicle, **options)
    file, _, factory = path.rpartition(":")
    return _made(Path(file), factory, vehicle, options)


def _expert(vehicle: Any) -> Policy:
    from baselines import make_policy

    return make_policy("backstepping", vehicle)


def _agent(folder: Path, vehicle: Any, fade: bool = False) -> Policy:
    from baselines.agents.agent import Agent

    return Agent.load(agent_folder(str(folder)) or folder).policy(fade, vehicle)


def _made(file: Path, factory: str, vehicle: Any, options: dict[str, Any]) -> Policy:
    with file.open("rb"):
        pass  # says that it is missing before the importer does
    name = f"user_policy_{file.stem}"
    spec = importlib.util.spec_from_file_location(name, file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # where dataclasses look for their module
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        raise ValueError(f"{file} cannot be imported: {type(error).__name__}: {error}") from error
    make = getattr(module, factory, None)
    if not callable(make):
        raise ValueError(f"{file} has no function or class {factory!r} that makes a policy")
    try:
        policy: Policy = make(**{**told(make, vehicle), **options})
    except (Exception, SystemExit) as error:
        raise ValueError(f"{factory} of {file} fails: {type(error).__name__}: {error}") from error
    if not callable(getattr(policy, "predict", None)):
        raise ValueError(f"{factory} of {file} returns {policy!r}, which has no method predict")
    return policy

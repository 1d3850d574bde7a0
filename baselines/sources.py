"""What to cite for a result, as BibTeX."""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from auv_gym import __version__
from auv_gym.scenarios.presets import as_scenario
from auv_gym.scenarios.scenario import Scenario
from auv_gym.scenarios.vehicles import PAPER, vehicle_model_of
from baselines.agents.agent import Agent
from baselines.agents.names import PolicyName
from baselines.control import POLICIES
from baselines.control.open_loop import NO_EXPERT
from baselines.policies import list_policies

_FOSSEN = "fossen2021handbook"
_SOURCES = {
    "los-pid": (_FOSSEN, "lekkas2014integral"),
    "los-setpoints": (_FOSSEN, "lekkas2014integral"),
    "ilos": ("borhaug2008integral", "caharija2016integral"),
    "lqi": ("kwakernaak1972linear",),
    "ekf": (_FOSSEN,),
    "nmpc": ("tassa2014control", "diehl2005realtime", _FOSSEN),
    "nmpc-adverse": ("tassa2014control", "diehl2005realtime", _FOSSEN),
}
"""Entries of citations.bib for controllers; the others are the paper's or this project's own."""
_LIBRARY = {"ppo": "raffin2021stable", "sac": "raffin2021stable", "td3": "raffin2021stable"}
"""The same for the algorithms of trained agents."""
ALWAYS = ("auv_gym", "repoulias2005trajectory")
"""Entries for every result: the software, and the paper of its planner and control law."""


@cache
def entries() -> dict[str, str]:
    """Return the entries of citations.bib by key, with the version of the package."""
    text = Path(__file__).with_name("citations.bib").read_text(encoding="utf-8").replace("VERSION", __version__)
    return {match[1]: match[0] for match in re.finditer(r"^@\w+\{(\w+),\n.*?^\}$", text, re.MULTILINE | re.DOTALL)}


def citation(policy: str | None = None, scenario: Scenario | str | None = None) -> str:
    """Return BibTeX entries for the software, the paper, and the sources of a policy and of a scenario's vehicle.

    A published vehicle is named by the source of its numbers, in a comment.

    Args:
        policy: its name or path, as in `make_policy`; of a file of your own nothing is known.
        scenario: the scenario or its name, as in `gym.make`.

    Raises:
        OSError: the file of an agent or a scenario cannot be read.
        ValueError: there is no such policy or scenario, or the agent is damaged.
    """
    task = None if scenario is None else as_scenario(scenario)
    keys = dict.fromkeys((*ALWAYS, *(() if policy is None else _of_policy(policy))))
    if task is not None and task.takes_setpoints:
        keys[_FOSSEN] = None
    parts = [entries()[key] for key in keys]
    known = None if task is None else vehicle_model_of(task.known_plane)
    if known is not None and known != PAPER:
        parts.append(f"% vehicle {known.name}: {known.source}")
    return "\n".join(parts)


def _of_policy(policy: str) -> Iterator[str]:
    """Yield the keys of a policy's sources."""
    name = PolicyName.of(policy) if isinstance(policy, str) else None
    if name is None or (name.kind == "controller" and name.base not in (*POLICIES, NO_EXPERT)):
        raise ValueError(f"unknown policy {policy!r}; allowed are {', '.join(list_policies(None))}, or a path")
    if name.folder is None:
        yield from _SOURCES.get(name.base, ())
        return
    agent = Agent.load(name.folder)
    yield from _of_policy(agent.expert)
    algorithm = dict(agent.training.get("config", {})).get("algo", "")
    if algorithm in _LIBRARY:
        yield _LIBRARY[algorithm]

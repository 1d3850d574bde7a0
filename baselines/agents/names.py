"""Names of policies: BASE[:guard[=FALLBACK]]; the base is a name, a path or a command."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from baselines.tools.programs import COMMAND

SHIPPED_FOLDER = Path(__file__).parent / "shipped"
"""Folder of the agents that ship with the package, one folder each."""
AGENT_FOLDER = "agent"  # folder of the trained agent in the folder of a run
GUARD = ":guard"
"""Suffix of a policy's name: a fallback policy takes over if it diverges, see `baselines.agents.guard`. "=" and the
name of the fallback may follow."""
_KINDS = {".onnx": "onnx", ".zip": "sb3", ".json": "gains"}
"""Kinds of files by suffix."""


class PolicyName(NamedTuple):
    """The parts of a policy's name."""

    base: str  # name, path or command of the policy itself
    fallback: str | None = None  # of its guard, "" for the default one; None: it has no guard

    @classmethod
    def of(cls, name: str) -> PolicyName:
        """Return the parts of a name; a command has no suffix."""
        base, mark, fallback = name.rpartition(GUARD)
        guarded = bool(mark and base) and (not fallback or (fallback[0] == "=" and len(fallback) > 1))
        return cls(base, fallback[1:]) if guarded and not name.startswith(COMMAND) else cls(name)

    @property
    def kind(self) -> str:
        """What the base is: "program", "onnx", "python", "sb3", "gains", "agent", else "controller"."""
        base = self.base
        if base.startswith(COMMAND):
            return "program"
        if ".py:" in base:
            return "python"
        if (found := _KINDS.get(Path(base).suffix)) is not None:
            return found
        return "agent" if "/" in base or "\\" in base or self.folder is not None else "controller"

    @property
    def folder(self) -> Path | None:
        """The folder of the agent; None if the base is no agent."""
        return agent_folder(self.base)


def shipped_agents(space: bool | None = None) -> list[str]:
    """Return the names of the agents in `SHIPPED_FOLDER`: those of motion in space, those of the plane, or all."""
    files = sorted(SHIPPED_FOLDER.glob("*/agent.json"))
    return [file.parent.name for file in files if space is None or is_in_space(json.loads(file.read_bytes())) == space]


def is_in_space(record: Mapping[str, Any]) -> bool:
    """Return whether the record agent.json is that of an agent for motion in space."""
    return any(name == "e_z" for name, _ in record["observation"])


def agent_folder(name: str) -> Path | None:
    """Return the folder of an agent by its name, its path, or the folder of its training run; None if there is none."""
    if name.startswith(COMMAND):
        return None
    places = (SHIPPED_FOLDER / name, Path(name), Path(name, AGENT_FOLDER))
    return next((place for place in places if (place / "agent.json").is_file()), None)

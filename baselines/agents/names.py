"""Names of policies: agents that ship with the package, paths, and suffixes."""

from __future__ import annotations

from pathlib import Path

from auv_gym.installation import RECORD, found

SHIPPED_FOLDER = Path(__file__).parent / "shipped"
"""Folder of the agents that ship with the package, one folder each."""
AGENT_FOLDER = "agent"  # folder of the trained agent in the folder of a run
FADING = ":fade"
"""Suffix of an agent's name: its corrections fade outside of the region of its training, see `Agent.policy`."""
GUARD = ":guard"
"""Suffix of a policy's name: a fallback policy takes over if it diverges, see `baselines.agents.guard`. "=" and the
name of the fallback may follow."""
CHECKED = ":checked"
"""Suffix of a policy's name, the last one: implausible measurements are replaced, see `baselines.agents.checked`."""
COMMAND = "cmd:"
"""Prefix of a command line: the policy is a separate program, see `baselines.agents.programs`."""


def shipped_agents() -> list[str]:
    """Return the names of the agents in `SHIPPED_FOLDER`, and in a checkout also of those in the research record."""
    return sorted(
        file.parent.name
        for folder in (SHIPPED_FOLDER, RECORD / SHIPPED_FOLDER.name)
        for file in folder.glob("*/agent.json")
    )


def agent_of(study: str) -> str:
    """Return the agent of a study: "helm" for the study "helm-slow", which has its results in one speed range."""
    return study if study in shipped_agents() else study.rpartition("-")[0] or study


def agent_folder(name: str) -> Path | None:
    """Return the folder of an agent by its name, its path, or the folder of its training run; None if there is none."""
    if name.startswith(COMMAND):
        return None
    places = (found(SHIPPED_FOLDER, name),) if name in shipped_agents() else (Path(name), Path(name, AGENT_FOLDER))
    return next((place for place in places if (place / "agent.json").is_file()), None)


def checked_name(name: str) -> str | None:
    """Return the name of the policy whose measurements are checked, None for a name without `CHECKED`."""
    bare = name.removesuffix(CHECKED)
    return bare if bare not in ("", name) and not name.startswith(COMMAND) else None


def guarded_name(name: str) -> tuple[str, str] | None:
    """Return the policy's name and that of its fallback, "" for the default one; None for a name without `GUARD`."""
    bare, mark, other = name.rpartition(GUARD)
    if name.startswith(COMMAND) or not bare or not (other == "" or (other[0] == "=" and len(other) > 1)):
        return None
    return (bare, other[1:]) if mark else None


def bare_name(name: str) -> str:
    """Return a policy's name without `CHECKED`, `GUARD` and `FADING`."""
    name = checked_name(name) or name
    parts = guarded_name(name)
    return (parts[0] if parts else name).removesuffix(FADING)


def is_path(name: str) -> bool:
    """Return whether a policy's name is a path or a command."""
    known = name.endswith((".zip", ".onnx")) or ".py:" in name or "/" in name or "\\" in name
    known = known or name.startswith(COMMAND)
    return known or (name not in shipped_agents() and agent_folder(name) is not None)

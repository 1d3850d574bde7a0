"""What the name of a policy stands for: an agent that ships with the package, a path, or neither."""

from __future__ import annotations

from pathlib import Path

from auv_gym.installation import RECORD, found

SHIPPED_FOLDER = Path(__file__).parent / "shipped"
"""Where the agents are that ship with the package, a folder each."""
FADING = ":fade"
"""Behind an agent's name: its corrections fade where it leaves what it has seen, see `Agent.policy`."""
GUARD = ":guard"
"""Behind a policy's name: another one takes over where it goes astray, see `baselines.agents.guard`; behind it perhaps
"=" and the name of the other one."""

COMMAND = "cmd:"
"""Before the words of a command line: the policy is a program that runs beside, see `baselines.agents.programs`."""


def shipped_agents() -> list[str]:
    """Return the names of the agents in `SHIPPED_FOLDER`, and in a checkout of those in the record."""
    return sorted(
        file.parent.name
        for folder in (SHIPPED_FOLDER, RECORD / SHIPPED_FOLDER.name)
        for file in folder.glob("*/agent.json")
    )


def agent_of(study: str) -> str:
    """Return the name of the agent that a study is of: "helm" of "helm-slow", which says what it does in one regime."""
    return study if study in shipped_agents() else study.rpartition("-")[0] or study


def agent_folder(name: str) -> Path | None:
    """Return the folder of an agent, by its name, its path or that of the run that trained it; None for no agent."""
    if name.startswith(COMMAND):
        return None
    places = (found(SHIPPED_FOLDER, name),) if name in shipped_agents() else (Path(name), Path(name, "agent"))
    return next((place for place in places if (place / "agent.json").is_file()), None)


def guarded_name(name: str) -> tuple[str, str] | None:
    """Return the name before `GUARD`, and that of the policy behind it, "" for the usual one; None without a guard."""
    bare, mark, other = name.rpartition(GUARD)
    if name.startswith(COMMAND) or not bare or not (other == "" or (other[0] == "=" and len(other) > 1)):
        return None
    return (bare, other[1:]) if mark else None


def bare_name(name: str) -> str:
    """Return a policy's name without `GUARD` and `FADING`."""
    parts = guarded_name(name)
    return (parts[0] if parts else name).removesuffix(FADING)


def is_path(name: str) -> bool:
    """Return whether a policy's name is a path to one."""
    known = name.endswith((".zip", ".onnx")) or ".py:" in name or "/" in name or "\\" in name
    known = known or name.startswith(COMMAND)
    return known or (name not in shipped_agents() and agent_folder(name) is not None)

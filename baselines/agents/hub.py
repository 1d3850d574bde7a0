"""Share trained agents on the Hugging Face Hub. Agents consist of weights and a description; they contain no code."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from auv_gym.installation import install
from baselines.agents.agent import AGENT_FILE, CARD, WEIGHTS, Agent
from baselines.agents.model_card import CURVE_FILE
from baselines.agents.names import agent_folder

_FILES = (AGENT_FILE, CARD, WEIGHTS, CURVE_FILE)
_HEAD = "---\nlibrary_name: auv_gym\npipeline_tag: reinforcement-learning\ntags: [gymnasium, robotics, marine]\n---\n\n"


def push(agent: str, repo_id: str) -> str:
    """Upload an agent with its card as the model card, and return the address of the commit.

    Args:
        agent: name or folder of an agent.
        repo_id: repository on the Hub, USER/NAME; it is created if it does not exist.

    Raises:
        ModuleNotFoundError: huggingface_hub is not installed.
        ValueError: the agent does not exist, or it is damaged.
    """
    if (folder := agent_folder(agent)) is None:
        raise ValueError(f"{agent!r} is not an agent; give the name of a shipped agent, or a folder with {AGENT_FILE}")
    Agent.load(folder)  # raises ValueError for a damaged agent
    api = _hub().HfApi()
    api.create_repo(repo_id, exist_ok=True)
    card = (_HEAD + (folder / CARD).read_text(encoding="utf-8")).encode()
    api.upload_file(path_or_fileobj=card, path_in_repo="README.md", repo_id=repo_id)
    return str(api.upload_folder(folder_path=folder, repo_id=repo_id, allow_patterns=list(_FILES)))


def load(repo_id: str, revision: str | None = None) -> Path:
    """Download an agent and return its folder, for `make_policy(str(folder))`.

    Args:
        repo_id: repository on the Hub, USER/NAME.
        revision: branch, tag or commit; only a commit always returns the same agent.

    Raises:
        ModuleNotFoundError: huggingface_hub is not installed.
        ValueError: the repository contains no agent, or a damaged one.
    """
    folder = Path(_hub().snapshot_download(repo_id, revision=revision, allow_patterns=list(_FILES)))
    Agent.load(folder)
    return folder


def _hub() -> Any:
    try:
        import huggingface_hub
    except ModuleNotFoundError:
        raise ModuleNotFoundError(f"sharing agents requires huggingface_hub: {install('hub')}") from None
    return huggingface_hub

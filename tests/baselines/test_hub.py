"""Agents on the Hugging Face Hub, with a folder in the place of the network."""

import shutil
import sys
import types

import numpy as np
import pytest

from auv_gym import PRESETS
from baselines import make_policy
from baselines.agents import hub
from baselines.evaluation.rollout import rollout
from baselines.evaluation.runner import drawn


@pytest.fixture
def remote(tmp_path, monkeypatch):
    """The folder in which the repositories are, in the place of the Hub."""

    class HfApi:
        def create_repo(self, repo_id, exist_ok):
            assert exist_ok
            (tmp_path / repo_id).mkdir(parents=True, exist_ok=True)

        def upload_file(self, path_or_fileobj, path_in_repo, repo_id):
            (tmp_path / repo_id / path_in_repo).write_bytes(path_or_fileobj)

        def upload_folder(self, folder_path, repo_id, allow_patterns):
            for name in allow_patterns:
                if (folder_path / name).exists():
                    shutil.copy(folder_path / name, tmp_path / repo_id)
            return f"https://hub/{repo_id}/commit/1"

    def snapshot_download(repo_id, revision, allow_patterns):
        target = tmp_path / "cache" / (revision or "main")
        target.mkdir(parents=True)
        for name in allow_patterns:
            if (tmp_path / repo_id / name).exists():
                shutil.copy(tmp_path / repo_id / name, target)
        return str(target)

    fake = types.SimpleNamespace(HfApi=HfApi, snapshot_download=snapshot_download)
    monkeypatch.setitem(sys.modules, "huggingface_hub", fake)
    return tmp_path


def test_a_pulled_agent_equals_the_pushed_one(remote):
    assert hub.push("ppo-slow", "ada/slow") == "https://hub/ada/slow/commit/1"
    card = (remote / "ada" / "slow" / "README.md").read_text(encoding="utf-8")
    assert card.startswith("---\nlibrary_name: auv_gym\n")
    assert "# ppo-slow" in card
    folder = hub.load("ada/slow", revision="v1")
    assert not (folder / "README.md").exists()
    scenario = PRESETS["slow-waves"]
    episodes = drawn(scenario, 2, seed=0).episodes
    own, again = (rollout(make_policy(name), scenario, episodes) for name in ("ppo-slow", str(folder)))
    np.testing.assert_array_equal(own.measures.steady_rmse, again.measures.steady_rmse)


def test_other_folders_are_rejected(remote):
    with pytest.raises(ValueError, match="'backstepping' is not an agent"):
        hub.push("backstepping", "ada/law")
    hub.push("ppo-slow", "ada/slow")
    (remote / "ada" / "slow" / "weights.safetensors").write_bytes(b"other")
    with pytest.raises(ValueError, match="its SHA-256 differs"):
        hub.load("ada/slow")


def test_the_message_without_the_library(monkeypatch):
    monkeypatch.setitem(sys.modules, "huggingface_hub", None)
    with pytest.raises(ModuleNotFoundError, match=r"requires huggingface_hub: pip install .*\[hub\]"):
        hub.load("ada/slow")

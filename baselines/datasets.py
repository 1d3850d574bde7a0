"""Record datasets of episodes for offline learning, in Minari's format: `auv-gym dataset --help`.

The same command gives the same content; the card has its SHA-256.
"""

from __future__ import annotations

import errno
import hashlib
import importlib.metadata
import math
import os
import re
import shutil
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from tyro.conf import arg

from auv_gym.installation import install
from auv_gym.scenarios.scenario import Scenario
from auv_gym.task.observation import SIZE
from auv_gym.task.policy import Policy, preview_of
from baselines.evaluation.episodes import EpisodeRecord, run_episodes
from baselines.tools.command_line import DONE, FAILED, UsageError, WorkerError, called, checked_folder, parse, typed
from baselines.tools.files import synchronise
from baselines.tools.workers import ProcessObject

PROGRAM = "auv-gym dataset"
LIBRARY_FOLDER = "MINARI_DATASETS_PATH"
"""Environment variable with the folder of Minari's datasets."""
_UNFINISHED = ".unfinished-"
"""Beginning of the name of a folder in which a dataset is being written."""
_ID = r"([A-Za-z0-9][\w-]+/)*[A-Za-z0-9][\w-]*-v\d+"
"""Pattern of ids: Minari accepts all of them."""
_MOST_EPISODES = 10**6
_LEFTOVER = 3600.0
"""Age [s] from which such a folder belongs to a process that was killed."""


@dataclass(frozen=True)
class Options:
    """Record episodes of policies as a Minari dataset, with a card beside it.

    Each combination of policy and noise has its own episodes. Exit status: 0 done, 1 a policy failed or the dataset
    could not be written, 2 wrong usage.

    Example: auv-gym dataset --policy backstepping --scenario cruise-storm --episodes 100
    """

    policy: Annotated[tuple[str, ...], arg(metavar="P [P ...]", help_behavior_hint="")] = ("backstepping",)
    """Policies by name or path, as for `auv-gym evaluate`."""
    scenario: str = "cruise-storm"
    """Name of a preset, or a .toml or .json file."""
    episodes: int = 20
    """Number of episodes for each combination of policy and noise."""
    noise: Annotated[tuple[float, ...], arg(metavar="STD [STD ...]", help_behavior_hint="")] = (0.0,)
    """Standard deviations of the white noise on the actions, as fractions of the limits, in [0, 1]."""
    seed: int = 0
    """Seed of the first episode; each further episode has the next seed. The noise depends on it too."""
    id: Annotated[str | None, arg(metavar="NAME", help_behavior_hint="")] = None
    """Id of the dataset in Minari. Default: auv_gym/SCENARIO/POLICIES-v0."""
    out: Path = Path("runs/datasets")
    """Folder of the datasets. To load them, set MINARI_DATASETS_PATH to it."""


@dataclass(frozen=True)
class DatasetPart:
    """The episodes of one policy with noise of one standard deviation."""

    policy: str
    noise: float
    records: list[EpisodeRecord]


class NoisyPolicy:
    """A policy with white noise on its actions.

    Args:
        policy: the policy without noise.
        noise: standard deviation, as a fraction of the limits.
        seed: seed of the noise.
    """

    def __init__(self, policy: Policy, noise: float, seed: int) -> None:
        self.policy, self.noise, self.preview = policy, noise, preview_of(policy)
        self._rng = np.random.default_rng(seed)

    def predict(
        self,
        observation: NDArray[Any],
        state: tuple[NDArray[Any], ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[NDArray[Any], ...] | None]:
        """Return the actions with noise, clipped to [-1, 1], and the policy's memory."""
        action, state = self.policy.predict(observation, state, episode_start, deterministic)
        noisy = action + self.noise * self._rng.standard_normal(action.shape)
        return np.clip(noisy, -1.0, 1.0).astype(np.float32), state


def content_hash(parts: Sequence[DatasetPart]) -> str:
    """Return the SHA-256 of all observations, actions, rewards, errors, saturations and failures, in order."""
    digest = hashlib.sha256()
    for part in parts:
        for r in part.records:
            for array in (r.observations[:, :SIZE], r.actions, r.rewards, r.errors, r.saturated, np.array(r.failed)):
                digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def collect(
    policies: Sequence[str], scenario: Scenario, episodes: int, noises: Sequence[float], seed: int
) -> list[DatasetPart]:
    """Return the episodes of each policy with each noise; every episode has its own seed.

    Raises:
        OSError: a policy's file cannot be read.
        ValueError: a policy is unknown, or no path of the scenario is feasible.
        PolicyError: a policy gives no usable action.
    """
    from baselines.policies import make_policy

    parts: list[DatasetPart] = []
    for policy in policies:
        for noise in noises:
            first = seed + episodes * len(parts)
            made = make_policy(policy, scenario.known)
            made = NoisyPolicy(made, noise, first) if noise else made
            parts.append(DatasetPart(policy, noise, run_episodes(made, scenario, episodes, first)))
    return parts


def _write(parts: Sequence[DatasetPart], scenario: Scenario, name: str, folder: Path, card: str) -> None:
    """Write episodes as a Minari dataset, which appears complete or not at all.

    Observations are those of `auv_gym:UnderactuatedAUVTrack-v0`, without the preview of a policy.

    Args:
        parts: the episodes.
        scenario: their scenario.
        name: id of the dataset in Minari.
        folder: folder of Minari's datasets.
        card: Markdown, written to the dataset's folder and used as its description.

    Raises:
        OSError: it cannot be written, or a dataset of this id exists.
        ValueError: Minari refuses the id.
    """
    folder.mkdir(parents=True, exist_ok=True)
    needed, free = sum(map(_size, parts)), shutil.disk_usage(folder).free
    if needed > free:
        raise OSError(
            errno.ENOSPC, f"{os.strerror(errno.ENOSPC)}: {needed} bytes are needed, {free} are free", str(folder)
        )
    for left in folder.glob(f"{_UNFINISHED}*"):
        if time.time() - left.stat().st_mtime > _LEFTOVER:
            shutil.rmtree(left)
    before, made = os.environ.get(LIBRARY_FOLDER), Path(tempfile.mkdtemp(prefix=_UNFINISHED, dir=folder.resolve()))
    os.environ[LIBRARY_FOLDER] = str(made)  # Minari needs an absolute path
    writer = ProcessObject(_Writer)
    try:
        try:
            writer.call("write", parts, scenario, name, card)()
        except (WorkerError, RuntimeError) as error:
            number = errno.ENOSPC if shutil.disk_usage(folder).free < needed else errno.EIO
            raise OSError(number, os.strerror(number), str(folder)) from error
        (made / name / "README.md").write_text(card, encoding="utf-8")
        for file in made.rglob("*"):
            if file.is_file():
                synchronise(file)
        for parent in reversed(Path(name).parents[:-1]):  # the namespaces, each of which Minari describes in a file
            (folder / parent).mkdir(exist_ok=True)
            for file in (made / parent).glob("*.json"):
                file.replace(folder / parent / file.name)
        (made / name).rename(folder / name)
        synchronise((folder / name).parent)
    finally:
        writer.close()
        shutil.rmtree(made)
        os.environ.pop(LIBRARY_FOLDER)
        if before is not None:
            os.environ[LIBRARY_FOLDER] = before


class _Writer:
    """Writes with Minari, in a process of its own: where a write fails, HDF5 prints tracebacks and can crash."""

    def __init__(self) -> None:
        """Discard the standard error of this process."""
        with Path(os.devnull).open("w", encoding="utf-8") as nothing:
            os.dup2(nothing.fileno(), 2)

    def write(self, parts: Sequence[DatasetPart], scenario: Scenario, name: str, card: str) -> None:
        """Write episodes as a dataset in the folder of Minari's environment variable; arguments as in `_write`."""
        import minari
        from minari.data_collector import EpisodeBuffer

        records = [record for part in parts for record in part.records]
        buffers = [EpisodeBuffer(i, record.seed, None, **_buffer_fields(record)) for i, record in enumerate(records)]
        minari.create_dataset_from_buffers(
            name,
            buffers,
            env=_environment(scenario),
            algorithm_name=", ".join(dict.fromkeys(part.policy for part in parts)),
            author="auv_gym contributors",
            description=card,
        )


def _environment(scenario: Scenario) -> Any:
    """Return the environment that Minari recovers from the dataset; its scenario is a name or a dict, as JSON needs."""
    import gymnasium as gym

    from auv_gym.scenarios.presets import PRESETS
    from baselines.evaluation.rollout import EVALUATED_ENV

    preset = PRESETS.get(scenario.name) == scenario
    return gym.make(EVALUATED_ENV, scenario=scenario.name if preset else scenario.to_dict())


def _size(part: DatasetPart) -> int:
    """Return an upper estimate of the bytes that a part takes on disk."""
    arrays = [x for r in part.records for x in (r.observations, r.actions, r.rewards, r.errors, r.saturated, r.times)]
    return sum(x.nbytes for x in arrays) * 3 // 2 + 2**16 * len(part.records)


def _buffer_fields(record: EpisodeRecord) -> dict[str, Any]:
    """Return an episode as the fields of Minari's `EpisodeBuffer`."""
    steps = len(record.actions)
    ends = np.arange(steps) == steps - 1
    return {
        "observations": record.observations[:, :SIZE],
        "actions": record.actions,
        "rewards": record.rewards.tolist(),
        "terminations": (ends & record.failed).tolist(),
        "truncations": (ends & (not record.failed)).tolist(),
        "infos": {"position_error": record.errors, "saturated": record.saturated, "time": record.times},
    }


def dataset_card(parts: Sequence[DatasetPart], scenario: Scenario, name: str, command: str) -> str:
    """Return the card of a dataset as Markdown: its parts, the command that makes it, hash, versions and licence."""
    from baselines.evaluation.metrics import steady_rmse
    from baselines.tools.files import versions

    rows = []
    for part in parts:
        length = max(len(r.errors) for r in part.records) - 1  # a failed episode keeps its last error
        errors = np.array([np.pad(r.errors[1:], (0, length + 1 - len(r.errors)), mode="edge") for r in part.records])
        returns = np.array([r.total_reward for r in part.records])
        rows.append(
            f"| `{part.policy}` | {part.noise:g} | {len(part.records)} | {sum(len(r.actions) for r in part.records)} "
            f"| {returns.mean():.1f} | {returns.min():.1f} | {steady_rmse(errors.T).mean():.3g} "
            f"| {sum(r.failed for r in part.records)} |"
        )
    made = ", ".join(f"{key} {value}" for key, value in versions().items())
    licence = importlib.metadata.metadata("auv-gym")["License-Expression"] or "MIT"
    return "\n".join(
        [
            f"# {name}",
            "",
            "An underactuated underwater vehicle follows a planned trajectory: episodes of",
            f"`auv_gym:UnderactuatedAUVTrack-v0` in the scenario `{scenario.name}`, recorded step by step.",
            "",
            "| policy | noise on actions | episodes | steps | mean return | least return | steady [m] | failed |",
            "|---|---|---|---|---|---|---|---|",
            *rows,
            "",
            "*steady* is the steady-state error: the root mean square of the position error after the first third of",
            "an episode, averaged over the episodes. `auv_gym.decode_observation` gives observations in SI units. The",
            "actions of a policy with memory depend on earlier observations too, and those of a policy with preview on",
            "columns that are not in the dataset.",
            "",
            "| | |",
            "|---|---|",
            f"| made by | `{command}` |",
            f"| SHA-256 of the content | `{content_hash(parts)}` |",
            f"| versions | {made} |",
            f"| licence | {licence} |",
            "",
        ]
    )


def main(arguments: Sequence[str]) -> int:
    """Record a dataset and return the exit status.

    Raises:
        UsageError: the arguments are wrong.
    """
    options = parse(Options, arguments, PROGRAM)
    from baselines.evaluation.request import checked_policies, checked_scenario
    from baselines.evaluation.rollout import PolicyError

    if find_spec("minari") is None or find_spec("h5py") is None:
        raise UsageError(f"datasets need Minari: {install('data')}")
    if not 1 <= options.episodes <= _MOST_EPISODES:
        raise UsageError(f"--episodes is {options.episodes}; it must be an integer from 1 to {_MOST_EPISODES}")
    if not options.policy or not options.noise:
        raise UsageError("--policy and --noise need one value or more")
    if options.id is not None and not re.fullmatch(_ID, options.id):
        raise UsageError(
            f"--id is {options.id!r}; it must be NAME-v0 or FOLDER/NAME-v0, of letters, digits, - and _, with folders "
            "of two letters or more"
        )
    if options.seed < 0:
        raise UsageError(f"--seed is {options.seed}; it must be at least 0")
    for noise in options.noise:
        if not 0 <= noise <= 1 or not math.isfinite(noise):
            raise UsageError(f"--noise is {noise}; it must be in [0, 1]")
    scenario, policies = checked_scenario(options.scenario), checked_policies(options.policy)
    default = (re.sub(r"[^\w-]+", "_", text, flags=re.ASCII) for text in (scenario.name, "-".join(policies)))
    name = options.id or f"auv_gym/{'/'.join(default)}-v0"
    folder = checked_folder(options.out)
    if (folder / name).exists():
        raise UsageError(f"{folder / name} exists; choose another --id, or delete it")
    try:
        parts = collect(policies, scenario, options.episodes, options.noise, options.seed)
        command = typed(PROGRAM, arguments)
        _write(parts, scenario, name, folder, dataset_card(parts, scenario, name, command))
    except ValueError as error:
        raise UsageError(str(error)) from error
    except PolicyError as error:
        print(f"{called(PROGRAM)}: {error}", file=sys.stderr)
        return FAILED
    episodes = sum(len(part.records) for part in parts)
    steps = sum(len(record.actions) for part in parts for record in part.records)
    print(f"{name}: {episodes} episodes, {steps} steps in {folder / name}")
    return DONE

"""The options of train.py: each field is an option, and its docstring is the help text."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

PROGRAM = "train.py"


@dataclass(frozen=True)
class Options:
    """Train a network that corrects an expert; write the agent, its learning curve and a checkpoint to a folder.

    Exit status: 0 done, 1 the training failed or could not be written, 2 wrong usage.
    """

    algo: str = "apg"
    """The algorithm: "apg" (analytic gradient: back-propagation through the simulator), or one of
    Stable-Baselines3: "ppo", "ppo_lstm", "sac", "td3", "tqc"."""
    scenario: Annotated[tuple[str, ...], arg(metavar="S [S ...]", help_behavior_hint="")] = ()
    """Training scenarios: names of presets, .toml and .json files, or a mixture; NAME:WEIGHT sets the weight.
    The mixtures "cruise" and "slow" have all cases of a speed range, storms with weight three, noise and slow actuators
    with weight two. "cruise-adverse" and "slow-adverse" also have storms with sensor and actuator faults. "helm" has
    both speed ranges and actuators with a rate limit, as the agent of that name.
    Default: cruise, or the scenarios of the initial agent."""
    expert: Annotated[str | None, arg(metavar="E", help_behavior_hint="")] = None
    """Name of the policy that is corrected; "none" for an agent without an expert. Default: backstepping."""
    authority: Annotated[tuple[float, ...], arg(metavar="A [A]", help_behavior_hint="")] = ()
    """Largest correction of surge and yaw command, as fractions of the vehicle's limits, in (0, 2]; one number for
    both. Default: from the hyper-parameters."""
    from_: Annotated[str | None, arg(name="from", metavar="AGENT", help_behavior_hint="")] = None
    """Initial agent, by name or folder, such as "helm". Its weights, network, inputs, expert and authority are used in
    a short training with small learning rates. Default: a new network, whose correction is zero."""
    vehicle: Annotated[str | None, arg(metavar="V", help_behavior_hint="")] = None
    """Vehicle to train for, a published one by name or a .toml file. The scenarios are adapted to it. Scenarios that
    are too slow for its fins are left out."""
    seed: int = 0
    """Seed of networks, exploration and episodes."""
    seeds: int = 1
    """Number of seeds, from --seed on; each has its own folder seed-N."""
    jobs: Annotated[int | None, arg(metavar="INT", help_behavior_hint="")] = None
    """Worker processes for several seeds, or for the groups of a single training of apg, one thread each.
    Default: 2, or 1 on a single processor."""
    timesteps: Annotated[int | None, arg(metavar="INT", help_behavior_hint="")] = None
    """Control steps to train for, summed over vehicles. Default: from the hyper-parameters."""
    hyperparameters: Annotated[Path | None, arg(metavar="FILE.yml", help_behavior_hint="")] = None
    """File in the format of rl_zoo3. Default: the file of the package."""
    set: Annotated[tuple[str, ...], arg(metavar="NAME=VALUE [...]", help_behavior_hint="")] = ()
    """Hyper-parameters that replace those of the file, such as "effort_weight=0.1" or "preview=[5,10]"."""
    out: Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="")] = None
    """Folder of the run; existing files are not overwritten. Default: runs/train/ALGO-SCENARIO-VEHICLE, or
    runs/train/AGENT-SCENARIO-VEHICLE with --from."""
    resume: bool = False
    """Continue the run that the same options have started in the folder, from its last checkpoint."""

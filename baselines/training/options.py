"""The options of train.py: a field is an option, its docstring the help."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

PROGRAM = "train.py"


@dataclass(frozen=True)
class Options:
    """Train a network that corrects an expert; keep it, its learning curve and all it takes to go on in a folder.

    Exit status: 0 done, 1 the training failed or could not be written, 2 wrong usage.
    """

    algo: str = "apg"
    """The algorithm: "apg" (analytic gradient: back-propagation through the simulator), or one of
    Stable-Baselines3: "ppo", "ppo_lstm", "sac", "td3", "tqc"."""
    scenario: Annotated[tuple[str, ...], arg(metavar="S [S ...]", help_behavior_hint="")] = ()
    """What to train on: names of presets, .toml and .json files, or a regime, "cruise" or "slow", for all of its cases
    (storms three times, noise and slow actuators twice as often), or "cruise-adverse" or "slow-adverse", for these and
    storms in which sensors, commands, actuators and current are not as known, or "helm", for both regimes and slewing
    actuators, as the agent of that name; NAME:WEIGHT weighs one against the others.
    Default: cruise, or what the agent was trained on that it begins with."""
    expert: Annotated[str | None, arg(metavar="E", help_behavior_hint="")] = None
    """The policy that is corrected, by name; "none" to learn without one. Default: backstepping."""
    authority: Annotated[tuple[float, ...], arg(metavar="A [A]", help_behavior_hint="")] = ()
    """Largest correction of surge and yaw command, as fractions of the vehicle's limits, in (0, 2]; one number for
    both. Default: what the hyper-parameters say."""
    from_: Annotated[str | None, arg(name="from", metavar="AGENT", help_behavior_hint="")] = None
    """An agent to begin with, by name or folder, such as "helm": its weights, network, inputs, expert and authority, in
    a short training at low rates. Default: a network that corrects nothing yet."""
    vehicle: Annotated[str | None, arg(metavar="V", help_behavior_hint="")] = None
    """The vehicle that it is for, a published one by name or a .toml file: the scenarios are made to fit it, and those
    below the speed at which its fins steer it are left out."""
    seed: int = 0
    """Seed of networks, exploration and episodes."""
    seeds: int = 1
    """How many seeds to train with, from the one above on, each in a folder seed-N of its own."""
    jobs: Annotated[int | None, arg(metavar="INT", help_behavior_hint="")] = None
    """Worker processes for several seeds, or for the groups of a single training of apg, one thread each.
    Default: 2, or 1 on a single processor."""
    timesteps: Annotated[int | None, arg(metavar="INT", help_behavior_hint="")] = None
    """Control steps to train for, summed over vehicles. Default: what the hyper-parameters say."""
    hyperparameters: Annotated[Path | None, arg(metavar="FILE.yml", help_behavior_hint="")] = None
    """In rl_zoo3's format. Default: those that ship with the package."""
    set: Annotated[tuple[str, ...], arg(metavar="NAME=VALUE [...]", help_behavior_hint="")] = ()
    """Hyper-parameters in place of the file's, such as "effort_weight=0.1" or "preview=[5,10]"."""
    out: Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="")] = None
    """Folder of the run; nothing in it is overwritten. Default: runs/train/ALGO-SCENARIO, with the agent
    that it begins with in place of these, and -VEHICLE behind."""
    resume: bool = False
    """Go on with the run that the same options have begun in the folder, from its last checkpoint."""

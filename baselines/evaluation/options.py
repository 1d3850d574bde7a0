"""The options of evaluate.py: a field is an option, its docstring the help."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import OmitArgPrefixes, arg

from baselines.evaluation.about import NOTHING, About


@dataclass(frozen=True)
class Options:
    """Run policies through the same episodes; print the table, write report.html, results.json and results.csv.

    The expert, backstepping, always runs too: its effort and smoothness are the reference of the others. Exit status: 0
    done, 1 a policy failed or the results could not be written, 2 wrong usage.
    """

    policy: Annotated[tuple[str, ...], arg(metavar="P [P ...]", help_behavior_hint="")] = ()
    """Policies, compared with the expert; without any, the expert alone. By name; FILE.py:FACTORY; a FILE.zip of
    Stable-Baselines3; a FILE.onnx; "cmd:COMMAND", a program in any language that is asked line by line, see
    docs/programs.md; the folder of a trained agent, or of the run that trained it. ":fade" behind an agent's name or
    folder makes its corrections fade where it leaves what it has seen."""
    suite: Annotated[str | None, arg(metavar="S", help_behavior_hint="")] = None
    """Frozen: "benchmark-v2" (the default), "benchmark-v1" (the same episodes; the score's 1 is the oracle's),
    "benchmark-v1-validation", "ood-v1", "unmodelled-v1" or "deep-v1"; other policies are shown as they were recorded.
    Drawn from the seed: "presets" (every preset)."""
    scenario: Annotated[tuple[str, ...], arg(metavar="S [S ...]", help_behavior_hint="")] = ()
    """Scenarios in place of a suite: names of presets, or .toml and .json files."""
    episodes: Annotated[int | None, arg(metavar="INT", help_behavior_hint="")] = None
    """Episodes of each policy in each scenario. Default: 20; in a frozen suite all of them."""
    seed: int = 0
    """Seed of the first episode that is drawn; episode i has seed + i, whatever the policy."""
    jobs: Annotated[int | None, arg(metavar="INT", help_behavior_hint="")] = None
    """Worker processes; the results are the same for any number. Default: 2, or 1 on a single processor."""
    out: Path = Path("runs/evaluate")
    """Folder for the results."""
    png: bool = False
    """Also write the report's charts as PNG files."""
    step_limit: float = 0.1
    """Seconds that a policy may take for a decision, on average; a slower one fails."""
    submit: Annotated[str | None, arg(metavar="NAME", help_behavior_hint="")] = None
    """Also write what the policy did in the whole suite as a submission, NAME.npz in the folder, to enter the
    leaderboard with; see docs/enter.md."""
    about: Annotated[About, OmitArgPrefixes] = NOTHING
    """What is said of a submission, all of it optional."""
    resume: bool = False
    """Use the finished runs that an interrupted evaluation has left in the folder; where the policy's file or the
    simulator has changed since, or it is too slow for --step-limit, it runs again."""

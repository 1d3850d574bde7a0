"""Look into what policies know of vehicle and sea: `python -m research probing`.

Probes of an agent's memory, memories exchanged between vehicles, vehicles that change in mid-run, the range of a
training, errors outside of it, and the sensitivity to model error. docs/knows.md shows what comes out for the
shipped agents.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import arg

from auv_gym.scenarios.names import REGIMES
from baselines.agents.names import agent_folder
from baselines.evaluation.rollout import PolicyError
from baselines.evaluation.score import FORESIGHTED
from baselines.policies import list_policies, make_policy
from baselines.tools.command_line import DONE, FAILED, UsageError, called, parse
from baselines.tools.files import json_text, write_atomically
from research.pages import fill
from research.probing.adaptation import adapted
from research.probing.changes import SEAS
from research.probing.extrapolation import stretched
from research.probing.memory_swap import swapped
from research.probing.model_error import with_wrong_models
from research.probing.page import FOLDER, context, figures, load
from research.probing.probe import probed
from research.probing.training_range import ranged
from research.probing.watching import remembering

PROGRAM = "python -m research probing"
RANGE = "training_range"  # what an agent was trained on: of all regimes at once
POLICIES = ("helm", "nmpc", "integral-normalised", "backstepping")
"""Whose adaptation and errors are measured by default; of those that remember the memories are read."""
OTHERS: Mapping[str, tuple[str, ...]] = {
    RANGE: ("helm", "helm-any"),
    "model_error": ("helm-any", "helm", "ekf", "backstepping", "nmpc"),
}
"""Who is measured by default in the other parts."""


def _in_seas(name: str, regime: str, episodes: int | None) -> dict[str, Any]:
    return {sea: adapted(name, regime, sea, episodes) for sea in SEAS}


_PARTS: Mapping[str, Callable[[str, str, int | None], dict[str, Any]]] = {
    "probe": probed,
    "memory_swap": swapped,
    "adaptation": _in_seas,
    "extrapolation": stretched,
    "model_error": with_wrong_models,
}
"""What is looked into, by name, for a policy in a regime with so many episodes."""
OF_AGENTS = ("probe", "memory_swap", RANGE)
"""Parts that only agents have."""


@dataclass(frozen=True)
class Options:
    """Look into what policies know: memories, adaptation, training ranges; a file for each part and policy.

    All of it takes about twenty minutes of one core. Exit status: 0 done, 1 a policy failed, 2 wrong usage.
    """

    policy: Annotated[tuple[str, ...], arg(metavar="P [P ...]", help_behavior_hint="")] = ()
    """Policies by name, or agents by their folder. Memories and training ranges are those of the agents among them.
    Default: those of docs/knows.md."""
    part: Annotated[tuple[str, ...], arg(metavar="PART [PART ...]", help_behavior_hint="")] = (*_PARTS, RANGE)
    """What to look into: probe, memory_swap, adaptation, extrapolation, model_error, training_range."""
    regime: Annotated[tuple[str, ...], arg(metavar="R [R ...]", help_behavior_hint="")] = REGIMES
    """Ranges of speeds: slow, cruise."""
    episodes: Annotated[int | None, arg(metavar="INT", help_behavior_hint="")] = None
    """Episodes of each kind. Default: 960 for probes, 40 for adaptation, 32 pairs for memory swaps, 12 for
    extrapolation and in each case for model errors."""
    out: Path = FOLDER
    """Folder for the files; what other policies did is left in it. Figures and probing.md go there too, unless it is
    that of docs/knows.md."""


def main(arguments: Sequence[str]) -> int:
    """Look as the arguments say and return the exit status.

    Raises:
        UsageError: the arguments do not make sense.
    """
    options = parse(Options, arguments, PROGRAM)
    policies = tuple(list_policies())
    for given, known, what in (
        ([p for p in options.policy if agent_folder(p) is None], policies, "the name of a policy or an agent's folder"),
        (options.part, (*_PARTS, RANGE), "a part"),
        (options.regime, REGIMES, "a regime"),
    ):
        if unknown := [name for name in given if name not in known]:
            raise UsageError(f"{unknown[0]!r} is not {what}; allowed are {', '.join(known)}")
    if wise := [name for name in options.policy if name in FORESIGHTED]:
        raise UsageError(f"{wise[0]} looks behind the observation: nobody need ask what it knows; leave it out")
    if options.episodes is not None and options.episodes < 6:
        raise UsageError(f"--episodes is {options.episodes}; it must be 6 or more: what is fitted has to be tested")
    asked = [(part, name) for part in options.part for name in options.policy or OTHERS.get(part, POLICIES)]
    remember = {name for _, name in asked if agent_folder(name) and remembering(make_policy(name))}
    if not remember and set(options.part) <= set(OF_AGENTS):
        raise UsageError(
            f"none of {', '.join(options.policy)} has a network that remembers; name an agent such as helm"
        )
    options.out.mkdir(parents=True, exist_ok=True)
    done = [_kept(part, name, options) for part, name in asked if part not in OF_AGENTS or name in remember]
    _show(options.out)
    return DONE if all(done) else FAILED


def _kept(part: str, name: str, options: Options) -> bool:
    """Look into a part of a policy and keep what comes out, beside other regimes; return whether it could."""
    kept = Path(name).name  # of an agent's folder
    file = options.out / f"{part}-{kept}.json"
    try:
        if part == RANGE:
            record = ranged(name)
        else:
            record = load(options.out).get((part, kept), {})
            for regime in options.regime:
                record[regime] = _PARTS[part](name, regime, options.episodes)
                print(f"{part}: {name}, {regime}", flush=True)
    except (ValueError, PolicyError) as error:
        print(f"{called(PROGRAM)}: {part} of {name}: {error}", file=sys.stderr)
        return False
    write_atomically(file, json_text(record))
    return True


def _show(folder: Path) -> None:
    """Print where the results are, and write page and figures beside them unless they are those of docs/knows.md."""
    if folder.resolve() == FOLDER.resolve():
        print("now: python -m research pages knows")
        return
    (folder / "images").mkdir(exist_ok=True)
    for name, picture in figures("probing", folder).items():
        write_atomically(folder / "images" / name, picture)
    write_atomically(folder / "probing.md", fill("probing", context("probing", folder)))
    print(f"written: {folder / 'probing.md'} and its figures")

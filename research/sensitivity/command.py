"""Measure the sensitivity of policies: `python -m research sensitivity --help`; docs/sensitivity.md has results."""

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
from baselines.policies import list_policies
from baselines.tools.command_line import DONE, FAILED, UsageError, called, check_words, parse
from baselines.tools.files import json_text, write_atomically
from research.pages import fill
from research.sensitivity.adaptation import adaptation_of
from research.sensitivity.changes import SEAS
from research.sensitivity.extrapolation import stretched
from research.sensitivity.model_error import with_wrong_models
from research.sensitivity.page import SENSITIVITY_FOLDER, context, figures, load_sensitivity

PROGRAM = "python -m research sensitivity"
_POLICIES = ("helm", "nmpc", "integral-normalised", "backstepping")
"""Policies by default."""
OTHERS: Mapping[str, tuple[str, ...]] = {"model_error": ("helm-any", "helm", "ekf", "backstepping", "nmpc")}
"""Policies by default where they are others."""


def _in_seas(name: str, regime: str, episodes: int | None) -> dict[str, Any]:
    return {sea: adaptation_of(name, regime, sea, episodes) for sea in SEAS}


_PARTS: Mapping[str, Callable[[str, str, int | None], dict[str, Any]]] = {
    "adaptation": _in_seas,
    "extrapolation": stretched,
    "model_error": with_wrong_models,
}
"""The studies by name: what a policy does in a regime, in so many episodes."""


@dataclass(frozen=True)
class Options:
    """Measure the sensitivity of policies to change, extrapolation and model error; a file for each part and policy.

    All of it takes about twenty minutes of one core. Exit status: 0 done, 1 a policy failed, 2 wrong usage.
    """

    policy: Annotated[tuple[str, ...], arg(metavar="P [P ...]", help_behavior_hint="")] = ()
    """Policies by name, or agents by their folder. Default: those of docs/sensitivity.md."""
    part: Annotated[tuple[str, ...], arg(metavar="PART [PART ...]", help_behavior_hint="")] = tuple(_PARTS)
    """What to measure: adaptation, extrapolation, model_error."""
    regime: Annotated[tuple[str, ...], arg(metavar="R [R ...]", help_behavior_hint="")] = REGIMES
    """Ranges of speeds: slow, cruise."""
    episodes: Annotated[int | None, arg(metavar="INT", help_behavior_hint="")] = None
    """Episodes of each kind. Default: 40 for adaptation, 12 for extrapolation and in each case for model errors."""
    out: Path = SENSITIVITY_FOLDER
    """Folder for the files. Results of other policies are left in it. Figures and a page go there too, unless it is the
    folder of docs/sensitivity.md."""


def main(arguments: Sequence[str]) -> int:
    """Measure as the arguments say and return the exit status.

    Raises:
        UsageError: the arguments do not make sense.
    """
    options = parse(Options, arguments, PROGRAM)
    check_words("policy", [name for name in options.policy if agent_folder(name) is None], list_policies())
    check_words("part", options.part, _PARTS)
    check_words("regime", options.regime, REGIMES)
    if wise := [name for name in options.policy if name in FORESIGHTED]:
        raise UsageError(f"{wise[0]} uses more than the observation, so it has no model to be wrong; leave it out")
    if options.episodes is not None and options.episodes < 2:
        raise UsageError(f"--episodes is {options.episodes}; it must be 2 or more, since intervals are over episodes")
    options.out.mkdir(parents=True, exist_ok=True)
    asked = [(part, name) for part in options.part for name in options.policy or OTHERS.get(part, _POLICIES)]
    done = [_kept(part, name, options) for part, name in asked]
    _show(options.out)
    return DONE if all(done) else FAILED


def _kept(part: str, name: str, options: Options) -> bool:
    """Run a part with a policy and keep its result beside those of other regimes; return whether it could be run."""
    kept = Path(name).name  # of an agent's folder
    record = load_sensitivity(options.out).get((part, kept), {})
    try:
        for regime in options.regime:
            record[regime] = _PARTS[part](name, regime, options.episodes)
            print(f"{part}: {name}, {regime}", flush=True)
    except (ValueError, PolicyError) as error:
        print(f"{called(PROGRAM)}: {part} of {name}: {error}", file=sys.stderr)
        return False
    write_atomically(options.out / f"{part}-{kept}.json", json_text(record))
    return True


def _show(folder: Path) -> None:
    """Print where the results are; write page and figures beside them unless they are those of docs/."""
    if folder.resolve() == SENSITIVITY_FOLDER.resolve():
        print("now: python -m research pages sensitivity")
        return
    (folder / "images").mkdir(exist_ok=True)
    for name, picture in figures("sensitivity", folder).items():
        write_atomically(folder / "images" / name, picture)
    write_atomically(folder / "sensitivity.md", fill("sensitivity", context("sensitivity", folder)))
    print(f"written: {folder / 'sensitivity.md'} and its figures")

"""Compare a guard's thresholds, and what it hands over to: `python -m research guard-thresholds`.

Policies run with every guard of `GUARDS` in the cases of a regime and in worlds in which agents are lost, all drawn
from seeds that no suite has. A guard is to save episodes that the expert keeps, and to leave alone what goes well.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from tyro.conf import arg

from auv_gym.installation import checkout
from auv_gym.physics.namespaces import Array
from auv_gym.scenarios.mixtures import OUTAGE_TIMES, SLEW_TIMES, adverse, hasty, slewing
from auv_gym.scenarios.presets import CASES, PRESETS, REGIMES
from auv_gym.scenarios.scenario import Scenario, Start
from auv_gym.task.policy import Policy
from baselines.agents.guard import Guarded, Thresholds, bounded_law
from baselines.evaluation.request import checked_policies
from baselines.evaluation.runner import drawn
from baselines.evaluation.score import EXPERT, cut, is_lost, largest_tail
from baselines.evaluation.side_by_side import SideBySide
from baselines.policies import make_policy
from baselines.tools.command_line import DONE, UsageError, check_words, parse
from baselines.tools.files import json_text, read_json, write_atomically
from research import DATA
from research.seeds import GUARD

PROGRAM = "python -m research guard-thresholds"
FILE = DATA / "guards.json"  # what guards did
EPISODES = 16  # of each case
IN_WORLDS = 48  # of each world in which agents are lost
FAR = 4.0  # [m] how far off a far start is, on each axis
USUAL = "as shipped"  # the guard of a name with `:guard`
Guard = Callable[[Policy], Policy]  # puts a guard around a policy
Lost = NDArray[np.bool_]  # which episodes are lost


def _guard(fallback: str | None = None, **thresholds: float) -> Guard:
    """Return what puts a guard around a policy; without a fallback by name the usual one."""

    def around(policy: Policy) -> Policy:
        other = make_policy(fallback) if fallback else bounded_law()
        return Guarded(policy, other, thresholds=Thresholds(**thresholds))

    return around


GUARDS: Mapping[str, Guard] = {
    "none": lambda policy: policy,
    USUAL: _guard(),
    "to the law as printed": _guard(EXPERT),
    "to `backstepping-normalised`": _guard("backstepping-normalised"),
    "to `ekf-adverse`": _guard("ekf-adverse"),
    "gives back four times as soon": _guard(hold=Thresholds.hold / 4),
    "energy alone": _guard(most=4.0),
    "energy 2.5, at the limit 75 %": _guard(energy=2.5, exhausted=0.75),
}
"""Guards that are compared, by what they do."""
POLICIES = ("helm", "apg-preview", "td3")
"""Families of agents that the thresholds are chosen for."""


@dataclass(frozen=True)
class Options:
    """Run agents with different guards through episodes of their own and keep what each does.

    Exit status: 0 done, 2 wrong usage.
    """

    policy: Annotated[tuple[str, ...], arg(metavar="P [P ...]", help_behavior_hint="")] = POLICIES
    """Agents by name, without the regime where there is one for each."""
    regime: Annotated[tuple[str, ...], arg(metavar="R [R ...]", help_behavior_hint="")] = REGIMES
    """Slow, cruise, or both."""
    guard: Annotated[tuple[str, ...], arg(metavar="G [G ...]", help_behavior_hint="")] = tuple(GUARDS)
    """Guards by name; those that were run before stay."""
    episodes: int = EPISODES
    """Of each case; three times as many in each world in which agents are lost."""
    out: Path = FILE if checkout() else Path("runs/guards.json")
    """File to which what they do is added."""


@lru_cache(maxsize=2)
def worlds(regime: str, episodes: int) -> SideBySide:
    """Return the episodes of a regime: the first eight cells are its cases, the others worlds with lost agents."""
    longest = max(SLEW_TIMES)
    hard = [adverse(regime), slewing(adverse(regime), longest)]
    hard += [slewing(PRESETS[f"{regime}-{case}"], longest) for case in ("storm", "actuator")]
    hard += [hasty()] if regime == "cruise" else []
    hard += [_far(PRESETS[f"{regime}-storm"]), _patchy(PRESETS[f"{regime}-storm"], OUTAGE_TIMES[regime])]
    cells = [drawn(PRESETS[f"{regime}-{case}"], episodes, GUARD.first) for case in CASES]
    each = episodes * IN_WORLDS // EPISODES
    return SideBySide([*cells, *(drawn(scenario, each, GUARD.first) for scenario in hard)])


def _far(storm: Scenario) -> Scenario:
    """Return the storm with starts from anywhere near: there the energy is large, and nothing is wrong."""
    start = Start(x_e=(-FAR, FAR), y_e=(-FAR, FAR), psi_e=(-math.pi, math.pi), surge=(0.0, 1.0))
    return replace(storm, name=f"{storm.name}-far", start=start)


def _patchy(storm: Scenario, times: tuple[float, float]) -> Scenario:
    """Return the storm with long outages of the position fix: what is measured then is no error."""
    longer = (2.0 * times[0], 2.0 * times[1])
    return replace(storm, name=f"{storm.name}-patchy", sensors=replace(storm.sensors, outages=2.0, outage_time=longer))


def outcome(policy: Policy, regime: str, episodes: int) -> tuple[Array, Lost]:
    """Return capped tails [m], and which episodes are lost, of all cells in a row."""
    cap = largest_tail(regime)
    ended = worlds(regime, episodes).run(policy)
    tails, lost = [cut(e.tail, e.lost, cap) for e in ended], [is_lost(e.tail, e.lost, cap) for e in ended]
    return np.concatenate(tails), np.concatenate(lost)


def main(arguments: Sequence[str]) -> int:
    """Compare as the arguments say and return the exit status.

    Raises:
        UsageError: the arguments do not make sense.
    """
    options = parse(Options, arguments, PROGRAM)
    check_words("regime", options.regime, REGIMES)
    check_words("guard", options.guard, GUARDS)
    if not 1 <= options.episodes <= 10_000:
        raise UsageError(f"--episodes is {options.episodes}; it must be in [1, 10000]")
    options.out.parent.mkdir(parents=True, exist_ok=True)
    for regime in options.regime:
        _, expert = outcome(make_policy(EXPERT), regime, options.episodes)
        for family in options.policy:
            (name,) = checked_policies((family if family == "helm" else f"{family}-{regime}",))
            for guard in options.guard:
                tails, lost = outcome(GUARDS[guard](make_policy(name)), regime, options.episodes)
                row = _row(tails, lost, expert, len(CASES) * options.episodes)
                _add(options.out, f"{name}, {regime}", guard, row)
                print(f"{name}, {regime}, guard {guard}: {row}", flush=True)
    return DONE


def _row(tails: Array, lost: Lost, expert: Lost, usual: int) -> dict[str, Any]:
    """Return what is kept; the first episodes, so many, are those of the usual cases."""
    own = lost & ~expert
    return {
        "episodes": [usual, len(tails) - usual],
        "lost": [int(lost[:usual].sum()), int(lost[usual:].sum())],
        "expert_keeps": [int(own[:usual].sum()), int(own[usual:].sum())],
        "tail_mm": [1e3 * float(tails[:usual].mean()), 1e3 * float(tails[usual:].mean())],
    }


def _add(file: Path, policy: str, guard: str, row: dict[str, Any]) -> None:
    record = read_json(file) if file.exists() else {}
    record.setdefault("thresholds", {}).setdefault(policy, {})[guard] = row
    write_atomically(file, json_text(record))

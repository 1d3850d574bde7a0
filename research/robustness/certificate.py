"""Count the episodes that policies lose, with the share that is still likely: `python -m research failure-rate --help`.

Episodes are drawn from seeds of their own, on which nothing is trained, tuned or chosen, the same number of each
scenario. The upper end of the interval is exact for equal chances (Clopper and Pearson, Biometrika 26 (1934) 404).
Where the scenarios' chances differ, it is on the safe side: of all chances with the same mean the equal ones make few
losses the likeliest, where few is one below the expected number, or less (Hoeffding, Annals of Mathematical Statistics
27 (1956) 713).
"""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import Positional, arg

from auv_gym.installation import checkout
from auv_gym.scenarios.mixtures import adverse
from auv_gym.scenarios.presets import CASES, PRESETS, REGIMES
from auv_gym.scenarios.scenario import Scenario
from baselines.evaluation.fingerprints import fingerprint
from baselines.evaluation.metrics import most_lost
from baselines.evaluation.request import checked_policies, checked_scenario
from baselines.evaluation.rollout import PolicyError, rollout
from baselines.evaluation.runner import drawn
from baselines.evaluation.score import largest_tail, losses
from baselines.policies import make_policy
from baselines.tools.command_line import DONE, FAILED, UsageError, called, parse
from baselines.tools.files import json_text, read_json, write_atomically
from research import DATA
from research.seeds import FAILURE_RATE

PROGRAM = "python -m research failure-rate"
FILE = DATA / "certificates.json"  # what was counted
_EPISODES = 10_000  # of all scenarios that are named together
AT_ONCE = 250  # episodes of a scenario that run side by side
ADVERSE = tuple(f"{regime}-adverse" for regime in REGIMES)
"""Names of the storms in which sensors, commands, actuators and current are not as told."""


@dataclass(frozen=True)
class Options:
    """Run policies through many fresh episodes, count those that are lost, and say which share is still likely.

    Exit status: 0 done, whatever was lost, 1 a policy failed, 2 wrong usage.
    """

    policy: Annotated[Positional[tuple[str, ...]], arg(metavar="POLICY [POLICY ...]")]
    """Policies by name, folder or file."""
    scenario: Annotated[tuple[str, ...], arg(metavar="S [S ...]", help_behavior_hint="")] = REGIMES
    """Presets, scenario files, slow or cruise for the eight cases of a regime, slow-adverse or cruise-adverse for
    storms in which anything may be wrong."""
    episodes: int = _EPISODES
    """Of each name of --scenario; those of a regime are shared evenly among its cases. Those that were run before
    count."""
    out: Path = FILE if checkout() else Path("runs/certificates.json")
    """File for the counts, to which episodes are added."""


@dataclass(frozen=True)
class Count:
    """What a policy did in some episodes of a scenario, those of the first seeds of `FAILURE_RATE`."""

    scenario: str  # SHA-256 of it
    episodes: int = 0
    lost: int = 0  # see `score.is_lost`
    largest_tail_m: float = 0.0

    def with_more(self, episodes: int, lost: int, largest_tail_m: float) -> Count:
        """Return the count of these episodes and of others of the scenario."""
        worst = max(self.largest_tail_m, largest_tail_m)
        return Count(self.scenario, self.episodes + episodes, self.lost + lost, worst)


def _scenarios_of(name: str) -> tuple[Scenario, ...]:
    """Return the scenarios that a word of the command line stands for.

    Raises:
        UsageError: it stands for none.
    """
    if name in REGIMES:
        return tuple(PRESETS[f"{name}-{case}"] for case in CASES)
    if name in ADVERSE:
        return (adverse(name.partition("-")[0]),)
    return (checked_scenario(name, (*REGIMES, *ADVERSE)),)


def counted(policy: str, scenario: Scenario, first: int, episodes: int) -> tuple[int, int, float]:
    """Return episodes, lost ones and the largest tail [m] of a policy, in `first` and the following ones.

    Raises:
        PolicyError: its actions are not finite.
    """
    cell = drawn(scenario, episodes, FAILURE_RATE.first + first)
    found = rollout(make_policy(policy, scenario.vehicle), scenario, cell.episodes).measures
    return episodes, losses(found, largest_tail(scenario.name)), float(found.tail.max())


def kept(file: Path = FILE) -> dict[str, dict[str, Any]]:
    """Return what was counted, by policy: its fingerprint, and a `Count` by scenario.

    Raises:
        ValueError: the file is damaged.
    """
    if not file.exists():
        return {}
    try:
        return {
            policy: {
                "fingerprint": own["fingerprint"],
                "counts": {scenario: Count(**count) for scenario, count in own["counts"].items()},
            }
            for policy, own in read_json(file).items()
        }
    except (TypeError, KeyError, AttributeError) as error:
        raise ValueError(
            f"{file} does not hold what {PROGRAM} writes; delete it, or name another with --out"
        ) from error


def together(counts: Sequence[Count]) -> tuple[int, int]:
    """Return how many episodes were lost, and of how many."""
    return sum(count.lost for count in counts), sum(count.episodes for count in counts)


def told(lost: int, episodes: int) -> str:
    """Return a count in words, with the upper end of the one-sided 95 % interval of the share."""
    return f"{lost} of {episodes} lost, at most {100 * most_lost(lost, episodes):.2g} % (one-sided, 95 %)"


def main(arguments: Sequence[str]) -> int:
    """Count as the arguments say and return the exit status.

    Raises:
        UsageError: the arguments do not make sense.
    """
    options = parse(Options, arguments, PROGRAM)
    named = {name: _scenarios_of(name) for name in options.scenario}
    if not (options.episodes >= 1 and FAILURE_RATE.holds(FAILURE_RATE.first, options.episodes)):
        most = FAILURE_RATE.end - FAILURE_RATE.first
        raise UsageError(f"--episodes is {options.episodes}; it must be in [1, {most}]")
    policies = checked_policies(options.policy)
    try:
        kept(options.out)
    except ValueError as error:
        raise UsageError(str(error)) from error
    options.out.parent.mkdir(parents=True, exist_ok=True)
    try:
        for policy in policies:
            for name, scenarios in named.items():
                share = -(-options.episodes // len(scenarios))  # of each, rounded up
                for target in (*range(AT_ONCE, share, AT_ONCE), share):  # in turns, so that none is ahead if it stops
                    counts = [_until(policy, scenario, target, options.out) for scenario in scenarios]
                print(f"{policy}, {name}: {told(*together(counts))}", flush=True)
    except PolicyError as error:
        print(f"{called(PROGRAM)}: {policy} failed: {error}", file=sys.stderr)
        return FAILED
    return DONE


def _until(policy: str, scenario: Scenario, episodes: int, out: Path) -> Count:
    """Run a policy until so many episodes of a scenario are counted in a file; return the count."""
    text = json.dumps(scenario.to_dict(), sort_keys=True, allow_nan=False)
    fresh, print_ = Count(hashlib.sha256(text.encode()).hexdigest()), fingerprint(policy)
    while True:
        record: dict[str, Mapping[str, Any]] = dict(kept(out))
        own = record.get(policy, {})
        counts = dict(own["counts"]) if own.get("fingerprint") == print_ else {}
        count = counts.get(scenario.name, fresh)
        count = count if count.scenario == fresh.scenario else fresh
        if count.episodes >= episodes:
            return count
        more = counted(policy, scenario, count.episodes, min(AT_ONCE, episodes - count.episodes))
        record[policy] = {"fingerprint": print_, "counts": {**counts, scenario.name: count.with_more(*more)}}
        plain = {
            name: {"fingerprint": of["fingerprint"], "counts": {key: asdict(c) for key, c in of["counts"].items()}}
            for name, of in record.items()
        }
        write_atomically(out, json_text(plain))

"""Count what agents lose that fall silent or meet speeds beyond their training: `auv-gym silence --help`.

`python -m baselines.evaluation.silence` counts how many fresh episodes of all cases are lost, and
keeps the counts in `baselines/evaluation/data/silence.json`, from which `make results` writes them.
"""

from __future__ import annotations

import json
import sys
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from auv_gym.installation import checkout
from auv_gym.presets import CASES, PRESETS, REGIMES
from auv_gym.scenario import RandomPath, Scenario
from baselines import make_policy
from baselines.agents.residual_policy import ResidualPolicy
from baselines.control.backstepping import StabilityWarning
from baselines.evaluation.fresh import AGENTS, SEED
from baselines.evaluation.rollout import rollout
from baselines.evaluation.runner import STEP_LIMIT, drawn
from baselines.evaluation.score import EXPERT, losses, waters_of
from baselines.tools.command_line import DONE, parse, run
from baselines.tools.files import json_text, write_atomically

PROGRAM = "python -m baselines.evaluation.silence"
FILE = Path(__file__).parent / "data" / "silence.json"  # what is kept of the measurement
EPISODES = 15  # of each of the eight cases
FAST = (1.5, 2.0)  # [m/s] speeds above those that any agent was trained at


@dataclass(frozen=True)
class Options:
    """Count the episodes that agents lose whose network falls silent after a third, or that are faster than trained.

    Exit status: 0 done, 2 wrong usage.
    """

    episodes: int = EPISODES
    """Of each case."""
    out: Path = FILE if checkout() else Path("runs/silence.json")
    """File for the counts."""


def lost(policy: str, scenarios: Sequence[Scenario], episodes: int, silent: bool = False) -> int:
    """Return how many episodes a policy loses; a silent one's corrections are zero after a third of each."""
    return sum(_lost(policy, scenario, episodes, silent) for scenario in scenarios)


def _lost(policy: str, scenario: Scenario, episodes: int, silent: bool) -> int:
    actor, cell = make_policy(policy), drawn(scenario, episodes, SEED)

    def on_step(k: int) -> None:
        if silent and k == scenario.steps // 3 and isinstance(actor, ResidualPolicy):
            actor.authority = np.zeros(2)

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", StabilityWarning)  # the law's gains are not for every speed, as is shown here
        measures = rollout(actor, scenario, cell.episodes, STEP_LIMIT, on_step).measures
    return losses(measures, waters_of(scenario.name))


def faster(scenario: Scenario) -> Scenario:
    """Return a scenario on paths of `FAST` speed."""
    assert isinstance(scenario.path, RandomPath)
    return replace(scenario, path=replace(scenario.path, speed=FAST))


def main(arguments: Sequence[str]) -> int:
    """Count and keep as the arguments say and return the exit status.

    Raises:
        UsageError: the arguments do not make sense.
    """
    options, counts = parse(Options, arguments, PROGRAM), {}
    for regime in REGIMES:
        cases = [PRESETS[f"{regime}-{case}"] for case in CASES]
        for policy in (EXPERT, *(f"{family}-{regime}" for family in AGENTS)):
            counts[f"{policy}, {regime}"] = {
                "as trained": lost(policy, cases, options.episodes),
                "silent": lost(policy, cases, options.episodes, silent=True),
                "fast": lost(policy, list(map(faster, cases)), options.episodes) if regime == "cruise" else None,
            }
            print(policy, regime, counts[f"{policy}, {regime}"], flush=True)
    record = {"episodes": options.episodes * len(CASES), "lost": counts}
    options.out.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(options.out, json_text(record))
    return DONE


def kept() -> tuple[int, dict[str, dict[str, int | None]]]:
    """Return of how many episodes each count is, and how many were lost, by policy and regime, then by kind."""
    record = json.loads(FILE.read_text(encoding="utf-8"))
    return record["episodes"], record["lost"]


if __name__ == "__main__":
    sys.exit(run(main, PROGRAM))

"""Count failures in many held-out episodes and bound their rate: `python -m research failure-rate`.

Episodes are drawn with separate seeds, on which no policy is trained, tuned or chosen, and with the same number for
each scenario. The bound is exact if all episodes have the same failure probability (Clopper and Pearson, Biometrika 26
(1934) 404). If the probabilities differ between scenarios, the bound is conservative: for a given mean, the probability
of at most c failures is largest with equal probabilities, for c up to the expected number minus one (Hoeffding, Annals
of Mathematical Statistics 27 (1956) 713).
"""

from __future__ import annotations

import itertools
from typing import Any

from auv_gym.scenarios.presets import CASES, PRESETS, SPEED_RANGES
from baselines.evaluation.cells import drawn
from baselines.evaluation.metrics import failure_bound
from baselines.evaluation.rollout import rollout
from baselines.evaluation.score import count_failures, error_cap
from baselines.policies import make_policy
from research.seeds import FAILURE_RATE
from research.study import Study, stamp

_EPISODES = {"helm": 625, "clairvoyant": 125}
"""Number of episodes of each scenario, by policy."""
_BATCH = 125  # episodes that are simulated together


def _measure(policy: str, scenario: str, quick: bool = False) -> dict[str, float]:
    """Return the number of episodes and failures, and the largest steady-state error [m]."""
    preset, episodes = PRESETS[scenario], 4 if quick else _EPISODES[policy]
    made, failed, largest = make_policy(policy, preset.known), 0, 0.0
    for first in range(0, episodes, _BATCH):
        cell = drawn(preset, min(_BATCH, episodes - first), FAILURE_RATE.first + first)
        measures = rollout(made, preset, cell.episodes).measures
        failed += count_failures(measures, error_cap(scenario))
        largest = max(largest, float(measures.steady_rmse.max()))
    return {"episodes": episodes, "failed": failed, "largest_steady_rmse_m": largest}


STUDY = Study(
    "failure-rate",
    [(policy, f"{speed}-{case}") for policy in _EPISODES for speed in SPEED_RANGES for case in CASES],
    _measure,
    lambda policy, scenario: stamp(policy, [PRESETS[scenario]], _EPISODES[policy], _BATCH),
)
main = STUDY.main


def context(_: str = "") -> dict[str, Any]:
    """Return the values of the template of docs/safety.md."""
    values, rates = STUDY.values(), []
    for policy, speed_range in itertools.product(_EPISODES, SPEED_RANGES):
        rows = [values[policy, f"{speed_range}-{case}"] for case in CASES]
        episodes, failed = (sum(row[key] for row in rows) for key in ("episodes", "failed"))
        at_most = f"{100 * failure_bound(failed, episodes):.2g} %"
        largest = f"{100 * max(row['largest_steady_rmse_m'] for row in rows):.3g}"
        rates.append([f"`{policy}`", f"the eight cases, {speed_range}", str(episodes), str(failed), at_most, largest])
    return {"rates": rates}

"""What learning is worth, docs/results/learning.md: the recorded rows, held-out episodes and studies in tables."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from auv_gym.physics.namespaces import Array
from auv_gym.scenarios.presets import REGIMES
from baselines.agents.names import agent_of, shipped_agents
from baselines.evaluation import recorded
from baselines.evaluation.metrics import most_lost
from baselines.evaluation.score import (
    ADVERSE_RIVAL,
    RIVAL,
    Score,
    interval_text,
    lead,
    regime_of,
    score_text,
    seeds_score,
)
from research.pages import table
from research.results import fresh
from research.results.collection import SUITES, Results, results_of
from research.results.kept import gone, kept_by_the_expert
from research.results.studies import SHORT
from research.results.study_files import Study, load_studies

_BASE = "short-cruise"
"""The training from which the other short ones differ in one thing."""
LEARNERS = ("ppo", "sac", "td3")
"""Families of agents that learn from rewards alone."""


def context(_: str) -> dict[str, Any]:
    """Return the body of the page."""
    found = [results for results in map(results_of, SUITES) if results is not None]
    return {"body": findings(found, fresh_results(), load_studies())}


def findings(found: Sequence[Results], anew: Sequence[Results], studies: Mapping[str, Study]) -> str:
    """Return the text of docs/results/learning.md.

    Args:
        found: what is recorded of the frozen suites.
        anew: what is recorded of their cases on fresh episodes.
        studies: agents of several seeds, by name.
    """
    by_name, fresh_by_name = (
        {results.suite.name: results for results in kind if RIVAL in results.policies} for kind in (found, anew)
    )
    parts = [_INTRODUCTION]
    if (benchmark := by_name.get("benchmark-v2")) is not None:
        parts += [LEADS, _leads(benchmark, fresh_by_name.get("benchmark-v2"), studies)]
        parts += [_CASES, *(_by_case(benchmark, studies, regime) for regime in REGIMES)]
    if (unmodelled := by_name.get("unmodelled-v1")) is not None:
        parts += [UNMODELLED, _leads(unmodelled, fresh_by_name.get("unmodelled-v1"), studies, ADVERSE_RIVAL)]
    if (opened := by_name.get("sealed-v1")) is not None:
        parts += [SEALED, _unforeseen(opened)]
    if (section := kept_by_the_expert(found)) != "":
        parts.append(section)
    if benchmark is not None:
        parts += [_RESIDUAL, SHORTS, _trainings(benchmark, studies, SHORT)]
        parts += [REWARDS, _trainings(benchmark, studies, *LEARNERS)]
        parts += [YARDSTICK, _shares(benchmark)]
    return "\n\n".join([*parts, UNTABLED]) + "\n"


def fresh_results() -> list[Results]:
    """Return what is recorded of fresh episodes, of the suites whose anchors ran."""
    runs = {
        suite: recorded.load_recorded(suite, fresh.HELD_OUT_FOLDER).runs
        for suite in map(fresh.fresh, fresh.HELD_OUT_EPISODES)
    }
    return [Results.of(suite, own) for suite, own in runs.items() if set(suite.anchors) <= {r.policy for r in own}]


def _tails(results: Results, policy: str, regime: str) -> dict[str, Array]:
    """Return the tail errors [m] of a policy by case of a regime, shape (M,) each; {} if it did not run."""
    own = [r for r in results.runs if r.policy == policy and regime_of(r.scenario.name) == regime]
    return {r.scenario.name: r.measures.tail for r in own if r.measures is not None}


def _lead(results: Results, regime: str, seeds: Mapping[str, Array], rival: str) -> tuple[Score, int]:
    """Return the lead over a rival of agents' tails, shape (S, M) by case, and of how many episodes each it is."""
    zero, its, one = (
        _tails(results, policy, regime) for policy in (results.suite.anchors.zero, rival, results.suite.anchors.one)
    )
    count = {case: min(len(its[case]), own.shape[1]) for case, own in seeds.items()}
    four = [[kind[case][..., :n] for case, n in count.items()] for kind in (zero, its, seeds, one)]
    return lead(*four), sum(count.values())


def _agents(studies: Mapping[str, Study], *left_out: str) -> Iterator[tuple[str, Study]]:
    """Yield the agents that ship with the package, without some families."""
    for name, study in studies.items():
        if not name.startswith((SHORT, *left_out)):
            yield name, study


def _leads(results: Results, anew: Results | None, studies: Mapping[str, Study], rival: str = RIVAL) -> str:
    rows = []
    for name, study in _agents(studies, *LEARNERS):
        if (own := study.suites.get(results.suite.source[0])) is None:
            continue
        regime, tails = study.regime, dict(zip(own.cells, own.tails, strict=True))
        above, count = _lead(results, regime, tails, rival)
        total, lost = sum(tail.size for tail in own.tails), own.losses()
        rows.append([
            _named(name, regime),
            score_text(_score(results, study)),
            f"{total // len(own.tails[0])}",
            *_text(above),
            str(count),
            *(_on_fresh(anew, name, regime, rival) if anew else ()),
            f"{lost} of {total}",
            f"{100 * most_lost(lost, total):.2g} %",
        ])  # fmt: skip
    names = ["agent", "score", "episodes", f"lead over {rival}", "95 %", "episodes"]
    return table([*names, *(("fresh lead", "95 %", "episodes") if anew else ()), "lost", "at most"], rows)


def _on_fresh(anew: Results, name: str, regime: str, rival: str) -> tuple[str, str, str]:
    """Return the lead of the shipped agent on fresh episodes, its interval and their number."""
    if not (own := _tails(anew, agent_of(name), regime)):
        return "-", "-", "-"
    above, count = _lead(anew, regime, {case: tail[None] for case, tail in own.items()}, rival)
    return *_text(above), str(count)


def _named(name: str, regime: str) -> str:
    """Return a study's agent as tables name it, with the regime where it serves both."""
    agent = agent_of(name)
    return f"`{name}`" if agent == name else f"`{agent}`, {regime}"


def _text(value: Score) -> tuple[str, str]:
    return score_text(value), interval_text(value)


def _unforeseen(results: Results) -> str:
    """Return the leads of shipped agents over both rivals in a suite that no study ran in, and what they lose."""
    rows, expert = [], results.suite.anchors.zero
    for name in (name for name in shipped_agents() if name.startswith(("helm", "apg"))):
        for regime in REGIMES:
            if own := _tails(results, name, regime):
                seeds = {case: tail[None] for case, tail in own.items()}
                leads = (
                    part for rival in (RIVAL, ADVERSE_RIVAL) for part in _text(_lead(results, regime, seeds, rival)[0])
                )
                mine, its = gone(results, name, regime), gone(results, expert, regime)
                losses = f"{mine.sum()} of {len(mine)}", f"{(mine & ~its).sum()} of {(~its).sum()}"
                rows.append([f"`{name}`, {regime}", *leads, *losses])
    return table(["agent", *(x for rival in (RIVAL, ADVERSE_RIVAL) for x in (f"lead over {rival}", "95 %")), "lost",
                  f"lost of those that {expert} keeps"], rows)  # fmt: skip


def _by_case(results: Results, studies: Mapping[str, Study], regime: str) -> str:
    """Return in how many episodes of each case shipped agents are nearer to the path than the rival is."""
    rival, rows = _tails(results, RIVAL, regime), []
    for name, study in _agents(studies, *LEARNERS):
        if study.regime == regime and (own := _tails(results, agent_of(name), regime)):
            nearer = (100 * np.mean(own[case][: len(tail)] < tail) for case, tail in rival.items())
            rows.append([_named(name, regime), *(f"{share:.0f} %" for share in nearer)])
    return table([regime, *(case.removeprefix(f"{regime}-") for case in rival)], rows)


def _score(results: Results, study: Study) -> Score:
    """Return the score of a study's agents."""
    own = study.suites[results.suite.source[0]]
    zero, one = ([_tails(results, p, study.regime)[case] for case in own.cells] for p in results.suite.anchors)
    return seeds_score(zero, own.tails, one)


def _trainings(results: Results, studies: Mapping[str, Study], *kinds: str) -> str:
    """Return the scores of the trainings whose names begin with one of the kinds, the best one first."""
    rows = []
    for name, study in studies.items():
        if name.startswith(kinds) and (own := study.suites.get(results.suite.source[0])) is not None:
            steps = float(np.mean([curve[-1, 0] for curve in study.curves])) / 1e6
            score, total = _score(results, study), sum(tail.size for tail in own.tails)
            lost = f"{own.losses()} of {total}"
            rows.append(
                (score.mean, [f"{_named(name, study.regime)}: {study.about}", f"{steps:.3g} M", *_text(score), lost])
            )
    ordered = [row for _, row in sorted(rows, key=lambda row: -row[0])]
    return table(("training", "steps", "score", "95 %", "lost"), ordered)


def _shares(results: Results) -> str:
    """Return the share of the distance between 0 and 1, the score's scale, that each case makes."""
    rows, cases = [], [cell.scenario.name.split("-", 1)[1] for cell in results.suite.cells]
    for regime in REGIMES:
        zero, one = (_tails(results, policy, regime) for policy in results.suite.anchors)
        spans = {case: float((zero[case] - one[case]).sum()) for case in zero}
        rows.append([regime, *(f"{100 * span / sum(spans.values()):.0f} %" for span in spans.values())])
    return table(("regime", *dict.fromkeys(cases)), rows)


_INTRODUCTION = """## What learning is worth

What learning gains over the strongest controller, where it loses, and what each part of the training contributes.
[Evaluation](metrics.md) defines the score and *lost*."""
LEADS = f"""### Against the strongest controller

`{RIVAL}`, the strongest controller that does not learn, has a filter, a model of the sea and a preview of the path.
*score* and *lead* are those of all training seeds on the frozen `benchmark-v2`, *fresh lead* that of the one shipped
agent on episodes of the same cases that nothing was trained, tuned or chosen on; a lead is a distance of scores, with
an interval over seeds and episodes, and *episodes* says of how many a number is. *lost* adds up all seeds; *at most* is
the largest share of lost episodes that is still likely (one-sided, 95 %): none lost is no promise."""
_CASES = f"""### Where an agent leads, and where it trails

A score is made of means. Episode by episode the picture is another one: the share of the episodes of each case, on the
frozen benchmark, in which the shipped agent's tail error is smaller than that of `{RIVAL}`. Below 50 % the agent trails
in most episodes, whatever its mean: so do the agents without a preview in storms."""
UNMODELLED = f"""### Where all is not as told

`unmodelled-v1`, in the same columns. The rival here is `{ADVERSE_RIVAL}`, predictive control on a filter that estimates
biased sensors and weak, late actuators too, tuned in the mixture of troubles in which `apg-adverse-*` were trained.
Intervals are wide, since a few episodes that go badly wrong weigh much.
`helm`, `helm-any` and `apg-adverse-*` were trained on these kinds of trouble, all at once and in slightly wider ranges,
and on the sheared current of `ood-v1`: for them this is no test of the unforeseen. The others had met none of it. What
robustness costs where nothing is wrong is the distance between `apg-adverse-*` and `apg-*` above."""
SEALED = f"""### In worlds that nobody had seen

`sealed-v1`: its episodes were drawn from a secret of which only the hash was known until everything was frozen, and
policies ran in them once, 512 episodes a regime, one shipped agent each. Speeds between and beyond the regimes,
missions of five minutes, slewing actuators, long outages of the position fix, far starts, other hulls, and all at once.
`helm` and `helm-any` know slewing actuators and some of the speeds ([Evaluation](metrics.md#sealed-suites)); in slow
motion they trail, mostly where the fix is out for longer than in their training. They have been trained anew since the
suite was opened, and chosen on other episodes: for them these are episodes that anybody knows. The first lead is over
`{RIVAL}`, the second over `{ADVERSE_RIVAL}`."""
_RESIDUAL = """### What the expert is for

The expert does not make the final score better: `apg-scratch-*`, networks that command alone, end level with the
corrected expert. What a residual buys instead, when networks fail, worlds change and training has just begun, and how
little of that a large authority leaves: [What a residual is for](results/residual.md)."""
SHORTS = f"""### What each part is worth

Trainings of fewer steps and seeds at cruise, each of which differs from `{_BASE}` in one thing."""
REWARDS = """### From rewards alone

Agents of Stable-Baselines3, which see the reward and no gradient of the simulator, trained for about as long."""
YARDSTICK = """### What the score weighs

The score pools errors over cases, so a case counts by the error that the expert leaves in it. The share of each case in
the distance from 0 to 1: to reject a current is most of the task, and a policy that is best in noise or waves
alone gains little by it. Read the single cases beside the pooled score."""
UNTABLED = """### What no table shows

- **An authority is no safety bound** where it is large: a correction of the whole limit can undo any command. Only a
  small one leaves the expert in charge.
- **An agent serves the speeds that it has seen.** `helm` and its kin have seen both regimes, every other one its own;
  beyond what it has seen an agent may do worse than the expert.
- **Memory belongs to the policy.** The recurrent agents need their state handed back at each call; without it they act
  as at an episode's first step.
- Where commands cost next to nothing, storms and slow actuators need larger weights in training, or now and then a fast
  vehicle with slow actuators spins. PPO needs exploration that moves a vehicle: noise kept for several steps. SAC and
  TD3 need a cost of the error moved on by its rate (`lead`) and returns over several steps, since what an action
  changes shows in the position only seconds later."""

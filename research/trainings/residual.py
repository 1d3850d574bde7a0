"""Measure what a residual is for, when networks fail and worlds change: `python -m research residual --help`.

Agents that correct the expert and agents that command alone are trained with several authorities and seeds. They and
policies of the registry then run in every situation of `research.robustness.situations`, and what they do is kept in
`research/data/residual.json`, from which `make pages` writes the first section of the results.
"""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import datetime, timezone
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from tyro.conf import Positional, arg

from auv_gym.scenarios.presets import REGIMES
from baselines.control.open_loop import NO_EXPERT
from baselines.evaluation import recorded
from baselines.evaluation.fingerprints import fingerprint
from baselines.evaluation.request import checked
from baselines.evaluation.score import EXPERT, RIVAL
from baselines.policies import list_policies
from baselines.tools.command_line import DONE, UsageError, check_words, parse
from baselines.tools.files import json_text, read_json, write_atomically
from baselines.tools.workers import Workers
from baselines.training.command import train
from baselines.training.options import Options as TrainOptions
from baselines.training.run_folder import AGENT_FOLDER, read_progress
from research.results.fresh import FAMILIES
from research.results.residual_file import (
    CURVE_COLUMNS,
    RESIDUAL_FILE,
    RESIDUAL_KIND,
    SCRATCH,
    SHIPPED_KIND,
    STUCK,
    UNIT,
    ResidualGroup,
    save_groups,
    whole,
)
from research.robustness.failures import SATURATED
from research.robustness.situations import WORLDS, outcome, silent, situation_episodes, situations_of
from research.trainings.trainings import SLOW_TRAINING, request_of, training

PROGRAM = "python -m research residual"
SEEDS = 5  # of each training
_STEPS = 1_000_000  # control steps of each training, an eighth of those of `apg-cruise`
AUTHORITIES: Mapping[str, tuple[float, ...]] = {"cruise": (0.1, 0.25, 0.5, 1.0, 2.0), "slow": (0.5, 1.0)}
"""Authorities of surge and yaw that are trained with, for both kinds."""
FOLLOWED = {(RESIDUAL_KIND, 0.5, "cruise"), (SCRATCH, 1.0, "cruise")}
"""Trainings whose first minutes are looked at."""
_VALIDATIONS = {True: 20, False: 1}  # of a training that is followed, and of another
_EPISODES = 10  # of each case for the agents of the study
EPISODES_SHIPPED = 40  # of each case for a policy of the registry, of which there is one
POLICIES = (EXPERT, RIVAL, "helm", *(f"{family}-{regime}" for family in FAMILIES for regime in REGIMES))
"""Policies of the registry that are measured beside them."""
_BOUNDS = (0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.75, 1.0, 1.5, 2.0)
"""Authorities of which it is measured what they bound, whatever a network was trained to."""
_OWN = "situations.json"  # file beside an agent of what it does


@dataclass(frozen=True)
class _Setting:
    """Agents of the study: trained alike, with several seeds."""

    kind: str
    authority: float
    regime: str

    @property
    def training(self) -> TrainOptions:
        """How they are trained, with the first seed."""
        changes: dict[str, Any] = {} if self.regime == "cruise" else dict(SLOW_TRAINING)
        changes["validations"] = _VALIDATIONS[(self.kind, self.authority, self.regime) in FOLLOWED]
        expert = NO_EXPERT if self.kind == SCRATCH else None
        return training("apg", self.regime, (self.authority,), expert, _STEPS, changes)


_SETTINGS: Mapping[str, _Setting] = {
    f"{kind}-{authority}-{regime}": _Setting(kind, authority, regime)
    for regime, authorities in AUTHORITIES.items()
    for kind in (RESIDUAL_KIND, SCRATCH)
    for authority in authorities
}
"""The agents of the study, by name."""


@dataclass(frozen=True)
class Options:
    """Train residual agents and agents from scratch, and measure them where networks fail and worlds change.

    A second call goes on where the first was interrupted. Exit status: 0 done, 1 a training failed, 2 wrong usage.
    """

    name: Annotated[Positional[tuple[str, ...]], arg(metavar="[NAME ...]")] = ()
    """Which of the study's agents, policies of the registry, or "stuck", what an authority bounds; without any, all of
    the study."""
    out: Path = Path("runs/residual")
    """Folder of the runs."""
    jobs: int = 2
    """Trainings, or agents that are measured, at the same time."""
    finished: bool = False
    """Train nothing, and measure the seeds that are finished, however few."""
    seeds: Annotated[int | None, arg(metavar="INT", help_behavior_hint="")] = None
    """Seeds of each training, to try it out. Default: 5. As with the next two, what comes out stays in --out."""
    timesteps: Annotated[int | None, arg(metavar="INT", help_behavior_hint="")] = None
    """Control steps of each training, to try it out. Default: a million."""
    episodes: Annotated[int | None, arg(metavar="INT", help_behavior_hint="")] = None
    """Episodes of each case, to try it out. Default: 10 for each agent of the study, 40 for a policy."""

    @property
    def tried(self) -> bool:
        """Whether it is only to be tried out."""
        return any(value is not None for value in (self.seeds, self.timesteps, self.episodes))


def main(arguments: Sequence[str]) -> int:
    """Train, measure and keep as the arguments say and return the exit status.

    Raises:
        UsageError: the arguments do not make sense.
    """
    options = parse(Options, arguments, PROGRAM)
    known = (*_SETTINGS, STUCK, *list_policies())
    check_words("policy", options.name, known)
    for option, value in (("seeds", options.seeds), ("episodes", options.episodes), ("timesteps", options.timesteps)):
        if value is not None and value < 1:
            raise UsageError(f"--{option} is {value}; it must be 1 or more")
    workers = checked(partial(Workers.of, options.jobs))
    file = options.out / RESIDUAL_FILE.name if options.tried else RESIDUAL_FILE
    for name in options.name or (*_SETTINGS, STUCK, *POLICIES):
        if name in _SETTINGS:
            status, groups = _trained(name, options, workers)
            if status != DONE:
                return status
        else:
            groups = _stuck(options) if name == STUCK else _registered(name, options, workers)
        checked(partial(save_groups, groups, file))
        for group in groups:
            print(_line(group), flush=True)
    print(f"written: {file}")
    return DONE


def _line(group: ResidualGroup) -> str:
    size = next(iter(group.tails.values())).size
    lost = "; ".join(f"{situation} {int(group.lost(situation).sum())}" for situation in group.tails)
    return f"{group.name}, {group.regime}: lost of {size}: {lost}"


def _trained(name: str, options: Options, workers: Workers) -> tuple[int, list[ResidualGroup]]:
    """Train the agents of a setting and measure them; return the exit status and what came out."""
    setting = _SETTINGS[name]
    chosen = replace(setting.training, seeds=options.seeds or SEEDS, timesteps=options.timesteps or _STEPS)
    request = request_of(chosen, options.out / name, options.jobs)
    if not options.finished and (status := train(request)) != DONE:
        return status, []
    folders = [folder for folder in request.folders if (folder / AGENT_FOLDER).exists()]
    if not folders:
        return DONE, []
    tasks = [(str(f / AGENT_FOLDER), setting.regime, options.episodes or _EPISODES, f / _OWN) for f in folders]
    tails = _measured(tasks, workers)
    curves = [
        np.array([[row[key] for key in CURVE_COLUMNS] for row in read_progress(folder) if "score" in row])
        for folder in folders
    ]
    entries = setting.regime, setting.kind, setting.authority, _today(), request.command
    return DONE, [ResidualGroup(name, *entries, tails, tuple(curves))]


def _registered(name: str, options: Options, workers: Workers) -> list[ResidualGroup]:
    """Measure a policy of the registry in its regimes."""
    groups = []
    for regime in recorded.regimes_of(name):
        file = options.out / SHIPPED_KIND / f"{name}-{regime}.json"
        tails = _measured([(name, regime, options.episodes or EPISODES_SHIPPED, file)], workers)
        groups.append(
            ResidualGroup(name, regime, SHIPPED_KIND, None, _today(), "", tails, fingerprint=fingerprint(name))
        )
    return groups


def _stuck(options: Options) -> list[ResidualGroup]:
    """Measure the law with a correction that is stuck at its limit from a third of each episode on."""
    groups, episodes, law = [], options.episodes or EPISODES_SHIPPED, fingerprint(EXPERT)
    for regime in REGIMES:
        for authority in _BOUNDS:
            found = {s: outcome(silent(authority), regime, s, episodes).tail[None] for s in SATURATED}
            entries = f"{STUCK}-{authority}", regime, STUCK, authority, _today(), "", found
            groups.append(ResidualGroup(*entries, fingerprint=law))
    return groups


def _today() -> str:
    return datetime.now(timezone.utc).date().isoformat()


def _measured(tasks: Sequence[tuple[str, str, int, Path]], workers: Workers) -> dict[str, Any]:
    """Return the capped tails [m] of agents by situation, shape (S, M), task after task."""
    found = dict(workers.results(measured, tasks))
    own = [found[name] for name, *_ in tasks]
    return {situation: np.array([tails[situation] for tails in own]) * UNIT for situation in own[0]}


def measured(name: str, regime: str, episodes: int, file: Path) -> tuple[str, dict[str, list[int]]]:
    """Return a policy's name and its capped tails by situation, in whole `UNIT`; they are kept in a file.

    What is kept counts while policy and episodes are the same.

    Args:
        name: of the policy, or the folder of an agent.
        regime: "slow" or "cruise".
        episodes: of each case.
        file: where they are kept.

    Raises:
        OSError: policy or file cannot be read or written.
        PolicyError: the policy's actions are not finite.
        ValueError: there is no such policy.
    """
    situations = situations_of(name)
    worlds = [cell.hash for world in WORLDS for cell in situation_episodes(regime, world, episodes).cells]
    key = hashlib.sha256(json.dumps([fingerprint(name), situations, worlds]).encode()).hexdigest()
    with suppress(OSError, ValueError, KeyError, TypeError):
        record = read_json(file)
        if record["key"] == key:
            return name, record["tails"]
    tails = {s: whole(outcome(name, regime, s, episodes).tail, regime) for s in situations}
    file.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(file, json_text({"key": key, "tails": tails}))
    print(f"measured: {name}, {regime}", file=sys.stderr, flush=True)
    return name, tails

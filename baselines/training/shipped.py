"""Train the agents that ship with the package: `python -m baselines.training.shipped --help`."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from baselines.agent import Agent
from baselines.command_line import DONE, UsageError, parse, run
from baselines.training.command import CURVE, train
from baselines.training.request import Request
from baselines.training.run import AGENT
from baselines.user_policies import AGENTS

PROGRAM = "python -m baselines.training.shipped"


@dataclass(frozen=True)
class Shipped:
    """How an agent was trained; everything else is train.py's default."""

    algo: str
    scenario: str
    authority: tuple[float, ...] = ()


SHIPPED: Mapping[str, Shipped] = {
    "apg-cruise": Shipped("apg", "cruise"),
    "apg-slow": Shipped("apg", "slow", (0.6, 1.6)),
    "ppo-cruise": Shipped("ppo", "cruise"),
    "ppo-slow": Shipped("ppo", "slow", (0.6, 1.0)),
}
"""The agents that ship with the package, by name."""


@dataclass(frozen=True)
class Options:
    """Train the agents that ship with the package, one after the other, each in a folder DIR/NAME.

    A second call goes on where the first was interrupted. Exit status: 0 done, 1 a training failed, 2 wrong usage.
    """

    name: Annotated[Positional[tuple[str, ...]], arg(metavar="[NAME ...]")] = ()
    """Which of them; without any, all."""
    out: Path = Path("runs/shipped")
    """Folder of the runs."""
    timesteps: Annotated[int | None, arg(metavar="INT", help_behavior_hint="")] = None
    """Control steps of each, to try it out. Default: as many as the shipped ones had."""
    install: bool = False
    """Put the trained agents into baselines/agents, in place of those that are there."""


def main(arguments: Sequence[str]) -> int:
    """Train as the arguments say and return the exit status.

    Raises:
        UsageError: the arguments do not make sense.
    """
    options = parse(Options, arguments, PROGRAM)
    if unknown := [name for name in options.name if name not in SHIPPED]:
        raise UsageError(f"no agent {unknown[0]!r} ships with the package; allowed are {', '.join(SHIPPED)}")
    for name in options.name or SHIPPED:
        print(f"{name}:", flush=True)
        request = shipped_request(name, options.out, options.timesteps)
        if (status := train(request)) != DONE:
            return status
        if options.install:
            agent, curve = Agent.load(request.out / AGENT), (request.out / CURVE).read_bytes()
            agent.save(AGENTS / name, curve)
    return DONE


def shipped_request(name: str, out: Path, timesteps: int | None = None) -> Request:
    """Return the training of a shipped agent.

    Args:
        name: one of `SHIPPED`.
        out: its run folder is made in there.
        timesteps: control steps, if other than it had.

    Raises:
        UsageError: the folder holds something else.
    """
    agent = SHIPPED[name]
    command = f"python train.py --algo {agent.algo} --scenario {agent.scenario}"
    if agent.authority:
        command += f" --authority {' '.join(map(str, agent.authority))}"
    if timesteps is not None:
        command += f" --timesteps {timesteps}"
    return Request.of(
        agent.algo,
        (agent.scenario,),
        authority=agent.authority,
        timesteps=timesteps,
        out=out / name,
        resume=True,
        command=command,
    )


if __name__ == "__main__":
    sys.exit(run(main, PROGRAM))

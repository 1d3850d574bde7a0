"""Build, seal, open, check, record and verify the frozen suites: `python -m research suites --help`."""

from __future__ import annotations

import secrets
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from baselines.evaluation import recorded, suites
from baselines.evaluation.progress import run_and_show
from baselines.evaluation.runner import STEP_LIMIT, Cell, Run
from baselines.evaluation.suites.anchor_errors import write_anchor_errors
from baselines.policies import list_policies
from baselines.tools.command_line import DONE, FAILED, UsageError, called, check_words, parse
from baselines.tools.files import versions
from baselines.tools.workers import Workers
from research.suites import held_out, sealed
from research.suites.builder import BUILDERS, SHARED, anchors_of, build
from research.suites.verify import PolicyVerdict, cells_to_run, verdict_line

PROGRAM = "python -m research suites"


@dataclass(frozen=True)
class Options:
    """Build frozen suites, check their episodes, record results of policies, or verify recorded results.

    Exit status: 0 done, 1 a suite is damaged, episodes or rows differ, or a policy failed, 2 wrong usage.
    """

    action: Annotated[
        Positional[Literal["build", "check", "seal", "open", "anchor-errors", "record", "verify"]],
        arg(metavar="ACTION"),
    ]
    """build: replace the file and the hash of a suite. check: compare the generated inputs of every episode with their
    digests. seal: draw the secret of a suite, keep its hash and print the secret once. open: check a secret against the
    hash, publish it and build the suite, after all policies are frozen. anchor-errors: measure the anchors for the
    scores of validations. record: run policies and keep their results. verify: run recorded policies again and compare
    every number with the recorded one, to the last recorded bit."""
    name: Annotated[Positional[tuple[str, ...]], arg(metavar="[NAME ...]")] = ()
    """Names of suites. Default of check and verify: all."""
    policy: Annotated[tuple[str, ...], arg(metavar="P [P ...]", help_behavior_hint="")] = ()
    """Policies to record or verify. Default: all named policies, or all recorded ones."""
    episodes: Annotated[int | None, arg(metavar="INT", help_behavior_hint="")] = None
    """Record only the first episodes of each cell, for a slow policy."""
    cells: Annotated[tuple[str, ...], arg(metavar="C [C ...]", help_behavior_hint="")] = ()
    """Verify only the cells of these scenarios. Cells run whole, since parts of a cell differ in the last bits."""
    held_out: bool = False
    """Record on held-out episodes of the cases of benchmark-v2 or unmodelled-v1, on which nothing was chosen."""
    secret: Annotated[str | None, arg(metavar="WORDS", help_behavior_hint="")] = None
    """The secret, to open a suite."""
    stamp: bool = False
    """Renew the fingerprints of policies whose rows are equal, so that the rows are valid again."""
    step_limit: float = STEP_LIMIT
    """Largest mean time of a decision [s]; slower policies fail."""
    jobs: int = 1
    """Worker processes. With one process the time of a decision is that of an idle processor."""


def main(arguments: Sequence[str]) -> int:
    """Run an action and return the exit status.

    Raises:
        UsageError: the arguments are invalid.
    """
    options = parse(Options, arguments, PROGRAM)
    check_words("suite", options.name, (*BUILDERS, *SHARED))
    if not options.name and options.action in ("build", "seal", "open", "anchor-errors", "record"):
        raise UsageError(f"name the suite to {options.action}: {', '.join((*BUILDERS, *SHARED))}")
    check_words("policy", options.policy, list_policies())
    if options.episodes is not None and (options.episodes < 1 or options.action != "record"):
        raise UsageError(f"--episodes is {options.episodes}; it must be 1 or more, and is for record")
    if options.held_out and (options.action != "record" or not {*options.name} <= {*held_out.HELD_OUT_EPISODES}):
        raise UsageError(f"--held-out is for record of {' and '.join(held_out.HELD_OUT_EPISODES)}")
    if options.held_out and options.episodes is not None:
        raise UsageError("--held-out excludes --episodes: all its episodes are recorded")
    if (options.secret is None) == (options.action == "open"):
        raise UsageError("open needs --secret WORDS, as seal has printed it; no other action takes it")
    actions = {
        "build": _build,
        "check": _check,
        "seal": _seal,
        "open": _open,
        "anchor-errors": _measure,
        "record": _record,
        "verify": _verify,
    }
    action = actions[options.action]
    try:
        return max([action(name, options) for name in options.name or _all()])
    except suites.SuiteError as error:
        print(f"{called(PROGRAM)}: {error}", file=sys.stderr)
        return FAILED


def _all() -> list[str]:
    """Return the suites with their own episodes: the default of check and verify."""
    return [name for name in suites.list_suites() if name not in SHARED]


def _build(name: str, _: Options) -> int:
    anchors = anchors_of(name)
    if name in SHARED:
        made = suites.save_shared(name, SHARED[name], anchors)
    else:
        made = suites.save_suite(name, build(name), anchors=anchors)
    print(f"{made}  {name}")
    return DONE


def _seal(name: str, _: Options) -> int:
    _check_sealed(name)
    secret = secrets.token_hex(24)  # no leading hyphen, so that it can follow an option
    sealed.write_seal(name, sealed.Seal(sealed.sha256(secret), sealed.worlds_hash(name)))
    print(f"the secret of {name}, which is not stored anywhere: {secret}")
    return DONE


def _open(name: str, options: Options) -> int:
    _check_sealed(name)
    if name not in (kept := sealed.seals()):
        raise UsageError(f"{name} has no seal; make one with: {PROGRAM} seal {name}")
    sealed.write_seal(name, kept[name].opened(options.secret or ""))
    return _build(name, options)


def _check_sealed(name: str) -> None:
    """Raise UsageError if a suite has no secret."""
    if name in SHARED or BUILDERS[name][0] is not None:
        raise UsageError(f"{name} is not a sealed suite")


def _check(name: str, _: Options) -> int:
    suite = suites.load_suite(name)
    for cell, digests in zip(suite.cells, suite.digests, strict=True):
        suites.check_cell(cell, digests)
    episodes = sum(len(cell.episodes) for cell in suite.cells)
    print(f"{suite.hash}  {suite.name}: {len(suite.cells)} cells, {episodes} episodes, all unchanged")
    return DONE


def _measure(name: str, _: Options) -> int:
    write_anchor_errors(suites.load_suite(name))
    return DONE


def _record(name: str, options: Options) -> int:
    """Record policy by policy, so that an interruption loses the results of one policy only."""
    suite, status = held_out.held_out(name) if options.held_out else suites.load_suite(name), DONE
    folder = held_out.HELD_OUT_FOLDER if options.held_out else recorded.RECORDED_FOLDER
    for policy in options.policy or tuple(list_policies()):
        speed_ranges = recorded.speed_ranges_of(policy)
        own = suite.cells_in(speed_ranges)
        if not own:
            continue
        found = _run(policy, [Cell(cell.scenario, cell.episodes[: options.episodes]) for cell in own], options)
        try:
            recorded.save_recorded(suite, found, versions(), folder, speed_ranges)
        except ValueError as error:
            reasons = dict.fromkeys(run.error for run in found if run.error)
            print(f"{called(PROGRAM)}: {error}: {'; '.join(map(str, reasons))}", file=sys.stderr)
            status = FAILED
    return status


def _verify(name: str, options: Options) -> int:
    """Verify policy by policy and print for each whether its rows are equal."""
    suite, status = suites.load_suite(name), DONE
    if note := recorded.missing(name):
        print(f"note: {note}", flush=True)
    for policy in [p for p in recorded.recorded_policies(suite) if p in (options.policy or (p,))]:
        try:
            old = {run.scenario.name: run for run in recorded.read_recorded(suite, policy)}
            cells = cells_to_run(suite, list(old.values()), options.cells)
            again = _run(policy, cells, options) if cells else []
            verdicts = [PolicyVerdict.of(old[run.scenario.name], run) for run in again]
        except (OSError, ValueError) as error:
            print(f"FAILED     {policy} in {name}: {error}", flush=True)
            status = FAILED
            continue
        if verdicts:
            print(verdict_line(f"{policy} in {name}", verdicts), flush=True)
        if any(verdict.differing for verdict in verdicts):
            status = FAILED
        elif verdicts and options.stamp:
            recorded.stamp_recorded(suite, policy)
    return status


def _run(policy: str, cells: Sequence[Cell], options: Options) -> list[Run]:
    """Return the runs of a policy and show their progress on stderr."""
    return run_and_show([(policy, cell) for cell in cells], Workers(options.jobs), options.step_limit)

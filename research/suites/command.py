"""Build, seal, open, check, record and verify the frozen suites: `python -m research suites --help`."""

from __future__ import annotations

import secrets
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from tyro.conf import Positional, arg

from auv_gym.physics.namespaces import Array
from baselines.evaluation.cells import Cell
from baselines.evaluation.metrics import Measures
from baselines.evaluation.recorded import RECORDED, read_recorded, recorded_files, speed_ranges_of
from baselines.evaluation.report.terminal import run_and_show
from baselines.evaluation.results import ResultFile
from baselines.evaluation.runner import Run
from baselines.evaluation.suites import FOLDER, Suite, SuiteError, check_cell, list_suites, load_suite, save_suite
from baselines.policies import list_policies
from baselines.tools.command_line import DONE, FAILED, UsageError, called, check_words, parse
from baselines.tools.files import DATA_FOLDERS
from baselines.tools.workers import Workers
from research import DATA
from research.suites import sealed
from research.suites.builder import BUILDERS, build

PROGRAM = "python -m research suites"
DIGITS = {"rmse": 8, "effort": 11, "smoothness": 13, "total_reward": 8}
"""Binary digits of recorded metrics of which only means over episodes are reported; no printed number needs more. The
other metrics have single precision."""
SINGLE = 24  # binary digits of single precision


@dataclass(frozen=True)
class Options:
    """Build frozen suites, check their episodes, record results of policies, or verify recorded results.

    Exit status: 0 done, 1 a suite is damaged, episodes or results differ, or a policy failed, 2 wrong usage.
    """

    action: Annotated[
        Positional[Literal["build", "check", "seal", "open", "record", "verify"]],
        arg(metavar="ACTION"),
    ]
    """build: replace the file and the hash of a suite. check: compare the generated inputs of every episode with their
    digests. seal: draw the secret of a suite, keep its hash and print the secret once. open: check a secret against the
    hash, publish it and build the suite, after all policies are frozen. record: run policies and keep their results.
    verify: run recorded policies again and compare every number with the recorded one, to the last recorded place."""
    name: Annotated[Positional[tuple[str, ...]], arg(metavar="[NAME ...]")] = ()
    """Names of suites. Default of check and verify: all."""
    policy: Annotated[tuple[str, ...], arg(metavar="P [P ...]")] = ()
    """Policies to record or verify. Default: all named policies, or all recorded ones."""
    cells: Annotated[tuple[str, ...], arg(metavar="C [C ...]")] = ()
    """Verify only the cells of these scenarios. Cells run whole, since parts of a cell differ in the last bits."""
    secret: Annotated[str | None, arg(metavar="WORDS")] = None
    """The secret, to open a suite."""
    stamp: bool = False
    """Renew the fingerprints of runs whose results are equal, so that they are valid again."""
    jobs: int = 1
    """Worker processes. With one process the time of a decision is that of an idle processor."""


def main(arguments: Sequence[str]) -> int:
    """Run an action and return the exit status."""
    options = parse(Options, arguments, PROGRAM)
    check_words("suite", options.name, BUILDERS)
    if not options.name and options.action in ("build", "seal", "open", "record"):
        raise UsageError(f"name the suite to {options.action}: {', '.join(BUILDERS)}")
    if options.action in ("seal", "open"):
        check_words("sealed suite", options.name, sealed.CHANGES)
    check_words("policy", options.policy, list_policies(None))
    if (options.secret is None) == (options.action == "open"):
        raise UsageError("open needs --secret WORDS, as seal has printed it; no other action takes it")
    actions = {"build": _build, "check": _check, "seal": _seal, "open": _open, "record": _record, "verify": _verify}
    try:
        return max([actions[options.action](name, options) for name in options.name or list_suites()])
    except SuiteError as error:
        print(f"{called(PROGRAM)}: {error}", file=sys.stderr)
        return FAILED


def _folder(name: str) -> Path:
    """Return the folder of data of a suite: that of the package for the benchmark, else that of the research record."""
    return DATA_FOLDERS[0] if name.startswith("benchmark") else DATA


def _build(name: str, _: Options) -> int:
    print(f"{save_suite(name, build(name), _folder(name) / FOLDER)}  {name}")
    return DONE


def _seal(name: str, _: Options) -> int:
    secret = secrets.token_hex(24)  # no leading hyphen, so that it can follow an option
    sealed.write_seal(name, sealed.Seal(sealed.sha256(secret), sealed.worlds_hash(name)))
    print(f"the secret of {name}, which is not stored anywhere: {secret}")
    return DONE


def _open(name: str, options: Options) -> int:
    if name not in (seals := sealed.seals()):
        raise UsageError(f"{name} has no seal; make one with: {PROGRAM} seal {name}")
    sealed.write_seal(name, seals[name].opened(options.secret or ""))
    return _build(name, options)


def _check(name: str, _: Options) -> int:
    suite = load_suite(name)
    for cell, digests in zip(suite.cells, suite.digests, strict=True):
        check_cell(cell, digests)
    episodes = sum(len(cell.episodes) for cell in suite.cells)
    print(f"{suite.hash}  {suite.name}: {len(suite.cells)} cells, {episodes} episodes, all unchanged")
    return DONE


def _record(name: str, options: Options) -> int:
    """Record policy by policy, so that an interruption loses the results of one policy only."""
    suite, status = load_suite(name), DONE
    for policy in options.policy or list_policies(any(cell.scenario.vertical for cell in suite.cells)):
        runs = _run(policy, suite.cells_in(speed_ranges_of(policy)), options)
        if failed := [run for run in runs if run.measures is None]:
            print(f"{called(PROGRAM)}: {policy} in {failed[0].scenario.name}: {failed[0].error}", file=sys.stderr)
            status = FAILED
        elif runs:
            keep(suite, runs, _folder(name) / RECORDED / f"{name}.npz")
    return status


def keep(suite: Suite, runs: Sequence[Run], file: Path) -> None:
    """Write the runs of a policy to a file of recorded results, in place of its earlier ones and in a fixed order."""
    content = read_recorded(suite, file) if file.exists() else ResultFile((), suite.name, suite.hash, PROGRAM)
    order, cells = list(list_policies(None)), [cell.scenario.name for cell in suite.cells]
    compact = [replace(r, measures=recorded_measures(r.measures), tracks=(), bands=None) for r in runs if r.measures]
    all_runs = content.with_runs(compact).runs
    ordered = sorted(all_runs, key=lambda run: (order.index(run.policy), cells.index(run.scenario.name)))
    replace(content, runs=tuple(ordered)).write(file, single=True)


def recorded_measures(measures: Measures) -> Measures:
    """Return metrics as they are recorded, some with `DIGITS` only; it does not change recorded ones."""
    rounded = {}
    for name, digits in DIGITS.items():
        fraction, exponent = np.frexp(getattr(measures, name))
        rounded[name] = np.ldexp(np.round(np.ldexp(fraction, digits)), exponent - digits)
    return replace(measures, **rounded)


def _verify(name: str, options: Options) -> int:
    """Verify policy by policy and print for each whether its results are equal."""
    suite, status = load_suite(name), DONE
    for file in recorded_files(name):
        content = read_recorded(suite, file)
        policies = dict.fromkeys(run.policy for run in content.runs)
        for policy in [p for p in policies if p in (options.policy or policies)]:
            recorded = {run.scenario.name: run for run in content.of(policy)}
            # All recorded episodes of a cell run together: batches of another size differ in the last bits.
            cells = [
                Cell(cell.scenario, cell.episodes[: len(recorded[scenario].measures or ())])
                for cell in suite.cells
                if (scenario := cell.scenario.name) in recorded and scenario in (options.cells or recorded)
            ]
            if options.stamp:  # equal fingerprints: the same kernels, data and code have made the results
                cells = [cell for cell in cells if _is_outdated(recorded[cell.scenario.name], cell)]
            runs = _run(policy, cells, options)
            if not runs:
                continue
            equal, says = proof(recorded, runs)
            print(f"{'equal' if equal else 'DIFFERENT':<10} {policy} in {name}: {says}", flush=True)
            if not equal:
                status = FAILED
            elif options.stamp:
                for run in runs:
                    scenario, prints = run.scenario.name, (run.fingerprint, run.simulator)
                    recorded[scenario] = replace(recorded[scenario], fingerprint=prints[0], simulator=prints[1])
                keep(suite, list(recorded.values()), file)
    return status


def _is_outdated(run: Run, cell: Cell) -> bool:
    planned = Run.planned(run.policy, cell)
    return (run.fingerprint, run.simulator) != (planned.fingerprint, planned.simulator)


def proof(recorded: Mapping[str, Run], runs: Sequence[Run]) -> tuple[bool, str]:
    """Return whether runs repeat the recorded ones, and how many numbers were compared.

    A number may differ by one unit in the last recorded place: the order in which NumPy adds depends on the processor.

    Args:
        recorded: recorded runs of a policy by scenario.
        runs: the runs of the same episodes.
    """
    units = np.array([[2.0 ** (1 - DIGITS.get(f.name, SINGLE))] for f in fields(Measures)])
    numbers = differing = 0
    first = ""
    for run in runs:
        scenario, measures = run.scenario.name, recorded[run.scenario.name].measures
        if run.measures is None or measures is None:
            return False, f"it fails in {scenario}: {run.error}"
        old, new = (_numbers(recorded_measures(m)) for m in (measures, run.measures))
        with np.errstate(invalid="ignore"):
            differs = ~((old == new) | (np.abs(new - old) <= units * np.abs(old)) | (np.isnan(old) & np.isnan(new)))
        numbers, differing = numbers + old.size, differing + int(differs.sum())
        if differs.any() and not first:
            metric, episode = np.argwhere(differs)[0].tolist()
            values = f"{old[metric, episode]:.9g} -> {new[metric, episode]:.9g}"
            first = f"{fields(Measures)[metric].name} of episode {episode} of {scenario}, {values}"
    if differing:
        return False, f"{differing} of {numbers} numbers, the first is {first}"
    return True, f"{numbers} numbers of {len(runs)} cells"


def _numbers(measures: Measures) -> Array:
    """Return metrics in single precision, shape (metrics, M)."""
    return np.array([getattr(measures, f.name) for f in fields(Measures)], dtype=np.float32).astype(np.float64)


def _run(policy: str, cells: Sequence[Cell], options: Options) -> list[Run]:
    """Return the runs of a policy and show their progress on stderr."""
    return run_and_show([(policy, cell) for cell in cells], Workers(options.jobs))

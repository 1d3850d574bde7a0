"""Train agents that correct an expert: `auv-gym train --help`, in a checkout also `python train.py --help`."""

from __future__ import annotations

import importlib
import json
import math
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import arg

from auv_gym.physics.vehicle import Vehicle
from auv_gym.scenarios.fitting import Sea
from auv_gym.scenarios.mixtures import MIXTURES, Mixture
from auv_gym.scenarios.presets import SETPOINTS, with_setpoints
from auv_gym.scenarios.records import meant, read_table, table_file
from auv_gym.scenarios.scenario import Scenario
from auv_gym.scenarios.vehicles import PAPER, as_vehicle_model
from baselines.agents.names import AGENT_FOLDER, shipped_agents
from baselines.control import POLICIES
from baselines.control.open_loop import NO_EXPERT
from baselines.evaluation.request import checked_scenario, import_effects
from baselines.evaluation.score import EXPERT, SETPOINT_EXPERT, expert_of
from baselines.tools.command_line import UsageError, check_words, checked, checked_folder, parse, typed
from baselines.tools.workers import Workers
from baselines.training.comparison import RESULT, Comparison
from baselines.training.config import ALGORITHMS, Config
from baselines.training.initial_agent import ALGO, InitialAgent, fitted, in_own_units
from baselines.training.run_folder import LOCK, read_config
from baselines.training.train import TrainingRequest, train_all

PROGRAM = "train.py"
BASE_AGENT, SPACE_BASE_AGENT = "helm-any", "helm-3d"
"""Shipped agents that a training for a vehicle starts from, in the plane and in space."""
VEHICLE_EXPERT = "los-pid"
"""Expert of a new network for a vehicle: its gains depend on limits and lag, and it follows waves that weak fins cannot
resist, where `EXPERT` diverges."""
DEFAULTS: Mapping[str, Any] = {"timesteps": 1_000_000, "expert": None, "authority": 0.5}
"""Values of these options if neither the command line nor the file of hyper-parameters has them; for the expert None
is that of `expert_of`, or `VEHICLE_EXPERT` for a vehicle that takes forces."""
DEFAULT_SCENARIO = ("cruise",)  # of `--scenario`
FINE_TUNING_METHOD = "fine-tuning"
"""Name of the file of the hyper-parameters that differ from those of an agent's own training, if it is trained
further."""
SETPOINT_METHOD = "setpoints"
"""Name of the file of the hyper-parameters of a new agent whose actions are setpoints."""


@dataclass(frozen=True)
class Options:
    """Train a network that corrects an expert; write the agent, its learning curve and a checkpoint to a folder.

    Exit status: 0 done, 1 the training failed or could not be written, 2 wrong usage.

    Example: auv-gym train --vehicle lauv
    """

    algo: Annotated[str, arg(metavar="apg|ppo|sac|td3")] = "apg"
    """The algorithm: "apg" (analytic gradient: back-propagation through the simulator), or one of
    Stable-Baselines3: "ppo", "sac", "td3"."""
    scenario: Annotated[tuple[str, ...], arg(metavar="S [S ...]")] = ()
    """Training scenarios: names of presets, .toml and .json files, or a mixture; NAME:WEIGHT sets the weight.
    The mixtures "cruise" and "slow" have all cases of a speed range, storms with weight three, noise and slow actuators
    with weight two. "helm" has both speed ranges, faults, outages and slow actuators, as the agent of that name.
    "space" has the cases in space. Default: cruise, or the scenarios of the initial agent."""
    expert: Annotated[str | None, arg(metavar="E")] = None
    """Name of the policy that is corrected; "none" for an agent without an expert. Default: that of the initial agent;
    for a new network backstepping, or los-pid with --vehicle."""
    authority: Annotated[tuple[float, ...], arg(metavar="A [A]")] = ()
    """Largest correction of surge and yaw command, as fractions of the vehicle's limits, in (0, 2]: one number for
    all, two, or in space three, with pitch between. Default: from the hyper-parameters."""
    from_: Annotated[str | None, arg(name="from", metavar="AGENT")] = None
    """Initial agent, by name or folder, such as "helm". Its weights, network, inputs, expert and authority are used in
    a short training with small learning rates. "none" for a new network, whose correction is zero. Default: none; with
    --vehicle but not --algo or --expert: helm-any, or helm-3d in space."""
    vehicle: Annotated[str | None, arg(metavar="V")] = None
    """Vehicle to train for, a published one by name or a .toml file. The scenarios are adapted to it. Scenarios that
    are too slow for its fins are left out. At the end the agent is compared with controllers on storms."""
    current: Annotated[tuple[float, float] | None, arg(metavar="LO HI")] = None
    """Least and largest current of the sea of the vehicle [m/s], in all scenarios. Default: shares of the
    path speed."""
    waves: Annotated[float | None, arg(metavar="SHARE")] = None
    """Factor of the forces of the waves in the scenarios; 0 for none. Default: 1."""
    no_compare: bool = False
    """With --vehicle: leave out the comparison at the end."""
    effects: Annotated[tuple[Path, ...], arg(metavar="FILE.py [...]")] = ()
    """Python files with effects of your own, which scenario files name: docs/make-your-own.md. They are executed."""
    seed: int = 0
    """Seed of networks, exploration and episodes."""
    seeds: int = 1
    """Number of seeds, from --seed on; each has its own folder seed-N."""
    jobs: int | None = None
    """Worker processes for several seeds, or for the groups of a single training of apg, one thread each.
    Default: 2, or 1 on a single processor."""
    cluster: Annotated[str | None, arg(metavar="ADDRESS")] = None
    """A Dask scheduler, by its address or its file, whose workers run instead of --jobs, see docs/many-runs.md."""
    timesteps: int | None = None
    """Control steps to train for, summed over vehicles, rounded up to whole updates. Default: from the
    hyper-parameters."""
    hyperparameters: Annotated[Path | None, arg(metavar="FILE")] = None
    """File of hyper-parameters, .toml or .json. Default: the file of the package."""
    set: Annotated[tuple[str, ...], arg(metavar="NAME=VALUE [...]")] = ()
    """Hyper-parameters that replace those of the file, such as "effort_weight=0.1" or "preview=[5,10]"."""
    out: Annotated[Path | None, arg(metavar="DIR")] = None
    """Folder of the run; existing files are not overwritten. Default: in runs/train, named after the algorithm
    or the initial agent, the scenarios, the vehicle and its sea."""
    resume: bool = False
    """Continue the run that the same options have started in the folder, from its last checkpoint."""

    @property
    def sea(self) -> Sea:
        """The sea of the vehicle."""
        return Sea(self.current, self.waves)


def main(arguments: Sequence[str]) -> int:
    """Run the command and return its exit status.

    Raises:
        ModuleNotFoundError: a library for training is not installed.
        UsageError: an argument is wrong.
    """
    return train_all(checked_request(parse(Options, arguments, PROGRAM), typed(PROGRAM, arguments)))


def checked_request(options: Options, command: str = "") -> TrainingRequest:
    """Return the trainings of the options of a command line, completely checked, and create their folders.

    Args:
        options: of the command line.
        command: the command line, for the description of the agents.

    Raises:
        UsageError: an option is wrong, or a folder holds something else; the message says what is allowed.
    """
    workers = checked(partial(Workers.of, options.jobs, options.cluster))
    import_effects(options.effects)
    configs = checked(partial(configurations, options))
    out = options.out or Path("runs/train") / _name(options)
    folders = (out,) if len(configs) == 1 else tuple(out / f"seed-{config.seed}" for config in configs)
    comparison = checked(partial(_comparison, options, configs[0]))
    ends = [out / RESULT if comparison else folder / AGENT_FOLDER for folder in folders]
    begun = [_holds(*run, options.resume) for run in zip(configs, folders, ends, strict=True)]
    if options.resume and not any(begun):
        print(f"note: --out {out} holds no run yet, so --resume begins one", file=sys.stderr)
    for folder in folders:
        checked_folder(folder)
    return TrainingRequest(configs, folders, out, workers, command, comparison)


def configurations(options: Options) -> tuple[Config, ...]:
    """Return the checked configuration of each seed.

    A value is that of the command line, else that of the file of hyper-parameters, else that of the initial agent.
    Expert and authority are always those of the initial agent, if there is one.

    Raises:
        OSError: a file cannot be read.
        UsageError: `--scenario` is wrong.
        ValueError: another option is wrong.
    """
    if options.seeds < 1:
        raise ValueError(f"--seeds is {options.seeds}; it must be 1 or more")
    if options.algo not in ALGORITHMS:
        hint = meant(options.algo, ALGORITHMS)
        raise ValueError(f"unknown algorithm {options.algo!r}{hint}; allowed are {', '.join(ALGORITHMS)}")
    start = _start(options)
    initial = None if start is None else InitialAgent.of(start)
    if initial and options.algo != ALGO:
        raise ValueError(f"--from requires the algorithm {ALGO}, not {options.algo}; leave out --algo")
    if options.vehicle is None and options.sea != Sea():
        raise ValueError("--current and --waves are those of a vehicle's sea; name it with --vehicle")
    scenarios, vehicle = _scenarios(options, initial)
    usual = expert_of(scenario for scenario, _ in scenarios)
    method = SETPOINT_METHOD if options.algo == ALGO and usual == SETPOINT_EXPERT else options.algo
    values = read_hyperparameters(options.hyperparameters or shipped(FINE_TUNING_METHOD if initial else method))
    timesteps, expert, authority = (values.pop(name, default) for name, default in DEFAULTS.items())
    values |= (changes := changes_of(options.set))
    authority = options.authority or authority
    if initial:
        initial.check(options.expert, options.authority, changes)
        values = {**initial.config.hyperparameters, **values}
        expert, authority = initial.agent.expert, initial.agent.authority
    else:
        if options.expert is not None and options.expert not in POLICIES:
            experts = (name for name, one in POLICIES.items() if not one.privileged)
            check_words("expert", [options.expert], (NO_EXPERT, *experts, *shipped_agents()))
        expert = options.expert or expert or (VEHICLE_EXPERT if options.vehicle and usual == EXPERT else usual)
    first = Config(
        options.algo,
        scenarios,
        expert,
        _authority(authority, len(scenarios[0][0].parts.model.channels)),
        options.seed,
        timesteps if options.timesteps is None else options.timesteps,
        values,
        initial.origin if initial else None,
        vehicle,
        initial.agent.whole_model if initial else any(scenario.model for scenario, _ in scenarios),
    )
    configs = tuple(replace(first, seed=first.seed + i) for i in range(options.seeds))
    check(first)
    return configs


def _authority(given: Any, channels: int) -> Any:
    """Return the authority of each channel: of one number all have it, of two pitch has that of yaw."""
    if not isinstance(given, Sequence):
        return given
    return (*given, *[given[-1]] * (channels - len(given)))


def check(config: Config) -> None:
    """Raise ValueError if the algorithm cannot train the configuration."""
    importlib.import_module(ALGORITHMS[config.algo]).check(config)


def shipped(name: str) -> Path:
    """Return the file of the package with the hyper-parameters of an algorithm, or of `FINE_TUNING_METHOD`."""
    return Path(__file__).parent / "hyperparameters" / f"{name}.toml"


def read_hyperparameters(file: Path) -> dict[str, Any]:
    """Return the hyper-parameters of a .toml or .json file, and its values for the options of `DEFAULTS`.

    Raises:
        OSError: the file cannot be read.
        ValueError: the file has another format.
    """
    values = read_table(file)
    if not isinstance(values, dict):
        raise ValueError(f"{file} has no table of hyper-parameters")
    return values


def changes_of(words: Sequence[str]) -> dict[str, Any]:
    """Return the hyper-parameters of words NAME=VALUE, where a value is JSON, or a name without quotation marks.

    Raises:
        ValueError: a word has another form.
    """
    changes = {}
    for word in words:
        name, _, text = word.partition("=")
        value = text if text.isidentifier() else None
        with suppress(ValueError, RecursionError):
            value = json.loads(text)
        if not name or value is None:
            raise ValueError(f"--set is {word!r}; it must be NAME=VALUE, such as effort_weight=0.1")
        changes[name] = value
    return changes


def hyperparameter_words(changes: Mapping[str, Any]) -> list[str]:
    """Return hyper-parameters as words NAME=VALUE."""
    return [f"{name}={json.dumps(value, separators=(',', ':'))}" for name, value in changes.items()]


def _start(options: Options) -> str | None:
    """Return the agent that a training starts from, None for a new network."""
    if options.from_ is None and options.vehicle and options.algo == ALGO and options.expert is None:
        mixture = resolved(options.scenario)
        return None if any(scenario.takes_setpoints for scenario, _ in mixture) else _base_agent(mixture)
    return None if options.from_ == NO_EXPERT else options.from_


def _base_agent(mixture: Mixture) -> str:
    """Return the agent of the package for a mixture of scenarios of any vehicle."""
    return SPACE_BASE_AGENT if any(scenario.vertical is not None for scenario, _ in mixture) else BASE_AGENT


def _scenarios(options: Options, initial: InitialAgent | None) -> tuple[Mixture, Vehicle | None]:
    """Return the training scenarios and the vehicle in whose units they are; note left-out scenarios on stderr."""
    if initial and not options.scenario:
        if initial.config.steers is not None and options.vehicle is None:
            return initial.config.scenarios, initial.config.steers
        mixture = initial.config.scenarios
    else:
        mixture = resolved(options.scenario or DEFAULT_SCENARIO)
    if options.vehicle is not None:
        if options.vehicle != PAPER.name:
            mixture, reasons = fitted(mixture, options.vehicle)
            if reasons:
                print(f"note: scenarios left out: {len(reasons)}; the first: {reasons[0]}", file=sys.stderr)
        mixture = tuple((options.sea.of(scenario), weight) for scenario, weight in mixture)
    return in_own_units(mixture)


def resolved(words: Sequence[str]) -> tuple[tuple[Scenario, float], ...]:
    """Return the scenarios and weights of the words of `--scenario`.

    Raises:
        UsageError: a scenario is unknown, or a weight is not a positive number.
    """
    mixture: list[tuple[Scenario, float]] = []
    for name, weight in map(_split, words):
        if (kind := name.removesuffix(SETPOINTS)) in MIXTURES:
            cases = [(scenario, weight * share) for scenario, share in MIXTURES[kind]]
            mixture += cases if kind == name else [(with_setpoints(scenario), share) for scenario, share in cases]
        else:
            mixture.append((checked_scenario(name, tuple(MIXTURES)), weight))
    return tuple(mixture)


def _split(word: str) -> tuple[str, float]:
    """Return the name and weight of NAME or NAME:WEIGHT."""
    name, colon, text = word.rpartition(":")
    if not colon or table_file(word) is not None:
        return word, 1.0
    try:
        weight = float(text)
    except ValueError:
        weight = math.nan
    if not 0 < weight < math.inf:
        raise UsageError(f"scenario {word!r} has weight {text!r}; it must be a positive number")
    return name, weight


def _name(options: Options) -> str:
    """Return the default name of a run's folder."""
    start = _start(options)
    words = options.scenario or (() if start else DEFAULT_SCENARIO)
    scenarios = "-".join(Path(_split(word)[0]).stem for word in words)
    current = () if options.current is None else ("current", *options.current)
    waves = () if options.waves is None else ("waves", options.waves)
    parts = Path(start).name if start else options.algo, scenarios, Path(options.vehicle or "").stem, *current, *waves
    return "-".join(str(part) for part in parts if part != "")


def _comparison(options: Options, config: Config) -> Comparison | None:
    """Return the comparison at the end; None if it is left out, or limits and lag of the vehicle are not known."""
    if options.no_compare or (vehicle_model := as_vehicle_model(options.vehicle)) is None:
        return None
    base, setpoints = _base_agent(config.scenarios), any(s.takes_setpoints for s, _ in config.scenarios)
    other = None if setpoints else _start(options) or base
    comparison = Comparison(vehicle_model, options.sea, other, base == SPACE_BASE_AGENT)
    try:
        comparison.scenario  # noqa: B018, it raises
    except ValueError as error:
        raise ValueError(f"--no-compare leaves out the comparison on storms, which is not possible: {error}") from error
    return comparison


def _holds(config: Config, folder: Path, end: Path, resume: bool) -> bool:
    """Return whether a folder holds the run; raise UsageError if it holds something else, or the run without resume.

    The run is finished if the file or folder `end` exists.
    """
    present = checked(partial(read_config, folder))
    if present is None:
        if folder.is_dir() and any(file.name != LOCK for file in folder.iterdir()):
            raise UsageError(f"--out {folder} is not empty and holds no run of `auv-gym train`; choose another folder")
        return False
    if (wanted := config.to_dict()) != (held := present.to_dict()):
        name = next(key for key in wanted if wanted[key] != held[key])
        change = f": {held[name]} instead of {wanted[name]}" if name not in ("scenarios", "hyperparameters") else ""
        raise UsageError(f"--out {folder} holds a run with other {name}{change}; choose another folder")
    if not resume:
        if end.exists():
            state, advice = "finished", "choose another folder, or delete it"
        else:
            state, advice = "unfinished", "add --resume to continue, or choose another folder"
        raise UsageError(f"--out {folder} holds this run already, {state}; {advice}")
    return True

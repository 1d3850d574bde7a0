"""Load policies: `file.py:factory`, `model.zip`, `model.onnx`, `gains.json`, folders of agents, programs."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

from auv_gym.installation import install
from auv_gym.physics.space import SpaceVehicle
from auv_gym.scenarios.records import guarded
from auv_gym.scenarios.vehicles import VehicleModel, as_vehicle
from auv_gym.task.policy import Policy
from baselines.agents.agent import Agent
from baselines.agents.names import PolicyName
from baselines.agents.onnx_models import OnnxModel
from baselines.agents.programs import ProgramPolicy
from baselines.agents.sb3_models import load_model, statistics_file
from baselines.control import make_controller, vehicle_option
from baselines.gains.loading import recorded_gains
from baselines.scaling import scaled_for
from baselines.space import make_in_space
from baselines.tools.command_line import described
from baselines.tools.files import read_bytes, read_json
from baselines.tools.programs import COMMAND


def caution(name: str) -> str | None:
    """Return the warning about a policy that is to be loaded, None if there is none."""
    if PolicyName.of(name).kind == "sb3":
        text = f"{name} holds pickled objects, which can run any code: load only files that you trust"
        if beside := statistics_file(Path(name)):
            return f"{text}; its observations are normalised by {beside}"
        if others := sorted(Path(name).parent.rglob("*vecnormalize*.pkl")):
            return f"{text}; its observations are not normalised; if {others[0]} belongs to it, copy it beside it"
        return text
    return None


def load_policy(name: PolicyName, vehicle: Any = None, **options: Any) -> Policy:
    """Return the policy of a path.

    Args:
        name: its parts; the base is "FILE.py:FACTORY", where the factory is called with the options, "FILE.zip",
            "FILE.onnx", "FILE.json" of `auv-gym tune`, an agent's folder, or "cmd:" and the words of a command.
        vehicle: the nominal one, see `baselines.make_policy`.
        options: of the factory, or `authority` of a model that was trained on the residual environment.

    Raises:
        OSError: the file cannot be read.
        ValueError: the file holds no such policy, or an option is unknown.
    """
    kind, base = name.kind, name.base
    if kind == "python":
        file, _, factory = base.rpartition(":")
        return _made(Path(file), factory, vehicle, options)
    allowed = ("authority",) if kind == "sb3" else ()
    if unknown := [option for option in options if option not in allowed]:
        raise ValueError(f"policy {base!r} takes no option {unknown[0]!r}; it has {', '.join(allowed) or 'no options'}")
    if isinstance(vehicle, SpaceVehicle) and kind in ("program", "onnx", "sb3"):
        raise ValueError(
            f"policy {base!r} is for motion in the plane; in space use FILE.py:FACTORY or an agent's folder"
        )
    if kind == "program":
        return ProgramPolicy(base.removeprefix(COMMAND), None if vehicle is None else as_vehicle(vehicle))
    if kind == "onnx":
        return _onnx(Path(base))
    if kind == "sb3":
        return load_model(Path(base), scaled_for(vehicle, partial(make_controller, "backstepping")), **options)
    if kind == "gains":
        return scaled_for(vehicle, partial(_tuned, Path(base)))
    return scaled_for(vehicle, _agent(name).policy)


def _tuned(file: Path, vehicle: Any) -> Policy:
    """Return a controller of the package with the gains of a file of `auv-gym tune`, for a vehicle in paper units."""
    record = read_json(file)
    with guarded(f"{file} holds no gains of a controller of the package"):
        name, gains = record["controller"], record["gains"]
        if name not in recorded_gains()["tuned"]:
            raise ValueError(f"its controller is {name!r}")
        if isinstance(vehicle, SpaceVehicle):
            return make_in_space(name, vehicle, gains=gains)
        return make_controller(name, vehicle, gains=gains)


def _onnx(file: Path) -> Policy:
    try:
        return OnnxModel(file)
    except ImportError as error:
        raise ValueError(f"{file} needs ONNX Runtime: {install('export')}") from error


def _agent(name: PolicyName) -> Agent:
    if name.folder is None and (folder := Path(name.base)).is_dir():
        several = sorted(str(one.parent) for one in folder.glob("*/agent/agent.json"))
        hint = f"choose one of {', '.join(several)}" if several else "finish its training with --resume"
        raise ValueError(f"{folder} has no agent; {hint}")
    return Agent.load(name.folder or name.base)


def _made(file: Path, factory: str, vehicle: Any, options: dict[str, Any]) -> Policy:
    source = read_bytes(file)
    module = ModuleType(f"user_policy_{file.stem}")
    module.__file__ = str(file)
    sys.modules[module.__name__] = module  # dataclasses look up their module here
    if (folder := str(file.resolve().parent)) not in sys.path:
        sys.path.append(folder)  # it may import files beside it; last, so that they replace no other module
    with _users_code(f"{file} cannot be imported"):
        # Not imported: the bytecode that an import keeps is stale if the file changes within a second.
        exec(compile(source, file, "exec", dont_inherit=True), vars(module))
    make = getattr(module, factory, None)
    if not callable(make):
        raise ValueError(f"{file} has no function or class {factory!r}")
    known = vehicle.vehicle if isinstance(vehicle, VehicleModel) else vehicle
    with _users_code(f"{factory} of {file} fails"):
        known_options = vehicle_option(make, known) | vehicle_option(make, vehicle, "vehicle_model")
        policy: Policy = make(**{**known_options, **options})
    if not callable(getattr(policy, "predict", None)):
        raise ValueError(f"{factory} of {file} returns a {type(policy).__name__}, which has no method predict")
    return policy


def load_effects(file: Path) -> None:
    """Import a Python file that defines effects, see `auv_gym.effects.effect`; worker processes import it too.

    Raises:
        OSError: the file cannot be read.
        ValueError: it is no Python file, its name is that of another module, or it raises an error.
    """
    read_bytes(file)
    name, folder = file.stem, str(file.resolve().parent)
    known = getattr(sys.modules.get(name), "__file__", None) if name in sys.modules else str(file.resolve())
    if file.suffix != ".py" or known != str(file.resolve()):
        raise ValueError(f"{file} must be a Python file whose name is not that of another module: rename it")
    if folder not in sys.path:
        sys.path.insert(0, folder)
    with _users_code(f"{file} cannot be imported"):
        import_module(name)


@contextmanager
def _users_code(failure: str) -> Iterator[None]:
    """Turn whatever a user's code raises, except KeyboardInterrupt, into a ValueError that begins with `failure`."""
    try:
        yield
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # noqa: BLE001 - it can raise anything
        raise ValueError(f"{failure}: {described(error)}") from None

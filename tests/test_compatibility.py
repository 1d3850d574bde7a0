"""The stable names of docs/compatibility.md, one by one: what tests/stable.json lists must still be there, unchanged.

`python tests/test_compatibility.py` adds what is new; it removes and changes nothing.
"""

import json
import re
import sys
from dataclasses import fields
from pathlib import Path

import gymnasium as gym

import auv_gym
import baselines
from auv_gym.scenarios.scenario import Scenario
from auv_gym.scenarios.vehicles import VehicleModel
from auv_gym.task.model import PLANE
from auv_gym.task.space import SPACE
from baselines.__main__ import COMMANDS
from baselines.agents import agent as agents
from baselines.agents import programs
from baselines.control import POLICIES
from baselines.evaluation import plants
from baselines.evaluation.results import ResultFile
from baselines.evaluation.suites import list_suites, load_suite
from baselines.policies import list_policies
from baselines.tools import command_line

SUITES = Path(baselines.__file__).parent / "evaluation" / "data" / "suites"
STABLE = Path(__file__).with_name("stable.json")


def options_of(module):
    """Return the options of a command, by the fields of its dataclass."""
    __import__(module)
    own = sys.modules[module]
    options = getattr(own, "Options", None)
    return sorted(field.name for field in fields(options)) if options else []


def present():
    """Return all that is stable now, as plain JSON."""
    return {
        "ids": sorted(name for name in gym.registry if name.startswith("UnderactuatedAUV")),
        "observation": {
            model.name: [[term.name, term.unit, term.scale, term.bound] for term in model.layout.terms]
            for model in (PLANE, SPACE)
        },
        "actions": {model.name: [[channel] for channel in model.channels] for model in (PLANE, SPACE)},
        "auv_gym": sorted(auv_gym.__all__),
        "baselines": sorted(baselines.__all__),
        "policies": sorted({*list_policies(None), *(name for name, entry in POLICIES.items() if entry.setpoints)}),
        "commands": {name: options_of(command.module) for name, command in COMMANDS.items()},
        "exit status": {"done": command_line.DONE, "failed": command_line.FAILED},
        "suites": {name: load_suite(name).hash for name in list_suites() if [*SUITES.glob(f"{name}.*")]},
        "files": {
            "scenario": sorted(field.name for field in fields(Scenario)),
            "vehicle": sorted(field.name for field in fields(VehicleModel)),
            "agent": sorted(agents.ENTRIES),
            "results.npz": sorted(field.name for field in fields(ResultFile)),
            "program protocol": programs.PROTOCOL,
            "plant protocol": plants.PROTOCOL,
        },
    }


def lost(before, now, where=""):
    """Yield what is missing or different: entries of tables and of lists of names; other values must be equal.

    In a list of lists also the order counts.
    """
    if isinstance(before, dict) and isinstance(now, dict):
        for key, value in before.items():
            yield from lost(value, now.get(key), f"{where}/{key}")
    elif isinstance(before, list) and isinstance(now, list) and all(isinstance(x, str) for x in before):
        yield from (f"{where}: {name}" for name in before if name not in now)
    elif before != now:
        yield f"{where}: {before} is now {now}"


def test_every_stable_name_is_still_there():
    assert list(lost(json.loads(STABLE.read_text(encoding="utf-8")), present())) == []


def test_what_is_new_is_listed():
    """So that the next version keeps it."""
    assert list(lost(present(), json.loads(STABLE.read_text(encoding="utf-8")))) == []


def test_lost_names_are_found():
    before = {"a": ["x", "y"], "b": {"c": 1}, "d": [[1]]}
    assert list(lost(before, {"a": ["y", "z"], "b": {"c": 2}, "d": [[1]]})) == ["/a: x", "/b/c: 1 is now 2"]


def test_the_page_names_each_kind():
    page = (Path(__file__).parents[1] / "docs" / "compatibility.md").read_text(encoding="utf-8")
    for name in auv_gym.__all__ + baselines.__all__:
        assert re.fullmatch(r"\w+", name)
    for kind in ("ids", "observation and action", "policies", "commands", "suites", "files", "tests/stable.json"):
        assert kind in page


def merged(before, now):
    """Return what was listed with what is new."""
    if isinstance(before, dict) and isinstance(now, dict):
        return {key: merged(before[key], now[key]) if key in before else now[key] for key in {**before, **now}}
    if isinstance(before, list) and all(isinstance(x, str) for x in before):
        return sorted({*before, *now})
    return before


if __name__ == "__main__":
    known = json.loads(STABLE.read_text(encoding="utf-8")) if STABLE.exists() else {}
    STABLE.write_text(json.dumps(merged(known, present()), indent=1) + "\n", encoding="utf-8")

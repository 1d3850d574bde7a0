"""Vehicles that another simulator moves: the programs of the page, six degrees of freedom, wrong answers."""

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from auv_gym.scenarios.presets import PRESETS, SPACE_PRESETS, as_scenario
from baselines.evaluation.cells import drawn
from baselines.evaluation.command import main
from baselines.evaluation.fingerprints import simulator_fingerprint
from baselines.evaluation.plants import PlantCommand, checked_plant, moved_by
from baselines.evaluation.report.numbers import compare
from baselines.evaluation.rollout import rollout
from baselines.evaluation.runner import runs
from baselines.policies import make_policy
from baselines.tools.command_line import UsageError
from baselines.tools.programs import ProgramError
from research.transfer.simulators import IN_SPACE, SIX_DOF_MODELS, SixDofSimulator

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "plants.md").read_text(encoding="utf-8")
PYTHON = shlex.quote(sys.executable)
SIX_DOF = f"{PYTHON} -m research plant remus100"
ECHO = """
import json, sys
hello = json.loads(sys.stdin.readline())
print("{}", flush=True)
rows = [[0.0] * len(hello["states"])] * hello["vehicles"]
for k, line in enumerate(sys.stdin):
    question = json.loads(line)
    answer = {} if "place" in question else {"states": rows}
"""
"""The beginning of a plant that does not move, once it prints."""
TELL = "    print(json.dumps(answer), flush=True)\n"


@pytest.fixture(autouse=True)
def _here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(ROOT))


def program(text):
    """Return the name of a plant that is a program of this text."""
    Path("plant.py").write_text(text, encoding="utf-8")
    return f"cmd:{PYTHON} plant.py"


def written(name):
    """Write the example of the page with this name of a file."""
    (text,) = re.findall(rf"^```\w+\n((?:#|//) {re.escape(name)}\n.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)
    Path(name).write_text(text, encoding="utf-8")


@pytest.mark.parametrize("name", ["cruise-mismatch@remus100", "space-storm@remus100"])
def test_six_degrees_of_freedom_through_the_protocol(name):
    """The same episodes as in this process, with current, waves and model errors."""
    scenario = as_scenario(name)
    cell = drawn(scenario, 3, 5)
    models = IN_SPACE if scenario.vertical else SIX_DOF_MODELS
    policy, plant = make_policy("los-pid", scenario.known), PlantCommand(SIX_DOF, 512)
    own, through = (
        rollout(policy, scenario, cell.episodes, simulator=simulator)
        for simulator in (
            moved_by(lambda n: SixDofSimulator("remus100", n, models)),
            plant.simulator(scenario, cell.episodes),
        )
    )
    np.testing.assert_allclose(through.errors, own.errors, rtol=1e-9)


@pytest.mark.parametrize(
    ("file", "command", "tool"),
    [("my_plant.py", f"{PYTHON} my_plant.py", sys.executable), ("my_plant.cpp", "./my_plant", "c++")],
)
def test_the_examples_of_the_page_move_as_the_equations(file, command, tool):
    """In calm water: they integrate the planar equations of the known vehicle in steps of their own."""
    if shutil.which(tool) is None:
        (pytest.fail if os.environ.get("CI") else pytest.skip)(f"{tool} is not installed")
    written(file)
    if tool == "c++":
        subprocess.run(["c++", "-std=c++17", "-O2", "-Wall", "-Wextra", "-Werror", "-o", "my_plant", file], check=True)
    scenario = PRESETS["cruise-current"]
    cell, policy = drawn(scenario, 3, 0), make_policy("los-pid", scenario.vehicle)
    plant = checked_plant(f"cmd:{command}", [scenario])
    other = rollout(policy, scenario, cell.episodes, simulator=plant.simulator(scenario, cell.episodes))
    plain = rollout(policy, scenario, cell.episodes)
    np.testing.assert_allclose(other.errors, plain.errors, atol=1e-3)


def test_the_page_names_the_commands():
    for words in ("cmd:python3 my_plant.py", "cmd:./my_plant", "cmd:python -m research plant remus100"):
        assert f'--plant "{words}"' in PAGE
    assert "c++ -std=c++17 -O2 -o my_plant my_plant.cpp" in PAGE


WRONG = {
    "no command": ("my_plant.py", "must be 'cmd:' and a command"),
    "nothing": ("cmd:./nothing", "cannot start cmd:./nothing: No such file"),
    "most": (ECHO.replace('"{}"', "'{\"most\": 0}'"), r"most 0; it must be an integer in \[1, 512\]"),
    "unknown entry": (ECHO.replace('"{}"', "'{\"dt\": 0}'"), "greeting has the entry 'dt'"),
    "states": (ECHO + "    answer = {'states': [[1.0]]}\n" + TELL, r"to new states; it must be \{\}"),
    "shape": (ECHO + "    answer and answer.update(states=[[1.0]])\n" + TELL, r"shape \(1, 1\); it must be \(1, 6\)"),
    "text": (ECHO + "    answer and answer.update(states=[['0'] * 6])\n" + TELL, "entries that are no numbers"),
    "no states": (
        ECHO + "    answer = {} if 'place' in question else {'forces': []}\n" + TELL,
        r"it answers \['forces'\]",
    ),
    "says why": (ECHO + "    answer = {'error': 'no licence'}\n" + TELL, "it reports: no licence"),
}
"""Plants that do not answer as they should, and what is said of them."""


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_plant_is_refused_before_the_run(case):
    text, says = WRONG[case]
    with pytest.raises((ProgramError, ValueError), match=says) as caught:
        checked_plant(program(text) if "\n" in text else text, [PRESETS["cruise-calm"]])
    assert "\n" not in str(caught.value)


def test_a_plant_that_ends_only_affects_its_row_and_a_lost_vehicle_is_lost():
    cell = drawn(PRESETS["cruise-calm"], 2, 0)
    late = program(ECHO + "    if k == 50: sys.exit('sunk')\n" + TELL)
    (run,) = runs([("los-pid", cell)], plant=checked_plant(late, [cell.scenario]))
    assert "sunk" in run.error
    lost = program(ECHO + "    if answer and k > 50: answer['states'] = [[None] * 6] * len(rows)\n" + TELL)
    (run,) = runs([("los-pid", cell)], plant=checked_plant(lost, [cell.scenario]))
    assert run.measures.failed.all()
    assert np.isfinite(run.measures.steady_rmse).all()
    assert np.isfinite(run.measures.total_reward).all()
    assert compare([run])[0].entry.failed == 2


def test_the_greeting_and_the_number_of_vehicles_at_once():
    """A plant of one vehicle gets the episodes one after the other, each with its own seed."""
    text = ECHO.replace('"{}"', "'{\"most\": 1}'")
    text = text.replace("rows =", "open('hellos', 'a').write(json.dumps(hello) + '\\n')\nrows =")
    cell = drawn(SPACE_PRESETS["space-current"], 3, 0)
    plant = checked_plant(program(text + TELL), [cell.scenario])
    Path("hellos").unlink()
    (run,) = runs([("los-pid", cell)], plant=plant)
    assert len(run.measures.failed) == 3
    hellos = [json.loads(line) for line in Path("hellos").read_text().splitlines()]
    assert [hello["seed"] for hello in hellos] == [episode.noise_seed for episode in cell.episodes]
    hello = hellos[0]
    assert (hello["motion"], hello["vehicles"], hello["dt"]) == ("space", 1, 0.1)
    assert hello["inputs"] == ["F_u", "F_q", "F_r", "V_x", "V_y", "V_z", "X", "Y", "Z", "M", "N"]
    assert hello["states"][:4] == ["x", "y", "z", "theta"]
    assert {"level_m11", "upright_m33", "stiffness"} <= set(hello["parameters"])


def test_evaluate_with_a_plant(capsys):
    """No recorded rows, no policies that know the equations, and a fingerprint of the program's files."""
    name = f"cmd:{SIX_DOF}"
    words = ["--plant", name, "--scenario", "cruise-calm@remus100", "--episodes", "2", "--jobs", "1", "--out", "out"]
    assert main(["--policy", "los-pid", *words]) == 0
    assert f"the vehicles are moved by {name}" in capsys.readouterr().err
    content = json.loads(Path("out/results.json").read_text())
    results = content["results"]
    assert content["plant"] == name
    assert {row["policy"] for row in results} == {"backstepping", "los-pid"}
    with pytest.raises(UsageError, match="clairvoyant needs the equations of motion"):
        main(["--policy", "clairvoyant", *words])
    Path("a.py").write_text("1")
    scenarios = [PRESETS["cruise-calm"]]
    plain, one = (simulator_fingerprint(scenarios, plant) for plant in (None, "python a.py"))
    Path("a.py").write_text("import b")
    two = simulator_fingerprint(scenarios, "python a.py")
    Path("b.py").write_text("1")
    assert len({plain, one, two, simulator_fingerprint(scenarios, "python a.py")}) == 4


def test_a_plant_for_another_vehicle_refuses():
    with pytest.raises(ProgramError, match="the scenario is for lauv, this plant is remus100"):
        checked_plant(f"cmd:{SIX_DOF}", [as_scenario("cruise-calm@lauv")])

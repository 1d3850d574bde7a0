"""Fingerprints change with what can change numbers, and with nothing else."""

import json
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import baselines
from auv_gym.effects.actuators import Actuators
from auv_gym.planning import kernels as planning
from auv_gym.scenarios.presets import PRESETS, as_scenario
from baselines.agents.agent import Agent
from baselines.agents.features import FEATURES
from baselines.agents.networks import Gru
from baselines.control import Registration
from baselines.control.backstepping import Backstepping
from baselines.evaluation import fingerprints
from baselines.evaluation.fingerprints import changed_parts, fingerprint, simulator_fingerprint
from baselines.gains import loading

ROOT = Path(__file__).parents[2]
STORM = PRESETS["cruise-storm"]
COMPILED = {"backstepping", "backstepping-normalised", "ilos", "open-loop"}
"""Policies whose arithmetic is in kernels only."""


def test_all_policies_have_different_fingerprints():
    prints = {name: fingerprint(name) for name in baselines.list_policies()}
    assert len(set(prints.values())) == len(prints)
    for name, text in prints.items():
        kernels, data, code = text.split(".")
        assert len(kernels) == len(data) == 20
        assert bool(code) == (name not in COMPILED)
    assert fingerprint("nobody") == ""


def test_suffixes_count():
    names = "helm", "helm:guard", "helm:guard=ekf"
    assert len({fingerprint(name) for name in names} - {""}) == len(names)
    assert fingerprint("helmet:guard") == fingerprint("helm:guard=nobody") == ""


def test_options_gains_and_vehicles_count(monkeypatch):
    before = {name: fingerprint(name) for name in ("backstepping", "lqi", "ekf")}
    monkeypatch.setitem(baselines.POLICIES, "backstepping", Registration(Backstepping, "", {"gains": "auto"}))
    assert changed_parts(before["backstepping"], fingerprint("backstepping")) == ["data"]
    real = loading.recorded_gains()
    other = {**real["tuned"], "lqi": {"slow": {"gains": {"anything": 1.0}}}}
    monkeypatch.setattr(loading, "recorded_gains", lambda: real | {"tuned": other})
    monkeypatch.setattr(fingerprints, "_used", lambda *_: (frozenset(), False))  # these gains make no policy
    assert "data" in changed_parts(before["lqi"], fingerprint("lqi"))
    assert "data" not in changed_parts(before["ekf"], fingerprint("ekf"))


def test_equations_depend_on_the_vehicle():
    """The law has the numbers of its vehicle as constants; the line-of-sight controller has them as inputs."""
    lauv = [as_scenario("cruise-storm@lauv")]
    assert changed_parts(fingerprint("backstepping", [STORM]), fingerprint("backstepping", lauv)) == ["equations"]
    assert changed_parts(fingerprint("los-pid", [STORM]), fingerprint("los-pid", lauv)) == []


def test_everything_that_affects_an_agent_counts(tmp_path):
    network = Gru(len(FEATURES), 2, 2, 2)
    weights = {name: np.zeros(shape, np.float32) for name, shape in network.shapes.items()}

    def made(**changes):
        given = {"network": network, "weights": weights, "expert": "backstepping", "authority": (0.5, 0.5)}
        Agent(**{**given, **changes}).save(tmp_path / "mine")
        return fingerprint(str(tmp_path / "mine"))

    before = made()
    assert made() == made(training={"seconds": 3}) == made(scenarios=("slow-calm",)) == before
    others = [
        made(weights={name: array + 0.1 for name, array in weights.items()}),
        made(authority=(0.5, 0.4)),
        made(expert="backstepping-normalised"),
    ]
    assert len({before, *others}) == 4


def test_the_parts_of_a_scenario_and_the_code_of_plans_count(monkeypatch):
    now = simulator_fingerprint([STORM])
    assert simulator_fingerprint([replace(STORM, error_scale=0.7)]) == now
    late = replace(STORM, actuators=Actuators(400.0, 200.0, delay=(0.0, 2.0)))
    assert simulator_fingerprint([late]) != now
    monkeypatch.setattr(planning, "_code", lambda: "another driver")
    assert simulator_fingerprint([STORM]) != now


EDITS = {
    "refactoring": [
        ("auv_gym/task/simulation.py", "squared_error", "distance_2"),  # renames a local variable
        ("auv_gym/physics/dynamics.py", "def rk4_step", "UNUSED = 3\n\n\ndef rk4_step"),
        ("baselines/control/los_pid.py", '"""Line-of-sight', '"""The line-of-sight'),
    ],
    "equation": [("auv_gym/task/simulation.py", "_error = sum_of_squares(", "_error = 2.0 * sum_of_squares(")],
    "metrics": [("baselines/evaluation/metrics.py", "\nimport ", "\nA_CONSTANT = 3\nimport ")],
    "filter": [("baselines/estimation/kalman.py", "ODDS = 10.0", "ODDS = 11.0")],
}
"""Edits of files: file, text, replacement."""
NAMES = "los-pid", "backstepping", "ekf", "nmpc", "helm"
PROGRAM = f"""
from auv_gym.scenarios.presets import PRESETS
from baselines.evaluation.fingerprints import fingerprint, simulator_fingerprint
import json
print(json.dumps([simulator_fingerprint([PRESETS["cruise-storm"]]), *map(fingerprint, {NAMES})]))
"""


@pytest.mark.slow
@pytest.mark.parametrize("kind", EDITS)
def test_fingerprints_survive_a_refactoring_and_nothing_else(kind, tmp_path):
    """A copy of the packages is edited, and a new process computes the fingerprints."""
    for package in ("auv_gym", "baselines"):
        shutil.copytree(ROOT / package, tmp_path / package)
    for name, text, other in EDITS[kind]:
        file = tmp_path / name
        assert text in file.read_text()
        file.write_text(file.read_text().replace(text, other))
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], cwd=tmp_path, env={**os.environ, "PYTHONPATH": str(tmp_path)},
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    simulator, *policies = json.loads(done.stdout)
    changed = {name for name, edited in zip(NAMES, policies, strict=True) if changed_parts(fingerprint(name), edited)}
    assert changed == ({"los-pid", "ekf", "nmpc", "helm"} if kind == "filter" else set())
    assert (simulator == simulator_fingerprint([STORM])) == (kind not in ("equation", "metrics"))

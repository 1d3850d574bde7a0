"""The controller of examples/ros2, without ROS: it commands what the agent does in Python, in both axes, and holds."""

import math
import re
import shutil
import subprocess
from pathlib import Path
from xml.etree import ElementTree as ET

import gymnasium as gym
import numpy as np
import pytest

from auv_gym import decode_observation
from auv_gym.effects.actuators import Actuators
from auv_gym.effects.autopilot import LARGEST_TURN
from auv_gym.physics.vehicle import PAPER_VEHICLE
from auv_gym.planning.paths import Circle
from auv_gym.planning.planner import plan
from auv_gym.scenarios.scenario import Scenario, Start
from baselines import make_policy
from baselines.export.c_header import c_header
from baselines.export.parts import exported

pytestmark = pytest.mark.slow  # a program is compiled, and an agent runs an episode
PACKAGE = Path(__file__).parents[1] / "examples" / "ros2" / "auv_gym_controller"
STRICT = ("-Wall", "-Wextra", "-Wpedantic", "-Werror", "-O2")
STEPS, PREVIEW, PERIOD = 150, 40, 0.1
MAIN = """
#include <fstream>
#include <iostream>
#include "auv_gym_controller/controller.hpp"
using namespace auv_gym_controller;
int main(int, char **argv) {
  const bool ned = std::string(argv[1]) == "ned";
  std::ifstream stream("reference.csv");
  Controller controller(read_reference(stream), {400.0, 200.0}, 0.1, std::stod(argv[2]));
  std::cout.precision(17);
  for (std::string line; std::getline(std::cin, line);) {
    std::istringstream text(line);
    double n[6];
    std::string word;
    for (double &x : n) { text >> word; x = std::stod(word); }
    const Measurement m = ned ? from_ned(n[0], n[1], n[2], n[3], n[4], n[5])
                              : Measurement{n[0], n[1], n[2], n[3], n[4], n[5]};
    const Command c = controller.step(std::isnan(n[2]) ? nullptr : &m), shown = ned ? to_ned(c) : c;
    const Setpoints s = controller.setpoints();
    std::cout << shown.F_u << " " << shown.F_r << " " << static_cast<int>(controller.status()) << " " << s.heading
              << " " << s.speed << "\\n";
  }
}
"""


def run(fin):
    """Return what the agent measures and commands on a circle, shape (STEPS, 6) and (STEPS, 2) [N, N m]."""
    path, policy = Circle(0.8, 0.1), make_policy("helm")
    start, actuators = Start(x_e=1.0, y_e=-0.5, psi_e=0.3), Actuators(fin=fin)
    scenario = Scenario(path=path, steps=STEPS, start=start, actuators=actuators)
    env = gym.make("auv_gym:UnderactuatedAUVTrack-v0", scenario=scenario, preview=policy.preview)
    observation, _ = env.reset(seed=0)
    memory, first, measured, commands = None, np.array([True]), [], []
    for _ in range(STEPS):
        measured.append(env.unwrapped.state)
        action, memory = policy.predict(observation, memory, first)
        o = decode_observation(observation)
        commands.append(action * (o.F_u_max, o.F_r_max))
        observation, *_ = env.step(action)
        first = np.array([False])
    return np.array(measured), np.array(commands)


@pytest.fixture(scope="module")
def episode():
    return run(0.0)


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    """The folder of the compiled program, with the reference as docs/on-a-vehicle.md writes it."""
    for compiler in ("gcc", "g++"):
        if shutil.which(compiler) is None:
            pytest.skip(f"{compiler} is not installed")
    folder = tmp_path_factory.mktemp("ros2")
    shutil.copytree(PACKAGE, folder / "package")
    header = folder / "package" / "include" / "auv_gym_controller" / "agent.h"
    header.write_text(c_header(exported("helm"), "float64"), encoding="utf-8")
    (folder / "main.cpp").write_text(MAIN, encoding="utf-8")
    reference = plan(Circle(0.8, 0.1), PAPER_VEHICLE, PERIOD * np.arange(STEPS + PREVIEW))
    np.savetxt(folder / "reference.csv", reference.table, fmt="%.17g", delimiter=",", header="x,y,psi,u,v,r,F_u,F_r")
    include = ("-I", "package/include")
    compiled(folder, "gcc", "-std=c99", *include, "-c", "package/src/agent.c", "-o", "agent.o")
    compiled(folder, "g++", "-std=c++17", *include, "main.cpp", "agent.o", "-o", "program", "-lm")
    return folder


def compiled(folder, compiler, *words):
    done = subprocess.run([compiler, *STRICT, *words], cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def commanded(folder, measured, axes="enu", fin=0.0):
    """Return forces, shape (N, 2), the status of each step, and the setpoints of heading and speed, shape (N, 2)."""
    lines = "\n".join(" ".join(f"{x:.17g}" for x in row) for row in measured)
    done = subprocess.run(
        [folder / "program", axes, str(fin)], input=lines, cwd=folder, capture_output=True, text=True, check=True
    )
    rows = np.array([line.split() for line in done.stdout.splitlines()], dtype=float)
    return rows[:, :2], rows[:, 2].astype(int).tolist(), rows[:, 3:]


def test_it_commands_what_the_agent_does(program, episode):
    measured, commands = episode
    forces, status, _ = commanded(program, measured)
    assert np.abs(commands).max() > 20.0
    np.testing.assert_allclose(forces, commands, atol=1e-3)
    assert status == [0] * STEPS


def test_it_knows_that_fins_need_speed(program):
    measured, commands = run(150.0)
    assert measured[:, 3].min() < 0.8 < 200 / 150
    np.testing.assert_allclose(commanded(program, measured, fin=150.0)[0], commands, atol=1e-3)


def test_ned_has_the_same_surge_force_and_the_opposite_moment(program, episode):
    """The track is mirrored: north is x, east is -y."""
    measured, commands = episode
    forces, *_ = commanded(program, measured * (1, -1, -1, 1, -1, -1), "ned")
    np.testing.assert_allclose(forces, commands * (1, -1), atol=1e-3)


def test_an_action_is_also_a_setpoint(program):
    """Relative to heading and speed of the reference, as an `Autopilot` takes it; with fins too."""
    measured, commands = run(150.0)
    largest = np.clip(150.0 * measured[:, 3] ** 2, 200.0 / 64, 200.0)
    *_, setpoints = commanded(program, measured, fin=150.0)
    reference = plan(Circle(0.8, 0.1), PAPER_VEHICLE, PERIOD * np.arange(STEPS))
    actions = commands / np.stack((np.full(STEPS, 400.0), largest), axis=1)
    np.testing.assert_allclose(setpoints[:, 0], reference.table[:, 2] + LARGEST_TURN * actions[:, 1], atol=1e-4)
    np.testing.assert_allclose(setpoints[:, 1], reference.table[:, 3] * (1 + actions[:, 0]), atol=1e-4)


def test_a_missing_measurement_repeats_the_command_then_stops(program, episode):
    measured = episode[0].copy()
    measured[50:53] = math.nan
    measured[80:100] = math.nan
    forces, status, _ = commanded(program, measured)
    assert status == [0] * 50 + [1] * 3 + [0] * 27 + [1] * 10 + [2] * 10 + [0] * 50
    assert (forces[50:53] == forces[49]).all()
    assert (forces[80:90] == forces[79]).all()
    assert (forces[90:100] == 0).all()
    assert np.isfinite(forces).all()


def test_a_missing_position_is_replaced_by_the_last_one(program, episode):
    missing, held = episode[0].copy(), episode[0].copy()
    missing[50:60, :2], held[50:60, :2] = math.nan, held[49, :2]
    assert (commanded(program, missing)[0] == commanded(program, held)[0]).all()
    missing[20:, :2] = math.nan
    assert commanded(program, missing)[1] == [0] * 120 + [1] * 10 + [2] * 20


def test_the_end_of_the_reference_is_zero_force(program, episode):
    forces, status, _ = commanded(program, np.concatenate((episode[0], episode[0][-1:])))
    assert (status[-1], *forces[-1]) == (3, 0, 0)


def test_the_package_names_what_its_node_includes():
    package = ET.parse(PACKAGE / "package.xml").getroot()
    depends = {entry.text for entry in package.findall("depend")}
    build = (PACKAGE / "CMakeLists.txt").read_text(encoding="utf-8")
    node = (PACKAGE / "src" / "controller_node.cpp").read_text(encoding="utf-8")
    assert depends == set(re.findall(r"#include <(\w+)/", node))
    assert depends | {"ament_cmake"} == set(re.findall(r"find_package\((\w+)", build))
    assert f"project({package.findtext('name')} C CXX)" in build


def test_a_reference_with_a_column_too_many_is_refused(program, tmp_path):
    (tmp_path / "reference.csv").write_text("0,0,0,0,0,0,0,0,0\n", encoding="utf-8")
    words = [program / "program", "enu", "0"]
    done = subprocess.run(words, input="", cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode != 0
    assert "a row has more than 8 numbers" in done.stderr

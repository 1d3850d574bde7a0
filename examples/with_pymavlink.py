"""MAVLink: a node that steers an autopilot by setpoints, and a fake vehicle on the loopback address that it follows.

    python with_pymavlink.py POLICY VEHICLE reference.csv udpin:0.0.0.0:14550

The node reads LOCAL_POSITION_NED and ATTITUDE and answers each pair: with MAV_CMD_DO_CHANGE_SPEED and the heading as
the quaternion of SET_ATTITUDE_TARGET, for a policy whose actions are forces with x and r of MANUAL_CONTROL. The
reference has the rows of docs/on-a-vehicle.md, with x north and y west.
"""

from __future__ import annotations

import math
import multiprocessing
import sys
import time
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from common import works
from pymavlink import mavutil

from auv_gym.effects.autopilot import LARGEST_TURN
from auv_gym.scenarios.presets import as_scenario
from auv_gym.scenarios.vehicles import vehicle_model_of
from auv_gym.task.model import PLANE
from baselines import make_policy
from baselines.evaluation.request import takes_setpoints
from baselines.export.parts import measurement_kernel

NO_RATES_NO_THRUST = 0b1000111  # entries of SET_ATTITUDE_TARGET that are ignored
CHANGE_SPEED, GROUND_SPEED = 178, 1.0  # MAV_CMD_DO_CHANGE_SPEED and its first parameter


class Node:
    """Turns measurements in north-east-down axes into commands, one for each control period."""

    def __init__(self, policy: str, vehicle: str, reference: np.ndarray, period: float) -> None:
        """Make the policy for a vehicle, and keep the rows of the reference, which are `period` [s] apart."""
        model: Any = vehicle_model_of(vehicle)
        self.policy, self.reference, self.period = make_policy(policy, vehicle), reference, period
        self.limits, self.fin = (model.actuators.F_u_max, model.actuators.F_r_max), model.actuators.fin
        self.setpoints = bool(takes_setpoints(policy))
        self.encode = measurement_kernel(PLANE, tuple(getattr(self.policy, "preview", ())), 1)
        self.memory, self.last, self.k = None, np.zeros(2), 0

    def command(self, position: Any, attitude: Any) -> np.ndarray:
        """Return the action for the newest messages."""
        now, psi = self.reference[self.k], attitude.yaw
        north, east = position.vx, position.vy
        u, v = north * math.cos(psi) + east * math.sin(psi), -(east * math.cos(psi) - north * math.sin(psi))
        measured = np.array([position.x, -position.y, -psi, u, v, -attitude.yawspeed])
        F_r_max = min(self.limits[1], max(self.fin * u * u, self.limits[1] / 64)) if self.fin else self.limits[1]
        rows: dict[str, Any] = {"measured": measured, "reference": now, "last": self.last}
        rows["setting"] = np.array([self.limits[0], F_r_max, self.period])
        if preview := getattr(self.policy, "preview", ()):
            rows["ahead"] = np.concatenate([self.reference[self.k + n][:2] - now[:2] for n in preview])
        seen = self.encode(**{name: np.asarray(row, dtype=float)[:, None] for name, row in rows.items()})["observation"]
        action, self.memory = self.policy.predict(seen[:, 0], self.memory, np.array([self.k == 0]))
        self.last, self.k = action.astype(float), self.k + 1
        return action

    def send(self, link: Any, action: np.ndarray) -> None:
        """Send the command of an action."""
        _, _, psi, u, *_ = self.reference[self.k - 1]
        if self.setpoints:
            heading = -(psi + LARGEST_TURN * float(action[1]))  # clockwise from north
            quaternion = [math.cos(heading / 2), 0.0, 0.0, math.sin(heading / 2)]
            speed = u * (1.0 + float(action[0]))
            link.mav.command_long_send(1, 1, CHANGE_SPEED, 0, GROUND_SPEED, speed, -1.0, 0, 0, 0, 0)
            link.mav.set_attitude_target_send(0, 1, 1, NO_RATES_NO_THRUST, quaternion, 0.0, 0.0, 0.0, 0.0)
        else:
            link.mav.manual_control_send(1, round(1000 * float(action[0])), 0, 500, round(-1000 * float(action[1])), 0)


def run(node: Node, address: str) -> None:
    """Answer messages until the reference ends."""
    link = mavutil.mavlink_connection(address, source_system=255)
    newest, answered = dict[str, Any](), None
    while node.k < len(node.reference) - max(getattr(node.policy, "preview", (0,)), default=0):
        message = link.recv_match(type=["LOCAL_POSITION_NED", "ATTITUDE"], blocking=True, timeout=30)
        if message is None:
            raise TimeoutError(f"no message at {address} for 30 s")
        if message.time_boot_ms == answered:  # sent again
            continue
        newest[message.get_type()] = message
        if len(newest) == 2:
            answered = message.time_boot_ms
            node.send(link, node.command(newest["LOCAL_POSITION_NED"], newest["ATTITUDE"]))
            newest = {}


def fly(name: str, policy: str, port: int, steps: int) -> float:
    """Run the node in another process against a vehicle of the environment; return its mean error after a third."""
    scenario = as_scenario(name)
    env: Any = gym.make("auv_gym:UnderactuatedAUVTrack-v0", scenario=scenario)
    env.reset(seed=0)
    plant, episode = env.unwrapped, []
    for _ in range(steps + 60):
        episode.append([*plant.reference])
        env.step(np.zeros(2, dtype=np.float32))
    np.savetxt("reference.csv", episode, delimiter=",")
    node = [sys.executable, __file__, policy, name.partition("@")[2], "reference.csv", f"udpin:127.0.0.1:{port}"]
    process = multiprocessing.Process(target=_node, args=(node[2:], scenario.control_dt), daemon=True)
    process.start()
    time.sleep(1.0)
    link = mavutil.mavlink_connection(f"udpout:127.0.0.1:{port}", source_system=1)
    env.reset(seed=0)
    errors = []
    for k in range(steps):
        x, y, psi, u, v, r = plant.state
        north, east = u * math.cos(psi) - v * math.sin(psi), -(u * math.sin(psi) + v * math.cos(psi))
        answer, now, speed = None, plant.reference, 0.0
        while answer is None:
            link.mav.local_position_ned_send(k, x, -y, 0.0, north, east, 0.0)
            link.mav.attitude_send(k, 0.0, 0.0, -psi, 0.0, 0.0, -r)
            answer = link.recv_match(blocking=True, timeout=1)  # the node may not listen yet
            if answer is not None and answer.get_type() == "COMMAND_LONG":
                speed, answer = answer.param2, link.recv_match(blocking=True, timeout=1)
        if answer.get_type() == "MANUAL_CONTROL":
            action = np.array([answer.x / 1000, -answer.r / 1000])
        else:
            heading = -2 * math.atan2(answer.q[3], answer.q[0])
            turn = (heading - now.psi + math.pi) % (2 * math.pi) - math.pi
            action = np.array([speed / now.u - 1, turn / LARGEST_TURN])
        info = env.step(action.astype(np.float32))[4]
        errors.append(info["position_error"])
    process.terminate()
    return float(np.mean(errors[steps // 3 :]))


def _node(words: list[str], period: float) -> None:
    policy, vehicle, file, address = words
    run(Node(policy, vehicle, np.loadtxt(file, delimiter=","), period), address)


if __name__ == "__main__":
    if len(sys.argv) > 4:
        _node(sys.argv[1:5], as_scenario(f"cruise-calm@{sys.argv[2]}").control_dt)
    else:
        both = {}
        for port, (suffix, policy) in enumerate((("-setpoints", "los-setpoints"), ("", "helm-any")), 14651):
            both[policy] = fly(f"cruise-calm{suffix}@lauv", policy, port, 150)
        assert max(both.values()) < 0.3, both
        errors = ", ".join(f"{policy} {error:.2g} m" for policy, error in both.items())
        works(f"a node with pymavlink steers a fake vehicle by setpoints and by forces: {errors}")
        Path("reference.csv").unlink()

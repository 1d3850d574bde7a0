"""`evaluate.py --stability`: where a policy is stable, how slow its computer may be, from where it converges."""

from __future__ import annotations

import itertools
import math
import sys
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from auv_gym.physics.actuators import Actuators
from auv_gym.physics.vehicle import PAPER_VEHICLE
from auv_gym.scenarios.presets import PAPER_SCENARIO
from auv_gym.scenarios.scenario import Start
from auv_gym.task.policy import Policy, preview_of
from baselines.evaluation.report.terminal import console
from baselines.evaluation.rollout import PolicyError, rollout
from baselines.evaluation.runner import drawn
from baselines.evaluation.stability.analysis import linearise_policy
from baselines.evaluation.stability.certificate import BOXES, MISSING, certificates, installed
from baselines.evaluation.stability.page import stability_html
from baselines.evaluation.stability.sampled_loop import PRIVILEGED, Steady, steady_motion
from baselines.evaluation.stability.tables import DISTANCE, Stability, sheets, stability_map, terminal_table
from baselines.evaluation.stability.verdicts import verdicts
from baselines.policies import make_policy
from baselines.policy import Privileged
from baselines.tools.command_line import DONE, FAILED
from baselines.tools.figure_style import styled, to_png
from baselines.tools.files import json_text, write_atomically

SPEEDS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.75, 1.0, 1.5, 2.0)  # [m/s] path speeds of the map
TURN_RATES = (0.0, 0.1, 0.2, 0.3)  # [rad/s] turn rates of the map
CERTIFIED_SPEEDS = (0.1, 0.3, 1.0, 2.0)  # [m/s] path speeds of the certificates
EXAMINED_LIMITS: dict[str, tuple[float, float]] = {"without limits": (8192.0, 4096.0), "250 N, 120 N m": (250.0, 120.0)}
"""Limits of the actuators [N], [N m] that success is sampled with; none means the largest that can be set."""
STARTS = 200  # number of random starts
_STEPS = 2000  # control steps from each start
_SUBSTEPS = 10  # integration steps in each: a vehicle without limits can spin fast
_FINE = 1e-4  # relative width of the interval in which the limiting speed of a policy without memory is found
_COARSE = 1e-2  # the same of one with memory
_SETTLED = 0.05  # [m] position error below which a start has converged after `_STEPS`


def examine(name: str) -> Stability:
    """Return what is known of a policy.

    Raises:
        ValueError: the policy looks behind the observation.
        PolicyError: it gives no usable actions.
    """
    policy, dt = make_policy(name), PAPER_SCENARIO.control_dt
    if remembers(policy, dt):
        motions = [[steady_motion(PAPER_VEHICLE, policy, U, turn_rate) for turn_rate in TURN_RATES] for U in SPEEDS]
        periods = certified = None
    else:
        loops = [
            [linearise_policy(PAPER_VEHICLE, policy, U, turn_rate, dt) for turn_rate in TURN_RATES] for U in SPEEDS
        ]
        motions = [[Steady(float(loop.eigenvalues[0].real), 0.0, 0.0) for loop in row] for row in loops]
        periods = [[loop.largest_period() for loop in row] for row in loops]
        certified = certificates(PAPER_VEHICLE, policy, CERTIFIED_SPEEDS, BOXES, dt) if installed() else None
    return Stability(
        name,
        SPEEDS,
        TURN_RATES,
        [[motion.rate for motion in row] for row in motions],
        [[motion.swing for motion in row] for row in motions],
        periods,
        limits_of_speed(policy, [motion[0].held for motion in motions], periods is None),
        STARTS,
        {label: success(policy, limits, STARTS) for label, limits in EXAMINED_LIMITS.items()},
        certified,
    )


def remembers(policy: Policy, dt: float) -> bool:
    """Return whether a policy has a memory; dt is the control period that it is told [s].

    Raises:
        ValueError: the policy looks behind the observation.
    """
    if isinstance(policy, Privileged):
        raise ValueError(PRIVILEGED)
    if preview_of(policy):
        return True
    try:
        linearise_policy(PAPER_VEHICLE, policy, SPEEDS[0], 0.0, dt)
    except ValueError:
        return True
    return False


def limits_of_speed(policy: Policy, stable: Sequence[bool], memory: bool) -> list[float]:
    """Return the speeds [m/s] between which straight lines change between stable and unstable, ascending.

    Args:
        policy: the policy.
        stable: whether they are stable at `SPEEDS`.
        memory: whether the policy has one.
    """
    dt, found = PAPER_SCENARIO.control_dt, []

    def at(speed: float) -> bool:
        if memory:
            return steady_motion(PAPER_VEHICLE, policy, speed, 0.0).held
        return bool(linearise_policy(PAPER_VEHICLE, policy, speed, 0.0, dt).eigenvalues[0].real < 0)

    for (low, below), (high, above) in itertools.pairwise(zip(SPEEDS, stable, strict=True)):
        if below == above:
            continue
        a, b = low, high
        while b - a > (_COARSE if memory else _FINE) * b:
            middle = 0.5 * (a + b)
            a, b = (middle, b) if at(middle) == below else (a, middle)
        found.append(0.5 * (a + b))
    return found


def success(policy: Policy, limits: tuple[float, float], starts: int) -> float:
    """Return the share of random starts from which a policy converges to the paper's circle within 200 s.

    Evidence, no proof: starts lie up to `DISTANCE` off on each axis, with any heading, at the reference's speed.
    """
    offset = (-DISTANCE, DISTANCE)
    scenario = replace(
        PAPER_SCENARIO,
        name="random-starts",
        actuators=Actuators(*limits),
        start=Start(x_e=offset, y_e=offset, psi_e=(-math.pi, math.pi)),
        steps=_STEPS,
        substeps=_SUBSTEPS,
        lost_distance=64.0,
    )
    result = rollout(policy, scenario, drawn(scenario, starts, 0).episodes, math.inf)
    return float(np.mean(result.errors[-1] < _SETTLED))


def report(names: Sequence[str], out: Path, command: str) -> int:
    """Examine policies, print what is found, write stability.json, .png and .html, and return the exit status."""
    found, screen = [], console()
    if not installed():
        print(f"note: {MISSING}", file=sys.stderr)
    for name in names:
        try:
            found.append(examine(name))
        except (ValueError, RuntimeError, PolicyError) as error:
            print(f"{name}: {error}", file=sys.stderr)
            continue
        for sentence in verdicts(found[-1]):
            screen.print(f"- {name}: {sentence}", soft_wrap=True, markup=False)
        for sheet in sheets(found[-1]):
            screen.print(terminal_table(sheet))
    if not found:
        return FAILED
    with styled():
        png = to_png(stability_map(found))
    write_atomically(out / "stability.json", json_text([asdict(s) for s in found]))
    write_atomically(out / "stability.png", png)
    write_atomically(out / "stability.html", stability_html(found, command))
    screen.print(f"Wrote stability.html, stability.json and stability.png to {out}", soft_wrap=True)
    return DONE if len(found) == len(names) else FAILED

"""Filters of agents in space: in level motion those of the plane, equal in both planes, better than the fixes."""

from dataclasses import replace

import numpy as np
import pytest

from auv_gym.codegen.graph import SYMBOLS
from auv_gym.codegen.kernel import Kernel
from auv_gym.envs.space import UnderactuatedAUVTrack3DVectorEnv
from auv_gym.physics.namespaces import ARRAYS, FLOATS
from auv_gym.scenarios.presets import SPACE_PRESETS, TYPICAL_NOISE
from auv_gym.scenarios.vehicles import PAPER
from auv_gym.task.observation import Observation as PlanarObservation
from auv_gym.task.space import SPACE, Observation, in_world
from baselines.agents import filters, space_filters
from baselines.agents.filters import ACROSS
from baselines.agents.space_filters import FILTERS, MEMORY_ENTRIES, ROWS, UPRIGHT
from baselines.policies import make_policy

SPEED, DT = 1.0, 0.1
ROW = PAPER.in_space.all_coefficients
STILL = replace(PAPER.in_space, stiffness=0.0).all_coefficients
"""A body whose vertical plane is as its horizontal one."""


def straight(e, theta, psi, velocities, rates, actions):
    """Return an observation of a vehicle near a straight level line, with measured errors."""
    terms = (*e, theta, psi, *velocities, *rates, 0, SPEED, 0, 0, 0, 0, 70.0, 0, 0)
    angles = np.cos(theta), np.sin(theta), np.cos(psi), np.sin(psi)
    return Observation(*(float(x) for x in (*terms, *angles, 20.0, 400.0, 200.0, 200.0, *actions, DT)))


def moving(memory, before, entries):
    """Return the memory with the surge force of the line: a start from rest would count as noise of the velocity."""
    for k in range(before, len(memory), len(entries)):
        memory = [*memory[: k + entries.index("F_u")], 70.0, *memory[k + entries.index("F_u") + 1 :]]
    return memory


def filtered(observations, row=ROW):
    """Return the last estimates of both filters, by entry."""
    memory = [0.0] * ROWS
    for k, o in enumerate(observations):
        output, memory = space_filters.filter_step(o, SPEED, memory, FLOATS, row)
        memory = memory if k else moving(memory, space_filters.CONSTANT, MEMORY_ENTRIES)
    return [z._asdict() for z in output.estimates]


def test_in_level_motion_they_are_those_of_the_plane():
    """After the settling time of the second filter, with the surge force of the line."""
    rng, memory, seen = np.random.default_rng(0), [0.0] * filters.ROWS, []
    for k in range(70):
        x, y, psi, u, v, r = 1e-4 * rng.standard_normal(6)
        a_r = 1e-3 * rng.standard_normal()
        seen.append(straight((x, y, 0), 0, psi, (u, v, 0), (0, r), (0.175, 0, a_r)))
        terms = (x, y, psi, u, v, r, SPEED, 0, 0, 70.0, 0, np.cos(psi), np.sin(psi), 400.0, 200.0, 0.175, a_r, DT)
        o = PlanarObservation(*(float(x) for x in terms))
        output, memory = filters.filter_step(o, SPEED, memory, FLOATS)
        memory = memory if k else moving(memory, filters.SHARED, filters.MEMORY_ENTRIES)
    for found, plane in zip(filtered(seen), output.estimates, strict=False):
        for name, value in plane._asdict().items():
            assert found[name] == pytest.approx(value, rel=1e-6, abs=1e-9), name
        for name in UPRIGHT:
            assert found[name] == pytest.approx(0, abs=1e-12)


def test_both_planes_have_the_same_filters():
    """What is measured aside and above exchanges the estimates, up to the signs of pitch and what turns with it."""
    rng = np.random.default_rng(1)
    level, steep = [], []
    for _ in range(60):
        x, y, psi, u, v, r, a = 1e-4 * rng.standard_normal(7)
        level.append(straight((x, y, 0), 0, psi, (u, v, 0), (0, r), (0.2, 0, a)))
        steep.append(straight((x, 0, y), -psi, 0, (u, 0, v), (-r, 0), (0.2, -a, 0)))
    for one, other in zip(filtered(level, STILL), filtered(steep, STILL), strict=True):
        for across, up in zip(ACROSS, UPRIGHT, strict=True):
            sign = -1 if up in ("theta", "q", "F_q", "M", "M_wave", "M_swing") else 1
            assert sign * other[up] == pytest.approx(one[across], rel=1e-3, abs=1e-8), up


def test_an_old_fix_does_not_count():
    """The depth is measured all the same."""
    held, memory = [], [0.0] * ROWS
    for k in range(6):
        stale = -DT * SPEED if k == 4 else 0.0
        o = straight((stale, 0, 1e-3 * (-1) ** k), 0, 0, (0, 0, 0), (0, 0), (0.175, 0, 0))
        output, memory = space_filters.filter_step(o, SPEED, memory, FLOATS, ROW)
        held.append(output.held)
    assert held == [0, 0, 0, 0, 1, 0]


def test_estimates_are_better_than_measurements_and_levels_are_those_of_the_sensors():
    """In a storm; the second filter in calm water with noise."""
    row = {"o": len(Observation._fields), "memory": ROWS}

    def equation(o, memory):
        output, after = space_filters.filter_step(Observation(*o), SPEED, memory, SYMBOLS, ROW)
        entries = [getattr(z, name) for z in output.estimates for name in MEMORY_ENTRIES[:3]]
        return {"place": entries, "levels": [*output.levels], "after": after}

    step = Kernel.traced(equation, row, blocked=True)
    for case, kind in (("storm", 0), ("noise", 1)):
        scenario, n = SPACE_PRESETS[f"space-{case}"], 8
        noisy = replace(scenario.vertical, depth_noise=0.02)
        scenario = replace(scenario, sensors=TYPICAL_NOISE["cruise"], vertical=noisy)
        env, law = UnderactuatedAUVTrack3DVectorEnv(n, scenario), make_policy("lqi", scenario.known)
        rows, memory, errors, levels = env.reset(seed=0)[0], np.zeros((ROWS, n)), [], []
        state = None
        for _ in range(300):
            o = np.array(SPACE.layout.decode(rows.T.astype(float), ARRAYS))
            results = step(o=o, memory=memory)
            memory = results["after"]
            R, seen = env.reference, in_world(o[:3], Observation(*o))
            true = np.array(env.pose).T[[0, 1, 3]] - (R.x, R.y, R.z)
            place = results["place"].reshape(FILTERS, 3, n)[kind]
            errors.append([np.square(place - true).sum(axis=0), np.square(np.array(seen) - true).sum(axis=0)])
            levels.append(results["levels"])
            action, state = law.predict(rows, state)
            rows, *_ = env.step(action)
        own, measured = np.sqrt(np.mean(errors[100:], axis=(0, 2)))
        assert own < (0.75 if case == "storm" else 0.3) * measured
        found = np.sqrt(np.mean(levels[100:], axis=(0, 2)))
        if case == "storm":
            np.testing.assert_allclose(found, [1.0, 0.4, 1.0, 1.0], rtol=0.2)

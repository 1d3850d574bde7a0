"""The inputs of a trained policy: one copy for NumPy and torch, what each is, and what it remembers."""

import math

import numpy as np
import pytest

from auv_gym.physics.namespaces import ARRAYS
from auv_gym.task.observation import Observation
from baselines.agents.features import FAST, FEATURES, INTEGRALS, LARGEST_FEATURE, SLOW, Inputs

NAMES = [feature.name for feature in FEATURES]


def observation(**changes):
    """A vehicle heading along the world's x, one metre ahead of its reference at 2 m/s."""
    terms = dict.fromkeys(Observation._fields, 0.0)
    terms |= {"e_x": 1.0, "u_R": 2.0, "cos_psi": 1.0, "F_u_max": 400.0, "F_r_max": 200.0, "dt": 0.1}
    return [np.array([value]) for value in (terms | changes).values()]


def features(o, integrals=None, base=(0.0, 0.0), correction=(0.0, 0.0)):
    sums = np.zeros((INTEGRALS, 1)) if integrals is None else integrals
    rows, sums = Inputs().update(o, (), np.reshape(base, (2, 1)), np.reshape(correction, (2, 1)), sums, ARRAYS)
    return dict(zip(NAMES, np.array(rows)[:, 0].tolist(), strict=True)), sums


def test_scales_are_those_of_the_table():
    got, _ = features(
        observation(psi_e=0.1, u_e=0.2, v_R=0.0, F_uR=100.0, F_rR=-20.0, r_e=0.05, a_u=0.3),
        base=(0.5, -0.25),
        correction=(0.1, 0.2),
    )
    wanted = {"e_x": 0.5, "psi_e": 0.2, "u_e": 0.2, "r_e": 0.4, "u_R": 2.0, "F_uR": 0.25, "F_rR": -0.1}
    wanted |= {"base_u": 0.5, "base_r": -0.25, "c_u": 0.1, "c_r": 0.2, "a_u": 0.3, "F_u_max": 1.5625, "dt": 0.8}
    assert {name: got[name] for name in wanted} == pytest.approx(wanted)
    far, _ = features(observation(e_x=-1e6, e_y=1e6, u_R=0.0))
    assert (far["e_x"], far["e_y"]) == (-LARGEST_FEATURE, LARGEST_FEATURE)


@pytest.mark.parametrize(("name", "rate", "scale"), [("fast_x", FAST, 4.0), ("slow_x", SLOW, 10.0)])
def test_integral_of_a_constant_error(name, rate, scale):
    sums = None
    for _ in range(400):
        got, sums = features(observation(), sums)
    exact = 0.5 * (1 - math.exp(-rate * 40.0)) / rate / scale
    assert got[name] == pytest.approx(exact, rel=0.01)
    assert got[name.replace("x", "y")] == 0.0


def test_integrals_do_not_rotate_with_the_vehicle():
    _, sums = features(observation())
    ahead, _ = features(observation(e_x=0.0), sums)
    aside, _ = features(observation(e_x=0.0, cos_psi=0.0, sin_psi=1.0), sums)  # heading along the world's y
    assert aside["fast_y"] == pytest.approx(-ahead["fast_x"])
    assert aside["slow_y"] == pytest.approx(-ahead["slow_x"])
    assert aside["fast_x"] == aside["slow_x"] == 0.0


def test_same_motion_at_another_speed_has_the_same_features():
    slow, _ = features(observation(e_x=0.1, e_y=-0.05, u_R=0.2, u_e=0.02))
    fast, _ = features(observation(e_x=1.0, e_y=-0.5, u_R=2.0, u_e=0.2))
    same = [name for name in NAMES if name != "u_R"]
    assert {n: slow[n] for n in same} == pytest.approx({n: fast[n] for n in same})


def test_preview_features_on_a_circle():
    """On a circle the way ahead is a chord: along it by the cosine, and aside by the sine, of half the turn."""
    inputs, speed, rate = Inputs((2, 10)), 2.0, 0.3
    turn = rate * 0.1 * np.array(inputs.preview)
    chord = 2 * speed / rate * np.sin(turn / 2)
    ahead = np.ravel([(c * np.cos(a / 2), c * np.sin(a / 2)) for c, a in zip(chord, turn, strict=True)])
    rows, _ = inputs.update(observation(), list(ahead), (0.0, 0.0), (0.0, 0.0), np.zeros((INTEGRALS, 1)), ARRAYS)
    got = dict(zip([f.name for f in inputs.features], [float(np.ravel(row)[0]) for row in rows], strict=True))
    assert got["ahead_10_y"] == pytest.approx(4 * (1 - np.cos(turn[1])) / turn[1])
    assert got["ahead_2_x"] == pytest.approx(4 * (np.sin(turn[0]) / turn[0] - 1))
    assert len(rows) == len(inputs.features) == len(FEATURES) + 4


def test_without_integrals_only_their_features_are_missing():
    names = [f.name for f in Inputs(integrals=False).features]
    assert names == [f.name for f in FEATURES if not f.name.startswith(("fast", "slow"))]
    sums = np.ones((INTEGRALS, 1))
    full, bare = (
        Inputs(integrals=kept).update(observation(e_y=0.3), (), (0.1, 0.2), (0.3, 0.4), sums, ARRAYS)
        for kept in (True, False)
    )
    kept = [float(np.ravel(x)[0]) for f, x in zip(FEATURES, full[0], strict=True) if f.name in names]
    assert [float(np.ravel(x)[0]) for x in bare[0]] == kept
    np.testing.assert_array_equal(full[1], bare[1])


@pytest.mark.parametrize("entries", [{"preview": (5, 3)}, {"preview": (0,)}, {"integrals": 1}])
def test_wrong_inputs_are_rejected(entries):
    with pytest.raises(ValueError, match=f"{next(iter(entries))} is"):
        Inputs(**entries)

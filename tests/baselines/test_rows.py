"""Nested named tuples to and from rows: every number has one place, and its name finds it."""

from typing import NamedTuple

import numpy as np

from auv_gym.physics.rows import flatten, numbered, unflatten
from auv_gym.scenarios.presets import PRESETS
from auv_gym.task.simulation import (
    CURRENT,
    LOAD,
    NOISE,
    PARAMETER_ROWS,
    PARAMETERS,
    PLANT,
    PLANT_ROWS,
    REFERENCE,
    SAMPLE,
    SAMPLE_ROWS,
    Parameters,
    Parts,
    Sample,
)


class Inner(NamedTuple):
    b: float
    c: float


class Outer(NamedTuple):
    a: float
    inner: Inner
    d: float
    kind: str = "no number"


def test_rows_and_names_are_the_same_numbers():
    places = numbered(Outer)
    assert places == Outer(0, Inner(1, 2), 3)
    tree = unflatten(places, (10.0, 11.0, 12.0, 13.0))
    assert tree == Outer(10.0, Inner(11.0, 12.0), 13.0)
    assert flatten(tree) == (10.0, 11.0, 12.0, 13.0)


def test_every_row_of_the_simulation_has_one_name():
    for places, n in ((PLANT, PLANT_ROWS), (SAMPLE, SAMPLE_ROWS), (PARAMETERS, PARAMETER_ROWS)):
        assert flatten(places) == tuple(range(n))
        assert flatten(unflatten(places, range(n))) == tuple(range(n))


def test_parts_of_a_sample_are_found_by_name():
    assert Sample._fields[REFERENCE] == ("x_R", "y_R", "psi_R", "u_R", "v_R", "r_R", "F_uR", "F_rR")
    assert Sample._fields[CURRENT] == ("V_x", "V_y")
    assert Sample._fields[LOAD] == ("X", "Y", "N")
    assert Sample._fields[NOISE] == ("n_x", "n_y", "n_psi", "n_u", "n_v", "n_r")


def test_constants_of_an_episode_survive_their_row():
    scenario = PRESETS["cruise-storm"]
    p = scenario.parameters(scenario.draw(np.random.default_rng(0)))
    assert Parameters.of(flatten(p), p.parts) == p
    assert (p.error_scale, p.lost_distance, p.h) == (scenario.error_scale, scenario.lost_distance, 0.1)


def test_joined_parts_are_those_of_both():
    both = Parts(2, filtered=True).joined(Parts(2, sheared=True))
    assert both == Parts(2, filtered=True, sheared=True)

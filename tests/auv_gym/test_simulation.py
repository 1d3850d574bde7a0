"""One control step in literal numbers: reward, measurements, saturation and limits of the actuators."""

import math

import numpy as np
import pytest

from auv_gym.effects.actuators import Reach
from auv_gym.physics.namespaces import ARRAYS, FLOATS
from auv_gym.physics.vehicle import PAPER_VEHICLE
from auv_gym.scenarios.scenario import Scenario
from auv_gym.task.observation import ERROR_TERMS, Observation
from auv_gym.task.simulation import Parts, Plant, Sample, start, step

IMMEDIATE = (1.0, 1.0, math.inf, math.inf)
CONSTANTS = (
    Scenario()
    .parameters(Scenario().draw(np.random.default_rng(0)))
    ._replace(
        h=0.1,
        coefficients=PAPER_VEHICLE.coefficients,
        F_u_max=400.0,
        F_r_max=200.0,
        response=IMMEDIATE,
        error_scale=0.5,
        rate_weight=0.05,
        lost_distance=30.0,
        thrust_u=400.0,
        thrust_r=200.0,
        parts=Parts(),
    )
)
STILL = Sample(*(0.0,) * 19)


def first_plant(p=CONSTANTS, sample=STILL, state=(0.0,) * 6):
    return start(state, sample, p, FLOATS)[0]


@pytest.mark.parametrize(
    ("before", "now", "cost"),
    [
        ((0.5, 0.0), (0.5, 0.0), 0.0),
        ((0.5, 0.0), (0.2, 0.0), 0.05 * 0.09),
        ((-0.5, 0.0), (0.2, 0.0), 0.05 * 0.49),
        ((0.0, 0.4), (0.0, -0.4), 0.05 * 0.64),
        ((0.3, -0.2), (-0.1, 0.1), 0.05 * (0.16 + 0.09)),
    ],
)
def test_reward_of_a_step(before, now, cost):
    """The reference is set so that the position error is (0.3, 0.4) m: 0.5 m, which is the error scale."""
    plant = first_plant()._replace(a_u=before[0], a_r=before[1])
    weak = CONSTANTS._replace(thrust_u=0.0, thrust_r=0.0)
    _, _, (reward, failed, squared_error, _) = step(plant, now, STILL._replace(x_R=0.3, y_R=-0.4), weak, FLOATS)
    assert squared_error == pytest.approx(0.25, abs=1e-15)
    assert reward == pytest.approx(1 / math.sqrt(2) - cost, abs=1e-15)
    assert failed is False


def test_measurement_errors_are_added():
    noisy = STILL._replace(n_x=0.1, n_y=-0.2, n_psi=0.0, n_u=0.3, n_v=-0.4, n_r=0.05, x_R=1.0, y_R=2.0, r_R=0.01)
    _, terms = start((1.0, 2.0, 0.0, 0.7, 0.02, 0.03), noisy._replace(u_R=0.5), CONSTANTS, FLOATS)
    o = Observation(*terms)
    assert o[:ERROR_TERMS] == pytest.approx(
        (0.1, -0.2, 0.0, 0.7 + 0.3 - 0.5, 0.02 - 0.4, 0.03 + 0.05 - 0.01), abs=1e-15
    )
    _, terms = start((0.0,) * 6, STILL._replace(n_psi=0.25), CONSTANTS, FLOATS)
    o = Observation(*terms)
    assert (o.psi_e, o.cos_psi, o.sin_psi) == pytest.approx((0.25, math.cos(0.25), math.sin(0.25)), abs=1e-15)


def test_velocities_are_measured_over_ground():
    _, terms = start((0.0, 0.0, math.pi / 2, 1.0, 0.0, 0.0), STILL._replace(V_x=0.3, V_y=0.2), CONSTANTS, FLOATS)
    o = Observation(*terms)
    assert (o.u_e, o.v_e) == pytest.approx((1.2, -0.3), abs=1e-15)


@pytest.mark.parametrize(
    ("action", "saturated"),
    [
        ((1.0, 0.0), True),
        ((-1.0, 0.0), True),
        ((0.0, 1.0), True),
        ((0.0, -1.0), True),
        ((0.0, -7.0), True),
        ((0.999, -0.999), False),
    ],
)
def test_saturation_on_both_sides_of_each_actuator(action, saturated):
    assert step(first_plant(), action, STILL, CONSTANTS, FLOATS)[2][3] is saturated
    rows = tuple(np.array([a]) for a in action)
    sample = [np.array([s]) for s in STILL]
    plant, _ = start((np.zeros(1),) * 6, sample, CONSTANTS, ARRAYS)
    assert step(plant, rows, sample, CONSTANTS, ARRAYS)[2][3].tolist() == [saturated]


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_each_actuator_has_its_own_limit_and_saturation_level(sign):
    weak = CONSTANTS._replace(thrust_u=300.0, thrust_r=100.0, own=(0.5, 0.25), parts=Parts(effects=(Reach,)))
    plant, terms, _ = step(first_plant(), (sign, sign), STILL, weak, FLOATS)
    assert (plant.F_u, plant.F_r) == pytest.approx((sign * 150.0, sign * 25.0))
    assert (plant.a_u, plant.a_r) == (sign, sign)  # the observation has the commands and nominal limits
    assert (Observation(*terms).F_u_max, Observation(*terms).F_r_max) == (400.0, 200.0)


def test_states_that_are_not_numbers_are_failures():
    nan = first_plant()._replace(x=math.nan)
    assert step(nan, (0.0, 0.0), STILL, CONSTANTS, FLOATS)[2][1] is True
    everything = Plant(*(math.nan,) * 10, memory=nan.memory)
    assert step(everything, (0.0, 0.0), STILL, CONSTANTS, FLOATS)[2][1] is True
    rows = Plant(*(np.array([math.nan, 0.0]) for _ in range(10)), memory=nan.memory)
    sample = [np.full(2, s) for s in STILL]
    assert step(rows, (np.zeros(2), np.zeros(2)), sample, CONSTANTS, ARRAYS)[2][1].tolist() == [True, False]

"""Units of vehicles: those of the paper have factors of one, and similar vehicles have the same commands."""

import inspect
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from similar_vehicles import similar_vehicle, twin

from auv_gym import PRESETS
from auv_gym.envs.track_vector_env import UnderactuatedAUVTrackVectorEnv
from auv_gym.physics.units import DIMENSIONS, POWERS, Units, in_paper_units
from auv_gym.physics.vehicle import PAPER_VEHICLE, Coefficients, CrossTerms
from auv_gym.scenarios.fitting import changed
from auv_gym.scenarios.vehicles import PAPER, vehicle_model, vehicle_names
from auv_gym.task.observation import TERMS
from auv_gym.task.policy import preview_of, traceable
from baselines import make_policy
from baselines.control.backstepping import Backstepping
from baselines.scaling import ScaledLaw, ScaledPolicy

FACTORS = st.floats(-2, 2).map(lambda x: 10**x)


def test_units_of_the_coefficients_are_those_of_the_comments():
    source = inspect.getsource(Coefficients) + inspect.getsource(CrossTerms)
    stated = dict(re.findall(r"^    (\w+): Number  # \[(.+?)\]", source, re.MULTILINE))
    assert stated == DIMENSIONS


def test_the_vehicle_of_the_paper_has_factors_of_one():
    assert Units.of(PAPER_VEHICLE) == Units.of(replace(PAPER_VEHICLE, m22=400.0, Y_vv=7.0)) == Units()
    assert in_paper_units(PAPER_VEHICLE) is PAPER_VEHICLE
    assert PAPER.in_paper_units is PAPER


def test_a_vehicle_model_in_the_units_of_the_paper():
    own = twin(Units(2.0, 3.0, 5.0)).in_paper_units
    assert (own.actuators.F_u_max, own.actuators.F_r_max) == (pytest.approx(400.0), pytest.approx(200.0))
    assert (own.turn_rate, own.lag, own.vehicle.speed) == (pytest.approx(0.12), pytest.approx(0.2), 1.5)


@pytest.mark.parametrize("name", vehicle_names())
def test_vehicles_in_the_units_of_the_paper_have_the_same_ratios(name):
    mine, similar = vehicle_model(name).vehicle, in_paper_units(vehicle_model(name).vehicle)
    assert Units.of(similar) == Units()
    assert similar.m22 / similar.m11 == pytest.approx(mine.m22 / mine.m11)
    for v in (similar, mine):
        drag = v.d22 * v.time / v.m22, v.Y_vv * v.speed * v.time / v.m22, v.N_rr / v.m33, v.N_ur * v.length / v.m33
        lift = v.Y_uv * v.length / v.m22, v.Y_ur / v.m11, v.N_uv / v.m11
        if v is similar:
            found = drag + lift
    assert found == pytest.approx(drag + lift)


@settings(max_examples=30, deadline=None)
@given(FACTORS, FACTORS, FACTORS)
def test_the_papers_vehicle_in_any_units_is_the_papers_in_its_own(length, speed, mass):
    own = in_paper_units(similar_vehicle(Units(length, length / min(max(speed, 0.01), 10.0), mass)))
    assert own.coefficients == pytest.approx(PAPER_VEHICLE.coefficients, rel=1e-12)
    assert (own.m11, own.m33, own.speed) == (215.0, 80.0, 1.5)


def test_cross_flow_keeps_its_ratios_in_other_units():
    units = Units(2.0, 3.0, 5.0)
    own = {"Y_vv": 1.0, "N_rr": 1.0} | dict.fromkeys(CrossTerms._fields, 0.1)
    scaled = {name: x * units.factor(*POWERS[DIMENSIONS[name]]) for name, x in own.items()}
    vehicle = replace(similar_vehicle(units), **scaled)
    assert in_paper_units(vehicle).cross_terms == pytest.approx((0.1,) * 12)


def run(policy, scenario, steps=40):
    """Return the first commands in four episodes, shape (steps, 4, 2)."""
    env = UnderactuatedAUVTrackVectorEnv(4, scenario, preview=preview_of(policy))
    observation, _ = env.reset(seed=3)
    memory, first, found = None, np.ones(4, dtype=bool), []
    for _ in range(steps):
        action, memory = policy.predict(observation, memory, first)
        observation, *_ = env.step(action)
        found.append(action)
        first = np.zeros(4, dtype=bool)
    return np.array(found)


UNITS = Units(2.0, 3.0, 5.0)


@pytest.mark.parametrize(
    "name", ["backstepping", "integral-normalised", "lqi", "ekf", "nmpc", "helm"]
)  # fmt: skip
def test_similar_vehicles_have_the_same_commands(name):
    storm = PRESETS["cruise-storm"]
    other = changed(storm, twin(UNITS))
    policy = make_policy(name, vehicle=other.vehicle)
    assert isinstance(policy, ScaledLaw if name == "backstepping" else ScaledPolicy)
    np.testing.assert_allclose(run(policy, other), run(make_policy(name, vehicle=storm.vehicle), storm), atol=1e-5)


@settings(max_examples=3, deadline=None)
@given(st.floats(0.3, 3.0), st.floats(0.5, 2.0), FACTORS)
@example(3.0, 0.5, 1.0)
def test_similar_vehicles_of_any_size_have_the_same_commands(length, speed, mass):
    other = changed(PRESETS["cruise-storm"], twin(Units(length, length / speed, mass)))
    other = replace(other, control_dt=0.1 * length / speed)  # since `adapted` rounds it
    same_steps = replace(PRESETS["cruise-storm"], substeps=other.substeps)  # slow vehicles have a long control period
    known = run(make_policy("los-pid"), same_steps, steps=20)
    np.testing.assert_allclose(run(make_policy("los-pid", vehicle=other.vehicle), other, steps=20), known, atol=1e-5)


def test_a_law_for_another_vehicle_is_a_law_with_its_forces_in_si_units():
    law, o = make_policy("backstepping", vehicle=similar_vehicle(UNITS)), np.random.default_rng(0).uniform(0.1, 1.0, 18)
    scaled = [x * UNITS.factor(*POWERS[term.unit]) for x, term in zip(o, TERMS, strict=True)]
    forces = Backstepping().forces(o.tolist())
    assert law.forces(scaled) == pytest.approx(
        (forces[0] * UNITS.factor(*POWERS["N"]), forces[1] * UNITS.factor(*POWERS["N m"]))
    )
    assert traceable(law)


@pytest.mark.parametrize("vehicle", [None, "paper", PAPER_VEHICLE, replace(PAPER_VEHICLE, d22=150.0)], ids=str)
@pytest.mark.parametrize("name", ["backstepping", "ekf", "helm"])
def test_no_policy_is_wrapped_for_mass_length_and_speed_of_the_paper(name, vehicle):
    assert not isinstance(make_policy(name, vehicle=vehicle), (ScaledPolicy, ScaledLaw))


@pytest.mark.parametrize("name", ["oracle", "clairvoyant"])
def test_privileged_policies_are_not_wrapped(name):
    assert not isinstance(make_policy(name, vehicle="otter"), ScaledPolicy)


def test_an_agent_of_a_speed_range_warns_of_speeds_in_si_units():
    policy = make_policy("ppo-slow", vehicle="otter")
    with pytest.warns(UserWarning, match=r"trained at reference speeds of 0 to 0.27 m/s") as caught:
        run(policy, changed(PRESETS["cruise-calm"], "otter"), steps=2)
    assert len(caught) == 1


def test_a_vehicle_with_extreme_ratios_is_refused():
    with pytest.raises(ValueError, match="in units of its own mass, length and speed the vehicle is out of bounds"):
        make_policy("los-pid", vehicle=replace(PAPER_VEHICLE, m11=1e-8, m33=1e-8, m22=1e8))

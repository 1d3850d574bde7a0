"""Gains that follow the vehicle: stable on published and random vehicles, compared with searches, and on the page."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from auv_gym.physics.namespaces import ARRAYS
from auv_gym.physics.units import POWERS, Units
from auv_gym.physics.vehicle import Vehicle
from auv_gym.scenarios.vehicles import PAPER, vehicle_model, vehicle_names
from baselines import make_policy
from baselines.tuning.objective import TUNABLES, TuningEpisodes, tuning_scenarios
from baselines.tuning.search import TUNING_SEED
from research.paper.stability import loop_eigenvalues
from research.vehicles import exponents, gains

SLIP = 0.25  # [rad] largest sideslip in the turns of random vehicles


@pytest.mark.parametrize("name", vehicle_names())
def test_expert_and_normalised_law_are_stable_on_published_vehicles(name):
    assert gains.worst_growth(vehicle_model(name)) < 0
    assert gains.worst_growth(vehicle_model(name), "backstepping-normalised") < 0


SIZES = st.floats(-1.5, 1.5).map(lambda x: 10**x)


def between(low, high):
    return st.floats(np.log(low), np.log(high)).map(lambda x: float(np.exp(x)))


@settings(max_examples=25, deadline=None)
@given(between(1.06, 2.4), between(0.2, 6.0), between(0.1, 7.0), between(0.25, 6.0), SIZES, SIZES)
def test_expert_is_stable_on_random_vehicles_of_any_size(ratio, surge, sway, yaw, length, mass):
    """Drag: 0.1 to 7 times that of the paper, in the units of the vehicle; turns have 14 degrees of sideslip."""
    units = Units(length, length, mass)  # as fast as the paper's vehicle
    m22 = 215.0 * ratio
    own = (215.0, m22, 80.0, 70.0 * surge, m22 / 265.0 * 100.0 * sway, 50.0 * yaw)
    dims = ("kg", "kg", "kg m^2", "kg/s", "kg/s", "kg m^2/s")
    vehicle = Vehicle(*(x * units.factor(*POWERS[d]) for x, d in zip(own, dims, strict=True)))
    law = make_policy("backstepping", vehicle=vehicle)
    for U in (0.1, 0.39, 0.41, 1.5):
        turn_rate = min(0.14 if U < 0.4 else 0.21, SLIP * own[4] / 215.0)
        for w in (0.0, turn_rate / units.time):
            assert loop_eigenvalues(vehicle, lambda o: law.forces(o, ARRAYS), U, w)[0].real < 0


def test_a_course_of_another_vehicle_is_in_the_papers_units():
    otter, law = vehicle_model("otter"), TUNABLES["los-pid"]
    plain, own = tuning_scenarios("cruise", "plain"), tuning_scenarios("cruise", "plain", otter)
    assert [s.name for s in own] == [s.name for s in plain]
    assert {(s.vehicle.speed, s.control_dt) for s in own} == {(1.5, 0.1)}
    assert len({s.substeps for s in own}) == 1
    policy = law.factory(gains.load_gains("los-pid", "cruise", law.names), vehicle=otter.in_paper_units.vehicle)
    episodes = TuningEpisodes("cruise", 8, TUNING_SEED, vehicle_model=otter)
    steady_rmses, failed, commands = episodes.steady_rmses(policy)
    assert steady_rmses.shape == failed.shape == commands.shape[1:2] == (8,)
    assert np.median(steady_rmses) < 0.2


@pytest.mark.slow
def test_an_agent_is_compared_with_predictive_control_with_both_gains():
    """If the searched gains are those from the parameters, both rows of predictive control are the same."""
    own = vehicle_model("otter").in_paper_units
    _, same = gains.from_parameters("nmpc", own)
    row = gains.beside(own, same, 8)
    steady_rmses = row["steady_rmses"]
    assert steady_rmses["parameters"] == steady_rmses["searched"] != steady_rmses["helm-any"]
    assert [len(errors) for errors in steady_rmses["helm-any"].values()] == [1] * 8
    says, rows = gains.agent_comparison({"otter": row}, {("otter", "nmpc"): {"budget": [60, 16]}})
    assert "Over all 1 vehicles" in says
    mine, theirs = (np.concatenate(list(steady_rmses[side].values())) for side in ("helm-any", "parameters"))
    assert rows.splitlines()[-1].count(f" {np.exp(np.log(mine / theirs).mean()):.2f} (") == 2


def test_for_the_papers_vehicle_nothing_is_adapted():
    for name in (*gains.SEARCHED, "nmpc"):
        plain, adapted = gains.from_parameters(name, PAPER)
        assert plain == adapted


class Quadratic:
    """Vehicles whose loss is a quadratic function of the changes of the gains, least at given exponents."""

    def __init__(self, seed, exponents):
        self.ratios = np.random.default_rng(seed).uniform(-1.0, 1.0, (64, len(exponents)))
        self.best = self.ratios @ exponents

    def losses(self, tunable, start, changes):
        assert list(start) == list(tunable.names)
        return np.square(changes - self.best).sum(axis=1)


def test_the_fit_finds_the_exponents_of_a_known_optimum(monkeypatch):
    monkeypatch.setattr(exponents, "_DECAY", 0.0)
    best = np.random.default_rng(1).uniform(-0.5, 0.5, (12, len(TUNABLES["los-pid"].names)))
    found = exponents.fitted_exponents("los-pid", 200, [Quadratic(seed, best) for seed in range(3)])
    assert np.abs(found.T - best).max() < 0.1

"""Vehicle models to train on: their ranges, their scenarios, and the inputs of networks and experts from them."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from marks import slow_except
from window_by_torch import group_of

from auv_gym.envs.track_vector_env import UnderactuatedAUVTrackVectorEnv
from auv_gym.physics.namespaces import ARRAYS
from auv_gym.physics.units import Units
from auv_gym.physics.vehicle import PAPER_VEHICLE, Coefficients, Vehicle
from auv_gym.scenarios import vehicles as vehicle_names
from auv_gym.scenarios.fitting import changed, in_vehicle_units
from auv_gym.scenarios.presets import PRESETS
from auv_gym.task.simulation import PARAMETERS
from baselines.agents.agent import Agent
from baselines.agents.features import INTEGRALS, LARGEST_FEATURE, VEHICLE_FEATURES, Inputs
from baselines.agents.filters import MEMORY_ENTRIES, SHARED
from baselines.agents.names import agent_folder
from baselines.agents.networks import Gru
from baselines.control.backstepping import Backstepping
from baselines.training import vehicle_models
from baselines.training.apg.closed_loop import ClosedLoop, law_of
from baselines.training.apg.network import put, torch_network, weights_of
from baselines.training.apg.settings import check
from baselines.training.config import Config

WITH_MODEL = Inputs((3, 20), fine=True, filters=True, nominal_vehicle=True)
OTHER = Vehicle(215.0, 400.0, 80.0, 12.0, 60.0, 30.0, 20.0, 300.0, 90.0, 150.0, 200.0, -40.0, 50.0)


@pytest.mark.parametrize("name", vehicle_names.vehicle_names())
def test_the_ranges_hold_every_published_vehicle(name):
    """In its own units, with a tolerance of a hundredth for the vehicles at the edges."""
    vehicle_model = vehicle_names.vehicle_model(name).in_paper_units
    v, acts, speed = vehicle_model.vehicle, vehicle_model.actuators, PAPER_VEHICLE.speed
    drag = v.d11 + speed * v.X_uu
    given = {"m22": v.m22 / v.m11, "d11": drag, "thrust": acts.F_u_max / drag / speed, "F_r_max": acts.F_r_max}
    given |= {name: getattr(v, name) for name in ("d22", "d33", "Y_vv", "N_rr", "Y_uv", "N_ur")}
    given |= {"turn_rate": vehicle_model.turn_rate, "lag": vehicle_model.lag, "fin": acts.fin, "astern": acts.astern}
    for what, value in given.items():
        low, high = vehicle_models.DECADES[what]
        assert not value or 0.99 * low <= value <= 1.01 * high, what
    for what, (low, high) in vehicle_models.LIFTS.items():
        assert low <= getattr(v, what) <= high


@pytest.fixture(scope="module")
def turned():
    """Four vehicles, every other one with a drawn model."""
    scenarios = [PRESETS[name] for name in ("slow-storm", "slow-storm", "cruise-noise", "cruise-storm")]
    return scenarios, vehicle_models.variants_of(scenarios, 0.5, 3)


def test_a_share_of_the_vehicles_has_drawn_models(turned):
    scenarios, given = turned
    assert [len(own) for own in given] == [1, vehicle_models.SEVERAL, 1, vehicle_models.SEVERAL]
    for scenario, own in zip(scenarios, given, strict=True):
        for s in own:
            assert (s.substeps, s.control_dt, s.steps) == (vehicle_models.SUBSTEPS, scenario.control_dt, scenario.steps)
            assert Units.of(s.vehicle) == Units()
            assert (s.vehicle == PAPER_VEHICLE) == (len(own) == 1)
    assert len({s.vehicle for own in given for s in own}) == 1 + 2 * vehicle_models.SEVERAL
    assert vehicle_models.variants_of(scenarios, 0.5, 3) == given
    assert vehicle_models.variants_of(scenarios, 0.5, 4) != given


def test_episodes_cycle_through_the_models(turned):
    _, given = turned
    group = group_of(given, n_steps=50)
    at = slice(PARAMETERS.coefficients.m11, PARAMETERS.coefficients.N_ur + 1)
    seen = [group.known.copy()]
    for _ in range(vehicle_models.SEVERAL):
        group.renew(group.carried, np.full(4, np.nan))
        assert group.begins.all()
        seen.append(group.known.copy())
        true = group.sub_envs.constants[at]
        assert (true[:, 2] == seen[-1][:, 2]).all()  # noise alone
        assert (true[:, 3] != seen[-1][:, 3]).any()
        assert group.carried.observation[:, 3].any()
    for k, known in enumerate(seen):
        for i in range(4):
            assert tuple(known[:, i]) == given[i][k % len(given[i])].vehicle.coefficients


def test_a_model_error_does_not_change_plan_and_motion(turned):
    _, given = turned
    right, misled = (group_of(given, n_steps=50, misinformed=misinformed) for misinformed in (False, True))
    wrong = []
    for _ in range(vehicle_models.SEVERAL):
        assert (right.sub_envs.constants == misled.sub_envs.constants).all()
        assert all((a == b).all() for a, b in zip(right.carried, misled.carried, strict=True))
        for ours, its in zip(right.exogenous_inputs(), misled.exogenous_inputs(), strict=True):
            np.testing.assert_array_equal(ours, its)
        wrong.append((right.known != misled.known).any(axis=0))
        for group in (right, misled):
            group.renew(group.carried, np.full(4, np.nan))
    assert 0.5 < np.mean(wrong) < 0.95  # of 64, three of four are expected
    assert np.any(wrong, axis=0).all()


def test_a_model_error_changes_ratios_only_and_keeps_the_vehicle_slender():
    rng, low, high = np.random.default_rng(0), *vehicle_models.MISTAKE
    for vehicle in (PAPER_VEHICLE, OTHER):
        said = [vehicle_models.with_model_error(vehicle, rng) for _ in range(400)]
        assert np.mean([told != vehicle for told in said]) == pytest.approx(vehicle_models.WRONG, abs=0.07)
        for name in ("m11", "m33", "Y_ur", "speed"):
            assert {getattr(told, name) for told in said} == {getattr(vehicle, name)}
        share = vehicle.N_uv / (vehicle.m22 - vehicle.m11)  # of the Munk moment, which scales as a whole
        assert [told.N_uv / (told.m22 - told.m11) for told in said] == pytest.approx([share] * len(said))
        for name in ("d11", "d22", "d33"):
            shares = [getattr(told, name) / getattr(vehicle, name) for told in said]
            assert low <= min(shares) < low + 0.05
            assert high - 0.05 < max(shares) <= high
        m22 = [told.m22 for told in said]
        assert 1.02 * vehicle.m11 <= min(m22) * (1 + 1e-9)
        assert max(m22) > 1.5 * vehicle.m22


def test_a_loop_of_several_vehicles_equals_a_policy_for_each():
    """Expert, filters and features of a loop with several vehicles are those of policies made for each."""
    known = [PAPER_VEHICLE, OTHER]
    expert = Backstepping()
    loop = ClosedLoop(law_of(expert)[0], WITH_MODEL, informed=expert)
    rows = np.array([v.coefficients for v in known]).T
    env = UnderactuatedAUVTrackVectorEnv(2, [replace(PRESETS["cruise-storm"], vehicle=v, substeps=3) for v in known])
    observation, _ = env.reset(seed=0)
    rng, memory = np.random.default_rng(0), WITH_MODEL.memory
    sums, alone = np.zeros((memory, 2)), [np.zeros((memory, 1))] * 2
    for _ in range(60):
        ahead, last = rng.normal(size=(4, 2)), rng.uniform(-1, 1, (2, 2))
        base = loop.expert(observation.T, ARRAYS, rows)
        features, sums = loop.features(observation.T, ahead, base, last, sums, ARRAYS, rows)
        for i, vehicle in enumerate(known):
            action, _ = Backstepping(vehicle=vehicle).predict(observation[i])
            np.testing.assert_allclose([base[0][i], base[1][i]], action, rtol=1e-6, atol=1e-7)
            one = ClosedLoop(law_of(expert)[0], WITH_MODEL)
            column = observation[i, :, None], ahead[:, i : i + 1], np.array(base)[:, i : i + 1], last[:, i : i + 1]
            own, alone[i] = one.features(*column, alone[i], ARRAYS, vehicle.coefficients)
            mine = [float(np.broadcast_to(row, 1)[0]) for row in own]
            np.testing.assert_allclose(mine, [np.broadcast_to(row, 2)[i] for row in features], rtol=1e-9)
        observation, *_ = env.step(rng.uniform(-0.5, 0.5, (2, 2)))


@pytest.mark.parametrize("name", slow_except(["lauv"], ["eca-a9", "lauv", "remus100"]))
def test_filters_of_an_agent_use_the_whole_model(name):
    """In calm water there is no sway load; the side force of a rudder and cross-flow are no load, either."""
    scenario = in_vehicle_units(changed(PRESETS["cruise-calm"], name))
    env = UnderactuatedAUVTrackVectorEnv(8, scenario)
    own, helm_any = scenario.vehicle, Agent.load(agent_folder("helm-any"))
    agent, without = (helm_any.policy(vehicle=vehicle) for vehicle in (own, Vehicle(*own.coefficients)))
    (observation, _), law = env.reset(seed=0), Backstepping(vehicle=own)
    row, loads, memories = INTEGRALS + SHARED + MEMORY_ENTRIES.index("Y"), [], [None, None]
    for _ in range(200):
        seen = np.hstack((observation, np.zeros((8, len(agent.preview) * 2))))
        memories = [p.predict(seen, m)[1] for p, m in zip((agent, without), memories, strict=True)]
        loads.append([np.abs(memory[0][:, row]).mean() for memory in memories])
        observation, *_ = env.step(law.predict(observation)[0])
    whole, part = np.mean(loads, axis=0)
    assert whole < 0.35 * part


def test_vehicle_features_are_bounded_and_equal_the_table():
    o = [np.array([x]) for x in [0.0] * 6 + [1.0, 0, 0, 0, 0, 1, 0, 400, 200, 0, 0, 0.1]]
    rows, _ = Inputs(nominal_vehicle=True).update(o, (), (0, 0), (0, 0), np.zeros((4, 1)), ARRAYS, OTHER.coefficients)
    values = (float(np.ravel(x)[0]) for x in rows[-len(VEHICLE_FEATURES) :])
    got = dict(zip([f.name for f in VEHICLE_FEATURES], values, strict=True))
    assert got["m22"] == pytest.approx(400 / 215 - 1)
    assert got["d22"] == pytest.approx(2 * 0.15 / (0.15 + 0.4))
    assert got["N_uv"] == pytest.approx(-0.5)
    assert (got["Y_ur"], got["N_ur"]) == pytest.approx((0.5, 2 * 0.625 / 1.125))
    extreme = Coefficients(215, 1e9, 80, *[1e9] * 10)
    rows, _ = Inputs(nominal_vehicle=True).update(o, (), (0, 0), (0, 0), np.zeros((4, 1)), ARRAYS, extreme)
    assert np.abs([float(np.ravel(row)[0]) for row in rows]).max() <= LARGEST_FEATURE
    assert Inputs().features == Inputs(nominal_vehicle=True).features[: -len(VEHICLE_FEATURES)]


def test_additional_inputs_do_not_change_the_initial_action():
    torch.manual_seed(0)
    observation = np.random.default_rng(0).uniform(-0.3, 0.3, (5, 18))
    observation[:, [13, 14, 17]] = 0.78125, 0.78125, 0.8
    actions, weights = [], None
    for inputs in (Inputs(), Inputs(nominal_vehicle=True)):
        net = torch_network(Gru(len(inputs.features), 8, 8, 8))
        if weights is None:
            torch.nn.init.normal_(net.head.weight)
        else:
            put(weights, net)
        weights = weights_of(net)
        agent = Agent(net.sizes, weights, "backstepping", (1.0, 1.0), inputs=inputs)
        actions.append(agent.policy(vehicle=PAPER_VEHICLE).predict(observation, None, np.ones(5, dtype=bool))[0])
    np.testing.assert_allclose(*actions, atol=1e-6)


def test_other_experts_are_rejected_with_drawn_vehicles():
    scenarios = ((PRESETS["cruise-storm"], 1.0),)
    settings = {"n_envs": 4, "n_steps": 10, "nominal_vehicle": True, "drawn_share": 0.5}
    for expert in ("backstepping", "backstepping-normalised", "none"):
        check(Config(scenarios=scenarios, expert=expert, hyperparameters=settings))
    with pytest.raises(ValueError, match="so they must be inputs of the network"):
        check(Config(scenarios=scenarios, hyperparameters=settings | {"nominal_vehicle": False}))
    with pytest.raises(ValueError, match="vehicles are drawn, so the expert must be"):
        check(Config(scenarios=scenarios, expert="lqi", hyperparameters=settings))


def test_a_vehicle_with_cross_terms_is_trained_on_fixed_paths():
    """Since the plan of a path takes as long as many control steps."""
    scenarios = [changed(PRESETS[name], vehicle) for name, vehicle in (("cruise-noise", "lauv"), ("slow-calm", None))]
    crossed, plain = vehicle_models.with_fixed_paths(scenarios, 0)
    assert plain == [scenarios[1]]
    assert len({id(s.path) for s in crossed}) == len(crossed) == vehicle_models.FIXED_PATHS
    assert all(replace(s, path=scenarios[0].path) == scenarios[0] for s in crossed)
    assert vehicle_models.with_fixed_paths(scenarios, 0)[0] == crossed
    assert vehicle_models.with_fixed_paths(crossed[:1], 0) == [crossed[:1]]

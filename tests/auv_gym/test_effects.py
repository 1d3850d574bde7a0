"""Effects of a user, those of examples/effects.py, and the rules for all effects."""

import pickle
from dataclasses import replace
from typing import Annotated, NamedTuple

import numpy as np
import pytest

from auv_gym import decode_observation
from auv_gym.effects import EFFECTS, PACKAGE, Effect, FineReward, Interval, effect
from auv_gym.effects.base import _check_points, uniform_of
from auv_gym.envs.track_env import UnderactuatedAUVTrackEnv
from auv_gym.envs.track_vector_env import UnderactuatedAUVTrackVectorEnv
from auv_gym.physics.units import Units
from auv_gym.physics.vehicle import PAPER_VEHICLE
from auv_gym.planning.paths import Line
from auv_gym.scenarios.fitting import changed, in_vehicle_units
from auv_gym.scenarios.presets import PRESETS
from auv_gym.scenarios.scenario import Scenario, Start
from auv_gym.scenarios.vehicles import vehicle_model
from examples.effects import DeadZone, DriftingCompass, TowedBody, Wall

ALL = DeadZone(0.1), DriftingCompass(), TowedBody(), Wall()
CALM, STORM = PRESETS["cruise-calm"], PRESETS["cruise-storm"]
MINE = replace(STORM, name="mine", effects=ALL)


def run(scenario, actions, seed=3):
    """Return the environment after some actions, with the observations and the rewards."""
    env = UnderactuatedAUVTrackEnv(scenario)
    seen, rewards = [env.reset(seed=seed)[0]], []
    for action in actions:
        observation, reward, terminated, *_ = env.step(np.array(action))
        seen.append(observation)
        rewards.append(reward)
        if terminated:
            break
    return env, np.array(seen), np.array(rewards)


def test_one_vehicle_and_eight_have_the_same_episodes():
    vector, singles = UnderactuatedAUVTrackVectorEnv(8, MINE), [UnderactuatedAUVTrackEnv(MINE) for _ in range(8)]
    seen, _ = vector.reset(seed=3)
    np.testing.assert_array_equal(seen, [env.reset(seed=3 + i)[0] for i, env in enumerate(singles)])
    rng = np.random.default_rng(0)
    for _ in range(150):
        actions = rng.uniform(-1, 1, (8, 2))
        seen, rewards, *_ = vector.step(actions)
        alone = [env.step(action) for env, action in zip(singles, actions, strict=True)]
        np.testing.assert_array_equal(seen, [result[0] for result in alone])
        np.testing.assert_array_equal(rewards, [result[1] for result in alone])


def test_beside_other_scenarios_nothing_changes():
    """Vehicles with and without the effects side by side; the bits are those of each scenario alone."""
    scenarios = [STORM, MINE, replace(CALM, effects=(Wall(0.5),)), MINE]
    vector, singles = UnderactuatedAUVTrackVectorEnv(4, scenarios), [UnderactuatedAUVTrackEnv(s) for s in scenarios]
    vector.reset(seed=1)
    for i, env in enumerate(singles):
        env.reset(seed=1 + i)
    for _ in range(60):
        seen, rewards, *_ = vector.step(np.full((4, 2), 0.3))
        alone = [env.step(np.full(2, 0.3)) for env in singles]
        np.testing.assert_array_equal(seen, [result[0] for result in alone])
        np.testing.assert_array_equal(rewards, [result[1] for result in alone])


def test_an_effect_changes_no_other_number_of_an_episode():
    for seed in range(5):
        plain, mine = (s.draw(np.random.default_rng(seed)) for s in (STORM, MINE))
        assert replace(mine, effects=()) == plain
        assert [name for name, _ in mine.effects] == ["dead_zone", "drifting_compass", "towed_body", "wall"]
    neutral = replace(STORM, effects=(DeadZone(0.0), DriftingCompass(0.0, 0.0), TowedBody(0.0), Wall(0.0, 1e6)))
    actions = np.random.default_rng(0).uniform(-1, 1, (80, 2))
    for mine, plain in zip(run(neutral, actions)[1:], run(STORM, actions)[1:], strict=True):
        np.testing.assert_array_equal(mine, plain)


def test_a_dead_zone_gives_no_force():
    actions = [(0.05, 0.1), (-0.09, 0.0), (0.11, 0.0), (-0.5, 0.2)]
    env = UnderactuatedAUVTrackEnv(replace(CALM, effects=(DeadZone(0.1),)))
    env.reset(seed=0)
    forces = []
    for action in actions:
        env.step(np.array(action))
        forces.append(env.force[0] / 400.0)
    np.testing.assert_allclose(forces, [0.0, 0.0, 0.11, -0.5], atol=1e-12)


def test_a_compass_drifts_by_its_rate_and_a_random_walk():
    scenario = replace(CALM, effects=(DriftingCompass(0.01, 0.02),))
    *_, errors = zip(*(_heading_errors(scenario, seed) for seed in range(60)), strict=True)
    final = np.array(errors)
    assert final.mean() == pytest.approx(0.01 * 0.1 * 100, abs=3.5 * 0.02 * 10 / np.sqrt(60))
    assert final.std() == pytest.approx(0.02 * 10, rel=0.3)


def _heading_errors(scenario, seed):
    env, seen, _ = run(scenario, [(0.5, 0.0)] * 100, seed)
    o = decode_observation(seen)
    return 0.0, np.remainder(np.arctan2(o.sin_psi[-1], o.cos_psi[-1]) - env.state[2] + np.pi, 2 * np.pi) - np.pi


def test_a_towed_body_pulls_with_its_drag_until_it_is_reeled_in():
    """Compared with the solution of m11 u' = -d11 u + load, with the load held over each control step."""
    drag, reeled = 20.0, 5.0
    env = UnderactuatedAUVTrackEnv(replace(CALM, effects=(TowedBody(drag, reeled),)))
    env.reset(seed=0)
    m, d, dt = PAPER_VEHICLE.m11, PAPER_VEHICLE.d11, CALM.control_dt
    for k in range(1, 80):
        u, decay = env.state[3], np.exp(-d * dt / m)
        load = 200.0 - max(0.0, 1.0 - k * dt / reeled) * drag * u * abs(u)
        env.step(np.array([0.5, 0.0]))
        assert env.state[3] == pytest.approx(u * decay + load / d * (1 - decay), abs=1e-5)


def test_a_wall_costs_reward_and_ends_the_episode():
    env = UnderactuatedAUVTrackEnv(CALM)
    env.reset(seed=0)
    x = env.state[0]
    _, seen, rewards = run(replace(CALM, effects=(Wall(0.5, x + 3.0),)), [(0.5, 0.0)] * 200, 0)
    _, _, plain = run(CALM, [(0.5, 0.0)] * (len(seen) - 1), 0)
    np.testing.assert_allclose(plain - rewards, 0.5 * 0.25, atol=1e-12)
    assert len(rewards) < 200


def test_a_fine_reward_tells_millimetres_from_centimetres():
    """It is the formula of its docstring, for the error after the step; for a small vehicle its scale is smaller."""
    plain = replace(PRESETS["cruise-calm"], path=Line(1.0), rate_weight=0.0, start=Start(0.0, (0.001, 0.1), 0.0))
    fine = replace(plain, effects=(FineReward(scale=0.02, weight=0.25),))
    env = UnderactuatedAUVTrackVectorEnv(32, fine)
    env.reset(seed=1)
    reward, info = env.step(np.zeros((32, 2)))[1::3]
    e = info["position_error"]
    np.testing.assert_allclose(reward, 0.75 / np.hypot(1, e / 0.5) + 0.25 / np.hypot(1, e / 0.02), rtol=1e-6)
    slope = np.polyfit(e, reward, 1)[0]
    assert slope < -1.5  # without the effect: a tenth of this
    assert changed(fine, "lauv").effects[0].scale == pytest.approx(
        0.02 * Units.of(vehicle_model("lauv").vehicle).length
    )


def test_scenarios_are_saved_with_their_effects(tmp_path):
    for file in (tmp_path / "mine.toml", tmp_path / "mine.json"):
        MINE.save(file)
        assert Scenario.load(file) == MINE
    assert "width = [\n" in (s := (tmp_path / "mine.toml").read_text()) or "[effects.dead_zone]" in s
    assert pickle.loads(pickle.dumps(MINE)) == MINE


def test_effects_are_scaled_to_another_vehicle():
    """Dimensionless numbers stay; the others have the factors of length, time and mass."""
    model = vehicle_model("remus100")
    units = Units.of(model.vehicle)
    dead, compass, tow, _ = changed(MINE, "remus100").effects
    assert dead == ALL[0]
    assert compass.rate[1] == pytest.approx(0.002 / units.time)
    assert tow.drag[0] == pytest.approx(5.0 * units.mass / units.length)
    assert tow.reeled == pytest.approx(60.0 * units.time)
    back = in_vehicle_units(changed(replace(MINE, mismatch=None), "remus100")).effects
    assert back[2].drag == pytest.approx(ALL[2].drag)


def test_the_simulation_on_tensors_has_them_with_gradients():
    torch = pytest.importorskip("torch")
    from auv_gym.envs.differentiable import episodes, simulate

    drawn = episodes([MINE] * 3, steps=20, seed=3)
    actions = torch.full((2, 3), 0.3, dtype=torch.float64, requires_grad=True)
    state, total = drawn.state, 0.0
    for sample in drawn.samples:
        state, observation, reward, *_ = simulate(state, actions, sample, drawn.parameters, drawn.parts)
        total = total + reward.sum()
    vector = UnderactuatedAUVTrackVectorEnv(3, MINE)
    vector.reset(seed=3)
    for _ in range(20):
        seen, *_ = vector.step(np.full((3, 2), 0.3))
    np.testing.assert_allclose(observation.detach().numpy().T, seen, rtol=1e-10, atol=1e-12)
    total.backward()
    assert (actions.grad.abs() > 0).all()


def test_random_numbers_of_an_effect_are_uniform_and_independent():
    """For many seeds at once as for each seed alone."""
    seeds = np.random.default_rng(0).integers(2**63, size=4000)
    first, second = (u() for u in [uniform_of(DeadZone.name, seeds)] * 2)
    other = uniform_of(TowedBody.name, seeds)()
    for i in range(5):
        assert uniform_of(DeadZone.name, int(seeds[i]))() == first[i]
    for numbers in (first, second, other):
        assert np.abs(np.histogram(numbers, 10, (0, 1))[0] / 4000 - 0.1).max() < 0.025
    assert np.abs(np.corrcoef([first, second, other]) - np.eye(3)).max() < 0.06


@pytest.mark.parametrize("own", PACKAGE, ids=str)
def test_effects_of_the_package_do_nothing_with_neutral_numbers(own):
    if not hasattr(own, "vehicle"):  # lift and cross terms replace the coefficients
        _check_points(own)


def field(unit="1", default=0.5):
    return Annotated[Interval, unit, 0.0, 1.0, "a number"], default


def made(name="Own", unit="1", points=None, **entries):
    """Make a class of effects with a field `size`."""
    kind, default = field(unit)
    methods = {key: staticmethod(one) for key, one in (points or {}).items()}
    return effect(type(name, (Effect,), {"__annotations__": {"size": kind}, "size": default, **methods, **entries}))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"points": {"shares": lambda x, _: x}}, "Own acts at 'shares'; the points are command, load, share"),
        ({"points": {"share": lambda x, _: x[0]}}, "Own.share returns .* it must return shares of the limits"),
        ({"points": {"share": lambda x, _: (x[0] + 1.0, x[1])}}, "Own.share changes the value .* neutral"),
        ({"points": {"reward": lambda x, at: x / at.own.size}}, "Own.reward fails: ZeroDivisionError"),
        ({"points": {"share": lambda x, at: (x[0] * at.own.width, x[1])}}, "no attribute 'width'"),
        ({"unit": "furlong"}, "the unit of Own.size is 'furlong'; it must be one of 1, rad, m, s"),
        ({"__annotations__": {"share": field()[0]}, "share": 0.5}, "a field with the name of a point"),
        ({"remembers": ("depth",)}, "Own remembers 'depth'; measurements are x, y, z, theta, psi, u, v, w, q, r"),
    ],
)
def test_a_wrong_class_is_refused_when_it_is_made(arguments, message):
    with pytest.raises(TypeError, match=message):
        made(**arguments)
    assert "own" not in EFFECTS


def test_a_field_needs_its_unit_and_bounds():
    class Bare(Effect):
        size: float = 1.0

    with pytest.raises(TypeError, match="field size of Bare must be annotated: Annotated"):
        effect(Bare)


def test_a_memory_must_be_returned():
    class Forgetful(Effect):
        class Memory(NamedTuple):
            last: float

        @staticmethod
        def command(command, memory, at):
            return command

    with pytest.raises(TypeError, match=r"Forgetful.command fails|must return the value and its Memory"):
        effect(Forgetful)


def test_neutral_numbers_can_be_named(monkeypatch):
    monkeypatch.setattr("auv_gym.effects.base.EFFECTS", {})
    share = {"share": lambda x, at: (x[0] * at.own.size, x[1])}
    gain = made("Gain", points=share, neutral={"size": 1.0})
    assert gain.Constants().size == 1.0


def test_mistakes_that_show_only_in_an_environment_name_the_effect(monkeypatch):
    monkeypatch.setattr("auv_gym.effects.base.EFFECTS", {})
    branching = made("Branching", points={"share": lambda x, at: (0.0 if x[0] > 0.9 else x[0], x[1])})
    with pytest.raises(TypeError, match=r"Branching.share: a symbol has no truth value; use `where`"):
        UnderactuatedAUVTrackEnv(replace(CALM, effects=(branching(),))).reset()

    class Inputs(NamedTuple):
        tide: float

    short = made("Short", Inputs=Inputs, inputs=lambda *_: np.zeros(3))
    with pytest.raises(ValueError, match=r"Short.inputs returns an array of shape \(3,\); it must be \(1, 601\)"):
        UnderactuatedAUVTrackEnv(replace(CALM, effects=(short(),))).reset()


@pytest.mark.parametrize(
    ("effects", "message"),
    [
        ([DeadZone()], "scenario effects is .* it must be a tuple of objects"),
        ((DeadZone,), "it must be a tuple of objects whose classes are made by auv_gym.effects.effect"),
        ((DeadZone(), DeadZone(0.2)), "has two of one name"),
    ],
)
def test_wrong_effects_of_a_scenario_are_refused(effects, message):
    with pytest.raises(ValueError, match=message):
        Scenario(effects=effects)


def test_wrong_numbers_and_names_are_refused():
    with pytest.raises(ValueError, match=r"dead_zone width is 2.0; it must be a number in \[0, 1\]"):
        DeadZone(2.0)
    with pytest.raises(ValueError, match=r"unknown effect .undertow.; known are .* auv-gym evaluate --effects FILE"):
        Scenario.from_dict({"effects": {"undertow": {}}})
    with pytest.raises(ValueError, match="effect dead_zone has no entry 'depth'; allowed are width"):
        Scenario.from_dict({"effects": {"dead_zone": {"depth": 1.0}}})
    episode = MINE.draw(np.random.default_rng(0))
    with pytest.raises(ValueError, match="the episode has the effect 'dead_zone', but scenario"):
        STORM.parameters(episode)

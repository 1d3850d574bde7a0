"""Governed plans: the path at another pace, the loads in a current, and scenarios with a governor."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from back_ends import assert_equals_scalars
from scipy.integrate import quad
from scipy.interpolate import CubicSpline

from auv_gym.envs.track_env import UnderactuatedAUVTrackEnv
from auv_gym.envs.track_vector_env import UnderactuatedAUVTrackVectorEnv
from auv_gym.physics.actuators import Actuators
from auv_gym.physics.disturbances import Waves
from auv_gym.physics.vehicle import PAPER_VEHICLE
from auv_gym.planning.governor import WAVES, Governor, reserves
from auv_gym.planning.paths import Circle, FigureEight, Line, Retimed, Spline
from auv_gym.planning.planner import plan
from auv_gym.scenarios.presets import as_scenario
from auv_gym.scenarios.scenario import Scenario
from auv_gym.scenarios.vehicles import vehicle_model
from auv_gym.task.observation import decode_observation
from baselines.evaluation.runner import Cell, drawn
from baselines.evaluation.suites import load_suite, rounded, save_suite

REMUS = vehicle_model("remus100")
RATES = (1.0, 1.3, 1.8, 1.2, 0.7, 0.9, 1.0)
T = np.linspace(0.0, 60.0, 601)


@dataclass(frozen=True)
class InWater:
    """A path seen from the water, which moves at a constant velocity."""

    path: object
    current: tuple[float, float]

    start, end = 0.0, 60.0

    @property
    def speed(self):
        return self.path.speed

    def derivatives(self, t):
        d = np.array(self.path.derivatives(t))
        for axis, V in enumerate(self.current):
            d[0, axis] -= V * np.asarray(t)
            d[1, axis] -= V
        return d


def left_in_water(path, vehicle, actuators, current, waves=None):
    """Return the share of the limits that the exact plan in the water leaves at each time."""
    R = plan(InWater(path, current), vehicle, T)
    torque = np.minimum(actuators.F_r_max, actuators.fin * R.u**2) if actuators.fin else actuators.F_r_max
    surge, yaw = (WAVES * waves.surge, WAVES * waves.yaw) if waves else (0.0, 0.0)
    return 1 - np.maximum((abs(R.F_u) + surge) / actuators.F_u_max, (abs(R.F_r) + yaw) / torque)


@pytest.mark.parametrize("path", [Circle(1.0, 0.1), FigureEight(8.0, 0.1), Spline(((0, 0), (30, 5), (60, -5)), 0.9)])
def test_a_path_at_another_pace_is_at_the_integral_of_its_rate(path):
    retimed = Retimed(path, 5.0, RATES)
    rate = CubicSpline(5.0 * np.arange(len(RATES)), RATES, bc_type="clamped")
    for t in (0.0, 3.3, 17.0, 30.0):
        s, _ = quad(rate, 0.0, t)
        np.testing.assert_allclose(
            retimed.derivatives(np.array([t]))[0], path.derivatives(np.array([s]))[0], rtol=0, atol=1e-9
        )
    t = np.linspace(0.5, 29.5, 2901)
    d = retimed.derivatives(t)
    for order in range(3):
        slope = CubicSpline(t, d[order], axis=1)(t[50:-50], 1)
        np.testing.assert_allclose(slope, d[order + 1][:, 50:-50], rtol=0, atol=2e-4)
    assert retimed.speed == path.speed
    with pytest.raises(ValueError, match=r"times must be in 0 ... 30 s, got 0 ... 31 s"):
        retimed.derivatives(np.array([0.0, 31.0]))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"path": 3.0}, "path must be a path, got 3.0"),
        ({"interval": 0.0}, "interval must be finite and positive, got 0.0"),
        ({"rates": (1.0, 1.0, 1.0)}, "rates must be four or more numbers"),
        ({"rates": (1.0, -1.0, 1.0, 1.0)}, "rates must be finite and positive, got -1.0"),
        ({"rates": (3.0, 0.01, 0.01, 3.0)}, "must stay positive between the given ones"),
        ({"path": Spline(((0, 0), (10, 0)), 1.0)}, "must be defined from 0 to 34.5"),
    ],
)
def test_an_impossible_pace_is_refused(changes, message):
    fields = {"path": Line(1.0), "interval": 5.0, "rates": RATES} | changes
    with pytest.raises(ValueError, match=message):
        Retimed(**fields)


@pytest.mark.parametrize("name", ["paper", "remus100", "eca-a9"])
@pytest.mark.parametrize("rate", [0.7, 1.0, 1.6])
def test_the_reserve_is_that_of_the_plan_in_the_water(name, rate):
    model = vehicle_model(name) if name != "paper" else None
    vehicle, acts = (model.vehicle, model.actuators) if model else (PAPER_VEHICLE, Actuators())
    waves = Waves(0.5, 0.1, 0.02, (1.0,), ((0.0,),) * 3)
    speed, turn_rate = 0.9, 0.02
    steady = Circle(rate * speed, rate * turn_rate)
    exact = left_in_water(steady, vehicle, acts, (0.0, 0.0), waves)
    found = reserves(Circle(speed, turn_rate).derivatives(T), np.array([rate]), vehicle, acts, (0.0, 0.0), waves)
    np.testing.assert_allclose(found[0], exact, rtol=0, atol=2e-3)
    current = (0.15, -0.1)
    exact = left_in_water(steady, vehicle, acts, current, waves)
    found = reserves(steady.derivatives(T), np.array([1.0]), vehicle, acts, current, waves)
    np.testing.assert_allclose(found[0, 50:], exact[50:], rtol=0, atol=0.02)  # the water turns under the vehicle


def test_a_current_ahead_takes_thrust():
    acts = Actuators(F_u_max=100.0)
    speeds = np.array([0.5, 1.0])
    found = reserves(Line(1.0).derivatives(T[:1]), speeds, PAPER_VEHICLE, acts, (-0.4, 0.0))[:, 0]
    through_water = speeds + 0.4
    drag = (PAPER_VEHICLE.d11 + PAPER_VEHICLE.X_uu * through_water) * through_water
    np.testing.assert_allclose(found, 1 - drag / 100.0, rtol=1e-12)


def test_a_plan_is_slower_where_thrust_is_short_and_faster_where_fins_are_weak():
    governor = Governor(reserve=0.3)
    drag = PAPER_VEHICLE.d11 + PAPER_VEHICLE.X_uu
    weak = Actuators(F_u_max=1.5 * drag)  # 1 m/s needs two thirds
    against = governor.governed(Line(1.0), PAPER_VEHICLE, weak, (-0.3, 0.0), duration=60.0)
    assert max(against.rates) < 0.9
    waves = Waves(0.0, 0.0, 0.25, (1.0,), ((0.0,),) * 3)
    fins = governor.governed(Line(0.8), REMUS.vehicle, REMUS.actuators, waves=waves, duration=60.0)
    assert min(fins.rates) > 1.1


@pytest.mark.parametrize("current", [(0.0, 0.0), (0.25, 0.1), (-0.2, 0.2)])
@pytest.mark.parametrize("path", [Circle(0.9, 0.03), FigureEight(100.0, 0.008, phase=1.2), Line(0.7, heading=0.5)])
def test_the_exact_plan_in_the_water_keeps_the_reserve(path, current):
    waves = Waves(0.5, 0.1, 0.2, (1.0,), ((0.0,),) * 3)
    given = REMUS.vehicle, REMUS.actuators, current, waves
    governed = Governor(reserve=0.2, fastest=4.0).governed(path, *given, duration=60.0)
    before, after = left_in_water(path, *given), left_in_water(governed, *given)
    assert before.min() < 0.2
    assert after[20:].min() > 0.05  # the smoothed rate is not exactly the one that was chosen
    assert np.median(after) > 0.15


def test_a_plan_with_enough_reserve_is_not_changed():
    path = Circle(1.0, 0.1)
    assert Governor().governed(path, PAPER_VEHICLE, Actuators(), (0.2, 0.1), duration=60.0) is path


def test_a_path_that_ends_is_not_left_too_early():
    path = Spline(((0, 0), (20, 3), (45, 0)), 0.7)
    waves = Waves(0.0, 0.0, 0.25, (1.0,), ((0.0,),) * 3)
    governed = Governor().governed(path, REMUS.vehicle, REMUS.actuators, waves=waves, duration=60.0)
    assert governed.end >= 60.0
    assert isinstance(governed, Retimed)


@pytest.mark.parametrize(
    ("changes", "message"),
    [({"reserve": 1.0}, "reserve is 1.0"), ({"slowest": 1.5}, "slowest is 1.5"), ({"fastest": 0.5}, "fastest is 0.5")],
)
def test_a_governor_out_of_range_is_refused(changes, message):
    with pytest.raises(ValueError, match=f"governor {message}"):
        Governor(**changes)


def test_a_scenario_with_a_governor_in_files(tmp_path):
    storm = as_scenario("cruise-storm@remus100")
    governed = replace(storm, governor=Governor(reserve=0.25))
    for kind in ("json", "toml"):
        governed.save(tmp_path / f"governed.{kind}")
        assert Scenario.load(tmp_path / f"governed.{kind}") == governed
    fixed = Scenario(path=Retimed(Circle(1.0, 0.1), 20.0, RATES), steps=1000)
    assert Scenario.from_dict(fixed.to_dict()) == fixed
    with pytest.raises(ValueError, match="unknown path family 'spiral'"):
        Scenario.from_dict({"path": {"family": "retimed", "path": {"family": "spiral"}, "interval": 1.0, "rates": []}})
    with pytest.raises(ValueError, match="path is 3; it must be a table with a family"):
        Scenario.from_dict({"path": {"family": "retimed", "path": 3, "interval": 1.0, "rates": [1, 1, 1, 1]}})
    cell = drawn(replace(governed, name="governed"), 3, 7)
    save_suite("custom", [rounded(cell)], folder=tmp_path)
    (loaded,) = load_suite("custom", tmp_path).cells
    assert isinstance(loaded, Cell)
    assert any(isinstance(e.path, Retimed) for e in loaded.episodes)
    assert rounded(cell).episodes == loaded.episodes


def test_episodes_differ_from_those_without_a_governor_by_their_pace_only():
    storm = as_scenario("cruise-storm@nps-auv2")
    for i in range(5):
        plain, governed = (
            s.draw(np.random.default_rng(i)) for s in (storm, replace(storm, governor=Governor(reserve=0.3)))
        )
        path = governed.path.path if isinstance(governed.path, Retimed) else governed.path
        assert replace(governed, path=path) == plain


def test_single_and_vector_environments_agree():
    scenario = replace(as_scenario("cruise-storm@eca-a9"), governor=Governor(), steps=40)
    vector = UnderactuatedAUVTrackVectorEnv(num_envs=20, scenario=scenario, preview=(5, 20))
    scalars = [UnderactuatedAUVTrackEnv(scenario, preview=(5, 20)) for _ in range(20)]
    assert_equals_scalars(vector, scalars, 39, scale=0.5, seed=3)


def test_a_fixed_path_is_governed_in_each_episode():
    storm = as_scenario("cruise-storm@remus100")
    env = UnderactuatedAUVTrackEnv(replace(storm, path=Line(1.0), governor=Governor()))
    speeds = [float(decode_observation(env.reset(seed=seed)[0]).u_R) for seed in range(3)]
    assert min(speeds) > 1.05
    assert len(set(speeds)) == 3

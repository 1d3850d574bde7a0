"""Environments in space: interfaces, equal episodes alone and together, physics of current, waves and limits."""

import json
import math
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from auv_gym import decode_observation
from auv_gym.effects.actuators import Actuators
from auv_gym.effects.current import Current
from auv_gym.effects.faults import RandomFaults
from auv_gym.effects.sensors import Sensors
from auv_gym.envs.residual import ResidualAction, VectorResidualAction
from auv_gym.envs.shaft import ShaftAction
from auv_gym.envs.space import UnderactuatedAUVTrack3DEnv, UnderactuatedAUVTrack3DVectorEnv
from auv_gym.envs.sub_environments import SubEnvironments
from auv_gym.envs.track_env import UnderactuatedAUVTrackEnv
from auv_gym.physics.namespaces import FLOATS
from auv_gym.physics.space import state_rates, tracking_errors
from auv_gym.planning.paths import Circle
from auv_gym.planning.paths.space import Climb, Steps, Trefoil, WithHeight
from auv_gym.scenarios import exogenous
from auv_gym.scenarios.names import SPACE_STEPS
from auv_gym.scenarios.presets import PRESETS, SPACE_PRESETS, as_scenario
from auv_gym.scenarios.scenario import Scenario
from auv_gym.scenarios.vertical import Vertical
from auv_gym.task.space import SPACE
from baselines.space.backstepping import SpaceBackstepping

STORM, CALM = SPACE_PRESETS["space-storm"], SPACE_PRESETS["space-calm"]
MUCH = replace(
    STORM,
    sensors=Sensors(position=0.1, outages=3.0),
    actuators=Actuators(lag=0.3, F_u_rate=300.0, delay=(1.0, 2.0), reach=(0.6, 0.9), astern=0.5, fin=90.0),
    faults=RandomFaults(("surge stuck", "yaw dead", "all frozen", "velocity offset"), rate=6.0),
)
VEHICLES = ("lauv", "eca-a9", "remus100", "nps-auv2")


@pytest.mark.parametrize("name", ["", *SPACE_STEPS])
def test_the_ids_pass_the_checker(name):
    env = gym.make(f"UnderactuatedAUVTrack3D-{name}-v0".replace("--", "-"))
    assert (env.observation_space.shape, env.action_space.shape) == ((31,), (3,))
    if name in ("", "space-storm"):
        check_env(env.unwrapped)


@pytest.mark.parametrize("scenario", [STORM, MUCH, "space-storm@remus100"], ids=["storm", "effects", "remus100"])
def test_one_vehicle_and_many_have_the_same_episodes(scenario):
    """Also after the end of episodes, and with a preview."""
    scenario = replace(as_scenario(scenario), steps=40)
    many = UnderactuatedAUVTrack3DVectorEnv(3, scenario, preview=[5, 20])
    one, rng = UnderactuatedAUVTrack3DEnv(scenario, preview=[5, 20]), np.random.default_rng(0)
    rows, seen = many.reset(seed=4)[0], one.reset(seed=5)[0]
    for _ in range(90):
        np.testing.assert_array_equal(rows[1], seen)
        actions = rng.uniform(-1, 1, (3, 3)).astype(np.float32)
        rows, rewards, *_ = many.step(actions)
        seen, reward, terminated, truncated, _ = one.step(actions[1])
        assert reward == rewards[1]
        assert one.observation_space.contains(seen)
        if terminated or truncated:
            seen, _ = one.reset()
    np.testing.assert_array_equal(many.state[1], one.state)
    np.testing.assert_array_equal(many.current[1], one.current)


def test_without_a_compiler_samples_are_the_same(monkeypatch):
    def samples():
        envs = UnderactuatedAUVTrack3DVectorEnv(2, STORM)
        envs.reset(seed=3)
        return envs._sub_envs.samples.copy()

    compiled = samples()
    monkeypatch.setattr(exogenous, "compiled", lambda *_, **__: None)
    np.testing.assert_array_equal(samples(), compiled)


def test_without_vertical_parts_the_motion_is_that_of_the_plane():
    """A level path, no weight below the buoyancy: the same positions as in the plane, for the same commands."""
    path = Circle(0.6, 0.05)
    plane = replace(PRESETS["cruise-calm"], path=path)
    space = replace(plane, name="level", vertical=Vertical(depth=20.0))
    flat, deep = UnderactuatedAUVTrackEnv(plane), UnderactuatedAUVTrack3DEnv(space)
    start = {"initial_error": (0.3, -0.2, 0.1), "initial_velocity": (0.4, 0.1, 0.05)}
    flat.reset(seed=0, options=start)
    x_e, y_e, psi_e = start["initial_error"]
    u, v, r = start["initial_velocity"]
    options = {"initial_error": (x_e, y_e, 0, 0, psi_e), "initial_velocity": (u, v, 0, 0, r)}
    deep.reset(seed=0, options=options)
    rng = np.random.default_rng(1)
    for _ in range(50):
        surge, yaw = rng.uniform(-1, 1, 2)
        flat.step(np.array([surge, yaw]))
        deep.step(np.array([surge, 0.0, yaw]))
    np.testing.assert_allclose(deep.state[[0, 1, 4, 5, 6, 9]], flat.state, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(deep.state[[2, 3, 7, 8]], [-20.0, 0, 0, 0], atol=1e-12)
    np.testing.assert_allclose(flat.reference[:3], np.array(deep.reference)[[0, 1, 4]], rtol=1e-9)


def test_a_step_is_that_of_an_integrator():
    """The true motion in a storm against scipy, with the sample's load and current."""
    solve_ivp = pytest.importorskip("scipy.integrate").solve_ivp
    scenario = replace(STORM, control_dt=0.02, steps=100, actuators=Actuators())
    env = UnderactuatedAUVTrack3DEnv(scenario)
    env.reset(seed=2)
    for _ in range(20):
        plant, _, p = env._truth()
        state = np.array(plant[:10])
        env.step(np.array([0.4, -0.3, 0.2], dtype=np.float32))
        after, sample, _ = env._truth()
        X, Y, Z, M, N = sample[SPACE.load_rows]
        load = X + 0.4 * 400, Y, Z, M - 0.3 * 200, N + 0.2 * 200
        row = p.coefficients.row()
        current = env.current

        def rates(_, s, load=load, row=row, current=current):
            return state_rates(s, load, row, current)

        end = solve_ivp(rates, (0, 0.02), state, rtol=1e-10, atol=1e-12).y[:, -1]
        np.testing.assert_allclose(after[:10], end, rtol=1e-5, atol=2e-6)


def test_the_observation_has_the_errors_of_the_measured_state():
    env = UnderactuatedAUVTrack3DEnv(CALM)
    observation, _ = env.reset(seed=1)
    o, state, R = decode_observation(observation, space=True), env.state, env.reference
    np.testing.assert_allclose(o[:10], tracking_errors(state, R[:10]), atol=1e-12)
    assert o.depth == -state[2]
    assert (o.theta_R, o.F_qR) == (R.theta, R.F_q)
    assert (o.cos_theta, o.sin_psi) == pytest.approx((math.cos(state[3]), math.sin(state[4])))


def test_waves_decay_with_depth():
    """Those of a component with w^2 / g; the amplitudes are those of the plane at the surface."""
    episode = STORM.draw(np.random.default_rng(0))
    rows = exogenous.wave_components(episode.waves, 0.1, SPACE)
    angles = np.array(episode.waves.frequencies)
    np.testing.assert_allclose(rows[:, -1], angles**2 / 9.81)
    at = {depth: exogenous.with_wave([0.0] * 5, 7.0, rows[0].tolist(), FLOATS, depth) for depth in (0.0, 5.0)}
    np.testing.assert_allclose(at[5.0], np.array(at[0.0]) * math.exp(-5 * rows[0, -1]))
    surge, sway, heave, pitch, yaw = episode.waves.forces
    assert (heave, pitch) == (sway, yaw)
    assert surge > 0


def test_a_current_turns_and_weakens_with_depth():
    env = UnderactuatedAUVTrack3DEnv(SPACE_PRESETS["space-current"])
    env.reset(seed=3)
    episode = replace(
        env.scenario.draw(np.random.default_rng(3)), current=Current(V_x=0.3, V_z=0.02), profile=(-10.0, 0.05, 0.02)
    )
    env.reset(options={"episode": episode})
    up = env.state[2] + 10.0
    share = 0.3 * math.exp(0.02 * up)
    np.testing.assert_allclose(
        env.current, [share * math.cos(0.05 * up), share * math.sin(0.05 * up), 0.02], rtol=1e-12
    )


def test_an_episode_ends_at_the_surface_and_at_the_largest_pitch():
    path = WithHeight(Circle(1.0, 0.05), Climb(0.0), -0.5)
    env = UnderactuatedAUVTrack3DEnv(replace(CALM, path=path, lost_distance=1e3))
    env.reset(options={"initial_error": (0, 0, 0, -0.5, 0), "initial_velocity": (1.0, 0, 0, 0, 0)})
    while not env.step(np.array([1.0, 0.0, 0.0]))[2]:
        assert env.state[2] <= 0
    assert env.state[2] > 0
    deep = UnderactuatedAUVTrack3DEnv(replace(CALM, path=replace(path, z0=-50.0), lost_distance=1e3))
    deep.reset(seed=0)
    while not deep.step(np.array([0.2, 1.0, 0.0]))[2]:
        pass
    assert abs(deep.state[3]) > math.radians(80)


def test_corrections_of_the_law():
    """Compiled into the step, and around it, for one vehicle and for many."""
    law, rng = SpaceBackstepping(), np.random.default_rng(1)

    class Around(SpaceBackstepping):
        def predict(self, observation, state=None, episode_start=None, deterministic=True):
            return super().predict(observation, state, episode_start, deterministic)

    one = ResidualAction(UnderactuatedAUVTrack3DEnv(STORM), law, (0.3, 0.2, 0.1))
    many = VectorResidualAction(UnderactuatedAUVTrack3DVectorEnv(3, STORM), law, (0.3, 0.2, 0.1))
    around = ResidualAction(UnderactuatedAUVTrack3DEnv(STORM), Around(), (0.3, 0.2, 0.1))
    seen, together, other = one.reset(seed=5)[0], many.reset(seed=5)[0], around.reset(seed=5)[0]
    assert seen.shape == (34,)
    for _ in range(40):
        np.testing.assert_array_equal(seen, together[0])
        np.testing.assert_allclose(other, seen, rtol=1e-6, atol=1e-6)
        action = rng.uniform(-1, 1, 3)
        seen, together, other = one.step(action)[0], many.step(np.tile(action, (3, 1)))[0], around.step(action)[0]
    with pytest.raises(ValueError, match="or one each for surge, pitch and yaw"):
        ResidualAction(UnderactuatedAUVTrack3DEnv(STORM), law, (0.3, 0.2))
    registered = gym.make("UnderactuatedAUVTrackResidual3D-space-storm-v0", authority=0.3)
    assert registered.reset(seed=0)[0].shape == (34,)


@pytest.mark.parametrize(
    "path", [Trefoil(8.0, 3.0, 0.02, z0=-20.0), WithHeight(Circle(1.0, 0.03), Steps(((20.0, 5.0),), 6.0), -20.0)]
)
def test_records_give_the_same_scenario(path, tmp_path):
    scenario = replace(STORM, name="mine", path=path)
    assert Scenario.from_dict(json.loads(json.dumps(scenario.to_dict()))) == scenario
    for suffix in ("json", "toml"):
        scenario.save(file := tmp_path / f"mine.{suffix}")
        assert Scenario.load(file) == scenario
    UnderactuatedAUVTrack3DEnv(scenario).reset(seed=0)


@pytest.mark.parametrize("vehicle", VEHICLES)
def test_the_presets_fit_other_vehicles(vehicle):
    """Their climbs respect the fins; both planes of the true vehicle have the same factors, and the same start."""
    scenario = as_scenario(f"space-mismatch@{vehicle}")
    theirs, above, level = SPACE_PRESETS["space-mismatch"], scenario.vertical, scenario.start
    assert np.divide(above.z_e, theirs.vertical.z_e) == pytest.approx(np.divide(level.x_e, theirs.start.x_e))
    assert np.divide(above.theta_e, theirs.vertical.theta_e) == pytest.approx(
        np.divide(level.psi_e, theirs.start.psi_e)
    )
    env = UnderactuatedAUVTrack3DEnv(scenario)
    env.reset(seed=0)
    known, true = scenario.vertical.vehicle(scenario), scenario.draw(np.random.default_rng(0)).vehicle
    assert known.stiffness > 0
    for name in ("m22", "m33", "d22", "d33"):
        ratio, other = (getattr(true, plane) for plane in ("horizontal", "vertical"))
        ratio, other = (
            getattr(a, name) / getattr(b, name) if getattr(b, name) else 1.0
            for a, b in ((ratio, known.horizontal), (other, known.vertical))
        )
        assert ratio == pytest.approx(other, rel=1e-9)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"path": Trefoil(8.0, 3.0, 0.02), "vertical": None}, "the path is one in space"),
        ({"sensors": Sensors(low_pass=1.0)}, "a scenario in space has none"),
        ({"vertical": 3}, "scenario vertical is 3"),
        ({"control_dt": 0.5}, "an integration step"),
    ],
)
def test_wrong_scenarios_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        replace(STORM, **change)


def test_plane_and_space_are_not_mixed():
    with pytest.raises(ValueError, match="'space-storm' is one in space; make the environment UnderactuatedAUVTrack3D"):
        UnderactuatedAUVTrackEnv("space-storm")
    with pytest.raises(ValueError, match="'cruise-calm' is one in the plane"):
        UnderactuatedAUVTrack3DVectorEnv(2, "cruise-calm")
    env = UnderactuatedAUVTrack3DEnv()
    env.reset(seed=0)
    with pytest.raises(ValueError, match="it must be three finite numbers"):
        env.step(np.zeros(2))
    with pytest.raises(ValueError, match="it must be five finite numbers"):
        env.reset(options={"initial_error": (0, 0, 0)})
    with pytest.raises(ValueError, match="plane' and 'space' cannot run together"):
        SubEnvironments([PRESETS["cruise-calm"], STORM])


def test_revolutions_and_angles_are_those_of_the_plane_in_level_motion():
    """And a positive angle of the planes gives a moment nose down, as large as that of the rudder."""
    scenario = as_scenario("space-calm@remus100")
    deep = ShaftAction(UnderactuatedAUVTrack3DEnv(scenario), "remus100")
    flat = ShaftAction(UnderactuatedAUVTrackEnv(as_scenario("cruise-calm@remus100")), "remus100")
    nu = (1.0, 0.05, 0.02)
    flat.reset(seed=0, options={"initial_velocity": nu})
    level = {"initial_error": (0, 0, 0, 0, 0), "initial_velocity": (nu[0], nu[1], 0, 0, nu[2])}
    deep.reset(seed=0, options=level)
    surge, turn = flat.action(np.array([0.4, 0.3]))
    np.testing.assert_allclose(deep.action(np.array([0.4, 0.0, 0.3])), (surge, 0.0, turn), atol=1e-6)
    fin_q, fin_r = scenario.vertical.fins(scenario.actuators)
    down = deep.action(np.array([0.4, 0.3, 0.0]))[1] * fin_q
    assert down == pytest.approx((turn - flat.action(np.array([0.4, 0.0]))[1]) * fin_r, rel=1e-5)

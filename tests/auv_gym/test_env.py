"""The scalar environment: the interface of Gymnasium and Stable-Baselines3, and the simulation."""

import copy
import itertools
import math
import pickle
import subprocess
import sys
from dataclasses import replace
from functools import partial

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env
from scipy.integrate import solve_ivp
from stable_baselines3.common.env_checker import check_env as sb3_check_env

from auv_gym import decode_observation
from auv_gym.effects import FineReward
from auv_gym.physics.dynamics import state_rates
from auv_gym.planning.paths import PATHS
from auv_gym.scenarios.fitting import changed
from auv_gym.scenarios.names import STEPS
from auv_gym.scenarios.presets import PAPER_SCENARIO, PRESETS
from auv_gym.scenarios.scenario import RandomPath, Scenario
from auv_gym.scenarios.vehicles import vehicle_model
from auv_gym.task.observation import SIZE
from baselines import make_policy
from baselines.control.backstepping import Backstepping

TRACK = "auv_gym:UnderactuatedAUVTrack-v0"
RESIDUAL = "auv_gym:UnderactuatedAUVTrackResidual-v0"
ZERO = np.zeros(2, dtype=np.float32)
FAST = {"family": "line", "speed": 1.0}


def rollout(env, policy, steps, **reset):
    """Return observations, rewards and infos of one run."""
    observation, info = env.reset(**reset)
    log = [(observation, 0.0, info)]
    for _ in range(steps):
        observation, reward, terminated, truncated, info = env.step(policy.predict(observation)[0])
        log.append((observation, reward, info))
        if terminated or truncated:
            break
    return log


@pytest.mark.parametrize("scenario", ["paper-circle", "cruise-storm"])
@pytest.mark.filterwarnings("ignore:.*is different from the unwrapped version")  # the residual environment is a wrapper
# The checkers reset without a seed: some drawn speeds are above those at which the default gains are stable.
@pytest.mark.filterwarnings("ignore::baselines.control.backstepping.StabilityWarning")
@pytest.mark.parametrize("env_id", [TRACK, RESIDUAL])
def test_environment_checkers(env_id, scenario):
    env = gym.make(env_id, scenario=scenario)
    check_env(env, skip_render_check=True)
    sb3_check_env(env)


def test_episodes_after_one_seed_differ():
    env = gym.make(TRACK, scenario="cruise-storm")
    assert (env.reset(seed=1)[0] != env.reset()[0]).any()


def test_info_keys_are_constant_and_observations_inside():
    env = gym.make(TRACK, scenario="cruise-storm")
    for observation, _, info in rollout(env, make_policy("backstepping"), 2000, seed=0):
        assert set(info) == {"position_error", "saturated", "time"}
        assert env.observation_space.contains(observation)
    assert info["time"] == pytest.approx(env.unwrapped.scenario.duration)


def test_truncation_after_the_steps_of_the_scenario():
    env = gym.make(TRACK, scenario={"steps": 3, "lost_distance": 60.0})
    with pytest.raises(ResetNeeded):
        env.step(ZERO)
    env.reset(seed=0)
    assert [env.step(ZERO)[2:4] for _ in range(3)] == [(False, False), (False, False), (False, True)]
    with pytest.raises(ResetNeeded):
        env.step(ZERO)


def test_the_spec_has_the_length_of_episodes():
    from gymnasium.wrappers import TimeAwareObservation

    assert gym.make(TRACK, scenario="slow-calm").spec.max_episode_steps == 600
    assert TimeAwareObservation(gym.make(TRACK)).reset(seed=0)[0].shape == (SIZE + 1,)
    again = gym.make(gym.make(TRACK, scenario="slow-calm").spec)
    env = gym.make(TRACK, scenario="slow-calm", max_episode_steps=5)
    assert (again.spec.max_episode_steps, env.spec.max_episode_steps) == (600, 5)
    env.reset(seed=0)
    assert [env.step(np.zeros(2))[3] for _ in range(5)] == [False] * 4 + [True]


def test_termination_beyond_the_lost_distance():
    env = gym.make(TRACK)
    env.reset(seed=0, options={"initial_error": (-9.99, 0.0, 0.0)})
    log = [env.step(ZERO) for _ in range(1)]
    while not log[-1][2]:
        log.append(env.step(ZERO))
    assert log[-1][4]["position_error"] > 10.0
    assert all(step[4]["position_error"] <= 10.0 for step in log[:-1])


def test_zero_error_is_possible_in_calm_water():
    """A vehicle that starts on the plan stays on it with the forces of the plan, held over each period."""
    env = gym.make(TRACK, control_dt=0.01)
    log = rollout(env, make_policy("backstepping", gains="paper"), 2000, seed=0, options=on_the_plan(env))
    assert max(info["position_error"] for _, _, info in log) < 1e-5


def on_the_plan(env):
    env.reset(seed=0)
    reference = env.unwrapped.reference
    return {"initial_error": (0, 0, 0), "initial_velocity": (reference.u, reference.v, reference.r)}


def test_a_run_agrees_with_a_tight_integrator():
    """Action, dynamics and time, compared with DOP853 with forces held over each period."""
    env = gym.make(TRACK, scenario="cruise-current", control_dt=0.05)
    env.reset(seed=3)
    raw = env.unwrapped
    c, s = math.cos(raw.state[2]), math.sin(raw.state[2])
    V_x, V_y = raw.current
    relative = raw.state - np.array([0, 0, 0, c * V_x + s * V_y, c * V_y - s * V_x, 0])
    rng = np.random.default_rng(0)
    for _ in range(100):
        action = rng.uniform(-0.3, 0.3, 2).astype(np.float32)
        load = (400.0 * float(action[0]), 0.0, 200.0 * float(action[1]))
        coefficients = raw.scenario.vehicle.coefficients
        relative = solve_ivp(
            lambda t, y, load=load, k=coefficients: state_rates(tuple(y), load, k, (V_x, V_y)),
            (0, 0.05),
            relative,
            method="DOP853",
            rtol=1e-12,
            atol=1e-12,
        ).y[:, -1]
        env.step(action)
    assert raw.state[[0, 1, 2, 5]] == pytest.approx(relative[[0, 1, 2, 5]], abs=2e-5)
    assert raw.time == pytest.approx(5.0)


def test_observation_is_the_tracking_error_in_calm_water():
    env = gym.make(TRACK, scenario="cruise-calm")
    env.reset(seed=1)
    for _ in range(20):
        o = decode_observation(env.step(np.array([0.5, 0.1], dtype=np.float32))[0])
    state, reference = env.unwrapped.state, env.unwrapped.reference
    c, s = math.cos(state[2]), math.sin(state[2])
    x_e, y_e = state[:2] - np.array(reference[:2])
    assert (o.e_x, o.e_y) == pytest.approx((c * x_e + s * y_e, c * y_e - s * x_e))
    assert (o.u_e, o.v_e, o.r_e) == pytest.approx(tuple(state[3:] - np.array(reference[3:6])))
    assert (o.u_R, o.v_R, o.r_R, o.F_uR, o.F_rR) == pytest.approx(reference[3:])
    assert math.remainder(o.psi_e - (state[2] - reference.psi), 2 * math.pi) == pytest.approx(0, abs=1e-12)
    assert (o.a_u, o.a_r, o.F_u_max, o.F_r_max) == pytest.approx((0.5, 0.1, 400.0, 200.0))


def test_actions_beyond_the_box_are_clipped_and_reported():
    env = gym.make(TRACK)
    env.reset(seed=0)
    assert env.step(np.array([3.0, 0.0]))[4]["saturated"]
    assert env.unwrapped.force == pytest.approx([400.0, 0.0])
    assert not env.step(np.array([0.9, 0.0]))[4]["saturated"]


@pytest.mark.parametrize(
    "action",
    [
        np.array([np.nan, 0]),
        np.array([0, np.inf]),
        np.array([0, -np.inf], dtype=np.float32),
        np.zeros(3),
        np.zeros((1, 2)),
        np.ma.array([0.1, 0.2], mask=[False, True]),
        None,
        "ab",
        [True, False],
        1.0,
    ],
)
@pytest.mark.parametrize("env_id", [TRACK, RESIDUAL])
def test_bad_actions_change_nothing(env_id, action):
    env = gym.make(env_id, scenario="cruise-storm")
    env.reset(seed=0)
    before, time = env.unwrapped.state, env.unwrapped.time
    with pytest.raises(ValueError, match=r"^action is [^\n]*; it must be two finite numbers"):
        env.step(action)
    assert (env.unwrapped.state == before).all()
    assert env.unwrapped.time == time


@pytest.mark.parametrize("action", [[0.5, -0.5], (0.5, -0.5), np.array([0.5, -0.5]), np.array([0.5, -0.5], np.float16)])
def test_actions_may_be_any_sequence_of_two_numbers(action):
    env, twin = (gym.make(TRACK, scenario="cruise-storm") for _ in range(2))
    for e in (env, twin):
        e.reset(seed=0)
    np.testing.assert_array_equal(env.step(action)[0], twin.step(np.array([0.5, -0.5], dtype=np.float32))[0])


@pytest.mark.parametrize(
    ("reset", "message"),
    [
        ({"seed": 1, "options": {"wind": 3}}, "unknown reset option 'wind'; allowed are"),
        ({"options": {"initial_error": [10**400, 0, 0]}}, "reset option initial_error is .* three finite numbers"),
        ({"options": "x"}, "reset options are 'x'; they must be a dict or None"),
        ({"options": {"episode": 3}}, "reset option episode is 3"),
        ({"seed": True}, "seed is True; it must be an integer of at least 0, or None"),
        ({"seed": 1.5}, "seed is 1.5"),
        ({"seed": -1}, "seed is -1"),
        ({"seed": 7, "options": {"initial_velocity": (1e5, 0, 0)}}, "an integration step, control_dt / substeps, is"),
    ],
)
def test_a_refused_reset_changes_nothing(reset, message):
    """The episode continues, and the next episode is the same as without the refused reset."""
    env, twin = (gym.make(TRACK, scenario="cruise-storm", render_mode="rgb_array") for _ in range(2))
    for e in (env, twin):
        e.reset(seed=0)
        e.step(ZERO)
    with pytest.raises(ValueError, match=rf"^{message}[^\n]*$"):
        env.reset(**reset)
    for _ in range(3):
        np.testing.assert_array_equal(env.render(), twin.render())
        a, b = env.step(ZERO), twin.step(ZERO)
        np.testing.assert_array_equal(a[0], b[0])
        assert a[1:] == b[1:]
    np.testing.assert_array_equal(env.reset()[0], twin.reset()[0])


@pytest.mark.parametrize("env_id", [TRACK, RESIDUAL])
@pytest.mark.parametrize("copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))], ids=["deep", "pickle"])
def test_copies_are_independent_also_after_rendering(env_id, copied):
    env = (
        gym.make(env_id, scenario="cruise-storm", render_mode="rgb_array", preview=(3,))
        if env_id == TRACK
        else (gym.make(env_id, scenario="cruise-storm", render_mode="rgb_array"))
    )
    env.reset(seed=3)
    for _ in range(60):
        env.step(ZERO)
    env.render()
    twin = copied(env)
    action = np.array([0.3, -0.2], dtype=np.float32)
    expected = [env.step(action) for _ in range(70)]  # until the next block of samples
    picture, after = env.render(), env.reset()[0]
    for step in expected:
        found = twin.step(action)
        np.testing.assert_array_equal(found[0], step[0])
        assert found[1:] == step[1:]
    assert twin.render().shape == picture.shape  # the copy has a new camera, which can have another position
    np.testing.assert_array_equal(twin.reset()[0], after)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"scenario": "hurricane"}, "unknown scenario 'hurricane'; allowed are"),
        ({"scenario": {"path": {"family": "circle", "speed": 1.0, "turn_rate": 7.9}}}, "infeasible|reference"),
        ({"vehicle": "ship"}, "unknown vehicle 'ship'"),
        ({"control_dt": math.nan}, "control_dt is nan"),
        ({"scenario": {"actuators": {"F_u_max": 10.0}, "path": FAST}}, r"F_u = .* N is beyond its limit of 10 N"),
    ],
)
def test_bad_arguments_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        gym.make(TRACK, **arguments)


def test_videos_without_a_display(tmp_path):
    env = gym.make(TRACK, scenario="cruise-storm", render_mode="rgb_array")
    video = gym.wrappers.RecordVideo(env, str(tmp_path / "video"), episode_trigger=lambda _: True, video_length=10)
    rollout(video, make_policy("backstepping"), 12, seed=0)
    video.close()
    assert [file.suffix for file in (tmp_path / "video").iterdir()] == [".mp4"]


def test_rendering_before_reset_or_without_a_mode():
    with pytest.raises(ResetNeeded, match=r"call reset\(\) before render"):
        gym.make(TRACK, render_mode="rgb_array").render()
    with pytest.warns(UserWarning, match="render_mode"):
        assert gym.make(TRACK).render() is None


STORM = replace(PRESETS["slow-storm"], steps=7)


@pytest.mark.parametrize("mode", ["scalar", "sync", "vector_entry_point"])
@pytest.mark.parametrize(
    ("scenario", "vehicle"),
    [
        (STORM, "paper"),
        (STORM.to_dict(), None),
        (replace(PAPER_SCENARIO, steps=7), None),
        (changed(PRESETS["cruise-storm"], "otter"), None),
        (PRESETS["cruise-storm"], vehicle_model("remus100")),
        (replace(STORM, effects=(FineReward(0.5, 0.01),)), None),
    ],
    ids=["object", "dict", "fixed path", "adapted", "vehicle model", "effect"],
)
def test_arguments_in_the_json_of_the_spec(scenario, vehicle, mode):
    make = gym.make if mode == "scalar" else partial(gym.make_vec, num_envs=2, vectorization_mode=mode)
    env = make(TRACK, scenario=scenario, vehicle=vehicle, control_dt=0.1)
    again = make(EnvSpec.from_json(env.spec.to_json()))
    np.testing.assert_array_equal(again.reset(seed=3)[0], env.reset(seed=3)[0])
    scenarios = [
        (e.scenarios if mode[0] == "v" else e.get_wrapper_attr("scenario"))
        for e in (e.envs[0] if mode == "sync" else e for e in (env, again))
    ]
    assert scenarios[0] == scenarios[1]


def test_a_list_of_scenarios_in_the_json_of_the_spec():
    scenarios = [replace(changed(STORM, name), substeps=8) for name in ("otter", "cybership2")]
    env = gym.make_vec(TRACK, 2, "vector_entry_point", scenario=scenarios)
    again = gym.make_vec(EnvSpec.from_json(env.spec.to_json()))
    assert again.scenarios == env.scenarios
    assert [one.known for one in again.scenarios] == [vehicle_model("otter"), vehicle_model("cybership2")]


def test_an_episode_can_be_run_again():
    scenario = PRESETS["cruise-storm"]
    episode = scenario.draw(np.random.default_rng(7))
    env = gym.make(TRACK, scenario=scenario)
    first, again = (env.reset(options={"episode": episode})[0] for _ in range(2))
    assert (first == again).all()


def test_user_paths_work():
    class Wavy:
        speed, start, end = 0.5, -math.inf, math.inf

        def derivatives(self, t):
            w = 0.1
            s, c = np.sin(w * t), np.cos(w * t)
            return np.array([[0.5 * t, s], [0.5 + 0 * t, w * c], [0 * t, -(w**2) * s], [0 * t, -(w**3) * c]])

    env = gym.make(TRACK, scenario=Scenario(path=Wavy(), steps=300))
    assert rollout(env, make_policy("backstepping"), 300, seed=0)[-1][2]["position_error"] < 0.05


def test_every_random_family_is_feasible_over_many_draws():
    families = tuple(name for name, cls in PATHS.items() if hasattr(cls, "drawn"))
    scenario = Scenario(path=RandomPath((0.5, 1.5), 0.12, families), steps=600)
    env = gym.make(TRACK, scenario=scenario)
    for seed in range(60):
        assert np.isfinite(env.reset(seed=seed)[0]).all()


def test_residual_correction_is_bounded_by_its_authority():
    env = gym.make(RESIDUAL, authority=(0.1, 0.2))
    base = env.reset(seed=0)[0][SIZE:]
    env.step(np.array([5.0, -1.0], dtype=np.float32))
    expected = np.clip(base + np.array([0.1, -0.2]), -1, 1) * (400.0, 200.0)
    assert env.unwrapped.force == pytest.approx(expected)


@pytest.mark.parametrize("authority", [0, -1, (1,), np.ones(3), "much", math.nan])
def test_impossible_authority_is_refused(authority):
    with pytest.raises(ValueError, match="authority is"):
        gym.make(RESIDUAL, authority=authority)


@pytest.mark.parametrize(
    ("expert", "message"),
    [
        ("oracle", "'oracle' uses more than the observation"),
        ("captain", r"unknown policy 'captain'; allowed are backstepping"),
        (3, "expert is 3; it must be the name of a policy"),
        (Backstepping, "it must be the name of a policy, or an object with the method predict"),
    ],
)
def test_what_cannot_be_an_expert_is_refused(expert, message):
    with pytest.raises(ValueError, match=message):
        gym.make(RESIDUAL, expert=expert)


def test_each_preset_has_an_id_with_its_length():
    assert {name: scenario.steps for name, scenario in PRESETS.items()} == STEPS
    for task in (TRACK, RESIDUAL):
        for name, steps in STEPS.items():
            env_id = f"{task[:-3]}-{name}-v0"
            assert gym.spec(env_id[8:]).kwargs == {"scenario": name}
            assert gym.make(env_id).spec.max_episode_steps == steps
        of_preset, options = f"{task[:-3]}-slow-calm-v0", {"num_envs": 2, "vectorization_mode": "vector_entry_point"}
        for env, same in (
            (gym.make(of_preset), gym.make(task, scenario="slow-calm")),
            (gym.make_vec(of_preset, **options), gym.make_vec(task, scenario="slow-calm", **options)),
        ):
            assert (env.reset(seed=4)[0] == same.reset(seed=4)[0]).all()
            assert env.spec.max_episode_steps == 600


@pytest.mark.parametrize(
    ("options", "steps"),
    [
        ({"control_dt": 0.05}, 1200),
        ({"scenario": replace(PRESETS["cruise-calm"], steps=700)}, 700),
        ({"max_episode_steps": 5}, 5),
        ({"control_dt": 0.05, "max_episode_steps": 5}, 5),
    ],
    ids=str,
)
def test_an_id_of_a_preset_cuts_no_episode_of_other_arguments(options, steps):
    env_id = "auv_gym:UnderactuatedAUVTrack-cruise-calm-v0"
    env = gym.make(env_id, **options)
    env.reset(seed=0)
    assert next(k for k in itertools.count(1) if env.step(ZERO)[3]) == steps
    vector = gym.make_vec(env_id, 2, "vector_entry_point", **options)
    assert env.spec.max_episode_steps == vector.spec.max_episode_steps == steps


def test_import_is_light_and_registers_the_ids_once():
    heavy = "torch", "stable_baselines3", "pygame", "matplotlib", "scipy", "auv_gym.scenarios.scenario"
    code = (
        "import importlib, sys, auv_gym; importlib.reload(auv_gym); import gymnasium; "
        f"gymnasium.spec('UnderactuatedAUVTrack-v0'); print([m for m in {heavy} if m in sys.modules])"
    )
    run = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout == "[]\n"

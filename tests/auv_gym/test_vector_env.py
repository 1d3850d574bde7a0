"""The vector environment: comparison with scalar environments, interface of Gymnasium, residual wrapper."""

import importlib
import re
import subprocess
import sys

import gymnasium as gym
import numpy as np
import pytest
from back_ends import assert_equals_scalars
from gymnasium.error import ResetNeeded
from marks import slow_except

from auv_gym.envs.sub_environments import SubEnvironments, plan_of, planner_of, reference_table
from auv_gym.scenarios.exogenous import ExogenousInputs
from auv_gym.scenarios.presets import PRESETS
from auv_gym.scenarios.scenario import Scenario
from baselines import make_policy
from baselines.control.backstepping import Backstepping

wrappers = pytest.importorskip("gymnasium.wrappers.vector")  # since Gymnasium 1.0
TRACK = "auv_gym:UnderactuatedAUVTrack-v0"
RESIDUAL = "auv_gym:UnderactuatedAUVTrackResidual-v0"
SHORT = {name: {**scenario.to_dict(), "steps": 100} for name, scenario in PRESETS.items()}
FILTERED = {**SHORT["cruise-storm"], "name": "filtered", "sensors": {"position": 0.05, "low_pass": 1.0}}
MIXED = [*SHORT.values(), FILTERED]


def vector(env_id=TRACK, n=3, **options):
    return gym.make_vec(env_id, num_envs=n, vectorization_mode="vector_entry_point", **options)


def test_equals_scalar_environments_over_every_preset_across_autoresets():
    scalars = [gym.make(TRACK, scenario=scenario) for scenario in MIXED]
    assert assert_equals_scalars(vector(n=len(MIXED), scenario=MIXED), scalars, 230) >= 2 * len(MIXED)


def test_accessors_equal_the_scalar_environments():
    env, scalar = vector(scenario="cruise-storm").unwrapped, gym.make(TRACK, scenario="cruise-storm").unwrapped
    with pytest.raises(ResetNeeded):
        env.state  # noqa: B018
    env.reset(seed=4)
    scalar.reset(seed=5)
    for _ in range(80):
        env.step(np.full((3, 2), 0.1))
        scalar.step(np.full(2, 0.1))
    for name in ("state", "force", "current", "time"):
        np.testing.assert_allclose(getattr(env, name)[1], getattr(scalar, name), rtol=0, atol=1e-12)
    np.testing.assert_allclose([row[1] for row in env.reference], scalar.reference, rtol=0, atol=1e-12)


def test_seeds_as_an_integer_a_list_or_none():
    env = vector(scenario="cruise-storm")
    by_integer = env.reset(seed=3)[0]
    assert (env.reset(seed=[3, 4, 5])[0] == by_integer).all()
    assert (env.reset()[0] != by_integer).any(axis=1).all()
    assert ((env.reset(seed=[3, None, 5])[0] == by_integer).all(axis=1) == (True, False, True)).all()
    with pytest.raises(ValueError, match="2 entries"):
        env.reset(seed=[1, 2])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("x", "reset options are 'x'; they must be a dict or None"),
        ({"initial_error": [10**400, 0, 0]}, "reset option initial_error is .* three finite numbers"),
        ({"wind": 3}, "unknown reset option 'wind'"),
    ],
)
def test_wrong_options_are_refused_in_one_line(options, message):
    with pytest.raises(ValueError, match=rf"^{message}[^\n]*$"):
        vector().reset(seed=0, options=options)


def test_masked_actions_are_refused():
    env = vector()
    env.reset(seed=0)
    actions = np.ma.array(np.zeros((3, 2)), mask=[[False, False], [False, True], [False, False]])
    with pytest.raises(ValueError, match=r"^action of sub-environment 1 is [^\n]*; it must be two finite numbers"):
        env.step(actions)
    env.step(np.ma.array(np.zeros((3, 2))))


@pytest.mark.parametrize("env_id", [TRACK, RESIDUAL])
@pytest.mark.parametrize("preview", [(), (2, 5)])
def test_returned_arrays_are_in_c_order_and_share_no_memory(env_id, preview):
    options = {"preview": preview} if env_id == TRACK else {}
    env = vector(env_id, scenario={**SHORT["cruise-storm"], "steps": 3}, **options)
    returned = [env.reset(seed=0), *(env.step(np.zeros((3, 2), dtype=np.float32)) for _ in range(3))]
    assert "final_obs" in returned[-1][-1]
    for observation, *rest, info in returned:
        assert observation.flags.c_contiguous
        final = info.get("final_info", {})
        arrays = [observation, *rest, *info.values(), *final.values()]
        arrays = [array for array in arrays if isinstance(array, np.ndarray)]
        assert len(arrays) == len({array.__array_interface__["data"][0] for array in arrays})


def test_wrong_seeds_have_the_same_error_in_all_environments():
    for env in (vector(), gym.make(TRACK)):
        for seed in (1.7, -1, True, "a", np.float64(3)):
            with pytest.raises(ValueError, match=re.escape(f"seed is {seed!r}; it must be an integer of at least 0")):
                env.reset(seed=seed)
        env.reset(seed=np.int64(3))
    assert (vector().reset(seed=list(np.arange(3)))[0] == vector().reset(seed=0)[0]).all()


@pytest.mark.parametrize("env_id", [TRACK, RESIDUAL])
def test_returned_observations_are_copies(env_id):
    env, twin = (vector(env_id, scenario="cruise-storm") for _ in range(2))
    mask = np.array([True, False, False])
    for action in (None, 0.1, 0.2):
        step = [e.reset(seed=0) if action is None else e.step(np.full((3, 2), action)) for e in (env, twin)]
        assert (step[0][0] == step[1][0]).all()
        step[0][0][:] = 1e3
    assert (env.reset(options={"reset_mask": mask})[0] == twin.reset(options={"reset_mask": mask})[0]).all()


# Fast turns in a wide range of speeds: about a quarter of the draws is infeasible.
HARD = {
    "name": "hard",
    "path": {"speed": [0.2, 1.5], "turn_rate": 0.5, "families": ["circle", "sine"]},
    "actuators": {"F_u_max": 160.0, "F_r_max": 60.0},
    "control_dt": 0.1,
    "steps": 25,
}


def test_infeasible_draws_are_repeated_alike_in_all_environments():
    scenario, rng = Scenario.from_dict(HARD), np.random.default_rng(0)
    planner = planner_of(*plan_of(scenario))
    assert 3 < sum(planner.table(scenario.draw(rng).path) is None for _ in range(40)) < 20
    n = 12
    scalars = [gym.make(TRACK, scenario=HARD) for _ in range(n)]
    assert assert_equals_scalars(vector(n=n, scenario=HARD), scalars, 80) >= 3 * n


@pytest.mark.parametrize("n", [3, 7])  # drawn one by one, and as rows
@pytest.mark.parametrize("backend", slow_except(["numpy"], ["numpy", "torch"]))
def test_an_infeasible_episode_changes_nothing(backend, n, monkeypatch):
    if backend == "torch":
        pytest.importorskip("torch")
    options = {"dtype": "float64"} if backend == "torch" else {}
    env = vector(n=n, scenario={**SHORT["cruise-storm"], "steps": 70}, backend=backend, **options)
    env.reset(seed=0)
    actions = np.full((n, 2), 0.05)
    for _ in range(69):
        env.step(actions)

    def infeasible(*_, **__):
        raise ValueError("infeasible")

    sub_envs = env.unwrapped._sub_envs
    with monkeypatch.context() as patch:
        patch.setattr("auv_gym.envs.sub_environments.reference_table", infeasible)
        patch.setattr("auv_gym.planning.planner.Planner.tables", lambda _, __, count: [None] * count)
        time, states = sub_envs.time, [g.bit_generator.state for g in sub_envs._generators]
        for _ in range(2):
            with pytest.raises(ValueError, match="infeasible"):
                env.step(actions)
        assert (sub_envs.time == time).all()
        assert [g.bit_generator.state for g in sub_envs._generators] == states
        with pytest.raises(ValueError, match="infeasible"):
            env.reset(options={"reset_mask": np.arange(n) == 0})
    *_, truncated, _ = env.step(actions)
    assert truncated.all()


def test_reset_mask_resets_only_these():
    env = vector(scenario="cruise-storm")
    with pytest.raises(ValueError, match="first reset"):
        env.reset(options={"reset_mask": np.array([True, False, False])})
    env.reset(seed=0)
    before = env.step(np.zeros((3, 2)))[0]
    mask = np.array([False, True, False])
    after, info = env.reset(options={"reset_mask": mask})
    assert (after[~mask] == before[~mask]).all()
    assert (after[mask] != before[mask]).any()
    assert (env.unwrapped.time > 0).tolist() == [True, False, True]
    assert (info["_time"] == mask).all()


def test_reset_options_for_all_or_for_each():
    env = vector()
    assert env.reset(options={"initial_error": (3.0, 4.0, 0.0)})[1]["position_error"].tolist() == [5.0] * 3
    errors = np.array([[1.0, 0, 0], [2.0, 0, 0], [3.0, 0, 0]])
    assert env.reset(options={"initial_error": errors})[1]["position_error"].tolist() == [1.0, 2.0, 3.0]
    episodes = [PRESETS["paper-circle"].draw(np.random.default_rng(1))] * 3
    first = env.reset(options={"episode": episodes})[0]
    assert (first == first[0]).all()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"wind": 1.0}, "unknown reset option 'wind'; allowed are episode, initial_error, initial_velocity"),
        ({"initial_error": np.zeros((2, 3))}, "must have 3 entries"),
        ({"initial_error": 1.0}, "must have 3 entries"),
        ({"initial_error": np.full((3, 3), np.nan)}, "three finite numbers"),
        ({"reset_mask": np.zeros(3, dtype=bool)}, "with a True"),
        ({"reset_mask": np.ones(2, dtype=bool)}, r"boolean array \(3,\)"),
    ],
)
def test_bad_reset_options_change_nothing(options, message):
    env, twin = vector(scenario="cruise-storm"), vector(scenario="cruise-storm")
    for e in (env, twin):
        e.reset(seed=2)
    with pytest.raises(ValueError, match=message):
        env.reset(options=options)
    for _ in range(3):
        assert (env.step(np.zeros((3, 2)))[0] == twin.step(np.zeros((3, 2)))[0]).all()


@pytest.mark.parametrize("env_id", [TRACK, RESIDUAL])
@pytest.mark.parametrize(
    ("actions", "message"),
    [
        (np.zeros((2, 2)), r"shape \(2, 2\)"),
        (np.zeros(2), r"shape \(2,\)"),
        (np.array([["a", "b"]] * 3), "type <U1"),
        (np.array([[0, 0], [0, 0], [np.nan, 0]]), "sub-environment 2"),
        (np.array([[0, 0], [np.inf, 0], [0, 0]]), "sub-environment 1"),
    ],
)
def test_bad_actions_advance_nothing(env_id, actions, message):
    env, twin = vector(env_id, scenario="cruise-storm"), vector(env_id, scenario="cruise-storm")
    for e in (env, twin):
        e.reset(seed=2)
    with pytest.raises(ValueError, match=message):
        env.step(actions)
    assert (env.step(np.zeros((3, 2)))[0] == twin.step(np.zeros((3, 2)))[0]).all()


def test_step_before_reset_is_refused():
    with pytest.raises(ResetNeeded):
        vector().step(np.zeros((3, 2)))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"n": 0}, "num_envs is 0"),
        ({"backend": "jax"}, "unknown backend 'jax'; allowed are 'numpy' and 'torch'"),
        ({"device": "cuda"}, "options of backend='torch'"),
        ({"render_mode": "human"}, "does not draw"),
        ({"scenario": ["paper-circle"]}, "1 scenarios are given for 3"),
        ({"scenario": "storm"}, "unknown scenario"),
        ({"scenario": [{"substeps": 2}, "paper-circle", "paper-circle"]}, "different substeps"),
    ],
)
def test_bad_arguments_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        vector(**arguments)


def test_message_of_missing_torch(monkeypatch):
    monkeypatch.setattr(importlib.import_module("auv_gym.envs"), "find_spec", lambda _: None)
    with pytest.raises(ImportError, match="pip install"):
        vector(backend="torch")


@pytest.mark.parametrize("env_id", [TRACK, RESIDUAL])
@pytest.mark.parametrize(
    "wrap",
    [
        wrappers.RecordEpisodeStatistics,
        wrappers.DictInfoToList,
        wrappers.NormalizeReward,
        wrappers.ClipAction,
        lambda env: wrappers.ClipReward(env, 0.0, 0.5),
        lambda env: wrappers.RescaleAction(env, np.float32(-2), np.float32(2)),
    ],
)
def test_gymnasiums_vector_wrappers_run(env_id, wrap):
    """The wrappers that accept SAME_STEP, which wrappers of observations do not."""
    env = wrap(vector(env_id, scenario=SHORT["cruise-storm"]))
    env.reset(seed=1)
    actions = np.zeros((3, 2), dtype=np.float32)
    for _ in range(120):
        env.step(actions)


def test_episode_statistics_are_the_sum_of_rewards():
    env = wrappers.RecordEpisodeStatistics(vector(scenario=SHORT["slow-calm"]))
    env.reset(seed=1)
    total = np.zeros(3)
    for _ in range(100):
        _, reward, _, truncated, info = env.step(np.zeros((3, 2), dtype=np.float32))
        total += reward
    assert truncated.all()
    np.testing.assert_allclose(info["episode"]["r"], total, rtol=1e-6)
    assert info["episode"]["l"].tolist() == [100] * 3


class WithMemory:
    """An expert with memory: the backstepping law plus a slow average of the position error."""

    def __init__(self):
        self.law = Backstepping()

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        rows = np.atleast_2d(observation)
        mean = np.zeros((len(rows), 2)) if state is None else np.where(episode_start[:, None], 0.0, state[0])
        mean = 0.9 * mean + 0.1 * rows[:, :2]
        action = np.clip(self.law.predict(rows)[0] - 0.05 * mean, -1, 1).astype(np.float32)
        return (action[0] if observation.ndim == 1 else action), (mean,)


@pytest.mark.parametrize("expert", [Backstepping, WithMemory])
def test_residual_equals_scalar_residual_environments_across_autoresets(expert):
    scenarios = [SHORT["cruise-storm"], SHORT["slow-noise"], SHORT["paper-circle"], FILTERED]
    env = vector(RESIDUAL, n=4, scenario=scenarios, expert=expert())
    scalars = [gym.make(RESIDUAL, scenario=s, expert=expert()) for s in scenarios]
    assert assert_equals_scalars(env, scalars, 220, scale=2.0) >= 8


def test_residual_reset_mask_keeps_the_memory_of_the_others():
    env, twin = (vector(RESIDUAL, scenario="cruise-storm", expert=WithMemory()) for _ in range(2))
    for e in (env, twin):
        e.reset(seed=0)
        for _ in range(5):
            before = e.step(np.zeros((3, 2)))[0]
    mask = np.array([False, True, False])
    after, _ = env.reset(options={"reset_mask": mask})
    assert (after[~mask] == before[~mask]).all()
    ours, theirs = env.step(np.zeros((3, 2)))[0], twin.step(np.zeros((3, 2)))[0]
    assert (ours[~mask] == theirs[~mask]).all()
    assert (ours[mask] != theirs[mask]).any()


def test_zero_residual_is_the_expert():
    expert, env, residual = (
        make_policy("backstepping"),
        vector(scenario="slow-storm"),
        vector(RESIDUAL, scenario="slow-storm"),
    )
    observation, extended = env.reset(seed=1)[0], residual.reset(seed=1)[0]
    for _ in range(50):
        assert (extended[:, :-2] == observation).all()
        observation = env.step(expert.predict(observation)[0])[0]
        extended = residual.step(np.zeros((3, 2), dtype=np.float32))[0]


@pytest.mark.parametrize("name", PRESETS)
def test_exogenous_inputs_do_not_depend_on_blocks(name):
    """Nor on other sub-environments and their order."""
    scenario = PRESETS[name]
    rng = np.random.default_rng(0)
    episodes = [scenario.draw(rng) for _ in range(3)]
    tables = [reference_table(episode.path, *plan_of(scenario)) for episode in episodes]
    all_three, one = ExogenousInputs(3, 64), ExogenousInputs(1, 64)
    for i in range(3):
        all_three.load(i, scenario, episodes[i], tables[i])
    one.load(0, scenario, episodes[1], tables[1])
    samples = np.concatenate([all_three.read((2, 0, 1), 64)[:, :, 2] for _ in range(3)])
    pieces = np.concatenate([one.read((0,), n)[:, :, 0] for n in (1, 2, 61, 5, 40, 19, 64)])
    np.testing.assert_allclose(samples, pieces, rtol=0, atol=1e-12)


def test_noise_is_standard_normal_times_the_sensors():
    """Mean, variance, kurtosis and correlations of about 10^5 numbers, within four standard errors."""
    scenario = PRESETS["slow-noise"]
    envs = SubEnvironments(256, scenario, None, None)
    envs.reset(0, None)
    white = np.concatenate([envs._exogenous.read(envs.all, 64)[:, 13:19] for _ in range(4)])
    z = (white / np.array(scenario.sensors.noise)[:, None]).transpose(1, 0, 2).reshape(6, -1)
    n = z.shape[1]
    assert np.abs(z.mean(axis=1)).max() < 4 / n**0.5
    assert np.abs(z.var(axis=1) - 1).max() < 4 * (2 / n) ** 0.5
    assert np.abs((z**4).mean(axis=1) - 3).max() < 4 * (96 / n) ** 0.5
    assert np.abs(np.corrcoef(z) - np.eye(6)).max() < 4.5 / n**0.5
    assert np.abs((z[:, 1:] * z[:, :-1]).mean(axis=1)).max() < 4.5 / n**0.5


def test_user_scenarios_with_a_fixed_path_share_their_plan():
    envs = SubEnvironments(3, Scenario(steps=50), None, None)
    envs.reset(0, None)
    assert envs._exogenous._tables[0] is envs._exogenous._tables[2]


MEMORY = """
import gymnasium as gym, numpy as np, auv_gym
env = gym.make_vec("UnderactuatedAUVTrack-v0", num_envs=16384, vectorization_mode="vector_entry_point",
                   scenario="cruise-storm")
env.reset(seed=0)
actions = np.zeros((16384, 2), dtype=np.float32)
for _ in range(20):
    env.step(actions)
with open("/proc/self/status") as status:  # ru_maxrss includes the parent process
    print(next(line.split()[1] for line in status if line.startswith("VmHWM")))
"""


@pytest.mark.slow
def test_16384_vehicles_fit_in_a_gibibyte():
    run = subprocess.run([sys.executable, "-c", MEMORY], check=True, capture_output=True, text=True)
    assert int(run.stdout) * 1024 < 2**30


def test_memory_does_not_grow():
    resource = pytest.importorskip("resource")  # not on Windows
    env = vector(n=64, scenario={**PRESETS["cruise-storm"].to_dict(), "steps": 20})
    env.reset(seed=0)
    actions = np.zeros((64, 2), dtype=np.float32)

    def grown(steps):
        for _ in range(steps):
            env.step(actions)
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss

    assert grown(400) - grown(200) <= 0 or grown(200) - grown(200) < 4096  # [KiB]

"""The vector environment: seeds, options of resets, mistakes, memory; see test_contract.py for its episodes."""

import re
import subprocess
import sys

import gymnasium as gym
import numpy as np
import pytest
from contract import together
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import vector as wrappers

from auv_gym.scenarios.presets import PRESETS

TRACK = "auv_gym:UnderactuatedAUVTrack-v0"
RESIDUAL = "auv_gym:UnderactuatedAUVTrackResidual-v0"
STORM = PRESETS["cruise-storm"].to_dict()


def vector(env_id=TRACK, n=3, **options):
    return gym.make_vec(env_id, num_envs=n, vectorization_mode="vector_entry_point", **options)


def test_seeds_as_an_integer_a_list_or_none():
    env = vector(scenario="cruise-storm")
    by_integer = env.reset(seed=3)[0]
    assert (env.reset(seed=[3, 4, 5])[0] == by_integer).all()
    assert (env.reset()[0] != by_integer).any(axis=1).all()
    assert ((env.reset(seed=[3, None, 5])[0] == by_integer).all(axis=1) == (True, False, True)).all()
    with pytest.raises(ValueError, match="2 entries"):
        env.reset(seed=[1, 2])


@pytest.mark.parametrize("env_id", [TRACK, RESIDUAL])
@pytest.mark.parametrize("preview", [(), (2, 5)])
def test_returned_arrays_are_in_c_order_and_share_no_memory(env_id, preview):
    options = {"preview": preview} if env_id == TRACK else {}
    env = vector(env_id, scenario={**STORM, "steps": 3}, **options)
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


@pytest.mark.parametrize("n", [3, 7])  # drawn one by one, and as rows
def test_an_infeasible_episode_changes_nothing(n, monkeypatch):
    env = vector(n=n, scenario={**STORM, "steps": 70})
    env.reset(seed=0)
    actions = np.full((n, 2), 0.05)
    for _ in range(69):
        env.step(actions)

    def infeasible(*_, **__):
        raise ValueError("infeasible")

    sub_envs = env.unwrapped._sub_envs
    with monkeypatch.context() as patch:
        patch.setattr("auv_gym.planning.planner.Planner.table", infeasible)
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
        (np.ma.array(np.zeros((3, 2)), mask=[[False, False], [False, True], [False, False]]), "sub-environment 1"),
    ],
)
def test_bad_actions_advance_nothing(env_id, actions, message):
    env, twin = vector(env_id, scenario="cruise-storm"), vector(env_id, scenario="cruise-storm")
    for e in (env, twin):
        e.reset(seed=2)
    with pytest.raises(ValueError, match=message):
        env.step(actions)
    assert (env.step(np.zeros((3, 2)))[0] == twin.step(np.zeros((3, 2)))[0]).all()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"n": 0}, "num_envs is 0"),
        ({"autoreset_mode": "Later"}, "unknown autoreset_mode 'Later'; allowed are 'NextStep'"),
        ({"max_episode_steps": 0}, "max_episode_steps is 0"),
        ({"render_mode": "human"}, "does not draw"),
        ({"scenario": ["paper-circle"]}, "1 scenarios are given for 3"),
        ({"scenario": "storm"}, "unknown scenario"),
        (
            {"scenario": [{"substeps": 2}, "paper-circle", "paper-circle"]},
            r"scenarios have 1 to 2 substeps; give each replace.scenario, substeps=2\)",
        ),
    ],
)
def test_bad_arguments_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        vector(**arguments)


@pytest.mark.parametrize("mode", ["NextStep", "NEXT_STEP", AutoresetMode.NEXT_STEP])
def test_a_name_of_a_mode_and_the_largest_number_of_steps(mode):
    env = vector(n=2, scenario="slow-calm", autoreset_mode=mode, max_episode_steps=3)
    assert env.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    assert type(env.unwrapped).metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    with pytest.raises(ResetNeeded, match="call reset"):
        env.step(np.zeros((2, 2)))
    with pytest.raises(ResetNeeded):
        env.unwrapped.state  # noqa: B018
    with pytest.raises(ValueError, match="first reset"):
        env.reset(options={"reset_mask": np.array([True, False])})
    env.reset(seed=0)
    ends = [bool(env.step(np.zeros((2, 2), dtype=np.float32))[3].all()) for _ in range(8)]
    assert ends == [False, False, True, False] * 2  # the step after an end resets


@pytest.mark.parametrize("mode", [AutoresetMode.SAME_STEP, AutoresetMode.NEXT_STEP])
@pytest.mark.parametrize(
    "wrap",
    [
        wrappers.RecordEpisodeStatistics,
        wrappers.NormalizeObservation,
        wrappers.ClipAction,
        wrappers.DictInfoToList,
    ],
)
def test_wrappers_of_gymnasium(wrap, mode):
    """Compared with the same wrappers around scalar environments; those of observations refuse SAME_STEP."""
    scenario, options = {**STORM, "steps": 20}, {"autoreset_mode": mode}
    scalars = together([gym.make(TRACK, scenario=scenario) for _ in range(3)], mode)
    try:
        env, other = wrap(vector(scenario=scenario, **options)), wrap(scalars)
    except (AssertionError, ValueError):
        assert mode is AutoresetMode.SAME_STEP
        return
    np.testing.assert_allclose(env.reset(seed=3)[0], other.reset(seed=3)[0], rtol=0, atol=1e-10)
    for _ in range(30):
        actions = np.full((3, 2), 0.2, dtype=np.float32)
        for a, b in zip(env.step(actions)[:4], other.step(actions)[:4], strict=True):
            np.testing.assert_allclose(a, b, rtol=0, atol=1e-10)


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

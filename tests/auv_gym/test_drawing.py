"""Episodes drawn as rows equal those drawn one by one, and their noise equals that of NumPy."""

from dataclasses import replace

import numpy as np
import pytest

from auv_gym.envs.sub_environments import FEWEST_ROWS, ReadyEpisodes, SubEnvironments
from auv_gym.physics.actuators import Actuators
from auv_gym.physics.disturbances import RandomCurrent, RandomMismatch
from auv_gym.physics.sensors import Sensors
from auv_gym.planning.paths import PATHS
from auv_gym.scenarios import exogenous
from auv_gym.scenarios.exogenous import ExogenousInputs
from auv_gym.scenarios.presets import PRESETS, as_scenario
from auv_gym.scenarios.scenario import RandomPath, Start
from auv_gym.task.simulation import NOISE, SAMPLE_ROWS

N, STORM = 3 * FEWEST_ROWS, PRESETS["cruise-storm"]
FAMILIES = tuple(name for name, family in PATHS.items() if hasattr(family, "drawn"))
EVERYTHING = replace(
    STORM,
    name="everything",
    path=RandomPath((0.5, 1.5), 0.12, FAMILIES),
    current=replace(STORM.current, turn=(-0.05, 0.05), shear=(0.0, 0.2), relative=False, speed=(0.1, 0.3)),
    sensors=replace(STORM.sensors, heading_bias=(-0.05, 0.05), velocity_bias=0.01, low_pass=1.0),
    actuators=Actuators(400.0, 200.0, (0.0, 0.7), 900.0, effectiveness=(0.6, 1.0), reach=(0.5, 1.0), delay=(0.0, 3.0)),
    start=Start((0.0, 1.0), 0.5, (0.0, 0.4), (0.3, 1.0), random_signs=True),
)
TIGHT = replace(
    EVERYTHING, name="tight", path=replace(EVERYTHING.path, turn_rate=0.5), actuators=Actuators(160.0, 60.0, 0.2)
)
SCENARIOS = [*PRESETS.values(), EVERYTHING, TIGHT, as_scenario("cruise-storm@lauv"), as_scenario("slow-storm@otter")]


def load(scenario, as_rows, preview=()):
    """Return N sub-environments with loaded episodes, their first states and errors, and their generators."""
    envs = SubEnvironments(N, scenario, None, None, preview)
    generators = [np.random.default_rng(i) for i in range(N)]
    if as_rows:
        ready = envs.ready(envs.all, generators, None)
        assert max(len(part.tables) for part in ready) >= FEWEST_ROWS
    else:
        single = [envs.ready(np.array([i]), generators, None) for i in range(N)]
        ready = [ReadyEpisodes(np.array([i]), *part[1:]) for i, (part,) in enumerate(single)]
    return envs, envs.load(envs.all, ready), generators


@pytest.mark.parametrize("scenario", SCENARIOS, ids=lambda scenario: scenario.name)
def test_rows_equal_episodes_drawn_one_by_one(scenario):
    """To the last bit; if an episode is infeasible, the next feasible one is the same."""
    rows, found, generators = load(scenario, True, (2, 7))
    single, expected, others = load(scenario, False, (2, 7))
    for mine, theirs in zip(found, expected, strict=True):
        np.testing.assert_array_equal(mine, theirs)
    for name in ("constants", "samples"):
        np.testing.assert_array_equal(getattr(rows, name), getattr(single, name))
    np.testing.assert_allclose(rows.preview._positions, single.preview._positions, rtol=0, atol=1e-12)
    for mine, theirs in zip(rows._exogenous._tables, single._exogenous._tables, strict=True):
        np.testing.assert_array_equal(mine, theirs)
    assert [g.bit_generator.state for g in generators] == [g.bit_generator.state for g in others]


def test_other_scenarios_in_the_same_environment_change_nothing():
    mixed = [STORM] * 6 + [PRESETS["slow-calm"]] * 5 + [PRESETS["paper-circle"], EVERYTHING]
    envs = SubEnvironments(len(mixed), mixed, None, None)
    envs.reset(0, None)
    for i, scenario in enumerate(mixed):
        single = SubEnvironments(1, scenario, None, None)
        single.reset(i, None)
        np.testing.assert_array_equal(envs.constants[:, i], single.constants[:, 0])
        np.testing.assert_array_equal(envs.samples[:, :, i], single.samples[: len(envs.samples), :, 0])


def test_an_impossible_mismatch_is_refused_before_drawing():
    vehicle = replace(STORM.vehicle, Y_ur=-30.0)
    with pytest.raises(ValueError, match=r"m22 = .* is not above"):
        replace(STORM, vehicle=vehicle, mismatch=RandomMismatch(ratio=(0.9, 1.1)))


@pytest.mark.parametrize("gust", [0.0, 0.1])
def test_noise_equals_that_of_numpy(gust):
    """Hundreds of thousands of numbers, read in blocks, to the last bit."""
    sensors, n_envs, steps = Sensors(1.0, 1.0, 1.0, 1.0), 40, 900
    scenario = replace(STORM, sensors=sensors, current=RandomCurrent(speed=0.1, gust=gust) if gust else None)
    inputs, width = ExogenousInputs(n_envs, 300), 8 if gust else 6
    rng = np.random.default_rng(1)
    episodes = [scenario.draw(rng) for _ in range(n_envs)]
    for i, episode in enumerate(episodes):
        inputs.load(i, scenario, episode, np.ones((steps, 8)))
    noise = np.concatenate([inputs.read(np.arange(n_envs), n)[:, NOISE] for n in (1, 299, 300, 7, 293)])
    for i, episode in enumerate(episodes):
        expected = np.random.Generator(np.random.SFC64(episode.noise_seed)).standard_normal((steps, width))[:, :6]
        np.testing.assert_array_equal(noise[:, :, i], expected)


@pytest.mark.parametrize("seed", [0, 1, 2**32 - 1, 2**32, 2**63 - 1, 2**64 - 1, 2**80 + 5])
def test_states_equal_those_of_the_generator_of_numpy(seed):
    (state,) = exogenous._states_of([seed], exogenous.compiled())
    np.testing.assert_array_equal(state, np.random.SFC64(seed).state["state"]["state"])


def test_compiled_code_equals_python(monkeypatch):
    (envs, *_), (other, *_) = (load(EVERYTHING, True) for _ in range(2))
    monkeypatch.setattr(exogenous, "compiled", lambda **_: None)
    expected = np.empty((64, SAMPLE_ROWS, N))
    other._exogenous.read_into(expected, other.all, other.all[::-1])
    monkeypatch.undo()
    found = np.empty((64, SAMPLE_ROWS, N))
    envs._exogenous.read_into(found, envs.all, envs.all[::-1])
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)

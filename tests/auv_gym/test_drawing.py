"""Episodes that are drawn side by side are those that are drawn alone, and their noise is NumPy's."""

from dataclasses import replace

import numpy as np
import pytest

from auv_gym.envs.lanes import FEWEST_ROWS, Lanes, ReadyEpisodes
from auv_gym.physics.actuators import Actuators
from auv_gym.physics.disturbances import RandomCurrent, RandomMismatch
from auv_gym.physics.sensors import Sensors
from auv_gym.planning.paths import PATHS
from auv_gym.scenarios import exogenous
from auv_gym.scenarios.exogenous import Tape
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


def begun(scenario, together, preview=()):
    """Return N lanes in which episodes have begun, and their first states and errors."""
    lanes = Lanes(N, scenario, None, None, preview)
    generators = [np.random.default_rng(i) for i in range(N)]
    if together:
        ready = lanes.ready(lanes.all, generators, None)
        assert max(len(part.tables) for part in ready) >= FEWEST_ROWS
    else:
        alone = [lanes.ready(np.array([i]), generators, None) for i in range(N)]
        ready = [ReadyEpisodes(np.array([i]), *part[1:]) for i, (part,) in enumerate(alone)]
    return lanes, lanes.load(lanes.all, ready), generators


@pytest.mark.parametrize("scenario", SCENARIOS, ids=lambda scenario: scenario.name)
def test_rows_are_the_episodes_that_are_drawn_alone(scenario):
    """To the last bit; where one cannot be followed, the next that can be is found alike."""
    rows, found, generators = begun(scenario, True, (2, 7))
    alone, expected, others = begun(scenario, False, (2, 7))
    for mine, theirs in zip(found, expected, strict=True):
        np.testing.assert_array_equal(mine, theirs)
    for name in ("constants", "samples"):
        np.testing.assert_array_equal(getattr(rows, name), getattr(alone, name))
    np.testing.assert_allclose(rows.preview._positions, alone.preview._positions, rtol=0, atol=1e-12)
    for mine, theirs in zip(rows._tape._tables, alone._tape._tables, strict=True):
        np.testing.assert_array_equal(mine, theirs)
    assert [g.bit_generator.state for g in generators] == [g.bit_generator.state for g in others]


def test_other_scenarios_beside_them_change_nothing():
    mixed = [STORM] * 6 + [PRESETS["slow-calm"]] * 5 + [PRESETS["paper-circle"], EVERYTHING]
    lanes = Lanes(len(mixed), mixed, None, None)
    lanes.reset(0, None)
    for i, scenario in enumerate(mixed):
        single = Lanes(1, scenario, None, None)
        single.reset(i, None)
        np.testing.assert_array_equal(lanes.constants[:, i], single.constants[:, 0])
        np.testing.assert_array_equal(lanes.samples[:, :, i], single.samples[: len(lanes.samples), :, 0])


def test_a_mismatch_that_no_vehicle_can_have_is_refused_before_anything_is_drawn():
    vehicle = replace(STORM.vehicle, Y_ur=-30.0)
    with pytest.raises(ValueError, match=r"m22 = .* is not above"):
        replace(STORM, vehicle=vehicle, mismatch=RandomMismatch(ratio=(0.9, 1.1)))


@pytest.mark.parametrize("gust", [0.0, 0.1])
def test_noise_is_that_of_numpys_generator(gust):
    """Hundreds of thousands of numbers, in pieces, to the last bit."""
    sensors, lanes, steps = Sensors(1.0, 1.0, 1.0, 1.0), 40, 900
    scenario = replace(STORM, sensors=sensors, current=RandomCurrent(speed=0.1, gust=gust) if gust else None)
    tape, width = Tape(lanes, 300), 8 if gust else 6
    rng = np.random.default_rng(1)
    episodes = [scenario.draw(rng) for _ in range(lanes)]
    for lane, episode in enumerate(episodes):
        tape.load(lane, scenario, episode, np.ones((steps, 8)))
    noise = np.concatenate([tape.read(np.arange(lanes), n)[:, NOISE] for n in (1, 299, 300, 7, 293)])
    for lane, episode in enumerate(episodes):
        numpys = np.random.Generator(np.random.SFC64(episode.noise_seed)).standard_normal((steps, width))[:, :6]
        np.testing.assert_array_equal(noise[:, :, lane], numpys)


@pytest.mark.parametrize("seed", [0, 1, 2**32 - 1, 2**32, 2**63 - 1, 2**64 - 1, 2**80 + 5])
def test_states_are_those_of_numpys_generator(seed):
    (state,) = exogenous._states_of([seed], exogenous.compiled())
    np.testing.assert_array_equal(state, np.random.SFC64(seed).state["state"]["state"])


def test_the_compiled_reader_gives_what_python_does(monkeypatch):
    (lanes, *_), (other, *_) = (begun(EVERYTHING, True) for _ in range(2))
    monkeypatch.setattr(exogenous, "compiled", lambda **_: None)
    expected = np.empty((64, SAMPLE_ROWS, N))
    other._tape.read_into(expected, other.all, other.all[::-1])
    monkeypatch.undo()
    found = np.empty((64, SAMPLE_ROWS, N))
    lanes._tape.read_into(found, lanes.all, lanes.all[::-1])
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)

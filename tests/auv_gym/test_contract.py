"""The pairs of environments that must do the same: many vehicles and one, in all scenarios and autoreset modes."""

from contextlib import suppress
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from contract import WithMemory, assert_same_runs, together
from gymnasium.vector import AutoresetMode

from auv_gym.effects.actuators import Actuators
from auv_gym.effects.current import RandomCurrent
from auv_gym.effects.faults import FAULT_KINDS, RandomFaults
from auv_gym.effects.navigation import RandomReckoning
from auv_gym.effects.sensors import Sensors
from auv_gym.envs.track_env import UnderactuatedAUVTrackEnv
from auv_gym.envs.track_vector_env import UnderactuatedAUVTrackVectorEnv
from auv_gym.physics.vehicle import PAPER_VEHICLE
from auv_gym.planning.feasibility import InfeasibleReferenceError
from auv_gym.planning.paths import PATHS
from auv_gym.scenarios.presets import PRESETS, as_scenario
from auv_gym.scenarios.scenario import RandomPath, Scenario, Start

TRACK, RESIDUAL = "auv_gym:UnderactuatedAUVTrack-v0", "auv_gym:UnderactuatedAUVTrackResidual-v0"
N, STEPS = 9, 40  # more vehicles than lanes of vector instructions, and than are drawn one by one
STORM = PRESETS["cruise-storm"]
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
CROSSED = replace(
    PAPER_VEHICLE, Y_vv=100.0, N_rr=50.0, X_vr=10.0, Y_rv=60.0, Y_vr=20.0, Y_rr=10.0, N_vv=15.0, N_vr=80.0
)
RECKONING = RandomReckoning((1.0, 3.0), (-0.1, 0.1), (-0.1, 0.1), (-0.01, 0.01), 0.01)
# Fast turns in a wide range of speeds: about a quarter of the draws is infeasible.
TIGHT = Scenario("tight", RandomPath((0.2, 1.5), 0.5, ("circle", "sine")), actuators=Actuators(160.0, 60.0))
SCENARIOS = [
    *PRESETS.values(),
    EVERYTHING,
    TIGHT,
    as_scenario("cruise-storm@lauv"),  # with lift and fins
    as_scenario("slow-storm@otter"),
    replace(STORM, name="outages", sensors=Sensors(position=0.1, outages=40.0, outage_time=(0.3, 1.0))),
    replace(STORM, name="dead-reckoning", sensors=replace(STORM.sensors, reckoning=RECKONING, outages=10.0)),
    replace(STORM, name="faults", faults=RandomFaults(FAULT_KINDS, rate=10.0)),
    replace(
        STORM,
        name="correlated",
        sensors=Sensors(position=(0.01, 0.1), position_bias=(-1.0, 1.0), correlation=(0.0, 5.0)),
    ),
    replace(STORM, name="crossed", vehicle=CROSSED, mismatch=None),
    replace(STORM, name="shear", current=RandomCurrent(speed=0.3, shear=(0.2, 0.3), wavelength=(5.0, 9.0))),
]


@pytest.mark.parametrize("scenario", SCENARIOS, ids=lambda scenario: scenario.name)
def test_many_vehicles_equal_one(scenario):
    """Vehicles that are drawn, planned, read and simulated together, over three episodes each."""
    short = replace(scenario, steps=STEPS)
    env, scalars = UnderactuatedAUVTrackVectorEnv(N, short), [UnderactuatedAUVTrackEnv(short) for _ in range(N)]
    attributes = "state", "force", "current", "time"
    assert assert_same_runs(env, together(scalars), 90, attributes=attributes) >= 2 * N


def test_many_vehicles_have_the_same_preview_as_one():
    """Up to the rounding of paths that are evaluated together."""
    short, preview = replace(EVERYTHING, steps=12), (1, 5, 40)
    env = UnderactuatedAUVTrackVectorEnv(N, short, preview=preview)
    scalars = [UnderactuatedAUVTrackEnv(short, preview=preview) for _ in range(N)]
    assert assert_same_runs(env, together(scalars), 30, tolerance=1e-11) >= 2 * N


def test_some_draws_of_tight_are_infeasible():
    rng, feasible = np.random.default_rng(0), 0
    for _ in range(40):
        with suppress(InfeasibleReferenceError):
            feasible += TIGHT.planner.table(TIGHT.draw(rng).path) is not None
    assert 20 < feasible < 37


MIXED = [
    replace(STORM, steps=7),
    replace(PRESETS["slow-storm"], steps=11),
    replace(STORM, steps=40, lost_distance=1.0),  # an episode can begin with a failure
    replace(PRESETS["paper-circle"], steps=30),
]


@pytest.mark.parametrize("mode", list(AutoresetMode))
@pytest.mark.parametrize(
    ("env_id", "options"),
    [(TRACK, {}), (RESIDUAL, {"authority": (0.2, 0.4)}), (RESIDUAL, {"expert": WithMemory()})],
    ids=["commands", "law", "memory"],
)
def test_different_scenarios_in_every_autoreset_mode(env_id, options, mode):
    """Compared with the vector environment of Gymnasium around scalar environments."""
    native = gym.make_vec(env_id, len(MIXED), "vector_entry_point", scenario=MIXED, autoreset_mode=mode, **options)
    scalars = [gym.make(env_id, scenario=scenario, **options) for scenario in MIXED]
    assert assert_same_runs(native, together(scalars, mode), 75, scale=1.5) >= 12

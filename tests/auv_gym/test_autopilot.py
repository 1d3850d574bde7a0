"""Setpoints as actions: the autopilots against a continuous integration, where they settle, scenarios and policies."""

from dataclasses import replace
from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from auv_gym.effects import Autopilot
from auv_gym.effects.autopilot import LARGEST_RISE, LARGEST_TURN, _heading
from auv_gym.physics.namespaces import FLOATS
from auv_gym.planning.paths import Line
from auv_gym.planning.paths.space import Climb, WithHeight
from auv_gym.scenarios.presets import as_scenario
from auv_gym.scenarios.scenario import Scenario
from baselines.evaluation.cells import drawn
from baselines.evaluation.request import checked_policies
from baselines.evaluation.rollout import rollout
from baselines.policies import make_policy, takes_setpoints
from baselines.tools.command_line import UsageError
from baselines.training.config import Config

REMUS = as_scenario("cruise-calm-setpoints@remus100")
SPEED = 1.0


def settled(scenario, action, steps=900):
    """Return the environment after steps with a constant action on a straight path from its start."""
    env = gym.make("auv_gym:UnderactuatedAUVTrack3D-v0" if scenario.vertical else "auv_gym:UnderactuatedAUVTrack-v0",
                   scenario=replace(scenario, steps=steps, lost_distance=1e4)).unwrapped  # fmt: skip
    env.reset(seed=0)
    for _ in range(steps):
        env.step(np.array(action, dtype=np.float32))
    return env


def test_the_heading_loop_is_that_of_its_differential_equations():
    """A step of the heading of a turning mass with damping, without a limit of the rate."""
    k, kappa, w, inertia, drag, step = 0.5, 1.2, 0.7, 8.0, 3.0, 0.6
    own = SimpleNamespace(heading=k, damping=kappa, model=w, turn=10.0, fin_r=0.0)
    vehicle, dt = SimpleNamespace(m33=inertia, d33=drag, N_ur=0.0), 1e-3
    m = Autopilot.Memory(*[0.0] * len(Autopilot.Memory._fields))._replace(psi_R=step)
    at, psi, r, found = SimpleNamespace(own=own, dt=dt, ns=FLOATS), 0.0, 0.0, []
    for _ in range(12000):
        share, m = _heading(0.0, m._replace(psi=psi, r=r), at, vehicle, 1e6)
        psi, r = psi + dt * r, r + dt * (1e6 * share - drag * r) / inertia
        found.append(psi)

    def rates(_, y):
        psi, r, total, psi_d, r_d, a_d = y
        e, slip = psi - psi_d, r - r_d
        sigma = slip + 2 * k * e + k**2 * total
        wanted, change = r_d - 2 * k * e - k**2 * total, a_d - 2 * k * slip - k**2 * e
        moment = inertia * (change - kappa * sigma) + drag * wanted
        jerk = w**3 * (step - psi_d) - 3 * w**2 * r_d - 3 * w * a_d
        return r, (moment - drag * r) / inertia, e, r_d, a_d, jerk

    exact = solve_ivp(rates, (0, 12), np.zeros(6), t_eval=dt * np.arange(1, 12001), rtol=1e-9, atol=1e-12).y[0]
    np.testing.assert_allclose(found, exact, atol=2e-3)
    assert exact[-1] == pytest.approx(step, abs=1e-2)


@pytest.mark.parametrize(("a_u", "a_r"), [(0.0, 0.0), (0.2, 0.3), (-0.2, -0.1)])
def test_the_vehicle_settles_at_its_setpoints(a_u, a_r):
    """Heading and speed relative to those of the reference, for weak fins."""
    env = settled(replace(REMUS, path=Line(SPEED)), (a_u, a_r))
    _, _, psi, u, _, r = env.state
    assert psi - env.reference.psi == pytest.approx(LARGEST_TURN * a_r, abs=2e-3)
    assert u == pytest.approx(env.reference.u * (1 + a_u), abs=5e-3)
    assert abs(r) < 1e-3


@pytest.mark.parametrize("slope", [0.0, -0.1])
def test_the_depth_settles_at_its_setpoint(slope):
    """On a level line and on a dive, above and below the reference."""
    scenario = as_scenario("space-calm-setpoints@lauv")
    path = WithHeight(Line(SPEED), Climb(slope * SPEED), -20.0)
    for a_q in (0.0, 0.2):
        env = settled(replace(scenario, path=path), (0.0, a_q, 0.0), 1200)
        height = env.state[2] - env.reference.z
        assert height == pytest.approx(-LARGEST_RISE * env.reference.u * a_q, abs=0.02)


def test_a_file_has_the_autopilot_and_a_vehicle_scales_it(tmp_path):
    own = Autopilot(heading=0.5, model=1.0)
    scenario = Scenario(name="mine", effects=(own,))
    file = tmp_path / "mine.toml"
    scenario.save(file)
    assert "[effects.autopilot]" in file.read_text(encoding="utf-8")
    assert Scenario.load(file) == scenario
    assert scenario.takes_setpoints
    assert not Scenario().takes_setpoints
    assert as_scenario(f"{file}@lauv").effects[0].heading != own.heading
    time = REMUS.effects[0].heading / Autopilot().heading
    assert REMUS.effects[0].turn == pytest.approx(Autopilot().turn * time)
    for wrong in (-1, 0):
        with pytest.raises(ValueError, match=f"autopilot heading is {wrong}"):
            Autopilot(heading=wrong)


@pytest.mark.parametrize("name", ["cruise-storm-setpoints@remus100", "space-storm-setpoints@lauv"])
def test_guidance_follows_a_storm_by_setpoints(name):
    scenario = as_scenario(name)
    measures = rollout(make_policy("los-setpoints", scenario.known), scenario, drawn(scenario, 8, 3).episodes).measures
    assert not measures.failed.any()
    assert measures.steady_rmse.max() < 0.6


def test_the_residual_of_zero_is_the_guidance():
    scenario, env_id = as_scenario("cruise-storm-setpoints"), "auv_gym:UnderactuatedAUVTrackResidual-v0"
    law = make_policy("los-setpoints")
    env = gym.make(env_id, scenario=scenario, authority=0.2)
    plain = gym.make("auv_gym:UnderactuatedAUVTrack-v0", scenario=scenario)
    seen, one = env.reset(seed=1)[0], plain.reset(seed=1)[0]
    for _ in range(40):
        np.testing.assert_array_equal(seen[:18], one)
        seen, *_ = env.step(np.zeros(2, dtype=np.float32))
        one, *_ = plain.step(law.predict(one)[0])


def test_policies_and_scenarios_must_have_the_same_actions(tmp_path):
    scenario = as_scenario("cruise-calm-setpoints")
    assert (takes_setpoints("los-setpoints"), takes_setpoints("helm"), takes_setpoints("nmpc")) == (True, False, False)
    (tmp_path / "gains.json").write_text('{"controller": "los-setpoints"}')
    assert takes_setpoints(str(tmp_path / "gains.json"))
    with pytest.raises(UsageError, match="los-pid gives forces, the actions of cruise-calm-setpoints are setpoints"):
        checked_policies(["los-pid"], [scenario])
    with pytest.raises(ValueError, match="nmpc gives forces, the actions of cruise-calm-setpoints are setpoints"):
        gym.make("auv_gym:UnderactuatedAUVTrackResidual-v0", scenario=scenario, expert="nmpc")
    with pytest.raises(ValueError, match="backstepping gives forces"):
        Config(scenarios=((scenario, 1.0),))
    with pytest.raises(ValueError, match="did you mean 'cruise-storm-setpoints'"):
        as_scenario("cruise-strom-setpoints")
    with pytest.raises(UsageError, match=r"los-setpoints gives setpoints, the actions of cruise-calm are forces$"):
        checked_policies(["los-setpoints"], [as_scenario("cruise-calm")])
    clairvoyant = make_policy("clairvoyant")
    with pytest.raises(ValueError, match="does not include the effect 'autopilot'"):
        rollout(clairvoyant, scenario, drawn(scenario, 1, 0).episodes)

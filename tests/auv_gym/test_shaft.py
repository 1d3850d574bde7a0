"""Revolutions and rudder angle as actions: against the equations of the REMUS 100 in six degrees of freedom."""

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from auv_gym.envs.shaft import ShaftAction, VectorShaftAction
from auv_gym.physics.namespaces import FLOATS
from auv_gym.scenarios.vehicles import vehicle_model
from research.transfer.remus100 import REMUS100, _Actuators
from research.transfer.six_dof import SpatialMotion

REMUS = vehicle_model("remus100")


@given(n=st.floats(0.1, 1.0), angle=st.floats(-1.0, 1.0), u=st.floats(0.3, 2.5))
def test_forces_of_the_shaft_are_those_of_the_source(n, angle, u):
    """Without sideslip; the source has the angle where the shaft has its sine."""
    motion = SpatialMotion(*([0.0] * 6), u, *([0.0] * 5))
    rudder = angle * REMUS.shaft.angle_max
    X, Y, _, _, _, N = REMUS100.actuation(motion, _Actuators(rudder, 0.0, 60 * n * REMUS.shaft.n_max, 0.0, 0.0), FLOATS)
    F_u, F_r = REMUS.shaft.forces((n, angle), u, 0.0, 0.0, FLOATS)
    assert F_u == pytest.approx(X, rel=2e-3, abs=0.04)
    assert F_r == pytest.approx(N, rel=2e-2, abs=1e-9)
    v = REMUS.vehicle
    assert -F_r * v.eps * v.m22 / v.m33 == pytest.approx(Y, rel=2.5e-2, abs=1e-9)


def test_actions_are_shares_of_revolutions_and_angle():
    """Held commands in still water, in one and in many environments: the forces are those of the shaft."""
    make = {"scenario": "cruise-calm", "vehicle": "remus100"}
    env = ShaftAction(gym.make("auv_gym:UnderactuatedAUVTrack-v0", **make), "remus100")
    envs = VectorShaftAction(
        gym.make_vec("auv_gym:UnderactuatedAUVTrack-v0", 2, "vector_entry_point", **make), "remus100"
    )
    env.reset(seed=4)
    envs.reset(seed=4)
    action = np.array([0.4, 0.3], dtype=np.float32)
    for _ in range(60):
        own = env.unwrapped
        _, _, _, u, v, r = own.state
        expected = REMUS.shaft.forces(action.tolist(), u, v - own.scenario.vehicle.eps * r, r, FLOATS)
        env.step(action)
        envs.step(np.stack((action, -action)))
        np.testing.assert_allclose(own.force, expected, rtol=1e-5)
        np.testing.assert_allclose(envs.unwrapped.force[0], own.force, rtol=1e-6)
    assert envs.unwrapped.force[1, 0] < 0 < envs.unwrapped.force[0, 0]


def test_wrong_vehicles_and_actions_are_refused():
    env = gym.make("auv_gym:UnderactuatedAUVTrack-v0", scenario="cruise-calm", vehicle="remus100")
    with pytest.raises(ValueError, match=r"vehicle 'lauv' has no propeller and rudder; .* \[shaft\]"):
        ShaftAction(env, "lauv")
    with pytest.raises(ValueError, match="the environment has another vehicle than 'remus100'"):
        ShaftAction(gym.make("auv_gym:UnderactuatedAUVTrack-v0"), "remus100")
    wrapped = ShaftAction(env, "remus100")
    wrapped.reset(seed=0)
    with pytest.raises(ValueError, match="action"):
        wrapped.step(np.array([np.nan, 0.0]))

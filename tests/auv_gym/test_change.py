"""Changes of the vehicle and the current during an episode of the vector environment."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from auv_gym.envs.track_vector_env import UnderactuatedAUVTrackVectorEnv
from auv_gym.physics.vehicle import PAPER_VEHICLE
from auv_gym.scenarios.presets import PRESETS
from baselines.evaluation.runner import drawn


def changing(scenario, n=2):
    env = UnderactuatedAUVTrackVectorEnv(n, scenario)
    episodes = drawn(scenario, n, 0).episodes
    env.reset(seed=0, options={"episode": list(episodes)})
    return env, episodes


def test_a_changed_vehicle_satisfies_the_new_equations():
    """Compared with the equations of the paper and another integrator; a change to the same episode has no effect."""
    calm = replace(PRESETS["cruise-calm"], control_dt=0.02)
    (env, episodes), (other, _) = changing(calm), changing(calm)
    v = replace(PAPER_VEHICLE, m11=300.0, m22=390.0, m33=120.0, d11=140.0)
    actions = np.full((2, 2), 0.4, dtype=np.float32)
    for k in range(20):
        if k == 10:
            env.change(episodes)
        env.step(actions)
        other.step(actions)
        np.testing.assert_array_equal(env.state, other.state)
    env.change([replace(e, vehicle=v, effectiveness=(1.0, 0.5)) for e in episodes])
    np.testing.assert_array_equal(env.state, other.state)
    before = env.state[0]
    for _ in range(50):
        env.step(actions)

    def slope(_, z):
        _, _, psi, u, w, r = z
        return [
            u * math.cos(psi) - w * math.sin(psi), u * math.sin(psi) + w * math.cos(psi), r,
            (0.4 * 400 + v.m22 * w * r - v.d11 * u) / v.m11,
            (-v.m11 * u * r - v.d22 * w) / v.m22,
            (0.4 * 0.5 * 200 + (v.m11 - v.m22) * u * w - v.d33 * r) / v.m33,
        ]  # fmt: skip

    end = solve_ivp(slope, (0.0, 1.0), before, rtol=1e-9, atol=1e-10).y[:, -1]
    np.testing.assert_allclose(env.state[0], end, atol=1e-6)


def test_a_step_of_the_current_keeps_the_velocity_over_ground():
    current = replace(PRESETS["cruise-current"].current, shear=(0.0, 0.0))  # shear allows a step of the current
    still = replace(PRESETS["cruise-noise"], current=current)
    env, episodes = changing(still)
    env.step(np.zeros((2, 2), dtype=np.float32))
    before, current = env.state, env.current
    shear = (0.2, -0.1, 0.0, 0.0, 0.5 * math.pi)  # zero wave number: a uniform current
    env.change([replace(e, current=replace(e.current, shear=shear)) for e in episodes])
    np.testing.assert_allclose(env.state, before, atol=1e-12)
    np.testing.assert_allclose(env.current - current, [(0.2, -0.1)] * 2)
    with pytest.raises(ValueError, match="1 episodes are given; there must be one for each of 2"):
        env.change(episodes[:1])
    calm, others = changing(PRESETS["cruise-calm"])
    with pytest.raises(ValueError, match="sheared current"):
        calm.change([replace(e, current=replace(e.current, shear=shear)) for e in others])

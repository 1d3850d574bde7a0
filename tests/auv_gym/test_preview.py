"""The preview of the reference: compared with the path."""

import json

import gymnasium as gym
import numpy as np
import pytest

import baselines
from auv_gym import PRESETS, Scenario, decode_observation
from auv_gym.effects.sensors import Sensors
from auv_gym.planning.paths import Spline
from auv_gym.scenarios.fitting import changed
from auv_gym.scenarios.scenario import RandomPath, Start
from auv_gym.task.observation import SIZE
from auv_gym.task.policy import checked_authority
from auv_gym.task.preview import checked_preview

PERIODS = (1, 5, 40)
NOISY = Scenario(
    path=RandomPath(speed=(0.5, 1.5), turn_rate=0.12),
    start=Start(x_e=(0.0, 1.0), y_e=(0.0, 1.0), psi_e=(0.0, 0.4), random_signs=True),
    sensors=Sensors(position=0.05, heading=0.1),
    steps=12,
)


def geometry(path, o, k, dt):
    """Return the expected preview for a path without end, shape (P, 2)."""
    times = dt * np.array([k, *(k + n for n in PERIODS)])
    positions = path.derivatives(times)[0].T
    turn = np.array([[o.cos_psi, o.sin_psi], [-o.sin_psi, o.cos_psi]])
    return (positions[1:] - positions[0]) @ turn.T


def test_preview_is_the_displacement_along_the_path_in_measured_body_axes():
    env = gym.make("auv_gym:UnderactuatedAUVTrack-v0", scenario=NOISY, preview=PERIODS)
    episode = NOISY.draw(np.random.default_rng(5))
    observation, _ = env.reset(seed=0, options={"episode": episode})
    for k in range(NOISY.steps + 1):
        assert observation in env.observation_space
        seen = observation[SIZE:].reshape(-1, 2)
        expected = geometry(episode.path, decode_observation(observation), k, NOISY.control_dt)
        np.testing.assert_allclose(seen, expected, atol=1e-12)
        if k < NOISY.steps:
            observation, *_ = env.step(np.array([0.3, 0.1], dtype=np.float32))


def test_after_its_end_a_path_is_straight():
    spline = Spline(waypoints=((0.0, 0.0), (6.0, 0.0), (12.0, 2.0), (18.0, 3.0)), speed=1.0)
    steps = int(spline.end / 0.1)
    env = gym.make("auv_gym:UnderactuatedAUVTrack-v0", scenario=Scenario(path=spline, steps=steps), preview=(50, 100))
    observation, _ = env.reset(seed=0)
    for _ in range(steps - 1):
        observation, *_ = env.step(np.zeros(2, dtype=np.float32))
    near, far = np.linalg.norm(observation[SIZE:].reshape(2, 2), axis=1)
    last = spline.derivatives(np.array([spline.end]))[1, :, 0]
    assert far - near == pytest.approx(5 * np.hypot(*last), rel=1e-3)


def test_residual_environments_have_the_preview_of_the_expert():
    class WithPreview:
        preview = PERIODS

        def predict(self, observation, state=None, episode_start=None, deterministic=True):
            return np.clip(observation[..., SIZE : SIZE + 2], -1, 1).astype(np.float32), None

    env = baselines.make_residual_env("cruise-noise", expert=WithPreview())
    observation, _ = env.reset(seed=1)
    assert observation in env.observation_space
    assert observation.shape == (SIZE + 2 * len(PERIODS) + 2,)
    np.testing.assert_allclose(observation[-2:], np.clip(observation[SIZE : SIZE + 2], -1, 1), atol=1e-6)
    rows, _ = baselines.make_residual_vector_env(1, "cruise-noise", expert=WithPreview()).reset(seed=1)
    np.testing.assert_allclose(rows[0], observation, atol=1e-12)


def test_numbers_of_numpy_are_numbers():
    options = {"control_dt": np.float32(0.05), "preview": np.array([5, 10])}
    env = gym.make("auv_gym:UnderactuatedAUVTrack-v0", scenario="cruise-calm", **options)
    assert env.observation_space.shape == (SIZE + 4,)
    scenario = env.unwrapped.scenario
    assert (scenario.steps, type(scenario.control_dt)) == (1200, float)
    residual = gym.make("auv_gym:UnderactuatedAUVTrackResidual-v0", authority=np.array([0.2, 0.3]))
    assert residual.authority == (0.2, 0.3)
    assert checked_authority(np.int64(1)) == checked_authority(np.array([1, 1])) == (1.0, 1.0)
    assert changed(PRESETS["cruise-calm"], control_dt=np.int64(1)).control_dt == 1.0
    assert checked_preview((np.int64(3), 4)) == (3, 4)
    record = Scenario(error_scale=np.float32(0.25), sensors=Sensors(position=(np.float32(0.5), 1.0))).to_dict()
    text = json.dumps({name: record[name] for name in ("sensors", "error_scale")})
    assert text == '{"sensors": {"position": [0.5, 1.0]}, "error_scale": 0.25}'


@pytest.mark.parametrize("preview", [(0,), (5, 5), (5, 2), (1.5,), np.array([1.5]), "12", 7, (10_000,), None])
def test_wrong_previews_are_refused(preview):
    with pytest.raises(ValueError, match=r"preview is .* ascending numbers of control periods"):
        checked_preview(preview)
    with pytest.raises(ValueError, match="preview is"):
        gym.make("auv_gym:UnderactuatedAUVTrack-v0", scenario=PRESETS["cruise-calm"], preview=preview)

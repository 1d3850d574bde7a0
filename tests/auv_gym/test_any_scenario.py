"""Random scenarios of the whole schema: all environments agree, whatever the order of resets, steps and mistakes."""

import copy
import math
import pickle
from contextlib import contextmanager
from dataclasses import replace
from unittest.mock import patch

import gymnasium as gym
import numpy as np
import pytest
from contract import assert_same, together
from gymnasium.envs.registration import EnvSpec
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode
from hypothesis import given, reject, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, precondition, rule
from random_scenarios import SUBSTEPS, scenarios

import auv_gym  # noqa: F401, which registers its environments
from auv_gym.codegen.kernel import Kernel
from auv_gym.envs.track_env import UnderactuatedAUVTrackEnv
from auv_gym.envs.track_vector_env import UnderactuatedAUVTrackVectorEnv
from auv_gym.physics.errors import to_world
from auv_gym.planning.paths import Spline
from auv_gym.scenarios.scenario import Scenario
from auv_gym.task.observation import Observation

N = 3
FEW = settings().max_examples // 25
NEAR = 1e-9  # between compiled and uncompiled code, of observations, rewards and errors: their rounding differs
ACTIONS = st.lists(st.floats(-1.5, 1.5), min_size=2 * N, max_size=2 * N).map(lambda a: np.reshape(a, (N, 2)))
BAD_ACTIONS = (math.nan, math.inf, -math.inf)
CHOICES = {
    "initial_error": st.tuples(st.floats(-2, 2), st.floats(-2, 2), st.floats(-3, 3)),
    "initial_velocity": st.tuples(st.floats(-0.5, 1), st.floats(-0.2, 0.2), st.floats(-0.1, 0.1)),
}
"""Options of `reset`."""


@contextmanager
def interpreted():
    """Run equations as Python, as on a machine without a compiler."""
    nothing = "auv_gym.planning.planner.driver", "auv_gym.scenarios.exogenous.compiled", "auv_gym.task.kernels.together"
    with patch.object(Kernel, "_native", lambda *_: None):
        patches = [patch(name, lambda *_, **__: None) for name in nothing]
        try:
            for made in patches:
                made.start()
            yield
        finally:
            for made in patches:
                made.stop()


class Environments(RuleBasedStateMachine):
    """Three environments that do the same: many vehicles, single ones, and single ones without a compiler."""

    @initialize(data=st.data(), mode=st.sampled_from([*AutoresetMode]), preview=st.sampled_from([(), (1, 6)]))
    def make(self, data, mode, preview):
        substeps = data.draw(st.sampled_from(SUBSTEPS))
        one = data.draw(st.booleans())  # or N different ones
        given = [data.draw(scenarios(substeps=(substeps,))) for _ in range(1 if one else N)]
        self.scenarios, self.mode = given * N if one else given, mode
        options = {"preview": preview, "autoreset_mode": mode}
        try:
            self.numpy = UnderactuatedAUVTrackVectorEnv(N, self.scenarios, **options)
            self.scalars, self.python = (
                together([UnderactuatedAUVTrackEnv(s, preview=preview) for s in self.scenarios], mode) for _ in range(2)
            )
        except ValueError:  # a path that is not drawn cannot be followed
            reject()
        for env, action in self._compiled(np.zeros((N, 2)), 0):
            with pytest.raises(ResetNeeded):
                env.step(action)
        self.reset(data, data.draw(st.integers(0, 2**31 - 1)))

    def _compiled(self, actions, i):
        """Return the compiled environments, of the single ones the i-th, with their actions."""
        return (self.numpy, actions), (self.scalars.envs[i], actions[i])

    def _all(self, call):
        """Do the same with all; whatever is returned is finite, in its space, and the same."""
        try:
            found = call(self.numpy)
        except ValueError as error:
            assert "\n" not in str(error)  # noqa: PT017
            reject()  # an episode that cannot be followed
        observation, *_ = found
        assert self.numpy.observation_space.contains(observation)
        if len(found) > 2:
            assert np.isfinite(found[1]).all()
        bounds = np.array([env.observation_space.high for env in self.scalars.envs])
        assert_same(found, call(self.scalars), NEAR, bounds)
        with interpreted():
            assert_same(found, call(self.python), NEAR, bounds)
        return found

    @rule(data=st.data(), seed=st.none() | st.integers(0, 2**31 - 1))
    def reset(self, data, seed):
        options = data.draw(st.fixed_dictionaries({}, optional=CHOICES))
        self._all(lambda env: env.reset(seed=seed, options=dict(options)))
        self.over = np.zeros(N, dtype=bool)

    @precondition(lambda self: self.mode == AutoresetMode.DISABLED)
    @rule(mask=st.lists(st.booleans(), min_size=N, max_size=N).filter(any))
    def reset_some(self, mask):
        mask = np.array(mask)
        self._all(lambda env: env.reset(options={"reset_mask": mask.copy()}))
        self.over &= ~mask

    @rule(actions=ACTIONS, steps=st.integers(1, 9))
    def step(self, actions, steps):
        for _ in range(steps):
            if self.mode == AutoresetMode.DISABLED and self.over.any():
                with pytest.raises(ResetNeeded):
                    self.numpy.step(actions)
                return
            _, _, terminated, truncated, _ = self._all(lambda env: env.step(actions))
            self.over = terminated | truncated
            if self.mode != AutoresetMode.DISABLED:
                self.over[:] = False

    @rule(actions=ACTIONS, bad=st.sampled_from(BAD_ACTIONS), place=st.integers(0, 2 * N - 1))
    def bad_action(self, actions, bad, place):
        """It is refused and changes nothing, which later steps show: one environment does not get it."""
        actions = actions.copy()
        actions.flat[place] = bad
        for env, action in self._compiled(actions, place // 2):
            with pytest.raises(ValueError, match="two finite numbers"):
                env.step(action)

    @rule(seed=st.none() | st.integers(0, 9), bad=st.sampled_from([{"wind": 1.0}, {"initial_error": (math.nan, 0, 0)}]))
    def bad_reset(self, seed, bad):
        for env, _ in self._compiled(np.zeros((N, 2)), 0):
            with pytest.raises(ValueError, match="reset option"):
                env.reset(seed=seed, options=bad)

    @rule(copied=st.sampled_from([copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))]))
    def copy(self, copied):
        self.numpy = copied(self.numpy)
        self.scalars.envs = tuple(copied(env) for env in self.scalars.envs)


TestEnvironments = Environments.TestCase
TestEnvironments.settings = settings(max_examples=FEW, stateful_step_count=12)


def turned(episode, angle, shift):
    """Return an episode in a world that is turned by an angle [rad] and moved by x, y [m]."""
    c, s = math.cos(angle), math.sin(angle)

    def vector(x, y):
        return to_world(x, y, c, s)

    def point(x, y):
        x, y = vector(x, y)
        return x + shift[0], y + shift[1]

    def turned_path(path):
        if isinstance(path, Spline):
            return replace(path, waypoints=tuple(point(*p) for p in path.waypoints))
        x0, y0 = point(path.x0, path.y0)
        return replace(path, x0=x0, y0=y0, heading=path.heading + angle)

    current = episode.current
    V_x, V_y = vector(current.V_x, current.V_y)
    (A_x, A_y), (k_x, k_y) = vector(*current.shear[:2]), vector(*current.shear[2:4])
    phase = current.shear[4] - k_x * shift[0] - k_y * shift[1]
    return replace(
        episode,
        path=turned_path(episode.path),
        current=replace(current, V_x=V_x, V_y=V_y, shear=(A_x, A_y, k_x, k_y, phase)),
        bias=(*vector(*episode.bias[:2]), *episode.bias[2:]),
        initial_error=(*vector(*episode.initial_error[:2]), episode.initial_error[2]),
        faults=tuple(f._replace(jump=vector(*f.jump)) if f.kind == "position jump" else f for f in episode.faults),
    )


@settings(max_examples=FEW)
@given(scenarios(), st.integers(0, 9), st.floats(-7, 7), st.tuples(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3)), ACTIONS)
def test_north_is_a_convention_and_so_is_the_origin(scenario, seed, angle, shift, actions):
    """All but the heading itself is observed alike; gusts and fixes have noise along the axes of the world."""
    scenario = replace(scenario, sensors=replace(scenario.sensors, position=0.0))
    if scenario.current:
        scenario = replace(scenario, current=replace(scenario.current, gust=0.0))
    try:
        envs = [UnderactuatedAUVTrackEnv(scenario, preview=(2,)) for _ in range(2)]
        episode = scenario.draw(np.random.default_rng(seed))
        found = [envs[0].reset(options={"episode": episode})]
    except ValueError:
        reject()
    found.append(envs[1].reset(options={"episode": turned(episode, angle, shift)}))
    heading = [Observation._fields.index(name) for name in ("cos_psi", "sin_psi")]
    for action in np.resize(actions, (scenario.steps, 2)):
        (first, *rest, info), (second, *other, other_info) = found
        np.testing.assert_allclose(np.delete(first, heading), np.delete(second, heading), rtol=0, atol=1e-6)
        c, s = math.cos(angle), math.sin(angle)
        np.testing.assert_allclose(to_world(*first[heading], c, s), second[heading], rtol=0, atol=1e-6)
        assert [*map(float, rest)] == pytest.approx([*map(float, other)], abs=1e-6)
        assert info == pytest.approx(other_info, abs=1e-6)
        if any(rest[1:]):
            break
        found = [env.step(action) for env in envs]


@given(scenarios(), st.sampled_from([".json", ".toml"]))
def test_saved_scenarios_come_back(tmp_path_factory, scenario, suffix):
    file = tmp_path_factory.getbasetemp() / f"scenario{suffix}"
    scenario.save(file)
    assert Scenario.load(file) == scenario
    spec = replace(gym.spec("UnderactuatedAUVTrack-v0"), kwargs={"scenario": scenario.to_dict()})
    assert Scenario.from_dict(EnvSpec.from_json(spec.to_json()).kwargs["scenario"]) == scenario

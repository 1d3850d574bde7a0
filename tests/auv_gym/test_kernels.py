"""The simulation as kernels: the same numbers as the equations; steps that are undone, and corrections to a law."""

import math
import os
import subprocess
import sys
import warnings

import numpy as np
import pytest

from auv_gym import PRESETS
from auv_gym.codegen import native
from auv_gym.effects import PACKAGE
from auv_gym.envs.residual import ResidualAction
from auv_gym.envs.track_env import UnderactuatedAUVTrackEnv
from auv_gym.physics.namespaces import FLOATS
from auv_gym.task.kernels import step_kernel
from auv_gym.task.observation import SIZE, encode
from auv_gym.task.policy import Law, traceable
from auv_gym.task.simulation import (
    SAMPLE_ROWS,
    Parts,
    plant_row,
    step,
)
from baselines import make_policy
from baselines.control.backstepping import Backstepping, StabilityWarning
from baselines.control.open_loop import OpenLoop, Zero

N, PARTS = 9, Parts()


def numbers(rng, parts=PARTS, n=N):
    """Return plausible plants, actions, samples and parameters, rows of n vehicles."""
    plant, samples = rng.normal(size=(parts.plant_rows, n)), rng.normal(size=(parts.sample_rows, n))
    samples[SAMPLE_ROWS:] = rng.integers(0, 2, (parts.sample_rows - SAMPLE_ROWS, n))
    parameters = rng.uniform(0.5, 1.5, (parts.parameter_rows, n))
    parameters[0] *= 0.1
    return plant, rng.uniform(-1.2, 1.2, (2, n)), samples, parameters


@pytest.mark.parametrize("effects", [(), *((one,) for one in PACKAGE), PACKAGE], ids=str)
def test_a_step_equals_the_simulation_for_all_effects(effects):
    parts = Parts(2, effects)
    plant, action, sample, parameters = numbers(np.random.default_rng(0), parts)
    given = {"plant": plant, "seen": np.zeros((SIZE, N)), "action": action, "authority": np.zeros((2, N))}
    found = step_kernel(parts)(1, **given, samples=sample[None], parameters=parameters)
    for i in range(N):
        columns = (a[:, i].tolist() for a in (plant, action, sample, parameters))
        before, command, inputs, constants = columns
        after, terms, (reward, failed, squared, saturated) = step(
            parts.plant(before), command, inputs, parts.parameters(constants), FLOATS
        )
        np.testing.assert_allclose(found["next_plant"][:, i], plant_row(after), rtol=1e-12, atol=1e-13)
        np.testing.assert_allclose(
            found["next_seen"][:, i], encode(terms, FLOATS, bound_factor=1), rtol=1e-12, atol=1e-13
        )
        outcome = reward, failed, math.sqrt(squared), saturated
        np.testing.assert_allclose(found["outcome"][:, i], outcome, rtol=1e-12, atol=1e-13)


CODE = """
import hashlib, numpy as np
from baselines.residual_envs import make_residual_vector_env
env = make_residual_vector_env(3, "cruise-storm")
seen, rng = hashlib.sha256(env.reset(seed=0)[0].tobytes()), np.random.default_rng(0)
for _ in range(200):
    observation, reward, *_ = env.step(rng.uniform(-1, 1, (3, 2)))
    seen.update(np.ascontiguousarray(observation).tobytes() + reward.tobytes())
print(seen.hexdigest())
"""


@pytest.mark.skipif(not native.wanted() or native.compiler() is None, reason="bits are those of compiled code")
@pytest.mark.skipif(os.name != "posix", reason="needs a shell")
@pytest.mark.slow
def test_bits_do_not_depend_on_the_compiler(tmp_path):
    """Nor on its level of optimisation, or on the instruction set, which one of them does not use."""
    slow = tmp_path / "unoptimised"
    slow.write_text(
        f'#!/bin/sh\nfor a; do shift; case "$a" in -march=*) exit 1;; -O?) ;; *) set -- "$@" "$a";; esac; done\n'
        f'exec {native.compiler()[0]} "$@"\n'
    )
    slow.chmod(0o755)
    printed = set()
    for compiler in ("gcc", "clang", str(slow)):
        cache = tmp_path / f"compiled-by-{compiler.rpartition('/')[2]}"
        environment = {**os.environ, "CC": compiler, native.CACHE: str(cache)}
        done = subprocess.run([sys.executable, "-c", CODE], env=environment, capture_output=True, text=True, check=True)
        printed.add(done.stdout)
        assert list(cache.glob("*.so"))
    assert len(printed) == 1


class OtherPredict(Backstepping):
    """A law whose actions are not given by its forces."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.full((*observation.shape[:-1], 2), 0.5, dtype=np.float32), state


def test_only_laws_with_the_actions_of_their_forces_are_traceable():
    assert all(traceable(law) for law in (Backstepping(), OpenLoop(), Zero(), Backstepping(horizon=5.0)))
    assert not any(traceable(policy) for policy in (make_policy("ekf"), OtherPredict(), object()))


@pytest.mark.parametrize(
    ("expert", "scenario"),
    [
        *((Backstepping(), name) for name in PRESETS),
        *(
            (law, "cruise-storm")
            for law in (Backstepping("normalised", horizon=5.0), OpenLoop(), Zero(), OtherPredict())
        ),
    ],
)
def test_an_action_is_that_of_the_expert_plus_a_correction(expert, scenario):
    """Compared with the environment without correction, `predict` of the policy and the formula of residual control.

    Without a correction the action is that of the expert, bit for bit.
    """
    plain = UnderactuatedAUVTrackEnv(scenario)
    env = ResidualAction(UnderactuatedAUVTrackEnv(scenario), expert, (0.4, 0.7))
    observation, _ = plain.reset(seed=3)
    seen, _ = env.reset(seed=3)
    rng = np.random.default_rng(0)
    assert seen in env.observation_space
    for k in range(150):
        base = expert.predict(observation)[0]
        np.testing.assert_array_equal(seen, np.append(observation, base))
        action = rng.uniform(-1.5, 1.5, 2) if k >= 50 else np.zeros(2)
        command = np.clip(base + np.array((0.4, 0.7)) * np.clip(action, -1, 1), -1, 1)
        observation, reward, *over, _ = plain.step(command)
        seen, corrected_reward, *corrected_over, _ = env.step(action)
        assert (reward, over) == (corrected_reward, corrected_over)
        if any(over):
            break


def test_a_compiled_law_still_warns():
    fast = {"name": "fast", "steps": 30, "path": {"family": "line", "speed": 0.8}}
    with pytest.warns(StabilityWarning, match="0.49"):
        ResidualAction(UnderactuatedAUVTrackEnv(fast), Backstepping("paper")).reset(seed=0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ResidualAction(UnderactuatedAUVTrackEnv(fast), Backstepping()).reset(seed=0)


def test_the_error_of_a_branching_law():
    class Branching(Law):
        def forces(self, o, ns=FLOATS):
            return (1.0, 0.0) if o[0] > 0 else (0.0, 1.0)

    with pytest.raises(TypeError, match="use `where` to select one of two values"):
        ResidualAction(UnderactuatedAUVTrackEnv(), Branching())

"""The simulation as kernels: the same numbers as the equations, for one vehicle and for many."""

import copy
import math
import os
import pickle
import subprocess
import sys
import warnings

import numpy as np
import pytest

from auv_gym import PRESETS
from auv_gym.codegen import native
from auv_gym.envs.residual import ResidualAction, VectorResidualAction
from auv_gym.envs.sub_environments import SubEnvironments
from auv_gym.envs.track_env import UnderactuatedAUVTrackEnv
from auv_gym.physics.namespaces import FLOATS
from auv_gym.physics.rows import flatten, unflatten
from auv_gym.task.kernels import OneVehicle, Vehicles, start_kernel, started, step_kernel
from auv_gym.task.observation import SIZE, encode
from auv_gym.task.policy import Law, traceable
from auv_gym.task.simulation import (
    PARAMETER_ROWS,
    PARAMETERS,
    PLANT,
    PLANT_ROWS,
    SAMPLE_ROWS,
    Parameters,
    Parts,
    start,
    step,
)
from baselines import make_policy
from baselines.control.backstepping import Backstepping, StabilityWarning
from baselines.control.open_loop import OpenLoop, Zero
from baselines.residual_envs import make_residual_vector_env

N = 9


def numbers(rng, n=N):
    """Return plausible plants, actions, samples and parameters, rows of n vehicles."""
    plant, samples = rng.normal(size=(PLANT_ROWS, n)), rng.normal(size=(SAMPLE_ROWS, n))
    samples[-1] = rng.integers(0, 2, n)
    parameters = rng.uniform(0.5, 1.5, (PARAMETER_ROWS, n))
    parameters[0] *= 0.1
    return plant, rng.uniform(-1.2, 1.2, (2, n)), samples, parameters


@pytest.mark.parametrize("flags", [[k == j for k in range(6)] for j in range(7)] + [[True] * 6])
def test_a_step_equals_the_simulation_for_all_parts(flags):
    parts = Parts(2, *flags, crossed=all(flags))
    plant, action, sample, parameters = numbers(np.random.default_rng(0))
    given = {"plant": plant, "seen": np.zeros((SIZE, N)), "action": action, "authority": np.zeros((2, N))}
    found = step_kernel(parts)(1, **given, samples=sample[None], parameters=parameters)
    for i in range(N):
        columns = (a[:, i].tolist() for a in (plant, action, sample, parameters))
        before, command, inputs, constants = columns
        after, terms, (reward, failed, squared, saturated) = step(
            unflatten(PLANT, before), command, inputs, Parameters.of(constants, parts), FLOATS
        )
        np.testing.assert_allclose(found["next_plant"][:, i], flatten(after), rtol=1e-12, atol=1e-13)
        np.testing.assert_allclose(found["next_seen"][:, i], encode(terms, FLOATS, span=1), rtol=1e-12, atol=1e-13)
        outcome = reward, failed, math.sqrt(squared), saturated
        np.testing.assert_allclose(found["outcome"][:, i], outcome, rtol=1e-12, atol=1e-13)


def test_a_start_equals_the_simulation():
    parts, rng = Parts(filtered=True, sheared=True), np.random.default_rng(1)
    _, _, sample, parameters = numbers(rng)
    states = rng.normal(size=(6, N))
    plant, seen = started(parts, states, sample, parameters)
    for i in range(N):
        p = Parameters.of(parameters[:, i].tolist(), parts)
        expected, terms = start(tuple(states[:, i].tolist()), sample[:, i].tolist(), p, FLOATS)
        np.testing.assert_allclose(plant[:, i], flatten(expected), rtol=1e-12)
        np.testing.assert_allclose(seen[:, i], encode(terms, FLOATS, span=1), rtol=1e-12, atol=1e-13)


@pytest.mark.skipif(not native.wanted() or native.compiler() is None, reason="bits are those of compiled code")
def test_results_do_not_depend_on_the_number_of_vehicles():
    """To the last bit, also with vector instructions."""
    kernel, rng = step_kernel(PRESETS["cruise-storm"].parts), np.random.default_rng(2)
    plant, action, sample, parameters = numbers(rng, 37)
    zero = {"seen": np.zeros((SIZE, 37)), "authority": np.zeros((2, 37))}
    all_at_once = kernel(1, plant=plant, action=action, samples=sample[None], parameters=parameters, **zero)
    for i in (0, 7, 36):
        one = slice(i, i + 1)
        alone = kernel(
            1,
            plant=plant[:, one],
            action=action[:, one],
            samples=sample[None, :, one],
            parameters=parameters[:, one],
            **{name: a[:, one] for name, a in zero.items()},
        )
        for name, rows in alone.items():
            np.testing.assert_array_equal(rows[:, 0], all_at_once[name][:, i])


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


def test_a_state_that_is_not_a_number_is_a_failure():
    kernel = step_kernel(Parts())
    plant, action, sample, parameters = numbers(np.random.default_rng(3))
    plant[PLANT.x, 4] = math.nan
    given = {"seen": np.zeros((SIZE, N)), "authority": np.zeros((2, N)), "samples": sample[None]}
    parameters[PARAMETERS.lost_distance] = 100.0
    failed = kernel(1, plant=plant, action=action, parameters=parameters, **given)["outcome"][1]
    assert failed[4] == 1
    assert failed.sum() == 1


def vehicles(n=4):
    envs = SubEnvironments(n, "cruise-storm", None, None)
    first = envs.reset(0, None)
    made = Vehicles(envs.parts, envs.samples, envs.constants)
    made.place(first.indices, first.plant, first.seen)
    made.action[:] = 0.3
    return made


@pytest.mark.parametrize("forces", [None, Backstepping().forces], ids=["commands", "corrections"])
def test_one_vehicle_equals_one_of_many(forces):
    envs = SubEnvironments(1, "cruise-storm", None, None)
    envs.forces = forces
    states, _ = envs.load(envs.all, envs.ready(envs.all, [np.random.default_rng(0)], None))
    plant, seen = started(envs.parts, states, envs.samples[0], envs.constants, forces)
    authority = (0.5, 0.3)
    many, one = (made(envs.parts, envs.samples, envs.constants, forces, authority) for made in (Vehicles, OneVehicle))
    many.place(slice(None), plant, seen)
    one.start(states)
    rng = np.random.default_rng(1)
    for k in range(1, 30):
        np.testing.assert_array_equal(one.seen, many.now.seen[:, 0])
        np.testing.assert_array_equal(one.plant, many.now.plant[:, 0])
        many.action[:, 0] = one.action[0], one.action[1] = rng.uniform(-1, 1, 2)
        many.step(k)
        one.step(k, 1)
        assert one.outcome.tolist() == many.now.outcome[:, 0].tolist()
        if k == 15:
            one = pickle.loads(pickle.dumps(one))
            one._arrays["samples"], one._arrays["parameters"] = envs.samples, envs.constants


def test_a_step_can_be_undone():
    made = vehicles()
    before = made.now.plant.copy()
    made.step(1)
    after = made.now.plant.copy()
    assert (before != after).any()
    made.undo()
    np.testing.assert_array_equal(made.now.plant, before)
    made.step(1)
    np.testing.assert_array_equal(made.now.plant, after)


@pytest.mark.parametrize("twin", [copy.deepcopy, lambda made: pickle.loads(pickle.dumps(made))])
def test_copies_are_independent(twin):
    made = vehicles()
    made.step(1)
    other = twin(made)
    made.step(2)
    expected = made.now.plant.copy()
    made.step(3)
    other.step(2)
    np.testing.assert_array_equal(other.now.plant, expected)


class OtherPredict(Backstepping):
    """A law whose actions are not given by its forces."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.full((*observation.shape[:-1], 2), 0.5, dtype=np.float32), state


def test_only_laws_with_the_actions_of_their_forces_are_traceable():
    assert all(traceable(law) for law in (Backstepping(), OpenLoop(), Zero(), Backstepping(horizon=5.0)))
    assert not any(traceable(policy) for policy in (make_policy("ekf"), OtherPredict(), object()))


@pytest.mark.parametrize(
    "expert", [Backstepping(), Backstepping("normalised", horizon=5.0), OpenLoop(), Zero(), OtherPredict()]
)
def test_the_compiled_correction_is_the_expert_plus_a_correction(expert):
    """Compared with the environment without correction, `predict` of the policy and the formula of residual control."""
    plain = UnderactuatedAUVTrackEnv("cruise-storm")
    env = ResidualAction(UnderactuatedAUVTrackEnv("cruise-storm"), expert, (0.4, 0.7))
    observation, _ = plain.reset(seed=3)
    seen, _ = env.reset(seed=3)
    rng = np.random.default_rng(0)
    assert seen in env.observation_space
    for _ in range(150):
        base = expert.predict(observation)[0]
        np.testing.assert_array_equal(seen, np.append(observation, base))
        action = rng.uniform(-1.5, 1.5, 2)
        command = np.clip(base + np.array((0.4, 0.7)) * np.clip(action, -1, 1), -1, 1)
        observation, reward, *over, _ = plain.step(command)
        seen, corrected_reward, *corrected_over, _ = env.step(action)
        assert (reward, over) == (corrected_reward, corrected_over)
        if any(over):
            break


def test_the_compiled_vector_correction_equals_the_scalar_one():
    def make():
        return UnderactuatedAUVTrackEnv("slow-storm")

    scalars = [ResidualAction(make(), Backstepping(), 0.5) for _ in range(3)]
    env = make_residual_vector_env(3, "slow-storm")
    assert isinstance(env, VectorResidualAction)
    rows, _ = env.reset(seed=5)
    np.testing.assert_array_equal(rows, [e.reset(seed=5 + i)[0] for i, e in enumerate(scalars)])
    rng = np.random.default_rng(1)
    for _ in range(60):
        actions = rng.uniform(-1, 1, (3, 2))
        rows, rewards, *_ = env.step(actions)
        steps = [e.step(a) for e, a in zip(scalars, actions, strict=True)]
        np.testing.assert_array_equal(rows, [s[0] for s in steps])
        np.testing.assert_array_equal(rewards, [s[1] for s in steps])


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


def test_kernels_are_traced_once():
    parts = PRESETS["cruise-storm"].parts
    assert step_kernel(parts) is step_kernel(parts)
    assert start_kernel(parts) is start_kernel(parts)

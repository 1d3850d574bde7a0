"""The simulation as kernels: the same numbers as the equations themselves, for one vehicle and for many."""

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
from auv_gym.envs.lanes import Lanes
from auv_gym.envs.residual import ResidualAction, VectorResidualAction
from auv_gym.envs.track_env import UnderactuatedAUVTrackEnv
from auv_gym.physics.namespaces import FLOATS
from auv_gym.physics.rows import filled, leaves
from auv_gym.task.kernels import OneVehicle, Vehicles, begun, start_kernel, step_kernel
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

LANES = 9


def numbers(rng, n=LANES):
    """Return plausible plants, actions, samples and parameters, rows of n vehicles."""
    plant, samples = rng.normal(size=(PLANT_ROWS, n)), rng.normal(size=(SAMPLE_ROWS, n))
    samples[-1] = rng.integers(0, 2, n)
    parameters = rng.uniform(0.5, 1.5, (PARAMETER_ROWS, n))
    parameters[0] *= 0.1
    return plant, rng.uniform(-1.2, 1.2, (2, n)), samples, parameters


@pytest.mark.parametrize("flags", [[k == j for k in range(6)] for j in range(7)] + [[True] * 6])
def test_a_step_is_the_simulations_own_whatever_is_in_use(flags):
    parts = Parts(2, *flags, crossed=all(flags))
    plant, action, sample, parameters = numbers(np.random.default_rng(0))
    given = {"plant": plant, "seen": np.zeros((SIZE, LANES)), "action": action, "authority": np.zeros((2, LANES))}
    found = step_kernel(parts)(1, **given, samples=sample[None], parameters=parameters)
    for i in range(LANES):
        columns = (a[:, i].tolist() for a in (plant, action, sample, parameters))
        before, command, outside, constants = columns
        after, terms, (reward, failed, squared, saturated) = step(
            filled(PLANT, before), command, outside, Parameters.of(constants, parts), FLOATS
        )
        np.testing.assert_allclose(found["next_plant"][:, i], leaves(after), rtol=1e-12, atol=1e-13)
        np.testing.assert_allclose(found["next_seen"][:, i], encode(terms, FLOATS, span=1), rtol=1e-12, atol=1e-13)
        outcome = reward, failed, math.sqrt(squared), saturated
        np.testing.assert_allclose(found["outcome"][:, i], outcome, rtol=1e-12, atol=1e-13)


def test_a_start_is_the_simulations_own():
    parts, rng = Parts(filtered=True, sheared=True), np.random.default_rng(1)
    _, _, sample, parameters = numbers(rng)
    states = rng.normal(size=(6, LANES))
    plant, seen = begun(parts, states, sample, parameters)
    for i in range(LANES):
        p = Parameters.of(parameters[:, i].tolist(), parts)
        expected, terms = start(tuple(states[:, i].tolist()), sample[:, i].tolist(), p, FLOATS)
        np.testing.assert_allclose(plant[:, i], leaves(expected), rtol=1e-12)
        np.testing.assert_allclose(seen[:, i], encode(terms, FLOATS, span=1), rtol=1e-12, atol=1e-13)


@pytest.mark.skipif(not native.wanted() or native.compiler() is None, reason="bits are those of compiled code")
def test_a_vehicle_goes_the_same_way_alone_and_among_others():
    """To the bit, whatever the compiler's vectors hold."""
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
def test_bits_do_not_depend_on_the_compiler(tmp_path):
    """Nor on its level of optimisation, or on the processor's instructions, which one of them does not know."""
    slow = tmp_path / "unoptimised"
    slow.write_text(
        f'#!/bin/sh\nfor a; do shift; case "$a" in -march=*) exit 1;; -O1) ;; *) set -- "$@" "$a";; esac; done\n'
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


def test_what_is_no_number_is_lost():
    kernel = step_kernel(Parts())
    plant, action, sample, parameters = numbers(np.random.default_rng(3))
    plant[PLANT.x, 4] = math.nan
    given = {"seen": np.zeros((SIZE, LANES)), "authority": np.zeros((2, LANES)), "samples": sample[None]}
    parameters[PARAMETERS.lost_distance] = 100.0
    failed = kernel(1, plant=plant, action=action, parameters=parameters, **given)["outcome"][1]
    assert failed[4] == 1
    assert failed.sum() == 1


def vehicles(n=4):
    lanes = Lanes(n, "cruise-storm", None, None)
    beginning = lanes.reset(0, None)
    made = Vehicles(lanes.parts, lanes.samples, lanes.constants)
    made.place(beginning.lanes, beginning.plant, beginning.seen)
    made.action[:] = 0.3
    return made


@pytest.mark.parametrize("forces", [None, Backstepping().forces], ids=["commands", "corrections"])
def test_one_vehicle_is_one_of_many(forces):
    lanes = Lanes(1, "cruise-storm", None, None)
    lanes.forces = forces
    states, _ = lanes.load(lanes.all, lanes.ready(lanes.all, [np.random.default_rng(0)], None))
    plant, seen = begun(lanes.parts, states, lanes.samples[0], lanes.constants, forces)
    authority = (0.5, 0.3)
    many, one = (
        made(lanes.parts, lanes.samples, lanes.constants, forces, authority) for made in (Vehicles, OneVehicle)
    )
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
            one._arrays["samples"], one._arrays["parameters"] = lanes.samples, lanes.constants


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
def test_copies_have_a_memory_of_their_own(twin):
    made = vehicles()
    made.step(1)
    other = twin(made)
    made.step(2)
    expected = made.now.plant.copy()
    made.step(3)
    other.step(2)
    np.testing.assert_array_equal(other.now.plant, expected)


class Stubborn(Backstepping):
    """A law that does something else than its forces say."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.full((*observation.shape[:-1], 2), 0.5, dtype=np.float32), state


def test_only_what_follows_its_forces_is_compiled():
    assert all(traceable(law) for law in (Backstepping(), OpenLoop(), Zero(), Backstepping(horizon=5.0)))
    assert not any(traceable(policy) for policy in (make_policy("ekf"), Stubborn(), object()))


@pytest.mark.parametrize(
    "expert", [Backstepping(), Backstepping("normalised", horizon=5.0), OpenLoop(), Zero(), Stubborn()]
)
def test_the_compiled_correction_is_the_expert_plus_a_correction(expert):
    """Against the environment without it, the policy's own `predict` and the rule of residual control."""
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


def test_the_compiled_vector_correction_is_the_scalar_one():
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


def test_a_refused_law_says_what_a_symbol_cannot_do():
    class Branching(Law):
        def forces(self, o, ns=FLOATS):
            return (1.0, 0.0) if o[0] > 0 else (0.0, 1.0)

    with pytest.raises(TypeError, match="choose between two values with `where`"):
        ResidualAction(UnderactuatedAUVTrackEnv(), Branching())


def test_kernels_are_traced_once():
    parts = PRESETS["cruise-storm"].parts
    assert step_kernel(parts) is step_kernel(parts)
    assert start_kernel(parts) is start_kernel(parts)

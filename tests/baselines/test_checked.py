"""The check of measurements: it replaces those that a fault has changed, and no others."""

from dataclasses import replace

import numpy as np
import pytest
from marks import slow_except

from auv_gym.envs.track_vector_env import UnderactuatedAUVTrackVectorEnv
from auv_gym.physics.faults import Fault, RandomFaults
from auv_gym.scenarios.presets import PRESETS
from auv_gym.task.observation import SIZE, decode_observation
from baselines.agents.checked import CHECK_ROWS, Checked
from baselines.agents.names import bare_name, checked_name
from baselines.evaluation.fingerprints import fingerprint
from baselines.policies import make_policy

N = 4
BEGIN, END = 150, 230  # control steps


class Recorder:
    """A policy that keeps the observations that it gets, and acts as another one."""

    def __init__(self, policy):
        self.policy, self.preview, self.seen = policy, policy.preview, []

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        self.seen.append(observation.copy())
        return self.policy.predict(observation, state, episode_start, deterministic)


def run(name, scenario, *faults, steps=300):
    """Return the states over ground (steps, N, 6), and the observations of environment and policy (steps, N, n)."""
    recorder = Recorder(make_policy(name))
    policy, memory = Checked(recorder), None
    env = UnderactuatedAUVTrackVectorEnv(N, scenario, preview=policy.preview)
    episodes = [replace(scenario.draw(np.random.default_rng([4, i])), faults=faults) for i in range(N)]
    observation, _ = env.reset(seed=0, options={"episode": episodes})
    true, given = [], []
    for _ in range(steps):
        x, y, psi, u, v, r = env.state.T
        V_x, V_y = env.current.T
        c, s = np.cos(psi), np.sin(psi)
        true.append((x, y, psi, u + c * V_x + s * V_y, v - s * V_x + c * V_y, r))
        given.append(observation.copy())
        action, memory = policy.predict(observation, memory)
        observation, *_ = env.step(action)
    assert memory[0].shape == (N, CHECK_ROWS)
    return np.array(true).transpose(0, 2, 1), np.array(given), np.array(recorder.seen)


@pytest.mark.parametrize("case", slow_except(["storm"], ["calm", "mismatch", "actuator", "storm"]))
@pytest.mark.parametrize("speed_range", ["slow", "cruise"])
def test_without_faults_nothing_is_replaced(speed_range, case):
    """After the start, in which the vehicle is far from its reference; a policy that keeps up is taken."""
    _, given, seen = run("helm", PRESETS[f"{speed_range}-{case}"])
    np.testing.assert_array_equal(seen, given)


@pytest.mark.parametrize(
    ("kind", "row", "most"),
    [
        ("heading frozen", 2, 0.12),
        ("velocity frozen", 3, 0.3),
        ("velocity missing", 3, 0.3),
        ("yaw rate frozen", 5, 0.08),
    ],
)
def test_a_changed_measurement_is_replaced_by_one_close_to_the_truth(kind, row, most):
    """Mean error over the fault in storms, beside that of the measurement; the other measurements stay."""
    scenario = replace(PRESETS["cruise-storm"], faults=RandomFaults((kind,)))
    true, given, seen = run("helm", scenario, Fault(kind, 0.1 * BEGIN - 0.05, 0.1 * END - 0.05))
    errors = []
    for rows in (given, seen):
        o = decode_observation(rows[BEGIN:END].reshape(-1, rows.shape[-1])[:, :SIZE])
        measured = {2: np.arctan2(o.sin_psi, o.cos_psi), 3: o.u_R + o.u_e, 5: o.r_R + o.r_e}[row]
        off = measured - true[BEGIN:END, :, row].ravel()
        errors.append(np.abs((off + np.pi) % (2 * np.pi) - np.pi if row == 2 else off).mean())
    raw, replaced = errors
    assert replaced < most
    assert replaced < 0.6 * raw
    np.testing.assert_array_equal(seen[:BEGIN], given[:BEGIN])
    assert (seen[BEGIN + 2 : END] != given[BEGIN + 2 : END]).any(axis=2).all()
    np.testing.assert_array_equal(seen[END + 60 :], given[END + 60 :])


def test_a_preview_turns_with_a_replaced_heading():
    kind = "heading frozen"
    scenario = replace(PRESETS["cruise-storm"], faults=RandomFaults((kind,)))
    _, given, seen = run("helm", scenario, Fault(kind, 0.1 * BEGIN - 0.05, 0.1 * END - 0.05))
    in_world = []
    for rows in (given[END - 1], seen[END - 1]):
        o = decode_observation(rows)
        x, y = rows[:, SIZE], rows[:, SIZE + 1]
        in_world.append((x * o.cos_psi - y * o.sin_psi, x * o.sin_psi + y * o.cos_psi))
    np.testing.assert_allclose(in_world[0], in_world[1], atol=1e-4)
    assert np.abs(given[END - 1, :, SIZE:] - seen[END - 1, :, SIZE:]).max() > 0.01


def test_a_batch_equals_single_vehicles():
    scenario = replace(PRESETS["cruise-storm"], faults=RandomFaults(("velocity missing",), rate=10.0))
    env = UnderactuatedAUVTrackVectorEnv(N, scenario)
    policy = make_policy("backstepping:checked")
    observation, _ = env.reset(seed=3)
    memory, alone = None, [None] * N
    for _ in range(150):
        action, memory = policy.predict(observation, memory)
        for i in range(N):
            one, alone[i] = policy.predict(observation[i], alone[i])
            np.testing.assert_allclose(one, action[i], atol=1e-6)
        observation, *_ = env.step(action)


def test_a_real_difference_is_accepted_after_a_while():
    """A mission that moves by 4 m looks like a position that jumps."""
    kind = "position jump"
    scenario = replace(PRESETS["cruise-storm"], faults=RandomFaults((kind,)))
    _, given, seen = run("helm", scenario, Fault(kind, 0.1 * BEGIN - 0.05, 60.0, (4.0, 0.0)))
    assert (seen[BEGIN : BEGIN + 20] != given[BEGIN : BEGIN + 20]).any(axis=2).all()
    np.testing.assert_array_equal(seen[BEGIN + 70 :], given[BEGIN + 70 :])


def test_names_with_the_suffix():
    assert checked_name("helm:guard=ekf:checked") == "helm:guard=ekf"
    assert [checked_name(name) for name in ("helm", ":checked", "cmd:x:checked", "helm:checked:guard")] == [None] * 4
    assert bare_name("apg-slow:fade:guard=ekf:checked") == "apg-slow"
    names = "helm", "helm:checked", "helm:guard=ekf", "helm:guard=ekf:checked", "nmpc:checked"
    assert len({fingerprint(name) for name in names} - {""}) == len(names)
    assert fingerprint("helmet:checked") == ""


def test_the_suffix_works_for_every_policy_and_vehicle():
    observation = np.zeros(SIZE)
    observation[[6, 11, 13, 14, 17]] = 1.0
    for name in ("backstepping", "lqi", "nmpc", "helm-small:guard"):
        policy = make_policy(f"{name}:checked", "lauv")
        rows = np.concatenate((observation, np.zeros(2 * len(policy.preview))))
        action, _ = policy.predict(rows)
        assert np.isfinite(action).all()

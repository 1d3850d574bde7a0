"""Failure rates and guards: intervals against simulations, alarms by hand, recorded results."""

import itertools
import json
import math
from dataclasses import replace
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from auv_gym import PRESETS
from auv_gym.physics.namespaces import ARRAYS
from auv_gym.physics.vehicle import PAPER_VEHICLE
from auv_gym.task.observation import Observation, encode_observation
from baselines import make_policy
from baselines.agents import guard
from baselines.agents.guard import ALARMS, GUARD_SHARE, LEFT, MEAN, Guarded, Thresholds, bounded_law
from baselines.agents.names import bare_name, guarded_name
from baselines.control.backstepping import GAINS, lyapunov_terms
from baselines.evaluation import recorded, suites
from baselines.evaluation.fingerprints import fingerprint
from baselines.evaluation.rollout import rollout
from baselines.evaluation.runner import drawn
from baselines.evaluation.score import count_failures
from baselines.tools.command_line import run
from baselines.tools.files import read_json
from research.robustness import failure_rate, guards
from research.seeds import FAILURE_RATE


def observed(**terms):
    """Return an observation at cruise with the given terms; all other errors are zero."""
    usual = {"u_R": 1.0, "cos_psi": 1.0, "F_u_max": 400.0, "F_r_max": 200.0, "dt": 0.1}
    return encode_observation(Observation(**{**dict.fromkeys(Observation._fields, 0.0), **usual, **terms}))


class Constant:
    """A policy with a constant action."""

    def __init__(self, *action):
        self.action = np.array(action, dtype=np.float32)

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.tile(self.action, (len(observation), 1)) if observation.ndim > 1 else self.action, state


def guard_steps(observations):
    """Return the commands and the memory of a guard for a sequence of observations."""
    policy, state, found = Guarded(Constant(0.5, -0.5), Constant(-1.0, 1.0)), None, []
    for o in observations:
        action, state = policy.predict(o, state)
        found.append((action, state[0][0].copy()))
    return found


# --- the failure rate ---


def test_failures_are_counted_and_later_runs_continue(tmp_path, monkeypatch, capsys):
    """Without feedback the vehicle drifts away: counts are those of single episodes, and more are added to them."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(failure_rate, "_BATCH", 3)
    arguments = ["open-loop", "--scenario", "slow-current", "--out", "counts.json"]
    assert run(failure_rate.main, failure_rate.PROGRAM, [*arguments, "--episodes", "4"]) == 0
    scenario = PRESETS["slow-current"]
    measures = rollout(make_policy("open-loop"), scenario, drawn(scenario, 4, FAILURE_RATE.first).episodes).measures
    failed = count_failures(measures, 0.6)
    assert failed > 0
    assert f"{failed} of 4 failed, 95 % upper bound" in capsys.readouterr().out
    (count,) = failure_rate.failure_counts(Path("counts.json"))["open-loop"]["counts"].values()
    assert (count["episodes"], count["failed"]) == (4, failed)
    monkeypatch.setattr(failure_rate, "_run", lambda _, __, first, episodes: (episodes, 0, 1e3 + first))
    assert run(failure_rate.main, failure_rate.PROGRAM, [*arguments, "--episodes", "6"]) == 0
    assert f"{failed} of 6 failed" in capsys.readouterr().out
    (count,) = failure_rate.failure_counts(Path("counts.json"))["open-loop"]["counts"].values()
    assert count["largest_steady_rmse_m"] == 1004.0  # the new episodes start at number 4
    record = json.loads(Path("counts.json").read_text(encoding="utf-8"))
    record["open-loop"]["fingerprint"] = "another"
    Path("counts.json").write_text(json.dumps(record), encoding="utf-8")
    assert run(failure_rate.main, failure_rate.PROGRAM, [*arguments, "--episodes", "3"]) == 0
    assert "0 of 3 failed" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("command", "arguments", "says"),
    [
        (failure_rate, ["helm", "--episodes", "0"], "--episodes is 0; it must be in [1, 10000000]"),
        (failure_rate, ["helm", "--scenario", "storm"], "unknown scenario 'storm'; allowed are"),
        (failure_rate, ["helmet"], "unknown policy 'helmet'"),
        (guards, ["--episodes", "0"], "--episodes is 0; it must be 1 or more"),
        (guards, ["--policy", "helmet"], "unknown policy 'helmet'"),
    ],
)
def test_wrong_usage_is_one_line(command, arguments, says, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert run(command.main, command.PROGRAM, arguments) == 2
    err = capsys.readouterr().err
    assert says in err
    assert err.count("\n") == 1


# --- the guard ---


def test_names_of_guards():
    assert guarded_name("helm:guard") == ("helm", "")
    assert guarded_name("a.py:f:guard=ekf") == ("a.py:f", "ekf")
    assert [guarded_name(name) for name in ("helm", ":guard", "helm:guards", "helm:guard=", "cmd:x:guard")] == [
        None
    ] * 5
    assert bare_name("apg-slow:fade:guard=ekf") == "apg-slow"
    assert len({fingerprint(name) for name in ("helm", "helm:guard", "helm:guard=ekf")}) == 3
    assert fingerprint("helmet:guard") == ""
    assert recorded.speed_ranges_of("apg-slow:guard") == ("slow",)
    with pytest.raises(ValueError, match="unknown policy 'dog'"):
        make_policy("helm:guard=dog")


def test_energy_is_the_scaled_lyapunov_function():
    """At 1 m/s and in units of T = 1/(k + k1), against V4 of errors that are scaled by hand."""
    gains, rate = GAINS["cruise"], GAINS["cruise"].k + GAINS["cruise"].k1
    o = Observation(*np.zeros((18, 1)))._replace(e_x=np.array([1.0 / rate]), u_R=np.array([1.0]))
    found, found_rate = guard.energy(o, PAPER_VEHICLE)
    assert found_rate[0] == rate
    assert found[0] == pytest.approx(0.5 * (1.0 + 1.0))  # e and z_u = (k + k1) e; z_v, psi_e and z_r are 0
    turned = o._replace(e_x=np.zeros(1), psi_e=np.array([0.3]))
    V4 = lyapunov_terms(turned, PAPER_VEHICLE, gains, ARRAYS)[3]
    z_r = gains.cr * 0.3
    assert V4[0] == pytest.approx(0.5 * (0.09 + z_r**2))
    assert guard.energy(turned, PAPER_VEHICLE)[0][0] == pytest.approx(0.5 * (0.09 + (z_r / rate) ** 2))


def test_decreasing_errors_raise_no_alarm():
    for action, own in guard_steps([observed(e_x=0.5 * math.exp(-0.02 * k), a_r=1.0) for k in range(100)]):
        np.testing.assert_array_equal(action, np.float32([0.5, -0.5]))
        assert (own[ALARMS], own[GUARD_SHARE], own[LEFT]) == (0, 1, 0)


def test_a_growing_error_raises_an_alarm_and_the_fallback_takes_over_smoothly():
    """The error grows linearly: its energy (rate e)^2 reaches the threshold, and it is twice its mean."""
    t, rate = Thresholds(), GAINS["cruise"].k + GAINS["cruise"].k1
    found = guard_steps([observed(e_x=0.1 * k) for k in range(200)])
    first = next(k for k, (_, own) in enumerate(found) if own[ALARMS])
    assert (rate * 0.1 * first) ** 2 > t.most > (rate * 0.1 * (first - 1)) ** 2
    shares = [own[GUARD_SHARE] for _, own in found[first : first + 10]]
    assert all(0 <= a - b <= 0.1 * rate / t.take + 1e-9 for a, b in itertools.pairwise(shares))
    for action, own in found:
        expected = np.float32([0.5, -0.5]) * own[GUARD_SHARE] + np.float32([-1.0, 1.0]) * (1 - own[GUARD_SHARE])
        np.testing.assert_allclose(action, expected, atol=1e-6)
    assert found[first + 10][1][GUARD_SHARE] == 0
    np.testing.assert_array_equal(found[first + 10][0], np.float32([-1.0, 1.0]))


def test_the_threshold_is_lower_while_the_yaw_command_is_saturated():
    """The energy rises from 1 to 36: an alarm only if the command has been saturated."""
    errors = [0.8 + 4.0 * min(1.0, max(0.0, k / 20 - 5)) for k in range(200)]
    assert not any(own[ALARMS] for _, own in guard_steps([observed(e_x=e, a_r=0.9) for e in errors]))
    assert guard_steps([observed(e_x=e, a_r=-1.0) for e in errors])[-1][1][ALARMS] == 1


def test_large_errors_that_do_not_grow_raise_no_alarm():
    """A far start, and a current that is too strong for the law: large energies that do not grow."""
    assert guard_steps([observed(e_x=12 * math.exp(-0.01 * k), a_r=1.0) for k in range(200)])[-1][1][ALARMS] == 0
    assert guard_steps([observed(e_x=12.0, a_r=1.0) for _ in range(300)])[-1][1][ALARMS] == 0


def test_the_policy_regains_control_and_later_after_each_alarm():
    """The error is zero while the fallback has control, and grows again afterwards."""
    t, rate = Thresholds(hold=4.0, longer=3.0), GAINS["cruise"].k + GAINS["cruise"].k1
    policy, state, held, e = Guarded(Constant(0.5, -0.5), Constant(-1.0, 1.0), thresholds=t), None, [], 0.0
    for _ in range(900):
        e = 0.0 if state is not None and state[0][0, LEFT] > 0 else e + 0.2
        _, state = policy.predict(observed(e_x=e), state)
        held.append(state[0][0, LEFT])
    begins = [h for before, h in itertools.pairwise(held) if h > before]
    np.testing.assert_allclose(begins[:3], [4.0 / rate, 12.0 / rate, 36.0 / rate])


def test_the_memory_is_reset_with_the_episode():
    policy = Guarded(Constant(0.5, -0.5), Constant(-1.0, 1.0))
    state = None
    for k in range(100):
        rows = np.stack([observed(e_x=0.2 * k)] * 2)
        _, state = policy.predict(rows, state)
    assert state[0][:, ALARMS].tolist() == [1, 1]
    _, state = policy.predict(rows, state, np.array([True, False]))
    assert state[0][:, ALARMS].tolist() == [0, 1]
    assert state[0][0, MEAN] > state[0][1, MEAN]


def test_without_an_alarm_an_agent_with_a_guard_is_the_agent():
    scenario = PRESETS["cruise-noise"]
    episodes = drawn(scenario, 3, 7).episodes
    own, guarded = (rollout(make_policy(name), scenario, episodes) for name in ("apg-cruise", "apg-cruise:guard"))
    np.testing.assert_array_equal(own.errors, guarded.errors)


class Saturated:
    """An agent whose commands are saturated after some control steps."""

    def __init__(self, policy, after):
        self._policy, self.preview, self._left = policy, policy.preview, after

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        self._left -= 1
        actions, state = self._policy.predict(observation, state, episode_start)
        return actions if self._left >= 0 else np.ones_like(actions), state


def test_the_law_takes_over_from_a_saturated_agent():
    """Without a guard the vehicle turns in circles until the end; with one it returns to the path."""
    scenario = PRESETS["cruise-calm"]
    episodes = drawn(scenario, 2, 7).episodes
    plain, inner = (Saturated(make_policy("apg-preview-cruise"), scenario.steps // 3) for _ in range(2))
    without, guarded = (rollout(p, scenario, episodes).errors[-1] for p in (plain, Guarded(inner, bounded_law())))
    assert (without > 2.0).all()
    assert (guarded < 2.0).all()


def test_after_the_handover_the_commands_are_those_of_the_fallback_bit_for_bit():
    """With a very low threshold the fallback takes over within the first second."""
    eager = Guarded(make_policy("helm"), make_policy("ekf"), thresholds=Thresholds(most=1e-3, start=1e-3, growth=1e-3))
    env = gym.make("auv_gym:UnderactuatedAUVTrack-v0", scenario="cruise-storm", preview=eager.preview)
    state, law, memory, taken = None, make_policy("ekf"), None, 0
    observation, _ = env.reset(seed=3)
    for _ in range(60):
        action, state = eager.predict(observation, state)
        alone, memory = law.predict(observation[:18], memory)
        if state[0][0, GUARD_SHARE] == 0:
            np.testing.assert_array_equal(action, alone)
            taken += 1
        observation, *_ = env.step(action)
    assert taken > 40


def test_a_quick_form_of_the_command(tmp_path, monkeypatch):
    """One case of each speed range in which the agent runs with and without a guard, against rollouts."""
    suite = suites.load_suite("sealed-v2")
    few = replace(suite, cells=tuple(cell for cell in suite.cells if cell.scenario.name.endswith("-slew")))
    monkeypatch.setattr(guards, "SUITES", ("few",))
    monkeypatch.setattr(guards, "load_suite", lambda _: few)
    out, policy = tmp_path / "guards.json", "apg-preview-cruise"
    words = ["--policy", policy, "--episodes", "2", "--jobs", "1", "--out", str(out)]
    assert run(guards.main, guards.PROGRAM, words) == 0
    record = read_json(out)
    cell = next(cell for cell in few.cells if cell.scenario.name == "cruise-slew")
    for name in (policy, f"{policy}:guard"):
        assert set(record[name]) == {"fingerprint", "cruise-slew"}  # not in slow motion
        found = rollout(make_policy(name), cell.scenario, cell.episodes[:2]).measures
        failed = found.failed | (found.steady_rmse >= 2.0)
        row = record[name]["cruise-slew"]
        assert (row["episodes"], row["failed"]) == (2, failed.sum())
        assert row["error_mm"] == pytest.approx(1e3 * np.where(failed, 2.0, found.steady_rmse).mean(), abs=0.01)
    monkeypatch.setattr(guards, "GUARDS_FILE", out)
    ((agent, _, episodes, text),) = guards.compared()
    assert (agent, episodes) == (f"`{policy}`", "2")
    assert text.startswith(f"{record[policy]['cruise-slew']['failed']}; ")


def test_the_reference_policy_does_not_fail():
    """As docs/metrics.md says."""
    failed, episodes, _ = failure_rate.total(failure_rate.failure_counts()["clairvoyant"]["counts"].values())
    assert (failed, episodes) == (0, 10_000)


def test_recorded_rows_belong_to_the_present_policies():
    for policy, own in failure_rate.failure_counts().items():
        assert own["fingerprint"] == fingerprint(policy), f"run {failure_rate.PROGRAM} {policy} again"
    for policy, rows in read_json(guards.GUARDS_FILE).items():
        assert rows["fingerprint"] == fingerprint(policy), f"run {guards.PROGRAM} again"


def test_a_guard_helps_an_agent_that_was_not_trained_on_rate_limits_and_not_helm():
    """As docs/safety.md says, in sealed-v2."""
    sealed = {cell.scenario.name for cell in suites.load_suite("sealed-v2").cells}
    failed = {
        policy: sum(row["failed"] for name, row in rows.items() if name in sealed)
        for policy, rows in read_json(guards.GUARDS_FILE).items()
    }
    assert failed["apg-preview-cruise"] > failed["apg-preview-cruise:guard"]
    assert failed["helm"] < failed["helm:guard"]

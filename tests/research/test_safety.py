"""Certificates, guards and seas: intervals against simulations, alarms by hand, and seas that lose whom they should."""

import itertools
import json
import math
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from scipy import stats

from auv_gym import PRESETS, Scenario
from auv_gym.installation import found
from auv_gym.physics.namespaces import ARRAYS
from auv_gym.physics.vehicle import PAPER_VEHICLE
from auv_gym.scenarios.mixtures import adverse
from auv_gym.scenarios.presets import SPEED_RANGES
from auv_gym.task.observation import Observation, encode_observation
from baselines import make_policy
from baselines.agents import guard
from baselines.agents.guard import ALARMS, GUARD_SHARE, LEFT, MEAN, Guarded, Thresholds, bounded_law
from baselines.agents.names import bare_name, guarded_name
from baselines.control.backstepping import GAINS, lyapunov_terms
from baselines.evaluation import recorded, suites
from baselines.evaluation.fingerprints import fingerprint
from baselines.evaluation.metrics import failure_bound
from baselines.evaluation.rollout import rollout
from baselines.evaluation.runner import drawn
from baselines.evaluation.score import count_failures
from baselines.tools.command_line import run
from baselines.tools.files import read_json
from research.results.learning import versus_expert
from research.robustness import failure_rate, falsification, guards, seas
from research.seeds import FAILURE_RATE, FALSIFICATION

ROOT = Path(__file__).parents[2]


def observed(**terms):
    """An observation at cruise, all errors zero but for those that are given."""
    usual = {"u_R": 1.0, "cos_psi": 1.0, "F_u_max": 400.0, "F_r_max": 200.0, "dt": 0.1}
    return encode_observation(Observation(**{**dict.fromkeys(Observation._fields, 0.0), **usual, **terms}))


class Says:
    """A policy that says one thing."""

    def __init__(self, *action):
        self.action = np.array(action, dtype=np.float32)

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.tile(self.action, (len(observation), 1)) if observation.ndim > 1 else self.action, state


def watched(observations):
    """What a guard does with observations: its commands and its memory, step by step."""
    policy, state, found = Guarded(Says(0.5, -0.5), Says(-1.0, 1.0)), None, []
    for o in observations:
        action, state = policy.predict(o, state)
        found.append((action, state[0][0].copy()))
    return found


# --- the failure rate ---


@pytest.mark.parametrize(("failed", "episodes"), [(0, 10_000), (3, 500), (7, 40)])
def test_upper_end_is_the_beta_quantile_and_covers(failed, episodes):
    top = failure_bound(failed, episodes)
    assert top == pytest.approx(stats.beta.ppf(0.95, failed + 1, episodes - failed), rel=1e-6)
    counts = np.random.default_rng(0).binomial(episodes, top, 20_000)
    assert np.mean(counts <= failed) == pytest.approx(0.05, abs=0.006)


def test_unequal_chances_only_make_it_safer():
    """Scenarios with chances of 0 to 0.2 and a mean of 0.05: the interval covers the mean at least as often."""
    rng = np.random.default_rng(1)
    counts = sum(rng.binomial(25, p, 4000) for p in (0.0, 0.0, 0.0, 0.2))
    covered = np.mean([failure_bound(int(k), 100) >= 0.05 for k in counts])
    assert covered >= 0.95


def test_failures_are_counted_and_counting_goes_on(tmp_path, monkeypatch, capsys):
    """Open loop drifts away: the counts are those of the episodes run here one by one; more are added to them."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(failure_rate, "_AT_ONCE", 3)
    arguments = ["open-loop", "--scenario", "slow-current", "--out", "counts.json"]
    assert run(failure_rate.main, failure_rate.PROGRAM, [*arguments, "--episodes", "4"]) == 0
    scenario = PRESETS["slow-current"]
    measures = rollout(make_policy("open-loop"), scenario, drawn(scenario, 4, FAILURE_RATE.first).episodes).measures
    failed = count_failures(measures, 0.6)
    assert failed > 0
    assert f"{failed} of 4 lost, at most" in capsys.readouterr().out
    (count,) = failure_rate.failure_counts(Path("counts.json"))["open-loop"]["counts"].values()
    assert (count["episodes"], count["failed"]) == (4, failed)
    monkeypatch.setattr(failure_rate, "_counted", lambda _, __, first, episodes: (episodes, 0, 1e3 + first))
    assert run(failure_rate.main, failure_rate.PROGRAM, [*arguments, "--episodes", "6"]) == 0
    assert f"{failed} of 6 lost" in capsys.readouterr().out
    (count,) = failure_rate.failure_counts(Path("counts.json"))["open-loop"]["counts"].values()
    assert count["largest_steady_rmse_m"] == 1004.0  # the new ones began at the fourth
    record = json.loads(Path("counts.json").read_text(encoding="utf-8"))
    record["open-loop"]["fingerprint"] = "another"
    Path("counts.json").write_text(json.dumps(record), encoding="utf-8")
    assert run(failure_rate.main, failure_rate.PROGRAM, [*arguments, "--episodes", "3"]) == 0
    assert "0 of 3 lost" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("command", "arguments", "says"),
    [
        (failure_rate, ["helm", "--episodes", "0"], "--episodes is 0; it must be in [1, 10000000]"),
        (failure_rate, ["helm", "--scenario", "storm"], "unknown scenario 'storm'; allowed are"),
        (failure_rate, ["helmet"], "unknown policy 'helmet'"),
        (falsification, ["helm", "--speed-range", "fast"], "unknown speed range 'fast'; allowed are slow, cruise"),
        (falsification, ["helm", "--sea", "rough"], "unknown sea 'rough'; allowed are storm, adverse"),
        (falsification, ["helm", "--generations", "0"], "--generations is 0; it must be in [1, 10000]"),
        (guards, ["--suite", "paper"], "unknown suite 'paper'; allowed are benchmark-v1"),
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


def test_energy_is_the_laws_in_its_own_units():
    """At 1 m/s and in units of T = 1/(k + k1): V4 of errors that are scaled by hand."""
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


def test_nothing_happens_where_nothing_is_wrong():
    for action, own in watched([observed(e_x=0.5 * math.exp(-0.02 * k), a_r=1.0) for k in range(100)]):
        np.testing.assert_array_equal(action, np.float32([0.5, -0.5]))
        assert (own[ALARMS], own[GUARD_SHARE], own[LEFT]) == (0, 1, 0)


def test_error_that_grows_is_an_alarm_and_the_other_one_takes_over_smoothly():
    """An error that grows steadily: its energy (rate e)^2 reaches the most that is allowed, and is twice its mean."""
    t, rate = Thresholds(), GAINS["cruise"].k + GAINS["cruise"].k1
    found = watched([observed(e_x=0.1 * k) for k in range(200)])
    first = next(k for k, (_, own) in enumerate(found) if own[ALARMS])
    assert (rate * 0.1 * first) ** 2 > t.most > (rate * 0.1 * (first - 1)) ** 2
    shares = [own[GUARD_SHARE] for _, own in found[first : first + 10]]
    assert all(0 <= a - b <= 0.1 * rate / t.take + 1e-9 for a, b in itertools.pairwise(shares))
    for action, own in found:
        expected = np.float32([0.5, -0.5]) * own[GUARD_SHARE] + np.float32([-1.0, 1.0]) * (1 - own[GUARD_SHARE])
        np.testing.assert_allclose(action, expected, atol=1e-6)
    assert found[first + 10][1][GUARD_SHARE] == 0
    np.testing.assert_array_equal(found[first + 10][0], np.float32([-1.0, 1.0]))


def test_less_is_allowed_while_the_yaw_command_is_at_its_limit():
    """An energy that rises from 1 to 36: none of a guard's business, unless the command has been at its limit."""
    errors = [0.8 + 4.0 * min(1.0, max(0.0, k / 20 - 5)) for k in range(200)]
    assert not any(own[ALARMS] for _, own in watched([observed(e_x=e, a_r=0.9) for e in errors]))
    assert watched([observed(e_x=e, a_r=-1.0) for e in errors])[-1][1][ALARMS] == 1


def test_what_is_far_away_and_grows_no_more_is_no_alarm():
    """A far start, and a current that the law cannot hold: energies beyond all limits, neither of which grows."""
    assert watched([observed(e_x=12 * math.exp(-0.01 * k), a_r=1.0) for k in range(200)])[-1][1][ALARMS] == 0
    assert watched([observed(e_x=12.0, a_r=1.0) for _ in range(300)])[-1][1][ALARMS] == 0


def test_it_gives_back_and_each_time_later():
    """The error is gone as soon as the other one has taken over, and comes again when it has given back."""
    t, rate = Thresholds(hold=4.0, longer=3.0), GAINS["cruise"].k + GAINS["cruise"].k1
    policy, state, held, e = Guarded(Says(0.5, -0.5), Says(-1.0, 1.0), thresholds=t), None, [], 0.0
    for _ in range(900):
        e = 0.0 if state is not None and state[0][0, LEFT] > 0 else e + 0.2
        _, state = policy.predict(observed(e_x=e), state)
        held.append(state[0][0, LEFT])
    begins = [h for before, h in itertools.pairwise(held) if h > before]
    np.testing.assert_allclose(begins[:3], [4.0 / rate, 12.0 / rate, 36.0 / rate])


def test_memory_begins_anew_with_the_episode():
    policy = Guarded(Says(0.5, -0.5), Says(-1.0, 1.0))
    state = None
    for k in range(100):
        rows = np.stack([observed(e_x=0.2 * k)] * 2)
        _, state = policy.predict(rows, state)
    assert state[0][:, ALARMS].tolist() == [1, 1]
    _, state = policy.predict(rows, state, np.array([True, False]))
    assert state[0][:, ALARMS].tolist() == [0, 1]
    assert state[0][0, MEAN] > state[0][1, MEAN]


def test_agent_with_a_guard_is_the_agent_where_nothing_is_wrong():
    scenario = PRESETS["cruise-noise"]
    episodes = drawn(scenario, 3, 7).episodes
    own, guarded = (rollout(make_policy(name), scenario, episodes) for name in ("apg-cruise", "apg-cruise:guard"))
    np.testing.assert_array_equal(own.errors, guarded.errors)


class Stuck:
    """An agent whose commands stay at their limits after some control steps."""

    def __init__(self, policy, after):
        self._policy, self.preview, self._left = policy, policy.preview, after

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        self._left -= 1
        actions, state = self._policy.predict(observation, state, episode_start)
        return actions if self._left >= 0 else np.ones_like(actions), state


def test_law_takes_over_from_an_agent_that_is_stuck():
    """Without a guard the vehicle turns in circles until the end; with one it comes back."""
    scenario = PRESETS["cruise-calm"]
    episodes = drawn(scenario, 2, 7).episodes
    bare, inner = (Stuck(make_policy("apg-preview-cruise"), scenario.steps // 3) for _ in range(2))
    gone, back = (rollout(who, scenario, episodes).errors[-1] for who in (bare, Guarded(inner, bounded_law())))
    assert (gone > 2.0).all()
    assert (back < 2.0).all()


def test_guard_whose_fallback_has_acted_is_the_fallback_bit_for_bit():
    """With an energy that is always too large the other one acts from the first second on."""
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


def test_helm_loses_no_recorded_episode_that_the_expert_keeps():
    """From the files alone: the second row is the tail, the last one says who ended far away; slow cells come first."""
    failed = 0
    for suite in (
        name for name in recorded.RECORDED_SUITES if name != "vehicles-v1"
    ):  # it has learned the paper's vehicle
        rows = [
            np.load(found(recorded.RECORDED_FOLDER, f"{suite}/{name}.npz"))["measures"]
            for name in ("helm", "backstepping")
        ]
        half = rows[0].shape[1] // 2
        caps = np.full(2 * half, 5.0) if suite == "deep-v1" else np.repeat([0.6, 2.0], half)
        mine, its = ((own[-1] > 0) | ~(own[1] < caps) for own in rows)
        assert versus_expert(_Recorded(suites.load_suite(suite)), "helm")[0] == (mine & ~its).sum()
        failed += (mine & ~its).sum()
    assert failed == 0


class _Recorded:
    """What is recorded of a suite, as the pages have it."""

    def __init__(self, suite):
        self.suite, self.runs = (
            suite,
            [r for name in ("helm", "backstepping") for r in recorded.read_recorded(suite, name)],
        )


# --- seas ---


@pytest.mark.parametrize("speed_range", SPEED_RANGES)
def test_seas_of_severity_1_are_in_the_ranges_of_the_storm(speed_range):
    for kind, storm in (("storm", PRESETS[f"{speed_range}-storm"]), ("adverse", adverse(speed_range))):
        size, rng = len(seas.names(speed_range, kind)), np.random.default_rng(0)
        for towards in (np.ones(size), -np.ones(size), rng.uniform(-1, 1, size)):
            scenario = seas.sea(speed_range, kind, "x", 1.0, towards)
            pairs = [(getattr(scenario.mismatch, n), getattr(storm.mismatch, n)) for n in ("mass", "d22", "quadratic")]
            pairs += [(scenario.path.speed, storm.path.speed), (scenario.start.x_e, storm.start.x_e)]
            pairs += [
                (scenario.actuators.delay, storm.actuators.delay),
                (scenario.sensors.heading_bias, storm.sensors.heading_bias),
            ]
            for value, interval in pairs:
                low, high = interval if isinstance(interval, tuple) else (interval, interval)
                assert low - 1e-9 <= value <= high + 1e-9
            assert scenario.current.speed <= storm.current.speed[1] + 1e-9
            assert scenario.waves.sway <= storm.waves.sway + 1e-9
            assert scenario.sensors.position <= storm.sensors.position + 1e-9
    calm = seas.sea(speed_range, "storm", "x", 0.0, np.ones(len(seas.names(speed_range, "storm"))))
    assert (calm.current.speed, calm.waves.yaw, calm.mismatch.mass, calm.actuators.lag) == (0, 0, 1, 0)


def test_coordinates_are_in_units_of_the_ranges():
    names = seas.names("cruise", "storm")
    towards = np.zeros(len(names))
    towards[[names.index("mass"), names.index("lag"), names.index("direction")]] = -1.0, -0.5, 0.5
    scenario = seas.sea("cruise", "storm", "x", 2.0, towards)
    assert scenario.mismatch.mass == pytest.approx(1 - 2 * 0.2)
    assert scenario.actuators.lag == pytest.approx(2 * 0.5 * 0.36)
    assert scenario.current.direction == pytest.approx(math.pi / 2)


def test_crossing_lies_between_what_is_kept_and_what_is_lost():
    assert falsification.crossing((1.0, 2.0, 3.0), (-1.0, 1.0, 2.0)) == pytest.approx(1.5)
    assert falsification.crossing((1.0, 2.0), (0.5, 1.0)) <= 1.0
    assert falsification.crossing((1.0, 2.0), (math.nan, math.nan)) > 2.0
    assert falsification.crossing((1.0, 2.0), (-3.0, -2.0)) > falsification.crossing((1.0, 2.0), (-3.0, -1.0)) > 2.0
    assert falsification.crossing((1.0, 2.0, 3.0), (-1.0, math.nan, 1.0)) == pytest.approx(2.0)


def test_search_finds_a_sea_that_loses_the_policy_and_writes_it(tmp_path, monkeypatch, capsys):
    """Open loop is lost in next to nothing; a sea of half that severity along the same direction does not lose it."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(falsification, "_POPULATION", 4)
    monkeypatch.setattr(falsification, "_FIRST", (0.01, 0.1, 1.0, 3.0))
    monkeypatch.setattr(falsification, "CONFIRMED", 4)
    given = ["backstepping", "--speed-range", "cruise", "--sea", "storm", "--generations", "1", "--out", "seas"]
    assert run(falsification.main, falsification.PROGRAM, given) == 0
    assert "severity" in capsys.readouterr().out
    (entry,) = falsification.found_seas(Path("seas/seas.json")).values()
    scenario = Scenario.load("seas/cruise-storm-that-loses-backstepping.toml")
    again = rollout(make_policy("backstepping"), scenario, drawn(scenario, 4, FALSIFICATION.end - 4).episodes).measures
    assert count_failures(again, 2.0) == entry["failed"] >= 2
    assert max(abs(x) for name, x in entry["coordinates"].items() if name != "direction") == pytest.approx(
        entry["severity"]
    )


FOUND = falsification.found_seas()


@pytest.mark.parametrize("name", FOUND)
def test_kept_seas_lose_whom_they_should(name):
    entry = FOUND[name]
    assert entry["fingerprint"] == fingerprint(entry["policy"]), f"run {falsification.PROGRAM} {entry['policy']} again"
    if entry["severity"] is None:
        pytest.fail("a search that found nothing is not to be kept as a sea")
    scenario = Scenario.load(falsification.SEAS_FOLDER / f"{name}.toml")
    seed = FALSIFICATION.end - falsification.CONFIRMED
    if entry["policy"] != "nmpc":  # which takes its time
        measures = rollout(make_policy(entry["policy"]), scenario, drawn(scenario, 8, seed).episodes).measures
        assert (
            count_failures(measures, 2.0 if scenario.name.startswith("cruise") else 0.6) >= 2
        )  # of 8, where half of 64 are lost


def test_rows_are_of_what_acts_now():
    for policy, own in failure_rate.failure_counts().items():
        assert own["fingerprint"] == fingerprint(policy), f"run {failure_rate.PROGRAM} {policy} again"
    for policy, rows in read_json(guards.GUARDS_FILE).items():
        assert rows["fingerprint"] == fingerprint(f"{policy}:guard"), f"run {guards.PROGRAM} --policy {policy} again"

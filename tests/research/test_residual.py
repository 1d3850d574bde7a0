"""What a residual is for: networks fail as they are said to, counts and intervals are right, the page says them."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from auv_gym.scenarios.presets import CASES, PRESETS
from baselines.agents.agent import Agent
from baselines.agents.names import agent_folder
from baselines.evaluation.fingerprints import fingerprint
from baselines.evaluation.metrics import share_interval
from baselines.evaluation.rollout import beginning, play, rollout
from baselines.evaluation.runner import drawn
from baselines.evaluation.score import EXPERT
from baselines.evaluation.side_by_side import SideBySide
from baselines.tools.command_line import UsageError
from baselines.tools.figure_style import to_png
from research.results import residual as page
from research.results import residual_file
from research.results.residual_figure import residual_figure
from research.results.residual_file import (
    RESIDUAL_KIND,
    SCRATCH,
    SHIPPED_KIND,
    STUCK,
    ResidualGroup,
    load_groups,
    save_groups,
    whole,
)
from research.robustness import situations
from research.robustness.failures import FAILURES, SATURATED, Failing, Shuffled
from research.trainings import residual as command

AFTER = 8  # control steps


@pytest.fixture(scope="module")
def cell():
    return drawn(PRESETS["cruise-storm"], 3, 0)


def steps(policy, cell, n=AFTER + 6):
    """Return what a policy saw and did in its first control steps, shapes (n, 3, terms) and (n, 3, 2)."""
    begun = beginning([(cell.scenario, cell.episodes)], policy.preview)
    moments = list(play(policy, begun, n))
    return np.array([m.observation for m in moments]), np.array([m.command for m in moments])


def failing(name, failure):
    return Failing(Agent.load(agent_folder(name)), failure, AFTER)


def law_of(agent):
    return agent.policy().expert


@pytest.mark.parametrize("failure", FAILURES)
def test_until_it_fails_it_is_the_agent_and_again_in_the_next_episode(cell, failure):
    policy = failing("apg-cruise", failure)
    healthy = steps(Agent.load(agent_folder("apg-cruise")).policy(), cell)
    for _ in range(2):
        observations, actions = steps(policy, cell)
        np.testing.assert_array_equal(observations[: AFTER + 1], healthy[0][: AFTER + 1])
        np.testing.assert_array_equal(actions[:AFTER], healthy[1][:AFTER])
        assert (actions[AFTER] != healthy[1][AFTER]).any()


def test_a_dead_network_leaves_the_expert_bit_for_bit(cell):
    agent = Agent.load(agent_folder("apg-cruise"))
    observations, actions = steps(failing("apg-cruise", "dead"), cell)
    for seen, action in zip(observations[AFTER:], actions[AFTER:], strict=True):
        np.testing.assert_array_equal(action.astype(np.float32), law_of(agent).predict(seen)[0])
    _, actions = steps(failing("apg-scratch-cruise", "dead"), cell)
    assert not actions[AFTER:].any()


@pytest.mark.parametrize("name", ["apg-cruise", "apg-scratch-cruise"])
@pytest.mark.parametrize(("failure", "value"), [("held", None), ("stuck at +1", 1.0), ("stuck at -1", -1.0)])
def test_an_output_is_held_or_stuck(cell, name, failure, value):
    agent = Agent.load(agent_folder(name))
    observations, actions = steps(failing(name, failure), cell)
    base = np.array([law_of(agent).predict(seen)[0] for seen in observations])
    told = np.array([value, value])
    if value is None:  # the last correction, where the expert's command plus it was within the limits
        assert (np.abs(actions[AFTER - 1]) < 1).any()
        told = (actions - base)[AFTER - 1] / np.array(agent.authority)
    expected = np.clip(base[AFTER:] + np.array(agent.authority) * told, -1, 1)
    inside = np.abs(actions[AFTER - 1]) < 1 if value is None else np.full((3, 2), fill_value=True)
    np.testing.assert_allclose(actions[AFTER:][:, inside], expected[:, inside], atol=1e-6)
    if name == "apg-scratch-cruise":
        assert (actions[AFTER:] == actions[AFTER]).all()


def test_shuffled_weights_are_the_same_numbers():
    agent = Agent.load(agent_folder("apg-cruise"))
    mine, other = Shuffled(agent, "float64"), Shuffled(agent, "float64")
    x, hidden = np.ones((agent.network.inputs, 2)), np.zeros((agent.network.memory, 2))
    (first, _), (again, _) = (network.forward((), x, hidden) for network in (mine, other))
    np.testing.assert_array_equal(first, again)
    healthy, _ = agent.network.forward(agent.network.prepared(agent.weights), x, hidden)
    assert np.abs(first - healthy).max() > 1e-3
    np.testing.assert_array_equal(np.sort(mine._layers[-1][0].ravel()), np.sort(agent.weights["head.weight"].ravel()))


def test_a_silent_network_is_the_law_until_it_is_stuck(cell):
    agent = situations.silent(0.25)
    observations, actions = steps(Failing(agent, "stuck at -1", AFTER), cell)
    base = np.array([law_of(agent).predict(seen)[0] for seen in observations])
    np.testing.assert_array_equal(actions[:AFTER].astype(np.float32), base[:AFTER])
    np.testing.assert_allclose(actions[AFTER:], np.clip(base[AFTER:] - 0.25, -1, 1), atol=1e-6)


def test_unknown_failures_are_refused():
    with pytest.raises(ValueError, match="unknown failure 'tired'; allowed are dead, held"):
        failing("apg-cruise", "tired")


def test_side_by_side_gives_what_each_scenario_gives_alone(cell):
    other, policy = drawn(PRESETS["cruise-calm"], 2, 0), Agent.load(agent_folder("apg-cruise")).policy()
    found = SideBySide([cell, other]).run(policy)
    for own, ended in zip((cell, other), found, strict=True):
        alone = rollout(policy, own.scenario, own.episodes).measures
        np.testing.assert_allclose(ended.tail, alone.tail, rtol=1e-9)
        np.testing.assert_array_equal(ended.lost, alone.lost)


def test_worlds_change_what_they_say_and_nothing_else():
    case = PRESETS["cruise-actuator"]
    slow = situations.WORLDS["slew 1 s"](case)
    assert (slow.actuators.F_u_rate, slow.actuators.F_r_rate) == (250.0, 100.0)
    assert replace(slow, actuators=case.actuators) == case
    fast = situations.WORLDS["faster"](case)
    assert fast.path.speed == (1.5, 2.0)
    assert replace(fast, path=case.path) == case
    assert situations.situations_of("nmpc") == tuple(situations.WORLDS)


@pytest.mark.parametrize(("lost", "episodes"), [(0, 400), (3, 80), (400, 400)])
def test_interval_of_a_share_is_that_of_the_beta_distribution(lost, episodes):
    low = stats.beta.ppf(0.025, lost, episodes - lost + 1) if lost else 0.0
    high = stats.beta.ppf(0.975, lost + 1, episodes - lost) if lost < episodes else 1.0
    assert share_interval(lost, episodes) == pytest.approx((low, high), abs=1e-9)


def made(name="residual-0.5-cruise", kind=RESIDUAL_KIND, authority=0.5, seeds=5, episodes=6, **changes):
    """Return a group with errors of its own in every situation, the first episodes of each case lost when stuck."""
    rng = np.random.default_rng(len(name))
    shape = seeds, len(CASES), episodes
    tails = {s: rng.uniform(0.01, 0.1, shape) * rng.uniform(0.5, 2.0, (seeds, 1, 1)) for s in situations.SITUATIONS}
    tails["stuck at +1"][:, :, :2] = 2.0
    curve = np.array([[1e5 * k, 0.5 / (1 + k), 0.1] for k in range(11)])
    own = {s: tail.reshape(seeds, -1) for s, tail in tails.items()}
    entries = {"tails": own, "curves": (curve,) * seeds, "command": "python train.py", **changes}
    return ResidualGroup(name, "cruise", kind, authority, "2026-01-01", **entries)


@pytest.fixture(scope="module")
def groups():
    law = made("backstepping", SHIPPED_KIND, None, 1, curves=(), command="")
    tails = {s: tail for s, tail in law.tails.items() if s in situations.WORLDS}
    scratch = [made(f"scratch-{a}-cruise", SCRATCH, a) for a in (0.5, 1.0)]
    ends = [made(f"stuck-{a}", STUCK, a, 1, curves=(), command="") for a in (0.25, 1.0)]
    stuck = [replace(group, tails={limit: group.tails[limit] for limit in SATURATED}) for group in ends]
    return [replace(law, tails=tails), made(), made("residual-2.0-cruise", authority=2.0), *scratch, *stuck]


def test_interval_of_an_error_is_over_seeds_and_episodes(groups):
    group = groups[1]
    tails = group.tails["as trained"].reshape(5, len(CASES), -1)
    score, rng = page.mean_error(group, "as trained"), np.random.default_rng(7)
    means = []
    for _ in range(3000):  # seeds anew, and the same episodes anew for all of them, within each case
        seeds, episodes = rng.integers(5, size=5), rng.integers(tails.shape[2], size=(len(CASES), tails.shape[2]))
        means.append(np.take_along_axis(tails[seeds], np.broadcast_to(episodes, tails.shape), axis=2).mean())
    assert score.mean == pytest.approx(tails.mean(), rel=1e-12)
    assert score.ci95 == pytest.approx(np.quantile(means, (0.025, 0.975)), rel=0.03)


def test_interval_of_one_policy_is_scipys(groups):
    group = replace(groups[0], tails={"as trained": np.random.default_rng(0).uniform(0, 1, (1, 8 * 40))})
    score = page.mean_error(group, "as trained")
    own = stats.bootstrap(group.tails["as trained"], np.mean, method="percentile", rng=1).confidence_interval
    assert score.ci95 == pytest.approx((own.low, own.high), rel=0.03)


def test_files_keep_groups_beside_the_others(groups, tmp_path):
    file = tmp_path / "residual.json"
    save_groups(groups[:2], file)
    save_groups([replace(groups[1], date="2026-02-02"), groups[2]], file)
    found = {group.name: group for group in load_groups(file)}
    assert set(found) == {group.name for group in groups[:3]}
    assert found[groups[1].name].date == "2026-02-02"
    for group in groups[:3]:
        for situation, tails in group.tails.items():
            np.testing.assert_allclose(found[group.name].tails[situation], tails, atol=0.6 * residual_file.UNIT)
            np.testing.assert_array_equal(found[group.name].lost(situation), tails == 2.0)
    assert whole(np.array([1.99999, 2.0, 0.01234]), "cruise") == [19999, 20000, 123]
    file.write_text("[1]", encoding="utf-8")
    with pytest.raises(ValueError, match="is damaged"):
        load_groups(file)


def test_the_section_says_what_the_file_says(groups):
    text = page.what_it_is_for(groups)
    row = re.search(r"^\| stuck at \+1 \| - \| - \| (.*) \|$", text, re.MULTILINE)[1].split(" | ")
    low, high = (100 * end for end in share_interval(5 * 8 * 2, 5 * 8 * 6))
    assert row[1] == f"33.3 % ({low:.1f} ... {high:.1f})"
    assert row[2] == "33 ... 33 %"
    mean = 100 * groups[1].tails["stuck at +1"].mean()
    assert row[0].startswith(f"{mean:.1f} (")
    assert "| 0.1 M | 25.0 (25.0 ... 25.0) | 10.0 % (10.0 ... 10.0) |" in text
    ends = [f"{100 * end:.1f}" for end in share_interval(8 * 2, 8 * 6)]
    assert f"| 0.25 | - | - | 33.3 % ({ends[0]} ... {ends[1]}) | 0.0 % " in text
    assert page.what_it_is_for([]) == ""
    assert len(to_png(residual_figure(groups))) > 20_000


@pytest.mark.parametrize(
    ("name", "situation"), [("apg-cruise", "stuck at -1"), ("apg-scratch-cruise", "held"), ("backstepping", "faster")]
)
def test_what_is_kept_is_what_they_do(name, situation):
    kept = next(group for group in load_groups() if (group.name, group.regime) == (name, "cruise"))
    again = situations.outcome(name, "cruise", situation, 1)
    first = kept.tails[situation].reshape(len(CASES), -1)[:, 0]
    np.testing.assert_allclose(again.tail, first, rtol=1e-3, atol=1e-4)


def test_the_words_of_the_pages_are_true():
    """What the page of training says of shipped agents."""
    lost = {group.name: {s: group.lost(s).mean() for s in group.tails} for group in load_groups()}
    for regime in ("slow", "cruise"):
        residual, scratch = lost[f"apg-{regime}"], lost[f"apg-scratch-{regime}"]
        assert scratch["dead"] == 1
        assert scratch["held"] > 0.8
        assert max(residual["dead"], residual["held"]) < 0.02
        assert min(residual["stuck at +1"], residual["stuck at -1"]) > 0.5
        assert max(scratch[s] for s in ("faster", "slower", "slew 0.5 s", "slew 1 s")) < 0.03


def test_the_words_of_what_an_authority_bounds_are_true():
    """At cruise half of the limits is too much, with all of them hardly an episode is left."""
    own = {
        (g.regime, g.authority): [g.lost(limit).mean() for limit in SATURATED] for g in load_groups() if g.kind == STUCK
    }
    assert min(own["cruise", 0.5]) > 0.4
    assert max(own["cruise", 0.1]) < 0.02
    assert max(own["slow", 0.4]) == 0
    assert all(min(lost) > 0.9 for (_, authority), lost in own.items() if authority >= 1)


def test_the_words_of_the_study_are_true():
    """Seeds from scratch lie on both sides of those with an expert; when they have caught up."""
    own = [group for kind in page.SHOWN for group in page.of(load_groups(), "cruise", kind)]
    shown = {group.kind: group for group in own if group.authority == page.SHOWN[group.kind]}
    errors = {kind: group.tails["as trained"].mean(axis=1) for kind, group in shown.items()}
    assert {len(seeds) for seeds in errors.values()} == {command.SEEDS}
    assert errors[SCRATCH].min() < errors[RESIDUAL_KIND].min() < errors[RESIDUAL_KIND].max() < errors[SCRATCH].max()
    (early, lost), (late, _) = (page.at(shown[SCRATCH], steps) for steps in (1e5, 4e5))
    assert lost.min() > 0.99
    assert early.mean() > 5 * page.at(shown[RESIDUAL_KIND], 1e5)[0].mean()
    assert late.mean() < 1.2 * page.at(shown[RESIDUAL_KIND], 4e5)[0].mean()


def test_a_second_call_measures_nothing_again(tmp_path, capsys):
    words = ["backstepping", "--episodes", "1", "--jobs", "1", "--out", str(tmp_path)]
    assert command.main(words) == 0
    file = tmp_path / SHIPPED_KIND / "backstepping-cruise.json"
    record = json.loads(file.read_text(encoding="utf-8"))
    record["tails"]["faster"][0] = 4321
    file.write_text(json.dumps(record), encoding="utf-8")
    assert "measured: backstepping, cruise" in capsys.readouterr().err
    assert command.main(words) == 0
    assert "measured" not in capsys.readouterr().err
    kept = {group.regime: group for group in load_groups(tmp_path / "residual.json")}
    assert kept["cruise"].tails["faster"][0, 0] == pytest.approx(0.4321)
    assert kept["slow"].tails["faster"].shape == (1, len(CASES))


def test_what_is_kept_of_policies_is_of_those_that_ship():
    kept = [group for group in load_groups() if group.kind in (SHIPPED_KIND, STUCK)]
    assert {group.name for group in kept if group.kind == SHIPPED_KIND} == set(command.POLICIES)
    for group in kept:
        policy = group.name if group.kind == SHIPPED_KIND else EXPERT
        assert group.fingerprint == fingerprint(policy), f"run {command.PROGRAM} {group.name}, then make results"


def test_seeds_that_are_not_finished_are_left_out(tmp_path, capsys):
    assert command.main(["residual-0.5-cruise", "--finished", "--episodes", "1", "--out", str(tmp_path)]) == 0
    assert capsys.readouterr().out == f"written: {tmp_path / 'residual.json'}\n"
    assert load_groups(tmp_path / "residual.json") == []


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nobody"], "unknown policy 'nobody'; allowed are residual-0.1-cruise"),
        (["--episodes", "0"], "--episodes is 0; it must be 1 or more"),
        (["--jobs", "0"], "--jobs is 0"),
    ],
)
def test_mistakes_are_refused(arguments, message):
    with pytest.raises(UsageError, match=message):
        command.main(arguments)

"""The full-information optimum in many episodes: counts are right, add up over runs, and belong to the policy."""

import json
from dataclasses import asdict, replace

import pytest

from auv_gym.scenarios.presets import PRESETS
from baselines import make_policy
from baselines.evaluation.rollout import rollout
from baselines.evaluation.runner import drawn
from baselines.tools.command_line import UsageError
from research.lower_bounds import bound
from research.lower_bounds.bound import (
    OptimumCount,
    all_cases,
    better_policies,
    main,
    optimum_counts,
    run_episodes,
    summary_text,
)
from research.seeds import OPTIMUM

SHORT = tuple(replace(PRESETS[name], steps=60) for name in ("slow-storm", "cruise-actuator"))


def test_no_failure_in_ten_thousand_episodes():
    """The record belongs to the present policy: otherwise `optimum_counts` returns {}."""
    counts = optimum_counts()
    assert set(counts) == {scenario.name for scenario in bound.SCENARIOS}
    every = all_cases(counts)
    assert every.episodes >= bound.OPTIMUM_EPISODES
    assert every.failed == 0
    assert every.largest_error_m < 0.1  # a vehicle that spins is metres away
    assert better_policies(counts) == []
    assert f"0 of {every.episodes} episodes failed" in summary_text(counts)


def test_a_run_continues_an_earlier_one(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(bound, "SCENARIOS", SHORT)
    monkeypatch.setattr(bound, "_BATCH", 2)
    file = tmp_path / "new" / "bound.json"
    assert main(["--episodes", "6", "--out", str(file)]) == 0
    assert main(["--episodes", "10", "--out", str(file)]) == 0
    assert "0 of 10 episodes failed" in capsys.readouterr().out
    counts = optimum_counts(file)
    assert [count.episodes for count in counts.values()] == [5, 5]
    cell = drawn(SHORT[1], 5, OPTIMUM.first)
    steady_rmse = rollout(make_policy("clairvoyant"), SHORT[1], cell.episodes).measures.steady_rmse
    assert counts["cruise-actuator"].steady_rmses_m == pytest.approx(steady_rmse.sum(), rel=1e-3)
    assert counts["cruise-actuator"].largest_steady_rmse_m == pytest.approx(steady_rmse.max(), rel=1e-3)
    file.write_text(file.read_text().replace('"fingerprint": "', '"fingerprint": "another'))
    assert optimum_counts(file) == {}


def test_a_better_policy_and_wrong_usage_are_reported(tmp_path, monkeypatch, capsys):
    """The planned forces without feedback replace the optimum, and an error of a nanometre is not small."""
    monkeypatch.setattr(bound, "SCENARIOS", SHORT[:1])
    monkeypatch.setattr(bound, "GOOD", 1e-9)
    worse = {"clairvoyant": "open-loop"}
    monkeypatch.setattr(bound, "make_policy", lambda name, vehicle: make_policy(worse.get(name, name), vehicle))
    file = tmp_path / "bound.json"
    assert main(["--episodes", "2", "--out", str(file)]) == 1
    assert "slow-storm, seed 90000000" in capsys.readouterr().err
    (count,) = optimum_counts(file).values()
    assert [own["seed"] for own in count.astray] == [OPTIMUM.first, OPTIMUM.first + 1]
    for text in ("[]", '{"cases": {"slow-storm": {"tea": 1, "astray": []}}, "fingerprint": ""}', "{}"):
        file.write_text(text)
        with pytest.raises(UsageError, match="was not written by"):
            main(["--out", str(file)])
    for arguments in (["--episodes", "0"], ["--episodes", str(10**12)]):
        with pytest.raises(UsageError, match="must be in"):
            main(arguments)


def test_counts_add_up():
    one, two = OptimumCount(2, 1, 0.5, 0.4, 0.6, ({"seed": 1},)), OptimumCount(3, 0, 0.1, 0.05, 0.7)
    assert one.with_more(two) == OptimumCount(5, 1, 0.6, 0.4, 0.7, ({"seed": 1},))
    assert json.loads(json.dumps(asdict(one)))["failed"] == 1
    assert run_episodes(SHORT[0], 3, 1).episodes == 1

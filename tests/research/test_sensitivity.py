"""Sensitivity: vehicles that change, errors outside of the training and with wrong models, the page and its data."""

import itertools
import json
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from auv_gym.envs.track_vector_env import UnderactuatedAUVTrackVectorEnv
from auv_gym.physics.vehicle import PAPER_VEHICLE
from auv_gym.scenarios.presets import PRESETS
from baselines.evaluation.rollout import beginning, play
from baselines.evaluation.side_by_side import SideBySide
from baselines.tools.command_line import run
from research.sensitivity import command, extrapolation, model_error
from research.sensitivity.adaptation import ADAPTATION_EPISODES, back, course_of, followed, lengths_of, windows
from research.sensitivity.changes import BEFORE, CHANGES, EVERYWHERE, LENGTHS, ChangeTrial
from research.sensitivity.episodes import acting, episodes_of
from research.sensitivity.page import context, load_sensitivity, ratio_of


def changing(scenario, n=2):
    env = UnderactuatedAUVTrackVectorEnv(n, scenario)
    episodes = episodes_of(scenario, n)
    env.reset(seed=0, options={"episode": list(episodes)})
    return env, episodes


def test_a_vehicle_that_changes_moves_as_the_other_one_from_then_on():
    """Against the paper's equations with the new numbers, by another integrator; the same again changes nothing."""
    calm = replace(PRESETS["cruise-calm"], control_dt=0.02)
    (env, episodes), (other, _) = changing(calm), changing(calm)
    v = replace(PAPER_VEHICLE, m11=300.0, m22=390.0, m33=120.0, d11=140.0)
    actions = np.full((2, 2), 0.4, dtype=np.float32)
    for k in range(20):
        if k == 10:
            env.change(episodes)
        env.step(actions)
        other.step(actions)
        np.testing.assert_array_equal(env.state, other.state)
    env.change([replace(e, vehicle=v, effectiveness=(1.0, 0.5)) for e in episodes])
    np.testing.assert_array_equal(env.state, other.state)
    before = env.state[0]
    for _ in range(50):
        env.step(actions)

    def slope(_, z):
        _, _, psi, u, w, r = z
        return [
            u * math.cos(psi) - w * math.sin(psi), u * math.sin(psi) + w * math.cos(psi), r,
            (0.4 * 400 + v.m22 * w * r - v.d11 * u) / v.m11,
            (-v.m11 * u * r - v.d22 * w) / v.m22,
            (0.4 * 0.5 * 200 + (v.m11 - v.m22) * u * w - v.d33 * r) / v.m33,
        ]  # fmt: skip

    end = solve_ivp(slope, (0.0, 1.0), before, rtol=1e-9, atol=1e-10).y[:, -1]
    np.testing.assert_allclose(env.state[0], end, atol=1e-6)


def test_other_water_begins_without_a_jump_of_the_vehicle():
    still = ChangeTrial.of("cruise", "noise", 2).scenario
    env, episodes = changing(still)
    env.step(np.zeros((2, 2), dtype=np.float32))
    before, current = env.state, env.current
    shear = (0.2, -0.1, 0.0, 0.0, EVERYWHERE)
    env.change([replace(e, current=replace(e.current, shear=shear)) for e in episodes])
    np.testing.assert_allclose(env.state, before, atol=1e-12)
    np.testing.assert_allclose(env.current - current, [(0.2, -0.1)] * 2)
    with pytest.raises(ValueError, match="1 episodes are given for 2 vehicles"):
        env.change(episodes[:1])
    calm, others = changing(PRESETS["cruise-calm"])
    with pytest.raises(ValueError, match="sheared current"):
        calm.change([replace(e, current=replace(e.current, shear=shear)) for e in others])


def test_who_is_back_stays_so_to_the_end():
    assert back(np.array([1.0, 1.1, 0.5]), 1.2) == 0
    assert back(np.array([3.0, 1.1, 1.3, 1.2, 0.9]), 1.2) == 3
    assert back(np.array([1.0, 1.0, 1.3]), 1.2) == math.inf
    assert back(np.array([1.0, math.nan]), 1.2) == math.inf


def test_errors_are_means_over_the_way():
    places = np.repeat(np.arange(-2.0, LENGTHS + 3), 5)[:, None]
    np.testing.assert_allclose(windows(places, places)[:, 0], np.arange(LENGTHS - 1) + 0.5)


@pytest.mark.parametrize("regime", ["slow", "cruise"])
def test_every_episode_goes_far_enough(regime):
    places = lengths_of(ChangeTrial.of(regime, "storm", ADAPTATION_EPISODES))
    assert places[-1].min() >= LENGTHS
    assert all((places == j).any(axis=0).all() for j in range(LENGTHS))


def test_a_course_that_decays_is_back_where_it_says():
    """An error of 10 mm (1 + 4 exp(-d/5)): within 20 % from 5 ln 20 = 15.0 lengths on; in the brackets."""
    rng = np.random.default_rng(0)
    d = np.arange(39.0)[:, None]
    always = 0.01 * np.exp(0.3 * rng.standard_normal((1, 200))) * np.ones((39, 1))
    now = always * (1 + 4 * np.exp(-d / 5)) * np.exp(0.05 * rng.standard_normal((39, 200)))
    course = course_of(now, always, always)
    place, low, high = course["back"][0]
    assert low <= place <= high
    assert 13 <= low <= 15 <= high <= 17
    assert course["back"][1][0] == pytest.approx(5 * math.log(8), abs=1)
    assert course["factor"][0][0] == pytest.approx(5, rel=0.02)
    assert course_of(2 * always, always, always)["back"][0] == [None, None, None]
    assert course_of(always, always, always)["back"] == [[0, 0, 0], [0, 0, 0]]


def test_a_change_at_the_start_and_on_the_way_lead_to_the_same():
    """A law without memory forgets what was before; only the vehicle's own motion has to settle."""
    trial = ChangeTrial.of("cruise", "noise", 2)
    errors, lost = followed("backstepping", trial, 2.0)
    late, always = errors["fouling"][-10:], errors["always fouling"][-10:]
    np.testing.assert_allclose(late, always, atol=5e-3)
    assert np.abs(errors["never"][-10:] - always).min() > 0.01
    assert not any(mine.any() for mine in lost.values())
    assert set(errors) == {"never", *CHANGES, *(f"always {change}" for change in CHANGES)}
    assert trial.scenario.steps > BEFORE


def test_stretched_storms_differ_in_one_thing():
    scenarios = extrapolation.stretched_storms("cruise", extrapolation.STRETCHED["mass"])
    first, last = (episodes_of(scenario, 2)[1] for scenario in (scenarios[0], scenarios[-1]))
    assert (first.path, first.waves, first.noise_seed, first.lag) == (last.path, last.waves, last.noise_seed, last.lag)
    assert last.vehicle.m11 / first.vehicle.m11 == pytest.approx(3.0 / 0.4)
    assert last.vehicle.d11 == first.vehicle.d11


def test_wrong_models_are_wrong_in_their_parameters_and_within_their_size():
    """Shares are spread over what there is; what `ratios` leaves right is right; each model has mistakes of its own."""
    drawn = [model_error.mistakes(k) for k in range(40)]
    assert all(abs(share) <= 1 for own in drawn for share in own.values())
    assert min(own["d11"] for own in drawn) < -0.9
    assert max(own["d11"] for own in drawn) > 0.9
    by = {name: model_error.wrong(PAPER_VEHICLE, drawn[0], 0.6, way) for name, way in model_error.WAYS.items()}
    assert (by["ratios"].m11, by["ratios"].m33, by["ratios"].speed) == (215, 80, PAPER_VEHICLE.speed)
    assert by["all"].m33 / 80 - 1 == pytest.approx(0.6 * drawn[0]["m33"])
    assert by["all"].d22 == by["ratios"].d22 == pytest.approx(100 * (1 + 0.6 * drawn[0]["d22"]))
    assert model_error.wrong(PAPER_VEHICLE, drawn[0], 0.0, model_error.WAYS["all"]) == PAPER_VEHICLE
    assert model_error.mistakes(3) == drawn[3] != drawn[4]


@pytest.fixture
def few(monkeypatch):
    """Make the measurement short: two cases, two models, one size."""
    whole = model_error.cells_of
    monkeypatch.setattr(model_error, "cells_of", lambda regime, n: [whole(regime, n)[i] for i in (0, 1)])
    monkeypatch.setattr(model_error, "_HULLS", 2)
    monkeypatch.setattr(model_error, "ERROR_SIZES", (0.6,))


def test_a_policy_that_does_not_use_its_model_loses_nothing(few, tmp_path):
    """The plan's own forces depend on no model; the paper's law cancels what its model says."""
    without = model_error.with_wrong_models("open-loop", "cruise", 6)
    assert without["wrong"]["ratios"][0]["above"] == [0, 0, 0]
    assert without["wrong"]["ratios"][0]["error_m"] == without["right"]["error_m"]
    found = model_error.with_wrong_models("backstepping", "cruise", 6)
    assert found["right"]["score"][0] == pytest.approx(0, abs=1e-3)  # the suite's own zero, run again
    for rows in found["wrong"].values():
        mean, low, high = rows[0]["above"]
        assert low <= mean <= high
        assert mean == pytest.approx(np.mean(rows[0]["hulls"]), abs=1e-4)
        assert rows[0]["score"][0] == pytest.approx(found["right"]["score"][0] + mean, abs=1e-4)
        assert rows[0]["error_m"] != found["right"]["error_m"]
    (tmp_path / "model_error-backstepping.json").write_text(json.dumps({"cruise": found}))
    row = context("sensitivity", tmp_path)["model_error"]["records"][0]["rows"][1]
    mean, low, high = found["wrong"]["all"][0]["above"]
    shown = ["`backstepping`", "0.000", "m22, drag, m11, m33", f"{mean:+.3f} [{low:+.3f}, {high:+.3f}]"]
    assert [cell for cell in row if cell != "-"][:4] == shown


def test_ratio_of_paired_errors():
    errors = np.exp(np.random.default_rng(0).standard_normal(50))
    assert ratio_of(2 * errors, errors) == pytest.approx((2.0, 2.0, 2.0))


def test_command_in_a_quick_form(tmp_path, capsys, monkeypatch):
    lag, speed = extrapolation.STRETCHED["lag"], extrapolation.STRETCHED_SPEEDS["cruise"]
    monkeypatch.setattr(extrapolation, "STRETCHED", {"lag": lag._replace(values=(0.2, 0.4))})
    monkeypatch.setattr(extrapolation, "STRETCHED_SPEEDS", {"cruise": speed._replace(values=(1.0, 2.0))})
    arguments = ["--policy", "helm", "backstepping", "--regime", "cruise", "--episodes", "6", "--out", str(tmp_path)]
    parts = ["--part", "adaptation", "extrapolation"]
    assert run(command.main, command.PROGRAM, arguments + parts) == 0
    page = (tmp_path / "sensitivity.md").read_text(encoding="utf-8")
    assert "**cruise-storm**, 6 episodes of each value:" in page
    assert "## Sensitivity to model error" not in page
    for part in ("adaptation", "extrapolation"):
        assert (tmp_path / "images" / f"sensitivity-{part}-cruise.png").stat().st_size > 10_000
    assert set(load_sensitivity(tmp_path)) == set(
        itertools.product(("adaptation", "extrapolation"), ("backstepping", "helm"))
    )
    assert "adaptation: helm, cruise" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--policy", "helmet"], "'helmet'"),
        (["--part", "probes"], "'probes'"),
        (["--regime", "fast"], "'fast'"),
        (["--episodes", "1"], "--episodes is 1; it must be 2 or more"),
        (["--policy", "oracle", "--part", "model_error"], "oracle uses more than the observation"),
    ],
)
def test_wrong_usage(arguments, says, capsys):
    assert run(command.main, command.PROGRAM, arguments) == 2
    error = capsys.readouterr().err
    assert says in error
    assert error.count("\n") == 1


@pytest.mark.parametrize(("policy", "at"), [("backstepping", 2), ("helm", 1)])
def test_kept_errors_are_those_of_today(policy, at):
    """The first episodes of one value of one parameter, run again."""
    kept = load_sensitivity(command.SENSITIVITY_FOLDER)["extrapolation", policy]["cruise"]["parameters"]["noise"]
    parameter = extrapolation.STRETCHED["noise"]._replace(values=extrapolation.STRETCHED["noise"].values[at : at + 1])
    scenario = extrapolation.stretched_storms("cruise", parameter)[0]
    errors = np.zeros((scenario.steps, 3))
    policy = acting(policy, scenario.vehicle)
    begun = beginning([(scenario, episodes_of(scenario, 3))], getattr(policy, "preview", ()))
    for k, moment in enumerate(play(policy, begun, scenario.steps)):
        errors[k] = moment.error
    tails = np.sqrt(np.square(errors[scenario.steps // 3 :]).mean(axis=0))
    np.testing.assert_allclose(tails, kept["tails_m"][at][:3], atol=2e-5)


def test_kept_errors_of_wrong_models_are_those_of_today():
    """Three episodes in still water, with the true model and the first wrong one."""
    kept = load_sensitivity(command.SENSITIVITY_FOLDER)["model_error", "helm-any"]["cruise"]
    cell = model_error.cells_of("cruise", model_error.KEPT_EPISODES)[0]
    way, size = model_error.WAYS["ratios"], model_error.ERROR_SIZES[-1]
    first = model_error.wrong(cell.scenario.vehicle, model_error.mistakes(0), size, way)
    there = SideBySide([cell])
    for vehicle, errors in (
        (cell.scenario.vehicle, kept["right"]["first_m"][0]),
        (first, kept["wrong"]["ratios"][-1]["first_m"][0]),
    ):
        tails = there.run(acting("helm-any", vehicle))[0].tail
        np.testing.assert_allclose(tails, errors, rtol=1e-2, atol=1e-5)

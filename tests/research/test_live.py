"""The live page in a browser: its numbers agree with Python over whole episodes, and its controls work."""

import json
from pathlib import Path

import numpy as np
import pytest
from browser import opened

from auv_gym.envs.track_env import UnderactuatedAUVTrackEnv
from auv_gym.physics.rows import flatten
from auv_gym.scenarios import exogenous
from auv_gym.scenarios.exogenous import GUST_ROWS, NORMALS, ExogenousInputs
from auv_gym.scenarios.presets import SPEED_RANGES
from auv_gym.task.simulation import REFERENCE, SAMPLE_ROWS
from baselines import make_policy
from research.site.live.data import LIVE_STEPS, episode_of, path_of, scenario_of
from research.site.live.page import links, main, write_page

pytestmark = pytest.mark.slow  # a browser runs whole episodes


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return the folder of the published page."""
    made = tmp_path_factory.mktemp("live")
    write_page(made)
    return made


@pytest.fixture(scope="module")
def bench(browser, folder, tmp_path_factory):
    """Return an open page with the equations and without controls."""
    names, file = ("equations.js", "data.js", "engine.js"), tmp_path_factory.mktemp("bench") / "bench.html"
    tags = "".join(f'<script src="{(folder / name).as_uri()}"></script>' for name in names)
    file.write_text(f"<!doctype html><title>bench</title>{tags}", encoding="utf-8")
    with opened(browser, file) as page:
        yield page


def episode_in_python(policy, speed_range, family, case, seed=1):
    """Return samples, parameters, initial state, and the rows of all steps of a policy in an episode of the page."""
    path = path_of(speed_range, family)
    scenario, episode = scenario_of(speed_range, case, path), episode_of(speed_range, case, path, seed)
    env = UnderactuatedAUVTrackEnv(scenario, preview=getattr(policy, "preview", ()))
    observation, _ = env.reset(seed=0, options={"episode": episode})
    state = episode.initial_state(env._truth()[1])
    samples, rows, memory = [list(env._truth()[1])], [], None
    for _ in range(LIVE_STEPS):
        action, memory = policy.predict(observation, memory)
        observation, _, failed, _, info = env.step(action)
        samples.append(list(env._truth()[1]))
        rows.append([*action.tolist(), *env._vehicle.now.plant[:8, 0], info["position_error"]])
        if failed:
            break
    parameters = np.nan_to_num(flatten(scenario.parameters(episode)), posinf=np.finfo(float).max).tolist()
    return samples, parameters, state, np.array(rows)


EPISODES = [("slow", "figure_eight", "storm"), ("cruise", "random_smooth", "actuator"), ("cruise", "sine", "mismatch")]
EPISODES = [(name, *episode) for name in ("backstepping", "open-loop", "ekf") for episode in EPISODES]
EPISODES += [("helm", "slow", "circle", "storm"), ("helm", "cruise", "line", "storm")]


@pytest.mark.parametrize(("name", "speed_range", "family", "case"), EPISODES)
def test_policies_agree_with_python_over_whole_episodes(bench, name, speed_range, family, case):
    """With the same samples, all rows of the page differ by rounding only."""
    samples, parameters, state, expected = episode_in_python(make_policy(name), speed_range, family, case)
    given = ["openLoop" if name == "open-loop" else name, speed_range, family, samples, parameters, state]
    rows = bench.evaluate("given => ENGINE.replay(...given)", given)
    assert len(expected) > (60 if name == "open-loop" else LIVE_STEPS - 1)  # open loop may fail
    assert np.abs(np.array(rows)[: len(expected)] - expected).max() < 1e-8


@pytest.mark.parametrize("speed_range", SPEED_RANGES)
def test_the_disturbances_of_the_page_equal_the_exogenous_inputs(bench, speed_range, monkeypatch):
    path, normals = path_of(speed_range, "line"), np.random.default_rng(0).standard_normal((LIVE_STEPS + 1, NORMALS))
    scenario, episode = scenario_of(speed_range, "storm", path), episode_of(speed_range, "storm", path, 3)

    monkeypatch.setattr(exogenous, "compiled", lambda *_, **__: None)
    monkeypatch.setattr(exogenous, "_drawn", lambda *_: normals)  # the same random numbers for both
    inputs = ExogenousInputs(1, LIVE_STEPS + 1, scenario.parts)
    inputs.load(0, scenario, episode, np.zeros((LIVE_STEPS + 1, 8)) + np.array([0, 0, 0, 1, 0, 0, 0, 0]))
    expected = inputs.read((0,), LIVE_STEPS + 1)[:, REFERENCE.stop :, 0]
    run = """([weather, waves, normals, rows, gusts]) => {
        const gust = ENGINE.zeros(gusts), sea = ENGINE.zeros(rows);
        return normals.map((n) => (EQUATIONS.sea(gust, n, weather, waves, sea), [...sea]));
    }"""
    weather = np.nan_to_num(inputs._weather[0], posinf=1e300).tolist()
    arguments = [weather, inputs._waves[0].ravel().tolist(), normals.tolist(), SAMPLE_ROWS - 8, GUST_ROWS]
    assert np.abs(np.array(bench.evaluate(run, arguments)) - expected).max() < 1e-9


def test_the_page_draws_its_disturbances_from_a_seed(bench):
    run = """([speedRange, seed, noise]) => {
        const path = DATA.speed_ranges[speedRange].paths.line, reference = ENGINE.referenceOf(path);
        const settings = { current: 0.2, direction: 1, gusts: 0.1, waves: 1, noise };
        const sea = ENGINE.seaOf(DATA.speed_ranges[speedRange], path, seed, settings);
        return Array.from({ length: 600 }, (_, k) => [...sea.next(reference.row(k))]);
    }"""
    once, again, other = (np.array(bench.evaluate(run, ["cruise", seed, 1])) for seed in (4, 4, 5))
    np.testing.assert_array_equal(once, again)
    assert np.abs(once - other).max() > 0.1
    V, load, noise = once[:, 8:10], once[:, 10:13], once[:, 13:19]
    assert np.abs(V.mean(axis=0) - 0.2 * np.array([np.cos(1), np.sin(1)])).max() < 0.1
    assert (V.std(axis=0) > 0.03).all()
    np.testing.assert_allclose(noise.std(axis=0), [0.05, 0.05, 0.015, 0.02, 0.02, 0.005], rtol=0.15)
    assert (load.std(axis=0) > [5, 5, 1]).all()
    still = np.array(bench.evaluate(run, ["cruise", 4, 0]))
    assert not still[:, 13:19].any()


def test_presets_of_the_page_agree_with_the_package(bench):
    cases = bench.evaluate("DATA.speed_ranges.cruise.cases")
    assert cases["calm"] == {"current": 0, "gust": 0, "waves": 0, "noise": 0, "mismatch": False, "actuator": False}
    assert (cases["storm"]["waves"], cases["storm"]["gust"]) == (pytest.approx(0.6), 0.12)
    assert cases["current"]["current"] == pytest.approx(0.275)


@pytest.fixture
def live(browser, folder):
    with opened(browser, folder / "index.html") as page:
        page.wait_for_function("PAGE.stats.frames > 8")
        yield page


def error_of(page, name):
    return page.evaluate("n => PAGE.run.vehicles.find((v) => v.name === n).points.at(-1)[1]", name)


def test_dragging_increases_the_error_and_controllers_reduce_it(live):
    live.get_by_role("button", name="Calm").click()
    live.get_by_role("button", name="8\u00d7").click()
    live.wait_for_function("PAGE.run.k > 150")
    before = {name: error_of(live, name) for name in ("backstepping", "ekf", "helm")}
    assert max(before.values()) < 0.1
    box = live.locator("#sea").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    live.mouse.move(x, y)
    live.mouse.down()
    live.mouse.move(x + 120, y - 60, steps=4)
    live.wait_for_function("k => PAGE.run.k > k + 3", arg=live.evaluate("PAGE.run.k"))
    assert all(error_of(live, name) > 1.0 for name in before)
    live.mouse.up()
    live.wait_for_function(
        "PAGE.run.vehicles.every((v) => ['openLoop', 'you'].includes(v.name) || v.points.at(-1)[1] < 0.3)",
        timeout=60_000,
    )
    assert live.evaluate("PAGE.run.marks.length") == 1
    assert live.locator("#hint").get_attribute("class") == "gone"


def test_controls_and_keyboard(live):
    live.get_by_role("button", name="Storm").click()
    assert live.locator("#slider-waves").input_value() == "0.6"
    assert live.locator("#toggle-mismatch").is_checked()
    live.get_by_role("button", name="Circle").click()
    assert live.evaluate("PAGE.chosen.family") == "circle"
    live.get_by_role("button", name="Slow, 0.2 m/s").click()
    assert live.evaluate("PAGE.run.reference.rows[3]") == pytest.approx(0.2, rel=0.05)
    live.locator("#slider-current").fill("0.5")
    assert "0.10 m/s" in live.locator("label.slider").first.inner_text()
    assert live.evaluate("PAGE.chosen.preset") == ""
    live.evaluate("document.activeElement.blur()")
    seed = live.evaluate("PAGE.chosen.seed")
    live.keyboard.press("n")
    assert live.evaluate("PAGE.chosen.seed") == seed + 1
    live.keyboard.press(" ")
    assert live.evaluate("PAGE.playing") is False
    live.keyboard.press("r")
    assert live.evaluate("PAGE.run.k") == 0


def test_a_link_shows_the_same_episode(browser, folder, live):
    live.get_by_role("button", name="Waves", exact=True).click()
    live.get_by_role("button", name="Sine").click()
    live.locator("[data-controller=ekf]").click()
    live.locator("#slider-waves").fill("1.5")
    address = live.url
    with opened(browser, folder / "index.html") as page:
        page.goto("about:blank")
        page.goto(address)
        page.wait_for_function("PAGE.stats.frames > 2")
        assert page.evaluate("[PAGE.chosen.family, PAGE.settings.waves]") == ["sine", 1.5]
        assert sorted(page.evaluate("[...PAGE.chosen.on]")) == ["backstepping", "helm"]


def test_arrow_keys_steer_a_vehicle(live):
    live.get_by_role("button", name="Calm").click()
    live.locator("[data-controller=you]").click()
    live.evaluate("document.activeElement.blur()")
    heading = "PAGE.run.vehicles.find((v) => v.name === 'you').vehicle.plant[DATA.at.plant.r]"
    live.wait_for_function("PAGE.run.k > 20")
    before = live.evaluate(heading)
    live.keyboard.down("ArrowLeft")
    live.wait_for_function("k => PAGE.run.k > k + 10", arg=live.evaluate("PAGE.run.k"))
    assert live.evaluate(heading) > before + 0.05  # a positive rudder turns to port
    live.keyboard.up("ArrowLeft")
    assert live.evaluate("ENGINE.hand") == [0, 0]


def test_page_on_a_telephone(browser, folder):
    with opened(browser, folder / "index.html", 390, 844, mobile=True) as page:
        page.wait_for_function("PAGE.stats.frames > 30")
        assert page.evaluate("document.documentElement.scrollWidth") <= 390
        box = page.locator("#sea").bounding_box()
        assert box["height"] >= 300
        assert box["y"] + box["height"] < 844
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        touch, send = page.context.new_cdp_session(page), "Input.dispatchTouchEvent"
        touch.send(send, {"type": "touchStart", "touchPoints": [{"x": x, "y": y}]})
        touch.send(send, {"type": "touchMove", "touchPoints": [{"x": x + 90, "y": y - 40}]})
        page.wait_for_function("PAGE.run.vehicles[0].points.at(-1)[1] > 1")
        touch.send(send, {"type": "touchEnd", "touchPoints": []})


def test_files_are_small_and_need_no_network(tmp_path, capsys):
    assert main(["--out", str(tmp_path)]) == 0
    sizes = {file.name: file.stat().st_size for file in tmp_path.iterdir()}
    assert set(sizes) == {"index.html", "live.css", "equations.js", "data.js", "engine.js", "drawing.js", "page.js"}
    size = sum(sizes.values())
    assert f"{size / 1e6:.2f} MB" in capsys.readouterr().out
    assert size < 3_000_000
    page = Path(__file__).parents[2] / "docs" / "live.md"
    assert f"{size / 1e6:.1f} MB in all" in page.read_text(encoding="utf-8")
    assert "http" not in (tmp_path / "index.html").read_text(encoding="utf-8")
    assert json.loads(links().removeprefix("window.LINKS = ").rstrip(";\n")).keys() <= {"Source", "Documentation"}

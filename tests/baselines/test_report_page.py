"""The report of an evaluation in a browser: wide and narrow screens, print, no scripts, and hostile names."""

import re
from dataclasses import replace

import pytest
from browser import opened

from baselines import list_policies
from baselines.evaluation.options import Options
from baselines.evaluation.report.html import report_html, short_names
from baselines.evaluation.report.numbers import compare, pool
from baselines.evaluation.report.page_data import FEW
from baselines.evaluation.request import Request
from baselines.evaluation.runner import run_all
from baselines.tools.figure_style import LOOKS

LARGEST = 1_500_000  # [bytes] of a page
HOSTILE = '</script><img src=x onerror="window.caught=1"><b>&{{7*7}}\\'
TIMEOUT = 60_000  # [ms]
pytestmark = pytest.mark.slow  # a browser draws large pages


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    """A folder with two pages: the whole benchmark, and a run of a few policies, one of them with a hostile name."""
    folder = tmp_path_factory.mktemp("pages")
    request = Request.of(Options(suite="benchmark-v3", out=folder / "out"))
    cells = [replace(cell, episodes=cell.episodes[:3]) for cell in request.cells]
    live = run_all(("backstepping",), cells, step_limit=TIMEOUT)
    order = [cell.scenario.name for cell in cells]
    runs = sorted((*request.earlier, *live), key=lambda run: order.index(run.scenario.name))
    texts = {"benchmark": report_html(request, compare(runs), pool(runs))}
    few = Request.of(Options(scenario=("cruise-storm", "slow-current"), episodes=3, out=folder / "out"))
    runs = run_all(("backstepping", "lqi", "open-loop"), few.cells, step_limit=TIMEOUT)
    runs = [replace(run, policy=HOSTILE) if run.policy == "open-loop" else run for run in runs]
    texts["few"] = report_html(
        replace(few, command=f"python evaluate.py --policy {HOSTILE}"), compare(runs), pool(runs)
    )
    (folder / "suite").mkdir()
    (folder / "suite" / "report.html").write_text(texts["benchmark"], encoding="utf-8")
    (folder / "few.html").write_text(texts["few"], encoding="utf-8")
    return folder


def ready(page):
    page.wait_for_function("document.documentElement.dataset.ready === 'charts'", timeout=TIMEOUT)


def policies_of(chart):
    """Return the policies that are named in a chart."""
    return set(chart.locator(".mark-text.role-axis-label text").all_text_contents()) & {*list_policies(), HOSTILE}


def test_thirty_policies_have_different_looks():
    assert len({(look.colour, look.dash) for look in LOOKS}) == len(LOOKS) >= 30
    assert len({(look.colour, look.marker) for look in LOOKS}) == len(LOOKS)


@pytest.mark.parametrize("width", [1200, 390])
def test_the_benchmark_in_a_browser(browser, pages, width):
    assert (pages / "suite" / "report.html").stat().st_size < LARGEST
    with opened(browser, pages / "suite" / "report.html", width, mobile=width < 500) as page:
        ready(page)
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        board = page.locator("#leaderboard .panel.current")
        slow = [policy for policy in list_policies() if not policy.endswith("-cruise")]
        assert board.locator("tbody tr").count() == len(slow)
        headings = [text.strip() for text in board.locator("thead th").all_inner_texts()]
        scores = [
            float(cell)
            for cell in board.locator(f"tbody td:nth-child({headings.index('score') + 1})").all_inner_texts()
        ]
        assert scores == sorted(scores, reverse=True)
        assert len(policies_of(page.locator("#steady_rmses"))) <= FEW
        page.get_by_role("button", name="all", exact=True).click()
        count = len(list_policies())
        page.wait_for_function(f"document.getElementById('count').textContent === '{count} of {count} shown'")
        page.wait_for_function(
            "document.getElementById('steady_rmses').textContent.includes('open-loop')", timeout=TIMEOUT
        )
        assert len(policies_of(page.locator("#steady_rmses"))) >= len(slow) - 1  # the optimum is outside of the axis
        assert page.locator("#scores svg").count() >= 2


def test_no_column_is_cut_off(browser, pages):
    for name in ("suite/report.html", "few.html"):
        with opened(browser, pages / name, 1400) as page:
            ready(page)
            for table in page.locator(".wide:visible").all():
                assert table.evaluate("box => box.scrollWidth <= box.clientWidth"), name


def test_sort_filter_and_scenario(browser, pages):
    with opened(browser, pages / "suite" / "report.html") as page:
        ready(page)
        board = page.locator("#leaderboard .panel.current tbody")
        page.locator("#leaderboard .panel.current th", has_text="effort").click()
        headings = page.locator("#leaderboard .panel.current thead th").all_inner_texts()
        place = [heading.strip() for heading in headings].index("effort") + 1
        efforts = [float(row) for row in board.locator(f"td:nth-child({place})").all_inner_texts() if row != "-"]
        assert efforts == sorted(efforts)
        page.fill("#filter", "nmpc")
        assert board.locator("tr:visible").count() == sum("nmpc" in policy for policy in list_policies())
        page.locator("#cases th", has_text="storm").first.click()
        page.wait_for_function("document.getElementById('scenarios').selectedOptions[0].textContent === 'slow-storm'")
        assert page.locator("#scenario .panel.current h3").text_content() == "slow-storm"


def test_switch_a_policy_off_and_play(browser, pages):
    with opened(browser, pages / "few.html") as page:
        ready(page)
        assert page.evaluate("window.caught") is None
        assert HOSTILE.rpartition("/")[2] in page.locator("#leaderboard .panel.current tbody").inner_text()
        for chart, mark in {"steady_rmses": "symbol", "errors": "line", "bands": "line"}.items():
            assert page.locator(f"#{chart} .mark-{mark} path").count() == 3, chart
        page.locator('#leaderboard .panel.current tr[data-policy="lqi"] input').uncheck()
        page.wait_for_function("document.querySelectorAll('#errors .mark-line path').length === 2", timeout=TIMEOUT)
        assert "lqi" not in policies_of(page.locator("#steady_rmses"))
        assert page.locator("#now div").count() == 2
        image = "document.getElementById('sea').toDataURL()"
        before = page.evaluate(image)
        page.click("#play")
        page.wait_for_function("Number(document.getElementById('time').value) > 5", timeout=TIMEOUT)
        page.click("#play")
        assert page.evaluate(image) != before
        assert re.match(r"\d+\.\d of \d+ s", page.locator("#clock").text_content())
        rule = page.locator("#errors .mark-rule line").last
        at = rule.get_attribute("transform")
        page.evaluate(
            "s => { s.value = 1; s.dispatchEvent(new Event('input')); }", page.locator("#time").element_handle()
        )
        page.wait_for_function(
            f"[...document.querySelectorAll('#errors .mark-rule line')].at(-1).getAttribute('transform') !== '{at}'"
        )


def test_depths_of_scenarios_in_space_are_below_the_map(browser, pages):
    request = Request.of(Options(scenario=("space-calm",), episodes=1, out=pages / "out"))
    results = compare(run_all(("backstepping",), request.cells, step_limit=TIMEOUT))
    (pages / "space.html").write_text(report_html(request, results, pool([r.run for r in results])), encoding="utf-8")
    with opened(browser, pages / "space.html") as page:
        ready(page)
        below = "sea.getContext('2d').getImageData(sea.width / 2, 0.75 * sea.height, 1, 0.2 * sea.height).data"
        assert page.evaluate(f"new Set({below}).size") > 2  # a curve on white


def test_print_has_all_tables(browser, pages):
    with opened(browser, pages / "few.html") as page:
        ready(page)
        assert page.locator("#leaderboard .panel:visible").count() == 1
        page.emulate_media(media="print")
        assert page.locator("#leaderboard .panel:visible").count() == 2
        assert page.locator("#scenario .panel").count() == 0  # each table is on the page once
        assert page.locator(".controls:visible").count() == 0
        assert len(page.pdf(format="A4")) > 20_000


def test_page_without_scripts_has_the_tables(browser, pages):
    context = browser.new_context(java_script_enabled=False)
    page = context.new_page()
    page.goto((pages / "few.html").resolve().as_uri())
    assert page.locator("#leaderboard .panel:visible").count() == 2
    assert page.locator(".script:visible").count() == 0
    assert HOSTILE in page.locator("body").inner_text()
    context.close()


@pytest.mark.parametrize(
    ("names", "short"),
    [
        (("nmpc", "a/b/hand.py:P", "cmd:./go a/b"), ("nmpc", "hand.py:P", "cmd:./go a/b")),
        (("a/b/hand.py:P", "a/c/hand.py:P"), ("b/hand.py:P", "c/hand.py:P")),
        (("a/x/y/hand.py:P", "b/x/y/hand.py:P"), ("a/.../hand.py:P", "b/.../hand.py:P")),
        (("hand.py:P", "a/hand.py:P"), ("hand.py:P", "a/hand.py:P")),
    ],
)
def test_names_of_files_are_as_short_as_they_can_be(names, short):
    assert short_names(names) == dict(zip(names, short, strict=True))

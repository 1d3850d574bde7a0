"""Checks of the built documentation in a browser: width of pages, sorting of tables, equations, search and links."""

import re

from browser import opened

WIDE = ("index", "theory", "results", "results/hard-v1")
NARROW = ("index", "theory", "paper", "policies", "scenarios/cruise-storm", "environments/track", "api/auv_gym.physics")
TOO_WIDE = """() => [...document.querySelectorAll("table, pre, .formula, img, dl")].filter(part => {
  const box = part.parentElement, scrolls = getComputedStyle(box).overflowX !== "visible";
  const out = part.getBoundingClientRect().right > innerWidth + 1;
  return out && !scrolls && getComputedStyle(part).overflowX === "visible"
    && !part.closest(".table-wrapper, .highlight, details");
}).map(part => part.outerHTML.slice(0, 80))"""
"""Lists elements that are wider than the window or their box, and cannot be scrolled."""
FLAT = """() => [...document.querySelectorAll("math")].filter(formula => {
  const {width, height} = formula.getBoundingClientRect();
  return width < 4 || height < 4;
}).length"""
"""Counts the equations without a size."""
WIDTH = "() => document.documentElement.scrollWidth - innerWidth"
"""Width of a page minus the width of its window."""


FIRST_HITS = {
    "install": "install",
    "train": "training",
    "cite": "citing",
    "SB3": "tools",
    "compare MPC": "results",
    "reward": "environments/track",
    "own controller": "tutorials/controller",
    "vehicle": "vehicles",
    "ROS": "on-a-vehicle",
}
"""Page of the first hit, by search words."""


def check_pages(started, folder):
    """Check pages on a wide and on a narrow screen."""
    for width, mobile, names in ((1200, False, WIDE), (390, True, NARROW)):
        for name in names:
            with opened(started, folder / f"{name}.html", width, mobile=mobile) as page:
                assert page.evaluate(WIDTH) <= 0, (name, width)
                assert page.evaluate(TOO_WIDE) == [], (name, width)
                assert page.evaluate(FLAT) == 0, name
                assert all(page.evaluate("() => [...document.images].map(image => image.naturalWidth)")), name


def check_sorting(started, folder):
    """Sort a table by errors, in both directions, and by names."""
    with opened(started, folder / "results" / "benchmark-v3.html") as page:
        first = page.locator("table.sortable").first.locator("tbody tr td").first
        heading = page.locator("table.sortable").first.locator("th", has_text="its error [mm]")
        heading.click()
        least = first.inner_text()
        assert least.endswith("-calm")
        heading.press("Enter")
        assert first.inner_text() != least
        page.locator("table.sortable").first.locator("th", has_text="cell").click()
        assert first.inner_text() == "cruise-actuator"


def check_search(started, folder):
    """Search for words, follow the first hit, and check its address."""
    for words, name in FIRST_HITS.items():
        with opened(started, folder / "index.html") as page:
            page.get_by_placeholder("Search").first.fill(words)
            page.keyboard.press("Enter")
            page.locator("#search-results li a").first.click()
            page.wait_for_url(re.compile(r"/(?!search)[\w-]+\.html"))
            assert page.url.partition("?")[0] == (folder / f"{name}.html").resolve().as_uri(), words


def check_links(folder):
    """Check that names in pages are links to the reference."""
    equations = (folder / "paper.html").read_text(encoding="utf-8")
    assert 'href="api/auv_gym.physics.html#auv_gym.physics.dynamics.rates"' in equations
    vehicle = (folder / "api" / "auv_gym.physics.html").read_text(encoding="utf-8")
    assert "[kg] surge inertia, added mass included" in vehicle
    assert 'id="auv_gym.physics.vehicle.Vehicle.m11"' in vehicle

"""Take screenshots of the report for the documentation: `python -m research screenshots`.

The command evaluates a few policies and takes screenshots of the report in a headless browser.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from baselines.evaluation import entry as evaluation
from baselines.tools.command_line import DONE, FAILED, UsageError, parse
from baselines.tools.files import write_atomically
from research import DOCS

PROGRAM = "python -m research screenshots"
IMAGES = DOCS / "images"  # folder for the screenshots
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
"""Names of the browser programs, in the order in which they are tried."""
_POLICIES = ("ekf", "apg-cruise", "lqi")
"""Policies of the report, in addition to the expert."""
READY = "document.documentElement.dataset.ready === 'charts'"  # true in the browser after all charts are drawn
_TIMEOUT = 120_000  # [ms], for loading a page


@dataclass(frozen=True)
class Options:
    """Write screenshots of the report to docs/images. This needs the extra `dev`, and Chromium or Chrome.

    Exit status: 0 done, 1 nothing could be written, 2 wrong usage.
    """

    out: Path = IMAGES
    """Folder for the screenshots."""
    pages: Path | None = None
    """Folder for the report. A report of an earlier call is used again."""


def main(arguments: Sequence[str]) -> int:
    """Take the screenshots and return the exit status.

    Raises:
        UsageError: the arguments are invalid, or there is no browser.
    """
    options = parse(Options, arguments, PROGRAM)
    program = next(filter(None, map(shutil.which, BROWSERS)), None)
    if program is None:
        raise UsageError(f"no browser is installed; the command needs one of {', '.join(BROWSERS)}")
    with tempfile.TemporaryDirectory() as temporary:
        pages = options.pages or Path(temporary)
        _evaluate(pages)
        try:
            for name, png in _pictures(program, pages).items():
                write_atomically(options.out / f"report-{name}.png", png)
        except OSError as error:
            print(f"{PROGRAM}: cannot write to {options.out}: {error.strerror}", file=sys.stderr)
            return FAILED
    print(f"Wrote report-*.png to {options.out}")
    return DONE


def _evaluate(pages: Path) -> None:
    """Evaluate the policies if the report is missing."""
    if not (pages / "suite" / "report.html").exists():
        words = ("--suite", "benchmark-v2", "--episodes", "40", "--policy", *_POLICIES)
        evaluation.main([*words, "--out", str(pages / "suite")])


def _pictures(program: str, pages: Path) -> dict[str, bytes]:
    """Return the screenshots as PNG, by name."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=program, chromium_sandbox=False, args=["--disable-gpu"])
        page = _opened(browser, pages / "suite" / "report.html")
        found = {"leaderboard": page.screenshot(), "cases": page.locator("#cases").screenshot()}
        page.select_option("#scenarios", label="cruise-storm")
        _at(page, 0.6)
        found["scenario"] = page.locator("#scenario .pair").first.screenshot()
        found["player"] = page.locator("#player").screenshot()
        phone = _opened(browser, pages / "suite" / "report.html", 390)
        phone.select_option("#scenarios", label="cruise-storm")
        _at(phone, 0.6)
        phone.locator("#player").scroll_into_view_if_needed()
        found["telephone"] = phone.screenshot()
        browser.close()
    return found


def _opened(browser: Any, file: Path, width: int = 1100) -> Any:
    page = browser.new_page(viewport={"width": width, "height": 860})
    page.goto(file.resolve().as_uri())
    page.wait_for_function(READY, timeout=_TIMEOUT)
    return page


def _at(page: Any, share: float) -> None:
    """Move the player to a share of the episode."""
    move = "(slider, share) => { slider.value = share * slider.max; slider.dispatchEvent(new Event('input')); }"
    page.locator("#time").evaluate(move, share)
    page.wait_for_timeout(500)

"""A headless browser for the tests of pages: Chromium or Chrome as installed, controlled by Playwright.

A test fails if a page uses the network, or writes an error to the console.
"""

import contextlib
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
QUIET = ("--disable-gpu", "--disable-dev-shm-usage", "--disable-background-networking", "--disable-component-update")


@contextlib.contextmanager
def browser() -> Iterator:
    """Start the installed browser for a `with` block; without one skip the test, on CI fail."""
    from playwright.sync_api import sync_playwright

    program = next(filter(None, map(shutil.which, NAMES)), None)
    if program is None:
        (pytest.fail if os.environ.get("CI") else pytest.skip)(f"no browser is installed: one of {', '.join(NAMES)}")
    with sync_playwright() as play:
        # Without the sandbox, since containers and continuous integration run as root; it opens only our own files.
        started = play.chromium.launch(executable_path=program, chromium_sandbox=False, args=list(QUIET))
        yield started
        started.close()


@contextlib.contextmanager
def opened(started, file: Path, width: int = 1200, height: int = 900, *, mobile: bool = False) -> Iterator:
    """Open a page from a file for a `with` block, and check that the page uses no network and has no errors."""
    faults = []
    context = started.new_context(viewport={"width": width, "height": height}, is_mobile=mobile, has_touch=mobile)
    page = context.new_page()
    page.on("pageerror", lambda error: faults.append(f"error on the page: {error}"))
    page.on("console", lambda message: message.type == "error" and faults.append(f"console: {message.text}"))
    page.on(
        "request",
        lambda request: request.url.startswith(("http", "ws")) and faults.append(f"asked for {request.url}"),
    )
    page.goto(file.resolve().as_uri())
    yield page
    context.close()
    assert not faults, faults

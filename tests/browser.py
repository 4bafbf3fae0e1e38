"""Headless Chromium, driven by playwright, and pages opened in it."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
FLAGS = (
    "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking "
    "--disable-component-update --disable-sync"
)


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """Chromium; without it the test is skipped."""
    if CHROMIUM is None:
        pytest.skip("Chromium is missing: apt-get install chromium")
    playwright = pytest.importorskip("playwright.sync_api").sync_playwright().start()
    browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS.split())
    yield browser
    browser.close()
    playwright.stop()


class Opened:
    """A page, with its requests and its complaints."""

    def __init__(self, browser: Any, file: Path, fragment: str = "") -> None:
        self.page = browser.new_page(viewport={"width": 1280, "height": 860})
        self.requests, self.complaints, self.uri = list[str](), list[str](), file.as_uri()
        self.page.on("request", lambda request: self.requests.append(request.url))
        self.page.on("console", lambda message: self.complaints.append(message.text))
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.goto(self.uri + fragment)

    @property
    def time(self) -> float:
        """The time that the page shows [s]."""
        return float(self.page.locator("#clock").inner_text())

    def close(self) -> None:
        """Close the page; it must be one file, without a network and without complaints."""
        assert self.complaints == []
        assert [request.partition("#")[0] for request in self.requests] == [self.uri]
        self.page.close()

"""One page for the whole run, written when the last test is over."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.extremes.page import Page


@pytest.fixture(scope="session")
def extremes_page() -> Iterator[Page]:
    page = Page()
    yield page
    page.write()

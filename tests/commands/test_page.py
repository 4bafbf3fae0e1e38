"""The animated page in a browser."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jackbox_env import Scene, make_simulator
from jackbox_env.recording.motion import Motion
from jackbox_env.recording.page import write_page
from tests.browser import Opened
from tests.commands.test_samples import run


@pytest.fixture(scope="module")
def motion() -> Motion:
    return run(Scene(), 10.0, contact="exact")


@pytest.fixture(scope="module")
def file(motion: Motion, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("page") / "trajectory.html"
    return write_page(path, motion, "</script><b>a test", [("contact model", "exact")])


class Film(Opened):
    """The animated page."""

    @property
    def playing(self) -> bool:
        return bool(self.page.locator("#play").get_attribute("aria-label") == "Pause")

    def pause(self) -> None:
        if self.playing:
            self.page.click("#play")

    def seek(self, moment: float) -> None:
        self.page.locator("#slider").evaluate("(slider, time) => { slider.value = time; }", moment)
        self.page.locator("#slider").dispatch_event("input")

    def numbers(self, plots: str) -> list[float]:
        texts = self.page.locator(f"#{plots} output").all_inner_texts()
        return [float(text.replace("\u2212", "-")) for text in texts]


@pytest.fixture
def opened(browser: Any, file: Path) -> Iterator[Film]:
    opened = Film(browser, file)
    yield opened
    opened.close()


def test_it_plays_by_itself_and_no_faster_than_the_clock(opened: Film) -> None:
    code = "() => Number(document.getElementById('clock').textContent) * 1000 / performance.now()"
    opened.page.wait_for_timeout(1000)
    assert opened.playing
    assert 0.0 < opened.page.evaluate(code) < 1.1  # a busy machine lets it fall behind


def test_the_list_names_each_impact_and_a_click_jumps_to_it(opened: Film, motion: Motion) -> None:
    listed = opened.page.locator("#impacts tr")
    assert listed.count() == len(motion.impacts)
    for index in (0, 4, len(motion.impacts) - 1):
        hit, row = motion.hits[index], listed.nth(index)
        cells = row.locator("td").all_inner_texts()
        assert cells == [f"{hit.time:.4f}", str(hit.wall), str(hit.foot), f"{hit.impulse:#.4g}"]
        row.click()
        assert opened.time == pytest.approx(hit.time, abs=0.006)
        assert not opened.playing
        assert row.get_attribute("class") == "now"
        assert opened.page.locator("#hits").inner_text() == str(index + 1)


@pytest.mark.parametrize("part", ["#impacts button >> nth=3", "#rows"])
def test_pause_holds_and_space_plays_on_wherever_the_focus_is(opened: Film, part: str) -> None:
    opened.pause()
    opened.page.locator(part).focus() if part == "#rows" else opened.page.click(part)
    opened.pause()
    held = opened.time
    opened.page.wait_for_timeout(300)
    assert opened.time == held
    opened.page.keyboard.press("Space")
    assert opened.playing
    opened.page.wait_for_timeout(300)
    assert opened.time > held


@pytest.mark.parametrize("plots", ["box-plots", "energy-plots"])
def test_a_click_in_a_plot_seeks(opened: Film, plots: str) -> None:
    opened.pause()
    canvas = opened.page.locator(f"#{plots} canvas").first
    canvas.scroll_into_view_if_needed()
    box = canvas.bounding_box()
    left, right = box["x"] + 46, box["x"] + box["width"] - 6
    for part in (0.5, 0.2):
        x = left + part * (right - left)
        opened.page.mouse.click(x, box["y"] + 40)
        assert opened.time == pytest.approx(10.0 * part, abs=0.05)
        assert opened.page.locator(f"#{plots} .cursor").bounding_box()["x"] == pytest.approx(x, abs=2.0)


def test_between_its_samples_it_shows_where_the_model_is(opened: Film, motion: Motion) -> None:
    """Also next to an impact, between two stored states: the corner is not cut."""
    opened.pause()
    for hit, since in zip(motion.hits[:4], (-0.004, 0.0005, 0.0137, 0.0005), strict=True):
        exact = make_simulator(Scene(), contact="exact")
        exact.reset([0.0] * 12)
        exact.step(hit.time + since)
        opened.seek(hit.time + since)
        shown = opened.numbers("box-plots") + opened.numbers("jack-plots")
        expected = exact.state[[0, 1, 2, 6, 7, 8, 3, 4, 5, 9, 10, 11]]
        np.testing.assert_allclose(shown, expected, rtol=1e-3, atol=2e-3)


def test_impacts_beyond_the_list_are_counted_and_stepped_through(browser: Any, tmp_path: Path) -> None:
    scene = Scene(restitution=0.4, drive=None)
    motion = run(scene, 8.0, 0.005)  # comes to rest
    opened = Film(browser, write_page(tmp_path / "trajectory.html", motion, "rest", []))
    opened.pause()
    opened.seek(8.0)
    assert len(motion.impacts) > opened.page.locator("#impacts tr").count() == 2000
    assert opened.page.locator("#hits").inner_text() == str(len(motion.impacts))
    opened.page.keyboard.press("Shift+ArrowLeft")
    assert opened.time == pytest.approx(motion.hits[-2].time, abs=0.006)
    opened.close()


def test_text_from_outside_is_shown_as_text(opened: Film) -> None:
    assert "</script><b>a test" in opened.page.locator("#subtitle").inner_text()

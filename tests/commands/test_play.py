"""The page of `jackbox play` in a browser."""

from __future__ import annotations

import gzip
import json
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import quote

import pytest

from jackbox_env import Scene, make_simulator
from jackbox_env.commands.game import read_game, write_game
from scripts.site.build import ensure_page
from tests.browser import Opened
from tests.script import jackbox
from tests.states import started

REST = [0.0] * 12


class Page(Opened):
    """The page, its message, and its game's text."""

    @property
    def message(self) -> str:
        return str(self.page.locator("#message").inner_text())

    @property
    def text(self) -> str:
        self.page.click("#share")
        text = self.page.locator("#text").input_value()
        self.page.keyboard.press("Escape")
        return str(text)

    def play(self, text: str, button: str = "Play the text above") -> None:
        """Paste a text and play it."""
        self.page.click("#share")
        self.page.locator("#text").fill(text)
        self.page.click(f"text={button}")
        self.page.locator("#sharing").wait_for(state="hidden")
        self.page.wait_for_timeout(100)  # the dialog's event comes a moment later

    def wait_for(self, message: str) -> None:
        self.page.locator("#message", has_text=message).wait_for()

    def paused(self) -> float:
        """The time that it shows [s] once it has paused: on a busy machine a moment after the key."""
        self.page.locator("#hint", has_text="Paused").wait_for()
        return self.time

    def wait_until_shown(self) -> None:
        """Wait until it has read its numbers anew, as it does every 80 ms, in a frame."""
        self.page.evaluate("new Promise((done) => setTimeout(() => requestAnimationFrame(() => setTimeout(done)), 99))")


def wait_for(frame: Any, name: str, pattern: str) -> float:
    """Wait until an output matches; its number then."""
    output = frame.locator(f"#{name}")
    output.filter(has_text=re.compile(pattern)).wait_for()
    return float(output.inner_text().removesuffix(" %"))


@pytest.mark.parametrize(
    ("policy", "scripts", "why"),
    [
        ("script-src 'unsafe-inline'", True, "forbid WebAssembly"),
        ("script-src 'self'", True, "forbid the page's script"),
        ("", False, "JavaScript is switched off"),
    ],
)  # fmt: skip
def test_a_page_that_may_not_run_says_why(policy: str, scripts: bool, why: str, browser: Any) -> None:
    context = browser.new_context(java_script_enabled=scripts)
    page, headers = context.new_page(), {"Content-Security-Policy": policy} if policy else {}
    body = ensure_page().read_text(encoding="utf-8")
    page.route("**", lambda route: route.fulfill(body=body, content_type="text/html", headers=headers))
    page.goto("http://jack.test/")
    page.wait_for_timeout(2500)  # the page gives its script 2 s
    assert why in page.locator("#hint").inner_text()
    context.close()


@pytest.fixture
def opened(browser: Any) -> Iterator[Page]:
    opened = Page(browser, ensure_page())
    yield opened
    opened.close()


def test_nothing_moves_before_a_key(opened: Page) -> None:
    opened.page.wait_for_timeout(300)
    assert opened.time == 0.0
    opened.page.keyboard.press("ArrowLeft")
    wait_for(opened.page, "clock", "[1-9]")
    opened.page.keyboard.press("Space")
    time = opened.paused()
    opened.page.wait_for_timeout(300)
    assert opened.time == time


def test_a_game_of_600_steps_is_replayed_to_the_last_bit(opened: Page, tmp_path: Path) -> None:
    opened.page.select_option("#speed", "4")
    side = 0
    while opened.time < 12.0:
        key = ("ArrowLeft", "ArrowRight", "c", "c")[side % 4]
        opened.page.keyboard.down(key)
        opened.page.wait_for_timeout(150)
        opened.page.keyboard.up(key)
        side += 1
    text = opened.text
    assert len(read_game(text).shares) >= 590
    assert "the same, bit for bit" in jackbox("replay", text, cwd=tmp_path).stdout


def test_a_text_of_the_package_plays_and_ends_with_a_verdict(opened: Page) -> None:
    opened.page.select_option("#speed", "4")
    shares = [None] * 50 + [0.3] * 100 + [k / 1e3 for k in range(50)]
    scene = Scene(restitution=0.8, jack_mass=2.0, box_mass=40.0, torque_limit=9000.0)
    text = write_game(scene, REST, shares, "spin")
    opened.play(text)
    opened.wait_for("after 200 steps: the same, bit for bit")
    assert json.loads(opened.text) == json.loads(text)
    changed = json.loads(text)
    changed["start"][0] = 1e-15
    opened.play(json.dumps(changed))
    opened.wait_for("it differs from step 1 on")


def test_the_agent_plays_and_such_an_episode_is_never_the_best(opened: Page) -> None:
    opened.page.select_option("#task", "rattle")
    opened.page.select_option("#speed", "4")
    opened.page.keyboard.press("a")
    opened.page.wait_for_timeout(100)
    opened.page.keyboard.press("a")
    opened.page.keyboard.press("ArrowLeft")
    opened.wait_for("10 s are over")
    assert "your best" not in opened.message
    assert len(set(read_game(opened.text).shares)) > 2
    opened.page.keyboard.press("r")
    opened.page.keyboard.press("ArrowLeft")
    opened.wait_for("your best")


def altered(**values: Any) -> Callable[[str], str]:
    return lambda text: json.dumps({**json.loads(text), **values})


BAD = [  # no sentence twice in a row
    ("cut off", lambda text: text[:-30], "not a complete game"),
    ("huge", lambda text: text + " " * 65536, "65536 characters"),
    ("another version", altered(version=2), "version must be 1"),
    ("NaN in package", altered(package=float("nan")), "not a complete game"),
    ("18 minutes", altered(dt=1.0, checks="AAAA" * 350, counts="GgQ"), "at most 1000 s, got 1050 s"),
    ("NaN torque", altered(shares="AAAAAAAA-H8"), "shares must be from -1 to 1"),
    ("NaN", altered(start=[float("nan")] * 12), "not a complete game"),
    ("gravity", altered(scene={"gravity": -1}), "gravity must be a finite number at least 0 and at most 1e+60, got -1"),
    (
        "arm",
        altered(scene={"jack_arm": 9}),
        "jack_arm must be below sqrt(2) * box_half_width = 8.48528 m to fit",
    ),
    ("inertia", altered(scene={"jack_arm": 1e-40}), "jack_inertia must be a finite number at least 1e-60"),
    ("code", altered(task="__proto__"), "task must be one of juggle, spin, rattle"),
    ("a foot outside", altered(start=[0, 0, 0, 9, *REST[4:]]), "every foot inside"),
    ("dt", altered(dt="0.02"), "dt must be from 0.001 to 1 s"),
    ("deep", lambda text: text[:-1] + ',"dt":' + "[" * 9000 + "]" * 9000 + "}", "cannot be played"),
    ("tiny dt", altered(dt=1e-7), "dt must be from 0.001 to 1 s"),
    ("missing checks", altered(checks=""), "a check for each step"),
    ("unknown key", altered(script="<b>"), 'has no "script"'),
]


def test_bad_texts_are_refused_in_one_sentence_by_page_and_package(opened: Page) -> None:
    for name, damage, sentence in BAD:
        text = damage(write_game(None, REST, [0.5]))
        opened.play(text)
        opened.wait_for(sentence)
        assert "cannot be played" in opened.message, name
        assert opened.page.locator("#hint").is_visible(), name  # as at the beginning
        with pytest.raises(ValueError):  # noqa: PT011  # its sentences have their own test
            read_game(text)
    opened.page.keyboard.press("ArrowLeft")
    wait_for(opened.page, "clock", "[1-9]")


def test_a_link_opens_its_scene(browser: Any) -> None:
    fragment = "#" + quote(json.dumps({"version": 1, "start": REST, "scene": {"gravity": 0, "jack_arm": 2.5}}))
    opened = Page(browser, ensure_page(), fragment)
    assert opened.page.locator("#sliders output").all_inner_texts() == [
        "90000 N m",
        "400 kg",
        "4.00 kg",
        "2.50 m",
        "1.00",
        "0.00 m/s²",
    ]
    opened.page.keyboard.press("ArrowLeft")
    wait_for(opened.page, "clock", "[1-9]")
    assert json.loads(opened.text)["scene"] == {"gravity": 0, "jack_arm": 2.5}
    opened.close()


# -- the lesson -------------------------------------------------------------------------------------------------------


def test_a_question_starts_its_scene_and_gives_it_the_keys(opened: Page) -> None:
    lesson = opened.page
    lesson.focus("#lesson")  # as a click does
    lesson.select_option("#lesson", "1")
    wait_for(lesson, "clock", "[1-9]")
    lesson.keyboard.press("Space")  # pauses, and scrolls nothing
    opened.paused()
    lesson.click("#stage", position={"x": 60, "y": 200})  # plays on
    wait_for(lesson, "clock", "^0.[5-9]|^[1-9]")
    lesson.click("#stage", position={"x": 60, "y": 200}, delay=200)  # pauses, and turns nothing
    opened.paused()
    assert lesson.locator("#torque").inner_text() == "0 %"
    assert lesson.locator("#question details").get_attribute("open") is None
    lesson.select_option("#speed", "0.125")  # so that a busy machine sees it
    lesson.click("text=A drop")  # starts anew
    assert wait_for(lesson, "clock", "^0.[0-4]") < 0.5
    lesson.keyboard.down("ArrowLeft")
    wait_for(lesson, "torque", "[1-9]")
    opened.play(write_game(None, REST))
    lesson.locator("#question").wait_for(state="hidden")  # a pasted game is no scene of it


def test_the_plots_of_a_question_are_on_the_screen_and_read_under_the_pointer(opened: Page) -> None:
    opened.page.set_viewport_size({"width": 1366, "height": 768})
    opened.page.select_option("#speed", "4")
    opened.page.select_option("#lesson", "1")
    wait_for(opened.page, "clock", "^1[0-9]")
    opened.page.keyboard.press("Space")
    plots = opened.page.locator("#plots")
    box = plots.bounding_box()
    lasts = opened.paused()
    second = (box["width"] - 52) / lasts  # of the axis, in pixels: the plots have margins of 46 and 6
    simulator = started(make_simulator({"drive": None}, contact="exact"), REST)
    middles = [plots.locator("canvas").nth(panel).bounding_box()["y"] + 40 for panel in (2, 3)]
    for time, plot in ((6.0, 0), (7.0675, 1), (7.1, 0)):  # an impact, and a tenth beside it
        simulator.step(time - simulator.time)
        opened.page.mouse.move(box["x"] + 46 + second * time, middles[plot])
        opened.wait_until_shown()
        energy, _, height, velocity, *_ = (
            text.replace("\u2212", "-") for text in plots.locator(".legend").all_inner_texts()
        )
        assert "all 0.000" in energy  # without its rounding
        seen = [float(text.split("jack ")[1].split()[0]) for text in (height, velocity)]
        assert seen[0] == pytest.approx(simulator.state[4], abs=1e-2)
        assert abs(seen[1]) == pytest.approx(abs(simulator.state[10]), abs=0.3)  # an impact turns it around


def test_a_resting_foot_is_no_bounce(opened: Page) -> None:
    opened.page.select_option("#speed", "4")
    opened.page.select_option("#lesson", "2")
    opened.page.locator("#rest").wait_for()
    counted = opened.page.locator("#hits").inner_text()
    simulator = started(make_simulator({"restitution": 0.5, "drive": None}, contact="exact"), REST)
    bounces = 0
    for _ in range(160):
        impacts = simulator.step(0.02).impacts
        bounces += sum(hit.time < simulator.time for hit in impacts)  # those of rest are recorded at the step's end
    assert int(counted) == bounces
    assert impacts
    opened.page.wait_for_timeout(300)
    assert opened.page.locator("#hits").inner_text() == counted


def test_an_address_may_name_a_question(browser: Any) -> None:
    refused = "scene must be from 1 to 9, got"
    for query, message in (("?scene=7", ""), ("?scene=ten", f"{refused} ten"), ("?scene=", f"{refused} nothing")):
        opened = Page(browser, ensure_page(), query)
        opened.page.wait_for_timeout(200)
        assert opened.message == message
        wait_for(opened.page, "clock", "^0.0$" if message else "[1-9]")
        opened.uri += query
        opened.close()


def test_the_ghost_is_the_agent_or_a_shared_game(opened: Page) -> None:
    def returns() -> list[str]:
        opened.wait_until_shown()
        return [opened.page.locator("#returns tr").nth(row).inner_text().split("\t")[1] for row in (0, 1)]

    opened.page.select_option("#speed", "4")
    for key in "ga":
        opened.page.keyboard.press(key)
    wait_for(opened.page, "clock", r"^[4-9]|\d\d\.")  # after an impact
    text = opened.text
    mine, ghost = returns()
    assert float(mine) == float(ghost) > 0.0
    opened.page.keyboard.press("a")
    opened.play(write_game(None, REST), "Play against it")
    opened.wait_for("it has no steps to play against")
    opened.play(text, "Play against it")
    for key in ("r", "Space"):
        opened.page.keyboard.press(key)
    while opened.time < 0.02 * len(read_game(text).shares) + 0.2:  # its game is over
        opened.page.wait_for_timeout(50)
    assert [text == ghost for text in returns()] == [False, True]
    assert read_game(opened.text).start.tolist() == read_game(text).start.tolist()


def test_the_file_is_small() -> None:
    assert len(gzip.compress(ensure_page().read_bytes())) < 165_000

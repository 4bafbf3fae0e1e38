"""Pages of studies show the numbers stored beside them, and the figures are what they are said to be."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import imageio.v3 as imageio
import numpy as np
import pymunk
import pytest
from matplotlib.figure import Figure

from jackbox_env import Scene, make_simulator
from scripts.studies import pages, timing
from scripts.studies.costs import costs
from scripts.studies.costs import measured as cost_steps
from scripts.studies.derivatives import derivatives
from scripts.studies.results import results
from scripts.studies.speed import measured, speed

DOCS = Path(__file__).parents[2] / "docs"


def stored(name: str) -> Any:
    return json.loads((DOCS / f"{name}.json").read_text())


PAGES: dict[str, Callable[[], str]] = {
    "speed": lambda: speed.page(stored("speed")),
    "costs": lambda: costs.page(stored("costs")),
    "results": lambda: results.page(stored("results")),
    "derivatives": lambda: derivatives.page(stored("derivatives")),
}


PICTURES = [f"derivatives/{name}.png" for name in derivatives.PARTS]


@pytest.mark.parametrize("name", PAGES)
def test_a_page_holds_the_numbers_that_are_stored(name: str) -> None:
    text = (DOCS / f"{name}.md").read_text()
    assert PAGES[name]() == text
    for picture in re.findall(r"!\[.*?\]\((.+?)\)", text):
        assert (DOCS / picture).is_file()


@pytest.mark.parametrize("name", ["speed.png", "costs.png", "results.png", *PICTURES])
def test_a_picture_is_read_on_light_pages_and_on_dark_ones(name: str) -> None:
    """It has no ground of its own, and whatever covers it stands out against white and against black."""
    picture = imageio.imread(DOCS / name).astype(float) / 255.0
    colours, shown = picture[..., :3], picture[..., 3] > 0.9
    assert (picture[..., 3] == 0.0).mean() > 0.7
    linear = np.where(colours <= 0.04045, colours / 12.92, ((colours + 0.055) / 1.055) ** 2.4)
    luminance = (linear @ [0.2126, 0.7152, 0.0722])[shown]
    assert np.minimum(1.05 / (luminance + 0.05), (luminance + 0.05) / 0.05).min() > 2.7


def test_dots_are_sorted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = list[Any]()
    monkeypatch.setattr(Figure, "savefig", lambda figure, path, dpi: drawn.extend(figure.axes))
    pages.dots(tmp_path / "dots.png", "what", {"middle": 10.0, "least": 1.0, "most": 1e5})
    assert [label.get_text() for label in drawn[0].get_yticklabels()] == ["least", "middle", "most"]


def test_other_numbers_would_make_another_page() -> None:
    data = stored("results")
    data["rows"][0]["mean"] += 50.0
    assert results.page(data) != (DOCS / "results.md").read_text()


# -- figures -----------------------------------------------------------------------------------------------------------


def test_rates_are_taken_in_turn_and_ratios_within_a_round() -> None:
    order: list[str] = []

    def timed(name: str, rates: list[float]) -> timing.Timed:
        def run() -> float:
            order.append(name)
            return rates.pop(0)

        return run

    rates = timing.measure({"a": timed("a", [9.0, 1.0, 4.0]), "b": timed("b", [9.0, 2.0, 2.0])}, 2, progress=False)
    assert order == ["a", "b"] * 3
    assert rates == {"a": [1.0, 4.0], "b": [2.0, 2.0]}  # the first is the warm-up
    assert timing.ratios(rates, "a", "b") == [0.5, 2.0]


def test_a_rate_is_what_a_block_did_over_the_time_that_it_took() -> None:
    now = [0.0]

    def block() -> int:
        now[0] += 0.5
        return 10

    def prepare() -> None:
        now[0] += 100.0  # is not timed

    assert timing.repeat(block, 1.9, prepare, lambda: now[0])() == 20.0
    assert now[0] == 4 * 100.5


def test_differences_are_taken_within_passes_and_noise_is_told() -> None:
    # The machine is twice as slow in the second pass, and the difference stays a tenth; one pass is disturbed.
    ns = {"plain": [100.0, 200.0, 100.0] * 2, "with": [110.0, 220.0, 900.0, 110.0, 220.0, 50.0]}
    rates = {name: [1e9 / value for value in values] for name, values in ns.items()}
    assert costs.in_rounds(rates, 3, {"with": 1.0, "plain": -1.0}) == pytest.approx([20.0, 10.0])
    assert costs.cell([20.0, 10.0], 100.0) == "+15 ns (+15%)"
    assert costs.cell([-1.0, 2.0], 100.0) == "below noise"


# -- what is timed -----------------------------------------------------------------------------------------------------


def test_the_bare_pymunk_loop_steps_the_scene_of_the_default(monkeypatch: pytest.MonkeyPatch) -> None:
    # From rest at the origin and under the same torques both reach the same state, before the first impact.
    space = pymunk.Space()
    monkeypatch.setattr(pymunk, "Space", lambda: space)
    monkeypatch.setattr(measured, "EPISODE", 40)
    measured.bare_pymunk(0.0)()
    box, jack = space.bodies
    monkeypatch.undo()
    simulator = make_simulator(Scene(), contact="pymunk")
    simulator.reset(np.zeros(12))
    for torque in np.random.default_rng(0).uniform(-90000.0, 90000.0, 40).tolist():
        simulator.step(0.02, torque)
    assert box.angular_velocity == pytest.approx(simulator.state[8], rel=1e-12)
    assert jack.velocity.y == pytest.approx(simulator.state[10], rel=1e-12)
    assert len(space.shapes) == 8


@pytest.mark.slow
def test_only_the_unguarded_search_loses_impacts_and_feet() -> None:
    found = measured.lost()
    assert found["certified"] == 0
    assert found["missed"] > 10
    assert found["escaped"] > 10


@pytest.mark.parametrize("contact", ["pymunk", "exact"])
def test_each_kind_of_step_is_timed(contact: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    usual, far = cost_steps.moments(2, 100), cost_steps.moments(2, 100, cost_steps.LONG)
    for kind in cost_steps.KINDS:
        assert cost_steps.stepped(contact, far if kind == "long arm" else usual, 0.0, kind)() > 0.0


@pytest.mark.parametrize("kind", cost_steps.LOSS)
def test_each_step_with_loss_is_what_its_row_says(kind: str) -> None:
    given = cost_steps.with_loss(kind, courses=24)
    few, most = {cost_steps.FLIGHT: (0, 0), cost_steps.BOUNCE: (1, 1), cost_steps.PILE: (10, 20)}.get(kind, (1, 4))
    assert few <= given.hits.min()
    assert given.hits.max() <= most
    scene, rests = cost_steps.LOSS[kind], kind.startswith("rest")
    simulator = make_simulator(scene, "exact")
    for state, hits in zip(given.states[:20, 0], given.hits[:20, 0], strict=True):
        simulator.reset(state)
        simulator.step(cost_steps.DT, 0.0)
        assert len(simulator.impacts) == hits
        held = {hit.foot for hit in simulator.impacts if hit.time == simulator.time}
        assert len(held) == (2 if rests else 0) or kind in (cost_steps.PILE, cost_steps.CORNER)

"""Pages of studies show the stored numbers, and the timed code is the code that the page describes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib.image
import numpy as np
import pymunk
import pytest

from jackbox_env import Scene, make_simulator
from scripts.studies.accuracy import accuracy
from scripts.studies.costs import costs
from scripts.studies.costs import measured as cost_steps
from scripts.studies.derivatives import derivatives
from scripts.studies.fitting import fitting
from scripts.studies.recipes import recipes
from scripts.studies.results import results
from scripts.studies.speed import measured, speed
from scripts.studies.study import as_text

DOCS = Path(__file__).parents[2] / "docs"


STUDIES = {one.STUDY.name: one.STUDY for one in (accuracy, costs, derivatives, fitting, recipes, results, speed)}


def stored(name: str) -> Any:
    return STUDIES[name].read(DOCS)


@pytest.mark.parametrize("name", STUDIES)
def test_a_page_shows_the_stored_numbers(name: str) -> None:
    assert STUDIES[name].page(stored(name)) == (DOCS / f"{name}.md").read_text(), f"scripts/studies/{name}/ --render"


@pytest.mark.parametrize("name", STUDIES)
def test_a_record_is_stored_as_it_is_written(name: str) -> None:
    assert as_text(stored(name)) == (DOCS / f"{name}.json").read_text()


def test_what_a_recipe_prints_is_its_result(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recipes, "HERE", tmp_path)
    (tmp_path / "with_one.py").write_text("print('training')\nprint('after 1,000 actions: return -3.5 +- 0.2')")
    row = recipes.trained("one", [])
    assert (row["actions"], row["mean"], row["half_width_95"]) == (1000, -3.5, 0.2)
    (tmp_path / "with_one.py").write_text("print('return 24, deviation 7')")
    row = recipes.trained("one", [])
    assert (row["actions"], row["mean"], row["half_width_95"]) == (None, 24.0, None)
    (tmp_path / "with_one.py").write_text("raise SystemExit('no memory')")
    with pytest.raises(RuntimeError, match="the recipe one failed: no memory"):
        recipes.trained("one", [])


def test_other_numbers_would_make_another_page() -> None:
    data = stored("results")
    data["rows"][0]["mean"] += 50.0
    assert STUDIES["results"].page(data) != (DOCS / "results.md").read_text()


@pytest.mark.parametrize("part", derivatives.PICTURED)
def test_a_picture_of_derivatives_is_drawn_from_the_stored_numbers(part: str, tmp_path: Path) -> None:
    derivatives.PICTURED[part].draw(stored("derivatives")[part], tmp_path / "picture.png")
    assert matplotlib.image.imread(tmp_path / "picture.png")[..., 3].any()


# -- figures -----------------------------------------------------------------------------------------------------------


def test_differences_are_computed_within_passes_and_noise_is_reported() -> None:
    # The machine is twice as slow in the second pass, and the difference stays a tenth; one pass is disturbed.
    ns = {"plain": [100.0, 200.0, 100.0] * 2, "with": [110.0, 220.0, 900.0, 110.0, 220.0, 50.0]}
    rates = {name: [1e9 / value for value in values] for name, values in ns.items()}
    assert costs.in_rounds(rates, 3, {"with": 1.0, "plain": -1.0}) == pytest.approx([20.0, 10.0])
    assert costs.cell([20.0, 10.0], 100.0) == "+15 (+15%)"
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


@pytest.mark.slow
def test_only_the_unguarded_search_loses_impacts_and_feet() -> None:
    counts = measured.lost()
    assert counts["certified"] == 0
    assert counts["missed"] > 10
    assert counts["escaped"] > 10


@pytest.mark.parametrize("kind", cost_steps.LOSS)
def test_each_step_with_loss_has_the_impacts_of_its_row(kind: str) -> None:
    steps = cost_steps.with_loss(kind, courses=24)
    few, most = {cost_steps.FLIGHT: (0, 0), cost_steps.BOUNCE: (1, 1), cost_steps.PILE: (10, 20)}.get(kind, (1, 4))
    assert few <= steps.hits.min()
    assert steps.hits.max() <= most
    scene, rests = cost_steps.LOSS[kind], kind.startswith("rest")
    simulator = make_simulator(scene, "exact")
    for state, hits in zip(steps.states[:20, 0], steps.hits[:20, 0], strict=True):
        simulator.reset(state)
        simulator.step(cost_steps.DT, 0.0)
        assert len(simulator.impacts) == hits
        held = {hit.foot for hit in simulator.impacts if hit.time == simulator.time}
        assert len(held) == (2 if rests else 0) or kind in (cost_steps.PILE, cost_steps.CORNER)

"""Pages of studies show the stored numbers, and the timed code is the code that the page describes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pymunk
import pytest

from jackbox_env import Scene, make_simulator
from scripts.studies.accuracy import accuracy
from scripts.studies.benchmark import benchmark
from scripts.studies.fitting import fitting
from scripts.studies.speed import costs, measured, speed
from scripts.studies.study import as_text

DOCS = Path(__file__).parents[2] / "docs"


STUDIES = {one.STUDY.name: one.STUDY for one in (accuracy, benchmark, fitting, speed)}


def stored(name: str) -> Any:
    return STUDIES[name].read(DOCS)


@pytest.mark.parametrize("name", STUDIES)
def test_a_page_shows_the_stored_numbers(name: str) -> None:
    assert STUDIES[name].page(stored(name)) == (DOCS / f"{name}.md").read_text(), f"scripts/studies/{name}/ --render"


@pytest.mark.parametrize("name", STUDIES)
def test_a_record_is_stored_as_it_is_written(name: str) -> None:
    assert as_text(stored(name)) == (DOCS / f"{name}.json").read_text()


def test_other_numbers_would_make_another_page() -> None:
    data = stored("benchmark")
    data["policies"][0]["mean"] += 50.0
    assert STUDIES["benchmark"].page(data) != (DOCS / "benchmark.md").read_text()


# -- figures -----------------------------------------------------------------------------------------------------------


def test_costs_are_computed_within_a_round_and_noise_is_reported() -> None:
    # The machine is twice as slow in the second round, and the difference stays a tenth.
    ns = {"exact: rattle": [110.0, 220.0]} | {f"{model}: plain": [100.0, 200.0] for model in costs.MODELS}
    on_top = costs.figures({name: [1e9 / value for value in values] for name, values in ns.items()})["on_top"]
    assert on_top["task rattle, in place of juggle"] == {"exact": pytest.approx([10.0, 20.0])}
    assert costs.cell([20.0, 10.0]) == "+15"
    assert costs.cell([-1.0, 2.0]) == "below noise"


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

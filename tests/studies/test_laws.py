"""The laws of ``scripts/studies/laws/laws.py`` over scenes, starts and actions that hypothesis chooses.

Each law is broken once on purpose, and seen to be.
"""

from __future__ import annotations

import dataclasses
import math
import random
from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jackbox_env.batches.exact import ExactBatch
from jackbox_env.batches.scenes import SceneTable
from jackbox_env.batches.single import SingleBatch
from jackbox_env.simulators import CONTACT_MODELS, Impact, make_simulator
from jackbox_env.simulators.exact import ExactSimulator
from jackbox_env.simulators.pymunk import PymunkSimulator
from jackbox_env.states import clearance, deepest_held, start_tolerance
from scripts.studies.laws.laws import LAWS, examine
from scripts.studies.laws.random_cases import Case, draw_case
from tests.studies.strategies import HypothesisDraw, cases

EVERY_MODEL = pytest.mark.parametrize("contact", CONTACT_MODELS)


@EVERY_MODEL
def test_every_law_holds_in_random_scenes(contact: str) -> None:
    found = [examine(draw_case(random.Random(number), contact)) for number in range(12)]
    assert [str(one) for one in found if one.broken] == []
    assert sum(one.impacts for one in found) > 100
    measured = set().union(*(one.worst for one in found))
    assert measured >= set(LAWS) - {"refusal"} - ({"scenes"} if contact == "pymunk" else set())


@pytest.mark.slow
@EVERY_MODEL
def test_every_law_holds_in_scenes_and_under_actions_of_any_kind(contact: str) -> None:
    seen: Counter[str] = Counter()

    @given(cases(contact))
    def every_law_holds(case: Case) -> None:
        found = examine(case)
        assert not found.broken, str(found)
        seen.update(list(found.worst))
        seen.update(cases=1, impacts=found.impacts > 0, refused=bool(found.refused), rest=found.held > 0)

    every_law_holds()
    # Else nothing would be tested.
    assert seen["impacts"] >= 0.5 * seen["cases"], seen
    assert seen["refused"] <= 0.2 * seen["cases"], seen
    assert set(LAWS) <= set(seen) | {"scenes", "refusal"}, seen
    assert seen["rest"] > 0 or contact == "pymunk", seen


@EVERY_MODEL
def test_a_jack_of_any_speed_stays_in_the_box_or_is_refused(contact: str) -> None:
    seen: Counter[str] = Counter()

    @settings(max_examples=settings.default.max_examples // 2)  # type: ignore[union-attr]
    @given(st.data())
    def stays_or_is_refused(data: st.DataObject) -> None:
        draw = HypothesisDraw(data.draw)
        case = draw_case(draw, contact, steps=1)
        try:
            simulator = make_simulator(case.scene, contact, substeps=case.substeps)
        except ValueError as error:  # a scene that pymunk does not solve
            if contact != "pymunk" or "couple the feet so strongly" not in str(error):
                raise
            return
        state = np.array(case.state)
        # Up to 1e8 crossings of the box in a step, and as fast a spin.
        state[[9, 10, 11]] *= 10.0 ** draw.uniform(0.0, 9.0)
        simulator.reset(state, case.time)
        seen["cases"] += 1
        for _ in range(3):
            before, time = simulator.state, simulator.time
            try:
                simulator.step(case.control_dt, 0.0)
            except RuntimeError:
                np.testing.assert_array_equal(simulator.state, before)
                assert simulator.time == time
                seen["refused"] += 1
                return
            after = simulator.state.tolist()
            allowed = start_tolerance(after) if contact == "exact" else deepest_held(case.scene)
            assert -clearance(case.scene, after) <= allowed
            seen["impacts"] += len(simulator.impacts)

    stays_or_is_refused()
    assert seen["refused"] >= 0.1 * seen["cases"], seen
    assert seen["impacts"] >= 0.3 * seen["cases"], seen


# -- the laws themselves -----------------------------------------------------------------------------------------------


def with_impacts(contact: str, **fields: Any) -> Case:
    """A case of held torques and 10 impacts or more in a scene without losses or drive."""
    for seed in range(100):
        case = draw_case(random.Random(seed), contact)
        scene = dataclasses.replace(case.scene, drive=None, restitution=1.0, **fields)
        case = dataclasses.replace(case, scene=scene, actions=(0.5,) * len(case.actions))
        found = examine(case)
        if found.impacts >= 10 and not found.refused:
            assert not found.broken
            return case
    raise AssertionError("no case with impacts")


def disturbed(step: Callable[..., None], place: int, amount: float, at: int) -> Callable[..., None]:
    """A simulator's step that adds to one number of the state in the ``at``-th call of each simulator."""
    calls: Counter[int] = Counter()

    def wrapped(self: Any, dt: float, torque: float | None = None) -> None:
        step(self, dt, torque)
        calls[id(self)] += 1
        if calls[id(self)] == at:
            state = self.state
            state[place] += amount * (1.0 + abs(state[place]))
            kept = state if isinstance(self, ExactSimulator) else state.tolist()
            self._present = self._present._replace(state=kept)

    return wrapped


@EVERY_MODEL
@pytest.mark.parametrize(
    ("law", "place", "amount"),
    [
        ("containment", 3, 30.0),
        ("momentum", 6, 1e-9),
        ("momentum", 10, 1e-8),
        ("centre", 1, 1e-9),
        ("energy", 8, 1e-8),
        ("energy", 11, 1e-6),
        ("restore", 5, 1e-13),
        ("energy at impacts with loss", 11, 0.5),
    ],
)
def test_a_disturbance_of_one_step_breaks_its_law(
    law: str, place: int, amount: float, contact: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    case = with_impacts(contact)
    if "loss" in law:
        case = dataclasses.replace(case, scene=case.scene.changed(restitution=0.5))
        assert not examine(case).broken
    simulator = ExactSimulator if contact == "exact" else PymunkSimulator
    monkeypatch.setattr(simulator, "step", disturbed(simulator.step, place, amount, at=5))
    assert law.split()[0] in examine(dataclasses.replace(case, restored_at=2)).broken


@EVERY_MODEL
def test_impacts_out_of_order_and_exceptions_break_their_laws(contact: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def early(self: Any) -> list[Impact]:
        return [hit._replace(time=-1e3) for hit in self._present.impacts]

    def fails(self: Any, dt: float, torque: float | None = None) -> None:
        raise RuntimeError("nobody knows why")

    case = with_impacts(contact)
    simulator = ExactSimulator if contact == "exact" else PymunkSimulator
    with monkeypatch.context() as patch:
        patch.setattr(simulator, "impacts", property(early))
        assert examine(case).broken == ["record"]
    monkeypatch.setattr(simulator, "step", fails)
    found = examine(case)
    assert found.broken == ["refusal"]
    assert "nobody knows why" in str(found)


@EVERY_MODEL
def test_a_batch_that_differs_by_a_bit_breaks_its_law(contact: str, monkeypatch: pytest.MonkeyPatch) -> None:
    batch: Any = ExactBatch if contact == "exact" else SingleBatch
    step = batch.step

    def wrapped(self: Any, actions: Any) -> Any:
        outcome = step(self, actions)
        outcome.rewards[2] = np.nextafter(outcome.rewards[2], math.inf)
        return outcome

    case = with_impacts(contact)
    monkeypatch.setattr(batch, "step", wrapped)
    assert examine(case).broken == ["batch"]


def test_environments_that_all_get_the_scene_of_the_first_break_the_law_of_scenes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made = SceneTable.__init__

    def wrapped(self: Any, own: Any, *settings: Any) -> None:
        made(self, [own[0]] * len(own), *settings)

    case = with_impacts("exact")
    case = dataclasses.replace(case, neighbours=(case.scene.changed(jack_mass=2.0 * case.scene.jack_mass),))
    assert examine(case).broken == []
    monkeypatch.setattr(SceneTable, "__init__", wrapped)
    assert examine(case).broken == ["scenes"]

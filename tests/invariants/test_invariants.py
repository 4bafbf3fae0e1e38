"""The invariants of ``invariants.py`` over scenes, starts and actions that hypothesis chooses.

Each is broken once on purpose, and its assertion fails.
"""

from __future__ import annotations

import dataclasses
import itertools
import random
from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jackbox_env.model.scene import Scene
from jackbox_env.simulators import CONTACT_MODELS
from jackbox_env.simulators.exact import ExactSimulator
from jackbox_env.simulators.pymunk import PymunkSimulator
from tests.invariants.cases import Case, HypothesisDraw, draw_case
from tests.invariants.invariants import assert_contained, examine, simulator_of, stepped

Cases = Callable[[int], int]
EVERY_MODEL = pytest.mark.parametrize("contact", CONTACT_MODELS)
pytestmark = pytest.mark.timeout(0 if settings.default.max_examples > 1000 else 300)  # type: ignore[union-attr]


@EVERY_MODEL
def test_every_invariant_holds_in_scenes_and_under_actions_of_any_kind(contact: str, cases: Cases) -> None:
    seen: Counter[str] = Counter()

    @settings(max_examples=cases(settings.default.max_examples))  # type: ignore[union-attr]
    @given(st.data())
    def every_invariant_holds(data: st.DataObject) -> None:
        counts = examine(draw_case(HypothesisDraw(data.draw), contact))
        seen.update({name: min(1, number) for name, number in counts.items()})

    every_invariant_holds()
    # Else nothing would be tested.
    assert seen["impacts"] >= 0.5 * seen["cases"], seen
    assert seen["refused"] <= 0.2 * seen["cases"], seen
    assert seen["held"] > 0 or contact == "pymunk", seen


@EVERY_MODEL
def test_a_jack_of_any_speed_stays_in_the_box_or_is_refused(contact: str, cases: Cases) -> None:
    seen: Counter[str] = Counter()

    @settings(max_examples=cases(settings.default.max_examples))  # type: ignore[union-attr]
    @given(st.data())
    def stays_or_is_refused(data: st.DataObject) -> None:
        draw = HypothesisDraw(data.draw)
        case = draw_case(draw, contact, steps=1)
        state = np.array(case.state)
        # Up to 1e8 crossings of the box in a step, and as fast a spin. With loss the box is then carried so far that
        # float64 leaves a hundred ulp of its position, see docs/trust.md: up to 1e3.
        fastest = 9.0 if contact == "pymunk" or case.scene.elastic else 4.0
        state[[9, 10, 11]] *= 10.0 ** draw.choice((draw.uniform(0.0, fastest), fastest))
        simulator = simulator_of(dataclasses.replace(case, state=tuple(state.tolist())))
        if simulator is None:
            return
        seen["cases"] += 1
        for _ in range(3):
            if not stepped(simulator, case.control_dt, 0.0):
                seen["refused"] += 1
                return
            assert_contained(case, simulator)

    stays_or_is_refused()
    # Hypothesis also draws constants of the modules that happen to be loaded, so few cases may have no refusal.
    assert seen["refused"] >= 0.02 * seen["cases"] - 1.0, seen
    assert examine(Case(Scene(), contact, None, 0.02, (*[0.0] * 9, 100.0, 0.0, 0.0), 0.0, (0.0,) * 3))["impacts"] > 0


# -- broken on purpose -------------------------------------------------------------------------------------------------


def with_impacts(contact: str, **fields: Any) -> Case:
    """A case of held torques and 10 impacts or more in a scene without drive."""
    for seed in range(100):
        case = draw_case(random.Random(seed), contact, steps=40)
        scene = case.scene.changed(drive=None, **fields)
        case = dataclasses.replace(case, scene=scene, actions=(0.5,) * len(case.actions))
        counts = examine(case)
        if counts["impacts"] >= 10 and not counts["refused"]:
            return case
    raise AssertionError("no case with impacts")


@EVERY_MODEL
@pytest.mark.parametrize(
    ("name", "column", "amount", "restitution"),
    [
        ("containment", 3, 30.0, 1.0),
        ("momentum", 6, 1e-9, 1.0),
        ("momentum", 10, 1e-8, 1.0),
        ("centre", 0, 1e-9, 1.0),
        ("energy", 8, 1e-8, 1.0),
        ("energy", 11, 1e-6, 1.0),
        ("energy", 11, 0.5, 0.5),
        ("restore", 5, 1e-13, 1.0),
    ],
)
def test_a_disturbance_of_one_step_breaks_its_invariant(
    name: str, column: int, amount: float, restitution: float, contact: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    case, calls = with_impacts(contact, restitution=restitution), itertools.count()
    simulator: Any = ExactSimulator if contact == "exact" else PymunkSimulator
    step = simulator.step

    def disturbed(self: Any, dt: float, torque: float | None = None) -> None:
        step(self, dt, torque)
        if next(calls) == 8:  # the fifth step; every other call is the twin's
            state = self.state
            state[column] += amount * (1.0 + abs(state[column]))
            stored = state if contact == "exact" else state.tolist()
            self._present = self._present._replace(state=stored)

    monkeypatch.setattr(simulator, "step", disturbed)
    with pytest.raises(AssertionError, match=name):
        examine(case)


@EVERY_MODEL
def test_impacts_out_of_order_are_seen(contact: str, monkeypatch: pytest.MonkeyPatch) -> None:
    case, simulator = with_impacts(contact), ExactSimulator if contact == "exact" else PymunkSimulator
    early = property(lambda self: [hit._replace(time=-1e3) for hit in self._present.impacts])
    monkeypatch.setattr(simulator, "impacts", early)
    with pytest.raises(AssertionError, match="record"):
        examine(case)


def test_contacts_remembered_by_the_engine_are_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(PymunkSimulator, "_forget_contacts", lambda self: [0.0] * 6)
    with pytest.raises(AssertionError, match="restore"):
        examine(draw_case(random.Random(0), "pymunk", steps=40))

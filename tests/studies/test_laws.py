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
from hypothesis import event, given, settings
from hypothesis import strategies as st

from jackbox_env.scene import Drive
from jackbox_env.simulators import CONTACT_MODELS, make_simulator
from jackbox_env.simulators.exact import ExactSimulator
from jackbox_env.simulators.pymunk import PymunkSimulator
from jackbox_env.states import clearance, deepest_held, start_tolerance
from scripts.studies.laws.laws import LAWS, Tally, examine
from scripts.studies.laws.random_cases import Case, Wave, draw_case
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
        seen["cases"] += 1
        seen["with impacts"] += found.impacts > 0
        seen["refused"] += bool(found.refused)
        seen["at rest"] += found.held > 0
        seen["balanced"] += "energy" in found.worst
        seen["beside others"] += "batch" in found.worst
        seen["beside other scenes"] += "scenes" in found.worst
        for kind in kinds(case):
            seen[kind] += found.impacts > 0 and not found.refused
        event("impacts" if found.impacts else "no impact")
        assert not found.broken, str(found)

    every_law_holds()
    # Else nothing would be tested.
    assert seen["with impacts"] >= 0.5 * seen["cases"], seen
    assert seen["balanced"] >= 0.3 * seen["cases"], seen
    assert seen["beside others"] >= 0.8 * seen["cases"], seen
    assert seen["refused"] <= 0.2 * seen["cases"], seen
    wanted = {"chirp", "chirp of rate 0", "falling chirp", "side forces", "no drive", "weightless", "heavy", "long arm"}
    wanted |= {"short arm", "limit", "drive", "zero torque", "lossy"}
    wanted |= {"at rest", "beside other scenes"} if contact == "exact" else set()
    assert wanted <= {kind for kind, count in seen.items() if count}, seen


def kinds(case: Case) -> list[str]:
    """What a case is an example of."""
    scene, drive = case.scene, case.scene.drive
    chirp = drive is not None and not isinstance(drive, Drive)
    found = {
        "chirp": chirp,
        "chirp of rate 0": chirp and drive.rate == 0.0,  # type: ignore[union-attr]
        "falling chirp": chirp and drive.rate < 0.0,  # type: ignore[union-attr]
        "side forces": isinstance(drive, Drive) and drive.force_bound > 0.0,
        "no drive": drive is None,
        "weightless": scene.gravity == 0.0,
        "heavy": scene.gravity > 20.0,
        "long arm": scene.jack_arm > scene.box_half_width,
        "short arm": scene.jack_arm < 0.4 * scene.box_half_width,
        "lossy": scene.restitution < 1.0,
        "limit": 1.0 in case.actions or -1.0 in case.actions,
        "drive": None in case.actions,
        "zero torque": 0.0 in case.actions,
    }
    return [name for name, is_one in found.items() if is_one]


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
    assert seen["impacts"] >= seen["cases"], seen


# -- the laws themselves -----------------------------------------------------------------------------------------------


@given(st.floats(-3.0, 3.0), st.floats(0.01, 3.0), st.floats(-3.0, 3.0), st.floats(-50.0, 50.0), st.floats(0.0, 9.0))
def test_a_waves_integrals_are_those_of_its_quadrature(
    mean: float, rate: float, phase: float, start: float, since: float
) -> None:
    wave = Wave(mean, 2.0, rate, phase)
    nodes, weights = np.polynomial.legendre.leggauss(40)
    times = 0.5 * since * (nodes + 1.0)
    values = 0.5 * since * weights * [wave(start + time) for time in times.tolist()]
    once, twice = wave.integrals(start, since)
    assert once == pytest.approx(values.sum(), abs=1e-10)
    assert twice == pytest.approx((values * (since - times)).sum(), abs=1e-9)


def test_cases_follow_from_their_seed() -> None:
    for contact in CONTACT_MODELS:
        one, other = (draw_case(random.Random(5), contact) for _ in range(2))
        assert one == other
        assert one != draw_case(random.Random(6), contact)


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
    ],
)
def test_a_disturbance_of_one_step_breaks_its_law(
    law: str, place: int, amount: float, contact: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    case = with_impacts(contact)
    simulator = ExactSimulator if contact == "exact" else PymunkSimulator
    monkeypatch.setattr(simulator, "step", disturbed(simulator.step, place, amount, at=5))
    assert law in examine(dataclasses.replace(case, restored_at=2)).broken


@EVERY_MODEL
def test_impacts_out_of_order_and_exceptions_break_their_laws(contact: str, monkeypatch: pytest.MonkeyPatch) -> None:
    case = with_impacts(contact)
    simulator = ExactSimulator if contact == "exact" else PymunkSimulator
    with monkeypatch.context() as patch:
        patch.setattr(
            simulator, "impacts", property(lambda self: [hit._replace(time=-1e3) for hit in self._present.impacts])
        )
        assert examine(case).broken == ["record"]

    def fails(self: Any, dt: float, torque: float | None = None) -> None:
        raise RuntimeError("nobody knows why")

    with monkeypatch.context() as patch:
        patch.setattr(simulator, "step", fails)
        found = examine(case)
        assert found.broken == ["refusal"]
        assert "RuntimeError: nobody knows why" in str(found)


@EVERY_MODEL
def test_a_gain_at_an_impact_with_losses_breaks_the_law_of_energy(
    contact: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    case = with_impacts(contact)
    lossy = dataclasses.replace(case, scene=dataclasses.replace(case.scene, restitution=0.5))
    assert not examine(lossy).broken
    simulator = ExactSimulator if contact == "exact" else PymunkSimulator
    monkeypatch.setattr(simulator, "step", disturbed(simulator.step, 11, 0.5, at=5))
    assert "energy" in examine(lossy).broken


def test_with_loss_some_jacks_lie_at_first_and_steps_at_rest_are_counted() -> None:
    drawn = [draw_case(random.Random(number), "exact", steps=5) for number in range(60)]
    lossy = [case for case in drawn if not case.scene.elastic]
    lying = [case for case in lossy if abs(clearance(case.scene, list(case.state))) < 1e-13 * (100.0 + case.state[3])]
    assert 5 < len(lying) < len(lossy) - 5
    still = next(case for case in lying if case.state[2] == 0.0 and case.scene.gravity > 0.0)
    scene = dataclasses.replace(still.scene, drive=None)
    still = dataclasses.replace(still, scene=scene, actions=(0.0,) * 5)
    found, tally = examine(still), Tally()
    assert (found.held, found.broken) == (5, [])
    for number, one in enumerate((found, examine(still))):
        tally.enter(number, one)
    assert str(tally).startswith("2 cases, ")
    assert " impacts, rest in 2 cases, for 10 steps" in str(tally)
    for other in (with_impacts("exact"), dataclasses.replace(still, contact="pymunk", substeps=4)):
        assert examine(other).held == 0


@EVERY_MODEL
def test_a_batch_that_differs_by_a_bit_breaks_its_law(contact: str, monkeypatch: pytest.MonkeyPatch) -> None:
    from jackbox_env.batches.exact import ExactBatch
    from jackbox_env.batches.single import SingleBatch

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
    from jackbox_env.batches.scenes import SceneTable

    made = SceneTable.__init__

    def wrapped(self: Any, own: Any, *settings: Any) -> None:
        made(self, [own[0]] * len(own), *settings)

    case = with_neighbour(with_impacts("exact"))
    assert examine(case).broken == []
    monkeypatch.setattr(SceneTable, "__init__", wrapped)
    assert examine(case).broken == ["scenes"]


def with_neighbour(case: Case) -> Case:
    """The same case beside a scene of another jack."""
    return dataclasses.replace(case, neighbours=(case.scene.changed(jack_mass=2.0 * case.scene.jack_mass),))


def test_some_cases_of_the_exact_model_have_neighbours_in_as_many_other_scenes() -> None:
    drawn = [draw_case(random.Random(number), "exact", steps=2) for number in range(200)]
    counts = Counter(len(case.neighbours) for case in drawn)
    assert set(counts) == {0, 1, 2, 3}
    assert 0.15 < 1.0 - counts[0] / 200 < 0.35
    assert all(len({case.scene, *case.neighbours}) == 1 + len(case.neighbours) for case in drawn)
    assert not any(draw_case(random.Random(number), "pymunk", steps=2).neighbours for number in range(50))


def test_a_case_measures_every_law_but_what_was_never_refused() -> None:
    case = dataclasses.replace(with_impacts("exact"), neighbours=())
    assert set(examine(case).worst) == set(LAWS) - {"refusal", "scenes"}
    assert set(examine(with_neighbour(case)).worst) == set(LAWS) - {"refusal"}

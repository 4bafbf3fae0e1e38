"""The exact model against 60 digits, the simultaneous law, sliding and grazing feet, limits."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from jackbox_env.exact import contact
from jackbox_env.mechanics import simultaneous_impact_map
from jackbox_env.model.scene import Chirp, Scene
from jackbox_env.simulators import Impact
from tests.guarantees.poses import velocity_error
from tests.simulators.exact_runs import plain_step, simulator
from tests.states import WEIGHTLESS, Array, load, several_contacts

RECORDS = [*load("exact_trajectories"), *load("loss_trajectories"), *load("seed_scene")]


# -- against the 60-digit reference ------------------------------------------------------------------------------------


@pytest.mark.parametrize("record", RECORDS, ids=lambda record: record["name"])
def test_impacts_and_states_equal_the_60_digit_reference(record: dict[str, Any]) -> None:
    drive = Chirp() if record["drive"] == "chirp" else None
    scene = Scene(gravity=record["gravity"], restitution=record.get("restitution", 1.0), drive=drive)
    run, hits, states = simulator(scene, record["q"] + record["qdot"]), list[Impact](), list[Array]()
    for number in range(round(record["T"] / 0.02)):
        run.step(0.02, 90000.0 * record["actions"][number] if record["drive"] == "held" else None)
        hits += run.impacts
        states.append(run.state)
    expected = record["impacts"][:14]  # beyond, rounding decides
    assert len(hits) == len(expected) or len(expected) == 14
    assert [(hit.wall, hit.foot) for hit in hits[:14]] == [(hit["wall"], hit["foot"]) for hit in expected]
    for hit, reference in list(zip(hits, expected, strict=False))[:5]:
        assert hit.time == pytest.approx(reference["time"], abs=1e-10, rel=0.0)
        assert hit.impulse == pytest.approx(reference["impulse"], rel=1e-8)
    checked = 0
    for state, reference in zip(states[4::5], record["states"], strict=True):  # every 0.1 s
        before = sum(hit["time"] < reference["time"] for hit in record["impacts"])
        if before <= 5:
            np.testing.assert_allclose(state, reference["state"], rtol=0.0, atol=1e-12 if before == 0 else 1e-8)
            checked += 1
    assert checked > 9


# -- the law of impact -------------------------------------------------------------------------------------------------


def test_one_contact_after_the_other_would_break_the_simultaneous_law(monkeypatch: pytest.MonkeyPatch) -> None:
    # Resolved one by one, two feet on a floor give another, also energy-keeping, answer.
    def one_by_one(n: Any, w: Any, count: int) -> None:
        for number in range(count):
            w.contacts.impulses[number] = contact.bounce(n, w.state, w.contacts.gradients[number])

    rng = np.random.default_rng(2)
    state, contacts = several_contacts(WEIGHTLESS, rng, "one wall")
    expected, _ = simultaneous_impact_map(WEIGHTLESS, state, contacts)
    assert velocity_error(WEIGHTLESS, plain_step(WEIGHTLESS, state, 1e-13, 0.0)[1][6:], expected[6:]) < 1e-9
    monkeypatch.setattr(contact, "bounce_together", one_by_one)
    assert velocity_error(WEIGHTLESS, plain_step(WEIGHTLESS, state, 1e-13, 0.0)[1][6:], expected[6:]) > 0.01


# -- resting, grazing, touching ----------------------------------------------------------------------------------------

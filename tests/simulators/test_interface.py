"""The interface of every contact model: restored states, returned copies, drives that fail."""

from __future__ import annotations

import copy
import math
import pickle
from typing import Any

import numpy as np
import pytest

from jackbox_env import simulators
from jackbox_env.exact.workspace import Call
from jackbox_env.scene import Drive, Scene
from jackbox_env.simulators import CONTACT_MODELS, make_simulator
from jackbox_env.simulators.exact import ExactSimulator
from tests.states import inside

EVERY_MODEL = pytest.mark.parametrize("contact", CONTACT_MODELS)


@EVERY_MODEL
@pytest.mark.parametrize("restitution", [0.5, 1.0])
def test_state_and_time_determine_the_future_also_pickled_and_copied(contact: str, restitution: float) -> None:
    rng = np.random.default_rng(7)
    run = make_simulator(Scene(jack_arm=5.0, restitution=restitution), contact)
    run.reset(inside(run.scene, rng))
    impacts = 0
    for _ in range(200):
        restored = make_simulator(run.scene, contact)
        restored.reset(run.state, run.time)
        twins = [restored, copy.deepcopy(run), pickle.loads(pickle.dumps(run))]
        torque = rng.uniform(-5e4, 5e4) if rng.uniform() < 0.7 else None
        for one in [run, *twins]:
            one.step(0.02, torque)
        for twin in twins:
            np.testing.assert_array_equal(twin.state, run.state)
            assert (twin.time, twin.impacts, twin.torque) == (run.time, run.impacts, run.torque)
        impacts += len(run.impacts)
    assert impacts > 10


@EVERY_MODEL
def test_returned_values_are_never_written_again(contact: str) -> None:
    simulator = make_simulator(Scene(jack_arm=5.0), contact)
    handed_out = []
    for _ in range(100):
        simulator.step(0.02)
        state, impacts = simulator.state, simulator.impacts
        handed_out.append((state, state.copy(), impacts, list(impacts)))
    assert any(impacts for _, _, impacts, _ in handed_out)
    for state, copied, impacts, listed in handed_out:
        np.testing.assert_array_equal(state, copied)
        assert impacts == listed
    simulator.state[:] = 0.0
    assert simulator.state.any()


@EVERY_MODEL
def test_a_drive_that_fails_or_answers_nonsense_leaves_the_simulator_usable(contact: str) -> None:
    answers: list[Any] = [math.nan]
    simulator = make_simulator(Scene(drive=Drive(torque=lambda t: answers[0])), contact)
    for nonsense in (math.nan, math.inf, "much"):
        answers[0] = nonsense
        with pytest.raises((TypeError, ValueError), match=r"torque\(.* s\) must be a finite number"):
            simulator.step(0.02)
    answers[0] = 5.0
    simulator.step(0.02)
    assert simulator.torque == pytest.approx(5.0, rel=1e-15)
    assert simulator.time == 0.02


class Soft(ExactSimulator):
    """A contact model with an additional setting."""

    name = "soft"
    settings = ("softness",)

    def __init__(self, scene: Scene, softness: float = 0.0) -> None:
        super().__init__(scene)
        self.softness = softness


def test_a_model_declares_its_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(simulators, "CONTACT_MODELS", {**CONTACT_MODELS, "soft": f"{__name__}.Soft"})
    soft: Any = make_simulator(None, "soft", softness=0.5)
    assert (soft.softness, pickle.loads(pickle.dumps(soft)).softness) == (0.5, 0.5)
    soft = make_simulator(None, "soft", softness=None, substeps=None)
    assert soft.softness == 0.0
    with pytest.raises(ValueError, match="^contact='exact' has no softness, got softness=0.5$"):
        make_simulator(None, "exact", softness=0.5)
    with pytest.raises(ValueError, match="accepts only 'substeps', 'iterations', 'softness', got 'sofness' "):
        make_simulator(None, "soft", sofness=0.5)


def test_an_interruption_while_the_log_grows_leaves_the_simulator_as_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    run, twin = (ExactSimulator(Scene()) for _ in range(2))
    run.step(0.02, 0.0)
    wild, calm = (np.array([0.0] * 9 + [speed, 0.7 * speed, 0.02 * speed]) for speed in (3e4, 3e2))
    run.reset(wild)

    def interrupt(*_: Any) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Call, "prepare", interrupt)
        with pytest.raises(KeyboardInterrupt):
            run.step(0.02, 0.0)
    for one in (run, twin):
        one.reset(calm)
    impacts = 0
    for _ in range(4):
        for one in (run, twin):
            one.step(0.02, 0.0)
        assert run.impacts == twin.impacts
        impacts += len(run.impacts)
    assert impacts > 1


def test_arguments_of_steps_are_never_replaced_under_another_thread() -> None:
    run = ExactSimulator(Scene())
    run.step(0.02, 0.0)
    first = run._calls[0]
    packed = first._packed.copy()
    run.step(0.03, None)
    np.testing.assert_array_equal(first._packed.view(np.int64), packed.view(np.int64))

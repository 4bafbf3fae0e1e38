"""The interface of every contact model: restored states, returned copies, drives that fail."""

from __future__ import annotations

import copy
import pickle
from typing import Any

import numpy as np
import pytest

from jackbox_env import simulators
from jackbox_env.model.scene import Scene
from jackbox_env.simulators import CONTACT_MODELS, Simulator, StepResult, make_simulator

EVERY_MODEL = pytest.mark.parametrize("contact", CONTACT_MODELS)


@EVERY_MODEL
def test_a_step_returns_what_the_simulator_then_has_and_never_writes_it_again(contact: str) -> None:
    simulator, handed_out = make_simulator(Scene(jack_arm=5.0), contact), list[Any]()
    for number in range(50):
        state, time, torque, impacts = simulator.step(0.02, 1e3 * number if number % 2 else None)
        assert (time, torque, list(impacts)) == (simulator.time, simulator.torque, simulator.impacts)
        handed_out.append((state, simulator.state, simulator.impacts, copy.deepcopy((simulator.state, impacts))))
        simulator.state[:] = 0.0
    assert any(impacts for *_, impacts, _ in handed_out)
    for state, then, listed, (copied, impacts) in handed_out:
        np.testing.assert_array_equal([state, then], [copied] * 2)
        assert listed == list(impacts)


class Still(Simulator):
    """A contact model of a user with a setting: nothing moves, and every third step returns no result."""

    name, room, settings = "still", 100, ("softness",)

    def __init__(self, scene: Scene, softness: float = 0.0) -> None:
        super().__init__(scene)
        self.softness = softness

    def stepped(self, dt: float, torque: float | None) -> StepResult:
        if round(self.time / dt) == 2:
            return None  # type: ignore[return-value]
        return StepResult(self.state, self.time + dt, torque or 0.0)


def test_a_model_of_a_user_declares_its_settings_and_returns_its_result_or_stays(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(simulators, "CONTACT_MODELS", {**CONTACT_MODELS, "still": f"{__name__}.Still"})
    still: Any = make_simulator(None, "still", softness=0.5)
    assert (still.softness, pickle.loads(pickle.dumps(still)).softness) == (0.5, 0.5)
    still = make_simulator(None, "still", softness=None, substeps=None)
    assert still.softness == 0.0
    with pytest.raises(ValueError, match="^contact='exact' has no softness, got softness=0.5$"):
        make_simulator(None, "exact", softness=0.5)
    with pytest.raises(ValueError, match="accepts only 'substeps', 'iterations', 'softness', got 'sofness' "):
        make_simulator(None, "still", sofness=0.5)
    assert [still.step(0.5, 3.0)[1:] for _ in range(2)] == [(0.5, 3.0, ()), (1.0, 3.0, ())]
    with pytest.raises(TypeError, match="^Still.stepped must return a StepResult, got None$"):
        still.step(0.5, 4.0)
    assert (still.time, still.torque) == (1.0, 3.0)
    assert still.step(0.1).time == 1.1  # the error has left it usable

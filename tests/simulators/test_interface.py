"""The interface of every contact model: restored states, returned copies, drives that fail."""

from __future__ import annotations

import copy
import math
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from jackbox_env import simulators
from jackbox_env.exact.workspace import Call
from jackbox_env.model.scene import Scene
from jackbox_env.simulators import CONTACT_MODELS, Simulator, StepResult, make_simulator
from jackbox_env.simulators.exact import ExactSimulator
from jackbox_env.simulators.pymunk import PymunkSimulator

EVERY_MODEL = pytest.mark.parametrize("contact", CONTACT_MODELS)


SETTINGS: list[dict[str, Any]] = [
    {"contact": "exact"}, {"contact": "pymunk", "substeps": 1}, {"contact": "pymunk", "substeps": 4},
]  # fmt: skip
RESTORED = [
    Scene(),
    Scene(jack_arm=5.5),
    Scene(jack_arm=6.5),
    Scene(jack_arm=5.9, jack_inertia=4.0),
    Scene(jack_arm=2.0, restitution=0.3),
]


def restores(scene: Scene, settings: dict[str, Any], steps: int, seed: int) -> tuple[int, int]:
    """Redo each step of a random run from (state, time) and in copies. Return misses and steps with impacts."""
    rng, start = np.random.default_rng(seed), np.zeros(12)
    start[5] = math.pi / 4.0
    start[6:] = rng.standard_normal(6) * (2.0, 2.0, 0.5, 8.0, 8.0, 3.0)
    run, restored = (make_simulator(scene, **settings) for _ in range(2))
    run.reset(start)
    misses = impacts = 0
    for number in range(steps):
        torque = None if number % 7 == 0 else rng.uniform(-0.5, 0.5) * scene.torque_limit
        copied = number % 10 == 0 or bool(restored.impacts)
        twins = [make_simulator(scene, **settings) if copied else restored]
        twins[0].reset(run.state, run.time)
        twins += [copy.deepcopy(run), pickle.loads(pickle.dumps(run))] if copied else []
        for one in [run, *twins]:
            one.step(0.02, torque)
        for twin in twins:
            same = (twin.time, twin.torque, twin.impacts) == (run.time, run.torque, run.impacts)
            misses += not (same and np.array_equal(twin.state, run.state))
        restored = twins[0]
        impacts += bool(run.impacts)
    return misses, impacts


@pytest.mark.parametrize("scene", RESTORED, ids=lambda scene: f"arm {scene.jack_arm:g} e {scene.restitution:g}")
def test_the_future_follows_from_state_and_time_bitwise(scene: Scene, cases: Callable[[int], int]) -> None:
    results = [restores(scene, settings, 500, seed) for settings in SETTINGS for seed in range(cases(4))]
    assert sum(misses for misses, _ in results) == 0
    assert sum(impacts for _, impacts in results) > cases(50)


def test_contacts_remembered_by_the_engine_would_change_the_future(
    monkeypatch: pytest.MonkeyPatch, cases: Callable[[int], int]
) -> None:
    monkeypatch.setattr(PymunkSimulator, "_forget_contacts", lambda self: [0.0] * 6)
    results = [restores(scene, settings, cases(1000), 0) for settings in SETTINGS[1:] for scene in RESTORED]
    assert sum(misses for misses, _ in results) > 0


@EVERY_MODEL
def test_returned_values_are_never_written_again(contact: str) -> None:
    simulator = make_simulator(Scene(jack_arm=5.0), contact)
    handed_out = []
    for _ in range(100):
        returned = simulator.step(0.02).state
        state, impacts = simulator.state, simulator.impacts
        handed_out += [(returned, returned.copy(), impacts, impacts), (state, state.copy(), impacts, list(impacts))]
    assert any(impacts for _, _, impacts, _ in handed_out)
    for state, copied, impacts, listed in handed_out:
        np.testing.assert_array_equal(state, copied)
        assert impacts == listed
    simulator.state[:] = 0.0
    simulator.step(0.02).state[:] = 0.0
    assert simulator.state.any()


@EVERY_MODEL
def test_a_step_returns_what_the_simulator_then_has(contact: str) -> None:
    simulator, struck = make_simulator(Scene(jack_arm=5.0), contact), 0
    for number in range(50):
        state, time, torque, impacts = simulator.step(0.02, 1e3 * number if number % 2 else None)
        assert (time, torque, list(impacts)) == (simulator.time, simulator.torque, simulator.impacts)
        np.testing.assert_array_equal(state, simulator.state)
        assert isinstance(state, np.ndarray)
        struck += len(impacts)
    assert struck


class Still(Simulator):
    """A contact model of a user: nothing moves, and every third step returns no result."""

    name, room = "still", 100

    def stepped(self, dt: float, torque: float | None) -> StepResult:
        if round(self.time / dt) == 2:
            return None  # type: ignore[return-value]
        return StepResult(self.state, self.time + dt, torque or 0.0)


def test_a_model_of_a_user_returns_its_result_or_stays_as_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(simulators, "CONTACT_MODELS", {**CONTACT_MODELS, "still": f"{__name__}.Still"})
    still = make_simulator(None, "still")
    assert [still.step(0.5, 3.0)[1:] for _ in range(2)] == [(0.5, 3.0, ()), (1.0, 3.0, ())]
    with pytest.raises(TypeError, match="^Still.stepped must return a StepResult, got None$"):
        still.step(0.5, 4.0)
    assert (still.time, still.torque) == (1.0, 3.0)
    with pytest.raises(ValueError, match="^dt must"):
        still.step(-1.0)
    assert still.step(0.1).time == 1.1  # the error has left it usable


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
    for one in (run, twin):
        one.reset([0.0] * 9 + [3e4, 2e4, 6e2])

    def interrupt(*_: Any) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Call, "prepare", interrupt)
        with pytest.raises(KeyboardInterrupt):
            run.step(0.02, 0.0)
    for one in (run, twin):
        one.step(0.02, 0.0)
    np.testing.assert_array_equal(run.state, twin.state)
    assert run.impacts == twin.impacts != []

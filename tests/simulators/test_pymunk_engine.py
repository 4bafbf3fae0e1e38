"""The engine of the pymunk model: faults that its set-up prevents, from cached contacts to swallowed errors."""

from __future__ import annotations

import contextlib
import copy
import math
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from jackbox_env.mechanics import simultaneous_impact_map
from jackbox_env.scene import Scene
from jackbox_env.simulators import contacts
from jackbox_env.simulators.pymunk import PymunkSimulator
from tests.simulators.engine import impact_in_an_instant, relative_error

Cases = Callable[[int], int]

# -- restoring ---------------------------------------------------------------------------------------------------------


RESTORE_SCENES = [
    Scene(),
    Scene(jack_arm=5.5),
    Scene(jack_arm=6.5),
    Scene(jack_arm=5.9, jack_inertia=4.0),
    Scene(jack_arm=2.0, restitution=0.3),
]


def restores(scene: Scene, substeps: int, steps: int, seed: int) -> tuple[int, int]:
    """Follow a random run; at each step redo it from (state, time) in a fresh simulator. Return misses and impacts."""
    rng = np.random.default_rng(seed)
    start = np.zeros(12)
    start[5] = math.pi / 4.0
    start[6:] = rng.standard_normal(6) * (2.0, 2.0, 0.5, 8.0, 8.0, 3.0)
    run = PymunkSimulator(scene, substeps=substeps)
    run.reset(start)
    fresh = PymunkSimulator(scene, substeps=substeps)
    pristine = pickle.dumps(fresh)
    misses = impacts = 0
    for _ in range(steps):
        torque = rng.uniform(-1.0, 1.0) * 0.5 * scene.torque_limit
        state, time = run.state, run.time
        run.step(0.02, torque)
        if rng.uniform() < 0.1 or fresh.impacts:  # else the last one, already used
            fresh = pickle.loads(pristine)
        fresh.reset(state, time)
        np.testing.assert_array_equal(fresh.state, state)
        fresh.step(0.02, torque)
        misses += not (np.array_equal(run.state, fresh.state) and run.impacts == fresh.impacts)
        impacts += bool(run.impacts)
    return misses, impacts


@pytest.mark.parametrize("scene", RESTORE_SCENES, ids=lambda scene: f"arm {scene.jack_arm:g} e {scene.restitution:g}")
def test_the_future_follows_from_state_and_time_bitwise(scene: Scene, cases: Cases) -> None:
    results = [restores(scene, substeps, 1000, seed) for substeps in (1, 4) for seed in range(cases(4))]
    assert sum(misses for misses, _ in results) == 0
    assert sum(impacts for _, impacts in results) > cases(100)


def test_contacts_remembered_by_the_engine_would_change_the_future(
    monkeypatch: pytest.MonkeyPatch, cases: Cases
) -> None:
    monkeypatch.setattr(PymunkSimulator, "_forget_contacts", lambda self: [0.0] * 6)
    results = [restores(scene, substeps, cases(1000), 0) for substeps in (1, 4) for scene in RESTORE_SCENES]
    assert sum(misses for misses, _ in results) > 0


# -- extremes and refusals ---------------------------------------------------------------------------------------------


def test_feet_do_not_sweep_through_walls_between_substeps() -> None:
    # A quarter turn per substep of 5 ms brings the next foot to where the last one was: at substep ends all are inside.
    start = np.zeros(12)
    start[[3, 5, 11]] = 2.0, math.pi / 4.0, math.pi / 2.0 / 0.005
    simulator = PymunkSimulator(Scene(gravity=0.0, drive=None, jack_arm=5.0))
    simulator.reset(start)
    simulator.step(0.02)
    assert simulator.impacts
    assert len({hit.time for hit in simulator.impacts}) > 4 or simulator.impacts[0].time < 0.005


@pytest.mark.parametrize("arm", [6.005, 6.01, 6.03])
def test_a_jack_wedged_between_three_walls_gets_the_iterations_it_needs(arm: float) -> None:
    scene = Scene(gravity=0.0, drive=None, jack_arm=arm)
    state = np.zeros(12)
    state[[5, 9, 10, 11]] = math.acos(6.0 / arm), 0.1, 1.0, -1.0  # feet 0 to 3 at walls 0 to 3, the fourth leaves
    expected, _ = simultaneous_impact_map(scene, state, [(0, 0), (1, 1), (2, 2), (3, 3)])
    resolved = impact_in_an_instant(scene, state)
    assert {0, 1, 2} <= {hit.wall for hit in resolved.impacts}
    assert relative_error(resolved.state, expected) < 1e-9
    assert PymunkSimulator(scene).iterations > 64
    with contextlib.suppress(RuntimeError):  # with fewer it is seen to be unresolved, or comes out otherwise
        hasty = impact_in_an_instant(scene, state, iterations=64).state
        assert relative_error(hasty, expected) > 1e-3
    with pytest.raises(ValueError, match="jack_arm = 1.000001 box_half_width couple the feet so strongly"):
        PymunkSimulator(Scene(jack_arm=6.0 + 6e-6))


def test_an_error_while_recording_is_raised(monkeypatch: pytest.MonkeyPatch) -> None:
    # The engine prints and forgets exceptions of its callbacks: an interruption there would swallow an impact.
    simulator, twin = PymunkSimulator(Scene()), PymunkSimulator(Scene())
    start = np.zeros(12)
    start[[4, 10]] = -4.9, -9.0

    def interrupted(*arguments: Any) -> Any:
        raise KeyboardInterrupt

    for one in (simulator, twin):
        one.reset(start)
    with monkeypatch.context() as patched:
        patched.setattr(contacts, "Impact", interrupted)
        with pytest.raises(KeyboardInterrupt):
            simulator.step(0.02)
    np.testing.assert_array_equal(simulator.state, start)
    assert (simulator.time, simulator.impacts) == (0.0, [])
    for one in (simulator, twin):
        one.step(0.02)
    np.testing.assert_array_equal(simulator.state, twin.state)
    assert simulator.impacts == twin.impacts != []


@pytest.mark.parametrize("moment", ["_forget_contacts", "_read"])
def test_an_interrupted_step_leaves_the_state_and_its_future(moment: str, monkeypatch: pytest.MonkeyPatch) -> None:
    # Each step is interrupted once before it completes, in a scene whose feet stay on the walls for long.
    rng = np.random.default_rng(4)
    simulator, twin = (PymunkSimulator(Scene(jack_arm=2.0, restitution=0.3)) for _ in range(2))
    start, real, cut_short = np.zeros(12), getattr(PymunkSimulator, moment), 0
    start[[5, 9, 11]] = 0.3, 6.0, 2.0
    for one in (simulator, twin):
        one.reset(start)

    def interrupted(self: PymunkSimulator) -> Any:
        raise KeyboardInterrupt

    for _ in range(300):
        torque, before, time = rng.uniform(-3e4, 3e4), simulator.state, simulator.time
        monkeypatch.setattr(PymunkSimulator, moment, interrupted)
        try:
            copy.deepcopy(simulator).step(0.02, torque)
        except KeyboardInterrupt:
            cut_short += 1
            with pytest.raises(KeyboardInterrupt):
                simulator.step(0.02, torque)
            np.testing.assert_array_equal(simulator.state, before)
            assert simulator.time == time
        monkeypatch.setattr(PymunkSimulator, moment, real)
        for one in (simulator, twin):
            one.step(0.02, torque)
        np.testing.assert_array_equal(simulator.state, twin.state)
        assert simulator.impacts == twin.impacts
    assert cut_short > 20

"""The engine of the pymunk model: faults that its set-up prevents, from tunnelling to swallowed errors."""

from __future__ import annotations

import copy
import math
from typing import Any

import numpy as np
import pytest

from jackbox_env.mechanics import simultaneous_impact_map
from jackbox_env.model.scene import Scene
from jackbox_env.simulators import contacts
from jackbox_env.simulators.pymunk import PymunkSimulator
from tests.guarantees.poses import velocity_error
from tests.simulators.engine import impact_in_an_instant


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
    assert velocity_error(scene, resolved.state[6:], expected[6:]) < 1e-9
    assert PymunkSimulator(scene).iterations > 64


@pytest.mark.parametrize(
    ("owner", "name"),
    [
        (PymunkSimulator, "_forget_contacts"),
        (PymunkSimulator, "_read"),
        (contacts, "Impact"),  # the engine prints and forgets exceptions of its callbacks: an impact would be lost
    ],
)
def test_an_interrupted_step_leaves_the_state_and_its_future(
    owner: Any, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Each step is interrupted once before it completes, in a scene whose feet stay on the walls for long.
    rng, cut_short = np.random.default_rng(4), 0
    simulator, twin = (PymunkSimulator(Scene(jack_arm=2.0, restitution=0.3)) for _ in range(2))
    start = np.zeros(12)
    start[[5, 9, 11]] = 0.3, 6.0, 2.0
    for one in (simulator, twin):
        one.reset(start)

    def interrupted(*_: Any) -> Any:
        raise KeyboardInterrupt

    for _ in range(300):
        torque, before, time = rng.uniform(-3e4, 3e4), simulator.state, simulator.time
        with monkeypatch.context() as patch:
            patch.setattr(owner, name, interrupted)
            try:
                copy.deepcopy(simulator).step(0.02, torque)
            except KeyboardInterrupt:
                cut_short += 1
                with pytest.raises(KeyboardInterrupt):
                    simulator.step(0.02, torque)
        np.testing.assert_array_equal(simulator.state, before)
        assert simulator.time == time
        for one in (simulator, twin):
            one.step(0.02, torque)
        np.testing.assert_array_equal(simulator.state, twin.state)
        assert simulator.impacts == twin.impacts
    assert cut_short > 20

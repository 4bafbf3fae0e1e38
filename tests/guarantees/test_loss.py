"""Bounces that end in rest, and walls that let feet go, in the exact model."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from jackbox_env.exact import late, rest, search
from jackbox_env.mechanics import gaps
from jackbox_env.model.complementarity import project
from jackbox_env.model.scene import Drive, Scene
from tests.simulators.exact_runs import plain_step, simulator
from tests.states import Array, lying

# -- rest -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("fall", "gap", "pressed"),
    [
        # At once at 3 g from t = 0.013 s on: the feet part from the floor at 2 g.
        (lambda t: 3.0 * 9.81 if t >= 0.013 else 0.0, 9.81 * 0.007**2, 0.013),
        # Ever faster, at g when t = 0.013 s: half of the weight on average presses until then.
        (lambda t: 9.81 * t / 0.013, 9.81 / 0.013 * 0.007**3 / 6.0, 0.0065),
    ],
    ids=["a jump", "a ramp"],
)
def test_a_wall_that_falls_faster_than_the_jack_lets_it_go_and_not_before(
    fall: Callable[[float], float], gap: float, pressed: float
) -> None:
    heavy = 1e9  # [kg] so that the box gives way by 1e-8 at most
    drive = Drive(force_y=lambda t: -heavy * fall(t))
    scene = Scene(restitution=0.5, box_mass=heavy, box_inertia=36.0 * heavy, drive=drive)
    run = simulator(scene, lying())
    run.step(0.02)
    assert gaps(scene, run.state)[3, 2:4] == pytest.approx([gap] * 2, rel=1e-8)
    assert sum(hit.impulse for hit in run.impacts) == pytest.approx(4.0 * 9.81 * pressed, rel=1e-8)


# -- negative controls ------------------------------------------------------------------------------------------------


def test_without_rest_a_step_never_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene(restitution=0.5, drive=None)
    assert plain_step(scene, lying(), 1e-3, 0.0)[0] == 0
    monkeypatch.setattr(late, "settle", lambda *arguments: 0)
    for module in (search, rest):
        monkeypatch.setattr(module, "MOST_WORK", 2000)
    assert plain_step(scene, lying(), 1e-3, 0.0)[0] != 0


def test_a_wall_lets_the_foot_that_it_turns_away_from_go_and_would_carry_it_along_if_it_held_on(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scene = Scene(restitution=0.0, drive=None)

    def floor_gaps() -> Array:
        ended: Array = gaps(scene, plain_step(scene, lying(along=2.0), 0.02, -6e4)[1])[3, 2:4]
        return ended

    assert floor_gaps().max() > 1e-4
    assert floor_gaps().min() > -1e-13
    monkeypatch.setattr(rest, "release_time", lambda *arguments: math.inf)
    monkeypatch.setattr(rest, "active_set", lambda work, count: (0, 1, -1) if project(work, 2, 0, 1, -1) else None)
    assert np.abs(floor_gaps()).max() < 1e-4

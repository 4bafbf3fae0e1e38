"""A jack at rest in the exact contact model: in corners, in small boxes, and distinguished from one that rattles."""

from __future__ import annotations

import math

import numpy as np
import pytest

from jackbox_env.exact import search as kernel
from jackbox_env.mechanics import energy
from jackbox_env.model.scene import Scene
from jackbox_env.model.states import Array, clearance
from tests.simulators.exact_runs import gaps_evaluated, plain_step, simulator
from tests.states import at, lying


def in_a_corner(scene: Scene, speed: float, turning: float = 0.0) -> Array:
    """Two feet on the floor and two at the wall on the left, all but at rest in a box that turns [rad/s]."""
    depth = scene.box_half_width - scene.jack_arm * math.sqrt(0.5)
    state = np.array([0.0, 0.0, 0.0, -depth, -depth, math.pi / 4.0, *np.zeros(6)])
    state[9:] = speed * np.random.default_rng(1).standard_normal(3)
    state[[8, 11]] += turning
    state[9:11] += -turning * state[4], turning * state[3]
    return state


def flat(angle: float) -> tuple[Scene, Array, float, int]:
    """A jack on one or two feet under ten times the weight, for a long step."""
    scene = Scene(box_half_width=0.71, jack_arm=0.67 * 0.71, gravity=98.1, drive=None)
    return scene, lying(turned=angle, depth=0.71 - scene.jack_arm * math.cos(angle)), 0.2, 1


def cornered(half: float, arm: float, speed: float, turning: float) -> tuple[Scene, Array, float, int]:
    scene = Scene(box_half_width=half, jack_arm=arm, drive=None)
    return scene, in_a_corner(scene, speed, turning), 0.02, 2


@pytest.mark.parametrize(
    ("scene", "start", "dt", "steps"),
    [
        flat(0.1), flat(math.pi / 4.0), *(
            cornered(*size, *motion)
            for size in ((0.71, 0.67 * 0.71), (6.0, 1.0)) for motion in ((0.0, 0.0), (1e-10, 2.0), (1e-6, 0.0))
        ),
    ],
)  # fmt: skip
def test_a_jack_all_but_at_rest_is_followed(scene: Scene, start: Array, dt: float, steps: int) -> None:
    run = simulator(scene, start)
    for _ in range(steps):
        run.step(dt, torque=0.0)
        assert gaps_evaluated(run) < 400_000
        assert clearance(scene, run.state.tolist()) > -2e-10 * min(1.0, scene.box_half_width)
    weight = 4.0 * scene.gravity * scene.box_half_width
    assert energy(scene, run.state) == pytest.approx(energy(scene, start), rel=1e-12, abs=1e-12 * weight)


def test_a_rattle_is_not_mistaken_for_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    # Feet in all four corners with 1e-4 m of play: as many gaps evaluated as at rest, but impulses of m v.
    scene = Scene(gravity=0.0, drive=None, jack_arm=6.0 * math.sqrt(2.0) - 1e-4)
    state = at(theta_jack=math.pi / 4.0, vx_jack=10.0, omega_jack=0.3)
    monkeypatch.setattr(kernel, "_CHATTER_WORK", 1000)
    guarded = plain_step(scene, state, 0.005, 0.0)
    monkeypatch.setattr(kernel, "is_chattering", lambda n, w: False)
    without = plain_step(scene, state, 0.005, 0.0)
    assert np.array_equal(guarded[1], without[1])  # the same bits
    assert guarded[2] == without[2]
    monkeypatch.setattr(kernel, "is_chattering", lambda n, w: bool(w.evaluations > 1000))
    assert not np.array_equal(plain_step(scene, state, 0.005, 0.0)[1], without[1])

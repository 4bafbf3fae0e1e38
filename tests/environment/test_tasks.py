"""What each task pays, and the returns of baselines: means over seeded episodes of 500 steps."""

from __future__ import annotations

import math

import pytest

import jackbox_env  # noqa: F401
from jackbox_env.model.scene import Scene
from jackbox_env.model.states import State
from jackbox_env.model.tasks import juggle, rattle, spin

SCENE = Scene()
V0 = math.sqrt(2.0 * 9.81 * 6.0)


REST = State(*[0.0] * 12)


def test_juggle_pays_by_the_distance_from_the_middle() -> None:
    for distance, pay in ((0.0, 1.0), (2.5, 0.5), (5.0, 0.0), (8.0, 0.0)):
        state = REST._replace(x_box=1.0, y_box=1.0, x_jack=1.0 + 0.6 * distance, y_jack=1.0 + 0.8 * distance)
        assert juggle(SCENE, state, 0.0, 0.0)[0] == pytest.approx(pay)
    near_the_walls = REST._replace(x_jack=0.5)  # L - l = 0.1 m, L / 6 = 1 m
    assert juggle(Scene(jack_arm=5.9), near_the_walls, 0.0, 0.0)[0] == pytest.approx(0.5)


def test_spin_pays_the_counter_clockwise_rate_of_a_calm_box() -> None:
    def pay(box: float, jack: float) -> float:
        return spin(SCENE, REST._replace(omega_box=box * V0 / 6.0, omega_jack=jack * V0), 0.0, 0.0)[0]

    assert pay(0.0, 0.5) == pytest.approx(0.5)
    assert pay(0.0, -0.5) == pytest.approx(-0.5)
    assert pay(0.0, 7.0) == pytest.approx(1.0)
    assert pay(-0.5, 1.0) == pytest.approx(0.5)
    assert pay(1.0, 1.0) == pay(3.0, 1.0) == 0.0


def test_rattle_pays_impulse_and_charges_torque() -> None:
    def pay(impulse: float, torque: float, box: float = 0.0) -> tuple[float, float]:
        return rattle(SCENE, REST._replace(omega_box=box * V0 / 6.0), torque, impulse)

    turned_back = 2.0 * 4.0 * V0  # impulse on a jack of 4 kg turned back at v0 [N s]
    assert pay(turned_back, 0.0) == pytest.approx((0.5, 0.0))
    assert pay(9.0 * turned_back, 45000.0) == pytest.approx((1.0, -0.0025))
    assert pay(turned_back, -9e9, box=1.0) == pytest.approx((0.25, -0.01))
    assert pay(turned_back, 0.0, box=-2.0)[0] == 0.0

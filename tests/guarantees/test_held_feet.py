"""Resting feet: hostile scenes with loss, a jack in a fast corner, and an independent integration."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from jackbox_env import Drive, Scene, rollout
from jackbox_env.exact import constrained
from jackbox_env.exact.workspace import OMEGA_SQUARED
from jackbox_env.mechanics import energy, gap_jacobian
from jackbox_env.model.states import Array, clearance
from jackbox_env.model.tasks import sample_start
from tests.simulators.exact_runs import plain_step, simulator
from tests.states import FLAT, lying

DEEPEST = 2.4e-10  # of a foot in a wall, in boxes of 1 m and more [m]


# A jack that slides on one foot along the floor of a box, both turning as one.
ON_ONE_FOOT = lying(1.0, 0.3, 0.2, turned=0.3, depth=6.0 - math.cos(0.3))
ON_ONE_FOOT[9:11] += 0.5 * math.cos(0.2), 0.5 * math.sin(0.2)


# -- hostile scenes ---------------------------------------------------------------------------------------------------


def hostile(rng: np.random.Generator) -> tuple[Scene, Array]:
    """A scene with loss, and a start in motion, in a box that turns by up to 100 rad/s."""
    half = 6.0 if rng.uniform() < 0.5 else 10.0 ** rng.uniform(-1.0, 1.0)
    mass, ratio = 10.0 ** rng.uniform(-1.0, 1.0), 10.0 ** rng.uniform(-2.0, 2.0)
    scene = Scene(
        box_half_width=half,
        box_mass=mass * ratio,
        jack_arm=half * (rng.uniform(0.05, 1.0) if rng.uniform() < 0.8 else rng.uniform(1.0, 1.4)),
        jack_mass=mass,
        gravity=rng.choice([9.81, 0.0, 1.62, 30.0]),
        restitution=rng.choice([0.0, 0.3, 0.5, 0.8, 0.95, 0.99, 0.999, rng.uniform(0.0, 0.999)]),
        torque_limit=mass * ratio * half * half * 10.0 ** rng.uniform(-1.0, 1.5),
        drive=None,
    )
    state = np.array(sample_start(scene, rng))
    state[6:] = rng.standard_normal(6) * scene.speed_scale * rng.uniform()
    state[6:] *= 0.2, 0.2, 0.0, 1.0, 1.0, 1.0 / half
    state[8] = rng.choice([0.0, 1.0, 10.0, 100.0]) * rng.uniform(-1.0, 1.0)
    if rng.uniform() < 0.5:  # the jack turns with the box
        state[11], state[9], state[10] = state[8], -state[8] * state[4], state[8] * state[3]
    return scene, state


def test_hostile_scenes_with_loss_are_followed_inside_the_walls_and_gain_nothing(cases: Callable[[int], int]) -> None:
    count, steps = cases(160), 200
    rng = np.random.default_rng(7)
    scenes, states = zip(*(hostile(rng) for _ in range(count)), strict=True)
    shares = np.repeat(rng.uniform(-1.0, 1.0, (count, steps // 25)), 25, axis=1)  # half a second each
    torques = shares * np.array([scene.torque_limit for scene in scenes])[:, None]
    torques[::4] = 0.0
    trajectories = rollout(scenes, np.array(states), torques, 0.02)
    for scene, path, held in zip(scenes, trajectories, torques, strict=True):
        turned = np.abs(path[:, [2, 5]]).max()
        rounded = 8.9e-16 * scene.box_half_width * turned  # of the angles
        deepest = -min(clearance(scene, state) for state in path[1:].tolist())
        assert deepest <= DEEPEST * min(1.0, scene.box_half_width) + rounded
        energies = np.array([energy(scene, state) for state in path])
        work = held * np.diff(path[:, 2])  # exact: the torque is held
        size = np.abs(energies[1:]) + np.abs(energies[:-1]) + scene.jack_mass * scene.gravity * scene.box_half_width
        allowed = 1e-12 * size + np.abs(held) * 2.3e-16 * turned
        assert (np.diff(energies) - work <= allowed).all()


# -- held feet against other computations -----------------------------------------------------------------------------


def constrained_motion(scene: Scene, pairs: list[tuple[int, int]], start: Array, until: float) -> Array:
    """Integrate M qddot = f + J^T lambda, J qddot + Jdot qdot = 0 by SciPy, with the gradients of ``mechanics``."""
    inverse = 1.0 / np.array(scene.mass_diagonal)

    def gradients(q: Array, rates: Array) -> Array:
        return np.array([gap_jacobian(scene, [*q, *rates], wall, foot) for wall, foot in pairs])

    def rates_of(t: float, y: Array) -> Array:
        q, rates, tiny = y[:6], y[6:], 1e-6
        drive = scene.drive
        assert isinstance(drive, Drive)
        pushed = [0.0 if part is None else part(t) for part in (drive.force_x, drive.force_y, drive.torque)]
        force = np.array([*pushed, 0.0, -scene.jack_mass * scene.gravity, 0.0])
        here = gradients(q, rates)
        bend = (gradients(q + tiny * rates, rates) - gradients(q - tiny * rates, rates)) / (2.0 * tiny) @ rates
        pushes = np.linalg.solve(here * inverse @ here.T, -bend - here @ (inverse * force))
        return np.concatenate([rates, inverse * (force + here.T @ pushes)])

    end: Array = solve_ivp(rates_of, (0.0, until), start, method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    return end


@pytest.mark.parametrize("e", [0.0, 0.5, 1.0])
@pytest.mark.parametrize(
    ("start", "pairs"),
    [(ON_ONE_FOOT, [(3, 3)]), (lying(1.0, 0.8), [(3, 2), (3, 3)]), (lying(-FLAT, 0.8), [(3, 2), (3, 3), (2, 1)])],
    ids=["one foot", "two feet", "locked in a corner"],
)
def test_held_feet_move_as_the_lagrangian_motion_that_scipy_integrates(start: Array, pairs: Any, e: float) -> None:
    drive = Drive(
        torque=lambda t: 40.0 * math.sin(7.0 * t), force_x=lambda t: 9.0 * math.cos(5.0 * t), force_y=lambda t: 30.0 * t
    )
    scene = Scene(box_mass=12.0, restitution=e, drive=drive)
    run = simulator(scene, start)
    for _ in range(10):
        run.step(0.02)
        assert {(hit.wall, hit.foot) for hit in run.impacts} >= set(pairs)  # held throughout
        assert sum(hit.impulse for hit in run.impacts if (hit.wall, hit.foot) in pairs) > 0.0
    np.testing.assert_allclose(run.state, constrained_motion(scene, pairs, start, 0.2), rtol=0.0, atol=3e-10)


# -- negative controls ------------------------------------------------------------------------------------------------


def test_without_the_turn_of_the_box_held_feet_leave_the_lagrangian_motion(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene(box_mass=12.0, restitution=0.5, drive=Drive(torque=lambda t: 40.0))
    right = constrained_motion(scene, [(3, 3)], ON_ONE_FOOT, 0.02)
    assert np.abs(plain_step(scene, ON_ONE_FOOT, 0.02)[1] - right).max() < 1e-10
    product = constrained.product
    monkeypatch.setattr(
        constrained,
        "product",
        lambda work, one, other, k, first=0: 0.0 if one == OMEGA_SQUARED else product(work, one, other, k, first),
    )
    assert np.abs(plain_step(scene, ON_ONE_FOOT, 0.02)[1] - right).max() > 1e-6

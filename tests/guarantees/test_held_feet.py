"""Resting feet at scale: batches with loss, jacks in corners, feet that leave, and independent computations."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import mpmath as mp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from jackbox_env import Drive, JackLostError, Lookahead, Scene, rollout
from jackbox_env.exact import constrained
from jackbox_env.exact.trigonometry import without_turns
from jackbox_env.exact.workspace import OMEGA_SQUARED
from jackbox_env.mechanics import energy, gap_jacobian
from jackbox_env.states import Array, clearance
from jackbox_env.tasks import sample_start
from tests.simulators.exact_runs import gaps_evaluated, plain_step, simulator
from tests.states import FLAT, lying

DEEPEST = 2.4e-10  # of a foot in a wall, in boxes of 1 m and more [m]


def on_one_foot(omega: float = 0.3) -> Array:
    """A jack that slides on one foot along the floor of a box, both turning as one."""
    state = np.zeros(12)
    state[2], state[5] = 0.2, 0.5
    below = -(6.0 - math.cos(0.3))
    state[3], state[4] = -below * math.sin(0.2) + math.cos(0.2), below * math.cos(0.2) + math.sin(0.2)
    state[[8, 11]], state[9], state[10] = omega, -omega * state[4], omega * state[3]
    state[9:11] += 0.5 * math.cos(0.2), 0.5 * math.sin(0.2)
    return state


def switching(size: float, period: float) -> Callable[[float], float]:
    """A square wave [N] of so many seconds."""
    return lambda t: size if t / period % 1.0 < 0.5 else -size


def changing(rng: np.random.Generator, count: int, steps: int) -> Array:
    """Actions that change every half second or so, shape (count, steps)."""
    actions, now = np.empty((count, steps)), rng.uniform(-1.0, 1.0, count)
    for k in range(steps):
        now = np.where(rng.uniform(size=count) < 0.04, rng.uniform(-1.0, 1.0, count), now)
        actions[:, k] = now
    return actions


# -- nobody is lost ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("e", "steps"), [(0.5, 200), (0.95, 350)])
def test_a_batch_with_loss_goes_on(e: float, steps: int) -> None:
    many = gym.make_vec("JackInBox-v0", num_envs=1024, contact="exact", scene=Scene(restitution=e), task="juggle")
    many.reset(seed=1)
    for actions in changing(np.random.default_rng(1), 1024, steps).T:
        many.step(actions[:, None])


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
    torques = changing(rng, count, steps) * np.array([scene.torque_limit for scene in scenes])[:, None]
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


def test_a_resting_foot_leaves_when_a_side_force_turns_round() -> None:
    for seed in range(12):
        rng = np.random.default_rng(seed)
        period, along = rng.uniform(0.3, 1.0), rng.uniform(-3.0, 3.0)
        scene = Scene(restitution=0.5, drive=Drive(force_y=switching(8000.0, period)))
        run, in_flight = simulator(scene, lying(along)), 0
        for _ in range(150):
            run.step(0.02)
            in_flight += not run.impacts
        assert in_flight > 30


def test_a_jack_that_rattles_in_the_corner_of_a_fast_box_sinks_no_deeper_with_each_of_a_thousand_bounces() -> None:
    # Flat on the floor of a box at 55 rad/s that has turned by 3059 rad, both feet 2.6e-10 m from the next wall.
    scene = Scene(box_mass=3.0, jack_mass=8.0, jack_arm=2.0, gravity=0.0, restitution=0.999, drive=None)
    flat, omega, angle = 6.0 - 2.0 * math.sqrt(0.5), 55.0, 3059.0
    x, y = -flat + 2.6e-10, -flat
    centre = np.array([x * math.cos(angle) - y * math.sin(angle), x * math.sin(angle) + y * math.cos(angle)])
    state = np.zeros(12)
    state[2], state[5], state[3:5] = angle, angle + math.pi / 4.0, centre
    state[[8, 11]], state[9], state[10] = omega, -omega * centre[1], omega * centre[0]
    state[9:11] += 0.01 * np.array([-math.cos(angle), -math.sin(angle)])
    run = simulator(scene, state)
    for _ in range(3):
        run.step(0.02, 0.0)
        assert clearance(scene, run.state.tolist()) > -DEEPEST - 8.9e-16 * 6.0 * 3062.0
    assert gaps_evaluated(run) < 1000.0  # at rest


def test_lookahead_works_to_the_end_of_lossy_episodes() -> None:
    env: Any = Lookahead(gym.make("JackInBox-v0", contact="exact", task="spin", scene={"restitution": 0.5}))
    env.reset(seed=0)
    for action in changing(np.random.default_rng(0), 1, 60)[0]:
        env.step(np.array([action], dtype=np.float32))


def test_of_a_batch_the_one_that_cannot_be_followed_is_named_and_the_others_go_on() -> None:
    many: Any = gym.make_vec("JackInBox-v0", num_envs=3, contact="exact", scene={"restitution": 0.5})
    many.reset(seed=0)
    states = many.unwrapped.states
    states[1, 3], states[1, 11] = 4.999, 1e9
    many.reset(options={"state": states})
    with pytest.raises(JackLostError, match="environment 1"):
        many.step(np.zeros((3, 1)))
    assert np.array_equal(many.unwrapped.states, states)
    many.reset(options={"reset_mask": np.array([False, True, False])})
    assert np.array_equal(many.unwrapped.states[[0, 2]], states[[0, 2]])
    many.step(np.zeros((3, 1)))
    assert many.unwrapped.times.tolist() == [0.02, 0.02, 0.02]


# -- held feet against other computations -----------------------------------------------------------------------------


def constrained_motion(scene: Scene, pairs: list[tuple[int, int]], start: Array, until: float) -> Array:
    """Integrate M qddot = f + J^T lambda, J qddot + Jdot qdot = 0 by SciPy, with the gradients of ``mechanics``."""
    inverse = 1.0 / np.array([scene.box_mass] * 2 + [scene.box_inertia] + [scene.jack_mass] * 2 + [scene.jack_inertia])

    def gradients(q: Array, rates: Array) -> Array:
        return np.array([gap_jacobian(scene, [*q, *rates], wall, foot) for wall, foot in pairs])

    def rates_of(t: float, y: Array) -> Array:
        q, rates, tiny = y[:6], y[6:], 1e-6
        drive = scene.drive
        assert isinstance(drive, Drive)
        force = np.zeros(6)
        for index, function in enumerate((drive.force_x, drive.force_y, drive.torque)):
            force[index] = function(t) if function is not None else 0.0
        force[4] = -scene.jack_mass * scene.gravity
        here = gradients(q, rates)
        bend = (gradients(q + tiny * rates, rates) - gradients(q - tiny * rates, rates)) / (2.0 * tiny) @ rates
        pushes = np.linalg.solve(here * inverse @ here.T, -bend - here @ (inverse * force))
        return np.concatenate([rates, inverse * (force + here.T @ pushes)])

    end: Array = solve_ivp(rates_of, (0.0, until), start, method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    return end


@pytest.mark.parametrize(
    ("start", "pairs"),
    [(on_one_foot(), [(3, 3)]), (lying(1.0, 0.8), [(3, 2), (3, 3)]), (lying(-FLAT, 0.8), [(3, 2), (3, 3), (2, 1)])],
    ids=["one foot", "two feet", "locked in a corner"],
)
def test_held_feet_move_as_the_lagrangian_motion_that_scipy_integrates(start: Array, pairs: Any) -> None:
    drive = Drive(
        torque=lambda t: 40.0 * math.sin(7.0 * t), force_x=lambda t: 9.0 * math.cos(5.0 * t), force_y=lambda t: 30.0 * t
    )
    scene = Scene(box_mass=12.0, restitution=0.5, drive=drive)
    run = simulator(scene, start)
    for _ in range(10):
        run.step(0.02)
        assert {(hit.wall, hit.foot) for hit in run.impacts} >= set(pairs)  # held throughout
        assert sum(hit.impulse for hit in run.impacts if (hit.wall, hit.foot) in pairs) > 0.0
    np.testing.assert_allclose(run.state, constrained_motion(scene, pairs, start, 0.2), rtol=0.0, atol=3e-10)


def test_a_locked_weightless_jack_turns_with_the_box_as_one_body() -> None:
    scene = Scene(gravity=0.0, restitution=0.0, drive=None)
    run = simulator(scene, lying(-FLAT, 2.0))
    inertia = scene.box_inertia + scene.jack_inertia + 2.0 * FLAT**2 / (1.0 / scene.box_mass + 1.0 / scene.jack_mass)
    for number in range(1, 51):
        run.step(0.02, 300.0)
        assert run.state[8] == pytest.approx(2.0 + 300.0 / inertia * 0.02 * number, rel=1e-14)
        assert run.state[11] == run.state[8]
    assert gaps_evaluated(run) < 40


def test_momentum_and_the_common_fall_hold_while_feet_are_held() -> None:
    for start in (on_one_foot(), lying(1.0, 0.3), lying(-FLAT, 0.8)):
        scene = Scene(box_mass=12.0, restitution=0.5, drive=None)
        run = simulator(scene, start)
        for _ in range(25):
            run.step(0.02, 20.0)
        momentum = 12.0 * run.state[6:8] + 4.0 * run.state[9:11]
        before = 12.0 * start[6:8] + 4.0 * start[9:11]
        np.testing.assert_allclose(momentum, before - [0.0, 4.0 * 9.81 * 0.5], rtol=0.0, atol=1e-12)
        centre = (12.0 * run.state[:2] + 4.0 * run.state[3:5]) / 16.0
        expected = (12.0 * start[:2] + 4.0 * start[3:5]) / 16.0 + before / 16.0 * 0.5 - [0.0, 9.81 * 0.25 * 0.125]
        np.testing.assert_allclose(centre, expected, rtol=0.0, atol=1e-13)


# -- large angles -----------------------------------------------------------------------------------------------------


def test_angles_without_turns_are_those_angles() -> None:
    rng = np.random.default_rng(0)
    for angle in (rng.uniform(-1.0, 1.0, 500) * 10.0 ** rng.uniform(0.0, 15.9, 500)).tolist():
        rest = without_turns(angle)
        with mp.workdps(60):
            turns = (mp.mpf(angle) - mp.mpf(rest)) / (2 * mp.pi)
            assert abs(turns - mp.nint(turns)) * 2 * mp.pi < 1e-15
        assert abs(rest) <= math.pi * (1.0 + 1e-15)


# -- negative controls ------------------------------------------------------------------------------------------------


def test_without_the_turn_of_the_box_held_feet_leave_the_lagrangian_motion(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene(box_mass=12.0, restitution=0.5, drive=Drive(torque=lambda t: 40.0))
    right = constrained_motion(scene, [(3, 3)], on_one_foot(), 0.02)
    assert np.abs(plain_step(scene, on_one_foot(), 0.02)[1] - right).max() < 1e-10
    product = constrained.product
    monkeypatch.setattr(
        constrained,
        "product",
        lambda work, one, other, k: 0.0 if one == OMEGA_SQUARED else product(work, one, other, k),
    )
    assert np.abs(plain_step(scene, on_one_foot(), 0.02)[1] - right).max() > 1e-6

"""Returns of good and bad behaviour in each task: means over seeded episodes of 500 steps."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import jackbox_env  # noqa: F401
from jackbox_env.model.scene import Scene
from jackbox_env.model.states import State
from jackbox_env.model.tasks import juggle, rattle, spin

Policy = Callable[[Sequence[float], np.random.Generator], float | None]
SCENE = Scene()
V0 = math.sqrt(2.0 * 9.81 * 6.0)


def hold(state: Sequence[float], target: float, stiffness: float, damping: float) -> float:
    """Action that turns the box towards an angle [rad]: a PD controller, gains in 1/s^2 and 1/s."""
    torque = 14400.0 * (stiffness * (target - state[2]) - damping * state[8])
    return max(-1.0, min(1.0, torque / 90000.0))


def level(state: Sequence[float], rng: np.random.Generator) -> float:
    return hold(state, 0.0, 10.0, 5.0)


def landing_time(state: Sequence[float]) -> float:
    """Time until the jack's fall reaches the floor of a level box [s]."""
    height, rise = max(0.0, state[4] - state[1] + 6.0 - 0.85), state[10] - state[7]
    return (rise + math.sqrt(rise**2 + 2.0 * 9.81 * height)) / 9.81


def spinner(state: Sequence[float], rng: np.random.Generator, offset: float = 0.4) -> float:
    """Tilt the box so that the foot that lands stands ``offset`` [rad] ahead of the plumb line: the floor spins it."""
    landing_angle = state[5] + state[11] * landing_time(state)
    tilt = (landing_angle - offset + math.pi / 4.0) % (math.pi / 2.0) - math.pi / 4.0
    return hold(state, tilt, 30.0, 10.0)


def slapper(state: Sequence[float], rng: np.random.Generator) -> float:
    """Swing the floor up against the falling jack 0.3 s before it lands; keep the box level otherwise."""
    time = landing_time(state)
    landing_offset = state[3] - state[0] + time * (state[9] - state[6])
    if time < 0.3 and abs(landing_offset) > 0.5:
        return math.copysign(1.0, landing_offset)
    return hold(state, 0.0, 4.0, 4.0)


@functools.cache
def mean_return(task: str, policy: Policy, episodes: int = 24, torque: str = "agent") -> float:
    env: gym.Env[Any, Any] = gym.make("JackInBox-v0", task=task, torque=torque)
    total = 0.0
    for seed in range(episodes):
        _, info = env.reset(seed=seed)
        rng = np.random.default_rng(seed)
        truncated = False
        while not truncated:
            _, reward, _, truncated, info = env.step(policy(info["state"].tolist(), rng))
            assert -1.0 <= float(reward) <= 1.0
            total += float(reward)
    return total / episodes


def constant(value: float, state: Sequence[float], rng: np.random.Generator) -> float:
    return value


rest = functools.partial(constant, 0.0)


def noise(state: Sequence[float], rng: np.random.Generator) -> float:
    return rng.uniform(-1.0, 1.0)


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


def test_juggle_ranks_the_baselines() -> None:
    # over many starts, give or take 9 on another processor; 500 is the ceiling
    earned = [mean_return("juggle", policy) for policy in (noise, rest, level)]
    earned.append(mean_return("juggle", rest, torque="chirp"))
    np.testing.assert_allclose(earned, [128, 200, 242, 134], atol=30)


def test_spin_rewards_skill_and_its_sense_of_rotation() -> None:
    # steering the landings earns about 65, the same skill the wrong way about -70, all else near 0
    assert mean_return("spin", spinner) > 35.0
    assert mean_return("spin", functools.partial(spinner, offset=-0.4)) < -35.0
    assert abs(mean_return("spin", noise, episodes=72)) < 35.0


def test_rattle_rewards_timed_blows() -> None:
    # timed blows earn about 5.3; nothing 2.35, levelling 2.3, noise 1
    assert mean_return("rattle", slapper) > 4.0
    assert max(mean_return("rattle", rest), mean_return("rattle", level)) < 3.0
    assert mean_return("rattle", noise) < 2.0


@pytest.mark.parametrize(("task", "skilled"), [("spin", spinner), ("rattle", slapper)])
def test_no_constant_torque_wins(task: str, skilled: Policy, cases: Callable[[int], int]) -> None:
    values = [0.0, 0.003, -0.003, 0.005, -0.005, 0.01, -0.01, 0.02, 0.03, 0.05, 0.1, 0.3, 1.0, -1.0]
    best = max(mean_return(task, functools.partial(constant, value), episodes=cases(12)) for value in values)
    assert best < 0.8 * mean_return(task, skilled)

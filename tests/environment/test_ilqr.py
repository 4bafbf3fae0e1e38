"""iLQR: better torques through impacts, their states, costs of one's own, and what is refused."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from jackbox_env import Drive, Scene, ilqr, rollout
from jackbox_env.model.states import X_JACK, Y_JACK, Array
from jackbox_env.planning import ilqr as method

SCENE = Scene(drive=Drive(force_x=lambda time: 300.0 * math.sin(time)))
START = np.array([0.0, 0.0, 0.05, 0.5, 0.3, 0.2, 0.0, 0.0, 0.0, 0.4, 0.0, 0.5])
PLAN = np.zeros(25)  # 2.5 s, some two impacts
TARGET = np.array([1.5, 0.5])  # [m]


def near_the_target(states: Array) -> tuple[Array, Array, Array]:
    """Half the square of the jack's distance from a target at the end."""
    off = states[-1, [X_JACK, Y_JACK]] - TARGET
    costs, slopes, curvatures = np.zeros(len(states)), np.zeros((len(states), 12)), np.zeros((len(states), 12, 12))
    costs[-1] = 0.5 * off @ off
    slopes[-1, [X_JACK, Y_JACK]] = off
    curvatures[-1, [X_JACK, Y_JACK], [X_JACK, Y_JACK]] = 1.0
    return costs, slopes, curvatures


@pytest.mark.parametrize(("task", "gain"), [("juggle", 15.0), ("spin", 15.0)])
def test_it_earns_more_and_returns_the_states_that_it_plays(task: str, gain: float) -> None:
    improved = ilqr(SCENE, START, PLAN, 0.02, task=task, repeat=5)
    torques, states, value, before, iterations, nonsmooth = improved
    played: Any = rollout(SCENE, START, torques[None], 0.02, rewards=task, repeat=5, impacts=True)
    assert played.impacts.sum() >= 2
    np.testing.assert_array_equal(played.trajectories[0], states)
    assert value == pytest.approx(played.rewards.sum(), rel=1e-13)
    assert value > before + gain
    assert before == pytest.approx(
        rollout(SCENE, START, PLAN[None], 0.02, rewards=task, repeat=5).rewards.sum(), rel=1e-13
    )
    assert abs(torques).max() <= SCENE.torque_limit
    assert 0 < iterations <= method.MOST_ITERATIONS
    assert nonsmooth == 0


def test_a_cost_replaces_the_task() -> None:
    improved = ilqr(SCENE, START, PLAN, 0.02, cost=near_the_target, repeat=5)
    assert improved.value == -near_the_target(improved.states[1:])[0].sum()
    assert improved.value > 0.5 * improved.before
    assert improved.before == -near_the_target(rollout(SCENE, START, PLAN[None], 0.02, repeat=5)[0, 1:])[0].sum()


def test_wrong_derivatives_improve_little_and_without_any_the_plan_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    lost = method._Problem._lost
    monkeypatch.setattr(method._Problem, "_lost", lambda self, states: (-lost(self, states)[0], lost(self, states)[1]))
    improved = ilqr(SCENE, START, PLAN, 0.02, repeat=5)
    assert improved.value < improved.before + 3.0
    np.testing.assert_array_equal(ilqr(SCENE, START, [0.0], 0.02, cost=constant).torques, [0.0])


SMALL = {"box_half_width": 0.07, "box_mass": 0.7, "jack_mass": 40.0, "jack_arm": 0.044, "torque_limit": 28.0}
STRONG = {"box_half_width": 0.05, "box_mass": 0.4, "jack_mass": 0.15, "jack_arm": 0.044, "torque_limit": 27000.0}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(("fields", "knots", "gain"), [(SMALL, 60, 10.0), (STRONG, 30, 0.0)])
def test_where_gains_overflow_or_a_changed_plan_loses_the_jack_no_error_is_raised(
    fields: dict[str, float], knots: int, gain: float
) -> None:
    start = [0.0] * 3 + [0.03 * fields["box_half_width"], 0.05 * fields["box_half_width"], 0.3] + [0.0] * 6
    improved = ilqr(fields, start, [0.0] * knots, 0.02, task="spin", repeat=5)
    assert improved.value >= improved.before + gain
    played = rollout(fields, start, improved.torques[None], 0.02, repeat=5)
    np.testing.assert_array_equal(played[0], improved.states)


def constant(states: Array) -> Any:
    return np.ones(len(states)), np.zeros((len(states), 12)), np.zeros((len(states), 12, 12))

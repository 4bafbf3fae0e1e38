"""Returns of policies on the page of results."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from agents.evaluation.returns import evaluate
from agents.policies.registry import find_policy
from agents.settings import EnvSettings
from jackbox_env import JackInBoxVectorEnv, Scene
from scripts.studies.results import measured

DOCS = Path(__file__).parents[2] / "docs"


def test_a_row_has_the_results_of_evaluate() -> None:
    row = measured.policy_row("", "spin", "exact", "zero", 8)
    settings = EnvSettings(task="spin", contact="exact")
    zero = find_policy("zero", settings, measured.SEED)
    evaluated = evaluate("zero", zero, settings.env_settings, 8, measured.SEED)
    assert (row["mean"], row["interval_95"]) == (evaluated.mean, evaluated.interval)
    planned = measured.milliseconds(find_policy("planner-fast", settings), settings)
    assert 0.0 < row["milliseconds"] < planned  # by far


def test_spin_pays_nothing_before_a_jack_can_have_fallen_to_a_wall() -> None:
    env = JackInBoxVectorEnv(64, contact="exact", task="spin")
    env.reset(seed=3)
    unpaid = measured.unpaid_steps(env.states)
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (500, 64, 1)).astype(np.float32)
    rewards = np.array([env.step(action)[1] for action in actions])
    for number, count in enumerate(unpaid.astype(int).tolist()):
        assert not rewards[:count, number].any()
    paid = (rewards != 0.0).argmax(axis=0)
    assert (paid - unpaid).min() <= 2  # the bound is close for some


@pytest.mark.parametrize("speed", [5.0, 10.85, 30.0, 50.0])
def test_rattle_pays_a_jack_that_flies_to_and_fro_the_reward_on_the_page(speed: float) -> None:
    scene = Scene(box_mass=1e12, gravity=0.0)  # weightless, in a box that does not give way
    env: Any = gym.make("JackInBox-v0", contact="exact", task="rattle", scene=scene)
    env.reset(options={"state": [0.0] * 9 + [speed, 0.0, 0.0]})
    earned = sum(float(env.step([0.0])[1]) for _ in range(500))
    assert earned == pytest.approx(measured.rattle_at(speed), abs=1.01)  # of a knock


def test_a_curve_is_the_interquartile_mean_of_the_trainings() -> None:
    curves = np.random.default_rng(0).normal(size=(5, 3))
    middle = measured.curve_of([{"seconds": [4, 8, 12], "curve": list(curve)} for curve in curves])[1]
    np.testing.assert_allclose(middle, np.sort(curves, axis=0)[1:4].mean(axis=0))

"""docs/learners.md: what is called equal, and a planner by another contact model."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

from agents.policies.planner import FAST_SEARCHES, planner_for
from agents.settings import EnvSettings
from jackbox_env import JackInBoxEnv, Scene
from scripts.studies.learners.learners import interval, verdict
from scripts.studies.learners.measured import by_environment


@pytest.mark.parametrize(
    ("difference", "wanted"),
    [
        ((0.0, -4.9, 4.9), "equal"),
        ((-9.0, -12.0, -5.1), "worse"),
        ((9.0, 5.1, 12.0), "better"),
        ((0.0, -10.0, 10.0), "undecided: about 64 trainings would do"),  # half the width: four times as many, twice
        ((-1.0, -9.0, 0.0), "undecided: about 64 trainings would do"),  # by the longer side of the interval
        ((5.0, 3.0, 7.0), "undecided: more than 1,000 trainings would do"),
    ],
)
def test_a_difference_is_judged_by_its_interval(difference: tuple[float, float, float], wanted: str) -> None:
    assert verdict(difference, 5.0, 8) == wanted


def test_intervals_are_of_trainings_without_the_best_and_the_worst_quarter() -> None:
    middle, low, high = interval(np.array([0.0, 10.0, 11.0, 12.0, 13.0, 99.0, 10.0, 12.0]))
    assert middle == 11.25
    assert 0.0 < low < middle < high < 99.0
    assert interval(np.full(8, 3.0), np.full(4, 1.0)) == (2.0, 2.0, 2.0)


def test_plans_by_an_environment_of_the_same_model_earn_the_same() -> None:
    planner = planner_for(EnvSettings(task="rattle").env_settings, 1, FAST_SEARCHES)
    env = JackInBoxEnv(fidelity="exact", task="rattle", action_repeat=planner.repeat, episode_steps=1_000_000)
    env.reset(seed=3)
    states, plans = np.array([env.state]), np.random.default_rng(0).uniform(-1.0, 1.0, (1, 3, 20))
    wanted, got = planner.search.evaluate(Scene(), states, plans), by_environment(env, Scene(), states, plans)
    np.testing.assert_allclose(got[0], wanted[0], rtol=1e-12)
    np.testing.assert_array_equal(got[1], wanted[1])

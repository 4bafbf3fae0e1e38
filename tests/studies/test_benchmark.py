"""docs/benchmark.md: what policies earn, limits of returns, what is called equal, and training algorithms."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any
from unittest.mock import Mock

import gymnasium as gym
import numpy as np
import pytest

from agents.evaluation.returns import evaluate
from agents.policies.registry import find_policy
from agents.settings import EnvSettings
from jackbox_env import JackInBoxVectorEnv, Scene
from scripts.recipes import with_sb3
from scripts.studies.benchmark import policies, trainings
from scripts.studies.benchmark.benchmark import _middle, interval, verdict


def test_a_row_has_the_results_of_evaluate() -> None:
    row = policies.policy_row("spin", "exact", "zero", 8)
    settings = EnvSettings(task="spin", contact="exact")
    zero = find_policy("zero", settings, trainings.SEED)
    evaluated = evaluate("zero", zero, settings.env_settings, 8, trainings.SEED)
    assert (row["mean"], row["interval_95"]) == (evaluated.mean, evaluated.interval)
    planned = policies.milliseconds(find_policy("planner-fast", settings), settings)
    assert 0.0 < row["milliseconds"] < planned  # by far


def test_spin_pays_nothing_before_a_jack_can_have_fallen_to_a_wall() -> None:
    env = JackInBoxVectorEnv(64, contact="exact", task="spin")
    env.reset(seed=3)
    unpaid = policies.unpaid_steps(env.states)
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
    assert earned == pytest.approx(policies.rattle_at(speed), abs=1.01)  # of a knock


@pytest.mark.parametrize(
    ("difference", "wanted"),
    [
        ((0.0, -4.9, 4.9), "equal"),
        ((-9.0, -12.0, -5.1), "worse"),
        ((9.0, 5.1, 12.0), "better"),
        (
            (0.0, -10.0, 10.0),
            "undecided (64)",
        ),  # half the width: four times as many, twice
        ((-1.0, -9.0, 0.0), "undecided (64)"),  # by the longer side of the interval
        ((5.0, 3.0, 7.0), "undecided (more than 1,000)"),
    ],
)
def test_a_difference_is_judged_by_its_interval(difference: tuple[float, float, float], wanted: str) -> None:
    assert verdict(difference, 5.0, 8) == wanted


def test_intervals_are_of_trainings_without_the_best_and_the_worst_quarter() -> None:
    middle, low, high = interval(_middle, np.array([0.0, 10.0, 11.0, 12.0, 13.0, 99.0, 10.0, 12.0]))
    assert middle == 11.25
    assert 0.0 < low < middle < high < 99.0
    assert interval(_middle, np.full(8, 3.0), np.full(4, 3.0)) == (3.0, 3.0, 3.0)


def test_an_algorithm_of_ones_own_is_evaluated_from_starts_that_it_cannot_know() -> None:
    def train(task: str, seed: int) -> Iterator[Any]:
        for torque in (1.0, 0.0):
            yield lambda seen, torque=torque: np.full((len(seen), 1), torque), {"action_repeat": 4}

    rows = [trainings.measured("mine", train, "spin", 3, 8) for _ in range(2)]
    assert rows[0]["starts"] != rows[1]["starts"]
    zero, settings = trainings.playing(lambda seen: np.zeros((len(seen), 1))), EnvSettings(task="spin").env_settings
    for row in rows:
        assert row["mean"] == evaluate("", zero, settings, 8, row["starts"]).mean  # of the last one
        assert len(set(row["curve"])) == len(row["seconds"]) == 2


@pytest.mark.parametrize(
    ("trained", "sentence"),
    [
        (3.0, "train must return a model with predict or a function, got 3.0"),
        (({}, np.zeros), "train must return a model and a dict of keywords, got ({}, <built-in function zeros>)"),
        ((1, 2, 3), "train must return a model with predict or a function, got (1, 2, 3)"),
        ((np.zeros, {"fidelity": "coarse"}), "accepts only 'observation', 'action', 'action_repeat', got 'fidelity'"),
    ],
)
def test_what_is_no_model_is_refused(trained: Any, sentence: str) -> None:
    with pytest.raises((TypeError, ValueError), match=re.escape(sentence)):
        trainings.playing(trained)


def test_observations_are_normalized_as_the_model_was_trained() -> None:
    model = Mock(**{"predict.side_effect": lambda seen, **_: (seen, None)})
    normalized = model.get_vec_normalize_env.return_value
    normalized.normalize_obs, normalized.observation_space = np.negative, gym.spaces.Box(-1.0, 1.0, (1,))
    acting = trainings.playing((model, {"action_repeat": 2}))
    assert (acting.policy.predict(np.ones((3, 1)))[0].sum(), acting.keywords) == (-3.0, {"action_repeat": 2})


@pytest.mark.parametrize("contact", ["exact", "pymunk"])
def test_the_setting_without_rates_has_the_other_numbers_of_state(contact: str) -> None:
    start = {"state": np.linspace(-0.9, 1.3, 12)}
    seen, whole = (
        gym.make("JackInBox-v0", contact=contact, **keywords).reset(options=start)[0]
        for keywords in (trainings.SETTINGS["no rates"], {})
    )
    np.testing.assert_allclose(seen, whole[[0, 1, 4, 5, 7, 8]], rtol=1e-6)


@pytest.mark.parametrize("setting", trainings.SETTINGS)
def test_algorithms_are_trained_and_evaluated_in_each_setting(setting: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(
        with_sb3.ALGORITHMS, "PPO", (*with_sb3.ALGORITHMS["PPO"][:2], 2, 100, {"n_steps": 10, "batch_size": 20})
    )
    monkeypatch.setattr(trainings, "CURVE_EPISODES", 2)
    row = trainings.training("", "PPO", setting, "juggle", 0, 4)
    assert (row["setting"], len(row["curve"]), row["steps"][-1]) == (setting, trainings.POINTS, 200)

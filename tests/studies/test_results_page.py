"""The page of what policies earn."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from agents.evaluation import evaluate, find_policy
from agents.settings import EnvSettings
from jackbox_env import JackInBoxVectorEnv, Lookahead, Scene
from jackbox_env.tasks import TASKS
from scripts.studies.results import across, ahead, attainable, chirps, page, results

DOCS = Path(__file__).parents[2] / "docs"


def test_the_page_is_what_was_measured() -> None:
    record = json.loads((DOCS / "results.json").read_text())
    assert (DOCS / "results.md").read_text() == page.page(record)
    found = {(row["task"], row["contact"], row["policy"]) for row in record["rows"]}
    assert found == {
        (task, contact, name) for task in TASKS for contact in results.CONTACTS for name in results.policies_on(task)
    }


def test_the_distilled_policy_is_between_ppo_and_the_planner_and_looking_ahead_earns_300() -> None:
    record = json.loads((DOCS / "results.json").read_text())
    rows = {(row["task"], row["contact"], row["policy"]): row["interval_95"] for row in record["rows"]}
    for contact in results.CONTACTS:
        ppo, distilled, planner = (rows["juggle", contact, name] for name in ("ppo", "distilled", "planner"))
        assert ppo[1] < distilled[0]
        assert distilled[1] < planner[0]
    assert rows["juggle", "exact", "distilled"][0] > 310.0
    assert [row["seed"] for row in record["ahead"]] == list(ahead.SEEDS)
    assert sum(row["interval_95"][0] > 300.0 for row in record["ahead"]) >= 4


def test_the_plan_alone_is_what_the_wrapper_plays_to_an_agent_that_says_0() -> None:
    policy, earned = ahead.PlanAlone(), 0.0
    plain: Any = gym.make("JackInBox-v0", contact="exact")
    seen, _ = plain.reset(seed=4)
    state = None
    for _ in range(100):
        action, state = policy.predict(seen, state)
        seen, reward, *_ = plain.step(action)
        earned += float(reward)
    env = Lookahead(gym.make("JackInBox-v0", contact="exact"), follow=True, hold=5, samples=32)
    env.reset(seed=4)
    assert sum(float(env.step(np.zeros(1, np.float32))[1]) for _ in range(20)) == pytest.approx(earned, abs=1e-6)


def test_the_command_beside_the_trainings_makes_them() -> None:
    import tyro

    from agents.settings import TrainSettings

    given = shlex.split(ahead.COMMAND)[2:]
    assert tyro.cli(TrainSettings, args=given) == ahead.SETTINGS


def test_the_table_of_trainings_says_shares_and_minutes() -> None:
    parts = {"environment": 6.0, "looking ahead": 90.0, "learning": 12.0, "choosing actions, evaluations and files": 12}
    row = {"seed": 3, "mean": 311.24, "interval_95": [309.0, 313.0], "time": {"seconds": 120.0, "parts": parts}}
    lines = ahead.text([row, {**row, "interval_95": [299.0, 301.0]}], {"mean": 317.0, "interval_95": [315.0, 319.0]})
    assert "in 1 of 2 trainings" in lines[3]
    assert "earns 317.0 (315.0 to 319.0)" in lines[3]
    assert lines[9] == "| 3 | 311.2 | 309.0 to 313.0 | 2.0 | 75 % | 5 % | 10 % |"


def test_the_shipped_network_and_the_planner_are_above_the_level_box() -> None:
    rows = {
        (row["task"], row["contact"], row["policy"]): row
        for row in json.loads((DOCS / "results.json").read_text())["rows"]
    }
    for task in TASKS:
        for contact in results.CONTACTS:
            level, ppo, planner = (rows[task, contact, name]["interval_95"] for name in ("level", "ppo", "planner"))
            assert level[1] < ppo[0] < ppo[1] < planner[0], (task, contact)


def test_a_row_holds_what_evaluating_gives() -> None:
    row = results.measured("spin", "exact", "zero", 8)
    settings = EnvSettings(task="spin", contact="exact")
    policy, _ = find_policy("zero", settings, results.SEED)
    returns = evaluate("zero", policy, settings.env_settings, 8, results.SEED).returns
    assert row["returns"] == returns
    assert row["iqm"] == pytest.approx(np.mean(np.sort(returns)[2:6]))
    low, high = row["iqm_interval_95"]
    assert low < row["iqm"] < high


def test_chirps_are_swept_from_the_same_starts_and_earn_what_the_environment_pays() -> None:
    tried = [chirps.chirps()[0], chirps.chirps()[-1]]
    found = chirps.returns_of("rattle", tried, 2, 5)
    for number, fields in enumerate(tried):
        scene = {"drive": fields}
        env = gym.make("JackInBox-v0", contact="exact", task="rattle", torque="chirp", scene=scene)
        env.reset(seed=6)
        earned = sum(float(env.step(0.0)[1]) for _ in range(500))
        assert found[number, 1] == pytest.approx(earned, abs=1e-9)
    assert len(chirps.chirps()) == 400


def test_spin_pays_nothing_before_a_jack_can_have_fallen_to_a_wall() -> None:
    env = JackInBoxVectorEnv(64, contact="exact", task="spin")
    env.reset(seed=3)
    unpaid = attainable.unpaid_steps(env.states)
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (500, 64, 1)).astype(np.float32)
    rewards = np.array([env.step(action)[1] for action in actions])
    for number, count in enumerate(unpaid.astype(int).tolist()):
        assert not rewards[:count, number].any()
    paid = (rewards != 0.0).argmax(axis=0)
    assert (paid - unpaid).min() <= 2  # the bound is close for some


@pytest.mark.parametrize("speed", [5.0, 10.85, 30.0, 50.0])
def test_rattle_pays_a_jack_that_flies_to_and_fro_what_the_page_says(speed: float) -> None:
    scene = Scene(box_mass=1e12, gravity=0.0)  # weightless, in a box that does not give way
    env: Any = gym.make("JackInBox-v0", contact="exact", task="rattle", scene=scene)
    env.reset(options={"state": [0.0] * 9 + [speed, 0.0, 0.0]})
    earned = sum(float(env.step([0.0])[1]) for _ in range(500))
    assert earned == pytest.approx(attainable.rattle_at(speed), abs=1.01)  # of a knock


def test_the_speed_of_a_return_is_that_which_earns_it() -> None:
    for speed in (3.0, 40.0):
        assert attainable.speed_of(attainable.rattle_at(speed)) == pytest.approx(speed)


def test_scenes_across_hold_the_default_and_the_ends_of_what_varies() -> None:
    fields = across.grid()
    assert sum(map(across.is_default, fields)) == 1
    for name, ends in across.RANGES.items():
        found = [one[name] for one in fields]
        assert [min(found), max(found)] == ends
    assert across.TRAININGS["varied scenes"].randomized == across.RANGES

"""The page of what policies earn."""

from __future__ import annotations

import json
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from agents.evaluation import evaluate, find_policy
from agents.settings import EnvSettings
from jackbox_env.tasks import TASKS
from scripts.studies import results

DOCS = Path(__file__).parents[2] / "docs"


def test_the_page_is_what_was_measured() -> None:
    record = json.loads((DOCS / "results.json").read_text())
    assert (DOCS / "results.md").read_text() == results.page(record)
    found = {(row["task"], row["contact"], row["policy"]) for row in record["rows"]}
    assert found == {
        (task, contact, name) for task in TASKS for contact in results.CONTACTS for name in results.POLICIES
    }


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
    tried = [results.chirps()[0], results.chirps()[-1]]
    found = results.returns_of("rattle", tried, 2, 5)
    for number, fields in enumerate(tried):
        scene = {"drive": fields}
        env = gym.make("JackInBox-v0", contact="exact", task="rattle", torque="chirp", scene=scene)
        env.reset(seed=6)
        earned = sum(float(env.step(0.0)[1]) for _ in range(500))
        assert found[number, 1] == pytest.approx(earned, abs=1e-9)
    assert len(results.chirps()) == 400
